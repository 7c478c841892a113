"""Tests likelihoods against SciPy's densities and the distributions of their own draws."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy import stats

from fitting import (
    Censored,
    Clustered,
    Gaussian,
    Parameter,
    Problem,
    SensorCounts,
    SensorNoise,
    StudentT,
    fit,
)
from fitting.checks.counts import GAINS, efficiency
from fitting.inference.likelihoods import Likelihood, substitute_values
from fitting.inference.misfit import judge
from fitting.inference.problem import likelihood_at
from fitting.inference.tails import log_ndtr, log_student
from jaxvision import BrighterFatter, Compression, PoissonShotNoise, Sensor, Taps
from jaxvision.errors import InputError
from jaxvision.sensor import even_mixing

PREDICTION = jnp.array([0.0, 1.0, 5.0, -2.0])
DATA = jnp.array([0.3, -4.0, 5.0, -1.0])
SD = 0.7
NOISY = Gaussian(SD)
RNG = np.random.default_rng(4)


def test_gaussian_against_scipy():
    ours = Gaussian(SD).log_density(PREDICTION, DATA)
    np.testing.assert_allclose(ours, stats.norm.logpdf(DATA, PREDICTION, SD), rtol=1e-12)


@pytest.mark.parametrize("dof", [1.0, 4.0, 30.0])
def test_student_t_against_scipy(dof):
    ours = StudentT(SD, dof).log_density(PREDICTION, DATA)
    reference = stats.t(dof, np.asarray(PREDICTION), SD)
    np.testing.assert_allclose(ours, reference.logpdf(DATA), rtol=1e-10)
    residuals = StudentT(SD, dof).residuals(PREDICTION, DATA, np.zeros(4))
    np.testing.assert_allclose(residuals, stats.norm.ppf(reference.cdf(DATA)), atol=1e-9)


def test_student_t_with_ends_against_scipy():
    signal = stats.t(3.0, np.asarray(PREDICTION), SD)
    data = jnp.array([0.3, -1.0, 4.0, -1.0])
    expected = np.where(data >= 4.0, signal.logsf(4.0), signal.logpdf(data))
    expected = np.where(data <= -1.0, signal.logcdf(-1.0), expected)
    likelihood = StudentT(SD, 3.0, low=-1.0, high=4.0)
    density = jax.jit(lambda *given: likelihood.log_density(*given))
    np.testing.assert_allclose(density(PREDICTION, data), expected, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("dof", [0.5, 1.0, 4.0, 30.0, 1000.0, 20_000.0])
def test_log_of_student_and_its_slope_in_both_tails(dof):
    """The reference has 120 digits, in both tails where probabilities underflow, and at the
    median."""
    farthest = -1e200 if dof < 1e4 else -1e8  # the logarithm has an error of eps times itself
    places = np.array([farthest, -1e8, -40.0, -3.0, -0.5, 0.0, 0.7, 6.0, 1e3])
    with mp.workdps(120):
        a, half = mp.mpf(dof) / 2, mp.mpf(1) / 2

        def tail(z):
            x = dof / (dof + mp.mpf(z) ** 2)
            one = mp.betainc(a, half, 0, x, regularized=True) / 2
            return one if z <= 0 else 1 - one

        norm = mp.gamma(a + half) / mp.gamma(a) / mp.sqrt(dof * mp.pi)
        truth = [mp.log(tail(z)) for z in places]
        slopes = [norm * (1 + mp.mpf(z) ** 2 / dof) ** (-a - half) / tail(z) for z in places]
    found = jax.vmap(jax.value_and_grad(log_student), (0, None))(jnp.asarray(places), dof)
    np.testing.assert_allclose(found[0], np.array(truth, float), rtol=2e-12)
    np.testing.assert_allclose(found[1], np.array(slopes, float), rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 2e-6)])
def test_student_with_infinite_degrees_of_freedom_is_normal(dtype, tolerance):
    """In float64 this holds to 40 deviations, where probabilities underflow."""
    z = np.array([-40, -37.5, -20, -8, -3, -2.01, -2, -1.99, -0.5, 0, 0.5, 2, 3], dtype)
    found = jax.jit(log_student)(z, dtype(1e17))
    np.testing.assert_allclose(found, stats.norm.logcdf(z.astype(float)), rtol=tolerance)
    slope = jax.jit(jax.vmap(jax.grad(log_student), (0, None)))(z, dtype(1e17))
    assert np.isfinite(slope).all()


def test_censored_against_scipy():
    signal = stats.norm(np.asarray(PREDICTION), SD)
    data = jnp.array([0.3, -1.0, 4.0, -1.0])
    expected = np.where(data >= 4.0, signal.logsf(4.0), signal.logpdf(data))
    expected = np.where(data <= -1.0, signal.logcdf(-1.0), expected)
    likelihood = Censored(SD, low=-1.0, high=4.0)
    density = jax.jit(lambda *given: likelihood.log_density(*given))
    np.testing.assert_allclose(density(PREDICTION, data), expected, rtol=1e-10)
    # far beyond a limit the probability and its gradient are still finite
    far = np.full(4, 400.0)
    value, slope = jax.jit(
        jax.value_and_grad(lambda p: Censored(SD, high=4.0).log_density(p, far).sum())
    )(-far)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()


ROBUST = StudentT(SD, 3.0, low=-0.5, high=0.4)
LIKELIHOODS = [Gaussian(SD), StudentT(SD, 3.0), Censored(SD, low=-0.5, high=0.4), ROBUST]


@pytest.mark.sweep
@pytest.mark.parametrize(
    "likelihood", LIKELIHOODS, ids=("Gaussian", "StudentT", "Censored", "ends")
)
def test_residuals_of_its_own_draws_are_standard_normal(likelihood):
    assert isinstance(likelihood, Likelihood)
    prediction = jnp.zeros(4000)
    data = likelihood.draw(jax.random.key(1), prediction)
    residuals = likelihood.residuals(prediction, data, RNG.uniform(size=4000))
    assert stats.kstest(np.asarray(residuals), "norm").pvalue > 1e-3
    assert not judge(np.asarray(residuals), 0.0).faults


def test_a_name_in_place_of_a_number():
    named = substitute_values(StudentT("noise", 4.0), {"noise": jnp.asarray(SD)}.get)
    np.testing.assert_allclose(
        named.log_density(PREDICTION, DATA), StudentT(SD, 4.0).log_density(PREDICTION, DATA)
    )


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        (lambda: Gaussian(-0.1), "Gaussian: sd must be positive and finite, got -0.1"),
        (lambda: Gaussian([0.1, np.inf]), "positive and finite, got inf"),
        (lambda: StudentT(0.0), "StudentT: scale must be positive"),
        (lambda: Censored(np.nan), "Censored: sd must be positive and finite, got nan"),
        (lambda: Gaussian(None), "sd is a number, an array or the name of a parameter, got None"),
        (lambda: Gaussian(""), "got ''"),
        (lambda: Gaussian([1, "a"]), "got .1, 'a'."),
        (lambda: StudentT(Censored(0.1)), r"scale is a number.*StudentT\(scale, low=..., high="),
        (lambda: Censored(StudentT(0.1)), r"sd is a number.*StudentT\(scale, low=..., high="),
        (lambda: Censored(0.1, low=3, high=2), "Censored: low = 3 must lie below high = 2"),
        (lambda: StudentT(0.1, low=[0.0, 3.0], high=3), "StudentT: low = 3 must lie below high"),
        (lambda: StudentT(0.1, low=np.zeros(2), high=np.ones(3)), r"the shapes \(2,\) and \(3,\)"),
        (lambda: StudentT(0.1, high=np.nan), "high is NaN"),
        (lambda: Clustered(0.1, [0, 1]), "0.1 is no likelihood"),
        (lambda: Clustered(NOISY, [0.5, 1]), "labels are whole numbers"),
        (lambda: Clustered(NOISY, ["a", "b"]), r"numpy\.unique"),
    ],
)
def test_an_invalid_likelihood_is_refused(wrong, expected):
    with pytest.raises(InputError, match=expected):
        wrong()


def test_one_sided_limits_and_names_are_kept():
    assert Censored("s", low="black", high=4).low == "black"
    assert StudentT("s", low=-np.inf).high is None


def test_chi_square_and_neighbours():
    noise = RNG.standard_normal((30, 40))
    good = judge(noise, 3.0)
    np.testing.assert_allclose(good.p, stats.chi2.sf((noise**2).sum(), 1197))
    assert not good.faults
    assert any("chi-square" in sentence for sentence in judge(1.2 * noise, 3.0).faults)
    assert any("less than stated" in sentence for sentence in judge(0.8 * noise, 3.0).remarks)
    smooth = (noise + np.roll(noise, 1, axis=1)) / np.sqrt(2)
    assert any("along axis 1" in sentence for sentence in judge(smooth, 3.0).faults)
    holes = np.where(RNG.uniform(size=noise.shape) < 0.3, np.nan, noise)
    assert judge(holes, 0.0).dof == np.isfinite(holes).sum()


LINE = np.linspace(-1, 1, 200)


def line(slope, inputs):
    return slope * inputs


def fitted(likelihood, data):
    return fit(
        Problem({"slope": Parameter(lower=-20, upper=20)}, line, likelihood, data, inputs=LINE),
        starts=4,
    )


@pytest.mark.slow
def test_outliers_of_saturated_data():
    """Neither suffices alone: outliers bias a censored Gaussian, and saturation a robust line."""
    data = 3 * LINE + 0.3 * np.random.default_rng(0).standard_t(4, 200)
    data[::20] -= 5
    data = np.minimum(data, 1.0)
    both = fitted(StudentT(0.3, 4.0, high=1.0), data)
    assert abs(both.values["slope"] - 3) < 0.08
    for likelihood in (StudentT(0.3, 4.0), Censored(0.3, high=1.0)):
        assert abs(fitted(likelihood, data).values["slope"] - 3) > 0.08
    with pytest.raises(InputError, match="dof must be a number where data have ends, got the name"):
        StudentT(0.1, "dof", high=1.0)


@pytest.mark.slow
def test_saturated_data_bias_a_gaussian_and_not_a_censored_fit():
    data = np.minimum(3 * LINE + 0.1 * RNG.standard_normal(200), 2.0)
    censored = fitted(Censored(0.1, high=2.0), data)
    assert censored.converged
    assert abs(censored.values["slope"] - 3) < 4 * censored.estimates[0].standard_error
    assert abs(fitted(Gaussian(0.1), data).values["slope"] - 3) > 0.1


def test_chi_square_without_a_degree_of_freedom_has_an_exact_quantile():
    """A bound stops two parameters fitted to two data."""
    found = judge(np.array([25.0, 1.3]), 2 - 3e-4)
    assert found.dof < 1
    assert found.p < 1e-100
    assert "chi-square is 626.7 with less than one degree of freedom left" in found.faults[0]
    assert "10.83 is exceeded by chance in one of 1000 cases" in found.faults[0]
    good = judge(np.array([0.02, 0.01]), 2 - 3e-4)
    assert not good.faults
    assert "so the fit cannot test the model" in good.remarks[0]
    bad = judge(np.full(3, 4.0), 1.0)
    assert f"{stats.chi2.isf(1e-3, 2) / 2:.4g} is exceeded" in bad.faults[0]


def sensor(**options):
    return Sensor(shot_noise=PoissonShotNoise(), **options)


def test_sensor_noise_has_the_sensors_mean_and_variance():
    """By EMVA 1288 the mean is K eta p + offset and the variance K^2 (eta p + sigma^2) + 1/12,
    censored at the ends."""
    light, code = (
        np.array([[200.0], [2000.0], [1e5], [0.0]]),
        np.array([[70.0], [350.0], [1023.0], [0.0]]),
    )
    likelihood = SensorNoise(
        sensor(quantum_efficiency=0.5, read_noise=3.0, gain=0.3, offset=2.0, bits=10)
    )
    electrons = 0.5 * light
    theirs = stats.norm(0.3 * electrons + 2, np.sqrt(0.09 * (electrons + 9) + 1 / 12))
    expected = theirs.logpdf(code)
    expected[2], expected[3] = theirs.logsf(1022.5)[2], theirs.logcdf(0.5)[3]
    ours = likelihood.log_density(jnp.asarray(light), jnp.asarray(code))
    np.testing.assert_allclose(ours, expected, rtol=1e-9)


def test_a_search_with_a_sensor_starts_from_the_variance_of_the_data():
    """The light is 4 for each datum and electron, and the variance K (d - o) + (K read noise)^2 +
    1/12."""
    known = Sensor(
        shot_noise=PoissonShotNoise(),
        quantum_efficiency=0.25,
        read_noise=3.0,
        gain=0.5,
        offset=10.0,
        bits=8,
    )
    data = jnp.array([[60.0], [110.0], [255.0], [255.0], [0.0]])
    light = jnp.array([[500.0], [200.0], [900.0], [3000.0], [0.0]])
    mean = 10 + 0.5 * 0.25 * light
    variance = 0.5 * jnp.maximum(data - 10, 0) + 1.5**2 + 1 / 12
    expected = (data - mean) / jnp.sqrt(variance)
    expected = expected.at[3].set(0)  # clipped, and predicted beyond
    found = SensorNoise(known).surrogate.residuals(light, data, np.zeros(()))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert SensorNoise("camera.sensor").surrogate is None


def test_noise_sources_of_a_sensor_follow_the_standard():
    """By EMVA 1288, in DN^2: K^2 eta p for photons, K^2 sigma^2 for the read noise, 1/12 for
    rounding."""
    light = np.array([[200.0], [2000.0]])
    options = {"quantum_efficiency": 0.5, "read_noise": 3.0, "gain": 0.3, "offset": 2.0}
    sources = SensorNoise(sensor(**options, bits=10)).noise_sources(jnp.asarray(light))
    np.testing.assert_allclose(sources["photons"], 0.09 * 0.5 * light, rtol=1e-9)
    np.testing.assert_allclose(sources["read noise"], 0.09 * 9)
    np.testing.assert_allclose(sources["rounding"], 1 / 12)
    unrounded = SensorNoise(sensor(**options)).noise_sources(jnp.asarray(light))
    np.testing.assert_allclose(unrounded["rounding"], 0)


def test_draws_of_a_coarse_sensor_are_rounded_once():
    """Averaged over all positions between two codes, the variance is K^2 sigma^2 + 1/12."""
    likelihood = SensorNoise(Sensor(read_noise=1.0, gain=0.5, bits=10))
    light = jnp.linspace(200.0, 1000.0, 40_000)[:, None]
    left = np.asarray(likelihood.draw(jax.random.key(2), light)) - 0.5 * np.asarray(light)
    np.testing.assert_allclose(left.var(), 0.25 + 1 / 12, rtol=0.04)  # with an error of 0.7 %
    assert abs(left.mean()) < 0.015


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize(("light", "code"), [(0.01, 3.0), (0.01, 60.0), (300.0, 0.0), (2.0, 255.0)])
def test_a_code_far_from_the_mean_has_its_probability(light, code):
    """The reference has 60 digits, dozens of standard deviations away, where no electron count
    gives the code."""
    gain, offset, noise = 0.5, 20.0, 1.5
    camera = sensor(read_noise=noise, gain=gain, offset=offset, bits=8)
    likelihood = SensorCounts(camera, reach=13)
    with mp.workdps(60):

        def share(n):
            """Return the probability from the tail that contains the interval, where no digits
            cancel."""
            centre = code - offset - gain * n
            side = 1 if centre < 0 else -1
            ends = sorted(side * (centre + half) / (gain * mp.mpf(noise)) for half in (-0.5, 0.5))
            if code in (0, 255):
                return mp.ncdf((0.5 + centre if code == 0 else 0.5 - centre) / (gain * noise))
            return mp.ncdf(ends[1]) - mp.ncdf(ends[0])

        chances = [mp.exp(n * mp.log(light) - light - mp.loggamma(n + 1)) for n in range(900)]
        truth = mp.log(sum(chance * share(n) for n, chance in enumerate(chances)))
    found, slope = jax.value_and_grad(
        lambda light: likelihood.log_density(light[None], jnp.array([code])).sum()
    )(jnp.asarray(light))
    np.testing.assert_allclose(found, float(truth), rtol=1e-9)
    assert np.isfinite(slope)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize(
    ("light", "code"), [(0.5, 40.0), (0.5, 900.0), (0.5, 1.0), (2000.0, 3000.0), (2000.0, 6000.0)]
)
def test_residuals_of_outliers_are_symmetric(light, code, dtype):
    """The reference is mpmath's, from 3 to 90 standard deviations, where 1 minus the probability
    rounds to 1."""
    camera = jax.tree.map(
        lambda x: jnp.asarray(x, dtype), sensor(read_noise=0.2, gain=2.0, offset=0.0, bits=13)
    )
    likelihood = SensorCounts(camera, reach=16)
    with mp.workdps(40):

        def chance(n):
            return mp.exp(n * mp.log(light) - light - mp.loggamma(n + 1))

        about = range(max(int(code / 2) - 30, 0), int(code / 2) + 31)
        edges = [(code + half) / 2 for half in (-0.5, 0.5)]
        inside, beneath, beyond = (mp.mpf(0) for _ in range(3))
        for n in about:
            low, high = ((edge - n) / mp.mpf(0.2) for edge in edges)
            beneath += chance(n) * mp.ncdf(low)
            beyond += chance(n) * mp.ncdf(-high)
            inside += chance(n) * (mp.ncdf(-low) - mp.ncdf(-high))
        beneath += mp.gammainc(about[0], light, mp.inf, regularized=True) if about[0] else 0
        beyond += mp.gammainc(about[-1] + 1, 0, light, regularized=True)
        tail, side = min((beneath + inside / 2, -1), (beyond + inside / 2, 1))
        start = mp.sqrt(-2 * mp.log(tail))
        truth = side * float(mp.findroot(lambda z: mp.log(mp.ncdf(-z)) - mp.log(tail), start))
    found = likelihood.residuals(jnp.asarray([light], dtype), jnp.asarray([code], dtype), 0.5)
    assert found.dtype == dtype
    np.testing.assert_allclose(found, truth, rtol=1e-4 if dtype == jnp.float32 else 1e-9)


@pytest.mark.sweep
@pytest.mark.parametrize("traced", [False, True])
def test_residuals_of_students_far_outliers_are_finite(traced):
    """Beyond 38 standard deviations the tail underflows for many degrees of freedom."""
    likelihood = StudentT(scale=1.0, dof=1e4, high=60.0)
    data = np.array([-45.0, 30.0, 45.0, 60.0])

    def residuals(data):
        return likelihood.residuals(jnp.zeros(4), data, np.ones(()))

    found = np.asarray((jax.jit(residuals) if traced else residuals)(data))
    with mp.workdps(40):
        for z, got in zip(data, found, strict=True):
            x = mp.mpf(1e4) / (mp.mpf(1e4) + z**2)
            log_tail = mp.log(mp.betainc(5000, 0.5, 0, x, regularized=True) / 2)
            start = mp.sqrt(-2 * log_tail)
            truth = mp.findroot(lambda d, tail=log_tail: mp.log(mp.ncdf(-d)) - tail, start)
            np.testing.assert_allclose(abs(got), float(truth), rtol=1e-8)
            assert np.sign(got) == np.sign(z)


@pytest.mark.sweep
@pytest.mark.parametrize("electrons", [5e4, 1e6, 1e7])
def test_codes_of_bright_light_keep_their_digits_in_float32(electrons):
    """ln P of every electron's code and residuals are right, although n ln mu - ln n! cancels."""
    camera = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), sensor(read_noise=0.1, gain=1.0))
    likelihood = SensorCounts(camera, reach=4)
    codes = np.round(electrons + np.linspace(-4, 4, 9) * np.sqrt(electrons)).astype(np.float32)
    light = jnp.full(9, electrons, jnp.float32)
    found = likelihood.log_density(light, jnp.asarray(codes))
    np.testing.assert_allclose(found, stats.poisson.logpmf(codes, electrons), atol=3e-5)
    deviates = likelihood.residuals(light, jnp.asarray(codes), 0.5)
    law = stats.poisson(electrons)
    middle = law.cdf(codes) - law.pmf(codes) / 2
    np.testing.assert_allclose(deviates, stats.norm.ppf(middle), atol=3e-4)


@pytest.mark.parametrize(
    ("options", "reach", "expected"),
    [
        ({"read_noise": 3.0}, 40, "needs a sensor with gain"),
        ({"gain": 0.5}, 40, "needs a sensor with read_noise"),
        ({"gain": 0.5, "read_noise": 3.0}, 20, "at least 25 are needed"),
    ],
)
def test_a_sensor_without_countable_electrons_is_refused(options, reach, expected):
    with pytest.raises(InputError, match=expected):
        SensorCounts(sensor(**options), reach)
    SensorCounts(sensor(gain=0.5, read_noise=3.0), 25)


@pytest.mark.parametrize("clustered", [False, True])
def test_codes_are_whole_and_light_is_not_negative(clustered):
    counted = SensorCounts(sensor(gain=0.5, read_noise=3.0), 25)
    grouped = Clustered(counted, [0, 0, 1]) if clustered else counted
    level = Problem({"a": Parameter()}, lambda a: a * jnp.ones(3), grouped, [20.0, np.nan, 21.0])
    with pytest.raises(InputError, match=r"codes, whole numbers, and hold 20\.4; use Sens"):
        level.with_data([20.0, np.nan, 20.4])
    light = jnp.array([3.0, -2.0, 1.0])
    for likelihood in (SensorNoise(counted.sensor), counted):
        with pytest.raises(InputError, match=r"the prediction is light, .* reaches -2 at"):
            likelihood.residuals(light, np.zeros(3), np.zeros(3))


@pytest.mark.slow
@pytest.mark.parametrize(
    "likelihood",
    [
        SensorNoise(sensor(read_noise=5.0, gain=0.5, offset=30.0, bits=12)),
        SensorCounts(sensor(read_noise=0.8, gain=0.5, bits=4), reach=9),
    ],
    ids=lambda x: type(x).__name__,
)
def test_residuals_of_a_sensors_draws_are_standard_normal(likelihood):
    light = jnp.linspace(1.0, 30.0, 3000)[:, None]
    codes = likelihood.draw(jax.random.key(3), light)
    residuals = likelihood.residuals(light, codes, RNG.uniform(size=codes.shape))
    assert stats.kstest(np.asarray(residuals)[:, 0], "norm").pvalue > 1e-3


@pytest.mark.slow
def test_gain_is_found_from_the_noise_of_a_sensor_in_a_record():
    """Photon transfer is stated as a problem, with the sensor's gain as the free parameter."""
    camera = sensor(read_noise=4.0, gain=0.25, offset=64.0, bits=12)
    light = jnp.repeat(jnp.linspace(100.0, 10_000.0, 40), 50)[:, None]
    codes = SensorNoise(camera).draw(jax.random.key(0), light)
    problem = Problem(
        {
            "sensor.gain": Parameter(unit="DN/e-", transform="log", lower=0.01, upper=10.0),
            "efficiency": Parameter(lower=0.05, upper=1.0),
        },
        lambda efficiency, inputs: efficiency * inputs,
        SensorNoise("sensor"),
        codes,
        records={"sensor": camera},
        inputs=light / 0.5,
    )
    result = fit(problem, starts=8)
    assert result.converged
    for estimate, truth in zip(result.estimates, (0.25, 0.5), strict=True):
        assert abs(estimate.value - truth) < 4 * estimate.standard_error < 0.4 * truth


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_gradient_of_a_clipped_pixel_is_right_in_the_far_tail(dtype):
    """The reference is phi / Phi by mpmath, to ten thousand deviations. Beyond, it is the distance
    itself."""
    z = jnp.asarray([-1e10, -1e4, -40, -5.001, -4.999, -1, 0, 3], dtype)
    slopes = jax.jit(jax.vmap(jax.grad(log_ndtr)))(z)
    for x, slope in zip(z.tolist(), slopes.tolist(), strict=True):
        with mp.workdps(60):
            x = mp.mpf(x)
            true = mp.npdf(x) / mp.ncdf(x) if x > -1e5 else -x
            assert abs(slope / true - 1) < 64 * float(jnp.finfo(dtype).eps), x


@pytest.mark.parametrize("beyond", [5.0, 11.9, 12.1, 20.0, 40.0])
@pytest.mark.parametrize("chance", [0.01, 0.5, 0.99])
def test_residuals_of_clipped_data_far_from_the_prediction(beyond, chance):
    """The probability below the residual is `chance` times the probability beyond the limit,
    however small that is."""
    ends = Censored(jnp.array(1.0), jnp.array(0.0), jnp.array(1.0))
    low = ends.residuals(jnp.array(beyond), jnp.array(0.0), jnp.array(chance))
    high = ends.residuals(jnp.array(1 - beyond), jnp.array(1.0), jnp.array(chance))
    assert float(low) == pytest.approx(-float(high), rel=1e-12)
    share = mp.ncdf(mp.mpf(float(low))) / mp.ncdf(mp.mpf(-beyond))
    assert float(share) == pytest.approx(chance, rel=3e-4)


@pytest.mark.slow
def test_nonlinearity_taps_and_light_offset_enter_the_probability_of_a_code():
    """The reference sums the Poisson distribution of light and offset over the curve's signal and
    each tap's parameters."""
    camera = sensor(
        read_noise=0.3,
        gain=4.0,
        offset=10.0,
        bits=7,
        light_offset=0.5,
        nonlinearity=Compression(0.1, electrons=30.0),
        taps=Taps(((0, 1),), gain=[1.0, 1.1], offset=[0.0, 2.0], read_noise=[1.0, 1.5]),
    )
    codes, n = np.arange(128.0), np.arange(60)
    signal = np.where(n <= 30, n * (1 - n / 300), 27 + 0.8 * (n - 30))
    light = jnp.full((1, 2, 128), 3.0)
    counted = SensorCounts(camera, reach=8)
    density = jax.jit(lambda light, codes: counted.log_density(light, codes))
    found = density(light, jnp.broadcast_to(codes, light.shape))
    for own, gain, offset, noise in zip(found[0], (4, 4.4), (10, 12), (0.3, 0.45), strict=True):
        low = np.where(codes == 0, -np.inf, codes - 0.5)[:, None]
        high = np.where(codes == 127, np.inf, codes + 0.5)[:, None]
        inside = stats.norm(offset + gain * signal, gain * noise)
        plain = (inside.cdf(high) - inside.cdf(low)) @ stats.poisson.pmf(n, 3.5)
        np.testing.assert_allclose(np.exp(own), plain, rtol=1e-7, atol=1e-14)


@pytest.mark.parametrize(
    "effect",
    [{"mixing": even_mixing(0.1)}, {"brighter_fatter": BrighterFatter(1e-7 * np.ones((3, 3)))}],
)
def test_charge_sharing_between_pixels_is_refused(effect):
    (name,) = effect
    with pytest.raises(InputError, match=f"Sensor.{name} changes counted electrons"):
        SensorCounts(sensor(gain=0.5, read_noise=0.5, **effect), 10)


TABLE_CODES = np.arange(4.0, 40.0)


def plain_shares(light, codes=TABLE_CODES, gain=4.0, noise=0.3, black=10.0):
    n = np.arange(60)[:, None]
    law = stats.norm(black + gain * n, gain * noise)
    found = stats.poisson.pmf(n[:, 0], light) @ (law.cdf(codes + 0.5) - law.cdf(codes - 0.5))
    return found / found.sum()


@pytest.mark.slow
def test_a_table_of_codes_is_multinomial_within_its_codes():
    """There are two light levels. Counts of codes outside the table are not known."""
    tables = SensorCounts(
        sensor(gain=4.0, read_noise=0.3, offset=10.0),
        reach=4,
        codes=TABLE_CODES,
        totals=np.array([[500_000.0], [40_000.0]]),
    )
    lights = jnp.asarray(np.array([[1.0], [3.0]]) * np.ones(TABLE_CODES.size))
    expected = np.stack([plain_shares(1.0), plain_shares(3.0)])
    counts = jnp.asarray(RNG.multinomial(1000, expected), float)
    density, drawn = jax.jit(
        lambda light: (tables.log_density(light, counts), tables.draw(jax.random.key(0), light))
    )(lights)
    np.testing.assert_allclose(density, counts * np.log(expected), rtol=1e-9)
    drawn = np.asarray(drawn)
    np.testing.assert_array_equal(drawn.sum(axis=1), [500_000, 40_000])
    pearson = np.sum((drawn - tables.totals * expected) ** 2 / (tables.totals * expected))
    assert 1e-3 < stats.chi2.sf(pearson, 2 * (TABLE_CODES.size - 1)) < 1 - 1e-3
    with pytest.raises(InputError, match="give it, such as totals="):
        SensorCounts(tables.sensor, 4, codes=TABLE_CODES).draw(jax.random.key(0), lights)
    with pytest.raises(InputError, match="whole and at least 0, and one is -"):
        tables.check_data(-counts)
    with pytest.raises(InputError, match=r"each table has \d+ codes and 2 counts;"):
        tables.check_data(counts[:, :2])
    with pytest.raises(InputError, match=r"one is 0\.5; give counts, not shares"):
        tables.check_data(np.full(counts.shape, 0.5))
    for codes, words in (([5, 6, 5], "hold 5 twice"), ([5, np.nan], "hold one that is not finite")):
        with pytest.raises(InputError, match=f"codes {words}; give each code of a table once"):
            SensorCounts(tables.sensor, 4, codes=codes)
    # A problem draws tables with as many counts as its data.
    space = {"mu": Parameter(shape=(2,), transform="log")}
    one = SensorCounts(tables.sensor, 4, codes=TABLE_CODES)
    problem = Problem(space, lambda mu: mu[:, None] * jnp.ones((1, TABLE_CODES.size)), one, counts)
    again = likelihood_at(problem, {"mu": jnp.array([1.0, 3.0])}).draw(jax.random.key(0), lights)
    np.testing.assert_array_equal(again.sum(axis=1), [1000, 1000])


@pytest.mark.slow
@pytest.mark.parametrize("traced", [False, True])
@pytest.mark.sweep
def test_residuals_of_tables_are_binomial_deviates(traced):
    """Given the counts of smaller codes, residuals follow SciPy's binomial distribution and are
    standard normal."""
    tables = SensorCounts(sensor(gain=4.0, read_noise=0.3, offset=10.0), 4, codes=TABLE_CODES)
    share = plain_shares(2.0)
    counts = RNG.multinomial(300, share, 200).astype(float)
    chance = RNG.uniform(size=counts.shape)

    def residuals(counts):
        return tables.residuals(jnp.full(counts.shape, 2.0), counts, chance)

    found = np.asarray((jax.jit(residuals) if traced else residuals)(counts))
    left = np.cumsum(counts[:, ::-1], axis=1)[:, ::-1]
    odds = np.clip(share / np.cumsum(share[::-1])[::-1], 0, 1)
    law = stats.binom(left[:, :-1].astype(int), odds[:-1])
    place = law.cdf(counts[:, :-1] - 1) + chance[:, :-1] * law.pmf(counts[:, :-1])
    np.testing.assert_allclose(found[:, :-1], stats.norm.ppf(place), atol=1e-6)
    assert stats.kstest(found.ravel(), "norm").pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("read_noise", GAINS)
def test_tables_of_codes_are_fitted_efficiently(read_noise):
    """The scatter of 200 fits is compared with the Cramer-Rao bound of a plain sum."""
    found = efficiency(read_noise, 200, seed=1)
    assert found.fits == 200
    assert 0.88 < found.whole < 1.15
    assert (found.ratios > 0.7).all()
    assert (abs(found.claimed / found.ratios - 1) < 0.1).all()
