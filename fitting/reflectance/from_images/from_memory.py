"""Images of a known shape under known lights from memory: the observation that a rig of the same
images gives."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike

from ...observation import in_memory
from ...photographs import CALLED, rig_entries
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
    intensity_sd: ArrayLike | None = None,
    direction_sd: ArrayLike | None = None,
    exposure_sd: ArrayLike | None = None,
    stray_sd: ArrayLike | None = None,
    held_out: Sequence[int] = (),
    point_lights: bool = False,
) -> ReflectanceObservation:
    """Photographs in memory, for `reflectance.calibrate`.

    The view is orthographic along +z (x right, y up, z toward the camera). Each standard deviation
    is one number for all images or one for each; None for exact.

    Args:
        images: one a light, (h, w) or (h, w, 3) DN each.
        lights: (lights, 3) unit vectors from the object toward distant lights.
        camera: its bits, and what else is known of it.
        normals: (h, w, 3) unit, 0 beside the object; either these or a sphere.
        sphere: seen orthographically.
        mask: (h, w), true where the object is; None for wherever the shape is.
        intensities: (lights,) or (lights, channels) irradiance on a surface that faces the light,
            W m^-2 or relative, or radiant intensity of point lights; None for 1.
        intensity_sd: of the intensities, relative.
        direction_sd: of the directions, rad along each of two axes across them.
        exposure_sd: of the images' exposures, relative.
        stray_sd: rms of light that reaches all pixels by other ways, relative to the irradiance.
        held_out: indices of the lights kept for testing; none for every fourth.
        point_lights: take `lights` as positions from the centre of the sphere, m.

    Returns:
        The observation, checked as one of a folder is.

    Raises:
        InputError: for lists of unequal length, and for what cannot be used.

    Example:
        >>> from fitting.reflectance import Camera, SphereGeometry, from_photographs
        >>> lights = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, 0, 1.0]])
        >>> images = [np.full((20, 20), 100)] * 4  # DN
        >>> ball = SphereGeometry(centre=(9.5, 9.5), radius=8.0)  # pixels
        >>> seen = from_photographs(images, lights, camera=Camera(bits=8), sphere=ball)
        >>> print(seen.channels, seen.shape, seen.held_out)
        ('grey',) (20, 20) [False False False  True]
    """
    named, entries = rig_entries(
        images,
        lights,
        normals=normals,
        sphere=sphere,
        mask=mask,
        intensities=intensities,
        held_out=held_out,
        place="position" if point_lights else "direction",
        uncertain={
            "intensity_sd": intensity_sd,
            "direction_sd": direction_sd,
            "exposure_sd": exposure_sd,
            "stray_sd": stray_sd,
        },
    )
    rig, load = in_memory(named, called=CALLED, camera=camera, **entries)
    return read_reflectance_observation(rig, load=load)
