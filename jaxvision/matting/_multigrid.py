"""One V-cycle of geometric multigrid for a symmetric positive definite stencil. With the V-cycle as
preconditioner, conjugate gradients take tens of steps; with a diagonal preconditioner they take
hundreds.

A coarse grid contains every second pixel. The interpolation P from coarse to fine is bilinear, and
the restriction is P^T. The coarse stencil is Galerkin's P^T A P, which again has 5 x 5
coefficients. Source: Briggs, Henson, McCormick, "A Multigrid Tutorial" (2000), chapter 10. All
quantities in this file are dimensionless.
"""

from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..core.parallel_loops import map_
from ._laplacian import Plane, Stencil, apply_stencil

# grids of any size, because one function takes coarse and fine grids
Grid = Float[Array, "_ _"]

_COARSEST = 8  # largest number of pixels per side of the coarsest grid, which is solved directly
_DAMPING = 0.7  # damping of Jacobi's iteration, for matting Laplacians


class Grids(NamedTuple):
    """The grids of a multigrid solver. `stencils`: from the finest grid to the second coarsest.
    `coarsest`: (n, n), the Cholesky factor of the matrix of the coarsest grid.
    """

    stencils: tuple[Float[Array, "5 5 _ _"], ...]
    coarsest: Float[Array, "n n"]


def coarsen(stencil: Stencil) -> Grids:
    """Compute all grids of a stencil (5, 5, h, w), down to at most 8 x 8 pixels; no unit."""
    stencils = [stencil]
    while max(stencils[-1].shape[2:]) > _COARSEST:
        stencils.append(_galerkin(stencils[-1]))
    last = stencils.pop()
    pixels = last.shape[2] * last.shape[3]
    units = jnp.eye(pixels, dtype=last.dtype).reshape(pixels, *last.shape[2:])
    matrix = jax.vmap(lambda x: apply_stencil(last, x))(units).reshape(pixels, pixels)
    return Grids(tuple(stencils), jnp.linalg.cholesky(matrix))


def v_cycle(grids: Grids, residual: Plane) -> Plane:
    """Return an approximate solution of A x = residual, (h, w), that is a linear and symmetric
    function of the residual; no unit."""
    if not grids.stencils:
        solution = jax.scipy.linalg.cho_solve((grids.coarsest, True), residual.ravel())
        return solution.reshape(residual.shape)
    stencil = grids.stencils[0]
    smoothing = _DAMPING / stencil[2, 2]
    x = smoothing * residual
    coarse = restrict(residual - apply_stencil(stencil, x))
    correction = v_cycle(Grids(grids.stencils[1:], grids.coarsest), coarse)
    x = x + interpolate(correction, residual.shape)
    return x + smoothing * (residual - apply_stencil(stencil, x))


def interpolate(coarse: Grid, shape: tuple[int, ...]) -> Grid:
    """Apply P: pixel (2 i, 2 j) of the result, (h, w), is coarse (i, j), and the pixels between are
    means of their coarse neighbours.
    """
    rows, columns = shape
    return _double(_double(coarse, rows, 0), columns, 1)


def restrict(fine: Grid) -> Grid:
    """Apply P^T, the transpose of `interpolate`."""
    coarse = jnp.zeros(_coarse_shape(fine.shape), fine.dtype)
    return jax.linear_transpose(lambda x: interpolate(x, fine.shape), coarse)(fine)[0]


def _double(x: Grid, size: int, axis: int) -> Grid:
    last = jax.lax.slice_in_dim(x, x.shape[axis] - 1, None, axis=axis)
    following = jnp.concatenate([jax.lax.slice_in_dim(x, 1, None, axis=axis), last], axis)
    pairs = jnp.stack([x, (x + following) / 2], axis + 1)
    shape = [2 * n if i == axis else n for i, n in enumerate(x.shape)]
    return jax.lax.slice_in_dim(pairs.reshape(shape), 0, size, axis=axis)


def _coarse_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    return (shape[0] + 1) // 2, (shape[1] + 1) // 2


def _galerkin(stencil: Stencil) -> Float[Array, "5 5 _ _"]:
    """Return the coarse stencil P^T A P, from its products with 25 combs of pixels five apart.
    Pixels five apart do not interact in a 5 x 5 stencil, so the products contain every coefficient.
    """
    shape = stencil.shape[2:]
    rows, columns = _coarse_shape(shape)
    y, x = np.mgrid[:rows, :columns]

    def respond(tooth: Int[Array, "2"]) -> Grid:
        comb = (jnp.asarray(y % 5) == tooth[0]) & (jnp.asarray(x % 5) == tooth[1])
        fine = interpolate(comb.astype(stencil.dtype), shape)
        return restrict(apply_stencil(stencil, fine))

    teeth = jnp.asarray(list(product(range(5), repeat=2)))
    answers = map_(respond, teeth)  # (25, rows, columns)
    offsets = np.arange(-2, 3)
    dy, dx = offsets[:, None, None, None], offsets[None, :, None, None]
    tooth = (y + dy) % 5 * 5 + (x + dx) % 5
    inside = (y + dy >= 0) & (y + dy < rows) & (x + dx >= 0) & (x + dx < columns)
    found = answers[tooth, y, x]
    return jnp.where(inside, found, 0)
