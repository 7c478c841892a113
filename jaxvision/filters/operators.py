"""What can be asked of any linear filter, given as a function from pictures to pictures of the same
shape, in any unit."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..padding import Filtered


def impulse_response(
    height: Float[Array, ""], *, operator: Callable[[Filtered], Filtered], shape: tuple[int, ...]
) -> Filtered:
    """What `operator` makes of a picture of that shape, (h, w) or (..., h, w, bands), which is
    `height` in the middle pixel (h // 2, w // 2) of every plane and 0 elsewhere, in any unit.

    Of `convolve` it is the kernel, of `correlate` the kernel turned by half a turn.
    """
    rows, columns = shape if len(shape) == 2 else shape[-3:-1]
    plane = jnp.zeros((rows, columns), height.dtype).at[rows // 2, columns // 2].set(height)
    return operator(jnp.broadcast_to(plane if len(shape) == 2 else plane[..., None], shape))


def adjoint(picture: Filtered, *, operator: Callable[[Filtered], Filtered]) -> Filtered:
    """H' g for g = `picture`, in its unit: the transpose of a filter that is linear and keeps the
    shape, any border but "constant". <operator(f), g> = <f, adjoint(g)>."""
    (transposed,) = jax.linear_transpose(
        operator, jax.ShapeDtypeStruct(picture.shape, picture.dtype)
    )(picture)
    return transposed
