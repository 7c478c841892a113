"""Histogram matching: give an image the distribution of the values of another image. Values are
codes (integer images) or relative."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped

from ..core._arguments import takes_numbers
from ..core._loops.fusion import materialise
from ._planes import Pixels, Stack, as_stack, bin_counts, binning, levels_of, plane_numbers


@takes_numbers
@jax.jit
def match_histogram(image: Pixels, reference: Pixels) -> Shaped[Array, "..."]:
    """Map each value to the value of equal cumulative frequency in the same plane of a reference.

    The result is F_reference^-1(F_image(x)), linear between the values that occur. Integer images
    are matched as in scikit-image's `match_histograms`, but rounded to the nearest code instead of
    truncated. Floating images are matched by rank, without bins. NaN in the image stays NaN and is
    not ranked. A reference plane that contains NaN makes the whole result plane NaN. The result has
    a gradient with respect to the values of `reference`. The gradient with respect to `image` is 0,
    because a small change leaves every rank unchanged.

    Args:
        image: (h, w) or (..., h, w, bands), uint8, uint16 or floating; codes or relative.
        reference: of the same dtype and unit, with the same bands and batch.

    Returns:
        The image's shape, unit and dtype.

    Raises:
        ValueError: for two dtypes, or for shapes that differ in more than h and w.

    Example:
        >>> dull, bright = np.array([[0.2, 0.3, 0.4]]), np.array([[0.9, 0.1, 0.5]])
        >>> print(jv.histogram.match_histogram(dull, bright))
        [[0.1 0.5 0.9]]
    """
    source, target = as_stack(image), as_stack(reference)
    if source.dtype != target.dtype:
        raise ValueError(
            f"image and reference must be of one dtype, got {source.dtype} and {target.dtype}."
        )
    if image.ndim != reference.ndim or (source.shape[0], source.shape[3]) != (
        target.shape[0],
        target.shape[3],
    ):
        raise ValueError(
            "image and reference must agree but for h and w, got "
            f"{image.shape} and {reference.shape}."
        )
    levels = levels_of(source)
    matched = (
        _match_ranks(source, target) if levels is None else _match_codes(source, target, levels)
    )
    return matched.reshape(image.shape)


def _match_codes(source: Stack, target: Stack, levels: int) -> Stack:
    counts, offered = (bin_counts(stack, binning(stack, None, None)) for stack in (source, target))
    table = materialise(_matching_codes, counts, offered).astype(source.dtype)
    entry = plane_numbers(source) * levels + source.astype(jnp.int32)
    return table.ravel().at[entry].get(mode="promise_in_bounds")


def _matching_codes(
    counts: Int[Array, "planes levels"], offered: Int[Array, "planes levels"]
) -> Float[Array, "planes levels"]:
    """Return the code to which each code is mapped."""
    codes = jnp.arange(counts.shape[-1], dtype=jnp.int32)[None]
    occupied = offered > 0
    # an empty code gets the value of the last occupied code, so that interpolation skips it
    last = jax.lax.cummax(jnp.where(occupied, codes, -1), axis=1)
    lowest = jnp.argmax(occupied, axis=-1).astype(last.dtype)[:, None]
    values = jnp.where(last < 0, lowest, last)
    wanted, at = _fractions(counts), _fractions(offered)
    return jnp.round(jax.vmap(jnp.interp)(wanted, at, values.astype(wanted.dtype)))


def _fractions(counts: Int[Array, "planes levels"]) -> Float[Array, "planes levels"]:
    below = jnp.cumsum(counts, axis=-1).astype(jnp.result_type(float))
    return below / below[:, -1:]


def _match_ranks(source: Stack, target: Stack) -> Stack:
    n, h, w, bands = source.shape

    def as_planes(stack: Stack) -> Float[Array, "planes pixels"]:
        return jnp.moveaxis(stack, -1, 1).reshape(n * bands, -1)

    moved = jax.vmap(_match_plane)(as_planes(source), as_planes(target))
    return jnp.moveaxis(moved.reshape(n, bands, h, w), 1, -1)


def _match_plane(
    values: Float[Array, " pixels"], offered: Float[Array, " others"]
) -> Float[Array, " pixels"]:
    """Match one plane by ranks. NaN is sorted last and has no fraction."""
    ordered = jnp.sort(offered)
    at, wanted = _fraction_up_to(ordered, ordered), _fraction_up_to(jnp.sort(values), values)
    unknown = jnp.isnan(values) | jnp.isnan(ordered[-1])
    return jnp.where(unknown, jnp.nan, jnp.interp(wanted, at, ordered))


def _fraction_up_to(ordered: Float[Array, " n"], values: Float[Array, " m"]) -> Float[Array, " m"]:
    """Return, for each value, the fraction of the ordered values, without NaN, that do not exceed
    it.
    """
    rank = jnp.searchsorted(ordered, values, side="right", method="sort")
    known = (~jnp.isnan(ordered)).sum()
    return rank.astype(values.dtype) / jnp.maximum(known, 1).astype(values.dtype)
