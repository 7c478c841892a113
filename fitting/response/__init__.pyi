# What `fitting.response` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .clipping import clear_of_clipping as clear_of_clipping
from .curve import ResponseCurve as ResponseCurve, fit_response_curve as fit_response_curve
from .read import Camera as Camera, from_stack as from_stack
from .places import Layout as Layout, layout_of as layout_of
from .read import read_exposure_stack as read_exposure_stack
