"""The names of the models and parameters that can be fitted, and of supported files, without
importing numerical libraries.
"""

from pathlib import Path
from typing import Literal, get_args

Model = Literal[
    "lambert",
    "oren-nayar",
    "eon",
    "phong",
    "normalised-phong",
    "gaussian-lobe",
    "blinn",
    "normalised-blinn",
    "torrance-sparrow-beckmann",
    "torrance-sparrow",
    "torrance-sparrow-metal",
]
# torrance-sparrow has GGX facets, the default of `jaxvision.TorranceSparrow`.
MODELS: tuple[Model, ...] = get_args(Model)
Axis = Literal["mirror", "half", "none"]  # direction about which a lobe is centred
AXIS_NAMES: dict[Axis, str | None] = {
    "mirror": "mirror direction",
    "half": "half vector",
    "none": None,
}
Objective = Literal["cosine", "cube-root"]  # what a fit of measured reflectance minimises
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)

# Models with facets of a clear dielectric, which has an index of refraction.
CLEAR: tuple[Model, ...] = ("torrance-sparrow-beckmann", "torrance-sparrow")
INDEX = 1.5  # of refraction: glass, varnish, most plastics
DESCRIBES = 0.5  # relative error of a prediction up to which a model describes a surface
SHOWS = 0.2  # the same limit for images
SUFFIXES = (".brdf", ".bsdf", ".binary")


def is_measured_brdf(path: Path) -> bool:
    """Return whether a path is a file of measured reflectance, by its suffix."""
    return path.suffix.lower() in SUFFIXES
