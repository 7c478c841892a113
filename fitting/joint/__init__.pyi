# What `fitting.joint` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .from_memory import Camera as Camera, from_photographs as from_photographs
from .read import read_joint_measurement as read_joint_measurement
