"""Tests that a chosen setting keeps its promised error, also with biases and wrong references, on
problems whose errors have closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from clocks import Clock
from scipy.stats import f as fisher
from scipy.stats import t as student

from jaxvision.accuracy import Knob, Problem, choose, combined, curve, relative_rms
from jaxvision.accuracy.curves import HOLLOW
from jaxvision.accuracy.fitted import fit_order
from jaxvision.accuracy.norms import next_error
from jaxvision.accuracy.records import Trial
from jaxvision.accuracy.several import check_combination, combine_and_check
from jaxvision.errors import InputError

SHAPE = np.random.default_rng(0).uniform(0.5, 1.5, 400)
RMS = float(np.sqrt(np.mean(SHAPE**2)))


def shifted(law, *, clock=None):
    """Return a problem whose result is too large by the fraction setting^law / 2, at 1 ms a
    unit."""
    clock = clock or Clock()

    def prepare(settings):
        def compute(seed):
            clock.now += 1e-3 * settings["n"]
            return SHAPE * (1 + 0.5 * settings["n"] ** law)

        return compute

    return Problem("shift", prepare), clock


@pytest.mark.parametrize("law", [-0.5, -1.0, -2.0])
@pytest.mark.parametrize("reference", [(32, 64), (32,)])
@pytest.mark.parametrize("whole", [False, True])
def test_a_bias_meets_its_tolerance_although_its_reference_errs_too(law, reference, whole):
    """The reference errs to the same side as the settings, so every measured error is too small."""
    knob = Knob("n", "", "", (1, 2, 3, 4, 6, 8, 12, 16), reference, order=law, whole=whole)
    problem, clock = shifted(law)
    found = curve(problem, knob, seconds=1e9, clock=clock)
    chosen = 0
    for tolerance in np.geomspace(0.5 * 40.0**law, 0.5, 60):
        try:
            setting = choose(found, tolerance=tolerance).setting
        except InputError:
            continue
        chosen += 1
        assert 0.5 * setting**law <= tolerance
    assert chosen > 20


def test_the_largest_error_is_bounded_by_the_largest_of_the_reference():
    """A single number of the result is wrong, so the maximum norm is 100 times the RMS."""
    clock = Clock()

    def prepare(settings):
        result = np.ones(10_000)
        result[7] += 50 / settings["n"]

        def compute(seed):
            clock.now += 1e-3
            return result

        return compute

    knob = Knob("n", "", "", (1, 2, 4, 8, 16), (32,), order=-1.0)
    found = curve(Problem("spike", prepare), knob, metrics=("max",), seconds=1e9, clock=clock)
    for trial in found.trials:
        assert 50 / trial.setting <= trial.error_high < 2 * 50 / trial.setting


@pytest.mark.parametrize("reference", [(256, 512), (256,)])
def test_a_reference_that_contradicts_all_settings_is_rejected(reference):
    """The settings agree with each other, and so do the references, but not the settings with the
    references."""

    def prepare(settings):
        n = settings["n"]
        return lambda seed: SHAPE * (1 + 1 / n + 0.3 * (n >= 256))

    knob = Knob("n", "", "", (4, 16, 64), reference, order=-1.0, whole=True)
    found = curve(Problem("wrong", prepare), knob, seconds=1e9)
    assert found.reference.error > 0.2
    for tolerance in (0.02, 0.05, 0.1, 0.2):
        with pytest.raises(InputError):
            choose(found, tolerance=tolerance)


def test_a_bias_is_measured_with_two_seeds():
    """Errors are measured with the first two seeds. Further calls only measure times, and repeat
    the first seed."""
    seen: set[int] = set()

    def prepare(settings):
        def compute(seed):
            seen.add(seed)
            return SHAPE * (1 + 0.5 / settings["n"])

        return compute

    curve(Problem("shift", prepare), Knob("n", "", "", (1, 2, 4), (8,)), seconds=1e9)
    assert seen == {0, 1}


def test_the_time_of_a_setting_is_the_median_of_its_warm_calls():
    """The warm calls of one setting are one slow and three quick ones. The bounds are quartiles."""
    clock, taken = Clock(), iter([9.0, *(1.0, 2.0, 3.0, 8.0) * 2])

    def prepare(settings):
        def compute(seed):
            clock.now += next(taken) if settings["n"] == 4 else 1e-3
            return SHAPE

        return compute

    problem = Problem("times", prepare, exact=SHAPE)
    found = curve(problem, Knob("n", "", "", (4,), ()), seconds=1e9, seeds=5, clock=clock)
    (trial,) = found.trials
    assert trial.first_seconds == 9.0
    assert (trial.seconds_low, trial.seconds, trial.seconds_high) == (1.75, 2.5, 4.25)


# ---------------------------------------------------------------- the bound on the next run's error


@pytest.mark.sweep("10-3", "3000-8")
@pytest.mark.parametrize("runs", [2, 3, 8])
@pytest.mark.parametrize("freedom", [1, 10, 3000])
def test_the_next_error_is_below_its_bound_as_often_as_promised(runs, freedom):
    """The bound is promised for 97.5 % of the next errors, and 96 % for two runs of one number.
    Results of one number, ten numbers and a picture keep this within four binomial standard
    deviations."""
    rng = np.random.default_rng(runs * freedom)
    errors = np.sqrt(rng.chisquare(freedom, (2000, runs + 1)) / freedom)
    bounds = np.array([next_error(seen[:-1]) for seen in errors])
    above = np.mean(errors[:, -1] > bounds[:, 2])
    said = 0.04 if runs == 2 and freedom == 1 else 0.025
    assert above < said + 4 * np.sqrt(0.025 * 0.975 / 2000)
    assert above > 0.004
    # for a picture the bounds are close to the error
    if freedom == 3000 and runs == 8:
        assert np.median(bounds[:, 2]) < 1.05
        assert np.median(bounds[:, 1]) > 0.95


def test_the_bounds_on_the_next_error_are_students_and_fishers():
    errors = np.array([1.0, 1.2, 0.7, 1.1, 0.9])
    logs = np.log(errors)
    half = student.ppf(0.975, 4) * logs.std(ddof=1) * np.sqrt(1 + 1 / 5)
    found = next_error(errors)
    np.testing.assert_allclose(found[0], np.sqrt(np.mean(errors**2)), rtol=1e-12)
    np.testing.assert_allclose(found[1:], np.exp(logs.mean() + np.array([-half, half])), rtol=1e-9)
    # at most the bound for a single Gaussian number
    wide = np.array([0.01, 1.0])
    np.testing.assert_allclose(
        next_error(wide)[2], np.sqrt(np.mean(wide**2) * fisher.ppf(0.975, 1, 2)), rtol=1e-9
    )
    # never below the largest error that was seen, however small the scatter of the others
    assert next_error(np.array([1.0] * 30 + [1.5]))[2] == 1.5
    assert np.isfinite(next_error(np.array([0.0, 1.0]))).all()


def test_a_point_is_hollow_below_three_errors_of_its_reference():
    assert HOLLOW == 3.0
    problem, clock = shifted(-1.0)
    knob = Knob("n", "", "", (1, 2, 4, 8, 16), (48,), order=-1.0)
    found = curve(problem, knob, seconds=1e9, clock=clock)
    hollow = {trial.setting for trial in found.trials if trial.error < 3 * found.reference.error}
    assert {trial.setting for trial in found.trials if trial.hollow} == hollow == {16}


def trial_of(setting, error, high):
    return Trial(setting, error, error**2 / high, high, 1.0, 1.0, 1.0, 1.0, seeds=2)


def test_points_are_weighted_in_the_order_by_their_inverse_variance():
    """The order equals the slope of NumPy's weighted line fit."""
    knob = Knob("n", "", "", (1, 2, 4, 8), (), random=True)
    trials = [
        trial_of(1, 1.0, 1.1),
        trial_of(2, 0.4, 0.8),
        trial_of(4, 0.3, 0.33),
        trial_of(8, 0.1, 0.4),
    ]
    spread = np.array([np.log(t.error_high / t.error) / 1.96 / np.sqrt(2) for t in trials])
    x, y = np.log([t.setting for t in trials]), np.log([t.error for t in trials])
    found = fit_order(knob, trials)
    assert found is not None
    np.testing.assert_allclose(found.exponent, np.polyfit(x, y, 1, w=1 / spread)[0], rtol=1e-9)


def test_a_declared_geometric_law_gives_way_to_a_power_that_describes_the_errors():
    """A Gauss rule across an edge has a power law. An error that is geometric keeps the declared
    law."""
    knob = Knob("order", "", "", (1, 2, 4, 8, 16), (), law="geometric")

    def order_of(error):
        found = fit_order(knob, [trial_of(n, error(n), 1.01 * error(n)) for n in knob.settings])
        assert found is not None
        return found

    edge, smooth = order_of(lambda n: n**-1.5), order_of(lambda n: 0.5**n)
    assert (edge.law, smooth.law) == ("power", "geometric")
    np.testing.assert_allclose([edge.exponent, smooth.exponent], [-1.5, np.log(0.5)], rtol=1e-9)


@pytest.mark.slow
def test_the_interval_of_an_order_covers_the_true_one():
    """The interval covers the true order in 92 to 99 % of 300 runs, and is at most five times as
    wide as the scatter of the orders."""
    knob = Knob("n", "", "", (4, 16, 64, 256, 1024), (), order=-0.5, random=True)
    held, found, wide = 0, [], []
    for number in range(300):

        def prepare(settings, number=number):
            n = settings["n"]
            return lambda seed: (
                1 + np.random.default_rng((number, n, seed)).standard_normal(400) / n**0.5
            )

        order = curve(Problem("mean", prepare, exact=np.ones(400)), knob, seconds=1e9).order
        assert order is not None
        held += order.low <= -0.5 <= order.high
        found.append(order.exponent)
        wide.append((order.high - order.low) / 2)
    assert held >= 0.92 * 300
    assert np.median(wide) < 5 * 1.96 * np.std(found)


# ---------------------------------------------------------------- the check of a combination

DRAWS = Knob("a", "", "", (4, 16, 64, 256), (1024,), order=-0.5, random=True, whole=True)
PARTS = Knob("b", "", "", (1, 2, 4, 8), (16,), order=-1.0, whole=True)


def both(*, offset=0.0):
    """Return a problem with a random error set by `a`, a bias set by `b` and a time of a b plus a
    constant, with its curves and its clock."""
    clock = Clock()

    def prepare(settings):
        a, b = settings["a"], settings["b"]

        def compute(seed):
            clock.now += 1e-4 * a * b + offset
            scatter = np.random.default_rng((seed, a)).standard_normal(400)
            return SHAPE * (1 + 0.5 / b) + 0.5 * scatter * a**-0.5

        return compute

    problem = Problem("two", prepare, settings={"a": 16, "b": 4})
    curves = [curve(problem, knob, clock=clock, seconds=1e9) for knob in (DRAWS, PARTS)]
    return problem, curves, clock


@pytest.mark.parametrize(("tolerance", "seconds"), [(0.15, None), (0.1, None), (None, 5.0)])
def test_the_promise_after_the_check_includes_the_error_of_its_reference(tolerance, seconds):
    problem, curves, clock = both()
    best, confirmed = combine_and_check(
        problem, curves, tolerance, seconds, seconds=1e9, clock=clock
    )
    assert confirmed
    assert best.error <= (tolerance or np.inf)
    compute = problem.prepare({**problem.settings, **best.settings})
    errors = [relative_rms(compute(10**6 + n), SHAPE) for n in range(100)]
    assert np.mean(np.array(errors) <= best.error) >= 0.95


def test_the_check_measures_the_time_where_factors_do_not_multiply():
    """Half a second of the time depends on no knob, so factors from single knobs predict the
    combined time badly."""
    problem, curves, clock = both(offset=0.5)
    best = combined(curves, problem.settings, seconds=0.52)
    check = check_combination(problem, curves, best, seconds=1e9, clock=clock)
    assert check is not None
    truth = 1e-4 * best.settings["a"] * best.settings["b"] + 0.5
    assert check.seconds == pytest.approx(truth, rel=1e-9)
    found, _ = combine_and_check(problem, curves, None, 0.6, seconds=1e9, clock=clock)
    assert found.seconds == pytest.approx(
        1e-4 * found.settings["a"] * found.settings["b"] + 0.5, rel=1e-9
    )
    assert found.seconds <= 0.6


def test_a_check_against_a_reference_no_better_than_the_settings_says_nothing():
    """Apart from a bias, four draws of the finest setting are as noisy as the settings to be
    checked."""
    problem, curves, clock = both()
    noisy = [replace(curves[0], reference=replace(curves[0].reference, setting=4)), curves[1]]
    best = replace(combined(curves, problem.settings, seconds=1.0), settings={"a": 4, "b": 8})
    plain = problem.prepare

    def prepare(settings):
        compute = plain({**settings, "a": min(settings["a"], 1)})
        return lambda seed: compute(seed) if seed >= 1_000_000 else plain(settings)(seed)

    assert (
        check_combination(replace(problem, prepare=prepare), noisy, best, seconds=1e9, clock=clock)
        is None
    )
