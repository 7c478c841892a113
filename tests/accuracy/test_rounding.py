"""Tests `digits`, which estimates how many digits rounding leaves, against errors of float32 in
higher precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from measure import drawn, parts_of
from mpmath import mp
from registry import every_entry

from jaxvision.accuracy import digits
from jaxvision.errors import InputError

mp.dps = 40
X = np.float32(0.0123)
# name: a form in float32, the same in mpmath, and the operation that loses more than one digit
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


@pytest.mark.sweep
@pytest.mark.parametrize("name", FORMS)
def test_digits_are_those_of_float32_against_many(name):
    """The digits agree within one with the float32 error at 20 nearby numbers."""
    form, exact, operation = FORMS[name]
    near = X * np.linspace(1, 1.01, 20, dtype=np.float32)
    true = np.array([float(exact(mp.mpf(float(x)))) for x in near])
    error = np.sqrt(np.mean((np.asarray(form(near), float) / true - 1) ** 2))
    found = digits(form, near, runs=8)
    left = -np.log10(np.sqrt(np.mean(10.0 ** (-2 * np.asarray(found.digits)))))
    assert left == pytest.approx(min(-np.log10(max(error, 1e-20)), 7.22), abs=1)
    assert found.operation.partition(" ")[0] == operation


def test_a_compensated_sum_loses_no_digits():
    """Exact operations are not perturbed, so Knuth's two-sum still recovers its rounding error."""

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
    assert found.fewest == pytest.approx(7.2, abs=0.4)
    assert "of 7.2 digits are left." in str(found)
    with pytest.raises(InputError, match="at least 2 runs"):
        digits(both, np.ones(3), runs=1)
    for narrow in (jnp.float16, jnp.bfloat16):
        with pytest.raises(InputError, match=r"convert_element_type .* rounds to b?float16"):
            digits(jax.jit(lambda x, narrow=narrow: x.astype(narrow).astype(jnp.float32)), X)


@pytest.mark.slow
def test_each_turn_of_a_loop_is_rounded():
    """The digits of a running sum of 1000 numbers agree with its errors against float64 over 20
    draws."""
    draws = np.random.default_rng(0).uniform(1, 2, (20, 1000)).astype(np.float32)

    def running(x):
        return jax.lax.scan(lambda sum_, one: (sum_ + one, None), jnp.zeros_like(x[0]), x)[0]

    errors = [float(running(jnp.asarray(x))) / x.sum(dtype=float) - 1 for x in draws]
    found = digits(running, draws[0])
    assert found.fewest == pytest.approx(-np.log10(np.sqrt(np.mean(np.square(errors)))), abs=0.5)
    assert found.fewest < 6.7

    def newton(x):
        done = jax.lax.while_loop(
            lambda c: c[1] < 20, lambda c: ((c[0] + x / c[0]) / 2, c[1] + 1), (x, 0)
        )[0]
        return jax.lax.cond(x > 1, lambda y: y - jnp.float32(1.4142), lambda y: y, done)

    assert digits(newton, np.float32(2.0)).fewest == pytest.approx(2.8, abs=0.5)


@pytest.mark.slow
def test_the_error_of_an_inaccurate_operation_counts_as_lost_digits():
    from scipy.special import digamma

    x = np.float32(1.4616)  # near its root
    wrong = float(jax.scipy.special.digamma(x)) / digamma(np.float64(x)) - 1
    found = digits(jax.scipy.special.digamma, x)
    assert found.fewest == pytest.approx(-np.log10(abs(wrong)), abs=0.3)
    assert found.operation.startswith("digamma")
    ones = jnp.ones(5, jnp.float32)
    hilbert = (1 / (np.arange(5)[:, None] + np.arange(5) + 1)).astype(np.float32)
    ours = np.asarray(jnp.linalg.solve(hilbert, ones), float)
    true = np.linalg.solve(hilbert.astype(float), np.ones(5))
    left = digits(lambda a: jnp.linalg.solve(a, ones), hilbert)
    assert left.fewest == pytest.approx(-np.log10(np.abs(ours / true - 1).max()), abs=1.2)


@pytest.mark.slow
def test_results_that_are_not_finite_or_zero_are_named():
    x = np.float32([1.0, -1.0])
    assert str(digits(jnp.log, -x[:1])) == "No result is finite at these arguments."
    assert str(digits(jnp.log, x)).startswith("1 of 2 results are not finite; of the others 7.")
    assert digits(lambda x: x - x, x).fewest > 7
    assert digits(lambda x: jnp.fft.fft(x)[1], x).fewest > 6


def of_a_function(entry):
    """Return the median digits of an entry's results at 64 points, and the digits from |float32 -
    float64|."""
    narrow = drawn(entry, 64, np.dtype(np.float32))
    wide = tuple(column.astype(np.float64) for column in narrow)
    each = jax.vmap(entry.call)
    got, true = (parts_of(entry, each(*map(jnp.asarray, x))) for x in (narrow, wide))
    with np.errstate(all="ignore"):
        errors = np.abs(np.stack(got) / np.stack(true) - 1).ravel()
    told = np.stack(parts_of(entry, digits(each, *narrow, runs=8).digits)).ravel()
    known = np.isfinite(errors) & np.isfinite(told)
    usual = np.median(errors[known]) / 0.674  # median to standard deviation
    return np.median(told[known]), min(-np.log10(max(usual, 1e-20)), 7.22)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("lossy", "fine", "at"),
    [
        (lambda x: jnp.exp(-x), lambda x: 1 + jnp.exp(-x), 200.0),  # exp(-200) is 1.4e-87
        (lambda x: jnp.log(jnp.exp(-x * x)), lambda x: -x * x, 20.0),
        (lambda x: jnp.sqrt(x * x + x * x), lambda x: jnp.sqrt(2.0) * x, 1e-25),
        (lambda x: x * x * 1e30 * 1e30, lambda x: (x * 1e30) ** 2, 1e-30),
    ],
)
def test_an_underflowed_result_has_no_digits(lossy, fine, at):
    """A result that underflows to 0 in float32 (at 1e-38) but not in float64 (at 1e-308) has lost
    all digits. Added to a number of ordinary size, it loses nothing."""
    x = np.float32(at)
    with jax.enable_x64(True):  # each operation by itself: XLA would simplify log(exp(x))
        assert float(lossy(jnp.asarray(x))) in (0, -np.inf)
        assert float(lossy(jnp.asarray(at))) not in (0, -np.inf)
    lost = digits(lossy, x)
    assert not lost.fewest >= 1  # NaN if the result is not finite
    assert digits(fine, x).fewest > 5.5
    assert lost.operation.split()[:1] != []


@pytest.mark.sweep
@pytest.mark.parametrize("x", [1e-3, 1e-5])
def test_a_small_number_that_is_absorbed_is_lost(x):
    """1e8 + x is 1e8 in float32, and 1 - cos(x) is 0 for x up to 1e-4, so no digit of x remains."""
    assert digits(lambda x: (x + 1e8) - 1e8, np.float32(x)).fewest < 0.5
    assert digits(lambda x: 1 - jnp.cos(x), np.float32(x)).fewest < 2
    kept = digits(lambda x: x + 1e8, np.float32(x))
    assert kept.fewest > 6.5
    assert kept.operation == ""


@pytest.mark.slow
def test_digits_of_many_functions_are_those_of_float32_against_float64():
    """The digits agree within half a digit for every third function of the table of errors (at
    least 40)."""
    quick = [e for e in every_entry() if "float32" in e.precisions and not e.of_digits]
    found = {entry.title: of_a_function(entry) for entry in quick[::3]}
    assert len(found) >= 40
    wrong = {name: pair for name, pair in found.items() if not abs(pair[0] - pair[1]) < 0.5}
    assert not wrong
