"""Development of raw data to a picture by successive stages, and conversion to the integers of a
file."""

import jax.numpy as jnp
from jaxtyping import Array, UInt

from ..colour_spaces import apply_matrix
from ..core._arguments import takes_numbers
from ..core._types import Image, Scalars, refuse_codes
from ..filters import bilateral_filter, nonlocal_means_filter, unsharp_mask
from ..scene import (
    Bilateral,
    Denoising,
    Development,
    GreyWorld,
    NeutralPatch,
    NonLocalMeans,
    WhiteBalance,
    WhiteBalancing,
)
from .demosaicing import demosaic
from .jpeg_loss import jpeg
from .tone import encode_tone, map_tone
from .white_balancing import Gains, grey_world_gains, neutral_gains, white_balance


@takes_numbers
def develop(raw: Scalars, development: Development) -> Scalars:
    """Compute (raw - black) / (white - black), then the stages of a development in order.

    A stage clips values only if its documentation says so. Noise below black stays negative, except
    that a gamma curve sets it to 0.

    Args:
        raw: DN. A mosaic (..., h, w) or (..., h, w, 1) with demosaicing, else (..., h, w, bands);
            any shape for levels and curves alone.
        development: the stages; a stage that is None is omitted.

    Returns:
        (..., h, w, bands), or the shape of `raw`: relative values, where 1 is the white level; DN
        without a white level.

    Raises:
        ValueError: as the stages raise it.

    Example:
        >>> how = jv.Development(black_level=64.0, white_level=1088.0)
        >>> jv.develop(jnp.array([64.0, 576.0, 1088.0]), how).tolist()
        [0.0, 0.5, 1.0]
    """
    picture = _scale_to_white(raw, development)
    if development.demosaicing is not None:
        how = development.demosaicing
        mosaic = picture[..., 0] if picture.shape[-1] == 1 else picture
        picture = demosaic(mosaic, how.pattern, method=how.method)
    if development.white_balance is not None:
        gains = _gains(picture, development.white_balance, development.saturation)
        picture = white_balance(picture, gains, saturation=development.saturation)
    if development.denoising is not None:
        picture = _denoise(picture, development.denoising)
    if development.colour_matrix is not None:
        picture = apply_matrix(picture, development.colour_matrix)
    if development.tone_map is not None:
        picture = map_tone(picture, development.tone_map)
    if development.tone is not None:
        picture = encode_tone(picture, development.tone)
    if development.sharpening is not None:
        how = development.sharpening
        picture = unsharp_mask(picture, how.sigma, how.amount, size=how.size)
    if development.compression is not None:
        how = development.compression
        picture = jpeg(picture, how.quality, subsampling=how.subsampling, rounding=how.rounding)
    return picture


@takes_numbers
def to_integers(picture: Scalars, *, bits: int = 8) -> UInt[Array, "..."]:
    """Convert relative values x to the codes of an integer file: round((2^bits - 1) x), with x
    clipped to [0, 1].

    Args:
        picture: (...) relative; NaN becomes 0.
        bits: 8 or 16.

    Returns:
        (...) codes, uint8 or uint16.

    Raises:
        ValueError: for other bits, and for numbers that are codes already.

    Example:
        >>> print(jv.to_integers(jnp.array([-0.1, 0.5, 2.0])))
        [  0 128 255]
    """
    dtypes = {8: jnp.uint8, 16: jnp.uint16}
    if bits not in dtypes:
        raise ValueError(f"bits must be 8 or 16, got {bits}.")
    refuse_codes(picture)
    if picture.dtype.itemsize < 4:  # half precision is too small for the codes
        picture = picture.astype(jnp.float32)
    clipped = jnp.clip(jnp.where(jnp.isnan(picture), 0, picture), 0, 1)
    return jnp.round(clipped * (2**bits - 1)).astype(dtypes[bits])


def _scale_to_white(raw: Scalars, development: Development) -> Scalars:
    picture, span = raw, development.white_level
    if development.black_level is not None:
        picture = picture - development.black_level
        span = None if span is None else span - development.black_level
    return picture if span is None else picture / span


def _gains(picture: Image, balance: WhiteBalancing, saturation: Scalars | None) -> Gains:
    match balance:
        case WhiteBalance(gains=gains):
            return gains
        case GreyWorld(norm=norm):
            return grey_world_gains(picture, norm=norm, saturation=saturation)
        case NeutralPatch(rows=(top, bottom), columns=(left, right)):
            height, width = picture.shape[-3:-1]
            if bottom > height or right > width:
                raise ValueError(
                    f"NeutralPatch must end by row {height} and column {width} of the picture, got "
                    f"{bottom} and {right}."
                )
            return neutral_gains(picture[..., top:bottom, left:right, :])


def _denoise(picture: Image, denoising: Denoising) -> Image:
    match denoising:
        case Bilateral(sigma_space=space, sigma_range=over_values, radius=radius):
            return bilateral_filter(picture, space, over_values, radius=radius)
        case NonLocalMeans(strength=strength, noise=noise, patch=patch, radius=radius):
            return nonlocal_means_filter(picture, strength, noise=noise, patch=patch, radius=radius)
