"""Charge in a CCD: blooming of full wells, and imperfect charge transfer.

All quantities are in electrons. The serial register is next to row 0, and its output next to column
0. The charge packet of row i is therefore transferred i + 1 times along its column.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import log1p, safe_sqrt
from ..core._types import Key, Scalar
from ..core.parallel_loops import scan
from ..scene import ChargeTransfer
from ._draws import Frame, check_image, gaussian
from .exposure import Counts

Shares = Float[Array, " size"]  # one share for the packet of each row, no unit


@takes_numbers
def bloomed(electrons: Counts, full_well: Scalar, blooming: Scalar) -> Counts:
    """Return the electrons after the charge above the full well has spilled along columns
    (blooming).

    The share `blooming` of the charge above `full_well` spills, half up and half down the column.
    Each full well that the charge reaches passes on the same share. The charge moves until it
    reaches a well with room, or is drained at the end of the column. Charge that moves down is
    placed first. With `blooming` = 1, electrons are lost only at the ends of columns.

    Args:
        electrons: (..., h, w, bands) electrons.
        full_well: () electrons that a pixel holds.
        blooming: () share of the excess that spills, in [0, 1], no unit.

    Returns:
        (..., h, w, bands) electrons, at most `full_well`.

    Raises:
        ValueError: `electrons` is not an image.

    Example:
        >>> column = jnp.array([0.0, 0.0, 300.0, 0.0, 0.0]).reshape(5, 1, 1)
        >>> spilled = jv.sensor.bloomed(column, jnp.array(100.0), jnp.array(1.0))
        >>> spilled.ravel().tolist()
        [0.0, 100.0, 100.0, 100.0, 0.0]
    """
    check_image("Sensor.blooming", electrons.shape)
    excess = jnp.maximum(electrons - full_well, 0)
    half = blooming * excess / 2
    level = jnp.minimum(electrons, full_well)
    for upwards in (False, True):
        level = _flow(level, half, full_well, blooming, upwards=upwards)
    return level


@partial(jax.jit, static_argnames="upwards")
def _flow(
    level: Counts, spilt: Counts, full_well: Scalar, blooming: Scalar, *, upwards: bool
) -> Counts:
    """Add to each row the charge that flows from the previous row, up to the full well. The share
    `blooming` of the excess, and the charge that the row itself spills, flow on to the next row.
    """

    def row(coming, state):
        level, spilt = state
        filled = level + coming
        over = jnp.maximum(filled - full_well, 0)
        return blooming * over + spilt, jnp.minimum(filled, full_well)

    rows = jnp.moveaxis(level, -3, 0), jnp.moveaxis(spilt, -3, 0)
    _, filled = scan(row, jnp.zeros_like(rows[0][0]), rows, reverse=upwards)
    return jnp.moveaxis(filled, 0, -3)


@takes_numbers
def transferred(electrons: Counts, transfer: ChargeTransfer) -> Counts:
    """Return the electrons that are read after imperfect transfers along columns and the serial
    register.

    Each transfer leaves the share eps of a packet behind, in the next packet. The expected share of
    row i's packet that is read in row j >= i is

        C(j, i) (1 - eps)^(i + 1) eps^(j - i)

    The lagging charge of a packet is computed for the `trail` rows behind it. The last of these
    rows receives all charge that lags farther, so charge is lost only beyond the last row of the
    image. The lag is approximately a Poisson variable with mean eps i. If the mean lag is 0.3 rows,
    the share that lags more than 8 rows is 4e-11. If the mean lag is 3 rows, this share is 4e-3,
    and a longer trail is needed.

    Args:
        electrons: (..., h, w, bands) electrons per packet.
        transfer: the inefficiencies and the length of the trail.

    Returns:
        (..., h, w, bands) electrons.

    Raises:
        ValueError: `electrons` is not an image.

    Example:
        >>> column = np.zeros((4, 1, 1))
        >>> column[1] = 1000.0  # electrons, which are shifted twice
        >>> read = jv.sensor.transferred(column, jv.ChargeTransfer(0.01))
        >>> print([round(float(x), 1) for x in read.ravel()])
        [0.0, 980.1, 19.6, 0.3]
    """
    rows_read = _trailing(electrons, transfer.inefficiency, transfer.trail, axis=-3, weight=_share)
    if transfer.serial_inefficiency is None:
        return rows_read
    return _trailing(
        rows_read, transfer.serial_inefficiency, transfer.trail, axis=-2, weight=_share
    )


@takes_numbers
def transfer_noise(key: Key | None, electrons: Counts, transfer: ChargeTransfer) -> Counts:
    """Draw the noise of charge transfer, in electrons: the deviation of the transferred charge from
    its expectation. The noise is Gaussian with the variance sum n p (1 - p) over packets of n
    electrons, of which the share p is expected in this pixel. The gradient of the mean square of
    the noise is unbiased if packets are not empty."""
    draw = gaussian(key, Frame.TRANSFER, electrons.shape, electrons.dtype)
    return safe_sqrt(_random_variance(electrons, transfer)) * draw


def _random_variance(electrons: Counts, transfer: ChargeTransfer) -> Counts:
    """Return the variance of the noise of charge transfer, sum n p (1 - p), as a sum of positive
    terms. If the serial register transfers the share s, p is replaced by p s, and a term is written
    as n (p s (1 - s) + p (1 - p) s^2)."""
    eps, serial, trail = transfer.inefficiency, transfer.serial_inefficiency, transfer.trail
    of_rows = _trailing(electrons, eps, trail, axis=-3, weight=_random)
    if serial is None:
        return of_rows
    rows_read = _trailing(electrons, eps, trail, axis=-3, weight=_share)
    of_register = _trailing(rows_read, serial, trail, axis=-2, weight=_random)
    return of_register + _trailing(of_rows, serial, trail, axis=-2, weight=_square)


def _share(share: Shares, rest: Shares) -> Shares:
    return share


def _square(share: Shares, rest: Shares) -> Shares:
    return share * share


def _random(share: Shares, rest: Shares) -> Shares:
    return share * rest


@takes_numbers
def counted_variance(mean: Counts, variance: Counts, transfer: ChargeTransfer) -> Counts:
    """Return the variance, electrons^2, of charge whose electrons are transferred independently.
    The variance is the sum of n p (1 - p) + var p^2 over packets with mean n and variance var, of
    which the share p is expected in this pixel."""
    return _random_variance(mean, transfer) + transferred_variance(variance, transfer)


@takes_numbers
def transferred_variance(variance: Counts, transfer: ChargeTransfer) -> Counts:
    """Return the variance of transferred charge, electrons^2, if each packet is divided in fixed
    proportions."""
    read = _trailing(variance, transfer.inefficiency, transfer.trail, axis=-3, weight=_square)
    if transfer.serial_inefficiency is None:
        return read
    return _trailing(read, transfer.serial_inefficiency, transfer.trail, axis=-2, weight=_square)


def _trailing(
    electrons: Counts,
    inefficiency: Scalar,
    trail: int,
    *,
    axis: int,
    weight: Callable[[Shares, Shares], Shares],
) -> Counts:
    check_image("Sensor.charge_transfer", electrons.shape)
    size = electrons.shape[axis]
    packets = jnp.moveaxis(electrons, axis, 0)
    read = jnp.zeros_like(packets)
    for behind, both in enumerate(_shares(inefficiency, size, trail, electrons)[:size]):
        part = packets * weight(*both).reshape(-1, *(1,) * (packets.ndim - 1))
        read = read + jnp.concatenate([jnp.zeros_like(part[:behind]), part[: size - behind]])
    return jnp.moveaxis(read, 0, axis)


def _shares(
    inefficiency: Scalar, size: int, trail: int, like: Counts
) -> list[tuple[Shares, Shares]]:
    """Return, for each lag k, the share of the packet of row i that is read k rows later, and 1
    minus this share. Binomial coefficients are computed by C(i + k, k) / C(i + k - 1, k - 1) = (i +
    k) / k. The last lag receives the remainder, but at least its own share, because the remainder
    is a difference of nearly equal numbers."""
    row = jnp.arange(size, dtype=like.dtype)
    kept = (row + 1) * log1p(-inefficiency)
    shares = [jnp.exp(kept)]
    for behind in range(1, trail + 1):
        shares.append(shares[-1] * inefficiency * ((row + behind) / behind))
    fallen = -jnp.expm1(kept)
    behind = [*shares[1:-1], jnp.maximum(shares[-1], fallen - sum(shares[1:-1]))]
    return [(shares[0], fallen), *((share, 1 - share) for share in behind)]
