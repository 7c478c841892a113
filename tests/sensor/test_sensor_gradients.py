"""Tests gradients through random draws: unbiased where promised, and otherwise with the stated
bias, against closed forms and sums over the Poisson distribution, within 3 standard errors."""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxvision import Sensor, raw_image, scene
from jaxvision.sensor import expected_of_count, expected_of_defect, expected_of_reading
from jaxvision.sensor.expectation import ESTIMATORS

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "gradients_of_noise.md"
KEY, DIE = jax.random.split(jax.random.key(3))
POISSON = scene.PoissonShotNoise()
# f and its slope by the count
FUNCTIONS = {
    "N²": (lambda n: n**2, lambda n: 2 * n),
    "N³": (lambda n: n**3, lambda n: 3 * n**2),
    "empty": (lambda n: (n < 0.5).astype(float), lambda n: 0 * n),
    "√(N + 3/8)": (lambda n: (n + 0.375) ** 0.5, lambda n: 0.5 / (n + 0.375) ** 0.5),
}


def within(found, true, errors=3):
    found = np.asarray(found, float)
    assert abs(found.mean() - true) <= errors * found.std() / np.sqrt(found.size) + 1e-12


def of_one_draw(name, m):
    """Return the true derivative, and (bias, standard deviation) of each estimator."""
    f, along = FUNCTIONS[name]
    n = np.arange(m + 40 * np.sqrt(m) + 60)
    p = stats.poisson.pmf(n, m)
    true = p @ f(n + 1) - p @ f(n)
    by = (along(n) * (0.5 + n / (2 * m)), f(n + 1) - f(n), (f(n) - p @ f(n)) * (n / m - 1))
    return true, [(p @ g - true, np.sqrt(p @ (g - p @ g) ** 2)) for g in by]


def test_closed_forms():
    for m in (0.01, 0.5, 10.0):
        slopes = {"N²": 2 * m + 1, "N³": 3 * m**2 + 6 * m + 1, "empty": -np.exp(-m)}
        for name, slope in slopes.items():
            np.testing.assert_allclose(of_one_draw(name, m)[0], slope, rtol=1e-12)


def test_the_page_states_these_numbers():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.read_text().split("\n")
    ]
    rows = [row for row in rows if row and row[0] in FUNCTIONS]
    assert len(rows) == 11
    for name, *numbers in rows:
        mean, slope, *stated = map(float, numbers)
        true, by = of_one_draw(name, mean)
        np.testing.assert_allclose(slope, true, rtol=5e-3)
        np.testing.assert_allclose(stated, np.ravel(by), rtol=0.06, atol=1e-9)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_estimators_have_the_stated_bias_and_variance(estimator):
    means = jnp.asarray([0.01, 0.5, 10.0])
    draws = 2 if estimator == "score" else 1

    def slopes(function):
        return jax.grad(
            lambda m: expected_of_count(KEY, m, function, estimator=estimator, draws=draws).sum()
        )(jnp.broadcast_to(means, (40_000, 3)))

    number = ESTIMATORS.index(estimator)
    for name, (f, _) in FUNCTIONS.items():
        found = np.asarray(slopes(f))
        for k, m in enumerate(np.asarray(means)):
            true, by = of_one_draw(name, m)
            bias, deviation = by[number]
            if name == "empty" and m > 1:
                continue  # rarely drawn
            within(found[:, k], true + bias)
            # the baseline is one other draw: (f - f')(N - N') / (2 m), with twice the noise of f
            if estimator != "score":
                np.testing.assert_allclose(found[:, k].std(), deviation, rtol=0.2)


@pytest.mark.slow
def test_score_estimates_of_a_whole_picture_and_of_closed_over_values():
    """The functions are the probability that all pixels of a row are empty, exp(-sum m), and the
    mean of f = exp(-b N) by b."""
    m = jnp.asarray([0.3, 0.1, 0.5])

    def all_empty(n):
        return jnp.where(n.sum() < 0.5, 1.0, 0.0)

    def chance(mean, key):
        return expected_of_count(key, mean, all_empty, estimator="score", draws=4)

    found = jax.jit(jax.vmap(jax.grad(chance), (None, 0)))(m, jax.random.split(KEY, 4000))
    for k in range(3):
        within(found[:, k], -np.exp(-0.9))

    def faded(b):
        return expected_of_count(KEY, jnp.full(40_000, 0.5), lambda n: jnp.exp(-b * n))

    wanted = -0.5 * np.exp(-1.0) * np.exp(-0.5 * (1 - np.exp(-1.0)))  # d/db exp(-m (1 - e^-b))
    slope = float(jax.jit(jax.grad(lambda b: faded(b).mean()))(1.0))
    assert abs(slope / wanted - 1) < 0.03


def test_wrong_estimators_and_shapes_are_refused():
    m = jnp.ones(3)
    with pytest.raises(ValueError, match="estimator must be"):
        expected_of_count(KEY, m, jnp.square, estimator="naive")
    with pytest.raises(ValueError, match="draws must be"):
        expected_of_count(KEY, m, jnp.square, estimator="score", draws=1)
    with pytest.raises(ValueError, match=r"must return values of shape \(3,\)"):
        expected_of_count(KEY, m, jnp.sum)


# ------------------------------------------------ readings and defects

NUMBERS = {  # f and its steps; f' is 0 between steps
    "number": (lambda x: jnp.clip(jnp.round(x), 0, 3), (0.5, 1.5, 2.5)),
    "number²": (lambda x: jnp.clip(jnp.round(x), 0, 3) ** 2, (0.5, 1.5, 2.5)),
}


def of_one_reading(name, mean, rms):
    """Return the true derivatives by mean and rms, and (bias, standard deviation) of each estimator
    for one draw."""
    f, steps = NUMBERS[name]
    f = partial(lambda g, x: np.asarray(g(jnp.asarray(x))), f)
    z = [(step - mean) / rms for step in steps]
    jumps = [f(step + 0.25) - f(step - 0.25) for step in steps]
    true = [
        sum(j * stats.norm.pdf(a) * a**power for j, a in zip(jumps, z, strict=True)) / rms
        for power in (0, 1)
    ]
    u = (np.arange(200_000) + 0.5) / 200_000
    draw, flat, deep = stats.norm.ppf(u), stats.chi(2).ppf(u), stats.chi(3).ppf(u)
    deep = np.concatenate([-deep, deep])
    here = f(mean + rms * draw)
    apart = (f(mean + rms * flat) - f(mean - rms * flat)) / (rms * np.sqrt(2 * np.pi))
    aside = f(mean + rms * deep)  # independent of `here`
    measured = (apart.mean(), (aside.mean() - here.mean()) / rms)
    deviations = (apart.std(), np.hypot(aside.std(), here.std()) / rms)
    scores = [(here - here.mean()) * weight / rms for weight in (draw, draw**2 - 1)]
    for k in range(2):
        np.testing.assert_allclose([measured[k], scores[k].mean()], true[k], rtol=2e-3, atol=2e-4)
    found = [[(-true[k], 0.0), (0.0, deviations[k]), (0.0, scores[k].std())] for k in range(2)]
    return true, found


READINGS = ((0.5, 0.1), (0.3, 0.5), (2.9, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_estimators_of_readings_that_are_rounded_and_clipped(estimator):
    number, draws = ESTIMATORS.index(estimator), 2 if estimator == "score" else 1
    pixels = 40_000

    for name, (f, _) in NUMBERS.items():

        @jax.jit
        def slopes(mean, rms, f=f):
            return jax.grad(
                lambda m, s: jnp.sum(
                    jax.vmap(
                        lambda key, m, s: expected_of_reading(
                            key, m, s, f, estimator=estimator, draws=draws
                        )
                    )(jax.random.split(KEY, pixels), m, s)
                ),
                (0, 1),
            )(jnp.full(pixels, mean), jnp.full(pixels, rms))

        for mean, rms in READINGS:
            true, by = of_one_reading(name, mean, rms)
            for k, found in enumerate(map(np.asarray, slopes(mean, rms))):
                bias, deviation = by[k][number]
                within(found, true[k] + bias)
                if estimator != "score":
                    np.testing.assert_allclose(found.std(), deviation, rtol=0.2, atol=1e-9)


@pytest.mark.slow
def test_the_page_states_these_numbers_for_readings():
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.read_text().split("\n")
    ]
    rows = [row for row in rows if row and row[0] in NUMBERS]
    assert len(rows) == 6
    for name, *numbers in rows:
        mean, rms, slope, *stated = map(float, numbers)
        true, by = of_one_reading(name, mean, rms)
        np.testing.assert_allclose(slope, true[0], rtol=6e-3)
        np.testing.assert_allclose(stated, np.ravel(by[0]), rtol=0.06, atol=5e-4)


@pytest.mark.slow
def test_clipping_alone_has_the_derivatives_of_its_closed_form():
    """For max(X, 0) they are Phi(m / s) and phi(m / s), by every estimator."""
    mean, rms = 0.3, 0.5
    wanted = (stats.norm.cdf(mean / rms), stats.norm.pdf(mean / rms))
    for estimator in ESTIMATORS:

        def each(key, m, s, estimator=estimator):
            return expected_of_reading(
                key, m, s, lambda x: jnp.maximum(x, 0), estimator=estimator, draws=2
            )

        program = jax.jit(jax.vmap(jax.grad(each, (1, 2)), (0, None, None)))
        found = program(jax.random.split(KEY, 40_000), mean, rms)
        for slope, true in zip(found, wanted, strict=True):
            within(slope, true)


def test_score_estimates_of_pictures_of_readings_and_defects():
    """The functions are the probability that all three readings are above 0, and that none of three
    pixels is dead."""
    mean, chance = jnp.asarray([0.2, 0.5, 1.0]), jnp.asarray([0.1, 0.3, 0.2])

    def all_above(m, key):
        return expected_of_reading(
            key, m, 1.0, lambda x: (x > 0).all().astype(x.dtype), estimator="score", draws=4
        )

    def none_dead(p, key):
        return expected_of_defect(
            key, p, lambda b: (b.sum() < 0.5).astype(b.dtype), estimator="score", draws=4
        )

    keys = jax.random.split(KEY, 4000)
    above = np.asarray(jax.jit(jax.vmap(jax.grad(all_above), (None, 0)))(mean, keys))
    alive = np.asarray(jax.jit(jax.vmap(jax.grad(none_dead), (None, 0)))(chance, keys))
    ratio = stats.norm.pdf(mean) / stats.norm.cdf(mean)
    for k in range(3):
        within(above[:, k], stats.norm.cdf(mean).prod() * ratio[k])
        within(alive[:, k], -np.prod(1 - chance) / (1 - chance[k]))


@pytest.mark.sweep
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_derivatives_by_the_probability_of_defects(estimator):
    """E[f] = p f(1) + (1 - p) f(0), for first and second moments of a pixel of 100 that may be
    dead, and of a hot one."""
    pixels = 40_000
    for chance in (1e-3, 0.2):
        for with_it, without in ((0.0, 100.0), (0.0, 1e4), (900.0, 100.0)):

            def each(key, p, with_it=with_it, without=without):
                return expected_of_defect(
                    key,
                    p,
                    lambda b: jnp.where(b > 0.5, with_it, without),
                    estimator=estimator,
                    draws=2,
                )

            program = jax.jit(jax.vmap(jax.value_and_grad(each, 1), (0, None)))
            value, found = program(jax.random.split(KEY, pixels), chance)
            within(value, chance * with_it + (1 - chance) * without)
            if estimator == "score":
                within(found, with_it - without)
            else:
                slope = 0 if estimator == "pathwise" else with_it - without
                np.testing.assert_array_equal(found, slope)


@pytest.mark.slow
def test_no_noise_and_certain_defects_have_finite_derivatives():
    for estimator in ESTIMATORS:
        reading = partial(expected_of_reading, KEY, function=jnp.round, estimator=estimator)
        defect = partial(expected_of_defect, KEY, function=lambda b: 3 * b, estimator=estimator)
        assert np.isfinite(jax.grad(reading, (0, 1))(jnp.asarray(0.4), jnp.asarray(0.0))).all()
        for chance in (0.0, 1.0):
            assert np.isfinite(jax.grad(defect)(jnp.asarray(chance)))


# ------------------------------------------------ the sensor

LEVELS = jnp.asarray([0.01, 0.5, 2.0, 100.0])


def by_level(sensor, *, key=KEY):
    """Return raw numbers of many pixels at each level, and their derivatives by it."""
    light = jnp.broadcast_to(LEVELS[:, None, None, None], (len(LEVELS), 200, 200, 1))
    shoot = jax.jit(
        lambda x: jax.jvp(lambda y: raw_image(key, sensor, y), (x,), (jnp.ones_like(x),))
    )
    return (np.asarray(part).reshape(len(LEVELS), -1) for part in shoot(light))


@pytest.mark.slow
def test_raw_numbers_have_unbiased_first_and_second_moments():
    """For Y = K (N + read) + offset + rounding, the derivatives are K and K^2 + 2 K E[Y]."""
    sensor = Sensor(shot_noise=POISSON, read_noise=3.0, gain=0.5, offset=20.0, bits=12)
    number, slope = by_level(sensor)
    for k, m in enumerate(np.asarray(LEVELS)):
        within(slope[k], 0.5)
        within(2 * number[k] * slope[k], 0.25 + 2 * 0.5 * (20 + 0.5 * m))


def test_a_full_well_clips_counts_with_the_stated_bias():
    """The reference sums the derivative of each Poisson count."""
    well = 100.0
    number, slope = by_level(Sensor(shot_noise=POISSON, full_well=well))
    for k, m in enumerate(np.asarray(LEVELS)):
        bias = -(1 - m / well) * stats.poisson.pmf(well - 1, m) / 4
        n = np.arange(400.0)
        passed = np.where(n < well, 1, np.where(n == well, 0.5, 0))
        exact = (stats.poisson.pmf(n, m) * passed * (0.5 + n / (2 * m))).sum()
        np.testing.assert_allclose(exact - stats.poisson.cdf(well - 1, m), bias, atol=1e-12)
        within(slope[k], stats.poisson.cdf(well - 1, m) + bias)
    assert (slope[number > well - 0.5] < 1).all()


@pytest.mark.slow
@pytest.mark.parametrize(("well", "most"), [(5, 0.037), (10, 0.014), (100, 9e-4)])
def test_a_full_well_biases_derivatives_of_mean_squares_as_stated(well, most):
    """The squares are of Poisson counts, for means up to the full well."""
    for m in np.linspace(0.01, well, 60):
        bias = -(well - m) * stats.poisson.pmf(well - 1, m) / 2
        n = np.arange(400.0)
        passed = np.where(n < well, 1, np.where(n == well, 0.5, 0))
        drawn = 2 * np.minimum(n, well) * passed * (0.5 + n / (2 * m))
        below = np.arange(float(well))
        true = ((2 * below + 1) * stats.poisson.pmf(below, m)).sum()
        np.testing.assert_allclose((stats.poisson.pmf(n, m) * drawn).sum() - true, bias, atol=1e-9)
        assert abs(bias) <= most * true
    level, draws = 0.8 * well, 200_000
    light = jnp.full((draws, 1), level)
    shoot = partial(raw_image, KEY, Sensor(shot_noise=POISSON, full_well=float(well)))
    number, slope = jax.jvp(shoot, (light,), (jnp.ones_like(light),))
    below = np.arange(float(well))
    true = ((2 * below + 1) * stats.poisson.pmf(below, level)).sum()
    bias = -(well - level) * stats.poisson.pmf(well - 1, level) / 2
    within(2 * np.asarray(number * slope).ravel(), true + bias)


@pytest.mark.parametrize(("rms", "most"), [(0.5, 0.0144), (1.0, 6e-9)])
def test_the_error_of_derivatives_through_rounding_is_the_stated_one(rms, most):
    """The mean of rounded Gaussian numbers has a derivative of 1, up to the stated error."""
    n = np.arange(-30, 31)
    for at in np.linspace(0, 0.5, 6):
        true = stats.norm.pdf(n + 0.5, at, rms).sum()  # d/d mu of sum n P(n)
        assert abs(true - 1) <= most
    assert abs(stats.norm.pdf(n + 0.5, 0, rms).sum() - 1) > 0.9 * most or rms == 1.0
    sensor = Sensor(read_noise=rms, offset=30.0, bits=8)
    slope = jax.grad(lambda x: raw_image(KEY, sensor, x).sum())(jnp.full((4, 1), 2.3))
    np.testing.assert_array_equal(slope, 1)


def test_defects_have_derivatives_by_their_parameters():
    """For hot pixels of fraction p and mean r: E[x] = p r and E[x^2] = 2 p r^2."""
    shape = (300, 300, 1)

    def hot(p, r):
        sensor = Sensor(exposure_time=1.0, hot_pixels=scene.HotPixels(p, r))
        return raw_image(None, sensor, jnp.zeros(shape), die_key=DIE).ravel()

    p, r = jnp.asarray(0.2), jnp.asarray(7.0)
    for argument, first, second in ((0, 7.0, 98.0), (1, 0.2, 5.6)):
        change = [jnp.zeros(()), jnp.zeros(())]
        change[argument] = jnp.ones(())
        x, slope = jax.jvp(hot, (p, r), tuple(change))
        within(slope, first)
        within(2 * x * slope, second)

    def dead(share, light):
        return raw_image(
            None, Sensor(dead_pixels=share), light * jnp.ones(shape), die_key=DIE
        ).sum()

    by_share, by_light = jax.grad(dead, argnums=(0, 1))(jnp.asarray(0.3), jnp.asarray(5.0))
    assert by_share == 0
    assert abs(float(by_light) / 9e4 - 0.7) < 3 * np.sqrt(0.21 / 9e4)


@pytest.mark.slow
def test_charge_transfer_has_unbiased_moments():
    """A packet of mean m leaves the share eps behind."""
    m, eps = 2.0, 0.2
    frames = jax.random.split(KEY, 4000)

    def read(eps):
        sensor = Sensor(
            shot_noise=POISSON, full_well=1e6, charge_transfer=scene.ChargeTransfer(eps)
        )
        light = jnp.zeros((2, 1, 1)).at[0].set(m)  # the lag goes to the second row
        return jax.vmap(lambda key: raw_image(key, sensor, light)[0, 0, 0])(frames)

    x, slope = jax.jit(lambda eps: jax.jvp(read, (eps,), (jnp.ones(()),)))(jnp.asarray(eps))
    within(slope, -m)  # E[x] = m (1 - eps)
    within(2 * x * slope, -m * (1 + 2 * m * (1 - eps)))  # E[x^2] = E[x] + E[x]^2


def test_shares_of_tails_and_traps_have_no_derivative():
    def read(share):
        sensor = Sensor(
            read_noise=scene.HeavyTailedReadNoise(1.0, 9.0, share),
            telegraph_noise=scene.TelegraphNoise(share, 4.0),
        )
        return (raw_image(KEY, sensor, jnp.ones((20, 20, 1)), die_key=DIE) ** 2).sum()

    assert jax.jit(jax.grad(read))(jnp.asarray(0.3)) == 0
