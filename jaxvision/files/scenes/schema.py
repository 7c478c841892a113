"""Models of a whole scene file and of its table `[render]`.

A scene file is written in TOML. Lengths are in metres, angles in degrees, and radiance in W m^-2
sr^-1. Paths are relative to the scene file. Most scenes need `[camera]`, `[[surface]]` and
`[material.NAME]`; `[[light]]`, `[ambient]`, `[render]` and `wavelengths` are optional. The module
`tables` reads each type of table. A key has the same meaning as the field of that name in the
record (`Pinhole`, `Quad`, `Lambert`, ...).
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from ...colour_spaces.colour_data import MOST_BANDS
from ...errors import InputError
from ..toml import Count, Entry, Positive, checked

# Samples and depth unless the file or the command gives them: enough for a first picture.
_USUAL = {
    "direct": {"samples": 1, "depth": 1},
    "rays": {"samples": 1, "depth": 16},
    "path": {"samples": 64, "depth": 6},
    "light": {"samples": 64, "depth": 6},
    "radiosity": {"samples": 1, "depth": 1},
}


# Keys that have no effect with an integrator.
_IDLE = {
    "direct": ("depth", "patches", "gather"),
    "rays": ("patches", "gather"),
    "path": ("rule", "order", "patches", "gather"),
    "light": ("rule", "order", "patches", "gather", "tile"),
    "radiosity": ("depth",),
}


class RenderEntry(Entry):
    """The settings with which a scene is rendered, unless options of the command override them.

    Attributes:
        integrator: "direct" sums over the lights; "path" adds reflected light; "rays" follows
            mirrors and glass; "light" traces from the lights; "radiosity" solves for diffuse
            patches.
        samples: rays or paths per pixel; by default 64 for "path" and "light", else 1.
        depth: largest number of segments of a path, by default 6; for "rays" largest number of rays
            of the tree, by default 16.
        rule: how "direct", "rays" and "radiosity" sample an extended light: by quadrature or,
            except for "rays", at random.
        order: quadrature nodes per side of a light, or random samples per light.
        shadows: whether "direct" traces shadows.
        patches: approximate number of patches for "radiosity".
        gather: number of rays from each visible point with which "radiosity" collects the light of
            other surfaces, drawn anew for each sample; 0 interpolates between patches instead.
        seed: of all random numbers.
        tile: number of pixels computed at once; "light" ignores it and renders whole pictures.
        dtype: "float32" or "float64".
    """

    integrator: Literal["direct", "path", "rays", "light", "radiosity"] = "direct"
    samples: Count
    depth: Count
    rule: Literal["quadrature", "monte_carlo", "balanced"] = "quadrature"
    order: Count = 8
    shadows: bool = True
    patches: Count = 1000
    gather: Annotated[int, Field(strict=True, ge=0, lt=2**31)] = 0
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


def idle(integrator: str, given: Mapping[str, Any]) -> list[str]:
    """Return the names of the given settings that an integrator does not use."""
    return [name for name in _IDLE[integrator] if given.get(name) is not None]


def ineffective_keys(content: Mapping[str, Any], entry: "SceneEntry") -> list[str]:
    """Describe the materials and the keys of `[render]` in a file that do not change the picture,
    in one sentence each, without a full stop. `entry` is the checked content."""
    integrator = entry.render.integrator
    given = content.get("render", {})
    used = {surface.get("material") for surface in entry.surface}
    return [
        *(
            f"render.{name} has no effect with the integrator {integrator!r}"
            for name in idle(integrator, given)
        ),
        *(f"material {name!r} is on no surface" for name in entry.material if name not in used),
    ]


def override_settings(settings: RenderEntry, given: Mapping[str, Any]) -> RenderEntry:
    """Return the settings of a file, overridden by the given settings that are not None. The
    samples and depth of the file are used only with the file's own integrator. Raise `InputError`
    for a wrong value, and for a setting of another integrator."""
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


class Grid(Entry):
    """A grid of evenly spaced wavelengths.

    Attributes:
        first: nm.
        last: nm, included.
        step: nm.
    """

    first: Positive
    last: Positive
    step: Positive

    @model_validator(mode="after")
    def _divides(self) -> "Grid":
        steps = (self.last - self.first) / self.step
        if steps < 1 or abs(steps - round(steps)) > 1e-6:
            raise ValueError("last must lie a whole number of steps above first")
        if steps >= MOST_BANDS:
            raise ValueError(f"{steps + 1:.3g} wavelengths are more than {MOST_BANDS:,}")
        return self


def _wavelengths_kind(value: Any) -> str:
    return "grid" if isinstance(value, Mapping | Grid) else "list"


Wavelengths = Annotated[
    Annotated[tuple[Positive, ...], Tag("list"), Field(min_length=2)]
    | Annotated[Grid, Tag("grid")],
    Discriminator(_wavelengths_kind),
]


Table = dict[str, Any]


class SceneEntry(Entry):
    """The content of a whole scene file.

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

    camera: Table
    surface: Annotated[tuple[Table, ...], Field(min_length=1)]
    material: dict[str, Table] = Field(default_factory=dict)
    light: tuple[Table, ...] = ()
    ambient: Table | None = None
    render: RenderEntry = Field(default_factory=lambda: RenderEntry.model_validate({}))
    bands: Count | None = None
    wavelengths: Wavelengths | None = None

    @model_validator(mode="after")
    def _check_bands(self) -> "SceneEntry":
        if self.bands is not None and self.wavelengths is not None:
            raise ValueError("give either bands or wavelengths, which also say how many there are")
        return self
