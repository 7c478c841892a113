"""The matting Laplacian as a stencil: 25 coefficients per pixel instead of a sparse matrix.

    L = sum over 3 x 3 windows of  I - (1 + X^T (Sigma + epsilon / 9 I)^-1 X) / 9

X (bands, 9) are the colours of a window minus their mean, and Sigma is their covariance. The
matting cost, alpha^T L alpha, is 0 for an alpha that is an affine function of the colours in every
window. A stencil is (5, 5, h, w). Its entry [dy + 2, dx + 2, y, x] multiplies pixel (y + dy, x +
dx), and is 0 if this pixel is outside. Light is relative. Source: Levin, Lischinski, Weiss, "A
Closed-Form Solution to Natural Image Matting", PAMI 30 (2008), equation 5.
"""

from itertools import product

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..core._types import Scalar, Scalars
from ..core.parallel_loops import fori_loop

Stencil = Float[Array, "5 5 h w"]
Plane = Float[Array, "h w"]

_WINDOW = tuple(product(range(3), repeat=2))


def matting_laplacian(
    image: Float[Array, "h w bands"], *, epsilon: Scalar | float = 1e-7
) -> Stencil:
    """Return the stencil of a picture (h, w, bands) with any number of bands. `epsilon` is in the
    square of relative light. Raise `ValueError` below 3 x 3 pixels.
    """
    rows, columns, bands = image.shape
    if min(rows, columns) < 3:
        raise ValueError(f"image must be at least 3 x 3 pixels, got {rows} x {columns}.")
    whitened = _whitened_windows(image, epsilon / 9)

    def coefficient(dy: int, dx: int) -> Plane:
        total = jnp.zeros((rows, columns), image.dtype)
        for n, (i, j) in enumerate(_WINDOW):
            if 0 <= i + dy < 3 and 0 <= j + dx < 3:
                m = 3 * (i + dy) + j + dx
                affinity = (1 + sum(whitened[n][b] * whitened[m][b] for b in range(bands))) / 9
                # the window's corner is at (y - i, x - j)
                total = total + jnp.pad(float(n == m) - affinity, ((i, 2 - i), (j, 2 - j)))
        return total

    return jnp.stack(
        [jnp.stack([coefficient(dy, dx) for dx in range(-2, 3)]) for dy in range(-2, 3)]
    )


def apply_stencil(stencil: Stencil, x: Plane) -> Plane:
    """Multiply the stencil's matrix by a picture of one band, (h, w), relative."""
    rows, columns = x.shape
    padded = jnp.pad(x, 2)

    def add_row(i: Int[Array, ""], total: Plane) -> Plane:
        band = jax.lax.dynamic_slice_in_dim(padded, i, rows)
        return total + sum(stencil[i, j] * band[:, j : j + columns] for j in range(5))

    # a loop over rows of taps, because one expression of all 25 taps compiles five times as long
    return fori_loop(0, 5, add_row, jnp.zeros_like(x))


def restricted_to(stencil: Stencil, kept: Plane) -> Stencil:
    """Return the stencil with its matrix set to 0 in the rows and columns of all pixels whose
    `kept`, (h, w), is 0 rather than 1.
    """
    rows, columns = kept.shape
    padded = jnp.pad(kept, 2)
    there = [[padded[i : i + rows, j : j + columns] for j in range(5)] for i in range(5)]
    return stencil * kept[None, None] * jnp.stack([jnp.stack(row) for row in there])


def _whitened_windows(
    image: Float[Array, "h w bands"], floor: Scalar | float
) -> list[list[Scalars]]:
    """Return the whitened colours C^-1 (colour - mean) of all windows, as [pixel of the
    window][band], each (h - 2, w - 2). C is the Cholesky factor of the covariance with `floor`
    added to its diagonal.
    """
    rows, columns, bands = image.shape
    colours = [
        [image[i : i + rows - 2, j : j + columns - 2, b] for b in range(bands)] for i, j in _WINDOW
    ]
    mean = [sum(pixel[b] for pixel in colours) / 9 for b in range(bands)]
    centred = [[pixel[b] - mean[b] for b in range(bands)] for pixel in colours]
    factor: list[list[Scalars]] = []
    for b in range(bands):
        row: list[Scalars] = []
        for c in range(b + 1):
            covariance = sum(pixel[b] * pixel[c] for pixel in centred) / 9
            rest = covariance - sum(p * q for p, q in zip(row, [*factor, row][c], strict=False))
            row.append(
                jnp.sqrt(jnp.maximum(rest + floor, floor)) if b == c else rest / factor[c][c]
            )
        factor.append(row)

    def whiten(pixel: list[Scalars]) -> list[Scalars]:
        solved: list[Scalars] = []
        for b in range(bands):
            known = sum(p * q for p, q in zip(factor[b], solved, strict=False))
            solved.append((pixel[b] - known) / factor[b][b])
        return solved

    return [whiten(pixel) for pixel in centred]
