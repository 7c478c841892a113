"""Three methods to compute the correlation g[p] = sum over i of k[i] f[p + i - anchor] of stacks of
images.

Images are (n, h, w, c) and kernels (kh, kw, c), or (kh, kw, 1) for all bands. The border "none"
keeps only complete windows, which give h - kh + 1 rows. Any border of `padding.ghosts` gives a
result of (n, h, w, c). Values in any unit.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from ..core._loops.fusion import PLAIN, materialise
from ..core.parallel_loops import fori_loop, while_loop
from ..programs import targets_cpu
from .padding import ghosts, pad_axis

Stack = Float[Array, "n h w c"]
Result = Float[Array, "n _ _ c"]
Kernel = Float[Array, "_ _ _"]
Anchor = tuple[int, int]
Planes = Float[Array, "n c _ _"]

# Largest number of taps in one loop: beyond about 225, XLA's code for the loop is 20 times slower.
_MOST_TAPS = 128
# Beyond this number, a program whose taps are written out takes longer to compile than to run, and
# the taps are added in a loop over blocks.
_MOST_UNROLLED, _BLOCK = 2 * _MOST_TAPS, 32
# Relative accuracy of a sum by transforms in float32 and in float64, by the bytes of the dtype.
_RIGHT = {4: 1e-4, 8: 1e-9}
_TILE = 256  # pixels along each side of a tile
# largest number of ranges of magnitudes in one plane: each covers 6 of the 630 decades of float64
_MOST_RANGES = 128
_SEEN = 64  # largest side, in pixels, of windows whose largest value is computed


def padded(image: Stack, size: tuple[int, ...], anchor: Anchor, border: str) -> Result:
    """Pad the image as far as a kernel of size (kh, kw) reaches beyond it."""
    if border == "none":
        return image
    zero = jnp.zeros((), image.dtype)
    for axis in (1, 2):
        before, after = anchor[axis - 1], size[axis - 1] - 1 - anchor[axis - 1]
        image = pad_axis(image, axis, before, after, border, zero)
    return image


def correlate_conv(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """Correlate by `lax.conv_general_dilated`. Bands that share a kernel are a batch, other bands
    are feature groups.
    """
    wide, bands = padded(image, kernel.shape[:2], anchor, border), image.shape[-1]
    shared = kernel.shape[-1] == 1
    if shared:
        wide = jnp.moveaxis(wide, -1, 1).reshape(-1, *wide.shape[1:3], 1)
    result = lax.conv_general_dilated(
        wide,
        kernel[:, :, None],
        window_strides=(1, 1),
        padding="VALID",
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
        feature_group_count=kernel.shape[-1],
        precision=lax.Precision.HIGHEST,
    )
    if shared:
        result = jnp.moveaxis(result.reshape(-1, bands, *result.shape[1:3]), 1, -1)
    return result


def correlate_fft(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """Correlate by Fourier transforms.

    The whole picture is transformed if the rounding error is small compared with every sum or with
    the values in each window. Otherwise the picture is transformed tile by tile.
    """
    given, size = image.dtype, kernel.shape[:2]
    dtype = given if given.itemsize >= 4 else np.dtype(np.float32)
    image, k = image.astype(dtype), jnp.moveaxis(kernel, -1, 0)[None].astype(dtype)
    if border == "extend":
        image, border = padded(image, size, anchor, border), "none"
    around = tuple(
        np.arange(n) if border == "none" else _places(border, n, taps, at)
        for n, taps, at in zip(image.shape[1:3], size, anchor, strict=True)
    )
    rows, columns = (len(places) - taps + 1 for places, taps in zip(around, size, strict=True))

    def whole(precision: DTypeLike) -> Planes:
        f = jnp.moveaxis(padded(image, size, anchor, border), -1, 1)
        return _transform(f, _spectrum(k, f.shape, precision))

    def crop(sums: Planes) -> Result:
        return jnp.moveaxis(sums[:, :, :rows, :columns], 1, -1).astype(given)

    if PLAIN:  # JAX cannot differentiate the choice
        return crop(whole(_widest()))

    largest, darkest, bound = _range(image, k)

    def exact() -> Planes:
        mean = jnp.square(image).sum((1, 2)) / (image.shape[1] * image.shape[2])
        return _least(jnp.sqrt(mean)[..., None, None], largest, k)

    # the picture's sums are computed only if the bound does not prove the accuracy
    least = lax.cond((darkest >= bound).all(), lambda: bound, exact)
    even = (darkest >= least).all()
    first = partial(whole, dtype)
    sums = lax.cond(even, first, lambda: jnp.zeros_like(jax.eval_shape(first)))
    # along the columns first, where XLA's loop vectorises
    smallest = jnp.abs(sums[:, :, :rows, :columns]).min(2).min(2)[..., None, None]
    right = (smallest >= least).all()

    def else_right() -> Bool[Array, ""]:
        either_sign = (image.min() < 0) | (k.min() < 0)
        return (smallest >= exact()).all() | even & either_sign

    # XLA's minima may ignore NaN, which a transform spreads over the whole plane
    known = jnp.isfinite(sums[:, :, 0, 0]).all()
    right = known & lax.cond(right, lambda: right, else_right)
    return crop(_correlate_tiles(image, k, around, sums, right))


def _places(border: str, n: int, taps: int, anchor: int) -> np.ndarray:
    """Return the source index of each position along a padded axis, or n where the border is
    zero.
    """
    source, own, *_ = ghosts(border, n, anchor, taps - 1 - anchor)
    return np.where(own == 0, n, source)


def _range(image: Stack, k: Planes) -> tuple[Planes, Planes, Planes]:
    """Return the largest magnitude, an upper bound on the sum in the darkest window, and an upper
    bound on `_least`, each (n, c, 1, 1). The last bound uses the largest values of groups of pixels
    in each column.
    """
    n, h, w, c = image.shape
    kh, kw = (min(side, taps, _SEEN) for side, taps in zip((h, w), k.shape[2:], strict=True))
    rows = image.reshape(n, h, w * c)  # whole rows of numbers are fast
    blocks, rest = rows[:, : h // kh * kh].reshape(n, h // kh, kh, w * c), rows[:, h // kh * kh :]
    down = jnp.abs(blocks).max(2).reshape(n, h // kh, w, c)
    left = jnp.abs(rest).max(1, initial=0).reshape(n, w, c)
    largest = jnp.maximum(down.max((1, 2)), left.max(1))
    across = down[:, :, : w // kw * kw].reshape(n, h // kh, w // kw, kw, c)
    darkest = across.max(3).min((1, 2)).reshape(n, c, 1, 1) * _sum(k)
    mean = (kh * jnp.square(down).sum(1) + rest.shape[1] * jnp.square(left)).sum(1) / (h * w)
    mean, largest = (x.reshape(n, c, 1, 1) for x in (mean, largest))
    return largest, darkest, _least(jnp.sqrt(mean), largest, k)


def _least(rms: Planes, largest: Planes, k: Planes) -> Planes:
    """Return the smallest sums that a transform of the whole picture computes accurately, (n, c, 1,
    1).
    """
    return _rounding(rms, largest, k) / _RIGHT[k.dtype.itemsize]


def _correlate_tiles(
    image: Stack,
    k: Planes,
    around: tuple[np.ndarray, ...],
    whole: Planes,
    right: Bool[Array, ""],
) -> Planes:
    """Compute the correlation tile by tile, unless the transform of the whole picture was
    accurate.
    """
    (n, c), (kh, kw), (rows, columns) = whole.shape[:2], k.shape[2:], map(len, around)
    rows, columns = rows - kh + 1, columns - kw + 1
    down, across = (
        max(1, round(side / max(_TILE, taps))) for side, taps in ((rows, kh), (columns, kw))
    )
    tile = -(-rows // down), -(-columns // across)
    size = tile[0] + kh - 1, tile[1] + kw - 1

    def spectra() -> Array:
        return _spectrum(k, size, _widest())

    # XLA would move it out of the loop, and compute it even if the loop never runs
    with jax.enable_x64(True):
        blank = jax.eval_shape(spectra)
        wide = lax.cond(right, lambda: jnp.zeros_like(blank), spectra)

    def correlate_tile(number: Array, whole: Planes) -> Planes:
        image_of, band, i, j = jnp.unravel_index(number, (n, c, down, across))
        y, x = jnp.minimum(i * tile[0], rows - tile[0]), jnp.minimum(j * tile[1], columns - tile[1])
        down_to, right_to = (
            lax.dynamic_slice_in_dim(jnp.asarray(places), start, taps)
            for places, start, taps in zip(around, (y, x), size, strict=True)
        )
        part = image.at[image_of, down_to[:, None], right_to, band].get(mode="fill", fill_value=0)
        part = part[None, None]
        own = band if k.shape[1] > 1 else 0
        weights, spectrum = (lax.dynamic_slice_in_dim(a, own, 1, 1) for a in (k, wide))
        sums = _sum_magnitudes(part, weights, spectrum)
        return lax.dynamic_update_slice(whole, sums, (image_of, band, y, x))

    return fori_loop(0, jnp.where(right, 0, n * c * down * across), correlate_tile, whole)


def _sum_magnitudes(f: Planes, k: Planes, spectrum: Array) -> Planes:
    """Correlate one plane in several ranges of magnitude and add the results, so that a pixel gets
    no rounding error, NaN or infinity from outside its window.
    """
    with jax.enable_x64(True):
        wide = spectrum.real.dtype
        finite, weights = (jnp.where(jnp.isfinite(x), x, 0).astype(wide) for x in (f, k))
        scale = jnp.abs(finite).max()
        scale = jnp.where(scale > 0, scale, 1)
        above = jnp.finfo(wide).eps ** -0.55

        def step(state: tuple[Planes, Planes, Array]) -> tuple[Planes, Planes, Array]:
            rest, total, ranges = state
            size = jnp.abs(rest)
            rounding = _rounding(jnp.sqrt(jnp.square(size).mean()), size.max(), weights)
            large = size * _sum(weights) >= above * rounding
            result = _transform(jnp.where(large, rest, 0), spectrum)[:, :, :h, :w]
            total = total + jnp.where(jnp.abs(result) >= rounding, result, 0)
            return jnp.where(large, 0, rest), total, ranges + 1

        def is_left(state: tuple[Planes, Planes, Array]) -> Bool[Array, ""]:
            return (state[0] != 0).any() & (state[2] < _MOST_RANGES)

        h, w = (a - b + 1 for a, b in zip(f.shape[2:], k.shape[2:], strict=True))
        start = finite / scale, jnp.zeros((1, 1, h, w), wide), jnp.zeros((), jnp.int32)
        _, total, _ = while_loop(is_left, step, start)
        total = (total * scale).astype(f.dtype)
        known = jnp.isfinite(f).all() & jnp.isfinite(k).all()
        return lax.cond(known, lambda: total, lambda: _propagate_nan(total, f, k))


def _propagate_nan(total: Planes, f: Planes, k: Planes) -> Planes:
    """Return the sums of the finite values, replaced by NaN or infinity where the window contains
    NaN or infinity.
    """
    single = jnp.float32

    def count(values: Planes, weights: Planes) -> Planes:
        whole = _transform(values, _spectrum(weights, f.shape, single))
        return whole[:, :, : total.shape[2], : total.shape[3]]

    positive, negative = jnp.isposinf(f), jnp.isneginf(f)
    up = count(positive, k > 0) + count(negative, k < 0) > 0.5
    down = count(positive, k < 0) + count(negative, k > 0) > 0.5
    spoilt = count(jnp.isnan(f), jnp.ones_like(k)) + count(jnp.isinf(f), k == 0) > 0.5
    spoilt = spoilt | (up & down) | ~jnp.isfinite(k).all()
    return jnp.where(spoilt, jnp.nan, jnp.where(up, jnp.inf, jnp.where(down, -jnp.inf, total)))


def _spectrum(k: Planes, size: tuple[int, ...], dtype: DTypeLike) -> Array:
    """Return the Fourier transform of the kernel for planes of size (..., h, w), in the precision
    of `dtype`.
    """
    with jax.enable_x64(True):
        lengths = _fast_length(size[-2]), _fast_length(size[-1])
        return jnp.conj(jnp.fft.rfft2(k.astype(dtype), lengths))


def _transform(f: Planes, spectrum: Array) -> Planes:
    """Return the sums by Fourier transforms, in the spectrum's precision. The result is as long as
    the transforms: the sums of complete windows come first, and the rest is invalid.
    """
    with jax.enable_x64(True):
        lengths = _fast_length(f.shape[2]), _fast_length(f.shape[3])
        product = jnp.fft.rfft2(f.astype(spectrum.real.dtype), lengths) * spectrum
        return jnp.fft.irfft2(product, lengths)


def _rounding(rms: Array, largest: Array, k: Planes) -> Planes:
    """Bound the rounding error of a correlation by transforms, in addition to a few ULP of each
    sum. The bound is the largest error measured for pictures from 60 x 60 to 1100 x 700.
    """
    own = jnp.sqrt(jnp.square(k).sum((2, 3), keepdims=True))
    return jnp.finfo(k.dtype).eps * (8 * rms * _sum(k) + 2 * largest * own)


def _sum(k: Planes) -> Planes:
    return jnp.abs(k).sum((2, 3), keepdims=True)


def _widest() -> np.dtype:
    """Return the widest floating type that Fourier transforms support on this machine."""
    double = targets_cpu() or jax.default_backend() == "gpu"
    return np.dtype(np.float64 if double else np.float32)


def _fast_length(n: int) -> int:
    """Return the smallest length of at least n whose prime factors are 2, 3, 5 and 7."""
    while True:
        rest = n
        for prime in (2, 3, 5, 7):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


def correlate_shifts(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """Correlate by adding shifted images, in loops over whole rows of w c numbers, which vectorise
    even for few bands. Columns are padded beforehand. Rows beyond the border are read from their
    source rows, and only border "extend" pads them too.
    """
    (kh, kw), (n, _, _, c) = kernel.shape[:2], image.shape
    long = kh * kw > _MOST_UNROLLED
    if border == "extend" or (long and border != "none"):
        image = materialise(lambda f: padded(f, (kh, kw), anchor, border), image)
        border = "none"
    elif kw > 1:
        across = (0, anchor[1])
        image = materialise(lambda f: padded(f, (1, kw), across, border), image)
    h, w = image.shape[1], image.shape[2] - kw + 1
    if border == "none":
        h -= kh - 1
        index, inside = np.arange(h + kh - 1), np.ones(h + kh - 1)
    else:
        index, inside, *_ = ghosts(border, h, anchor[0], kh - 1 - anchor[0])
    # a weight for all bands is one number in the loop, otherwise a row of numbers
    weights = kernel if kernel.shape[-1] == 1 else materialise(lambda k: jnp.tile(k, w), kernel)

    def taps(rows: Array, weights: Array, chosen: list[tuple[int, int]]) -> Array:
        sums: list[Array] = []
        accumulators = 4 if len(chosen) >= 15 else 2
        for position, (i, j) in enumerate(chosen):
            weight = weights[i, j][None, None, :]
            if not inside.all():
                weight = weight * jnp.asarray(inside[i : i + h, None], image.dtype)[None]
            seen = rows[:, index[i : i + h]] if border != "none" else rows[:, i : i + h]
            term = weight * lax.slice_in_dim(seen, j * c, (j + w) * c, axis=2)
            if position < accumulators:
                sums.append(term)
            else:
                sums[position % accumulators] += term
        return sum(sums[1:], start=sums[0])

    rows = image.reshape(*image.shape[:2], -1)
    every = [(i, j) for i in range(kh) for j in range(kw)]
    if long:
        blocks = len(every) // _BLOCK

        def add(number: Array, total: Array) -> Array:
            terms = []
            for position in range(_BLOCK):
                i, j = jnp.divmod(number * _BLOCK + position, kw)
                seen = lax.dynamic_slice(rows, (0, i, j * c), (n, h, w * c))
                terms.append(weights[i, j][None, None, :] * seen)
            return total + sum(terms[1:], start=terms[0])

        total = fori_loop(0, blocks, add, jnp.zeros((n, h, w * c), image.dtype))
        rest = every[blocks * _BLOCK :]
        return (total + taps(rows, weights, rest) if rest else total).reshape(n, h, w, c)
    groups = [every[k : k + _MOST_TAPS] for k in range(0, len(every), _MOST_TAPS)]
    total = materialise(partial(taps, chosen=groups[0]), rows, weights)
    for group in groups[1:]:
        total = materialise(lambda t, r, v, g=group: t + taps(r, v, g), total, rows, weights)
    return total.reshape(n, h, w, c)


METHODS = {"conv": correlate_conv, "direct": correlate_shifts, "fft": correlate_fft}
