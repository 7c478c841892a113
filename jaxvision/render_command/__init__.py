"""Implement `jaxvision render`, from a scene file to an image file.

- `job` renders tile by tile, in memory that does not grow with the picture, and can resume.
- `integrators` has, for each value of `[render] integrator`, a function from pixels to radiance.
- `pruning` drops the negligible effects of the scene.
- `tiles` stores the unfinished picture on disk.
- `cost` measures the standard error and the time of a render.
"""

# ruff: noqa: F401

from .cost import cost_sentence
from .integrators import light_findings, seeded_passes_of, seeded_pixels_of
from .job import band_names, change_resolution, linear_srgb, render_to_file
from .pruning import inspect_scene, lossless_sentence, prune_losslessly, prune_scene, pruned_scene
