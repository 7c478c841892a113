# What `fitting.lights` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .file import Lights as Lights, read_lights as read_lights, write_lights as write_lights
