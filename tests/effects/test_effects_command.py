"""Tests `jaxvision effects` and `render --tolerance`: the printed text and the file's header."""

import json
from functools import partial

import numpy as np
import OpenImageIO as oiio
import pytest
from commands import called
from scene_texts import BALL

from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.images import read_image

FAR_LAMP = """
[[light]]
kind = "point"
position = [0, -900, 0]
intensity = [1, 1, 1]
"""
SCENE = BALL.replace("[6, 8]", "[12, 16]") + FAR_LAMP


run = partial(called, app)


@pytest.fixture
def scene(tmp_path):
    file = tmp_path / "ball.toml"
    file.write_text(SCENE)
    return file


def test_effects_are_listed(scene):
    status, said, _ = run("effects", scene)
    assert status == 0
    assert "lights[1]" in said
    assert "shadows[0]" in said
    status, said, _ = run("effects", scene, "--json", "--free", "lights[1].intensity=0,5")
    found = {effect["name"]: effect for effect in json.loads(said)}
    assert status == 0
    assert found["lights[1]"]["free"]
    assert found["shadows[0]"]["rank"] == "exact"


@pytest.mark.slow
def test_the_time_of_each_effect_is_measured(scene):
    """A program is timed for each effect, except those that are kept because they are absent or
    have no simpler form."""
    status, said, _ = run("effects", scene, "--json", "--time")
    found = {effect["name"]: effect["seconds"] for effect in json.loads(said)}
    assert status == 0
    assert isinstance(found["lights[1]"], float)
    assert found["ambient"] is None
    status, said, _ = run("effects", scene, "--tolerance", "1%", "--time")
    assert status == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--tolerance", "lots"], "a tolerance is a number and its unit"),
        (["--tolerance", ""], "a tolerance is a number and its unit"),
        (["--tolerance", "1DN"], "needs a camera with a sensor"),
        (["--camera", "consumer_bayer"], "the camera has 31 bands and the scene 3"),
        (["--free", "lights[0].intensity"], "give a name and two numbers"),
        (["--free", "lights[0].intensty=0,1"], "the nearest is 'lights[0].intensity'"),
    ],
)
def test_mistakes_are_one_sentence(scene, arguments, sentence):
    status, _, said = run("effects", scene, *arguments)
    assert status == 2
    assert sentence in said
    assert said.count("\n") == 1


def test_place_is_passed_with_the_tolerance(scene, monkeypatch):
    def prune_scene(source, settings, goal, **asked):
        raise InputError(f"{goal.value:g} {goal.unit}, {goal.place:g} pixels.")

    monkeypatch.setattr("jaxvision.render_command.prune_scene", prune_scene)
    status, _, said = run("effects", scene, "--tolerance", "1%", "--place", "0.37")
    assert status == 2
    assert "0.01 relative, 0.37 pixels" in said


@pytest.mark.slow
def test_a_pruned_render_equals_the_whole_scene_within_its_tolerance(scene, tmp_path):
    whole, pruned = tmp_path / "whole.exr", tmp_path / "pruned.exr"
    assert run("render", scene, "--out", whole, "--no-preview")[0] == 0
    status, said, _ = run("render", scene, "--out", pruned, "--no-preview", "--tolerance", "1%")
    assert status == 0
    assert "Dropped 4 of 5" in said
    a, b = (np.asarray(read_image(file), float) for file in (whole, pruned))
    assert a.shape == b.shape
    assert 0 < np.abs(a - b).max() <= 0.01 * a.max()
    head = oiio.ImageInput.open(str(pruned)).spec()
    assert "lights[1]" in head.getattribute("jaxvision:certificate")


@pytest.mark.slow
def test_effects_that_may_be_left_out_are_listed_last(scene):
    _, said, _ = run("effects", scene, "--tolerance", "1%")
    assert said.splitlines()[-1].startswith("Dropped 4 of 5: at most")
    assert said.rstrip().endswith("% smaller.")
    _, said, _ = run("effects", scene, "--camera", "emva1288", "--tolerance", "0.5DN", "--json")
    assert json.loads(said)["unit"] == "DN"


@pytest.mark.slow
def test_effects_have_the_names_of_the_file_and_shares_in_per_cent():
    status, out, _ = called(app, "effects", "glass_and_mirror", "--tolerance", "1%")
    assert status == 0
    for words in ('lights[0] "lamp"', 'surfaces[2].material "glass ball"', "> 100 %"):
        assert words in out
    status, out, _ = called(app, "effects", "cornell_box", "--estimates")
    assert out.strip().splitlines()[-1].endswith(("is an estimate.", "are estimates."))
