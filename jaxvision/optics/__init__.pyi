# What `jaxvision.optics` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .aperture import (
    aperture_area as aperture_area,
    aperture_corners as aperture_corners,
    aperture_kernel as aperture_kernel,
    aperture_point as aperture_point,
)
from .defocus import (
    chromatic_defocus as chromatic_defocus,
    defocus_radius as defocus_radius,
    gather_defocus as gather_defocus,
    layered_defocus as layered_defocus,
    scatter_defocus as scatter_defocus,
)
from .diffraction import (
    airy_kernel as airy_kernel,
    airy_pattern as airy_pattern,
    airy_radius as airy_radius,
    diffracted as diffracted,
    diffraction_mtf as diffraction_mtf,
    lens_kernel as lens_kernel,
)
from .distortion import (
    distort as distort,
    distortion_area as distortion_area,
    undistort as undistort,
)
from .irradiance import pixel_irradiance as pixel_irradiance, sensor_irradiance as sensor_irradiance
from .overlap import (
    overlap_of_disc_and_polygon as overlap_of_disc_and_polygon,
    overlap_of_discs as overlap_of_discs,
)
from .resampling import (
    distort_image as distort_image,
    lateral_aberration as lateral_aberration,
    sample_image as sample_image,
    undistort_image as undistort_image,
)
from .thin_lens import (
    circle_of_confusion as circle_of_confusion,
    depth_of_field as depth_of_field,
    hyperfocal_distance as hyperfocal_distance,
    image_distance as image_distance,
    image_vergence as image_vergence,
    lens_focal_length as lens_focal_length,
    lens_power as lens_power,
    magnification as magnification,
    vergence_difference as vergence_difference,
    working_f_number as working_f_number,
)
from .views import (
    Projection as Projection,
    camera_ray as camera_ray,
    chip_size as chip_size,
    chief_slope as chief_slope,
    cos_to_axis as cos_to_axis,
    focus_vergence as focus_vergence,
    lens_ray as lens_ray,
    look_at as look_at,
    opencv_view as opencv_view,
    pixel_grid as pixel_grid,
    pixel_offset as pixel_offset,
    project as project,
    sensor_vergence as sensor_vergence,
    view_ray as view_ray,
)
from .vignetting import clear_fraction as clear_fraction
from .wavefront import (
    wavefront_kernel as wavefront_kernel,
    wavefront_otf as wavefront_otf,
    zernike as zernike,
)
