"""Histograms per plane, exact or differentiable, and the statistics that follow from them: the
cumulative distribution, quantiles, Otsu's threshold.

Edges and values are in the unit of the image: codes (integer images) or relative values. Bins are
as in numpy: equal, half-open [edge, next edge), except that the last bin includes its upper edge.
NaN and values outside the range are not counted.
"""

import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import divide
from ..core._shown import Shown
from ..core._types import SHARE, Scalar, as_float, check_choice, is_known
from ._planes import (
    Binning,
    Pixels,
    Range,
    Stack,
    as_stack,
    bin_counts,
    binning,
    cumulative_fractions,
    levels_of,
    plane_numbers,
    reshape_per_plane,
)

# Partial sums of weights have up to this many separate entries: see `_weighted_counts`.
PARTIAL_SUMS = 2**20  # largest number of entries of all bins together
RUN = 2**12  # smallest number of pixels in one partial sum
DIGITS = 2**11  # upper digits are multiples of 1 / DIGITS, of which 2^13 sum exactly in float32


class Histogram(Shown):
    """The histograms of the planes of an image: counts and edges.

    Attributes:
        counts: (bins,) for a grey image, else (..., bands, bins), no unit; integers if exact.
        edges: (bins + 1,) in the unit of the image.
        departure: () or (..., bands) for a soft histogram, no unit: the fraction of its weight that
            lies in another bin than in the exact histogram (half the sum of absolute differences
            over the number of values counted). None for an exact one.
    """

    counts: Shaped[Array, "*planes bins"]
    edges: Float[Array, " edges"]
    departure: Float[Array, "*planes"] | None = None


@takes_numbers
def exact_histogram(
    image: Pixels, *, bins: int | np.integer | None = None, value_range: Range | None = None
) -> Histogram:
    """Count the pixels of each plane in each of `bins` equal bins of a range.

    The result equals numpy's exactly; its gradient is 0.

    Args:
        image: (h, w) or (..., h, w, bands), uint8, uint16 or floating; codes or relative.
        bins: number of bins, at least 1. None for one bin per code (edges 0, 1 ... 256 or 65536),
            or 256 bins for floating images.
        value_range: (low, high) in the image's unit. None for all codes, or [0, 1].

    Returns:
        Counts (bins,) or (..., bands, bins), no unit, and edges (bins + 1,) in the image's unit.

    Raises:
        ValueError: for bins < 1, an empty range, or another rank or dtype.

    Example:
        >>> codes = np.array([[0, 1, 1], [3, 3, 3]], np.uint8)
        >>> print(jv.histogram.exact_histogram(codes, bins=4, value_range=(0, 4)).counts)
        [1 2 0 3]
    """
    stack, chosen = as_stack(image), binning(image, bins, value_range)
    counts = _exact(stack, chosen)
    if value_range is None:
        _warn_of_outside(image, counts)
    return Histogram(reshape_per_plane(counts, image), _edges(stack, chosen))


def _warn_of_outside(image: Pixels, counts: Array) -> None:
    """Warn about values outside [0, 1] if the caller gave no range and the values are not
    traced.
    """
    if is_known(counts) and jnp.issubdtype(image.dtype, jnp.floating):
        missing = image.size - float(counts.sum())
        if missing > 0.5:
            warnings.warn(
                f"{missing:.0f} of {image.size} values are outside [0, 1] or NaN, and are not "
                "counted; state value_range.",
                stacklevel=4,
            )


@takes_numbers
def soft_histogram(
    image: Pixels,
    *,
    bins: int | np.integer | None = None,
    value_range: Range | None = None,
    kernel: str = "linear",
) -> Histogram:
    """Compute a differentiable histogram, in which each value distributes its weight of 1 over the
    nearest bins.

    Weight that would lie outside the range is added to the end bin, so the counts sum to the number
    of values in the range, within a millionth for 25 million equal values in 256 bins. An integer
    code lies at the centre of its bin of width 1. `departure` is the difference from the exact
    histogram. The departure grows with the number of bins, because fewer values lie near a bin's
    centre. For data that are smooth on the scale of a bin it decreases as the square of the bin's
    width.

    Args:
        image: (h, w) or (..., h, w, bands), uint8, uint16 or floating; codes or relative.
        bins: number of bins, as for `exact_histogram`.
        value_range: (low, high) in the image's unit, as for `exact_histogram`.
        kernel: the B-spline by which weight falls off with the distance to a bin's centre: "linear"
            (2 bins wide; the gradient jumps at the centres) or "cubic" (4 bins wide; twice
            continuously differentiable).

    Returns:
        Counts (bins,) or (..., bands, bins), edges (bins + 1,) in the image's unit, and the
        departure.

    Raises:
        ValueError: for another kernel and as for `exact_histogram`.

    Example:
        >>> print(jv.histogram.soft_histogram(np.array([[0.25, 0.5]]), bins=4).counts)
        [0.5 1.  0.5 0. ]
    """
    check_choice("kernel", kernel, ("linear", "cubic"))
    stack, chosen = as_stack(image), binning(image, bins, value_range)
    counts, departure = _soft(stack, chosen, kernel)
    if value_range is None:
        _warn_of_outside(image, counts)
    return Histogram(
        reshape_per_plane(counts, image), _edges(stack, chosen), reshape_per_plane(departure, image)
    )


@takes_numbers
def cumulative_distribution(histogram: Histogram) -> Float[Array, "*planes edges"]:
    """Return the fraction of counted values below each edge (at the last edge: up to and including
    it).

    Args:
        histogram: exact or soft.

    Returns:
        (..., bins + 1) from 0 to 1, no unit; 0 throughout for an empty histogram.

    Example:
        >>> counts = jv.histogram.exact_histogram(np.array([[0.1, 0.3], [0.3, 0.9]]), bins=4)
        >>> print(jv.histogram.cumulative_distribution(counts))
        [0.   0.25 0.75 0.75 1.  ]
    """
    return cumulative_fractions(histogram.counts, histogram.edges.dtype)


@takes_numbers
@takes_range(q=SHARE)
def quantile(histogram: Histogram, q: Scalar) -> Float[Array, "*planes"]:
    """Return the smallest value that a fraction q of the counted values does not exceed.

    Values outside the histogram's range are not counted. Values are assumed to be uniformly
    distributed within their bin, so the result is within a bin's width of the exact quantile.

    Args:
        histogram: exact or soft.
        q: () no unit, in [0, 1].

    Returns:
        () or (..., bands) in the image's unit. q = 0 gives the lower edge of the first occupied
        bin, q = 1 the upper edge of the last; NaN for an empty histogram.

    Raises:
        ValueError: for a q outside [0, 1].

    Example:
        >>> codes = np.arange(256, dtype=np.uint8).reshape(16, 16)
        >>> print(jv.histogram.quantile(jv.histogram.exact_histogram(codes), 0.5))
        128.0
    """
    cdf, edges = cumulative_distribution(histogram), histogram.edges
    bins = edges.shape[0] - 1
    q = jnp.clip(jnp.asarray(q, edges.dtype), 0, 1)
    end = jnp.maximum((cdf < q).sum(-1), (cdf <= 0).sum(-1))
    end = jnp.clip(end, 1, bins)[..., None]
    low, high = (jnp.take_along_axis(cdf, end - i, axis=-1)[..., 0] for i in (1, 0))
    rise = high - low
    part = divide(q - low, rise)
    start = jnp.take(edges, end[..., 0] - 1)
    value = start + jnp.maximum(part, 0) * (edges[1] - edges[0])
    return jnp.where(cdf[..., -1] > 0, value, jnp.nan)


@takes_numbers
def otsu_threshold(histogram: Histogram) -> Float[Array, "*planes"]:
    """Return the inner edge t that maximises the variance between the two classes, values < t and
    values >= t.

    If several edges give the same variance, the first of these edges is returned. If all values are
    in one bin, the first inner edge is returned. For integer images, OpenCV and scikit-image return
    t - 1, the last code of the lower class. Near its maximum the variance is constant within
    float32 rounding. In float32 the threshold for 65536 bins may therefore be wrong by a few bins
    (30002 instead of 30000).

    Args:
        histogram: exact or soft, of at least 2 bins.

    Returns:
        () or (..., bands) in the image's unit; NaN for an empty histogram.

    Raises:
        ValueError: for fewer than 2 bins.

    Source: Otsu 1979.

    Example:
        >>> codes = np.array([[10, 12, 11], [200, 190, 210]], np.uint8)  # ink and paper
        >>> print(jv.histogram.otsu_threshold(jv.histogram.exact_histogram(codes)))
        13.0
    """
    counts, edges = histogram.counts.astype(histogram.edges.dtype), histogram.edges
    bins = edges.shape[0] - 1
    if bins < 2:
        raise ValueError("a threshold needs at least 2 bins, got 1.")
    # bin numbers relative to the middle replace values, because shift and scale do not change the
    # argmax
    centres = jnp.arange(bins, dtype=edges.dtype) - (bins - 1) / 2
    centres = centres.reshape(*(1,) * (counts.ndim - 1), bins)
    weight = cumulative_distribution(histogram)[..., 1:-1]
    total = counts.sum(-1, keepdims=True)
    moment = jnp.cumsum(divide(counts, total) * centres, axis=-1)
    mean = moment[..., -1:]
    spread = weight * (1 - weight)
    between = divide((mean * weight - moment[..., :-1]) ** 2, spread)
    best = jnp.argmax(between, axis=-1)
    return jnp.where(total[..., 0] > 0, jnp.take(edges, best + 1), jnp.nan)


@partial(jax.jit, static_argnames=("chosen",))
def _exact(stack: Stack, chosen: Binning) -> Int[Array, "planes bins"]:
    return bin_counts(stack, chosen)


@partial(jax.jit, static_argnames=("chosen", "kernel"))
def _soft(
    stack: Stack, chosen: Binning, kernel: str
) -> tuple[Float[Array, "planes bins"], Float[Array, " planes"]]:
    """Return the soft counts, and their difference from the exact counts."""
    exact = bin_counts(stack, chosen)
    values = stack if levels_of(stack) is None else as_float(stack) + 0.5
    counts = _weighted_counts(values, chosen, kernel)
    shifted = jnp.abs(counts - exact.astype(counts.dtype)).sum(-1)
    return counts, shifted / (2 * jnp.maximum(exact.sum(-1), 1)).astype(counts.dtype)


def _edges(stack: Stack, chosen: Binning) -> Float[Array, " edges"]:
    integer = levels_of(stack) is not None
    return jnp.asarray(
        chosen.edges, jax.dtypes.canonicalize_dtype(float) if integer else stack.dtype
    )


def _weighted_counts(
    values: Float[Array, "n h w bands"], chosen: Binning, kernel: str
) -> Float[Array, "planes bins"]:
    """Add the B-spline weights of all values about the bins' centres. A running float32 sum of
    equal weights stalls after about 2^24 of them. Each weight is therefore split into upper digits,
    thousands of which add without rounding, and lower digits, and groups of pixels are summed
    pairwise. Gradients flow through the lower digits only.
    """
    bins, low, high = chosen
    n, h, w, bands = values.shape
    inside = (values >= low) & (values <= high)
    position = (jnp.where(inside, values, low) - low) / chosen.width - 0.5
    floor = jnp.floor(position)
    f = position - floor
    if kernel == "linear":
        first, weights = 0, (1 - f, f)
    else:
        first = -1
        weights = (
            (1 - f) ** 3 / 6,
            (3 * f**3 - 6 * f**2 + 4) / 6,
            (-3 * f**3 + 3 * f**2 + 3 * f + 1) / 6,
            f**3 / 6,
        )
    parts = max(1, min(h * w // RUN + 1, PARTIAL_SUMS // bins))
    pixel = jnp.arange(h * w, dtype=jnp.int32).reshape(1, h, w, 1)
    start = (plane_numbers(values) * parts + pixel // -(-h * w // parts)) * bins
    upper, lower = (jnp.zeros(n * bands * parts * bins, values.dtype) for _ in range(2))
    for offset, weight in enumerate(weights, first):
        index = (start + jnp.clip(floor.astype(jnp.int32) + offset, 0, bins - 1)).ravel()
        kept = jnp.where(inside, weight, 0).ravel()
        high_digits = jax.lax.stop_gradient(jnp.floor(kept * DIGITS) / DIGITS)
        upper, lower = upper.at[index].add(high_digits), lower.at[index].add(kept - high_digits)
    whole, rest = (_pairwise_sum(part.reshape(n * bands, parts, bins)) for part in (upper, lower))
    return whole + rest


def _pairwise_sum(parts: Float[Array, "planes parts bins"]) -> Float[Array, "planes bins"]:
    """Sum over the parts in pairs, with an error that grows only with the logarithm of their
    number.
    """
    while (count := parts.shape[1]) > 1:
        parts = jnp.pad(parts, ((0, 0), (0, count % 2), (0, 0)))
        parts = parts[:, ::2] + parts[:, 1::2]
    return parts[:, 0]
