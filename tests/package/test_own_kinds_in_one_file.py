"""Tests a user-defined light and BRDF, each in one file: rendered, read from a scene file, pruned,
measured and fitted without other changes."""

import importlib
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import accuracy, brdf, effects, sensor
from jaxvision.errors import InputError
from jaxvision.files.scenes import read_scene

SPOT = '''
"""A lamp whose intensity falls like cos^4."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxvision as jv
from jaxvision import effects, lights


class Lantern(jv.Light):
    """A lantern.

    Attributes:
        position: (3,) m.
        axis: (3,) unit, where it is brightest.
        intensity: (bands,) W sr^-1 along the axis.
    """

    spectra = ("intensity",)
    position: jax.Array = eqx.field(converter=jnp.asarray)
    axis: jax.Array = eqx.field(converter=jnp.asarray)
    intensity: jax.Array = eqx.field(converter=jnp.asarray)


def arriving(light, point):
    toward = jv.as_vec(light.position - point)
    distance = jv.norm(toward)
    wi = toward * (1 / distance)
    cosine = jnp.maximum(-jv.dot(wi, jv.as_vec(light.axis)), 0)
    return lights.Incident(wi, light.intensity * cosine**4 / distance**2, distance)


def bound(ends):
    """A point of the same intensity sends no less."""
    at, one = np.asarray(ends.low.position, float)[None], np.ones(1)
    most = np.maximum(*(np.asarray(end.intensity, float) for end in ends))
    return effects.Source(most, at, 0 * one, one, None, (at, 0 * one), "place")


lights.register(Lantern, incident=arriving, bound=bound)
'''

TAPE = '''
"""A tape that sends light back to where it came from."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxvision as jv
from jaxvision import brdf, effects


class Tape(jv.Material):
    """A retroreflector.

    Attributes:
        strength: (bands,) sr^-1 toward the light.
        exponent: () of its lobe, no unit.
    """

    spectra = ("strength",)
    strength: jax.Array = eqx.field(converter=jnp.asarray)
    exponent: jax.Array = eqx.field(converter=jnp.asarray)


def back_again(material, wi, wo):
    both = (wi.z > 0) & (wo.z > 0)
    cosine = jnp.where(both, jnp.maximum(jv.dot(wi, wo), 0), 0)
    return jnp.where(both, material.strength * cosine**material.exponent, 0)


def bound(ends):
    most = np.maximum(*(np.asarray(end.strength, float) for end in ends))
    return effects.Reflection(most, plain=np.inf)


brdf.register(Tape, evaluate=back_again, bound=bound)
'''

SCENE = """
[camera]
kind = "orthographic"
position = [0.1, 0.2, 3]
target = [0.1, 0.2, 0]
up = [0, 1, 0]
resolution = [3, 4]
width = 2

[material.tape]
family = "tape"
strength = [0.2, 0.3, 0.4]
exponent = 2

[[surface]]
shape = "quad"
corner = [-2, -2, 0]
edge_u = [4, 0, 0]
edge_v = [0, 4, 0]
material = "tape"

[[light]]
name = "spot"
kind = "lantern"
position = [0, 0, 2]
axis = [0, 0, -1]
intensity = 8

[[light]]
kind = "lantern"
position = [0, 0, 90]
axis = [0, 0, -1]
intensity = [1, 2, 3]
"""


@pytest.fixture
def kinds(tmp_path, monkeypatch):
    """Import the two files from their own folder, and return the modules by name."""
    folder = tmp_path / "kinds"
    folder.mkdir()
    (folder / "own_spot.py").write_text(SPOT)
    (folder / "own_tape.py").write_text(TAPE)
    monkeypatch.syspath_prepend(folder)
    yield [importlib.import_module(name) for name in ("own_spot", "own_tape")]
    for name in ("own_spot", "own_tape"):
        del sys.modules[name]
    assert sorted(file.name for file in folder.glob("*.py")) == ["own_spot.py", "own_tape.py"]


@pytest.fixture
def source(tmp_path, kinds):
    (tmp_path / "scene.toml").write_text(SCENE)
    return read_scene(tmp_path / "scene.toml")


def expected(height, intensity, points):
    """Return the radiance straight up from the tape under a spot above the origin, W m^-2 sr^-1."""
    square = (points**2).sum(-1) + height**2
    cosine = (height / np.sqrt(square))[..., None]
    strength = np.array([0.2, 0.3, 0.4])
    return intensity * cosine**4 / square[..., None] * cosine * strength * cosine**2


def seen_points():
    """Return the points of the floor, (3, 4, 2) m, that the pixels of the file's camera see."""
    x, y = 0.1 + 0.5 * (np.arange(4) - 1.5), 0.2 - 0.5 * (np.arange(3) - 1)
    return np.stack(np.meshgrid(x, y), axis=-1)


def test_a_scene_file_contains_them_and_they_render(source):
    """The picture equals the closed form."""
    assert [type(light).__name__ for light in source.scene.lights] == ["Lantern", "Lantern"]
    assert type(source.scene.surfaces[0].material).__name__ == "Tape"
    points = seen_points()
    wanted = expected(2, 8, points) + expected(90, np.array([1, 2, 3]), points)
    picture = jax.jit(jv.render)(source.scene, source.view)
    np.testing.assert_allclose(picture, wanted, rtol=3e-6)


MISTAKES = {
    "misspelt": ("axis", "axes", r'light "spot"\.axes is not a key .* nearest is \'axis\''),
    "missing": ("axis = [0, 0, -1]\n", "", r'light "spot"\.axis is missing; add it'),
    "word": ('"tape"\nstr', '"tap"\nstr', r"material\.tape: family = 'tap' .* nearest is 'tape'"),
    "number": ("= 2\n\n[[s", '= "2"\n\n[[s', r"material\.tape\.exponent = '2' must be a number"),
    "dark": ("intensity = 8", "intensity = -8", r'light "spot"\.intensity must be .*, got -8'),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_their_mistakes_are_named(tmp_path, kinds, case):
    right, wrong, sentence = MISTAKES[case]
    assert right in SCENE
    (tmp_path / "scene.toml").write_text(SCENE.replace(right, wrong, 1))
    with pytest.raises(InputError, match=sentence):
        read_scene(tmp_path / "scene.toml")


def test_effects_drops_what_their_bounds_allow(source, kinds):
    """The distant spot is dropped, and the picture changes by at most the certified bound."""
    pruned = effects.prune(source.scene, source.view, "1%", level=0.1)
    assert len(pruned.scene.lights) == 1
    (row,) = (row for row in pruned.certificate.dropped if row.name == "lights[1]")
    change = expected(90, np.array([1, 2, 3]), seen_points()).max()
    assert change <= 0.1 * row.bound <= 1.6 * change  # relative to the level
    tape = kinds[1]
    brdf.register(tape.Tape, evaluate=tape.back_again)
    kept = effects.prune(source.scene, source.view, "1%", level=0.1)
    assert len(kept.scene.lights) == 2


@pytest.mark.slow
def test_accuracy_measures_them(source):
    problem = accuracy.scene_problem(
        source, settings=source.render.model_copy(update={"integrator": "path"}), probe=2
    )
    found = accuracy.curve(problem, accuracy.KNOBS["samples"], seconds=8.0)
    assert found.trials[0].error >= 0


@pytest.mark.slow
def test_a_fit_estimates_them(source, kinds):
    import fitting

    spot, tape = kinds
    points = seen_points()[..., :2].reshape(-1, 2)
    truth = expected(2, 8, points)[:, 1]

    def predict(inputs, intensity, exponent):
        lamp = spot.Lantern(jnp.array([0.0, 0, 2]), jnp.array([0.0, 0, -1]), jnp.stack([intensity]))
        material = tape.Tape(jnp.array([0.3]), exponent)
        up = jnp.array([0.0, 0, 1])

        def at(point):
            return jv.outgoing_radiance(material, [lamp], point, up, up)[0]

        return jax.vmap(at)(jnp.concatenate([inputs, 0 * inputs[:, :1]], axis=1))

    problem = fitting.Problem(
        {
            "intensity": fitting.Parameter(unit="W/sr", lower=0.1, upper=100.0),
            "exponent": fitting.Parameter(lower=0.1, upper=20.0),
        },
        predict,
        fitting.Gaussian(sd=0.002),
        inputs=jnp.asarray(points),
        data=truth + 0.002 * np.random.default_rng(3).normal(size=len(truth)),
    )
    truth_of = {"intensity": 8, "exponent": 2}
    for found in fitting.fit(problem).estimates:
        assert found.value is not None
        assert found.standard_error is not None
        assert abs(found.value - truth_of[found.name]) < 4 * found.standard_error


# ------------------------------------------------ a sensor effect

LEAK = '''
"""Charge that leaks to the pixel below."""

import equinox as eqx
import jax
import jax.numpy as jnp

import jaxvision as jv
from jaxvision import sensor


class Leak(jv.SensorEffect):
    """A leak.

    Attributes:
        share: () of a pixel's charge, no unit.
    """

    share: jax.Array = eqx.field(converter=jnp.asarray)


def leaked(key, effect, electrons):
    below = jnp.roll(electrons, 1, axis=-3).at[..., 0, :, :].set(0)
    return (1 - effect.share) * electrons + effect.share * below


def moments(effect, charge):
    """In even light as much comes as goes."""
    kept = (1 - effect.share) ** 2 + effect.share**2
    return sensor.Moments(charge.mean, kept * charge.variance)


def bound(ends, electrons):
    """A pixel moves by its share of the difference to the one above."""
    return float(max(end.share for end in ends)) * electrons, 1.0


sensor.register(Leak, charge=leaked, moments=moments, bound=bound)
'''

CAMERA = """
[view]
kind = "Pinhole"
focal_length = 8e-3
pixel_pitch = 5e-6
resolution = [6, 5]
[sensor]
gain = 0.5
bits = 14
shot_noise = {kind = "PoissonShotNoise"}
[[sensor.own]]
kind = "Leak"
share = 0.25
[[sensor.own]]
kind = "Leak"
share = 1e-6
"""


@pytest.fixture
def leak(tmp_path, monkeypatch):
    folder = tmp_path / "kinds"
    folder.mkdir()
    (folder / "own_leak.py").write_text(LEAK)
    monkeypatch.syspath_prepend(folder)
    yield importlib.import_module("own_leak")
    del sys.modules["own_leak"]
    assert [file.name for file in folder.glob("*.py")] == ["own_leak.py"]


def test_a_camera_file_holds_a_sensor_effect_and_raw_images_show_it(tmp_path, leak):
    file = tmp_path / "mine.toml"
    file.write_text(CAMERA)
    camera = jv.read_camera(file)
    first, second = camera.sensor.own
    assert (type(first), float(first.share), float(second.share)) == (leak.Leak, 0.25, 1e-6)
    jv.write_camera(camera, tmp_path / "again.toml")
    again = jv.read_camera(tmp_path / "again.toml")
    assert all(
        np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (camera, again)), strict=True)
    )
    file.write_text(CAMERA.replace("share = 0.25", "shore = 0.25"))
    with pytest.raises(InputError, match=r"sensor\.own\[1\]\.shore is not a key .* 'share'"):
        jv.read_camera(file)
    even = jv.Sensor(own=(first,))
    spot = jnp.zeros((3, 2, 1)).at[1, 0, 0].set(100.0)
    raw = jv.collect(None, even, spot)
    np.testing.assert_allclose(raw[:, 0, 0], [0, 75, 25])
    noisy = jv.Sensor(own=(first,), shot_noise=jv.PoissonShotNoise())
    frame = jv.collect(jax.random.key(1), noisy, jnp.full((300, 300, 1), 100.0))[1:]
    variance = jv.signal_variance(noisy, jnp.array([100.0]))[0]
    np.testing.assert_allclose(variance, 100 * (0.75**2 + 0.25**2), rtol=1e-6)
    np.testing.assert_allclose(frame.var(), variance, rtol=0.03)


def test_effects_drops_a_sensor_effect_that_its_bound_allows(tmp_path, leak):
    """The small effect is dropped. Without a bound, no effect before it is dropped."""
    (tmp_path / "mine.toml").write_text(CAMERA)
    camera = jv.read_camera(tmp_path / "mine.toml")
    floor = jv.Surface(jv.Plane([0, 0, 2], [0, 0, -1]), jv.Lambert([0.3]))
    scene = jv.Scene([floor], [jv.PointLight([0, 0, 0.5], [4e3])])
    pruned = effects.prune(scene, camera, "0.5DN")
    (kept,) = pruned.camera.sensor.own
    assert float(kept.share) == 0.25
    (row,) = (row for row in pruned.certificate.dropped if row.name == "sensor.own[1]")
    assert 0 < row.bound < 0.1
    sensor.register(leak.Leak, charge=leak.leaked)
    assert len(effects.prune(scene, camera, "0.5DN").camera.sensor.own) == 2
    with pytest.raises(ValueError, match="Leak was registered without moments"):
        jv.signal_variance(camera.sensor, jnp.array([100.0]))


@pytest.mark.slow
def test_a_fit_estimates_a_sensor_effect(leak):
    """The share is estimated from the variance of simulated flat frames."""
    import fitting

    levels, count = jnp.array([50.0, 200.0, 800.0]), 40_000

    def of(share):
        return jv.Sensor(own=(leak.Leak(share),), shot_noise=jv.PoissonShotNoise())

    def frame(key, level):
        return jv.collect(key, of(0.2), jnp.full((201, 200, 1), level))[1:].var()

    def predict(inputs, share):
        return jax.vmap(lambda level: jv.signal_variance(of(share), level[None])[0])(inputs)

    keys = jax.random.split(jax.random.key(0), 3)
    data = jnp.stack([frame(key, level) for key, level in zip(keys, levels, strict=True)])
    sd = np.asarray(data) * np.sqrt(2 / count) * 1.2  # for correlated neighbours
    problem = fitting.Problem(
        {"share": fitting.Parameter(lower=0.01, upper=0.45)},
        predict,
        fitting.Gaussian(sd=sd),
        inputs=levels,
        data=data,
    )
    (found,) = fitting.fit(problem).estimates
    assert found.value is not None
    assert abs(found.value - 0.2) < 0.01
