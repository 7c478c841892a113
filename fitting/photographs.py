"""Photographs of a known shape under known lights, from memory, as the entries of a rig."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from jaxvision import ArrayLike
from jaxvision.errors import InputError
from jaxvision.plain_arrays import plain_array

from .observation import require_as_many, require_several_images
from .rig import SphereGeometry

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


def rig_entries(
    images: Sequence[ArrayLike],
    lights: Float[np.ndarray, "lights 3"],
    *,
    normals: Float[np.ndarray, "h w 3"] | None,
    sphere: SphereGeometry | None,
    mask: Bool[np.ndarray, "h w"] | None,
    intensities: ArrayLike | None,
    held_out: Sequence[int],
    place: Literal["direction", "position"] = "direction",
    uncertain: Mapping[str, ArrayLike | None],
) -> tuple[dict[str, ArrayLike], dict[str, Any]]:
    """What `observation.in_memory` takes.

    Args:
        images: one a light, (h, w) or (h, w, 3) DN each.
        lights: (lights, 3) directions or positions.
        normals: (h, w, 3) unit; None where the shape is a sphere.
        sphere: None where the shape is given by its normals.
        mask: (h, w), true where the object is; None for wherever the shape is.
        intensities: (lights,) or (lights, channels); None for 1.
        held_out: indices of the lights kept for testing.
        place: what `lights` holds.
        uncertain: by name of an entry of a light, its standard deviation: one for all lights or one
            for each; None for exact.

    Returns:
        The images by name, and the entries `light` and `geometry`.

    Raises:
        InputError: for lists of unequal length.
    """
    lights, intensities = plain_array("lights", lights), plain_array("intensities", intensities)
    require_several_images("images", images)
    require_as_many("lights", lights, "images", images)
    strengths = np.ones(len(lights)) if intensities is None else np.asarray(intensities)
    require_as_many("intensities", strengths, "images", images)
    sizes = {name: _each(name, sd, images) for name, sd in uncertain.items() if sd is not None}
    entries = [
        {
            "file": f"images[{i}]",
            place: np.asarray(light).tolist(),
            "intensity": np.atleast_1d(strength).tolist(),
            "held_out": i in held_out,
        }
        | {name: float(each[i]) for name, each in sizes.items() if each[i] != 0}
        for i, (light, strength) in enumerate(zip(lights, strengths, strict=True))
    ]
    named: dict[str, ArrayLike] = {f"images[{i}]": image for i, image in enumerate(images)}
    geometry: dict[str, Any] = {} if sphere is None else {"sphere": sphere}
    for name, array in (("normals", normals), ("mask", mask)):
        if array is not None:
            named[name] = array
            geometry[name] = name
    return named, {"light": entries, "geometry": geometry}


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
