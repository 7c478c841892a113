"""When each row sees the scene, and what it sees averaged over that time. Times in s;
weights have no unit.

The time from the first row's opening to the last row's closing is cut into equal slots; the scene
is taken as it is in the middle of each slot, and a row averages the slots by how much of them lies
in its own exposure. A global shutter opens all rows at 0.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._types import Scalar
from ..scene import RollingShutter

Pictures = TypeVar("Pictures")


def row_starts(
    shutter: RollingShutter | None, exposure_time: Scalar, *, rows: int
) -> Float[Array, " rows"]:
    """The time (rows,) s at which each row's exposure begins."""
    if shutter is None:
        return jnp.zeros(rows, exposure_time.dtype)
    return jnp.arange(rows, dtype=exposure_time.dtype) * shutter.line_time


def exposure_slots(
    shutter: RollingShutter | None, exposure_time: Scalar, *, rows: int, slots: int
) -> tuple[Float[Array, " slots"], Float[Array, "rows slots"]]:
    """(middle of each slot (slots,) s, weight (rows, slots) of each slot in each row's average).

    The weights of a row add up to 1, and are smooth in the times but where a row's exposure begins
    or ends with a slot. `ValueError` unless slots >= 1.
    """
    if slots < 1:
        raise ValueError(f"slots must be at least 1, got {slots}.")
    starts = row_starts(shutter, exposure_time, rows=rows)
    edges = (starts[-1] + exposure_time) * jnp.linspace(0, 1, slots + 1, dtype=starts.dtype)
    begin, end = starts[:, None], starts[:, None] + exposure_time
    open_until = jnp.clip(jnp.broadcast_to(edges, (rows, slots + 1)), begin, end)
    exposed = exposure_time > 0
    weights = jnp.diff(open_until) / jnp.where(exposed, exposure_time, 1)
    return (edges[:-1] + edges[1:]) / 2, weights


def exposed(
    shutter: RollingShutter | None,
    exposure_time: Scalar,
    picture_at: Callable[[Scalar], Pictures],
    *,
    rows: int,
    slots: int,
) -> Pictures:
    """A picture (rows, w, bands), or a record of several, averaged over each row's exposure, in its
    own unit.

    `picture_at`: what is seen at a time () s. `slots`: how many times it is asked; the error of a
    smooth motion falls with their square.
    """
    times, weights = exposure_slots(shutter, exposure_time, rows=rows, slots=slots)

    def add(total, slot):
        time, weight = slot
        seen = picture_at(time)
        return jax.tree.map(lambda t, x: t + weight[:, None, None] * x, total, seen), None

    start = jax.tree.map(
        lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(picture_at, times[0])
    )
    return jax.lax.scan(add, start, (times, weights.T))[0]
