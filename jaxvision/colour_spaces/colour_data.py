"""Colorimetric tables of the library colour-science, interpolated to the caller's wavelengths.

The functions run eagerly, not under `jit`. The first call that needs a table of colour-science
imports that library, which takes about two seconds. The usual RGB spaces, adaptations, luma weights
and white points are defined here and do not import it. Wavelengths are in m everywhere;
`nanometres` converts from nm. colour-science interpolates smooth tables (Sprague's quintic on an
even grid, a cubic spline elsewhere). Outside the wavelengths of its table, an observer or a
sensitivity is 0, and a reflectance keeps its end value. Outside its table, an illuminant raises an
error, unless the CIE gives a formula: for "A" at every wavelength, for daylight from 300 to 830 nm.
An unknown name raises an `InputError` that lists the known ones.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._types import as_float, require_metres
from ..errors import InputError, nearest
from ..spectra import daylight

# Correlated colour temperatures in K of the tabulated phases of daylight: nominal on the older
# temperature scale with c_2 = 1.4380e-2 m K (CIE 15:2018, section 4.1.2).
_DAYLIGHT = {f"D{t // 100}": t * 1.4388 / 1.4380 for t in (5000, 5500, 6000, 6500, 7500)}
BY_FORMULA = ("A", "E", *_DAYLIGHT)  # illuminants whose formula extends beyond their tables
OBSERVER = "CIE 1931 2 Degree Standard Observer"

# Values of colour-science under the same names; a test compares them.
_WHITES = {  # x and y for the CIE 1931 observer
    "A": (0.44758, 0.40745),
    "C": (0.31006, 0.31616),
    "D50": (0.3457, 0.3585),
    "D55": (0.33243, 0.34744),
    "D65": (0.3127, 0.3290),
    "D75": (0.29903, 0.31488),
    "E": (1 / 3, 1 / 3),
}
_ACES_WHITE = (0.32168, 0.33767)
_PRIMARIES = {  # x and y of red, green and blue, and of white
    "sRGB": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), _WHITES["D65"]),
    "Adobe RGB (1998)": ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), _WHITES["D65"]),
    "Display P3": ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06), _WHITES["D65"]),
    "ITU-R BT.709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), _WHITES["D65"]),
    "ITU-R BT.2020": ((0.708, 0.292), (0.17, 0.797), (0.131, 0.046), _WHITES["D65"]),
    "ProPhoto RGB": ((0.7347, 0.2653), (0.1596, 0.8404), (0.0366, 0.0001), _WHITES["D50"]),
    "ACES2065-1": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), _ACES_WHITE),
    "ACEScg": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), _ACES_WHITE),
}
_CONES = {
    "Bradford": ((0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296)),
    "CAT02": ((0.7328, 0.4296, -0.1624), (-0.7036, 1.6975, 0.0061), (0.0030, 0.0136, 0.9834)),
    "Von Kries": ((0.40024, 0.7076, -0.08081), (-0.2263, 1.16532, 0.0457), (0.0, 0.0, 0.91822)),
    "XYZ Scaling": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}
_LUMA = {  # luma weights of red and blue
    "ITU-R BT.601": (0.2990, 0.1140),
    "ITU-R BT.709": (0.2126, 0.0722),
    "ITU-R BT.2020": (0.2627, 0.0593),
    "SMPTE-240M": (0.2122, 0.0865),
}


def nanometres(values: Any) -> Float[Array, "..."]:
    """Convert numbers in nm to wavelengths in m.

    Args:
        values: array-like of any shape, in nm.

    Returns:
        An array of the same shape, in m.
    """
    return as_float(np.asarray(values, np.float64) * 1e-9)


MOST_BANDS = 100_000  # largest number of wavelengths of a grid


def wavelength_grid(
    *, first: float = 380e-9, last: float = 780e-9, step: float = 5e-9
) -> Float[Array, " bands"]:
    """Return evenly spaced wavelengths.

    Args:
        first: m.
        last: m, included.
        step: m, > 0.

    Returns:
        (bands,) m.

    Raises:
        InputError: `last` is not a whole number of steps above `first`, or there are more than
            100,000 wavelengths.

    Example:
        >>> jv.colour_spaces.wavelength_grid().shape
        (81,)
    """
    steps = (last - first) / step if step > 0 else -1
    if steps >= MOST_BANDS:
        raise InputError(
            f"A grid from {first:g} m to {last:g} m in steps of {step:g} m has {steps + 1:.3g} "
            f"wavelengths, more than {MOST_BANDS:,}; take longer steps."
        )
    if not (steps > 0 and abs(steps - round(steps)) < 1e-6):
        raise InputError(
            f"A grid from {first:g} m to {last:g} m is not a whole number of steps of {step:g} m; "
            "change one of them."
        )
    return as_float(np.linspace(first, last, round(steps) + 1))


def illuminant(name: str, wavelengths: Float[Array, " bands"]) -> Float[Array, " bands"]:
    """Return the relative spectral power of a standard illuminant.

    The CIE's series A and D are 100 at 560 nm. Outside its table, from 300 to 780 nm, A is the
    black body that defines it. Above 780 nm, D50, D55, D65 and D75 are computed from the CIE's
    daylight basis (300 to 830 nm), which agrees with the tables within 5e-4 from 380 nm on. "E" is
    the same at every wavelength.

    Args:
        name: "A", "D65", "FL2", "LED-B1", "E", ...
        wavelengths: (bands,) m.

    Returns:
        (bands,) relative.

    Raises:
        InputError: an unknown name, or a wavelength for which there is neither table nor formula.

    Example:
        >>> print(jv.colour_spaces.illuminant("D65", jnp.array([450e-9, 560e-9])).round())
        [117. 100.]
    """
    import colour

    table = _entry(colour.SDS_ILLUMINANTS, name, "illuminant")
    name = table.name  # upper case, whatever the case of the requested name
    wanted, power = _nanometres(wavelengths), _sample_table(table, wavelengths)
    beyond = (wanted < table.shape.start) | (wanted > table.shape.end)
    if name == "E" or not beyond.any():
        return power
    if name == "A":
        return jnp.where(beyond, as_float(_black_body_a(wanted)), power)
    if name not in _DAYLIGHT:
        _check_within(f"Illuminant {name!r}", wanted, table.shape.start, table.shape.end)
    basis = daylight_basis(wavelengths)
    return jnp.where(beyond, daylight(basis, jnp.asarray(_DAYLIGHT[name], basis.dtype)), power)


def _black_body_a(wavelengths: Float[np.ndarray, " bands"]) -> Float[np.ndarray, " bands"]:
    """Return the relative power of illuminant A at wavelengths in nm (CIE 15:2018, equation 3)."""
    unit, exponent = 560 / wavelengths, 1.435e7 / 2848
    return 100 * unit**5 * np.expm1(exponent / 560) / np.expm1(exponent / wavelengths)


def _check_within(name: str, wanted: Float[np.ndarray, " bands"], low: float, high: float) -> None:
    """Raise `InputError` for a wavelength, nm, beyond the ends of a table."""
    outside = wanted[(wanted < low) | (wanted > high)]
    if outside.size:
        raise InputError(
            f"{name} is known from {low:g} to {high:g} nm, and {outside[0]:g} nm is asked for; "
            "leave these wavelengths out, or give a spectrum of your own."
        )


def observer(
    wavelengths: Float[Array, " bands"], *, name: str = OBSERVER
) -> Float[Array, "bands 3"]:
    """Return the colour matching functions of a CIE standard observer, 0 outside their table.

    Args:
        wavelengths: (bands,) m.
        name: of the observer, by default the CIE 1931 2 degree observer.

    Returns:
        (bands, 3) x, y, z, no unit.

    Raises:
        InputError: an unknown name.
    """
    import colour

    return _sample_table(_entry(colour.MSDS_CMFS, name, "observer"), wavelengths, ends=True)


def camera_sensitivities(
    name: str, wavelengths: Float[Array, " bands"]
) -> Float[Array, "bands channels"]:
    """Return the relative spectral sensitivities of a measured camera, 0 outside its table.

    Args:
        name: "Nikon 5100 (NPL)" or "Sigma SDMerill (NPL)".
        wavelengths: (bands,) m.

    Returns:
        (bands, 3) R, G, B, relative: 1 at the peak of the most sensitive channel.

    Raises:
        InputError: an unknown name.

    Example:
        >>> wavelengths = jnp.array([450e-9, 530e-9, 600e-9])
        >>> camera = jv.colour_spaces.camera_sensitivities("Nikon 5100 (NPL)", wavelengths)
        >>> print(camera.argmax(axis=1))  # blue, green, red
        [2 1 0]
    """
    import colour

    cameras = colour.MSDS_CAMERA_SENSITIVITIES
    return _sample_table(_entry(cameras, name, "camera"), wavelengths, ends=True)


def chart_reflectances(
    wavelengths: Float[Array, " bands"], *, name: str = "ColorChecker N Ohta"
) -> Float[Array, "patches bands"]:
    """Return the reflectances of the patches of a colour chart. Outside the table they keep their
    end values.

    Args:
        wavelengths: (bands,) m.
        name: "ColorChecker N Ohta" or "BabelColor Average", with 24 patches row by row from dark
            skin to black, or another chart of colour-science.

    Returns:
        (patches, bands) relative to perfect white.

    Raises:
        InputError: an unknown name.
    """
    import colour

    patches = _entry(colour.SDS_COLOURCHECKERS, name, "chart")
    return as_float(np.stack([_sample_table(patch, wavelengths) for patch in patches.values()]))


def daylight_basis(wavelengths: Float[Array, " bands"]) -> Float[Array, "bands 3"]:
    """Return the basis spectra S_0, S_1, S_2 of CIE daylight, for `spectra.daylight`.

    The basis is interpolated linearly, as the CIE prescribes.

    Args:
        wavelengths: (bands,) m, from 300e-9 to 830e-9.

    Returns:
        (bands, 3) relative.

    Raises:
        InputError: a wavelength beyond the CIE's table.
    """
    import colour

    table = colour.colorimetry.SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    wanted, shape = _nanometres(wavelengths), table["S0"].shape
    _check_within("CIE daylight", wanted, shape.start, shape.end)
    columns = [
        np.interp(wanted, table[name].wavelengths, table[name].values)
        for name in ("S0", "S1", "S2")
    ]
    return as_float(np.stack(columns, axis=-1))


def rgb_basis(wavelengths: Float[Array, " bands"]) -> Float[Array, "bands 3"]:
    """Return the reflectances of linear sRGB's red, green and blue primaries, for
    `spectra.rgb_to_reflectance`.

    The reflectances are Mallett's and Yuksel's table from 380 to 780 nm, interpolated linearly.
    Outside the table they keep their end values. All three reflectances are in [0, 1]. In each band
    their sum is between 1 - 1e-5 and 1.

    Args:
        wavelengths: (bands,) m.

    Returns:
        (bands, 3) relative to perfect white.

    Source:
        Mallett and Yuksel, Spectral primary decomposition for rendering with sRGB reflectance
        (Eurographics Symposium on Rendering, 2019), in the table of colour-science.
    """
    import colour

    table = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    values = table.values / np.maximum(table.values.sum(axis=1, keepdims=True), 1)
    grid = _nanometres(wavelengths)
    return as_float(np.stack([np.interp(grid, table.wavelengths, v) for v in values.T], axis=-1))


def white_point(name: str, *, observer: str = OBSERVER) -> Float[Array, "3"]:
    """Return the tristimulus values of an illuminant from its CIE chromaticity ("D65": 0.3127,
    0.3290).

    Args:
        name: of the illuminant.
        observer: name of the observer.

    Returns:
        (3,) X, Y, Z relative to Y = 1.

    Raises:
        InputError: an unknown name.
    """
    if observer == OBSERVER and name in _WHITES:
        x, y = _WHITES[name]
    else:
        import colour

        x, y = _entry(_entry(colour.CCS_ILLUMINANTS, observer, "observer"), name, "illuminant")
    return as_float([x / y, 1.0, (1 - x - y) / y])


# `colour_spaces` reads the tables below while it is traced: NumPy, float64, cached.


@cache
def rgb_to_xyz_matrix(space: str) -> Float[np.ndarray, "3 3"]:
    """Return the matrix from linear RGB to XYZ, computed in full precision from the primaries and
    white of the space.

    The rounded matrices that standards print have inverses with errors of up to 1e-4.

    Args:
        space: "sRGB", "Adobe RGB (1998)", "Display P3", "ITU-R BT.2020", "ProPhoto RGB",
            "ACES2065-1", "ACEScg" or another RGB space of colour-science.

    Returns:
        (3, 3) float64, no unit.

    Raises:
        InputError: an unknown name.
    """
    if space in _PRIMARIES:
        *primaries, white = _PRIMARIES[space]
    else:
        import colour

        chosen = _entry(colour.RGB_COLOURSPACES, space, "RGB space")
        primaries, white = chosen.primaries, chosen.whitepoint
    x, y = np.asarray([*primaries, white], np.float64).T
    points = np.stack([x, y, 1 - x - y])
    colours, white_xyz = points[:, :3], points[:, 3] / y[3]
    return colours * np.linalg.solve(colours, white_xyz)


@cache
def cone_matrix(method: str) -> Float[np.ndarray, "3 3"]:
    """Return the matrix from XYZ to the cone responses that chromatic adaptation scales.

    Args:
        method: "Bradford", "CAT02", "Von Kries", "XYZ Scaling" or another of colour-science.

    Returns:
        (3, 3) float64, no unit.

    Raises:
        InputError: an unknown name.
    """
    if method in _CONES:
        return np.asarray(_CONES[method])
    import colour

    transforms = colour.CHROMATIC_ADAPTATION_TRANSFORMS
    return np.asarray(_entry(transforms, method, "chromatic adaptation"))


@cache
def luma_weights(standard: str) -> tuple[float, float, float]:
    """Return the weights of R', G', B' in luma; their sum is 1.

    Args:
        standard: "ITU-R BT.601", "ITU-R BT.709", "ITU-R BT.2020" or "SMPTE-240M".

    Returns:
        Three weights, no unit.

    Raises:
        InputError: an unknown name.
    """
    red, blue = _entry(_LUMA, standard, "luma standard")
    return red, 1 - red - blue, blue


def _entry(table: Mapping[str, Any], name: str, kind: str) -> Any:
    if isinstance(name, str) and name in table:
        return table[name]
    alike = [known for known in table if str(known).lower() == str(name).lower()]
    if alike:
        return table[alike[0]]
    raise InputError(f"No {kind} {name!r}; {nearest(str(name), map(str, table))}.")


def _nanometres(wavelengths: Float[Array, " bands"]) -> Float[np.ndarray, " bands"]:
    """Convert m to nm, the unit of the tables, rounded to whole picometres so that 555e-9 gives
    555.
    """
    metres = np.asarray(wavelengths, np.float64)
    require_metres("wavelength", metres)
    return np.round(metres * 1e9, 3)


def _sample_table(
    distribution: Any, wavelengths: Float[Array, " bands"], *, ends: bool = False
) -> Float[Array, "..."]:
    """Interpolate a table of colour-science at wavelengths in m. Outside the table the result is 0
    if `ends`, else the end value.
    """
    wanted = _nanometres(wavelengths)
    values = np.asarray(distribution[wanted])
    if ends:
        shape = distribution.shape
        inside = (wanted >= shape.start) & (wanted <= shape.end)
        values = np.where(inside.reshape((-1,) + (1,) * (values.ndim - 1)), values, 0)
    return as_float(values)
