"""Point operators: each pixel by itself, elementwise on arrays of any shape and floating dtype.

Encoded and linear values are relative, nominally in [0, 1] and continued above 1; integer codes are
a `ValueError`. Values and gradients of finite pixels are finite everywhere, also at and below 0.
NaN stays NaN; neither it nor infinity affects another pixel. Parameters are Python floats or arrays
that broadcast with the pixels: one number, one per band, or one per pixel. Inside one `jit` a chain
of these operators is a single pass over the picture. For linear light and superposition see
Szeliski, Computer Vision, section 3.1.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt

from ._numerics import divide, power, safe_log, smallest_divisor
from ._types import Image, Scalar, Scalars, as_relative, check_choice

_LN_10 = 2.302585092994046

# ---------------------------------------------------------------- linear in the light


def gain_bias(x: Scalars, gain: Scalars | float, bias: Scalars | float) -> Scalars:
    """gain x + bias.

    Args:
        x: (...) relative.
        gain: no unit; a map (h, w, 1) makes it vary over the picture.
        bias: in the unit of the result; a map likewise.

    Returns:
        (...) relative.

    Source: Szeliski, Computer Vision, section 3.1.1.
    """
    return gain * as_relative(x) + bias


def contrast_brightness(
    x: Scalars,
    contrast: Scalars | float,
    brightness: Scalars | float,
    *,
    pivot: Scalars | float = 0.5,
) -> Scalars:
    """contrast (x - pivot) + pivot + brightness: the contrast changes about the grey `pivot`.

    Args:
        x: (...) relative.
        contrast: no unit; 1 changes nothing.
        brightness: relative, added.
        pivot: relative, the grey that a change of contrast keeps.

    Returns:
        (...) relative.
    """
    return contrast * (as_relative(x) - pivot) + (pivot + brightness)


def exposure(x: Scalars, stops: Scalars | float) -> Scalars:
    """2^stops x: linear light as `stops` more of exposure would have recorded it.

    Args:
        x: (...) relative, linear.
        stops: no unit; may be negative.

    Returns:
        (...) relative.
    """
    return jnp.exp2(stops) * as_relative(x)


def blend(first: Scalars, second: Scalars, fraction: Scalars | float) -> Scalars:
    """(1 - fraction) first + fraction second, the linear blend.

    Args:
        first: (...) relative.
        second: (...) relative.
        fraction: no unit; outside [0, 1] it extrapolates.

    Returns:
        (...) relative.

    Source: Szeliski, Computer Vision, section 3.1.
    """
    return (1 - fraction) * as_relative(first) + fraction * as_relative(second)


def cross_dissolve(
    first: Float[Array, "frames ..."], second: Float[Array, "..."]
) -> Float[Array, "frames ..."]:
    """Two sequences blended frame by frame: `first` alone at the first frame, `second` at the last.

    Args:
        first: (frames, ...) relative, at least two frames.
        second: the same shape, relative.

    Returns:
        (frames, ...) relative.

    Raises:
        ValueError: for unequal shapes or fewer than two frames.
    """
    if first.shape != second.shape or first.shape[0] < 2:
        raise ValueError(
            "cross_dissolve needs two sequences of one shape and at least two frames, got "
            f"{first.shape} and {second.shape}."
        )
    first, second = as_relative(first), as_relative(second)
    fraction = jnp.linspace(0, 1, first.shape[0], dtype=first.dtype)
    return blend(first, second, fraction.reshape((-1,) + (1,) * (first.ndim - 1)))


def graded_filter(
    image: Image,
    density: Scalar | float,
    angle: Scalar | float,
    centre: Scalar | float,
    width: Scalar | float,
) -> Image:
    """A graded neutral density filter before the lens: linear light times 10^(-density s).

    s rises smoothly, 3 t^2 - 2 t^3, from 0 on the clear side to 1 on the dark one.

    Args:
        image: (..., h, w, bands) relative, linear.
        density: () optical density of the dark side, no unit; 0.3 is one stop.
        angle: () rad, the direction in which it darkens: 0 to the right, pi/2 up.
        centre: () where half the density is reached, relative to the picture's height, from its
            centre.
        width: () over which it rises, relative to the picture's height; 0 or less is a step.

    Returns:
        (..., h, w, bands) relative.

    Raises:
        ValueError: for fewer than three axes.
    """
    image, rows, columns = _sized(image)
    right, up = _from_centre(rows, columns, image.dtype, unit=rows)
    along = jnp.cos(angle) * right + jnp.sin(angle) * up
    t = jnp.clip((along - centre) / jnp.maximum(width, smallest_divisor(image.dtype)) + 0.5, 0, 1)
    return image * _per_pixel(jnp.exp(-_LN_10 * density * t * t * (3 - 2 * t)), image)


def vignette(image: Image, coefficients: Float[Array, " terms"]) -> Image:
    """Linear light times the falloff 1 + k_1 r^2 + k_2 r^4 + ...

    r is the distance from the centre of the picture relative to that of its corner. The cos^4 law
    of an ideal lens belongs to `optics`.

    Args:
        image: (..., h, w, bands) relative, linear.
        coefficients: (terms,) k_1, k_2, ..., no unit. A falloff below 0 counts as 0.

    Returns:
        (..., h, w, bands) relative.

    Raises:
        ValueError: for fewer than three axes.

    Source: the "pa" model of lens tables.
    """
    image, rows, columns = _sized(image)
    return image * _per_pixel(_falloff(rows, columns, image.dtype, coefficients), image)


def correct_vignetting(image: Image, coefficients: Float[Array, " terms"]) -> Image:
    """The inverse of `vignette`; pixels that received no light at all stay 0.

    Args:
        image: (..., h, w, bands) relative, linear.
        coefficients: (terms,) k_1, k_2, ..., no unit, as for `vignette`.

    Returns:
        (..., h, w, bands) relative.

    Raises:
        ValueError: for fewer than three axes.
    """
    image, rows, columns = _sized(image)
    falloff = _falloff(rows, columns, image.dtype, coefficients)
    inverse = divide(1, falloff, falloff > smallest_divisor(image.dtype))
    return image * _per_pixel(inverse, image)


def _falloff(
    rows: int, columns: int, dtype: np.dtype, coefficients: Float[Array, " terms"]
) -> Float[Array, "h w"]:
    half_diagonal = ((rows - 1) ** 2 + (columns - 1) ** 2) ** 0.5 / 2
    right, up = _from_centre(rows, columns, dtype, unit=half_diagonal or 1)
    r2 = right * right + up * up
    total = jnp.zeros_like(r2)
    for k in coefficients[::-1]:
        total = (total + k) * r2
    return jnp.maximum(1 + total, 0)


def _sized(image: Image) -> tuple[Image, int, int]:
    """The picture, its rows and its columns."""
    image = as_relative(image)
    if image.ndim < 3:
        raise ValueError(f"image must be (..., h, w, bands), got shape {image.shape}.")
    rows, columns = image.shape[-3:-1]
    return image, rows, columns


def _from_centre(
    rows: int, columns: int, dtype: np.dtype, *, unit: float | int
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """(right, up) of each pixel's centre from that of the picture, in `unit`s of pixels."""
    right = (jnp.arange(columns, dtype=dtype) - (columns - 1) / 2) / unit
    up = ((rows - 1) / 2 - jnp.arange(rows, dtype=dtype)) / unit
    return jnp.broadcast_to(right, (rows, columns)), jnp.broadcast_to(up[:, None], (rows, columns))


def _per_pixel(values: Float[Array, "h w"], image: Image) -> Float[Array, "... h w 1"]:
    """A map of the picture, with the axes of a batch of images."""
    return values.reshape((1,) * (image.ndim - 3) + values.shape + (1,))


# ---------------------------------------------------------------- curves


def gamma_encode(linear: Scalars, gamma: Scalars | float, *, method: str = "power") -> Scalars:
    """linear^(1 / gamma); values below 0 count as 0, where the gradient is 0.

    Args:
        linear: (...) relative.
        gamma: no unit, above 0.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, encoded.

    Raises:
        ValueError: for an unknown method.
    """
    return _raised(as_relative(linear), 1 / gamma, method)


def gamma_decode(encoded: Scalars, gamma: Scalars | float, *, method: str = "power") -> Scalars:
    """encoded^gamma, the inverse of `gamma_encode`; values below 0 count as 0.

    Args:
        encoded: (...) relative.
        gamma: no unit, above 0.
        method: "power" is right to the last place. "exp2", exp2(gamma log2 x), takes a third of its
            time on a CPU and is off by up to 60 units of the last place on [1e-5, 1].

    Returns:
        (...) relative, linear.

    Raises:
        ValueError: for an unknown method.
    """
    return _raised(as_relative(encoded), gamma, method)


def srgb_encode(linear: Scalars, *, method: str = "power") -> Scalars:
    """The sRGB curve: 12.92 x up to 0.0031308 (also below 0), else 1.055 x^(1/2.4) - 0.055.

    Args:
        linear: (...) relative.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, encoded.

    Raises:
        ValueError: for an unknown method.

    Source: IEC 61966-2-1.

    Example:
        >>> print(jv.srgb_encode(jnp.array([0.0, 0.18, 1.0])).round(4))
        [0.     0.4614 1.    ]
    """
    linear = as_relative(linear)
    curved = linear > 0.0031308
    root = _raised(jnp.where(curved, linear, 1), 1 / 2.4, method)
    return jnp.where(curved, 1.055 * root - 0.055, 12.92 * linear)


def srgb_decode(encoded: Scalars, *, method: str = "power") -> Scalars:
    """The inverse of `srgb_encode`.

    It is x / 12.92 up to 0.04045 (also below 0), else ((x + 0.055) / 1.055)^2.4.

    Args:
        encoded: (...) relative.
        method: "power" or "exp2", as for `gamma_decode`.

    Returns:
        (...) relative, linear.

    Raises:
        ValueError: for an unknown method.

    Source: IEC 61966-2-1.
    """
    encoded = as_relative(encoded)
    curved = encoded > 0.04045
    base = (jnp.where(curved, encoded, 1) + 0.055) / 1.055
    return jnp.where(curved, _raised(base, 2.4, method), encoded / 12.92)


def _raised(base: Scalars, exponent: Scalars | float, method: str) -> Scalars:
    check_choice("method", method, ("power", "exp2"))
    if method == "power":
        raised = power(base, jnp.asarray(exponent))
    else:
        positive = base > 0
        raised = jnp.where(positive, jnp.exp2(exponent * jnp.log2(jnp.where(positive, base, 1))), 0)
    return jnp.where(jnp.isnan(base), base, raised)


def clip(x: Scalars, low: Scalars | float, high: Scalars | float) -> Scalars:
    """x limited to [low, high]; outside, the gradient goes to the limit.

    Args:
        x: (...) relative.
        low: relative.
        high: relative.

    Returns:
        (...) relative.
    """
    x = as_relative(x)
    return jnp.where(x < low, low, jnp.where(x > high, high, x))


def lookup(x: Scalars, table: Float[Array, " entries"]) -> Scalars:
    """A curve through equally spaced entries: piecewise linear, constant outside [0, 1].

    Args:
        x: (...) relative.
        table: (entries,) any unit, the first entry at x = 0 and the last at x = 1.

    Returns:
        (...) in the table's unit.

    Raises:
        ValueError: for fewer than two entries.
    """
    if table.shape[0] < 2:
        raise ValueError(f"table must hold at least two entries, got {table.shape[0]}.")
    lower, t = _cell(as_relative(x), table.shape[0])
    return blend(table[lower], table[lower + 1], t)


def lookup_codes(
    codes: UInt[Array, "..."] | Int[Array, "..."], table: Float[Array, " entries"]
) -> Float[Array, "..."]:
    """table[codes]: the exact curve of integer codes.

    Args:
        codes: (...) whole numbers; a code outside the table takes its nearest end.
        table: (entries,) relative, or any unit.

    Returns:
        (...) in the table's unit.
    """
    return table[jnp.clip(codes, 0, table.shape[0] - 1)]


def lookup_3d(
    image: Float[Array, "... 3"], table: Float[Array, "red green blue channels"]
) -> Float[Array, "... channels"]:
    """A colour table over the cube of R, G and B: trilinear, constant outside [0, 1].

    Args:
        image: (..., 3) relative.
        table: (n_r, n_g, n_b, channels) any unit, its axes spanning [0, 1].

    Returns:
        (..., channels) in the table's unit.

    Raises:
        ValueError: for an axis of fewer than two entries, and for an image without three bands.
    """
    image = as_relative(image)
    if image.shape[-1:] != (3,):
        raise ValueError(f"image must have a last axis of 3, got shape {image.shape}.")
    if min(table.shape[:3]) < 2:
        raise ValueError(f"table must have at least two entries an axis, got {table.shape}.")
    lower, t = zip(*(_cell(image[..., i], table.shape[i]) for i in range(3)), strict=True)
    flat = table.reshape(-1, table.shape[-1])
    _, n_green, n_blue = table.shape[:3]

    def corner(r: int, g: int, b: int) -> Float[Array, "... channels"]:
        return flat[((lower[0] + r) * n_green + lower[1] + g) * n_blue + lower[2] + b]

    tr, tg, tb = (fraction[..., None] for fraction in t)
    edges = [blend(corner(r, g, 0), corner(r, g, 1), tb) for r in (0, 1) for g in (0, 1)]
    return blend(blend(edges[0], edges[1], tg), blend(edges[2], edges[3], tg), tr)


def _cell(x: Scalars, entries: int) -> tuple[Int[Array, "..."], Scalars]:
    """The entry at or below x in a table over [0, 1], and the fraction of the way to the next."""
    at = jnp.where(x <= 0, 0, jnp.minimum(x, 1)) * (entries - 1)
    # NaN has no integer: it may take any entry, since the fraction is NaN
    lower = jnp.clip(jax.lax.stop_gradient(at).astype(jnp.int32), 0, entries - 2)
    return lower, at - lower.astype(at.dtype)


# ---------------------------------------------------------------- tone mapping


def reinhard(x: Scalars, *, white: Scalars | float | None = None) -> Scalars:
    """Reinhard's tone curve: x / (1 + x), or with a white x (1 + x / white^2) / (1 + x).

    Below 0 it is x itself, which continues value and slope.

    Args:
        x: (...) relative scaled luminance, as `scaled_to_key` gives it.
        white: relative, the smallest x that maps to 1; None for a curve that only tends to 1.

    Returns:
        (...) relative.

    Source: Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002,
    equations 3 and 4.
    """
    x = as_relative(x)
    positive = jnp.maximum(x, 0)
    lifted = positive if white is None else positive * (1 + positive / (white * white))
    return jnp.where(x > 0, lifted / (1 + positive), x)


def scaled_to_key(luminance: Float[Array, "h w"], *, key_value: float = 0.18) -> Scalars:
    """Luminance times key / log-average, which moves the picture's middle grey to the key.

    The log-average clamps black at 1e-6 of the mean and leaves out values that are not finite.

    Args:
        luminance: (h, w) relative.
        key_value: relative, the wanted middle grey.

    Returns:
        (h, w) relative.

    Source: Reinhard et al. 2002, equations 1 and 2.
    """
    luminance = as_relative(luminance)
    known = jnp.isfinite(luminance)
    mean = jnp.mean(luminance, where=known)
    floor = 1e-6 * jnp.maximum(mean, smallest_divisor(luminance.dtype))
    average = jnp.exp(jnp.mean(safe_log(jnp.maximum(luminance, floor)), where=known))
    return luminance * (key_value / average)


def filmic(x: Scalars) -> Scalars:
    """The ACES film curve x (2.51 x + 0.03) / (x (2.43 x + 0.59) + 0.14), clipped to 1.

    Unclipped it ends a little above 1, at 1.033.

    Args:
        x: (...) relative; below 0 counts as 0.

    Returns:
        (...) relative, in [0, 1].

    Source: the fit of Narkowicz, "ACES Filmic Tone Mapping Curve" (2016).
    """
    positive = jnp.maximum(as_relative(x), 0)
    # both sides over x^2 where x is large, so that nothing overflows
    small = jnp.minimum(positive, 1)
    large = 1 / jnp.maximum(positive, 1)
    low = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14)
    high = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large))
    return jnp.minimum(jnp.where(positive < 1, low, high), 1)


def log_curve(x: Scalars, strength: Scalars | float) -> Scalars:
    """log(1 + strength x) / log(1 + strength): 0 at 0 and 1 at 1.

    Args:
        x: (...) relative; below 0 counts as 0.
        strength: no unit, above 0; the larger, the steeper at the dark end.

    Returns:
        (...) relative.

    Source: the mu-law of ITU-T G.711.
    """
    return jnp.log1p(strength * jnp.maximum(as_relative(x), 0)) / jnp.log1p(strength)


def with_luminance(
    image: Float[Array, "... channels"], luminance: Scalars, wanted: Scalars
) -> Float[Array, "... channels"]:
    """image times wanted / luminance, pixel by pixel: applies a curve and keeps the chromaticity.

    Args:
        image: (..., channels) relative.
        luminance: (...) of the image, relative or in any unit; black stays black.
        wanted: (...) in the unit of `luminance`.

    Returns:
        (..., channels) relative.
    """
    image, luminance = as_relative(image), as_relative(luminance)
    gain = divide(wanted, luminance, ~(luminance <= smallest_divisor(luminance.dtype)))
    return image * gain[..., None]
