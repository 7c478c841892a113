"""Checks of the rig's light directions and object position against the images.

Under a distant light, the signal of a matt surface with normal n is g.n, where the vector g has the
direction of the light. Therefore the light direction can be estimated from each image and the known
normals (Woodham 1980), with the highlight left out as an outlier. A wrong sign, files in another
order or a displaced sphere make the estimated direction differ from the stated direction, whatever
the model of the surface.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtri

from ...copies import Copies
from ...inference.formatting import format_percent
from ...observation import unequal_sites
from ...rig import COLOURS
from .read import Photographs, lightless_images

LIT = 0.1  # share of the brightest above which pixels are neither shadow nor background
OUTLYING, ROUNDS = 2.5, 8  # median absolute deviations of a highlight; number of passes
MATT = 0.9  # share of the variance of the kept pixels that g.n must explain
UNEVEN = 0.2  # relative range of the irradiance over the object of a light that is not distant
FEWEST_PIXELS, FLAT = 30, 0.05  # to estimate a direction; smallest spread of the normals
FAR, NEAR = 15.0, 10.0  # degrees: deviation of a doubtful direction; of an acceptable alternative
DARK, SHARE = 0.01, 0.05  # of the brightest: an unlit pixel; reported share of such pixels
MOST, FEWEST_LEFT = 0.5, 3  # largest share of images left out; fewest fitted images that stay
CAMERA = np.array([0.0, 0.0, 1.0])
BRIGHTER = 1.15  # least factor of an image that is brighter or dimmer than the others
UNCHANGED = 0.04  # of the usual change between lights: below it a pixel does not see light
SIDE = 0.3  # cosine of incidence from which a pixel faces a light
CHANGES = {
    "the sign of y turned around": lambda v: v * [1, -1, 1],
    "the sign of x turned around": lambda v: v * [-1, 1, 1],
    "the signs of x and y turned around": lambda v: v * [-1, -1, 1],
    "x and y exchanged": lambda v: v[:, [1, 0, 2]],
}


def directions_by_shading(
    observation: Photographs,
) -> tuple[Float[np.ndarray, "lights 3"], Bool[np.ndarray, " lights"]]:
    """Return the unit direction (lights, 3) estimated from each image alone, and whether the
    estimate is valid (lights,). The estimate is valid if the light is distant and the surface matt
    enough.
    """
    found, known = _lights_by_shading(observation)
    return found / np.linalg.norm(found, axis=1, keepdims=True), known


def _lights_by_shading(
    observation: Photographs,
) -> tuple[Float[np.ndarray, "lights 3"], Bool[np.ndarray, " lights"]]:
    """Return g (lights, 3), in DN, estimated from each image alone, and whether it is valid."""
    signal = np.mean(observation.dn - observation.black, axis=0)
    if observation.gamma is not None:
        signal = np.maximum(signal, 0) ** observation.gamma
    clear = ~np.any(observation.saturated, axis=0)
    distant = np.ptp(observation.falloff, axis=1) < UNEVEN * observation.falloff.mean(axis=1)
    found, known = np.zeros((len(signal), 3)), np.zeros(len(signal), bool)
    for light, kept in enumerate(np.atleast_2d(clear)):
        found[light], known[light] = _direction(signal[light, kept], observation.normals[kept])
    return found, known & distant


def _direction(
    values: Float[np.ndarray, " pixels"], normals: Float[np.ndarray, "pixels 3"]
) -> tuple[Float[np.ndarray, "3"], bool]:
    """Return the least-squares g of one light, in DN, without shadows and highlights, and whether
    this estimate is valid.
    """
    if len(values) < FEWEST_PIXELS:
        return CAMERA, False
    kept = lit = values > LIT * np.quantile(values, 0.98)
    toward = CAMERA
    for _ in range(ROUNDS):
        if kept.sum() < FEWEST_PIXELS or _spread(normals[kept]) < FLAT:
            return toward, False
        fitted = np.linalg.lstsq(normals[kept], values[kept], rcond=None)[0]
        if not np.any(fitted):
            return toward, False
        toward = fitted
        shown = normals @ fitted
        off = np.abs(values - shown)
        kept = lit & (shown > 0) & (off <= OUTLYING * max(np.median(off[lit]), 1e-9))
    rest = values[kept] - normals[kept] @ toward
    explained = float(np.var(rest)) < (1 - MATT) * float(np.var(values[kept]))
    return toward, bool(kept.sum() > lit.sum() / 2) and explained


def contradictions(observation: Photographs, *, gamma: float | None = None) -> list[str]:
    """Report copies, light directions and an outline that contradict the rig. `gamma` is the
    encoding exponent that a fit has found; None for the rig's."""
    if gamma is not None:
        observation = replace(observation, gamma=gamma)
    return [
        *_copies_findings(observation),
        *_direction_findings(observation),
        *_ball_outline_findings(observation),
        *_mosaic_findings(observation),
    ]


def _mosaic_findings(observation: Photographs) -> list[str]:
    """Report sites of a 2 x 2 mosaic, rows or columns that differ, in grey images or in one colour
    of a mosaic."""
    if len(observation.channels) > 1:
        return []
    picture = np.full(observation.shape, np.nan)
    mean = np.mean(observation.dn[0] - observation.black, axis=0)
    picture[observation.rows, observation.columns] = mean
    clause, key = unequal_sites(picture)
    channel = next(iter(observation.channels))
    if channel in COLOURS:
        clause = clause.replace("pixels", f"{channel} pixels", 1).partition(", as")[0]
        return [
            f"{clause}, so the mosaic has another phase than camera.pattern says; correct it."
        ] * bool(clause)
    each = ", and black_level and gain of each" * ("taps" in key)
    return [f"{clause}; give {key}{each}."] * bool(clause)


def drop_strangers(observation: Photographs) -> Photographs:
    """Leave out images that are dark or saturated throughout, copies of other images, and dead
    or hot pixels. If most images agree with the stated lights, also leave out images whose shading
    contradicts the stated direction or intensity. A finding reports each omitted image. If more
    than half of the images, or all but a few, would be left out, no image is left out.
    """
    observation = _drop_dead_pixels(observation)
    reasons = {
        i: f"every pixel that its light reaches is {state}"
        for i, state in lightless_images(observation).items()
    }
    g, known = _lights_by_shading(observation)
    size = np.linalg.norm(g, axis=1)
    off = _angles(g / size[:, None], _stated_directions(observation))
    names = list(observation.files)
    for copies in _copies(observation).equal_groups:
        places = [names.index(name) for name in copies]
        best = min(places, key=lambda i: (not known[i], off[i]))
        reasons |= {
            i: f"its numbers are those of {names[best]}, so that one is a copy of the other"
            for i in places
            if i != best
        }
    if known.sum() >= 2 and (median := float(np.median(off[known]))) < FAR:
        for i in _odd(observation, off, known, median):
            reasons.setdefault(
                int(i),
                f"its shading shows the light {off[i]:.0f}° from where the rig states it (median "
                f"of all {median:.1f}°), so check its direction and file",
            )
        for i, factor in _unequal(observation, size, known):
            reasons.setdefault(
                i,
                f"it is {factor:.3g} times as bright as the other images and the stated intensity "
                "of its light say, so check its intensity, exposure and bit depth",
            )
    kept = np.array([i not in reasons for i in range(len(names))])
    enough = np.count_nonzero(kept & ~observation.held_out) >= FEWEST_LEFT
    if kept.all() or not enough or kept.sum() < (1 - MOST) * len(kept):
        return observation
    sentences = (f"{names[i]} was left out: {why}." for i, why in sorted(reasons.items()))
    return replace(observation.select_lights(kept), findings=(*sentences, *observation.findings))


def _drop_dead_pixels(observation: Photographs) -> Photographs:
    """Leave out pixels whose readings do not change with the light, and report them."""
    driven = observation.intensity.mean(axis=0)[:, None] * observation.falloff
    expected = np.ptp(driven * np.maximum(observation.cosine, 0), axis=0)
    clear = expected > SIDE * expected.max()
    change = np.ptp(observation.dn, axis=1).min(axis=0) / np.maximum(expected, 1e-300)
    dead = clear & (change < UNCHANGED * np.median(change[clear]))
    count = int(dead.sum())
    if not 0 < count < SHARE * len(dead):
        return observation
    sentence = (
        f"{count} pixels of the object read the same under all lights and were left out: they are "
        "dead or hot pixels of the sensor, or black spots of the surface."
    )
    left = observation.select_pixels(~dead)
    return replace(left, findings=(sentence, *observation.findings))


def _stated_directions(observation: Photographs) -> Float[np.ndarray, "lights 3"]:
    """Return the rig's unit directions of the lights."""
    stated = observation.wi.mean(axis=1)
    return stated / np.linalg.norm(stated, axis=1, keepdims=True)


def _odd(
    observation: Photographs,
    off: Float[np.ndarray, " lights"],
    judged: Bool[np.ndarray, " lights"],
    median: float,
) -> np.ndarray:
    """Return the lights that individually deviate from their stated direction by more than the
    rig's uncertainty.
    """
    known = np.degrees(observation.uncertain.get("direction_sd", np.zeros(len(off))))
    return np.flatnonzero(judged & (off > np.maximum(max(FAR, 4 * median), 4 * known)))


def _unequal(
    observation: Photographs, size: Float[np.ndarray, " lights"], known: Bool[np.ndarray, " lights"]
) -> list[tuple[int, float]]:
    """Return the lights that are individually brighter or dimmer than the rig states, with the
    factor."""
    driven = np.mean(observation.intensity, axis=0) * observation.falloff.mean(axis=1)
    ratio = np.log(size / driven)
    ratio -= np.median(ratio[known])
    spread = np.median(np.abs(ratio[known])) / ndtri(0.75)
    errors = (observation.uncertain.get(name, 0.0) for name in ("intensity_sd", "exposure_sd"))
    error = np.sqrt(sum((np.asarray(own) ** 2 for own in errors), np.zeros(())))
    widest = np.maximum(max(np.log(BRIGHTER), 6 * spread), 4 * error)
    odd = np.flatnonzero(known & (np.abs(ratio) > widest))
    return [(int(i), float(np.exp(ratio[i]))) for i in odd]


def _copies(observation: Photographs) -> Copies:
    copies = Copies()
    for light, file in enumerate(observation.files):
        copies.add(file, observation.dn[:, light])
    return copies


def _copies_findings(observation: Photographs) -> list[str]:
    """Report images with equal numbers, which noise rules out for two exposures."""
    copies = _copies(observation)
    if not copies.equal_groups:
        return []
    named = "; ".join(
        ", ".join(files[:5]) + (" ..." if len(files) > 5 else "") for files in copies.equal_groups
    )
    return [
        f"Images of equal numbers are copies of one exposure: {named}. Every copy counts as "
        "another measurement, so the intervals are too narrow; keep one of them, under its light."
    ]


def _spread(normals: Float[np.ndarray, "pixels 3"]) -> float:
    """Return the root mean square component of the normals along the axis where it is smallest; 0
    for normals in one plane.
    """
    return float(np.linalg.svd(normals, compute_uv=False)[2] / np.sqrt(len(normals)))


def _direction_findings(observation: Photographs) -> list[str]:
    shown, known = directions_by_shading(observation)
    if known.sum() < 2:
        return []
    stated = _stated_directions(observation)
    off = float(np.median(_angles(shown, stated)[known]))
    if off < FAR:
        return _single_light_findings(observation, _angles(shown, stated), known, off)
    words = (
        "The shading of the images shows the lights "
        f"{off:.0f}° (median of {known.sum()}) from where the rig states them"
    )
    changed = {name: turn(stated) for name, turn in CHANGES.items()}
    _, order = linear_sum_assignment(-shown[known] @ stated[known].T)
    changed["the files in another order"] = stated.copy()
    changed["the files in another order"][known] = stated[known][order]
    left = {name: float(np.median(_angles(shown, v)[known])) for name, v in changed.items()}
    best = min(left, key=lambda name: left[name])
    if left[best] < NEAR:
        return [
            f"{words}; with {best} it would be {left[best]:.0f}°. Check the directions (x right, "
            "y up, z toward the camera) and which file belongs to which light."
        ]
    return [
        f"{words}. Check the directions (x right, y up, z toward the camera), the order of the "
        "files, the object's outline and normals, and the camera's gamma."
    ]


def _single_light_findings(
    observation: Photographs,
    angles: Float[np.ndarray, " lights"],
    known: Bool[np.ndarray, " lights"],
    median: float,
) -> list[str]:
    """Report lights that individually deviate from their stated directions."""
    odd, files = _odd(observation, angles, known, median), observation.files
    names = ", ".join(f"{files[i]} {angles[i]:.0f}°" for i in odd[np.argsort(-angles[odd])][:5])
    return [
        f"The shading shows {len(odd)} of {len(files)} lights elsewhere than the rig states them: "
        f"{names} off (median of all {median:.1f}°). Check their directions and files."
    ] * bool(len(odd))


def _angles(
    one: Float[np.ndarray, "lights 3"], other: Float[np.ndarray, "lights 3"]
) -> Float[np.ndarray, " lights"]:
    """Return the angles between directions, degrees."""
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=1), -1, 1)))


def _ball_outline_findings(observation: Photographs) -> list[str]:
    """Report pixels that stay dark under lights that they face, because the stated outline of the
    ball is too large or the object is black there.
    """
    signal = np.mean(observation.dn - observation.black, axis=0)
    facing = observation.cosine.max(axis=0) > SIDE
    dark = facing & (signal.max(axis=0) < DARK * np.quantile(signal, 0.98))
    share = float(dark.sum() / max(facing.sum(), 1))
    if share < SHARE:
        return []
    return [
        f"{format_percent(share)} of the object's pixels stay dark under every light, although "
        "they face one: its outline (the sphere's centre and radius, or the mask) reaches too "
        "far, or it is black there."
    ]
