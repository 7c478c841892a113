"""Non-local means (Buades, Coll & Morel, CVPR 2005), computed exactly from their definition, with a
weight for every neighbour:

    g(p) = sum_q w f(q) / sum_q w,    w = exp(-max(D(p, q) - 2 noise^2, 0) / strength^2),

where D is the mean squared difference of the patches about p and q over their pixels (weighted by a
profile) and bands, and q lies in a square about p. A neighbour has the same weight in all bands.
`strength` and `noise` are in the unit of the image: relative or DN.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from ..core._arguments import takes_numbers
from ..core._numerics import log_of_zero
from ..core._types import Scalars, check_choice, check_count
from ._neighbours import Plane, Planes, inverse, planes_of, scaled_guide, weighted_mean
from .padding import Filtered, Picture, check_border


@takes_numbers
@functools.partial(jax.jit, static_argnames=("patch", "radius", "profile", "border"))
def nonlocal_means_filter(
    picture: Picture,
    strength: float | Scalars,
    *,
    noise: float | Scalars = 0.0,
    patch: int = 7,
    radius: int = 11,
    profile: str = "uniform",
    cutoff: float | Scalars | None = None,
    border: str = "mirror",
) -> Filtered:
    """Replace each pixel by the mean of the pixels with similar surroundings.

    For a strength of 0 or below the result is the limit: a mean over equal patches only. A pixel
    becomes NaN if its search window, or a patch about a pixel of that window, contains NaN.

    scikit-image's `denoise_nl_means` differs: it has the Gaussian profile, a cutoff of 5 and an
    approximate exp (with `fast_mode`, uniform patches one row and column smaller than asked for).

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        strength: () in the picture's unit, scale of the patch difference at which weights fall off;
            about the standard deviation of the noise.
        noise: () in the picture's unit, standard deviation of the noise; its expected contribution
            to D is subtracted.
        patch: side of the patches in pixels, odd.
        radius: of the search window in pixels, at least 0.
        profile: weights of D over a patch, "uniform", or "gaussian" with a standard deviation of
            (patch - 1) / 4 pixels.
        cutoff: () no unit; neighbours with a larger exponent have weight 0. None for no cutoff.
        border: any key of `padding.BORDERS` except "constant". With "normalised_zero", pixels
            outside the picture are not averaged; in the comparison of patches they count as 0.

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for an unknown profile or border, an even patch, and a radius below 0.
    """
    check_choice("profile", profile, ("uniform", "gaussian"))
    check_count("patch", patch, 1, odd=True)
    check_count("radius", radius, 0)
    check_border(border, refused=("constant",))
    values, restore = planes_of(picture)
    dtype = values[0].dtype
    guide, (strength, noise) = scaled_guide(values, strength, noise, dtype=dtype)
    scale = inverse(strength, dtype)
    taps = _taps(patch, profile)
    noise_share = 2 * (scale * noise) ** 2

    def weight_of(change: Planes, dy: Int[Array, ""], dx: int) -> Plane:
        square = functools.reduce(jnp.add, ((scale * c) ** 2 for c in change))
        distance = _average(_average(square, taps, 1), taps, 2) / len(change)
        exponent = jnp.maximum(distance - noise_share, 0)
        weight = jnp.exp(-jnp.minimum(exponent, -log_of_zero(dtype)))
        return weight if cutoff is None else jnp.where(exponent > cutoff, 0, weight)

    mean = weighted_mean(
        values,
        guide,
        weight_of,
        radius=radius,
        border=border,
        margin=patch // 2,
    )
    return restore(mean)


def _taps(patch: int, profile: str) -> np.ndarray:
    """Return the (patch,) weights along a side of a patch; their sum is 1."""
    if profile == "uniform" or patch == 1:
        return np.full(patch, 1 / patch)
    place = np.arange(patch) - patch // 2
    bell = np.exp(-(place**2) / (2 * ((patch - 1) / 4) ** 2))
    return bell / bell.sum()


def _average(plane: Plane, taps: np.ndarray, axis: int) -> Plane:
    """Return the weighted sum of neighbours along an axis, at the pixels whose neighbours all
    exist. The neighbours are shifted and added, because a running sum would lose the digits of
    small distances.
    """
    count = plane.shape[axis] - len(taps) + 1
    parts = (
        float(tap) * lax.slice_in_dim(plane, i, i + count, axis=axis) for i, tap in enumerate(taps)
    )
    return functools.reduce(jnp.add, parts)
