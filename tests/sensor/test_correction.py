"""Tests `correct`, which inverts a camera, against the true light, naive NumPy, and the scatter of
simulated frames."""

import re
import warnings
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from traced import primitives

import jaxvision as jv
from jaxvision import sensor as js

SIDE = 24
LIGHT = np.full((SIDE, SIDE, 1), 3000.0) + np.linspace(0, 3000, SIDE)[:, None, None]  # e-
PATCH = np.zeros((SIDE, SIDE), bool)
PATCH[8:16, 6:18] = True
INSIDE = (slice(None), slice(4, -4), slice(4, -4))
SENSOR = jv.Sensor(
    exposure_time=0.02,
    light_offset=100.0,
    crosstalk=0.02,
    prnu=0.01,
    dark_current=2000.0,
    shot_noise=jv.PoissonShotNoise(),
    brighter_fatter=jv.BrighterFatter([[4e-7]]),
    mixing=js.even_mixing(0.08),
    nonlinearity=jv.Compression(0.05, 0.01, electrons=1e4),
    dsnu=3.0,
    read_noise=15.0,
    row_noise=4.0,
    column_noise=2.0,
    frame_noise=1.0,
    gain=0.5,
    offset=100.0,
    bits=14,
)
DIE = jax.random.key(3)
SIMPLE = replace(
    SENSOR, brighter_fatter=None, crosstalk=None, nonlinearity=jv.Compression(0.05, electrons=1e4)
)


TAPS = {
    "columns": jv.Taps(
        ((0, 1),), offset=[-2.0, 2.0], gain=[0.985, 1.015], read_noise=[0.7, 1.2], prnu=[0.8, 1.2]
    ),
    "mosaic": jv.Taps("RGGB", offset=[0.0, 3.0, -3.0], quantum_efficiency=[0.6, 1.0, 0.4]),
    "quadrants": jv.Taps(((0, 1), (2, 3)), gain=[1.0, 1.03, 0.98, 1.01], stretched=True),
}


def exposed(light):
    """Return the light in photons per second."""
    return jnp.asarray(light / 0.02)


def test_a_camera_without_noise_is_inverted():
    """All effects without random draws are inverted within 0.02 %, the second order of the
    brighter-fatter effect and charge transfer."""
    sensor = replace(
        SENSOR,
        shot_noise=None,
        prnu=None,
        dsnu=None,
        read_noise=None,
        row_noise=None,
        column_noise=None,
        frame_noise=None,
        bits=None,
        smear=1e-4,
        quantum_efficiency=0.5,
        charge_transfer=jv.ChargeTransfer(1e-5, serial_inefficiency=1e-5),
        taps=jv.Taps(((0, 1),), offset=[0.0, 5.0], gain=[1.0, 1.1]),
    )
    scene = LIGHT * (1 + 0.2 * np.random.default_rng(1).uniform(-1, 1, LIGHT.shape))
    raw = jax.jit(jv.raw_image)(None, sensor, exposed(scene))
    found = js.correct(raw, sensor)
    np.testing.assert_allclose(found.image, 0.5 * scene, rtol=4e-4)
    photons = js.correct(raw, sensor, unit="photons")
    np.testing.assert_allclose(photons.image, scene, rtol=4e-4)
    assert np.abs(np.asarray(raw) - 100 - 0.25 * scene).max() > 100  # the effects are large


def test_integer_codes_are_corrected_as_numbers():
    """Unsigned integers would wrap around below the dark frame, and truncate gains of taps."""
    codes = np.array([[90, 130, 95, 140]] * 4, np.uint16)[..., None]
    camera = jv.Sensor(gain=0.25, offset=100.0, bits=12)
    taps = replace(camera, taps=jv.Taps(((0, 1),), gain=[0.9, 1.1], offset=[-2.0, 3.0]))
    dark = js.Masters(dark=js.Master(np.full((4, 4, 1), 100.5), 4))
    for sensor, masters in ((camera, dark), (taps, None), (taps, dark)):
        seen, numbers = (js.correct(x, sensor, masters=masters) for x in (codes, codes * 1.0))
        np.testing.assert_allclose(seen.image, numbers.image, rtol=1e-5)
    found = js.correct(codes, camera, masters=dark).image
    np.testing.assert_allclose(found, (codes - 100.5) / 0.25, rtol=1e-6)


@pytest.mark.slow
def test_a_frame_at_the_full_well_has_no_values():
    """With read noise, half of the codes are below the well."""
    camera = jv.Sensor(read_noise=6.0, gain=0.25, offset=100.0, full_well=14_000.0, bits=12)
    raw = jv.raw_image(jax.random.key(0), camera, jnp.full((32, 32, 1), 30_000.0))
    assert np.isnan(js.correct(raw, camera).image).all()
    dim = jv.raw_image(jax.random.key(0), camera, jnp.full((32, 32, 1), 13_000.0))
    assert np.isfinite(js.correct(dim, camera).image).all()


def test_dark_flat_and_defects_against_naive_numpy():
    rng = np.random.default_rng(2)
    raw, dark, flat = (
        rng.uniform(*ends, (6, 7, 1)) for ends in ((500, 900), (90, 110), (900, 990))
    )
    defects = np.zeros((6, 7), bool)
    defects[2, 3] = True
    sensor = jv.Sensor(gain=0.25, offset=100.0, read_noise=2.0)
    masters = jv.Masters(dark=jv.Master(dark, 10), flat=jv.Master(flat, 10), defects=defects)
    found = js.correct(raw, sensor, masters=masters)
    field = flat - dark
    around = np.ones_like(field, bool)
    around[2, 3] = False
    hood = around[0:5, 1:6] * 1.0
    field[2, 3] = (hood * field[0:5, 1:6]).sum() / hood.sum()
    wanted = (raw - dark) / 0.25 / (field / field.mean())
    wanted[2, 3] = np.nan
    np.testing.assert_allclose(found.image, wanted, rtol=1e-5)
    clipped = js.correct(jnp.array([[[255.0], [254.0]]]), jv.Sensor(bits=8))
    assert np.isnan(clipped.image).ravel().tolist() == [True, False]


def test_bias_dark_and_flat_equal_ccdproc():
    """The values were printed by ccdproc 2.5.1: subtract_bias, subtract_dark of the same exposure,
    gain_correct and flat_correct, and create_deviation of the frame without bias."""
    raw, bias, dark, flat = (
        np.reshape(values, (2, 3, 1))
        for values in (
            [1203.0, 987, 3051, 455, 2210, 1777],
            [100.25, 99.5, 101, 98.75, 100, 102.5],
            [104.5, 103.25, 110, 101, 160.75, 105.5],
            [2104, 2200.5, 1999, 2150.25, 2051, 2333.75],
        )
    )
    sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), gain=0.25, read_noise=5.0)
    plain, darker, flatter = (
        js.correct(raw, replace(sensor, offset=np.median(masters.dark.mean)), masters=masters)
        for masters in (
            jv.Masters(dark=jv.Master(bias, 8)),
            jv.Masters(dark=jv.Master(dark, 8)),
            jv.Masters(dark=jv.Master(dark, 8), flat=jv.Master(flat, 8)),
        )
    )
    values = [
        [4411.0, 3550, 11800, 1425, 8440, 6698],
        [4394.0, 3535, 11764, 1416, 8197, 6686],
        [4451.319413, 3414.202924, 12614.590965, 1399.646700, 8783.868051, 6077.886308],
    ]
    for found, wanted in zip((plain, darker, flatter), values, strict=True):
        np.testing.assert_allclose(found.image.ravel(), wanted, rtol=1e-6)
    deviation = [66.603303221387, 59.791303715507, 108.742815854658]
    deviation += [38.07886552932, 92.005434622092, 81.993902212299]
    np.testing.assert_allclose(np.sqrt(plain.variance).ravel(), deviation, rtol=1e-6)


def test_irradiance_is_recovered():
    conversion = jv.PhotonConversion(550e-9, 25e-12)
    sensor = jv.Sensor(
        photon_conversion=conversion, quantum_efficiency=0.6, exposure_time=0.01, gain=0.5
    )
    raw = jv.raw_image(None, sensor, jnp.full((2, 3, 1), 0.02))
    np.testing.assert_allclose(js.correct(raw, sensor, unit="irradiance").image, 0.02, rtol=1e-6)


def test_unusable_frames_are_refused():
    raw = jnp.ones((2, 2, 1))
    with pytest.raises(ValueError, match="unit must be one of electrons, photons, irradiance"):
        js.correct(raw, jv.Sensor(), unit="lux")
    with pytest.raises(ValueError, match=r"irradiance needs Sensor\.photon_conversion"):
        js.correct(raw, jv.Sensor(), unit="irradiance")
    with pytest.raises(ValueError, match="photons of several bands"):
        js.correct(raw, jv.Sensor(quantum_efficiency=[0.5]), unit="photons")
    with pytest.raises(
        ValueError, match=r"raw must have shape \(\.\.\., h, w, bands\), got \(2, 2\)"
    ):
        js.correct(raw[..., 0], jv.Sensor())
    wide = jv.Masters(dark=jv.Master(jnp.ones((2, 3, 1)), 10))
    with pytest.raises(ValueError, match=r"masters\.dark\.mean must have shape \(2, 2, 1\), got"):
        js.correct(raw, jv.Sensor(), masters=wide)
    with pytest.raises(ValueError, match=r"masters\.defects must have shape \(2, 2\), got"):
        js.correct(raw, jv.Sensor(), masters=jv.Masters(defects=jnp.ones(3, bool)[:, None]))
    with pytest.raises(ValueError, match=r"Master\.frames must be .*above 0, got 0"):
        jv.Master(raw, 0)
    with pytest.raises(ValueError, match="draws must be of the same kind"):
        js.correct(raw, jv.Sensor(gain=1.0), draws=jv.Sensor(offset=1.0))


@pytest.mark.slow
def test_a_filter_propagates_errors_like_a_mean():
    """A box of 5 x 5 at one pixel is the mean over 25 pixels, and so for shared errors."""
    draws = jax.vmap(lambda x: replace(SIMPLE, gain=SIMPLE.gain * (1 + 0.01 * x)))
    raw = jv.raw_image(jax.random.key(1), SIMPLE, exposed(LIGHT), die_key=DIE)
    found = js.correct(raw, SIMPLE, draws=draws(jnp.linspace(-1, 1, 9)))
    box = np.zeros((SIDE, SIDE), bool)
    box[10:15, 9:14] = True
    mean, filtered = found.mean(box), found.filtered(jnp.full((5, 5), 1 / 25))
    np.testing.assert_allclose(filtered.image[12, 11], mean.mean, rtol=1e-6)
    np.testing.assert_allclose(filtered.total_variance[12, 11], mean.variance, rtol=0.02)
    np.testing.assert_allclose(filtered.shared[:, 12, 11], found.shared[:, box].mean(1), rtol=1e-5)


@pytest.mark.slow
def test_shared_errors_are_the_scatter_over_draws():
    """The sum of squares equals the variance of frames corrected with each draw."""
    best = jv.Sensor(gain=0.5, offset=100.0, nonlinearity=jv.Compression(0.05, electrons=1e4))
    rng = np.random.default_rng(4)

    def drawn(x):
        curve = jv.Compression(0.05 + 0.002 * x[2], electrons=1e4)
        return replace(best, gain=0.5 + 0.002 * x[0], offset=100 + x[1] + x[0], nonlinearity=curve)

    draws = jax.vmap(drawn)(jnp.asarray(rng.normal(size=(300, 3))))
    raw = jnp.linspace(200, 4000, 12).reshape(3, 4, 1)
    found = js.correct(raw, best, draws=draws)
    assert found.shared.shape == (3, 3, 4, 1)
    each = jax.vmap(lambda sensor: js.correct(raw, sensor).image)(draws)
    np.testing.assert_allclose(np.sum(found.shared**2, 0), np.var(each, 0), rtol=0.03)


def simulated(count, masters_of, frames=16, taps=None):
    """Return z of pixels, patches, and their differences in pairs of frames that share dark and
    flat."""

    def master(sensor, key, die, light):
        shots = jax.random.split(key, frames)
        mean = jax.vmap(lambda k: jv.raw_image(k, sensor, light, die_key=die))(shots).mean(0)
        return jv.Master(mean, frames)

    sensor, wanted = replace(SENSOR, taps=taps), np.asarray(LIGHT)
    if taps is not None and taps.quantum_efficiency is not None and not masters_of:
        plain = replace(sensor, light_offset=None, exposure_time=None)
        wanted = np.asarray(jv.mean_photoelectrons(plain, LIGHT))

    @jax.jit
    def pair(key):
        die, one, other, dark, flat = jax.random.split(key, 5)
        lit = jnp.full(LIGHT.shape, 5000 / 0.02)
        masters = jv.Masters(
            dark=master(replace(sensor, light_offset=None), dark, die, 0 * lit),
            flat=master(sensor, flat, die, lit),
        )
        a, b = (
            js.correct(
                jv.raw_image(k, sensor, exposed(LIGHT), die_key=die),
                sensor,
                masters=masters if masters_of else None,
                expected=jnp.asarray(wanted),
            )
            for k in (one, other)
        )
        difference, patches = a - b, (a.mean(PATCH), (a - b).mean(PATCH))
        return (
            (a.image - wanted) / jnp.sqrt(a.total_variance),
            difference.image / jnp.sqrt(difference.total_variance),
            (patches[0].mean - wanted[PATCH].mean()) / jnp.sqrt(patches[0].variance),
            patches[1].mean / jnp.sqrt(patches[1].variance),
        )

    keys = jax.random.split(jax.random.key(17), count)
    return [np.asarray(z) for z in jax.lax.map(pair, keys)]


def check(count, found):
    pixels, differences, patch, patches = found
    for z in (pixels[INSIDE], differences[INSIDE]):
        per_frame = z.mean((1, 2, 3))
        assert abs(per_frame.mean()) < 4 * per_frame.std() / np.sqrt(count) + 0.01
        assert abs(z.var() - 1) < 0.02
    for z in (patch, patches):
        assert abs(z.mean()) < 4 / np.sqrt(count)
        assert abs(z.var() - 1) < 4 * np.sqrt(2 / count)


@pytest.mark.slow
def test_stated_errors_equal_the_scatter_of_a_few_frames():
    """The camera has mixing, a curve, row noise and read noise, and one die without a pattern."""
    plain = replace(SIMPLE, prnu=None, dsnu=None, row_noise=12.0)
    keys = jax.random.split(jax.random.key(6), 60)
    raw = jax.jit(jax.vmap(lambda key: jv.raw_image(key, plain, exposed(LIGHT))))(keys)
    found = js.correct(raw, plain, expected=jnp.asarray(LIGHT)[None])
    pixels = ((np.asarray(found.image) - LIGHT) / np.sqrt(found.total_variance))[INSIDE]
    patch = found.mean(PATCH)
    z = (np.asarray(patch.mean) - LIGHT[PATCH].mean()) / np.sqrt(patch.variance)
    frames = pixels.mean((1, 2, 3))
    assert abs(frames.mean()) < 4 * frames.std() / np.sqrt(60) + 0.01
    assert abs(pixels.var() - 1) < 0.05
    assert abs(z.var() - 1) < 4 * np.sqrt(2 / 60)
    alone = np.asarray(found.variance)[:, PATCH].sum(1) / PATCH.sum() ** 2
    assert (alone < 0.8 * patch.variance).all()  # row noise is shared in a patch


@pytest.mark.slow
@pytest.mark.parametrize("with_masters", [True, False])
def test_stated_errors_equal_the_scatter_of_two_hundred_frames(with_masters):
    """Without masters the pattern of each die counts as an error."""
    check(200, simulated(200, with_masters))


@pytest.mark.slow
@pytest.mark.parametrize("masters", [True, False])
@pytest.mark.parametrize("kind", TAPS)
def test_stated_errors_equal_the_scatter_of_frames_of_several_taps(kind, masters):
    """A flat equalises the sites of a mosaic only if its light has the scene's spectrum."""
    if kind == "mosaic" and masters:
        pytest.skip("electrons of a mosaic behind a flat are those of a mean pixel")
    check(100, simulated(100, masters, taps=TAPS[kind]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", TAPS)
@pytest.mark.sweep
def test_frames_of_several_taps_are_inverted(kind):
    """Without noise the result is exact, in photons on one scale. With noise, the moments of z over
    100 frames are right."""
    plain = jv.Sensor(quantum_efficiency=0.5, gain=0.5, offset=100.0, read_noise=6.0)
    plain = replace(plain, prnu=1e-6, taps=TAPS[kind])
    raw = jv.raw_image(
        None,
        replace(
            plain, read_noise=None, prnu=None, taps=replace(TAPS[kind], read_noise=None, prnu=None)
        ),
        LIGHT,
    )
    np.testing.assert_allclose(js.correct(raw, plain, unit="photons").image, LIGHT, rtol=1e-5)
    noisy = replace(plain, shot_noise=jv.PoissonShotNoise(), bits=14)
    keys = jax.random.split(jax.random.key(6), 100)
    raw = jax.jit(jax.vmap(lambda key: jv.raw_image(key, noisy, LIGHT, die_key=DIE)))(keys)
    true = np.asarray(jv.mean_photoelectrons(plain, LIGHT))
    found = js.correct(raw, noisy, expected=true[None])
    z = (np.asarray(found.image) - true) / np.sqrt(found.variance)
    assert abs(z.mean()) < 4 / np.sqrt(z.size)
    assert abs(z.var() - 1) < 4 * np.sqrt(2 / z.size)
    mean = np.mean(js.correct(raw, noisy, unit="photons").image, axis=0)
    assert abs(float((mean / LIGHT).mean()) - 1) < 1e-3


def test_effects_that_a_camera_lacks_are_not_traced():
    raw = jnp.ones((4, 4, 1))
    found = primitives(lambda x: js.correct(x, jv.Sensor(offset=8.0)).image, raw)
    assert not {"mul", "div", "add"} & {*found}
    assert found["sub"] == 2  # for the image, and for its errors


@pytest.mark.slow
def test_patches_of_random_cameras_differ_as_their_draws():
    """200 cameras are drawn from the posterior, and each frame is corrected with the best one."""
    plain = jv.Sensor(
        exposure_time=0.02,
        shot_noise=jv.PoissonShotNoise(),
        nonlinearity=jv.Compression(0.05, electrons=1e4),
        read_noise=5.0,
        gain=0.5,
        offset=100.0,
    )

    def drawn(x):
        curve = jv.Compression(0.05 + 0.003 * x[1], electrons=1e4)
        return replace(plain, gain=0.5 * (1 + 0.003 * x[0]), nonlinearity=curve)

    normal = np.random.default_rng(8).normal(size=(500, 2))
    draws = jax.vmap(drawn)(jnp.asarray(normal))
    light = jnp.asarray(LIGHT)

    @jax.jit
    def z(key):
        own, frame = jax.random.split(key)
        camera = drawn(jax.random.normal(own, (2,)))
        found = js.correct(
            jv.raw_image(frame, camera, exposed(LIGHT)), plain, draws=draws, expected=light
        )
        patch = found.mean(PATCH)
        off = (found.image - light) / jnp.sqrt(found.total_variance)
        alone = found.variance[PATCH].sum() / float(PATCH.sum()) ** 2
        return (
            (patch.mean - LIGHT[PATCH].mean()) / jnp.sqrt(patch.variance),
            off,
            alone / patch.variance,
        )

    patch, pixels, share = (
        np.asarray(x) for x in jax.lax.map(z, jax.random.split(jax.random.key(2), 200))
    )
    assert abs(patch.mean()) < 4 / np.sqrt(200)
    assert abs(patch.var() - 1) < 4 * np.sqrt(2 / 200)
    assert abs(pixels.var() - 1) < 0.05
    assert share.max() < 0.5  # most of the error is shared


@pytest.mark.slow
def test_masters_that_contradict_the_camera_are_named():
    """Earlier, a flat at full scale left the pattern in, and a dark of ten times the exposure
    subtracted too much."""
    sensor = replace(SIMPLE, dark_current=2000.0, exposure_time=0.02, bits=12)
    shape, top = (SIDE, SIDE, 1), 4095.0
    raw, dark = jnp.full(shape, 900.0), js.expected_signal(sensor, jnp.zeros(shape))
    with pytest.raises(ValueError, match="flat is saturated in all its pixels"):
        js.correct(raw, sensor, masters=js.Masters(flat=js.Master(jnp.full(shape, top), 8)))
    flat = jnp.full(shape, 2000.0).at[3, 4].set(top)
    found = js.correct(
        raw, sensor, masters=js.Masters(dark=js.Master(dark, 8), flat=js.Master(flat, 8))
    )
    assert np.argwhere(np.isnan(found.image)).tolist() == [[3, 4, 0]]
    with pytest.warns(UserWarning, match=r"has a median of .* DN, where the camera states"):
        js.correct(raw, sensor, masters=js.Masters(dark=js.Master(dark + 200, 8)))


@pytest.mark.parametrize("swapped", [False, True])
def test_a_flat_without_light_is_refused(swapped):
    """A flat divided by its mean, or exchanged with the dark, gave NaN everywhere."""
    shape = (SIDE, SIDE, 1)
    dark, flat = (js.Master(jnp.full(shape, level), 8) for level in (SIMPLE.offset, 900.0))
    flat, dark = (dark, flat) if swapped else (js.Master(jnp.ones(shape), 8), dark)
    with pytest.raises(ValueError, match="shows no light above"):
        js.correct(jnp.full(shape, 500.0), SIMPLE, masters=js.Masters(dark=dark, flat=flat))


@pytest.mark.slow
def test_the_mean_of_a_patch_with_saturated_pixels_is_called_too_low():
    raw = jnp.full((SIDE, SIDE, 1), 900.0).at[:6].set(2.0**14 - 1)
    found = js.correct(raw, replace(SIMPLE, bits=14))
    with pytest.warns(UserWarning, match="0.25 of the patch's pixels are saturated"):
        found.mean()
    below = np.arange(SIDE)[:, None] * np.ones(SIDE) >= 6
    assert float(found.mean(below).mean[0]) > 0  # no warning
    with pytest.warns(UserWarning, match="saturated"):
        (found - js.correct(jnp.full_like(raw, 500.0), replace(SIMPLE, bits=14))).mean()


def test_unusable_pixels_of_flats_do_not_affect_the_scale_of_others():
    sensor = jv.Sensor(read_noise=5.0, gain=0.25, offset=60.0, bits=12)
    flat = jnp.full((24, 24, 1), 60.0 + 0.25 * 3000).at[:12].set(4095.0)
    flat = flat.at[15, 3].set(60.0).at[15, 9].set(50.0)
    raw = jnp.full((24, 24, 1), 60.0 + 0.25 * 3000)
    found = js.correct(raw, sensor, masters=js.Masters(flat=js.Master(flat, 16)))
    assert np.isnan(np.asarray(found.image)).sum() == 12 * 24 + 2
    assert np.allclose(np.asarray(found.image)[12:, 10:], 3000)
    assert np.isfinite(np.asarray(found.mean().variance)).all()


@pytest.mark.parametrize("scale", [1 / 4095, 1 / 16])
def test_numbers_on_another_scale_cause_a_warning(scale):
    sensor = jv.Sensor(read_noise=5.0, gain=0.25, offset=200.0, bits=12)
    raw = jnp.full((8, 8, 1), 800.0)
    with pytest.warns(UserWarning, match="below the 200 DN without light"):
        js.correct(raw * scale, sensor)
    js.correct(raw, sensor)


@pytest.mark.slow
def test_raw_numbers_of_a_colour_mosaic_are_corrected_without_a_warning():
    """This also holds with a light offset, whose share differs between the sites."""
    colours = jv.ColourFilter(jnp.diag(jnp.array([0.6, 1.0, 0.4])), pattern=((0, 1), (1, 2)))
    noise = {"shot_noise": jv.PoissonShotNoise(), "read_noise": 5.0}
    sensor = jv.Sensor(gain=0.4, offset=64.0, bits=12, colour_filter=colours, **noise)
    for camera in (sensor, replace(sensor, light_offset=50.0)):
        field = jnp.full((64, 64, 3), 3000.0)
        raw = jv.raw_image(jax.random.key(1), camera, field)
        green = np.asarray(js.correct(raw, camera).image)[::2, 1::2]
        assert abs(green.mean() - 3000) < 5 * np.sqrt(3000 / green.size)
        with pytest.warns(UserWarning, match="without light"):
            js.correct(raw / 64, camera)


def processed_frames():
    """Return a camera's frames of a smooth scene, and masters of 64 frames, by naive NumPy."""
    rng, shape = np.random.default_rng(0), (96, 96)
    gains, offsets = 1 + 0.01 * rng.normal(size=shape), 2 * rng.normal(size=shape)
    light = np.linspace(50, 8000, 96) * np.ones(shape)

    def frame(electrons):
        charge = rng.poisson(electrons * gains + 2.0) + offsets + 5 * rng.normal(size=shape)
        return np.clip(np.round(0.4 * charge + 64), 0, 4095)

    dark, flat = (sum(frame(e * np.ones(shape)) for _ in range(64)) / 64 for e in (0, 4000))
    return lambda: frame(light), dark, flat


def told_of(raw, **of):
    parts = {"read_noise": 5.0, "prnu": 0.01, "dsnu": 2.0, "dark_current": 40.0}
    sensor = jv.Sensor(
        shot_noise=jv.PoissonShotNoise(),
        gain=0.4,
        offset=64.0,
        bits=12,
        exposure_time=0.05,
        **parts,
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        js.correct(np.asarray(raw)[..., None], sensor, **of)
    assert all(one.filename == __file__ for one in told)
    return " ".join(str(one.message) for one in told)


def test_processed_frames_cause_a_warning():
    frame, dark, flat = processed_frames()
    masters = jv.Masters(dark=js.Master(dark[..., None], 64), flat=js.Master(flat[..., None], 64))
    assert told_of(frame()) == told_of(frame(), masters=masters) == ""
    mean = np.mean([frame() for _ in range(4)], axis=0)
    share = r"at its smoothest, has 0\.\d+ of the variance"
    assert "not whole, as means of frames" in told_of(mean)
    assert re.search(share, told_of(np.round(mean)))
    assert re.search(share, told_of(np.round(frame().reshape(48, 2, 48, 2).mean((1, 3)))))
    assert re.search(share, told_of(np.round(32 + frame() / 2)))  # half the gain
    assert "numbers below the" in told_of(frame() // 16)
    assert "numbers below the" in told_of(np.maximum(frame() - 64, 0))
    assert "numbers below the" in told_of(np.round(frame() - dark))
    assert "12 bits end at 4095" in told_of(16 * frame())
    response = (flat - dark) / np.mean(flat - dark)
    corrected = np.round(64 + (frame() - 64) / response)
    assert "lacks the pattern of masters.flat" in told_of(corrected, masters=masters)
    dim = np.round(64 + 0.1 * (frame() - 64) - dark + 64)
    assert "lacks the pattern of masters.dark" in told_of(dim, masters=masters)


@pytest.mark.parametrize("level", [300, 800, 1500])
def test_subtracted_black_in_uniform_light_causes_a_warning(level):
    """No number is below black. The noise would be that of 160 more electrons."""
    for seed in range(3):
        rng, shape = np.random.default_rng(seed), (128, 128)
        light = rng.poisson(level * (1 + 0.01 * rng.normal(size=shape)) + 2)
        charge = light + 5 * rng.normal(size=shape) + 2 * rng.normal(size=shape)
        raw = np.round(0.4 * charge + 64)
        assert told_of(raw) == ""
        assert "are then 162 electrons too small" in told_of(raw - 64)


def test_mirrored_frames_cause_a_warning():
    frame, dark, flat = processed_frames()
    masters = jv.Masters(dark=js.Master(dark[..., None], 64), flat=js.Master(flat[..., None], 64))
    for axis, words in ((1, "left to right"), (0, "top to bottom"), ((0, 1), "by 180 degrees")):
        told = told_of(np.flip(frame(), axis), masters=masters)
        assert re.search(rf"masters.flat where it is, but has it mirrored [^;]*{words}", told)
    assert "mirrored" not in told_of(np.roll(frame(), (8, 8), (0, 1)), masters=masters)


def test_masters_of_a_scene_another_mosaic_or_fewer_frames_are_warned_of():
    """A mean of frames of the scene as flat left no structure in the result, without a word."""
    rng, shape = np.random.default_rng(0), (96, 96)
    gains, offsets = 1 + 0.01 * rng.normal(size=shape), 2 * rng.normal(size=shape)
    rows, columns = np.mgrid[:96, :96] - 47.5
    fall_off = 1 / (1 + 0.3 * (rows**2 + columns**2) / 48**2) ** 2

    def frames(electrons, count=32):
        charge = rng.poisson(electrons * gains + 2.0, (count, *shape)) + offsets
        codes = np.round(0.4 * (charge + 5 * rng.normal(size=charge.shape)) + 64)
        return codes.mean(0)[..., None]

    colours = np.tile([[0.5, 1.0], [1.0, 0.35]], (48, 48))
    scene = fall_off * np.kron(rng.uniform(200, 5000, (8, 8)), np.ones((12, 12)))
    dark, white = js.Master(frames(0 * rows), 32), 4000 * fall_off

    def told(raw, flat, count=32):
        masters = js.Masters(dark=dark, flat=js.Master(flat, count))
        return told_of(raw[..., 0], masters=masters)

    raw, mosaic = frames(scene, 1), frames(scene * colours, 1)
    assert told(raw, frames(white)) == told(mosaic, frames(white * colours)) == ""
    assert "as a picture of a scene" in told(raw, frames(scene))
    for wrong in (raw, np.roll(mosaic, 1, 1)):
        assert "as of a colour mosaic, that raw lacks or" in told(wrong, frames(white * colours))
    assert re.search(r"masters.flat differ [12]\S* times", told(raw, frames(white, 1)))


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(12))
def test_raw_frames_of_cameras_cause_no_warning(seed):
    """The frames are dim and bright, with row noise, dark current, a curve, mixing or a well, over
    four scenes."""
    rng, size = np.random.default_rng(seed), 64
    gain = 10 ** rng.uniform(-1.5, 0.7)
    some = {
        "row_noise": 5.0,
        "nonlinearity": jv.Compression(0.05, electrons=4095 / gain),
        "mixing": jv.Mixing(jnp.asarray([[0, 0.01, 0], [0.01, 0.96, 0.01], [0, 0.01, 0]])),
        "full_well": 3000 / gain,
    }
    sensor = jv.Sensor(
        shot_noise=jv.PoissonShotNoise(),
        read_noise=10 ** rng.uniform(-0.5, 1.3),
        gain=gain,
        offset=rng.choice([0.0, 10.0, 64.0, 500.0]),
        bits=12,
        prnu=0.01,
        dsnu=10 ** rng.uniform(-1, 1.3),
        **{name: value for name, value in some.items() if rng.random() < 0.3},
    )
    light = 4095 / gain * 10 ** rng.uniform(-3, -0.05)
    rows, columns = np.mgrid[:size, :size] / size
    scenes = (
        np.ones((size, size)),
        columns,
        np.kron(rng.uniform(0.02, 1, (4, 4)), np.ones((16, 16))),
        0.5 + 0.5 * np.sin(9 * rows) * np.sin(12 * columns),
    )
    field = light * scenes[seed % 4][..., None]
    raw = jv.raw_image(jax.random.key(seed), sensor, field, die_key=jax.random.key(99))
    js.correct(raw, sensor)  # pytest turns warnings into errors
