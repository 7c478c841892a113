"""Cameras and materials to files and back, with the draws of a fit; bands that they predict."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Parameter, Problem, SensorNoise, fit
from jaxvision import (
    Camera,
    DirectionalLight,
    Lambert,
    OrenNayar,
    Orthographic,
    Phong,
    PoissonShotNoise,
    Scene,
    Schlick,
    Sensor,
    Sphere,
    Surface,
    TorranceSparrow,
    capture,
    read_camera,
    read_material,
    write_camera,
    write_material,
)
from jaxvision.errors import InputError

SHIPPED = ["ideal", "emva1288", pytest.param("consumer_bayer", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_camera_comes_back_bit_equal(tmp_path, name):
    camera, file = read_camera(name), tmp_path / "camera.toml"
    write_camera(camera, file, about="one that ships")
    assert eqx.tree_equal(read_camera(file), camera)


MATERIALS = [
    Lambert((0.1, 0.2, 0.3)),
    Phong((0.3,), (0.4,), exponent=25.0),
    OrenNayar((0.3,), 0.5),
    TorranceSparrow((0.1,), (1.0,), 0.2, interface=Schlick((0.04,))),
]


@pytest.mark.parametrize("material", MATERIALS, ids=lambda x: type(x).__name__)
def test_a_material_comes_back_bit_equal(tmp_path, material):
    write_material(material, tmp_path / "material.toml")
    assert eqx.tree_equal(read_material(tmp_path / "material.toml"), material)


def drawn(material, count=10):
    """The exponent differs from draw to draw, nothing else."""
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), material)
    return eqx.tree_at(lambda m: m.exponent, many, 20 + jnp.arange(1.0 * count))


def test_draws_lie_beside_and_are_thinned(tmp_path):
    file, material = tmp_path / "gloss.toml", MATERIALS[1]
    write_material(material, file, draws=drawn(material))
    assert eqx.tree_equal(read_material(file), material)
    four = read_material(file, draws=4)
    np.testing.assert_array_equal(four.exponent, [20, 23, 26, 29])
    np.testing.assert_array_equal(four.diffuse, np.full((4, 1), 0.3))
    assert list(np.load(tmp_path / "gloss.npz")) == [".exponent"]


def test_draws_that_are_none_are_refused(tmp_path):
    file, material = tmp_path / "gloss.toml", MATERIALS[1]
    write_material(material, file)
    with pytest.raises(InputError, match=r"no draws lie beside gloss\.toml"):
        read_material(file, draws=4)
    for wrong, expected in (
        (material, "need one leading axis"),
        (MATERIALS[0], "another kind of record"),
        (jax.tree.map(lambda x: x[None], material), "no number differs"),
    ):
        with pytest.raises(InputError, match=expected):
            write_material(material, file, draws=wrong)
    write_material(material, file, draws=drawn(material))
    with pytest.raises(InputError, match="11 draws were asked for, 10 are there"):
        read_material(file, draws=11)
    write_material(MATERIALS[0], file)
    with pytest.raises(InputError, match=r"has no \.exponent"):
        read_material(file, draws=2)
    file.write_text('kind = "Fong"')
    with pytest.raises(InputError, match="'Fong' is no material; the nearest is 'Phong'"):
        read_material(file)


def ball():
    front = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
    view = Orthographic((0.0, 0.0, 3.0), front, 2.2 / 48, resolution=(48, 48))
    grey = Surface(Sphere((0.0, 0.0, 0.0), 1.0), Lambert((0.25,)))
    return Scene([grey], [DirectionalLight((0.3, 0.4, 1.0), (4000.0,))]), view


@pytest.mark.slow
def test_a_fitted_camera_predicts_pictures_that_it_has_not_seen(tmp_path):
    """Flats to gain, read noise, offset and efficiency; to a file; to bands of a ball's pixels."""
    scene, view = ball()
    sensor = Sensor(
        shot_noise=PoissonShotNoise(),
        quantum_efficiency=0.5,
        read_noise=12.0,
        gain=0.5,
        offset=60.0,
        bits=12,
    )
    light = jnp.repeat(jnp.linspace(0.0, 4000.0, 12), 20)[:, None]
    truth = Camera(view, sensor)
    codes = SensorNoise(sensor).draw(jax.random.key(0), light)
    problem = Problem(
        {
            "camera.sensor.gain": Parameter(transform="log", lower=0.05, upper=5),
            "camera.sensor.read_noise": Parameter(transform="log", lower=1, upper=99),
            "camera.sensor.offset": Parameter(unit="DN", lower=0.0, upper=200.0),
            "camera.sensor.quantum_efficiency": Parameter(lower=0.05, upper=1.0),
        },
        lambda inputs: inputs,
        SensorNoise("camera.sensor"),
        codes,
        records={"camera": truth},
        inputs=light,
    )
    result = fit(problem, starts=8)
    assert result.converged
    file = tmp_path / "mine.toml"
    write_camera(result.record("camera"), file, draws=result.records("camera", draws=400))
    assert eqx.tree_equal(read_camera(file), result.record("camera"))
    keys = jax.random.split(jax.random.key(1), 400)
    many = jax.vmap(lambda key, camera: capture(key, scene, camera).raw)
    low, high = np.quantile(many(keys, read_camera(file, draws=400)), (0.025, 0.975), axis=0)
    unseen = np.stack(
        [capture(key, scene, truth).raw for key in jax.random.split(jax.random.key(2), 5)]
    )
    assert 0.93 < np.mean((unseen >= low) & (unseen <= high)) < 0.97
