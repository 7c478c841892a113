"""Tests of coverage checks: calibrated intervals pass, planted faults are flagged, and runs
continue. Also checks the coverage of real fits."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2, norm, t

import fitting
from fitting import Gaussian, Normal, Parameter, Problem
from fitting.checks import command, noise, reflectance, response
from fitting.checks.coverage import coverage
from fitting.checks.section import section
from fitting.checks.simulations import places_in, simulated
from fitting.inference.clustering import Robustness
from fitting.inference.estimates import gaussian_estimate
from fitting.inference.posterior import laplace
from fitting.report.progress import reporting
from jaxvision.errors import InputError


def z_of(count, *, sd=1.0, mean=0.0, seed=0):
    return ndtr(mean + sd * np.random.default_rng(seed).standard_normal((count, 3)))


def test_calibrated_intervals_are_not_flagged():
    """At most 5 of 100 checks of correct intervals are flagged, where one is expected."""
    flagged = [
        any(one.faults for one in coverage(z_of(500, seed=seed), ("a", "b", "c")))
        for seed in range(100)
    ]
    assert np.sum(flagged) <= 5


@pytest.mark.slow
def test_a_gamma_has_an_interval_although_the_shutter_is_unidentifiable():
    """The posterior of ln tau is nearly flat and has no curvature, but it still gives an
    interval."""
    for seed in (70000, 70012):
        found = response.places(response.CASES["three exposures off by 1 %"], seed)
        assert np.isfinite(found).all()


@pytest.mark.parametrize("fault", [{"sd": 1.25}, {"sd": 0.8}, {"mean": 0.2}])
def test_planted_faults_are_flagged(fault):
    """The faults are errors .8 and 1.25 times the right ones, and a bias of a fifth of an error."""
    for one in coverage(z_of(2000, **fault), ("a", "b", "c")):
        assert one.faults
        assert abs(one.z_sd - fault.get("sd", 1.0)) < 0.05
        assert abs(one.z_mean - fault.get("mean", 0.0)) < 0.1


@pytest.mark.sweep
@pytest.mark.parametrize("sd", [0.8, 1.25])
def test_two_hundred_fits_flag_one_parameter_whose_errors_are_wrong_by_a_fifth(sd):
    """The fault is found as often as the chi-square test can find it. With shares and ranks alone
    it was found in 65 of 100 checks."""
    sizes = np.array([sd, 1.0, 1.0])
    draws = [np.random.default_rng(seed).standard_normal((200, 3)) for seed in range(100)]
    flagged = [bool(coverage(ndtr(sizes * z), ("a", "b", "c"))[0].faults) for z in draws]
    chance = 0.01 / (3 * 5)
    ends = chi2.ppf([chance / 2, 1 - chance / 2], 200) / sd**2
    power = chi2.cdf(ends[0], 200) + chi2.sf(ends[1], 200)
    assert np.mean(flagged) > power - 4 * np.sqrt(power * (1 - power) / 100)
    assert power > 0.8


def test_a_check_goes_on_where_it_stopped(tmp_path):
    file, asked = tmp_path / "places.npy", []

    def simulate(seed):
        if seed == 25 and len(asked) == 25:
            raise KeyboardInterrupt
        asked.append(seed)
        if seed == 3:
            raise InputError("no interval.")
        return np.random.default_rng(seed).uniform(size=2)

    with pytest.raises(KeyboardInterrupt):
        simulated(simulate, 30, parameters=2, kept=file)
    rows = simulated(simulate, 30, parameters=2, kept=file)
    assert asked == [*range(25), 0, 10, 19, *range(20, 30)]
    assert np.flatnonzero(np.isnan(rows[:, 0])).tolist() == [3]
    told = section("toy", {"case": coverage(rows, ("a", "b"))}, 30).findings
    assert any("1 of 30 fits gave no interval" in sentence for sentence in told)


def quarters(seed):
    return np.full(2, seed / 4)


@pytest.mark.parametrize("damage", [slice(0, -5), slice(0, 3), slice(12, None)])
def test_stored_fits_that_are_damaged_are_not_overwritten(tmp_path, damage):
    """The file is cut within the data, within its first word, or at the front. It is refused and
    not overwritten."""
    file = tmp_path / "places.npy"
    np.save(file, np.ones((2, 2)))
    file.write_bytes(file.read_bytes()[damage])
    left = file.read_bytes()
    with pytest.raises(InputError, match=r"places\.npy: holds no kept fits, or damaged ones"):
        simulated(quarters, 4, parameters=2, kept=file)
    assert file.read_bytes() == left


def test_files_without_fits_are_not_overwritten(tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("years of work")
    with pytest.raises(InputError, match=r"notes\.txt: holds no kept fits, or"):
        simulated(quarters, 4, parameters=2, kept=notes)
    assert notes.read_text() == "years of work"
    with pytest.raises(InputError, match="is a folder"):
        simulated(quarters, 4, parameters=2, kept=tmp_path)
    notes.write_bytes(b"")  # any name, and no content yet
    first = simulated(quarters, 2, parameters=2, kept=notes)
    np.testing.assert_array_equal(simulated(quarters, 2, parameters=2, kept=notes), first)


@pytest.mark.parametrize(
    "rows",
    [
        np.ones((2, 3)),
        np.ones(4),
        np.ones((2, 2), int),
        np.ones((2, 2)),
        np.array([[0.0, 0.0], [0.25, 0.25], [0.9, 0.9]]),  # the last is from another problem
    ],
)
def test_kept_fits_of_another_problem_are_neither_used_nor_lost(tmp_path, rows):
    file = tmp_path / "places.npy"
    np.save(file, rows)
    with pytest.raises(
        InputError, match=r"places\.npy: holds fits of another problem, seed or vers"
    ):
        simulated(quarters, 4, parameters=2, kept=file)
    np.testing.assert_array_equal(np.load(file), rows)


def test_a_check_without_a_successful_fit_gives_the_reason(tmp_path):
    line = Problem(
        {"a": Parameter(prior=Normal(0.0, 1.0))},
        lambda a: a * jnp.ones(4),
        Gaussian(0.1),
        np.zeros(4),
    )
    free = {"a": Parameter(prior=Normal(0.0, 1.0))}
    nowhere = Problem(free, lambda a: a * np.full(4, np.nan), Gaussian(0.1), np.zeros(4))
    with pytest.raises(InputError, match=r"none of 3 fits gave an interval; the first: "):
        fitting.check(nowhere, simulations=3)
    with pytest.raises(InputError, match="posterior = 'x': use Laplace"):
        fitting.check(line, simulations=3, posterior="x")
    with pytest.raises(InputError, match="truth has values that are NaN"):
        fitting.check(line, simulations=3, truth={"a": np.nan})

    def every_other(seed):
        if seed % 2:
            raise InputError("odd")
        return np.array([0.3])

    places = simulated(every_other, 4, parameters=1)
    found = fitting.Check(coverage(places, ("a",)), places)
    assert "2 of 4 fits gave no interval" in str(found)


def test_a_check_with_fewer_fits_keeps_all_stored_ones(tmp_path):
    file = tmp_path / "places.npy"
    every = simulated(quarters, 4, parameters=2, kept=file)
    np.testing.assert_array_equal(simulated(quarters, 2, parameters=2, kept=file), every[:2])
    np.testing.assert_array_equal(np.load(file), every)


def test_another_seed_draws_anew_and_keeps_its_own(tmp_path, monkeypatch):
    asked = []

    def places(case, seed):
        asked.append(seed)
        return quarters(seed % 3)

    room = SimpleNamespace(CASES={"toy": None}, NAMES=("a", "b"), places=places)
    monkeypatch.setitem(command.KINDS, "toy", room)
    with reporting() as reporter:
        for seed in (0, 0, 5):
            command.run("toy", 2, tmp_path, reporter, seed=seed)
    assert asked == [0, 1, 0, 1, 5_000_000, 5_000_001]


def line():
    x = np.linspace(-1, 1, 20)
    return Problem(
        {"a": Parameter(prior=Normal(0.0, 1.0)), "b": Parameter(prior=Normal(0.0, 1.0))},
        predict=lambda a, b, inputs: a + b * inputs,
        likelihood=Gaussian(sd=0.3),
        data=np.zeros(20),
        inputs=x,
    )


def test_a_true_value_of_a_parameter_that_is_not_fitted_is_refused():
    with pytest.raises(
        InputError, match="names slope, which the problem does not fit; it fits a, b"
    ):
        fitting.check(line(), truth={"a": 1.0, "b": 0.0, "slope": 1.0})


def test_a_check_needs_something_to_draw_from():
    free = Problem({"a": Parameter(start=0.0)}, lambda a: a, Gaussian(sd=1.0), np.zeros(()))
    with pytest.raises(InputError, match="neither prior nor bounds"):
        fitting.check(free)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["clean", "lights off by 1 %", "4 lights off by 1 %"])
def test_intervals_of_reflectance_cover_the_true_values(case):
    sphere = reflectance.CASES[case]
    places = simulated(lambda seed: reflectance.places(sphere, seed), 200, parameters=3)
    for one in coverage(places, reflectance.NAMES):
        assert not one.faults, one
        assert 0.8 < one.z_sd < 1.35


def sphere(vector, args):
    return -jnp.sum(vector**2) / (2 * args)


def test_places_are_those_of_the_printed_intervals():
    """The intervals are Laplace's on the transformed scale, Student's, from draws, and from an
    estimate alone."""
    space = (Parameter("a"), Parameter("b", transform="log"))
    mode, own = jnp.zeros(2), np.diag([4.0, 0.25])
    found = laplace(sphere, space, mode, jnp.asarray(1.0), covariance=own)
    placed = places_in(found, {"a": 2.0, "b": np.exp(-0.5), "c": 1.0})
    assert placed == pytest.approx({"a": norm.cdf(1), "b": norm.cdf(-1)})
    student = replace(found, freedom=np.array([3.0, np.inf]))
    assert places_in(student, {"a": 2.0})["a"] == pytest.approx(t.cdf(1, 3))
    drawn = replace(found, method="emcee")
    assert places_in(drawn, {"a": 2.0})["a"] == pytest.approx(norm.cdf(1), abs=0.02)
    printed = gaussian_estimate(Parameter("a"), 3.0, 0.5)
    truths = 3 + 0.5 * np.array([-3, -1.96, -1, 0, 0.5, 1.5, 2.5])
    places = [response._interval_deviate(printed, x) for x in truths]
    np.testing.assert_allclose(places, norm.cdf((truths - 3) / 0.5), atol=3e-3)


def test_a_simulated_stack_follows_its_response():
    """Decoded codes of one pixel in two exposures have the ratio of the exposure times."""
    stack = replace(response.CASES["sRGB"], times=(0.5, 1.0))
    short, long = response.photographs(stack, 0) / 255
    used = (long < 0.9) & (short > 0.3)
    ratio = stack.decode(long[used]) / stack.decode(short[used])
    assert np.median(ratio) == pytest.approx(2, rel=2e-3)
    known = response.photographs(replace(stack, quality=90), 0) / 255
    assert 0 < np.abs(known - [short, long]).mean() < 0.02


def flagged(room, case, count):
    places = simulated(lambda seed: room.places(case, seed), count, parameters=len(room.NAMES))
    return any(one.faults for one in coverage(places, room.NAMES))


@pytest.mark.slow
def test_neglected_errors_of_lights_are_flagged(monkeypatch):
    """The pixels are treated as independent although the lights have errors."""

    def naive(scores, information, *rest, **known):
        whole = np.full(len(information), np.inf)
        return Robustness(np.linalg.inv(information), whole, (np.nan, np.nan), 1.0)

    monkeypatch.setattr("fitting.reflectance.from_images.fit.cluster_robust", naive)
    assert flagged(reflectance, reflectance.CASES["lights off by 1 %"], 60)


@pytest.mark.slow
def test_a_wrong_factor_of_the_sandwich_covariance_is_flagged(monkeypatch):
    """The factor m / (m - P) is applied to a sandwich covariance whose clusters have each lost one
    degree of freedom."""

    def old(scores, information, light, *rest, **known):
        sums = np.stack([np.bincount(light, row) for row in scores])
        inverse, m = np.linalg.inv(information), sums.shape[1]
        covariance = inverse @ (sums @ sums.T) @ inverse * m / (m - len(scores))
        return Robustness(covariance, np.full(len(scores), np.inf), (2.0, np.nan), 2.0)

    monkeypatch.setattr("fitting.reflectance.from_images.fit.cluster_robust", old)
    assert flagged(reflectance, reflectance.CASES["4 lights off by 1 %"], 150)


@pytest.mark.slow
def test_laplaces_approximation_of_a_scatter_is_flagged(monkeypatch):
    """The maximum-likelihood scatter of few levels is too small, and so are all errors that depend
    on it."""

    def old(fit, sampling, seed):
        known = {"covariance": fit.inflation * fit.covariance, "seed": seed}
        vector = jnp.asarray(fit.optimum.vector)
        return laplace(log_density, fit.space, vector, fit.problem, **known)

    from fitting.inference.problem import log_density

    monkeypatch.setattr("fitting.noise.calibration._posterior", old)
    assert flagged(noise, noise.CASES["5 levels off by 1 %"], 150)


@pytest.mark.slow
def test_intervals_under_errors_of_light_cover_the_true_values():
    assert not flagged(noise, noise.CASES["5 levels off by 1 %"], 150)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["clean", "JPEG", "hand-held JPEG"])
def test_bands_of_a_response_cover_the_true_values(case):
    """The share of 95 % intervals that cover the true value is within its binomial range."""
    stack = response.CASES[case]
    places = simulated(lambda seed: response.places(stack, seed), 60, parameters=5)
    for one in coverage(places, response.NAMES):
        low, high = one.band[-1]
        assert low <= one.covered[-1] <= high, one


@pytest.mark.slow
def test_a_dark_of_identical_frames_is_refused():
    """A variance of 0 has no likelihood. Without the check, errors of 1e-13 were printed."""
    with pytest.raises(InputError, match="frames are all alike"):
        noise.places(noise.CASES["fine read noise"], 1009)
