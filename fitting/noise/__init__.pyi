# What `fitting.noise` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .from_memory import from_frames as from_frames
from .read import read_photon_transfer as read_photon_transfer
