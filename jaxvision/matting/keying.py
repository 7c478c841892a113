"""Mattes from a known background: its picture, its colour, or several known backgrounds.

Pictures are (..., bands) in linear light of any unit; alpha is (..., 1), clipped to [0, 1]. If the
background gives no information, the matte is opaque and the layer is the picture itself. A
background gives no information if it is the same behind every picture, or equal to the foreground,
within eight rounding errors. A NaN affects only its own pixel. Integer codes raise a `ValueError`.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, magnitude, safe_sqrt, smallest_divisor
from ..core._types import Scalar, Scalars, as_relative, check_choice, is_known, print_by_name
from ..point_ops import clip
from .compositing import checked_alpha

Picture = Float[Array, "... bands"]
Alpha = Float[Array, "... 1"]
Layer = Float[Array, "... _"]
print_by_name(globals(), "Picture", "Alpha", "Layer")


@takes_numbers
def difference_matte(
    image: Picture, background: Picture, low: Scalar | float, high: Scalar | float
) -> Alpha:
    """Return the distance of each pixel's colour from the clean background, mapped linearly to [0,
    1].

    Args:
        image: (..., bands) linear relative light.
        background: (..., bands) or (bands,), relative.
        low: () relative, the Euclidean distance of colours up to which alpha is 0.
        high: () relative, the distance from which alpha is 1.

    Returns:
        (..., 1) alpha, no unit.

    Raises:
        ValueError: unless `low` < `high`. If traced limits violate this, the matte is a step at
            `low`.

    Example:
        >>> wall, leaf = [0.2, 0.2, 0.2], [0.2, 0.5, 0.6]
        >>> picture = [wall, leaf]  # of two pixels
        >>> print(jv.matting.difference_matte(picture, wall, 0.1, 0.4).ravel())
        [0. 1.]
    """
    if is_known(low) and is_known(high) and not np.asarray(low) < np.asarray(high):
        raise ValueError(f"low must lie below high, got {low} and {high}.")
    image, background = as_relative(image), as_relative(background)
    size = magnitude(jnp.stack([low, high]).astype(image.dtype))[0]
    low, high = low / size, high / size
    apart = (image - jnp.broadcast_to(background, image.shape)) / size
    # safe_sqrt of NaN is 0
    squared = jnp.sum(apart * apart, axis=-1, keepdims=True)
    distance = jnp.where(jnp.isnan(squared), squared, safe_sqrt(squared))
    return _unit((distance - low) / jnp.maximum(high - low, smallest_divisor(image.dtype)))


@takes_numbers
def blue_screen_matte(
    image: Picture, backing: Picture, *, channel: int = 2, foreground: str = "grey"
) -> Alpha:
    """Compute the matte of an object before a screen of one colour, under an assumption about the
    object's colours.

    Under each assumption, a linear combination n of a pixel's bands depends on the screen only, so
    that alpha = 1 - n . image / n . backing.

    Args:
        image: (..., bands) linear relative light.
        backing: (..., bands) or (bands,) light of the screen, relative.
        channel: the band of the screen (2 is blue; 1 for a green screen).
        foreground: assumption on the object: "none": it reflects no light in that band; "grey": it
            reflects the mean of the other bands. (Skin fulfils "grey" if only the green and blue
            bands are passed.)

    Returns:
        (..., 1) alpha, no unit.

    Raises:
        ValueError: for another assumption, and for a channel that the image does not have.

    Source: Smith and Blinn, "Blue Screen Matting", SIGGRAPH 1996, solutions 1 and 2, here for any
    backing.

    Example:
        >>> screen, grey = np.array([0.0, 0.1, 0.8]), np.array([0.4, 0.4, 0.4])
        >>> edge = 0.25 * grey + 0.75 * screen  # a grey object in a quarter of the pixel
        >>> print(jv.matting.blue_screen_matte(edge, screen))
        [0.25]
    """
    image, backing = as_relative(image), as_relative(backing)
    bands = image.shape[-1]
    check_choice("foreground", foreground, ("none", "grey"))
    if not 0 <= channel < bands or (foreground == "grey" and bands < 2):
        raise ValueError(
            f"channel {channel} and foreground {foreground!r} ask for more bands than the {bands} "
            "of the image."
        )

    def excess(light: Picture) -> Scalars:
        own = light[..., channel : channel + 1]
        if foreground == "none":
            return own
        return own - (jnp.sum(light, axis=-1, keepdims=True) - own) / (bands - 1)

    backing = jnp.broadcast_to(backing, image.shape)
    whole = excess(backing)
    return _unit(1 - divide(excess(image), whole, ~_is_rounding(whole, backing)))


@takes_numbers
def projected_matte(image: Picture, foreground: Picture, background: Picture) -> Alpha:
    """The least-squares alpha for two known colours: (C - B) . (F - B) / |F - B|^2.

    Args:
        image: (..., bands) linear relative light.
        foreground: (..., bands) or (bands,), a picture or a colour, relative.
        background: (..., bands) or (bands,), relative.

    Returns:
        (..., 1) alpha, no unit; 1 where both colours are equal, so that any alpha fits.

    Source: Levin, Lischinski, Weiss 2008, equation 1, projected onto the line from B to F.

    Example:
        >>> hair, sky = np.array([0.1, 0.05, 0.0]), np.array([0.3, 0.5, 0.9])
        >>> print(jv.matting.projected_matte(0.6 * hair + 0.4 * sky, hair, sky))
        [0.6]
    """
    image = as_relative(image)
    foreground, background = (
        jnp.broadcast_to(as_relative(x), image.shape) for x in (foreground, background)
    )
    span = foreground - background
    differs = ~_is_rounding(span, jnp.maximum(jnp.abs(foreground), jnp.abs(background)))
    size = magnitude(span)
    along = jnp.sum((image - background) / size * (span / size), axis=-1, keepdims=True)
    length = jnp.sum((span / size) ** 2, axis=-1, keepdims=True)
    return _unit(divide(along, length, differs, otherwise=1))


@takes_numbers
def least_squares_matte(
    images: Float[Array, "pictures *picture bands"],
    backgrounds: Float[Array, "pictures *picture bands"],
) -> Layer:
    """Return the layer whose composites over the known backgrounds K_i are nearest to their
    pictures C_i.

    The residual C_i - C_o - (1 - alpha) K_i is linear in the unknown colour C_o and in alpha.
    Subtracting the means over i eliminates C_o. The optimal alpha in [0, 1] is then, after
    clipping,

        alpha = 1 - sum (C_i - mean C) . (K_i - mean K) / sum |K_i - mean K|^2

    The result is exact for two backgrounds without noise, for any colours of the object.

    Args:
        images: (pictures, ..., bands) linear relative light of one object in front of at least two
            backgrounds.
        backgrounds: the same shape, relative.

    Returns:
        (..., bands + 1), a layer; alpha is 1 where all backgrounds are equal, so that any fits.

    Raises:
        ValueError: for unequal shapes or fewer than two pictures.

    Source: Smith and Blinn, "Blue Screen Matting", SIGGRAPH 1996, theorem 4 and its extension to
    more backings.

    Example:
        >>> layer, screens = np.array([0.1, 0.2]), np.array([[0.0, 0.8], [0.8, 0.0], [0.4, 0.4]])
        >>> pictures = layer + (1 - 0.5) * screens  # smoke, of alpha 0.5
        >>> print(np.asarray(jv.matting.least_squares_matte(pictures, screens)).round(3))
        [0.1 0.2 0.5]
    """
    images, backgrounds = as_relative(images), as_relative(backgrounds)
    if images.shape != backgrounds.shape or images.shape[0] < 2:
        raise ValueError(
            "images and backgrounds must have one shape, at least two pictures of each, got "
            f"{images.shape} and {backgrounds.shape}."
        )
    image, background = jnp.mean(images, axis=0), jnp.mean(backgrounds, axis=0)
    about_c, about_k = images - image[None], backgrounds - background[None]
    differs = ~_is_rounding(about_k, backgrounds).all(axis=0)
    size = magnitude(about_k, axis=(0, -1))
    together = jnp.sum(about_c / size * (about_k / size), axis=(0, -1))[..., None]
    spread = jnp.sum((about_k / size) ** 2, axis=(0, -1))[..., None]
    return _lift(image, _unit(1 - divide(together, spread, differs)), background)


@takes_numbers
def triangulation_matte(
    image: Picture, background: Picture, image_2: Picture, background_2: Picture
) -> Layer:
    """Return the exact layer of an object before two backgrounds that differ in every pixel.

    The function is `least_squares_matte` of two pictures.

    Args:
        image: (..., bands) linear relative light in front of the first background.
        background: (..., bands) the first background, relative.
        image_2: (..., bands) in front of the second background.
        background_2: (..., bands) the second background.

    Returns:
        (..., bands + 1), a layer; alpha is 1 where all backgrounds are equal, so that any fits.

    Raises:
        ValueError: for two pictures, or backgrounds, of different shapes.

    Example:
        >>> blue, green = np.array([0.0, 0.1, 0.8]), np.array([0.1, 0.7, 0.1])
        >>> glass = np.array([0.1, 0.1, 0.2])  # its own light; it hides 30 % of what is behind
        >>> seen = glass + 0.7 * blue, blue, glass + 0.7 * green, green
        >>> print(np.asarray(jv.matting.triangulation_matte(*seen)).round(3))
        [0.1 0.1 0.2 0.3]
    """
    for one, other in ((image, image_2), (background, background_2)):
        if one.shape != other.shape:
            raise ValueError(
                "triangulation_matte: both pictures must have one shape, and both backgrounds, got "
                f"{one.shape} and {other.shape}."
            )
    return least_squares_matte(jnp.stack([image, image_2]), jnp.stack([background, background_2]))


@takes_numbers
def lift(image: Picture, alpha: Alpha, background: Picture) -> Layer:
    """Return the light of the object alone, image - (1 - alpha) background, as a layer.

    Composited over `background`, the layer gives the original picture.

    Args:
        image: (..., bands) linear relative light.
        alpha: (..., 1) coverage in [0, 1], no unit.
        background: (..., bands) or (bands,), relative.

    Returns:
        (..., bands + 1), a layer.

    Raises:
        ValueError: for an alpha outside [0, 1], as in `compositing`.

    Example:
        >>> layer = jv.matting.lift([0.5, 0.4], [0.25], [0.4, 0.4])
        >>> print(np.asarray(layer).round(3), jv.matting.over(layer, [0.4, 0.4, 1.0])[:2])
        [0.2  0.1  0.25] [0.5 0.4]
    """
    return _lift(as_relative(image), checked_alpha(alpha), as_relative(background))


def _lift(image: Picture, alpha: Alpha, background: Picture) -> Layer:
    behind = jnp.broadcast_to(background, image.shape)
    return jnp.concatenate([image - (1 - alpha) * behind, alpha], axis=-1)


def _is_rounding(difference: Scalars, light: Scalars) -> Bool[Array, "... 1"]:
    """Return whether a difference of light is at most eight rounding errors of the light, in every
    band.
    """
    least = 8 * float(jnp.finfo(light.dtype).eps) * jnp.max(jnp.abs(light), axis=-1, keepdims=True)
    return (jnp.abs(difference) <= least).all(axis=-1, keepdims=True)


def _unit(x: Scalars) -> Scalars:
    return clip(x, 0.0, 1.0)
