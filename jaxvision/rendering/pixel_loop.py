"""The loop over the pixels of a view, which all integrators use.

photograph(along, view, samples)

`along` computes the radiance along rays; integrators differ only in this function. The value of a
pixel depends on the random key, the pixel and the indices of its samples. It does not depend on the
division of the picture into blocks, or on which other pixels are computed.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt32

from ..core._arguments import takes_numbers
from ..core._loops.fusion import LANES, entries_per_step
from ..core._numerics import divide, safe_sqrt
from ..core._random import Stream, Word, lattice_point, seed_of
from ..core._shown import Shown
from ..core._types import Key, Scalar, Spectrum, check_count, check_given, check_key, is_known
from ..core.in_notebooks import picture_html, preview_png
from ..core.parallel_loops import map_, scan
from ..geometry import Ray
from ..optics import view_ray
from ..point_ops import srgb_encode
from ..scene import ThinLens, View

# Number of rays in a block. The cores share the loop over a block, so this loop must take much
# longer than starting a task.
BLOCK = 65536
WHITE = 0.99  # quantile of the radiance that a notebook shows as white

# A function from a block of rays, components (n,), and their samples, of pixels (n,), to the
# radiance in W m^-2 sr^-1: one array (n, bands), or a tuple of (n,) for each band.
Along = Callable[[Any, Stream], Any]


class PixelRay(eqx.Module):
    """The ray of a pixel, and the derivatives of the ray with respect to row and column, per
    pixel."""

    ray: Ray
    by_row: Ray
    by_column: Ray


class PixelSamples(Shown):
    """Rays spread over the square of each pixel, and over the lens of a thin-lens view.

    The samples of a pixel are points of a Kronecker sequence, shifted at random for each pixel. The
    mean over these samples is unbiased, and the samples are spread more evenly than independent
    ones. In a scene of eight spheres with shadows, seen through a pinhole, the error with 4, 16 and
    64 samples is .61, .58 and .37 times the error of independent samples. Through a lens out of
    focus the factors are .91, .65 and .71.

    Attributes:
        key: random key.
        count: samples per pixel, >= 1; static.

    Raises:
        ValueError: for a count below 1.

    Example:
        >>> lamp = jv.Surface(jv.Plane([0, 0, 9], [0, 0, -1]), jv.Lambert([0.0]), [2.0])
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=2.0)
        >>> samples = jv.PixelSamples(jax.random.key(0), 4)  # through four places of the lens
        >>> print(jv.render(jv.Scene(lamp, []), lens, samples=samples).ravel())
        [2.]
    """

    key: Key
    count: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        check_key("PixelSamples.key", self.key)
        check_count("PixelSamples.count", self.count, 1)


class Traced(Shown):
    """The mean of samples of radiance, and its standard error.

    Attributes:
        radiance: (..., bands) W m^-2 sr^-1, the mean of the samples.
        error: (..., bands) W m^-2 sr^-1, the standard error for independent samples. The standard
            error is too low if no sample hits a rare bright path, and inf for one sample.

    Example:
        All paths in this room give the same radiance, so their mean has no error.

        >>> grey = jv.Lambert([0.5 / np.pi])
        >>> wall = jv.Surface(jv.Sphere([0, 0, 0], 1), grey, [0.5], two_sided=True)
        >>> method = jv.Paths(samples=2, depth=1, strategy="surfaces")
        >>> ray, key = jv.Ray([0, 0, 0], [0, 0, 1]), jax.random.key(0)
        >>> traced = jv.path_radiance(key, jv.Scene(wall, []), ray, method=method)
        >>> print(traced.radiance, traced.error)
        [0.5] [0.]
    """

    radiance: Spectrum
    error: Spectrum

    @property
    def relative_error(self) -> Scalar:
        """The RMS of the standard error divided by the RMS of the radiance, over all finite values,
        as the command `jaxvision render` prints it. Four times as many samples halve this ratio."""
        known = jnp.isfinite(self.radiance) & jnp.isfinite(self.error)
        light, error = (jnp.where(known, x, 0) for x in (self.radiance, self.error))
        return safe_sqrt(divide(jnp.sum(error**2), jnp.sum(light**2)))

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: a table of the fields, and a picture if the radiance is an
        image."""
        table = super()._repr_html_()
        if not is_known(self.radiance) or not np.size(self.radiance) or self.radiance.ndim < 3:
            return table
        return picture_html(
            preview_png(_encode_preview(self.radiance)), table, meaning="radiance, sRGB"
        )


def _encode_preview(radiance: Spectrum) -> np.ndarray:
    """Return an encoded picture (h, w, 1 or 3) of the first image in a batch, with white at the
    99th percentile. If the number of bands is not three, the picture shows the mean over bands."""
    seen = np.asarray(radiance, float).reshape(-1, *radiance.shape[-3:])[0]
    if seen.shape[2] != 3:
        seen = seen.mean(axis=2, keepdims=True)
    finite = seen[np.isfinite(seen)]
    white = np.quantile(finite, WHITE) if finite.size else 0.0
    return np.asarray(srgb_encode(np.clip(seen / (white if white > 0 else 1.0), 0, 1)))


def photograph(
    along: Along,
    view: View,
    samples: PixelSamples | None,
    *,
    pixels: tuple[Int[Array, " n"], Int[Array, " n"]] | None = None,
    first_sample: int | Word = 0,
    keep: Sequence[str] = (),
    several: bool = True,
    wide: bool = False,
) -> Traced:
    """Compute the radiance of the pixels of a view, with one ray or many samples for each pixel.

    Args:
        along: function from a block of rays to radiance.
        view: any view; a thin lens needs samples for defocus.
        samples: rays of each pixel, or None for one ray through its centre.
        pixels: rows and columns, (n,) each; None for the whole picture.
        first_sample: index of the first sample. Two calls with samples 0 to n - 1 and n to 2 n - 1
            draw the same samples as one call with 2 n.
        keep: names of `jax.ad_checkpoint.checkpoint_name` whose values a gradient of one ray per
            pixel keeps; everything else is recomputed, block by block.
        several: whether a device with enough memory computes several samples of each pixel at once,
            by `vmap` of `along`.
        wide: whether `along` takes a `PixelRay` for each pixel; only for one ray per pixel.

    Returns:
        (n, bands), or (h, w, bands) for the whole picture, in W m^-2 sr^-1.

    Raises:
        ValueError: for a thin lens without samples, unless its f_number is inf or traced.
    """
    check_given("photograph: view", view, View)
    if samples is None:
        check_lens(view)
    height, width = view.resolution
    dtype = view.pixel_pitch.dtype
    seed = None if samples is None else seed_of(samples.key)
    number = jnp.arange(height * width) if pixels is None else pixels[0] * width + pixels[1]

    def place(pixel: Word) -> tuple[Scalar, Scalar]:
        # convert via int32, for which CPUs have vector instructions
        row, column = (x.astype(jnp.int32) for x in (pixel // width, pixel % width))
        return row.astype(dtype), column.astype(dtype)

    def centre(pixel: Word) -> Ray | PixelRay:
        if not wide:
            return view_ray(view, *place(pixel))
        row, column = place(pixel)
        ray, by_row = jax.jvp(lambda r: view_ray(view, r, column), (row,), (jnp.ones_like(row),))
        _, by_column = jax.jvp(lambda c: view_ray(view, row, c), (column,), (jnp.ones_like(row),))
        return PixelRay(ray, by_row, by_column)

    def draw_ray(pixel: Word, sample: Word) -> Ray:
        return sample_ray(view, *place(pixel), Stream(pixel, sample, seed))

    def block(pixels: UInt32[Array, " n"]) -> tuple[Any, Any]:
        if samples is None:
            seen = along(jax.vmap(centre)(pixels), Stream(pixels, None, None))
            return seen, jax.tree.map(lambda x: jnp.full_like(x, jnp.inf), seen)

        def sample(k: Word) -> Any:
            rays = jax.vmap(draw_ray, in_axes=(0, None))(pixels, k)
            return along(rays, Stream(pixels, k, seed))

        room = max(1, entries_per_step(1) // len(pixels)) if several else 1
        return mean_of_samples(sample, samples.count, first=first_sample, room=room)

    kept = keep if samples is None else None  # each sample is a checkpoint
    seen = map_blocks(block, number.astype(jnp.uint32), keep=kept)
    radiance, error = (jnp.stack(x, axis=-1) if isinstance(x, tuple) else x for x in seen)
    shape = (-1,) if pixels is not None else (height, width)
    return Traced(*(x.reshape(*shape, x.shape[-1]) for x in (radiance, error)))


def map_rays(along: Callable[[Any, Stream], Any]) -> Along:
    """Turn a function of one ray into a function of a block of rays.

    Args:
        along: function from one ray and its sample to radiance, W m^-2 sr^-1.

    Returns:
        The same function for rays of components (n,) and the samples of n pixels.
    """

    def block(rays: Any, stream: Stream) -> Any:
        def trace_ray(ray: Any, pixel: Word) -> Any:
            return along(ray, Stream(pixel, stream.sample, stream.seed))

        return jax.vmap(trace_ray)(rays, stream.pixel)

    return block


def numbers_of(stream: Stream) -> tuple[Array, ...]:
    """Return the indices that identify a sample: its pixel, and its index in this pixel.

    Args:
        stream: the sample.

    Returns:
        The number of its pixel and, for several samples, the sample's number in that pixel; no
        unit.
    """
    return (stream.pixel,) if stream.sample is None else (stream.pixel, stream.sample)


@takes_numbers
def sample_ray(view: View, row: Scalar, column: Scalar, stream: Stream) -> Ray:
    """Return the ray of one sample of a pixel.

    Two random numbers give the position in the pixel, and two more the position on a lens.

    Args:
        view: any view.
        row, column: () pixels, of the pixel's centre.
        stream: the sample.

    Returns:
        Origin in m, direction of unit length.
    """
    lens = isinstance(view, ThinLens)
    u = lattice_point(stream, 4 if lens else 2, view.pixel_pitch.dtype)
    return view_ray(view, row + u[0] - 0.5, column + u[1] - 0.5, u=u[2:] if lens else None)


def map_blocks(
    function: Callable[..., Any],
    *arrays: Array,
    size: int | None = None,
    lanes: int = LANES,
    keep: Sequence[str] | None = None,
) -> Any:
    """Apply `function` to arrays in blocks along their leading axis. A block has up to `size`
    entries, a multiple of `lanes`; None chooses a number that suits the device.

    All blocks have the same size; the last one is padded with entries that are discarded. Otherwise
    the last entries of a block would be computed without vector instructions, and the last bit of a
    result would depend on the division into blocks. With several blocks, a gradient stores the
    values whose names are in `keep` and recomputes all others. If `keep` is None, the gradient
    stores the values that the checkpoints inside `function` select.
    """
    count = len(arrays[0])
    size = min(entries_per_step(BLOCK) if size is None else size, -(-count // lanes) * lanes)
    blocks = -(-count // size)

    def cut(x: Array) -> Array:
        around = ((0, blocks * size - count), *((0, 0),) * (x.ndim - 1))
        return jnp.pad(x, around, mode="edge").reshape(blocks, size, *x.shape[1:])

    parts = tuple(map(cut, arrays))
    if blocks == 1:  # each nested loop about doubles the compile time of a gradient
        found = jax.tree.map(lambda x: x[None], function(*(part[0] for part in parts)))
    else:
        if keep is not None:
            policy = jax.checkpoint_policies.save_only_these_names(*keep)
            function = jax.checkpoint(function, policy=policy)
        found = map_(lambda part: function(*part), parts)
    return jax.tree.map(lambda x: x.reshape(blocks * size, *x.shape[2:])[:count], found)


def mean_of_samples(
    sample: Callable[[Word], Any], count: int, *, first: int | Word = 0, room: int = 1
) -> tuple[Any, Any]:
    """Return the mean of samples and its standard error, in the unit of the samples. The samples
    are computed one after the other, or up to `room` at once.

    Source: Chan, Golub and LeVeque, The American Statistician 37(3) (1983), for groups of equal
    size; for single samples Welford, Technometrics 4(3) (1962). Both methods avoid the difference
    of large sums of squares.
    """
    sample = jax.jit(sample, inline=True)  # traced once for its shapes and the loop
    each = max(n for n in range(1, min(room, count) + 1) if count % n == 0)
    shapes = jax.eval_shape(sample, jax.ShapeDtypeStruct((), jnp.uint32))
    dark = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)

    @jax.checkpoint
    def add(state: tuple[Any, Any], k: Word) -> tuple[tuple[Any, Any], None]:
        means, squares = state
        start = k + jnp.uint32(first)
        if each == 1:
            values = sample(start)
        else:
            group = jax.vmap(sample)(start + jnp.arange(each, dtype=jnp.uint32))
            values = jax.tree.map(lambda x: x.mean(axis=0), group)
            squares = jax.tree.map(
                lambda square, x, mean: square + ((x - mean[None]) ** 2).sum(axis=0),
                squares,
                group,
                values,
            )
        after = jax.tree.map(
            lambda x, mean: mean + (x - mean) * each / (k + each).astype(mean.dtype), values, means
        )
        squares = jax.tree.map(
            lambda x, square, mean, new: square + each * (x - mean) * (x - new),
            values,
            squares,
            means,
            after,
        )
        return (after, squares), None

    (mean, squares), _ = scan(add, (dark, dark), jnp.arange(0, count, each, dtype=jnp.uint32))
    if count == 1:
        return mean, jax.tree.map(lambda x: jnp.full_like(x, jnp.inf), mean)
    return mean, jax.tree.map(lambda x: safe_sqrt(x / (float(count) * (count - 1))), squares)


def check_lens(view: View) -> None:
    """Raise `ValueError` for a thin lens whose f-number is finite and not traced. With one ray per
    pixel such a lens would act as a pinhole, with everything in focus."""
    if isinstance(view, ThinLens) and is_known(view.f_number) and np.isfinite(view.f_number):
        raise ValueError(
            "a ThinLens defocuses by rays spread over its aperture: give samples, or use a Pinhole "
            "or f_number inf."
        )
