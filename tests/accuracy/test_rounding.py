"""The digits that rounding leaves, against the errors of float32 in higher precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp

from jaxvision.accuracy import digits
from jaxvision.errors import InputError

mp.dps = 40
X = np.float32(0.0123)
# name: a form in float32, the same in mpmath, and whether it loses more than one digit
FORMS = {
    "one less a cosine": (lambda x: 1 - jnp.cos(x), lambda x: 1 - mp.cos(x), "sub"),
    "by the half angle": (lambda x: 2 * jnp.sin(x / 2) ** 2, lambda x: 1 - mp.cos(x), ""),
    "a lightness": (
        lambda y: 116 * (y / 128 / (3 * (6 / 29) ** 2) + 4 / 29) - 16,
        lambda y: 116 * y / 128 / (3 * (mp.mpf(6) / 29) ** 2),
        "sub",
    ),
    "the lightness": (
        lambda y: y * (116 / (3 * (6 / 29) ** 2)),
        lambda y: 116 * y / (3 * (mp.mpf(6) / 29) ** 2),
        "",
    ),
    "a root": (lambda x: jnp.sqrt(1 + x * x) - 1, lambda x: mp.sqrt(1 + x * x) - 1, "sub"),
    "its other form": (
        lambda x: x * x / (jnp.sqrt(1 + x * x) + 1),
        lambda x: mp.sqrt(1 + x * x) - 1,
        "",
    ),
    "an exponential": (lambda x: jnp.exp(x) - 1, lambda x: mp.expm1(x), "sub"),
    "expm1": (jnp.expm1, lambda x: mp.expm1(x), ""),
    "an angle by its cosine": (
        lambda x: jnp.arccos(1 / jnp.sqrt(1 + jnp.tan(x) ** 2)),
        lambda x: x,
        "acos",
    ),
    "its arc tangent": (lambda x: jnp.arctan2(jnp.sin(x), jnp.cos(x)), lambda x: x, ""),
}


@pytest.mark.parametrize("name", FORMS)
def test_digits_are_those_of_float32_against_many(name):
    """Within a digit of the error of float32 at 20 near numbers; the operation is that which
    cancels, or is flat."""
    form, exact, operation = FORMS[name]
    near = X * np.linspace(1, 1.01, 20, dtype=np.float32)
    true = np.array([float(exact(mp.mpf(float(x)))) for x in near])
    error = np.sqrt(np.mean((np.asarray(form(near), float) / true - 1) ** 2))
    found = digits(form, near, runs=8)
    left = -np.log10(np.sqrt(np.mean(10.0 ** (-2 * np.asarray(found.digits)))))
    assert left == pytest.approx(min(-np.log10(max(error, 1e-20)), 7.22), abs=1)
    assert found.operation.partition(" ")[0] == operation


def test_a_compensated_sum_keeps_its_digits():
    """An exact operation is not rounded at random, so that Knuth's two-sum finds its rest."""

    def total(a, b, c):
        s = a + b
        back = s - a
        rest = (a - (s - back)) + (b - back)
        return (s + c) + rest

    big = np.float32(1e4), np.float32(0.123456), np.float32(-1e4)
    assert digits(lambda a, b, c: (a + b) + c, *big).fewest < 4
    assert digits(total, *big).fewest > 6


def test_loops_branches_trees_and_refusals():
    def both(x):
        summed = jax.lax.fori_loop(0, 3, lambda _, y: y * x, x)
        return {"power": summed, "count": jnp.sum(x > 0), "branch": jnp.where(x > 0, x, -x)}

    found = digits(jax.jit(both), np.ones(3) / 3)
    assert set(found.digits) == {"power", "count", "branch"}
    assert found.fewest == pytest.approx(7.2, abs=0.1)
    assert "7.2 of 7.2 digits are left." in str(found)
    with pytest.raises(InputError, match="at least 2 runs"):
        digits(both, np.ones(3), runs=1)
