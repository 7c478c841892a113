# What `fitting.resolution` offers, each name where it is defined.

from .aberrations import wavefront_from_edges as wavefront_from_edges
from .edge import Resolution as Resolution, from_edge as from_edge
from .model import Blur as Blur
