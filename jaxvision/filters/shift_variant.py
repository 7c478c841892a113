"""Filters whose kernel changes from pixel to pixel: lens blur, defocus by depth, foveation.

There are three methods, from general to fast. `correlate_per_pixel` takes a kernel for each pixel
and is exact. `radial_blur` takes radial kernels that depend on the pixel through one number, the
scale; it is exact and stores no kernels. `correlate_bank` blends a bank of ordinary filters, whose
number sets the accuracy. Pictures and borders are as in `convolution`, in any unit. The kernel of a
pixel contains the weights with which THAT pixel gathers its neighbours. Gathering keeps a flat
picture flat, but does not conserve the sum of light. To scatter instead, so that each pixel spreads
its light by its rotated kernel and the sum is conserved, take the transpose: `operators.adjoint` of
the same filter.
"""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers, warn_of_idle_fill
from ..core._loops.fusion import materialise
from ..core._numerics import divide, smallest_divisor
from ..core._types import as_float, check_count, print_by_name
from ..core.parallel_loops import scan
from ._methods import Anchor
from ._terms import Fill
from .convolution import _anchor, correlate
from .gaussians import _SMALLEST_SIGMA, gaussian
from .kernels import gaussian_size
from .padding import (
    Filtered,
    Picture,
    Widths,
    as_planes,
    check_border,
    check_picture,
    pad,
)

Kernels = Float[Array, "..."]  # (kh, kw, h, w)
ScaleMap = Float[Array, "..."]  # (h, w)
print_by_name(globals(), "Kernels", "ScaleMap")
# (radius in pixels, scale of each pixel) -> weight, before the weights are normalised to sum 1
_REFUSED = ("constant", "normalised_zero")  # each pixel has its own kernel

Profile = Callable[[Float[Array, ""], ScaleMap], ScaleMap]

Planes = Float[Array, "n h c w"]


@takes_numbers
def gaussian_profile(radius: Float[Array, ""], sigma: ScaleMap) -> ScaleMap:
    """exp(-r^2 / 2 sigma^2).

    Args:
        radius: () in pixels.
        sigma: (h, w) in pixels. Values below 0.01 act as 0.01, which leaves the pixel unchanged.

    Returns:
        (h, w) weights, no unit, not normalised.
    """
    t = radius / jnp.maximum(sigma, _SMALLEST_SIGMA)
    return jnp.exp(-0.5 * t * t)


@takes_numbers
def disk_profile(radius: Float[Array, ""], blur_radius: ScaleMap) -> ScaleMap:
    """Return the weights of a defocus disc: 1 inside, 0 outside, with a linear edge one pixel wide.

    This edge makes the weights continuous in the blur radius.

    Args:
        radius: () in pixels.
        blur_radius: (h, w) in pixels.

    Returns:
        (h, w) weights in [0, 1], no unit, not normalised.
    """
    return jnp.clip(blur_radius + 0.5 - radius, 0, 1)


@takes_numbers
def correlate_per_pixel(
    picture: Picture,
    kernels: Kernels | np.ndarray,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
) -> Filtered:
    """Correlate with one kernel for each pixel: g[p] = sum over i of kernels[i, p] f[p + i -
    anchor].

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        kernels: (kh, kw, h, w), each tap a map of weights; no unit, or any.
        anchor: (row, column) of the kernel entry that lies on the pixel; None for the middle.
        border: "zero", "clamp", "wrap", "mirror", "reflect_101" or "extend".

    Returns:
        The picture's shape; its unit times the kernels'.

    Raises:
        ValueError: for kernels of another shape, an anchor outside them, or another border.
    """
    check_border(border, refused=_REFUSED)
    plane = _plane(picture)
    if kernels.ndim != 4 or 0 in kernels.shape or kernels.shape[2:] != plane:
        raise ValueError(f"kernels must be (kh, kw, {plane[0]}, {plane[1]}), got {kernels.shape}.")
    anchor = _anchor(anchor, (kernels.shape[0], kernels.shape[1]))
    return _correlate_pixels(picture, as_float(kernels), anchor=anchor, border=border)


@takes_numbers
def convolve_per_pixel(
    picture: Picture,
    kernels: Kernels | np.ndarray,
    *,
    anchor: Sequence[int] | None = None,
    border: str = "mirror",
) -> Filtered:
    """Convolve with one kernel for each pixel: g[p] = sum over i of kernels[i, p] f[p - i +
    anchor].

    A kernel belongs to the pixel of the result. For kernels that describe how the light of each
    pixel of the picture spreads, the blur is instead the `adjoint` of `correlate_per_pixel`.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        kernels: (kh, kw, h, w), each tap a map of weights; no unit, or any.
        anchor: (row, column) of the kernel entry that lies on the pixel; None for the middle.
        border: "zero", "clamp", "wrap", "mirror", "reflect_101" or "extend".

    Returns:
        The picture's shape; its unit times the kernels'.

    Raises:
        ValueError: as for `correlate_per_pixel`.

    Example:
        Each row looks one pixel further to the left.

        >>> kernels = jnp.broadcast_to(jnp.eye(3)[None, :, :, None], (1, 3, 3, 4))
        >>> picture = jnp.broadcast_to(jnp.arange(4.0), (3, 4))
        >>> print(jv.filters.convolve_per_pixel(picture, kernels, anchor=(0, 0), border="clamp"))
        [[0. 1. 2. 3.]
         [0. 0. 1. 2.]
         [0. 0. 0. 1.]]
    """
    if kernels.ndim != 4 or 0 in kernels.shape:
        raise ValueError(f"kernels must be (kh, kw, h, w), got {kernels.shape}.")
    kh, kw = kernels.shape[:2]
    top, left = _anchor(anchor, (kh, kw))
    turned = (kh - 1 - top, kw - 1 - left)
    return correlate_per_pixel(picture, kernels[::-1, ::-1], anchor=turned, border=border)


@takes_numbers
def correlate_bank(
    picture: Picture,
    bank: Float[Array | np.ndarray, "..."],
    position: ScaleMap,
    *,
    border: str = "mirror",
    fill: Fill = 0.0,
    method: str = "auto",
) -> Filtered:
    """Filter the picture with each kernel of a bank, and blend the results pixel by pixel.

    The effective kernel of a pixel is the blend of two kernels of the bank. The error is
    proportional to the square of the distance between neighbouring kernels.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        bank: (members, kh, kw), no unit, or any.
        position: (h, w) real-valued index into the bank, no unit, in [0, members - 1]; linear
            interpolation in between, constant beyond.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".
        method: as for `correlate`.

    Returns:
        The picture's shape; its unit times the bank's.

    Raises:
        ValueError: for a bank or a position of another shape and as for `correlate`.
    """
    _check_map("position", position, picture)
    if bank.ndim != 3 or 0 in bank.shape:
        raise ValueError(f"bank must be (members, kh, kw), got shape {bank.shape}.")
    kernels = bank if isinstance(bank, Tracer) else np.asarray(bank)
    members = [correlate(picture, k, border=border, fill=fill, method=method) for k in kernels]
    return _blend(members, position)


@takes_numbers
def radial_blur(
    picture: Picture,
    scale: ScaleMap,
    *,
    profile: Profile = gaussian_profile,
    radius: int,
    border: str = "mirror",
) -> Filtered:
    """Compute the mean over the pixels within `radius`, weighted by profile(distance, scale[p]).

    The result is the exact weighted mean. Pixels at the same distance have the same weight and are
    summed first, so the profile is evaluated once for each ring, not for each tap. If all weights
    of a pixel are 0, the pixel keeps its value.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        scale: (h, w) in pixels, the second argument of the profile.
        profile: function of the distance, () in pixels, and of the scale, (h, w) in pixels; it
            returns the weight, (h, w).
        radius: radius of the kernel in pixels, at least 0; beyond it the kernel is 0. A larger
            radius is more accurate and slower.
        border: "zero", "clamp", "wrap", "mirror", "reflect_101" or "extend".

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for a scale of another shape, a radius below 0, or another border.
    """
    _check_map("scale", scale, picture)
    check_border(border, refused=_REFUSED)
    check_count("radius", radius, 0)
    return _radial(picture, scale, profile=profile, radius=radius, border=border)


@takes_numbers
def gaussian_varying(
    picture: Picture,
    sigma: ScaleMap,
    *,
    sigmas: Sequence[float],
    truncate: float = 4.0,
    border: str = "mirror",
    fill: Fill = 0.0,
) -> Filtered:
    """Blur with a Gaussian whose `sigma` varies from pixel to pixel, interpolated in a bank of
    Gaussians.

    The blend of two kernels of the bank has exactly the spatial variance `sigma`^2. The blend's
    fourth moment has an error proportional to the square of the distance between the two sigmas.
    `kernels.blur_sigmas` chooses the sigmas of a bank. `radial_blur` is exact.

    Args:
        picture: (h, w) or (..., h, w, bands), any unit.
        sigma: (h, w) in pixels, clipped to the range of the bank.
        sigmas: the bank, at least two increasing sigmas in pixels, each at least 0.
        truncate: sigmas at which a kernel is cut off, no unit.
        border: a key of `padding.BORDERS`.
        fill: () or (bands,) in the picture's unit: the value outside with border "constant".

    Returns:
        The result, with the picture's shape and unit.

    Raises:
        ValueError: for a sigma of another shape and for fewer than two or not increasing `sigmas`.
    """
    _check_map("sigma", sigma, picture)
    if len(sigmas) < 2 or any(b <= a for a, b in pairwise(sigmas)):
        raise ValueError(f"sigmas must be at least two increasing numbers, got {sigmas}.")
    bank = tuple(float(s) for s in sigmas)
    warn_of_idle_fill(fill, border)
    return _gaussian_bank(picture, sigma, fill, sigmas=bank, truncate=truncate, border=border)


# ---------------------------------------------------------------- sums
#
# Here images are (n, h, c, w): the weights of neighbouring pixels are adjacent along a row, and
# stay in the cache for all bands of the row.


@partial(jax.jit, static_argnames=("anchor", "border"))
def _correlate_pixels(
    picture: Picture, kernels: Kernels, *, anchor: Anchor, border: str
) -> Filtered:
    kh, kw, h, w = kernels.shape
    reach = (anchor[0], kh - 1 - anchor[0]), (anchor[1], kw - 1 - anchor[1])
    wide, restore = _rows_of_planes(picture, reach, border)
    weights = kernels.astype(wide.dtype)

    def add_row(total: Planes, row: tuple[Array, Array]) -> tuple[Planes, None]:
        i, taps = row
        seen = lax.dynamic_slice_in_dim(wide, i, h, axis=1)
        for j in range(kw):
            total = total + taps[j][None, :, None] * seen[..., j : j + w]
        return total, None

    start = jnp.zeros((wide.shape[0], h, wide.shape[2], w), wide.dtype)
    return restore(scan(add_row, start, (jnp.arange(kh), weights))[0])


@partial(jax.jit, static_argnames=("profile", "radius", "border"))
def _radial(
    picture: Picture, scale: ScaleMap, *, profile: Profile, radius: int, border: str
) -> Filtered:
    wide, restore = _rows_of_planes(picture, ((radius, radius), (radius, radius)), border)
    h, w = scale.shape
    scale = scale.astype(wide.dtype)

    def add_octet(
        totals: tuple[Planes, ScaleMap], octet: tuple[Array, Array, Array]
    ) -> tuple[tuple[Planes, ScaleMap], None]:
        offset, distance, share = octet
        a, b = offset
        total, weights = totals
        weight = share * profile(distance, scale)
        ring = sum(
            lax.dynamic_slice_in_dim(
                lax.dynamic_slice_in_dim(wide, radius + y, h, axis=1), radius + x, w, axis=3
            )
            for p, q in ((a, b), (b, a))
            for y in (p, -p)
            for x in (q, -q)
        )
        return (total + weight[None, :, None] * ring, weights + 8 * weight), None

    octets = _octets(radius)
    distance, share = (jnp.asarray(v, wide.dtype) for v in octets[1:])
    start = jnp.zeros((wide.shape[0], h, wide.shape[2], w), wide.dtype), jnp.zeros_like(scale)
    (total, weights), _ = scan(add_octet, start, (jnp.asarray(octets[0]), distance, share))
    weights = weights[None, :, None]
    middle = wide[:, radius : radius + h, :, radius : radius + w]
    return restore(divide(total, weights, ~(weights <= smallest_divisor(weights.dtype)), middle))


def _octets(radius: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return offsets (a, b) with 0 <= b <= a, their distances, and their shares. Each offset stands
    for its eight images under the symmetries of the square. The share of an image is 1/2 if the
    images coincide in pairs, and 1/8 if all coincide.
    """
    a, b = np.tril_indices(radius + 1)
    a, b = (v[a * a + b * b <= radius * radius] for v in (a, b))
    share = np.where(a == 0, 1 / 8, np.where((b == 0) | (a == b), 1 / 2, 1.0))
    return np.stack([a, b], axis=-1).astype(np.int32), np.hypot(a, b), share


def _rows_of_planes(
    picture: Picture, reach: Widths, border: str
) -> tuple[Planes, Callable[[Planes], Filtered]]:
    """Return a padded picture as (n, h, c, w), and the function that restores a picture from that
    layout.
    """
    image, restore = as_planes(picture)
    wide = materialise(lambda f: jnp.moveaxis(pad(f, reach, border=border), -1, 2), image)
    return wide, lambda planes: restore(jnp.moveaxis(planes, 2, -1))


@partial(jax.jit, static_argnames=("sigmas", "truncate", "border"))
def _gaussian_bank(
    picture: Picture,
    sigma: ScaleMap,
    fill: Fill,
    *,
    sigmas: tuple[float, ...],
    truncate: float,
    border: str,
) -> Filtered:
    f = as_float(picture)

    def member(s: float) -> Filtered:
        size = gaussian_size(s, truncate=truncate)
        return f if s == 0 else gaussian(f, s, size=size, border=border, fill=fill)

    members = [member(s) for s in sigmas]
    variance = jnp.asarray(np.square(sigmas), sigma.dtype)
    position = jnp.interp(sigma * sigma, variance, jnp.arange(len(sigmas), dtype=sigma.dtype))
    return _blend(members, position)


@jax.jit
def _blend(members: list[Filtered], position: ScaleMap) -> Filtered:
    """Blend the filtered pictures of a bank, weighted by hat functions of `position`."""
    bands = 1 if members[0].ndim == 2 else members[0].shape[-1]
    batch = (1,) * max(members[0].ndim - 3, 0)
    # rows of numbers, whatever the bands: see `_methods.correlate_shifts`
    t = jnp.clip(position, 0, len(members) - 1).astype(members[0].dtype)
    t = materialise(lambda t: jnp.repeat(t, bands, axis=1), t).reshape(
        *batch, position.shape[0], -1
    )
    total = jnp.zeros((), t.dtype)
    for m, member in enumerate(members):
        hat = jnp.maximum(1 - jnp.abs(t - m), 0)
        total = total + hat * member.reshape(*member.shape[: len(batch)], position.shape[0], -1)
    return total.reshape(members[0].shape)


def _plane(picture: Picture) -> tuple[int, ...]:
    """Return (h, w) of a picture. Raise `ValueError` for any other array."""
    check_picture(picture)
    return picture.shape if picture.ndim == 2 else picture.shape[-3:-1]


def _check_map(name: str, values: Float[Array, "..."], picture: Picture) -> None:
    """Raise `ValueError` unless there is one value for each pixel of the picture's plane."""
    plane = _plane(picture)
    if values.shape != plane:
        raise ValueError(f"{name} must be {plane}, one a pixel, got {values.shape}.")
