"""White balance: one gain per band, so that neutral objects look neutral.

Images are (..., h, w, bands), linear, in DN or relative. Gains have no unit. The smallest gain is
1, so that no band becomes darker than recorded. The gains are von Kries' law applied in the
camera's primaries (Szeliski, Computer Vision, section 2.3.2).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import divide, or_one, power, smallest_divisor
from ..core._types import Image, Range, Scalar, Spectrum, as_relative, check_range, print_by_name

Gains = Float[Array, "*images bands"]
Picture = Float[Array, "..."]
print_by_name(globals(), "Gains", "Picture")


@takes_numbers
def white_balance(
    image: Picture, gains: Float[Array, "..."], *, saturation: Scalar | float | None = None
) -> Picture:
    """Multiply each band by its gain.

    A pixel that is saturated in all bands would take the colour of the gains, usually magenta. With
    `saturation`, values are clipped at `saturation` times the smallest gain, the brightest value
    that all bands can reach. A pixel that is saturated in all bands then becomes neutral.

    Args:
        image: (h, w) or (..., h, w, bands) linear, DN or relative.
        gains: (bands,), or (..., bands) with one set for each image of a batch; () or (1,) for
            (h, w); no unit.
        saturation: () in the image's unit, the largest value of the sensor; None clips nothing.

    Returns:
        The image's shape and unit.

    Raises:
        ValueError: for gains of another shape, and for gains below 0.

    Example:
        >>> picture, gains = jnp.array([[[0.25, 0.5, 0.5]]]), jnp.array([2.0, 1.0, 1.5])
        >>> jv.white_balance(picture, gains).ravel().tolist()
        [0.5, 0.5, 0.75]
    """
    check_range("white_balance: gains", gains, 0, finite=False, nan=True)
    if image.ndim == 2 and gains.size == 1:
        return white_balance(image[..., None], gains.reshape(1), saturation=saturation)[..., 0]
    if (
        image.ndim < 3
        or gains.shape[-1:] != image.shape[-1:]
        or gains.ndim not in (1, image.ndim - 2)
    ):
        raise ValueError(
            f"gains must be (bands,) or (..., bands) of an image of shape {image.shape}, got shape "
            f"{gains.shape}."
        )
    shape = as_relative(image).shape
    balanced = image * jnp.broadcast_to(gains[..., None, None, :], shape)
    if saturation is None:
        return balanced
    most = jnp.asarray(saturation, image.dtype) * jnp.min(gains, axis=-1)
    return jnp.minimum(balanced, jnp.broadcast_to(most[..., None, None, None], shape))


@takes_numbers
def neutral_gains(patch: Spectrum) -> Float[Array, " bands"]:
    """Return the gains that make the mean of a patch neutral, such as a grey card or a cloud.

    Args:
        patch: (..., bands) DN or relative, for instance `image[..., 10:20, 30:40, :]`. NaN is left
            out.

    Returns:
        (bands,) no unit. A band without light has the gain 1; if a band contains only NaN, all
        gains are NaN.

    Raises:
        ValueError: for an empty patch.

    Example:
        >>> card = np.full((4, 4, 3), [200.0, 400.0, 100.0])  # DN of a grey card
        >>> gains = jv.development.neutral_gains(card)
        >>> print(gains * card[0, 0])
        [400. 400. 400.]
    """
    if patch.size == 0:
        raise ValueError(f"patch must hold a pixel, got shape {patch.shape}.")
    patch = as_relative(patch)
    if patch.dtype.itemsize < 4:  # half precision is too small for the sums
        patch = patch.astype(jnp.float32)
    return _balancing(jnp.nanmean(patch, axis=tuple(range(patch.ndim - 1))))


@takes_numbers
@takes_range(norm=Range(1, finite=False, nan=True))
def grey_world_gains(
    image: Image, *, norm: Scalar | float = 1.0, saturation: Scalar | float | None = None
) -> Gains:
    """Return the gains that make each image grey on average (the grey-world assumption).

    Args:
        image: (..., h, w, bands) linear, DN or relative. Values below 0 count as 0. Pixels with NaN
            in a band are left out.
        norm: () no unit, at least 1: the p of the mean (mean x^p)^(1/p). 1 is grey world, 6 is
            shades of grey; in the limit of infinity the brightest value becomes white.
        saturation: () in the image's unit; pixels that reach it in any band are left out.

    Returns:
        (..., bands) no unit; NaN if every pixel has NaN in a band.

    Raises:
        ValueError: for a picture without pixels or of fewer than three axes, and a norm below 1.

    Source: Buchsbaum, J. Franklin Institute 310, 1980 (the grey world); Finlayson and Trezzi,
    "Shades of gray and colour constancy", CIC 2004.

    Example:
        >>> under_a_lamp = np.array([[[0.8, 0.4], [0.4, 0.2]]])  # twice as red as it is green
        >>> print(jv.development.grey_world_gains(under_a_lamp).round(3))
        [1. 2.]
    """
    image = as_relative(image)
    if image.dtype.itemsize < 4:  # half precision is too small for the sums
        image = image.astype(jnp.float32)
    if image.ndim < 3 or image.size == 0:
        raise ValueError(
            f"image must be (..., h, w, bands) with at least one pixel, got shape {image.shape}."
        )
    known = ~jnp.isnan(image).any(-1, keepdims=True)
    used = known if saturation is None else known & (image < saturation).all(-1, keepdims=True)
    used = jnp.broadcast_to(used, image.shape).astype(image.dtype)
    image = jnp.where(known, image, 0)
    norm = jnp.asarray(norm, image.dtype)
    # values are divided by the largest: their powers do not overflow, and that of the largest does
    # not vanish
    largest = jax.lax.stop_gradient(jnp.max(image * used, axis=(-3, -2)))
    scale = or_one(largest)
    raised = used * power(image / jnp.broadcast_to(scale[..., None, None, :], image.shape), norm)
    count = jnp.maximum(used.sum((-3, -2)), 1)
    means = scale * power(raised.sum((-3, -2)) / count, 1 / norm)
    return _balancing(jnp.where(known.any((-3, -2)), means, jnp.nan))


def _balancing(means: Gains) -> Gains:
    """Return the largest mean divided by each band's mean, or 1 for a band whose mean is 0. A NaN
    makes the gains of all bands NaN.
    """
    brightest = jnp.max(means, axis=-1, keepdims=True)
    share = divide(means, brightest, ~(brightest <= 0))
    return divide(1, share, ~(share <= smallest_divisor(means.dtype)), 1)
