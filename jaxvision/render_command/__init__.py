"""The inside of `jaxvision render`: a scene file to an image file.

job          tile by tile, in memory that does not grow with the picture, and resumable
integrators  the words of `[render] integrator` as functions from pixels to radiance
tiles        the unfinished picture on disk
"""

from .job import band_names, render_to_file, with_resolution

__all__ = ["band_names", "render_to_file", "with_resolution"]
