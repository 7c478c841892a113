"""Charge on its way through a CCD: overfull wells, and what transfers leave behind. In electrons.

The read-out lies before row 0 (and the serial register's before column 0), so the packet of row i
is transferred i + 1 times.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics import safe_sqrt
from .._types import Key, Scalar
from ..scene import ChargeTransfer
from ._draws import Frame, check_image, gaussian
from .exposure import Counts


def bloomed(electrons: Counts, full_well: Scalar, blooming: Scalar) -> Counts:
    """(..., h, w, bands) electrons after overfull wells spilled along their columns.

    Of what exceeds `full_well` the share `blooming` leaves, half of it up and half down, and so at
    each full well on its way, until it finds room or the end of its column, where it is drained.
    What goes down goes first. With `blooming` of 1 electrons are lost at the ends of columns alone.
    """
    check_image("Sensor.blooming", electrons.shape)
    excess = jnp.maximum(electrons - full_well, 0)
    half = blooming * excess / 2
    level = electrons - excess
    for upwards in (False, True):
        level = _flow(level, half, full_well, blooming, upwards=upwards)
    return level


@partial(jax.jit, static_argnames="upwards")
def _flow(
    level: Counts, spilt: Counts, full_well: Scalar, blooming: Scalar, *, upwards: bool
) -> Counts:
    """Each row takes what comes from the row before, up to a full well, and passes on the rest and
    what it spilt itself."""

    def row(coming, state):
        level, spilt = state
        over = jnp.maximum(level + coming - full_well, 0)
        return blooming * over + spilt, level + coming - over

    rows = jnp.moveaxis(level, -3, 0), jnp.moveaxis(spilt, -3, 0)
    _, filled = jax.lax.scan(row, jnp.zeros_like(rows[0][0]), rows, reverse=upwards)
    return jnp.moveaxis(filled, 0, -3)


def transferred(electrons: Counts, transfer: ChargeTransfer) -> Counts:
    """(..., h, w, bands) electrons as they are read, along the columns and then along the register.

    Each transfer leaves the share eps of a packet to the next one, so of the packet of row i

        C(j, i) (1 - eps)^(i + 1) eps^(j - i)

    is read in row j >= i, in expectation. Packets are followed over `trail` rows, in the last of
    which all is read that falls that far behind or further: nothing is lost but behind the last
    row. That is nearly a Poisson variable of mean eps i: of 0.3 rows the share beyond 8 is 4e-11,
    of 3 rows 4e-3, and a longer trail is due.
    """
    rows_read = _trailing(electrons, transfer.inefficiency, transfer.trail, axis=-3)
    if transfer.serial_inefficiency is None:
        return rows_read
    return _trailing(rows_read, transfer.serial_inefficiency, transfer.trail, axis=-2)


def transfer_noise(key: Key | None, electrons: Counts, transfer: ChargeTransfer) -> Counts:
    """What chance adds to `transferred` of (..., h, w, bands) whole electrons, each left behind or
    not by itself: Gaussian, of variance sum n p (1 - p) over the packets n and their shares p. As
    for Gaussian shot noise, a row that expects few electrons can go below 0."""
    variance = transferred(electrons, transfer) - transferred_variance(electrons, transfer)
    draw = gaussian(key, Frame.TRANSFER, electrons.shape, electrons.dtype)
    return safe_sqrt(variance) * draw


def counted_variance(mean: Counts, variance: Counts, transfer: ChargeTransfer) -> Counts:
    """The variance of electrons, (..., h, w, bands), that were moved one by one, from the mean and
    variance of their packets: sum n p (1 - p) + var p^2, so that of Poisson packets it is the mean
    that is read. In electrons and electrons^2."""
    return transferred(mean, transfer) + transferred_variance(variance - mean, transfer)


def transferred_variance(variance: Counts, transfer: ChargeTransfer) -> Counts:
    """The variance of `transferred` electrons whose own, (..., h, w, bands) in electrons^2, is
    independent from pixel to pixel, where they are moved in fixed shares."""
    read = _trailing(variance, transfer.inefficiency, transfer.trail, axis=-3, power=2)
    if transfer.serial_inefficiency is None:
        return read
    return _trailing(read, transfer.serial_inefficiency, transfer.trail, axis=-2, power=2)


def _trailing(
    electrons: Counts, inefficiency: Scalar, trail: int, *, axis: int, power: int = 1
) -> Counts:
    check_image("Sensor.charge_transfer", electrons.shape)
    size = electrons.shape[axis]
    packets = jnp.moveaxis(electrons, axis, 0)
    read = jnp.zeros_like(packets)
    for behind, share in enumerate(_shares(inefficiency, size, trail, electrons)[:size]):
        part = packets * (share**power).reshape(-1, *(1,) * (packets.ndim - 1))
        read = read + jnp.concatenate([jnp.zeros_like(part[:behind]), part[: size - behind]])
    return jnp.moveaxis(read, 0, axis)


def _shares(
    inefficiency: Scalar, size: int, trail: int, like: Counts
) -> list[Float[Array, " size"]]:
    """For each number k of rows behind, the share of the packet of row i that is read there, by
    recursion: C(i + k, k) / C(i + k - 1, k - 1) = (i + k) / k. The last is all the rest, and as
    such at least its own share, which keeps its digits where the difference from 1 has none."""
    row = jnp.arange(size, dtype=like.dtype)
    shares = [jnp.exp((row + 1) * jnp.log1p(-inefficiency))]
    for behind in range(1, trail + 1):
        shares.append(shares[-1] * inefficiency * ((row + behind) / behind))
    return [*shares[:-1], jnp.maximum(shares[-1], 1 - sum(shares[:-1]))]
