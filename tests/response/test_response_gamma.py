"""Tests estimates of gamma: unbiased, with intervals that cover, also with shutter errors."""

import jax
import numpy as np
import pytest
from oracles.stacks import exposure_stack, gamma, srgb
from scipy import stats

from fitting.inference.emcee_run import Emcee
from fitting.inference.left_out import TOLERANCE
from fitting.response import gamma as gamma_module
from fitting.response.curve import fit_response_curve
from fitting.response.gamma import fit_gamma

TIMES = 2.0 ** np.arange(-4, 5)


def fitted(response, times, seed, **options):
    sampling = options.pop("sampling", None)
    _, codes = exposure_stack(response, times, np.random.default_rng(seed), **options)
    return fit_gamma(fit_response_curve(codes, times, bits=8), sampling=sampling)


@pytest.mark.slow
@pytest.mark.parametrize("truth", [1.0, 1.8, 2.2])
def test_gamma_is_unbiased_by_noise_and_rounding(truth):
    """A log regression of these stacks has an error of at least 0.5 %."""
    found = [fitted(gamma(truth), TIMES, seed).gamma.value for seed in range(4)]
    assert np.mean(found) == pytest.approx(truth, rel=1.5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("exposures", "error"), [(9, 0.02), (5, 0.02), (5, 0.05), (9, 0.1)])
def test_intervals_cover_with_shutter_errors(exposures, error):
    """For 32 stacks, 95 % intervals cover at least 26 times (with probability .999 if calibrated).
    They are not wider than needed, because the free curve limits shutter errors."""
    hits, widths, errors = 0, [], []
    for seed in range(32):
        times = TIMES[:exposures]
        estimate = fitted(gamma(2.2), times, 100 + seed, pixels=3000, shutter_error=error).gamma
        low, high = estimate.interval_95
        hits += low < 2.2 < high
        widths.append(high - low)
        errors.append(estimate.value - 2.2)
    assert hits >= stats.binom.ppf(1e-3, 32, 0.95)
    assert np.median(widths) < 8 * np.std(errors)


@pytest.mark.slow
def test_three_exposures_need_wider_intervals_than_nine():
    nine = fitted(gamma(2.2), TIMES, 1, pixels=4000, shutter_error=0.01).gamma
    three = fitted(gamma(2.2), TIMES[3:6], 1, pixels=4000, shutter_error=0.01).gamma
    assert three.standard_error > 1.5 * nine.standard_error
    assert three.interval_95[0] < 2.2 < three.interval_95[1]


@pytest.mark.slow
def test_sampling_equals_the_exact_integral():
    exact = fitted(gamma(2.2), TIMES, 2, pixels=4000, shutter_error=0.02).gamma
    options = Emcee(walkers=32, steps=6000, block=500)
    sampled = fitted(gamma(2.2), TIMES, 2, pixels=4000, shutter_error=0.02, sampling=options)
    assert sampled.posterior.method == "emcee"
    width = exact.interval_95[1] - exact.interval_95[0]
    assert sampled.gamma.value == pytest.approx(exact.value, abs=0.05 * width)
    np.testing.assert_allclose(sampled.gamma.interval_95, exact.interval_95, atol=0.1 * width)


@pytest.mark.parametrize("shutter_error", [0.0, 0.02])
def test_draws_have_the_printed_intervals(shutter_error):
    found = fitted(gamma(2.2), TIMES, 2, pixels=4000, shutter_error=shutter_error)
    for estimate, draws in zip(
        (found.gamma, found.shutter_error), found.posterior.samples.T, strict=True
    ):
        for (low, high), outside in ((estimate.interval_68, 0.32), (estimate.interval_95, 0.05)):
            for share in (np.mean(draws < low), np.mean(draws > high)):
                assert share == pytest.approx(
                    outside / 2, abs=4 * np.sqrt(outside / 2 / len(draws))
                )


def test_srgb_is_recognised():
    found = fitted(srgb, TIMES, 3, full_well=40_000.0)
    central = slice(20, 236)
    assert np.nanmax(np.abs(found.srgb_departure[central])) < 0.02
    assert np.nanmax(np.abs(found.departure[central])) > 0.05


def test_stated_errors_of_black_and_shutter_widen():
    """Gamma is the slope of ln X over ln(code - black). An exponent common to all shutter times has
    the error sd / sqrt(sum (ln t - mean)^2)."""
    _, codes = exposure_stack(gamma(2.2), TIMES, np.random.default_rng(4), pixels=4000)
    curve = fit_response_curve(codes, TIMES, bits=8)
    plain = fit_gamma(curve).gamma
    of_black = fit_gamma(curve, black_sd=1.0).gamma
    assert of_black.standard_error > 3 * plain.standard_error
    of_shutter = fit_gamma(curve, exposure_sd=0.05).gamma
    spread = np.sum((np.log(TIMES) - np.log(TIMES).mean()) ** 2)
    expected = np.hypot(2.2 * 0.05 / np.sqrt(spread), plain.standard_error)
    assert of_shutter.standard_error == pytest.approx(expected, rel=0.1)


def test_two_exposures_use_the_stated_shutter_error():
    """Two shutters do not reveal their errors. A stated error of 1e-4, which pixels cannot detect
    and the fit neglects, gives a narrower interval than 1e-3 does, and not that of the prior on
    cameras."""
    times = np.array([0.25, 1.0])
    _, codes = exposure_stack(gamma(2.2), times, np.random.default_rng(4), pixels=4000)
    curve = fit_response_curve(codes, times, bits=8)
    widths = [
        float(np.ptp(fit_gamma(curve, exposure_sd=stated).gamma.interval_95))
        for stated in (1e-4, 1e-3, 5e-3, 0.0)
    ]
    assert [own.name for own in fit_gamma(curve, exposure_sd=1e-4).left_out] == ["exposure_sd"]
    assert (np.diff(widths) > 0).all()
    assert widths[2] == pytest.approx(2 * 1.96 * 2.2 * 5e-3 / np.log(4) * np.sqrt(2), rel=0.2)


def test_undetectable_errors_of_black_and_shutter_are_left_out():
    """The bound is compared with the least-squares energy of all pixels, with the best irradiances
    for each shift: the change of gamma is the effect of the shift on the misfit without noise."""
    _, codes = exposure_stack(gamma(2.2), TIMES, np.random.default_rng(4), pixels=4000)
    curve = fit_response_curve(codes, TIMES, bits=8)
    known = fit_gamma(curve, black_sd=1e-4, exposure_sd=1e-6)
    plain = fit_gamma(curve)
    assert {own.name for own in known.left_out} == {"black_sd", "exposure_sd"}
    assert not fit_gamma(curve, black_sd=1.0, exposure_sd=0.05).left_out
    assert not plain.left_out
    assert known.gamma.interval_95 == plain.gamma.interval_95
    bounds = {own.name: own.bound for own in known.left_out}
    assert 0 < sum(bounds.values()) <= TOLERANCE
    # pixel by pixel: weights are the inverse variance of ln X, and irradiances are weighted means
    bin_of = curve.bins.lookup[codes]
    code = np.maximum(codes.astype(float), 1)
    variance = curve.pixel_noise[bin_of] ** 2 + (2.2 / code) ** 2 / 12
    weight = np.where((bin_of >= 0) & (variance < 0.04), 1 / variance, 0)
    weight /= known.dispersion * curve.design_effect
    shift = 2.2 * 1e-4 / code
    best = (weight * shift).sum(0) / np.where(weight.any(0), weight.sum(0), 1)
    square = (weight * (shift - best) ** 2).sum()
    assert bounds["black_sd"] == pytest.approx(np.sqrt(1 + square) - 1, rel=0.25)
    laplacian = np.diag(weight.sum(1)) - np.einsum(
        "ip,jp->ij", weight, weight / np.where(weight.any(0), weight.sum(0), 1)
    )
    squares = np.linalg.eigvalsh(1e-12 * laplacian)
    expected = np.sqrt(((np.sqrt(1 + np.maximum(squares, 0)) - 1) ** 2).sum())
    assert bounds["exposure_sd"] == pytest.approx(expected, rel=0.25)


def test_errors_that_are_left_out_are_not_traced(monkeypatch):
    """With undetectable errors the maximised density is the program without errors."""
    _, codes = exposure_stack(gamma(2.2), TIMES, np.random.default_rng(4), pixels=400)
    curve, laplace, programs = fit_response_curve(codes, TIMES, bits=8), gamma_module.laplace, []

    def seen(density, space, mode, sums, **options):
        programs.append(str(jax.make_jaxpr(density)(mode, sums)))
        return laplace(density, space, mode, sums, **options)

    monkeypatch.setattr(gamma_module, "laplace", seen)
    for sizes in ({}, {"black_sd": 1e-4, "exposure_sd": 1e-6}, {"exposure_sd": 0.05}):
        fit_gamma(curve, **sizes)
    plain, without, whole = programs
    assert without == plain
    assert whole.count("\n") > plain.count("\n")
