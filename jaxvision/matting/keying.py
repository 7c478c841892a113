"""Mattes from a background that is known: its picture, its colour, or several of them.

For pictures (..., bands) of linear relative light; alpha is (..., 1), clipped to [0, 1]. Where a
background tells nothing (the same behind every picture, or equal to the foreground) the matte is
opaque: the picture itself. NaN stays NaN and spreads no further than its own pixel. Integer codes
are a `ValueError`.
"""

import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from .._numerics import safe_sqrt, smallest_divisor
from .._types import Scalar, Scalars, as_relative, print_by_name
from ..compositing import checked_alpha
from ..point_ops import clip

Picture = Float[Array, "... bands"]
Alpha = Float[Array, "... 1"]
Layer = Float[Array, "... _"]
print_by_name(globals(), "Picture", "Alpha", "Layer")


def difference_matte(
    image: Picture, background: Picture, low: Scalar | float, high: Scalar | float
) -> Alpha:
    """How far each pixel is from the clean background: 0 up to a distance `low`, 1 from `high` on,
    linear between; a Euclidean distance of colours, relative like the light.

    `ValueError` unless `low` < `high`, where they are known; under a trace, a step at `low`.
    """
    if not isinstance(low, Tracer) and not isinstance(high, Tracer) and not low < high:
        raise ValueError(f"low must lie below high, got {low} and {high}.")
    image, background = as_relative(image), as_relative(background)
    apart = image - jnp.broadcast_to(background, image.shape)
    # safe_sqrt of NaN is 0
    squared = jnp.sum(apart * apart, axis=-1, keepdims=True)
    distance = jnp.where(jnp.isnan(squared), squared, safe_sqrt(squared))
    return _unit((distance - low) / jnp.maximum(high - low, smallest_divisor(image.dtype)))


def blue_screen_matte(
    image: Picture, backing: Picture, *, channel: int = 2, foreground: str = "grey"
) -> Alpha:
    """The matte of an object before a screen of one colour, if the object keeps a promise.

    `backing`: (..., bands) or (bands,) the screen's light. `channel`: the band it shines in (2,
    blue; 1 for a green one). `foreground`: "none" promises that the object sends nothing in that
    band, "grey" that it sends the mean of the other bands. (Flesh keeps this promise in its green
    and blue: pass these two alone.) Some n of each pixel's bands then belongs to the screen only,
    so that alpha = 1 - n . image / n . backing. Source: Smith and Blinn, "Blue Screen Matting",
    SIGGRAPH 1996, solutions 1 and 2, here for any backing. `ValueError` for another promise.
    """
    image, backing = as_relative(image), as_relative(backing)
    bands = image.shape[-1]
    if foreground not in ("none", "grey"):
        raise ValueError(f'foreground must be "none" or "grey", got {foreground!r}.')
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

    return _unit(1 - _ratio(excess(image), excess(jnp.broadcast_to(backing, image.shape))))


def projected_matte(image: Picture, foreground: Picture, background: Picture) -> Alpha:
    """The least-squares alpha when both colours are known: (C - B) . (F - B) / |F - B|^2.

    `foreground`, `background`: (..., bands) or (bands,) of relative light, a picture or a colour
    each. Source: Levin, Lischinski, Weiss 2008, equation 1: a projection onto one line.
    """
    image = as_relative(image)
    foreground, background = (
        jnp.broadcast_to(as_relative(x), image.shape) for x in (foreground, background)
    )
    span = foreground - background
    along = jnp.sum((image - background) * span, axis=-1, keepdims=True)
    length = jnp.sum(span * span, axis=-1, keepdims=True)
    return _unit(1 - _ratio(length - along, length))


def least_squares_matte(
    images: Float[Array, "pictures *picture bands"],
    backgrounds: Float[Array, "pictures *picture bands"],
) -> Layer:
    """The layer (..., bands + 1) that, over each known background, comes nearest to its picture.

    `images`, `backgrounds`: (pictures, ..., bands) relative light of the same object before two or
    more backgrounds. The residual C_i - C_o - (1 - alpha) K_i is linear in both unknowns; C_o is
    eliminated by the means, and of what is left the clipped optimum is the optimum in [0, 1]:

        alpha = 1 - sum (C_i - mean C) . (K_i - mean K) / sum |K_i - mean K|^2

    Exact for two backgrounds without noise, whatever the object's colours. Source: Smith and Blinn,
    "Blue Screen Matting", SIGGRAPH 1996, theorem 4 and its extension to more backings. `ValueError`
    for unequal shapes or fewer than two pictures.
    """
    images, backgrounds = as_relative(images), as_relative(backgrounds)
    if images.shape != backgrounds.shape or images.shape[0] < 2:
        raise ValueError(
            "images and backgrounds must have one shape, at least two pictures of each, got "
            f"{images.shape} and {backgrounds.shape}."
        )
    image, background = jnp.mean(images, axis=0), jnp.mean(backgrounds, axis=0)
    about_c, about_k = images - image[None], backgrounds - background[None]
    together = jnp.sum(about_c * about_k, axis=(0, -1))[..., None]
    spread = jnp.sum(about_k * about_k, axis=(0, -1))[..., None]
    return _lifted(image, _unit(1 - _ratio(together, spread)), background)


def triangulation_matte(
    image: Picture, background: Picture, image_2: Picture, background_2: Picture
) -> Layer:
    """`least_squares_matte` of two pictures: the exact layer (..., bands + 1) of an object before
    two backgrounds that differ in every pixel; relative light."""
    return least_squares_matte(jnp.stack([image, image_2]), jnp.stack([background, background_2]))


def lift(image: Picture, alpha: Alpha, background: Picture) -> Layer:
    """What the object itself sends, image - (1 - alpha) background, as a layer (..., bands + 1) of
    relative light: over the same background it gives the picture back. An alpha out of [0, 1] is a
    `ValueError`, as in `compositing`."""
    return _lifted(as_relative(image), checked_alpha(alpha), as_relative(background))


def _lifted(image: Picture, alpha: Alpha, background: Picture) -> Layer:
    behind = jnp.broadcast_to(background, image.shape)
    return jnp.concatenate([image - (1 - alpha) * behind, alpha], axis=-1)


def _ratio(part: Scalars, whole: Scalars) -> Scalars:
    """part / whole, 0 where `whole` is."""
    untold = jnp.abs(whole) <= smallest_divisor(whole.dtype)
    return jnp.where(untold, 0, part / jnp.where(untold, 1, whole))


def _unit(x: Scalars) -> Scalars:
    return clip(x, 0.0, 1.0)
