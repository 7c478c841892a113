"""Error against time on a quadrature whose error is known in closed form."""

import time

import numpy as np
import pytest

from jaxvision.accuracy import cheapest, error_against_time, relative_rms
from jaxvision.errors import InputError


def midpoint(n):
    x = (np.arange(n) + 0.5) / n
    return np.mean(x**2)


def trials():
    calls = {n: lambda n=n: midpoint(n) for n in (1, 10, 100)}
    return error_against_time(calls, 1 / 3, repeats=3)


def test_errors_are_those_of_the_midpoint_rule():
    """The midpoint rule on x^2 over [0, 1] errs by exactly -1 / (12 n^2)."""
    for trial in trials():
        np.testing.assert_allclose(trial.error, 3 / (12 * trial.setting**2), rtol=1e-9)


def test_time_is_that_of_the_call():
    (slow,) = error_against_time({"sleep": lambda: time.sleep(0.02) or 1.0}, 1.0, repeats=3)
    assert 0.02 <= slow.seconds < 1
    assert slow.first_seconds >= 0.02
    assert slow.error == 0


def test_the_cheapest_setting_that_suffices():
    measured = trials()
    assert cheapest(measured, tolerance=1e-4).setting == 100
    assert cheapest(measured, tolerance=1.0).setting in (1, 10, 100)
    with pytest.raises(InputError, match=r"No setting reaches 1e-09; the most accurate, 100,"):
        cheapest(measured, tolerance=1e-9)


def test_relative_rms_and_empty_sweeps():
    np.testing.assert_allclose(relative_rms([3.0, 4.0], [0.0, 5.0]), np.sqrt(10 / 25))
    with pytest.raises(InputError, match="at least one call"):
        error_against_time({}, 1.0)
