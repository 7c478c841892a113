"""Error against time on a quadrature whose error is known in closed form, by a clock of its own."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxvision import accuracy
from jaxvision.accuracy import Trial, cheapest, error_against_time, relative_rms
from jaxvision.errors import InputError


def midpoint(n):
    x = (np.arange(n) + 0.5) / n
    return np.mean(x**2)


@pytest.fixture
def clock(monkeypatch):
    """The seconds that `accuracy` reads; calls advance them."""
    now = SimpleNamespace(seconds=100.0)
    monkeypatch.setattr(accuracy, "time", SimpleNamespace(perf_counter=lambda: now.seconds))
    return now


def test_errors_are_those_of_the_midpoint_rule():
    """The midpoint rule on x^2 over [0, 1] errs by exactly -1 / (12 n^2)."""
    calls = {n: lambda n=n: midpoint(n) for n in (1, 10, 100)}
    for trial in error_against_time(calls, 1 / 3, repeats=1):
        np.testing.assert_allclose(trial.error, 3 / (12 * trial.setting**2), rtol=1e-9)


def test_times_are_those_of_the_first_call_and_the_median_warm_one(clock):
    """And the settings take turns, so that a machine that slows down favours none."""
    turns = []

    def call(setting, costs):
        turns.append(setting)
        clock.seconds += next(costs)
        return 1.0

    costs = {"a": iter([8.0, 3.0, 1.0, 5.0]), "b": iter([4.0, 0.5, 0.25, 64.0])}
    calls = {setting: lambda s=setting: call(s, costs[s]) for setting in costs}
    assert error_against_time(calls, 1.0, repeats=3) == [
        Trial("a", error=0.0, seconds=3.0, first_seconds=8.0),
        Trial("b", error=0.0, seconds=0.5, first_seconds=4.0),
    ]
    assert turns == ["a", "b"] * 4


def test_the_cheapest_setting_that_suffices():
    trials = [Trial(1, 0.25, 1.0, 9.0), Trial(10, 2e-3, 3.0, 9.0), Trial(100, 2e-5, 2.0, 9.0)]
    assert cheapest(trials, tolerance=1e-4).setting == 100
    assert cheapest(trials, tolerance=2e-3).setting == 100
    assert cheapest(trials, tolerance=0.25).setting == 1
    with pytest.raises(InputError, match=r"No setting reaches 1e-09; the most accurate, 100,"):
        cheapest(trials, tolerance=1e-9)


def test_relative_rms_and_empty_sweeps():
    np.testing.assert_allclose(relative_rms([3.0, 4.0], [0.0, 5.0]), np.sqrt(10 / 25))
    with pytest.raises(InputError, match="at least one call"):
        error_against_time({}, 1.0)
