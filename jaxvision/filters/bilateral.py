"""The bilateral filter (Tomasi & Manduchi, ICCV 1998) and the joint bilateral filter (Petschnigg et
al.; Eisemann & Durand, SIGGRAPH 2004), computed exactly from their definition, with a weight for
every neighbour:

    g(p) = sum_q w f(q) / sum_q w,
    w = exp(-|p - q|^2 / (2 sigma_space^2)) exp(-d(p, q)^2 / (2 sigma_range^2)),

where d is the difference of the guide's colours (for the bilateral filter, the guide is the image
itself). A neighbour has the same weight in all bands. `sigma_space` is in pixels; values, and with
them `sigma_range`, are relative or DN.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..core._arguments import takes_numbers
from ..core._numerics import log_of_zero
from ..core._types import Scalars, check_choice, check_count
from ._neighbours import (
    AnyPicture,
    Floats,
    Plane,
    Planes,
    inverse,
    planes_of,
    scaled_guide,
    weighted_mean,
)
from .padding import check_border


@takes_numbers
def bilateral_filter(
    picture: AnyPicture,
    sigma_space: float | Scalars,
    sigma_range: float | Scalars,
    *,
    radius: int,
    window: str = "square",
    difference: str = "euclidean",
    border: str = "mirror",
) -> Floats:
    """Smooth a picture within regions, but not across edges.

    For a sigma of 0 or below the result is the limit: a mean over the pixel itself only
    (`sigma_space`), or over equal colours only (`sigma_range`). NaN spreads to every pixel whose
    window contains it.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        sigma_space: () in pixels.
        sigma_range: () in the picture's unit.
        radius: of the neighbourhood in pixels, at least 0; beyond 3 sigma_space the weights are
            negligible.
        window: "square" of 2 radius + 1 pixels, or "disc" (as in OpenCV).
        difference: of two colours, "euclidean" or the "sum" of absolute values (as in OpenCV).
        border: a key of `padding.BORDERS` but "constant"; with "normalised_zero" pixels outside
            have no weight.

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for a radius below 0 and for an unknown window, difference or border.

    Example:
        >>> edge = np.array([[0.1, 0.12, 0.9, 0.92]] * 3)
        >>> print(np.asarray(jv.filters.bilateral_filter(edge, 2.0, 0.05, radius=1))[1].round(2))
        [0.11 0.11 0.91 0.91]
    """
    return joint_bilateral_filter(
        picture,
        picture,
        sigma_space,
        sigma_range,
        radius=radius,
        window=window,
        difference=difference,
        border=border,
    )


@takes_numbers
@functools.partial(jax.jit, static_argnames=("radius", "window", "difference", "border"))
def joint_bilateral_filter(
    picture: AnyPicture,
    guide: AnyPicture,
    sigma_space: float | Scalars,
    sigma_range: float | Scalars,
    *,
    radius: int,
    window: str = "square",
    difference: str = "euclidean",
    border: str = "mirror",
) -> Floats:
    """Smooth a picture except across the edges of another picture, such as one taken with flash.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        guide: the picture whose edges are kept, of the same h, w and batch, with any number of
            bands.
        sigma_space: () in pixels.
        sigma_range: () in the guide's unit.
        radius: of the neighbourhood in pixels, at least 0.
        window: "square" or "disc".
        difference: of two colours, "euclidean" or the "sum" of absolute values.
        border: a key of `padding.BORDERS` but "constant".

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: as for `bilateral_filter`, and for a guide of another size.
    """
    check_count("radius", radius, 0)
    check_choice("window", window, WINDOWS)
    check_choice("difference", difference, DIFFERENCES)
    check_border(border, refused=("constant",))
    values, restore = planes_of(picture)
    edges, _ = planes_of(guide)
    if values[0].shape != edges[0].shape:
        raise ValueError(
            "picture and guide must agree but for their bands, got "
            f"{jnp.shape(picture)} and {jnp.shape(guide)}."
        )
    dtype = values[0].dtype
    edges, (in_its_range,) = scaled_guide(edges, sigma_range, dtype=dtype)
    in_space, in_range = inverse(sigma_space, dtype), inverse(in_its_range, dtype)
    square = DIFFERENCES[difference]

    def weight_of(change: Planes, dy: Int[Array, ""], dx: int) -> Plane:
        away = in_space**2 * _square(dy, dx).astype(dtype)
        unlike = square(tuple(in_range.astype(c.dtype) * c for c in change)).astype(dtype)
        return jnp.exp(-jnp.minimum((away + unlike) / 2, -log_of_zero(dtype)))

    def is_inside_disc(dy: Int[Array, ""], dx: int) -> Bool[Array, ""]:
        return _square(dy, dx) <= radius**2

    mean = weighted_mean(
        values,
        edges,
        weight_of,
        radius=radius,
        border=border,
        taken=is_inside_disc if window == "disc" else None,
    )
    return restore(mean)


def _square(dy: Int[Array, ""], dx: int) -> Int[Array, ""]:
    return dy**2 + dx**2


WINDOWS = ("square", "disc")
DIFFERENCES = {
    "euclidean": lambda change: functools.reduce(jnp.add, (c**2 for c in change)),
    "sum": lambda change: functools.reduce(jnp.add, (jnp.abs(c) for c in change)) ** 2,
}
