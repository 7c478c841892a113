"""Estimate directions, or near positions, and intensities of lights from photographs of a ball.

With n the normal, v the direction to the camera and l that to the light, a mirror ball shows the
light where l = 2 (n.v) n - v. A matte ball has a brightness in proportion to n.l. For both, n
follows from the outline of the ball. An error of the outline rotates all light directions together.
Two careful outlines differ by a pixel, which rotates all lights by 0.5 to 0.8 degrees. All lights
therefore have one joint covariance,

    C = J_o C_o J_o' + diag(own),    J_o = d(places)/d(outline).

where C_o is the covariance of the outline and `own` the variance of each light for a known outline.
Two mirror balls give two lines of sight, which meet at a near light.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag

from jaxvision import ArrayLike
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from ..codes import converter_of
from ..copies import Copies
from ..inference.diagnostics import listed
from ..inference.formatting import format_percent, format_with_error
from ..inference.given import plain_numbers, require_positive
from ..observation import (
    pixels_of_mask,
    require_as_many,
    require_several_images,
    unequal_sites,
)
from ..rig import SiteCamera
from .file import Lights
from .highlight import Highlight, highlight_of, reflected
from .matte import Shading, moved_image, odd_image, shading_of
from .outline import Lens, Outline, centre_of, edge_beside_mask, outline_of

Kind = Literal["mirror", "matte"]
OUTLINE_SD = 0.5  # pixels
INSIDE = 0.97  # share of the radius within which highlights are searched
STEP = 1e-3  # pixels
NOT_MATTE = 0.03  # residual, relative to the largest signal, from which it is reported
FEWEST = 4  # images of a matte ball from which one may be left out
SPREADS = 25.0  # median deviations from which an image differs from the others
EQUAL = 3  # fewest images with the same largest reading that count as clipped
MOVED = 1.0  # pixels between the outlines of a ball in two images
UNLIKE = 4.0  # factor of an intensity from the median from which it is reported
UNEVEN = 0.05  # of a highlight: difference of the ball's level from that of other images
CONTRADICTED = 3.5  # standard deviations between two outlines from which they are reported
FOCAL = 5000.0  # pixels, such as a lens of 25 mm and pixels of 5 micrometres
CONVENTION = (
    "x points right and y up in the images, as upright pictures show the scene, and z toward the "
    "camera. A ball does not show whether all images are mirrored or upside down: the directions "
    "then are, too."
)
LINEAR = " Intensities assume linear readings: a highlight does not show a gamma."
SEEN_FROM = 0.5  # largest standard deviation of a position, relative to its distance


def calibrate(
    images: Sequence[ArrayLike],
    masks: Sequence[ArrayLike],
    *,
    camera: SiteCamera,
    kind: Kind = "mirror",
    files: Sequence[str] | None = None,
    focal_length: float | None = None,
    radius: float | None = None,
    outline_sd: float = OUTLINE_SD,
) -> Lights:
    """Estimate directions or positions of lights and relative intensities, with one covariance.

    Args:
        images: one for each light, (h, w) or (h, w, 3) linear DN, all of one fixed view.
        masks: (h, w) true where the ball is, one for each ball; two mirror balls give positions.
        camera: the camera's bits, and its black level and saturation where they are not 0 and full
            scale.
        kind: `mirror` for highlights, `matte` for shading.
        files: names of the images; None names them `images[0]`, `images[1]` and so on.
        focal_length: focal length of the lens in pixels, with its axis through the middle of the
            picture; None for an orthographic view.
        radius: radius of two equal balls, m. Without a focal length, their centres must be equally
            far from the camera.
        outline_sd: standard deviation of the centre and radius of a careful outline, pixels.

    Returns:
        The lights. Intensities are NaN where a highlight is clipped.

    Raises:
        InputError: for another kind of ball, lengths and standard deviations that are out of their
            range, for a ball without a highlight, with two, or with one that is saturated or cut
            by the border, for a mask that is not the outline of a ball, and for lights too far away
            for a position.

    Example:
        >>> from fitting.lights import calibrate
        >>> from fitting.reflectance import Camera
        >>> row, column = np.mgrid[:64, :64] - 31.5
        >>> ball = np.hypot(row, column) < 28
        >>> spot = 3000 * np.exp(-(row**2 + column**2) / 8)  # toward the camera
        >>> found = calibrate([spot.round()], [ball], camera=Camera(bits=12).at("grey"))
        >>> print(found.places.round(2) + 0.0)
        [[0. 0. 1.]]
    """
    if kind not in get_args(Kind):
        raise InputError(f"kind must be one of {', '.join(get_args(Kind))}, got {kind!r}.")
    if not 0 <= outline_sd < np.inf:
        raise InputError(f"outline_sd must be at least 0 and finite, in pixels, got {outline_sd}.")
    for name, length in (("focal_length", focal_length), ("radius", radius)):
        if length is not None:
            require_positive(name, length)
    require_several_images("images", images)
    require_several_images("masks", masks)
    names = [f"images[{i}]" for i in range(len(images))] if files is None else list(files)
    require_as_many("files", names, "images", images)
    readings = [_grey(name, image) for name, image in zip(names, images, strict=True)]
    balls = [_mask(f"masks[{i}]", mask) for i, mask in enumerate(masks)]
    for name, one in zip(
        (*names, *(f"masks[{i}]" for i in range(len(balls)))), (*readings, *balls), strict=True
    ):
        if one.shape != readings[0].shape:
            raise InputError(
                f"{name}: is {one.shape}, but {names[0]} is {readings[0].shape}; all images and "
                "masks need the same size."
            )
    if len(balls) > 1 and (len(balls) > 2 or kind == "matte" or radius is None):
        raise InputError(
            f"{len(balls)} masks of {kind} balls; give one mask, or two masks of mirror balls and "
            "their radius in metres, which gives positions."
        )
    height, width = readings[0].shape
    lens = Lens(focal_length, ((width - 1) / 2, (height - 1) / 2))
    outlines = [
        outline_of(ball, lens, sd=outline_sd, name=f"masks[{i}]") for i, ball in enumerate(balls)
    ]
    black, clip = camera.black_level or 0.0, camera.clip_level
    top = None
    if camera.saturation is None:  # a matte ball has many pixels near its largest reading
        matte = kind == "matte"
        top = converter_of(np.stack(readings)).clips_at if matte else _clips_at(readings)
    signals = np.stack(readings) - black
    clipped: tuple[str, ...] = ()
    if top is not None and top < clip:
        clip = top
        clipped = (
            f"Many readings are equal to the largest, {top:g}, and count as clipped; state "
            "camera.saturation.",
        )
    found = (
        _locate_by_shading(signals, balls[0], clip - black, outlines[0], names)
        if kind == "matte"
        else _locate_by_highlights(signals, balls, clip - black, outlines, names, radius)
    )
    copies = Copies()
    for name, reading in zip(names, readings, strict=True):
        copies.add(name, reading)
    sentences = clipped + tuple(
        f"{listed(list(same))} hold equal numbers: they are copies of one exposure, so all but "
        "one of these lights are wrong."
        for same in copies.equal_groups
    )
    relative = found.intensities / np.median(found.intensities)
    sentences += tuple(
        f"{name} is {factor:.2g} times as bright as the others (median). If the lamps are alike, "
        "its exposure, gain or bit depth differs."
        for name, factor in zip(found.files, relative, strict=True)
        if not 1 / UNLIKE < factor < UNLIKE and np.isfinite(factor)
    )
    inside = np.where(np.any(balls, axis=0), signals.mean(axis=0), np.nan)
    clause, key = unequal_sites(inside)
    if clause:
        remedy = f"give {key}, with the numbers of each" if "taps" in key else "demosaic the images"
        sentences += (
            f"{clause}. Such pixels count as equal, which makes intensities wrong, and directions "
            f"of a matte ball; {remedy}.",
        )
    if focal_length is None:
        sentences += _lens_finding(found, lens.centre)
    elif focal_length < max(width, height) / 2:
        sentences += (
            f"At a focal length of {focal_length:g} pixels the picture is "
            f"{2 * np.degrees(np.arctan(max(width, height) / 2 / focal_length)):.0f} degrees wide. "
            "If the number is in millimetres, divide it by the pixel pitch in millimetres.",
        )
    assumed = CONVENTION if kind == "matte" else CONVENTION + LINEAR
    return Lights(**{**found.__dict__, "findings": (*sentences, *found.findings, assumed)})


def _clips_at(readings: list[Float[np.ndarray, "h w"]]) -> float | None:
    """Return the largest reading, DN, if more readings are equal to it than chance explains: one or
    two in each image. None otherwise."""
    stack = np.stack(readings)
    most = float(stack.max())
    counts = np.count_nonzero(stack == most, axis=(1, 2))
    images = np.count_nonzero(counts)
    return most if images >= EQUAL and counts.sum() >= EQUAL + 1.5 * images else None


def _lens_finding(found: Lights, middle: tuple[float, float]) -> tuple[str, ...]:
    """Return a finding on how much an unstated lens could change the directions, if this exceeds
    their errors."""
    beside = np.hypot(*(found.outlines[:, :2] - middle).T) + found.outlines[:, 2]
    turn, sd = float(beside.max()) / FOCAL, np.median(found.place_sd)
    if found.near:
        sd = sd / np.median(np.linalg.norm(found.places, axis=1))
    if turn < sd / 2:
        return ()
    return (
        "The view was taken as orthographic. Through a lens of focal length f, in pixels, "
        f"directions differ by up to {beside.max():.0f} / f rad; at f = {FOCAL:.0f} these are "
        f"{np.degrees(turn):.2g} degrees. State the focal length.",
    )


def _grey(name: str, image: ArrayLike) -> Float[np.ndarray, "h w"]:
    pixels = np.asarray(plain_numbers(name, image), float)
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] not in (1, 3)):
        raise InputError(f"{name}: is {pixels.shape}; give (h, w) or (h, w, 3) numbers.")
    if unknown := int(np.count_nonzero(~np.isfinite(pixels))):
        raise InputError(
            f"{name}: {unknown} of its {pixels.size} numbers are NaN or infinite; interpolate "
            "these pixels in all images."
        )
    return pixels if pixels.ndim == 2 else pixels.mean(axis=2)


def _mask(name: str, mask: ArrayLike) -> Bool[np.ndarray, "h w"]:
    return pixels_of_mask(np.asarray(plain_array(name, mask)))


def _locate_by_highlights(
    signals: Float[np.ndarray, "lights h w"],
    balls: list[Bool[np.ndarray, "h w"]],
    clip: float,
    outlines: list[Outline],
    names: list[str],
    radius: float | None,
) -> Lights:
    values = np.array([outline.values for outline in outlines])
    row, column = np.indices(signals.shape[1:])
    seen: list[list[Highlight]] = []
    for ball, outline in zip(balls, outlines, strict=True):
        x, y, r = outline.values
        inner = ball & (np.hypot(column - x, row - y) < INSIDE * r)
        seen.append(
            [
                highlight_of(signal, inner, clip, outline, name=name)
                for signal, name in zip(signals, names, strict=True)
            ]
        )
    spots = np.array([[one.place for one in of_ball] for of_ball in seen])  # (balls, lights, 2)
    lens = outlines[0].lens

    def places(values: np.ndarray, spots: np.ndarray) -> np.ndarray:
        toward, normals = reflected(values[:, None], spots, lens)
        if len(values) == 1:
            return toward[0]
        assert radius is not None
        centres = centre_of(values, lens)
        if lens.focal_length is None:  # equal balls at equal distance
            centres = centres * values[:, 2:] / values[:, 2].mean()
        return _crossing(radius * (centres - centres[0])[:, None] + radius * normals, toward)

    found = places(values, spots)
    picture = np.median(signals, axis=0)
    beside: tuple[str, ...] = ()
    for i, (ball, outline) in enumerate(zip(balls, tuple(outlines), strict=True)):
        edge = edge_beside_mask(picture, ball, outline)
        for name, signal in zip(names, signals, strict=True):
            own = None if edge is None else edge_beside_mask(signal, ball, outline)
            if own is not None and np.hypot(*(own - edge)[:2]) > MOVED:
                raise InputError(
                    f"{name}: shows ball {i} at {np.hypot(*(own - edge)[:2]):.1f} pixels from its "
                    "place in the other images: the ball or the camera moved; take that image "
                    "again, or leave it out."
                )
        if edge is None:
            beside += (
                f"The images do not show the outline of ball {i}, so its mask was not checked.",
            )
        elif (
            np.abs(edge) > np.maximum(1, CONTRADICTED * np.sqrt(np.diag(outline.covariance)))
        ).any():
            x, y, r = outline.values + edge
            outlines[i] = replace(outline, covariance=outline.covariance + np.outer(edge, edge))
            beside += (
                f"In the images the edge of ball {i} is a circle about ({x:.2f}, {y:.2f}) with a "
                f"radius of {r:.2f} pixels, not where its mask is: the mask is wrong. The standard "
                "deviations include the difference; correct the mask.",
            )
    by_outline = np.stack(
        [
            _slope(lambda step, b=b, i=i: places(_move_ball(values, (b, i), step), spots))
            for b in range(len(balls))
            for i in range(3)
        ],
        axis=-1,
    )  # (lights, 3, outlines)
    of_outline = np.asarray(block_diag(*(outline.covariance for outline in outlines)))
    own = np.zeros((len(names), 3, 3))
    for b, of_ball in enumerate(seen):
        for axis in (0, 1):
            slope = _slope(
                lambda h, b=b, a=axis: places(values, _move_ball(spots, (b, slice(None), a), h))
            )
            slope = slope * np.sqrt(np.mean([one.sd**2 for one in of_ball]))  # pooled over lights
            own += slope[:, :, None] * slope[:, None, :]
    shared = np.einsum("lio,op,mjp->limj", by_outline, of_outline, by_outline)
    flux = np.array([one.flux for one in seen[0]])
    levels, peaks = np.array([(one.level, one.peak) for one in seen[0]]).T
    apart = levels - np.median(levels)
    shared, own = np.pad(shared, 2 * ((0, 0), (0, 1))), np.pad(own, ((0, 0), (0, 1), (0, 1)))
    findings, near = (*_outline_findings(outlines), *beside), len(balls) == 2
    findings += tuple(
        f"{names[i]}: beside its highlight the ball is at {levels[i]:.3g} DN above black, in the "
        f"other images at {np.median(levels):.3g} (median). Its black level, bit depth or gamma "
        "differs, or other light fell on the ball, and its intensity may be wrong."
        for i in np.flatnonzero(np.abs(apart) > UNEVEN * (peaks - levels))
    )
    if np.isnan(flux).any():
        flux = np.full_like(flux, np.nan)
        findings += (
            "Highlights are clipped, so that they give no intensities; take them from a matte "
            "ball, or expose less.",
        )
    else:
        if near:
            flux = flux * np.sum(found**2, axis=1)  # radiant intensity
        own[:, 3, 3] = np.square([one.flux_sd for one in seen[0]])
    sds = np.sqrt([np.diag(outline.covariance) for outline in outlines])
    lights = _add_covariances(names, found, flux, shared, own, near, values, sds, findings)
    if near:
        _refuse_far(found, lights.covariance, names)
    return lights


def _add_covariances(
    names: list[str],
    places: Float[np.ndarray, "lights 3"],
    strengths: Float[np.ndarray, " lights"],
    shared: Float[np.ndarray, "lights 4 lights 4"],
    own: Float[np.ndarray, "lights 4 4"],
    near: bool,
    outlines: Float[np.ndarray, "balls 3"],
    outline_sds: Float[np.ndarray, "balls 3"],
    findings: tuple[str, ...],
) -> Lights:
    """Return the lights with the sum of two covariances: one from the outlines, which all lights
    share, and one of each light alone.
    """
    covariance, each = shared.copy(), np.arange(len(names))
    covariance[each, :, each, :] += own
    common, whole = (np.einsum("lili->", c[:, :3, :, :3]) for c in (shared, covariance))
    relative = strengths / strengths.mean()
    covariance = _about_mean(covariance)
    return Lights(
        *(tuple(names), places, relative, covariance, near, outlines, outline_sds),
        *(float(common / whole), findings),
    )


def _move_ball(values: np.ndarray, at: tuple, step: float) -> np.ndarray:
    moved = values.copy()
    moved[at] += step
    return moved


def _slope(of: Callable[[float], np.ndarray]) -> np.ndarray:
    return (of(STEP) - of(-STEP)) / (2 * STEP)


def _crossing(
    starts: Float[np.ndarray, "balls lights 3"], toward: Float[np.ndarray, "balls lights 3"]
) -> Float[np.ndarray, "lights 3"]:
    """Return the point closest to two lines of sight, for each light."""
    across = np.eye(3) - toward[..., :, None] * toward[..., None, :]
    right = np.einsum("blij,blj->li", across, starts)
    return np.linalg.solve(across.sum(axis=0), right[..., None])[..., 0]


def _refuse_far(places: np.ndarray, covariance: np.ndarray, names: list[str]) -> None:
    for i, place in enumerate(places):
        sd = np.sqrt(np.trace(covariance[i, :3, i, :3]))
        distance = np.linalg.norm(place)
        if not sd < SEEN_FROM * distance:
            raise InputError(
                f"{names[i]}: the two balls see its light at {distance:.3g} m with a standard "
                f"deviation of {sd:.3g} m; it is too far for a position, so give one mask, or move "
                "the balls apart."
            )


def _locate_by_shading(
    signals: Float[np.ndarray, "lights h w"],
    ball: Bool[np.ndarray, "h w"],
    clip: float,
    outline: Outline,
    names: list[str],
) -> Lights:
    found, gone = shading_of(signals, ball, clip, outline, names=names), []
    while len(names) > FEWEST:
        for differs in (odd_image, moved_image):
            if (odd := differs(found, 0.0)) is None:
                continue
            kept = [i for i in range(len(names)) if i != odd]
            rest = shading_of(signals[kept], ball, clip, outline, names=[names[i] for i in kept])
            known = replace(outline, values=rest.values, covariance=1e-6 * outline.covariance)
            whole = shading_of(signals, ball, clip, known, names=names)  # the outline of the others
            if differs(whole, SPREADS) == odd:
                break
        else:
            break
        gone.append(_left_out_finding(names[odd], whole, odd, moved=differs is moved_image))
        signals, names, found = signals[kept], [names[i] for i in kept], rest
    size = np.linalg.norm(found.g, axis=1)
    toward = found.g / size[:, None]
    across = np.eye(3) - toward[:, :, None] * toward[:, None, :]
    to_four = np.concatenate([across, toward[:, None, :]], axis=1) / size[:, None, None]
    by_outline = to_four @ found.by_outline
    shared = np.einsum("lio,op,mjp->limj", by_outline, found.outline_covariance, by_outline)
    own = to_four @ found.own @ np.swapaxes(to_four, 1, 2)
    findings = (*gone, *_outline_findings([outline]))
    if found.moved is not None:
        moved = np.einsum("lij,lj->li", to_four, found.moved)
        shared = shared + moved[:, :, None, None] * moved
        turn = np.degrees(np.median(np.linalg.norm(moved[:, :3], axis=1)))
        findings += (
            "Readings of the ball grow as (n.l)^p with p = "
            f"{format_with_error(found.power, found.power_sd)} in place of 1: they are not linear "
            "(a gamma, an unstated black level), or the ball is not Lambertian. This power would "
            f"rotate the directions by {turn:.2g} degrees (median), which their standard "
            "deviations include.",
        )
    if found.floor:
        findings += (
            f"Pixels of the ball that face away from a light read {found.floor:.4g} DN above "
            "black (median). This was subtracted from all numbers. Camera.black_level is wrong, or "
            "the room was not dark.",
        )
    if found.tilt is not None:
        moved = to_four * np.linalg.norm(found.tilt)  # in any direction: its shape is not known
        shared = shared + np.einsum("lio,mjo->limj", moved, moved)
        turn = np.degrees(np.median(np.linalg.norm((to_four @ found.tilt)[:, :3], axis=1)))
        low, high = int(np.nanargmin(found.unlit)), int(np.nanargmax(found.unlit))
        findings += (
            "Pixels that face away from the lights are brighter on one side of the ball: "
            f"{found.unlit[low]:.4g} DN above black in {names[low]}, {found.unlit[high]:.4g} DN in "
            f"{names[high]}. Causes are room light, or images with different black levels. This "
            f"difference would rotate the directions by {turn:.2g} degrees (median), which their "
            "standard deviations include.",
        )
    off = np.abs(found.values - outline.values) / np.sqrt(np.diag(outline.covariance))
    if off.max() > CONTRADICTED:
        findings += (
            f"The shading has its outline at ({found.values[0]:.2f}, {found.values[1]:.2f}) with a "
            f"radius of {found.values[2]:.2f} pixels, {off.max():.1f} standard deviations from the "
            "mask's. The mask is wrong, or the ball is not Lambertian; directions may be further "
            "off than their standard deviations say.",
        )
    if found.misfit > NOT_MATTE:
        findings += (
            "The ball is not Lambertian: readings differ from g.n by "
            f"{format_percent(found.misfit)} of the largest signal (rms, median over lights), by "
            "highlights, roughness, a gamma or shadows. Directions may be further off than their "
            "standard deviations say.",
        )
    values, sds = found.values[None], np.sqrt(np.diag(found.outline_covariance))[None]
    return _add_covariances(names, toward, size, shared, own, False, values, sds, findings)


def _left_out_finding(name: str, whole: Shading, odd: int, *, moved: bool) -> str:
    if moved:
        return (
            f"{name} was left out: by its shading, the ball is {np.hypot(*whole.shift[odd]):.1f} "
            "pixels from its place in the other images. The ball or the camera moved, or the image "
            "is rotated."
        )
    level = whole.offset[odd] - np.median(whole.offset)
    share = abs(level) / float(np.linalg.norm(whole.g[odd]))
    return (
        f"{name} was left out: compared with the other images, it has {level:+.3g} DN on "
        f"all of the ball ({format_percent(share)} of its signal). Its black level, bit depth "
        "or gamma differs, a shadow or other light fell on the ball, or it moved."
    )


def _about_mean(
    covariance: Float[np.ndarray, "lights 4 lights 4"],
) -> Float[np.ndarray, "lights 4 lights 4"]:
    """Return the covariance after subtracting the mean of the log intensities, which is
    arbitrary.
    """
    centred = covariance.copy()
    centred[:, 3] -= centred[:, 3].mean(axis=0)
    centred[..., 3] -= centred[..., 3].mean(axis=-1, keepdims=True)
    return centred


def _outline_findings(outlines: list[Outline]) -> tuple[str, ...]:
    return tuple(
        f"By its mask, ball {i} has its centre at ({one.values[0]:.2f}, {one.values[1]:.2f}) and a "
        f"radius of {one.values[2]:.2f} pixels, each ± "
        f"{np.sqrt(np.trace(one.covariance) / 3):.2f}; the mask's edge is {one.scatter:.2f} pixels "
        "(rms) from it."
        for i, one in enumerate(outlines)
    )
