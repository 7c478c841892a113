"""Tests `curve` and `choose` on problems whose errors have closed forms, timed by a simulated
clock."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from clocks import Clock

from jaxvision.accuracy import (
    Knob,
    Problem,
    choose,
    curve,
    error_against_time,
    relative_rms,
)
from jaxvision.accuracy.choice import candidates
from jaxvision.accuracy.records import Order
from jaxvision.accuracy.reference import mean_of
from jaxvision.errors import InputError

LENGTH = 400  # numbers in a result that stands for a picture


STILL = Clock()  # never advances, so everything fits into any budget


def quadrature(rule, *, cost=lambda n: 1e-3 * n, clock=None, compiling=0.0):
    """Return the problem of integrating exp(c x) over [0, 1] for many c by a rule of n nodes, and
    the exact integrals."""
    c = np.linspace(-2, 2, LENGTH)[:, None] + 1e-9

    def prepare(settings):
        n = settings["n"]
        state = {"first": True}

        def compute(seed):
            if clock is not None:
                clock.now += cost(n) + (compiling if state.pop("first", False) else 0)
            x, w = rule(n)
            return np.exp(c * x) @ w

        return compute

    return Problem("exp", prepare, exact=None), (np.expm1(c) / c)[:, 0]


def law(found):
    """Return the fitted order of a curve."""
    assert found.order is not None
    return found.order


def midpoint(n):
    return (np.arange(n) + 0.5) / n, np.full(n, 1 / n)


def gauss(n):
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def monte_carlo(settings_sd=1.0, *, size=LENGTH, cost=lambda n: 1e-3 * n, clock=None, law=-0.5):
    """Return a problem whose result is means of n draws, with a Gaussian error of known standard
    deviation."""

    def prepare(settings):
        n = settings["n"]

        def compute(seed):
            if clock is not None:
                clock.now += cost(n)
            rng = np.random.default_rng((seed, n, size))
            return 1.0 + settings_sd * n**law * rng.standard_normal(size)

        return compute

    return Problem("mean", prepare)


N = Knob("n", "nodes", "a rule", (4, 8, 16, 32, 64), (128, 256), order=-2.0, whole=True)
RANDOM = Knob(
    "n", "draws", "a mean", (4, 16, 64, 256), (1024, 4096), order=-0.5, random=True, whole=True
)


def test_the_order_of_the_midpoint_rule_and_the_floor_of_its_reference():
    """The order is -2, and the reported error of the reference (256 nodes) is its true error. The
    reference's error, a 16th of the smallest error, makes the measured order steeper by 1 %."""
    clock = Clock()
    problem, exact = quadrature(midpoint, clock=clock)
    found = curve(problem, N, clock=clock)
    assert law(found).low <= -2 <= law(found).high
    np.testing.assert_allclose(law(found).exponent, -2, atol=0.03)
    assert found.reference.setting == 256
    truth = relative_rms(problem.prepare({"n": 256})(0), exact)
    assert truth / 2 < found.reference.error < 2 * truth
    for trial in found.trials:
        if not trial.hollow:
            np.testing.assert_allclose(
                trial.error,
                relative_rms(problem.prepare({"n": trial.setting})(0), exact),
                rtol=0.065,
            )


def test_gauss_converges_geometrically():
    """A Gauss rule with n nodes converges geometrically, so the fitted line is against n and not
    log n."""
    clock = Clock()
    problem, exact = quadrature(gauss, clock=clock)
    knob = replace(
        N, settings=(1, 2, 3, 4, 5, 12, 16), reference=(24, 32), order=None, law="geometric"
    )
    found = curve(problem, knob, clock=clock)
    assert [trial.setting for trial in found.trials if trial.hollow] == [12, 16]
    assert law(found).points == 5
    first, last = found.trials[0].error, found.trials[4].error
    np.testing.assert_allclose(law(found).exponent, np.log(last / first) / 4, rtol=0.1)
    assert np.exp(law(found).exponent) < 0.05
    given = curve(replace(problem, exact=exact), knob, clock=clock)
    assert given.reference.how == "closed form"
    np.testing.assert_allclose(given.trials[2].error, found.trials[2].error, rtol=1e-6)


def test_monte_carlo_has_order_one_half_and_its_reference_knows_its_error():
    clock = Clock()
    found = curve(monte_carlo(clock=clock), RANDOM, clock=clock)
    np.testing.assert_allclose(law(found).exponent, -0.5, atol=0.05)
    assert law(found).low <= -0.5 <= law(found).high
    assert found.reference.setting == 4096
    draws = round(1 / (4096 * found.reference.error**2))  # its error is 1 / sqrt(draws n)
    assert 4 / 2 < draws < 16 * 2
    for trial in found.trials:
        if not trial.hollow:
            np.testing.assert_allclose(trial.error, trial.setting**-0.5, rtol=0.1)


def test_a_kronecker_set_is_better_than_independent_draws():
    """Shifted multiples of the golden ratio integrate a smooth function with an order below
    -1/2."""
    golden = (5**0.5 - 1) / 2
    c = np.linspace(-2, 2, 64)[:, None]

    def prepare(settings):
        def compute(seed):
            shift = np.random.default_rng(seed).random()
            x = (shift + golden * np.arange(settings["n"])) % 1
            return np.mean(np.exp(c * x), axis=1)

        return compute

    fibonacci = replace(RANDOM, settings=(5, 8, 13, 21, 34, 55, 89, 144, 233, 377))
    found = curve(Problem("lattice", prepare), fibonacci, clock=STILL)
    assert law(found).high < -0.5


def test_a_slow_setting_is_not_chosen():
    """The setting is as accurate as the next finer one, and ten times as slow."""
    clock = Clock()
    slow = monte_carlo(clock=clock, cost=lambda n: 5.0 if n == 64 else 1e-3 * n)
    knob = replace(RANDOM, whole=False)
    found = curve(slow, knob, clock=clock, seconds=2000.0)
    assert choose(found, tolerance=0.15).setting == 256
    assert 2 not in found.pareto


def test_a_lucky_seed_is_not_chosen():
    """The first draw of the coarsest setting happens to be exact."""
    plain = monte_carlo()

    def prepare(settings):
        honest = plain.prepare(settings)
        return lambda seed: np.ones(LENGTH) if settings["n"] == 4 and seed == 0 else honest(seed)

    found = curve(Problem("lucky", prepare), RANDOM, clock=STILL)
    assert choose(found, tolerance=0.2).setting > 4
    assert found.trials[0].error > 0.4


@pytest.mark.parametrize("knob", [N, RANDOM])
def test_with_a_wrong_reference_nothing_is_chosen(knob):
    """A reference that disagrees with itself has a large error, so all points are hollow and
    nothing is chosen."""
    plain = quadrature(midpoint)[0] if knob is N else monte_carlo()

    def prepare(settings):
        honest, n = plain.prepare(settings), settings["n"]
        if n not in knob.reference:
            return honest
        return lambda seed: honest(seed) + (n == knob.reference[-1]) * (1 + seed % 3)

    found = curve(Problem("wrong", prepare), knob, clock=STILL)
    assert found.reference.error > 0.1
    assert all(trial.hollow for trial in found.trials)
    with pytest.raises(InputError, match="allow more time"):
        choose(found, tolerance=0.05)


@pytest.mark.sweep
@pytest.mark.parametrize(("size", "whole"), [(1, False), (1, True), (10, False), (LENGTH, True)])
def test_a_chosen_setting_meets_its_tolerance_with_fresh_seeds(size, whole):
    """At least 95 of 100 chosen settings meet the tolerance in a run that did not take part in the
    choice. This includes results of a single number, whose errors vary by 100 %."""
    met = 0
    for trial in range(100):
        rng = np.random.default_rng(trial)
        tolerance = 10 ** rng.uniform(-1.5, -0.7)
        first = int(rng.integers(10**9))
        plain = monte_carlo(size=size)

        def prepare(settings, plain=plain, first=first):
            compute = plain.prepare(settings)
            return lambda seed: compute(first + seed)

        problem = Problem("mean", prepare, exact=np.ones(size))
        knob = replace(RANDOM, settings=(4, 16, 64, 256, 1024, 4096, 16384), whole=whole)
        found = curve(problem, knob, seconds=np.inf, metrics=("rms",))
        setting = choose(found, tolerance=tolerance).setting
        fresh = prepare({"n": setting})(10**7)
        met += relative_rms(fresh, np.ones(size)) <= tolerance
    assert met >= 95


def test_a_bias_is_measured_by_equal_seeds():
    """The setting n shifts the result by 1 / n^2, which is far smaller than the result's random
    scatter. Runs with equal seeds cancel the scatter."""
    c = np.linspace(1, 2, 10_000)

    def prepare(settings):
        n = settings["n"]
        return lambda seed: (
            c * (1 + n**-2.0)
            + 0.2 * np.random.default_rng(seed).standard_normal(10_000) * (1 + 2.0 / n)
        )

    problem = Problem("biased", prepare, level=float(np.sqrt(np.mean(c**2))))
    found = curve(problem, replace(N, settings=(2, 4, 8), reference=(64, 128)), clock=STILL)
    for trial in found.trials:
        shift = trial.setting**-2.0
        assert trial.error_low <= shift <= trial.error_high
        assert trial.error_high < shift + 0.06


def test_the_budget_is_kept_and_what_was_not_run_is_named():
    clock = Clock()
    costly = monte_carlo(clock=clock, cost=lambda n: 0.05 * n)
    found = curve(costly, RANDOM, seconds=30.0, clock=clock)
    assert found.taken <= 33.0
    assert found.taken == clock.now - 100.0
    assert found.not_run == (256,)
    assert found.stopped == "out of time"
    assert found.reference.how == "other seeds"


def test_compilation_is_timed_separately():
    clock = Clock()
    problem, _ = quadrature(midpoint, clock=clock, compiling=2.0)
    found = curve(problem, N, clock=clock)
    for trial in found.trials:
        np.testing.assert_allclose(trial.seconds, 1e-3 * trial.setting)
        np.testing.assert_allclose(trial.first_seconds, 2 + 1e-3 * trial.setting)


def test_an_interrupt_keeps_what_was_measured():
    plain = monte_carlo()

    def prepare(settings):
        compute = plain.prepare(settings)

        def stopping(seed):
            if settings["n"] == 64:
                raise KeyboardInterrupt
            return compute(seed)

        return stopping

    found = curve(Problem("stopped", prepare), RANDOM, clock=STILL)
    assert found.stopped == "interrupted"
    assert [trial.setting for trial in found.trials] == [4, 16]
    assert found.not_run == (64, 256)
    assert all(trial.hollow for trial in found.trials)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_error_of_a_bias_is_known_after_an_interrupt(seed):
    """The bias follows from the differences between the settings that were run with both seeds."""
    plain, exact = quadrature(midpoint)

    def prepare(settings):
        compute = plain.prepare(settings)

        def stopping(number):
            if settings["n"] == 64 and number == seed:
                raise KeyboardInterrupt
            return compute(number)

        return stopping

    found = curve(replace(plain, prepare=prepare), N, clock=STILL)
    assert found.stopped == "interrupted"
    assert found.reference.how == "finest setting"
    truth = relative_rms(midpoint_of(found.reference.setting), exact)
    assert truth / 2 < found.reference.error < 2 * truth
    for trial in found.trials[:-2]:
        true = relative_rms(midpoint_of(trial.setting), exact)
        assert true <= trial.error_high
        assert choose(found, tolerance=2 * true).error < 2 * true


def midpoint_of(n):
    """Return the integral of exp(c x) by the midpoint rule with n nodes."""
    return quadrature(midpoint)[0].prepare({"n": n})(0)


def test_an_interrupt_while_results_are_compared_loses_none(monkeypatch):
    from jaxvision.accuracy import curves

    whole, calls = curve(monte_carlo(), RANDOM, clock=STILL), iter([KeyboardInterrupt])

    def stopped_once(*given):
        for interrupt in calls:
            raise interrupt
        return level_of(*given)

    level_of = curves.level_of
    monkeypatch.setattr(curves, "level_of", stopped_once)
    found = curve(monte_carlo(), RANDOM, clock=STILL)
    assert found.stopped == "interrupted"
    assert found.trials == whole.trials


def test_a_setting_that_the_problem_refuses_is_left_out_and_says_why():
    """The problem refuses a setting, with one or all seeds, for too few pixels. The other settings
    are still measured."""

    def prepare(settings):
        def compute(seed):
            if settings["n"] < 4 or (settings["n"] == 16 and seed == 3):
                raise InputError(f"only {settings['n']} pixels")
            return monte_carlo().prepare(settings)(seed)

        return compute

    knob = Knob("n", "pixels", "", (1, 4, 16, 64), (256,), order=-0.5, random=True)
    found = curve(Problem("pixels", prepare), knob, seconds=100.0)
    assert [trial.setting for trial in found.trials] == [4, 16, 64]
    assert [trial.seeds for trial in found.trials] == [8, 7, 8]
    assert (found.not_run, found.stopped) == ((1,), "1 refused (only 1 pixels)")
    with pytest.raises(InputError, match="only 2 pixels"):
        curve(Problem("pixels", prepare), knob, settings=(2, 3), seconds=100.0)


def test_settings_between_and_beyond_are_inferred_where_the_order_holds():
    clock = Clock()
    found = curve(monte_carlo(clock=clock), RANDOM, clock=clock)
    between, beyond = choose(found, tolerance=0.2), choose(found, tolerance=0.01)
    assert 25 <= between.setting <= 50
    assert 10_000 <= beyond.setting <= 20_000
    assert not beyond.measured
    np.testing.assert_allclose(beyond.seconds, 1e-3 * beyond.setting, rtol=0.1)
    wide = Order(-0.18, -0.55, 0.19, "power", 4)
    assert wide.low <= -0.5
    assert len(candidates(replace(found, order=wide))) == len(found.trials)
    shallow = curve(monte_carlo(law=-0.2), RANDOM, clock=STILL)
    assert law(shallow).exponent > -0.3
    with pytest.raises(InputError, match="No setting reaches"):
        choose(shallow, tolerance=0.01)


@pytest.mark.parametrize(
    ("order", "text"),
    [
        (Order(-0.5, -0.6, -0.4, "power", 5), "-0.50 ± 0.10"),
        (Order(-7.86, -14.35, -1.37, "power", 4), "unknown"),
        (Order(-0.52, -3.77, 2.73, "power", 3), "unknown"),
        (Order(-0.57, -np.inf, np.inf, "power", 2), "unknown"),
        (Order(-4.2, -5.1, -3.3, "geometric", 4), "× 0.015 (0.0061 to 0.037) a unit"),
        (Order(-4.2, -9.0, 0.6, "geometric", 3), "unknown"),
    ],
)
def test_an_order_that_is_not_known_is_no_number(order, text):
    assert str(order) == text


def test_of_settings_with_indistinguishable_times_the_most_accurate_is_chosen():
    """The chosen setting is a measured one, because a declared order is not a measurement."""
    clock = Clock()
    found = curve(monte_carlo(clock=clock, cost=lambda n: 1e-3), RANDOM, clock=clock)
    chosen = choose(found, tolerance=0.3)
    assert (chosen.setting, chosen.measured) == (256, True)


def test_the_most_accurate_within_a_time():
    clock = Clock()
    found = curve(monte_carlo(clock=clock), replace(RANDOM, whole=False), clock=clock)
    assert choose(found, seconds=0.1).setting == 64
    with pytest.raises(InputError, match="No setting takes at most"):
        choose(found, seconds=1e-6)
    with pytest.raises(InputError, match="either a tolerance or a time"):
        choose(found)


def test_several_norms_are_kept():
    problem, exact = quadrature(midpoint)
    found = curve(replace(problem, exact=exact), N, metrics=("max", "rms", "p99"), clock=STILL)
    trial = found.trials[0]
    apart = problem.prepare({"n": 4})(0) - exact
    level = np.sqrt(np.mean(exact**2))
    np.testing.assert_allclose(trial.error, np.abs(apart).max() / level)
    np.testing.assert_allclose(trial.norms["rms"], np.sqrt(np.mean(apart**2)) / level)
    np.testing.assert_allclose(trial.norms["p99"], np.quantile(np.abs(apart), 0.99) / level)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("knob", [N, RANDOM])
def test_a_result_that_is_not_finite_is_left_out_and_says_so(knob, wrong):
    """The non-finite result is in all settings, in the first, or in the reference. The remaining
    settings still have errors."""

    def broken(*lost):
        def prepare(settings):
            n = settings["n"]
            value = wrong if n in lost else 1 + 1 / n**2
            return lambda seed: np.array([1.0, value, 1.0]) + 1e-13 * seed * knob.random

        return Problem("broken", prepare)

    every = (*knob.settings, *knob.reference)
    with pytest.raises(InputError, match=r"of n 4 is not finite in 1 of 3 numbers"):
        curve(broken(*every), knob, clock=STILL)
    found = curve(broken(4), knob, clock=STILL)
    assert found.not_run == (4,)
    assert found.stopped.startswith("4 refused (broken: the result of n 4 is not finite")
    assert choose(found, tolerance=0.1).setting > 4
    last = knob.settings[-1]
    found = curve(broken(*knob.reference), knob, clock=STILL)
    assert found.reference.setting == last
    assert [trial.setting for trial in found.trials] == list(knob.settings)
    assert last**-2.0 / 3 < found.reference.error * np.sqrt(3) < 17 * last**-2.0
    with pytest.raises(InputError, match="the reference holds numbers that are not finite"):
        curve(broken(), knob, reference=[wrong, 1, 1], clock=STILL)


@pytest.mark.parametrize("knob", [N, RANDOM])
@pytest.mark.parametrize("at", [32, 128, 1024])
def test_a_setting_that_fails_loses_no_other(knob, at):
    """A setting or a reference that needs more memory than there is must not affect the others."""
    plain = quadrature(midpoint)[0] if knob is N else monte_carlo()

    def prepare(settings):
        if settings["n"] >= at:
            raise MemoryError("too large\nwith more to say")
        return plain.prepare(settings)

    found = curve(Problem("large", prepare), knob, clock=STILL)
    run = [trial.setting for trial in found.trials]
    assert run == [n for n in knob.settings if n < at]
    assert np.isfinite(found.reference.error)
    failed = max(knob.reference) >= at
    assert ("refused (MemoryError: too large)" in found.stopped) == failed
    with pytest.raises(MemoryError):
        curve(Problem("large", prepare), knob, settings=(at, 2 * at), clock=STILL)


def test_the_error_of_a_reference_includes_a_bias_that_was_declared_random():
    """The knob is declared random, but all seeds agree, so the error is a bias. No finer setting
    could be run, so the reference's error must include the bias."""
    knob = replace(RANDOM, settings=(4, 8), reference=())
    found = curve(
        Problem("biased", lambda s: lambda seed: np.full(9, 1 + 1 / s["n"] ** 2)), knob, clock=STILL
    )
    assert found.reference.error >= 1 / 8**2
    with pytest.raises(InputError, match="and the reference itself within"):
        choose(found, tolerance=1e-3)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("alone", [False, True])
def test_a_deterministic_rule_is_not_its_own_reference(dtype, alone):
    """The mean of seven equal results differs from them by rounding, and this difference is not
    their error."""
    shape, clock = np.random.default_rng(0).uniform(0.5, 1.5, LENGTH), Clock()

    def prepare(settings):
        fixed = settings["rule"] == "quadrature"

        def compute(seed):
            clock.now += 1.0
            if alone and not fixed:
                raise InputError("there is no light to draw")
            noise = 0.0 if fixed else np.random.default_rng(seed).standard_normal(LENGTH)
            return (shape * (1.05 if fixed else 1 + 0.2 * noise)).astype(dtype)

        return compute

    knob = Knob("rule", "", "", ("drawn", "quadrature"), (), random=True)
    problem = Problem("rules", prepare, compared=lambda result: np.minimum(result, np.pi / 2.5))
    found = curve(problem, knob, seconds=16.0, clock=clock)
    assert found.reference.setting == "quadrature"
    if alone:
        assert found.reference.error == np.inf
    else:
        assert 0.05 < found.reference.error < 0.25
    for tolerance in (1e-3, 0.01, 0.045):
        with pytest.raises(InputError):
            choose(found, tolerance=tolerance)


def test_the_mean_of_clipped_results_is_clipped_after_the_mean():
    """Clipping before the mean would make it darker. The error is the scatter of repeated means."""
    draws = 2 * np.random.default_rng(0).binomial(4, 0.5, (16, 64, LENGTH)) / 4

    def cut(values):
        return np.minimum(values, 1.1)

    means = cut(draws.mean(axis=0))
    found, error = mean_of(list(draws[:, 0]), cut)
    np.testing.assert_allclose(found, means[0])
    assert found.mean() > cut(draws).mean() + 0.05
    np.testing.assert_allclose(error, np.sqrt(means.var(axis=0).mean()), rtol=0.15)
    whole = mean_of(list(draws[:, 0]), None)[1]
    np.testing.assert_allclose(whole, mean_of(list(draws[:, 0]), np.asarray)[1])


@pytest.mark.parametrize("law", [-0.7, -1.5, -2.0])
@pytest.mark.parametrize("reference", [(24, 32), (24,), ()])
def test_a_law_that_is_declared_geometric_may_be_a_power(law, reference):
    """A Gauss rule converges on an integrand with an edge by a power law, although its knob
    declares a geometric one. The reported error of the reference is within a factor of 2 of the
    true one."""
    shape = np.random.default_rng(1).uniform(0.5, 1.5, LENGTH)
    knob = Knob("order", "", "", (1, 2, 4, 8, 16), reference, law="geometric")
    problem = Problem("edge", lambda s: lambda seed: shape * (1 + 0.1 * s["order"] ** law))
    found = curve(problem, knob, clock=STILL)
    truth = 0.1 * float(found.reference.setting) ** law
    assert truth / 2 < found.reference.error < 2 * truth


@pytest.mark.parametrize("settings", [(1, 2, 8), (2, 4, 16)])
def test_three_settings_cannot_distinguish_a_geometric_law_from_a_power(settings):
    """Three settings fit a geometric law and a power law alike, so the larger of the two errors is
    reported. A geometric law over a step of six units would predict almost no error."""
    knob = Knob("order", "", "", settings, (), law="geometric")
    for law in (-0.7, -1.5, -2.0):
        problem = Problem("edge", lambda s, law=law: lambda seed: np.full(9, 1 + s["order"] ** law))
        found = curve(problem, knob, clock=STILL)
        assert settings[-1] ** law / 2 < found.reference.error < 2 * settings[-1] ** law


@pytest.mark.parametrize("rate", [0.3, 0.63, 0.8])
@pytest.mark.parametrize("reference", [(16, 24, 32), (16,), ()])
def test_a_geometric_law_is_kept(rate, reference):
    """Paths cut at a depth have a geometric error."""
    knob = Knob("depth", "", "", (2, 3, 4, 6, 8, 12), reference, law="geometric")
    problem = Problem("depth", lambda s: lambda seed: np.full(9, 1 - rate ** s["depth"]))
    found = curve(problem, knob, clock=STILL)
    truth = rate**found.reference.setting
    if truth > 1e-13:
        assert truth / 2 < found.reference.error < 2 * truth


@pytest.mark.parametrize("reference", [(64, 128), (48, 64), (64, 256), ()])
@pytest.mark.parametrize("order", [-0.5, -1.0, -2.0, -4.0])
@pytest.mark.parametrize("chance", [False, True])
def test_the_error_of_a_reference_without_a_closed_form_is_the_true_one(reference, order, chance):
    """The reported error is within a factor of 2 of the true one, for settings at equal and unequal
    ratios, and for errors that shift all numbers together or each at random."""
    c = np.linspace(1, 2, LENGTH)

    def result(n):
        error = np.random.default_rng(n).standard_normal(LENGTH) if chance else c
        return c + error * n**order

    knob = replace(N, settings=(4, 8, 16, 32), reference=reference, order=None)
    problem = Problem("sequence", lambda settings: lambda seed: result(settings["n"]))
    found = curve(problem, knob, clock=STILL).reference
    truth = relative_rms(result(found.setting), c)
    assert truth / 2 < found.error < 2 * truth


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"knob": "sample"}, "the nearest is 'samples'"),
        ({"knob": replace(N, settings=())}, "has no settings"),
        ({"seeds": 1}, "at least 2 seeds"),
        ({"seconds": float("nan")}, "a time above 0 s"),
        ({"metrics": ("rsm",)}, "the nearest is 'rms'"),
        ({"metrics": ("delta_e",)}, "the first norm must be"),
    ],
)
def test_wrong_questions_are_sentences(given, sentence):
    problem, _ = quadrature(midpoint)
    with pytest.raises(InputError, match=sentence):
        curve(problem, given.pop("knob", N), **given)


def test_errors_of_rivals_are_those_of_the_midpoint_rule():
    """The midpoint rule for x^2 over [0, 1] has an error of exactly -1 / (12 n^2)."""
    calls = {n: lambda n=n: np.mean(midpoint(n)[0] ** 2) for n in (1, 10, 100)}
    for trial in error_against_time(calls, 1 / 3, repeats=1):
        np.testing.assert_allclose(trial.error, 3 / (12 * trial.setting**2), rtol=1e-9)


def test_times_of_rivals_are_those_of_the_first_call_and_the_median_warm_one():
    """Competing programs alternate, so that a machine that slows down favours none."""
    turns, clock = [], SimpleNamespace(now=0.0)

    def call(setting, costs):
        turns.append(setting)
        clock.now += next(costs)
        return 1.0

    costs = {"a": iter([8.0, 3.0, 1.0, 5.0]), "b": iter([4.0, 0.5, 0.25, 64.0])}
    calls = {setting: lambda s=setting: call(s, costs[s]) for setting in costs}
    trials = error_against_time(calls, 1.0, repeats=3, clock=lambda: clock.now)
    assert [(t.setting, t.seconds, t.first_seconds) for t in trials] == [
        ("a", 3.0, 8.0),
        ("b", 0.5, 4.0),
    ]
    assert turns == ["a", "b"] * 4


def test_relative_rms_and_empty_sweeps():
    np.testing.assert_allclose(relative_rms([3.0, 4.0], [0.0, 5.0]), np.sqrt(10 / 25))
    with pytest.raises(InputError, match="at least one call"):
        error_against_time({}, 1.0)


def test_no_error_is_a_share_of_nothing():
    with pytest.raises(InputError, match="reference is 0"):
        relative_rms(np.ones(3), np.zeros(3))
    dark = Problem("dark", lambda settings: lambda seed: np.zeros(3), exact=[0.0] * 3)
    with pytest.warns(UserWarning, match="dark: the reference is 0 everywhere"):
        curve(dark, N, clock=Clock())


def test_a_reference_of_another_shape_is_refused():
    """Broadcasting (4, 4, 1) against (4, 4) would compare each pixel with the others of its row."""
    picture = np.arange(16.0).reshape(4, 4)
    assert relative_rms(picture, picture) == 0
    assert relative_rms(np.array([1.0, 3.0]), 2.0) == 0.5
    for result, reference in ((picture[..., None], picture), (picture[0], picture), ([], [])):
        with pytest.raises(InputError, match="give both one shape"):
            relative_rms(result, reference)
