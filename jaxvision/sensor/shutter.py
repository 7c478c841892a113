"""The exposure interval of each row, and the average of a moving scene over it.

Times are in s; weights have no unit. The time from the start of the first row's exposure to the end
of the last row's exposure is divided into equal slots. The scene is evaluated in the middle of each
slot. The weight of a slot for a row is the part of the slot within the row's exposure. If this is
not the whole slot, the scene in the middle of the part is interpolated linearly between the middles
of two slots. A linear change of the scene is therefore averaged exactly for every row. If a slot is
at least as long as an exposure, the slots begin earlier and end later: the first and the last slot
are then centred on the exposure of the first and the last row. A global shutter exposes all rows
from time 0 on.
"""

from collections.abc import Callable
from functools import reduce
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide
from ..core._types import Scalar, check_count, is_known
from ..core.parallel_loops import scan
from ..scene import RollingShutter

Pictures = TypeVar("Pictures")


@takes_numbers
def row_starts(
    shutter: RollingShutter | None, exposure_time: Scalar, *, rows: int
) -> Float[Array, " rows"]:
    """Return the time at which the exposure of each row begins.

    Args:
        shutter: the rolling shutter; None for a global shutter, which opens every row at 0.
        exposure_time: () s.
        rows: number of rows, static.

    Returns:
        (rows,) s.

    Example:
        >>> print(1000 * jv.sensor.row_starts(jv.RollingShutter(0.001), 0.01, rows=3))  # ms
        [0. 1. 2.]
    """
    if shutter is None:
        return jnp.zeros(rows, exposure_time.dtype)
    return jnp.arange(rows, dtype=exposure_time.dtype) * shutter.line_time


@takes_numbers
def exposure_slots(
    shutter: RollingShutter | None, exposure_time: Scalar, *, rows: int, slots: int
) -> tuple[Float[Array, " slots"], Float[Array, "rows slots"]]:
    """Return the time slots of an exposure, and the weight of each slot in the average of each row.

    Args:
        shutter: the rolling shutter; None for a global shutter.
        exposure_time: () s.
        rows: number of rows, static.
        slots: number of slots, static, at least 1.

    Returns:
        Middle of each slot (slots,) in s, and weights (rows, slots), >= 0, whose sum is 1 for each
        row. The weights are smooth functions of the times, except where the beginning, the middle
        or the end of a row's exposure is at the border of two slots.

    Raises:
        ValueError: `slots` is less than 1.

    Example:
        >>> shutter = jv.RollingShutter(0.001)  # s from row to row
        >>> times, weights = jv.sensor.exposure_slots(shutter, 0.002, rows=3, slots=4)
        >>> print(np.asarray(1000 * times), weights[0])  # ms
        [0.5 1.5 2.5 3.5] [0.5 0.5 0.  0. ]
    """
    check_count("slots", slots, 1)
    starts = row_starts(shutter, exposure_time, rows=rows)
    whole = starts[-1] + exposure_time
    length = whole / slots
    if slots > 1:
        length = jnp.maximum(length, starts[-1] / (slots - 1))
    edges = whole / 2 + length * (jnp.arange(slots + 1, dtype=starts.dtype) - slots / 2)
    times = (edges[:-1] + edges[1:]) / 2
    begin, end = starts[:, None], starts[:, None] + exposure_time
    open_until = jnp.clip(jnp.broadcast_to(edges, (rows, slots + 1)), begin, end)
    covered = jnp.diff(open_until)
    late = (open_until[:, :-1] + open_until[:, 1:]) / 2 - times[None]  # of its middle
    share = divide(covered * late, length, ~(length <= 0))
    moved = jnp.maximum(share[:, :-1], 0) - jnp.maximum(-share[:, 1:], 0)  # to the next slot
    covered = covered - jnp.pad(moved, ((0, 0), (0, 1))) + jnp.pad(moved, ((0, 0), (1, 0)))
    return times, divide(covered, exposure_time, ~(exposure_time <= 0))


@takes_numbers
def exposed(
    shutter: RollingShutter | None,
    exposure_time: Scalar,
    picture_at: Callable[[Scalar], Pictures],
    *,
    rows: int,
    slots: int,
) -> Pictures:
    """Average a picture over the exposure of each row.

    Args:
        shutter: the rolling shutter; None for a global shutter.
        exposure_time: () s.
        picture_at: function from a time () in s to the picture (rows, w, bands) in any unit, or to
            a record of several such pictures. The function is called once for each slot without
            compilation; wrap it in `jax.jit` if this is slow.
        rows: number of rows, static.
        slots: number of times at which the picture is evaluated, static; for a smooth motion the
            error is inversely proportional to the square of this number.

    Returns:
        What `picture_at` returns, averaged over time, in its unit.

    Raises:
        ValueError: `slots` is less than 1.

    Example:
        The scene grows brighter by 1 each second, and each row is exposed for 2 s.

        >>> shutter = jv.RollingShutter(line_time=2.0)
        >>> growing = lambda t: t * jnp.ones((2, 1, 1))
        >>> seen = jv.exposed(shutter, jnp.array(2.0), growing, rows=2, slots=2)
        >>> [round(float(x), 4) for x in seen.ravel()]  # means over 0 to 2 s, and 2 to 4 s
        [1.0, 3.0]
    """
    times, weights = exposure_slots(shutter, exposure_time, rows=rows, slots=slots)

    def add(total, slot):
        time, weight = slot
        seen = picture_at(time)
        return jax.tree.map(lambda t, x: t + weight[:, None, None] * x, total, seen), None

    start = jax.tree.map(
        lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(picture_at, times[0])
    )
    if is_known(times):  # a scan outside of `jit` would compile the caller's function in each call
        return reduce(
            lambda total, slot: add(total, slot)[0], zip(times, weights.T, strict=True), start
        )
    return scan(add, start, (times, weights.T))[0]
