"""Tests the likelihood of photon transfer: bias, efficiency, coverage, and detected deviations."""

import re
from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import called
from noise_findings import told
from oracles.cameras import CameraTruth, expose, sweep
from scipy.stats import norm, poisson
from test_emva1288 import measurement_of, noise_free

from fitting.cli import app
from fitting.inference.emcee_run import Emcee
from fitting.inference.estimates import find
from fitting.inference.formatting import format_with_error
from fitting.inference.left_out import negligible
from fitting.inference.newton import minimise
from fitting.inference.parameters import names
from fitting.inference.search import negative_log_density
from fitting.noise.calibration import calibrate as calibrate_noise
from fitting.noise.emva1288 import evaluate, ranges, sheet, statistics
from fitting.noise.levels import Levels, linear_levels
from fitting.noise.pattern import pattern_variance
from fitting.noise.quantised import quantised_moments, window_for
from fitting.noise.read import read_photon_transfer
from fitting.noise.section import section as noise_section
from fitting.noise.statement import (
    base_space,
    likelihood_sheet,
    make_problem,
    noise_data,
    start_vector,
)
from fitting.noise.window import needed_window, usual_moments_error
from jaxvision.errors import InputError

LIGHT, EXPOSURE = np.linspace(250, 6000, 16), np.linspace(1e-3, 2e-2, 16)


def simulate(camera, *, seed=0, light=LIGHT, exposure=EXPOSURE, pixels=10_000, frames=2, **options):
    rows = sweep(np.random.default_rng(seed), camera, light, exposure, (frames, pixels))
    rows = [levels[:, :2] for levels in rows]
    return measurement_of(light, exposure, *rows, pixels=pixels, frames=frames, **options)


@pytest.mark.slow
def test_more_electrons_than_photons_is_a_finding_and_gives_no_sensor():
    """The stated number of photons is ten times too low."""
    measurement = simulate(CameraTruth())
    bright = replace(measurement.bright, light=measurement.bright.light / 10)
    wrong = noise_section(calibrate_noise(replace(measurement, bright=bright)))
    assert "photons are stated too low" in wrong.findings[0]
    assert wrong.records == {}


def fit_levels(template, inputs, rows, standard):
    """Return the fit of a problem like `template` to other levels, which may be batched."""
    there = ~jnp.isnan(rows)
    levels = jnp.where(there, rows, 0), there, inputs
    problem = eqx.tree_at(lambda p: (p.data, p.present, p.inputs), template, levels)
    return minimise(negative_log_density, start_vector(problem, standard), problem)


def both_methods(measurements):
    """Return (values, errors) of the standard's sheet and of the likelihood for a list of
    cameras."""
    within, usable = ranges(measurements[0]), linear_levels(measurements[0])
    space = base_space(measurements[0], within)
    window, _ = needed_window(measurements[0], usable)
    template = make_problem(space, *noise_data(measurements[0], usable, window=window))

    def one(measurement):
        standard = evaluate(measurement, within)
        data, rows = noise_data(measurement, usable, window=window)
        solution = fit_levels(template, data, rows, standard.values)
        covariance = jnp.linalg.inv(solution.information)
        args = (space, data, jnp.ones(data.lit.shape, bool))
        values = likelihood_sheet(solution.vector, None, args)
        slopes = jax.jacfwd(likelihood_sheet)(solution.vector, None, args)
        errors = {name: jnp.sqrt(slope @ covariance @ slope) for name, slope in slopes.items()}
        return (standard.values, standard.errors), (values, errors), solution

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *measurements)
    return eqx.filter_jit(eqx.filter_vmap(one))(stacked)


TRUTH = {
    "system_gain": 0.3,
    "quantum_efficiency": 50.0,
    "responsivity": 0.15,
    "read_noise": 8.0,
    "temporal_dark_noise": np.sqrt(2.4**2 + 1 / 12),
    "threshold_photons": (np.sqrt(2.4**2 + 1 / 12) / 0.3 + 0.5) / 0.5,
}


def check_coverage(found, *, count, band):
    """Check that every 95 % interval of both methods covers within `band`, and that the bias is
    below 1 %."""
    standard, likelihood, solution = found
    assert np.all(solution.converged)
    for name, true in TRUTH.items():
        for values, errors in (standard, likelihood):
            value, error = np.asarray(values[name]), np.asarray(errors[name])
            # Intervals of positive values are symmetric in the logarithm, as in the report's
            # section.
            covered = np.abs(np.log(value / true)) < 1.96 * error / value
            assert abs(covered.mean() - 0.95) <= band, name
            standard_error = value.std() / np.sqrt(count)
            assert abs(value.mean() / true - 1) < max(0.01, 3 * standard_error / true), name
            assert abs(value.mean() - true) < 4 * standard_error, name


@pytest.fixture(scope="module")
def two_hundred():
    # 1500 pixels are enough for Gaussian moments, and few enough to be quick.
    return both_methods([simulate(CameraTruth(), seed=i, pixels=1500) for i in range(200)])


@pytest.mark.slow
def test_the_likelihood_is_efficient_and_beats_the_regressions(two_hundred):
    (standard, _), (likelihood, errors), _ = two_hundred
    for name in ("system_gain", "quantum_efficiency", "read_noise"):
        scatter = np.var(np.asarray(likelihood[name]))
        # The claimed error is the Cramer-Rao bound. The variance of 200 values has an error of 10
        # %.
        bound = np.median(np.asarray(errors[name]) ** 2)
        assert bound / scatter > 0.8, name
        assert np.var(np.asarray(standard[name])) > 1.4 * scatter, name


@pytest.mark.slow
def test_intervals_cover_over_two_thousand_cameras():
    found = both_methods([simulate(CameraTruth(), seed=i, pixels=4000) for i in range(2000)])
    check_coverage(found, count=2000, band=0.015)


def brute_moments(mu, gain, read, offset, largest=400):
    """Return cumulants of the clipped, rounded signal by summing over electrons and codes."""
    electrons = np.arange(600)
    edges = np.concatenate([[-np.inf], np.arange(largest) + 0.5, [np.inf]])
    cells = np.diff(norm.cdf((edges - offset - gain * electrons[:, None]) / (gain * read)), axis=1)
    codes, weight = np.arange(largest + 1), poisson.pmf(electrons, mu) @ cells
    mean = weight @ codes
    second, third, fourth = (weight @ (codes - mean) ** p for p in (2, 3, 4))
    return mean, second, third, fourth - 3 * second**2


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("mu", "gain", "read", "offset"),
    [
        (0.0, 0.5, 3.0, 1.0),
        (5.0, 0.5, 3.0, 1.0),
        (0.0, 0.1, 2.0, 4.0),
        (30.0, 0.1, 2.0, 4.4),
        (2.0, 4.0, 0.3, 10.0),
        (0.0, 3.0, 4.0, 5.0),
        (60.0, 0.5, 3.0, 20.0),
    ],
)
def test_quantised_moments_equal_those_of_the_summed_distribution(mu, gain, read, offset):
    expected = brute_moments(mu, gain, read, offset)
    deviation = np.sqrt(gain**2 * (mu + read**2) + 1 / 12)
    window = window_for((0,), np.array([expected[0]]), deviation=deviation, read_noise=gain * read)
    own = jax.tree.map(lambda leaf: leaf[0], window)
    arguments = (jnp.asarray(x) for x in (mu, gain, read, offset))
    found = quantised_moments(*arguments, own)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-8)
    scale = expected[1]
    for power, value, true in zip((1, 1.5, 2), found[1:4], expected[1:], strict=True):
        np.testing.assert_allclose(value, true, atol=1e-6 * max(scale, 0.05) ** power)


def test_a_scatter_too_large_for_exact_sums_is_a_sentence():
    with pytest.raises(InputError, match=r"scatters by 4e\+11 DN rms where the darks scatter by 3"):
        window_for((0,), np.array([3.9]), deviation=4e11, read_noise=3.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "top"),
    [
        (CameraTruth(gain=0.5, read_noise=3.0, offset=1.0, dark_current=0.0), 32.0),
        (CameraTruth(gain=0.1, read_noise=2.0, offset=4.0, dark_current=0.0), 1400.0),
    ],
    ids=["clipped black", "read noise of 0.2 DN"],
)
def test_exact_moments_correct_clipped_black_and_fine_read_noise(camera, top):
    light = np.linspace(top / 8, top, 8)
    exposure = np.full(8, 0.01)
    measured = [
        simulate(camera, seed=i, light=light, exposure=exposure, pixels=20_000) for i in range(16)
    ]
    usable, within = np.arange(8), ranges(measured[0])
    window, _ = needed_window(measured[0], usable)
    assert window is not None
    space = base_space(measured[0], within)
    template = make_problem(space, *noise_data(measured[0], usable, window=window))

    def fit(measurement):
        standard = sheet(statistics(measurement, None), measurement, within)
        levels = noise_data(measurement, usable, window=window)
        return standard, fit_levels(template, *levels, standard)

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *measured)
    standard, solution = eqx.filter_jit(eqx.filter_vmap(fit))(stacked)
    assert np.all(solution.converged)
    covariance = np.linalg.inv(np.asarray(solution.information))
    for name, true in (("system_gain", camera.gain), ("read_noise", camera.read_noise)):
        i = names(space).index(name)
        value = np.exp(np.asarray(solution.vector)[:, i])
        error = value * np.sqrt(covariance[:, i, i])
        assert abs(value.mean() - true) < 3.5 * value.std(ddof=1) / np.sqrt(16), name
        assert abs(value.mean() / true - 1) < 0.01, name
        # Of 16 draws at 95 %, fewer than 12 cover once in 1000 times.
        assert np.sum(np.abs(value - true) < 1.96 * error) >= 12, name
    assert abs(np.mean(np.asarray(standard["read_noise"])) / camera.read_noise - 1) > 0.3


@pytest.mark.parametrize("deviation", [0.3, 0.5, 0.65, 0.9])
def test_the_usual_moments_are_used_if_no_fit_can_see_the_difference(deviation):
    """The bound is compared with sums over codes, for the worst mean between two codes."""
    codes, off = np.arange(60.0), []
    for mean in np.linspace(20, 21, 41):
        share = np.diff(norm.cdf((np.append(codes, 60) - 0.5 - mean) / deviation))
        first = share @ codes
        off.append((abs(first - mean), abs(share @ (codes - first) ** 2 - deviation**2 - 1 / 12)))
    worst, total = np.max(off, axis=0), deviation**2 + 1 / 12
    expected = np.sqrt(1e6 * (2 * worst[0] ** 2 / total + worst[1] ** 2 / (2 * total**2)))
    levels = [np.array([x]) for x in (20.5, total, 2.0)]
    assert usual_moments_error(*levels, 1e6).bound == pytest.approx(expected, rel=1e-2)
    assert bool(negligible([usual_moments_error(*levels, 1e6)])) == (deviation > 0.7)
    above = 2 * deviation
    signal = np.linspace(above - 12 * deviation, above + 12 * deviation, 200_001)
    share = norm.pdf(signal, above, deviation)
    share, seen = share / share.sum(), np.maximum(signal, 0)
    clipped = share @ seen
    lost = clipped - above, share @ (seen - clipped) ** 2 - deviation**2
    moved = np.sqrt(1e6 * (2 * lost[0] ** 2 / total + lost[1] ** 2 / (2 * total**2)))
    assert usual_moments_error(np.array([above]), *levels[1:], 1e6).bound >= 0.9 * moved


@pytest.mark.slow
def test_an_ordinary_camera_traces_no_exact_moments_and_no_effect():
    measured = simulate(CameraTruth())
    usable = linear_levels(measured)
    assert needed_window(measured, usable)[0] is None
    problem = make_problem(base_space(measured, ranges(measured)), *noise_data(measured, usable))
    standard = sheet(statistics(measured, None), measured, ranges(measured))
    traced = jax.make_jaxpr(negative_log_density)(start_vector(problem, standard), problem)
    plain = {eqn.primitive.name for eqn in _equations(traced)}
    assert not plain & {"cos", "sin"}


def _equations(closed):
    for equation in closed.jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            if hasattr(value, "jaxpr"):
                yield from _equations(value)


@pytest.mark.slow
def test_a_linear_camera_is_called_linear():
    calibration = calibrate_noise(simulate(CameraTruth(), seed=4))
    assert calibration.chosen is calibration.linear
    section = noise_section(calibration)
    assert "A linear camera" in section.findings[0]
    assert "photons are stated" not in " ".join(section.findings)
    assert set(section.records) == {"sensor"}


@pytest.fixture(scope="module")
def bent():
    """Return a camera whose gain falls by 4 %, with a flickering lamp, a late shutter and a
    drifting black level."""
    camera = CameraTruth(
        compression=0.02,
        top=0.15 * 6000,
        light_offset=20.0,
        light_scatter=0.002,
        black_scatter=0.3,
    )
    light = np.round(np.linspace(250, 6000, 30))
    exposure = light * 4e-6
    measured = simulate(camera, seed=6, light=light, exposure=exposure, pixels=40_000)
    return camera, calibrate_noise(measured)


@pytest.mark.slow
def test_a_nonlinear_response_is_detected_and_corrected(bent):
    camera, calibration = bent
    assert calibration.linear.p_value < 1e-10
    chosen = calibration.chosen
    assert {"compression", "light_offset", "light_scatter", "black_scatter"} <= set(chosen.values)
    assert chosen.p_value > 1e-3
    rescale = camera.top / float(chosen.data.top_signal)
    truth = {
        "system_gain": camera.gain,
        "responsivity": camera.gain * camera.efficiency,
        "read_noise": camera.read_noise,
        "light_offset": camera.light_offset,
        "light_scatter": camera.light_scatter,
        "black_scatter": camera.black_scatter,
    }
    natural = {"light_offset"}
    for name, true in truth.items():
        value, error = float(chosen.values[name]), chosen.errors[name]
        error = error if name in natural else error * value
        assert abs(value - true) < 3.5 * error, name
        assert error < 0.4 * true, name
    bend = float(chosen.values["compression"]) * rescale
    assert abs(bend - camera.compression) < 3.5 * chosen.errors["compression"]


@pytest.mark.slow
def test_sentences_quote_the_numbers_of_the_table():
    """The posterior for a drifting black level is skewed, so the sentence quotes its median, not
    its mode."""
    rng, n = np.random.default_rng(11), 10_000
    light, exposure = np.linspace(500, 6000, 8), np.linspace(1e-3, 1e-2, 8)
    black = 60 + rng.normal(size=16)
    electrons = np.concatenate([0.5 * light, 0 * light]) + 100 * np.tile(exposure, 2)
    variance = 0.3**2 * (electrons + 64) + 1 / 12
    mean = black + 0.3 * electrons + rng.normal(size=16) * np.sqrt(variance / (2 * n))
    variance *= rng.chisquare(n, 16) / n
    rows = np.stack([mean, variance], axis=1)
    measured = measurement_of(light, exposure, rows[:8], rows[8:], pixels=n, frames=2)
    section = noise_section(calibrate_noise(measured))
    (shown,) = (one for one in section.estimates if one.name == "black_scatter")
    (told,) = (one for one in section.findings if "black level varies" in one)
    assert format_with_error(shown.value, shown.standard_error) in told


@pytest.mark.slow
def test_a_nonlinear_camera_is_described_in_words(bent):
    _, calibration = bent
    told = " ".join(noise_section(calibration).findings)
    for words in (
        "is not linear",
        "the gain falls by",
        "zero signal",
        "photons more than recorded",
        "black level varies",
        "off by",
    ):
        assert words in told
    # The standard's regression gives the mean slope of the curve.
    standard = float(calibration.standard.values["system_gain"])
    error = float(calibration.standard.errors["system_gain"])
    assert abs(calibration.likelihood.standard_of_chosen - standard) < 4 * error
    assert calibration.likelihood.standard_of_chosen < float(
        calibration.chosen.values["system_gain"]
    )


@pytest.mark.slow
def test_the_section_has_both_methods_and_its_pictures(bent):
    _, calibration = bent
    with jax.enable_x64(False):  # as in the command; a warning of lost digits is an error here
        section = noise_section(calibration)
    for name in ("system_gain", "quantum_efficiency", "read_noise", "threshold_photons"):
        for method in ("EMVA 1288", "likelihood"):
            estimate = find(section.estimates, name, method=method)
            assert estimate.value is not None
            assert estimate.interval_95[0] < estimate.interval_68[0] < estimate.value
            assert estimate.value < estimate.interval_68[1] < estimate.interval_95[1]
    for name in ("saturation_photons", "dynamic_range"):
        assert "add brighter flats" in find(section.estimates, name).reason
    assert "temporal sums" in find(section.estimates, "prnu").reason
    assert all(sentence.endswith(".") for sentence in section.findings)
    for picture in section.pictures:
        figure = picture.draw()
        assert figure.axes
        assert all(axis.get_ylabel() for axis in figure.axes)


@pytest.mark.slow
def test_light_in_seconds_gives_a_gain_but_no_efficiency():
    light = EXPOSURE * 3e5
    rows = sweep(np.random.default_rng(2), CameraTruth(), light, EXPOSURE, (2, 10_000))
    measured = measurement_of(EXPOSURE, EXPOSURE, *rows, photons_known=False)
    section = noise_section(calibrate_noise(measured))
    gain = find(section.estimates, "system_gain", method="likelihood")
    assert abs(gain.value - 0.3) < 4 * gain.standard_error
    rate = find(section.estimates, "signal_rate")
    assert abs(rate.value - 4.5e4) < 4 * rate.standard_error
    assert "was not measured" in find(section.estimates, "quantum_efficiency").reason


def test_newton_leaves_a_saddle_and_finds_the_minimum():
    # x^4 - 2 x^2 + y^2 / 2 has minima at (+-1, 0) and a saddle point at the origin.
    found = minimise(_double_well, jnp.array([1e-3, 3.0]), jnp.asarray(2.0))
    assert bool(found.converged)
    np.testing.assert_allclose(np.abs(found.vector), [1, 0], atol=1e-3)
    np.testing.assert_allclose(found.information, [[8, 0], [0, 1]], atol=0.02)


def _double_well(vector, depth):
    x, y = vector
    return x**4 - depth * x**2 + y**2 / 2


def test_newton_refuses_steps_out_of_bounds():
    found = minimise(_barrier, jnp.array([5.0]), jnp.asarray(1.0))
    np.testing.assert_allclose(found.vector, [1], rtol=1e-3)


def _barrier(vector, target):
    # -log x + x / target is not finite for x < 0.
    return (vector / target - jnp.log(vector)).sum()


@pytest.mark.slow
def test_sampling_agrees_with_laplace():
    measured = simulate(CameraTruth(), seed=3)
    smooth = calibrate_noise(measured)
    drawn = calibrate_noise(measured, sampling=Emcee(walkers=32), seed=1)
    for name in ("system_gain", "read_noise", "quantum_efficiency"):
        one, two = (find(c.sheet, name) for c in (smooth, drawn))
        assert abs(one.value - two.value) < 0.15 * one.standard_error
        assert abs(two.standard_error / one.standard_error - 1) < 0.1


@pytest.mark.slow
def test_a_rig_gives_fixed_pattern_by_both_methods(tmp_path):
    camera = replace(CameraTruth(), dsnu=5.0, prnu=0.012)
    rng = np.random.default_rng(9)
    shape = (60, 80)
    die = 1 + camera.prnu * rng.standard_normal(shape), camera.dsnu * rng.standard_normal(shape)
    text = "[camera]\nbits = 12\n"
    for i in range(8):
        for kind, photons in (("flat", 1000.0 * (i + 1)), ("dark", 0.0)):
            stack = expose(rng, camera, photons, 0.002 * (i + 1), (6, *shape), die=die)
            files = [f"{kind}{i}_{k}.npy" for k in range(6)]
            for name, frame in zip(files, stack, strict=True):
                np.save(tmp_path / name, frame.astype(np.uint16))
            text += f"[[{kind}]]\nfiles = {files!r}\nexposure = {0.002 * (i + 1)}\n"
            text += f"photons = {photons}\n" if kind == "flat" else ""
    (tmp_path / "rig.toml").write_text(text)
    section = noise_section(calibrate_noise(read_photon_transfer(tmp_path)))
    for method in ("EMVA 1288", "likelihood"):
        for name, true in (("dsnu", camera.dsnu), ("prnu", 100 * camera.prnu)):
            estimate = find(section.estimates, name, method=method)
            assert abs(estimate.value - true) < 3.5 * estimate.standard_error
            assert estimate.standard_error < 0.1 * true


@pytest.mark.slow
def test_a_noise_free_curve_is_fitted_exactly():
    camera = CameraTruth()
    # Means without scatter reduce each variance by 1 / pixels.
    measured, _, _ = noise_free(camera, LIGHT, EXPOSURE, pixels=10_000_000)
    calibration = calibrate_noise(measured)
    for name, true in TRUTH.items():
        np.testing.assert_allclose(find(calibration.sheet, name).value, true, rtol=1e-6)


def test_the_variance_of_a_pattern_variance_equals_that_of_repetitions():
    """The stacks have L frames of pixels without a pattern, and with one as strong as the noise."""
    rng, n, repetitions = np.random.default_rng(8), 200, 1500
    for count, fixed in ((2, 0.0), (2, 1.0), (5, 0.0)):
        pattern = np.sqrt(fixed) * np.sqrt(2) * np.sin(2 * np.pi * np.arange(n) / n)
        frames = pattern + rng.standard_normal((repetitions, count, n))
        spatial = frames.mean(1).var(1, ddof=1) - frames.var(1, ddof=1).mean(1) / count
        one, ones = jnp.ones(()), jnp.ones(1)
        levels = Levels(ones, ones, ones, ones, count * ones, n * one, (fixed + 1 / count) * ones)
        found, by_noise = pattern_variance(levels)
        np.testing.assert_allclose(found, fixed, atol=1e-6)
        np.testing.assert_allclose(by_noise, spatial.var(), rtol=0.15)  # with an error of 4 %


@pytest.mark.parametrize(
    ("efficiency", "least", "said"),
    [
        *((None, None, ""), (0.6, 0.59, ""), (5e-29, 5e-29, "the light is stated too high")),
        *((1.3, 1.29, "which no sensor has"), (1.006, 0.993, "is 100 % within its error")),
    ],
)
def test_an_impossible_efficiency_is_named(efficiency, least, said):
    found = SimpleNamespace(efficiency=efficiency, least_efficiency=least)
    words = told(found, "low efficiency", "high efficiency", "efficiency of one")
    assert said in " ".join(words)
    assert bool(words) == bool(said)


@pytest.mark.slow
def test_a_level_darker_than_its_dark_does_not_change_the_gain(tmp_path):
    """One dark in the middle is 256 DN. Means and variances of the others give .25 DN/e-."""
    head = "exposure_ms,photons_per_pixel,mean_bright_DN,var_bright_DN2,mean_dark_DN,var_dark_DN2"
    rows = [(50, 72.5, 12.6), (100, 85.1, 15.7), (500, 185.0, 40.7), (2000, 560.2, 134.4)]
    rows += [(5000, 1310.1, 321.9), (10000, 2560.4, 634.1), (2000, 560.2, 134.4)]
    lines = [f"{head},pixels"]
    for n, (photons, mean, variance) in enumerate(rows):
        exposure, dark = "1e-45" if n == 1 else "1", "256" if n == 2 else "60.1"
        lines.append(f"{exposure},{photons},{mean},{variance},{dark},9.4,10000")
    (tmp_path / "levels.csv").write_text("\n".join(lines) + "\n")
    status, said, complained = called(
        app, "noise", tmp_path / "levels.csv", "--out", tmp_path / "out"
    )
    assert status == 0, complained
    assert "The black level varies by" in said
    gain, error = map(float, re.findall(r"system gain[^\n]*│ ([\d.]+) ± ([\d.]+)", said)[-1])
    assert abs(gain - 0.25) < 3 * error < 0.03
    assert "encountered" not in complained
    assert (tmp_path / "out" / "report.html").exists()
