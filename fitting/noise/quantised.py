"""Exact moments of a quantised, clipped Poisson-Gaussian signal.

A pixel with the gain K and read noise sigma_d has the number K (n + sigma_d z) + offset, where n ~
Poisson(mu) and z is a standard normal number. This number is then rounded to a whole code and
clipped at zero. The characteristic function of the number before rounding is a product,

    phi(u) = exp(i u offset - (K sigma_d u)^2 / 2 + mu (exp(i u K) - 1)),

and the probability of code c, the integral over c - 1/2 .. c + 1/2, is its Fourier sum over a
window of M codes that contains the whole signal:

    P(c) = 1/M sum_k phi(2 pi k / M) sinc(k / M) exp(-2 pi i k c / M).

If the sum over codes is done first, the moment of order p about a reference code r is a weighted
sum of phi over the frequencies. The weights w_p depend on the clipping but not on the parameters,
and z is now the rounded, clipped code:

    E[(z - r)^p] = sum_k phi(2 pi k / M) w_p(k),
    w_p(k) = 1/M sinc(k / M) sum_c (max(c, 0) - r)^p exp(-2 pi i k c / M).

No sum over electrons is needed, so the cost does not grow with the light.

The offsets of pixels lie at different positions between two codes. If the offsets are Normal with
standard deviation s, the moments of a pixel at offset + d are averaged over d ~ N(0, s^2). The
average is a trapezoidal sum over J nodes, which converges exponentially for such smooth functions.
The temporal variance of each pixel, given its offset, is averaged in this way. The variance of the
pixels' means over the offsets is the DSNU after rounding. The n pixels of a sensor are a sample of
the distribution of offsets. The fit estimates the mean and the spread of the offsets in this
sample. Averages over the sample of a pixel's mean, variance and squared deviation still differ
between sensors with equal mean and spread. The parts of these quantities that are neither linear
nor quadratic in d cause this difference.

The usual mean and variance, with a variance of 1/12 for rounding, are wrong for small read noise
and for clipped black. The module `window` tests whether this error is significant.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from jaxvision.errors import InputError

REACHED = 6.0  # standard deviations of the offsets on either side
WIDEST = 1.0  # codes, spread of offsets above which all positions on the grid are equally likely
WIDEST_CLIPPED = 3.0  # the same limit if black is clipped, which is not periodic
SPREAD = 8.0  # standard deviations on either side that a window covers
DECAY = 6.5  # phi is negligible where K sigma_d u exceeds this
PADDED = 4  # the number of levels of a window is padded to a multiple by repeating the last
FINER = 2  # sizes of the frequency sum per octave: few, because each is compiled separately
FINEST_READ_NOISE = 0.1  # DN; below, phi hardly decays and the data hardly determine it
ORDERS = (1, 2, 3, 4)
LARGEST = 2**27  # largest transform, in numbers: 2 GB


class Window(eqx.Module):
    """The weights w_p(k) for the exact moments of some levels."""

    # an integer code near each mean; phases and moments are relative to it
    centre: Float[Array, " levels"]
    # real part of w_p(k), for p = 1 .. 4 and k = 0, 1 ...; conjugate frequencies are folded in
    cosine: Float[Array, "levels orders frequencies"]
    sine: Float[Array, "levels orders frequencies"]  # the imaginary part
    levels: Int[Array, " levels"]  # their indices; one may occur more than once
    # variance of the pixels' offsets in addition to the fitted one, codes^2
    known_spread: Float[Array, " levels"]
    # (levels, J) values d / s of the offsets; None where all pixels are alike
    nodes: Float[Array, "levels nodes"] | None = None
    size: int = eqx.field(static=True, default=0)  # M
    widest: float = eqx.field(static=True, default=WIDEST)  # largest s


class Moments(NamedTuple):
    """The first four cumulants of a pixel's number, averaged over the pixels, in powers of codes or
    of DN."""

    mean: Array
    variance: Array  # of a pixel over the frames
    third: Array
    fourth: Array
    spatial: Array | None = None  # variance of the pixels' means; None where all pixels are alike
    # variance of the pixels' variances; None where all pixels are alike
    uneven: Array | None = None
    # (3, 3) covariance over the pixels of mean, variance and squared deviation of the mean, beyond
    # what is linear or quadratic in the offset; None where all pixels are alike
    die: Array | None = None


def window_for(
    levels: Sequence[int] | Int[np.ndarray, " levels"],
    mean: Float[np.ndarray, " levels"],
    *,
    deviation: float,
    read_noise: float,
    spread: float = 0.0,
    known_spread: Float[np.ndarray, " levels"] | None = None,
    widest: float = WIDEST,
) -> Window:
    """Compute the weights w_p(k) for levels whose means are known approximately."""
    again = np.pad(np.arange(len(levels)), (0, -len(levels) % PADDED), mode="edge")
    levels, mean = np.asarray(levels)[again], mean[again]
    known_spread = np.zeros(len(levels)) if known_spread is None else known_spread[again]
    reached = min(1.5 * np.hypot(spread, np.sqrt(known_spread.max())), widest)
    size = 2 ** int(np.ceil(np.log2(2 * SPREAD * max(np.hypot(deviation, reached), 0.5) + 2)))
    finest = max(read_noise / 2, FINEST_READ_NOISE)
    octaves = np.log2(size * DECAY / (2 * np.pi * finest))
    frequencies = int(2 ** (np.ceil(FINER * octaves) / FINER)) + 1
    if frequencies * size > LARGEST:
        raise InputError(
            f"a level near black scatters by {deviation:.3g} DN rms where the darks scatter by "
            f"{read_noise:.3g} DN; no camera does, so check the variances (DN^2)."
        )
    k = np.arange(frequencies)
    centre = np.round(mean)
    away = np.arange(size) - size // 2
    read = np.maximum(centre[:, None] + away, 0) - centre[:, None]
    turns = np.exp(-2j * np.pi * (np.outer(k, away) % size) / size)
    powers = np.stack([read**order for order in ORDERS], axis=1)
    folded = np.where(k > 0, 2, 1) * np.sinc(k / size) / size
    weights = powers @ turns.T * folded
    return Window(
        jnp.asarray(centre),
        jnp.asarray(weights.real),
        jnp.asarray(weights.imag),
        jnp.asarray(levels),
        jnp.asarray(known_spread),
        jnp.tile(_nodes(reached, finest), (len(levels), 1)) if reached else None,
        size,
        widest,
    )


def _nodes(spread: float, finest: float) -> Float[Array, " nodes"]:
    """Return nodes d / s that resolve every harmonic that the least read noise leaves."""
    harmonics = DECAY / (2 * np.pi * finest)
    half = REACHED * (spread * 2 * harmonics + 1.2)
    half = int(2 ** (np.ceil(FINER * np.log2(half)) / FINER))  # few sizes, as for the frequencies
    return jnp.asarray(np.linspace(-REACHED, REACHED, 2 * half + 1))


def quantised_moments(
    electrons: Float[Array, ""],
    gain: Float[Array, ""],
    read_noise: Float[Array, ""],
    offset: Float[Array, ""],
    window: Window,
    *,
    spread: Float[Array, ""] | None = None,
) -> Moments:
    """Return the cumulants of the number at ONE level; use `vmap` over the window."""
    frequencies = window.cosine.shape[-1]
    u = 2 * jnp.pi * jnp.arange(frequencies, dtype=gain.dtype) / window.size
    # cos - 1 is computed as -2 sin^2 of half the angle, which has no cancellation at small u.
    log_size = -((gain * read_noise * u) ** 2) / 2 - 2 * electrons * jnp.sin(u * gain / 2) ** 2
    phase = u * (offset - window.centre) + electrons * jnp.sin(u * gain)
    size = jnp.exp(log_size)
    real, imaginary = size * jnp.cos(phase), size * jnp.sin(phase)
    nodes = window.nodes
    if nodes is None:
        first, variance, skew, tail = _cumulants(window.cosine @ real - window.sine @ imaginary)
        return Moments(window.centre + first, variance, skew, tail)
    square = window.known_spread + (0.0 if spread is None else spread**2)
    width = jnp.sqrt(jnp.minimum(square, window.widest**2))
    share = jnp.exp(-(nodes**2) / 2)
    share = share / jnp.sum(share)
    weights = jax.lax.complex(window.cosine, window.sine)
    summands = weights * jax.lax.complex(real, imaginary)[None]
    turn = u[1] * width * (nodes[1] - nodes[0])
    sums = jax.vmap(lambda own: _sums_at_nodes(own, turn, len(nodes)))(summands)
    each = _cumulants(sums.real)  # (nodes,) each
    first, variance, skew, tail = (moment @ share for moment in each)
    away = each[0] - first
    narrow = away**2 @ share
    rest = jnp.stack([away, each[1] - variance, away**2 - narrow])
    linear, quadratic = nodes, (nodes**2 - 1) / jnp.sqrt(2.0)
    explained = rest @ jnp.stack([linear * share, quadratic * share], axis=1)
    die = (rest * share[None]) @ rest.T
    spatial = narrow + jnp.maximum(square - width**2, 0)
    return Moments(
        *(window.centre + first, variance, skew, tail, spatial, die[1, 1]),
        die=die - explained @ explained.T,
    )


def _sums_at_nodes(
    summands: Complex[Array, " frequencies"], turn: Array, nodes: int
) -> Complex[Array, " nodes"]:
    """Return sum_k summands_k exp(i k j turn) for the whole numbers j about 0, by the chirp z
    transform: k j = (k^2 + j^2 - (k - j)^2) / 2 makes the sum a convolution, of N log N products in
    place of N^2.

    Source:
        Bluestein, "A linear filtering approach to the computation of discrete Fourier transform",
        1970.
    """
    frequencies, half = summands.shape[-1], nodes // 2
    size = 2 ** int(np.ceil(np.log2(2 * frequencies + nodes)))
    k, j = np.arange(frequencies), np.arange(-half, half + 1)
    apart = np.arange(size) - half - frequencies + 1  # j - k, from its least value on

    def chirp(at: np.ndarray) -> Array:
        angle = jnp.asarray(at**2 / 2, turn.dtype) * turn
        return jax.lax.complex(jnp.cos(angle), jnp.sin(angle))

    kernel = jnp.where(apart <= half, jnp.conj(chirp(apart)), 0)
    chirped = jnp.fft.fft(summands * chirp(k), size)
    found = jnp.fft.ifft(chirped * jnp.fft.fft(kernel))[frequencies - 1 :][:nodes]
    return found * chirp(j)


def _cumulants(raw: Array) -> tuple[Array, Array, Array, Array]:
    """Convert the first four moments, one in each row, to cumulants."""
    first, second, third, fourth = raw
    variance = second - first**2
    skew = third - 3 * first * second + 2 * first**3
    tail = fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4
    return first, variance, skew, tail - 3 * variance**2
