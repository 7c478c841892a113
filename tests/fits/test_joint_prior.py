"""Tests a posterior, or the draws of a camera, as the prior of another problem."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from scipy.optimize import curve_fit

import jaxvision as jv
from fitting import (
    Candidate,
    Clustered,
    Emcee,
    Gaussian,
    Normal,
    Nuts,
    Parameter,
    Problem,
    as_prior,
    fit,
)
from fitting.inference.joint_prior import Marginal, log_dependence
from fitting.inference.problem import log_prior_at
from jaxvision.errors import InputError

SD = 0.1
PLACES = np.linspace(0.0, 3.0, 40)
COLUMNS = np.stack([np.ones(40), PLACES, np.sin(PLACES)], axis=1)
DATA = COLUMNS @ [1.0, 2.0, -1.0] + SD * np.random.default_rng(0).standard_normal(40)
FREE = {"a": Parameter(start=0.0, prior=Normal(1.2, 0.3)), "b": Parameter(start=0.0)}
FIRST, SECOND, ALL = slice(0, 20), slice(20, 40), slice(0, 40)
fitted = partial(fit, starts=2)


def line(part, prior=None, *, sd=SD, **other):
    """Return a problem of three parameters with a linear prediction."""
    free = {**FREE, "c": Parameter(start=0.0), **other}
    return Problem(
        free,
        lambda a, b, c, inputs: inputs @ jnp.stack([a, b, c]),
        Gaussian(sd=sd),
        DATA[part],
        inputs=COLUMNS[part],
        prior=prior,
    )


@pytest.fixture(scope="module")
def half():
    with jax.enable_x64(True):
        return fitted(line(FIRST))


def normal_equations(part, precision=None, centre=None):
    """Return mode and covariance of the linear problem by its normal equations."""
    prior = np.diag([0.3**-2, 0.0, 0.0]) if precision is None else precision
    mean = np.array([1.2, 0.0, 0.0]) if centre is None else centre
    matrix = COLUMNS[part].T @ COLUMNS[part] / SD**2 + prior
    return np.linalg.solve(matrix, COLUMNS[part].T @ DATA[part] / SD**2 + prior @ mean), (
        np.linalg.inv(matrix)
    )


@pytest.mark.slow
def test_two_halves_of_linear_data_equal_the_whole(half):
    with jax.enable_x64(True):
        both = fitted(line(SECOND, half.as_prior("*")))
    centre, covariance = normal_equations(ALL)
    np.testing.assert_allclose(both.posterior.mode, centre, atol=1e-10)
    np.testing.assert_allclose(both.posterior.covariance, covariance, atol=1e-10)
    assert not any("hardly from the data" in one for one in both.findings)
    shares = both.budget("a").shares
    assert shares[0].source == "prior of a, b and c"
    # c^T C P C c over c^T C c, with the information P of the first half.
    along = covariance[0]
    known = np.linalg.inv(normal_equations(FIRST)[1])
    np.testing.assert_allclose(shares[0].share, along @ known @ along / covariance[0, 0], atol=1e-8)


@pytest.mark.slow
def test_other_parameters_are_marginalised_and_keep_their_own_priors(half):
    """The prior of a is from the first half and that of b its own, whatever the first half says
    about b and c."""
    prior = half.as_prior(["a", "c"])
    with jax.enable_x64(True):
        found = fitted(line(SECOND, prior, b=Parameter(prior=Normal(2.1, 0.05))))
    centre, covariance = normal_equations(FIRST)
    told = np.zeros((3, 3))
    told[np.ix_([0, 2], [0, 2])] = np.linalg.inv(covariance[np.ix_([0, 2], [0, 2])])
    told[1, 1] = 0.05**-2
    expected, spread = normal_equations(SECOND, told, np.array([centre[0], 2.1, centre[2]]))
    np.testing.assert_allclose(found.posterior.mode, expected, atol=1e-9)
    np.testing.assert_allclose(found.posterior.covariance, spread, atol=1e-9)


@pytest.mark.parametrize(
    "names", [{"a": "x", "b": "y"}, {"*": "left.*"}], ids=["by name", "by pattern"]
)
@pytest.mark.slow
def test_parameters_may_be_renamed(half, names):
    new = [names.get(one, f"left.{one}") for one in "ab"]
    record = {"left": {"a": 1.0, "b": 1.0}} if "*" in names else None
    with jax.enable_x64(True):
        problem = Problem(
            dict.fromkeys(new, Parameter(start=1.0)),
            lambda values: jnp.stack([values[name] for name in new]),
            Gaussian(sd=1e6),
            [0.0, 0.0],
            records=record,
            prior=half.as_prior(names),
        )
        found = fitted(problem)
    np.testing.assert_allclose(found.posterior.mode, half.posterior.mode[:2], atol=1e-7)
    np.testing.assert_allclose(
        found.posterior.covariance, half.posterior.covariance[:2, :2], rtol=1e-7
    )


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ("q", "as_prior: no parameter 'q' was estimated; use one of a, b, c"),
        ("q.*", "as_prior: no parameter 'q.*' was estimated"),
        (
            {"*": "left.*"},
            "prior: none of left.a, left.b, left.c is a free parameter of this problem",
        ),
        ({"a": "other", "b": "b"}, "prior: 'other' is no free parameter of this problem; use one"),
        ({"a": "b", "b": "b"}, "as_prior: two parameters get the same name"),
        ({"*": "b"}, "as_prior: '*' cannot be renamed to 'b'; give one * in both, or names"),
        ([3], "as_prior: 3 is no name of a parameter"),
    ],
)
def test_a_wrong_name_gives_one_sentence(half, names, words):
    with jax.enable_x64(True), pytest.raises(InputError) as caught:
        line(SECOND, half.as_prior(names))
    assert words in str(caught.value)


def test_mismatched_shapes_and_invalid_priors_are_refused(half):
    with jax.enable_x64(True):
        with pytest.raises(InputError, match=r"prior: a has the shape \(\) there and \(2,\)"):
            line(SECOND, half.as_prior("a"), a=Parameter(start=np.zeros(2)))
        with pytest.raises(InputError, match="prior must be a JointPrior, got Fit"):
            line(SECOND, half)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", [Emcee(), pytest.param(Nuts(), marks=pytest.mark.slow)], ids=["emcee", "NUTS"]
)
def test_draws_of_a_sampler_are_a_prior(method):
    if isinstance(method, Nuts):
        pytest.importorskip("blackjax")
    with jax.enable_x64(True):
        first = fitted(line(FIRST), posterior=method)
        both = fitted(line(SECOND, first.as_prior()))
    centre, covariance = normal_equations(ALL)
    error = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose(both.posterior.mode, centre, atol=0.12 * error.max())
    widths = np.sqrt(np.diagonal(both.posterior.covariance))
    np.testing.assert_allclose(widths, error, rtol=0.06)


def test_a_non_gaussian_posterior_is_refused():
    """The data give only an upper bound on a rate."""
    time = np.linspace(0, 1, 5)
    problem = Problem(
        {"rate": Parameter(lower=0, upper=50)},
        lambda rate, inputs: jnp.exp(-rate * inputs),
        Gaussian(sd=0.3),
        np.array([1.0, 0.9, 0.9, 0.9, 0.8]),
        inputs=time,
    )
    found = fit(problem, starts=4)
    assert found.posterior.method != "Laplace"
    with pytest.raises(
        InputError, match="as_prior: the posterior of rate is not Gaussian: 95 % of"
    ):
        found.as_prior()


def test_a_fit_that_failed_is_refused():
    found = fitted(line(ALL, sd=SD / 3))
    with pytest.raises(InputError, match="as_prior: the fit did not converge, so that it cannot"):
        found.as_prior()


@pytest.mark.slow
def test_inflation_is_passed_on():
    with jax.enable_x64(True):
        found = fitted(line(FIRST, sd=SD / 3), misfit="inflate")
        assert found.noise > 2
        both = fitted(line(SECOND, found.as_prior()))
    (told,) = [one for one in both.findings if "The prior comes from a fit with a misfit" in one]
    assert f"are multiplied by {found.noise:.3g}" in told
    expected = np.linalg.inv(
        np.linalg.inv(found.posterior.covariance) + COLUMNS[SECOND].T @ COLUMNS[SECOND] / SD**2
    )
    np.testing.assert_allclose(both.posterior.covariance, expected, rtol=1e-7)


@pytest.mark.slow
def test_few_groups_give_students_t():
    """The errors are from 6 groups. Where new data say nothing, the prior is reproduced with the
    intervals of the first fit."""
    rng, labels = np.random.default_rng(3), np.repeat(np.arange(6), 5)
    data = 2.0 + 0.3 * rng.standard_normal(6)[labels] + SD * rng.standard_normal(30)
    with jax.enable_x64(True):
        first = fitted(
            Problem(
                {"m": Parameter(start=1.0)},
                lambda m: m * jnp.ones(30),
                Clustered(Gaussian(sd=SD), labels),
                data,
            )
        )
        prior = first.as_prior("m")
        assert prior.marginals[0].freedom < 8
        again = Problem(
            {"m": Parameter()}, lambda m: m * jnp.ones(1), Gaussian(sd=1e4), [0.0], prior=prior
        )
        found = fit(again, starts=2, posterior=Emcee(walkers=16))
    (one,), (before,) = found.estimates, first.estimates
    width = np.subtract(*before.interval_95)
    np.testing.assert_allclose(one.interval_95, before.interval_95, atol=0.05 * abs(width))
    assert any("groups share errors" in one for one in found.findings)


@pytest.mark.slow
def test_a_prior_that_new_data_contradict_is_named(half):
    with jax.enable_x64(True):
        agreeing = fitted(line(SECOND, half.as_prior()))
        assert not any("from an earlier fit" in one for one in agreeing.findings)
        moved = line(SECOND, half.as_prior()).with_data(DATA[SECOND] + 1.0)
        found = fitted(moved)
    own, spread = normal_equations(SECOND, np.zeros((3, 3)), np.zeros(3))
    gap = own + np.array([1.0, 0.0, 0.0]) - half.posterior.mode
    square = gap @ np.linalg.solve(spread + half.posterior.covariance, gap)
    (told,) = [one for one in found.failures if "from an earlier fit" in one]
    assert f"a chi-square of {square:.4g} for 3 degrees of freedom" in told
    alone = np.sum((DATA[SECOND] - COLUMNS[SECOND] @ own) ** 2) / SD**2  # without the prior
    dof = len(DATA[SECOND]) - len(own)
    assert f"and would be about {alone / dof:.2g} without that prior" in told


@pytest.mark.slow
def test_a_prior_far_from_the_data_is_the_only_cause_that_is_named():
    """The background of a decay is .1, then .3. The search ends uphill between the two."""
    time, noise = np.linspace(0, 5, 200), 0.02 * np.random.default_rng(0).standard_normal(200)
    free = {
        "amplitude": Parameter(lower=0, upper=5),
        "decay": Parameter(lower=0.1, upper=10, transform="log"),
        "background": Parameter(prior=Normal(0.1, 0.1)),
    }

    def glow(inputs, amplitude, decay, background):
        return amplitude * jnp.exp(-inputs / decay) + background

    with jax.enable_x64(True):
        data = np.asarray(glow(time, 2.0, 1.5, 0.1)) + noise
        first = fitted(Problem(free, glow, Gaussian(sd=0.02), data, inputs=time))
        later = data + 0.2
        prior = first.as_prior()
        found = fitted(Problem(free, glow, Gaussian(sd=0.02), later, inputs=time, prior=prior))
    sigma = np.full(200, 0.02)
    best, spread = curve_fit(
        lambda t, a, d, b: a * np.exp(-t / d) + b,
        *(time, later, (2, 1.5, 0.3)),
        sigma=sigma,
        absolute_sigma=True,
    )
    sd = np.sqrt(spread[2, 2])
    z = (best[2] - first.values["background"]) / np.hypot(sd, first.estimates[2].standard_error)
    both, alone = found.failures
    assert "differs from what the data alone say" in both
    assert "does not describe the data because of it" in both
    assert alone.startswith("The prior of background in it, ")
    assert abs(float(alone.split("lies ")[1].split()[0]) - z) < 0.02 * z
    assert f"({best[2]:.2f}" in alone
    assert not found.findings


@pytest.mark.slow
def test_the_density_is_a_gaussian_copula_of_students_t():
    """The reference is SciPy's, with two bounds and on a log scale. Gradients are compared with
    differences."""
    marginals = (
        Marginal(0.3, 0.2, 3.0, Parameter(transform="log", lower=0.5, upper=4.0)),
        Marginal(-1.0, 0.5, np.inf, Parameter()),
    )
    with jax.enable_x64(True):
        for one in marginals:
            first, last = (float(one.quantile(np.array(p))) for p in (1e-9, 1 - 1e-9))
            knots = one.quantile(np.linspace(0.01, 0.99, 9))
            total, _ = quad(
                lambda x: float(jnp.exp(one.log_density(jnp.asarray(x)))),  # noqa: B023
                first,
                float(one.quantile(np.array(0.2))),
                points=knots[knots < one.quantile(np.array(0.2))],
            )
            np.testing.assert_allclose(total, 0.2, atol=1e-6)
            assert first < last
        t = np.array([-40.0, -3.0, -1e-3, 0.0, 0.5, 10.0])
        score = jax.vmap(lambda t: Marginal(0.0, 1.0, 3.0, Parameter()).score(t))
        wanted = stats.norm.isf(stats.t.sf(np.abs(t), 3.0)) * np.sign(t)
        np.testing.assert_allclose(score(jnp.asarray(t)), wanted, rtol=1e-9)
        slopes = jax.vmap(jax.grad(lambda t: Marginal(0.0, 1.0, 3.0, Parameter()).score(t)))
        np.testing.assert_allclose(
            slopes(jnp.asarray(t)), stats.t.pdf(t, 3.0) / stats.norm.pdf(wanted), rtol=1e-9
        )


def test_correlations_add_the_joint_gaussians_part():
    draws = np.random.default_rng(1).multivariate_normal([1, -5], [[1, 0.6], [0.6, 0.5]], 4000)
    with jax.enable_x64(True):
        prior = as_prior({"x": draws[:, 0], "y": draws[:, 1]}, ["x", "y"])
        problem = Problem(
            {"y": Parameter(start=-4.0), "x": Parameter(start=0.0)},
            lambda x, y: jnp.stack([x, y]),
            Gaussian(sd=1.0),
            [0.0, 0.0],
            prior=prior,
        )
        vectors = jnp.asarray([[-4.0, 0.3], [-5.5, 2.0]])  # y and x
        known = np.asarray(log_prior_at(problem, vectors))
        wanted = stats.multivariate_normal(draws.mean(0), np.cov(draws.T)).logpdf(
            np.asarray(vectors)[:, ::-1]
        )
        np.testing.assert_allclose(np.diff(known), np.diff(wanted), rtol=1e-3)
        alone = problem._replace({"y": -5.0})
        assert alone.prior.names == ("x",)
        zeros = log_dependence(alone.prior, alone.space, jnp.zeros(1))
        np.testing.assert_allclose(zeros, 0.0, atol=1e-15)


@pytest.mark.slow
def test_draws_of_a_camera_file_are_a_prior(tmp_path):
    """Gain and read noise of a sensor have a correlation of -.8, and there is one datum of each."""
    rng = np.random.default_rng(2)
    spread = 0.02 * rng.multivariate_normal([0, 0], [[1, -0.8], [-0.8, 1]], 1000)
    best = jv.Sensor(gain=0.5, read_noise=4.0, offset=64.0)
    like = jax.tree.map(lambda x: np.full(1000, x), best)
    draws = eqx.tree_at(
        lambda sensor: (sensor.gain, sensor.read_noise),
        like,
        (0.5 * np.exp(spread[:, 0]), 4.0 * np.exp(spread[:, 1])),
    )
    jv.write_sensor(best, tmp_path / "sensor.toml", draws=draws)
    kept = jv.read_sensor(tmp_path / "sensor.toml", draws=1000)
    prior = as_prior({"sensor": kept}, "sensor.*")
    assert set(prior.names) == {"sensor.gain", "sensor.read_noise"}  # the offset does not vary
    with jax.enable_x64(True):
        problem = Problem(
            {"sensor.gain": Parameter(), "sensor.read_noise": Parameter(lower=0)},
            lambda sensor: jnp.stack([jnp.log(sensor.gain), sensor.offset]),
            Gaussian(sd=np.array([0.01, 1.0])),
            [np.log(0.5) + 0.03, 64.0],
            records={"sensor": best},
            prior=prior,
        )
        found = fitted(problem)
    # The gain is estimated from both, and the read noise follows the gain by -.8 times its step.
    step = np.mean(spread[:, 0]) + (0.03 - np.mean(spread[:, 0])) * 0.02**2 / (0.02**2 + 0.01**2)
    np.testing.assert_allclose(np.log(found.values["sensor.gain"] / 0.5), step, atol=1e-3)
    np.testing.assert_allclose(
        np.log(found.values["sensor.read_noise"] / 4.0), -0.8 * step, atol=2e-3
    )
    with pytest.raises(InputError, match=r"no parameter 'sensor\.offset' was estimated"):
        as_prior({"sensor": kept}, "sensor.offset")
    with pytest.raises(InputError, match="none of the numbers varies from draw to draw"):
        as_prior({"sensor": best}, "*")
    with pytest.raises(InputError, match="determine each other"):
        as_prior({"x": spread[:, 0], "y": 2 * spread[:, 0]}, "*")
    with pytest.raises(InputError, match=r"the posterior of x is not Gaussian: 95 % of its draws"):
        as_prior({"x": rng.exponential(size=1000) - 0.1}, "x")


@pytest.mark.slow
def test_candidates_and_samplers_take_a_prior(half):
    with jax.enable_x64(True):
        prior = half.as_prior(["b", "c"])
        terms = line(SECOND, prior, c=Candidate(Parameter(start=0.0)))
        assert [one.kept for one in fitted(terms).choices] == [True]
        assert terms.without("c").prior.names == ("b",)
        chain = fitted(line(SECOND, prior), posterior=Emcee())
        laplace = fitted(line(SECOND, prior))
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(chain.posterior.covariance)),
        np.sqrt(np.diagonal(laplace.posterior.covariance)),
        rtol=0.08,
    )


@pytest.mark.slow
def test_phong_from_two_halves_of_the_lights_equals_all_lights():
    """The data are photographs of a ball. The exponent makes the likelihood non-Gaussian."""
    rng, side = np.random.default_rng(0), np.linspace(-0.9, 0.9, 24)
    x, y = (one[np.add.outer(side**2, side**2) < 0.9] for one in np.meshgrid(side, side))
    normals = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=1)
    lights = rng.standard_normal((24, 3)) + np.array([0, 0, 2])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    names = ("diffuse", "specular", "exponent")
    scale = {"exponent": {"lower": 1.0, "upper": 500.0, "transform": "log"}}
    start = dict(zip(names, (0.3, 0.3, 20.0), strict=True))

    def shade(diffuse, specular, exponent, inputs):
        cosine = inputs @ normals.T
        mirrored = 2 * cosine * normals[None, :, 2] - inputs[:, 2:]
        lobe = jnp.maximum(mirrored, 1e-9) ** exponent
        return jnp.where(cosine > 0, diffuse * cosine + specular * lobe, 0.0)

    with jax.enable_x64(True):
        exact = np.asarray(shade(0.4, 0.3, 30.0, jnp.asarray(lights)))
        data = exact + 0.01 * rng.standard_normal(exact.shape)

        def of(part, prior=None):
            plain = {"lower": 0.0, "upper": 2.0}
            free = {n: Parameter(start=start[n], **scale.get(n, plain)) for n in names}
            own = {"inputs": lights[part], "prior": prior}
            return fitted(Problem(free, shade, Gaussian(sd=0.01), data[part], **own))

        whole, first = of(slice(None)), of(slice(0, None, 2))
        both = of(slice(1, None, 2), first.as_prior("*"))
    for one, other in zip(whole.estimates, both.estimates, strict=True):
        assert abs(one.value - other.value) < 0.05 * one.standard_error
        assert other.standard_error == pytest.approx(one.standard_error, rel=0.01)
