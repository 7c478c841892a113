# What `jaxvision.matting` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .closed_form import Matte as Matte, closed_form_matte as closed_form_matte
from .foreground import estimate_foreground as estimate_foreground
from .keying import (
    blue_screen_matte as blue_screen_matte,
    difference_matte as difference_matte,
    least_squares_matte as least_squares_matte,
    lift as lift,
    projected_matte as projected_matte,
    triangulation_matte as triangulation_matte,
)
