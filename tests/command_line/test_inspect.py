"""Tests the figure and the command that show an image as numbers."""

import json
from functools import partial

import numpy as np
import pytest
from commands import called

import jaxvision
from jaxvision import plots
from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

RNG = np.random.default_rng(12)
CODES = RNG.integers(1, 255, size=(20, 30, 3), dtype=np.uint8)
CODES[2, 3] = 255
CODES[4, 5:7, 0] = 0


run = partial(called, app)


@pytest.fixture
def picture(tmp_path):
    write_image(tmp_path / "picture.png", CODES)
    return tmp_path / "picture.png"


def test_the_version_is_the_packages():
    assert run("--version") == (0, f"jaxvision {jaxvision.__version__}\n", "")


# ------------------------------------------------ numbers


def test_summary_is_numpys():
    bands = plots.summarise(CODES)
    assert [band.name for band in bands] == ["red", "green", "blue"]
    for i, band in enumerate(bands):
        values = CODES[..., i]
        assert (band.minimum, band.maximum) == (values.min(), values.max())
        np.testing.assert_allclose(
            (band.mean, band.standard_deviation, band.median),
            (values.mean(), values.std(), np.median(values)),
        )
        assert (band.black, band.saturated) == ((values == 0).sum(), (values == 255).sum())
    assert bands[0].black == 2


def test_undefined_values_are_counted_apart():
    image = np.array([[np.nan, np.inf, -1.0], [0.0, 0.5, 1.0]], np.float32)
    (band,) = plots.summarise(image)
    assert (band.nan, band.infinite, band.black, band.saturated) == (1, 1, 2, 2)
    assert (band.minimum, band.maximum, band.mean) == (-1.0, 1.0, 0.125)
    assert plots.summarise(image, white=0.4)[0].saturated == 3
    assert np.isnan(plots.summarise(np.full((2, 2), np.nan))[0].mean)


# ------------------------------------------------ figure


def panels(figure):
    return {axis.get_title().split(":")[0].split(" (")[0]: axis for axis in figure.axes}


def test_the_five_views_show_the_image():
    views = panels(plots.inspect(CODES, row=4, at=(10, 12), title="a.png"))
    assert {"picture", "histogram", "scan line", "values", "surface", "in numbers"} == set(views)
    for band, line in enumerate(views["scan line"].lines):
        np.testing.assert_array_equal(line.get_ydata(), CODES[4, :, band])
    printed = [text.get_text() for text in views["values"].texts]
    expected = ["\n".join(map(str, CODES[i, j])) for i in range(7, 14) for j in range(9, 16)]
    assert printed == expected
    counts = views["histogram"].patches[1].get_data().values
    np.testing.assert_array_equal(counts, np.bincount(CODES[..., 1].ravel(), minlength=256))


@pytest.mark.slow
@pytest.mark.parametrize(
    "image",
    [
        np.zeros((1, 1), np.uint8),
        np.full((3, 4), np.nan),
        (RNG.random((5, 90)) * 65535).astype(np.uint16),
        np.exp(RNG.normal(0, 4, size=(9, 8, 3))).astype(np.float32),
        RNG.random((6, 7, 4)).astype(np.float32),
        RNG.random((6, 7, 5)),
        -RNG.random((6, 7, 2)),
    ],
    ids=["pixel", "nan", "16 bit", "hdr", "rgba", "spectral", "negative"],
)
def test_every_kind_of_image_is_drawn(image, tmp_path):
    figure = plots.inspect(image)
    figure.savefig(tmp_path / "figure.png", dpi=40)
    assert (tmp_path / "figure.png").stat().st_size > 5000


def test_a_tall_bin_is_noted_instead_of_squeezing_the_rest():
    mostly_black = CODES.copy()
    mostly_black[:15] = 0
    axis = panels(plots.inspect(mostly_black))["histogram"]
    words = [text.get_text() for text in axis.texts]
    assert [line.split(",")[0] for line in words] == ["red", "green", "blue"]
    assert all("highest bin: 45" in line for line in words)
    assert axis.get_ylim()[1] < 100


def test_alpha_does_not_set_the_height_of_the_histogram():
    opaque = np.dstack([CODES, np.full((20, 30), 255, np.uint8)])
    axis = panels(plots.inspect(opaque))["histogram"]
    assert axis.get_ylim()[1] < 20
    assert [text.get_text() for text in axis.texts] == ["alpha, highest bin: 600 at 255"]


def test_nan_stands_at_the_mean_of_the_surface():
    image = np.full((6, 6), 5.0)
    image[2, 3], image[0, 0] = np.nan, np.inf
    axis = panels(plots.inspect(image))["surface"]
    np.testing.assert_allclose(axis.zz_viewLim.intervalx, 5, atol=0.5)


def test_limits_of_the_figure_are_named():
    def how(image):
        return next(
            axis.get_title() for axis in plots.inspect(image).axes if "picture" in axis.get_title()
        )

    assert how(np.full((3, 3), -0.5)) == "picture (as stored, below 0 black)"
    assert how(np.full((3, 3), 0.5)) == "picture (as stored)"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: plots.inspect(CODES, row=20), "row 20 is outside.*0 to 19"),
        (lambda: plots.inspect(CODES, at=(3, 30)), r"\(3, 30\) is outside.*columns 0 to 29"),
        (lambda: plots.inspect(np.zeros(5)), r"got \(5,\)"),
        *(
            (lambda white=white: plots.summarise(CODES, white=white), f"white = {white:g} must be")
            for white in (np.nan, 0.0, -1.0, np.inf)
        ),
        (lambda: plots.summarise(np.zeros((0, 2))), r"got \(0, 2\)"),
        (lambda: plots.summarise(np.array([["a"]])), "<U1"),
    ],
)
def test_images_that_cannot_be_shown_are_one_sentence(call, words):
    with pytest.raises(InputError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


# ------------------------------------------------ command


@pytest.mark.slow
def test_the_command_prints_a_table_and_draws(picture, tmp_path):
    status, stdout, _ = run("inspect", picture, "--out", tmp_path / "new" / "figure.png")
    assert status == 0
    assert "20 × 30 × 3, uint8" in stdout
    assert all(word in stdout for word in ("red", "saturated", "figure.png"))
    assert all(len(line) <= 80 for line in stdout.splitlines() if "figure" not in line)
    assert (tmp_path / "new" / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_json_holds_the_same_numbers(picture):
    status, stdout, _ = run("inspect", picture, "--json", "--white", "200")
    sheet = json.loads(stdout)
    assert status == 0
    assert (sheet["shape"], sheet["dtype"]) == ([20, 30, 3], "uint8")
    assert sheet["bands"][2]["saturated"] == int((CODES[..., 2] >= 200).sum())
    assert sheet["bands"][1]["median"] == np.median(CODES[..., 1])


def test_json_of_an_all_nan_image_is_valid(tmp_path):
    np.save(tmp_path / "nan.npy", np.full((2, 3), np.nan))
    status, stdout, _ = run("inspect", tmp_path / "nan.npy", "--json")
    assert status == 0
    assert json.loads(stdout)["bands"][0]["mean"] is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--row", "20"], "row 20 is outside"),
        (["--at", "3,30"], "(3, 30) is outside"),
        (["--at", "3"], "--at 3: give a row and a column"),
        (["--out", "figure.bmp"], "unknown figure suffix '.bmp'"),
    ],
)
def test_bad_options_exit_with_2_and_one_sentence(picture, options, words):
    status, stdout, stderr = run("inspect", picture, *options)
    assert (status, stdout) == (2, "")
    assert stderr.startswith("jaxvision: ")
    assert words in stderr
    assert stderr.count("\n") == 1


def test_unreadable_files_exit_with_2_and_one_sentence(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    np.save(tmp_path / "line.npy", np.zeros(4))
    for name, words in (
        ("none.png", "no such"),
        ("text.png", "not readable"),
        ("line.npy", "(4,)"),
    ):
        status, _, stderr = run("inspect", tmp_path / name)
        assert status == 2
        assert words in stderr
        assert stderr.count("\n") == 1
