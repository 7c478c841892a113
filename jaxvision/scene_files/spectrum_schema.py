"""Numbers and spectra of a scene file."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, model_validator

from ..colour_data import MOST_BANDS
from ..toml_files import Entry, NonNegative, Positive, Vector

Axes = tuple[Vector, Vector, Vector]


class Tabulated(Entry):
    """A spectrum by its wavelengths or by name, reduced to the bands of the scene.

    One of `pairs`, `file`, `illuminant`, `patch` and `blackbody` is given.

    Attributes:
        pairs: [wavelength in nm, value], wavelengths ascending, as many as there are.
        file: a CSV with a header line and wavelengths in nm in its first column.
        column: header of the column with the values; by default the second column.
        illuminant: relative power by colour-science's name ("D65", "A", "FL2").
        patch: reflectance of a patch of `chart`.
        chart: name of the chart.
        blackbody: temperature in K, for W m^-2 sr^-1 per m.
        scale: factor on the spectrum, no unit.
    """

    pairs: Annotated[tuple[tuple[Positive, NonNegative], ...], Field(min_length=2)] | None = None
    file: str | None = None
    column: str | None = None
    illuminant: str | None = None
    patch: str | None = None
    chart: str = "ColorChecker N Ohta"
    blackbody: Positive | None = None
    scale: NonNegative = 1.0

    @model_validator(mode="after")
    def _one_source(self) -> "Tabulated":
        sources = (self.pairs, self.file, self.illuminant, self.patch, self.blackbody)
        if sum(source is not None for source in sources) != 1:
            raise ValueError("give one of pairs, file, illuminant, patch and blackbody")
        known = [wavelength for wavelength, _ in self.pairs or ()]
        if any(after <= before for before, after in pairwise(known)):
            raise ValueError("the wavelengths of pairs must ascend")
        if self.column is not None and self.file is None:
            raise ValueError("column is that of a file; give the file")
        return self


def _spectrum_kind(value: Any) -> str:
    if isinstance(value, Mapping | Tabulated):
        return "table"
    return "list" if isinstance(value, list | tuple) else "number"


# A number for all bands alike, a list of one per band, or a table.
Spectrum = Annotated[
    Annotated[NonNegative, Tag("number")]
    | Annotated[tuple[NonNegative, ...], Tag("list"), Field(min_length=1)]
    | Annotated[Tabulated, Tag("table")],
    Discriminator(_spectrum_kind),
]


class Grid(Entry):
    """Evenly spaced wavelengths.

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
