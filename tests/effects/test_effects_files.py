"""Tests pruning of random scenes through the code that `render --tolerance` runs, with files on
disk, whole and pruned."""

from dataclasses import replace
from pathlib import Path

import jax
import pytest
from oracles.random_scenes import random_scene

import jaxvision as jv
from jaxvision.errors import InputError
from jaxvision.files.scenes import SceneFile
from jaxvision.files.scenes.schema import RenderEntry
from jaxvision.render_command import prune_scene, render_to_file
from jaxvision.render_command.pruning import pruned_scene
from jaxvision.transport import light_traced

SETTINGS = RenderEntry.model_validate({"dtype": "float64"})


def scene_file(seed):
    """Return a random scene as if it had been read from a file."""
    scene, view = random_scene(seed)
    first = scene.lights[0]
    bands = getattr(first, first.spectra[0]).shape[-1]
    shapes, lamps = (tuple(map(str, range(len(x)))) for x in (scene.surfaces, scene.lights))
    return SceneFile(
        Path(f"{seed}.toml"), scene, view, SETTINGS, bands, None, shapes, lamps, str(seed)
    )


@pytest.mark.slow
def test_light_tracing_keeps_a_lamp_behind_a_mirror():
    """A lamp shines only at a mirror, so it lights the floor only by paths that start at the
    lamp."""
    floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.3]))
    mirror = jv.Surface(jv.Quad([-1, -1, 3], [0, 2, 0], [2, 0, 0]), jv.Mirror([0.9]))
    scene = jv.Scene([floor, mirror], jv.SmallLight([0, 0, 1.5], [0, 0, 1], [5.0]))
    view = jv.Orthographic([0, 0, 1], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], 0.2, resolution=(4, 4))
    names = (("floor", "mirror"), ("lamp",), "mirror")
    lit = light_traced(jax.random.key(0), scene, view, paths=2000, depth=3, samples=1).radiance
    assert lit.mean() > 0.01
    for integrator, kept in ("light", True), ("path", False):
        settings = RenderEntry.model_validate({"integrator": integrator, "depth": 3})
        source = SceneFile(Path("m.toml"), scene, view, settings, 1, None, *names)
        pruned = prune_scene(source, settings, "1%", level=float(lit.max()))
        assert (len(pruned.scene.lights) == 1) == kept


@pytest.mark.parametrize("integrator", ["path", "light", "rays", "radiosity"])
def test_only_integrators_of_paths_are_cut(integrator):
    """The cost of radiosity and of trees of rays does not depend on the depth."""
    settings = RenderEntry.model_validate({"integrator": integrator})
    pruned = prune_scene(scene_file(3), settings, "50%", level=1e6)
    cut = integrator in ("path", "light")
    (row,) = (
        (e for e in pruned.certificate.dropped if e.name == "bounces")
        if cut
        else (e for e in pruned.certificate.kept if e.name == "bounces")
    )
    assert (row.saves > 0) == cut
    assert (pruned_scene(scene_file(3), settings, pruned)[1].depth < settings.depth) == cut


@pytest.mark.slow
def test_a_pruned_picture_is_not_resumed_as_a_whole_one(tmp_path):
    """The partial file of a killed render is used only with the same certificate."""
    source, out = scene_file(41), tmp_path / "out.exr"
    settings = SETTINGS.model_copy(update={"tile": 100})
    pruned = prune_scene(source, settings, "5%")

    def killed(done, total):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_to_file(source, out, settings, pruned=pruned, advance=killed)
    other = replace(pruned, certificate=replace(pruned.certificate, tolerance=0.04))
    for another in (None, other):
        with pytest.raises(InputError, match="certificate"):
            render_to_file(source, out, settings, pruned=another)
    seen = []
    render_to_file(source, out, settings, pruned=pruned, advance=lambda n, _: seen.append(n))
    assert seen[0] == 1
