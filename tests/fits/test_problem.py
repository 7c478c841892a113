"""Tests users' own problems: fits against SciPy, closed forms and grids, paths, ties, bounds and
reports, and that a second fit compiles nothing."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from scipy import stats

from fitting import Emcee, Gaussian, Normal, Parameter, Problem, Tied, fit
from fitting.inference.problem import give, log_density, prediction, values_at
from fitting.inference.search import spread_starts
from jaxvision import Lambert, Phong, PointLight, Scene, Sphere, Surface
from jaxvision.errors import InputError

RNG = np.random.default_rng(3)
TIME = np.linspace(0.0, 3.0, 60)
RECORD = {"a": np.zeros(3), "b": np.ones(3)}
HEIGHT, RATE = 2.0, 1.3
DECAY = HEIGHT * np.exp(-RATE * TIME) + 0.02 * RNG.standard_normal(60)
BOXED = {
    "height": Parameter(unit="V", lower=0, upper=10),
    "rate": Parameter(unit="s^-1", transform="log", lower=0.01, upper=50),
}


def decay(height, rate, inputs):
    return height * jnp.exp(-rate * inputs)


def decay_problem(data=DECAY, **options):
    return Problem(BOXED, decay, Gaussian(sd=0.02), data, inputs=TIME, **options)


@pytest.fixture(scope="module")
def fitted():
    return fit(decay_problem())


def scipy_decay(data):
    found = scipy.optimize.least_squares(
        lambda p: (p[0] * np.exp(-p[1] * TIME) - data) / 0.02, [1.0, 1.0], xtol=1e-14
    )
    return found.x, np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))


def test_least_squares_against_scipy(fitted):
    best, sd = scipy_decay(DECAY)
    assert fitted.converged
    assert not fitted.failures
    for estimate, value, error in zip(fitted.estimates, best, sd, strict=True):
        # The mode is for the unconstrained value, which differs by a small part of the error.
        assert abs(estimate.value - value) < 0.05 * error
        np.testing.assert_allclose(estimate.standard_error, error, rtol=0.02)
    assert [e.unit for e in fitted.estimates] == ["V", "s^-1"]
    assert abs(fitted.misfit.chi_square - 60) < 5 * math.sqrt(120)
    np.testing.assert_allclose(
        fitted.misfit.p, stats.chi2.sf(fitted.misfit.chi_square, fitted.misfit.dof), rtol=1e-6
    )
    assert "converged" in str(fitted)
    assert "height" in fitted._repr_html_()


ENSEMBLE = {"posterior": Emcee(walkers=8, block=50)}


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, ENSEMBLE], ids=["laplace", "emcee"])
def test_a_second_fit_of_equal_shapes_compiles_nothing(options):
    """This also holds if an ensemble needs another number of steps."""
    compiled = []

    def listen(name, seconds, **_):
        if "backend_compile" in name:
            compiled.append(seconds)

    other = np.asarray(DECAY + 0.02 * RNG.standard_normal(60))
    problem = decay_problem().with_data(other)
    first = fit(decay_problem(), seed=1, **options)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        again = fit(problem, seed=2, **options)
    finally:
        jax.monitoring.clear_event_listeners()
    assert not compiled
    assert (again.posterior.draws.shape == first.posterior.draws.shape) == (not options)
    assert abs(again.values["height"] - scipy_decay(other)[0][0]) < 0.01


def test_the_posterior_of_a_line_with_priors_is_the_closed_form():
    """For Gaussian data and priors the precision is exactly A^T A / sd^2 + 1 / prior sd^2."""
    design = np.stack([np.ones(20), np.linspace(-1, 1, 20)], axis=-1)
    data = design @ [0.5, 2.0] + 0.3 * RNG.standard_normal(20)
    result = fit(
        Problem(
            {"line": Parameter(prior=Normal(1.0, 0.2), shape=(2,))},
            lambda line, inputs: inputs @ line,
            Gaussian(sd=0.3),
            data,
            inputs=design,
        )
    )
    precision = design.T @ design / 0.09 + np.eye(2) / 0.04
    mean = np.linalg.solve(precision, design.T @ data / 0.09 + 1.0 / 0.04)
    np.testing.assert_allclose(result.values["line"], mean, rtol=1e-6)
    np.testing.assert_allclose(result.posterior.covariance, np.linalg.inv(precision), atol=1e-9)
    assert result.draws["line"].shape == (1, 4000, 2)
    total = result.derived(lambda line: line.sum())
    sd = math.sqrt(np.linalg.inv(precision).sum())
    np.testing.assert_allclose([total.mean, total.sd], [mean.sum(), sd], rtol=0.1)
    # A new datum scatters by the noise and by the uncertainty of the line.
    at = jnp.array([[1.0, 3.0]])
    bands = result.predictive(at, draws=4000)
    row = np.asarray(at[0])
    expected = math.sqrt(0.09 + row @ np.linalg.inv(precision) @ row)
    np.testing.assert_allclose(bands.mean, row @ mean, rtol=0.05)
    np.testing.assert_allclose(np.diff(bands.interval_95[:, 0])[0] / 3.92, expected, rtol=0.1)


@pytest.mark.slow
def test_a_bounded_parameter_against_its_posterior_on_a_grid():
    """For a proportion near its bound, the mode is in u, and probabilities are by quadrature over
    x."""
    problem = Problem(
        {"share": Parameter(lower=0, upper=1)},
        lambda share: share * jnp.ones(4),
        Gaussian(sd=0.1),
        np.array([0.02, 0.12, -0.05, 0.07]),
    )
    x = np.linspace(0, 1, 20_001)[1:-1]
    likelihood = stats.norm.logpdf(problem.data, x[:, None], 0.1).sum(1)
    u = np.log(x) - np.log1p(-x)
    theirs = likelihood + np.log(x) + np.log1p(-x)  # flat in x, as a density of u
    ours = jax.vmap(lambda v: log_density(v, problem))(jnp.asarray(u[::500, None]))
    np.testing.assert_allclose(ours - ours[0], (theirs - theirs[0])[::500], rtol=1e-9, atol=1e-9)
    result = fit(problem)
    np.testing.assert_allclose(result.values["share"], x[np.argmax(theirs)], atol=1e-4)
    density = np.exp(likelihood - likelihood.max())
    below = np.cumsum(density) / density.sum()
    expected = np.interp([0.025, 0.16, 0.84, 0.975], below, x)
    found = np.quantile(result.draws["share"], [0.025, 0.16, 0.84, 0.975])
    np.testing.assert_allclose(found, expected, atol=0.05 * (expected[2] - expected[1]))
    assert any("far from a Gaussian" in sentence for sentence in result.findings)


def test_fixed_and_tied_numbers():
    result = fit(
        Problem(
            {"a": Parameter(start=0.3), "b": 2.0, "c": Tied(lambda values: 3 * values["a"])},
            lambda values: jnp.stack([values["a"], values["b"] * values["c"]]),
            Gaussian(sd=0.1),
            np.array([1.0, 6.0]),
        )
    )
    np.testing.assert_allclose(result.values["a"], 1.0)
    np.testing.assert_allclose(result.values["c"], 3.0)
    assert result.values["b"] == 2.0


def test_data_that_are_all_missing_are_refused():
    with pytest.raises(InputError, match="all data are missing"):
        fit(decay_problem(np.full(60, np.nan)))


def scene():
    ball = Surface(Sphere((0.0, 0.0, 0.0), 1.0), Phong((0.2,), (0.4,), exponent=20.0))
    floor = Surface(Sphere((0.0, 0.0, -3.0), 1.0), Lambert((0.1,)))
    return Scene([ball, floor], [PointLight((0.0, 1.0, 2.0), (5.0,))])


def of_scene(name, predict=None, **options):
    return Problem(
        {name: Parameter(**options)},
        predict or (lambda scene: scene.lights[0].position),
        Gaussian(sd=1.0),
        np.zeros(3),
        records={"scene": scene()},
    )


def test_a_path_replaces_only_its_leaf():
    problem = of_scene("scene.lights[0].position", lower=-5, upper=5)
    assert problem.free[0].shape == (3,)
    starts = spread_starts(problem, 3, seed=0)
    np.testing.assert_allclose(values_at(problem, starts[0])[problem.free[0].name], [0, 1, 2])
    moved = values_at(problem, jnp.array([0.0, 1.0, -1.0]))
    np.testing.assert_allclose(prediction(problem, moved), moved["scene.lights[0].position"])

    def others(scene):
        return jnp.stack(
            [
                scene.surfaces[0].material.exponent,
                *scene.surfaces[0].material.diffuse,
                scene.lights[0].position[1],
            ]
        )

    one = of_scene("scene.lights[0].position[2]", others)
    vector = jnp.array([7.0])
    np.testing.assert_allclose(prediction(one, values_at(one, vector)), [20.0, 0.2, 1.0])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("scne.lights[0].position", "no record 'scne'; the nearest is 'scene'"),
        ("scene.light[0].position", "scene has no 'light'; there is surfaces, lights"),
        ("scene.lights[1].position", r"scene.lights has no 1; there is \[0\] alone"),
        ("scene.lights[0]", r"is no number; there is position, intensity"),
        ("scene.lights[0].position[3]", "has 3 numbers"),
        ("scene.lights[0]position", "is no path"),
    ],
)
def test_a_wrong_path_gets_a_list_of_valid_ones(name, expected):
    with pytest.raises(InputError, match=expected):
        of_scene(name)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"parameters": {"a": 1.0}}, "Nothing to fit"),
        ({"predict": lambda b: b}, "predict asks for 'b'"),
        ({"data": np.zeros(4)}, r"predict gives an array of shape \(3,\), the data have \(4,\)"),
        ({"likelihood": Gaussian(sd="s")}, "The likelihood names 's': no such parameter"),
        ({"parameters": {"values": Parameter()}}, "'values' is taken"),
        ({"data": np.array([0.0, np.inf, 1.0])}, "1 of the data are infinite"),
        ({"predict": lambda *a: a[0]}, r"predict takes \*a"),
        ({"predict": lambda a: np.sin(a)}, "predict passes .* to NumPy.*; use jax.numpy in place"),
        (
            {"predict": lambda a: math.sin(a)},
            "predict converts .* to a Python number .* use jax.numpy, and",
        ),
        ({"likelihood": object()}, "object is no likelihood: it lacks least_squares, surrogate"),
        (
            {"parameters": {"a": Parameter(), "b": Tied(lambda values: values["aa"])}},
            "The tie of b asks for 'aa': no such parameter; the nearest is 'a'",
        ),
        (
            {"parameters": {"a": Parameter(shape=(3,), lower=(0, 1))}},
            "bounds, priors and start do not fit a value of shape",
        ),
        (
            {"parameters": {"a": Parameter(shape=(3,), start=(0, 1))}},
            "bounds, priors and start do not fit a value of shape",
        ),
        (
            {"parameters": {"b": Parameter(), "r['a']": np.ones(2)}, "records": {"r": RECORD}},
            r"r\['a'\]: shape \(2,\) does not fit, the record's is \(3,\)",
        ),
    ],
)
def test_an_impossible_problem_is_refused(change, expected):
    predict = (lambda b, r: b * r["a"]) if "records" in change else (lambda a: a * jnp.ones(3))
    whole = {
        "parameters": {"a": Parameter()},
        "predict": predict,
        "likelihood": Gaussian(sd=1.0),
        "data": np.zeros(3),
    }
    with pytest.raises(InputError, match=expected):
        Problem(**(whole | change))


def test_a_function_may_take_all_parameters_by_name():
    problem = Problem(
        {"b": Parameter(start=1.0), "r['a']": Parameter(), "c": 2.0},
        lambda b, r: b + r["a"],
        Gaussian(sd=1.0),
        np.zeros(3),
        records={"r": RECORD},
    )
    values = values_at(problem, jnp.zeros(len(problem.space)))
    assert give(problem, lambda **given: sorted(given), values, None) == ["b", "c", "r", "r['a']"]
    assert give(problem, lambda b, **given: sorted(given), values, None)[0] == "c"


def test_a_fit_that_cannot_start_gives_the_reason():
    problem = Problem({"a": Parameter()}, lambda a: a * jnp.ones(3), Gaussian(sd=1.0), np.zeros(3))
    with pytest.raises(InputError, match="Nothing says where to search for a"):
        fit(problem)
    with pytest.raises(InputError, match="'b' is no free parameter"):
        fit(problem, start={"b": 1.0})
    with pytest.raises(InputError, match="a: its bounds, priors and start do not fit"):
        fit(problem, start={"a": [1.0, 2.0]})
    with pytest.raises(InputError, match="a: start is nan"):
        fit(problem, start={"a": np.nan})


@pytest.mark.parametrize("seed", [-1, 1.5, None, True, 2**32])
def test_an_invalid_seed_is_refused(seed):
    with pytest.raises(InputError, match="give a whole number from 0 to 4294967295"):
        fit(decay_problem(), seed=seed)


@pytest.mark.parametrize(
    ("function", "draws", "expected"),
    [
        (lambda height: height, 0, "draws = 0: give a whole number of at least 1"),
        (lambda height: height, 2.5, r"draws = 2\.5"),
        (lambda height: {"h": height}, 9, "returns a dict, not an array; return one array"),
        (lambda height: (height, jnp.ones(2)), 9, "returns a tuple, not an array"),
        ("height", 9, "'height' is no function"),
        (lambda height: np.sin(height), 9, "The function passes .* to NumPy"),
        (lambda *v: v[0], 9, r"takes \*v: .* take all by name"),
    ],
)
def test_functions_without_derivatives_are_refused(fitted, function, draws, expected):
    with pytest.raises(InputError, match=expected):
        fitted.derived(function, draws=draws)


def test_a_records_value_starts_the_search_inside_the_bounds():
    parameters = {"r['a']": Parameter(lower=2.0, upper=3.0), "r['b']": 2.0}
    records = {"r": {"a": np.array([0.0, 2.5, np.inf]), "b": np.zeros(3)}}
    seen = Problem(
        parameters, lambda r: r["a"] + r["b"], Gaussian(sd=1.0), np.zeros(3), records=records
    )
    assert seen.free[0].start is None  # one of them is not finite
    records["r"]["a"] = np.array([0.0, 2.5, 7.0])
    assert seen.with_records(records).free[0].start == (2.0, 2.5, 3.0)


@pytest.mark.slow
def test_two_optima_that_fit_equally_well_are_reported():
    problem = Problem(
        {"a": Parameter(lower=-3, upper=3)},
        lambda a: a**2 * jnp.ones(50),
        Gaussian(0.1),
        np.ones(50),
    )
    result = fit(problem, starts=8)
    assert not result.converged
    assert any("fit as well" in sentence for sentence in result.failures)


@pytest.mark.slow
def test_parameters_determined_only_by_their_prior_are_reported():
    problem = Problem(
        {"seen": Parameter(start=0.0), "unseen": Parameter(unit="DN", prior=Normal(5.0, 0.5))},
        lambda seen, unseen: seen + 0.01 * unseen * jnp.linspace(0, 1, 9),
        Gaussian(sd=1.0),
        stats.norm.ppf((np.arange(9) * 4 % 9 + 0.5) / 9),
    )
    result = fit(problem)
    assert any("unseen is known from its prior" in sentence for sentence in result.findings)


def test_a_misfit_can_be_inflated(fitted):
    """The noise is twice the stated one, so the intervals double, and the fit counts as
    converged."""
    loud = HEIGHT * np.exp(-RATE * TIME) + 0.05 * np.random.default_rng(8).standard_normal(60)
    assert not fit(decay_problem(loud)).converged
    allowed = fit(decay_problem(loud), misfit="inflate")
    assert allowed.converged
    factor = allowed.misfit.chi_square / allowed.misfit.dof
    np.testing.assert_allclose(
        allowed.estimates[0].standard_error / fitted.estimates[0].standard_error,
        math.sqrt(factor),
        rtol=0.05,
    )


def test_arviz_and_the_report(fitted, tmp_path):
    arviz = pytest.importorskip("arviz")
    data = fitted.to_arviz()
    assert data.posterior["rate"].dims == ("chain", "draw")
    np.testing.assert_array_equal(data.posterior["rate"], fitted.draws["rate"])
    np.testing.assert_array_equal(data.observed_data["data"], fitted.problem.data)
    assert "rate" in arviz.summary(data, var_names=["rate"]).index
    names = {path.name for path in fitted.write(tmp_path)}
    assert names == {"report.html", "results.json", "fit_chains.nc"}
    assert "Before and after the data" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_the_file_of_draws_equals_the_arviz_data(tmp_path):
    arviz = pytest.importorskip("arviz")
    found = fit(
        Problem(
            {"a": Parameter(shape=(2, 2), start=1.0), "b": 0.0},
            lambda a, b: jnp.repeat((a + b).ravel(), 5),
            Gaussian(sd=0.1),
            np.repeat(np.arange(4.0), 5),
        ),
        starts=1,
    )
    found.write(tmp_path)
    given, kept = found.to_arviz(), arviz.from_netcdf(tmp_path / "fit_chains.nc")
    assert kept.posterior["a"].dims == given.posterior["a"].dims
    np.testing.assert_array_equal(kept.posterior["a"], given.posterior["a"])


def coverage(count):
    """Return how often the 68 and 95 % intervals of both parameters cover the true values."""
    inside = np.zeros((2, 2))
    template = decay_problem()
    for i in range(count):
        noise = 0.02 * np.random.default_rng([9, i]).standard_normal(60)
        result = fit(template.with_data(HEIGHT * np.exp(-RATE * TIME) + noise), starts=1, seed=i)
        for j, (estimate, truth) in enumerate(zip(result.estimates, (HEIGHT, RATE), strict=True)):
            for k, (low, high) in enumerate((estimate.interval_68, estimate.interval_95)):
                inside[j, k] += low < truth < high
    return inside


@pytest.mark.parametrize("count", [40, pytest.param(1000, marks=pytest.mark.slow)])
def test_intervals_cover_the_true_values(fitted, count):
    for row in coverage(count):
        for found, level in zip(row, (0.68, 0.95), strict=True):
            low, high = stats.binom.interval(0.999, count, level)
            assert low <= found <= high


@pytest.mark.slow
@pytest.mark.parametrize("below", [1.0, 3.0])
def test_intervals_at_an_active_bound_are_not_those_of_a_flat_direction(below):
    """The data of a positive number are below 0, so the exact posterior is a truncated normal."""
    error, count = 0.02, 25
    spread = np.random.default_rng(0).standard_normal(count)
    data = -below * error + error * np.sqrt(count) * (spread - spread.mean())
    problem = Problem(
        {"a": Parameter(lower=0.0, upper=10.0)},
        lambda a: a * jnp.ones(count),
        Gaussian(sd=error * np.sqrt(count)),
        data,
    )
    exact = scipy.stats.truncnorm(a=below, b=np.inf, loc=-below * error, scale=error).ppf(0.95)
    lower, upper = fit(problem).estimates[0].interval_95  # starts at the bound
    assert lower == 0
    np.testing.assert_allclose(upper, exact, rtol=0.03)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (lambda a: jax.lax.complex(a * jnp.ones(5), jnp.ones(5)), "predict gives complex numbers"),
        (lambda a: (a * jnp.ones(5), a), "predict gives a tuple and no array"),
        (lambda a: None, "predict gives a NoneType and no array"),
    ],
)
def test_a_prediction_of_another_type_is_refused(model, said):
    with pytest.raises(InputError, match=said):
        Problem({"a": Parameter(start=0.0)}, model, Gaussian(sd=1.0), np.zeros(5))


def test_a_likelihood_of_another_shape_and_paths_within_paths_are_refused():
    data, model = np.zeros(5), lambda a: a * jnp.ones(5)
    with pytest.raises(InputError, match="do not fit data of shape"):
        Problem({"a": Parameter(start=0.0)}, model, Gaussian(sd=np.ones((5, 1))), data)
    record = {"r": {"x": jnp.ones(3)}}
    with pytest.raises(InputError, match="part of"):
        Problem(
            {"r['x']": Parameter(), "r['x'][0]": 1.0},
            lambda r: r["x"],
            Gaussian(sd=1.0),
            np.zeros(3),
            records=record,
        )


@pytest.mark.slow
def test_a_misfit_inflates_the_likelihood_and_not_the_prior():
    """The prior is N(1, .001), and the data scatter three times as much as stated."""
    noise = np.random.default_rng(4).standard_normal(50)
    problem = Problem(
        {"a": Parameter(prior=Normal(1.0, 0.001))},
        lambda a: a * jnp.ones(50),
        Gaussian(sd=1.0),
        1 + 3 * noise,
    )
    found = fit(problem, misfit="inflate")
    np.testing.assert_allclose(found.estimates[0].standard_error, 0.001, rtol=1e-3)


@pytest.mark.parametrize("scatter", [1.01, 1.05])
def test_an_inflation_below_2_percent_is_not_reported(scatter):
    noise = np.random.default_rng(4).standard_normal(50)
    noise = scatter * (noise - noise.mean()) / noise.std(ddof=1)
    problem = Problem(
        {"a": Parameter(start=0.0)}, lambda a: a * jnp.ones(50), Gaussian(sd=1.0), 1 + noise
    )
    found = fit(problem, misfit="inflate", starts=2)
    np.testing.assert_allclose(found.estimates[0].standard_error, scatter / 50**0.5, rtol=1e-3)
    assert any("are multiplied by" in one for one in found.findings) == (scatter > 1.02)


@pytest.mark.parametrize("dtype", [np.float16, jnp.bfloat16])
def test_squares_of_half_precision_among_the_inputs_do_not_overflow(dtype):
    codes = np.linspace(0, 800, 26).astype(dtype)
    problem = Problem(
        {"scale": Parameter(start=1.0)},
        predict=lambda scale, inputs: scale * inputs**3,
        likelihood=Gaussian(sd=0.01),
        data=np.zeros(26, dtype),
        inputs=codes,
    )
    found = prediction(problem, {"scale": 2e-6}, inputs=None)
    np.testing.assert_allclose(found, 2e-6 * codes.astype(float) ** 3, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16])
def test_squares_of_codes_among_the_inputs_do_not_overflow(dtype):
    codes = np.linspace(0, np.iinfo(dtype).max, 20).astype(dtype)
    problem = Problem(
        {"scale": Parameter(start=1.0)},
        predict=lambda scale, inputs: scale * (inputs["codes"] ** 3).astype(float),
        likelihood=Gaussian(sd=0.01),
        data=2.0 * (codes / 100.0) ** 3,
        inputs={"codes": codes},
    )
    found = prediction(problem, {"scale": 2e-6}, inputs=None)
    np.testing.assert_allclose(found, 2e-6 * codes.astype(float) ** 3, rtol=1e-6)
