"""Tests effects found by calibrations beyond the linear model: mixing of neighbours, curves from
charge to signal, light offsets, taps, and noise shared by columns and frames.

Moments are checked against simulated frames and closed forms in NumPy and SciPy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensor_moments import shared
from scipy import stats
from scipy.interpolate import PchipInterpolator

import jaxvision as jv
from jaxvision import sensor as js
from jaxvision.core._bounds import Ends

KEY, DIE = jax.random.split(jax.random.key(5))
KERNEL = np.array([[0.0, 0.03, 0.01], [0.02, 0.88, 0.04], [0.0, 0.02, 0.0]])
CURVES = {
    "one term": jv.Compression(0.05, electrons=1e4),
    "two terms": jv.Compression(0.04, 0.02, electrons=1e4),
    "expansive": jv.Compression(-0.03, 0.01, electrons=1e4),
    "table": jv.ResponseTable([0, 2e3, 5e3, 1e4], [0, 2e3, 4.9e3, 9.3e3]),
    "spline": jv.ResponseSpline([0, 2e3, 5e3, 1e4], [0, 2e3, 4.9e3, 9.3e3]),
}
CHARGES = np.array([-40.0, 0.0, 1.0, 1500.0, 2000.0, 7777.0, 1e4, 1.4e4])


def straight_on(x, low, high, inside, first, last):
    """Return a curve that continues straight beyond both ends."""
    within = np.clip(x, low, high)
    return inside(within) + np.where(x < low, first, last) * (x - within)


def by_hand(curve, x):
    """Return the signal of a charge, in NumPy and SciPy."""
    if isinstance(curve, jv.Compression):
        c, d = float(curve.first), 0.0 if curve.second is None else float(curve.second)
        top = float(curve.electrons)
        last = 1 - 2 * c - 3 * d
        return straight_on(
            x, 0, top, lambda e: e * (1 - c * e / top - d * (e / top) ** 2), 1.0, last
        )
    at, to = np.asarray(curve.electrons, float), np.asarray(curve.signal, float)
    if isinstance(curve, jv.ResponseTable):
        chords = np.diff(to) / np.diff(at)
        return straight_on(x, at[0], at[-1], lambda e: np.interp(e, at, to), chords[0], chords[-1])
    cubic = PchipInterpolator(at, to)
    slope = cubic.derivative()
    return straight_on(x, at[0], at[-1], cubic, slope(at[0]), slope(at[-1]))


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.sweep
def test_curves_their_inverses_and_slopes(name):
    curve = CURVES[name]
    signal = js.signal_of_charge(curve, jnp.asarray(CHARGES))
    np.testing.assert_allclose(signal, by_hand(curve, CHARGES), rtol=3e-7, atol=1e-4)
    np.testing.assert_allclose(js.charge_of_signal(curve, signal), CHARGES, rtol=1e-6, atol=1e-3)
    inside = jnp.asarray([900.0, 3000.0, 7777.0])
    there = jax.vmap(jax.grad(lambda x: js.signal_of_charge(curve, x)))(inside)
    rise = by_hand(curve, np.asarray(inside) + 1) - by_hand(curve, np.asarray(inside) - 1)
    np.testing.assert_allclose(there, rise / 2, rtol=2e-4)
    read = js.signal_of_charge(curve, inside)
    back = jax.vmap(jax.grad(lambda s: js.charge_of_signal(curve, s)))(read)
    np.testing.assert_allclose(back * there, 1, rtol=2e-5)


@pytest.mark.parametrize("name", CURVES)
def test_slopes_of_curves_are_within_the_bounds_for_effects(name):
    """`slopes` bounds every slope between two of 4,000 charges, and is at most 0.1 % too wide."""
    curve = CURVES[name]
    moved, grows = js.stage_of(curve).bound(Ends(curve, curve), 1.0)
    x = np.linspace(-1e3, 1.5e4, 4001)
    slopes = np.diff(by_hand(curve, x)) / np.diff(x)
    assert max(slopes.max(), 1) <= grows * (1 + 1e-5)
    most = np.abs(slopes - 1).max()
    assert most <= moved * (1 + 1e-5) <= most + 2e-3


def test_the_inverse_of_a_curve_has_derivatives_by_its_parameters():
    """By the implicit function theorem, against differences."""

    def back(second):
        return js.charge_of_signal(jv.Compression(0.05, second, electrons=1e4), 7000.0)

    step = 1e-3
    wanted = (back(0.02 + step) - back(0.02 - step)) / (2 * step)
    np.testing.assert_allclose(jax.grad(back)(0.02), wanted, rtol=2e-3)


def frames(sensor, light, count, size=40):
    picture = jnp.full((size, size, 1), light)
    one = jax.jit(lambda key: jv.raw_image(key, sensor, picture, die_key=DIE)[..., 0])
    return np.asarray(jax.lax.map(one, jax.random.split(KEY, count), batch_size=50))


def at(function, sensor, light, **options):
    return np.asarray(function(sensor, jnp.full((1, 1, 1), light), **options)).squeeze()


def covariances(found, reach):
    """Return covariances of pixels i rows and j columns apart, the mean of (i, j) and (i, -j)."""
    x = found - found.mean(0)
    h, w = x.shape[1:]
    result = np.zeros((reach + 1, reach + 1))
    for i in range(reach + 1):
        for j in range(reach + 1):
            right = x[:, : h - i, : w - j] * x[:, i:, j:]
            left = x[:, : h - i, j:] * x[:, i:, : w - j]
            result[i, j] = (right.mean() + left.mean()) / 2
    return result * len(x) / (len(x) - 1)


def test_mixing_equals_a_naive_loop():
    picture = np.random.default_rng(2).uniform(0, 100, (7, 9))
    found = js.mixed(jnp.asarray(picture)[..., None], jv.Mixing(KERNEL))[..., 0]
    np.testing.assert_allclose(found, shared(picture, KERNEL), rtol=2e-6)
    even = js.mixed(jnp.asarray(picture)[..., None], js.even_mixing(0.2))
    np.testing.assert_allclose(even.sum(), picture.sum(), rtol=1e-6)
    np.testing.assert_allclose(1 - np.sum(np.asarray(js.even_mixing(0.2).kernel) ** 2), 0.2)


@pytest.mark.slow
def test_moments_of_mixed_poisson_counts_equal_sums_over_the_kernel():
    """They are V sum w^2 and V sum w(k) w(k + lag), with a total of V."""
    sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), mixing=jv.Mixing(KERNEL), gain=0.5)
    assert at(jv.expected_signal, sensor, 800.0) == pytest.approx(400)
    variance = at(jv.signal_variance, sensor, 800.0)
    np.testing.assert_allclose(variance, 200 * (KERNEL**2).sum(), rtol=1e-6)
    found = at(js.neighbour_covariances, sensor, 800.0, reach=2)
    wide = np.pad(KERNEL, 2)
    for i, j in np.ndindex(3, 3):
        lags = [np.sum(wide * np.roll(wide, (-i, sign * j), (0, 1))) for sign in (1, -1)]
        np.testing.assert_allclose(found[i, j], 200 * np.mean(lags), rtol=1e-5, atol=1e-4)
    copies = np.outer([1, 2, 2], [1, 2, 2])
    np.testing.assert_allclose((found * copies).sum(), 200, rtol=1e-6)


@pytest.mark.slow
def test_all_of_them_together_against_simulated_frames():
    """Mean, variance and covariances of 3,000 frames are within 4.5 standard errors."""
    sensor = jv.Sensor(
        light_offset=300.0,
        shot_noise=jv.PoissonShotNoise(),
        brighter_fatter=jv.BrighterFatter([[2e-6, 3e-7], [1e-7, 0.0]]),
        mixing=jv.Mixing(KERNEL),
        nonlinearity=jv.Compression(0.05, 0.02, electrons=1e4),
        read_noise=5.0,
        row_noise=3.0,
        column_noise=4.0,
        frame_noise=2.0,
        banding=jv.Banding(3.0, 3.5),
        gain=0.5,
        offset=100.0,
        bits=14,
    )
    count, light, size = 3000, 8000.0, 40
    found = frames(sensor, light, count, size)[:, 2:-2, 2:-2]
    per_pixel = found.shape[1] * found.shape[2]
    variance = at(jv.signal_variance, sensor, light)
    of_frames = found.mean((1, 2)).std()
    error = of_frames / np.sqrt(count)
    assert abs(found.mean() - at(jv.expected_signal, sensor, light)) < 4.5 * error
    wanted = at(js.neighbour_covariances, sensor, light, reach=2)
    np.testing.assert_allclose(wanted[0, 0], variance, rtol=1e-6)
    halves = [covariances(part, 2) for part in np.split(found, 20)]
    spread = np.std(halves, axis=0, ddof=1) / np.sqrt(20)
    z = (np.mean(halves, axis=0) - wanted) / spread
    assert np.abs(z).max() < 4.5, z
    assert per_pixel > 1000
    alone = replace(sensor, mixing=None)
    assert at(jv.signal_variance, alone, light) > 1.1 * variance


@pytest.mark.slow
def test_noise_of_columns_and_frames_against_simulated_frames():
    sensor = jv.Sensor(read_noise=1.0, column_noise=4.0, frame_noise=3.0)
    uneven = replace(sensor, column_prnu=0.1, conversion_prnu=0.1, gain=2.0, bits=12)
    wanted = [[4 * (26 * 1.01) + 1 / 12, 36], [4 * 25 * 1.01, 36]]
    np.testing.assert_allclose(at(js.neighbour_covariances, uneven, 0.0), wanted, rtol=1e-6)
    found = frames(sensor, 0.0, 600, 24)
    wanted = at(js.neighbour_covariances, sensor, 0.0)
    np.testing.assert_allclose(wanted, [[26, 9], [25, 9]])
    np.testing.assert_allclose(covariances(found, 1), wanted, rtol=0.2)
    assert not np.array_equal(found[0], found[1])


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["two terms", "spline"])
def test_moments_behind_a_curve_against_sums_over_counts(name):
    """The reference sums over Poisson's probabilities. The closed form has an error of order 1 /
    m^2."""
    curve, light = CURVES[name], 3000.0
    sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), nonlinearity=curve, gain=0.5)
    counts = np.arange(2000, 4000)
    chance, signal = stats.poisson.pmf(counts, light), 0.5 * by_hand(curve, counts)
    mean = chance @ signal
    assert at(jv.expected_signal, sensor, light) == pytest.approx(mean, rel=3e-7)
    variance = chance @ (signal - mean) ** 2
    assert at(jv.signal_variance, sensor, light) == pytest.approx(variance, rel=1e-3)
    naive = 0.5 * by_hand(curve, light)
    assert abs(naive - mean) > 1e-3  # noise changes the mean


@pytest.mark.slow
def test_faint_light_behind_a_curve_is_summed_over_counts():
    curve = jv.Compression(0.3, electrons=20.0)
    sensor = jv.Sensor(
        shot_noise=jv.PoissonShotNoise(), nonlinearity=curve, read_noise=0.3, gain=2.0, bits=8
    )
    counts, codes = np.arange(60), np.arange(256)
    signal = 2 * by_hand(curve, counts)[:, None]
    above = stats.norm.cdf((codes + 0.5 - signal) / 0.6)
    below = stats.norm.cdf((codes - 0.5 - signal) / 0.6)
    below[:, 0], above[:, -1] = 0, 1
    share = stats.poisson.pmf(counts, 5.0) @ (above - below)
    mean = share @ codes
    found = jv.clipped_moments(sensor, jnp.asarray([5.0]))
    np.testing.assert_allclose(found.mean[0], mean, rtol=1e-5)
    np.testing.assert_allclose(found.variance[0], share @ (codes - mean) ** 2, rtol=1e-4)


def test_a_light_offset_in_photons_and_in_seconds():
    bands = jnp.array([1e5, 2e5])
    plain = jv.Sensor(quantum_efficiency=[0.5, 0.25], exposure_time=0.01, infrared_cut=[0.8, 1])
    beside = replace(plain, light_offset=[100.0, -40.0])
    found = jv.mean_photoelectrons(beside, bands) - jv.mean_photoelectrons(plain, bands)
    np.testing.assert_allclose(found, [0.8 * 0.5 * 100, -0.25 * 40], rtol=1e-5)
    dark = jv.mean_photoelectrons(beside, 0 * bands)
    np.testing.assert_allclose(dark, found, rtol=1e-5)
    late = replace(plain, light_offset=jv.ShutterOffset(1e-3), dark_current=100.0)
    np.testing.assert_allclose(
        jv.mean_photoelectrons(late, bands), 1.1 * jv.mean_photoelectrons(plain, bands), rtol=1e-6
    )
    assert jv.expected_signal(late, 0 * bands).tolist() == [1.0, 1.0]  # by the dark current
    with pytest.raises(ValueError, match="exposure_time must be given with a ShutterOffset"):
        jv.Sensor(light_offset=jv.ShutterOffset(1e-3))


@pytest.mark.sweep
@pytest.mark.parametrize("stretched", [False, True])
def test_taps_affect_their_own_pixels(stretched):
    taps = jv.Taps(
        ((0, 1), (2, 3)),
        offset=[0.0, 5.0, 10.0, -3.0],
        gain=[1.0, 1.1, 0.9, 1.0],
        read_noise=[1.0, 2.0, 1.0, 0.5],
        prnu=[1.0, 1.0, 3.0, 0.0],
        stretched=stretched,
    )
    sensor = jv.Sensor(taps=taps, read_noise=4.0, prnu=0.02, gain=0.5, offset=100.0)
    rows, columns = np.indices((8, 10))
    at_row, at_column = (rows // 4, columns // 5) if stretched else (rows % 2, columns % 2)
    tap = at_row * 2 + at_column
    light = jnp.full((8, 10, 1), 1000.0)
    offset, gain, read, pattern = (
        np.asarray(getattr(taps, name), float)[tap]
        for name in ("offset", "gain", "read_noise", "prnu")
    )
    np.testing.assert_allclose(
        jv.expected_signal(sensor, light)[..., 0], 500 * gain + 100 + offset, rtol=1e-6
    )
    np.testing.assert_allclose(
        jv.signal_variance(sensor, light)[..., 0], (0.5 * gain * 4 * read) ** 2, rtol=1e-6
    )
    np.testing.assert_allclose(
        jv.pattern_variance(sensor, light)[..., 0], (0.5 * gain * 20 * pattern) ** 2, rtol=1e-5
    )
    many = jax.vmap(lambda key, die: jv.raw_image(key, sensor, light, die_key=die)[..., 0])(
        jax.random.split(KEY, 4000), jax.random.split(DIE, 4000)
    )
    spread = np.var(many, axis=0)
    wanted = (0.5 * gain) ** 2 * ((4 * read) ** 2 + (20 * pattern) ** 2)
    for one in range(4):
        of_tap = spread[tap == one].mean() / wanted[tap == one].mean()
        assert abs(of_tap - 1) < 5 * np.sqrt(2 / (4000 * 20))


def test_invalid_taps_kernels_and_curves_are_refused():
    with pytest.raises(ValueError, match=r"Sensor\.prnu must be given with Taps\.prnu"):
        jv.Sensor(taps=jv.Taps(((0, 1),), prnu=[1.0, 2.0]))
    with pytest.raises(ValueError, match=r"Taps\.pattern has the 2 bands .* Taps\.gain has 3"):
        jv.Taps(((0, 1),), gain=[1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"Taps\.gain must be .*above 0, got -1"):
        jv.Taps(((0, 1),), gain=[1.0, -1.0])
    with pytest.raises(ValueError, match=r"Sensor\.taps needs an image"):
        jv.expected_signal(jv.Sensor(taps=jv.Taps(((0, 1),), gain=[1.0, 2.0])), jnp.ones(1))
    with pytest.raises(ValueError, match=r"Mixing\.kernel must sum to 1, got 0\.9"):
        jv.Mixing([[0.9]])
    with pytest.raises(ValueError, match="odd numbers of rows and columns"):
        jv.Mixing([[0.5, 0.5]])
    with pytest.raises(ValueError, match=r"must rise up to its electrons, got a slope of -0\.2"):
        jv.Compression(0.6, electrons=100.0)
    with pytest.raises(ValueError, match=r"ResponseTable\.signal must ascend"):
        jv.ResponseTable([0.0, 1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="at least two entries"):
        jv.ResponseSpline([0.0], [1.0])


FULL = jv.Sensor(
    exposure_time=0.01,
    light_offset=jv.ShutterOffset(1e-5),
    shot_noise=jv.PoissonShotNoise(),
    mixing=jv.Mixing(KERNEL),
    nonlinearity=jv.Compression(0.05, 0.02, electrons=1e4),
    read_noise=5.0,
    column_noise=4.0,
    frame_noise=2.0,
    prnu=0.01,
    gain=0.5,
    taps=jv.Taps(((0, 1),), offset=[0.0, 1 / 3], gain=[1.0, 1.1], prnu=[1, 2], stretched=True),
)


@pytest.mark.parametrize("curve", CURVES.values(), ids=list(CURVES))
@pytest.mark.sweep
def test_a_sensor_file_contains_them_and_their_draws(tmp_path, curve):
    sensor = replace(FULL, nonlinearity=curve)
    shifts = 1e-4 * jnp.arange(5.0)
    draws = jax.vmap(lambda shift: jax.tree.map(lambda x: x + shift, sensor))(shifts)
    jv.write_sensor(sensor, tmp_path / "sensor.toml", draws=draws)
    back = jv.read_sensor(tmp_path / "sensor.toml")
    assert jax.tree.structure(back) == jax.tree.structure(sensor)
    for one, other in zip(*map(jax.tree.leaves, (back, sensor)), strict=True):
        np.testing.assert_array_equal(one, other)
    drawn = jv.read_sensor(tmp_path / "sensor.toml", draws=5)
    light = jnp.full((2, 2, 1), 1e5)
    means = jax.vmap(lambda one: jv.expected_signal(one, light))(drawn)
    assert means.shape == (5, 2, 2, 1)
    assert len(np.unique(means[:, 0, 0, 0])) == 5


def test_absent_effects_do_not_change_the_program():
    """The jaxpr of a sensor without them has no operation of theirs."""
    plain = jv.Sensor(read_noise=2.0, gain=0.5)
    picture = jnp.ones((4, 4, 1))

    def program(sensor):
        return str(jax.make_jaxpr(lambda s, x: jv.raw_image(KEY, s, x))(sensor, picture))

    nothing = program(plain)
    for field, value in {
        "mixing": jv.Mixing([[1.0]]),
        "nonlinearity": jv.Compression(0.0, electrons=1.0),
        "taps": jv.Taps(((0,),), gain=[1.0]),
        "light_offset": 0.0,
        "frame_noise": 0.0,
        "column_noise": 0.0,
    }.items():
        assert len(program(replace(plain, **{field: value}))) > len(nothing)
        assert program(replace(replace(plain, **{field: value}), **{field: None})) == nothing
