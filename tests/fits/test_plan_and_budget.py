"""Tests the choice of the next measurement and the budget of an interval's uncertainty against
closed forms and simulated refits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting import Clustered, Gaussian, Normal, Parameter, Problem, SensorNoise, StudentT, fit
from fitting.inference.newton import minimise
from fitting.inference.problem import log_density
from jaxvision import PoissonShotNoise, Sensor
from jaxvision.errors import InputError

PLACE = np.linspace(-1.0, 1.0, 30)
SD = 0.1
DRIFT = 0.005 * (1 + PLACE)  # variance of a part of the noise
OFFSET_SD = 0.05


def line(base, slope, offset, inputs):
    return base + slope * inputs + offset * inputs**2


LINE = {
    "base": Parameter(start=0.0),
    "slope": Parameter(start=0.0),
    "offset": Parameter(prior=Normal(0.0, OFFSET_SD)),
}


@pytest.fixture(scope="module")
def fitted():
    data = 1 + 2 * PLACE + SD * np.random.default_rng(1).standard_normal(30)
    return fit(Problem(LINE, line, Gaussian(SD), data, inputs=PLACE), starts=1)


def estimator():
    """Return the weights of data and prior mean in the three estimates, (3, 31), by NumPy."""
    rows = np.concatenate([np.stack([np.ones(30), PLACE, PLACE**2], 1), [[0, 0, 1]]])
    weight = np.concatenate([np.full(30, SD**-2), [OFFSET_SD**-2]])
    return np.linalg.solve(rows.T @ (weight[:, None] * rows), rows.T * weight)


@pytest.mark.slow
def test_the_budget_of_a_line_propagates_each_source(fitted):
    """By Var = A Sigma A^T for each source, for a parameter and for a function of parameters."""
    weights = estimator()
    targets = (("base", weights[0]), (lambda base, slope: base + slope, weights[:2].sum(0)))
    for target, row in targets:
        found = fitted.budget(target, noise={"drift": DRIFT}, nuisances={"curvature": ["offset"]})
        parts = [
            row[:30] ** 2 @ DRIFT,
            row[:30] ** 2 @ (SD**2 - DRIFT),
            row[30] ** 2 * OFFSET_SD**2,
        ]
        expected = np.array(parts) / np.sum(parts)
        ours = [found.share_of(name) for name in ("drift", "other noise", "curvature")]
        np.testing.assert_allclose(ours, expected, rtol=1e-6)
        np.testing.assert_allclose(found.sd, np.sqrt(np.sum(parts)), rtol=1e-6)
        assert abs(sum(share.share for share in found.shares) - 1) < 1e-12
        assert "curvature" in str(found)
    with pytest.raises(InputError, match="more variance than the likelihood"):
        fitted.budget("base", noise={"drift": 1.0})
    with pytest.raises(InputError, match="no free number 'offst'"):
        fitted.budget("base", nuisances={"curvature": ["offst"]})


@pytest.mark.parametrize("target", ["slope", "base"])
def test_the_plan_of_a_line_equals_the_fit_of_a_longer_line(fitted, target):
    """The reference inverts the information of the data with one more row by NumPy."""
    rows = np.stack([np.ones(30), PLACE, PLACE**2], 1)
    which = list(LINE).index(target)
    information = rows.T @ rows / 0.01 + np.diag([0, 0, OFFSET_SD**-2])
    found = fitted.plan({"at 0": np.zeros(1), "at 4": np.full(1, 4.0)}, target, repeats=3)
    for candidate in found.candidates:
        x = float(candidate.name[3:])
        new = np.array([1, x, x**2])
        after = np.linalg.inv(information + 3 * np.outer(new, new) / 0.01)
        np.testing.assert_allclose(candidate.sd, np.sqrt(after[which, which]), rtol=1e-6)
        gain = np.linalg.slogdet(information + 3 * np.outer(new, new) / 0.01)[1]
        gain = (gain - np.linalg.slogdet(information)[1]) / 2
        np.testing.assert_allclose(candidate.gain, gain, rtol=1e-6)
    assert found.candidates[0].sd < found.candidates[1].sd <= found.sd
    assert found.best in str(found)


def test_invalid_plans_are_refused(fitted):
    for candidates, target, expected in (
        ({}, "base", "at least one candidate"),
        ({"a": PLACE}, "bas", "no free number; the nearest is 'base'"),
        ({"a": PLACE}, lambda base: base * jnp.ones(2), "one number"),
        ({"a": [np.zeros(7)]}, "base", "cannot use the inputs"),
    ):
        with pytest.raises(InputError, match=expected):
            fitted.plan(candidates, target)
    with pytest.raises(InputError, match="not finite for candidate 'dark'"):
        fitted.plan({"dark": np.full(1, np.nan)}, "base")
    with pytest.raises(InputError, match=r"repeats = 0\.5: give a whole number"):
        fitted.plan({"a": PLACE}, "base", repeats=0.5)


def flat_patch(exposures):
    """Return the problem of a matte patch with codes 255 (albedo light t)^(1 / gamma), about one
    mean per exposure."""
    return Problem(
        {
            "albedo": Parameter(prior=Normal(0.4, 0.2), lower=0.01, upper=1.0),
            "gamma": Parameter(prior=Normal(2.0, 0.4), lower=1.0, upper=4.0),
        },
        lambda albedo, gamma, inputs: 255 * (albedo * inputs) ** (1 / gamma),
        Gaussian(1.0),
        255 * (0.3 * exposures) ** (1 / 2.2),
        inputs=exposures,
    )


@pytest.mark.slow
@pytest.mark.parametrize("target", ["albedo", "gamma"])
def test_a_flat_patch_at_one_exposure_asks_for_another(target):
    found = fit(flat_patch(np.ones(16)))
    exposures = {"the same exposure": np.ones(16), "another exposure": np.full(16, 0.25)}
    planned = found.plan(exposures, target)
    assert planned.best == "another exposure"
    same, other = planned.candidates[1].fall, planned.candidates[0].fall
    assert same < 0.05 < 0.9 < other


ONES = jnp.ones(50)
TIMES = np.linspace(0.1, 2.0, 12)
CAMERA = Sensor(shot_noise=PoissonShotNoise(), read_noise=20.0, gain=0.05, offset=10.0, bits=12)


def decay(height, rate, inputs):
    return (height * jnp.exp(-rate * inputs))[:, None]


def counted(likelihood, times, seed, *, off=()):
    """Return the problem of a decay seen by a camera. Sources of noise that are `off` are missing
    only in the data."""
    rng = np.random.default_rng([5, seed])
    light = 4000 * np.exp(-1.5 * times)
    electrons = light if "photons" in off else rng.poisson(light)
    signal = electrons + (0 if "read noise" in off else 20.0 * rng.standard_normal(len(times)))
    codes = 0.05 * signal + 10.0
    codes = codes if "rounding" in off else np.round(codes)
    return Problem(
        {
            "height": Parameter(transform="log", start=3000.0, lower=100.0, upper=1e5),
            "rate": Parameter(lower=0.0, upper=10.0, start=1.0),
        },
        decay,
        likelihood,
        codes[:, None],
        inputs=times,
    )


def scatter(times, *, off=(), count=400):
    """Return the standard deviation of the rate over refits, with a relative error of 1 / sqrt(2
    count)."""
    rates = [
        fit(counted(SensorNoise(CAMERA), times, seed, off=off), starts=1).values["rate"]
        for seed in range(count)
    ]
    return np.std(rates)


@pytest.mark.slow
def test_the_budget_of_a_sensor_equals_refits_without_a_source():
    found = fit(counted(SensorNoise(CAMERA), TIMES, 0), starts=4).budget("rate")
    whole = scatter(TIMES) ** 2
    for source in ("photons", "read noise"):
        lost = 1 - scatter(TIMES, off=(source,)) ** 2 / whole
        assert abs(found.share_of(source) - lost) < 0.1
    np.testing.assert_allclose(found.sd**2, whole, rtol=0.2)
    assert found.share_of("rounding") < 0.15


@pytest.mark.slow
def test_a_plan_predicts_the_scatter_of_refits():
    more = np.concatenate([TIMES, np.full(6, 0.7)])
    planned = fit(counted(SensorNoise(CAMERA), TIMES, 0), starts=4).plan(
        {"six at 0.7": np.full(6, 0.7)}, "rate"
    )
    np.testing.assert_allclose(planned.candidates[0].sd, scatter(more), rtol=0.1)


def test_inflated_noise_is_attributed_to_the_model():
    """The data scatter c times as much as stated, so the variance is c^2 sd^2 / n, and the stated
    noise has 1 / c^2 of it."""
    scatter = 0.3 * stats.norm.ppf((np.arange(60) + 0.5) / 60)
    mean = {"mean": Parameter(start=0.0)}
    problem = Problem(mean, lambda mean: mean * jnp.ones(60), Gaussian(SD), 2 + scatter)
    found = fit(problem, starts=1, misfit="inflate").budget("mean")
    inflated = np.sum((scatter / SD) ** 2) / 59
    np.testing.assert_allclose(found.sd, np.sqrt(inflated / 60) * SD, rtol=1e-3)
    np.testing.assert_allclose(found.share_of("noise"), 1 / inflated, rtol=1e-3)
    np.testing.assert_allclose(found.share_of("model"), 1 - 1 / inflated, rtol=1e-3)


@pytest.mark.slow
def test_shared_errors_and_inflation_are_attributed_to_the_model():
    """Offsets of 40 groups are three times the noise, so they cause nearly all of the mean's
    variance."""
    labels = np.repeat(np.arange(40), 5)
    rng = np.random.default_rng(2)
    data = 0.3 * rng.standard_normal(40)[labels] + 0.1 * rng.standard_normal(200)

    def fitted(likelihood, **options):
        mean = Parameter(start=0.0)
        model = Problem({"mean": mean}, lambda mean: mean * jnp.ones(200), likelihood, data)
        return fit(model, **options)

    shared = fitted(Clustered(Gaussian(0.1), labels)).budget("mean")
    np.testing.assert_allclose(shared.sd, 0.3 / np.sqrt(40), rtol=0.3)
    assert shared.share_of("model") > 0.9
    found = fitted(Gaussian(0.1), misfit="inflate")
    inflated = found.budget("mean")
    np.testing.assert_allclose(inflated.share_of("model"), 1 - found.noise**-2, rtol=1e-6)
    np.testing.assert_allclose(inflated.sd, found.noise * 0.1 / np.sqrt(200), rtol=1e-6)


@pytest.mark.slow
def test_information_without_a_closed_form_is_that_of_students_t():
    """Fisher's information of a location under Student's t is (dof + 1) / (dof + 3) / scale^2."""
    mean = Parameter(start=0.0)
    problem = Problem(
        {"a": mean},
        lambda a, inputs: a * inputs,
        StudentT(0.2, 4.0),
        np.zeros(50),
        inputs=jnp.ones(50),
    )
    found = fit(problem.with_data(0.2 * np.random.default_rng(1).standard_t(4, 50)), starts=1)
    planned = found.plan({"more": jnp.ones(1000)}, "a")
    added = 1000 * 5 / 7 / 0.04
    expected = 1 / np.sqrt(1 / planned.sd**2 + added)
    np.testing.assert_allclose(planned.candidates[0].sd, expected, rtol=0.02)


ANGLES = np.tile(np.linspace(-1.2, 1.2, 15), 4)
IMAGE = np.repeat(np.arange(4), 15)
SEEN = ANGLES, IMAGE, 0.3 * (IMAGE - 1.5)  # rad, and the image's number
SIZES = {"strength": 0.02, "tilt": 0.01}  # for lights and geometry
SHINY = {
    "diffuse": Parameter(transform="log", start=800.0),
    "specular": Parameter(transform="log", start=1500.0),
    "exponent": Parameter(transform="log", start=12.0),
    "strength": Parameter(shape=(4,), start=1.0, prior=Normal(1.0, SIZES["strength"])),
    "tilt": Parameter(shape=(4,), start=0.0, unit="rad", prior=Normal(0.0, SIZES["tilt"])),
}


def shiny(diffuse, specular, exponent, strength, tilt, inputs):
    angle, image, towards = inputs
    turned = angle + towards + tilt[image]
    light = diffuse * jnp.cos(angle) + specular * jnp.exp(exponent * (jnp.cos(turned) - 1))
    return (strength[image] * light)[:, None]


def of_one_source(source, rng, count):
    """Return the codes of `count` afternoons where only this source has errors, in DN."""
    truth = {name: np.full(p.shape or (), p.start) for name, p in SHINY.items()}
    codes = []
    for _ in range(count):
        drawn = dict(truth)
        if source in SIZES:
            drawn[source] = truth[source] + SIZES[source] * rng.standard_normal(4)
        light = np.asarray(shiny(**drawn, inputs=SEEN))
        electrons = rng.poisson(light) if source == "photons" else light
        read = 20.0 * rng.standard_normal(light.shape) if source == "read noise" else 0.0
        signal = 0.05 * (electrons + read) + 10.0
        phase = rng.uniform(-0.5, 0.5, light.shape)  # phase of a signal within a code
        codes.append(np.round(signal + phase) - phase if source == "rounding" else signal)
    return np.array(codes)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["exponent", "diffuse"])
def test_each_source_has_the_scatter_of_refits_with_it_alone(target):
    """The sources are photons, read noise, rounding, lights and geometry."""
    rng = np.random.default_rng(11)
    nominal = np.asarray(shiny(800.0, 1500.0, 12.0, np.ones(4), np.zeros(4), inputs=SEEN))
    problem = Problem(*(SHINY, shiny, SensorNoise(CAMERA), 0.05 * nominal + 10), inputs=SEEN)
    whole = fit(problem, starts=1)
    nuisances = {"lights": ["strength"], "geometry": ["tilt"]}
    found = whole.budget(target, nuisances=nuisances)
    start = jnp.asarray(whole.optimum.vector)
    place = [number.name for number in problem.space].index(target)

    def refitted(data):
        own = eqx.tree_at(lambda p: p.data, problem, data)
        return minimise(lambda v, p: -log_density(v, p), start, own).vector[place]

    names = {"strength": "lights", "tilt": "geometry"}
    for source in ("photons", "read noise", "rounding", "strength", "tilt"):
        codes = of_one_source(source, rng, 4000)
        logs = np.asarray(jax.lax.map(jax.jit(refitted), jnp.asarray(codes), batch_size=500))
        share = next(s for s in found.shares if s.source == names.get(source, source))
        scatter = np.std(logs) * found.value
        print(f"{target}, {source}: {share.sd:.4g}, refits {scatter:.4g}")
        np.testing.assert_allclose(share.sd**2, scatter**2, rtol=0.1, atol=1e-3 * found.sd**2)
