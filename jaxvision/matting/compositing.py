"""Compositing: pictures with coverage, layered in linear light.

A layer is (..., bands + 1): linear relative light multiplied by its coverage, then the coverage
alpha in [0, 1] as the last channel. In this form every operator of Porter and Duff is one equation
for all channels,

    result = F_A A + F_B B,

and light may exceed its alpha (a glow). `layer_from_srgb` and `layer_to_srgb` convert from and to
the straight, encoded RGBA of files. Integer codes raise a `ValueError`.

An alpha that is NaN, or outside [0, 1] by more than rounding (100 ULP: blurred full coverage
reaches 1 + 4 eps), raises a `ValueError` that states the number of such pixels. A traced alpha is
not checked, and the equation then applies to any value. Nothing is clipped. Source: Porter and
Duff, "Compositing Digital Images", SIGGRAPH 1984.
"""

import warnings
from collections.abc import Callable
from functools import reduce
from typing import overload

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import divide, smallest_divisor
from ..core._types import (
    AMOUNT,
    Scalars,
    as_relative,
    check_choice,
    is_known,
    map_beside,
    print_by_name,
)
from ..core._warnings import warn_caller
from ..point_ops import srgb_decode, srgb_encode

Layer = Float[Array, "... _"]
Alpha = Float[Array, "... 1"]
print_by_name(globals(), "Layer", "Alpha")

# Smallest number of partly covered pixels that shows whether colours are premultiplied
SEVERAL = 30
CODE = 0.5 / 255  # rounding error of an 8-bit colour

# (F_A of alpha_B, F_B of alpha_A): Porter and Duff, section 4.2, and their "plus" of section 4.5.
_FRACTIONS: dict[str, tuple[Callable[[Alpha], Alpha], Callable[[Alpha], Alpha]]] = {
    "clear": (jnp.zeros_like, jnp.zeros_like),
    "front": (jnp.ones_like, jnp.zeros_like),
    "back": (jnp.zeros_like, jnp.ones_like),
    "over": (jnp.ones_like, lambda a: 1 - a),
    "back over": (lambda b: 1 - b, jnp.ones_like),
    "in": (lambda b: b, jnp.zeros_like),
    "back in": (jnp.zeros_like, lambda a: a),
    "out": (lambda b: 1 - b, jnp.zeros_like),
    "back out": (jnp.zeros_like, lambda a: 1 - a),
    "atop": (lambda b: b, lambda a: 1 - a),
    "back atop": (lambda b: 1 - b, lambda a: a),
    "xor": (lambda b: 1 - b, lambda a: 1 - a),
    "plus": (jnp.ones_like, jnp.ones_like),
}


@overload
def over(front: Layer, back: Layer) -> Layer: ...
@overload
def over(front: Layer, back: Layer, *, alpha_sd: Alpha) -> tuple[Layer, Layer]: ...
@takes_numbers
@takes_range(alpha_sd=AMOUNT)
def over(
    front: Layer, back: Layer, *, alpha_sd: Alpha | None = None
) -> Layer | tuple[Layer, Layer]:
    """Composite front + (1 - alpha) back: the front hides the back in proportion to its coverage.

    The operator is associative, not commutative.

    Args:
        front: (..., bands + 1) premultiplied relative light and coverage.
        back: the same channels.
        alpha_sd: (..., 1) standard deviation of the front's coverage, no unit, as `matte_errors`
            returns it. The straight colour of the front, light divided by coverage, counts as
            exact.

    Returns:
        (..., bands + 1), a layer. With `alpha_sd` also the standard deviations of its channels, the
        same shape: |c - back| alpha_sd, where c is the straight colour and coverage 1. Where the
        coverage is 0, the colour is unknown and counts as black; a coverage of at least 1e-6 keeps
        it.

    Raises:
        ValueError: for unequal channels, for an alpha outside [0, 1], and for an `alpha_sd` that is
            negative.

    Example:
        >>> glass = jnp.array([0.2, 0.0, 0.0, 0.5])  # half covering, red
        >>> blue = jnp.array([0.0, 0.0, 1.0, 1.0])
        >>> print(jv.matting.over(glass, blue))
        [0.2 0.  0.5 1. ]
        >>> print(jv.matting.over(glass, blue, alpha_sd=jnp.array([0.1]))[1])
        [0.04 0.   0.1  0.  ]
    """
    made = composite(front, back, operator="over")
    if alpha_sd is None:
        return made
    colour = unpremultiply(front)
    whole = jnp.concatenate([colour, jnp.ones_like(colour[..., :1])], axis=-1)
    return made, jnp.abs(whole - back) * alpha_sd


@takes_numbers
def composite(front: Layer, back: Layer, *, operator: str = "over") -> Layer:
    """Composite F_A front + F_B back, for any of Porter and Duff's thirteen operators.

    "in" shows the front where the back covers, and "out" shows the front where the back does not
    cover. "atop" shows the front over the back, within the outline of the back. "xor" shows each
    layer where the other is absent. "back ..." exchanges the roles of front and back. "plus" adds
    light and coverage (for a cross-dissolve of two dissolved layers), and its alpha may exceed 1.

    Args:
        front: (..., bands + 1) premultiplied relative light and coverage.
        back: the same channels.
        operator: "clear", "front", "back", "over", "in", "out", "atop", "back over", "back in",
            "back out", "back atop", "xor" or "plus".

    Returns:
        (..., bands + 1), a layer.

    Raises:
        ValueError: for another operator, for unequal channels, and for an alpha outside [0, 1].
    """
    check_choice("operator", operator, _FRACTIONS)
    front, back = as_relative(front), as_relative(back)
    if front.shape[-1] != back.shape[-1] or front.shape[-1] < 2:
        raise ValueError(
            "front and back must have the same channels, at least one of light and one of "
            f"coverage, got shapes {front.shape} and {back.shape}."
        )
    _warn_of_rgb(front, back)
    for name, layer in (("front", front), ("back", back)):
        _warn_of_straight(name, layer)
    of_front, of_back = _FRACTIONS[operator]
    a, b = checked_alpha(front[..., -1:]), checked_alpha(back[..., -1:])
    return of_front(b) * front + of_back(a) * back


def _warn_of_rgb(*layers: Layer) -> None:
    """Warn about a picture with three channels whose last channel is rarely 0 or 1, and thus
    probably no coverage.
    """
    if any(not is_known(x) or x.ndim < 3 or x.shape[-1] != 3 or x.size < 100 for x in layers):
        return
    whole = [np.isin(np.asarray(x[..., -1]), (0, 1)).mean() for x in layers]
    if max(whole) < 0.5:
        warnings.warn(
            "layers of three channels are two bands of light and a coverage, and here the coverage "
            "is 0 or 1 in less than half of the pixels; if these are RGB pictures, give each its "
            "alpha as a fourth channel.",
            stacklevel=4,
        )


def _partly_covered(layer: Layer, most: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the largest light and the coverage of pixels with a coverage up to `most`. Return None
    if JAX traces the picture, if it has too few such pixels, or if it has light above 1."""
    if not is_known(layer) or layer.ndim < 3:
        return None
    pixels = np.asarray(layer)
    light, covered = pixels[..., :-1].max(axis=-1), pixels[..., -1]
    at = (covered > 0) & (covered < most)
    if at.sum() < SEVERAL or not light.max() <= 1:
        return None
    return light[at], covered[at]


def _warn_of_straight(name: str, layer: Layer) -> None:
    """Warn about light that exceeds the coverage of most partly covered pixels."""
    found = _partly_covered(layer, 0.5)
    if found is None or not (share := np.mean(found[0] > found[1])) > 0.5:
        return
    warn_caller(
        f"{name}: light exceeds the coverage in {share:.0%} of the pixels that are covered by less "
        "than half, as in straight colours. Layers hold light times coverage; use premultiply, or "
        "layer_from_srgb for files."
    )


def _warn_of_premultiplied(rgba: Layer) -> None:
    """Warn about colours that nowhere exceed their coverage, although some pixels are hardly
    covered."""
    found = _partly_covered(rgba, 0.1)
    if found is None or not (found[0] <= found[1] + CODE).all() or not np.median(found[0]) > 0:
        return
    warn_caller(
        "No colour exceeds its coverage where that is below 0.1, as in colours that were already "
        "multiplied by it. If so, divide by it before layer_from_srgb, or edges become too dark."
    )


@takes_numbers
def flatten(layers: Float[Array, "layers *picture channels"]) -> Layer:
    """Combine all layers to one by `over`, from the back to the front. The first layer is in front.

    Args:
        layers: (layers, ..., bands + 1) premultiplied relative light and coverage, at least one.

    Returns:
        (..., bands + 1), a layer.

    Raises:
        ValueError: for no layer, and for an alpha outside [0, 1].
    """
    if layers.shape[0] == 0:
        raise ValueError(f"flatten needs at least one layer, got shape {layers.shape}.")
    return reduce(lambda behind, layer: over(layer, behind), layers[::-1])


@takes_numbers
def dissolve(layer: Layer, fraction: Scalars | float) -> Layer:
    """Multiply the light and the coverage of a layer by `fraction`.

    Args:
        layer: (..., bands + 1) premultiplied relative light and coverage.
        fraction: no unit, in [0, 1], or a map (h, w).

    Returns:
        (..., bands + 1), a layer.
    """
    layer = as_relative(layer)
    return layer * map_beside(fraction, layer)


@takes_numbers
def darken(layer: Layer, factor: Scalars | float) -> Layer:
    """Multiply the light of a layer by `factor`, and keep its coverage.

    Args:
        layer: (..., bands + 1) premultiplied relative light and coverage.
        factor: no unit; above 1 it brightens.

    Returns:
        (..., bands + 1), a layer.
    """
    layer = as_relative(layer)
    return jnp.concatenate([layer[..., :-1] * factor, layer[..., -1:]], axis=-1)


@takes_numbers
def premultiply(colour: Float[Array, "... bands"], alpha: Alpha) -> Layer:
    """Return the layer of a straight (not premultiplied) colour and its coverage.

    Args:
        colour: (..., bands) linear relative light.
        alpha: (..., 1) coverage in [0, 1], no unit.

    Returns:
        (..., bands + 1), a layer.

    Raises:
        ValueError: for shapes that do not fit, and for an alpha outside [0, 1].
    """
    if alpha.shape != (*colour.shape[:-1], 1):
        raise ValueError(
            f"alpha must be (..., 1) for its colour (..., bands), got shapes {alpha.shape} and "
            f"{colour.shape}."
        )
    colour, covered = as_relative(colour), checked_alpha(alpha)
    return jnp.concatenate([colour * covered, covered], axis=-1)


@takes_numbers
def unpremultiply(layer: Layer) -> Float[Array, "... bands"]:
    """Return the straight colour of a layer: light divided by coverage.

    Args:
        layer: (..., bands + 1) premultiplied relative light and coverage.

    Returns:
        (..., bands) linear relative light; 0 with gradient 0 where nothing is covered, which is a
        coverage up to 3e-10 in float32 and 1e-77 in float64.

    Raises:
        ValueError: for an alpha outside [0, 1].
    """
    alpha = checked_alpha(layer[..., -1:])
    return divide(layer[..., :-1], alpha, ~(alpha <= smallest_divisor(alpha.dtype)))


@takes_numbers
def layer_from_srgb(rgba: Layer) -> Layer:
    """Return the layer of straight sRGB with coverage, as PNG files store it.

    The colour is decoded to linear light, then premultiplied. The coverage of PNG files is not
    sRGB-encoded, so it is not decoded.

    Args:
        rgba: (..., 4) relative, in [0, 1].

    Returns:
        (..., 4), a layer.

    Raises:
        ValueError: for an alpha outside [0, 1].
    """
    _warn_of_premultiplied(rgba)
    return premultiply(srgb_decode(rgba[..., :-1]), rgba[..., -1:])


@takes_numbers
def layer_to_srgb(layer: Layer) -> Layer:
    """The inverse of `layer_from_srgb`.

    Args:
        layer: (..., 4) premultiplied relative light and coverage.

    Returns:
        (..., 4) in [0, 1]: sRGB, not multiplied by the coverage, and the coverage. The sRGB colour
        is black where the coverage is 0.

    Raises:
        ValueError: for an alpha outside [0, 1].
    """
    return jnp.concatenate([srgb_encode(unpremultiply(layer)), layer[..., -1:]], axis=-1)


@takes_numbers
def checked_alpha(alpha: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return `alpha` unchanged, after a check that it lies in [0, 1].

    Args:
        alpha: (...) coverage, relative; a tracer passes unchecked.

    Returns:
        (...) the same.

    Raises:
        ValueError: for values that are not finite, or outside [0, 1] by more than 100 units of the
            last place.
    """
    alpha = as_relative(alpha)
    if isinstance(alpha, Tracer):
        return alpha
    rounding, values = 100 * float(jnp.finfo(alpha.dtype).eps), np.asarray(alpha)
    wrong = np.sum(~((values >= -rounding) & (values <= 1 + rounding)))
    if wrong:
        raise ValueError(
            f"alpha must lie in [0, 1]: {wrong} of {alpha.size} values do not; clip or rescale it."
        )
    return alpha
