"""What may stand in a scene file: the models below are the documentation of the format.

A scene file is TOML. Lengths are metres, angles degrees, radiance W m^-2 sr^-1; paths are relative
to the file. `[camera]`, `[[surface]]` and `[material.NAME]` are what most scenes need; `[[light]]`,
`[ambient]`, `[render]` and `wavelengths` are as wanted. What a number means is said by the record
that is made of it (`Pinhole`, `Quad`, `Lambert`, ...), whose field has the same name. Spectra are
in `spectrum_schema`, materials in `material_schema`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .._toml import Entry, checked
from ..errors import InputError
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
    """`name`: for messages. `material`: a `[material.NAME]`, or none for a black surface that
    shines. `emission`: W m^-2 sr^-1 from its front. `two_sided`: both sides are fronts."""

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
    """A sphere."""

    shape: Literal["sphere"]
    centre: Vector
    radius: Positive


class PlaneEntry(_Surface):
    """An unbounded plane."""

    shape: Literal["plane"]
    point: Vector
    normal: Vector


class DiscEntry(_Surface):
    """A flat disc."""

    shape: Literal["disc"]
    centre: Vector
    normal: Vector
    radius: Positive


class QuadEntry(_Surface):
    """A flat parallelogram."""

    shape: Literal["quad"]
    corner: Vector
    edge_u: Vector
    edge_v: Vector


class BoxEntry(_Surface):
    """A box, its axes those of the room or turned."""

    shape: Literal["box"]
    centre: Vector
    half_extents: tuple[Positive, Positive, Positive]
    rotation: Axes | None = None


class MeshEntry(_Surface):
    """`file`: OBJ, PLY, GLB or another that trimesh reads. Its points are scaled, then rotated
    (rows are the file's axes in the world), then moved. `smooth`: shade with normals interpolated
    between vertices. `flip`: turn the surface inside out."""

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
    """Light from a point."""

    kind: Literal["point"]
    name: str | None = None
    position: Vector
    intensity: Spectrum


class DirectionalEntry(Entry):
    """Light from one direction."""

    kind: Literal["directional"]
    name: str | None = None
    direction: Vector
    irradiance: Spectrum


class RectangleEntry(Entry):
    """A rectangle that shines to one side."""

    kind: Literal["rectangle"]
    name: str | None = None
    corner: Vector
    edge_u: Vector
    edge_v: Vector
    radiance: Spectrum


class EnvironmentEntry(Entry):
    """`file`: a latitude-longitude EXR or HDR of as many bands as the scene, times `scale`; or
    `radiance`, the same from everywhere. `up`: where the top of the picture lies, `toward`: its
    middle column."""

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
    PointEntry | DirectionalEntry | RectangleEntry | EnvironmentEntry, Field(discriminator="kind")
]


class AmbientEntry(Entry):
    """The same light from everywhere."""

    radiance: Spectrum


# ---------------------------------------------------------------- camera


class _Camera(Entry):
    """`position` looks at `target`; `up` points to the top of the picture. `resolution`: rows and
    columns."""

    position: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    resolution: tuple[Count, Count]


class OrthographicEntry(_Camera):
    """`width`: m of the scene across the picture."""

    kind: Literal["orthographic"]
    width: Positive


class PinholeEntry(_Camera):
    """Either `field_of_view`, degrees across the width of the picture, or `focal_length` and
    `pixel_pitch`."""

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
    """`focus_distance`: m, absent at infinity. `blades`: of the iris, absent for a round one."""

    kind: Literal["thin_lens"]
    focal_length: Positive
    pixel_pitch: Positive
    f_number: Positive
    focus_distance: Positive | None = None
    blades: Annotated[int, Field(ge=3)] | None = None


Camera = Annotated[OrthographicEntry | PinholeEntry | ThinLensEntry, Field(discriminator="kind")]


# ---------------------------------------------------------------- the whole


# Samples and depth where neither the file nor the command says them: enough for a first picture.
_USUAL = {
    "direct": {"samples": 1, "depth": 1},
    "rays": {"samples": 1, "depth": 16},
    "path": {"samples": 64, "depth": 6},
    "light": {"samples": 64, "depth": 6},
    "radiosity": {"samples": 1, "depth": 1},
}


class RenderEntry(Entry):
    """How the scene is rendered unless the command says otherwise.

    `integrator`: "direct" sums over the lights; "path" adds what bounces; "rays" follows mirrors
    and glass; "light" traces from the lights; "radiosity" solves for diffuse patches. `samples`:
    rays or paths a pixel; 64 of "path" and "light" if absent, else 1. `depth`: the most straight
    pieces of a path, 6 if absent; of "rays", how many rays of the tree are followed, 16. `rule`,
    `order`: how "direct", "rays" and "radiosity" take an extended light apart: by quadrature of
    `order` a side, or, but not by "rays", by `order` random samples. `shadows`: of "direct".
    `patches`: about how many, of "radiosity". `gather`: of "radiosity" alone, rays from each point
    seen that look for what other surfaces send there, drawn anew for each sample; 0: that is
    interpolated between patches. `seed`: of what is random. `tile`: pixels computed at once; of
    "light" without meaning, whose passes are whole pictures.
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
    """The settings with those `given`, None apart. Samples and depth are meant for the integrator
    that they were written beside: another one begins with its usual ones. `InputError` for the
    first that is out of range, or of another integrator."""
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
    """A whole file. `bands`: how many, if neither RGB nor given by `wavelengths` (nm)."""

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
