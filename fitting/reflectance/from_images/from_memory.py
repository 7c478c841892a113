"""Images of a known shape under known lights from memory: the observation that a rig of the same
images gives."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from ...observation import in_memory, require_as_many
from ...rig import Camera, SphereGeometry
from .read import ReflectanceObservation, read_reflectance_observation


def from_photographs(
    images: Sequence[ArrayLike],
    lights: Float[np.ndarray, "lights 3"],
    *,
    camera: Camera,
    normals: Float[np.ndarray, "h w 3"] | None = None,
    sphere: SphereGeometry | None = None,
    mask: Bool[np.ndarray, "h w"] | None = None,
    intensities: ArrayLike | None = None,
    held_out: Sequence[int] = (),
    point_lights: bool = False,
) -> ReflectanceObservation:
    """Photographs in memory, for `reflectance.from_images.calibration.calibrate`.

    The view is orthographic along +z (x right, y up, z toward the camera).

    Args:
        images: one a light, (h, w) or (h, w, 3) DN each.
        lights: (lights, 3) unit vectors from the object toward distant lights.
        camera: its bits, and what else is known of it.
        normals: (h, w, 3) unit, 0 beside the object; either these or a sphere.
        sphere: seen orthographically.
        mask: (h, w), true where the object is; None for wherever the shape is.
        intensities: (lights,) or (lights, channels) irradiance on a surface that faces the light,
            W m^-2 or relative, or radiant intensity of point lights; None for 1.
        held_out: indices of the lights kept for testing; none for every fourth.
        point_lights: take `lights` as positions from the centre of the sphere, m.

    Returns:
        The observation, checked as one of a folder is.

    Raises:
        InputError: for lists of unequal length, and for what cannot be used.
    """
    require_as_many("lights", lights, "images", images)
    strengths = np.ones(len(lights)) if intensities is None else np.asarray(intensities)
    require_as_many("intensities", strengths, "images", images)
    entries = [
        {
            "file": f"images[{i}]",
            "position" if point_lights else "direction": np.asarray(light).tolist(),
            "intensity": np.atleast_1d(strength).tolist(),
            "held_out": i in held_out,
        }
        for i, (light, strength) in enumerate(zip(lights, strengths, strict=True))
    ]
    named: dict[str, ArrayLike] = {f"images[{i}]": image for i, image in enumerate(images)}
    geometry: dict[str, Any] = {} if sphere is None else {"sphere": sphere}
    for name, array in (("normals", normals), ("mask", mask)):
        if array is not None:
            named[name] = array
            geometry[name] = name
    rig, load = in_memory(named, camera=camera, light=entries, geometry=geometry)
    return read_reflectance_observation(rig, load=load)
