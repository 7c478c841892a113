"""The implementation of `jaxvision render`: from a scene file to an image file.

cost         the standard error of a render and its time
job          tile by tile, in memory that does not grow with the picture, and resumable
integrators  the words of `[render] integrator` as functions from pixels to radiance
pruning      the scene without negligible effects
tiles        the unfinished picture on disk
"""

from .cost import in_words
from .integrators import lacking, seeded_passes_of, seeded_pixels_of
from .job import band_names, linear_srgb, render_to_file, with_resolution
from .pruning import changing_nothing, inspected, left_of, nothing_lost, pruned_for

__all__ = [
    "band_names",
    "changing_nothing",
    "in_words",
    "inspected",
    "lacking",
    "left_of",
    "linear_srgb",
    "nothing_lost",
    "pruned_for",
    "render_to_file",
    "seeded_passes_of",
    "seeded_pixels_of",
    "with_resolution",
]
