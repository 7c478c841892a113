"""The brighter-fatter effect: collected charge moves the borders of pixels during the exposure.

Q is the number of electrons that a pixel holds, I the number that arrive over the exposure, K the
kernel, * a convolution, and phi = K * Q. The current (I_p + I_q) (phi_p - phi_q) / 2 flows across
the border of neighbours p and q. The charge of pixel p therefore changes as

    dQ_p / dt = I_p + sum over the four q of (I_p + I_q) (phi_q - phi_p) / 2,     t from 0 to 1.

Let a be the Laplacian of K, and mu = I the mean in uniform light. Poisson charges then have the
covariances

    C(k) = (exp(2 a(k) mu) - 1) / (2 a(k)) = mu + a mu^2 + (2/3) (a*a) mu^3 + (1/3) (a*a*a) mu^4 ...

as a function of the spatial frequency k: equation 20 of Astier et al. (A&A 629 A36, 2019) with b =
0. The variance is less than mu by a term in a_00 mu^2, and the covariances of neighbours grow with
mu^2. The sum of a is 0, so the variance and all covariances of a pixel add up to mu. The effect
also smooths a pattern of pixel sensitivities. If its power spectrum is p(k)^2, the power spectrum
of the charges is

    p(k)^2 mu^2 ((exp(a(k) mu) - 1) / (a(k) mu))^2.
"""

from collections.abc import Callable
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._loops.fusion import one_program
from ..core._numerics import polynomial
from ..core._types import Key, Scalar, Scalars
from ..core.parallel_loops import fori_loop
from ..filters.convolution import Settings, Terms, filtered, summed
from ..scene import BrighterFatter, ShotNoise
from ._draws import Frame, check_image, needed
from .exposure import Counts
from .shot_noise import count

Quadrant = Float[Array, "rows columns"]

PERIOD = 32  # pixels after which the sensor of the closed forms repeats itself
TERMS = 20  # terms of their series in sum |a| mu; the next term is below 1e-10 up to FURTHEST
SMALLEST = 1e-12  # lower limit of S = sum |a| per electron, which changes no value
# Beyond this sum |a| mu the relative change stays constant, because borders have crossed a pixel.
FURTHEST = 2.0


@takes_numbers
def gathered(
    key: Key | None,
    electrons: Counts,
    effect: BrighterFatter,
    *,
    shot_noise: ShotNoise | None = None,
    full_well: Scalar | None = None,
) -> Counts:
    """Return the electrons that pixels collect while their charge repels later electrons.

    Args:
        key: random key of the frame; may be None without `shot_noise`.
        electrons: (..., h, w, bands) expected without the effect, >= 0.
        effect: kernel and number of parts of the exposure.
        shot_noise: distribution of the electron count; None for the expectation.
        full_well: () electrons above which the repulsion of a pixel's charge no longer grows.

    Returns:
        (..., h, w, bands) electrons.

    Raises:
        ValueError: `electrons` is not an image, or `key` is None and needed.

    Example:
        >>> effect = jv.BrighterFatter([[1e-6]])
        >>> spot = jnp.array([0.0, 1e4, 0.0]).reshape(1, 3, 1)
        >>> [round(float(x)) for x in jv.sensor.gathered(None, spot, effect).ravel()]
        [25, 9950, 25]
    """
    check_image("Sensor.brighter_fatter", electrons.shape)
    parts = effect.steps
    kernel = _unfold(effect.kernel) * (parts / (parts - 1))
    # prepared outside the loop, because the kernel's numbers may be known here
    terms, settings = summed(kernel, electrons, border="mirror")
    return _gather_in_parts(key, electrons, terms, settings, parts, shot_noise, full_well)


@one_program
def _gather_in_parts(
    key: Key | None,
    electrons: Counts,
    terms: Terms,
    settings: Settings,
    parts: int,
    shot_noise: ShotNoise | None,
    full_well: Scalar | None,
) -> Counts:
    """Return the charges after an exposure that is divided into `parts` steps."""
    arriving = electrons / parts

    def part(i: Array, held: Counts) -> Counts:
        repelling = held if full_well is None else jnp.minimum(held, full_well)
        potential = filtered(repelling, terms, 0.0, settings)
        more = jnp.maximum(arriving + _drift(arriving, potential), 0)
        if shot_noise is not None:
            more = count(jax.random.fold_in(needed(key, Frame.SHOT), i), more, shot_noise)
        return held + more

    return fori_loop(0, parts, part, jnp.zeros_like(electrons))


@takes_numbers
def area_changes(kernel: Quadrant) -> Float[Array, "_ _"]:
    """Return a_ij, the relative change of the area of surrounding pixels per electron, which is the
    Laplacian of K.

    Args:
        kernel: (rows, columns) per electron, at offsets of 0, 1, ... rows and columns.

    Returns:
        (rows + 1, columns + 1) per electron at the same offsets. Over all pixels, with offsets of
        either sign, they sum to 0.

    Example:
        >>> print(jv.sensor.area_changes(jnp.array([[1e-6]])) * 1e6)
        [[-4.  1.]
         [ 1.  0.]]
    """
    around = jnp.pad(kernel, ((0, 2), (0, 2)))
    rows, columns = kernel.shape
    up, left = (np.abs(np.arange(n + 1) - 1) for n in (rows, columns))
    own = around[: rows + 1, : columns + 1]
    below, right = around[1 : rows + 2, : columns + 1], around[: rows + 1, 1 : columns + 2]
    return below + right + own[up] + own[:, left] - 4 * own


@takes_numbers
def flat_covariances(area_change: Quadrant, electrons: Scalars) -> Float[Array, "..."]:
    """Return the covariances of neighbouring pixels in uniform light, for Poisson charges.

    The series of the covariances in `jaxvision.sensor.brighter_fatter` is summed up to 20 terms, on
    a periodic sensor of 32 x 32 pixels. The result has an error of at most 1e-10 mu if sum |a| mu
    is at most 2.

    Args:
        area_change: (rows, columns) per electron, a at offsets of 0, 1, ... rows and columns, at
            most 16 each; from `area_changes`, or measured values, whose sum need not be 0.
        electrons: (...) mu, expected electrons per pixel, >= 0.

    Returns:
        (..., rows, columns) electrons^2: the variance at offset (0, 0), covariances at the others.

    Raises:
        ValueError: if `area_change` reaches further than 16 pixels.

    Example:
        >>> a = jv.sensor.area_changes(jnp.array([[1e-6]]))
        >>> covariances = jv.sensor.flat_covariances(a, jnp.array(1e4))
        >>> [round(float(c)) for c in covariances.ravel()]
        [9613, 95, 95, 1]
    """
    size, terms = _series(area_change, _count_series)
    ones = (1,) * electrons.ndim
    mu = electrons[..., None, None]
    terms = [term.reshape(*ones, *area_change.shape) for term in terms]
    return mu * polynomial(terms, _hold(size, mu) * jnp.ones_like(terms[0]))


@takes_numbers
def flat_variance(effect: BrighterFatter, electrons: Scalars) -> Scalars:
    """Return the variance, electrons^2, of a pixel's Poisson charge in uniform light of
    `electrons` >= 0."""
    size, terms = _series(area_changes(effect.kernel), _count_series)
    return electrons * polynomial([term[0, 0] for term in terms], _hold(size, electrons))


@takes_numbers
def smoothed_pattern(effect: BrighterFatter, electrons: Scalars) -> Scalars:
    """Return the factor, no unit, by which the brighter-fatter effect reduces the variance of
    sensitivities that are independent from pixel to pixel, in uniform light of `electrons` >= 0."""
    size, terms = _series(area_changes(effect.kernel), _pattern_series)
    return polynomial([term[0, 0] for term in terms], _hold(size, electrons))


def _count_series(m: int) -> float:
    """Return coefficient m of the power series of (exp(2 y) - 1) / (2 y)."""
    return 2**m / factorial(m + 1)


def _pattern_series(m: int) -> float:
    """Return coefficient m of the power series of ((exp y - 1) / y)^2."""
    return (2 ** (m + 2) - 2) / factorial(m + 2)


def _hold(size: Scalar, electrons: Scalars) -> Scalars:
    return jnp.minimum(size * electrons, FURTHEST)


def _drift(arriving: Counts, potential: Counts) -> Counts:
    """Return the charge that each pixel gains from its four neighbours in one step."""
    gained = jnp.zeros_like(arriving)
    for axis in (-3, -2):
        before = (slice(None),) * (arriving.ndim + axis)
        here, there = (*before, slice(None, -1)), (*before, slice(1, None))
        over = (arriving[here] + arriving[there]) / 2 * (potential[here] - potential[there])
        gained = gained.at[here].add(-over).at[there].add(over)
    return gained


def _unfold(kernel: Quadrant) -> Float[Array, "_ _"]:
    """Return the kernel at positive and negative offsets, given its values at offsets of 0, 1,
    ..."""
    rows, columns = (np.abs(np.arange(1 - n, n)) for n in kernel.shape)
    return kernel[rows][:, columns]


def _series(area_change: Quadrant, weight: Callable[[int], float]) -> tuple[Scalar, list[Quadrant]]:
    """Return S = sum |a|, and the coefficients of a power series in S mu, highest power first. The
    series is the sum over m of weight(m) mu^m (a * ... * a), with m factors a."""
    rows, columns = area_change.shape
    if max(rows, columns) > PERIOD // 2:
        raise ValueError(
            f"area_change must reach at most {PERIOD // 2} pixels, got {rows, columns}."
        )
    # cosine transforms over offsets of either sign, and back over frequencies of either sign
    there, back = zip(*(_cosines(n, area_change.dtype) for n in (rows, columns)), strict=True)
    copies = jnp.asarray(np.outer(_copies(rows), _copies(columns)), area_change.dtype)
    size = jnp.maximum(jnp.sum(jnp.abs(area_change) * copies), SMALLEST)
    spectrum = there[0] @ (area_change / size) @ there[1].T
    terms, power = [], jnp.ones_like(spectrum)
    for m in range(TERMS):
        terms.append(weight(m) * (back[0] @ power @ back[1].T))
        power = power * spectrum
    return size, terms[::-1]


def _cosines(lags: int, dtype: DTypeLike) -> tuple[Array, Array]:
    """Return the matrix of the cosine transform from offsets 0, 1, ... to spatial frequencies,
    (half a period, lags), and the matrix of its inverse, (lags, half a period)."""
    frequencies = np.arange(PERIOD // 2 + 1)
    cosines = np.cos(2 * np.pi * frequencies[:, None] * np.arange(lags) / PERIOD)
    weights = _copies(frequencies.size)
    weights[-1] = 1.0
    to, back = cosines * _copies(lags), (cosines * weights[:, None] / PERIOD).T
    return jnp.asarray(to, dtype), jnp.asarray(back, dtype)


def _copies(lags: int) -> Float[np.ndarray, " lags"]:
    """Return, for each magnitude of an offset, the number of offsets with this magnitude: 1 for 0,
    else 2."""
    return np.where(np.arange(lags) == 0, 1.0, 2.0)
