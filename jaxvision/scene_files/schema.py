"""The format of a scene file; the models below are its documentation.

A scene file is TOML. Lengths are metres, angles degrees, radiance W m^-2 sr^-1; paths are relative
to the file. Most scenes need `[camera]`, `[[surface]]` and `[material.NAME]`; `[[light]]`,
`[ambient]`, `[render]` and `wavelengths` are optional. The meaning of a number is that of the field
of the same name in the record made from the table (`Pinhole`, `Quad`, `Lambert`, ...). Spectra are
in `spectrum_schema`, materials in `material_schema`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from ..errors import InputError
from ..toml_files import Entry, checked
from .material_schema import Material
from .spectrum_schema import (
    Axes,
    Count,
    NonNegative,
    Positive,
    Spectrum,
    Vector,
    Wavelengths,
)

# ---------------------------------------------------------------- surfaces


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


class MeshEntry(_Surface):
    """Triangles from a file. Points are scaled, then rotated, then moved.

    Attributes:
        shape: "mesh".
        file: OBJ, PLY, GLB or another format that trimesh reads.
        scale: m per unit of the file.
        rotation: rows are the file's axes in the world.
        position: m, added to every point.
        smooth: shade with normals interpolated between vertices.
        flip: turn the surface inside out.
    """

    shape: Literal["mesh"]
    file: str
    scale: Positive = 1.0
    rotation: Axes | None = None
    position: Vector = (0.0, 0.0, 0.0)
    smooth: bool = False
    flip: bool = False


Surface = Annotated[
    SphereEntry | PlaneEntry | DiscEntry | QuadEntry | BoxEntry | MeshEntry,
    Field(discriminator="shape"),
]


# ---------------------------------------------------------------- lights


class PointEntry(Entry):
    """A point light.

    Attributes:
        kind: "point".
        name: for messages.
        position: m.
        intensity: W sr^-1.
    """

    kind: Literal["point"]
    name: str | None = None
    position: Vector
    intensity: Spectrum


class SmallEntry(Entry):
    """A small flat lamp: light from a point, with the cosine to its normal.

    Attributes:
        kind: "small".
        name: for messages.
        position: m.
        normal: direction of its brightest light.
        intensity: W sr^-1 along the normal.
    """

    kind: Literal["small"]
    name: str | None = None
    position: Vector
    normal: Vector
    intensity: Spectrum


class DirectionalEntry(Entry):
    """Light from one direction.

    Attributes:
        kind: "directional".
        name: for messages.
        direction: from the scene towards the light.
        irradiance: W m^-2 on a surface that faces the light.
    """

    kind: Literal["directional"]
    name: str | None = None
    direction: Vector
    irradiance: Spectrum


class RectangleEntry(Entry):
    """A rectangle that emits from one side.

    Attributes:
        kind: "rectangle".
        name: for messages.
        corner: m.
        edge_u: m, from the corner.
        edge_v: m, from the corner; it emits from the side of edge_u x edge_v.
        radiance: W m^-2 sr^-1.
    """

    kind: Literal["rectangle"]
    name: str | None = None
    corner: Vector
    edge_u: Vector
    edge_v: Vector
    radiance: Spectrum


class EnvironmentEntry(Entry):
    """Distant light from all directions: a picture or a constant.

    Attributes:
        kind: "environment".
        name: for messages.
        file: a latitude-longitude EXR or HDR with as many bands as the scene.
        radiance: W m^-2 sr^-1, the same from all directions, instead of a file.
        scale: factor on the radiance, no unit.
        up: direction of the top of the picture.
        toward: direction of its middle column.
    """

    kind: Literal["environment"]
    name: str | None = None
    file: str | None = None
    radiance: Spectrum | None = None
    scale: NonNegative = 1.0
    up: Vector = (0.0, 0.0, 1.0)
    toward: Vector = (1.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_source(self) -> "EnvironmentEntry":
        if (self.file is None) == (self.radiance is None):
            raise ValueError("give either file or radiance")
        return self


Light = Annotated[
    PointEntry | SmallEntry | DirectionalEntry | RectangleEntry | EnvironmentEntry,
    Field(discriminator="kind"),
]


class AmbientEntry(Entry):
    """Uniform light from all directions.

    Attributes:
        radiance: W m^-2 sr^-1.
    """

    radiance: Spectrum


# ---------------------------------------------------------------- camera


class _Camera(Entry):
    """Fields of every camera.

    Attributes:
        position: m.
        target: m, the point at which the camera looks.
        up: direction of the top of the picture.
        resolution: (rows, columns) pixels.
    """

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    resolution: tuple[Count, Count]


class OrthographicEntry(_Camera):
    """Parallel projection.

    Attributes:
        kind: "orthographic".
        width: m of the scene across the picture.
    """

    kind: Literal["orthographic"]
    width: Positive


class PinholeEntry(_Camera):
    """Central projection; either `field_of_view`, or `focal_length` and `pixel_pitch`.

    Attributes:
        kind: "pinhole".
        field_of_view: degrees across the width of the picture.
        focal_length: m.
        pixel_pitch: m.
    """

    kind: Literal["pinhole"]
    field_of_view: Annotated[Positive, Field(lt=180)] | None = None
    focal_length: Positive | None = None
    pixel_pitch: Positive | None = None

    @model_validator(mode="after")
    def _one_way(self) -> "PinholeEntry":
        by_size = (self.focal_length is not None, self.pixel_pitch is not None)
        if any(by_size) == (self.field_of_view is not None) or (any(by_size) and not all(by_size)):
            raise ValueError("give either field_of_view, or focal_length and pixel_pitch")
        return self


class ThinLensEntry(_Camera):
    """Central projection through a lens.

    Attributes:
        kind: "thin_lens".
        focal_length: m.
        pixel_pitch: m.
        f_number: no unit.
        focus_distance: m; absent for focus at infinity.
        blades: of the iris; absent for a round aperture.
    """

    kind: Literal["thin_lens"]
    focal_length: Positive
    pixel_pitch: Positive
    f_number: Positive
    focus_distance: Positive | None = None
    blades: Annotated[int, Field(ge=3)] | None = None


Camera = Annotated[OrthographicEntry | PinholeEntry | ThinLensEntry, Field(discriminator="kind")]


# ---------------------------------------------------------------- the whole


# Samples and depth unless the file or the command gives them: enough for a first picture.
_USUAL = {
    "direct": {"samples": 1, "depth": 1},
    "rays": {"samples": 1, "depth": 16},
    "path": {"samples": 64, "depth": 6},
    "light": {"samples": 64, "depth": 6},
    "radiosity": {"samples": 1, "depth": 1},
}


class RenderEntry(Entry):
    """How the scene is rendered unless the command says otherwise.

    Attributes:
        integrator: "direct" sums over the lights; "path" adds reflected light; "rays" follows
            mirrors and glass; "light" traces from the lights; "radiosity" solves for diffuse
            patches.
        samples: rays or paths per pixel; by default 64 for "path" and "light", else 1.
        depth: the most segments of a path, by default 6; for "rays" the most rays of the tree, by
            default 16.
        rule: how "direct", "rays" and "radiosity" sample an extended light: by quadrature or,
            except for "rays", at random.
        order: quadrature nodes per side of a light, or random samples per light.
        shadows: whether "direct" traces shadows.
        patches: approximate number of patches for "radiosity".
        gather: rays from each visible point by which "radiosity" gathers the light of other
            surfaces, drawn anew for each sample; 0 interpolates between patches instead.
        seed: of all random numbers.
        tile: pixels computed at once; unused by "light", which renders whole pictures.
        dtype: "float32" or "float64".
    """

    integrator: Literal["direct", "path", "rays", "light", "radiosity"] = "direct"
    samples: Count
    depth: Count
    rule: Literal["quadrature", "monte_carlo", "balanced"] = "quadrature"
    order: Count = 8
    shadows: bool = True
    patches: Count = 1000
    gather: Annotated[int, Field(strict=True, ge=0)] = 0
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**32)] = 0
    tile: Count = 65536
    dtype: Literal["float32", "float64"] = "float32"

    @model_validator(mode="before")
    @classmethod
    def _usual(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        integrator = given.get("integrator", "direct")
        usual = _USUAL.get(integrator, {}) if isinstance(integrator, str) else {}
        return {**usual, **given}


def overridden(settings: RenderEntry, given: Mapping[str, Any]) -> RenderEntry:
    """Settings of a file with some values replaced.

    Samples and depth belong to the integrator beside which they were written: another integrator
    starts from its own defaults.

    Args:
        settings: those of the file.
        given: replacements by name; None leaves a setting.

    Returns:
        The settings.

    Raises:
        InputError: the first value that is out of range or belongs to another integrator.
    """
    given = {name: value for name, value in given.items() if value is not None}
    kept = settings.model_dump()
    if given.get("integrator", settings.integrator) != settings.integrator:
        del kept["samples"], kept["depth"]
    if given.get("gather") and given.get("integrator", settings.integrator) != "radiosity":
        raise InputError(
            f"gather = {given['gather']} is of radiosity alone; leave it out, or set the "
            "integrator to 'radiosity'."
        )
    return checked("render", {**kept, **given}, RenderEntry, "scene")


class SceneEntry(Entry):
    """A whole file.

    Attributes:
        camera: the camera.
        surface: the surfaces, at least one.
        material: the materials by name.
        light: the lights.
        ambient: uniform light.
        render: how the scene is rendered.
        bands: number of bands, if neither RGB nor given by `wavelengths`.
        wavelengths: nm, a list or a grid.
    """

    camera: Camera
    surface: Annotated[tuple[Surface, ...], Field(min_length=1)]
    material: dict[str, Material] = Field(default_factory=dict)
    light: tuple[Light, ...] = ()
    ambient: AmbientEntry | None = None
    render: RenderEntry = Field(default_factory=lambda: RenderEntry.model_validate({}))
    bands: Count | None = None
    wavelengths: Wavelengths | None = None

    @model_validator(mode="after")
    def _bands_once(self) -> "SceneEntry":
        if self.bands is not None and self.wavelengths is not None:
            raise ValueError("give either bands or wavelengths, which also say how many there are")
        return self
