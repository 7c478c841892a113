# What `jaxvision.matting` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import compositing as compositing
from .compositing import (
    checked_alpha as checked_alpha,
    composite as composite,
    darken as darken,
    dissolve as dissolve,
    flatten as flatten,
    layer_from_srgb as layer_from_srgb,
    layer_to_srgb as layer_to_srgb,
    over as over,
    premultiply as premultiply,
    unpremultiply as unpremultiply,
)
from .closed_form import Matte as Matte, closed_form_matte as closed_form_matte
from .errors import MatteErrors as MatteErrors, matte_errors as matte_errors
from .foreground import estimate_foreground as estimate_foreground
from .keying import (
    blue_screen_matte as blue_screen_matte,
    difference_matte as difference_matte,
    least_squares_matte as least_squares_matte,
    lift as lift,
    projected_matte as projected_matte,
    triangulation_matte as triangulation_matte,
)
