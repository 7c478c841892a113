"""Photometric stereo: normals and albedo from photographs under different lights, in closed form
for each pixel.

For a matte surface under a light of direction l and irradiance E, the reading of a pixel is
m = E rho n.l, with n its unit normal and rho its albedo in the unit of the readings over that of E.
Distant lights have the same l and E in all pixels. A near light of radiant intensity I at a
distance d from the point of the surface has E = I / d^2.
The reading is linear in the vector g = rho n. Therefore three lights determine g, and with more
lights g is estimated by least squares (Woodham, Optical Engineering 19, 1980). Attached and cast
shadows, clipped pixels and highlights are outliers of this model.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage
from scipy.special import ndtri, stdtrit
from threadpoolctl import threadpool_limits

from jaxvision import ArrayLike
from jaxvision.core.in_notebooks import figure_png, picture_html, record_html
from jaxvision.errors import InputError
from jaxvision.plots import pictures

from ..codes import converter_of
from ..copies import Copies
from ..inference.diagnostics import listed
from ..inference.formatting import format_percent, format_spread, format_with_error
from ..inference.given import plain_numbers, require_covariance
from ..observation import mosaic_contrast
from .models import has_lobe, shape_of
from .names import MODELS, Model
from .stereo_axes import axes_findings
from .stereo_interreflection import exchange_of, side_of_facets
from .stereo_lights import (
    EXPLAINED,
    FLAT,
    NORMAL_MAD,
    Common,
    Counted,
    Images,
    Matrices,
    OfPixels,
    Readings,
    Rows,
    Vectors,
    common_departure,
    directions_of,
    light_covariance,
    offset_in_shadow,
    predicted,
    solved,
    take_pixels,
)
from .stereo_misfit import Departures, departures, shared_squares
from .stereo_model import Surface, fitted_surface

ROUNDS = 30  # reweightings toward the least sum of absolute residuals
FAR = 2.5  # standard deviations at which a reading is left out (Rousseeuw & Leroy, 1987)
CHANCE = 0.01  # probability that a pixel without wrong readings leaves one out
RETURNS = 5  # rounds that accept excluded readings again, by the scatter of the accepted ones
CLEAR = 3.0  # standard deviations of a reading between its prediction and a limit
PASSES = 8  # at most, of a fit and the readings that it predicts between the limits
CONTRADICTED, USUAL = 0.5, 0.25  # share of contradicted pixels; largest in the median image
APART = 8.0  # ratio to the median image's median residual from which an image deviates
AGREE, TRIPLES = 5, 250  # least readings that agree; most triples of lights that are tried
FEWEST = 30  # fewest pixels to judge an image
HALF_NORMAL = 0.8318  # interquartile range of |x| if x is a Gaussian of unit variance
ALONE = 0.02  # logarithm of a factor from which an image deviates from those that agree
WHOLLY = 0.95  # share of residuals that factors explain if no image is of another scene
SHARED, SMALL = 0.5, 0.02  # shares of residuals' squares and of the albedo to be reported
FITTED = 256  # pixels of a first test whether a rough body explains residuals
SHOWN_BY = 32  # lights from which residuals reveal the effect of roughness on normals
NEGLIGIBLE = 1e-6  # of the albedo: departures from Lambert's law below it are rounding
SAME = 1e-3  # rad between lights of the same direction
DARK = 3.0  # standard errors from 0 within which the mean of images shows no light
RIVAL = 6  # least readings of a second set that agrees on another normal
NOISY = 0.01  # of the readings: residuals from which wrong readings in most pixels are looked for
VOTERS, LUCKY = 200, 0.1  # pixels that estimate their noise; share with enough right readings
SCATTERED = 0.25  # of the readings: residuals from which readings hardly show the normal
NOTICED = 0.5  # standard deviations by which interreflection rotates normals
STILL = 0.1  # standard deviations of the last change of normals without interreflection
MOST_ESTIMATES, MOST_ROUNDS = 4, 20  # with interreflection removed; rounds of each
SPOILED = 2.0  # ratio of residuals to noise from which most pixels have wrong readings
# lowest, highest, standard deviation of readings without light, and of all readings where most
# pixels have wrong ones (infinite where they do not)
Limits = tuple[float, float, float, float]
HEADS = ("", "median", "90 % of pixels in", "unit")


@dataclass(frozen=True)
class Stereo:
    """Normals, albedo and their errors for each pixel. Print the record, or show it in a notebook.

    Attributes:
        normals: (h, w, 3) unit normals, in the axes of the lights; NaN where the lights that are
            used have fewer than three directions, or have directions in one plane.
        albedo: (h, w) ratio of readings to irradiance.
        normal_sd: (h, w) standard deviation of the normal's direction, rad, as the root mean square
            over two axes. A cone whose half-angle is 2.448 times this standard deviation contains
            the normal with 95 % probability. NaN where only three lights are used, because a fit to
            three readings has no residual.
        albedo_sd: (h, w) standard deviation of the albedo, in its unit; NaN where `normal_sd` is
            NaN.
        used: (h, w) number of lights that are used.
        misfit: (h, w) standard deviation of departures from Lambert's law that neighbouring lights
            share, relative to the albedo; 0 where none is found. The standard deviations of normal
            and albedo include it.
        findings: sentences on images that do not match the others, on a surface that is not
            Lambertian, on images without light, and on normals that belong to no surface in the
            axes of the image.
        materials: by label, the parameters that its pixels share, with their standard deviations.
            For a lobe the parameters are the amplitude, in the unit of the albedo times the unit of
            the model's k_s, and the shape. For a rough surface the parameter is the roughness.
            Empty for Lambert's law.
    """

    normals: Float[np.ndarray, "h w 3"]
    albedo: Float[np.ndarray, "h w"]
    normal_sd: Float[np.ndarray, "h w"]
    albedo_sd: Float[np.ndarray, "h w"]
    used: Int[np.ndarray, "h w"]
    misfit: Float[np.ndarray, "h w"]
    findings: tuple[str, ...] = ()
    materials: Mapping[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def __str__(self) -> str:
        rows = [
            f"  {name}: median {middle}, 90 % of pixels in {ends} {unit}".rstrip()
            for name, middle, ends, unit in self._rows()
        ]
        return "\n".join([self._heading(), *rows, *(f"  {finding}" for finding in self.findings)])

    def _heading(self) -> str:
        found = int(np.isfinite(self.albedo).sum())
        return f"Normals and albedo at {found} of {self.albedo.size} pixels"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        maps = {
            "albedo": (self.albedo, "readings / irradiance"),
            "albedo: s.d.": (self.albedo_sd, "readings / irradiance"),
            "normal: s.d.": (self.normal_sd, "rad"),
            "lights that count": (self.used, ""),
        }
        rows = []
        for name, (values, unit) in maps.items():
            known = values[np.isfinite(values) & np.isfinite(self.albedo)]
            if known.size:
                rows.append((name, *format_spread(known), unit))
        return rows

    def _repr_html_(self) -> str:
        """Return the maps and their table as HTML for a notebook."""
        table = record_html(HEADS, self._rows(), title=self._heading(), notes=self.findings)
        known = self.albedo[np.isfinite(self.albedo)]
        if not known.size:
            return table
        white = np.percentile(known, 99) or 1.0
        shown = {"normals as colours": (1 + self.normals) / 2, "albedo": self.albedo / white}
        maps = pictures({name: np.nan_to_num(pixels) for name, pixels in shown.items()})
        return picture_html(figure_png(maps), table, meaning="normals and albedo")


@threadpool_limits.wrap(limits=1, user_api="blas")  # systems are too small for threads
def photometric_stereo(
    images: ArrayLike,
    lights: ArrayLike,
    *,
    intensities: ArrayLike | None = None,
    points: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
    lowest: float = 0.0,
    highest: float = np.inf,
    robust: bool = True,
    model: Model = "lambert",
    materials: ArrayLike | None = None,
    viewer: ArrayLike = (0.0, 0.0, 1.0),
    white: float | None = None,
    white_sd: float = 0.0,
) -> Stereo:
    """Estimate normals, albedo and their errors from photographs of one still view under distant
    or near lights.

    Args:
        images: (lights, h, w) linear readings without black level, in any unit. NaN marks a missing
            reading; the other readings of the pixel are used.
        lights: (lights, 3) unit vectors toward distant lights, in any axes, or positions of near
            lights if `points` is given. A finding says if normals belong to no surface with x right
            and y up in the image.
        intensities: (lights,) irradiance on a surface that faces a distant light, W m^-2, or
            radiant intensity of a near light, W sr^-1; both may be relative. None for 1.
        points: (h, w, 3) position of the surface in each pixel, in the axes and the unit of
            `lights`, such as the points of a plane or of a measured depth map. The irradiance of a
            near light falls with the square of its distance to the point. NaN for pixels without
            surface. The positions count as exact. None for distant lights.
        covariance: (lights, 4, lights, 4) covariance of directions or positions, and of the
            logarithms of intensities, as `fitting.lights.calibrate` returns it; None for exact
            lights.
        lowest: readings at or below this number are left out as shadow, in the unit of the images.
            Readings that the other images predict to be less than three standard deviations above
            this number are also left out. The noise of dark readings is estimated from readings
            below 0, or from the residuals of dim pixels. A reading within three standard deviations
            of `lowest` is left out even if fewer than three directions of light remain.
        highest: readings at or above this number are left out as clipped. Readings that the other
            images predict to be less than three standard deviations below this number are also left
            out. If `highest` is None and many readings equal the largest reading, the largest
            reading is used as the limit, and a finding says so.
        robust: whether to leave out readings that the other images contradict, as in highlights and
            cast shadows. A reading is left out if two conditions are met. First, it differs by more
            than 2.5 standard deviations from the fit of least absolute residuals. Second, its
            difference from the least-squares fit of the other readings is so large that chance
            would cause it in fewer than one of a hundred pixels. This test needs at least six
            usable lights. With five lights, the fit of four readings has only one residual. Then
            hardly any reading is left out, and the standard deviations include the contradiction.
            With two wrong readings among six, as at the rim of an object, a wrong one may remain
            and the normal be wrong by 0.25 rad. An image that the others contradict in most pixels
            is left out as a whole, and a finding names it. Of at least five images, an image that
            is brighter or darker than predicted by one factor in all pixels is also left out.
        model: reflectance model, one of those that `calibrate` fits. A lobe is added to a
            Lambertian surface whose albedo differs between pixels. All pixels of a material share
            the amplitude and the shape of the lobe, or the roughness. Facets have an index of
            refraction of 1.5.
        materials: (h, w) integers, one label for each material; pixels with negative labels are
            Lambertian. None for one material.
        viewer: (3,) unit vector toward the camera, in the axes of the lights. The vector is used by
            a `model` other than Lambert's, by the comparison with a rough surface, and by the check
            of the axes.
        white: albedo of a surface that reflects all light, in the unit of the result's albedo, as
            measured on a white reference in the same light. Interreflection is then removed. None
            neglects it.
        white_sd: standard error of `white`.

    Returns:
        Normals, albedo and their standard deviations. The standard deviations are computed from the
        residuals of each pixel, with the distribution of the residuals over all pixels as prior. If
        residuals show that the surface is not Lambertian or the readings are not linear, the
        standard deviations include the departures that neighbouring lights share, and a finding
        says so. With fewer than 32 lights, the standard deviations also include the change of the
        normal by roughness (Oren and Nayar's model), if roughness explains the residuals. Roughness
        rotates normals toward the viewer and leaves hardly any residual. A finding names a factor
        of one light's intensity, or an offset of all readings, if it explains the residuals of all
        pixels. An offset is also found from pixels that face away from a light. The normals are not
        corrected for such factors or offsets, but the standard deviations include the change that a
        correction would make. If no pixel faces away from a light, an offset is not identifiable
        under lights of equal elevation. On simulated balls under 6 to 96 lights, cones of 95 %
        contained the true normal in 93 to 98 % of the pixels of a matte ball, in 92 to 100 % of a
        glossy one and in 91 to 100 % of a rough one. With a `model`, departures are measured from
        this model, and the standard deviations include the errors of its parameters.
        Interreflection between parts of a surface has the effect of another normal and leaves
        hardly any residual. With `white`, interreflection is computed from the normals and the
        images and removed, in rounds until the normals no longer change. The standard deviations
        then include the error of `white`, the last change, and the change from facets of twice the
        size. Light from surfaces outside the images is not included.

    Raises:
        InputError: for fewer than three lights, lights in one plane, shapes that do not agree, and
            a `covariance` that is not finite, symmetric and positive semi-definite, and lights at
            a point of the surface; for `white` with `points`, or with a viewer that is not z.

    Example:
        >>> import numpy as np
        >>> from fitting.reflectance import photometric_stereo
        >>> lights = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])
        >>> readings = 100 * lights @ [0.0, 0.0, 1.0]  # a plane that faces the camera
        >>> found = photometric_stereo(readings[:, None, None], lights)
        >>> print(found.normals[0, 0].round(6) + 0.0, found.albedo[0, 0].round(6))
        [0. 0. 1.] 100.0
    """
    stack, rows, distances = _check_images(images, lights, intensities, points)
    infinite = np.isinf(stack)
    missing = _infinite_finding(int(infinite.sum())) if infinite.any() else ()
    stack = np.where(infinite, np.nan, stack)
    missing += _wrapped_finding(plain_numbers("images", images))
    labels, toward = _checked_materials(stack, model, materials, viewer)
    together = None if covariance is None else _common_errors(covariance, len(stack))
    clipped: tuple[str, ...] = ()
    if np.isinf(highest) and (top := converter_of(stack).clips_at) is not None:
        highest, clipped = top, (_clipped_finding(stack.reshape(len(stack), -1), top),)
    read = (*missing, *clipped, *_copies(stack), *_mosaic_finding(stack))

    def estimate(images: Images) -> Stereo:
        return _estimate(
            images, rows, distances, together, lowest, highest, robust, model, labels, toward
        )

    if white is not None and not (0 < white < np.inf and 0 <= white_sd < np.inf):
        raise InputError(f"white must be above 0, and white_sd at least 0: {white}, {white_sd}.")
    found, more = estimate(stack), ()
    if distances is None and abs(toward[2]) > 1 - 1e-6:
        axes = np.array([1, *np.sign(toward[[2, 2]])])
        scene = _Hollow(stack, rows, (stack > lowest) & (stack < highest), axes)
        if white is None:
            more = _interreflection_finding(found, scene)
        else:
            found, more = _without_interreflection(found, estimate, scene, white, white_sd)
    elif white is not None:
        raise InputError("white needs distant lights, and axes with z toward the camera.")
    return replace(found, findings=read + found.findings + more)


def _estimate(
    stack: Images,
    rows: Rows,
    distances: np.ndarray | None,
    together: np.ndarray | None,
    lowest: float,
    highest: float,
    robust: bool,
    model: Model,
    labels: np.ndarray,
    toward: np.ndarray,
) -> Stereo:
    """Estimate normals and albedo from readings that contain direct light only."""
    readings = stack.reshape(len(stack), -1)
    between = (readings > lowest) & (readings < highest)
    noise, scattered = np.inf, ()
    if robust:
        noise, scattered = _noise_among_wrong(rows, readings, between, stack.shape)
    first = _consistent(rows, readings, between, noise) if robust else between
    limits = (lowest, highest, _dark_noise(rows, readings, first), noise)
    unlit = _unlit_finding(readings, between, limits)
    between &= not unlit
    counts = _used_readings(rows, readings, between, limits, robust=robust)
    surface, linear, tilt, remarks = None, rows, 0.0, ()
    if model != "lambert":
        start = solved(rows, readings, counts.astype(float))[0]
        surface = fitted_surface(model, rows, readings, between, start, labels.ravel(), toward)
        linear, tilt = surface.slopes, surface.tilt(rows)
        readings = readings - surface.extra
        counts = _used_readings(rows, readings, between, limits, robust=robust)
    apart, findings = _contradicted_images(rows, readings, counts, limits)
    common, alone = _common(rows, readings, between, limits, robust=robust)
    if common is not None and common.explained > WHOLLY and (alone > apart).any():
        apart, findings = np.zeros_like(apart), ()  # factors explain the contradiction
    if robust and apart.any():
        between[apart] = False
        common, alone = _common(rows, readings, between, limits, robust=robust)
    if common is not None and alone.any():
        between[alone] = False
        findings += _deviating_factors_finding(common, alone)
        common, _ = _common(rows, readings, between, limits, robust=False)
    measured = stack.reshape(len(stack), -1)
    shadow = offset_in_shadow(rows, readings, counts & between, measured)
    if shadow is not None and (
        common is None
        or common.offset
        or _common(rows, shadow.removed(readings), between, limits, robust=False)[0] is None
    ):
        common = shadow
    agreeing = readings
    if apart.any() or alone.any() or common is not None:
        agreeing = readings if common is None else common.removed(readings)
        counts = _used_readings(rows, agreeing, between, limits, robust=robust)
    shape, undecided = stack.shape, np.zeros(readings.shape[1], bool)
    against, wild = _contradicted_pixels(rows, agreeing, counts, between, limits)
    for lost in (against, wild):
        if robust:
            undecided |= lost
        shaped = (counts & ~undecided).reshape(shape)
        found = departures(rows, (agreeing + tilt).reshape(shape), shaped, linear)
        if found.significant or not (wild & ~undecided).any():
            break  # departures from the model include the scatter of such pixels
    counts &= ~undecided
    g, _ = solved(linear, readings + tilt, found.weights)
    covariance_of_g, rough = found.covariance, None
    if surface is not None:
        covariance_of_g = covariance_of_g + surface.covariance
        remarks = _materials_finding(model, surface)
    elif found.significant and np.median(counts.sum(axis=0)[np.isfinite(g[:, 0])]) < SHOWN_BY:
        rough = _rough_body(rows, readings, shaped, found, toward)
    if rough is not None and (common is None or common.explained < rough.explained):
        covariance_of_g, common = rough.covariance, None
    if common is not None:
        covariance_of_g = departures(
            rows, (readings + tilt).reshape(shape), shaped, linear
        ).covariance
        moved = solved(linear, agreeing + tilt, found.weights)[0] - g
        covariance_of_g = covariance_of_g + moved[:, :, None] * moved[:, None, :]
        findings += (_common_factor_finding(common, moved / _typical(g)),)
        rough = None
    if together is not None:
        covariance_of_g = covariance_of_g + light_covariance(
            rows, found.weights, found.inverse, g, together, distances
        )
    albedo = np.linalg.norm(g, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = g / albedo[:, None]
        normal_sd, albedo_sd = _deviations(normals, albedo, covariance_of_g)
        misfit = np.where(np.isfinite(albedo), found.size / albedo, np.nan)
        by_noise = _deviations(normals, albedo, found.inverse * found.noise[:, None, None])[0]
    if found.significant and np.nanmedian(misfit) > NEGLIGIBLE:
        findings += (
            _misfit_finding(model, misfit, normal_sd / by_noise, counts.sum(axis=0), rough),
        )
    if not findings:
        findings = unlit or _contradiction_finding(rows, readings.reshape(shape), between, limits)
    if undecided.any():
        findings += (
            f"At {int(undecided.sum())} pixels the readings contradict each other so that no set "
            "of them prevails, as where cast shadows or highlights lie under about half of the "
            "lights. They have no normal; use more lights.",
        )
    seen = np.isfinite(albedo)
    exact = seen & np.isnan(normal_sd)
    if exact.sum() > seen.sum() / 2:
        findings += (_exact_finding(exact.sum() / seen.sum()),)
    repeated = seen & ~exact & (_distinct(rows, counts) == 3)
    if repeated.sum() > seen.sum() / 2:
        findings += (_repeated_finding(repeated.sum() / seen.sum()),)
    normals = normals.reshape(*shape[1:], 3)
    return Stereo(
        normals,
        albedo.reshape(shape[1:]),
        normal_sd.reshape(shape[1:]),
        albedo_sd.reshape(shape[1:]),
        counts.sum(axis=0).reshape(shape[1:]),
        misfit.reshape(shape[1:]),
        (
            *scattered,
            *remarks,
            *findings,
            *axes_findings(normals, toward),
        ),
        {} if surface is None else surface.numbers,
    )


@dataclass(frozen=True)
class _Hollow:
    """Images of a surface whose parts light each other; normals in `axes` have x right, y up and z
    to the camera."""

    stack: Images
    rows: Rows
    between: Bool[np.ndarray, "lights h w"]
    axes: Float[np.ndarray, "3"]

    def added(self, g: np.ndarray, white: float, scale: int = 1) -> np.ndarray | None:
        """Return the readings that interreflection adds on a surface of this g; None without a
        hollow."""
        albedo = np.linalg.norm(g, axis=-1)
        exchange = exchange_of(g / albedo[..., None] * self.axes, scale=scale)
        if exchange is None:
            return None
        share = np.clip(np.nan_to_num(albedo / white), 0, 1)
        return share * exchange.irradiance(np.nan_to_num(self.stack))

    def change(self, g: np.ndarray, added: Images) -> np.ndarray:
        """Return the least-squares change of g from lit readings if `added` is part of the
        readings."""
        flat = g.reshape(-1, 3)
        lit = self.between.reshape(len(self.stack), -1)
        lit = lit & (np.nan_to_num(predicted(self.rows, flat)) > 0)
        readings = added.reshape(len(added), -1)
        return solved(self.rows, readings, lit.astype(float))[0].reshape(g.shape)

    def share(self, added: Images) -> str:
        lit = self.between & (self.stack > added)
        return format_percent(np.median(added[lit] / self.stack[lit]) if lit.any() else 0.0)


def _interreflection_finding(found: Stereo, scene: _Hollow) -> tuple[str, ...]:
    """Return a sentence on the light that parts of a hollow send each other, if it matters."""
    g = found.normals * found.albedo[..., None]
    known = found.albedo[np.isfinite(found.albedo)]
    added = scene.added(g, float(np.percentile(known, 99))) if known.size else None
    if added is None:
        return ()
    turned = _rotation(g, g - scene.change(g, added))
    errors = _middle(turned / np.nan_to_num(found.normal_sd, nan=SAME))
    if not errors > NOTICED:
        return ()
    known_sd = np.isfinite(found.normal_sd).any()
    size = f"{errors:.1f} standard deviations, " if known_sd else ""
    return (
        "The normals form a hollow, whose parts light each other. If its brightest pixels reflect "
        f"all light, this adds {scene.share(added)} to the readings (median) and rotates normals "
        f"by {np.degrees(_middle(turned)):.2g} degrees, {size}which the standard deviations do not "
        "include; if they reflect half of it, about half as much. Give white, the albedo of a "
        "surface that reflects all light, to remove this light.",
    )


def _without_interreflection(
    first: Stereo,
    estimate: Callable[[Images], Stereo],
    scene: _Hollow,
    white: float,
    white_sd: float,
) -> tuple[Stereo, tuple[str, ...]]:
    """Remove the light that parts of the surface send each other. The shape gives the
    interreflected light, which is subtracted before the next estimate of the shape. In an inner
    loop the shape changes by least squares; an outer loop repeats the whole estimate. The standard
    deviations include the error of `white`, the last change, and the difference from facets of
    twice the size."""
    found, change = first, np.inf
    last = g = found.normals * found.albedo[..., None]
    added = before = np.zeros(scene.stack.shape)
    for estimates in range(1, MOST_ESTIMATES + 1):
        start, noise = g, np.nan_to_num(found.normal_sd, nan=SAME)
        for _ in range(MOST_ROUNDS):
            received = scene.added(g, white)
            if received is None:
                return found, ()
            added = received
            last, g = g, start - scene.change(start, added - before)
            if not _middle(_rotation(last, g) / noise) >= STILL / 10:
                break
        found = estimate(np.where(scene.between, scene.stack - added, scene.stack))
        last, g, before = g, found.normals * found.albedo[..., None], added
        change = _middle(_rotation(last, g) / np.nan_to_num(found.normal_sd, nan=SAME))
        if estimates > 1 and not change > STILL:
            break
    coarse = scene.added(g, white, scale=2)
    by_grid = scene.change(g, added - (0 if coarse is None else coarse))
    errors = np.stack([g - last, by_grid, scene.change(g, added) * (white_sd / white)])
    along = (errors * found.normals).sum(axis=-1)
    aside = np.square(errors).sum(axis=-1) - along**2
    width = 2 * side_of_facets(found.albedo.shape) + 1  # grids differ somewhere near a fold
    aside[1] = ndimage.maximum_filter(np.nan_to_num(aside[1]), width)
    turned = _rotation(first.normals, found.normals)
    said = (
        f"The surface is a hollow, whose parts add {scene.share(added)} to the readings (median). "
        "Without this light, normals are rotated by "
        f"{np.degrees(_middle(turned)):.2g} degrees (median).",
    )
    if change > STILL:
        said += (
            f"The last round changed normals by {change:.1f} standard deviations, so the rounds "
            "did not converge; the standard deviations include this change.",
        )
    if (above := float(np.mean(found.albedo > white))) > SMALL:
        said += (
            f"white = {white:.4g} is below the albedo of {format_percent(above)} of the pixels, "
            "which would reflect more light than they receive; check white, and the intensities of "
            "the lights.",
        )
    normal_sd = np.sqrt(found.normal_sd**2 + aside.sum(axis=0) / 2 / found.albedo**2)
    albedo_sd = np.sqrt(found.albedo_sd**2 + (along**2).sum(axis=0))
    return replace(found, normal_sd=normal_sd, albedo_sd=albedo_sd), said


def _middle(values: np.ndarray) -> float:
    """Return the median of the finite values; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else np.nan


def _rotation(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between vectors, rad."""
    size = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    sine = np.linalg.norm(np.cross(first, second), axis=-1) / size
    return np.arctan2(sine, (first * second).sum(axis=-1) / size)


def _materials_finding(model: Model, surface: Surface) -> tuple[str, ...]:
    names = ["specular"] * has_lobe(model) + [shape_of(model).name]
    return tuple(
        f"Material {label} ({model}) has "
        + listed(
            [
                f"{name} = {format_with_error(*numbers)}"
                for name, *numbers in zip(names, *found, strict=True)
            ]
        )
        + "."
        for label, found in surface.numbers.items()
    )


@dataclass(frozen=True)
class _Rough:
    """The change of the normals if a rough surface model replaces Lambert's law."""

    covariance: Matrices  # of g, including the change by the rough body
    sigma: float  # roughness, rad
    sigma_sd: float
    explained: float  # share of the residuals' squares
    turned: float  # rad, median change of the normals


def _rough_body(
    rows: Rows,
    readings: Readings,
    counts: Bool[np.ndarray, "lights h w"],
    found: Departures,
    viewer: Float[np.ndarray, "3"],
) -> _Rough | None:
    """Fit a rough surface (Oren-Nayar), and return it if it explains the residuals of Lambert's
    law. Roughness rotates the fitted normals toward the viewer and leaves hardly any residual under
    few lights. The detected departures from Lambert's law remain in the covariance, unless
    roughness explains all of them.
    """
    weights = found.weights
    flat = counts.reshape(len(readings), -1)
    g = solved(rows, readings, weights)[0]
    plain = np.where(flat, readings - predicted(rows, g), 0)
    lit = np.flatnonzero(np.isfinite(g[:, 0]) & (flat.sum(axis=0) > 3))
    labels = np.full(len(g), -1)
    labels[lit[:: -(-len(lit) // FITTED)]] = 0
    for part in (labels, np.where(np.isin(np.arange(len(g)), lit), 0, -1)):
        body = fitted_surface("oren-nayar", rows, readings, flat, g, part, viewer)
        if not body.numbers:
            return None
        bent = readings - body.extra + body.tilt(rows)
        own = solved(body.slopes, bent, weights)[0]
        left = np.where(flat, bent - predicted(body.slopes, own), 0)
        some = (part == 0) & np.isfinite(own[:, 0])
        explained = 1 - float((left[:, some] ** 2).sum() / (plain[:, some] ** 2).sum())
        if explained < EXPLAINED:
            return None
    after = departures(rows, bent.reshape(counts.shape), counts, body.slopes)
    own_covariance = (found if after.significant else after).covariance
    moved = np.where(some[:, None], own - g, 0)
    (sigma, sd) = (float(x[0]) for x in body.numbers[0])
    turned = np.linalg.norm(np.cross(g, own), axis=1) / np.linalg.norm(g, axis=1)
    turned = np.arcsin(np.clip(turned[some] / np.linalg.norm(own[some], axis=1), 0, 1))
    return _Rough(
        own_covariance + body.covariance + moved[:, :, None] * moved[:, None, :],
        sigma,
        sd,
        explained,
        float(np.median(turned)),
    )


def _exact_finding(share: float) -> str:
    return (
        f"At {format_percent(share)} of the pixels only three lights are used. They leave no "
        "residuals, so normal and albedo have no standard deviation there, and errors of the "
        "lights or of the model do not show. Use four lights or more."
    )


def _distinct(rows: Rows, counts: Counted) -> Int[np.ndarray, " pixels"]:
    """Return the number of distinct directions among the lights that each pixel uses."""
    directions = directions_of(rows)
    alike = np.linalg.norm(directions[:, None] - directions, axis=-1) < SAME
    first = np.unique(np.argmax(alike, axis=1), return_inverse=True)[1]
    return np.sum([counts[first == one].any(axis=0) for one in range(first.max() + 1)], axis=0)


def _repeated_finding(share: float) -> str:
    return (
        f"At {format_percent(share)} of the pixels the lights that are used have three distinct "
        "directions, some of them repeated. Their residuals show noise alone, so the standard "
        "deviations of normal and albedo do not include errors of the lights or of the model. Use "
        "four directions or more."
    )


def _infinite_finding(count: int) -> tuple[str, ...]:
    return (
        f"{count} readings are infinite, as where a number is too large for its type (float16 ends "
        "at 65504), and were left out.",
    )


def _wrapped_finding(images: ArrayLike) -> tuple[str, ...]:
    """Return a sentence if some unsigned integers lie near the largest number of their type, far
    above all others, as after a subtraction that passed below 0."""
    codes = np.asarray(images)
    if codes.dtype.kind != "u":
        return ()
    top = int(np.iinfo(codes.dtype).max)
    upper = codes > top - top // 16
    between = (codes > top - top // 4) & ~upper
    if upper.sum() < FEWEST or between.any() or np.unique(codes[upper]).size < 2:
        return ()
    return (
        f"{upper.sum()} readings are from {codes[upper].min()} to {codes[upper].max()}, far above "
        f"all others, as where a subtraction of unsigned integers ({codes.dtype}) passes below 0 "
        "and wraps; convert the images to floating numbers before black is subtracted.",
    )


def _clipped_finding(readings: Readings, top: float) -> str:
    lit, at = np.sum(readings > 0), np.sum(readings >= top)
    return (
        f"{at} readings ({format_percent(at / lit)} of those above 0) are equal to the largest, "
        f"{top:.6g}, as in clipped images, and were left out; give highest to choose another "
        "limit."
    )


def _unlit_finding(readings: Readings, between: Counted, limits: Limits) -> tuple[str, ...]:
    """Return a sentence on why no pixel has a normal: too few readings lie between the limits, or
    they scatter about 0 as noise does."""
    known = readings[~np.isnan(readings)]
    if (between.sum(axis=0) >= 3).any():
        mean, error = known.mean(), known.std() / np.sqrt(known.size)
        low, middle, high = np.quantile(known, [0.001, 0.5, 0.999])
        if mean > DARK * error or high - middle > 2 * (middle - low):
            return ()
        reason = (
            f"the readings scatter evenly about {format_with_error(mean, error)}, as noise does"
        )
    else:
        dark, bright = (known <= limits[0]).sum(), (known >= limits[1]).sum()
        reason = (
            f"{dark} of {readings.size} readings are at or below lowest = {limits[0]:g}, {bright} "
            f"are at or above highest = {limits[1]:g}, and {readings.size - known.size} are missing"
        )
    return (
        f"No pixel has a normal, because {reason}; check the files, the black level, and lowest "
        "and highest.",
    )


def _deviations(
    normals: Vectors, albedo: OfPixels, covariance: Matrices
) -> tuple[OfPixels, OfPixels]:
    """Return standard deviations of the normal, rad, and of the albedo, from the covariance of
    g."""
    along = np.einsum("pi,pij,pj->p", normals, covariance, normals)
    aside = (np.trace(covariance, axis1=-2, axis2=-1) - along) / 2
    return np.sqrt(aside) / albedo, np.sqrt(along)


def _common(
    rows: Rows, readings: Readings, between: Counted, limits: Limits, *, robust: bool
) -> tuple[Common | None, Bool[np.ndarray, " lights"]]:
    """Return factors of the lights, or an offset, that are common to all pixels, and the lights
    whose factor deviates if there are few such lights.
    """
    counts = _used_readings(rows, readings, between, limits, robust=False)
    common = common_departure(rows, readings, counts)
    if common is None or not robust:
        return common, np.zeros(len(rows), bool)
    off = np.abs(np.log(common.factors))
    alone = off > ALONE
    few = alone.sum() <= min(between.any(axis=1).sum() - 4, (len(rows) - 1) // 2)
    others_agree = 10 * off[~alone].max(initial=0) < off[alone].min(initial=np.inf)
    return common, alone & few & others_agree


def _deviating_factors_finding(
    common: Common, alone: Bool[np.ndarray, " lights"]
) -> tuple[str, ...]:
    return tuple(
        f"images[{i}] is {format_with_error(common.factors[i], common.factor_sds[i])} times as "
        "bright as the other images predict, by the same factor in all pixels, and was left out: "
        "its intensity or exposure time is not as stated."
        for i in np.flatnonzero(alone)
    )


def _common_factor_finding(common: Common, moved: Vectors) -> str:
    allowed = (
        f"would change g = rho n by {format_percent(_typical(moved), decimals=1)} of the albedo "
        "(median over pixels), which the standard deviations include."
    )
    if common.offset:
        offset = format_with_error(common.offset, common.offset_sd)
        seen = f"All readings have a common offset of {offset}."
        if not common.explained:
            seen = f"Pixels that face away from a light read {offset} in place of 0."
        return (
            f"{seen} Causes are room light or a black level that was not subtracted, one "
            "subtracted twice (a negative offset), or a surface that is not Lambertian. Removing "
            f"it {allowed} Subtract it from the images if you know its cause."
        )
    shown = listed([f"{value:.3f}" for value in common.factors])
    return (
        "The images contradict the intensities of the lights. They agree with the intensities "
        f"multiplied by the factors {shown} (standard errors up to {common.factor_sds.max():.2g}; "
        "the common scale is arbitrary). Causes are wrong intensities or exposure times, or a lamp "
        "that drifts. "
        f"They explain {format_percent(common.explained)} of the residuals' sum of squares. "
        f"Applying them {allowed} If so, multiply the intensities by these factors."
    )


def _contradiction_finding(
    rows: Rows, stack: Images, between: Counted, limits: Limits
) -> tuple[str, ...]:
    """Return a sentence if the readings of most pixels differ from Lambert's law, and neighbouring
    pixels do so in the same way.
    """
    readings = stack.reshape(len(rows), -1)
    counts = _used_readings(rows, readings, between, limits, robust=False)
    g, _, scatter, _ = _least_squares(rows, readings, counts)
    counts &= np.isfinite(g[:, 0])
    residuals = np.where(counts, readings - predicted(rows, g), 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(scatter) / np.linalg.norm(g, axis=1)
    lit = size[np.isfinite(size)]
    shared = shared_squares(residuals.reshape(stack.shape), counts.reshape(stack.shape))
    if shared < SHARED or not lit.size or np.median(lit) < SMALL:
        return ()
    return (
        f"The images contradict m = E rho n.l by {format_percent(np.median(lit))} of the albedo "
        "(median over pixels), and neighbouring pixels in the same way: they share "
        f"{format_percent(shared)} of the residuals' sum of squares. Causes are wrong directions, "
        "order or intensities of the lights, a black level, a gamma, highlights, shadows or a "
        "surface that is not Lambertian; the images alone do not show which. The errors of "
        "normals may be larger than their standard deviations.",
    )


def _misfit_finding(
    model: Model,
    misfit: OfPixels,
    wider: OfPixels,
    used: Int[np.ndarray, " pixels"],
    rough: _Rough | None,
) -> str:
    few = (
        f" With only {np.median(used):.0f} lights they are lower bounds: a rough surface may bias "
        f"normals by twice as much; {SHOWN_BY} lights would show it."
        if np.median(used) < SHOWN_BY
        else ""
    )
    if rough is not None:
        sigma, sd, turned = np.degrees([rough.sigma, rough.sigma_sd, rough.turned])
        few = (
            f" A rough body (Oren-Nayar, sigma = {format_with_error(sigma, sd)} degrees) explains "
            f"{format_percent(rough.explained)} of the residuals' squares. It would rotate normals "
            f"by {turned:.2g} degrees (median), which the standard deviations include. If the "
            'surface is rough, give model = "oren-nayar".'
        )
    surface, law, near = "is not Lambertian", "m = E rho n.l", ""
    if model != "lambert":
        surface, law = f"does not follow {model}", "the model"
        near = ", or the camera is not far away (viewer is the same in all pixels)"
    return (
        f"The surface {surface}, or the readings are not linear (room light, a black level, "
        f"a gamma, clipped pixels), or the lights are not as stated{near}: under neighbouring "
        f"lights, the readings depart from {law} in the same way, by "
        f"{format_percent(np.nanmedian(misfit), decimals=1)} of the albedo (median over pixels). "
        "The standard deviations of normals include this and are "
        f"{np.nanmedian(wider):.1f} times those of noise alone.{few}"
    )


def _copies(stack: Images) -> tuple[str, ...]:
    copies = Copies()
    for i, image in enumerate(stack):
        copies.add(f"images[{i}]", image)
    return tuple(
        f"{listed(list(files))} hold equal numbers: they are copies of one exposure, under "
        "lights of which all but one are wrong or counted twice; keep one of them."
        for files in copies.equal_groups
    )


def _mosaic_finding(stack: Images) -> tuple[str, ...]:
    contrast = mosaic_contrast(stack.mean(axis=0))
    return (
        f"Neighbouring pixels differ by {format_percent(contrast)} in a pattern of 2 x 2 pixels, "
        "as in a raw colour mosaic. The albedo includes this pattern; give one colour at a time.",
    ) * bool(contrast)


def _contradicted_images(
    rows: Rows, readings: Readings, counts: Counted, limits: Limits
) -> tuple[Bool[np.ndarray, " lights"], tuple[str, ...]]:
    """Return the images that contradict the other images in most pixels, with findings. Only pixels
    that the other images predict to lie between the limits are counted."""
    g, _, scatter, used = _least_squares(rows, readings, counts)
    expected = _within_limits(rows, g, scatter, limits) & ~np.isnan(readings) & (used > 3)
    total = np.maximum(expected.sum(axis=1), 1)
    share = (expected & ~counts).sum(axis=1) / total
    miss = np.where(expected, np.abs(readings - predicted(rows, g)), np.nan)
    size = np.array([np.median(m[~np.isnan(m)]) if (~np.isnan(m)).any() else 0.0 for m in miss])
    size /= np.linalg.norm(rows, axis=-1).reshape(len(rows), -1).mean(axis=1)
    apart = (share > CONTRADICTED) & (size > APART * np.median(size)) & (total >= FEWEST)
    if not apart.any() or np.median(share) > USUAL or apart.sum() > len(rows) - 4:
        return np.zeros(len(rows), bool), ()
    return apart, tuple(
        f"images[{i}] contradicts the other images in {format_percent(share[i])} of the pixels "
        f"that these predict to be lit under it (by {format_percent(size[i] / _typical(g))} of "
        "the albedo in the median), and was left out. Causes are a wrong file, direction or "
        "intensity of the light, a black frame, or a highlight over all of them."
        for i in np.flatnonzero(apart)
    )


def _typical(g: Vectors) -> float:
    return float(np.nanmedian(np.linalg.norm(g, axis=1)))


def _check_images(
    images: ArrayLike,
    lights: ArrayLike,
    intensities: ArrayLike | None,
    points: ArrayLike | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return the images, E l of each light, and the distances (lights, pixels) of near lights.
    Readings of pixels without a point are missing.
    """
    stack = np.asarray(plain_numbers("images", images), float)
    places = np.asarray(plain_numbers("lights", lights), float)
    if stack.ndim != 3 or places.shape != (len(stack), 3):
        raise InputError(
            f"images (lights, h, w) and lights (lights, 3) do not agree: got {stack.shape} and "
            f"{places.shape}; give one direction an image, and one channel at a time."
        )
    if not stack.size:
        raise InputError(f"images have no pixels: got {stack.shape}.")
    strengths = np.ones(len(stack))
    if intensities is not None:
        strengths = np.asarray(plain_numbers("intensities", intensities), float)
    if strengths.shape != (len(stack),) or not ((strengths > 0) & (strengths < np.inf)).all():
        raise InputError(f"intensities must be {len(stack)} numbers above 0, got {strengths}.")
    if points is None:
        lengths = np.linalg.norm(places, axis=1)
        if not np.allclose(lengths, 1, atol=1e-3):
            raise InputError(
                f"lights must be unit vectors, got lengths {lengths.round(4)}; for positions of "
                "near lights, also give points."
            )
        rows, distances = places * strengths[:, None], None
    else:
        stack, toward, distances = _light_vectors(stack, places, points)
        rows = toward * (strengths[:, None] / distances**3)[:, :, None]
    sizes = np.linalg.svd(directions_of(rows), compute_uv=False)
    if len(stack) < 3 or sizes[2] < FLAT * sizes[0]:
        raise InputError("normals need three lights that do not lie in one plane; add a light.")
    return stack, rows, distances


def _light_vectors(
    stack: Images, places: Float[np.ndarray, "lights 3"], points: ArrayLike
) -> tuple[Images, np.ndarray, np.ndarray]:
    """Return the images, and the vectors and distances from each point to each light."""
    surface = np.asarray(plain_numbers("points", points), float)
    if surface.shape != (*stack.shape[1:], 3):
        raise InputError(
            f"points must be {(*stack.shape[1:], 3)}, a position (x, y, z) a pixel, got "
            f"{surface.shape}."
        )
    surface = surface.reshape(-1, 3)
    known = np.asarray(np.isfinite(surface).all(axis=1))
    if not known.any():
        raise InputError("points are not finite in any pixel; give the position of the surface.")
    toward = places[:, None] - np.where(known[:, None], surface, surface[known].mean(axis=0))
    distances = np.linalg.norm(toward, axis=-1)
    if not (distances > 0).all():  # also where a light is NaN
        raise InputError("lights must be finite positions away from all points of the surface.")
    return np.where(known.reshape(stack.shape[1:]), stack, np.nan), toward, distances


def _checked_materials(
    stack: np.ndarray, model: Model, materials: ArrayLike | None, viewer: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    if model not in MODELS:
        raise InputError(f"model must be one of {', '.join(MODELS)}, got {model!r}.")
    labels = np.zeros(stack.shape[1:], int)
    if materials is not None:
        labels = np.asarray(plain_numbers("materials", materials))
        if labels.shape != stack.shape[1:] or not np.issubdtype(labels.dtype, np.integer):
            raise InputError(
                f"materials must be whole numbers of shape {stack.shape[1:]}, one label a pixel, "
                f"got {labels.dtype} of shape {labels.shape}."
            )
    toward = np.asarray(plain_numbers("viewer", viewer), float)
    if toward.shape != (3,) or not np.isclose(np.linalg.norm(toward), 1, atol=1e-3):
        raise InputError(f"viewer must be a unit vector toward the camera, got {toward}.")
    return labels, toward / np.linalg.norm(toward)


def _common_errors(covariance: ArrayLike, lights: int) -> np.ndarray:
    together = np.asarray(plain_numbers("covariance", covariance), float)
    if together.shape != (lights, 4, lights, 4):
        raise InputError(
            f"covariance must be ({lights}, 4, {lights}, 4), of x, y, z and the logarithm of the "
            f"intensity, got {together.shape}."
        )
    require_covariance("covariance", together.reshape(4 * lights, -1))
    return together


def _least_squares(
    rows: Rows, readings: Readings, near: Counted
) -> tuple[Vectors, Matrices, OfPixels, Int[np.ndarray, " pixels"]]:
    """Return g, its covariance for readings of variance 1, the variance of a reading about its
    prediction (NaN without residuals), and the number of used readings."""
    g, inverse = solved(rows, readings, near.astype(float))
    used = near.sum(axis=0)
    residuals = np.where(near, readings - predicted(rows, g), 0)
    scatter = (residuals**2).sum(axis=0) / np.where(used > 3, used - 3, np.nan)
    return g, inverse, scatter, used


def _within_limits(rows: Rows, g: Vectors, scatter: OfPixels, limits: Limits) -> Counted:
    """Return a mask of the readings that a fit predicts to lie between both limits with a margin of
    several standard deviations."""
    expected, margin = predicted(rows, g), CLEAR * np.sqrt(np.nan_to_num(scatter))
    return (expected - margin > limits[0]) & (expected + margin < limits[1])


def _used_readings(
    rows: Rows, readings: Readings, between: Counted, limits: Limits, *, robust: bool
) -> Counted:
    """Return a mask of the readings that the fit uses. A reading is used if the fit predicts it
    between the limits and the other readings do not contradict it. Readings within the noise of the
    lower limit are not used, because readings in attached shadow do not follow the model. A margin
    beyond this noise that would leave fewer than three lights is not applied.
    """

    near = _consistent(rows, readings, between, limits[3]) if robust else between.copy()
    moving = np.arange(readings.shape[1])
    for _ in range(PASSES):
        own, own_near, own_between = readings[:, moving], near[:, moving], between[:, moving]
        own_rows = take_pixels(rows, moving)
        g, _ = solved(own_rows, own, own_near.astype(float))
        lit = ~(predicted(own_rows, g) <= limits[0] + CLEAR * limits[2])
        chosen = own_near & lit
        for spread in (0 * own[0], _usual_residual(own_rows, own, own_near, g)):
            narrower = own_between & lit & _within_limits(own_rows, g, spread**2, limits)
            known = np.isfinite(solved(own_rows, own, narrower.astype(float))[1][:, 0, 0])
            chosen = np.where(known, narrower, chosen)
        if robust:
            chosen = _consistent(own_rows, own, chosen, limits[3])
        changed = (chosen != own_near).any(axis=0)
        near[:, moving] = chosen
        moving = moving[changed]
        if not moving.size:
            break
    return near


def _dark_noise(rows: Rows, readings: Readings, near: Counted) -> float:
    """Return the standard deviation of readings without light. It is estimated from the quartiles
    of the readings below 0 or, without such readings, as in clipped images, from the residuals of
    the dimmer half of the pixels. The lower quartile of these residuals is used, because attached
    shadows and clipped readings enlarge many of them.
    """
    below = -readings[readings < 0]
    if below.size >= FEWEST:
        return float(np.subtract(*np.quantile(below, [0.75, 0.25]))) / HALF_NORMAL
    g, _ = solved(rows, readings, near.astype(float))
    largest = np.where(near, readings, 0).max(axis=0)
    known = (near.sum(axis=0) > 3) & np.isfinite(g[:, 0])
    if known.sum() < FEWEST:
        return 0.0
    dim = known & (largest <= np.median(largest[known]))
    return float(np.quantile(_usual_residual(rows, readings, near, g)[dim], 0.25))


def _usual_residual(rows: Rows, readings: Readings, near: Counted, g: Vectors) -> OfPixels:
    """Return the standard deviation of a reading about its prediction, from the median residual,
    which shadowed readings do not increase; 0 without residuals.
    """
    used = near.sum(axis=0)
    ordered = np.sort(np.where(near, np.abs(readings - predicted(rows, g)), np.inf), axis=0)
    middle = np.take_along_axis(ordered, np.maximum(used - 1, 0)[None] // 2, axis=0)[0]
    middle = np.where((used > 3) & np.isfinite(middle), middle, 0)
    return NORMAL_MAD * middle * np.sqrt(used / np.maximum(used - 3, 1))


def _consistent(rows: Rows, readings: Readings, counts: Counted, noise: float = np.inf) -> Counted:
    """Return the readings near the fit of least absolute residuals, if there are at least five.
    The usual residual is at most `noise`."""
    used = counts.sum(axis=0)
    residuals, scale, least = _least_absolute(rows, readings, counts)
    near = counts & ~(residuals > FAR * np.maximum(scale, least))
    near = np.where((used >= 5) & (near.sum(axis=0) >= 4), near, counts)
    usual = float(np.median(scale[used >= AGREE])) if (used >= AGREE).any() else 0.0
    usual = min(usual, noise)
    wild = (used > AGREE) & (np.where(near, residuals, 0).max(axis=0) > APART * max(usual, 1e-300))
    wild |= (used > AGREE) & ((counts & ~near).sum(axis=0) > 1)
    if wild.any() and usual > 0:
        some = np.flatnonzero(wild)
        own_rows, own_readings = take_pixels(rows, some), readings[:, some]
        own = _agreeing(own_rows, own_readings, counts[:, some], FAR * usual)
        better = own.sum(axis=0) > np.maximum(
            (near & (residuals < FAR * usual))[:, some].sum(axis=0), AGREE - 1
        )
        near[:, some] = np.where(better, own, near[:, some])
    for _ in range(RETURNS):
        back = _explained_readings(rows, readings, counts & ~near, near)
        if not back.any():
            break
        near |= back
    return near


def _least_absolute(
    rows: Rows, readings: Readings, counts: Counted
) -> tuple[Readings, OfPixels, OfPixels]:
    """Fit each pixel by least absolute residuals. Return the absolute residuals, a standard
    deviation derived from their median, and the smallest residual that rounding allows."""
    weights = counts.astype(float)
    size = np.abs(np.where(counts, readings, 0)).max(axis=0)
    least = np.where(size > 0, 1e-6 * size, 1.0)
    residuals = np.zeros_like(readings)
    for _ in range(ROUNDS):
        g, _ = solved(rows, readings, weights)
        residuals = np.where(counts, np.abs(readings - predicted(rows, g)), np.nan)
        weights = np.where(counts, 1 / np.maximum(residuals, least), 0)
        weights = np.nan_to_num(weights / np.maximum(weights.max(axis=0), 1e-300))
    return residuals, NORMAL_MAD * _median(residuals, counts.sum(axis=0)), least


def _noise_among_wrong(
    rows: Rows, readings: Readings, counts: Counted, shape: tuple[int, ...]
) -> tuple[float, tuple[str, ...]]:
    """Return the standard deviation of a reading if most pixels have wrong readings, else infinity,
    and a sentence if readings scatter so much that they hardly depend on the normal.
    Wrong readings enlarge the residuals of most pixels, and neighbouring pixels do not share them.
    The noise is then estimated from the residuals of the readings nearest to an exact fit of three
    readings, in the pixels where these residuals are small. The residuals are divided by those of
    Gaussian noise of unit variance.
    """
    used, largest = counts.sum(axis=0), np.where(counts, readings, 0).max(axis=0)
    known = used > AGREE
    bright = np.flatnonzero(known & (largest >= np.median(largest[known] if known.any() else 0)))
    if bright.size < FEWEST:
        return np.inf, ()

    def sample(pixels: np.ndarray) -> tuple[Rows, Readings, Counted]:
        some = pixels[:: -(-pixels.size // VOTERS)]
        return take_pixels(rows, some), readings[:, some], counts[:, some]

    def scatter(some: tuple[Rows, Readings, Counted]) -> float:
        return float(np.median(_least_absolute(*some)[1]))

    own_rows, own, valid = brightest = sample(bright)
    least = scatter(brightest)
    usual = max(least, scatter(sample(np.flatnonzero(known))))
    relative = least / float(np.median(own[valid]))
    if usual <= NOISY * np.median(own[valid]):
        return np.inf, ()
    weights = counts.astype(float)
    residuals = np.where(counts, readings - predicted(rows, solved(rows, readings, weights)[0]), 0)
    lit = (counts & np.isfinite(residuals)).reshape(shape)
    if shared_squares(residuals.reshape(shape), lit) > SHARED:
        return np.inf, ()
    unit = np.random.default_rng(0).normal(size=own.shape)
    seen, expected = (
        np.quantile(_nearest_half(own_rows, values, valid), LUCKY) for values in (own, unit)
    )
    noise = min(float(seen / expected), least)
    said = () if relative <= SCATTERED else (_scattered_finding(relative),)
    return noise if SPOILED * noise < usual else np.inf, said


def _scattered_finding(relative: float) -> str:
    return (
        f"Readings scatter about m = E rho n.l by {format_percent(relative)} of their median, and "
        "neighbouring pixels do so independently. If this is not noise, most pixels have wrong "
        "readings, as in images of other views or damaged files, and normals and their standard "
        "deviations are wrong; look at the images."
    )


def _nearest_half(rows: Rows, readings: Readings, counts: Counted) -> OfPixels:
    """Fit each pixel exactly to each set of three readings. About half of all readings of the pixel
    lie within some distance of each fit; return the smallest such distance."""
    place = np.maximum(counts.sum(axis=0) // 2, AGREE)[None] - 1
    found = np.full(readings.shape[1], np.inf)
    for residuals in _exact_fits(rows, readings, counts):
        away = np.nan_to_num(np.where(counts, residuals, np.inf), nan=np.inf)
        found = np.minimum(found, np.take_along_axis(np.sort(away, axis=0), place, axis=0)[0])
    return found


def _exact_fits(rows: Rows, readings: Readings, counts: Counted) -> Iterator[Readings]:
    """Yield the absolute residuals of the fit to each set of three readings; NaN in pixels that
    lack one of the three."""
    triples = list(combinations(range(len(readings)), 3))
    for three in map(list, triples[:: -(-len(triples) // TRIPLES)]):
        weights = np.zeros_like(readings)
        weights[three] = counts[three].all(axis=0)
        yield np.abs(readings - predicted(rows, solved(rows, readings, weights)[0]))


def _agreeing(
    rows: Rows,
    readings: Readings,
    counts: Counted,
    tolerance: float | OfPixels,
    apart: Counted | None = None,
) -> Counted:
    """Return, for each pixel, the largest set of readings within a tolerance of the prediction from
    three of them. The set contains the valid readings even if up to half of the readings are in
    shadow. If `apart` is given, at least a third of the readings in the set are flagged in it."""
    best, most = np.zeros_like(counts), np.zeros(readings.shape[1])
    for residuals in _exact_fits(rows, readings, counts):
        with np.errstate(invalid="ignore"):
            own = counts & (residuals < tolerance)
        more = own.sum(axis=0) > most
        if apart is not None:
            more &= 3 * (own & apart).sum(axis=0) >= own.sum(axis=0)
        best[:, more], most = own[:, more], np.maximum(most, own.sum(axis=0))
    return best


def _contradicted_pixels(
    rows: Rows, readings: Readings, counts: Counted, between: Counted, limits: Limits
) -> tuple[Bool[np.ndarray, " pixels"], Bool[np.ndarray, " pixels"]]:
    """Return two masks of pixels. In the first, at least as many readings contradict the fit as
    support it, or nearly as many readings agree on another normal. In the second, the
    readings scatter much more than usual."""
    g, _, variance, used = _least_squares(rows, readings, counts)
    scatter = np.sqrt(variance)
    usual = np.nanmedian(scatter) if np.isfinite(scatter).any() else np.inf
    usual = min(usual, limits[3])
    expected = predicted(rows, g)
    dark = limits[0] + CLEAR * limits[2]
    off = between & ~counts & (np.abs(readings - expected) > APART * usual)
    apart = (off & (expected > dark)).sum(axis=0)
    against = apart > used - (2 if np.isinf(limits[3]) else 4)
    some = np.flatnonzero((off.sum(axis=0) > 1) & (used > 3) & ~against)
    if some.size and 0 < usual < np.inf:
        own, lit = readings[:, some], (between & (readings > dark))[:, some]
        misses = np.where(counts, np.abs(readings - expected), 0)[:, some].max(axis=0)
        as_well = np.maximum(FAR * usual, misses)  # as the accepted readings agree
        second = _agreeing(take_pixels(rows, some), own, lit, as_well, off[:, some])
        against[some] = second.sum(axis=0) >= np.maximum(used[some] - 2, RIVAL)
    return (used > 3) & against, scatter > APART * usual


def _explained_readings(rows: Rows, readings: Readings, apart: Counted, near: Counted) -> Counted:
    """Return a mask of excluded readings that agree with the prediction from the accepted readings,
    by Student's t for the largest of all prediction errors. Even if no reading is wrong, the
    accepted readings are those nearest to the fit, so their scatter is too small. The variance of
    the accepted readings is therefore corrected as for a truncated Gaussian.
    """
    some = np.flatnonzero(apart.any(axis=0))
    found = np.zeros_like(apart)
    if not some.size:
        return found
    own, own_near, own_apart = readings[:, some], near[:, some], apart[:, some]
    rows = take_pixels(rows, some)
    g, inverse, scatter, used = _least_squares(rows, own, own_near)
    several = own_apart.sum(axis=0)
    share = used / (used + several)
    cut = ndtri((1 + share) / 2)
    narrower = 1 - 2 * cut * np.exp(-(cut**2) / 2) / np.sqrt(2 * np.pi) / share
    covariance = inverse * scatter[:, None, None]
    spelled = "ki,pij,kj->kp" if rows.ndim == 2 else "kpi,pij,kpj->kp"
    variance = scatter + np.einsum(spelled, rows, covariance, rows)
    error = np.sqrt(variance / narrower)
    limit = stdtrit(used - 3.0, 1 - CHANCE / 2 / (used + several))
    found[:, some] = own_apart & (np.abs(own - predicted(rows, g)) < limit * error)
    return found


def _median(residuals: Readings, used: Int[np.ndarray, " pixels"]) -> OfPixels:
    """Return the lower median of the residuals, without the three residuals that are 0 in any fit
    of three unknowns by least absolute deviations."""
    ordered = np.sort(residuals, axis=0)  # NaN last
    place = np.clip(3 + (used - 4) // 2, 0, len(ordered) - 1)
    return np.take_along_axis(ordered, place[None], axis=0)[0]
