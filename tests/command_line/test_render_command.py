"""Tests `jaxvision render`: the files that it writes, how it continues after a kill, and that tiles
are invisible."""

import json
import re
import warnings
from functools import partial

import jax
import numpy as np
import OpenImageIO as oiio
import pytest
from commands import called
from scene_texts import BALL

from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.images import read_image
from jaxvision.files.scenes import read_scene
from jaxvision.files.scenes.schema import override_settings
from jaxvision.render_command import job, pruning
from jaxvision.render_command.tiles import PartialImage, PartialSum
from jaxvision.rendering import render

K = {"scene": "a", "seed": 1}
SCENE = "[render]\ntile = 100\n" + BALL.replace("[6, 8]", "[18, 26]").replace(
    "[[surface]]", '[[surface]]\nname = "ball"'
).replace("[0.2, 0.2, 0.2]", "[0.2, 0.5, 0.7]").replace("[10, 10, 10]", "[10, 20, 30]")


run = partial(called, app, "render")


def head(path):
    source = oiio.ImageInput.open(str(path))
    spec = source.spec()
    source.close()
    return spec.channelnames, {a.name: a.value for a in spec.extra_attribs}


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Return the folder of a scene, its EXR and its preview."""
    folder = tmp_path_factory.mktemp("render")
    (folder / "ball.toml").write_text(SCENE)
    status, out, _ = run(folder / "ball.toml", "--out", folder / "ball.exr")
    assert status == 0
    assert "ball.exr" in out
    assert "ball.png" in out
    return folder


@pytest.mark.slow
def test_the_picture_in_the_file_equals_render(rendered):
    """The picture rendered in tiles and read from the file equals the one rendered at once."""
    source = read_scene(rendered / "ball.toml")
    expected = jax.jit(render)(source.scene, source.view)
    np.testing.assert_allclose(read_image(rendered / "ball.exr"), expected, rtol=2e-6, atol=1e-7)
    assert sorted(file.name for file in rendered.iterdir()) == ["ball.exr", "ball.png", "ball.toml"]


def test_the_header_describes_the_picture(rendered):
    channels, attributes = head(rendered / "ball.exr")
    assert channels == ("R", "G", "B")
    assert attributes["jaxvision:unit"] == "W m^-2 sr^-1"
    assert attributes["jaxvision:seed"] == 0
    assert attributes["jaxvision:integrator"] == "direct"
    assert attributes["jaxvision:sceneSha256"] == read_scene(rendered / "ball.toml").digest
    assert attributes["Software"].startswith("jaxvision ")
    assert 0 < float(attributes["jaxvision:seconds"]) < 60


@pytest.mark.slow
@pytest.mark.filterwarnings("always:.*every pixel is black")
def test_a_black_picture_is_named(tmp_path):
    (tmp_path / "away.toml").write_text(SCENE.replace("target = [0, 0, 0]", "target = [0, -8, 0]"))
    status, _, said = run(tmp_path / "away.toml", "--out", tmp_path / "a.exr")
    assert status == 0
    assert "every pixel is black: the camera sees no surface" in said


@pytest.mark.filterwarnings("always:.*pixels are infinite")
def test_infinite_pixels_are_named(tmp_path):
    bright = SCENE.replace("[10, 20, 30]", "[3e38, 1, 1]").replace("[1, -2, 3]", "[0, -1.01, 0]")
    (tmp_path / "bright.toml").write_text(bright)
    status, _, said = run(tmp_path / "bright.toml", "--out", tmp_path / "a.exr")
    assert status == 0
    assert re.search(r"a.exr: \d+ pixels are infinite or NaN; reduce the power", said)


def test_surfaces_that_coincide_are_named(tmp_path):
    again = BALL[BALL.index("[[surface]]") : BALL.index("[[light]]")]
    (tmp_path / "a.toml").write_text(BALL + again.replace("radius = 1", "radius = 1.5"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_scene(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_text(BALL + again)
    with pytest.warns(UserWarning, match=r"surface\[2\]: lies exactly where surface\[1\] lies"):
        read_scene(tmp_path / "a.toml")


def test_the_preview_follows_its_rule(rendered):
    """In the preview, 95 % of the pixels that are not black are below .8 of white, in 8-bit sRGB
    (IEC 61966-2-1)."""
    radiance = read_image(rendered / "ball.exr").astype(float)
    luminance = radiance @ [0.212639, 0.715169, 0.072192]
    linear = np.clip(radiance / (np.quantile(luminance[luminance > 0], 0.95) / 0.8), 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = read_image(rendered / "ball.png")
    assert shown.dtype == np.uint8
    assert np.abs(shown - 255 * encoded).max() <= 0.51


@pytest.mark.slow
@pytest.mark.parametrize("tile", [7, 26, 468, 5000])
def test_the_picture_does_not_depend_on_its_tiles(rendered, tmp_path, tile):
    status, *_ = run(
        rendered / "ball.toml", "--out", tmp_path / "a.exr", "--tile", tile, "--no-preview"
    )
    assert status == 0
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), read_image(rendered / "ball.exr"))
    assert not (tmp_path / "a.png").exists()


def stop_after(monkeypatch, tiles, error=KeyboardInterrupt):
    """Let a render append this many tiles and then fail."""
    whole = PartialImage.append
    count = iter(range(1000))

    def append(self, values):
        if next(count) == tiles:
            raise error
        whole(self, values)

    monkeypatch.setattr(PartialImage, "append", append)


@pytest.mark.slow
def test_a_render_interrupted_before_its_first_tile_offers_no_continuation(tmp_path, monkeypatch):
    stop_after(monkeypatch, 0)
    status, _, error = run("cornell_box", "--resolution", "2,2", "--out", tmp_path / "a.exr")
    assert status == 130
    assert "a.exr: interrupted; the same command starts again: nothing was computed" in error


@pytest.mark.slow
def test_an_interrupted_render_says_how_to_continue_and_continues(rendered, tmp_path, monkeypatch):
    command = rendered / "ball.toml", "--out", tmp_path / "a.exr"
    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        status, _, error = run(*command)
    assert status == 130
    assert "a.exr: interrupted; the same command goes on from there" in error
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr.partial"]

    computed = []
    original = job.pixels_of

    def counting(*arguments, **options):
        compute = original(*arguments, **options)
        return lambda rows, columns: computed.append(1) or compute(rows, columns)

    monkeypatch.setattr(job, "pixels_of", counting)
    assert run(*command)[0] == 0
    assert len(computed) == 3
    assert (read_image(tmp_path / "a.exr") == read_image(rendered / "ball.exr")).all()
    assert not (tmp_path / "a.exr.partial").exists()
    heads = [head(file)[1] for file in (tmp_path / "a.exr", rendered / "ball.exr")]
    assert all(float(own.pop("jaxvision:seconds")) > 0 for own in heads)
    assert heads[0] == heads[1]


def test_a_stale_part_is_refused_until_overwriting_is_allowed(rendered, tmp_path, monkeypatch):
    command = rendered / "ball.toml", "--out", tmp_path / "a.exr"
    with monkeypatch.context() as patch:
        stop_after(patch, 1)
        run(*command)
    changes = (
        (["--seed", 3], "seed"),
        (["--tile", 50], "tile"),
        (["--resolution", "9,13", "--samples", 2], "resolution and another samples"),
        (["--integrator", "light"], "integrator and another samples and another depth"),
    )
    for change, names in changes:
        status, _, error = run(*command, *change)
        assert status == 2
        assert f"a.exr.partial: holds part of a render with another {names}" in error
    with monkeypatch.context() as patch:
        patch.setattr(job, "__version__", "0.0")
        assert "another version of jaxvision; add --fresh" in run(*command)[2]
    (tmp_path / "b.toml").write_text(SCENE.replace("radius = 1", "radius = 0.9"))
    _, _, error = run(tmp_path / "b.toml", "--out", tmp_path / "a.exr")
    assert "another scene; add --fresh" in error
    status, *_ = run(*command, "--resolution", "9,13", "--fresh")
    assert status == 0
    assert read_image(tmp_path / "a.exr").shape == (9, 13, 3)


QUAD = """
[[surface]]
name = "floor"
shape = "quad"
corner = [-3, -3, -1]
edge_u = [6, 0, 0]
edge_v = [0, 6, 0]
material = "grey"
"""


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["rays", "path", "radiosity"])
def test_the_picture_does_not_depend_on_its_tiles_by_any_integrator(tmp_path, integrator):
    (tmp_path / "a.toml").write_text(SCENE + QUAD)
    pictures = []
    for tile in (7, 300):
        out = tmp_path / f"{tile}.exr"
        command = tmp_path / "a.toml", "--out", out, "--tile", tile, "--no-preview"
        assert run(*command, "--integrator", integrator, "--samples", 2)[0] == 0
        pictures.append(read_image(out))
    assert pictures[0].max() > 0
    np.testing.assert_array_equal(*pictures)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_passes_continue_after_an_interrupt(tmp_path, monkeypatch):
    """Light tracing is a mean of passes. After an interrupt between passes, the final picture is
    bit-identical."""
    (tmp_path / "a.toml").write_text(SCENE.replace("[18, 26]", "[6, 8]") + QUAD)
    options = tmp_path / "a.toml", "--integrator", "light", "--samples", 3, "--depth", 2
    assert run(*options, "--out", tmp_path / "whole.exr")[0] == 0
    add, count = PartialSum.add, iter(range(9))

    def failing(self, picture):
        if next(count) == 1:
            raise KeyboardInterrupt
        add(self, picture)

    with monkeypatch.context() as patch:
        patch.setattr(PartialSum, "add", failing)
        assert run(*options, "--out", tmp_path / "a.exr")[0] == 130
    status, _, error = run(*options, "--out", tmp_path / "a.exr", "--seed", 1)
    assert (status, "holds part of a render with another seed" in error) == (2, True)
    status, _, error = run(*options, "--out", tmp_path / "a.exr", "--tile", 9)
    assert (status, "--tile has no effect" in error) == (0, True)
    assert (read_image(tmp_path / "a.exr") == read_image(tmp_path / "whole.exr")).all()
    assert not list(tmp_path.glob("*.partial"))


def test_the_stated_error_of_a_render_is_the_scatter_of_its_samples(rendered, tmp_path):
    """The stated error equals the scatter of renders with single samples and other seeds, and the
    printed line gives it in the norm of `--accuracy`."""
    command = rendered / "ball.toml", "--integrator", "path", "--depth", 2, "--no-preview"
    singles = []
    for seed in range(24):
        out = tmp_path / f"{seed}.exr"
        assert run(*command, "--samples", 1, "--seed", seed, "--out", out)[0] == 0
        singles.append(read_image(out))
    status, told, _ = run(*command, "--samples", 24, "--out", tmp_path / "a.exr")
    assert status == 0
    error = read_image(tmp_path / "a.exr", part="error").astype(float)
    expected = np.std(singles, axis=0, ddof=1) / np.sqrt(24)
    assert np.sqrt((error**2).mean() / (expected**2).mean()) == pytest.approx(1, abs=0.15)
    radiance = read_image(tmp_path / "a.exr").astype(float)
    share = np.sqrt((error**2).mean() / (radiance**2).mean())
    bound = f"usually at most {100 * share:.2g} % of the rms radiance"
    assert f"24 samples a pixel: standard error {bound}" in told
    assert float(head(tmp_path / "a.exr")[1]["jaxvision:relativeError"]) == pytest.approx(
        share, rel=1e-2
    )


def test_a_single_ray_has_no_error(rendered, tmp_path):
    _, told, _ = run(rendered / "ball.toml", "--out", tmp_path / "a.exr", "--no-preview")
    assert "1 sample a pixel: no standard error, " in told
    assert head(tmp_path / "a.exr")[0] == ("R", "G", "B")


@pytest.mark.slow
def test_the_error_of_passes_is_that_of_their_pictures(tmp_path):
    (tmp_path / "a.toml").write_text(SCENE.replace("[18, 26]", "[6, 8]") + QUAD)
    options = tmp_path / "a.toml", "--integrator", "light", "--depth", 2, "--samples"
    assert run(*options, 1, "--out", tmp_path / "one.exr")[0] == 0
    assert run(*options, 2, "--out", tmp_path / "two.exr")[0] == 0
    first, mean = (read_image(tmp_path / name).astype(float) for name in ("one.exr", "two.exr"))
    error = read_image(tmp_path / "two.exr", part="error")
    np.testing.assert_allclose(error, np.abs(first - mean), rtol=1e-4, atol=1e-6)


@pytest.mark.slow
def test_every_integrator_sees_the_same_direct_light(tmp_path):
    """A convex ball under a point light has only direct light."""
    (tmp_path / "a.toml").write_text(SCENE.replace("[18, 26]", "[12, 16]"))
    pictures = {}
    for name in ("direct", "rays", "path", "light", "radiosity"):
        out = tmp_path / f"{name}.exr"
        samples = {"path": 64, "light": 64}.get(name, 1)
        status, _, error = run(
            tmp_path / "a.toml", "--integrator", name, "--samples", samples, "--out", out
        )
        assert status == 0, error
        pictures[name] = read_image(out)
    np.testing.assert_allclose(pictures["rays"], pictures["direct"], rtol=1e-5, atol=1e-6)
    inside = np.s_[5:7, 7:9]
    np.testing.assert_allclose(pictures["path"][inside], pictures["direct"][inside], rtol=0.05)
    for name in ("path", "light", "radiosity"):
        means = [pictures[key].mean(axis=(0, 1)) for key in (name, "direct")]
        np.testing.assert_allclose(*means, rtol=0.1)


def test_a_folder_is_no_image(rendered, tmp_path):
    """The refusal comes before anything is rendered."""
    (tmp_path / "a.exr").mkdir()
    (tmp_path / "a.png").mkdir()
    for out, name in (("a.exr", "a.exr"), ("b.exr", "a.png")):
        options = "--out", tmp_path / out, "--preview", tmp_path / "a.png"
        status, _, error = run(rendered / "ball.toml", *options)
        assert (status, error.count("\n")) == (2, 1)
        assert f"{name}: is a folder; choose another name" in error
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.exr", "a.png"]


def test_another_integrator_has_its_own_samples_and_depth():
    """The samples and depth of a scene are for its own integrator. Values given to the command
    always count."""
    own = read_scene("glass_and_mirror").render
    assert (own.integrator, own.samples, own.depth) == ("path", 128, 10)
    same = override_settings(own, {"integrator": "path", "samples": None})
    assert (same.samples, same.depth) == (128, 10)
    rays = override_settings(own, {"integrator": "rays", "depth": None})
    assert (rays.samples, rays.depth) == (1, 16)
    assert override_settings(own, {"integrator": "rays", "samples": 4, "seed": 3}).samples == 4


def test_what_an_integrator_refuses_is_named_as_in_the_file(rendered, tmp_path):
    text = SCENE.replace('"lambert"\nalbedo', '"mirror"\nreflectance')
    (tmp_path / "a.toml").write_text(text)
    status, _, error = run(
        tmp_path / "a.toml", "--out", tmp_path / "a.exr", "--integrator", "radiosity"
    )
    assert status == 2
    assert 'a.toml: surface "ball".material must be Lambert' in error
    (tmp_path / "b.toml").write_text(SCENE.replace("[render]", '[render]\nrule = "balanced"'))
    status, _, error = run(tmp_path / "b.toml", "--out", tmp_path / "a.exr", "--integrator", "rays")
    assert status == 2
    assert "rule = 'balanced'; set rule = 'quadrature'" in error
    glow = '[[surface]]\nname = "glow"\nshape = "plane"\npoint = [0, 0, -2]\nnormal = [0, 0, 1]\n'
    (tmp_path / "c.toml").write_text(SCENE + glow + "emission = 1\n")
    out = tmp_path / "made" / "a.exr"
    status, _, error = run(tmp_path / "c.toml", "--out", out, "--integrator", "light")
    assert status == 2
    assert 'c.toml: surface "glow" shines without end' in error
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.toml", "b.toml", "c.toml"]


WALLS = [
    ([0, 0, 0], [1, 0, 0], [0, 1, 0]),
    ([0, 0, 1], [0, 1, 0], [1, 0, 0]),
    ([0, 0, 0], [0, 1, 0], [0, 0, 1]),
    ([1, 0, 0], [0, 0, 1], [0, 1, 0]),
    ([0, 0, 0], [0, 0, 1], [1, 0, 0]),
    ([0, 1, 0], [1, 0, 0], [0, 0, 1]),
]
ROOM = SCENE[: SCENE.index("[[surface]]")].replace("[18, 26]", "[4, 5]")
ROOM = ROOM.replace("[0, -4, 0.5]", "[0.5, 0.5, 0.1]").replace("[0, 0, 0]", "[0.5, 0.6, 1]")
ROOM = ROOM.replace("tile = 100", 'tile = 20\nintegrator = "radiosity"\npatches = 24')
ROOM += "".join(
    f'[[surface]]\nname = "wall {i}"\nshape = "quad"\ncorner = {corner}\nedge_u = {u}\n'
    f'edge_v = {v}\nmaterial = "grey"\n'
    for i, (corner, u, v) in enumerate(WALLS)
)
ROOM += '[[light]]\nkind = "point"\nposition = [0.4, 0.5, 0.6]\nintensity = [1, 1, 1]\n'


@pytest.mark.slow
def test_the_final_gather_of_radiosity(tmp_path):
    """The final gather has no tiles and depends on the seed. Its mean over the picture includes the
    light that is otherwise interpolated."""
    (tmp_path / "a.toml").write_text(ROOM)
    pictures = {}
    for name, options in {
        "none": (),
        "gather": ("--gather", 16),
        "tiles": ("--gather", 16, "--tile", 7),
        "seed": ("--gather", 16, "--seed", 1),
    }.items():
        out = tmp_path / f"{name}.exr"
        assert run(tmp_path / "a.toml", "--out", out, "--no-preview", *options)[0] == 0
        pictures[name] = read_image(out)
    np.testing.assert_array_equal(pictures["gather"], pictures["tiles"])
    assert (pictures["gather"] != pictures["seed"]).any()
    for name in ("gather", "seed"):
        np.testing.assert_allclose(
            pictures[name].mean((0, 1)), pictures["none"].mean((0, 1)), rtol=0.05
        )
    status, _, error = run(tmp_path / "a.toml", "--out", tmp_path / "b.exr", "--gather", -1)
    assert (status, error.count("\n")) == (2, 1)
    assert "gather = -1: must be greater than or equal to 0" in error


@pytest.mark.slow
def test_light_that_grows_without_limit_is_named(tmp_path):
    """A closed room that is white in one band has no equilibrium. The grey room of the test above
    has one."""
    (tmp_path / "a.toml").write_text(ROOM.replace("0.5, 0.7]", "1, 0.7]", 1))
    status, _, error = run(tmp_path / "a.toml", "--out", tmp_path / "a.exr")
    assert (status, error.count("\n")) == (2, 1)
    assert 'a.toml: surface "wall 0".material has albedo 1 in a closed room' in error
    assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]


def test_missing_folders_are_made_and_others_named(rendered, tmp_path):
    scene = rendered / "ball.toml"
    options = "--out", tmp_path / "a" / "b" / "c.exr", "--preview", tmp_path / "d" / "e.tif"
    assert run(scene, *options)[0] == 0
    assert read_image(tmp_path / "d" / "e.tif").dtype == np.uint8
    for out in (tmp_path / "d" / "e.tif" / "a.exr", "/proc/a.exr"):
        status, _, error = run(scene, "--out", out)
        assert (status, error.count("\n")) == (2, 1)
        assert f"{out}: cannot be written" in error


@pytest.mark.slow
def test_bands_that_are_wavelengths_have_names(tmp_path):
    text = "wavelengths = {first = 400, last = 1000, step = 300}\n" + SCENE
    text = text.replace("[0.2, 0.5, 0.7]", "0.5").replace("[10, 20, 30]", "[1, 2, 4]")
    (tmp_path / "a.toml").write_text(text)
    assert run(tmp_path / "a.toml", "--out", tmp_path / "a.exr")[0] == 0
    channels, attributes = head(tmp_path / "a.exr")
    assert channels == ("S0.0400,0nm", "S0.0700,0nm", "S0.1000,0nm")
    assert attributes["jaxvision:unit"] == "W m^-2 sr^-1 per m"
    pixels = read_image(tmp_path / "a.exr")
    lit = pixels[..., 0] > 0
    np.testing.assert_allclose(pixels[lit] / pixels[lit][:, :1], [[1, 2, 4]] * lit.sum(), rtol=1e-5)
    assert read_image(tmp_path / "a.png").shape == (18, 26, 3)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["cornel_box", "--out", "a.exr"], "nearest is 'cornell_box'"),
        (["cornell_box", "--out", "a.png"], "a render holds radiance and is written as EXR"),
        (["cornell_box", "--out", "a.exr", "--resolution", "9"], "--resolution 9: give a row"),
        (["cornell_box", "--out", "a.exr", "--resolution", "0,9"], "at least one pixel"),
        (["none.toml", "--out", "a.exr"], "none.toml: no such scene file"),
        (["cornell_box", "--out", "."], "a render holds radiance and is written as EXR"),
        (["cornell_box", "--out", "a.exr", "--preview", "a.xyz"], "unknown image suffix '.xyz'"),
        (["cornell_box", "--out", "a.exr", "--preview", "b.exr"], "uint8 pixels do not fit .exr"),
        (["cornell_box", "--out", "a.exr", "--samples", "0"], "samples = 0: must be greater than"),
        (["cornell_box", "--out", "a.exr", "--integrator", "pth"], "the nearest is 'path'"),
        (["cornell_box", "--out", "a.exr", "--gather", "4"], "gather = 4 is of radiosity alone"),
        (["cornell_box", "--out", "a.exr", "--resolution", "1000000,1000000"], "lower the resol"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    status, out, error = run(*arguments)
    assert status == 2
    assert out == ""
    assert sentence in error
    assert error.startswith("jaxvision: ")
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------ the file of finished tiles


def test_a_part_counts_whole_tiles_only(tmp_path):
    """If the file is cut anywhere, or a byte is changed, the render continues after the last whole
    tile."""
    tiles = np.random.default_rng(1).normal(size=(4, 6)).astype(np.float32)
    path = tmp_path / "a.partial"
    with PartialImage(path, key=K, values=6, fresh=False) as part:
        assert not path.exists()
        for values in tiles:
            part.append(values)
    data = path.read_bytes()
    first = data.index(b"\n") + 1
    assert json.loads(data[:first]) == {"render": K, "values": 6}
    for cut in range(len(data)):
        path.write_bytes(data[:cut])
        with PartialImage(path, key=K, values=6, fresh=False) as part:
            assert part.done == max(cut - first, 0) // 28
            for index in range(part.done):
                assert (part.tile(index) == tiles[index]).all()
    damaged = bytearray(data)
    damaged[first + 30] ^= 1
    path.write_bytes(damaged)
    with PartialImage(path, key=K, values=6, fresh=False) as part:
        assert part.done == 1
    other = {"scene": "b", "seed": 2}
    with pytest.raises(InputError, match="part of a render with another scene and another seed"):
        PartialImage(path, key=other, values=6, fresh=False)
    with PartialImage(path, key=other, values=6, fresh=True) as part:
        assert part.done == 0
    path.write_bytes(data[:first])
    with PartialImage(path, key=other, values=6, fresh=False) as part:
        assert part.done == 0  # a file without a tile contains no result to lose
    path.write_bytes(b"a line\nand another")
    with pytest.raises(InputError, match="holds something else than part of this render"):
        PartialImage(path, key=K, values=6, fresh=False)


def test_a_sum_continues_after_its_last_whole_pass(tmp_path):
    """The sum is continued in float64 and equals the uninterrupted one bit by bit."""
    pictures = np.random.default_rng(3).normal(size=(3, 2, 4, 3)).astype(np.float32)
    path = tmp_path / "a.partial"
    for done, picture in enumerate(pictures):
        part = PartialSum(path, key=K, shape=(2, 4, 3), fresh=False)
        assert part.done == done
        part.add(picture)
    part = PartialSum(path, key=K, shape=(2, 4, 3), fresh=False)
    expected = (pictures[0].astype(float) + pictures[1]) + pictures[2]
    np.testing.assert_array_equal(part.total, expected)
    for other, sentence in (
        ({**K, "seed": 2}, "part of a render with another seed; add"),
        ({"scene": "a"}, "part of a render with another seed; add"),
    ):
        with pytest.raises(InputError, match=sentence):
            PartialSum(path, key=other, shape=(2, 4, 3), fresh=False)
        assert PartialSum(path, key=other, shape=(2, 4, 3), fresh=True).done == 0
    path.write_bytes(path.read_bytes().replace(b'"scene"', b'"sc\\nne"'))
    with pytest.raises(InputError, match="part of a render with another scene; add"):
        PartialSum(path, key=K, shape=(2, 4, 3), fresh=False)
    part.delete()
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_sum_starts_again(tmp_path):
    """If the file is cut anywhere, or any bit is changed, the result is its sum, nothing, or one
    sentence."""
    path = tmp_path / "a.partial"
    PartialSum(path, key=K, shape=(1, 2, 3), fresh=False).add(np.ones((1, 2, 3)))
    data = path.read_bytes()
    first = data.index(b"\n") + 1
    damaged = [data[:cut] for cut in range(len(data))]
    for bit in range(8 * len(data)):
        turned = bytearray(data)
        turned[bit // 8] ^= 1 << bit % 8
        damaged.append(bytes(turned))
    begun = 0
    for content in damaged:
        path.write_bytes(content)
        try:
            part = PartialSum(path, key=K, shape=(1, 2, 3), fresh=False)
        except InputError:  # as for another render
            assert content[:first] != data[:first]
            continue
        assert (part.done, part.total.sum()) == (0, 0)
        begun += 1
    assert begun >= 9 * (len(data) - first)


@pytest.mark.parametrize("at_once", [1, 3, 64])
@pytest.mark.parametrize("tile", [4, 7, 35, 40])
def test_rows_come_out_as_tiles_went_in(tmp_path, tile, at_once):
    picture = np.arange(5 * 7 * 2, dtype=np.float32).reshape(35, 2)
    with PartialImage(tmp_path / "p", key=K, values=tile * 2, fresh=False) as part:
        for start in range(0, 35, tile):
            part.append(picture[np.minimum(start + np.arange(tile), 34)])
        blocks = list(part.rows(7, 2, 5, at_once=at_once))
    np.testing.assert_array_equal(np.concatenate(blocks), picture.reshape(5, 7, 2))


@pytest.mark.slow
def test_missing_light_is_named_in_the_output_and_the_header(tmp_path):
    """Paths cannot find the light that a mirror reflects from a point lamp. The command and the
    header of the picture say so."""
    text = SCENE.replace("tile = 100", 'integrator = "path"\nsamples = 1')
    mirror = '[material.silver]\nfamily = "mirror"\nreflectance = [0.9, 0.9, 0.9]\n'
    plate = (
        '[[surface]]\nname = "plate"\nshape = "plane"\npoint = [0, 0, -2]\nnormal = [0, 0, 1]\n'
        'material = "silver"\n'
    )
    (tmp_path / "scene.toml").write_text(text + mirror + plate)
    status, _, error = run(tmp_path / "scene.toml", "--out", tmp_path / "o.exr", "--no-preview")
    words = 'Missing: light of light[1] that reaches other surfaces by way of surface "plate".'
    assert status == 0
    assert words in error
    assert words in head(tmp_path / "o.exr")[1]["jaxvision:lacks"]


def test_too_little_time_to_choose_still_makes_a_picture(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    chosen = "--accuracy", "5%", "--measure", "1e-3"
    status, _, error = run(tmp_path / "scene.toml", "--out", tmp_path / "o.exr", *chosen)
    assert status == 0
    assert "within 0.001 s; allow more time to measure." in error
    assert "Rendered with the scene's own settings." in error
    assert (tmp_path / "o.exr").exists()


def far_balls(count):
    """Return the text of a scene's balls outside the view."""
    turns = np.linspace(0.3, 0.7, count) * 2 * np.pi
    return "".join(
        f'[[surface]]\nshape = "sphere"\ncentre = [{99 * np.sin(t):.6g}, {99 * np.cos(t) - 200:.6g}'
        ', 0]\nradius = 1\nmaterial = "grey"\n'
        for t in turns
    )


@pytest.mark.slow
def test_negligible_objects_are_left_out_unless_all_are_requested(tmp_path, monkeypatch):
    floor = (
        '[[surface]]\nshape = "quad"\ncorner = [-2, -2, -1]\nedge_u = [4, 0, 0]\n'
        'edge_v = [0, 4, 0]\nmaterial = "grey"\n'
    )
    (tmp_path / "scene.toml").write_text(SCENE + floor + far_balls(8))
    command = tmp_path / "scene.toml", "--no-preview", "--out"
    assert "Left out" not in run(*command, tmp_path / "less.exr")[1]  # a small picture
    monkeypatch.setattr(pruning, "looking_pays", lambda *_, **__: True)
    status, said, _ = run(*command, tmp_path / "less.exr")
    assert status == 0
    assert "Left out what changes nothing: surfaces[2]" in said
    assert "and 5 more (--keep-all keeps it)." in said
    _, said, _ = run(*command, tmp_path / "all.exr", "--keep-all")
    assert "Left out" not in said
    less, whole = (read_image(tmp_path / name) for name in ("less.exr", "all.exr"))
    np.testing.assert_allclose(less, whole, rtol=1e-6)  # one band serves for three
    assert "surfaces[9]" in head(tmp_path / "less.exr")[1]["jaxvision:certificate"]
    with monkeypatch.context() as patch:
        stop_after(patch, 2)
        run(*command, tmp_path / "rest.exr")
    assert run(*command, tmp_path / "rest.exr")[0] == 0
    np.testing.assert_array_equal(less, read_image(tmp_path / "rest.exr"))
    # path tracing chooses emitters at random, so nothing is left out there
    text = (SCENE + floor + far_balls(8)).replace("tile = 100", 'integrator = "path"\nsamples = 1')
    (tmp_path / "path.toml").write_text(text)
    _, said, _ = run(tmp_path / "path.toml", "--no-preview", "--out", tmp_path / "path.exr")
    assert "Left out" not in said
    excluded = run(*command, tmp_path / "less.exr", "--keep-all", "--tolerance", "1%")
    assert "--keep-all and --tolerance exclude each other" in excluded[2]


@pytest.mark.slow
def test_workers_leave_out_negligible_objects(tmp_path, monkeypatch):
    monkeypatch.setattr(pruning, "looking_pays", lambda *_, **__: True)
    (tmp_path / "scene.toml").write_text(SCENE + far_balls(8))
    command = tmp_path / "scene.toml", "--no-preview", "--out"
    assert "Left out" in run(*command, tmp_path / "here.exr")[1]
    _, told, _ = run(*command, tmp_path / "there.exr", "--workers", 2)
    assert "Left out" in told
    # the time excludes compilation: 468 pixels of one ball take milliseconds, their program takes a
    # second
    took = re.search(
        r"no standard error, (\S+) s of work on [12] workers? and (\S+) s of comp", told
    )
    assert took is not None
    assert float(took[1]) < float(took[2])
    np.testing.assert_array_equal(
        *(read_image(tmp_path / name) for name in ("here.exr", "there.exr"))
    )
