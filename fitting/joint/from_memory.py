"""Images of a known shape under known lights from memory, with flats and darks: the measurement
that a rig of the same images gives."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike

from ..observation import in_memory, require_frames
from ..photographs import CALLED, rig_entries
from ..rig import Camera, SphereGeometry
from .read import JointMeasurement, read_joint_measurement


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
    flats: Sequence[Sequence[ArrayLike]] = (),
    darks: Sequence[Sequence[ArrayLike]] = (),
) -> JointMeasurement:
    """Photographs in memory, for `joint.calibrate`.

    The view is orthographic along +z (x right, y up, z toward the camera). Each standard deviation
    is one number for all images or one for each; None for exact.

    Args:
        images: one a light, (h, w) or (h, w, 3) DN each.
        lights: (lights, 3) unit vectors from the object toward distant lights.
        camera: its bits, and what else is known of it and how well (`black_sd`, `gamma_sd`,
            `gain_sd`, `read_noise_sd`, `prnu_sd`).
        normals: (h, w, 3) unit, 0 beside the object; either these or a sphere.
        sphere: seen orthographically.
        mask: (h, w), true where the object is; None for wherever the shape is.
        intensities: (lights,) or (lights, channels) irradiance on a surface that faces the light,
            W m^-2 or relative; None for 1.
        intensity_sd: of the intensities, relative.
        direction_sd: of the directions, rad along each of two axes across them.
        exposure_sd: of the images' exposures, relative.
        stray_sd: rms of light that reaches all pixels by other ways, relative to the irradiance.
        held_out: indices of the lights kept for testing; none for every fourth.
        flats: of each level of light two or more frames, (h, w) or (h, w, 3) DN.
        darks: two or more frames each, the same without light.

    Returns:
        The measurement, checked as one of a folder is.

    Raises:
        InputError: for lists of unequal length, and for what cannot be used.
    """
    named, entries = rig_entries(
        images,
        lights,
        normals=normals,
        sphere=sphere,
        mask=mask,
        intensities=intensities,
        held_out=held_out,
        uncertain={
            "intensity_sd": intensity_sd,
            "direction_sd": direction_sd,
            "exposure_sd": exposure_sd,
            "stray_sd": stray_sd,
        },
    )
    for kind, sets in (("flat", flats), ("dark", darks)):
        if len(sets):
            require_frames(f"{kind}s", sets)
        files = [[f"{kind}s[{i}][{j}]" for j in range(len(set_))] for i, set_ in enumerate(sets)]
        for of_level, frames in zip(files, sets, strict=True):
            named |= dict(zip(of_level, frames, strict=True))
        entries[kind] = [{"files": of_level, "exposure": 1.0} for of_level in files]
    rig, load = in_memory(named, called=CALLED, camera=camera, **entries)
    return read_joint_measurement(rig, load=load)
