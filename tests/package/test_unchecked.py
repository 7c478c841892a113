"""Tests, without the type checks of the other tests, that the library itself refuses bad input."""

import subprocess
import sys

import pytest

UNCHECKED = {
    "Sensor(shot_noise=3.0)": "Sensor.shot_noise must be a record, PoissonShotNoise or "
    "FastPoissonShotNoise or GaussianShotNoise, got 3.0.",
    "Sensor(shot_noise=PoissonShotNoise)": "got the class PoissonShotNoise.",
    "Sensor(pixel_aperture=0.5)": "Sensor.pixel_aperture must be a record, PixelAperture, got 0.5.",
    "ColourFilter([[1.0]] * 2, pattern=[[0, 1]])": "ColourFilter.pattern must be a tuple of rows, "
    "each a tuple of whole numbers, as in ((0, 1), (1, 2)), got [[0, 1]].",
    "Demosaicing(5)": "Demosaicing.pattern must be a tuple of rows",
    "ChargeTransfer(1e-5, trail=8.5)": "trail must be a whole number of at least 1, got 8.5.",
    "PixelAperture(0.5, oversampling='a')": "must be a whole number of at least 1, got 'a'.",
    "PolygonalAperture(5.5)": "blades must be a whole number of at least 3, got 5.5.",
    "Diffraction(5e-7, size=5.0)": "Diffraction.size must be an odd number of at least 1, got 5.0.",
    "Pinhole(*EYE, resolution=(4.5, 6))": "must be a whole number of at least 1, got 4.5.",
    "Pinhole(*EYE, resolution=4)": "Pinhole.resolution must be (rows, columns), got 4.",
    "Pinhole(*EYE, resolution=(4, 6), distortion=0.1)": "must be a record, Distortion, got 0.1.",
    "ThinLens(*EYE, resolution=(4, 6), f_number=2, aperture=3)": "ThinLens.aperture must be a "
    "record, CircularAperture or",
    "Development(tone=2.2)": "Development.tone must be a record, Gamma or SRGB, got 2.2.",
    "pixel_means(np.ones((4, 4)), PixelAperture(0.5))": "irradiance must be (..., h, w, bands), "
    "got shape (4, 4).",
    "Camera(None, None, development=3)": "Camera.development must be a record, Development, got 3.",
    "brdf.evaluate(GREY, MANY, UP)": "wi must have shape (3,), got (4, 3)",
    "brdf.shading(GREY, UP, UP[:2])": "wo must have shape (3,), got (2,).",
    "brdf.pdf(GREY, MANY, UP)": "wi must have shape (3,), got (4, 3)",
    "brdf.sample(GREY, MANY, UP)": "wo must have shape (3,), got (4, 3)",
    "brdf.albedo(GREY, UP[:2])": "wo must have shape (3,), got (2,).",
    "TorranceSparrow([0.2], [0.3], 0.3, interface=1.5)": "must be a record, Dielectric or "
    "Conductor or Schlick, got 1.5.",
    "Quadrature(2.5)": "Quadrature.order must be a whole number of at least 1, got 2.5.",
    "Surface(GREY, GREY)": "Surface.shape must be a record, Sphere or",
    "Surface(BALL, BALL)": "Surface.material must be a record, Material, got a Sphere.",
    "hemisphere_radiance(GREY, one, UP, UP, azimuths=2.5)": "azimuths must be a whole number of at "
    "least 2, got 2.5.",
    "Scene([Surface(BALL, Mirror([0.5, 0.5]))], [SUN])": "Scene.surfaces[0].material.reflectance "
    "must have 1 or 3 bands, got 2.",
    "Scene([BALL], [])": "Scene.surfaces[0] must be a record, Surface, got a Sphere.",
    "Scene(Surface(BALL, GREY), [3.0])": "Scene.lights[0] must be a record, Light, got 3.0.",
    "Scene(Surface(BALL, GREY), [], [1.0])": "Scene.ambient must be a record, AmbientLight, got a "
    "list.",
}
PROGRAM = """
import numpy as np
from jaxvision import DirectionalLight, Quadrature, brdf, hemisphere_radiance
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.scene import *
from jaxvision.sensor import pixel_means
EYE = np.zeros(3), np.eye(3), 0.01, 1e-5
UP, MANY, GREY, BALL = np.eye(3)[2], np.ones((4, 3)), Lambert([0.2]), Sphere([0, 0, 0], 1)
SUN = DirectionalLight([0, 0, 1], [1.0, 1.0, 1.0])


def one(wi):
    return np.ones(3)


for call in CALLS:
    try:
        eval(call)
        print("accepted")
    except ValueError as error:
        print(error)
"""


@pytest.mark.slow
def test_without_type_checks_the_library_says_what_is_wrong():
    program = PROGRAM.replace("CALLS", repr(list(UNCHECKED)))
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for said, (call, wanted) in zip(run.stdout.splitlines(), UNCHECKED.items(), strict=True):
        assert wanted in said, call
