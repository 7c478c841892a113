"""Implement `jaxvision render`, from a scene file to an image file.

cost         the standard error of a render and its time
job          tile by tile, in memory that does not grow with the picture, and resumable
integrators  the words of `[render] integrator` as functions from pixels to radiance
pruning      the scene without negligible effects
tiles        the unfinished picture on disk
"""

# ruff: noqa: F401

from .cost import cost_sentence
from .integrators import light_findings, seeded_passes_of, seeded_pixels_of
from .job import band_names, linear_srgb, render_to_file, with_resolution
from .pruning import inspect_scene, lossless_sentence, prune_losslessly, prune_scene, pruned_scene
