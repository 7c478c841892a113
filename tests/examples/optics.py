"""Calls for projection, focus, apertures, diffraction, distortion and defocus."""

import jax.numpy as jnp
import numpy as np

from jaxvision import scene as s

RNG = np.random.default_rng(23)
ONE, TWO, U = jnp.asarray(0.7), jnp.asarray(2.3), jnp.asarray([0.31, 0.83])
POINT, AHEAD, UP = (jnp.asarray(v) for v in ([0.2, 0.1, -0.3], [0.5, 0.3, 0.9], [-0.4, -0.5, 0.8]))
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(4, 5, 2)))
DEPTH = jnp.asarray(RNG.uniform(1.2, 3.0, size=(4, 5)))
BAND = jnp.asarray([0.2, 0.1])
BENT = s.Distortion([-0.2, 0.1], [0.01, -0.02])
PINHOLE = s.Pinhole(POINT, np.eye(3), 1.0, 0.05, resolution=(4, 5), f_number=4.0, distortion=BENT)
LENS = s.ThinLens(
    POINT,
    np.eye(3),
    0.05,
    0.002,
    resolution=(4, 5),
    f_number=2.0,
    focus_distance=2.0,
    aperture=s.PolygonalAperture(5, angle=0.3),
    rim=s.Rim(0.06, 0.03),
    distortion=BENT,
)
ROUND = s.ThinLens(
    POINT, np.eye(3), 0.05, 0.0002, resolution=(4, 5), f_number=2.0, focus_distance=2.0
)
F, F_NUMBER, Z = jnp.asarray(0.05), jnp.asarray(2.8), jnp.asarray(1.7)
PITCH, WAVELENGTHS = jnp.asarray(3e-6), jnp.asarray([4.7e-7, 6.1e-7])
CORNERS = jnp.asarray([0.9, 0.3, -0.7, 0.1]), jnp.asarray([0.1, 0.8, 0.2, -0.9])
ROWS, COLUMNS = (jnp.asarray(RNG.uniform(0.2, 2.8, size=(2, 3))) for _ in range(2))

EXAMPLES = {
    "optics.aperture.aperture_area": ((LENS.aperture, ONE), {}),
    "optics.aperture.aperture_corners": ((s.RectangularAperture(0.4, 0.7),), {"dtype": F.dtype}),
    "optics.aperture.aperture_kernel": ((LENS.aperture, TWO), {"size": 7}),
    "optics.aperture.aperture_point": ((LENS.aperture, U), {}),
    "optics.defocus.chromatic_defocus": ((ROUND, X, DEPTH, F * (1 + 0.01 * BAND)), {"radius": 2}),
    "optics.defocus.defocus_radius": ((ROUND, DEPTH), {}),
    "optics.defocus.gather_defocus": ((ROUND, X, DEPTH), {"radius": 2}),
    "optics.defocus.layered_defocus": ((LENS, X, DEPTH), {"radius": 1, "layers": 2}),
    "optics.defocus.scatter_defocus": ((ROUND, X, DEPTH), {"radius": 2}),
    "optics.diffraction.airy_kernel": ((WAVELENGTHS, F_NUMBER, PITCH), {"size": 3, "order": 4}),
    "optics.diffraction.airy_pattern": ((PITCH, WAVELENGTHS[0], F_NUMBER), {}),
    "optics.diffraction.airy_radius": ((WAVELENGTHS, F_NUMBER), {}),
    "optics.diffraction.diffracted": ((ROUND, s.Diffraction(WAVELENGTHS, size=3), X), {}),
    "optics.diffraction.lens_kernel": ((ROUND, s.Diffraction(WAVELENGTHS, size=3), PITCH), {}),
    "optics.diffraction.diffraction_mtf": ((0.2 / PITCH, WAVELENGTHS[0], F_NUMBER), {}),
    "optics.wavefront.wavefront_kernel": (
        (1e-7 * BAND, WAVELENGTHS, 8 * ONE, PITCH),
        {"size": 3, "order": 4, "samples": 32},
    ),
    "optics.wavefront.wavefront_otf": (
        (BAND / PITCH, 1e-7 * BAND, WAVELENGTHS[0], 8 * ONE),
        {"samples": 8},
    ),
    "optics.wavefront.zernike": ((TWO / 10, TWO / 9), {"count": 11}),
    "optics.distortion.distort": ((BENT, ONE, TWO / 10), {}),
    "optics.distortion.distortion_area": ((BENT, ONE, TWO / 10), {}),
    "optics.distortion.undistort": ((BENT, ONE, TWO / 10), {}),
    "optics.irradiance.pixel_irradiance": ((LENS, BAND, ONE, TWO), {}),
    "optics.irradiance.sensor_irradiance": ((PINHOLE, X), {}),
    "optics.overlap.overlap_of_disc_and_polygon": ((ONE / 9, ONE / 8, ONE, *CORNERS), {}),
    "optics.overlap.overlap_of_discs": ((ONE, ONE, TWO / 3), {}),
    "optics.resampling.distort_image": ((PINHOLE, X), {}),
    "optics.resampling.lateral_aberration": ((X, 1 + 0.1 * BAND), {}),
    "optics.resampling.sample_image": ((X, ROWS, COLUMNS), {"interpolation": "linear"}),
    "optics.resampling.undistort_image": ((PINHOLE, X), {}),
    "optics.thin_lens.circle_of_confusion": ((Z, 2 * Z, F, F_NUMBER), {}),
    "optics.thin_lens.depth_of_field": ((Z, F, F_NUMBER, PITCH), {}),
    "optics.thin_lens.hyperfocal_distance": ((F, F_NUMBER, PITCH), {}),
    "optics.thin_lens.image_distance": ((Z, F), {}),
    "optics.thin_lens.image_vergence": ((Z, F), {}),
    "optics.thin_lens.lens_focal_length": ((TWO, -ONE, 2 * ONE), {}),
    "optics.thin_lens.lens_power": ((TWO, -ONE, 2 * ONE), {"thickness": ONE / 10}),
    "optics.thin_lens.magnification": ((Z, F), {}),
    "optics.thin_lens.vergence_difference": ((ONE, TWO), {}),
    "optics.thin_lens.working_f_number": ((F_NUMBER, Z, F), {}),
    "optics.vignetting.clear_fraction": ((LENS, ONE, TWO), {}),
    "optics.views.camera_ray": ((PINHOLE, ONE, TWO), {}),
    "optics.views.chip_size": ((PINHOLE,), {}),
    "optics.views.chief_slope": ((LENS, ONE, TWO), {}),
    "optics.views.cos_to_axis": ((PINHOLE, ONE, TWO), {}),
    "optics.views.focus_vergence": ((LENS,), {}),
    "optics.views.lens_ray": ((LENS, ONE, TWO, U), {}),
    "optics.views.look_at": ((POINT, AHEAD, UP), {}),
    "optics.views.pixel_grid": ((PINHOLE,), {}),
    "optics.views.pixel_offset": ((PINHOLE, ONE, TWO), {}),
    "optics.views.project": ((PINHOLE, AHEAD), {}),
    "optics.views.sensor_vergence": ((LENS,), {}),
    "optics.views.view_ray": ((LENS, ONE, TWO), {"u": U}),
}
