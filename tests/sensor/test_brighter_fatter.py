"""Tests the brighter-fatter effect against differential equations and series in plain NumPy."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import convolve2d

from jaxvision import scene as s
from jaxvision.effects.sensor import sensor_stage
from jaxvision.effects.stages import Ends
from jaxvision.sensor import (
    area_changes,
    expected_signal,
    flat_covariances,
    gathered,
    pattern_variance,
    raw_image,
    signal_variance,
)
from jaxvision.sensor.brighter_fatter import flat_variance

KERNEL = np.array([[1e-6, 2e-7], [1.5e-7, 4e-8]])
EFFECT = s.BrighterFatter(KERNEL)
RNG = np.random.default_rng(1)
SPOTS = 2e4 * RNG.uniform(size=(6, 5)) ** 2


def neighbours(shape, p):
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        q = (p[0] + step[0], p[1] + step[1])
        if 0 <= q[0] < shape[0] and 0 <= q[1] < shape[1]:
            yield q


def potentials(shape, kernel):
    """Return phi of each pixel by the charge of each, (pixels, pixels), mirrored at the borders."""
    places = list(product(range(shape[0]), range(shape[1])))
    of = np.zeros((len(places), len(places)))
    reach = [range(1 - n, n) for n in kernel.shape]
    for (i, p), offset in product(enumerate(places), product(*reach)):
        q = []
        for x, size in zip(np.add(p, offset), shape, strict=True):
            x = -x - 1 if x < 0 else x
            q.append(2 * size - 1 - x if x >= size else x)
        of[i, places.index(tuple(q))] += kernel[abs(offset[0]), abs(offset[1])]
    return places, of


def currents(light, kernel):
    """Return what each pixel gains by the charge of each per unit of time, (pixels, pixels)."""
    places, phi = potentials(light.shape, kernel)
    gains = np.zeros_like(phi)
    for i, p in enumerate(places):
        for q in neighbours(light.shape, p):
            gains[i] += (light[p] + light[q]) / 2 * (phi[places.index(q)] - phi[i])
    return gains


def moments(light, kernel):
    """Return mean and covariance after the exposure."""
    gains, arriving, n = currents(light, kernel), light.ravel(), light.size

    def rates(time, state):
        mean, covariance = state[:n], state[n:].reshape(n, n)
        got = arriving + gains @ mean
        spread = gains @ covariance + covariance @ gains.T + np.diag(got)
        return np.concatenate([got, spread.ravel()])

    found = solve_ivp(rates, (0, 1), np.zeros(n + n * n), rtol=1e-10, atol=1e-6).y[:, -1]
    return found[:n].reshape(light.shape), found[n:].reshape(n, n)


def test_the_mean_solves_the_differential_equation():
    mean = moments(SPOTS, KERNEL)[0]
    assert np.abs(mean - SPOTS).max() > 30
    errors = {}
    for steps in (8, 64):
        got = gathered(None, jnp.asarray(SPOTS)[..., None], replace(EFFECT, steps=steps))[..., 0]
        errors[steps] = np.abs(got - mean).max()
        assert float(got.sum()) == pytest.approx(SPOTS.sum(), rel=1e-12)
    assert errors[8] < 0.005 * np.abs(mean - SPOTS).max()
    assert errors[64] < errors[8] / 6


def test_flat_covariances_are_equation_20_of_astier():
    """The reference is its first four terms, by convolutions, where the next is below 1e-7."""
    a = np.asarray(area_changes(jnp.asarray(KERNEL)))
    lags = [np.abs(np.arange(-2, 3))] * 2
    whole = a[np.ix_(*lags)]
    assert whole.sum() == pytest.approx(0, abs=1e-20)
    assert a[0, 0] < 0 < a[0, 1]
    mu, terms, power = 3e3, np.zeros((33, 33)), np.pad([[1.0]], 16)
    for factor in (1, 1, 2 / 3, 1 / 3, 2 / 15):
        terms += factor * mu * power
        power = convolve2d(power, whole * mu, mode="same")
    got = flat_covariances(jnp.asarray(a), jnp.asarray(mu))
    np.testing.assert_allclose(got, terms[16:19, 16:19], atol=1e-7 * mu)


@pytest.mark.parametrize("mu", [1.0, 1e5, 4e5])
def test_flat_covariances_equal_the_exponential_in_fourier_space(mu):
    a = np.asarray(area_changes(jnp.asarray(KERNEL)))
    whole = np.zeros((32, 32))
    for i, j in product(range(-2, 3), repeat=2):
        whole[i % 32, j % 32] = a[abs(i), abs(j)]
    spectrum = np.fft.fft2(whole).real
    with np.errstate(invalid="ignore"):
        power = np.where(np.abs(spectrum) < 1e-20, mu, np.expm1(2 * spectrum * mu) / spectrum / 2)
    exact = np.fft.ifft2(power).real[:3, :3]
    got = flat_covariances(jnp.asarray(a), jnp.asarray(mu))
    if mu < 2e5:  # sum |a| mu is below 2
        np.testing.assert_allclose(got, exact, atol=1e-9 * mu)
        assert float(got[0, 0]) < mu * (1 - 1e-9)
    else:
        assert np.isfinite(got).all()


def test_frames_have_the_covariances_of_the_closed_form():
    """In frames of a flat, variance and covariances are within 4.5 standard errors."""
    mu, shape, frames = 6e4, (64, 64), 48
    sensor = s.Sensor(shot_noise=s.GaussianShotNoise(), brighter_fatter=EFFECT)
    keys = jax.random.split(jax.random.key(3), frames)
    light = jnp.full((*shape, 1), mu)
    drawn = np.asarray(jax.jit(jax.vmap(lambda key: raw_image(key, sensor, light)))(keys))[..., 0]
    x = (drawn - mu)[:, 4:-4, 4:-4]
    expected = np.asarray(flat_covariances(area_changes(jnp.asarray(KERNEL)), jnp.asarray(mu)))
    for i, j in product(range(3), repeat=2):
        h, w = x.shape[1:]
        both = x[:, : h - i, : w - j] * x[:, i:, j:]
        error = mu * np.sqrt((2 if i == j == 0 else 1) / both.size)
        tolerance = 4.5 * error + 0.04 * (3.3e-6 * mu) ** 2 / 9 * mu  # for 8 steps
        assert abs(both.mean() - expected[i, j]) < tolerance, (i, j)
    assert mu - x.var() > 20 * mu * np.sqrt(2 / x.size)
    got = signal_variance(sensor, light)
    np.testing.assert_allclose(got, expected[0, 0], rtol=1e-9)


def test_a_pattern_of_sensitivities_is_smoothed():
    rng, mu, prnu = np.random.default_rng(2), 6e4, 0.01
    uneven = mu * (1 + prnu * rng.standard_normal((96, 96, 1)))
    spread = float(np.var(gathered(None, jnp.asarray(uneven), EFFECT)[8:-8, 8:-8]))
    sensor = s.Sensor(prnu=prnu, brighter_fatter=EFFECT)
    got = float(pattern_variance(sensor, jnp.full((4, 4, 1), mu))[1, 1, 0])
    own = float(np.var(uneven[8:-8, 8:-8]))
    assert got / (prnu * mu) ** 2 == pytest.approx(spread / own, rel=0.01)
    assert got < 0.9 * (prnu * mu) ** 2


@pytest.mark.parametrize("scale", [0.05, 1.0, 4.0])
def test_the_bound_holds_over_the_true_moments(scale):
    light = scale * SPOTS
    mean, covariance = moments(light, KERNEL)
    rms = np.sqrt(np.diag(covariance).reshape(light.shape) + 9.0)
    apart = np.hypot(mean - light, rms - np.sqrt(light + 9.0)).max()
    sensor = s.Sensor(shot_noise=s.PoissonShotNoise(), read_noise=3.0, brighter_fatter=EFFECT)
    rows, _ = sensor_stage(Ends(sensor, sensor), np.array([light.max()]), shape=light.shape)
    bound = {row.effect.name: row.effect.bound for row in rows}["sensor.brighter_fatter"]
    assert apart <= bound <= 20 * apart


def test_the_effect_is_limited_by_the_full_well():
    """Charge beyond the full well has no further effect."""
    light = np.full((5, 5, 1), 1000.0)
    light[2, 2] = 1e8
    sensor = s.Sensor(brighter_fatter=EFFECT, full_well=1e4)
    got = np.asarray(expected_signal(sensor, jnp.asarray(light)))
    assert np.isfinite(got).all()
    assert got.min() > 900


def test_impossible_kernels_are_refused():
    with pytest.raises(ValueError, match="at least 2, got 1"):
        s.BrighterFatter(KERNEL, steps=1)
    with pytest.raises(ValueError, match="needs an image"):
        gathered(None, jnp.ones(3), EFFECT)
    with pytest.raises(ValueError, match="random key, got None"):
        gathered(None, jnp.ones((2, 2, 1)), EFFECT, shot_noise=s.GaussianShotNoise())
    with pytest.raises(ValueError, match="at most 16 pixels"):
        flat_covariances(jnp.zeros((17, 2)), jnp.asarray(1.0))


@pytest.mark.slow
def test_derivatives_equal_the_series_also_without_an_effect():
    """d C_ij / d a_ij is mu^2 at a = 0, where a fit starts."""
    mu = jnp.asarray(1e4)
    slopes = jax.jacfwd(lambda a: flat_covariances(a, mu))(jnp.zeros((2, 2)))
    np.testing.assert_allclose(slopes[0, 0, 0, 0], 1e8, rtol=1e-12)
    np.testing.assert_allclose(slopes[0, 1, 0, 1], 1e8, rtol=1e-12)
    a = area_changes(jnp.asarray(KERNEL))
    one = jax.jacfwd(lambda a: flat_covariances(a, mu)[0, 0])(a)
    step = 1e-10
    both = [flat_covariances(a.at[0, 1].add(sign * step), mu)[0, 0] for sign in (1, -1)]
    np.testing.assert_allclose(one[0, 1], (both[0] - both[1]) / (2 * step), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [1e4, 1e7])
def test_derivatives_by_the_kernel_hold_where_the_series_is_clamped(mu):
    """The reference takes central differences with steps of a thousandth of each number."""
    effect = s.BrighterFatter([[8e-7, 2e-7], [3e-7, 5e-8]])

    def variance(kernel):
        return flat_variance(s.BrighterFatter(kernel), jnp.asarray(mu))

    slope = jax.grad(variance)(effect.kernel)
    for at in np.ndindex(2, 2):
        step = jnp.zeros((2, 2)).at[at].set(1e-3 * effect.kernel[at])
        ends = [float(variance(effect.kernel + sign * step)) for sign in (1, -1)]
        wanted = (ends[0] - ends[1]) / (2 * float(step[at]))
        assert float(slope[at]) == pytest.approx(wanted, rel=1e-4)
