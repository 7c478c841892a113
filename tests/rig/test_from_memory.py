"""Tests that arrays in memory give the measurement and the estimates of the same images in
files."""

from dataclasses import fields

import jax
import numpy as np
import pytest

import jaxvision as jv
from fitting.joint import calibrate as calibrate_joint
from fitting.noise import calibrate as calibrate_noise
from fitting.noise import darks_from_frames, from_frames, read_photon_transfer
from fitting.reflectance import from_photographs
from fitting.reflectance.from_images.calibration import calibrate as calibrate_reflectance
from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.response import calibrate as calibrate_response
from fitting.response import from_stack, read_exposure_stack
from fitting.rig import Camera, SphereGeometry, load_rig
from jaxvision.errors import InputError
from jaxvision.files.images import read_image, write_image

CAMERA = Camera(bits=12, black_level=64.0)
HEAD = "[camera]\nbits = 12\nblack_level = 64\n"
PHOTONS = [0.0, 500.0, 1000.0, 2000.0, 4000.0, 6000.0]


def assert_equal(one, other):
    """Check that two records are equal bit by bit, except for the names of images."""
    for field in fields(one):
        if field.name != "files":
            ours, theirs = (jax.tree.leaves(getattr(x, field.name)) for x in (one, other))
            for a, b in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(a, b, err_msg=field.name)


def written(folder, images, text):
    for name, image in images.items():
        write_image(folder / f"{name}.tif", image)
    (folder / "rig.toml").write_text(text)
    return folder


def levels(light, seed, frames=3):
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(light, (frames, 20, 30)) + 3 * rng.standard_normal((frames, 20, 30))
    return np.clip(np.round(64 + 0.4 * electrons), 0, 4095).astype(np.uint16)


def test_frames_of_photon_transfer(tmp_path):
    flats = [levels(0.5 * p, i) for i, p in enumerate(PHOTONS)]
    darks = [levels(0, 20)]
    text, images = HEAD, {}
    for kind, sets in (("flat", flats), ("dark", darks)):
        for i, frames in enumerate(sets):
            images |= {f"{kind}{i}_{j}": frame for j, frame in enumerate(frames)}
            names = [f"{kind}{i}_{j}.tif" for j in range(len(frames))]
            text += f"[[{kind}]]\nfiles = {names}\nexposure = 0.01\n"
            text += f"photons = {PHOTONS[i]}\n" if kind == "flat" else ""
    exposures = np.full(len(flats), 0.01)
    ours = from_frames(flats, darks, exposures, PHOTONS, camera=CAMERA, dark_exposures=[0.01])
    theirs = read_photon_transfer(written(tmp_path, images, text))
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    assert_equal(ours.bright, theirs.bright)
    assert_equal(ours.dark, theirs.dark)
    assert_equal(ours, theirs)


def test_mismatched_arrays_are_refused_in_one_sentence():
    flats = [levels(0.5 * p, i) for i, p in enumerate(PHOTONS)]
    times = [0.01] * len(flats)
    with pytest.raises(InputError, match=r"5 exposures for 6 levels of flats; give one for each\."):
        from_frames(flats, flats, times[1:], None, camera=CAMERA)
    with pytest.raises(InputError, match=r"len\(darks\) is 1 and len\(flats\) 6.*; give dark_exp"):
        from_frames(flats, flats[:1], times, None, camera=CAMERA)
    with pytest.raises(InputError, match="vary the exposure"):
        from_frames(flats, flats, times, None, camera=CAMERA)
    small = Camera(bits=8)
    with pytest.raises(InputError, match=r"arrays/darks\[2\]\[0\]: values .* do not fit 8 bits"):
        from_frames([f + 300 for f in flats], flats, times, PHOTONS, camera=small)
    with pytest.raises(InputError, match=r"arrays/images\[1\]: holds fractions"):
        from_stack([np.ones((9, 9)), np.full((9, 9), 1.5)], [1, 2], camera=CAMERA)
    with pytest.raises(InputError, match=r"exposures\[0\] = -1.0: must be greater than or eq"):
        from_frames(flats, flats, [-1.0] * 6, PHOTONS, camera=CAMERA)
    with pytest.raises(InputError, match=r"exposures, but 1 different photons; .* rate per second"):
        from_frames(flats, flats, [0.01 * p for p in range(1, 7)], [1e5] * 6, camera=CAMERA)
    with pytest.raises(InputError, match="give either sphere or normals"):
        from_photographs([np.ones((9, 9))], np.array([[0.0, 0.0, 1.0]]), camera=CAMERA)


def test_one_image_instead_of_a_list_is_named():
    flats = [levels(0.5 * p, i) for i, p in enumerate(PHOTONS)]
    times, singles = [0.01] * len(flats), [frames[0] for frames in flats]
    one = r"flats\[0\] is one frame, \(20, 30\), .* give of each level a list of two or more"
    with pytest.raises(InputError, match=one):
        from_frames(singles, flats, times, PHOTONS, camera=CAMERA)
    with pytest.raises(InputError, match=r"darks\[0\] is one frame, \(20, 30, 1\)"):
        from_frames(flats, [f[..., None] for f in singles], times, PHOTONS, camera=CAMERA)
    with pytest.raises(InputError, match=r"darks\[0\] has 1 frame, .* two or more"):
        darks_from_frames([[f] for f in singles], times, camera=CAMERA)
    with pytest.raises(InputError, match="flats is empty; give a list of levels"):
        from_frames([], [], [], [], camera=CAMERA)
    with pytest.raises(InputError, match=r"images is one image, \(20, 30\); give a list"):
        from_stack(singles[0], [1.0], camera=CAMERA)
    with pytest.raises(InputError, match=r"images is one image, \(20, 30\); give a list"):
        from_photographs(singles[0], LIGHTS, camera=CAMERA, sphere=SPHERE)


def test_other_objects_are_refused_as_measurements():
    for calibrate, named in (
        (calibrate_noise, "noise.calibrate: measurement must be a PhotonTransfer, got dict; from_"),
        (calibrate_response, "response.calibrate: stack must be an ExposureStack, got dict"),
        (calibrate_joint, "joint.calibrate: measurement must be a Photographs, got dict"),
    ):
        with pytest.raises(InputError, match=named):
            calibrate({"a": 1})
    with pytest.raises(InputError, match="observation must be a Photographs, got dict"):
        calibrate_reflectance({"a": 1}, model="phong")


@pytest.mark.parametrize("colours", [(), (3,)])
def test_images_of_an_exposure_stack(tmp_path, colours):
    rng = np.random.default_rng(0)
    scene = rng.uniform(50, 3000, (12, 16, *colours))
    times = [0.1, 0.4, 1.0]
    images = [np.round(64 + t * scene).astype(np.uint16) for t in times]
    text = HEAD + "".join(
        f'[[exposure]]\nfile = "e{i}.tif"\nexposure = {t}\n' for i, t in enumerate(times)
    )
    folder = written(tmp_path, {f"e{i}": image for i, image in enumerate(images)}, text)
    mask = scene.reshape(12, 16, -1)[..., 0] > 200
    theirs = read_exposure_stack(load_rig(folder), mask=mask)
    ours = from_stack(images[::-1], times[::-1], camera=CAMERA, mask=mask)
    assert len(ours.planes) == len(theirs.planes) == (colours or (1,))[0]
    for a, b in zip(ours.planes, theirs.planes, strict=True):
        assert_equal(a, b)
    if not colours:
        banded = from_stack([image[..., None] for image in images], times, camera=CAMERA, mask=mask)
        assert_equal(banded.planes[0], theirs.planes[0])
    told = from_stack(images, times, camera=CAMERA, mask=mask, exposure_sd=0.01)
    assert told.planes[0].exposure_sd == pytest.approx(0.01)


LIGHTS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [-0.6, 0.0, 0.8]])
SPHERE = SphereGeometry(centre=(15.0, 15.0), radius=14.0, radius_m=0.1)


def normals_of_the_sphere():
    row, column = np.indices((31, 31))
    x, y = (column - 15) / 14, (15 - row) / 14
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    return np.where((np.hypot(x, y) < 0.9)[..., None], np.stack([x, y, z], -1), 0.0)


@pytest.mark.parametrize("shape", ["sphere", "normals", "point lights"])
def test_photographs_of_a_known_shape(tmp_path, shape):
    normals = normals_of_the_sphere()
    images = [np.round(64 + 2000 * np.maximum(normals @ v, 0)).astype(np.uint16) for v in LIGHTS]
    text, kind, scale = HEAD, "direction", 1.0
    if shape == "point lights":
        kind, scale = "position", 2.0
    for i, light in enumerate(LIGHTS):
        text += f'[[light]]\nfile = "l{i}.tif"\n{kind} = {(scale * light).tolist()}\n'
        text += f"intensity = [{1 + i / 10}]\nheld_out = {str(i == 2).lower()}\n"
        if i != 1:  # its exposure is exact
            text += "exposure_sd = 0.005\n"
        text += "intensity_sd = 0.01\ndirection_sd = 0.02\nstray_sd = 0.001\n"
    files = {f"l{i}": image for i, image in enumerate(images)}
    if shape == "normals":
        np.save(tmp_path / "n.npy", normals)
        files["m"] = (normals[..., 2] > 0.5).astype(np.uint8)
        text += '[geometry]\nnormals = "n.npy"\nmask = "m.tif"\n'
        given = {"normals": normals, "mask": normals[..., 2] > 0.5}
    else:
        text += "[geometry.sphere]\ncentre = [15, 15]\nradius = 14\nradius_m = 0.1\n"
        given = {"sphere": SPHERE}
    theirs = read_reflectance_observation(load_rig(written(tmp_path, files, text)))
    ours = from_photographs(
        *(images, scale * LIGHTS),
        camera=CAMERA,
        intensities=1 + np.arange(4) / 10,
        intensity_sd=0.01,
        direction_sd=0.02,
        exposure_sd=[0.005, 0.0, 0.005, 0.005],
        stray_sd=0.001,
        held_out=[2],
        point_lights=shape == "point lights",
        **given,
    )
    assert_equal(ours, theirs)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"intensity_sd": [[0.01]] * 4}, "intensity_sd: give one number"),
        ({"stray_sd": "a"}, "stray_sd: give one number"),
        ({"exposure_sd": True}, "exposure_sd: give one number"),
        ({"intensity_sd": [0.01] * 3}, "values of intensity_sd"),
        ({"intensity_sd": -0.01}, "intensity_sd"),
        ({"direction_sd": np.nan}, "direction_sd"),
        ({"direction_sd": 3.0}, "3 rad leaves the direction unknown; give it in radians"),
    ],
)
def test_unusable_errors_of_lights_are_refused(given, said):
    images = [64 + 2000.0 * np.maximum(normals_of_the_sphere() @ v, 0) for v in LIGHTS]
    with pytest.raises(InputError, match=said):
        from_photographs(images, LIGHTS, camera=CAMERA, sphere=SPHERE, **given)


def test_nan_outside_the_mask_is_accepted():
    """Pixels outside the mask may have any value, and those inside must be numbers."""
    normals = normals_of_the_sphere()
    images = [64 + 2000.0 * np.maximum(normals @ v, 0) for v in LIGHTS]
    mask = normals[..., 2] > 0.5
    given = {"camera": CAMERA, "normals": normals, "mask": mask}
    whole = from_photographs(images, LIGHTS, **given)
    for outside in (np.nan, np.inf):
        holed = [np.where(mask, image, outside) for image in images]
        assert_equal(from_photographs(holed, LIGHTS, **given), whole)
    images[1][15, 15] = np.nan
    with pytest.raises(InputError, match=r"1 pixels are NaN or infinite"):
        from_photographs(images, LIGHTS, **given)


def loaded(rig, names):
    return [read_image(rig.path(name)) for name in names]


@pytest.mark.slow
def test_the_noise_calibration_equals_that_of_files(lab):
    rig = load_rig(lab[0] / "noise")
    ours = from_frames(
        [loaded(rig, flat.files) for flat in rig.flat],
        [loaded(rig, dark.files) for dark in rig.dark],
        [flat.exposure for flat in rig.flat],
        [flat.photons for flat in rig.flat],
        camera=rig.camera,
        dark_exposures=[dark.exposure for dark in rig.dark],
    )
    theirs = read_photon_transfer(lab[0] / "noise")
    assert calibrate_noise(ours).sheet == calibrate_noise(theirs).sheet


@pytest.mark.slow
def test_the_response_equals_that_of_files(lab):
    rig = load_rig(lab[0] / "response")
    images = loaded(rig, [entry.file for entry in rig.exposure])
    ours = from_stack(images, [entry.exposure for entry in rig.exposure], camera=rig.camera)
    results = [calibrate_response(stack) for stack in (ours, read_exposure_stack(rig))]
    for a, b in zip(*(result.channels for result in results), strict=True):
        assert a.gamma.gamma == b.gamma.gamma
        np.testing.assert_array_equal(a.curve.log_exposure, b.curve.log_exposure)


@pytest.mark.slow
def test_the_reflectance_equals_that_of_files(lab):
    rig = load_rig(lab[0] / "brdf")
    ours = from_photographs(
        loaded(rig, [light.file for light in rig.light]),
        np.array([light.direction for light in rig.light]),
        camera=rig.camera,
        sphere=rig.geometry.sphere,
        intensities=[light.intensity for light in rig.light],
        held_out=[i for i, light in enumerate(rig.light) if light.held_out],
    )
    results = [
        calibrate_reflectance(observation, model="phong")
        for observation in (ours, read_reflectance_observation(rig))
    ]
    for a, b in zip(*(result.chosen_fits for result in results), strict=True):
        np.testing.assert_array_equal(a.vector, b.vector)
        np.testing.assert_array_equal(a.robustness.covariance, b.robustness.covariance)


@pytest.mark.slow
def test_calibrations_compute_in_float64_if_jax_uses_float32():
    """The fits run in float64 whatever the script has set, as in the commands."""
    with jax.enable_x64(False):
        sensor = jv.Sensor(
            quantum_efficiency=0.5,
            shot_noise=jv.PoissonShotNoise(),
            read_noise=5.0,
            gain=0.25,
            offset=64.0,
            bits=12,
        )
        photons = np.linspace(500, 30_000, 8)
        keys = jax.random.split(jax.random.key(0), (16, 2))
        field = np.ones((48, 48, 1), np.float32)
        take = jax.jit(jax.vmap(lambda key, n: jv.raw_image(key, sensor, n * field), (0, None)))
        flats = [np.asarray(take(k, n))[..., 0] for k, n in zip(keys[:8], photons, strict=True)]
        darks = [np.asarray(take(k, 0.0))[..., 0] for k in keys[8:]]
        exposures, camera = [0.01] * 8, Camera(bits=12)
        measured = from_frames(flats, darks, exposures, photons, camera=camera)
        found = calibrate_noise(measured)
        assert bool(found.chosen.optimum.stationary)
        told = " ".join(repr(found).split())
        assert "system gain" in told
        assert "standard errors. sampling=Emcee() draws from the posterior itself." in told
        found.section.figure("photon_transfer")
