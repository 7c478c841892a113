"""Images of a known shape under known lights, as samples. Each light and pixel has the digital
number, the cosine of incidence, the angle to the mirror direction and the irradiance.

The view is orthographic along +z (x right, y up, z toward the camera), so that the viewer's
direction is the same everywhere. Angles are radians, digital numbers as stored.
"""

import os
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from jaxvision import as_array, as_vec
from jaxvision.errors import InputError
from jaxvision.files.images import read_image
from jaxvision.geometry import angle_between, mirror_direction
from jaxvision.geometry.hemisphere import local_frame

from ...frame_checks.frame import refuse_half
from ...frame_checks.heads import Stated, odd_heads
from ...inference.formatting import format_percent
from ...lights.file import read_lights
from ...observation import Load, in_region, one_site, read_mask, read_stack, to_one_site
from ...rig import (
    Camera,
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
PURPOSE: Purpose = "a reflectance calibration"
HOLD_OUT_EVERY = 4  # lights kept for testing where the rig names none: every fourth
FEWEST_LIGHTS_TO_SPLIT = 4
FEWEST_PIXELS = 50
DARK_ERRORS = 4.0  # of an image's median, up to which it lies at the black level
DARK_SHARE = 0.05  # of the signal that the other images let one expect, below which one is dark
OF_LIGHTS = ("intensity_sd", "direction_sd", "exposure_sd", "stray_sd")
SAME_LIGHT = 1e-3  # of a place: difference of one light in two files
NOT_UNIT = 1e-2  # deviation of a normal's length from 1 beyond rounding
FEWEST_AT_TOP = 20  # samples at the largest number that may be a pile of clipped ones
PILE, BELOW_TOP = 5, 8  # times as many as at any of so many of the next smaller numbers
BRIGHT = 0.9  # of the largest number, from which numbers are counted
ASSUMED_BLACK = "The rig gives no camera.black_level, so a black level of 0 DN was assumed."

PILED = (
    "{count} samples stand at {top:g} DN and none above, far more than at any number below: they "
    "count as clipped. Give the rig camera.saturation."
)


@dataclass(frozen=True)
class UniformLevels:
    """Flats and darks of one channel, one level for each entry of the rig."""

    mean: Float[np.ndarray, " levels"]  # over frames and pixels, DN
    variance: Float[np.ndarray, " levels"]  # temporal, of one pixel, DN^2
    freedom: Float[np.ndarray, " levels"]  # degrees of freedom of the variance
    mean_error: Float[np.ndarray, " levels"]  # standard error of the mean, DN
    dark: Bool[np.ndarray, " levels"]  # which are darks


@dataclass(frozen=True)
class Photographs:
    """The measurements at the pixels of the object, with the rig's values and their uncertainties.

    intensity x falloff is the irradiance on a surface that faces the light.

    Attributes:
        channels: names.
        files: names, one for each light.
        dn: (channels, lights, pixels) stored digital numbers.
        intensity: (channels, lights) as stated in the rig.
        falloff: (lights, pixels) factor on the intensity by distance: 1 for distant lights, m^-2
            for point lights.
        wi: (lights, pixels, 3) unit, toward the light.
        cosine: (lights, pixels) n.l, negative in attached shadows.
        mirror_angle: (lights, pixels) between view and mirror direction, rad.
        normals: (pixels, 3) unit.
        held_out: (lights,), true for those kept for the test.
        rows: (pixels,) row of each pixel in images of `shape`.
        columns: (pixels,) column of each pixel in images of `shape`.
        shape: (h, w).
        camera: of the rig, after its mosaic sites were shifted to one black level.
        black: DN without light.
        white: DN of full scale above black.
        clip: DN from which a pixel is saturated.
        gamma: encoding exponent; None where linear or unknown.
        gain: DN per electron; None where unknown.
        read_noise: e- rms; None where unknown.
        findings: sentences on assumptions.
        uncertain: (lights,) standard deviations by their key in the rig; 0 where exact.
        turn_prior: (turns, turns) covariance of the rotations of all lights, two a light, in units
            of `direction_sd`; None for independent lights.
        black_sd: DN, standard deviation of the black level; 0 where exact.
        gamma_sd: standard deviation of the encoding exponent; 0 where exact.
        levels: of the uniform frames of each channel; None without any, or where none are
            requested.
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

    @property
    def saturated(self) -> Bool[np.ndarray, "channels lights pixels"]:
        return self.dn >= self.clip


def read_reflectance_observation(
    rig: Rig | str | os.PathLike[str], *, load: Load = read_image
) -> Photographs:
    """Read and check all files that a rig's `[[light]]` and `[geometry]` entries name.

    Lights marked `held_out` are kept for testing. If none is marked and there are at least four,
    every fourth is kept. Normals are scaled to unit length.

    Args:
        rig: with `[[light]]` and `[geometry]`, or its folder or file.
        load: function that reads an image from its path.

    Returns:
        The observation.

    Raises:
        InputError: for images that are missing, of unequal size, dark or clipped throughout, for
            shapes that do not match and for too few pixels.
    """
    rig = as_rig(rig)
    require(rig, PURPOSE)
    if rig.camera.pattern is not None:
        raise InputError(
            f"{rig.folder}: camera.pattern says the images are a Bayer mosaic; {PURPOSE} needs "
            "demosaicked images (or one plane), so convert them and remove the pattern."
        )
    rig, told = _without_odd_heads(rig)
    assert rig.geometry is not None
    frames = _read_frames(rig, load)
    shape = (frames.shape[2], frames.shape[3])
    rows, columns, normals = _surface(rig, rig.geometry, shape, load)
    wi, falloff = _light_field(rig, normals)
    cosine, mirror_angle = angles(normals, wi)
    camera = one_site(rig.camera)
    black = camera.black_level or 0.0
    dn = frames[:, :, rows, columns]
    pile = _pile_at_top(dn) if camera.saturation is None else None
    if pile is not None and pile[0] < camera.clip_level:
        camera = camera.model_copy(update={"saturation": pile[0]})
        told = [*told, PILED.format(count=pile[1], top=pile[0])]
    held_out, how = _held_out(rig)
    observation = Photographs(
        channels=("grey",) if len(frames) == 1 else ("red", "green", "blue"),
        files=tuple(light.file for light in rig.light),
        dn=dn,
        intensity=_intensities(rig, len(frames)),
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
            *told,
            *how,
            *([ASSUMED_BLACK] * (rig.camera.black_level is None)),
            *_mask_without_effect(rig, shape, load),
        ),
        uncertain={
            name: np.array([getattr(light, name) or 0.0 for light in rig.light])
            for name in OF_LIGHTS
        },
        black_sd=camera.black_sd or 0.0,
        gamma_sd=camera.gamma_sd or 0.0,
    )
    _refuse_unusable(rig, observation)
    if rig.covariance is not None:
        return with_covariance(observation, _covariance_of(rig))
    return observation


def _covariance_of(rig: Rig) -> Float[np.ndarray, "lights 3 lights 3"]:
    """Of the directions of the rig's lights, from the file that it names."""
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
                f"{rig.folder}: light {light.file} is none of those of {rig.covariance}; give its "
                f"{'position' if known.near else 'direction'} as that file has it, or remove "
                "covariance."
            )
    across = known.covariance[:, :3, :, :3] / scale[:, None, None, None] / scale[:, None]
    return across[order][:, :, order]


def with_covariance(
    observation: Photographs, covariance: Float[np.ndarray, "lights 3 lights 3"]
) -> Photographs:
    """The observation with a covariance of the directions of all lights, of their components."""
    axes = across(observation.wi)
    both = np.einsum("lai,limj,mbj->lamb", axes, covariance, axes)
    sizes = np.sqrt(np.einsum("lala->l", both) / 2)
    lights = len(sizes)
    scale = np.repeat(np.maximum(sizes, 1e-12), 2)
    prior = both.reshape(2 * lights, 2 * lights) / np.outer(scale, scale)
    return replace(
        observation,
        uncertain=observation.uncertain | {"direction_sd": sizes},
        turn_prior=prior + 1e-9 * np.eye(2 * lights),
    )


def turn_prior_of(
    observation: Photographs, lights: Bool[np.ndarray, " lights"] | Int[np.ndarray, " some"]
) -> Float[np.ndarray, "turns turns"] | None:
    """The common covariance of the rotations of some lights; None where each errs alone."""
    if observation.turn_prior is None:
        return None
    count = len(observation.files)
    places = np.arange(2 * count).reshape(count, 2)[lights].ravel()
    return observation.turn_prior[np.ix_(places, places)]


def across(wi: Float[np.ndarray, "lights pixels 3"]) -> Float[np.ndarray, "lights 2 3"]:
    """Two unit axes across each light, about which it may be turned."""
    middle = wi.mean(axis=1)
    frame = local_frame(as_vec(middle / np.linalg.norm(middle, axis=1, keepdims=True)))
    return np.stack([np.asarray(as_array(v)) for v in (frame.tangent, frame.bitangent)], axis=1)


def _pile_at_top(dn: Float[np.ndarray, "channels lights pixels"]) -> tuple[float, int] | None:
    """The largest number, DN, and how many samples have it, if they far outnumber those of the next
    smaller numbers in several images: the camera clipped them."""
    top = dn.max()
    values, counts = np.unique(dn[dn >= BRIGHT * top], return_counts=True)
    several = np.count_nonzero((dn == top).any(axis=(0, 2))) > 1
    most = PILE * counts[-1 - BELOW_TOP : -1].max(initial=0)
    if len(values) > BELOW_TOP and several and counts[-1] > max(FEWEST_AT_TOP, most):
        return float(top), int(counts[-1])
    return None


def _without_odd_heads(rig: Rig) -> tuple[Rig, list[str]]:
    """A rig without the lights whose metadata contradict the majority, with the reason."""
    stated = [Stated(light.file, rig.path(light.file), 0.0) for light in rig.light]
    odd, _ = odd_heads(rig.folder, stated)
    refuse_half(rig.folder, odd, len(stated))
    gone = {name for one in odd for name in one.names}
    kept = tuple(light for light in rig.light if light.file not in gone)
    return rig.model_copy(update={"light": kept}), [one.sentence for one in odd]


def _read_frames(rig: Rig, load: Load) -> Float[np.ndarray, "channels lights h w"]:
    named = None if rig.geometry is None else rig.geometry.mask
    mask = None if named is None else read_mask(rig.path(named), rig.camera, load=load)
    stored = read_stack(rig, [light.file for light in rig.light], load=load, mask=mask)
    stack = np.stack([to_one_site(image, rig.camera) for image in stored])
    if stack.ndim == 3:
        return stack[None]
    return np.moveaxis(stack, 3, 0)


def _surface(
    rig: Rig, geometry: Geometry, shape: tuple[int, int], load: Load
) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"], Float[np.ndarray, "pixels 3"]]:
    """Rows, columns and unit normals of the pixels that show the object."""
    mask = None
    if geometry.mask is not None:
        mask = read_mask(rig.path(geometry.mask), rig.camera, shape=shape, load=load)
    if geometry.sphere is not None:
        normals, seen = _sphere_normals(geometry.sphere, shape, rig.camera)
    else:
        assert geometry.normals is not None
        normals, seen = _stored_normals(rig, geometry.normals, shape, mask, load)
    if mask is not None:
        seen = seen & mask
    rows, columns = np.nonzero(seen)
    if len(rows) < FEWEST_PIXELS:
        raise InputError(
            f"{rig.folder}: mask and geometry leave {len(rows)} pixels of the object; {PURPOSE} "
            f"needs at least {FEWEST_PIXELS}, so check the mask, the sphere and the image size."
        )
    return rows, columns, normals[rows, columns]


def _mask_without_effect(rig: Rig, shape: tuple[int, int], load: Load) -> tuple[str, ...]:
    named = None if rig.geometry is None else rig.geometry.mask
    if named is None or not read_mask(rig.path(named), rig.camera, shape=shape, load=load).all():
        return ()
    return (f"The mask {named} leaves out no pixel; it has no effect.",)


def _sphere_normals(
    sphere: SphereGeometry, shape: tuple[int, int], camera: Camera
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    """Normals of an orthographic sphere, without pixels that its outline may cross."""
    top, left = (camera.region or (0, 0))[:2]
    row, column = np.indices(shape, dtype=np.float64) + np.reshape((top, left), (2, 1, 1))
    x = (column - sphere.centre[0]) / sphere.radius
    y = (sphere.centre[1] - row) / sphere.radius
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    return np.stack([x, y, z], axis=-1), np.hypot(x, y) < 1 - 1 / sphere.radius


def _stored_normals(
    rig: Rig, name: str, shape: tuple[int, int], mask: np.ndarray | None, load: Load
) -> tuple[Float[np.ndarray, "h w 3"], Bool[np.ndarray, "h w"]]:
    path = rig.path(name)
    normals = in_region(np.asarray(load(path), np.float64), rig.camera, path)
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
) -> tuple[Float[np.ndarray, "lights pixels 3"], Float[np.ndarray, "lights pixels"]]:
    """Unit vectors toward each light and the falloff of its intensity, at every pixel."""
    directions, falloffs = [], []
    for light in rig.light:
        if light.direction is not None:
            unit = np.asarray(light.direction) / np.linalg.norm(light.direction)
            directions.append(np.broadcast_to(unit, normals.shape))
            falloffs.append(np.ones(len(normals)))
            continue
        toward = np.asarray(light.position) - _radius_in_metres(rig, light) * normals
        distance = np.linalg.norm(toward, axis=-1)
        directions.append(toward / distance[:, None])
        falloffs.append(distance**-2.0)
    return np.stack(directions), np.stack(falloffs)


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


def _intensities(rig: Rig, channels: int) -> Float[np.ndarray, "channels lights"]:
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
            f"Of {len(chosen)} light{'s' * (len(chosen) > 1)} none was kept back, so the fit's "
            "prediction of other lights is untested; add lights.",
        )
    chosen[HOLD_OUT_EVERY - 1 :: HOLD_OUT_EVERY] = True
    return chosen, (
        f"The rig holds no light out, so every fourth ({int(chosen.sum())} of {len(chosen)}) was "
        "kept from the fit to test its prediction.",
    )


def _refuse_unusable(rig: Rig, observation: Photographs) -> None:
    lit = observation.cosine > 0
    for name, of_light in zip(observation.files, lit, strict=True):
        if not of_light.any():
            raise InputError(
                f"{rig.folder}: light {name} reaches no visible pixel; its direction must point "
                "from the object toward the light (x right, y up, z toward the camera)."
            )
    for channel, dn in zip(observation.channels, observation.dn, strict=True):
        _refuse_clipped_or_dark(rig, observation, channel, dn[lit])
    lightless = lightless_images(observation)
    if 2 * len(lightless) > len(observation.files) or len(observation.files) - len(lightless) < 3:
        for i, state in lightless.items():
            raise InputError(
                f"{rig.folder}: every lit pixel of {observation.files[i]} is {state}; take that "
                "image again or remove its [[light]] entry."
            )


def lightless_images(observation: Photographs) -> dict[int, str]:
    """Return, by index, the images in which all lit pixels are dark or saturated, and which."""
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
    """Images at the black level within their noise, although the other images imply a much brighter
    one."""
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


def _refuse_clipped_or_dark(
    rig: Rig, observation: Photographs, channel: str, lit_dn: Float[np.ndarray, " lit"]
) -> None:
    clipped = float(np.mean(lit_dn >= observation.clip))
    if clipped > 0.9:
        raise InputError(
            f"{rig.folder}: {format_percent(clipped)} of the lit pixels of the {channel} channel "
            f"are saturated (at or above {observation.clip:g} DN); expose less, or correct "
            "camera.saturation."
        )
    if np.median(lit_dn) - observation.black < 1:
        raise InputError(
            f"{rig.folder}: the lit pixels of the {channel} channel are dark (median "
            f"{np.median(lit_dn):g} DN over a black level of {observation.black:g} DN); expose "
            "more, or correct camera.black_level or the directions of the lights."
        )
