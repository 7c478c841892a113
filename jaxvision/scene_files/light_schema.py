"""`[[light]]` and `[ambient]` of a scene file. Lengths in m, radiance in W m^-2 sr^-1."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..toml_files import Entry, NonNegative, Vector
from .spectrum_schema import Spectrum


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
