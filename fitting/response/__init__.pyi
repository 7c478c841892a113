# What `fitting.response` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .from_memory import Camera as Camera, from_stack as from_stack
from .read import read_exposure_stack as read_exposure_stack
