"""Tests rig files: valid ones are read, and errors name their entry."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxvision as jv
from fitting.observation import (
    equalise_sites,
    equalised_camera,
    read_frame,
    read_mask,
    read_stack,
    split_channels,
)
from fitting.rig import Camera, as_rig, load_rig, require
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

GOOD = """
[camera]
bits = 12
black_level = 60.0

[[flat]]
files = ["a.tif", "b.tif"]
exposure = 0.01
photons = 120.0

[[light]]
file = "l.tif"
direction = [0.0, 0.6, 0.8]
intensity = [1.0, 2.0, 3.0]

[geometry]
sphere = { centre = [10.0, 11.0], radius = 5.0 }
"""


def test_a_sensor_of_a_mosaic_gives_the_numbers_of_each_site(tmp_path):
    """Sites have the names of the taps. A rig with another layout is refused."""
    stated = {"pattern": "RGGB", "taps": "left and right"}
    names = Camera(bits=12, **stated).sites
    taps = jv.Taps(
        ((0, 1, 2, 3), (4, 5, 6, 7)),
        offset=np.arange(8.0) - 3.5,
        gain=np.linspace(0.9, 1.1, 8),
        stretched=True,
        cell=(2, 2),
        names=names,
    )
    best = jv.Sensor(gain=0.5, offset=64.0, read_noise=4.0, row_noise=3.0, taps=taps)
    jv.write_sensor(best, tmp_path / "sensor.toml")
    rig = 'camera = {bits = 12, pattern = "RGGB", sensor = "sensor.toml"'
    camera = load_rig(write_rig(tmp_path, rig + ', taps = "left and right"}')).camera
    np.testing.assert_allclose(camera.black_level, 60.5 + np.arange(8))
    np.testing.assert_allclose(camera.gain, 0.5 * np.linspace(0.9, 1.1, 8))
    assert camera.read_noise == pytest.approx(5.0)
    assert camera.at("red tap right").black_level == 62.5
    write_rig(tmp_path, rig + "}")
    with pytest.raises(
        InputError, match=r"has 8 taps, red tap left, .*; state camera\.pattern and"
    ):
        load_rig(tmp_path)


def test_a_sensor_file_gives_values_that_the_rig_lacks(tmp_path):
    """The temporal noise of a pixel includes noise of pixels, rows and frames."""
    rng = np.random.default_rng(0)
    best = jv.Sensor(gain=0.5, read_noise=4.0, row_noise=3.0, offset=64.0, prnu=0.01)
    draws = jax.tree.map(lambda x: np.full(300, x), best)
    gains, noises = 0.5 + 0.01 * rng.standard_normal(300), 4 + 0.1 * rng.standard_normal(300)
    draws = eqx.tree_at(lambda s: (s.gain, s.read_noise), draws, (gains, noises))
    jv.write_sensor(best, tmp_path / "sensor.toml", draws=draws)
    camera = load_rig(write_rig(tmp_path, 'camera = {bits = 12, sensor = "sensor.toml"}')).camera
    assert (camera.gain, camera.read_noise, camera.black_level) == (0.5, 5.0, 64.0)
    np.testing.assert_allclose(camera.prnu_sd, 0.01)
    np.testing.assert_allclose(camera.gain_sd, gains.std(), rtol=1e-5)
    np.testing.assert_allclose(camera.read_noise_sd, np.hypot(noises, 3).std(), rtol=1e-5)
    assert camera.black_sd is None  # the offset does not vary
    (tmp_path / "sensor.npz").unlink()
    stated = Camera(bits=12, gain=0.4, gain_sd=0.1, sensor=str(tmp_path / "sensor.toml"))
    assert (stated.gain, stated.gain_sd, stated.read_noise) == (0.4, 0.1, 5.0)
    assert stated.read_noise_sd is None
    write_rig(tmp_path, 'camera = {bits = 12, sensor = "none.toml"}')
    with pytest.raises(InputError, match=r"none\.toml: no such sensor file; check the name"):
        load_rig(tmp_path)


def write_rig(folder, text):
    (folder / "rig.toml").write_text(text)
    return folder


def test_a_rig_is_read_from_its_folder_or_its_file(tmp_path):
    rig = load_rig(write_rig(tmp_path, GOOD))
    assert rig == load_rig(tmp_path / "rig.toml")
    assert as_rig(str(tmp_path)) == as_rig(rig) == rig
    assert rig.camera.full_scale == 4095
    assert rig.camera.at("grey").clip_level == 4095
    assert rig.flat[0].files == ("a.tif", "b.tif")
    assert rig.light[0].intensity == (1.0, 2.0, 3.0)
    assert rig.path("a.tif") == tmp_path / "a.tif"


def test_an_exposure_may_be_written_as_cameras_show_it(tmp_path):
    rig = load_rig(write_rig(tmp_path, GOOD.replace("exposure = 0.01", 'exposure = "1/80"')))
    assert rig.flat[0].exposure == 1 / 80


def test_root_expands_environment_variables(tmp_path, monkeypatch):
    monkeypatch.setenv("LAB_DATA", str(tmp_path / "elsewhere"))
    write_rig(tmp_path, 'root = "${LAB_DATA}/today"\n' + GOOD)
    assert load_rig(tmp_path).path("a.tif") == tmp_path / "elsewhere" / "today" / "a.tif"


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("bits = 12", "", r"camera\.bits is missing"),
        ("bits = 12", "bits = 20", r"camera\.bits = 20"),
        ("bits = 12", "bits = 12\nbit_depth = 12", r"camera\.bit_depth is not a key"),
        ("bits = 12", "bits = 12\ngain_sd = 0.1", r"camera: gain_sd without gain; give both"),
        ("bits = 12", "bits = 12\ngamma_sd = 0.1", r"camera: gamma_sd without gamma; give both"),
        ("exposure = 0.01", "", r"flat\[1\]\.exposure is missing"),
        ("exposure = 0.01", "exposure = -1.0", r"flat\[1\]\.exposure = -1\.0"),
        ("exposure = 0.01", "exposure = nan", r"flat\[1\]\.exposure = nan"),
        ("exposure = 0.01", 'exposure = "fast"', r'exposure.*no time; write seconds.*"1/8"'),
        ("exposure = 0.01", 'exposure = "1/0"', r"no time; write seconds"),
        (
            "exposure = 0.01",
            "exposure = true",
            r"exposure = True: must be a valid number",
        ),
        ("bits = 12", "bits = true", r"camera\.bits = True: must be a valid integer"),
        ('"a.tif", "b.tif"', '"a.tif"', r"flat\[1\]\.files lists 1; give at least 2\."),
        ("[0.0, 0.6, 0.8]", "[0.0, 0.6, 0.9]", r"light\[1\]: direction has length 1\.08"),
        ("[0.0, 0.6, 0.8]", "[0.0, 0.6]", r"light\[1\]\.direction"),
        ("direction = [0.0, 0.6, 0.8]", "", r"light\[1\]: give either direction or position"),
        ("radius = 5.0", "radius = -5.0", r"geometry\.sphere\.radius = -5"),
        ("sphere = {", "sphere = ", "not a TOML file"),
        ("[camera]", 'folder = "x"\n[camera]', "`folder` is not a key"),
    ],
)
def test_mistakes_are_named_with_their_entry(tmp_path, old, new, expected):
    assert old in GOOD
    with pytest.raises(InputError, match=expected) as raised:
        load_rig(write_rig(tmp_path, GOOD.replace(old, new)))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("stated", "exponent"), [({}, None), ({"gamma": 1}, None), ({"gamma": 1, "gamma_sd": 0.1}, 1)]
)
def test_files_are_linear_if_nothing_else_is_possible(stated, exponent):
    assert Camera(bits=12, **stated).encoding == exponent


def test_a_direction_with_rounding_errors_is_accepted(tmp_path):
    load_rig(write_rig(tmp_path, GOOD.replace("0.8]", "0.80005]")))


def test_missing_rig_and_missing_section(tmp_path):
    with pytest.raises(InputError, match=r"rig\.toml: no such rig file"):
        load_rig(tmp_path)
    rig = load_rig(write_rig(tmp_path, GOOD))
    require(rig, "a reflectance calibration")
    with pytest.raises(InputError, match=r"no \[\[dark\]\] entry, which photon transfer needs"):
        require(rig, "photon transfer")


@pytest.fixture
def camera():
    return Camera(bits=12)


def test_frames_are_float64_as_stored(tmp_path, camera):
    pixels = np.arange(12, dtype=np.uint16).reshape(3, 4) * 300
    write_image(tmp_path / "a.tif", pixels)
    frame = read_frame(tmp_path / "a.tif", camera)
    assert frame.dtype == np.float64
    np.testing.assert_array_equal(frame, pixels)


@pytest.mark.parametrize(
    ("name", "pixels", "expected"),
    [
        ("a.png", np.zeros((2, 2), np.uint8), "8-bit data, but the rig declares 12 bits"),
        ("a.png", np.full((2, 2), 4096, np.uint16), "do not fit 12 bits"),
        ("a.npy", np.array([[1.0, np.nan]]), "1 pixels are NaN or infinite"),
        ("a.npy", np.array([[1.0, -2.0]]), "holds numbers below 0, down to -2"),
        ("a.npy", np.array(["x"]), "not an image"),
        ("a.npy", np.zeros((2, 2, 2, 2)), "not an image"),
        ("a.npy", np.zeros((2, 2, 4)), "a.npy: has 4 channels; .* without an alpha channel"),
    ],
)
def test_unusable_frames_are_named(tmp_path, camera, name, pixels, expected):
    if name.endswith("npy"):
        np.save(tmp_path / name, pixels)
    else:
        write_image(tmp_path / name, pixels)
    with pytest.raises(InputError, match=expected):
        read_frame(tmp_path / name, camera)


def test_frames_of_one_set_need_one_size(tmp_path):
    rig = load_rig(write_rig(tmp_path, GOOD))
    write_image(tmp_path / "a.tif", np.zeros((3, 4), np.uint16))
    write_image(tmp_path / "b.tif", np.zeros((4, 4), np.uint16))
    with pytest.raises(InputError, match=r"b\.tif: is \(4, 4\), but a\.tif is \(3, 4\)"):
        read_stack(rig, rig.flat[0].files)


def test_bayer_sites_against_the_mosaic_written_out():
    mosaic = np.array([[1, 2], [3, 4]] * 2)
    sites = split_channels(np.tile(mosaic, (1, 2)), Camera(bits=8, pattern="GBRG"))
    assert {name: plane.flat[0] for name, plane in sites.items()} == {
        "green 1": 1,
        "blue": 2,
        "red": 3,
        "green 2": 4,
    }
    assert all(plane.shape == (2, 2) and np.ptp(plane) == 0 for plane in sites.values())


def test_colour_frames_split_by_channel(camera):
    frame = RNG_FRAME
    planes = split_channels(frame, camera)
    assert list(planes) == ["red", "green", "blue"]
    np.testing.assert_array_equal(planes["blue"], frame[..., 2])


RNG_FRAME = np.random.default_rng(0).random((3, 4, 3))


def test_masks(tmp_path):
    write_image(tmp_path / "m.png", np.array([[0, 255], [1, 0]], np.uint8))
    mask = read_mask(tmp_path / "m.png", Camera(bits=8), shape=(2, 2))
    np.testing.assert_array_equal(mask, [[False, True], [True, False]])
    with pytest.raises(InputError, match=r"the mask is \(2, 2\), the images are \(3, 3\)"):
        read_mask(tmp_path / "m.png", Camera(bits=8), shape=(3, 3))


SITES = {"bits": 14, "pattern": "RGGB"}
BLACK = [480.0, 512.0, 513.0, 560.0]


@pytest.mark.parametrize(
    ("camera", "names"),
    [
        ({}, ("grey",)),
        ({"taps": (1, 2)}, ("tap 0,0", "tap 0,1")),
        ({"pattern": "GBRG"}, ("green 1", "blue", "red", "green 2")),
        ({"pattern": "RGGB", "taps": (2, 1)}, ("red", "green 1", "green 2", "blue")),
        (
            {"pattern": "RGGB", "taps": (1, 4)},
            (
                *("red tap 0,0", "green 1 tap 0,1", "red tap 0,2", "green 1 tap 0,3"),
                *("green 2 tap 0,0", "blue tap 0,1", "green 2 tap 0,2", "blue tap 0,3"),
            ),
        ),
    ],
)
def test_the_sites_of_a_cell_are_named_in_reading_order(camera, names):
    assert Camera(bits=12, **camera).sites == names


def test_numbers_by_site_can_be_read_by_name(tmp_path):
    stated = "bits = 14\npattern = 'RGGB'\nblack_level = [480, 512, 513, 560]\ngain = 0.5"
    (tmp_path / "rig.toml").write_text(f"[camera]\n{stated}")
    camera = load_rig(tmp_path).camera
    assert [camera.at(name).black_level for name in camera.sites] == BLACK
    assert camera.at("blue").gain == 0.5
    assert camera.at("blue").clip_level == 2**14 - 1
    assert Camera(**SITES, black_level=np.array(BLACK)) == Camera(**SITES, black_level=BLACK)
    colour = Camera(bits=8, saturation=[250, 251, 252])
    assert [colour.at(name).clip_level for name in ("red", "green", "blue")] == [250, 251, 252]


@pytest.mark.parametrize(
    ("camera", "expected"),
    [
        ({"pattern": "RGGB", "black_level": [1, 2, 3]}, r"black_level lists 3 numbers, but .* 4$"),
        ({"gain": [1, 2]}, r"gain lists 2 .* 1 x 1 pixels .* has 1 site; .* or 3 in reading order"),
        ({"taps": (1, 2), "gain": [1, 2, 3]}, r"has 2 sites; give one number, or 2 or 6 in read"),
        ({"black_level": [1, 2, -3]}, r"black_level\[3\] = -3: must be greater than or equal to 0"),
        ({"black_level": []}, "black_level lists 0; give at least 1"),
        ({"taps": "top and bottom", "gain": [1, 2, 3]}, "taps = .* has 2 sites; give one number"),
        (
            {"taps": "quadrants", "region": (0, 0, 8, 8)},
            "parts of a whole frame and exclude a reg",
        ),
        (
            {"taps": "left and right", "pattern": "RGGB", "gain": [1, 2]},
            "a mosaic with taps = .* has 8 sites; give one number, or 8 in reading order",
        ),
        (
            {"taps": "thirds"},
            r"'thirds' are no taps; give rows and columns, as in \[1, 2\], or one of",
        ),
        ({"taps": (1, 1)}, "repeat at every pixel and separate nothing; remove it"),
        ({"region": (0, 0, 0, 5)}, r"region\[3\] = 0: must be greater"),
    ],
)
def test_numbers_by_site_fit_the_cell(tmp_path, camera, expected):
    text = "\n".join(f"{k} = {list(v) if isinstance(v, tuple) else v!r}" for k, v in camera.items())
    with pytest.raises(InputError, match=expected.replace("$", "")):
        load_rig(write_rig(tmp_path, f"[camera]\nbits = 12\n{text}"))


def test_a_grey_image_cannot_have_numbers_by_colour(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((4, 4)))
    with pytest.raises(InputError, match=r"is grey, but camera\.gain lists 3 numbers, as for RGB"):
        read_frame(tmp_path / "a.npy", Camera(bits=12, gain=[1, 2, 3]))


def test_a_region_keeps_the_phase_of_the_mosaic_and_of_the_taps(tmp_path):
    frame = np.arange(8.0 * 10).reshape(8, 10)
    np.save(tmp_path / "a.npy", frame)
    camera = Camera(bits=12, pattern="RGGB", region=(1, 2, 5, 7))
    read = read_frame(tmp_path / "a.npy", camera)
    np.testing.assert_array_equal(read, frame[1:6, 2:9])
    planes = split_channels(read, camera)
    np.testing.assert_array_equal(planes["red"], frame[2:6:2, 2:9:2])
    np.testing.assert_array_equal(planes["green 2"], frame[1:6:2, 2:9:2])
    np.testing.assert_array_equal(planes["blue"], frame[1:6:2, 3:9:2])
    with pytest.raises(InputError, match=r"is 8 x 10 .* ends at row 9, column 3; correct top"):
        read_frame(tmp_path / "a.npy", Camera(bits=12, region=(4, 0, 5, 3)))


def test_colour_images_of_two_taps_have_six_planes():
    image = np.arange(2.0 * 4 * 3).reshape(2, 4, 3)
    camera = Camera(bits=12, taps=(1, 2), black_level=[0, 1, 2, 3, 4, 5])
    planes = split_channels(image, camera)
    assert list(planes)[2:4] == ["blue tap 0,0", "red tap 0,1"]
    np.testing.assert_array_equal(planes["red tap 0,1"], image[:, 1::2, 0])
    np.testing.assert_array_equal(equalise_sites(image, camera)[0, 0], [2.5, 2.5, 2.5])


def test_one_intensity_needs_no_list(tmp_path):
    rig = load_rig(write_rig(tmp_path, GOOD.replace("[1.0, 2.0, 3.0]", "1.5776")))
    assert rig.light[0].intensity == (1.5776,)


def test_pixels_of_several_black_levels_are_shifted_to_their_mean():
    """The smallest range up to saturation is used for all."""
    camera = Camera(bits=12, black_level=[60, 70, 80], saturation=[4000, 4050, 4095], gain=0.5)
    alike = equalised_camera(camera)
    assert (alike.black_level, alike.saturation, alike.gain) == (70, 4000 - 60 + 70, 0.5)
    with pytest.raises(InputError, match=r"camera\.gain lists several numbers by colour"):
        equalised_camera(Camera(bits=12, gain=[0.5, 0.6, 0.5]))


def test_pixels_of_several_gains_are_scaled_to_their_mean():
    camera = Camera(bits=12, taps=(1, 2), black_level=[60, 70], gain=[0.5, 0.6], read_noise=[3, 4])
    electrons = np.array([[1000.0, 1000, 2000, 2000]])
    image = np.array([60.0, 70, 60, 70]) + np.array([0.5, 0.6, 0.5, 0.6]) * electrons
    np.testing.assert_allclose(equalise_sites(image, camera), 65 + 0.55 * electrons)
    alike = equalised_camera(camera)
    np.testing.assert_allclose(
        [alike.gain, alike.read_noise, alike.black_level], [0.55, np.sqrt(12.5), 65]
    )
    # The second amplifier saturates at 4095 - 70 DN of its own gain.
    np.testing.assert_allclose(alike.saturation, 65 + 4025 * 0.55 / 0.6)
    with pytest.raises(InputError, match=r"camera\.gain lists several numbers, but the files"):
        equalised_camera(Camera(bits=12, taps=(1, 2), gain=[0.5, 0.6], gamma=2.2))


@pytest.mark.parametrize(
    ("entries", "which"),
    [
        (
            '[[flat]]\nfiles = ["a.png", "b.png"]\nexposure = 1\n'
            '[[dark]]\nfiles = ["c.png", "a.png"]\nexposure = 1',
            "[[flat]] and [[dark]]",
        ),
        ('[[exposure]]\nfile = "a.png"\nexposure = 1\n' * 2, "[[exposure]]"),
        ('[[light]]\nfile = "a.png"\ndirection = [0, 0, 1]\n' * 2, "[[light]]"),
    ],
)
def test_a_file_that_is_listed_twice_is_refused(tmp_path, entries, which):
    (tmp_path / "rig.toml").write_text(f"camera = {{bits = 8}}\n{entries}\n")
    with pytest.raises(InputError) as found:
        load_rig(tmp_path)
    assert f"a.png stands more than once in {which}; list each file once" in str(found.value)


def test_one_photograph_in_two_formats_is_refused(tmp_path):
    lights = "".join(
        f'[[light]]\nfile = "{name}"\ndirection = [0, 0, 1]\n'
        for name in ("a.1s.tif", "a.2s.tif", "a.1s.jpg")
    )
    (tmp_path / "rig.toml").write_text(f"camera = {{bits = 8}}\n{lights}")
    with pytest.raises(
        InputError, match=r"a\.1s\.tif and a\.1s\.jpg in \[\[light\]\] are files of"
    ):
        load_rig(tmp_path)


def test_lengths_that_are_not_in_metres_are_refused():
    for key, length in (("wavelength", 550), ("pixel_pitch", 5)):
        with pytest.raises(ValueError, match=f"{length} m is too long; give metres"):
            Camera(bits=12, **{key: length})
