# What `fitting.reflectance` offers, each name where it is defined.

from . import from_files as from_files
from .from_images.calibration import calibrate as calibrate
from .from_images.read import (
    Camera as Camera,
    SphereGeometry as SphereGeometry,
    from_photographs as from_photographs,
)
from .from_images.read import read_reflectance_observation as read_reflectance_observation
from .models import LABELS as LABELS, REFLECTANCES as REFLECTANCES
from .stereo.calibration import photometric_stereo as photometric_stereo
from .stereo.result import Stereo as Stereo
