"""Filters for scipy: a sparse matrix, or an operator with its transpose, for its solvers. Pixels
row by row, values in any unit; NumPy comes out, nothing is traced."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.sparse import BCOO

from ..padding import Filtered
from .operators import _check_no_offset

if TYPE_CHECKING:
    import scipy.sparse
    import scipy.sparse.linalg


def scipy_matrix(matrix: BCOO) -> "scipy.sparse.csr_array":
    """A sparse matrix of JAX as one of scipy, entries of one place added up."""
    from scipy import sparse

    rows, columns = np.asarray(matrix.indices).T
    whole = sparse.coo_array((np.asarray(matrix.data), (rows, columns)), shape=matrix.shape)
    return whole.tocsr()


def scipy_operator(
    operator: Callable[[Filtered], Filtered], shape: tuple[int, ...], *, dtype: type = np.float64
) -> "scipy.sparse.linalg.LinearOperator":
    """A linear filter of pictures of that shape as scipy's LinearOperator: H @ f and H.T @ g on
    flat vectors, without a matrix. `ValueError` for a filter with an offset, as for `adjoint`."""
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
