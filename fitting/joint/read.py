"""The input of a joint calibration: photographs, read as for a reflectance calibration, with flats
and darks.
"""

from ..reflectance.from_images.read import Camera as Camera
from ..reflectance.from_images.read import SphereGeometry as SphereGeometry
from ..reflectance.from_images.read import from_photographs as from_photographs
from ..reflectance.from_images.read import (
    read_joint_measurement as read_joint_measurement,
)
