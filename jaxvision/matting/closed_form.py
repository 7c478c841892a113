"""Closed-form matting: the smoothest alpha, in the sense of the matting Laplacian L, that agrees
with a trimap.

    L_UU alpha_U = -L_UK s_K        or, with a confidence c,        (L + c D) alpha = c D s

K are the pixels whose alpha s is given by the trimap, U are the other pixels, and D is the diagonal
that marks K (Levin, Lischinski, Weiss, PAMI 30 (2008), equation 12, and its limit of full
confidence). The equation is solved by conjugate gradients with a multigrid preconditioner.
Derivatives are computed by one more solve, not by differentiating the solver's steps.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import Scalar, as_relative, is_known
from ..core._warnings import warn_caller
from ..errors import InputError
from ._laplacian import apply_stencil, matting_laplacian, restricted_to
from ._multigrid import coarsen, v_cycle

BACKGROUND, FOREGROUND = 0.1, 0.9
# Smallest epsilon, divided by the machine epsilon and by the square of the largest light
ROUNDING = 0.5
STEPS = 500  # largest number of steps of the solver


class Matte(Shown):
    """A coverage, and whether the solver that computed it converged.

    Attributes:
        alpha: (h, w, 1) in [0, 1], no unit.
        converged: () whether the solver met its tolerance; if not, raise `max_steps`, or in float32
            `epsilon`.
    """

    alpha: Float[Array, "h w 1"]
    converged: Bool[Array, ""]


@takes_numbers
def closed_form_matte(
    image: Float[Array, "h w bands"],
    trimap: Float[Array, "rows columns"],
    *,
    epsilon: float = 1e-7,
    confidence: float | None = None,
    tolerance: float | None = None,
    max_steps: int = STEPS,
) -> Matte:
    """Compute the matte of a picture from a trimap.

    The first call for a size of picture compiles for some seconds. Later calls take a fraction of a
    second.

    Args:
        image: (h, w, bands) linear relative light, at least 3 x 3 pixels.
        trimap: (h, w) no unit: up to 0.1 is background, from 0.9 on foreground, between is unknown.
        epsilon: regularisation of windows of one colour, in the square of relative light, above 0.
            Values below the rounding of the picture's squares are raised to it.
        confidence: c, no unit, above 0; 100 in the paper. None for an exact trimap.
        tolerance: of the residual relative to the right-hand side, no unit. None takes 1e-7 in
            float64 and 1e-6 in float32.
        max_steps: largest number of steps of the solver.

    Returns:
        The alpha (h, w, 1), and whether the solver converged.

    Raises:
        ValueError: for shapes that do not match, for integer codes, and for an `epsilon` or
            `confidence` that is not above 0 (unless traced).
        InputError: for NaN, and for a trimap without foreground or without background (unless
            traced). If traced, NaN gives a matte of NaN, and such a trimap gives a constant matte.

    Example:
        >>> picture = np.repeat([[[0.1], [0.1], [0.5], [0.9], [0.9]]], 3, axis=0)  # a soft edge
        >>> trimap = np.repeat([[0.0, 0.0, 0.5, 1.0, 1.0]], 3, axis=0)
        >>> matte = jv.matting.closed_form_matte(picture, trimap)
        >>> print(matte.alpha[1, :, 0].round(2), matte.converged)
        [0.  0.  0.5 1.  1. ] True
    """
    image, trimap = as_relative(image), as_relative(trimap)
    if image.ndim != 3 or min(image.shape[:2]) < 3:
        raise ValueError(
            f"image must be (h, w, bands) of at least 3 x 3 pixels, got shape {image.shape}."
        )
    for name, number in (("epsilon", epsilon), ("confidence", confidence)):
        if number is not None and is_known(number) and not np.asarray(number) > 0:
            raise ValueError(f"{name} must be above 0, got {number}.")
    if image.shape[:2] != trimap.shape:
        raise ValueError(
            f"image and trimap must have the same rows and columns, got {image.shape} and "
            f"{trimap.shape}."
        )
    _check_numbers(image, trimap)
    _warn_of_no_effect(image, trimap, epsilon, confidence)
    dtype = image.dtype
    if dtype.itemsize < 4:  # half precision is too small for the windows' covariances
        image, trimap = image.astype(jnp.float32), trimap.astype(jnp.float32)
    if tolerance is None:
        tolerance = _least_residual(image)
    matte = _solve(image, trimap, epsilon, confidence, tolerance, max_steps)
    return Matte(matte.alpha.astype(dtype), matte.converged)


def _least_residual(image: Array) -> float:
    """Return the relative residual that the solver can reach in the image's precision."""
    return 1e-7 if image.dtype == jnp.float64 else 1e-6


@partial(jax.jit, static_argnames="max_steps")
def _solve(
    image: Float[Array, "h w bands"],
    trimap: Float[Array, "h w"],
    epsilon: Scalar,
    confidence: Scalar | None,
    tolerance: Scalar,
    max_steps: int,
) -> Matte:
    """Compute the matte from checked arguments, with one compiled program for each size."""
    known = ((trimap <= BACKGROUND) | (trimap >= FOREGROUND)).astype(image.dtype)
    # a pixel whose trimap is NaN is neither known nor unknown
    known = jnp.where(jnp.isnan(trimap), jnp.nan, known)
    alpha_known = (trimap >= FOREGROUND).astype(image.dtype)
    # smaller values of epsilon are lost in the rounding of the windows' covariances
    rounding = ROUNDING * jnp.finfo(image.dtype).eps * jnp.max(image, initial=0) ** 2
    laplacian = matting_laplacian(
        image, epsilon=jnp.maximum(epsilon, jax.lax.stop_gradient(rounding))
    )
    if confidence is None:
        unknown = 1 - known
        system = restricted_to(laplacian, unknown).at[2, 2].add(known)
        wanted = alpha_known - unknown * apply_stencil(laplacian, alpha_known)
    else:
        system = laplacian.at[2, 2].add(confidence * known)
        wanted = confidence * alpha_known
    grids = coarsen(jax.lax.stop_gradient(system))
    solution, _ = jax.scipy.sparse.linalg.cg(
        lambda x: apply_stencil(system, x),
        wanted,
        tol=tolerance,  # pyright: ignore[reportArgumentType]: it may be traced
        maxiter=max_steps,
        M=lambda r: v_cycle(grids, r),
    )
    # recomputed, because the solver updates its residual, which accumulates rounding errors
    left = jnp.linalg.norm(wanted - apply_stencil(system, solution))
    converged = left <= 4 * tolerance * jnp.linalg.norm(wanted)
    solution = jnp.where(jnp.isnan(left), left, solution)  # NaN if the solver could not start
    return Matte(jnp.clip(solution, 0, 1)[..., None], converged)


def _warn_of_no_effect(
    image: Array, trimap: Array, epsilon: Scalar | float, confidence: Scalar | float | None
) -> None:
    """Warn if the matte does not depend on the picture, or hardly depends on it."""
    if is_known(trimap) and confidence is None:
        marks = np.asarray(trimap)
        if not ((marks > BACKGROUND) & (marks < FOREGROUND)).any():
            warn_caller(
                "The trimap has no unknown pixels (between 0.1 and 0.9), so the matte is the "
                "trimap; mark the pixels to be estimated, for example by 0.5."
            )
            return
    if is_known(image) and is_known(epsilon):
        spread = np.asarray(image, float).std(axis=(0, 1)).max()
        if spread**2 < float(epsilon):
            warn_caller(
                f"The picture varies by {spread:.2g} about its mean, which is less than the "
                f"square root of epsilon = {float(epsilon):.2g}, so alpha hardly depends on it; "
                "scale the picture to about 1, or give a smaller epsilon."
            )


def _check_numbers(image: Array | np.ndarray, trimap: Array | np.ndarray) -> None:
    if not (is_known(image) and is_known(trimap)):
        return
    image, trimap = np.asarray(image), np.asarray(trimap)
    for name, numbers in (("picture", image), ("trimap", trimap)):
        wrong = int(np.sum(~np.isfinite(numbers)))
        if wrong:
            raise InputError(
                f"The {name} holds {wrong} numbers that are not finite; repair or mask them."
            )
    if float(trimap.min()) < 0 or float(trimap.max()) > 1:
        raise InputError("The trimap leaves [0, 1]; divide integer codes by their largest.")
    for kind, pixels in (
        ("foreground (0.9 and above)", trimap >= FOREGROUND),
        ("background (0.1 and below)", trimap <= BACKGROUND),
    ):
        if not bool(pixels.any()):
            raise InputError(f"The trimap has no {kind}; mark some pixels of it.")
