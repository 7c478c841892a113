# What `fitting.reflectance.from_files` offers, each name where it is defined.

from .calibration import BRDFCalibration as BRDFCalibration, calibrate as calibrate
from .errors import best_about_axis as best_about_axis
from .figures import in_plane_angles as in_plane_angles, predicted as predicted
from .read import MeasuredBRDF as MeasuredBRDF, read_measured_brdf as read_measured_brdf
from .section import materials_section as materials_section
