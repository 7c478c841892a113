"""Tests reading photographs of a known shape: the geometry is right, and errors are named."""

from contextlib import nullcontext

import numpy as np
import pytest
from oracles.sphere_photographs import light_directions, shade, sphere_normals, write_rig

from fitting import folders
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


def test_angles_equal_the_textbooks(tmp_path):
    seen = read(rig_folder(tmp_path))
    normals = sphere_normals(SIZE, RADIUS)[seen.rows, seen.columns]
    np.testing.assert_allclose(seen.normals, normals, atol=1e-14)
    n_l = DIRECTIONS @ normals.T
    np.testing.assert_allclose(seen.cosine, n_l, atol=1e-14)
    mirrored_z = 2 * n_l * normals[:, 2] - DIRECTIONS[:, 2:]
    np.testing.assert_allclose(np.cos(seen.mirror_angle), mirrored_z, atol=1e-13)
    assert np.all(seen.falloff == 1)
    assert seen.channels == ("grey",)


def test_pixels_on_the_outline_are_left_out(tmp_path):
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


def test_a_colour_of_a_mosaic_uses_only_its_own_pixels(tmp_path):
    """The pattern is GBRG. Black level and gain of each site, in reading order, are normalised to
    their mean."""
    colour = np.arange(1, 4) * (100 + np.arange(5 * SIZE**2).reshape(5, SIZE, SIZE, 1) % 250)
    site = np.array([[1, 2], [0, 1]])
    which = np.tile(site, (SIZE // 2, SIZE // 2))
    black, gain = (
        np.tile(x, (SIZE // 2, SIZE // 2)) for x in ([[60, 64], [68, 72]], [[1, 2], [2, 1]])
    )
    mosaic = black + gain * np.take_along_axis(colour, which[None, :, :, None], 3)[..., 0]
    camera = {"bits": 12, "pattern": '"GBRG"', "black_level": [60, 64, 68, 72]}
    camera["gain"] = [0.1, 0.2, 0.2, 0.1]
    folder = rig_folder(tmp_path, frames=mosaic, camera=camera, intensity=[1.0, 2.0, 3.0])
    rig, whole = load_rig(folder), 0
    for i, name in enumerate(("red", "green", "blue")):
        seen = read_reflectance_observation(rig, channel=name)
        assert seen.channels == (name,)
        assert (which[seen.rows, seen.columns] == i).all()
        normals = sphere_normals(SIZE, RADIUS)[seen.rows, seen.columns]
        np.testing.assert_allclose(seen.normals, normals, atol=1e-14)
        np.testing.assert_array_equal(seen.intensity, np.full((1, 5), i + 1.0))
        signal = 1.5 * colour[:, seen.rows, seen.columns, i]
        np.testing.assert_allclose(seen.dn[0], seen.black + signal, rtol=1e-12)
        whole += len(seen.rows)
    (tmp_path / "grey").mkdir()
    grey = rig_folder(tmp_path / "grey")
    assert whole == len(read(grey).rows)
    with pytest.raises(InputError, match=r"'red' is a colour of a mosaic; give camera\.pattern"):
        read_reflectance_observation(grey, channel="red")


@pytest.mark.slow
@pytest.mark.parametrize("command", [folders.brdf, folders.joint])
def test_photographs_of_a_raw_mosaic_give_each_colour(tmp_path, command):
    """Each colour uses the pixels of its sites, with their black levels and gains."""
    rng, size, radius = np.random.default_rng(3), 48, 22.0
    directions = light_directions(16)
    which = np.tile([[0, 1], [1, 2]], (size // 2, size // 2))
    black, gain = (
        np.tile(x, (size // 2, size // 2))
        for x in ([[60, 64], [68, 72]], [[0.25, 0.26], [0.24, 0.25]])
    )
    diffuse = [0.5, 0.35, 0.2]

    def exposed(electrons):
        of = rng.poisson(electrons) + 5 * rng.standard_normal(electrons.shape)
        return np.clip(np.round(black + gain * of), 0, 4095).astype(np.uint16)

    lit = [shade(sphere_normals(size, radius), directions, "phong", d, 0.3, 30.0) for d in diffuse]
    frames = exposed(9000 * np.take_along_axis(np.stack(lit, 3), which[None, ..., None], 3)[..., 0])
    camera = {"bits": 12, "pattern": '"RGGB"', "black_level": [60, 64, 68, 72]}
    camera["gain"] = [0.25, 0.26, 0.24, 0.25]
    extra = []
    if command is folders.joint:
        for kind, level in [("dark", 0.0), *(("flat", e) for e in (1000.0, 4000.0, 8000.0))]:
            names = [f"{kind}_{level:g}_{i}.npy" for i in range(2)]
            for name in names:
                np.save(tmp_path / name, exposed(np.full((size, size), level)))
            extra += [f"[[{kind}]]", f"files = {names}", "exposure = 0.01"]
    else:
        camera["read_noise"] = 5.0
    write_rig(
        tmp_path,
        frames,
        directions,
        [9000 * 0.25],
        radius=radius,
        camera=camera,
        extra="\n".join(extra),
    )
    sections, _ = command(
        tmp_path,
        lambda label: nullcontext(lambda done, total: None),
        lambda kind, progress: {"sampling": None, "seed": 0},
        model="phong",
    )
    assert [one.title.rpartition(": ")[2] for one in sections] == ["red", "green", "blue"]
    for one, truth in zip(sections, diffuse, strict=True):
        found = next(e for e in one.estimates if e.symbol == "k_d")
        print(found)
        assert abs(found.value - truth) < 4 * found.standard_error
        assert found.standard_error < 0.01 * truth


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": frames(level=4095)}, "saturated"),
        ({"frames": frames(level=60)}, "dark"),
        ({"held_out": [1] * 5}, "every light is held out"),
        ({"radius": 3.0}, "leave 1. pixels"),
        ({"directions": [[0.0, 0.0, -1.0]] * 5}, "reaches no visible pixel"),
        ({"camera": CAMERA | {"bits": 8}}, "do not fit 8 bits"),
        (
            {"camera": CAMERA | {"pattern": '"RGGB"'}},
            "are a Bayer mosaic; read one colour at a time, by a channel of red, green, blue",
        ),
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
    write_image(folder / "02.png", np.zeros((SIZE, SIZE), np.uint8))
    with pytest.raises(InputError, match="8-bit data"):
        read(folder)


@pytest.mark.parametrize("damage", ["size", "cut", "text"])
def test_an_image_that_cannot_be_read_is_named_and_left_out(tmp_path, damage):
    folder = rig_folder(tmp_path)
    whole, image = read(folder), folder / "02.png"
    if damage == "size":  # a thumbnail
        write_image(image, np.zeros((8, 8), np.uint16))
    else:
        image.write_bytes(image.read_bytes()[:200] if damage == "cut" else b"<html>404</html>")
    seen = read(folder)
    assert "02.png" not in seen.files
    assert len(seen.files) == len(whole.files) - 1
    assert seen.findings[0].startswith("02.png was left out: it")
    for light in range(len(seen.files)):
        (folder / seen.files[light]).write_bytes(b"no image")
    with pytest.raises(InputError, match="not readable as an image"):
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
