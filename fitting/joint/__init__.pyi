# What `fitting.joint` offers, each name where it is defined.

from .calibration import calibrate as calibrate
from .fit import image_errors as image_errors
from .prediction import PixelPrediction as PixelPrediction, predict as predict
from .read import (
    Camera as Camera,
    SphereGeometry as SphereGeometry,
    from_photographs as from_photographs,
    read_joint_measurement as read_joint_measurement,
)
