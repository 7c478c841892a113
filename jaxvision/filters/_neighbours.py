"""The weighted mean that the bilateral and the non-local means filters compute, accumulated over
rows of neighbours.

Each band is a separate array here, because vector code is slow over a trailing axis of three.
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
from ..core.parallel_loops import scan
from .padding import as_planes, pad

# Pictures in one call may differ in size or bands, so their axes have no names to agree on.
AnyPicture = Shaped[Array | np.ndarray, "..."]
Floats = Float[Array, "..."]
print_by_name(globals(), "AnyPicture", "Floats")

Plane = Float[Array, "images _ _"]
Planes = tuple[Plane, ...]


def planes_of(picture: AnyPicture) -> tuple[Planes, Callable[[Planes], Floats]]:
    """Return the bands of a picture as separate planes, and the function that joins planes to a
    picture. Half precision becomes float32 in between.
    """
    stack, restore = as_planes(picture)
    dtype = stack.dtype
    if dtype.itemsize < 4:  # half precision is too small for sums over a window
        stack = stack.astype(jnp.float32)
    planes = tuple(stack[..., band] for band in range(stack.shape[-1]))
    return planes, lambda bands: restore(jnp.stack(bands, axis=-1)).astype(dtype)


def scaled_guide(
    guide: Planes, *sizes: float | Scalars, dtype: DTypeLike
) -> tuple[Planes, tuple[Scalars, ...]]:
    """Divide a guide, and sizes in its unit, by one power of two, so that lower bounds on the sizes
    do not depend on the unit of light.
    """
    unit = binary_unit(jnp.stack(guide))
    scaled = tuple(jnp.asarray(size, dtype) / unit.astype(dtype) for size in sizes)
    return tuple(g / unit for g in guide), scaled


def inverse(sigma: float | Scalars, dtype: DTypeLike) -> Scalars:
    """Return 1 / sigma, with sigma at least tiny ** (1/2) (1e-19 in float32). The square and the
    derivative of 1 / sigma are then finite, and so are gradients of differences measured in sigmas.
    """
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
    """Return sum w f / sum w over the neighbours up to `radius` rows and columns away.

    Only neighbours for which `taken(dy, dx)` is true count; None takes all. The weight w is
    `weight_of(change, dy, dx)`, where `change` is guide(p + (dy, dx)) - guide(p) on the picture and
    `margin` pixels around it. The windows of `margin` pixels about a pixel and about its neighbour
    are compared. The neighbour has weight 0 if the guide is infinite in one window and finite at
    the corresponding place of the other. Border "normalised_zero" ignores neighbours outside the
    picture. The backward pass recomputes each row of neighbours, to save memory.
    """
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
    (sums, total), _ = scan(add, start, jnp.arange(2 * radius + 1, dtype=jnp.int32))
    return tuple(s / total for s in sums)


def _signs_of_infinity(guide: Planes) -> Plane:
    """Encode in one number per pixel which bands are +inf, -inf or finite, as digits to the base
    3.
    """
    signs = (jnp.where(jnp.isinf(g), jnp.sign(g), 0) * 3.0**k for k, g in enumerate(guide))
    return lax.stop_gradient(functools.reduce(jnp.add, signs))


def _any_around(flags: Bool[Array, "images _ _"], margin: int) -> Bool[Array, "images _ _"]:
    """Return whether any flag within `margin` rows and columns is set, for the pixels whose window
    lies inside.
    """
    side = 2 * margin + 1
    return lax.reduce_window(flags, False, lax.bitwise_or, (1, side, side), (1, 1, 1), "valid")


def _pad_guide(plane: Plane, by: int, border: str) -> Plane:
    """Pad the plane by `by` pixels on every side."""
    return pad(plane[..., None], ((by, by), (by, by)), border=border)[..., 0]
