"""Bound the change of irradiance, and the displacement of light, by each part of a lens.

The gain from radiance to irradiance of each pixel, its `brightness`, is the picture of a scene of
radiance 1. The bound for parts that change this gain (rim, distortion) is the largest change of the
gain over all pixels, times the largest radiance. The bound for parts that move light (distortion,
defocus, sampling inside a pixel) is the largest displacement in pixels. Defocus has a second bound,
the difference in a point's radiance between parts of the lens.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..optics import aperture_area, chief_slope, sensor_irradiance, sensor_vergence
from ..optics.diffraction import lens_kernel
from ..scene import Orthographic, Pinhole, ThinLens, View, Wavefront
from .boxes import corners, same, setting
from .cells import lens_radius
from .certificate import IRRADIANCE
from .pixel import INF, clean
from .sampling import oversampling_row, samples_row, times
from .stages import Arriving, Draft, Ends, OnSensor, Row

_KERNEL_ACCURACY = 2e-5  # accuracy of the shares of `airy_kernel`


def optics_stage(
    view: Ends[View], arriving: Arriving, *, samples: Any = None, oversampling: int = 1
) -> tuple[tuple[Row, ...], OnSensor]:
    """Return a `Row` for each part of a view, and the largest irradiance and gain on the sensor.
    The lens is evaluated on a grid with `oversampling` points along each side of a pixel."""
    radiance = np.asarray(arriving.radiance, float)
    grids = _Grids(view, oversampling)
    opening = grids.opening
    with np.errstate(invalid="ignore"):
        irradiance = np.nan_to_num(radiance * opening, nan=INF, posinf=INF)
    rows = []
    if getattr(view.high, "rim", None) is not None:
        rows.append(_row("rim", *rim(grids, radiance)))
    if getattr(view.high, "distortion", None) is not None:
        rows.append(_row("distortion", *distortion(grids, radiance)))
    if getattr(view.high, "diffraction", None) is not None:
        rows.append(_row("diffraction", *diffraction(view, irradiance, oversampling)))
    if isinstance(view.high, ThinLens):
        rows.append(_defocus_row(view, grids, arriving, radiance))
    if samples is not None:
        rows.append(samples_row(view, radiance))
    if oversampling > 1:
        rows.append(oversampling_row(view, opening, radiance, oversampling))
    return tuple(rows), OnSensor(irradiance, opening)


class _Grids:
    """Caches pictures of a scene of radiance 1, with and without parts of the lens. The grid of the
    pictures contains all samples of the pixel apertures."""

    def __init__(self, view: Ends[View], oversampling: int) -> None:
        self.view, self.oversampling = view, oversampling
        self.brightness = cache(self._brightness)
        self.slopes = cache(self._slopes)

    def drop(self, *parts: str) -> View:
        """Return the view without some parts, with one pixel for each sample of the apertures."""
        view, n = self.view.high, self.oversampling
        rows, columns = view.resolution
        view = replace(view, resolution=(n * rows, n * columns), pixel_pitch=view.pixel_pitch / n)
        there = {part: None for part in parts if getattr(view, part, None) is not None}
        return replace(view, **there) if there else view

    def has(self, part: str) -> bool:
        """Return whether the view has a part with this name."""
        return getattr(self.view.high, part, None) is not None

    @property
    def fixed(self) -> bool:
        """Whether all parameters that these pictures depend on are fixed."""
        names = set(vars(self.view.high)) - {"position", "rotation", "resolution"}
        return all(same(*self.view.field(name)) for name in names)

    @property
    def straight(self) -> bool:
        """Whether all distortion coefficients are 0, over the range of the free parameters."""
        ends = [getattr(end, "distortion", None) for end in self.view]
        return not any(np.any(np.asarray(leaf)) for leaf in jax.tree.leaves(ends))

    @property
    def opening(self) -> float:
        """The largest gain, W m^-2 per W m^-2 sr^-1, for any choice of dropped parts."""
        most = max(opening_of(view) for view in corners(self.view))
        if not self.has("distortion") or self.straight:
            return most
        if not self.fixed:
            return INF
        variants = [(), ("rim",)] if self.has("rim") else [()]
        return max(most, *(float(np.max(self.brightness(*parts))) for parts in variants))

    def _brightness(self, *gone: str) -> np.ndarray:
        """Compute the gain of each pixel, (h, w), without some parts and without diffraction."""
        view = self.drop("diffraction", *gone)
        ones = jnp.ones((*view.resolution, 1), view.pixel_pitch.dtype)
        return np.asarray(_brightness_of(view, ones), float)[..., 0]

    def _slopes(self, *gone: str) -> np.ndarray:
        """Compute slopes of chief rays, (2, h + 2, w + 2), of pixels and the picture's edges."""
        view = self.drop(*gone)
        dtype = view.pixel_pitch.dtype
        rows, columns = (
            jnp.asarray([-0.5, *range(size), size - 0.5], dtype) for size in view.resolution
        )
        return np.stack([np.asarray(x, float) for x in _slopes_at(view, rows, columns)])


@jax.jit
def _slopes_at(view: Pinhole | ThinLens, rows: jax.Array, columns: jax.Array) -> Any:
    over_columns = jax.vmap(chief_slope, in_axes=(None, None, 0))
    return jax.vmap(over_columns, in_axes=(None, 0, None))(view, rows, columns)


_brightness_of = jax.jit(sensor_irradiance)


def opening_of(view: View) -> float:
    """Return the gain on the axis, in W m^-2 per W m^-2 sr^-1: pi / (4 N^2) for a given f-number N,
    or the aperture's area over the squared distance to the sensor. The gain is 1 for a view that
    returns radiance. Rim, distortion and diffraction are not included."""
    if isinstance(view, ThinLens):
        area = float(aperture_area(view.aperture, view.focal_length / view.f_number))
        return area * float(sensor_vergence(view)) ** 2
    return 1.0 if view.f_number is None else math.pi / (4 * float(view.f_number) ** 2)


def rim(grids: _Grids, radiance: np.ndarray) -> tuple[np.ndarray, float, str]:
    """Bound the light that the rim of the lens removes by the largest difference between the gains
    without and with the rim.

    The bound is exactly 0 if every pixel sees the whole aperture through the rim. The bound is
    valid with and without the distortion of the lens.
    """
    if not grids.fixed:
        return np.full_like(radiance, INF), 0.0, "the lens may change"
    kept = [(), ("distortion",)] if grids.has("distortion") else [()]
    if all(_passes(grids, *parts) for parts in kept):
        return np.zeros_like(radiance), 0.0, "the rim cuts nothing off"
    lost = [grids.brightness(*parts, "rim") - grids.brightness(*parts) for parts in kept]
    most = max(float(x.max()) for x in lost) + _rounding(grids)
    clear = min(float(np.min(grids.brightness(*parts))) for parts in kept)
    return times(radiance, most), 0.0, f"the darkest pixel keeps {clear / grids.opening:.3g}"


def _passes(grids: _Grids, *gone: str) -> bool:
    """Return whether the rim clears the aperture for every pixel: r |1 - l / z_f| + l t <= R. Here
    r is the distance of the aperture's farthest point from the axis, l the rim's distance from the
    lens, z_f the focus distance, t the largest slope of a chief ray, and R the rim's radius."""
    view = grids.view.high
    assert isinstance(view, ThinLens)
    assert view.rim is not None
    steepest = float(np.hypot(*grids.slopes(*gone)).max())
    ahead = float(view.rim.distance)
    focus = 0.0 if view.focus_distance is None else 1 / float(view.focus_distance)
    radius = lens_radius(view) * abs(1 - ahead * focus)
    return (radius + ahead * steepest) * (1 + 1e-6) <= float(view.rim.diameter) / 2


def distortion(grids: _Grids, radiance: np.ndarray) -> tuple[np.ndarray, float, str]:
    """Bound distortion by the largest displacement and change of gain, with and without the rim."""
    if grids.straight:
        return np.zeros_like(radiance), 0.0, "all coefficients are 0"
    if not grids.fixed:
        return np.full_like(radiance, INF), INF, "the lens may change"
    view = grids.view.high
    assert not isinstance(view, Orthographic)
    moved = np.hypot(*(grids.slopes() - grids.slopes("distortion")))
    pixels = float(moved.max()) / (float(view.pixel_pitch) * float(sensor_vergence(view)))
    kept = [(), ("rim",)] if grids.has("rim") else [()]
    change = [grids.brightness(*p) - grids.brightness(*p, "distortion") for p in kept]
    most = max(float(np.abs(x).max()) for x in change) + _rounding(grids)
    why = f"light moves by {pixels:.3g} pixels and changes by {most / grids.opening:.3g} of it"
    return times(radiance, most), clean(pixels), why


def diffraction(
    view: Ends[View], irradiance: np.ndarray, oversampling: int
) -> tuple[np.ndarray, float, str]:
    """Bound the change of irradiance E by diffraction: (1 - k_0) sup E, where k_0 is the kernel's
    value at its centre. The bound follows because the kernel of the diffraction is positive and has
    sum 1.

    For a lens with free parameters, k_0 is at least the share of the widest diffraction pattern
    that falls on its central pixel. A narrower pattern has a larger share on its central pixel.
    Normalising the kernel to sum 1 does not reduce this share.
    """
    middles, lenses = [], corners(view)
    for lens in lenses:
        if not (isinstance(lens, ThinLens) and lens.diffraction is not None):
            continue
        fine = lens.pixel_pitch / oversampling
        if len(lenses) == 1:
            kernel = lens_kernel(lens, lens.diffraction, fine)
        elif isinstance(lens.diffraction, Wavefront):
            return irradiance, 0.0, "aberrations may take all light from the middle pixel"
        else:
            closed = not math.isfinite(float(lens.f_number))
            f_number = jnp.ones_like(lens.f_number) if closed else lens.f_number
            working = f_number / (sensor_vergence(lens) * lens.focal_length)
            wide = lens.diffraction.wavelength * working / fine
            middles.append(middle_pixel_share(np.asarray(wide, float)) - _KERNEL_ACCURACY)
            continue
        middles.append(np.asarray(kernel, float)[kernel.shape[0] // 2, kernel.shape[1] // 2])
    least = np.min(middles, axis=0)
    why = f"the middle pixel keeps {float(np.min(least)):.3g}"
    with np.errstate(invalid="ignore"):
        return irradiance * np.clip(1 - least, 0, 1), 0.0, why


def middle_pixel_share(width: np.ndarray) -> np.ndarray:
    """Return the smallest share of the light of an Airy pattern that falls on the pixel at the
    pattern's centre, (...) no unit. The product lambda N of the pattern's wavelength and f-number
    is at most `width` pixels. The share is

        1 - integral (J_0^2 + J_1^2) / (2 pi r^2) (r . n) ds

    over the pixel's border, where the vector r goes from the centre to the border, n is the outward
    unit normal, and the argument of the Bessel functions J is pi |r| / `width`.

    Source:
        Rayleigh's encircled energy and Gauss's theorem; Born and Wolf, Principles of Optics,
        section 8.5.2.
    """
    from scipy.special import j0, j1

    nodes, weights = np.polynomial.legendre.leggauss(64)
    r = np.hypot(0.5, nodes / 4 + 0.25)  # along half a side of the pixel; there are eight
    x = np.pi * r / np.maximum(width, 1e-300)[..., None]
    leaving = (j0(x) ** 2 + j1(x) ** 2) / (2 * np.pi * r**2)
    return np.where(width > 0, 1 - 8 * (leaving * weights / 8).sum(-1), 1.0)


def defocus(view: Ends[View], near: float, far: float, *, wider: float = 1.0) -> float:
    """Return the largest displacement of a ray by defocus, pixels: r z_i |1 / z - 1 / z_f| over the
    pitch.

    `near` and `far` are the smallest and largest depths in the picture, in m; inf is allowed.
    `wider` is the largest factor by which distortion magnifies small distances. The result is inf
    if objects may touch the lens.

    Here r is the distance of the aperture's farthest point from the axis, z_i the distance to the
    sensor, z the depth and z_f the focus distance. For a round aperture the result is half the
    diameter of the largest circle of confusion. The displacement is monotone in 1 / z, the focal
    length, the f-number and the focus distance. Its largest value is therefore at an end of the
    range of depths and of each free parameter.

    Source:
        Szeliski, Computer Vision, section 2.2.3.
    """
    widest = 0.0
    for lens in corners(view):
        assert isinstance(lens, ThinLens)
        focus = 0.0 if lens.focus_distance is None else 1 / float(lens.focus_distance)
        radius = lens_radius(lens)
        image = 1 / float(sensor_vergence(lens))
        for depth in (near, far):
            if depth <= 0:
                return INF if radius > 0 else 0.0
            away = abs((0.0 if math.isinf(depth) else 1 / depth) - focus)
            widest = max(widest, radius * image * away / float(lens.pixel_pitch))
    return clean(widest * wider)


def stretch(view: Pinhole | ThinLens, steepest: float) -> float:
    """Return the largest relative factor, >= 1, by which distortion magnifies small distances on
    the sensor. The norm of the derivative of the distortion is at most 1 + sum (2 i + 1) |k_i| r^2i
    + 6 |p| r, with the radial coefficients k_i, the tangential coefficients p, and the largest
    slope r of a chief ray in the picture."""
    if view.distortion is None:
        return 1.0
    radial = np.abs(np.asarray(view.distortion.radial, float))
    order = np.arange(1, radial.size + 1)
    grown = 1 + float(((2 * order + 1) * radial * steepest ** (2 * order)).sum())
    tangential = view.distortion.tangential
    if tangential is not None:
        grown += 6 * float(np.abs(np.asarray(tangential, float)).sum()) * steepest
    own = view.distortion.stretch
    return grown if own is None else grown * max(1.0, float(own))


def _defocus_row(view: Ends[View], grids: _Grids, arriving: Arriving, radiance: np.ndarray) -> Row:
    """Return the `Row` for replacing a lens by a pinhole with the same sensor distance and gain.
    The replacement displaces light that is out of focus. The replacement also changes the
    brightness of a point whose radiance differs between parts of the lens."""
    lens = view.high
    assert isinstance(lens, ThinLens)
    wider = 1.0
    if grids.has("distortion"):
        steepest = float(np.hypot(*grids.slopes()).max())
        wider = stretch(lens, steepest) if grids.fixed else INF
    moved = defocus(view, arriving.near, arriving.far, wider=wider)
    why = f"blurred by {2 * moved:.3g} pixels at most, of {arriving.near:.3g} m and beyond"
    if math.isinf(moved):
        why = "objects may touch the lens: their blur is not bounded"
    parts = frozenset(f"view.{part}" for part in ("rim", "diffraction") if grids.has(part))
    amount = times(arriving.turning, grids.opening) + np.zeros_like(radiance)
    bound = clean(np.max(amount))
    if math.isinf(bound):
        why += "; a mirror, glass or a material without a bound shows other objects to each part"
    elif bound > 0:
        why += "; gloss looks different from each part of the lens"
    drop = None if math.isinf(moved + bound) or opening_of(lens) == 0 else _to_pinhole
    more = {"unit": IRRADIANCE, "place": moved, "saves": 0.1, "needs": parts}
    return Row("view.defocus", amount, why, drop, **more)


def _to_pinhole(draft: Draft) -> Draft:
    lens = draft.camera.view
    assert isinstance(lens, ThinLens)
    hole = Pinhole(
        lens.position,
        lens.rotation,
        1 / sensor_vergence(lens),
        lens.pixel_pitch,
        resolution=lens.resolution,
        f_number=jnp.sqrt(jnp.pi / (4 * jnp.asarray(opening_of(lens), lens.pixel_pitch.dtype))),
        distortion=lens.distortion,
    )
    return replace(draft, camera=replace(draft.camera, view=hole))


def _row(name: str, amount: np.ndarray, place: float, why: str) -> Row:
    """Return the `Row` of a part of the lens that is dropped by setting its field to None."""
    drop = setting(f"camera.view.{name}")
    return Row(f"view.{name}", amount, why, drop, unit=IRRADIANCE, place=place, saves=0.3)


def _rounding(grids: _Grids) -> float:
    """Return the rounding error of a gain in the dtype of the view."""
    dtype = grids.view.high.pixel_pitch.dtype
    return 0.0 if dtype == np.float64 else 16 * float(jnp.finfo(dtype).eps) * grids.opening


# The functions that bound each part, by the name of its field.
BOUNDS: dict[str, Callable[..., Any]] = {
    function.__name__: function for function in (rim, distortion, diffraction, defocus)
}
