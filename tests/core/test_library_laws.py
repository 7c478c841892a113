"""Tests random draws and special functions of JAX and SciPy against mpmath or each other, for the
arguments where `docs/concepts/random_laws.md` calls them correct."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
import scipy.special as scipy_special
from jax.scipy import special
from scipy import stats

pytestmark = pytest.mark.slow
KEY = jax.random.key(1)
ROWS = {  # function, oracle, arguments, relative error in float32 and in float64
    "ndtr": (special.ndtr, scipy_special.ndtr, np.linspace(-12, 8, 200), 2e-5, 1e-14),
    "ndtri": (special.ndtri, scipy_special.ndtri, np.geomspace(1e-37, 0.4, 200), 1e-6, 1e-14),
    "erfc": (jax.lax.erfc, scipy_special.erfc, np.linspace(-2, 8.8, 200), 5e-6, 2e-15),
    "log_ndtr": (
        special.log_ndtr,
        np.vectorize(lambda z: float(mp.log(mp.ncdf(z)))),
        np.linspace(-30, 0, 100),
        1e-5,
        1e-9,
    ),
    "gammaln": (special.gammaln, scipy_special.gammaln, np.geomspace(3, 1e8, 200), 4e-6, 1e-14),
    "betainc": (
        lambda x: special.betainc(jnp.full_like(x, 10), jnp.full_like(x, 0.5), x),
        lambda x: scipy_special.betainc(10, 0.5, x),
        np.linspace(0.25, 0.99, 100),
        1e-4,
        1e-12,
    ),
}


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_special_functions_of_jax(name, dtype):
    function, oracle, x, single, double = ROWS[name]
    x = x.astype(dtype)
    with mp.workdps(30):
        truth = oracle(x.astype(np.float64))
    got = np.asarray(jax.jit(function)(jnp.asarray(x)), np.float64)
    assert np.abs(got / truth - 1).max() < (single if dtype == np.float32 else double)


@pytest.mark.parametrize(
    ("dtype", "a", "bound"),
    [(np.float32, 100, 1e-4), (np.float64, 1e5, 1e-9), (np.float64, 1e4, 1e-10)],
)
def test_incomplete_gamma_function_up_to_where_we_use_it(dtype, a, bound):
    x = (a + np.linspace(-5, 5, 41) * np.sqrt(a)).astype(dtype)
    lower = special.gammainc(jnp.full(41, a, dtype), jnp.asarray(x))
    upper = special.gammaincc(jnp.full(41, a, dtype), jnp.asarray(x))
    np.testing.assert_allclose(lower, scipy_special.gammainc(a, x.astype(float)), rtol=bound)
    np.testing.assert_allclose(upper, scipy_special.gammaincc(a, x.astype(float)), rtol=bound)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_random_laws_of_jax(dtype):
    """300,000 draws pass the Kolmogorov-Smirnov test, and their extreme values are those that a
    draw can have."""
    size = (300_000,)
    z = np.asarray(jax.random.normal(KEY, size, dtype))
    assert stats.kstest(z, "norm").pvalue > 1e-3
    if dtype == jnp.float32:
        assert np.abs(z).max() < 5.5  # its uniform numbers end at 1 - 2^-24
    for dof in (0.5, 1.0, 4.0, 1e4):
        t = np.asarray(jax.random.t(KEY, jnp.asarray(dof, dtype), size, dtype), float)
        assert stats.kstest(t, "t", args=(dof,)).pvalue > 1e-3
    for dof in (2, 3):
        x = np.asarray(jax.random.chisquare(KEY, dof, shape=size, dtype=dtype), float)
        assert stats.kstest(x, "chi2", args=(dof,)).pvalue > 1e-3
    u = np.asarray(jax.random.uniform(KEY, (3_000_000,), dtype))
    assert u.min() >= 0
    assert u.max() < 1


def test_quantiles_of_scipy():
    """Each inverse is checked against its own distribution function."""
    p = np.array([1e-6, 0.001, 0.025, 0.5, 0.975])
    for dof in (0.5, 1.0, 10.0, 1e4, 1e7):
        np.testing.assert_allclose(
            scipy_special.chdtrc(dof, scipy_special.chdtri(dof, p)), p, rtol=1e-11
        )
        np.testing.assert_allclose(
            scipy_special.stdtr(dof, scipy_special.stdtrit(dof, p)), p, rtol=1e-11
        )
    for shape in (0.5, 1.0, 100.0, 1e5):
        found = scipy_special.gammainc(shape, scipy_special.gammaincinv(shape, p))
        np.testing.assert_allclose(found, p, rtol=1e-11)
    for degrees in ((1, 1), (3, 20), (1e3, 1e3)):
        found = scipy_special.fdtr(*degrees, scipy_special.fdtri(*degrees, p))
        np.testing.assert_allclose(found, p, rtol=1e-11)
