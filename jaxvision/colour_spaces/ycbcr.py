"""Conversions between encoded R'G'B' and Y'CbCr, its luma and colour differences; all relative."""

import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers
from ..core._types import check_choice, check_count, refuse_codes
from ._components import Colours, check_colours, times_matrix
from .colour_data import luma_weights


@takes_numbers
def rgb_to_ycbcr(
    rgb: Colours, *, standard: str = "ITU-R BT.709", levels: str = "full", bits: int = 8
) -> Colours:
    """Convert encoded R'G'B' to the luma Y' and the colour differences Cb and Cr.

    Args:
        rgb: (..., 3) encoded, relative.
        standard: "ITU-R BT.601", "ITU-R BT.709" or "ITU-R BT.2020" (non-constant luminance).
        levels: "full" gives Y' in [0, 1] and Cb, Cr in [-0.5, 0.5]. "legal" gives the studio codes
            over the largest code: at 8 bits Y' in [16, 235] / 255 and Cb, Cr in [16, 240] / 255.
        bits: of the studio codes, at least 8.

    Returns:
        (..., 3) relative.

    Raises:
        ValueError: for other levels, fewer than 8 bits, a last axis other than 3, and codes such as
            0 to 255 in place of relative values.
    """
    refuse_codes(rgb)
    matrix, _, zero = _ycbcr(standard, levels, bits)
    centred = times_matrix(rgb, matrix)
    return centred + jnp.broadcast_to(jnp.asarray(zero, centred.dtype), centred.shape)


@takes_numbers
def ycbcr_to_rgb(
    ycbcr: Colours, *, standard: str = "ITU-R BT.709", levels: str = "full", bits: int = 8
) -> Colours:
    """The inverse of `rgb_to_ycbcr`.

    Args:
        ycbcr: (..., 3) relative.
        standard: as for `rgb_to_ycbcr`.
        levels: "full" or "legal".
        bits: of the studio codes, at least 8.

    Returns:
        (..., 3) encoded R'G'B', relative.

    Raises:
        ValueError: for other levels, fewer than 8 bits, a last axis other than 3, and codes such as
            0 to 255 in place of relative values.
    """
    _, inverse, zero = _ycbcr(standard, levels, bits)
    refuse_codes(ycbcr := check_colours(ycbcr))
    centred = ycbcr - jnp.broadcast_to(jnp.asarray(zero, ycbcr.dtype), ycbcr.shape)
    return times_matrix(centred, inverse)


def _ycbcr(standard: str, levels: str, bits: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the matrix from R'G'B' to Y'CbCr, its inverse, and the offset added after the
    matrix.
    """
    check_choice("levels", levels, ("full", "legal"))
    check_count("bits", bits, 8)
    luma = np.asarray(luma_weights(standard))
    red, _, blue = np.eye(3)
    of_blue, of_red = 2 - 2 * luma[2], 2 - 2 * luma[0]
    matrix = np.stack([luma, (blue - luma) / of_blue, (red - luma) / of_red])
    # in closed form: the rounding error of a solver, in place of a 0, would dominate a dark primary
    green = -np.array([of_blue * luma[2], of_red * luma[0]]) / luma[1]
    inverse = np.array([[1, 0, of_red], [1, *green], [1, of_blue, 0]])
    if levels == "full":
        return matrix, inverse, np.zeros(3)
    step = 2 ** (bits - 8) / (2**bits - 1)
    scale = np.array([219, 224, 224]) * step
    return scale[:, None] * matrix, inverse / scale, np.array([16, 128, 128]) * step
