"""Photometric stereo: normals and albedo from photographs under different lights, in closed form
for each pixel.

For a matte surface under a light of direction l and irradiance E, the reading of a pixel is m = E
rho n.l. Here n is the unit normal, and rho the albedo, whose unit is the unit of the readings
divided by the unit of E. Distant lights have the same l and E in all pixels. A near light of
radiant intensity I at a distance d from the point of the surface has E = I / d^2. The reading is
linear in the vector g = rho n. Therefore three lights determine g, and with more lights g is
estimated by least squares (Woodham, Optical Engineering 19, 1980). Attached and cast shadows,
clipped pixels and highlights are outliers of this model.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from threadpoolctl import threadpool_limits

from jaxvision import ArrayLike
from jaxvision.errors import InputError

from ...codes import converter_of
from ...inference.formatting import format_percent
from ...inference.given import plain_numbers, require_covariance
from ..names import MODELS, Model
from .axes import axes_findings
from .findings import (
    SHOWN_BY,
    clipped_finding,
    common_factor_finding,
    contradiction_finding,
    deviating_factors_finding,
    equal_images_finding,
    exact_finding,
    infinite_finding,
    materials_finding,
    misfit_finding,
    mosaic_finding,
    repeated_finding,
    typical_albedo,
    unlit_finding,
    wrapped_finding,
)
from .hollow import SAME, Hollow, interreflection_finding, without_interreflection
from .lights import (
    FLAT,
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
)
from .misfit import departures
from .model import fitted_surface
from .readings import (
    APART,
    FEWEST,
    Limits,
    consistent,
    contradicted_pixels,
    dark_noise,
    least_squares,
    noise_among_wrong,
    used_readings,
    within_limits,
)
from .result import Stereo
from .rough import rough_body

CONTRADICTED, USUAL = 0.5, 0.25  # share of contradicted pixels; largest in the median image
ALONE = 0.02  # logarithm of a factor from which an image deviates from those that agree
WHOLLY = 0.95  # share of residuals that factors explain if no image is of another scene
NEGLIGIBLE = 1e-6  # of the albedo: departures from Lambert's law below it are rounding


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
    missing = infinite_finding(int(infinite.sum())) if infinite.any() else ()
    stack = np.where(infinite, np.nan, stack)
    missing += wrapped_finding(plain_numbers("images", images))
    labels, toward = _checked_materials(stack, model, materials, viewer)
    together = None if covariance is None else _common_errors(covariance, len(stack))
    clipped: tuple[str, ...] = ()
    if np.isinf(highest) and (top := converter_of(stack).clips_at) is not None:
        highest, clipped = top, (clipped_finding(stack.reshape(len(stack), -1), top),)
    read = (*missing, *clipped, *equal_images_finding(stack), *mosaic_finding(stack))

    def estimate(images: Images) -> Stereo:
        return _estimate(
            images, rows, distances, together, lowest, highest, robust, model, labels, toward
        )

    if white is not None and not (0 < white < np.inf and 0 <= white_sd < np.inf):
        raise InputError(f"white must be above 0, and white_sd at least 0: {white}, {white_sd}.")
    found, more = estimate(stack), ()
    if distances is None and abs(toward[2]) > 1 - 1e-6:
        axes = np.array([1, *np.sign(toward[[2, 2]])])
        scene = Hollow(stack, rows, (stack > lowest) & (stack < highest), axes)
        if white is None:
            more = interreflection_finding(found, scene)
        else:
            found, more = without_interreflection(found, estimate, scene, white, white_sd)
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
        noise, scattered = noise_among_wrong(rows, readings, between, stack.shape)
    first = consistent(rows, readings, between, noise) if robust else between
    limits = (lowest, highest, dark_noise(rows, readings, first), noise)
    unlit = unlit_finding(readings, between, limits)
    between &= not unlit
    counts = used_readings(rows, readings, between, limits, robust=robust)
    surface, linear, tilt, remarks = None, rows, 0.0, ()
    if model != "lambert":
        start = solved(rows, readings, counts.astype(float))[0]
        surface = fitted_surface(model, rows, readings, between, start, labels.ravel(), toward)
        linear, tilt = surface.slopes, surface.tilt(rows)
        readings = readings - surface.extra
        counts = used_readings(rows, readings, between, limits, robust=robust)
    apart, findings = _contradicted_images(rows, readings, counts, limits)
    common, alone = _common(rows, readings, between, limits, robust=robust)
    if common is not None and common.explained > WHOLLY and (alone > apart).any():
        apart, findings = np.zeros_like(apart), ()  # factors explain the contradiction
    if robust and apart.any():
        between[apart] = False
        common, alone = _common(rows, readings, between, limits, robust=robust)
    if common is not None and alone.any():
        between[alone] = False
        findings += deviating_factors_finding(common, alone)
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
        counts = used_readings(rows, agreeing, between, limits, robust=robust)
    shape, undecided = stack.shape, np.zeros(readings.shape[1], bool)
    against, wild = contradicted_pixels(rows, agreeing, counts, between, limits)
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
        remarks = materials_finding(model, surface)
    elif found.significant and np.median(counts.sum(axis=0)[np.isfinite(g[:, 0])]) < SHOWN_BY:
        rough = rough_body(rows, readings, shaped, found, toward)
    if rough is not None and (common is None or common.explained < rough.explained):
        covariance_of_g, common = rough.covariance, None
    if common is not None:
        covariance_of_g = departures(
            rows, (readings + tilt).reshape(shape), shaped, linear
        ).covariance
        moved = solved(linear, agreeing + tilt, found.weights)[0] - g
        covariance_of_g = covariance_of_g + moved[:, :, None] * moved[:, None, :]
        findings += (common_factor_finding(common, moved / typical_albedo(g)),)
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
            misfit_finding(model, misfit, normal_sd / by_noise, counts.sum(axis=0), rough),
        )
    if not findings:
        findings = unlit or contradiction_finding(rows, readings.reshape(shape), between, limits)
    if undecided.any():
        findings += (
            f"At {int(undecided.sum())} pixels the readings contradict each other so that no set "
            "of them prevails, as where cast shadows or highlights lie under about half of the "
            "lights. They have no normal; use more lights.",
        )
    seen = np.isfinite(albedo)
    exact = seen & np.isnan(normal_sd)
    if exact.sum() > seen.sum() / 2:
        findings += (exact_finding(exact.sum() / seen.sum()),)
    repeated = seen & ~exact & (_distinct(rows, counts) == 3)
    if repeated.sum() > seen.sum() / 2:
        findings += (repeated_finding(repeated.sum() / seen.sum()),)
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


def _distinct(rows: Rows, counts: Counted) -> Int[np.ndarray, " pixels"]:
    """Return the number of distinct directions among the lights that each pixel uses."""
    directions = directions_of(rows)
    alike = np.linalg.norm(directions[:, None] - directions, axis=-1) < SAME
    first = np.unique(np.argmax(alike, axis=1), return_inverse=True)[1]
    return np.sum([counts[first == one].any(axis=0) for one in range(first.max() + 1)], axis=0)


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
    counts = used_readings(rows, readings, between, limits, robust=False)
    common = common_departure(rows, readings, counts)
    if common is None or not robust:
        return common, np.zeros(len(rows), bool)
    off = np.abs(np.log(common.factors))
    alone = off > ALONE
    few = alone.sum() <= min(between.any(axis=1).sum() - 4, (len(rows) - 1) // 2)
    others_agree = 10 * off[~alone].max(initial=0) < off[alone].min(initial=np.inf)
    return common, alone & few & others_agree


def _contradicted_images(
    rows: Rows, readings: Readings, counts: Counted, limits: Limits
) -> tuple[Bool[np.ndarray, " lights"], tuple[str, ...]]:
    """Return the images that contradict the other images in most pixels, with findings. Only pixels
    that the other images predict to lie between the limits are counted."""
    g, _, scatter, used = least_squares(rows, readings, counts)
    expected = within_limits(rows, g, scatter, limits) & ~np.isnan(readings) & (used > 3)
    total = np.maximum(expected.sum(axis=1), 1)
    share = (expected & ~counts).sum(axis=1) / total
    miss = np.where(expected, np.abs(readings - predicted(rows, g)), np.nan)
    size = np.array([np.median(m[~np.isnan(m)]) if (~np.isnan(m)).any() else 0.0 for m in miss])
    size /= np.linalg.norm(rows, axis=-1).reshape(len(rows), -1).mean(axis=1)
    apart = (share > CONTRADICTED) & (size > APART * np.median(size)) & (total >= FEWEST)
    if not apart.any() or np.median(share) > USUAL or apart.sum() > len(rows) - 4:
        return np.zeros(len(rows), bool), ()
    relative = size / typical_albedo(g)
    return apart, tuple(
        f"images[{i}] contradicts the other images in {format_percent(share[i])} of the pixels "
        f"that these predict to be lit under it (by {format_percent(relative[i])} of "
        "the albedo in the median), and was left out. Causes are a wrong file, direction or "
        "intensity of the light, a black frame, or a highlight over all of them."
        for i in np.flatnonzero(apart)
    )


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
