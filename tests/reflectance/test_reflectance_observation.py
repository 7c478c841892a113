"""Reading photographs of a known shape: the geometry is right, and what is wrong is named."""

import numpy as np
import pytest
from oracles.sphere_photographs import light_directions, sphere_normals, write_rig

from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.rig import load_rig
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

SIZE, RADIUS = 24, 10.5
CAMERA = {"bits": 12, "black_level": 60.0}
DIRECTIONS = light_directions(5)


def frames(count=5, level=1000):
    return np.full((count, SIZE, SIZE), level)


def rig_folder(tmp_path, **changes):
    options = {
        "frames": frames(),
        "directions": DIRECTIONS,
        "intensity": [1.0],
        "radius": RADIUS,
        "camera": CAMERA,
    }
    return write_rig(tmp_path, **(options | changes))


def edit(folder, old, new):
    text = (folder / "rig.toml").read_text()
    assert old in text
    (folder / "rig.toml").write_text(text.replace(old, new))
    return folder


def read(folder):
    return read_reflectance_observation(load_rig(folder))


def test_angles_are_those_of_the_textbook(tmp_path):
    seen = read(rig_folder(tmp_path))
    normals = sphere_normals(SIZE, RADIUS)[seen.rows, seen.columns]
    np.testing.assert_allclose(seen.normals, normals, atol=1e-14)
    n_l = DIRECTIONS @ normals.T
    np.testing.assert_allclose(seen.cosine, n_l, atol=1e-14)
    mirrored_z = 2 * n_l * normals[:, 2] - DIRECTIONS[:, 2:]
    np.testing.assert_allclose(np.cos(seen.mirror_angle), mirrored_z, atol=1e-13)
    assert np.all(seen.falloff == 1)
    assert seen.channels == ("grey",)


def test_pixels_that_the_outline_may_cross_are_left_out(tmp_path):
    seen = read(rig_folder(tmp_path))
    middle = (SIZE - 1) / 2
    corner = np.hypot(np.abs(seen.rows - middle) + 0.5, np.abs(seen.columns - middle) + 0.5)
    assert corner.max() < RADIUS


def test_every_fourth_light_is_held_out_unless_the_rig_says(tmp_path):
    seen = read(rig_folder(tmp_path))
    assert seen.held_out.tolist() == [False, False, False, True, False]
    assert any("every fourth" in sentence for sentence in seen.findings)
    told = read(rig_folder(tmp_path, held_out=[1, 0, 0, 0, 0]))
    assert told.held_out.tolist() == [True, False, False, False, False]
    few = read(rig_folder(tmp_path, frames=frames(3)))
    assert not few.held_out.any()
    assert any("untested" in sentence for sentence in few.findings)


def test_a_point_light_falls_off_with_the_square_of_its_distance(tmp_path):
    folder = edit(rig_folder(tmp_path), f"radius = {RADIUS}", f"radius = {RADIUS}, radius_m = 0.1")
    direction = [float(x) for x in DIRECTIONS[0]]
    seen = read(edit(folder, f"direction = {direction}", "position = [0.3, 0.0, 0.4]"))
    toward = np.array([0.3, 0.0, 0.4]) - 0.1 * seen.normals
    distance = np.linalg.norm(toward, axis=1)
    np.testing.assert_allclose(seen.falloff[0], distance**-2.0, rtol=1e-13)
    expected = np.sum(seen.normals * toward, axis=1) / distance
    np.testing.assert_allclose(seen.cosine[0], expected, atol=1e-14)


def test_normals_from_a_file_are_masked_and_scaled(tmp_path):
    normals = np.nan_to_num(sphere_normals(SIZE, RADIUS)) * (1 + 5e-3)
    np.save(tmp_path / "normals.npy", normals)
    mask = np.zeros((SIZE, SIZE), np.uint8)
    mask[8:16, 8:16] = 255
    write_image(tmp_path / "mask.png", mask)
    folder = rig_folder(tmp_path)
    middle = (SIZE - 1) / 2
    edit(
        folder,
        f"sphere = {{ centre = [{middle}, {middle}], radius = {RADIUS} }}",
        'normals = "normals.npy"\nmask = "mask.png"',
    )
    seen = read(folder)
    assert len(seen.rows) == 64
    np.testing.assert_allclose(np.linalg.norm(seen.normals, axis=1), 1, rtol=1e-15)


def test_colour_images_need_one_intensity_or_one_a_channel(tmp_path):
    colour = np.repeat(frames()[..., None], 3, axis=3)
    seen = read(rig_folder(tmp_path, frames=colour, intensity=[1.0, 2.0, 3.0]))
    assert seen.channels == ("red", "green", "blue")
    np.testing.assert_array_equal(seen.intensity[:, 0], [1, 2, 3])
    with pytest.raises(InputError, match="2 intensities"):
        read(rig_folder(tmp_path, frames=colour, intensity=[1.0, 2.0]))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": frames(level=4095)}, "saturated"),
        ({"frames": frames(level=60)}, "dark"),
        ({"held_out": [1] * 5}, "every light is held out"),
        ({"radius": 3.0}, "leave 1. pixels"),
        ({"directions": [[0.0, 0.0, -1.0]] * 5}, "reaches no visible pixel"),
        ({"camera": CAMERA | {"bits": 8}}, "do not fit 8 bits"),
        ({"camera": CAMERA | {"pattern": '"RGGB"'}}, "mosaic"),
    ],
)
def test_bad_folders_are_refused_in_one_sentence(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        read(rig_folder(tmp_path, **changes))


def test_missing_and_contradicting_files_are_refused(tmp_path):
    folder = rig_folder(tmp_path)
    (folder / "02.png").unlink()
    with pytest.raises(InputError, match=r"02\.png: no such image"):
        read(folder)
    write_image(folder / "02.png", np.zeros((SIZE, SIZE + 1), np.uint16))
    with pytest.raises(InputError, match="same size"):
        read(folder)
    write_image(folder / "02.png", np.zeros((SIZE, SIZE), np.uint8))
    with pytest.raises(InputError, match="8-bit data"):
        read(folder)


def test_wrong_normals_are_refused(tmp_path):
    folder = rig_folder(tmp_path)
    middle = (SIZE - 1) / 2
    edit(
        folder,
        f"sphere = {{ centre = [{middle}, {middle}], radius = {RADIUS} }}",
        'normals = "normals.npy"',
    )
    np.save(folder / "normals.npy", np.ones((SIZE, SIZE, 3)))
    with pytest.raises(InputError, match="not of length 1"):
        read(folder)
    normals = np.zeros((SIZE, SIZE, 3))
    normals[..., 2] = 1
    normals[3, 4] = np.nan
    np.save(folder / "normals.npy", normals)
    with pytest.raises(InputError, match="row 3, column 4"):
        read(folder)
    np.save(folder / "normals.npy", np.ones((SIZE, SIZE + 1, 3)))
    with pytest.raises(InputError, match="one normal"):
        read(folder)


def test_point_lights_need_a_sphere_in_metres(tmp_path):
    direction = [float(x) for x in DIRECTIONS[0]]
    folder = edit(rig_folder(tmp_path), f"direction = {direction}", "position = [0.0, 0.0, 0.05]")
    with pytest.raises(InputError, match="radius_m"):
        read(folder)
    edit(folder, f"radius = {RADIUS}", f"radius = {RADIUS}, radius_m = 0.1")
    with pytest.raises(InputError, match="inside the sphere"):
        read(folder)
