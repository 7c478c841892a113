"""Filters for scipy's solvers: as a sparse matrix, or as a linear operator and its transpose.

Pixels are ordered row by row, with values in any unit. The results are NumPy arrays; nothing is
traced.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.sparse import BCOO

from .matrix import MatrixForm
from .operators import _check_no_offset
from .padding import Filtered

if TYPE_CHECKING:
    import scipy.sparse
    import scipy.sparse.linalg


def scipy_matrix(matrix: MatrixForm | BCOO) -> "scipy.sparse.csr_array":
    """Convert a filter's matrix to scipy's sparse format, and add entries with the same row and
    column.

    Args:
        matrix: (rows, columns), any unit: from `filter_matrix`, or a sparse matrix of JAX.

    Returns:
        (rows, columns) in the same unit.

    Raises:
        ValueError: for a filter with an offset, which a matrix cannot represent.

    Example:
        >>> form = jv.filters.filter_matrix([1.0, 2.0, 1.0], shape=4, border="zero")
        >>> print(jv.filters.scipy_matrix(form) @ np.ones(4))
        [3. 4. 4. 3.]
    """
    from scipy import sparse

    if isinstance(matrix, MatrixForm):
        if matrix.offset is not None:
            raise ValueError(
                'a filter with an offset is no matrix alone: take border "zero", or convert '
                "form.matrix and add form.offset."
            )
        matrix = matrix.matrix

    rows, columns = np.asarray(matrix.indices).T
    whole = sparse.coo_array((np.asarray(matrix.data), (rows, columns)), shape=matrix.shape)
    return whole.tocsr()


def scipy_operator(
    operator: Callable[[Filtered], Filtered], shape: tuple[int, ...], *, dtype: type = np.float64
) -> "scipy.sparse.linalg.LinearOperator":
    """Return a linear filter as scipy's LinearOperator, which computes H @ f and H.T @ g without a
    matrix.

    Args:
        operator: the filter, from pictures to pictures of the same shape, any unit.
        shape: (h, w) or (..., h, w, bands) of the pictures.
        dtype: of the computation.

    Returns:
        The operator on vectors of (h w,), or of all numbers of the shape.

    Raises:
        ValueError: for a filter with an offset, as for `adjoint`.
    """
    from scipy.sparse.linalg import LinearOperator

    _check_no_offset(operator, shape, dtype)

    blank = jax.ShapeDtypeStruct(shape, dtype)
    forward = jax.jit(operator)
    backward = jax.jit(jax.linear_transpose(operator, blank))
    size = int(np.prod(shape))

    def apply(f: np.ndarray) -> np.ndarray:
        return np.asarray(forward(jnp.asarray(f, dtype).reshape(shape))).ravel()

    def transpose(g: np.ndarray) -> np.ndarray:
        return np.asarray(backward(jnp.asarray(g, dtype).reshape(shape))[0]).ravel()

    return LinearOperator(  # pyright: ignore[reportCallIssue]
        (size, size),
        matvec=apply,  # pyright: ignore[reportCallIssue]
        rmatvec=transpose,  # pyright: ignore[reportCallIssue]
        dtype=np.dtype(dtype),  # pyright: ignore[reportCallIssue]
    )
