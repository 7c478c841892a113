"""Tests the detection of clipped or rounded data, and of standard deviations computed from noisy
data."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from fitting import Censored, Gaussian, Parameter, Problem, SensorCounts, fit, fit_map

TIME = np.linspace(0.0, 4.0, 200)
TRUE = 1.5 * np.exp(-TIME / 0.8) + 0.2
FREE = {
    "amplitude": Parameter(lower=0, upper=50),
    "decay": Parameter(lower=0.1, upper=10, transform="log"),
    "background": Parameter(lower=-5, upper=50),
}
SD = 0.02


def decay(inputs, amplitude, decay, background):
    return amplitude * jnp.exp(-inputs / decay) + background


def fitted(data, likelihood, **options):
    return fit(Problem(FREE, decay, likelihood, data, inputs=TIME), starts=4, **options)


def noisy(seed=0):
    return TRUE + SD * np.random.default_rng(seed).standard_normal(200)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (np.minimum(noisy(), 1.2), r"of 200 data are equal to the largest, 1\.2, .* Censored"),
        (np.maximum(noisy(), 0.3), r"of 200 data are equal to the smallest, 0\.3, .* low=0\.3"),
        (0.25 * np.round(noisy() / 0.25), r"All data lie 0\.25 apart .* 1[1-4] times the noise"),
    ],
)
def test_clipped_or_rounded_data_are_named(data, expected):
    found = fitted(data, Gaussian(sd=SD))
    assert not found.converged
    assert re.search(expected, found.failures[0]), found.failures[0]
    allowed = fitted(data, Gaussian(sd=SD), misfit="inflate")
    assert allowed.findings[0].split(" data ")[0] == found.failures[0].split(" data ")[0]


def test_constant_data_are_neither_clipped_at_one_end_nor_copies():
    for level in (0.3, 255.0):
        problem = Problem(
            {"level": Parameter(lower=-10, upper=300)},
            lambda level: level * np.ones(60),
            Gaussian(sd=2.0),
            np.full(60, level),
        )
        found = fit(problem, starts=2)
        told = [one for one in (*found.failures, *found.findings) if "data are" in one]
        assert len(told) == 1
        assert told[0].startswith(f"All 60 data are equal to {level:.6g}")


def test_copies_among_the_data_are_named():
    """Only 50 of 200 data are independent, so standard errors are half of the right ones."""
    copied = noisy()[::4].repeat(4)
    line = {"level": Parameter(lower=-5, upper=5), "slope": Parameter(lower=-5, upper=5)}
    found = fit(
        Problem(
            line,
            lambda inputs, level, slope: level + slope * inputs,
            Gaussian(sd=1.0),
            copied,
            inputs=TIME,
        ),
        starts=2,
    )
    (told,) = [one for one in (*found.failures, *found.findings) if "copies" in one]
    assert told.startswith("Only 50 of 200 data are different numbers")
    assert "too narrow, by a factor of 2." in told
    own = fitted(noisy(), Gaussian(sd=SD))
    assert not any("copies" in one for one in (*own.failures, *own.findings))
    zero = np.where(TIME > 2, 0.0, noisy())  # equal, but not copies
    missed = fitted(zero, Gaussian(sd=SD))
    assert not any("copies" in one for one in (*missed.failures, *missed.findings))


@pytest.mark.slow
def test_data_that_are_clipped_as_stated_or_rounded_finely_are_not():
    for data, likelihood in (
        (noisy(), Gaussian(sd=SD)),
        (np.minimum(noisy(), 1.2), Censored(sd=SD, high=1.2)),
        (0.01 * np.round(noisy() / 0.01), Gaussian(sd=SD)),
    ):
        found = fitted(data, likelihood)
        assert found.converged
        assert not any("apart" in text or "equal to the" in text for text in found.findings)


@pytest.mark.slow
def test_standard_deviations_computed_from_the_data_are_named():
    """The sum of the predictions is below the sum of the data."""
    counts = np.random.default_rng(1).poisson(9 * TRUE).astype(float)
    found = fitted(counts, Gaussian(sd=np.sqrt(np.maximum(counts, 1))))
    assert "follow the data themselves" in found.failures[0]
    told = found.failures[0].split("add up to ")[1].split(",")[0]
    missed = counts.sum() - float(told)
    assert abs(missed - found.misfit.chi_square) < 0.3 * missed
    assert not any("overrated" in text for text in found.findings)
    stated = fitted(counts, Gaussian(sd=np.sqrt(9 * TRUE)))
    assert not any("follow the data" in text for text in (*stated.failures, *stated.findings))


@pytest.mark.slow
def test_poissons_law_fits_few_counts():
    """The printed advice is to fit with Poisson noise."""
    counts = np.random.default_rng(1).poisson(3 * TRUE).astype(float)
    sensor = jv.Sensor(shot_noise=jv.PoissonShotNoise(), read_noise=0.05, gain=1.0)
    problem = Problem(
        FREE,
        lambda inputs, amplitude, decay, background: (
            amplitude * jnp.exp(-inputs / decay) + background
        )[:, None],
        SensorCounts(sensor, reach=8),
        counts[:, None],
        inputs=TIME,
    )
    found = fit(problem, starts=4)
    assert found.converged
    predicted = decay(TIME, **{name: found.values[name] for name in FREE})
    assert abs(float(predicted.sum()) - counts.sum()) < 0.01 * counts.sum()


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda x: np.minimum(x, 30.0), r"of 768 data are equal to the largest, 30, .*high=30"),
        (lambda x: 2.0 * np.round(x / 2.0), r"All data lie 2 apart .* 4.* times the noise"),
        (lambda x: 0.05 * np.round(x / 0.05), None),
    ],
)
def test_the_data_of_a_map_are_checked_as_those_of_one_fit(change, expected):
    rng, seconds = np.random.default_rng(0), np.linspace(1.0, 12.0, 12)
    dark, offset = rng.uniform(1, 3, (8, 8)), rng.uniform(5, 10, (8, 8))
    images = offset + dark * seconds[:, None, None] + 0.5 * rng.standard_normal((12, 8, 8))
    pixel = Problem(
        {"dark": Parameter(start=1.0), "offset": Parameter(start=0.0)},
        lambda dark, offset, inputs: offset + dark * inputs,
        *(Gaussian(sd=0.5), np.zeros(12)),
        inputs=seconds,
    )
    told = [one for one in fit_map(pixel, change(images)).findings if "data " in one]
    assert len(told) == (expected is not None)
    assert expected is None or re.search(expected, told[0])


def line_far_from_zero(share, seed):
    """Return a problem of a line with noise of .05, whose data have a last digit of `share` times
    the noise."""
    rng, x = np.random.default_rng(seed), np.linspace(0, 10, 200)
    offset = share * 0.05 / np.finfo(jnp.result_type(float)).eps
    return Problem(
        {"offset": Parameter(start=offset), "slope": Parameter(start=0.0)},
        lambda offset, slope, inputs: offset + slope * inputs,
        Gaussian(sd=0.05),
        offset + 3 * x + rng.normal(0, 0.05, 200),
        inputs=x,
    )


@pytest.mark.sweep
@pytest.mark.parametrize("share", [1.2, 2000.0])
def test_data_with_too_few_digits_are_named(share):
    found = fit(line_far_from_zero(share, 0))
    assert not found.converged
    told = float(re.search(r"at (\S+) times the noise", found.failures[0]).group(1))
    assert share / 2 < told <= 2 * share  # within a binary digit
    assert "subtract a constant" in found.failures[0]
    assert ("jax_enable_x64" in found.failures[0]) == (jnp.result_type(float) == np.float32)
    assert not any("edges of shadows" in one for one in found.findings)


def test_rounding_of_the_cost_is_not_taken_for_an_increase():
    """The sum of squares is rounded, and the parameters are known to their last digit."""
    found = fit(line_far_from_zero(2e-4, 1), starts=4)
    assert found.converged
    assert abs(float(found.values["slope"]) - 3) < 4 * 0.00122


def test_half_precision_data_are_named():
    x = np.linspace(0, 10, 200)
    y = 1000 + 30 * x + np.random.default_rng(0).normal(0, 0.05, 200)
    line = {"level": Parameter(start=900.0), "slope": Parameter(start=20.0)}

    def told(data):
        found = fit(
            Problem(
                line,
                lambda level, slope, inputs: level + slope * inputs,
                Gaussian(sd=0.05),
                data,
                inputs=x,
            ),
            starts=4,
        )
        return [one for one in (*found.failures, *found.findings) if "float16" in one]

    (words,) = told(y.astype(np.float16))
    assert "rounded to 1 or more, 2" in words  # 20 times the noise
    assert not told(y + 5 * (np.arange(200) % 20 == 0))


def test_two_equal_numbers_of_eleven_are_no_copies():
    """The data have six digits, and two of them are equal by chance."""
    data = np.array([1.54378, 1.54341, 1.55381, 1.54877, 1.55381, 1.56225])
    data = np.concatenate([data, [1.56568, 1.56822, 1.58282, 1.60016, 1.62545]])
    found = fit(
        Problem(
            {"level": Parameter(start=1.0)}, lambda level: level * np.ones(11), Gaussian(0.03), data
        )
    )
    assert not any("copies" in one for one in (*found.failures, *found.findings))
