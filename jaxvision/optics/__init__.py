"""The optics of a camera, from the scene to the sensor's surface.

Projection, focus, apertures, diffraction, vignetting, distortion and chromatic aberrations.
"""

from .aperture import aperture_area, aperture_corners, aperture_kernel, aperture_point
from .defocus import (
    chromatic_defocus,
    defocus_radius,
    gather_defocus,
    layered_defocus,
    scatter_defocus,
)
from .diffraction import airy_kernel, airy_pattern, airy_radius, diffracted, diffraction_mtf
from .distortion import distort, distortion_area, undistort
from .irradiance import pixel_irradiance, sensor_irradiance
from .overlap import overlap_of_disc_and_polygon, overlap_of_discs
from .resampling import distort_image, lateral_aberration, sample_image, undistort_image
from .thin_lens import (
    circle_of_confusion,
    depth_of_field,
    hyperfocal_distance,
    image_distance,
    image_vergence,
    lens_focal_length,
    lens_power,
    magnification,
    vergence_difference,
    working_f_number,
)
from .views import (
    camera_ray,
    chief_slope,
    cos_to_axis,
    focus_vergence,
    lens_ray,
    look_at,
    pixel_grid,
    pixel_offset,
    sensor_vergence,
    view_ray,
)
from .vignetting import clear_fraction

__all__ = [
    "airy_kernel",
    "airy_pattern",
    "airy_radius",
    "aperture_area",
    "aperture_corners",
    "aperture_kernel",
    "aperture_point",
    "camera_ray",
    "chief_slope",
    "chromatic_defocus",
    "circle_of_confusion",
    "clear_fraction",
    "cos_to_axis",
    "defocus_radius",
    "depth_of_field",
    "diffracted",
    "diffraction_mtf",
    "distort",
    "distort_image",
    "distortion_area",
    "focus_vergence",
    "gather_defocus",
    "hyperfocal_distance",
    "image_distance",
    "image_vergence",
    "lateral_aberration",
    "layered_defocus",
    "lens_focal_length",
    "lens_power",
    "lens_ray",
    "look_at",
    "magnification",
    "overlap_of_disc_and_polygon",
    "overlap_of_discs",
    "pixel_grid",
    "pixel_irradiance",
    "pixel_offset",
    "sample_image",
    "scatter_defocus",
    "sensor_irradiance",
    "sensor_vergence",
    "undistort",
    "undistort_image",
    "vergence_difference",
    "view_ray",
    "working_f_number",
]
