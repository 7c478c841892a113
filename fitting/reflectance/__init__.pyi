# What `fitting.reflectance` offers, each name where it is defined.

from .from_images.calibration import calibrate as calibrate
from .from_images.from_memory import (
    Camera as Camera,
    SphereGeometry as SphereGeometry,
    from_photographs as from_photographs,
)
from .stereo import (
    Stereo as Stereo,
    photometric_stereo as photometric_stereo,
)
