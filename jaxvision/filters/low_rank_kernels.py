"""Approximation of a kernel by the sum of a few separable kernels. The number of separable kernels,
the rank, sets the accuracy, and the error is reported.

The best approximation of each rank is the truncated singular value decomposition (Eckart and Young
1936; for filters: Treitel and Shanks 1971). Kernels and pictures may be in any unit.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import as_float
from ._terms import Fill, Separable, Settings, filtered
from .convolution import _anchor
from .padding import Filtered, Picture, check_border, check_picture


class LowRank(Shown):
    """A kernel k[i, j] as the sum over r of columns[r, i] rows[r, j].

    Attributes:
        columns: (rank, kh) factors down the columns, in the square root of the kernel's unit.
        rows: (rank, kw) factors along the rows, in the square root of the kernel's unit.
        error: () Frobenius norm of the missing part, in the kernel's unit. For a picture within
            [-1, 1] the error of a pixel is at most sqrt(kh kw) times `error`.
    """

    columns: Float[Array, "rank kh"] = eqx.field(converter=as_float)
    rows: Float[Array, "rank kw"] = eqx.field(converter=as_float)
    error: Float[Array, ""] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        shapes = self.columns.shape, self.rows.shape
        if any(len(s) != 2 for s in shapes) or shapes[0][0] != shapes[1][0]:
            raise ValueError(f"columns and rows must be (rank, taps) of one rank, got {shapes}.")


@takes_numbers
def low_rank(kernel: Float[Array | np.ndarray, "kh kw"], *, rank: int) -> LowRank:
    """Return the best approximation of a kernel by a sum of `rank` separable kernels.

    The approximation is differentiable if the singular values differ.

    Args:
        kernel: (kh, kw), any unit.
        rank: 1 to min(kh, kw).

    Returns:
        The factors and the error of the approximation.

    Raises:
        ValueError: for a rank outside [1, min(kh, kw)].

    Example:
        >>> disc = np.hypot(*np.mgrid[-3:4, -3:4]) <= 3
        >>> kernel = jnp.asarray(disc / disc.sum())
        >>> errors = [jv.filters.low_rank(kernel, rank=r).error for r in (1, 2, 3)]
        >>> print([f"{error:.3f}" for error in errors])
        ['0.061', '0.042', '0.000']
    """
    if not 1 <= rank <= min(kernel.shape):
        raise ValueError(f"rank must be in [1, {min(kernel.shape)}], got {rank}.")
    u, s, v = jnp.linalg.svd(kernel, full_matrices=False)
    root = jnp.sqrt(s[:rank])
    missing = jnp.zeros((), s.dtype) if rank == len(s) else jnp.linalg.norm(s[rank:])
    return LowRank((u[:, :rank] * root[None]).T, v[:rank] * root[:, None], missing)


@takes_numbers
def correlate_low_rank(
    picture: Picture,
    kernel: LowRank,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> Filtered:
    """Correlate a picture with a `LowRank` kernel, by one pass down the columns and one along the
    rows for each rank.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        kernel: factors from `low_rank`.
        anchor: (row, column) of the kernel entry that lies on the pixel; None for the middle.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        The picture's shape; its unit times the kernel's.

    Raises:
        ValueError: for an anchor outside the kernel and an unknown border.
    """
    check_picture(picture)
    check_border(border)
    size = kernel.columns.shape[1], kernel.rows.shape[1]
    terms = tuple(map(Separable, kernel.columns, kernel.rows))
    return filtered(picture, terms, fill, Settings(_anchor(anchor, size), border, "separable"))
