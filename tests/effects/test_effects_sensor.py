"""Tests bounds on the effects of a sensor against moments in plain NumPy
(`oracles.sensor_moments`)."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from oracles.sensor_moments import distance, law, transfer_matrix
from oracles.sensors import EVERY_EFFECT
from random_sensors import SHAPE, draw, without
from scipy import stats

import jaxvision as jv
from jaxvision import scene as s
from jaxvision.effects import prune
from jaxvision.effects.overflow import Charge, excess
from jaxvision.effects.pixel import pixel_of
from jaxvision.effects.sensor import BOUNDS, SCALES, sensor_stage
from jaxvision.effects.sensor_charge import WHOLE, shares_along, transfer_shares
from jaxvision.effects.stages import Ends

ROUNDING = 1e-6  # DN, of the oracle's differences of large squares
NOT_MOMENTS = {"sensor.blooming", "sensor.bits"}  # have separate tests


def rows_of(sensor, light, shape=SHAPE):
    """Return the rows by name, and the response, for light in photons per pixel."""
    rows, response = sensor_stage(Ends(sensor, sensor), np.array([np.max(light)]), shape=shape)
    return {row.effect.name: row for row in rows}, response


def pixels(f):
    """Yield the types of pixels: with a trap, hot, and others."""
    for trapped in {False, "telegraph" in f}:
        for hot in {False, "hot" in f}:
            yield {"trapped": trapped, "hot": hot}


def changed(f, gone, light):
    return max(distance(law(f, light, **p), law(without(f, gone), light, **p)) for p in pixels(f))


def droppable(rows):
    return {
        name: row
        for name, row in rows.items()
        if row.drop is not None and row.effect.rank != "estimate"
    }


def dropped(rows, tolerance):
    """Return (names, promised DN), dropping the effect with the smallest remaining bound first."""
    rows, gone, total = droppable(rows), frozenset(), 0.0
    first = sorted(rows, key=lambda name: rows[name].after(frozenset()))
    for name in [*first, "sensor.full_well"]:  # the well is dropped after its blooming
        if name in gone or name not in rows or name == "sensor.bits":
            continue
        change = rows[name].after(gone)
        if rows[name].needs <= gone and total + change <= tolerance:
            gone, total = gone | {name}, total + change
    return gone, total


def check_sensor(seed, **kind):
    """Return (promised / actual change) of all dropped effects together, and of each alone."""
    sensor, f, light, rng = draw(seed, **kind)
    electrons = light * float(sensor.quantum_efficiency)
    rows, response = rows_of(sensor, light)
    alone = {}
    for name, row in droppable(rows).items():
        if name in NOT_MOMENTS or name == "sensor.quantum_efficiency":
            continue
        actual = changed(f, {name}, electrons)
        assert actual <= row.effect.bound * (1 + 1e-9) + ROUNDING, (seed, name)
        if actual > ROUNDING:
            alone[name] = row.effect.bound / actual
    tolerance = float(rng.choice([0.02, 0.1, 1.0])) * response.dark
    gone, promised = dropped(rows, tolerance)
    actual = changed(f, gone, electrons)
    assert actual <= promised * (1 + 1e-9) + ROUNDING, (seed, sorted(gone))
    return (promised / actual if actual > ROUNDING else None), alone


def test_a_few_random_sensors_against_moments():
    ratios = [check_sensor(seed)[0] for seed in range(4)]
    assert np.median([r for r in ratios if r is not None]) <= 1.5


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(300), marks=pytest.mark.slow)])
def test_random_sensors_with_all_effects_of_calibrations(seeds):
    """The sensors have light offset, mixing, a curve, noise of columns and frames, and taps besides
    all other effects."""
    found = [check_sensor(seed, further=True) for seed in seeds]
    for name in sorted({name for _, alone in found for name in alone}):
        ratios = [alone[name] for _, alone in found if name in alone]
        print(name, len(ratios), np.percentile(ratios, [25, 50, 75]).round(3))


def test_half_of_a_bound_is_caught():
    """The check above must fail for a bound that is too small by a factor of 2."""
    sensor, f, light, _ = draw(3)
    rows, _ = rows_of(sensor, light)
    actual = changed(f, {"sensor.read_noise"}, light * float(sensor.quantum_efficiency))
    assert actual > rows["sensor.read_noise"].effect.bound / 2


@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(60), marks=pytest.mark.slow)])
def test_no_charge_reaches_a_well_that_was_dropped(seeds):
    """Ten draws of each sensor in NumPy, with wells at the level where they begin to matter."""
    wells = 0
    for seed in seeds:
        sensor, f, light, rng = draw(seed, wells=False)
        mean = light * float(sensor.quantum_efficiency) + f.get("dark", 0.0)
        rms = math.hypot(math.sqrt(mean.max()), f.get("prnu", 0.0) * mean.max())
        well = mean.max() + rng.uniform(4, 8) * rms + 3
        sensor = replace(sensor, full_well=well, charge_transfer=None, smear=None, hot_pixels=None)
        sensor = replace(sensor, crosstalk=None)
        row = rows_of(sensor, light)[0]["sensor.full_well"]
        if row.effect.bound > 1e-3 * f["gain"]:
            continue
        wells += 1
        for _ in range(10):
            sensitivity = np.maximum(1 + f.get("prnu", 0.0) * rng.standard_normal(SHAPE), 0)
            expected = light * float(sensor.quantum_efficiency) * sensitivity + f.get("dark", 0.0)
            counts = rng.poisson(expected) if "shot" in f else expected
            assert counts.max() <= well
    assert wells >= len(seeds) / 4


def test_every_field_of_a_sensor_has_its_row():
    names = {field.name for field in fields(s.Sensor)}
    assert set(BOUNDS) == names - {"shutter", "own"}  # of motion, and a row for each effect
    assert names >= SCALES
    rows, _ = sensor_stage(Ends(EVERY_EFFECT, EVERY_EFFECT), np.ones(3), shape=(6, 8))
    assert {row.effect.name for row in rows} >= {f"sensor.{name}" for name in BOUNDS}
    assert all(row.effect.why for row in rows)


@pytest.mark.parametrize("counting", ["none", "poisson", "gaussian"])
@pytest.mark.parametrize("margin", [-2.0, 1.0, 5.0, 9.0])
def test_excess_over_a_level_against_sums(counting, margin):
    """The reference uses Poisson probabilities, closed forms for Gaussians, and quadrature for
    sensitivities."""
    light, prnu, dark = 900.0, 0.03, 20.0
    level = light + dark + margin * math.sqrt(light + (prnu * light) ** 2)
    got = excess(Charge(light, dark, prnu, 0.0, counting), level)
    g, weight = np.polynomial.hermite_e.hermegauss(60)
    means = light * np.maximum(1 + prnu * g, 0) + dark
    if counting == "poisson":
        n = np.arange(4000)
        over = np.maximum(n - level, 0)
        chance = stats.poisson.pmf(n, means[:, None])
        first, second = chance @ over, chance @ over**2
    else:
        rms = np.sqrt(means) if counting == "gaussian" else np.full_like(means, 1e-9)
        z = (means - level) / rms
        first = rms * (z * stats.norm.cdf(z) + stats.norm.pdf(z))
        second = rms**2 * ((1 + z**2) * stats.norm.cdf(z) + z * stats.norm.pdf(z))
    weight = weight / weight.sum()
    assert got.mean >= weight @ first * (1 - 1e-9)
    assert got.rms >= math.sqrt(max(weight @ second, 0)) * (1 - 1e-9)
    if margin == -2:
        assert got.rms <= 1.5 * math.sqrt(weight @ second)


@pytest.mark.slow
def test_counts_and_gaussians_of_the_same_moments_are_less_than_half_an_electron_apart():
    chance = (np.arange(40000) + 0.5) / 40000
    apart = [
        np.sqrt(np.mean((stats.poisson.ppf(chance, m) - stats.norm.ppf(chance, m, m**0.5)) ** 2))
        for m in np.geomspace(0.01, 1e4, 40)
    ]
    assert 0.95 * WHOLE <= max(apart) <= WHOLE
    assert apart[-1] == pytest.approx(math.sqrt(1 / 12 + 1 / 18), abs=2e-3)


def test_shares_of_a_packet_are_binomial():
    own, every = shares_along(0.02, 9, 3)
    shares = transfer_matrix(9, 0.02, 3)
    np.testing.assert_allclose(own, np.diag(shares), rtol=1e-12)
    np.testing.assert_allclose(every, shares.sum(1), rtol=1e-12)
    transfer = s.ChargeTransfer(0.02, serial_inefficiency=0.01, trail=3)
    lost, gained = transfer_shares(transfer, (9, 7))
    both = np.kron(shares, transfer_matrix(7, 0.01, 3))
    assert lost == pytest.approx(1 - np.diag(both).min())
    most = (both.sum(1) - np.diag(both)).max()
    assert gained == pytest.approx(most, rel=1e-9)


def spill(column, well, share):
    """Return a column after its overfull wells have spilled, in plain loops."""
    level = np.minimum(column, well)
    half = share * np.maximum(column - well, 0) / 2
    for order in (range(len(column)), range(len(column) - 1, -1, -1)):
        coming = 0.0
        for i in order:
            over = max(level[i] + coming - well, 0.0)
            level[i] = level[i] + coming - over
            coming = share * over + half[i]
    return level


@pytest.mark.parametrize("load", [0.9, 0.97, 1.0, 1.2])
def test_blooming_against_drawn_columns(load):
    """The RMS of the charge that spills into a column's pixels, from random draws, is below the
    bound."""
    rng, well, share, height = np.random.default_rng(5), 400.0, 0.7, 12
    light = np.full(height, load * well)
    light[3:5] = 0.2 * well
    sensor = s.Sensor(shot_noise=s.PoissonShotNoise(), full_well=well, blooming=share)
    rows, _ = rows_of(sensor, light, (height, 1))
    counts = rng.poisson(light, (3000, height)).astype(float)
    with_spill = np.array([spill(column.copy(), well, share) for column in counts])
    gained = with_spill - np.minimum(counts, well)
    assert np.sqrt((gained**2).mean(0)).max() <= rows["sensor.blooming"].effect.bound * 1.02
    both = [(x.mean(0), x.std(0)) for x in (with_spill, counts)]
    promised = rows["sensor.blooming"].effect.bound + rows["sensor.full_well"].effect.bound
    assert distance(*both) <= promised * 1.02


@pytest.mark.parametrize("noise", [0.0, 0.3, 0.6, 2.0])
@pytest.mark.parametrize("black", [0.0, 3.0, 40.0])
def test_rounding_and_clipping_against_integrals(noise, black):
    """The reference integrates the distribution of a rounded and clipped Gaussian, over means
    within a code."""
    sensor = s.Sensor(read_noise=noise, gain=0.5, offset=black, bits=8)
    row = rows_of(sensor, [400.0])[0]["sensor.bits"]
    actual = 0.0
    for mean in np.concatenate([black + np.linspace(0, 200, 173), [black]]):
        rms = max(noise * 0.5, 1e-9)
        codes = np.arange(256)
        edges = np.concatenate([[-np.inf], codes[:-1] + 0.5, [np.inf]])
        chance = np.diff(stats.norm.cdf(edges, mean, rms))
        first = chance @ codes
        second = max(chance @ (codes - first) ** 2, 0)
        actual = max(actual, math.hypot(first - mean, math.sqrt(second) - noise * 0.5))
    assert actual <= row.effect.bound * (1 + 1e-9) + 1e-9


class TestTraps:
    def test_pattern_is_counted_once_in_the_dark_noise(self):
        """4: DSNU is not temporal noise, but it still masks effects that are dropped besides it."""
        sensor = s.Sensor(read_noise=3.0, dsnu=4.0)
        rows, response = rows_of(sensor, [0.0])
        assert response.dark == pytest.approx(5.0)
        assert rows["sensor.dsnu"].effect.bound == pytest.approx(5 - 3)
        gone = frozenset({"sensor.read_noise"})
        assert rows["sensor.dsnu"].after(gone) == pytest.approx(4.0)

    def test_a_change_of_the_mean_also_changes_its_noise(self):
        """5: without other noise, d more electrons in the dark add sqrt(d) of noise."""
        sensor = s.Sensor(shot_noise=s.PoissonShotNoise())
        _, response = rows_of(sensor, [100.0])
        assert response.dn(np.array([4.0]), frozenset()) == pytest.approx(math.hypot(4, 2))
        still = s.Sensor()
        assert rows_of(still, [100.0])[1].dn(np.array([4.0]), frozenset()) == pytest.approx(4)

    def test_gains_of_columns_and_pixels_amplify_earlier_noise(self):
        """Trap 6."""
        plain = rows_of(s.Sensor(read_noise=2.0), [0.0])[0]["sensor.read_noise"].effect.bound
        wide = s.Sensor(read_noise=2.0, column_prnu=0.5)
        bound = rows_of(wide, [0.0])[0]["sensor.read_noise"].effect.bound
        assert bound == pytest.approx(plain * math.sqrt(1.25))

    def test_effects_that_depend_on_unbounded_light_are_kept(self):
        """7: neither 0 times infinity nor infinity minus infinity may drop anything."""
        sensor = replace(EVERY_EFFECT, colour_filter=None, crosstalk=0.0, prnu=0.0)
        rows, response = sensor_stage(Ends(sensor, sensor), np.full(3, np.inf), shape=(6, 8))
        bounds = {row.effect.name: row.effect.bound for row in rows}
        for name in ("crosstalk", "smear", "prnu", "shot_noise", "charge_transfer", "full_well"):
            assert bounds[f"sensor.{name}"] == math.inf, name
        assert bounds["sensor.read_noise"] < math.inf
        assert response.dn(np.full(3, np.inf), frozenset()) == math.inf
        assert not any(math.isnan(b) or b < 0 for b in bounds.values())

    def test_rounding_can_increase_a_change(self):
        """12: without noise a change of .01 DN may become 1 DN, so the promise is for values before
        rounding."""
        rows, _ = rows_of(s.Sensor(bits=8, gain=1.0, offset=10.0), [100.0])
        assert rows["sensor.bits"].effect.bound == pytest.approx(0.5, abs=1e-12)


def test_dropped_noise_makes_the_remaining_noise_more_visible():
    """The variance decreases as sources are dropped, so the later of two equal sources matters
    more."""
    rows, _ = rows_of(s.Sensor(dsnu=3.0, read_noise=3.0), [0.0])
    first = rows["sensor.dsnu"].after(frozenset())
    second = rows["sensor.read_noise"].after(frozenset({"sensor.dsnu"}))
    assert first + second == pytest.approx(math.sqrt(18))
    assert second > first


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [2, 9])
def test_bounds_hold_over_the_box_of_free_parameters(seed):
    """Bounds from the two ends hold for sensors between them."""
    rng = np.random.default_rng(1)
    sensor, f, light, _ = draw(seed, wells=False)
    low, high = f["read_noise"] / 3, f["read_noise"] * 3
    ends = Ends(replace(sensor, read_noise=low), replace(sensor, read_noise=high))
    rows, _ = sensor_stage(ends, np.array([light.max()]), shape=SHAPE)
    electrons = light * float(sensor.quantum_efficiency)
    for noise in rng.uniform(low, high, 20):
        now = {**f, "read_noise": noise}
        for row in rows:
            name = row.effect.name
            if row.drop is None or row.effect.rank == "estimate" or name in NOT_MOMENTS:
                continue
            if name != "sensor.quantum_efficiency":
                actual = changed(now, {name}, electrons)
                assert actual <= row.effect.bound * (1 + 1e-9) + ROUNDING, name


def test_an_attenuator_is_bounded_by_what_it_takes_away():
    sensor = s.Sensor(infrared_cut=[0.5, 1.0], quantum_efficiency=0.8)
    rows, _ = sensor_stage(Ends(sensor, sensor), np.array([10.0, 3.0]), shape=(1, 1))
    bounds = {row.effect.name: row.effect.bound for row in rows}
    assert bounds["sensor.infrared_cut"] == pytest.approx(0.5 * 0.8 * 10)
    assert bounds["sensor.quantum_efficiency"] == pytest.approx(0.2 * 5)
    clear = replace(sensor, infrared_cut=[1.0, 1.0])
    rows, _ = sensor_stage(Ends(clear, clear), np.full(2, np.inf), shape=(1, 1))
    assert rows[0].effect.rank == "exact"


def test_light_of_another_number_of_bands_is_refused_as_a_capture_refuses_it():
    sensor = s.Sensor(colour_filter=s.ColourFilter(np.ones((1, 31)), pattern=((0,),)))
    with pytest.raises(ValueError, match="31 bands"):
        sensor_stage(Ends(sensor, sensor), np.ones(3), shape=(4, 4))


def test_the_pixel_is_computed_without_dropped_effects():
    ends = Ends(EVERY_EFFECT, EVERY_EFFECT)
    gone = frozenset({"sensor.dsnu", "sensor.read_noise"})
    pixel = pixel_of(ends, np.ones(3), (6, 8), gone)
    assert {"dsnu", "read_noise"} & pixel.variances.high.keys() == set()
    assert pixel.dark == pytest.approx(500 * 2 ** (10 / 8) * 0.02)


@pytest.mark.parametrize(("rms", "most"), [(1.0, 1.03), (0.5, 1.3), (0.2, 2.0)])
@pytest.mark.sweep
def test_counts_with_noise_differ_little_more_than_their_moments(rms, most):
    """The reference is Wasserstein's distance of Poisson counts with Gaussian noise, by their
    quantiles."""
    tail = np.geomspace(1e-12, 1e-3, 500)
    u = np.concatenate([tail, np.linspace(1e-3, 1 - 1e-3, 5001)[1:-1], 1 - tail[::-1]])
    x = np.linspace(-9 * rms, 60, 20001)[:, None]

    def quantiles(mean):
        n = np.arange(60)
        below = (stats.norm.cdf((x - n) / rms) * stats.poisson.pmf(n, mean)).sum(1)
        return np.interp(u, below, x[:, 0])

    sensor = s.Sensor(read_noise=rms, shot_noise=s.PoissonShotNoise())
    _, response = sensor_stage(Ends(sensor, sensor), np.array([20.0]), shape=SHAPE)
    ratios = []
    for mean, more in ((0.0, 0.01), (0.0, 0.1), (0.1, 1.0), (2.0, 0.1), (10.0, 5.0)):
        apart = (quantiles(mean + more) - quantiles(mean)) ** 2
        found = math.sqrt(np.trapezoid(apart, u))
        ratios.append(found / response.dn(np.array([more]), frozenset()))
    assert 0.98 * most <= max(ratios) <= most


def test_every_certificate_explains_its_distance_in_dn():
    """The certificate says that the distance is one of moments, also if light is dropped."""
    floor = s.Surface(s.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.3]))
    lamps = jv.PointLight([0.0, 0, 2], [1.0]), jv.PointLight([0.0, 0, 2], [1e-6])
    view = s.Pinhole([0, 0, 3.0], np.diag([1.0, -1, -1]), 1.0, 0.1, resolution=(4, 4))
    camera = s.Camera(view, s.Sensor(shot_noise=s.PoissonShotNoise(), full_well=1e9))
    for tolerance in ("0.1DN", "0.1sigma"):
        left = prune(s.Scene(floor, lamps), camera, tolerance).certificate
        assert [e.name for e in left.dropped]
        assert any("mean and rms" in note for note in left.assumptions)
    assert not any(
        "rms" in n for n in prune(s.Scene(floor, lamps), view, "1%").certificate.assumptions
    )
