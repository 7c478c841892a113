"""Tables of colour: what colour-science holds, as arrays on the caller's grid. Eager; the library
is loaded on first use (about a second).

Wavelengths are m everywhere; `nanometres` is the one place where others come in. Smooth tables are
interpolated by colour-science (Sprague's quintic on an even grid, a cubic spline elsewhere). Beyond
its table an observer or a sensitivity is 0, a reflectance keeps its end value, and so does an
illuminant that is no CIE daylight: "A" and "C" beyond 300 to 780 nm, "FL..." and "LED-..." beyond
380 to 780 nm.
A name that does not exist is an `InputError` that lists what does.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._types import as_float
from .errors import InputError
from .spectra import daylight

# Correlated colour temperatures of the tabulated phases of daylight, K: their nominal ones on the
# temperature scale that had c_2 = 1.4380e-2 m K (CIE 15:2018, section 4.1.2).
_DAYLIGHT = {f"D{t // 100}": t * 1.4388 / 1.4380 for t in (5000, 5500, 6000, 6500, 7500)}
OBSERVER = "CIE 1931 2 Degree Standard Observer"


def nanometres(values: Any) -> Float[Array, "..."]:
    """Wavelengths in m from numbers in nm."""
    return as_float(np.asarray(values, np.float64) * 1e-9)


def wavelength_grid(
    *, first: float = 380e-9, last: float = 780e-9, step: float = 5e-9
) -> Float[Array, " bands"]:
    """Wavelengths in m from `first` to `last`, both included; `InputError` unless they are a whole
    number of positive steps apart."""
    steps = (last - first) / step if step > 0 else -1
    if not (steps > 0 and abs(steps - round(steps)) < 1e-6):
        raise InputError(
            f"A grid from {first:g} m to {last:g} m is no whole number of steps of {step:g} m; "
            "change one of them."
        )
    return as_float(np.linspace(first, last, round(steps) + 1))


def illuminant(name: str, wavelengths: Float[Array, " bands"]) -> Float[Array, " bands"]:
    """Relative spectral power (bands,) of "A", "D65", "FL2", "LED-B1", "E", ...; the CIE's series A
    and D are 100 at 560 nm. Above 780 nm, where their tables end, D50, D55, D65 and D75 are the
    daylight of their temperature, from the CIE's basis (300 to 830 nm), which is within 5e-4 of
    the tables from 380 nm on."""
    import colour

    table = _entry(colour.SDS_ILLUMINANTS, name, "illuminant")
    power = _sampled(table, wavelengths)
    if name not in _DAYLIGHT:
        return power
    basis = daylight_basis(wavelengths)
    beyond = _nanometres(wavelengths) > table.shape.end
    return jnp.where(beyond, daylight(basis, jnp.asarray(_DAYLIGHT[name], basis.dtype)), power)


def observer(
    wavelengths: Float[Array, " bands"], *, name: str = OBSERVER
) -> Float[Array, "bands 3"]:
    """Colour matching functions x, y, z of a CIE standard observer: (bands, 3), no unit."""
    import colour

    return _sampled(_entry(colour.MSDS_CMFS, name, "observer"), wavelengths, ends=True)


def camera_sensitivities(
    name: str, wavelengths: Float[Array, " bands"]
) -> Float[Array, "bands channels"]:
    """Relative sensitivities (bands, 3) to R, G, B of a measured camera, "Nikon 5100 (NPL)" or
    "Sigma SDMerill (NPL)", 1 at the peak of the most sensitive channel."""
    import colour

    cameras = colour.MSDS_CAMERA_SENSITIVITIES
    return _sampled(_entry(cameras, name, "camera"), wavelengths, ends=True)


def chart_reflectances(
    wavelengths: Float[Array, " bands"], *, name: str = "ColorChecker N Ohta"
) -> Float[Array, "patches bands"]:
    """Reflectances (patches, bands), relative to perfect white, of a colour chart: the 24 patches
    of "ColorChecker N Ohta" or "BabelColor Average", row by row from dark skin to black, and other
    charts of colour-science."""
    import colour

    patches = _entry(colour.SDS_COLOURCHECKERS, name, "chart")
    return as_float(np.stack([_sampled(patch, wavelengths) for patch in patches.values()]))


def daylight_basis(wavelengths: Float[Array, " bands"]) -> Float[Array, "bands 3"]:
    """S_0, S_1, S_2 of CIE daylight (bands, 3), interpolated linearly as the CIE prescribes; for
    `spectra.daylight`."""
    import colour

    table = colour.colorimetry.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    columns = [
        np.interp(_nanometres(wavelengths), table[name].wavelengths, table[name].values)
        for name in ("S0", "S1", "S2")
    ]
    return as_float(np.stack(columns, axis=-1))


def white_point(name: str, *, observer: str = OBSERVER) -> Float[Array, "3"]:
    """X, Y, Z of an illuminant with Y = 1, from the CIE's chromaticity of it ("D65": 0.3127,
    0.3290)."""
    import colour

    x, y = _entry(_entry(colour.CCS_ILLUMINANTS, observer, "observer"), name, "illuminant")
    return as_float([x / y, 1.0, (1 - x - y) / y])


# What follows is read by `colour_spaces` while it traces: NumPy, float64, cached.


@cache
def rgb_to_xyz_matrix(space: str) -> Float[np.ndarray, "3 3"]:
    """Linear RGB to XYZ, derived in full precision from the primaries and white of a working space:
    "sRGB", "Adobe RGB (1998)", "Display P3", "ITU-R BT.2020", "ProPhoto RGB", "ACES2065-1",
    "ACEScg" and the others of colour-science. (Standards print rounded matrices, whose inverses
    miss by up to 1e-4.)"""
    import colour

    chosen = _entry(colour.RGB_COLOURSPACES, space, "RGB space")
    return colour.normalised_primary_matrix(chosen.primaries, chosen.whitepoint)


@cache
def cone_matrix(method: str) -> Float[np.ndarray, "3 3"]:
    """XYZ to the responses that chromatic adaptation scales: "Bradford", "CAT02", "Von Kries",
    "XYZ Scaling" and the others of colour-science."""
    import colour

    transforms = colour.CHROMATIC_ADAPTATION_TRANSFORMS
    return np.asarray(_entry(transforms, method, "chromatic adaptation"))


@cache
def luma_weights(standard: str) -> tuple[float, float, float]:
    """Weights of R', G', B' in the luma of "ITU-R BT.601", "ITU-R BT.709", "ITU-R BT.2020" or
    "SMPTE-240M"; they sum to 1."""
    import colour

    red, blue = _entry(colour.WEIGHTS_YCBCR, standard, "luma standard")
    return float(red), float(1 - red - blue), float(blue)


def _entry(table: Mapping[str, Any], name: str, kind: str) -> Any:
    if name in table:
        return table[name]
    raise InputError(f"No {kind} {name!r}; use one of {_listed(table)}.")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(map(str, names)))


def _nanometres(wavelengths: Float[Array, " bands"]) -> Float[np.ndarray, " bands"]:
    """Wavelengths in nm, as the tables have them; whole picometres, so that 555e-9 is 555."""
    return np.round(np.asarray(wavelengths, np.float64) * 1e9, 3)


def _sampled(
    distribution: Any, wavelengths: Float[Array, " bands"], *, ends: bool = False
) -> Float[Array, "..."]:
    """A table of colour-science at these wavelengths; 0 beyond it where it `ends`."""
    wanted = _nanometres(wavelengths)
    values = np.asarray(distribution[wanted])
    if ends:
        shape = distribution.shape
        inside = (wanted >= shape.start) & (wanted <= shape.end)
        values = np.where(inside.reshape((-1,) + (1,) * (values.ndim - 1)), values, 0)
    return as_float(values)
