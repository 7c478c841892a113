"""Tests files of cameras and materials, with the draws of a fit, and intervals predicted from
them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from fitting.noise import calibrate, from_frames
from fitting.noise.section import section as noise_section
from fitting.rig import Camera as RigCamera
from jaxvision.errors import InputError
from jaxvision.sensor import raw_image

SHIPPED = ["ideal", "emva1288", pytest.param("consumer_bayer", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_camera_is_read_back_bit_by_bit(tmp_path, name):
    camera, file = jv.read_camera(name), tmp_path / "camera.toml"
    jv.write_camera(camera, file, about="one that ships")
    assert eqx.tree_equal(jv.read_camera(file), camera)


MATERIALS = [
    jv.Lambert((0.1, 0.2, 0.3)),
    jv.Phong((0.3,), (0.4,), exponent=25.0),
    jv.OrenNayar((0.3,), 0.5),
    jv.EON((0.3,), 0.5, facet_albedo=(1.0,)),
    jv.TorranceSparrow((0.1,), (1.0,), 0.2, interface=jv.Schlick((0.04,))),
]


@pytest.mark.parametrize("material", MATERIALS, ids=lambda x: type(x).__name__)
def test_a_material_is_read_back_bit_by_bit(tmp_path, material):
    jv.write_material(material, tmp_path / "material.toml")
    assert eqx.tree_equal(jv.read_material(tmp_path / "material.toml"), material)


def drawn(material, count=10):
    """Return draws of a material that differ only in the exponent."""
    many = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), material)
    return eqx.tree_at(lambda m: m.exponent, many, 20 + jnp.arange(1.0 * count))


def test_a_sensor_is_read_back_bit_by_bit_and_needs_its_table(tmp_path):
    sensor, file = jv.read_camera("emva1288").sensor, tmp_path / "sensor.toml"
    jv.write_sensor(sensor, file, about="of a camera")
    assert eqx.tree_equal(jv.read_sensor(file), sensor)
    file.write_text("gain = 0.5")
    with pytest.raises(InputError, match="gain is not a key of a sensor file"):
        jv.read_sensor(file)
    with pytest.raises(InputError, match="ends in"):
        jv.write_sensor(sensor, tmp_path / "sensor.txt")


def test_draws_are_stored_beside_the_record_and_thinned(tmp_path):
    file, material = tmp_path / "gloss.toml", MATERIALS[1]
    jv.write_material(material, file, draws=drawn(material))
    assert eqx.tree_equal(jv.read_material(file), material)
    four = jv.read_material(file, draws=4)
    assert isinstance(four, jv.Phong)
    np.testing.assert_array_equal(four.exponent, [20, 23, 26, 29])
    np.testing.assert_array_equal(four.diffuse, np.full((4, 1), 0.3))
    assert list(np.load(tmp_path / "gloss.npz")) == [".exponent"]


def test_invalid_draws_are_refused(tmp_path):
    file, material = tmp_path / "gloss.toml", MATERIALS[1]
    jv.write_material(material, file)
    with pytest.raises(InputError, match=r"no draws lie beside gloss\.toml"):
        jv.read_material(file, draws=4)
    for wrong, expected in (
        (material, "need one leading axis"),
        (MATERIALS[0], "another kind of record"),
        (jax.tree.map(lambda x: x[None], material), "no number differs"),
    ):
        with pytest.raises(InputError, match=expected):
            jv.write_material(material, file, draws=wrong)
    jv.write_material(material, file, draws=drawn(material))
    with pytest.raises(InputError, match="11 draws were asked for, 10 are there"):
        jv.read_material(file, draws=11)
    jv.write_material(MATERIALS[0], file)
    with pytest.raises(InputError, match=r"has no \.exponent"):
        jv.read_material(file, draws=2)
    file.write_text('kind = "Fong"')
    with pytest.raises(InputError, match="'Fong' is no material; the nearest is 'Phong'"):
        jv.read_material(file)
    for number in ("nan", "inf", "1e309"):
        file.write_text(f'kind = "Lambert"\ndiffuse = [0.1, {number}]')
        with pytest.raises(InputError, match="diffuse must hold finite numbers"):
            jv.read_material(file)
    jv.write_material(material, file, draws=drawn(material))
    beside = file.with_suffix(".npz")
    content = beside.read_bytes()
    directory = content.rindex(b"PK\1\2")
    unknown = (  # an unsupported compression
        content[: directory + 10] + b"\x63" + content[directory + 11 :]
    )
    for damaged in (b"PK\x03\x04 cut short", content[:-9], unknown):
        beside.write_bytes(damaged)
        with pytest.raises(InputError, match=r"\.npz: not a file of draws"):
            jv.read_material(file, draws=2)


@pytest.mark.slow
def test_a_calibrated_sensor_predicts_levels_that_were_not_measured(tmp_path):
    """The command calibrates from flats and darks, and its sensor.toml predicts another level."""
    truth = jv.Sensor(
        shot_noise=jv.PoissonShotNoise(),
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
    best = jv.read_sensor(tmp_path / "sensor.toml")
    for name in ("gain", "read_noise", "offset", "quantum_efficiency"):
        np.testing.assert_allclose(getattr(best, name), getattr(truth, name), rtol=0.03)
    many = jv.read_sensor(tmp_path / "sensor.toml", draws=400)
    light = jnp.full(size, 3333.0 / 0.01)
    drawn = jax.vmap(lambda k, sensor: raw_image(k, sensor, light))(
        jax.random.split(jax.random.key(9), 400), many
    )
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    unseen = np.stack(frames(3333.0, 200))[..., None]
    assert 0.93 < np.mean((unseen >= low) & (unseen <= high)) < 0.97
