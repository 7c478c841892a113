"""Spectra: arrays (..., bands) with one value per wavelength, on a grid of wavelengths (bands,) in
m.

An RGB colour is a spectrum of three bands, so every function of `bands` takes both.
`spectrum_to_camera`, `spectrum_to_xyz` and `reflectance_to_xyz` reduce the bands of a physical
spectrum to the few bands of a camera or an observer. `rgb_to_reflectance` does the opposite.
Integrals are sums of value times band width (CIE 15:2018, section 7). Tables for these functions
(illuminants, reflectances, sensitivities, observers) come from `colour_data`.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .core._arguments import takes_numbers, takes_range, warn_caller
from .core._numerics import difference_of_products, or_one
from .core._powers import decay, exact
from .core._types import (
    AMOUNT,
    LONGEST_WAVE,
    Scalar,
    Spectrum,
    check_choice,
    is_known,
    name_above,
    print_by_name,
    require_metres,
)

Wavelengths = Float[Array, " bands"]
Responses = Float[Array, "bands channels"]
print_by_name(globals(), "Wavelengths", "Responses")

LUMINOUS_EFFICACY = 683.0  # lm W^-1, CIE's K_m for sums over the tabulated observer
_LONGEST_RADIO = 100.0  # m; longer wavelengths are probably in nm
_PLANCK = Fraction("6.62607015e-34")  # J s; all three constants are exact in the SI of 2019
_TWO_H_C_SQUARED = 2 * _PLANCK * 299792458**2  # W m^2
_H_C_OVER_K = _PLANCK * 299792458 / Fraction("1.380649e-23")  # m K

# CIE 167:2005: the polynomial's coefficients from six neighbours, and two values past each end.
_SPRAGUE = (
    np.array(
        [
            [0, 0, 24, 0, 0, 0],
            [2, -16, 0, 16, -2, 0],
            [-1, 16, -30, 16, -1, 0],
            [-9, 39, -70, 66, -33, 7],
            [13, -64, 126, -124, 61, -12],
            [-5, 25, -50, 50, -25, 5],
        ]
    )
    / 24
)
_SPRAGUE_BEFORE = (
    np.array([[884, -1960, 3033, -2648, 1080, -180], [508, -540, 488, -367, 144, -24]]) / 209
)


_MOST_REFLECTED = 5.0  # largest reflectance without a warning; fluorescence exceeds 1


@takes_numbers
def interpolate_spectrum(
    values: Spectrum,
    known: Wavelengths,
    wanted: Float[Array, " wanted"],
    *,
    method: str = "linear",
    outside: str = "clamp",
) -> Float[Array, "... wanted"]:
    """Interpolate spectra to other wavelengths.

    Args:
        values: (..., bands) in any unit.
        known: (bands,) m, ascending.
        wanted: (wanted,) m.
        method: "linear", or "sprague", the quintic of CIE 167:2005 for smooth spectra, which
            assumes evenly spaced `known` and needs at least six bands.
        outside: beyond `known`, "clamp" repeats the end values (CIE 15:2018, 7.2.3), and "zero"
            returns 0 (for sensitivities).

    Returns:
        (..., wanted) in the unit of `values`.

    Raises:
        ValueError: for an unknown option, too few bands, values with another number of bands, known
            wavelengths that do not ascend or, for "sprague", are not evenly spaced (unless traced),
            or wavelengths that are not in m.
    """
    bands = known.shape[0]
    least = {"linear": 2, "sprague": 6}
    check_choice("method", method, least)
    check_choice("outside", outside, ("clamp", "zero"))
    if bands < least[method]:
        raise ValueError(
            f"{method} interpolation needs at least {least[method]} bands, got {bands}."
        )
    if values.shape[-1:] != (bands,):
        raise ValueError(
            f"values must have one number for each of the {bands} known wavelengths along its last "
            f"axis, got shape {values.shape}."
        )
    for name, given in (("known", known), ("wanted", wanted)):
        if is_known(given):
            require_metres(f"interpolate_spectrum: {name}", np.asarray(given))
    _check_ascending("interpolate_spectrum: known", known)
    if method == "sprague" and is_known(known):
        steps = np.diff(np.asarray(known))
        if np.ptp(steps) > 0.01 * steps.mean():
            raise ValueError(
                "sprague interpolation needs evenly spaced known wavelengths, got steps from "
                f"{1e9 * steps.min():.4g} to {1e9 * steps.max():.4g} nm; take linear."
            )
    interval = jnp.clip(jnp.searchsorted(known, wanted, side="right") - 1, 0, bands - 2)
    start, end = known[interval], known[interval + 1]
    t = jnp.clip((wanted - start) / (end - start), 0, 1)
    if method == "linear":
        taps, weights = values, jnp.stack([1 - t, t])
    else:
        before = values[..., :6] @ jnp.asarray(_SPRAGUE_BEFORE.T, values.dtype)
        after = values[..., -6:] @ jnp.asarray(_SPRAGUE_BEFORE[::-1, ::-1].T, values.dtype)
        taps = jnp.concatenate([before, values, after], axis=-1)
        weights = jnp.asarray(_SPRAGUE.T, t.dtype) @ jnp.stack([t**n for n in range(6)])
    if outside == "zero":
        weights = weights * ((wanted >= known[0]) & (wanted <= known[-1])).astype(t.dtype)[None]
    neighbours = jnp.stack([taps[..., interval + n] for n in range(len(weights))], axis=-2)
    return jnp.sum(jnp.broadcast_to(weights, neighbours.shape) * neighbours, axis=-2)


def _check_visible(name: str, wavelengths: Wavelengths) -> None:
    """Raise `ValueError` for known wavelengths outside the range of every observer."""
    if is_known(wavelengths):
        shortest, longest = np.min(np.asarray(wavelengths)), np.max(np.asarray(wavelengths))
        if shortest > 1e-6 or longest < 1e-7:
            raise ValueError(
                f"{name}, in metres, are {shortest:.6g} to {longest:.6g}, and an observer sees "
                "360e-9 to 830e-9."
            )


def _check_ascending(name: str, wavelengths: Wavelengths) -> None:
    """Raise `ValueError` for known wavelengths that are not ascending."""
    if is_known(wavelengths) and (np.diff(np.asarray(wavelengths)) <= 0).any():
        raise ValueError(f"{name} must ascend.")


@takes_numbers
def band_widths(wavelengths: Wavelengths) -> Wavelengths:
    """Return the width of the interval that each sample of a spectrum represents.

    The width is half the distance between the two neighbours. The width of an end sample is the
    distance to its only neighbour. On an even grid every width is the step, so an integral is the
    sum times the step, as in CIE 15:2018.

    Args:
        wavelengths: (bands,) m, ascending, at least two.

    Returns:
        (bands,) m.

    Raises:
        ValueError: for fewer than two wavelengths, or for wavelengths that do not ascend or are not
            in m.
    """
    if wavelengths.shape[0] < 2:
        raise ValueError(f"wavelengths must hold at least two values, got {wavelengths.shape[0]}.")
    if is_known(wavelengths):  # numbers 1, 2, 3 give bands of one unit
        require_metres("a grid", np.median(np.asarray(wavelengths)), longest=_LONGEST_RADIO)
    _check_ascending("band_widths: wavelengths", wavelengths)
    step = jnp.diff(wavelengths)
    padded = jnp.concatenate([step[:1], step, step[-1:]])
    return (padded[1:] + padded[:-1]) / 2


@takes_numbers
def integrate_spectrum(spectrum: Spectrum, wavelengths: Wavelengths) -> Float[Array, "..."]:
    """Integrate over wavelength: the sum of value times band width.

    Args:
        spectrum: (..., bands) in any unit.
        wavelengths: (bands,) m, ascending.

    Returns:
        (...) in the unit of the spectrum times m.

    Raises:
        ValueError: for wavelengths that do not ascend, or are not in m.
    """
    if is_known(wavelengths):  # most of them: a grid of heat may end at a metre
        require_metres("integrate_spectrum: wavelengths", np.median(np.asarray(wavelengths)))
    return spectrum @ band_widths(wavelengths)


@takes_numbers
def spectrum_to_camera(
    spectrum: Spectrum, wavelengths: Wavelengths, sensitivities: Responses
) -> Float[Array, "... channels"]:
    """Return the response of each channel, the integral of spectrum times sensitivity.

    Args:
        spectrum: (..., bands) per m of wavelength, such as W m^-3.
        wavelengths: (bands,) m, ascending.
        sensitivities: (bands, channels), such as electrons J^-1.

    Returns:
        (..., channels) in the unit of spectrum times sensitivity times m; for the units above,
        electrons m^-2 s^-1.
    """
    return spectrum @ (sensitivities * band_widths(wavelengths)[:, None])


@takes_numbers
def spectrum_to_xyz(
    spectrum: Spectrum, wavelengths: Wavelengths, observer: Responses
) -> Float[Array, "... 3"]:
    """Compute the absolute tristimulus values X, Y, Z: the constant K_m times the integral of the
    spectrum times the colour matching functions.

    Args:
        spectrum: (..., bands) W m^-2 sr^-1 per m, for Y in cd m^-2; or W m^-2 per m, for lux.
        wavelengths: (bands,) m, ascending.
        observer: (bands, 3), no unit, from `colour_data.observer`.

    Returns:
        (..., 3) X, Y, Z in cd m^-2 or lux.

    Source:
        CIE 15:2018, section 7.1.
    """
    _check_visible("spectrum_to_xyz: wavelengths", wavelengths)
    return LUMINOUS_EFFICACY * spectrum_to_camera(spectrum, wavelengths, observer)


@takes_numbers
def reflectance_to_xyz(
    reflectance: Spectrum, wavelengths: Wavelengths, observer: Responses, illuminant: Wavelengths
) -> Float[Array, "... 3"]:
    """Return the tristimulus values of a reflecting object, relative to a perfect white of Y = 1.

    Args:
        reflectance: (..., bands) relative, 1 for perfect white.
        wavelengths: (bands,) m, ascending.
        observer: (bands, 3), no unit, from `colour_data.observer`.
        illuminant: (bands,) relative; its scale cancels.

    Returns:
        (..., 3) X, Y, Z, relative.

    Source:
        CIE 15:2018, section 7.1.
    """
    _check_visible("reflectance_to_xyz: wavelengths", wavelengths)
    name_above("the reflectance", reflectance, _MOST_REFLECTED, "divide per cent by 100")
    weights = observer * (illuminant * band_widths(wavelengths))[:, None]
    return reflectance @ (weights / jnp.sum(weights[:, 1]))


@takes_numbers
def rgb_to_reflectance(
    rgb: Float[Array, "... 3"], basis: Float[Array, "bands 3"]
) -> Float[Array, "... bands"]:
    """Return a smooth reflectance whose colour under D65 is the given linear sRGB.

    The result is the sum of the basis reflectances of red, green and blue, each times its component
    of the colour. The reflectance is linear in the colour, and within [0, 1] for colours within [0,
    1]. Many reflectances have that colour: under another lamp, or seen by another camera, a real
    surface of the same colour may look different. If the reflectance is converted back to RGB, the
    error is at most 2.4e-4 with samples every 5 nm from 380 to 780 nm, and 1.1e-2 with samples
    every 10 nm from 400 to 700 nm.

    Args:
        rgb: (..., 3) linear sRGB, relative; or k_d in sr^-1.
        basis: (bands, 3), no unit, from `colour_data.rgb_basis`.

    Returns:
        (..., bands) in the unit of `rgb`.

    Example:
        >>> grid = jv.colour_spaces.wavelength_grid(first=400e-9, last=700e-9, step=100e-9)
        >>> basis = jv.colour_spaces.rgb_basis(grid)
        >>> red = jv.spectra.rgb_to_reflectance(jnp.array([1.0, 0.0, 0.0]), basis)
        >>> print(*(f"{share:.2f}" for share in red))
        0.24 0.01 0.95 0.41

    Source:
        Mallett and Yuksel, Spectral primary decomposition for rendering with sRGB reflectance
        (Eurographics Symposium on Rendering, 2019).
    """
    return rgb @ basis.T


@takes_numbers
@takes_range(temperature=AMOUNT)
def blackbody(wavelengths: Wavelengths, temperature: Scalar) -> Wavelengths:
    """Return the spectral radiance of a black body by Planck's law: 2 h c^2 / lambda^5 / (exp(h c /
    (lambda k T)) - 1).

    Args:
        wavelengths: (bands,) m.
        temperature: () K; at 0 the radiance is 0.

    Returns:
        (bands,) W m^-2 sr^-1 per m, with the constants of the SI of 2019.

    Raises:
        ValueError: for wavelengths above 100 m, which are probably in another unit, and a
            temperature below 0. From 1e-2 to 100 m a warning says that they are radio waves.

    Example:
        >>> wavelengths = jnp.linspace(50e-9, 100e-6, 100_000)
        >>> L = jv.spectra.integrate_spectrum(
        ...     jv.spectra.blackbody(wavelengths, jnp.array(5000.0)), wavelengths
        ... )
        >>> round(float(np.pi * L / 5000**4 * 1e8), 3)  # Stefan-Boltzmann constant, 5.670e-8
        5.67
    """
    if is_known(wavelengths):
        longest = np.max(np.asarray(wavelengths), initial=0)
        if LONGEST_WAVE < longest <= _LONGEST_RADIO:
            warn_caller(
                f"blackbody: wavelengths is in metres, got {longest:.6g}, a radio wave; "
                f"{longest:.6g} um are {longest:.6g}e-6."
            )
        else:
            require_metres("blackbody: wavelengths", longest)
    dtype = jnp.result_type(wavelengths, temperature)
    # Half precision cannot represent the constants
    wide = jnp.float32 if dtype.itemsize == 2 else dtype
    cold, kelvin = temperature <= 0, or_one(temperature).astype(wide)
    return jnp.where(cold, 0, _planck(wavelengths.astype(wide), kelvin)).astype(dtype)


@jax.custom_jvp
def _planck(wavelengths: Wavelengths, kelvin: Scalar) -> Wavelengths:
    """Compute `blackbody` within two ULP: each product and quotient is computed with its rounding
    error, and the errors are added at the end.
    """
    one = jnp.ones_like(wavelengths)
    x = float(_H_C_OVER_K) / (wavelengths * kelvin)
    left, left_rest, scale, further, lost, lost_rest = decay(
        x, _lost_of_exponent(x, wavelengths, kelvin)
    )
    # Exact; the fifth power is in range, but not the square of the fifth power
    scaled = 2**20 * wavelengths
    square = scaled * scaled
    constant, constant_rest = exact(_TWO_H_C_SQUARED * 2**100, wavelengths.dtype)
    missing = constant_rest / constant + left_rest / or_one(left) - lost_rest / lost
    missing = missing - 2 * difference_of_products(scaled, scaled, square, one) / square

    def divide(a: Wavelengths, b: Wavelengths) -> tuple[Wavelengths, Wavelengths]:
        quotient = a / b
        return quotient, difference_of_products(a, one, quotient, b) / or_one(a)

    per_wave = constant * one
    for divisor in (square, square, scaled):
        per_wave, share = divide(per_wave, divisor)
        missing = missing + share
    odds, share = divide(left, lost)
    value = per_wave * odds
    missing = missing + share + difference_of_products(per_wave, odds, value, one) / or_one(value)
    # if a number is so small that its lower half underflows, its rounding error is unknown
    known = (per_wave > float(jnp.finfo(x.dtype).tiny) * 2.0**48) & jnp.isfinite(missing)
    radiance = (value + jnp.where(known, value * missing, 0)) * scale * further
    # Even if the fifth power of a short wavelength is infinite
    return jnp.where(left == 0, 0, radiance)


@_planck.defjvp
def _planck_jvp(primals, tangents):
    (wavelengths, kelvin), (longer, warmer) = primals, tangents
    radiance = _planck(wavelengths, kelvin)
    x = float(_H_C_OVER_K) / (wavelengths * kelvin)
    steepness = jnp.where(radiance == 0, 0, x / or_one(-jnp.expm1(-x)))
    by_wavelength = (steepness - 5) * (longer / wavelengths)
    return radiance, radiance * (by_wavelength + steepness * (warmer / kelvin))


def _lost_of_exponent(x: Wavelengths, wavelengths: Wavelengths, kelvin: Scalar) -> Wavelengths:
    """Return the rounding error h c / (lambda k T) - x, which the exponential amplifies; no
    unit.
    """
    product, one = wavelengths * kelvin, jnp.ones_like(wavelengths)
    nearest, rest = exact(_H_C_OVER_K, x.dtype)
    lost = difference_of_products(nearest * one, one, x, product)
    lost = lost - x * difference_of_products(wavelengths, kelvin * one, product, one)
    lost = (lost + rest) / product
    return jnp.where(jnp.isfinite(lost), lost, 0)


def _locus_polynomial(constant: str, x: str, y: str) -> tuple[float, float, float]:
    """Return the coefficients of constant + x x_D + y y_D as a polynomial in x_D, on the daylight
    locus y_D = -3 x_D^2 + 2.87 x_D - 0.275. Evaluating the sum from rounded x_D and y_D would
    amplify their error 300 times by cancellation.
    """
    c, a, b = Fraction(constant), Fraction(x), Fraction(y)
    return float(c - b * Fraction("0.275")), float(a + b * Fraction("2.87")), float(-3 * b)


def _roots(polynomial: tuple[float, float, float]) -> tuple[float, float]:
    first, second = np.polynomial.polynomial.polyroots(polynomial)
    return float(first), float(second)


_DAYLIGHT = (  # CIE 15:2018, equations 4.3: the divisor, the numerators of M_1 and M_2
    _locus_polynomial("0.0241", "0.2562", "-0.7341"),
    _locus_polynomial("-1.3515", "-1.7703", "5.9114"),
    _locus_polynomial("0.0300", "-31.4424", "30.0717"),
)


@takes_numbers
def daylight(basis: Float[Array, "bands 3"], temperature: Scalar) -> Wavelengths:
    """Return the relative power of CIE daylight: S_0 + M_1 S_1 + M_2 S_2, 100 at 560 nm.

    The CIE rounds M_1 and M_2 to three decimals; here they are not rounded.

    Args:
        basis: (bands, 3) relative, from `colour_data.daylight_basis`.
        temperature: () correlated colour temperature in K, clamped to CIE's range of 4000 to 25000
            K, with a warning unless it is traced; D65 is at 6504 K (6500 K on the scale of 1931).

    Returns:
        (bands,) relative.

    Source:
        CIE 15:2018, section 4.1.2.
    """
    if is_known(temperature) and not 4000 <= float(temperature) <= 25000:
        warn_caller(
            f"daylight: CIE defines it from 4000 to 25000 K, got {float(temperature):g} K; the "
            "nearest end is taken. Cooler lamps have the spectrum of a black body."
        )
    inverse = 1e3 / jnp.clip(temperature, 4000, 25000)
    cool = temperature <= 7000

    def chromaticity_offset(x_0: float) -> Scalar:
        """Return x_D - x_0, from the CIE's two polynomials in 1 / T, below and above 7000 K."""
        low = (0.244063 - x_0) + inverse * (0.09911 + inverse * (2.9678 - 4.6070 * inverse))
        high = (0.237040 - x_0) + inverse * (0.24748 + inverse * (1.9018 - 2.0064 * inverse))
        return jnp.where(cool, low, high)

    def evaluate_factors(polynomial: tuple[float, float, float]) -> Scalar:
        first, second = _roots(polynomial)
        return polynomial[2] * (chromaticity_offset(first) * chromaticity_offset(second))

    m1, m2 = (evaluate_factors(part) / evaluate_factors(_DAYLIGHT[0]) for part in _DAYLIGHT[1:])
    return basis[:, 0] + m1 * basis[:, 1] + m2 * basis[:, 2]
