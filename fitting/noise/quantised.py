"""Exact moments of a quantised, clipped Poisson-Gaussian signal.

Behind the gain a pixel reads  K (n + sigma_d z) + offset,  n ~ Poisson(mu), z ~ Normal, rounded to
whole digital numbers and clipped at zero. Its characteristic function is a product,

    phi(u) = exp(i u offset - (K sigma_d u)^2 / 2 + mu (exp(i u K) - 1)),

and the probability of code c, the mass of the interval c - 1/2 .. c + 1/2, is its Fourier sum over
a window of M codes that holds all of the signal:

    P(c) = 1/M sum_k phi(2 pi k / M) sinc(k / M) exp(-2 pi i k c / M).

Summed over the codes first, a moment is one weighted sum of phi over the frequencies, whose weights
know the clipping but no parameter:

    E[(z - r)^p] = sum_k phi(2 pi k / M) w_p(k),
    w_p(k) = 1/M sinc(k / M) sum_c (max(c, 0) - r)^p exp(-2 pi i k c / M).

No sum over electrons is needed, and light may be bright or dim. The usual moments, a variance of
1/12 for rounding, fail where read noise is small and where black is clipped: `window` says whether
the data can tell.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxvision.errors import InputError

SPREAD = 8.0  # standard deviations on either side that a window holds
DECAY = 6.5  # phi is negligible where K sigma_d u exceeds this
PADDED = 4  # levels of a window come in multiples of it, the last repeated
FINER = 2  # sizes of a sum over frequencies in an octave: few, as each is compiled by itself
FINEST_READ_NOISE = 0.1  # DN; below, phi hardly decays and the data hardly tell
ORDERS = (1, 2, 3, 4)
LARGEST = 2**27  # numbers of a transform: 2 GB


class Window(eqx.Module):
    """Weights of some levels for their exact moments.

    Attributes:
        centre: (levels,) an integer code near each mean, from which phases and moments count.
        cosine: (levels, orders, frequencies) real part of w_p(k), for p = 1 .. 4 and k = 0, 1 ...;
            conjugate frequencies are folded in.
        sine: the imaginary part.
        levels: their indices; one may occur more than once.
        size: M.
    """

    centre: Float[Array, " levels"]
    cosine: Float[Array, "levels orders frequencies"]
    sine: Float[Array, "levels orders frequencies"]
    levels: Int[Array, " levels"]
    size: int = eqx.field(static=True)


def window_for(
    levels: Sequence[int] | Int[np.ndarray, " levels"],
    mean: Float[np.ndarray, " levels"],
    *,
    deviation: float,
    read_noise: float,
) -> Window:
    """Weights for levels of given means.

    Args:
        levels: (levels,) their indices.
        mean: (levels,) DN.
        deviation: largest standard deviation among them, DN.
        read_noise: about as large, DN.

    Returns:
        The window.

    Raises:
        InputError: for a window that memory does not hold.
    """
    again = np.pad(np.arange(len(levels)), (0, -len(levels) % PADDED), mode="edge")
    levels, mean = np.asarray(levels)[again], mean[again]
    size = 2 ** int(np.ceil(np.log2(2 * SPREAD * max(deviation, 0.5) + 2)))
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
        size,
    )


def quantised_moments(
    electrons: Float[Array, ""],
    gain: Float[Array, ""],
    read_noise: Float[Array, ""],
    offset: Float[Array, ""],
    window: Window,
) -> tuple[Array, Array, Array, Array]:
    """First four cumulants of the digital number at ONE level (vmap it over the window).

    Args:
        electrons: expected, e-.
        gain: DN/e-.
        read_noise: e- rms.
        offset: DN.
        window: of that level.

    Returns:
        Mean (DN), variance (DN^2), third and fourth cumulant.
    """
    frequencies = window.cosine.shape[-1]
    u = 2 * jnp.pi * jnp.arange(frequencies, dtype=gain.dtype) / window.size
    # cos - 1 as -2 sin^2 of half the angle: nothing cancels where u is small.
    log_size = -((gain * read_noise * u) ** 2) / 2 - 2 * electrons * jnp.sin(u * gain / 2) ** 2
    phase = u * (offset - window.centre) + electrons * jnp.sin(u * gain)
    size = jnp.exp(log_size)
    real, imaginary = size * jnp.cos(phase), size * jnp.sin(phase)
    first, second, third, fourth = window.cosine @ real - window.sine @ imaginary
    variance = second - first**2
    skew = third - 3 * first * second + 2 * first**3
    tail = fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4
    return window.centre + first, variance, skew, tail - 3 * variance**2
