"""Exposure stacks from images in memory, with the same result as from a rig with these images."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from jaxvision import ArrayLike

from ..observation import each, require_as_many, require_several_images, rig_in_memory
from ..rig import Camera
from .read import ExposureStack, read_exposure_stack


def from_stack(
    images: Sequence[ArrayLike],
    exposures: Sequence[float],
    *,
    camera: Camera,
    mask: Bool[np.ndarray, "h w"] | None = None,
    exposure_sd: float | None = None,
) -> ExposureStack:
    """Make an exposure stack from images of one still scene in memory, as the input of
    `response.calibrate`.

    Args:
        images: (h, w) or (h, w, 3) integer DN each, in any order.
        exposures: of the images, s.
        camera: the camera's bits, and other known properties.
        mask: (h, w), true where the scene may be used; None for all pixels.
        exposure_sd: relative standard deviation of each exposure's error; None where it is unknown
            and estimated from the images.

    Returns:
        The stack, after the same checks as one from a folder.

    Raises:
        InputError: for lists of unequal length, and for images that cannot be used.

    Example:
        >>> from fitting.response import Camera, from_stack
        >>> light = np.random.default_rng(0).uniform(100, 500, (20, 20))  # DN a second
        >>> times = [0.5, 1.0, 2.0]
        >>> images = [(t * light).astype(int) for t in times]
        >>> stack = from_stack(images, times, camera=Camera(bits=12))
        >>> print([(plane.channel, plane.codes.shape) for plane in stack.planes])
        [('grey', (3, 20, 20))]
    """
    require_several_images("images", images)
    exposures = each("exposures", exposures)
    require_as_many("exposures", exposures, "images", images)
    entries = [
        {"file": f"images[{i}]", "exposure": exposure, "exposure_sd": exposure_sd}
        for i, exposure in enumerate(exposures)
    ]
    named = {f"images[{i}]": image for i, image in enumerate(images)}
    called = {"exposure.exposure": "exposures"}
    rig, load = rig_in_memory(named, called=called, camera=camera, exposure=entries)
    return read_exposure_stack(rig, mask=mask, load=load)
