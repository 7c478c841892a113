"""Tests the conversion of RGB to spectra against colour-science, and back to RGB."""

import colour
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import InputError, spectra
from jaxvision.colour_spaces import colour_data

GRID = colour_data.nanometres(np.arange(380, 785, 5.0))
CAMERA = colour_data.nanometres(np.arange(400, 705, 10.0))
COLOURS = np.concatenate(
    [np.indices((2, 2, 2)).reshape(3, -1).T, np.random.default_rng(2).uniform(size=(200, 3))]
).astype(float)


def linear_srgb(reflectance, grid):
    """Return linear sRGB under D65 by the CIE's sums, with colour-science's matrix from XYZ to
    RGB."""
    observer, lamp = colour_data.observer(grid), colour_data.illuminant("D65", grid)
    xyz = np.asarray(spectra.reflectance_to_xyz(reflectance, grid, observer, lamp))
    return xyz @ np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ).T


def test_reflectances_are_those_of_colour_science():
    lifted = spectra.rgb_to_reflectance(COLOURS, colour_data.rgb_basis(GRID))
    for rgb, ours in zip(COLOURS[:20], np.asarray(lifted), strict=False):
        theirs = colour.recovery.RGB_to_sd_Mallett2019(rgb)
        np.testing.assert_allclose(ours, theirs.values, atol=1e-8)


@pytest.mark.parametrize("grid", [GRID, CAMERA, colour_data.nanometres([300, 402.3, 555.5, 900])])
def test_reflectances_stay_between_black_and_white(grid):
    lifted = np.asarray(spectra.rgb_to_reflectance(COLOURS, colour_data.rgb_basis(grid)))
    assert lifted.min() >= 0
    assert lifted.max() <= 1 + 4 * np.finfo(lifted.dtype).eps
    white = spectra.rgb_to_reflectance(jnp.ones(3), colour_data.rgb_basis(grid))
    np.testing.assert_allclose(white, 1, atol=1.1e-5)


@pytest.mark.parametrize(("grid", "most"), [(GRID, 3e-4), (CAMERA, 1.2e-2)])
def test_rgb_is_recovered(grid, most):
    """RGB is recovered on the table's own grid, and at steps of 10 nm, which resolve its steep
    flanks half as well."""
    lifted = spectra.rgb_to_reflectance(COLOURS, colour_data.rgb_basis(grid))
    assert np.abs(linear_srgb(lifted, grid) - COLOURS).max() < most


def ball(colour_of, light):
    surface = jv.Surface(jv.Sphere([0, 0, 3], 1.0), jv.Lambert(colour_of))
    return jv.Scene(surface, jv.PointLight([1, -1, 0], light))


@pytest.mark.slow
def test_a_lifted_scene_looks_as_in_rgb():
    """A ball in white light, rendered with spectra and integrated with the observer, equals its
    picture in RGB."""
    view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.1, resolution=(8, 8))
    rgb = ball([0.2, 0.05, 0.1], [6.0, 6.0, 6.0])
    lifted = jv.lift_scene(rgb, GRID)
    np.testing.assert_allclose(lifted.lights[0].intensity.sum(), 18, rtol=1e-6)
    seen, expected = jv.render(lifted, view), jv.render(rgb, view)
    observer, white = colour_data.observer(GRID), colour_data.illuminant("D65", GRID)
    xyz = np.asarray(seen) @ np.asarray(observer)
    xyz *= white.sum() / (white @ observer[:, 1]) / 3  # RGB's white light has 1 W in each band
    back = xyz @ np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ).T
    np.testing.assert_allclose(back, expected, atol=5e-4 * float(expected.max()))
    assert expected.max() > 0.05


def test_every_part_is_lifted_and_neutral_parts_stay():
    glossy = jv.TorranceSparrow(
        [0.1, 0.2, 0.1], [0.5], 0.3, interface=jv.Dielectric([1.5, 1.5, 1.5])
    )
    two = jv.Dichromatic(jv.Lambert([0.3]), jv.Lambert([0.3]), [0.1, 0.2, 0.3], [1.0])
    surfaces = [
        jv.Surface(jv.Sphere([0, 0, 3], 1.0), glossy),
        jv.Surface(jv.Sphere([0, 3, 3], 1.0), two, [1.0, 2.0, 3.0]),
        jv.Surface(jv.Sphere([0, 6, 3], 1.0), jv.Mirror([0.9])),
    ]
    scene = jv.Scene(surfaces, [], jv.AmbientLight([0.1, 0.2, 0.3]))
    lifted = jv.lift_scene(scene, CAMERA)
    first, second, third = (surface.material for surface in lifted.surfaces)
    assert first.diffuse.shape == lifted.ambient.radiance.shape == (31,)
    assert first.specular.shape == first.interface.eta.shape == third.reflectance.shape == (1,)
    assert second.body_spectrum.shape == lifted.surfaces[1].emission.shape == (31,)
    basis = np.asarray(colour_data.rgb_basis(CAMERA))
    np.testing.assert_allclose(second.body_spectrum, basis @ [0.1, 0.2, 0.3], rtol=1e-5)


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (ball([0.1], [1.0]), "only RGB"),
        (ball([0.1] * 4, [1.0] * 4), "only RGB"),
        (
            jv.Scene(
                jv.Surface(
                    jv.Sphere([0, 0, 3], 1.0),
                    jv.TorranceSparrow(
                        [0.0] * 3, [1.0], 0.3, interface=jv.Conductor([0.2, 0.9, 1.1], [3.9] * 3)
                    ),
                ),
                [],
            ),
            "interface.eta differs from band to band",
        ),
    ],
)
def test_unknown_parts_of_rgb_scenes_are_refused(scene, words):
    with pytest.raises(InputError, match=words):
        jv.lift_scene(scene, CAMERA)


def test_a_spectral_camera_names_the_lift():
    camera = jv.read_camera("consumer_bayer")
    rgb = ball([0.2, 0.05, 0.1], [6.0, 6.0, 6.0])
    with pytest.raises(ValueError, match="as lift_scene"):
        jv.capture(None, rgb, camera)
