"""Estimate the colours of foreground and background in a picture of known coverage.

The colours F and B minimise, band by band,

    sum_i (alpha F + (1 - alpha) B - I)^2
        + sum_ij (regularisation + |alpha_i - alpha_j|) ((F_i - F_j)^2 + (B_i - B_j)^2)

over pixels i and their four neighbours j. The estimated colours are smooth, especially where alpha
changes.
Source: Germer, Uelwer, Conrad, Harmeling, "Fast Multi-Level Foreground Estimation", ICPR 2020.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ..core._arguments import takes_numbers
from ..core._types import Scalar, as_relative, print_by_name
from ..core.parallel_loops import fori_loop
from .compositing import checked_alpha

Picture = Float[Array, "h w bands"]
Alpha = Float[Array, "h w 1"]
print_by_name(globals(), "Picture", "Alpha")


@takes_numbers
def estimate_foreground(
    image: Picture,
    alpha: Float[Array, "rows columns 1"],
    *,
    regularisation: float = 1e-5,
    coarse_steps: int = 10,
    fine_steps: int = 4,
) -> tuple[Picture, Picture]:
    """Estimate the straight colours of foreground and background in every pixel, including hidden
    pixels.

    The solver starts with one pixel and doubles the size from level to level up to the whole
    picture. Each step solves the equations of every pixel exactly, with the neighbours fixed. For a
    layer of `compositing`, multiply the foreground by alpha and append alpha.

    Four `fine_steps` are fast, not exact. In the soft edge of a disc on 256 x 256 pixels the RMS
    error of the layer, in relative light, is 0.0142 with four steps, 0.0102 with 40, and 0.0094 at
    the exact minimum.

    Args:
        image: (h, w, bands) linear relative light.
        alpha: (h, w, 1) coverage in [0, 1], no unit.
        regularisation: no unit, above 0.
        coarse_steps: steps per level, up to 32 pixels along each side.
        fine_steps: steps per level of larger size.

    Returns:
        The foreground and the background, each (h, w, bands) relative light, at least 0.

    Raises:
        ValueError: for shapes that do not match and, unless traced, for an alpha outside [0, 1] or
            not finite and a `regularisation` that is not above 0. If traced, a single NaN makes
            both pictures NaN everywhere.

    Example:
        >>> alpha = np.array([[[1.0], [0.5], [0.0], [0.0]]] * 4)
        >>> picture = alpha * 0.8 + (1 - alpha) * 0.2
        >>> front, behind = jv.matting.estimate_foreground(picture, alpha)
        >>> print(np.asarray(front)[0, :2, 0].round(2), np.asarray(behind)[0, 1:, 0].round(2))
        [0.8 0.8] [0.2 0.2 0.2]
    """
    image, alpha = as_relative(image), checked_alpha(alpha)
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image must be (h, w, bands) and not empty, got shape {image.shape}.")
    if not isinstance(regularisation, Tracer) and not regularisation > 0:
        raise ValueError(f"regularisation must be above 0, got {regularisation}.")
    if alpha.shape != (*image.shape[:2], 1):
        raise ValueError(
            f"alpha must be (h, w, 1) for its image (h, w, bands), got {alpha.shape} and "
            f"{image.shape}."
        )
    return _solve_levels(image, alpha, regularisation, coarse_steps, fine_steps)


@partial(jax.jit, static_argnames=("coarse_steps", "fine_steps"))
def _solve_levels(
    image: Picture, alpha: Alpha, regularisation: Scalar, coarse_steps: int, fine_steps: int
) -> tuple[Picture, Picture]:
    """Estimate both colours from checked arguments, with one compiled program for each size."""
    rows, columns = image.shape[:2]
    levels = max(math.ceil(math.log2(max(rows, columns))), 0)
    foreground = background = jnp.mean(image, axis=(0, 1), keepdims=True)
    for level in range(levels + 1):
        shape = tuple(max(1, round(n ** (level / max(levels, 1)))) for n in (rows, columns))
        if level == levels:
            shape = (rows, columns)
        foreground, background = (_nearest(x, shape) for x in (foreground, background))
        steps = coarse_steps if max(shape) <= 32 else fine_steps
        foreground, background = _relax(
            foreground,
            background,
            _nearest(image, shape),
            _nearest(alpha, shape),
            regularisation,
            steps,
        )
    return jnp.maximum(foreground, 0), jnp.maximum(background, 0)


def _relax(
    foreground: Picture,
    background: Picture,
    image: Picture,
    alpha: Alpha,
    regularisation: Scalar,
    steps: int,
) -> tuple[Picture, Picture]:
    """Iterate by Jacobi's method, which solves each pixel's two equations with its neighbours j
    fixed:

    (alpha^2 + w) F + alpha (1 - alpha) B = alpha I + sum_j w_j F_j
    alpha (1 - alpha) F + ((1 - alpha)^2 + w) B = (1 - alpha) I + sum_j w_j B_j
    """
    weights = [regularisation + jnp.abs(alpha - near) for near in _neighbours(alpha)]
    total = weights[0] + weights[1] + weights[2] + weights[3]
    rest = 1 - alpha
    own, other, cross = alpha * alpha + total, rest * rest + total, alpha * rest
    determinant = total * (alpha * alpha + rest * rest + total)  # own other - cross^2

    def step(_: Int[Array, ""], both: tuple[Picture, Picture]) -> tuple[Picture, Picture]:
        f, b = (sum(w * x for w, x in zip(weights, _neighbours(p), strict=True)) for p in both)
        f, b = alpha * image + f, rest * image + b
        return (other * f - cross * b) / determinant, (own * b - cross * f) / determinant

    return fori_loop(0, steps, step, (foreground, background))


def _neighbours(x: Picture) -> tuple[Picture, Picture, Picture, Picture]:
    """Return the pixels above, below, left and right of each pixel. At the border the pixel itself
    stands for the missing neighbour, which slows the iteration there but does not change its limit.
    """
    return (
        jnp.concatenate([x[:1], x[:-1]]),
        jnp.concatenate([x[1:], x[-1:]]),
        jnp.concatenate([x[:, :1], x[:, :-1]], axis=1),
        jnp.concatenate([x[:, 1:], x[:, -1:]], axis=1),
    )


def _nearest(x: Picture, shape: tuple[int, ...]) -> Float[Array, "rows columns bands"]:
    """Resample to another number of rows and columns by nearest neighbours."""
    i, j = (jnp.arange(wanted) * n // wanted for wanted, n in zip(shape, x.shape, strict=False))
    return x[i][:, j]
