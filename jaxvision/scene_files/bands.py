"""Spectra of a scene file, reduced to the bands in which the scene is rendered.

With wavelengths, a band is the value at its wavelength, interpolated linearly; beyond its table a
reflectance keeps its end value and a light is 0. Without wavelengths, three bands are linear sRGB:
for a reflectance its colour under D65, 1 for perfect white; for light the integral of S(lambda)
xyz(lambda) over that of y(lambda), so that a flat spectrum of 1 has Y = 1. Colours outside the sRGB
gamut are clipped at 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import colour_data
from .._types import NOT_NEGATIVE, POSITIVE
from ..colour_spaces import xyz_to_rgb
from ..errors import InputError, nearest
from ..record_files import Reading, record_of, value_of
from ..spectra import (
    LUMINOUS_EFFICACY,
    blackbody,
    integrate_spectrum,
    reflectance_to_xyz,
    spectrum_to_xyz,
)
from .folder import Folder
from .schema import Grid

Quantity = Literal["reflectance", "light"]


@dataclass(frozen=True, kw_only=True)
class Tabulated:
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

    pairs: Annotated[Float[Array, "pairs 2"], NOT_NEGATIVE] | None = None
    file: str | None = None
    column: str | None = None
    illuminant: str | None = None
    patch: str | None = None
    chart: str = "ColorChecker N Ohta"
    blackbody: Annotated[float, POSITIVE] | None = None
    scale: Annotated[float, NOT_NEGATIVE] = 1.0

    def __post_init__(self) -> None:
        sources = (self.pairs, self.file, self.illuminant, self.patch, self.blackbody)
        if sum(source is not None for source in sources) != 1:
            raise InputError("give one of pairs, file, illuminant, patch and blackbody.")
        if self.pairs is not None:
            known = np.asarray(self.pairs)[:, 0]
            if len(known) < 2 or not known[0] > 0:
                raise InputError("pairs must be at least 2, of wavelengths above 0.")
            if (np.diff(known) <= 0).any():
                raise InputError("the wavelengths of pairs must ascend.")
        if self.column is not None and self.file is None:
            raise InputError("column is that of a file; give the file.")


# A number for all bands alike, one for each band, or a table.
Spectrum = np.ndarray | Tabulated


def spectrum_of(reading: Reading, where: str, value: Any) -> Spectrum:
    """A spectrum as a file states it; `InputError` for what is none."""
    if isinstance(value, Mapping):
        return record_of(reading, where, Tabulated, value)
    return value_of(reading, where, Annotated[Float[Array, "..."], NOT_NEGATIVE], value)


@dataclass(frozen=True)
class Bands:
    """The bands of a scene.

    Attributes:
        count: number of bands.
        wavelengths: (bands,) m, or None: RGB if there are three bands.
    """

    count: int
    wavelengths: np.ndarray | None = None


def bands_of(count: int | None, wavelengths: Grid | tuple[float, ...] | None) -> Bands:
    """The bands that a scene file asks for.

    Args:
        count: number of bands, or None: 3.
        wavelengths: list or grid in nm, or None.

    Returns:
        The bands, wavelengths in m.

    Raises:
        InputError: the wavelengths do not ascend.
    """
    if wavelengths is None:
        return Bands(3 if count is None else count)
    if isinstance(wavelengths, Grid):
        steps = round((wavelengths.last - wavelengths.first) / wavelengths.step)
        values = np.linspace(wavelengths.first, wavelengths.last, steps + 1)
    else:
        values = np.asarray(wavelengths)
        if (np.diff(values) <= 0).any():
            raise InputError("wavelengths must ascend; sort them.")
    return Bands(len(values), values * 1e-9)


def in_bands(spectrum: Spectrum, bands: Bands, folder: Folder, *, quantity: Quantity) -> np.ndarray:
    """A spectrum of a scene file in the bands of the scene.

    Args:
        spectrum: a number, a list of one per band, or a table.
        bands: the bands of the scene.
        folder: where the file's paths start.
        quantity: "reflectance" or "light".

    Returns:
        (bands,) in the unit of the spectrum.

    Raises:
        InputError: another number of values than bands, or an unknown table.
    """
    if isinstance(spectrum, Tabulated):
        return _tabulated(spectrum, bands, folder, quantity)
    values = np.atleast_1d(np.asarray(spectrum, float))
    if values.shape not in ((1,), (bands.count,)):
        raise InputError(
            f"a spectrum has {len(values)} numbers where the scene has {bands.count} bands; give "
            f"one number for all or {bands.count}."
        )
    return np.broadcast_to(values, bands.count).copy()


def reduction(known: np.ndarray, bands: Bands, *, quantity: Quantity) -> np.ndarray:
    """Matrix from a spectrum at given wavelengths to the bands of the scene, before clipping.

    Args:
        known: (known,) m.
        bands: the bands of the scene.
        quantity: "reflectance" or "light".

    Returns:
        (known, bands), no unit.
    """
    ends = None if quantity == "reflectance" else 0.0  # None: the value at the end
    wanted = _samples(bands)
    each = np.eye(len(known))
    sampled = np.stack([np.interp(wanted, known, one, left=ends, right=ends) for one in each])
    return sampled if bands.wavelengths is not None else sampled @ colours_of(wanted, quantity)


def _tabulated(spectrum: Tabulated, bands: Bands, folder: Folder, quantity: Quantity) -> np.ndarray:
    if spectrum.pairs is not None or spectrum.file is not None:
        if spectrum.pairs is not None:
            nanometres, values = np.asarray(spectrum.pairs, float).T
            known = nanometres * 1e-9
        else:
            assert spectrum.file is not None
            known, values = _column(spectrum.file, spectrum.column, folder)
        reduced = values @ reduction(known, bands, quantity=quantity)
    else:
        wanted = _samples(bands)
        values = _from_library(spectrum, wanted)
        reduced = values if bands.wavelengths is not None else values @ colours_of(wanted, quantity)
    return spectrum.scale * np.maximum(reduced, 0)


def _samples(bands: Bands) -> np.ndarray:
    """The wavelengths in m at which spectra are evaluated: the bands' own, or the visible range."""
    if bands.wavelengths is not None:
        return bands.wavelengths
    if bands.count != 3:
        raise InputError(
            f"a tabulated spectrum cannot become {bands.count} bands that have no wavelengths; "
            "give the scene its wavelengths."
        )
    return np.arange(360, 831) * 1e-9


def colours_of(wavelengths: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Linear sRGB of a spectrum that is 1 at one wavelength and 0 at the others.

    Args:
        wavelengths: (wavelengths,) m.
        quantity: "reflectance" or "light", as described above.

    Returns:
        (wavelengths, 3), relative.
    """
    grid, each = jnp.asarray(wavelengths), jnp.eye(len(wavelengths))
    observer = colour_data.observer(grid)
    if quantity == "reflectance":
        xyz = reflectance_to_xyz(each, grid, observer, colour_data.illuminant("D65", grid))
    else:
        flat = LUMINOUS_EFFICACY * integrate_spectrum(observer[:, 1], grid)
        xyz = spectrum_to_xyz(each, grid, observer) / flat
    return np.asarray(xyz_to_rgb(xyz))


def _from_library(spectrum: Tabulated, wavelengths: np.ndarray) -> np.ndarray:
    """The spectrum of a name or a temperature at these wavelengths in m."""
    grid = jnp.asarray(wavelengths)
    if spectrum.illuminant is not None:
        return np.asarray(colour_data.illuminant(spectrum.illuminant, grid))
    if spectrum.blackbody is not None:
        return np.asarray(blackbody(grid, jnp.asarray(spectrum.blackbody, grid.dtype)))
    import colour

    charts = colour.SDS_COLOURCHECKERS
    if spectrum.chart not in charts:
        raise InputError(f"no chart {spectrum.chart!r}; {nearest(spectrum.chart, charts)}.")
    patches, patch = list(charts[spectrum.chart]), str(spectrum.patch)
    if patch not in patches:
        raise InputError(f"no patch {patch!r} on {spectrum.chart}; {nearest(patch, patches)}.")
    every = colour_data.chart_reflectances(grid, name=spectrum.chart)
    return np.asarray(every[patches.index(patch)])


def _column(name: str, column: str | None, folder: Folder) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths, m, and values of one column of a CSV."""
    file, lines = folder.file(name), folder.text(name).splitlines()
    heads = [head.strip() for head in lines[0].split(",")] if lines else []
    if len(heads) < 2:
        raise InputError(f"{file}: no columns; begin with a line of heads, as in wavelength,value.")
    wanted = heads[1] if column is None else column
    if wanted not in heads[1:]:
        raise InputError(f"{file}: no column {wanted!r}; {nearest(wanted, heads[1:])}.")
    rows = []
    for number, line in enumerate(lines[1:], 2):
        if line.strip():
            cells = line.split(",")
            try:
                rows.append((float(cells[0]), float(cells[heads.index(wanted)])))
            except (ValueError, IndexError):
                raise InputError(
                    f"{file}, line {number}: {line.strip()[:40]!r} has no number for {wanted!r}; "
                    "correct it."
                ) from None
    table = np.asarray(rows).reshape(-1, 2)
    if len(table) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(
            f"{file}: a spectrum takes at least two rows of finite numbers whose wavelengths "
            "ascend; correct it."
        )
    if (table[:, 1] < 0).any():
        raise InputError(f"{file}: {wanted!r} has negative values; a spectrum has none.")
    return table[:, 0] * 1e-9, table[:, 1]
