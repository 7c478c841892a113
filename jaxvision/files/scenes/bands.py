"""Reduce the spectra of a scene file to the bands in which the scene is rendered.

A tabulated spectrum is linear between its wavelengths. Beyond the table, a reflectance keeps its
end value, and a light is 0.

If the scene has wavelengths, a band of a reflectance is its value at the band's wavelength. A band
of a light extends half-way to the neighbouring bands. If the table has further wavelengths within
the band, the value of the band is the mean of the spectrum over the part of the band that the table
covers, so that no spectral line of a lamp is lost between the bands. Otherwise the value of the
band is the spectrum's value at the band's wavelength.

If the scene has no wavelengths, three bands are linear sRGB. For a reflectance, the three bands are
its colour under D65, in which a perfect white is (1, 1, 1). For a light, the colour is the integral
of S(lambda) xyz(lambda) divided by the integral of y(lambda), where S is the spectrum and x, y and
z are the colour-matching functions. A flat spectrum of 1 then has Y = 1. Colours outside the sRGB
gamut are clipped at 0. If a reflectance is at most 1, its colour is also clipped at 1, and a
warning says so.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...colour_spaces import colour_data, xyz_to_rgb
from ...core._types import NOT_NEGATIVE, POSITIVE
from ...core._warnings import warn
from ...errors import InputError, nearest
from ...spectra import (
    LUMINOUS_EFFICACY,
    blackbody,
    integrate_spectrum,
    reflectance_to_xyz,
    spectrum_to_xyz,
)
from ..records import Reading, record_of, value_of
from .folder import Folder
from .schema import Grid
from .spectrum_tables import read_table

Quantity = Literal["reflectance", "light"]

_SHORTEST = 10  # nm, the shortest wavelength; smaller numbers were meant in um or m
_ROUNDING = 1e-3  # white is up to 1.0002 in linear sRGB, whose matrix is rounded


@dataclass(frozen=True, kw_only=True)
class Tabulated:
    """A spectrum that is given by wavelengths or by a name, before it is reduced to the bands of
    the scene.

    Exactly one of `pairs`, `file`, `illuminant`, `patch` and `blackbody` is given.

    Attributes:
        pairs: any number of [wavelength in nm, value], wavelengths ascending.
        file: a CSV with a header line. The wavelengths are in the column whose header says so, or
            in the first column. They are in nm unless the header says um, m, angstrom or, for a
            reflectance, cm^-1.
        column: header of the values. By default, it is the only column besides wavelengths, indices
            and uncertainties, or the only column whose header names the quantity. A reflectance may
            be in %.
        illuminant: relative power by colour-science's name ("D65", "A", "FL2"), in upper or lower
            case.
        patch: name of a patch of `chart`, whose reflectance is used.
        chart: name of the chart.
        blackbody: temperature in K, for radiance in W m^-2 sr^-1 per m.
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
    """Read a spectrum from the value of a key in a scene file."""
    if isinstance(value, Mapping):
        return record_of(reading, where, Tabulated, value)
    return value_of(reading, where, Annotated[Float[Array, "..."], NOT_NEGATIVE], value)


@dataclass(frozen=True)
class Bands:
    """The number of bands of a scene, and the wavelengths of the bands if there are any.

    Attributes:
        count: number of bands.
        wavelengths: (bands,) m, or None; then three bands are RGB.
    """

    count: int
    wavelengths: np.ndarray | None = None


def bands_of(count: int | None, wavelengths: Grid | tuple[float, ...] | None) -> Bands:
    """Make the bands of a scene file, 3 by default. A list or a grid of wavelengths is in nm. Raise
    `InputError` for wavelengths that do not ascend, or that seem to be in another unit."""
    if wavelengths is None:
        return Bands(3 if count is None else count)
    if isinstance(wavelengths, Grid):
        steps = round((wavelengths.last - wavelengths.first) / wavelengths.step)
        values = np.linspace(wavelengths.first, wavelengths.last, steps + 1)
    else:
        values = np.asarray(wavelengths)
        if (np.diff(values) <= 0).any():
            raise InputError("wavelengths must ascend; sort them.")
    if values[-1] < _SHORTEST:
        raise InputError(f"wavelengths are in nm, got {values[-1]:.6g}; 0.55 um are 550.")
    return Bands(len(values), values * 1e-9)


def band_values(
    spectrum: Spectrum, bands: Bands, folder: Folder, *, quantity: Quantity
) -> np.ndarray:
    """Convert a spectrum of a scene file to the bands of the scene, (bands,), in the unit of the
    spectrum. Raise `InputError` for another number of values, and for an unknown table."""
    if isinstance(spectrum, Tabulated):
        return _reduce(spectrum, bands, folder, quantity)
    values = np.atleast_1d(np.asarray(spectrum, float))
    if values.shape not in ((1,), (bands.count,)):
        raise InputError(
            f"a spectrum has {len(values)} numbers where the scene has {bands.count} bands; give "
            f"one number for all or {bands.count}."
        )
    return np.broadcast_to(values, bands.count).copy()


def reduction(known: np.ndarray, bands: Bands, *, quantity: Quantity) -> np.ndarray:
    """Return the matrix, (known, bands), no unit, that converts a spectrum at ascending
    wavelengths, in m, to the bands of the scene, before clipping. Raise `InputError` if no
    wavelength of the scene is in the range of the spectrum."""
    nm, wanted = known * 1e9, _samples(bands) * 1e9
    half = np.diff(wanted) / 2
    edges = np.r_[wanted[0] - half[0], wanted[:-1] + half, wanted[-1] + half[-1]]
    if nm[-1] < edges[0] or nm[0] > edges[-1]:
        raise InputError(
            f"a spectrum from {nm[0]:.6g} to {nm[-1]:.6g} nm covers none of the wavelengths "
            f"{wanted[0]:.6g} to {wanted[-1]:.6g} nm of the scene; give its wavelengths in nm, or "
            "their unit in the head of a CSV, as in wavelength_um."
        )
    covered = nm[[0, -1]] if quantity == "light" else np.array([-np.inf, np.inf])
    if bands.wavelengths is None:
        return _integrals(nm, wanted, colours_of(wanted * 1e-9, quantity), covered)
    is_covered = (wanted >= covered[0]) & (wanted <= covered[1])
    matrix = _shares(nm, wanted, np.diag(is_covered.astype(float)))
    if quantity == "light":
        for band, (low, high) in enumerate(pairwise(edges)):
            near = 1e-6 * (high - low)
            inside = (nm >= low - near) & (nm <= high + near) & (abs(nm - wanted[band]) > near)
            if inside.any():
                part = np.clip(covered, low, high) if is_covered[band] else np.array([low, high])
                mean = _integrals(nm, part, np.full((2, 1), 1 / (part[1] - part[0])), covered)
                matrix[:, band] = mean[:, 0]
    return matrix


def _integrals(
    known: np.ndarray, grid: np.ndarray, density: np.ndarray, covered: np.ndarray
) -> np.ndarray:
    """Return the matrix, (known, bands), that integrates a spectrum times a density for each band,
    over a grid of wavelengths. The spectrum and the density are linear between their wavelengths
    and 0 beyond them."""
    points = np.concatenate([grid, known[(known > grid[0]) & (known < grid[-1])]])
    points = np.unique(points[(points >= covered[0]) & (points <= covered[1])])
    at = np.stack([np.interp(points, grid, one) for one in density.T], axis=-1)
    steps, share = np.diff(points)[:, None] / 6, np.zeros_like(at)
    share[:-1] += steps * (2 * at[:-1] + at[1:])  # exact for a product of two lines
    share[1:] += steps * (at[:-1] + 2 * at[1:])
    return _shares(known, points, share)


def _shares(known: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the matrix, (known, bands), that converts values of a spectrum at `known` wavelengths
    to bands. A band is the sum over points of the interpolated spectrum times the weights, (points,
    bands)."""
    above = np.clip(np.searchsorted(known, points, side="right"), 1, max(len(known) - 1, 1))
    below, above = above - 1, np.minimum(above, len(known) - 1)
    t = np.clip((points - known[below]) / np.maximum(known[above] - known[below], 1e-300), 0, 1)
    matrix = np.zeros((len(known), weights.shape[1]))
    np.add.at(matrix, below, (1 - t)[:, None] * weights)
    np.add.at(matrix, above, t[:, None] * weights)
    return matrix


def _reduce(spectrum: Tabulated, bands: Bands, folder: Folder, quantity: Quantity) -> np.ndarray:
    table = _table_of(spectrum, bands, folder, quantity)
    if table is not None:
        known, values = table
        reduced = spectrum.scale * np.maximum(
            values @ reduction(known, bands, quantity=quantity), 0
        )
        is_reflectance = quantity == "reflectance" and spectrum.scale * values.max() <= 1
        if bands.wavelengths is None and is_reflectance and reduced.max() > 1 + _ROUNDING:
            red, green, blue = reduced
            warn(
                f"a reflectance of at most 1 is ({red:.3g}, {green:.3g}, {blue:.3g}) in linear "
                "sRGB, whose colours end at 1, where it is cut; give the scene wavelengths to keep "
                "it."
            )
        return np.minimum(reduced, 1) if is_reflectance else reduced
    wanted = _samples(bands)
    values = _library_spectrum(spectrum, wanted)
    reduced = values if bands.wavelengths is not None else values @ colours_of(wanted, quantity)
    return spectrum.scale * np.maximum(reduced, 0)


def _table_of(
    spectrum: Tabulated, bands: Bands, folder: Folder, quantity: Quantity
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the wavelengths, in m, and the values of a spectrum given by pairs, by a file, or by a
    tabulated CIE illuminant; None for a spectrum given by a formula or a chart."""
    if spectrum.pairs is not None:
        nanometres, values = np.asarray(spectrum.pairs, float).T
        return nanometres * 1e-9, values
    if spectrum.file is not None:
        return read_table(folder.file(spectrum.file), spectrum.column, quantity)
    if spectrum.illuminant is None:
        return None
    import colour

    table = colour.SDS_ILLUMINANTS.get(spectrum.illuminant)
    if table is None or table.name in colour_data.BY_FORMULA:
        return None
    if bands.wavelengths is not None:
        # raises an error for wavelengths beyond the table
        _library_spectrum(spectrum, bands.wavelengths)
    elif table.shape.start > 380 or table.shape.end < 780:
        raise InputError(
            f"illuminant {table.name!r} is known from {table.shape.start:g} to {table.shape.end:g} "
            "nm, and RGB takes 380 to 780 nm; give the scene wavelengths within the table, or a "
            "spectrum of your own."
        )
    return table.wavelengths * 1e-9, table.values


def _samples(bands: Bands) -> np.ndarray:
    """Return the wavelengths, m, of the bands, or the visible range for RGB."""
    if bands.wavelengths is not None:
        return bands.wavelengths
    if bands.count != 3:
        raise InputError(
            f"a tabulated spectrum cannot become {bands.count} bands that have no wavelengths; "
            "give the scene its wavelengths."
        )
    return np.arange(360, 831) * 1e-9


def colours_of(wavelengths: np.ndarray, quantity: Quantity) -> np.ndarray:
    """Compute linear sRGB, (wavelengths, 3), for spectra that are 1 at one wavelength, m, and 0 at
    all others."""
    grid, each = jnp.asarray(wavelengths), jnp.eye(len(wavelengths))
    observer = colour_data.observer(grid)
    if quantity == "reflectance":
        xyz = reflectance_to_xyz(each, grid, observer, colour_data.illuminant("D65", grid))
    else:
        flat = LUMINOUS_EFFICACY * integrate_spectrum(observer[:, 1], grid)
        xyz = spectrum_to_xyz(each, grid, observer) / flat
    return np.asarray(xyz_to_rgb(xyz))


def _library_spectrum(spectrum: Tabulated, wavelengths: np.ndarray) -> np.ndarray:
    """Evaluate a spectrum that is given by a name or a temperature, at wavelengths in m."""
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
