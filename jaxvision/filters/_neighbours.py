"""The weighted mean of bilateral and non-local means filters, accumulated over rows of neighbours.

Each band is its own array here, because vector code is slow over a trailing axis of three.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..core._numerics import binary_unit, smallest_divisor
from ..core._types import Scalars, print_by_name
from .padding import as_planes, pad

# Pictures in one call may differ in size or bands, so their axes have no names to agree on.
AnyPicture = Shaped[Array | np.ndarray, "..."]
Floats = Float[Array, "..."]
print_by_name(globals(), "AnyPicture", "Floats")

Plane = Float[Array, "images _ _"]
Planes = tuple[Plane, ...]


def planes_of(picture: AnyPicture) -> tuple[Planes, Callable[[Planes], Floats]]:
    """The bands of a picture, and the inverse function."""
    stack, restore = as_planes(picture)
    planes = tuple(stack[..., band] for band in range(stack.shape[-1]))
    return planes, lambda bands: restore(jnp.stack(bands, axis=-1))


def scaled_guide(
    guide: Planes, *sizes: float | Scalars, dtype: DTypeLike
) -> tuple[Planes, tuple[Scalars, ...]]:
    """A guide and sizes in its unit, both divided by one power of two, so that no bound on a size
    depends on the unit of light."""
    unit = binary_unit(jnp.stack(guide))
    scaled = tuple(jnp.asarray(size, dtype) / unit.astype(dtype) for size in sizes)
    return tuple(g / unit for g in guide), scaled


def inverse(sigma: float | Scalars, dtype: DTypeLike) -> Scalars:
    """1 / sigma, with sigma at least tiny ** (1/2) (1e-19 in float32): its square and its
    derivative stay finite, so differences measured in sigmas have finite gradients."""
    return 1 / jnp.maximum(jnp.asarray(sigma, dtype), smallest_divisor(dtype) ** 2)


def weighted_mean(
    values: Planes,
    guide: Planes,
    weight_of: Callable[[Planes, Int[Array, ""], int], Plane],
    *,
    radius: int,
    border: str,
    margin: int = 0,
    taken: Callable[[Int[Array, ""], int], Bool[Array, ""]] | None = None,
) -> Planes:
    """sum w f / sum w over the neighbours up to `radius` away for which `taken(dy, dx)`, or all.
    `weight_of(change, dy, dx)` gets guide(p + (dy, dx)) - guide(p) on the picture and `margin`
    pixels around it. A neighbour has no weight if, there or in its margin, one guide is infinite
    and the other is not. Border "normalised_zero" leaves out neighbours outside. The backward pass
    recomputes each row of neighbours."""
    zero = jnp.zeros_like(values[0])
    height, width = zero.shape[1:]
    present = (_pad_guide(zero + 1, radius, border),) if border == "normalised_zero" else ()
    values = tuple(_pad_guide(plane, radius, border) for plane in values)
    guide = tuple(_pad_guide(plane, radius + margin, border) for plane in guide)
    signs = _signs_of_infinity(guide)
    guide = tuple(jnp.where(jnp.isinf(plane), 0, plane) for plane in guide)
    inner = slice(radius, radius + height + 2 * margin), slice(radius, radius + width + 2 * margin)
    here, signs_here = tuple(g[:, *inner] for g in guide), signs[:, *inner]

    @jax.checkpoint
    def row(dy: Int[Array, ""]) -> tuple[Planes, Plane]:
        lines, inside = (
            tuple(lax.dynamic_slice_in_dim(f, dy, height, 1) for f in planes)
            for planes in (values, present)
        )
        guides = tuple(lax.dynamic_slice_in_dim(g, dy, height + 2 * margin, 1) for g in guide)
        signs_of_row = lax.dynamic_slice_in_dim(signs, dy, height + 2 * margin, 1)
        sums, total = tuple(zero for _ in lines), zero
        for dx in range(2 * radius + 1):
            there = (lax.slice_in_dim(g, dx, dx + width + 2 * margin, axis=2) for g in guides)
            change = tuple(a - b for a, b in zip(there, here, strict=True))
            weight = weight_of(change, dy - radius, dx - radius)
            moved = tuple(lax.slice_in_dim(f, dx, dx + width, axis=2) for f in lines)
            signs_there = lax.slice_in_dim(signs_of_row, dx, dx + width + 2 * margin, axis=2)
            near = ~_any_around(signs_there != signs_here, margin)
            weight = jnp.where(near, weight, 0)
            moved = tuple(jnp.where(near, f, 0) for f in moved)
            for here_or_not in inside:
                weight = weight * lax.slice_in_dim(here_or_not, dx, dx + width, axis=2)
            if taken is not None:
                use = taken(dy - radius, dx - radius)
                weight = jnp.where(use, weight, 0)
                moved = tuple(jnp.where(use, f, 0) for f in moved)
            sums = tuple(s + weight * f for s, f in zip(sums, moved, strict=True))
            total = total + weight
        return sums, total

    def add(sums: tuple[Planes, Plane], dy: Int[Array, ""]) -> tuple[tuple[Planes, Plane], None]:
        return jax.tree.map(jnp.add, sums, row(dy)), None

    start = tuple(zero for _ in values), zero
    (sums, total), _ = lax.scan(add, start, jnp.arange(2 * radius + 1, dtype=jnp.int32))
    return tuple(s / total for s in sums)


def _signs_of_infinity(guide: Planes) -> Plane:
    """One number for each pixel, which tells the bands that are +inf, -inf and finite."""
    signs = (jnp.where(jnp.isinf(g), jnp.sign(g), 0) * 3.0**k for k, g in enumerate(guide))
    return lax.stop_gradient(functools.reduce(jnp.add, signs))


def _any_around(flags: Bool[Array, "images _ _"], margin: int) -> Bool[Array, "images _ _"]:
    """Whether any flag within `margin` rows and columns is set, where all of them exist."""
    side = 2 * margin + 1
    return lax.reduce_window(flags, False, lax.bitwise_or, (1, side, side), (1, 1, 1), "valid")


def _pad_guide(plane: Plane, by: int, border: str) -> Plane:
    """The plane with `by` more pixels on every side."""
    return pad(plane[..., None], ((by, by), (by, by)), border=border)[..., 0]
