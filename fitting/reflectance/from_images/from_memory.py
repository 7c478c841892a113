"""Images of a known shape under known lights from memory: the same input as from a rig with these
images."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from ...observation import in_memory, require_as_many, require_frames, require_several_images
from ...rig import Camera, SphereGeometry
from .read import Photographs, with_covariance
from .uniform_frames import read_joint_measurement

# What a caller calls the keys of the entries.
CALLED = {
    "light.direction": "lights",
    "light.position": "lights",
    "light.intensity": "intensities",
    "light.intensity_sd": "intensity_sd",
    "light.direction_sd": "direction_sd",
    "light.exposure_sd": "exposure_sd",
    "light.stray_sd": "stray_sd",
}


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
) -> Photographs:
    """Photographs in memory, for `reflectance.calibrate` and `joint.calibrate`.

    The view is orthographic along +z (x right, y up, z toward the camera). Each standard deviation
    is one number for all images or one for each; None for exact.

    Args:
        images: one for each light, (h, w) or (h, w, 3) DN.
        lights: (lights, 3) unit vectors from the object toward distant lights.
        camera: its bits, other known properties, and their errors (`black_sd`, `gamma_sd`,
            `gain_sd`, `read_noise_sd`, `prnu_sd`).
        normals: (h, w, 3) unit, 0 beside the object. Pass either these or a sphere.
        sphere: in orthographic projection.
        mask: (h, w), true where the object is; None for all pixels of the shape.
        intensities: (lights,) or (lights, channels) irradiance on a surface that faces the light, W
            m^-2 or relative; for point lights, radiant intensity. None for 1.
        intensity_sd: relative standard deviation of the intensities.
        direction_sd: standard deviation of the directions, rad along each of two axes across them;
            or the covariance of all lights together, (lights, 4, lights, 4), as
            `fitting.lights.calibrate` finds it (of its intensities, `intensity_sd` counts).
        exposure_sd: relative standard deviation of the images' exposures.
        stray_sd: rms of stray light on all pixels, relative to the irradiance.
        held_out: indices of the lights that are kept for the test; none keeps every fourth.
        point_lights: whether `lights` are positions from the centre of the sphere, m.
        flats: for each level of light two or more frames, (h, w) or (h, w, 3) DN; a joint
            calibration estimates gain and read noise from them.
        darks: two or more frames each, without light.

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
    uncertain = {
        "intensity_sd": intensity_sd,
        "direction_sd": direction_sd,
        "exposure_sd": exposure_sd,
        "stray_sd": stray_sd,
    }
    sizes = {name: _each(name, sd, images) for name, sd in uncertain.items() if sd is not None}
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
    rig, load = in_memory(named, called=CALLED, camera=camera, **entries)
    found = read_joint_measurement(rig, load=load)
    if together is None:
        return found
    scale = np.linalg.norm(lights, axis=1)
    components = together[:, :3, :, :3] / scale[:, None, None, None] / scale[:, None]
    return with_covariance(found, components)


def _each(name: str, sd: ArrayLike, images: Sequence[ArrayLike]) -> Float[np.ndarray, " lights"]:
    sizes = np.asarray(plain_array(name, sd))
    if sizes.dtype.kind not in "fiu" or sizes.ndim > 1:
        raise InputError(
            f"{name}: give one number for all images or a list of one for each, got {sd!r:.60}."
        )
    if sizes.ndim == 0:
        return np.full(len(images), float(sizes))
    require_as_many(f"values of {name}", sizes, "images", images)
    return sizes
