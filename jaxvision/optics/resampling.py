"""Interpolation between pixels, distortion of pictures, and lateral chromatic aberration.

Coordinates are (row, column) in pixels, with (0, 0) the centre of the upper left pixel. Outside the
picture the values of its border pixels are repeated. Values keep their unit.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, warn_caller
from ..core._types import Image, Scalars, check_choice, is_known, print_by_name
from ..scene import Pinhole, ThinLens
from ..scene.folds import folded_share
from .distortion import distort, undistort
from .views import pixel_grid, pixel_offset, sensor_vergence

INTERPOLATIONS = ("linear", "cubic")

Coordinates = Float[Array, "rows columns"]
print_by_name(globals(), "Coordinates")


@takes_numbers
def sample_image(
    image: Image, row: Coordinates, column: Coordinates, *, interpolation: str = "cubic"
) -> Float[Array, "..."]:
    """Interpolate an image at pixel coordinates.

    Args:
        image: (..., h, w, bands) in any unit.
        row: (rows, columns) pixels.
        column: (rows, columns) pixels.
        interpolation: "linear", or "cubic", which reproduces parabolas but may overshoot.

    Returns:
        (..., rows, columns, bands) in the unit of the image.

    Raises:
        ValueError: `interpolation` is neither "linear" nor "cubic", or the image has no pixel.

    Source:
        Keys, "Cubic Convolution Interpolation for Digital Image Processing", IEEE Trans. ASSP 29
        (1981).

    Example:
        >>> row = [[[1.0], [2.0], [4.0]]]
        >>> print(jv.optics.sample_image(row, [[0.0]], [[1.5]], interpolation="linear").ravel())
        [3.]
    """
    check_choice("interpolation", interpolation, INTERPOLATIONS)
    image = jnp.asarray(image)  # a NumPy array cannot be indexed by traced numbers
    taps = _linear_taps if interpolation == "linear" else _cubic_taps
    h, w = image.shape[-3:-1]
    if 0 in (h, w):
        raise ValueError(f"image must have at least one pixel, got shape {image.shape}.")
    down, across = taps(jnp.clip(row, 0, h - 1)), taps(jnp.clip(column, 0, w - 1))
    total = jnp.zeros((), image.dtype)
    for r, weight_r in down:
        for c, weight_c in across:
            seen = image[..., jnp.clip(r, 0, h - 1), jnp.clip(c, 0, w - 1), :]
            total = total + (weight_r * weight_c)[..., None].astype(image.dtype) * seen
    return total


@takes_numbers
def distort_image(view: Pinhole | ThinLens, image: Image, *, interpolation: str = "cubic") -> Image:
    """Distort an ideal picture as the view's lens does.

    Each pixel is interpolated at the position that its light would have without distortion.

    Args:
        view: the lens; without distortion it returns the picture itself.
        image: (..., h, w, bands) in any unit, of the view's resolution.
        interpolation: "linear" or "cubic", as in `sample_image`.

    Returns:
        (..., h, w, bands) in the unit of the picture.

    Raises:
        ValueError: another resolution or interpolation.
    """
    return _bent(view, image, undistort, interpolation)


@takes_numbers
def undistort_image(
    view: Pinhole | ThinLens, image: Image, *, interpolation: str = "cubic"
) -> Image:
    """Remove the view's distortion from a picture: the inverse of `distort_image`.

    Args:
        view: the lens; without distortion it returns the picture itself.
        image: (..., h, w, bands) in any unit, of the view's resolution.
        interpolation: "linear" or "cubic", as in `sample_image`.

    Returns:
        (..., h, w, bands) in the unit of the picture.

    Raises:
        ValueError: another resolution or interpolation.
    """
    return _bent(view, image, distort, interpolation)


@takes_numbers
def lateral_aberration(
    image: Image, magnification: Float[Array, "..."], *, interpolation: str = "cubic"
) -> Image:
    """Apply lateral chromatic aberration: magnify each band about the middle of the picture.

    The inverse is the aberration with 1 / `magnification`.

    Args:
        image: (..., h, w, bands) in any unit.
        magnification: (bands,) relative, > 0; 1 leaves a band unchanged.
        interpolation: "linear" or "cubic", as in `sample_image`.

    Returns:
        (..., h, w, bands) in the unit of the image.

    Raises:
        ValueError: `magnification` does not have one value per band, or another interpolation.

    Example:
        >>> picture = np.linspace(0, 1, 5)[None, :, None] * np.ones((1, 1, 2))  # of two bands
        >>> wide = jv.optics.lateral_aberration(picture, [1.0, 2.0], interpolation="linear")
        >>> print(wide[0, :, 1])
        [0.25  0.375 0.5   0.625 0.75 ]
    """
    if magnification.shape != image.shape[-1:]:
        raise ValueError(
            f"magnification must be {image.shape[-1:]}, one per band, got {magnification.shape}."
        )
    h, w = image.shape[-3:-1]
    rows = jnp.arange(h, dtype=magnification.dtype) - (h - 1) / 2
    columns = jnp.arange(w, dtype=magnification.dtype) - (w - 1) / 2

    def resample_band(plane: Float[Array, "... h w"], factor: Float[Array, ""]) -> Array:
        row, column = jnp.meshgrid(
            rows / factor + (h - 1) / 2, columns / factor + (w - 1) / 2, indexing="ij"
        )
        return sample_image(plane[..., None], row, column, interpolation=interpolation)[..., 0]

    return jax.vmap(resample_band, in_axes=(-1, 0), out_axes=-1)(image, magnification)


def _bent(
    view: Pinhole | ThinLens, image: Image, move: Callable[..., tuple], interpolation: str
) -> Image:
    """Interpolate the image at the positions to which `move` maps the slope of each pixel's chief
    ray."""
    if view.distortion is None:
        return image
    if image.shape[-3:-1] != view.resolution:
        raise ValueError(
            f"the picture must be {view.resolution}, as the view is, got {image.shape[-3:-1]}."
        )
    share = 0.0
    if all(map(is_known, jax.tree.leaves(view))):
        with jax.ensure_compile_time_eval():
            pitch = float(sensor_vergence(view) * view.pixel_pitch)
        share = folded_share(view.distortion, pitch, view.resolution, ideal=move is distort)
    if share:
        warn_caller(
            f"{100 * share:.2g} % of the pixels lie beyond the fold of the distortion, at which "
            "images turn back, and show light from elsewhere; correct the coefficients."
        )
    rows, columns = view.resolution
    per_pixel = sensor_vergence(view) * view.pixel_pitch

    def source(row: Float[Array, ""], column: Float[Array, ""]) -> tuple[Array, Array]:
        x, y = pixel_offset(view, row, column)
        vergence = sensor_vergence(view)
        right, down = move(view.distortion, x * vergence, y * vergence)
        return down / per_pixel + (rows - 1) / 2, right / per_pixel + (columns - 1) / 2

    row, column = jnp.meshgrid(*pixel_grid(view), indexing="ij")
    at_row, at_column = jax.vmap(jax.vmap(source))(row, column)
    return sample_image(image, at_row, at_column, interpolation=interpolation)


def _linear_taps(x: Scalars) -> list[tuple[Array, Scalars]]:
    """Return (index, weight) of the two samples around x, for linear interpolation."""
    start = jnp.floor(x)
    t, first = x - start, start.astype(int)
    return [(first, 1 - t), (first + 1, t)]


def _cubic_taps(x: Scalars) -> list[tuple[Array, Scalars]]:
    """Return (index, weight) of the four samples around x, for cubic interpolation by Keys' kernel
    with a = -1/2.
    """
    start = jnp.floor(x)
    t, first = x - start, start.astype(int)
    s = 1 - t
    return [
        (first - 1, -t * s * s / 2),
        (first, s * (2 + 2 * t - 3 * t * t) / 2),
        (first + 1, t * (2 + 2 * s - 3 * s * s) / 2),
        (first + 2, -s * t * t / 2),
    ]
