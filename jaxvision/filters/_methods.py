"""Three ways to one number: g[p] = sum over i of k[i] f[p + i - anchor], on stacks of images.

Images are (n, h, w, c), kernels (kh, kw, c), or (kh, kw, 1) for all bands alike. A border is "none"
(only whole windows: h - kh + 1 rows), or one that `padding.ghosts` knows; the result is then
(n, h, w, c). Values in any unit.
"""

from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._staging import stored
from ..padding import continued, ghosts

Stack = Float[Array, "n h w c"]
Result = Float[Array, "n _ _ c"]
Kernel = Float[Array, "_ _ _"]
Anchor = tuple[int, int]

# Taps in one loop: beyond some 225 XLA's code for the loop is 20 times slower.
_MOST_TAPS = 128


def padded(image: Stack, size: tuple[int, ...], anchor: Anchor, border: str) -> Result:
    """The image, padded by the reach of a kernel of that size (kh, kw)."""
    if border == "none":
        return image
    zero = jnp.zeros((), image.dtype)
    for axis in (1, 2):
        before, after = anchor[axis - 1], size[axis - 1] - 1 - anchor[axis - 1]
        image = continued(image, axis, before, after, border, zero)
    return image


def by_conv(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """`lax.conv_general_dilated`: planes as a batch where bands share a kernel, else as groups."""
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


def by_fft(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """The product of the transforms, planes last in memory; half precision by way of float32."""
    dtype = image.dtype if image.dtype.itemsize >= 4 else jnp.float32
    planes = jnp.moveaxis(padded(image, kernel.shape[:2], anchor, border), -1, 1).astype(dtype)
    rows, columns = planes.shape[-2:]
    lengths = _fast_length(rows), _fast_length(columns)
    spectrum = jnp.fft.rfft2(jnp.moveaxis(kernel, -1, 0).astype(dtype), lengths)[None]
    product = jnp.fft.rfft2(planes, lengths) * jnp.conj(spectrum)
    whole = jnp.fft.irfft2(product, lengths)
    whole = whole[:, :, : rows - kernel.shape[0] + 1, : columns - kernel.shape[1] + 1]
    return jnp.moveaxis(whole, 1, -1).astype(image.dtype)


def _fast_length(n: int) -> int:
    """The next product of 2, 3, 5 and 7."""
    while True:
        rest = n
        for prime in (2, 3, 5, 7):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


def by_shifts(image: Stack, kernel: Kernel, anchor: Anchor, border: str) -> Result:
    """The sum of shifted images, in loops over whole rows (h, w c).

    A shift by one pixel is then a shift by c numbers: the loop vectorises even for few bands.

    Rows beyond the border are read in place by their index. Columns beyond it are added to the
    image first, and so are rows that do not equal a row of the image (border "extend").
    """
    (kh, kw), (n, _, _, c) = kernel.shape[:2], image.shape
    if border == "extend":
        image = stored(lambda f: padded(f, (kh, kw), anchor, border), image)
        border = "none"
    elif kw > 1:
        across = (0, anchor[1])
        image = stored(lambda f: padded(f, (1, kw), across, border), image)
    h, w = image.shape[1], image.shape[2] - kw + 1
    if border == "none":
        h -= kh - 1
        index, inside = np.arange(h + kh - 1), np.ones(h + kh - 1)
    else:
        index, inside, *_ = ghosts(border, h, anchor[0], kh - 1 - anchor[0])
    # a weight for all bands is one number in the loop, otherwise a row of numbers
    weights = kernel if kernel.shape[-1] == 1 else stored(lambda k: jnp.tile(k, w), kernel)

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
    groups = [every[k : k + _MOST_TAPS] for k in range(0, len(every), _MOST_TAPS)]
    total = stored(partial(taps, chosen=groups[0]), rows, weights)
    for group in groups[1:]:
        total = stored(lambda t, r, v, g=group: t + taps(r, v, g), total, rows, weights)
    return total.reshape(n, h, w, c)


METHODS = {"conv": by_conv, "direct": by_shifts, "fft": by_fft}
