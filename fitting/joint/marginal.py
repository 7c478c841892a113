"""Density of Gaussian data with shared errors, marginalised over these errors in closed form.

The residual r_jc of cell c in image j is

    r_jc = e_jc + sum_k H_jkc u_jk + G_jc g_c,        e ~ N(0, 1 / w),   u, g ~ N(0, 1)

where e is noise, u_jk the k-th error of a whole image (the strength or direction of its light, or
stray light), and g_c the error of a cell's pixels in all images (the gains of the pixels). The
factors H and G convert these errors to digital numbers. The density of r, marginalised over u and
g, follows from Woodbury's identity. With W the diagonal matrix of the weights w, D = 1 + sum_j w
G^2, and g eliminated first, the remaining matrix is

    M = 1 + H'W H - (H'W G) D^-1 (G'W H)

with one row for each image error. M is block diagonal if no g couples the images. The shared errors
are marginalised and never fitted as parameters, because with a free scale the joint density of
errors and scale has no maximum.

Source:
    Woodbury, "Inverting Modified Matrices", 1950; Searle, Casella & McCulloch, "Variance
    Components", 1992, chapter 6.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Float

Table = Float[Array, "images cells"]
OfImages = Float[Array, "images errors"]


class Residuals(eqx.Module):
    """Residuals of cells in images, with the errors that they share."""

    residual: Table  # r, DN
    weight: Table  # w, DN^-2; 0 for a cell without data
    image_errors: Float[Array, "images errors cells"] | None = None  # H, DN; None for no such error
    cell_errors: Table | None = None  # G, DN; None for no such error
    # inverse covariance of u, (images x errors) squared; None where it is 1
    precision: Array | None = None


def log_density(of: Residuals) -> Float[Array, ""]:
    """Return ln p(r), up to a constant."""
    square, log_volume = _parts(of)
    return -(square + log_volume) / 2


def chi_square(of: Residuals) -> Float[Array, ""]:
    """Return the chi-square r' C^-1 r, with C the covariance of r. The expectation of this
    chi-square is the number of cells with data.
    """
    return _parts(of)[0]


def _parts(of: Residuals) -> tuple[Array, Array]:
    """Return r' C^-1 r and ln det C, with C the covariance of r."""
    square = jnp.sum(of.weight * of.residual**2)
    log_volume = -jnp.sum(jnp.log(jnp.where(of.weight > 0, of.weight, 1)))
    if of.cell_errors is not None:
        pull, stiffness = _cell_sums(of, of.cell_errors)
        square = square - jnp.sum(pull**2 / stiffness)
        log_volume = log_volume + jnp.sum(jnp.log(stiffness))
    if of.image_errors is None:
        return square, log_volume
    factor, pull = _image_error_system(of, of.image_errors)
    explained = jax.vmap(lambda L, b: solve_triangular(L, b, lower=True))(factor, pull)
    log_volume = log_volume + 2 * jnp.sum(jnp.log(jnp.diagonal(factor, axis1=1, axis2=2)))
    return square - jnp.sum(explained**2), log_volume


def image_error_means(of: Residuals) -> tuple[OfImages, OfImages]:
    """Return posterior means and deviations of image errors given r, in prior deviations."""
    assert of.image_errors is not None
    factor, pull = _image_error_system(of, of.image_errors)
    shape = of.image_errors.shape[:2]
    mean = jax.vmap(lambda L, b: cho_solve((L, True), b))(factor, pull)
    unit = jnp.eye(factor.shape[1], dtype=factor.dtype)
    inverse = jax.vmap(lambda L: cho_solve((L, True), unit))(factor)
    spread = jnp.sqrt(jnp.diagonal(inverse, axis1=1, axis2=2))
    return mean.reshape(shape), spread.reshape(shape)


def _cell_sums(of: Residuals, errors: Table) -> tuple[Array, Array]:
    """Return G'W r and D, each (cells,)."""
    pull = jnp.sum(of.weight * errors * of.residual, axis=0)
    return pull, 1 + jnp.sum(of.weight * errors**2, axis=0)


def _image_error_system(of: Residuals, image_errors: Array) -> tuple[Array, Array]:
    """Return the Cholesky factors (blocks, n, n) of M, and the right hand sides (blocks, n) H'W r
    minus the part that g explains. Each image is a block of the matrix M. If the pixel errors g
    couple the images, M is a single block.
    """
    images, errors, cells = image_errors.shape
    weighted = of.weight[:, None] * image_errors
    pull = jnp.einsum("jkc,jc->jk", weighted, of.residual)
    own = jnp.einsum("jkc,jlc->jkl", weighted, image_errors)
    if of.precision is None:
        own = own + jnp.eye(errors, dtype=own.dtype)[None]
        if of.cell_errors is None:
            return jnp.linalg.cholesky(own), pull
    blocks = jnp.einsum("jkl,ji->jkil", own, jnp.eye(images, dtype=own.dtype))
    matrix, pull = blocks.reshape(images * errors, images * errors), pull.reshape(-1)
    if of.precision is not None:
        matrix = matrix + of.precision
    if of.cell_errors is not None:
        cell_pull, stiffness = _cell_sums(of, of.cell_errors)
        across = (weighted * of.cell_errors[:, None]).reshape(images * errors, cells)
        matrix = matrix - (across / stiffness[None]) @ across.T
        pull = pull - across @ (cell_pull / stiffness)
    return jnp.linalg.cholesky(matrix)[None], pull[None]


def scatter_log_density(
    scatter: Table,
    count: Table,
    variance: Table,
    *,
    pixel_errors: Table | None = None,
    products: Float[Array, "cells images images"] | None = None,
) -> Float[Array, ""]:
    """Return ln p of the scatter of each cell's pixels about their mean, up to a constant.

    `scatter` is the sum of n squared deviations in DN^2, with n - 1 degrees of freedom. `variance`
    is the variance of one pixel, DN^2. A pixel may have an error P_jc g, where g ~ N(0, 1) is the
    same in all images (`pixel_errors` P in DN). The scatter of a cell in all images then has a
    Wishart distribution of covariance diag(variance) + P P', which needs `products`, the sums of
    products of deviations in two images, DN^2.
    """
    freedom = jnp.maximum(count - 1, 0)
    total = -jnp.sum(freedom * jnp.log(variance) + scatter / variance) / 2
    if pixel_errors is None:
        return total
    assert products is not None
    seen = count > 0
    along = jnp.where(seen, pixel_errors / variance, 0)
    strength = 1 + jnp.sum(along * jnp.where(seen, pixel_errors, 0), axis=0)
    shared = jnp.einsum("jc,cji,ic->c", along, products, along) / strength
    # n is the same in every image that sees the cell
    freedom = jnp.max(freedom, axis=0)
    return total + jnp.sum(shared - freedom * jnp.log(strength)) / 2
