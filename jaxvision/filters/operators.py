"""Impulse response and transpose of any linear filter, given as a function from pictures to
pictures of the same shape, in any unit."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._types import as_float, check_shape, is_known
from .padding import Filtered


def impulse_response(
    height: Float[Array, ""] | float,
    *,
    operator: Callable[[Filtered], Filtered],
    shape: tuple[int, ...],
) -> Filtered:
    """Return the response of a filter to one bright pixel in every plane.

    For `convolve` it is the kernel, and for `correlate` the kernel rotated by 180 degrees.

    Args:
        height: () value of the middle pixel (h // 2, w // 2), any unit; all others are 0.
        operator: the filter.
        shape: (h, w) or (..., h, w, bands) of the picture, or (n,) of a signal.

    Returns:
        The result of the filter, of the given shape.
    """
    height = as_float(height)
    check_shape("height", height, ())
    if len(shape) == 1:
        return operator(jnp.zeros(shape, height.dtype).at[shape[0] // 2].set(height))
    rows, columns = shape if len(shape) == 2 else shape[-3:-1]
    plane = jnp.zeros((rows, columns), height.dtype).at[rows // 2, columns // 2].set(height)
    return operator(jnp.broadcast_to(plane if len(shape) == 2 else plane[..., None], shape))


@takes_numbers
def adjoint(picture: Filtered, *, operator: Callable[[Filtered], Filtered]) -> Filtered:
    """Apply the transpose of a linear filter: <operator(f), g> = <f, adjoint(g)>.

    Args:
        picture: g, of the shape that the filter returns, any unit.
        operator: the linear filter.

    Returns:
        H' g, of the same shape and unit.

    Raises:
        ValueError: for a filter with an offset, such as border "constant" with a fill. The check
            applies the filter to a picture of 0, and is skipped where `picture` is traced.
    """
    if is_known(picture):
        _check_no_offset(operator, picture.shape, picture.dtype)
    (transposed,) = jax.linear_transpose(
        operator, jax.ShapeDtypeStruct(picture.shape, picture.dtype)
    )(picture)
    return transposed


def _check_no_offset(
    operator: Callable[[Filtered], Filtered], shape: tuple[int, ...], dtype: DTypeLike
) -> None:
    with jax.ensure_compile_time_eval():
        most = jnp.abs(operator(jnp.zeros(shape, dtype))).max()
    if is_known(most) and float(most) != 0:
        raise ValueError(
            "only a linear filter has a transpose, got one that makes up to "
            f'{float(most):.3g} of a picture of 0: take border "zero" or '
            "fill=0."
        )
