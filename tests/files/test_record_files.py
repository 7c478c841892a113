"""Cameras and materials to files and back, with the draws of a fit; bands that they predict."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Parameter, Problem, SensorNoise, fit
from fitting.noise import calibrate, from_frames
from fitting.noise.section import section as noise_section
from fitting.rig import Camera as RigCamera
from jaxvision import (
    EON,
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
    read_sensor,
    write_camera,
    write_material,
    write_sensor,
)
from jaxvision.errors import InputError
from jaxvision.sensor import raw_image

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
    EON((0.3,), 0.5, facet_albedo=(1.0,)),
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


def test_a_sensor_comes_back_bit_equal_and_is_told_its_table(tmp_path):
    sensor, file = read_camera("emva1288").sensor, tmp_path / "sensor.toml"
    write_sensor(sensor, file, about="of a camera")
    assert eqx.tree_equal(read_sensor(file), sensor)
    file.write_text("gain = 0.5")
    with pytest.raises(InputError, match="gain is not a key of a sensor file"):
        read_sensor(file)
    with pytest.raises(InputError, match="ends in"):
        write_sensor(sensor, tmp_path / "sensor.txt")


def test_draws_lie_beside_and_are_thinned(tmp_path):
    file, material = tmp_path / "gloss.toml", MATERIALS[1]
    write_material(material, file, draws=drawn(material))
    assert eqx.tree_equal(read_material(file), material)
    four = read_material(file, draws=4)
    assert isinstance(four, Phong)
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
    for number in ("nan", "inf", "1e309"):
        file.write_text(f'kind = "Lambert"\ndiffuse = [0.1, {number}]')
        with pytest.raises(InputError, match="diffuse must hold finite numbers"):
            read_material(file)
    write_material(material, file, draws=drawn(material))
    beside = file.with_suffix(".npz")
    content = beside.read_bytes()
    directory = content.rindex(b"PK\1\2")
    unknown = content[: directory + 10] + b"\x63" + content[directory + 11 :]  # a compression
    for damaged in (b"PK\x03\x04 cut short", content[:-9], unknown):
        beside.write_bytes(damaged)
        with pytest.raises(InputError, match=r"\.npz: not a file of draws"):
            read_material(file, draws=2)


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


@pytest.mark.slow
def test_the_sensor_of_a_noise_calibration_predicts_levels_that_it_has_not_seen(tmp_path):
    """Flats and darks to the report of the command, whose sensor.toml predicts another level."""
    truth = Sensor(
        shot_noise=PoissonShotNoise(),
        exposure_time=0.01,
        quantum_efficiency=0.5,
        read_noise=12.0,
        gain=0.3,
        offset=40.0,
        bits=12,
    )
    size, key = (64, 64, 1), jax.random.key(4)

    def frames(photons, number):
        light = jnp.full(size, photons / 0.01)
        keys = jax.random.split(jax.random.fold_in(key, number), 4)
        return [np.asarray(raw_image(k, truth, light))[..., 0] for k in keys]

    levels = np.linspace(500.0, 20_000.0, 8)
    exposures = np.full(8, 0.01)
    measured = from_frames(
        [frames(photons, i) for i, photons in enumerate(levels)],
        [frames(0.0, 100)],
        exposures.tolist(),
        levels.tolist(),
        camera=RigCamera(bits=12),
        dark_exposures=[0.01],
    )
    section = noise_section(calibrate(measured))
    section.records["sensor"](tmp_path / "sensor.toml")
    best = read_sensor(tmp_path / "sensor.toml")
    for name in ("gain", "read_noise", "offset", "quantum_efficiency"):
        np.testing.assert_allclose(getattr(best, name), getattr(truth, name), rtol=0.03)
    many = read_sensor(tmp_path / "sensor.toml", draws=400)
    light = jnp.full(size, 3333.0 / 0.01)
    drawn = jax.vmap(lambda k, sensor: raw_image(k, sensor, light))(
        jax.random.split(jax.random.key(9), 400), many
    )
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    unseen = np.stack(frames(3333.0, 200))[..., None]
    assert 0.93 < np.mean((unseen >= low) & (unseen <= high)) < 0.97
