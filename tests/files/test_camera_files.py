"""Tests cameras from files: the shipped ones, and one sentence for each mistake in a file."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import Lambert
from jaxvision import scene as s
from jaxvision.colour_spaces import colour_data
from jaxvision.errors import InputError
from jaxvision.files.cameras import read_camera, shipped_cameras
from jaxvision.sensor import expected_signal, mean_photoelectrons
from jaxvision.shot import capture


def test_five_cameras_ship():
    assert shipped_cameras() == ("ccd", "cmos", "consumer_bayer", "emva1288", "ideal")


def test_the_industrial_camera_has_the_published_figures(data_folder):
    lines = (data_folder / "emva1288" / "reference_results.csv").read_text().splitlines()[1:]
    published = {line.split(",")[0]: float(line.split(",")[1]) for line in lines}
    sensor = read_camera("emva1288").sensor
    for field, name, scale in (
        ("gain", "K", 1),
        ("quantum_efficiency", "QE", 100),
        ("read_noise", "sigma_d", 1),
        ("dark_current", "u_I_mean", 1),
        ("dsnu", "DSNU1288", 1),
        ("prnu", "PRNU1288", 100),
    ):
        np.testing.assert_allclose(scale * getattr(sensor, field), published[name], rtol=1e-11)
    responsivity = sensor.gain * sensor.quantum_efficiency
    np.testing.assert_allclose(responsivity, published["R"], rtol=1e-9)


def test_the_ideal_camera_counts_photons():
    sensor = read_camera("ideal").sensor
    joule = 6.62607015e-34 * 299792458 / 555e-9
    electrons = expected_signal(sensor, jnp.asarray([1.0]))
    np.testing.assert_allclose(electrons, 25e-12 * 0.01 / joule, rtol=1e-12)


def test_the_consumer_camera_has_the_measured_sensitivities():
    """An equal-energy band reaches each colour in proportion to the measured response per watt."""
    sensor = read_camera("consumer_bayer").sensor
    grid = colour_data.wavelength_grid(first=400e-9, last=700e-9, step=10e-9)
    measured = np.asarray(colour_data.camera_sensitivities("Nikon 5100 (NPL)", grid))
    assert sensor.colour_filter.transmission.shape == (3, 31)
    assert float(sensor.colour_filter.transmission.max()) == pytest.approx(0.5)
    band = 14  # 540 nm
    light = jnp.zeros((2, 2, 31)).at[..., band].set(1.0)
    tile = np.asarray(mean_photoelectrons(sensor, light))[..., 0]
    red, green, blue = tile[0, 0], tile[0, 1], tile[1, 1]
    assert tile[1, 0] == green
    np.testing.assert_allclose(red / green, measured[band, 0] / measured[band, 1], rtol=1e-9)
    np.testing.assert_allclose(blue / green, measured[band, 2] / measured[band, 1], rtol=1e-9)
    two = np.asarray(mean_photoelectrons(sensor, jnp.ones((2, 2, 31)).at[..., 15:].set(0))) / (
        np.asarray(mean_photoelectrons(sensor, jnp.ones((2, 2, 31))))
    )
    share = measured[:15].sum(axis=0) / measured.sum(axis=0)
    np.testing.assert_allclose(two[0, 0, 0], share[0], rtol=1e-6)
    three = read_camera("consumer_bayer", wavelengths=jnp.asarray([4.5e-7, 5.5e-7, 6.2e-7])).sensor
    assert three.colour_filter.transmission.shape == (3, 3)
    np.testing.assert_array_equal(three.photon_conversion.wavelength, [4.5e-7, 5.5e-7, 6.2e-7])


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ccd", "cmos", "consumer_bayer", "emva1288", "ideal"])
def test_each_takes_a_picture(name):
    camera = read_camera(name)
    bands = 31 if name == "consumer_bayer" else 1
    camera = replace(camera, view=replace(camera.view, resolution=(8, 12)))
    white = Lambert([0.0] * bands, ambient=[1.0] * bands)
    wall = s.Surface(s.Plane([0, 0, 2.0], [0, 0, -1]), white)
    scene = s.Scene([wall], [], s.AmbientLight([0.01 if bands > 1 else 5.0] * bands))
    key = jax.random.key(0)
    shot = jax.jit(capture)(key, scene, camera, die_key=key)
    assert jnp.isfinite(shot.raw).all()
    assert shot.raw.shape == (8, 12, 1)
    assert float(shot.raw.std()) > 0
    if camera.development is not None:
        assert shot.picture.shape[:2] == (8, 12)


def test_ccd_and_cmos_have_the_effects_of_their_kind():
    ccd, cmos = (read_camera(name).sensor for name in ("ccd", "cmos"))
    of_ccd = ("smear", "charge_transfer", "blooming")
    of_cmos = ("shutter", "conversion_prnu", "column_dsnu", "column_prnu", "row_noise")
    assert all(getattr(ccd, name) is not None for name in of_ccd)
    assert all(getattr(ccd, name) is None for name in of_cmos)
    assert all(getattr(cmos, name) is not None for name in of_cmos)
    assert all(getattr(cmos, name) is None for name in of_ccd)
    for sensor in (ccd, cmos):  # the ADC saturates above the well
        top = float(sensor.offset + sensor.gain * sensor.full_well)
        assert 0.9 * 2 ** float(sensor.bits) < top < 2 ** float(sensor.bits)


GOOD = """
[view]
kind = "Pinhole"
focal_length = 8e-3
pixel_pitch = 5e-6
resolution = [4, 6]
[sensor]
gain = 0.5
[sensor.colour_filter]
pattern = "GRBG"
transmission = [[1.0], [0.5], [0.2]]
[sensor.read_noise]
kind = "HeavyTailedReadNoise"
rms = 2.0
tail_rms = 9
tail_fraction = 0.01
"""


def test_tables_become_records(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(GOOD)
    camera = read_camera(file)
    assert camera.view.resolution == (4, 6)
    np.testing.assert_array_equal(camera.view.rotation, np.eye(3))
    assert camera.sensor.colour_filter.pattern == ((1, 0), (2, 1))
    assert isinstance(camera.sensor.read_noise, s.HeavyTailedReadNoise)
    assert float(camera.sensor.read_noise.tail_rms) == 9
    assert camera.development is None


MISTAKES = {
    "key": ("gain = 0.5", "gian = 0.5", r"sensor\.gian is not a key .* nearest is 'gain'"),
    "table": ("[view]", "[veiw]", r"veiw is not a key of a camera file; the nearest is 'view'"),
    "kind": ('"Pinhole"', '"Pinhol"', r"view\.kind = 'Pinhol' is unknown; .* 'Pinhole'"),
    "no kind": ('kind = "Pinhole"', "", r"view\.kind is missing; use one of Orthographic, Pinhole"),
    "missing": ("focal_length = 8e-3", "", r"view\.focal_length is missing; add it"),
    "value": ("gain = 0.5", "gain = -1", r"Sensor\.gain must be finite, above 0, got -1"),
    "out of range": ("gain = 0.5", f"gain = 1{400 * '0'}", r"sensor\.gain is out of the range"),
    "word": ("gain = 0.5", 'gain = "high"', r"sensor\.gain = 'high' must be a number"),
    "toml": ("gain = 0.5", "gain 0.5", r"not a TOML file"),
    "pattern": ('"GRBG"', '"GRRB"', r"pattern: phase must be one of RGGB"),
    "number": ("gain = 0.5", "gain = {a = 1}", r"sensor\.gain is a number, not a table"),
    "noise": (
        "gain = 0.5",
        "shot_noise = 3",
        r"sensor\.shot_noise must be the table of a PoissonShotNoise or .*, got 3; head it "
        r"\[sensor\.shot_noise\]",
    ),
    "noise in words": (
        "gain = 0.5",
        'shot_noise = "PoissonShotNoise"',
        r"must be the table of a PoissonShotNoise or .*, got 'PoissonShotNoise'; head it",
    ),
    "distortion": (
        "focal_length",
        "distortion = 0.1\nfocal_length",
        r"view\.distortion must be the table of a Distortion, got 0\.1",
    ),
    "development": (
        "[view]",
        "development = 3\n[view]",
        r"development must be the table of a Development, got 3; head it \[development\]",
    ),
    "list of kinds": ('kind = "Pinhole"', "kind = []", r"view\.kind = \[\] is unknown; use one of"),
    "rotation": (
        "focal_length",
        "rotation = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\nfocal_length",
        r"Pinhole\.rotation must be a rotation",
    ),
    "broken tile": ('"GRBG"', "[[0, 1], [2]]", r"ColourFilter\.pattern must be rows of one length"),
    "method": (
        "[sensor]",
        '[development.demosaicing]\npattern = "RGGB"\nmethod = "malver"\n[sensor]',
        r"Demosaicing\.method must be one of bilinear, malvar, .*, got 'malver'",
    ),
    "subsampling": (
        "[sensor]",
        '[development.compression]\nquality = 50\nsubsampling = "4:2:1"\n[sensor]',
        r"JPEG\.subsampling must be one of 4:4:4, 4:2:0, got '4:2:1'",
    ),
    "too many bands": (
        "transmission = [[1.0], [0.5], [0.2]]",
        'sensitivities = "Nikon 5100 (NPL)"\npeak = 0.5\n[bands]\nfirst = 4e-7\nlast = 7e-7\n'
        "step = 1e-28\n[sensor.photon_conversion]\nx = 1",
        r"bands: A grid .* has 3e\+21 wavelengths, more than 100,000; take longer steps",
    ),
    "a list for a camera": (
        "transmission = [[1.0], [0.5], [0.2]]",
        "sensitivities = [1.0]\npeak = 0.5\n[bands]\nfirst = 4e-7\nlast = 7e-7\nstep = 1e-8",
        r"No camera \[1\.0\]; use one of ",
    ),
    "conversion": (
        "transmission = [[1.0], [0.5], [0.2]]",
        'sensitivities = "Nikon 5100 (NPL)"\npeak = 0.5\n[bands]\nfirst = 4e-7\nlast = 7e-7\n'
        "step = 1e-7\n[sensor.photon_conversion]\nx = 1",
        r"sensor\.photon_conversion\.x is not a key",
    ),
}


def test_a_whole_number_may_be_larger_than_an_integer_of_jax(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace("gain = 0.5", f"gain = {10**20}"))
    assert float(read_camera(file).sensor.gain) == 1e20


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_one_sentence(case, tmp_path):
    right, wrong, message = MISTAKES[case]
    assert right in GOOD
    file = tmp_path / "mine.toml"
    file.write_text(GOOD.replace(right, wrong, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_camera(file)
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_camera_that_is_not_there_names_the_nearest():
    with pytest.raises(InputError, match="the nearest is 'emva1288'"):
        read_camera("emva1289")
