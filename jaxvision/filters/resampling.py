"""Resampling: resize pictures, or warp them by any map of positions.

Pixels are squares whose centres lie at whole rows and columns, so that n rows span -1/2 to n - 1/2.
Reductions in size are antialiased: `resize` widens its kernel by the factor, and `warp` averages
positions within each pixel of the result. Values are relative or DN; integer pictures are computed
as floating numbers.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers, warn_of_idle_fill
from ..core._types import check_choice, check_count, check_shape
from ..core.parallel_loops import map_
from ._neighbours import AnyPicture, Floats
from .padding import as_planes

_NOTHING = 1e-12  # largest rounding error, in float64, of a weight of 0
METHODS = ("nearest", "linear", "cubic", "lanczos3", "lanczos5")
BORDERS = {  # names of this library and of SciPy
    "clamp": "nearest",
    "constant": "constant",
    "mirror": "reflect",
    "reflect_101": "mirror",
}


@takes_numbers
def resize(
    picture: AnyPicture, size: tuple[int, int], *, method: str = "cubic", antialias: bool = True
) -> Floats:
    """Resize a picture, with the kernels of `jax.image.resize`.

    Args:
        picture: (h, w) or (..., h, w, bands), relative or DN.
        size: rows and columns of the result, each at least 1; static.
        method: "nearest", "linear" (a triangle), "cubic" (Keys, a = -1/2), "lanczos3" or
            "lanczos5". The last three overshoot at edges.
        antialias: whether to widen the kernel where the picture shrinks, so that every pixel
            contributes.

    Returns:
        A picture of `size`, or with batch and bands, in the picture's unit. Constants stay
        constant. NaN and infinity spread as far as the kernel reaches, and have gradient 0.

    Raises:
        ValueError: for an array that is no picture, an unknown method, and a size below 1.

    Example:
        >>> print(jv.filters.resize(jnp.arange(8.0)[None], (1, 2), method="linear").round(2))
        [[1.89 5.11]]
    """
    check_choice("method", method, METHODS)
    if not isinstance(size, tuple | list) or len(size) != 2:
        raise ValueError(f"size must be rows and columns, such as (480, 640), got {size!r}.")
    for count in size:
        check_count("size", count, 1)
    return _resize(picture, tuple(size), method, antialias)


@partial(jax.jit, static_argnames=("size", "method", "antialias"))
def _resize(picture: AnyPicture, size: tuple[int, int], method: str, antialias: bool) -> Floats:
    image, restore = as_planes(picture)
    n, h, w, c = image.shape
    if method == "nearest":
        return restore(jax.image.resize(image, (n, *size, c), method, antialias=antialias))
    known = jnp.isfinite(image)
    rows, columns = (
        _weights(side, count, method, antialias).astype(image.dtype)
        for side, count in zip((h, w), size, strict=True)
    )
    total = jnp.einsum(
        "ih,nhwc,jw->nijc",
        rows,
        jnp.where(known, image, 0),
        columns,
        precision=jax.lax.Precision.HIGHEST,
    )

    def propagate_nan() -> Floats:
        return _propagate_nan(total, image, rows, columns)

    return restore(jax.lax.cond(known.all(), lambda: total, propagate_nan))


def _weights(side: int, count: int, method: str, antialias: bool) -> Float[Array, "count side"]:
    """Return the matrix that resamples `side` to `count` samples, as
    `jax.image.scale_and_translate` does, but in double precision and exactly 0 outside the kernel.
    """
    with jax.enable_x64(True):
        scale = side / count
        middle = (jnp.arange(count, dtype=jnp.float64) + 0.5) * scale - 0.5
        away = jnp.abs(middle[:, None] - jnp.arange(side, dtype=jnp.float64)[None])
        x = away / max(scale, 1) if antialias else away
        match method:
            case "linear":
                weights = jnp.maximum(1 - x, 0)
            case "cubic":
                near, far = (1.5 * x - 2.5) * x * x + 1, ((2.5 - 0.5 * x) * x - 4) * x + 2
                weights = jnp.where(x < 1, near, jnp.where(x < 2, far, 0))
            case _:
                reach = int(method[-1])
                weights = jnp.where(x < reach, jnp.sinc(x) * jnp.sinc(x / reach), 0)
        weights = jnp.where(jnp.abs(weights) < _NOTHING, 0, weights)
        return weights / weights.sum(1, keepdims=True)


def _propagate_nan(total: Floats, image: Floats, rows: Floats, columns: Floats) -> Floats:
    """Return the sums of the finite values, replaced by NaN or infinity where such a value has a
    weight.
    """

    def count(chosen: Bool[Array, "..."], sign: int) -> Floats:
        """Count, for each pixel of the result, the chosen pixels whose weight has a given sign."""
        values = chosen.astype(jnp.float32)
        same, opposite = (
            jnp.einsum(
                "ih,nhwc,jw->nijc",
                (own * rows > 0).astype(jnp.float32),
                values,
                (sign * own * columns > 0).astype(jnp.float32),
            )
            for own in (1, -1)
        )
        return same + opposite

    positive, negative, nan = jnp.isposinf(image), jnp.isneginf(image), jnp.isnan(image)
    up = count(positive, 1) + count(negative, -1) > 0.5
    down = count(positive, -1) + count(negative, 1) > 0.5
    spoilt = (count(nan, 1) + count(nan, -1) > 0.5) | (up & down)
    return jnp.where(spoilt, jnp.nan, jnp.where(up, jnp.inf, jnp.where(down, -jnp.inf, total)))


@takes_numbers
def warp(
    picture: AnyPicture,
    rows: Float[Array, "h w"],
    columns: Float[Array, "h w"],
    *,
    samples: int = 1,
    border: str = "clamp",
    fill: Float[Array, ""] | float = 0.0,
) -> Floats:
    """Interpolate the picture linearly at given positions.

    Args:
        picture: (h', w') or (..., h', w', bands), relative or DN.
        rows: (h, w) row in the picture of each pixel of the result, pixels.
        columns: (h, w) column in the picture of each pixel of the result, pixels.
        samples: samples along each side of a pixel of the result, whose mean is taken; about the
            factor by which the map shrinks the picture. 1 takes the centre only. The map is
            interpolated linearly within a pixel of the result, so it needs at least two rows and
            columns.
        border: how values outside the picture are set: "clamp", "constant", "mirror" or
            "reflect_101".
        fill: () value outside with border "constant", in the picture's unit.

    Returns:
        (h, w), or with batch and bands, in the picture's unit.

    Raises:
        ValueError: for an array that is no picture, maps of unequal shape, an unknown border, and
            `samples` below 1.

    Example:
        >>> rows, columns = jnp.mgrid[0.5:2, 0.5:3]
        >>> print(jv.filters.warp(jnp.arange(12.0).reshape(3, 4), rows, columns))
        [[2.5 3.5 4.5]
         [6.5 7.5 8.5]]
    """
    check_choice("border", border, tuple(BORDERS))
    check_count("samples", samples, 1)
    check_shape("columns", columns, rows.shape)
    warn_of_idle_fill(fill, border)
    return _warp(picture, rows, columns, fill, samples, border)


@partial(jax.jit, static_argnames=("samples", "border"))
def _warp(
    picture: AnyPicture,
    rows: Float[Array, "h w"],
    columns: Float[Array, "h w"],
    fill: Float[Array, ""] | float,
    samples: int,
    border: str,
) -> Floats:
    image, restore = as_planes(picture)
    # JAX fills with 0 alone where the value may be traced.
    outside = jnp.asarray(fill if border == "constant" else 0, image.dtype)
    offsets = (jnp.arange(samples, dtype=image.dtype) + 0.5) / samples - 0.5
    places = jnp.stack([rows, columns]).astype(image.dtype)

    def sample_at(places: Float[Array, "2 h w"]) -> Float[Array, "images h w bands"]:
        def plane(values: Float[Array, "_ _"]) -> Float[Array, "h w"]:
            return map_coordinates(values, list(places), order=1, mode=BORDERS[border])

        return jax.vmap(jax.vmap(plane, -1, -1))(image - outside) + outside

    if samples == 1:
        return restore(sample_at(places))
    down, right = (jnp.gradient(places, axis=axis) for axis in (1, 2))
    shifts = jnp.stack(jnp.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    total = map_(lambda shift: sample_at(places + shift[1] * down + shift[0] * right), shifts)
    return restore(total.mean(axis=0))
