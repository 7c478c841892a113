"""Curves and colour maps given as tables, from relative values to the unit of the table."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt

from ..core._arguments import takes_numbers
from ..core._types import Scalars, as_relative, refuse_codes
from .linear import blend


@takes_numbers
def lookup(x: Scalars, table: Float[Array, " entries"]) -> Scalars:
    """Evaluate a curve through equally spaced table entries, piecewise linear and constant outside
    [0, 1].

    Args:
        x: (...) relative.
        table: (entries,) any unit, the first entry at x = 0 and the last at x = 1.

    Returns:
        (...) in the table's unit.

    Raises:
        ValueError: for fewer than two entries, and for codes (`lookup_codes` is for integers).
    """
    if table.shape[0] < 2:
        raise ValueError(f"table must hold at least two entries, got {table.shape[0]}.")
    refuse_codes(x := as_relative(x))
    lower, t = _cell(x, table.shape[0])
    return blend(table[lower], table[lower + 1], t)


@takes_numbers
def lookup_codes(
    codes: UInt[Array, "..."] | Int[Array, "..."], table: Float[Array, " entries"]
) -> Float[Array, "..."]:
    """Map integer codes by a table with one entry per code: table[codes].

    Args:
        codes: (...) whole numbers; a code outside the table takes the nearest entry.
        table: (entries,) relative, or any unit.

    Returns:
        (...) in the table's unit.

    Raises:
        ValueError: for values that are not whole numbers.
    """
    if not jnp.issubdtype(codes.dtype, jnp.integer):
        raise ValueError(
            f"codes must be integers, got {codes.dtype}; lookup takes relative values."
        )
    return table[jnp.clip(codes, 0, table.shape[0] - 1)]


@takes_numbers
def lookup_3d(
    image: Float[Array, "... 3"], table: Float[Array, "red green blue channels"]
) -> Float[Array, "... channels"]:
    """Map colours by a table over the cube of R, G and B, with trilinear interpolation, constant
    outside [0, 1].

    Args:
        image: (..., 3) relative.
        table: (n_r, n_g, n_b, channels) any unit, its axes spanning [0, 1].

    Returns:
        (..., channels) in the table's unit.

    Raises:
        ValueError: for an axis of fewer than two entries, an image without three bands, and codes
            such as 0 to 255 in place of relative values.
    """
    refuse_codes(image := as_relative(image))
    if image.shape[-1:] != (3,):
        raise ValueError(f"image must have a last axis of 3, got shape {image.shape}.")
    if min(table.shape[:3]) < 2:
        raise ValueError(f"table must have at least two entries an axis, got {table.shape}.")
    lower, t = zip(*(_cell(image[..., i], table.shape[i]) for i in range(3)), strict=True)
    flat = table.reshape(-1, table.shape[-1])
    _, n_green, n_blue = table.shape[:3]

    def corner(r: int, g: int, b: int) -> Float[Array, "... channels"]:
        return flat[((lower[0] + r) * n_green + lower[1] + g) * n_blue + lower[2] + b]

    tr, tg, tb = (fraction[..., None] for fraction in t)
    edges = [blend(corner(r, g, 0), corner(r, g, 1), tb) for r in (0, 1) for g in (0, 1)]
    return blend(blend(edges[0], edges[1], tg), blend(edges[2], edges[3], tg), tr)


def _cell(x: Scalars, entries: int) -> tuple[Int[Array, "..."], Scalars]:
    """Return the index of the entry at or below x in a table over [0, 1], and x's fraction of the
    way to the next entry.
    """
    at = jnp.where(x <= 0, 0, jnp.minimum(x, 1)) * (entries - 1)
    # NaN has no integer: it may take any entry, since the fraction is NaN
    lower = jnp.clip(jax.lax.stop_gradient(at).astype(jnp.int32), 0, entries - 2)
    return lower, at - lower.astype(at.dtype)
