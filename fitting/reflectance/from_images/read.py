"""Reading of photographs of a known shape under known lights, from a rig or from memory. The
result, `Photographs`, contains for each light and pixel the digital number, the cosine of
incidence, the angle to the mirror direction and the irradiance. If the rig has flats and darks of
the camera, their temporal noise gives gain and read noise, and the darks give the black level.

The view is orthographic along +z (x right, y up, z toward the camera), so that the viewer's
direction is the same everywhere. Angles are in radians, and digital numbers are those of the files.
"""

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from jaxvision import ArrayLike, as_array, as_vec
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError
from jaxvision.files.images import JPEG_FORMATS, read_image
from jaxvision.geometry import angle_between, mirror_direction
from jaxvision.geometry.hemisphere import local_frame

from ...frame_checks.frame import OddFrames, frame_sample, refuse_half
from ...frame_checks.heads import Stated, different_settings, odd_heads
from ...frame_checks.levels import odd_frames
from ...inference.diagnostics import listed
from ...inference.formatting import format_percent
from ...lights.file import read_lights
from ...noise.settings import require_one_setting
from ...observation import (
    Load,
    cropped_to_region,
    equalise_sites,
    equalised_camera,
    pixels_of_colour,
    read_mask,
    read_stack,
    require_as_many,
    require_frames,
    require_several_images,
    rig_in_memory,
)
from ...rig import (
    COLOURS,
    Camera,
    Dark,
    Flat,
    Geometry,
    Light,
    Purpose,
    Rig,
    SiteCamera,
    SphereGeometry,
    as_rig,
    require,
)

VIEW = (0.0, 0.0, 1.0)
# Positions, in pixels to the right of and below the centre, and weights of a quadrature over the
# area of a pixel. It is exact for polynomials of the third degree and for the fourth power of
# distance
POINTS = np.array([[0, -1, 1, -1, 1], [0, -1, -1, 1, 1]]) * np.sqrt(7 / 60)
WEIGHTS = np.array([8, 5, 5, 5, 5]) / 28
PURPOSE: Purpose = "a reflectance calibration"
HOLD_OUT_EVERY = 4  # every fourth light is kept for testing if the rig names none
FEWEST_LIGHTS_TO_SPLIT = 4
FEWEST_PIXELS = 50
FEWEST_READ = 3  # images that stay where others cannot be read
DARK_ERRORS = 4.0  # standard errors of an image's median within which it is at the black level
DARK_SHARE = 0.05  # share of the predicted signal below which an image is dark
OF_LIGHTS = ("intensity_sd", "direction_sd", "exposure_sd", "stray_sd")
SAME_LIGHT = 1e-3  # difference of a position up to which two files have the same light
SAME_SD = 1e-2  # relative difference of two standard deviations that are one number as printed
NOT_UNIT = 1e-2  # deviation of a normal's length from 1 beyond rounding
FEWEST_AT_TOP = 20  # fewest samples at the largest number that may be clipped
PILE, BELOW_TOP = 5, 8  # ratio to the counts at each of the next smaller numbers; how many of these
BRIGHT = 0.9  # share of the largest number from which numbers are counted
ASSUMED_BLACK = "The rig gives no camera.black_level, so a black level of 0 DN was assumed."

PILED = (
    "{count} samples are at {top:g} DN and none above, far more than at any number below: they "
    "count as clipped. Give the rig camera.saturation."
)


class UniformLevels(eqx.Module):
    """The statistics of flats and darks in one channel, one level for each entry of the rig."""

    mean: Float[Any, " levels"]  # over frames and pixels, DN
    variance: Float[Any, " levels"]  # temporal, of one pixel, DN^2
    freedom: Float[Any, " levels"]  # degrees of freedom of the variance
    mean_error: Float[Any, " levels"]  # standard error of the mean, DN
    dark: Bool[Any, " levels"]  # which are darks


@dataclass(frozen=True)
class Photographs:
    """The measurements at the pixels of the object, with the rig's values and their uncertainties.

    The product of `intensity` and `falloff` is the irradiance on a surface that faces the light.

    Attributes:
        channels: names of the channels.
        files: names of the images, one for each light.
        dn: (channels, lights, pixels) stored digital numbers.
        intensity: (channels, lights) intensity as stated in the rig.
        falloff: (lights, pixels) factor on the intensity by distance: 1 for distant lights, m^-2
            for point lights.
        wi: (lights, pixels, 3) unit vector toward the light.
        cosine: (lights, pixels) n.l, negative in attached shadows.
        mirror_angle: (lights, pixels) angle between view and mirror direction, rad.
        normals: (pixels, 3) unit normals.
        held_out: (lights,), true for lights that are used only to test predictions.
        rows: (pixels,) row of each pixel in images of `shape`.
        columns: (pixels,) column of each pixel in images of `shape`.
        shape: (h, w) of the images.
        camera: camera of the rig, after its mosaic sites were shifted to one black level.
        black: DN without light.
        white: DN of full scale above black.
        clip: DN from which a pixel is saturated.
        gamma: encoding exponent; None where linear or unknown.
        gain: DN per electron; None where unknown.
        read_noise: e- rms; None where unknown.
        findings: sentences on assumptions.
        uncertain: (lights,) standard deviations, by their key in the rig; 0 where the value is
            exact.
        turn_prior: prior covariance of the errors of all lights in units of their standard
            deviations; None for independent lights. The errors of a light are two rotations of its
            direction, the logarithm of its intensity unless exact, and its relative distance if
            near.
        black_sd: DN, standard deviation of the black level; 0 where exact.
        gamma_sd: standard deviation of the encoding exponent; 0 where exact.
        levels: statistics of the flats and darks of each channel; None if there are none or they
            are not requested.
        within: (points, pixels, 3) unit normals at `POINTS` of each pixel; None where pixels count
            as points.
        reach: (lights,) displacement of a point of the surface per unit change of its normal, m; 0
            for distant lights.
    """

    channels: tuple[str, ...]
    files: tuple[str, ...]
    dn: Float[np.ndarray, "channels lights pixels"]
    intensity: Float[np.ndarray, "channels lights"]
    falloff: Float[np.ndarray, "lights pixels"]
    wi: Float[np.ndarray, "lights pixels 3"]
    cosine: Float[np.ndarray, "lights pixels"]
    mirror_angle: Float[np.ndarray, "lights pixels"]
    normals: Float[np.ndarray, "pixels 3"]
    held_out: Bool[np.ndarray, " lights"]
    rows: Int[np.ndarray, " pixels"]
    columns: Int[np.ndarray, " pixels"]
    shape: tuple[int, int]
    camera: SiteCamera
    black: float
    white: float
    clip: float
    gamma: float | None
    gain: float | None
    read_noise: float | None
    findings: tuple[str, ...]
    uncertain: dict[str, Float[np.ndarray, " lights"]] = field(default_factory=dict)
    turn_prior: Float[np.ndarray, "turns turns"] | None = None
    black_sd: float = 0.0
    gamma_sd: float = 0.0
    levels: tuple[UniformLevels, ...] | None = None
    within: Float[np.ndarray, "points pixels 3"] | None = None
    reach: Float[np.ndarray, " lights"] = field(default_factory=lambda: np.zeros(1))

    @cached_property
    def points(self) -> tuple["Photographs", ...]:
        """Return the photographs once for each of the `POINTS` within a pixel, with the normals and
        light directions at these points.
        """
        if self.within is None:
            return (self,)
        to_light, lit, found = self.wi / np.sqrt(self.falloff)[..., None], {}, []
        for normals in self.within:
            if self.reach.any():
                toward = to_light - self.reach[:, None, None] * (normals - self.normals)
                distance = np.linalg.norm(toward, axis=-1)
                lit = {"wi": toward / distance[..., None], "falloff": distance**-2.0}
            found.append(replace(self, normals=normals, within=None, **lit))
        return tuple(found)

    @property
    def saturated(self) -> Bool[np.ndarray, "channels lights pixels"]:
        return self.dn >= self.clip

    def select_pixels(self, some: slice | Bool[np.ndarray, " pixels"]) -> "Photographs":
        """Return the photographs of some pixels."""
        own = {name: getattr(self, name)[some] for name in ("normals", "rows", "columns")}
        seen = {n: getattr(self, n)[:, some] for n in ("wi", "cosine", "mirror_angle", "falloff")}
        within = None if self.within is None else self.within[:, some]
        return replace(self, **own, **seen, dn=self.dn[..., some], within=within)

    def select_lights(self, kept: Bool[np.ndarray, " lights"]) -> "Photographs":
        """Return the photographs of some lights."""
        names = "wi", "cosine", "mirror_angle", "falloff", "reach"
        return replace(
            self,
            **{name: getattr(self, name)[kept] for name in names},
            files=tuple(name for name, stays in zip(self.files, kept, strict=True) if stays),
            dn=self.dn[:, kept],
            intensity=self.intensity[:, kept],
            held_out=self.held_out[kept],
            uncertain={name: sizes[kept] for name, sizes in self.uncertain.items()},
            turn_prior=turn_prior_of(self, kept),
        )


def read_reflectance_observation(
    rig: Rig | str | os.PathLike[str], *, load: Load = read_image, channel: str = ""
) -> Photographs:
    """Read and check all files that a rig's `[[light]]` and `[geometry]` entries name.

    Lights marked `held_out` are used only to test predictions. If none is marked and there are at
    least four, every fourth is held out. Normals are scaled to unit length.

    Args:
        rig: with `[[light]]` and `[geometry]`, or its folder or file.
        load: function that reads an image from its path.
        channel: the colour of a mosaic to read, "red", "green" or "blue"; only its pixels are used.

    Returns:
        The observation.

    Raises:
        InputError: for images that are missing, of unequal size, dark or clipped throughout, for
            shapes that do not match and for too few pixels.
    """
    rig = as_rig(rig)
    require(rig, PURPOSE)
    if rig.camera.pattern is None and channel:
        raise InputError(f"{rig.folder}: {channel!r} is a colour of a mosaic; give camera.pattern.")
    if rig.camera.pattern is not None and channel not in COLOURS:
        raise InputError(
            f"{rig.folder}: camera.pattern says the images are a Bayer mosaic; read one colour at "
            f"a time, by a channel of {', '.join(COLOURS)}."
        )
    rig, load, unreadable = _drop_unreadable(rig, load)
    rig, remarks = _drop_odd_heads(rig)
    remarks = [*unreadable, *remarks]
    assert rig.geometry is not None
    frames = _read_frames(rig, load)
    shape = (frames.shape[2], frames.shape[3])
    named, mask = rig.geometry.mask, None
    if named is not None:
        mask = read_mask(rig.path(named), rig.camera, shape=shape, load=load)
    useless = [f"The mask {named} leaves out no pixel; it has no effect."]
    rows, columns, normals, within = _surface(rig, rig.geometry, shape, mask, load, channel)
    wi, falloff, reach = _light_field(rig, normals)
    cosine, mirror_angle = angles(normals, wi)
    camera = equalised_camera(rig.camera)
    black = camera.black_level or 0.0
    dn = frames[:, :, rows, columns]
    pile = _pile_at_top(dn) if camera.saturation is None else None
    if pile is not None and pile[0] < camera.clip_level:
        camera = camera.model_copy(update={"saturation": pile[0]})
        remarks = [*remarks, PILED.format(count=pile[1], top=pile[0])]
    held_out, how = _held_out(rig)
    observation = Photographs(
        channels=COLOURS if len(frames) > 1 else (channel or "grey",),
        files=tuple(light.file for light in rig.light),
        dn=dn,
        intensity=_intensities(rig, len(frames), channel),
        falloff=falloff,
        wi=wi,
        cosine=cosine,
        mirror_angle=mirror_angle,
        normals=normals,
        held_out=held_out,
        rows=rows,
        columns=columns,
        shape=shape,
        camera=camera,
        black=black,
        white=camera.full_scale - black,
        clip=camera.clip_level,
        gamma=camera.encoding,
        gain=camera.gain,
        read_noise=camera.read_noise,
        findings=(
            *remarks,
            *how,
            *([ASSUMED_BLACK] * (rig.camera.black_level is None)),
            *useless * (mask is not None and bool(mask.all())),
        ),
        uncertain={
            name: np.array([getattr(light, name) or 0.0 for light in rig.light])
            for name in OF_LIGHTS
        },
        black_sd=camera.black_sd or 0.0,
        gamma_sd=camera.gamma_sd or 0.0,
        within=within,
        reach=reach,
    )
    _refuse_unusable(rig, observation)
    if rig.covariance is not None:
        return set_light_covariance(observation, *_covariance_of(rig))
    return observation


def _covariance_of(rig: Rig) -> tuple[Float[np.ndarray, "lights 4 lights 4"], bool]:
    """Return the covariance of the lights, and whether they are near, from the file that the rig
    names. An `intensity_sd` of the rig that differs from that of the file replaces it.
    """
    assert rig.covariance is not None
    known = read_lights(rig.folder / rig.covariance)
    scale = np.linalg.norm(known.places, axis=1)
    order = []
    for light in rig.light:
        place = light.position if known.near else light.direction
        apart = np.full(len(scale), np.inf)
        if place is not None:
            apart = np.linalg.norm(known.places - np.asarray(place), axis=1) / scale
        order.append(int(np.argmin(apart)))
        if not apart.min() < SAME_LIGHT:
            raise InputError(
                f"{rig.folder}: light {light.file} is not in {rig.covariance}; give its "
                f"{'position' if known.near else 'direction'} as in that file, or remove "
                "covariance."
            )
    covariance = known.covariance[order][:, :, order]
    sds = known.intensity_sd[order]
    for i, light in enumerate(rig.light):
        stated = light.intensity_sd
        if stated is not None and abs(stated - sds[i]) > SAME_SD * stated:
            covariance = set_intensity_sd(covariance, i, stated)
    return covariance, known.near


def set_intensity_sd(
    covariance: Float[np.ndarray, "lights 4 lights 4"], light: int, sd: float
) -> Float[np.ndarray, "lights 4 lights 4"]:
    """Return a covariance of lights in which the intensity of one has an independent error."""
    covariance = covariance.copy()
    covariance[light, 3], covariance[..., light, 3] = 0, 0
    covariance[light, 3, light, 3] = sd**2
    return covariance


def set_light_covariance(
    observation: Photographs,
    covariance: Float[np.ndarray, "lights 4 lights 4"],
    near: bool,
) -> Photographs:
    """Return the photographs with uncertain lights. `covariance` is the joint covariance of the
    lights' directions, or positions in m, and of the logarithms of their intensities.
    """
    lights, middle = len(covariance), observation.wi.mean(axis=1)
    distance = np.ones(lights)
    if near:
        distance = np.mean(observation.falloff**-0.5, axis=1)
    along = np.zeros((lights, 4, 4))  # of the errors by each number of the covariance
    along[:, :2, :3] = across(observation.wi) / distance[:, None, None]
    along[:, 2, 3] = 1
    along[:, 3, :3] = near * _unit(middle) / distance[:, None]
    both = np.einsum("lai,limj,mbj->lamb", along, covariance, along)
    own = np.sqrt(np.maximum(np.einsum("lala->la", both), 0))
    sizes = {
        "direction_sd": np.sqrt(np.mean(own[:, :2] ** 2, axis=1)),
        "intensity_sd": own[:, 2],
        "distance_sd": own[:, 3],
    }
    kept = 4 if near else 3 if own[:, 2].any() else 2
    found = replace(observation, uncertain=observation.uncertain | sizes)
    scale = np.maximum(np.stack([own[:, 0], *sizes.values()], axis=1)[:, :kept], 1e-12)
    scale[:, 0] = scale[:, 1]
    prior = both[:, :kept, :, :kept].reshape(kept * lights, -1)
    prior = prior / np.outer(scale, scale) + 1e-9 * np.eye(kept * lights)
    return replace(found, turn_prior=prior)


def turn_prior_of(
    observation: Photographs, lights: Bool[np.ndarray, " lights"] | Int[np.ndarray, " some"]
) -> Float[np.ndarray, "turns turns"] | None:
    """Return the joint covariance of the errors of some lights; None if lights are independent."""
    if observation.turn_prior is None:
        return None
    places = np.arange(len(observation.turn_prior)).reshape(len(observation.files), -1)
    places = places[lights].ravel()
    return observation.turn_prior[np.ix_(places, places)]


def _unit(vectors: Float[np.ndarray, "lights 3"]) -> Float[np.ndarray, "lights 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def across(wi: Float[np.ndarray, "lights pixels 3"]) -> Float[np.ndarray, "lights 2 3"]:
    """Return two unit axes perpendicular to each light direction, about which it may rotate."""
    middle: Any = _unit(wi.mean(axis=1))
    frame = local_frame(as_vec(middle))
    return np.stack([np.asarray(as_array(v)) for v in (frame.tangent, frame.bitangent)], axis=1)


def _pile_at_top(dn: Float[np.ndarray, "channels lights pixels"]) -> tuple[float, int] | None:
    """Return the largest number, DN, and how many samples have this number, if these samples far
    outnumber those with the next smaller numbers in several images. The camera has then clipped
    these samples.
    """
    top = dn.max()
    values, counts = np.unique(dn[dn >= BRIGHT * top], return_counts=True)
    several = np.count_nonzero((dn == top).any(axis=(0, 2))) > 1
    most = PILE * counts[-1 - BELOW_TOP : -1].max(initial=0)
    if len(values) > BELOW_TOP and several and counts[-1] > max(FEWEST_AT_TOP, most):
        return float(top), int(counts[-1])
    return None


def _drop_unreadable(rig: Rig, load: Load) -> tuple[Rig, Load, list[str]]:
    """Return the rig without the lights whose images cannot be read or have another size than the
    others, a function that returns the images that were read, and the reasons. The rig is unchanged
    if half of the lights, or all but two, would be left out.
    """
    stored: dict[Path, np.ndarray] = {}
    odd: list[OddFrames] = []
    for light in rig.light:
        path = rig.path(light.file)
        try:
            stored[path] = load(path)
        except InputError as error:
            if not path.is_file():
                raise
            reason = str(error).removeprefix(f"{path}: ").removesuffix(".")
            odd.append(OddFrames((light.file,), f"it cannot be read ({reason})"))
    sizes = Counter(image.shape[:2] for image in stored.values())
    size, count = sizes.most_common(1)[0] if sizes else ((), 0)
    if count <= len(rig.light) / 2 or count < FEWEST_READ:
        return rig, load, []
    odd += [
        OddFrames((light.file,), f"it is {image.shape[:2]}, the others {size}")
        for light in rig.light
        if (image := stored.get(rig.path(light.file))) is not None and image.shape[:2] != size
    ]
    gone = {name for one in odd for name in one.names}
    kept = tuple(light for light in rig.light if light.file not in gone)

    def read(path: Path) -> np.ndarray:
        """Return an image, and release it from memory."""
        image = stored.pop(path, None)
        return load(path) if image is None else image

    return rig.model_copy(update={"light": kept}), read, [one.sentence for one in odd]


def _drop_odd_heads(rig: Rig) -> tuple[Rig, list[str]]:
    """Return the rig without the lights whose metadata contradict those of the majority, with the
    reasons."""
    stated = [Stated(light.file, rig.path(light.file), 0.0) for light in rig.light]
    odd, _ = odd_heads(rig.folder, stated)
    refuse_half(rig.folder, odd, len(stated))
    gone = {name for one in odd for name in one.names}
    kept = tuple(light for light in rig.light if light.file not in gone)
    remarks = [one.sentence for one in odd]
    if settings := different_settings([rig.path(light.file) for light in kept]):
        remarks.append(
            f"By their metadata, the images differ in settings ({settings}). The rig states none "
            "for lights, so their intensities must include these settings."
        )
    lossy = [one.file for one in kept if Path(one.file).suffix.lower() in JPEG_FORMATS]
    if lossy:
        remarks.append(
            f"{listed([*lossy[:3], *['others'] * (len(lossy) > 3)])} "
            f"{'are' if len(lossy) > 1 else 'is'} JPEG, which blurs narrow highlights and encodes "
            "colours as sRGB in most cameras; no interval includes the blur."
        )
    return rig.model_copy(update={"light": kept}), remarks


def _read_frames(rig: Rig, load: Load) -> Float[np.ndarray, "channels lights h w"]:
    named = None if rig.geometry is None else rig.geometry.mask
    mask = None if named is None else read_mask(rig.path(named), rig.camera, load=load)
    stored = read_stack(rig, [light.file for light in rig.light], load=load, mask=mask)
    stack = np.stack([equalise_sites(image, rig.camera) for image in stored])
    return stack[None] if stack.ndim == 3 else np.moveaxis(stack, 3, 0)


def _surface(
    rig: Rig,
    geometry: Geometry,
    shape: tuple[int, int],
    mask: np.ndarray | None,
    load: Load,
    channel: str,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rows, columns and unit normals of the pixels that show the object, and the normals at
    several points (`POINTS`) inside each of these pixels.
    """
    if geometry.sphere is not None:
        normals, seen = _sphere_normals(geometry.sphere, rig.camera, *np.indices(shape))
    else:
        assert geometry.normals is not None
        normals, seen = _stored_normals(rig, geometry.normals, shape, mask, load)
    if mask is not None:
        seen = seen & mask
    smooth = np.where(seen[..., None], normals, np.nan)
    if channel:
        seen = seen & pixels_of_colour(rig.camera, shape, channel)
    rows, columns = np.nonzero(seen)
    if len(rows) < FEWEST_PIXELS:
        raise InputError(
            f"{rig.folder}: mask and geometry leave {len(rows)} pixels of the object; {PURPOSE} "
            f"needs at least {FEWEST_PIXELS}, so check the mask, the sphere and the image size."
        )
    if geometry.sphere is not None:
        places = rows + POINTS[1, :, None], columns + POINTS[0, :, None]
        within = _sphere_normals(geometry.sphere, rig.camera, *places)[0]
    else:
        within = _normals_within(smooth, rows, columns)
    return rows, columns, normals[rows, columns], within


def _sphere_normals(
    sphere: SphereGeometry, camera: Camera, row: np.ndarray, column: np.ndarray
) -> tuple[Float[np.ndarray, "... 3"], Bool[np.ndarray, "..."]]:
    """Return the normals of a sphere in orthographic projection, and a mask of the pixels inside
    its outline.
    """
    top, left = (camera.region or (0, 0))[:2]
    x = (column + left - sphere.centre[0]) / sphere.radius
    y = (sphere.centre[1] - row - top) / sphere.radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    return np.stack([x, y, z], axis=-1), np.hypot(x, y) < 1 - 1 / sphere.radius


def _normals_within(
    image: Float[np.ndarray, "h w 3"],
    rows: Int[np.ndarray, " pixels"],
    columns: Int[np.ndarray, " pixels"],
) -> Float[np.ndarray, "points pixels 3"]:
    """Return unit normals at `POINTS` of pixels, from parabolas through the normals of the
    neighbours on both sides. If a neighbour is missing or NaN, the normal is constant along that
    row or column."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    found = own = image[rows, columns]
    for place, down, across in zip(POINTS[..., None, None], (0, 1), (1, 0), strict=True):
        before, after = (padded[rows + 1 + s * down, columns + 1 + s * across] for s in (-1, 1))
        more = place * (after - before) / 2 + place**2 * (after + before - 2 * own) / 2
        found = found + np.where(np.isfinite(more), more, 0)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def _stored_normals(
    rig: Rig, name: str, shape: tuple[int, int], mask: np.ndarray | None, load: Load
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    path = rig.path(name)
    normals = cropped_to_region(np.asarray(load(path), np.float64), rig.camera, path)
    if normals.shape != (*shape, 3):
        raise InputError(
            f"{path}: the normals are {normals.shape}, the images are {shape}; give one normal "
            "(x right, y up, z toward the camera) per pixel."
        )
    length = np.linalg.norm(normals, axis=-1)
    claimed = (length != 0) if mask is None else mask
    wrong = claimed & ~(np.abs(length - 1) < NOT_UNIT)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise InputError(
            f"{path}: {int(wrong.sum())} normals of the object are not of length 1, the first "
            f"(length {length[row, column]:.4g}) in row {row}, column {column}; normalise them or "
            "mask those pixels."
        )
    unit = normals / np.where(claimed, length, 1)[..., None]
    away = np.count_nonzero(claimed & (unit[..., 2] < 0))
    if 2 * away > np.count_nonzero(claimed):
        raise InputError(
            f"{path}: {away} of {np.count_nonzero(claimed)} normals point away from the camera, "
            "where no pixel sees them; z is toward the camera, so change its sign."
        )
    return unit, claimed & (unit[..., 2] > 0)


def _light_field(
    rig: Rig, normals: Float[np.ndarray, "pixels 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit vectors toward each light (lights, pixels, 3), the falloff of its intensity
    (lights, pixels), and its reach (lights,).
    """
    directions, falloffs, reach = [], [], np.zeros(len(rig.light))
    for i, light in enumerate(rig.light):
        if light.direction is not None:
            unit = np.asarray(light.direction) / np.linalg.norm(light.direction)
            directions.append(np.broadcast_to(unit, normals.shape))
            falloffs.append(np.ones(len(normals)))
            continue
        reach[i] = _radius_in_metres(rig, light)
        toward = np.asarray(light.position) - reach[i] * normals
        distance = np.linalg.norm(toward, axis=-1)
        directions.append(toward / distance[:, None])
        falloffs.append(distance**-2.0)
    return np.stack(directions), np.stack(falloffs), reach


def _radius_in_metres(rig: Rig, light: Light) -> float:
    sphere = rig.geometry.sphere if rig.geometry is not None else None
    if sphere is None or sphere.radius_m is None:
        raise InputError(
            f"{rig.folder}: light {light.file} has a position in metres, which needs the object's "
            "place in metres too; give geometry.sphere with radius_m, or use a direction."
        )
    assert light.position is not None
    if np.linalg.norm(light.position) <= sphere.radius_m:
        raise InputError(
            f"{rig.folder}: light {light.file} lies inside the sphere of radius "
            f"{sphere.radius_m:g} m; correct its position (metres from the sphere's centre)."
        )
    return sphere.radius_m


@jax.jit
def _angles_of_one_light(normals: jax.Array, wi: jax.Array) -> tuple[jax.Array, ...]:
    mirrored = mirror_direction(normals, wi)
    view = jnp.broadcast_to(jnp.array(VIEW, normals.dtype), normals.shape)
    cosine = jnp.sum(normals * wi, axis=-1)
    return cosine, angle_between(mirrored, view)


def angles(
    normals: Float[np.ndarray, "pixels 3"], wi: Float[np.ndarray, "lights pixels 3"]
) -> tuple[np.ndarray, ...]:
    """Return n.l and the mirror angle in rad, (lights, pixels) each."""
    per_light = [_angles_of_one_light(normals, w) for w in wi]
    return tuple(np.stack([np.asarray(x) for x in kind]) for kind in zip(*per_light, strict=True))


def _intensities(
    rig: Rig, channels: int, channel: str = ""
) -> Float[np.ndarray, "channels lights"]:
    if channel:
        return _intensities(rig, len(COLOURS))[[COLOURS.index(channel)]]
    columns = []
    for light in rig.light:
        if len(light.intensity) not in (1, channels):
            raise InputError(
                f"{rig.folder}: light {light.file} has {len(light.intensity)} intensities, but the "
                f"images have {channels} channel{'s' * (channels > 1)}; give one intensity per "
                "channel."
            )
        columns.append(np.broadcast_to(light.intensity, channels))
    return np.stack(columns, axis=1).astype(np.float64)


def _held_out(rig: Rig) -> tuple[Bool[np.ndarray, " lights"], tuple[str, ...]]:
    chosen = np.array([light.held_out for light in rig.light])
    if chosen.all():
        raise InputError(
            f"{rig.folder}: every light is held out, so none is left to fit; set held_out = false "
            "for most of them."
        )
    if chosen.any():
        return chosen, ()
    if len(chosen) < FEWEST_LIGHTS_TO_SPLIT:
        return chosen, (
            f"Of {len(chosen)} light{'s' * (len(chosen) > 1)} none was held out, so the fit's "
            "prediction of other lights is untested; add lights.",
        )
    chosen[HOLD_OUT_EVERY - 1 :: HOLD_OUT_EVERY] = True
    return chosen, (
        f"The rig holds no light out, so every fourth ({int(chosen.sum())} of {len(chosen)}) was "
        "kept from the fit to test its prediction.",
    )


def _refuse_unusable(rig: Rig, observation: Photographs) -> None:
    lit, black = observation.cosine > 0, observation.black
    for name, of_light in zip(observation.files, lit, strict=True):
        if not of_light.any():
            raise InputError(
                f"{rig.folder}: light {name} reaches no visible pixel; its direction must point "
                "from the object toward the light (x right, y up, z toward the camera)."
            )
    for channel, dn in zip(observation.channels, observation.dn[:, lit], strict=True):
        clipped = float(np.mean(dn >= observation.clip))
        if clipped > 0.9:
            raise InputError(
                f"{rig.folder}: {format_percent(clipped)} of the lit pixels of the {channel} "
                f"channel are saturated (at or above {observation.clip:g} DN); expose less, or "
                "correct camera.saturation."
            )
        if np.median(dn) - black < 1:
            raise InputError(
                f"{rig.folder}: the lit pixels of the {channel} channel are dark (median "
                f"{np.median(dn):g} DN over a black level of {black:g} DN); expose more, or "
                "correct camera.black_level or the directions of the lights."
            )
    lightless = lightless_images(observation)
    if 2 * len(lightless) > len(observation.files) or len(observation.files) - len(lightless) < 3:
        for i, state in lightless.items():
            raise InputError(
                f"{rig.folder}: every lit pixel of {observation.files[i]} is {state}; take that "
                "image again or remove its [[light]] entry."
            )


def lightless_images(observation: Photographs) -> dict[int, str]:
    """Return, by index, the images whose lit pixels are all dark or all saturated, and which of the
    two applies.
    """
    found = {}
    dark = _dark(observation)
    for i, lit in enumerate(observation.cosine > 0):
        seen = observation.dn[:, i, lit]
        if (seen >= observation.clip).all():
            found[i] = "saturated"
        elif (seen <= observation.black + 1).all() or dark[i]:
            found[i] = "dark"
    return found


def _dark(observation: Photographs) -> Bool[np.ndarray, " lights"]:
    """Find images that are at the black level within their noise, although the other images imply a
    much larger signal.
    """
    signal = (observation.dn - observation.black).mean(axis=0)
    driven = observation.intensity.mean(axis=0)[:, None] * observation.falloff * observation.cosine
    median, error, drive = np.zeros((3, len(signal)))
    for i, lit in enumerate(observation.cosine > 0):
        median[i] = np.median(signal[i, lit])
        spread = np.median(np.abs(signal[i, lit] - median[i])) / ndtri(0.75)
        error[i] = spread * np.sqrt(np.pi / 2 / np.count_nonzero(lit))
        drive[i] = np.median(driven[i, lit])
    expected = drive * np.median(median / drive)
    at_black = np.abs(median) <= 1 + DARK_ERRORS * np.hypot(error, observation.black_sd)
    return at_black & (median < DARK_SHARE * expected)


def read_joint_measurement(
    rig: Rig | str | os.PathLike[str], *, load: Load = read_image, channel: str = ""
) -> Photographs:
    """Read and check the images of a rig, its flats and its darks.

    Args:
        rig: with `[[light]]` and `[geometry]`, and optional `[[flat]]` and `[[dark]]`; or its
            folder or file.
        load: function that reads an image from its path.
        channel: the colour of a mosaic to read, "red", "green" or "blue"; only its pixels are used.

    Returns:
        The photographs, with the levels of flats and darks.

    Raises:
        InputError: as for the reflectance calibration, and for flats and darks that do not match.
    """
    rig = as_rig(rig)
    observation = read_reflectance_observation(rig, load=load, channel=channel)
    encoded = observation.gamma is not None
    rig, findings = _drop_odd_frames(rig, load)
    if encoded and rig.dark:
        findings.append(
            "The files are gamma encoded: darks, at the foot of the curve, were left out."
        )
    return replace(
        observation,
        levels=_levels(rig, observation.channels, load, with_darks=not encoded),
        findings=(*findings, *observation.findings),
    )


def _drop_odd_frames(rig: Rig, load: Load) -> tuple[Rig, list[str]]:
    """Return a rig without the flats and darks that deviate from the others, with the reasons."""
    sentences: list[str] = []
    camera, black = equalised_camera(rig.camera), np.zeros(0)
    kept: dict[str, list[Flat | Dark]] = {"dark": [], "flat": []}
    for kind in kept:
        entries: Sequence[Flat | Dark] = getattr(rig, kind)
        if not entries:
            continue
        levels = []
        for entry in entries:
            stack = read_stack(rig, entry.files, load=load)
            grey = stack.mean(axis=3) if stack.ndim == 4 else stack
            frames = zip(entry.files, grey, strict=True)
            levels.append(
                [frame_sample(name, frame, top=camera.clip_level) for name, frame in frames]
            )
        light = [getattr(entry, "photons", None) or entry.exposure for entry in entries]
        is_flat = kind == "flat"
        floor = np.median(black) if black.size else camera.black_level or 0.0
        odd = odd_frames(
            levels, light=light, black=np.full(len(levels), floor) if is_flat else None
        )
        refuse_half(rig.folder, odd, sum(len(level) for level in levels))
        sentences += [one.sentence for one in odd]
        gone = {name for one in odd for name in one.names}
        black = np.array([one.mean for level in levels for one in level if one.name not in gone])
        for entry in entries:
            if files := tuple(name for name in entry.files if name not in gone):
                kept[kind].append(entry.model_copy(update={"files": files}))
    return rig.model_copy(update={kind: tuple(own) for kind, own in kept.items()}), sentences


def _levels(
    rig: Rig, channels: tuple[str, ...], load: Load, *, with_darks: bool
) -> tuple[UniformLevels, ...] | None:
    entries = [*rig.flat, *(rig.dark if with_darks else ())]
    if not entries:
        return None
    require_one_setting(rig, "give only flats and darks at the images' gain and temperature")
    rows = np.array([_level(rig, entry.files, channels, load) for entry in entries])
    dark = np.arange(len(entries)) >= len(rig.flat)
    levels = tuple(UniformLevels(*own.T, dark=dark) for own in np.moveaxis(rows, 1, 0))
    for channel in levels:
        if (channel.variance <= 0).any():
            first = entries[int(np.argmax(channel.variance <= 0))].files[0]
            raise InputError(
                f"{rig.path(first)}: its frames are equal in every pixel, so they are copies, "
                "clipped or saturated; give independent frames at another level."
            )
    return levels


def _level(rig: Rig, files: tuple[str, ...], names: tuple[str, ...], load: Load) -> np.ndarray:
    """Return, for each channel, the mean of a level, its temporal variance, the variance's degrees
    of freedom, and the error of the mean, (channels, 4).
    """
    stack = np.stack([equalise_sites(f, rig.camera) for f in read_stack(rig, files, load=load)])
    if rig.camera.pattern is not None:
        own = pixels_of_colour(rig.camera, stack.shape[1:3], names[0])
        stack = stack[:, own][:, :, None]
    stack = stack[..., None] if stack.ndim == 3 else stack
    channels = len(names)
    if stack.shape[3] != channels:
        raise InputError(
            f"{rig.path(files[0])}: has {stack.shape[3]} channels, the object's images have "
            f"{channels}; give flats and darks of the same kind."
        )
    if (stack >= equalised_camera(rig.camera).clip_level).any():
        raise InputError(
            f"{rig.path(files[0])}: has saturated pixels; leave this level out of the rig."
        )
    frames, height, width = stack.shape[:3]
    pixels = height * width
    # a common drift of frames is not pixel noise
    noise = stack - stack.mean(axis=(1, 2), keepdims=True)
    variance = noise.var(axis=0, ddof=1).mean(axis=(0, 1)) * pixels / (pixels - 1)
    of_pixels = stack.mean(axis=0).reshape(pixels, channels)
    error = np.sqrt(of_pixels.var(axis=0, ddof=1) / pixels)
    freedom = np.full(channels, (frames - 1.0) * (pixels - 1))
    return np.stack([of_pixels.mean(axis=0), variance, freedom, error], axis=1)


# Names of the arguments for the keys of the entries.
CALLED = {
    "light.direction": "lights",
    "light.position": "lights",
    "light.intensity": "intensities",
} | {f"light.{name}": name for name in OF_LIGHTS}


def from_photographs(
    images: Sequence[ArrayLike],
    lights: Float[np.ndarray, "lights 3"],
    *,
    camera: Camera,
    normals: Float[np.ndarray, "h w 3"] | None = None,
    sphere: SphereGeometry | None = None,
    mask: Bool[np.ndarray, "h w"] | None = None,
    intensities: ArrayLike | None = None,
    intensity_sd: ArrayLike | None = None,
    direction_sd: ArrayLike | None = None,
    exposure_sd: ArrayLike | None = None,
    stray_sd: ArrayLike | None = None,
    held_out: Sequence[int] = (),
    point_lights: bool = False,
    flats: Sequence[Sequence[ArrayLike]] = (),
    darks: Sequence[Sequence[ArrayLike]] = (),
    channel: str = "",
) -> Photographs:
    """Make a record of photographs in memory, for `reflectance.calibrate` and `joint.calibrate`.

    The view is orthographic along +z (x right, y up, z toward the camera). Each standard deviation
    is one number for all images or one number for each. None means that the value is exact.

    Args:
        images: one for each light, (h, w) or (h, w, 3) DN.
        lights: (lights, 3) unit vectors from the object toward distant lights.
        camera: the camera's bits, other known properties, and their errors (`black_sd`, `gamma_sd`,
            `gain_sd`, `read_noise_sd`, `prnu_sd`).
        normals: (h, w, 3) unit, 0 beside the object. Pass either these or a sphere.
        sphere: sphere in orthographic projection.
        mask: (h, w), true where the object is; None for all pixels of the shape.
        intensities: (lights,) or (lights, channels) irradiance on a surface that faces the light, W
            m^-2 or relative; for point lights, radiant intensity. None for 1.
        intensity_sd: relative standard deviation of the intensities.
        direction_sd: standard deviation of the directions, rad along each of two axes perpendicular
            to them. Or the covariance of all lights together, (lights, 4, lights, 4), as
            `fitting.lights.calibrate` returns it. It includes the errors of intensities, unless
            `intensity_sd` is given.
        exposure_sd: relative standard deviation of the images' exposures.
        stray_sd: rms of stray light on all pixels, relative to the irradiance.
        held_out: indices of the lights that are used only to test predictions. If none is given,
            every fourth light is held out.
        point_lights: whether `lights` are positions from the centre of the sphere, m.
        flats: for each level of light two or more frames, (h, w) or (h, w, 3) DN; a joint
            calibration estimates gain and read noise from them.
        darks: levels of two or more frames each, without light.
        channel: the colour of a mosaic to use, "red", "green" or "blue".

    Returns:
        The photographs, after the same checks as those of a folder.

    Raises:
        InputError: for lists of unequal length, and for images that cannot be used.

    Example:
        >>> from fitting.reflectance import Camera, SphereGeometry, from_photographs
        >>> lights = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])
        >>> images = [np.full((20, 20), 100)] * 4  # DN
        >>> ball = SphereGeometry(centre=(9.5, 9.5), radius=8.0)  # pixels
        >>> seen = from_photographs(images, lights, camera=Camera(bits=8), sphere=ball)
        >>> print(seen.channels, seen.shape, seen.held_out)
        ('grey',) (20, 20) [False False False  True]
    """
    lights, intensities = plain_array("lights", lights), plain_array("intensities", intensities)
    require_several_images("images", images)
    require_as_many("lights", lights, "images", images)
    strengths = np.ones(len(lights)) if intensities is None else np.asarray(intensities)
    require_as_many("intensities", strengths, "images", images)
    together = None
    if np.ndim(direction_sd) == 4:  # type: ignore[arg-type]
        together, direction_sd = np.asarray(plain_array("direction_sd", direction_sd)), None
        if together.shape != 2 * (len(lights), 4):
            raise InputError(
                f"direction_sd: a covariance of {len(lights)} lights is ({len(lights)}, 4, "
                f"{len(lights)}, 4), got {together.shape}."
            )
    stated = zip(OF_LIGHTS, (intensity_sd, direction_sd, exposure_sd, stray_sd), strict=True)
    sizes = {name: _one_per_image(name, sd, images) for name, sd in stated if sd is not None}
    entries: dict[str, Any] = {"geometry": {} if sphere is None else {"sphere": sphere}}
    entries["light"] = [
        {
            "file": f"images[{i}]",
            "position" if point_lights else "direction": np.asarray(light).tolist(),
            "intensity": np.atleast_1d(strength).tolist(),
            "held_out": i in held_out,
        }
        | {name: float(each[i]) for name, each in sizes.items() if each[i] != 0}
        for i, (light, strength) in enumerate(zip(lights, strengths, strict=True))
    ]
    named: dict[str, ArrayLike] = {f"images[{i}]": image for i, image in enumerate(images)}
    for name, array in (("normals", normals), ("mask", mask)):
        if array is not None:
            named[name] = array
            entries["geometry"][name] = name
    for kind, sets in (("flat", flats), ("dark", darks)):
        if len(sets):
            require_frames(f"{kind}s", sets)
        files = [[f"{kind}s[{i}][{j}]" for j in range(len(set_))] for i, set_ in enumerate(sets)]
        for of_level, frames in zip(files, sets, strict=True):
            named |= dict(zip(of_level, frames, strict=True))
        entries[kind] = [{"files": of_level, "exposure": 1.0} for of_level in files]
    rig, load = rig_in_memory(named, called=CALLED, camera=camera, **entries)
    found = read_joint_measurement(rig, load=load, channel=channel)
    if together is None:
        return found
    for i, sd in enumerate(sizes.get("intensity_sd", ())):
        together = set_intensity_sd(together, i, sd)
    return set_light_covariance(found, together, point_lights)


def _one_per_image(
    name: str, sd: ArrayLike, images: Sequence[ArrayLike]
) -> Float[np.ndarray, " lights"]:
    sizes = np.asarray(plain_array(name, sd))
    if sizes.dtype.kind not in "fiu" or sizes.ndim > 1:
        raise InputError(
            f"{name}: give one number for all images or a list of one for each, got {sd!r:.60}."
        )
    if sizes.ndim == 0:
        return np.full(len(images), float(sizes))
    require_as_many(f"values of {name}", sizes, "images", images)
    return sizes
