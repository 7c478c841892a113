"""`[[surface]]` of a scene file: shapes and their materials. Lengths in m, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..toml_files import Entry, Finite, Positive, Vector
from .spectrum_schema import Axes, Spectrum


class _Surface(Entry):
    """Fields of every surface.

    Attributes:
        name: for messages.
        material: NAME of a `[material.NAME]`; absent for a black surface that emits.
        emission: W m^-2 sr^-1 from its front.
        two_sided: both sides are fronts.
    """

    name: str | None = None
    material: str | None = None
    emission: Spectrum | None = None
    two_sided: bool = False

    @model_validator(mode="after")
    def _is_of_something(self) -> "_Surface":
        if self.material is None and self.emission is None:
            raise ValueError("give a material, an emission or both")
        return self


class SphereEntry(_Surface):
    """A sphere.

    Attributes:
        shape: "sphere".
        centre: m.
        radius: m, > 0.
    """

    shape: Literal["sphere"]
    centre: Vector
    radius: Positive


class PlaneEntry(_Surface):
    """An unbounded plane.

    Attributes:
        shape: "plane".
        point: m, any point of it.
        normal: direction towards its front.
    """

    shape: Literal["plane"]
    point: Vector
    normal: Vector


class DiscEntry(_Surface):
    """A flat disc.

    Attributes:
        shape: "disc".
        centre: m.
        normal: direction towards its front.
        radius: m, > 0.
    """

    shape: Literal["disc"]
    centre: Vector
    normal: Vector
    radius: Positive


class QuadEntry(_Surface):
    """A flat parallelogram.

    Attributes:
        shape: "quad".
        corner: m.
        edge_u: m, from the corner.
        edge_v: m, from the corner; the front is the side of edge_u x edge_v.
    """

    shape: Literal["quad"]
    corner: Vector
    edge_u: Vector
    edge_v: Vector


class BoxEntry(_Surface):
    """A box.

    Attributes:
        shape: "box".
        centre: m.
        half_extents: m, > 0, half of each side.
        rotation: rows are the axes of its sides in the world; absent for the world's axes.
    """

    shape: Literal["box"]
    centre: Vector
    half_extents: tuple[Positive, Positive, Positive]
    rotation: Axes | None = None


_Number = Annotated[int, Field(strict=True, ge=0)]
_Row = tuple[Finite, Finite, Finite, Finite]


class MeshEntry(_Surface):
    """Triangles from a file. Points are scaled, then rotated, then moved; or mapped by `matrix`.

    Attributes:
        shape: "mesh".
        file: OBJ, PLY, GLB or another format that trimesh reads.
        scale: m per unit of the file.
        rotation: rows are the file's axes in the world.
        position: m, added to every point.
        matrix: three rows of four numbers, an affine map of the file's points to m in the world,
            instead of scale, rotation and position.
        smooth: shade with normals interpolated between vertices.
        flip: turn the surface inside out.
        primitive: of a glTF file the numbers of a mesh and of a primitive in it, from 0; absent:
            the whole file.
    """

    shape: Literal["mesh"]
    file: str
    scale: Positive = 1.0
    rotation: Axes | None = None
    position: Vector = (0.0, 0.0, 0.0)
    matrix: tuple[_Row, _Row, _Row] | None = None
    smooth: bool = False
    flip: bool = False
    primitive: tuple[_Number, _Number] | None = None

    @model_validator(mode="after")
    def _placed_once(self) -> "MeshEntry":
        placed = {"scale", "rotation", "position"} & self.model_fields_set
        if self.matrix is not None and placed:
            raise ValueError(f"give either matrix or {', '.join(sorted(placed))}")
        return self


Surface = Annotated[
    SphereEntry | PlaneEntry | DiscEntry | QuadEntry | BoxEntry | MeshEntry,
    Field(discriminator="shape"),
]
