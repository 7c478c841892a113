"""Tests published regressions with certified results: NIST's Statistical Reference Datasets for
nonlinear regression (https://www.itl.nist.gov/div898/strd/).

The sets are those of higher difficulty and one of average, from the harder start if a search
without bounds reaches the optimum from there. The certified results have eleven digits. The
residual standard deviation is taken as known, so that the covariance of the fit is NIST's."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Gaussian, Parameter, Problem, fit


class Regression(NamedTuple):
    """Data and certified results of one set."""

    model: Callable[..., Any]
    x: Any
    y: list[float]
    start: list[float]
    certified: list[float]
    sd: list[float]
    residual_squares: float


def growth(inputs, b1, b2):
    return b1 * (1 - jnp.exp(-b2 * inputs))


def peak(inputs, b1, b2, b3):
    return b1 / b2 * jnp.exp(-0.5 * ((inputs - b3) / b2) ** 2)


def richards(inputs, b1, b2, b3, b4):
    return b1 / (1 + jnp.exp(b2 - b3 * inputs)) ** (1 / b4)


def quadratics(inputs, b1, b2, b3, b4):
    return b1 * (inputs**2 + inputs * b2) / (inputs**2 + inputs * b3 + b4)


def two_decays(inputs, b1, b2, b3, b4, b5):
    return b1 + b2 * jnp.exp(-inputs * b4) + b3 * jnp.exp(-inputs * b5)


def cubics(inputs, b1, b2, b3, b4, b5, b6, b7):
    above = b1 + b2 * inputs + b3 * inputs**2 + b4 * inputs**3
    return above / (1 + b5 * inputs + b6 * inputs**2 + b7 * inputs**3)


# fmt: off
SETS = {
    "BoxBOD": Regression(
        growth, [1, 2, 3, 5, 7, 10], [109, 149, 149, 191, 213, 224],
        start=[1, 1], certified=[213.80940889, 0.54723748542], sd=[12.354515176, 0.10455993237],
        residual_squares=1168.0088766,
    ),
    "Eckerle4": Regression(
        peak,
        np.r_[400:435.1:5, 436.5:465.1:1.5, 470:500.1:5],
        [
            1.575e-4, 1.699e-4, 2.350e-4, 3.102e-4, 4.917e-4, 8.710e-4, 1.7418e-3, 4.64e-3,
            6.5895e-3, 9.7302e-3, 0.0149002, 0.0237310, 0.0401683, 0.0712559, 0.1264458, 0.2073413,
            0.2902366, 0.3445623, 0.3698049, 0.3668534, 0.3106727, 0.2078154, 0.1164354, 0.0616764,
            0.03372, 0.0194023, 0.0117831, 7.4357e-3, 2.2732e-3, 8.8e-4, 4.579e-4, 2.345e-4,
            1.586e-4, 1.143e-4, 7.1e-5,
        ],
        start=[1, 10, 500], certified=[1.5543827178, 4.0888321754, 451.54121844],
        sd=[1.5408051163e-2, 4.6803020753e-2, 4.6800518816e-2], residual_squares=1.4635887487e-3,
    ),
    "Rat43": Regression(
        richards, np.arange(1.0, 16.0),
        [
            16.08, 33.83, 65.8, 97.2, 191.55, 326.2, 386.87, 520.53, 590.03, 651.92, 724.93,
            699.56, 689.96, 637.56, 717.41,
        ],
        start=[100, 10, 1, 1], certified=[699.6415127, 5.2771253025, 0.75962938329, 1.2792483859],
        sd=[16.302297817, 2.0828735829, 0.19566123451, 0.68761936385],
        residual_squares=8786.404908,
    ),
    "MGH09": Regression(
        quadratics, [4, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625],
        [0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246],
        start=[0.25, 0.39, 0.415, 0.39],
        certified=[0.19280693458, 0.19128232873, 0.12305650693, 0.13606233068],
        sd=[1.1435312227e-2, 0.19633220911, 8.0842031232e-2, 9.0025542308e-2],
        residual_squares=3.0750560385e-4,
    ),
    "MGH17": Regression(
        two_decays, 10.0 * np.arange(33),
        [
            0.844, 0.908, 0.932, 0.936, 0.925, 0.908, 0.881, 0.85, 0.818, 0.784, 0.751, 0.718,
            0.685, 0.658, 0.628, 0.603, 0.58, 0.558, 0.538, 0.522, 0.506, 0.49, 0.478, 0.467,
            0.457, 0.448, 0.438, 0.431, 0.424, 0.42, 0.414, 0.411, 0.406,
        ],
        start=[0.5, 1.5, -1, 0.01, 0.02],
        certified=[0.37541005211, 1.9358469127, -1.4646871366, 1.286753464e-2, 2.2122699662e-2],
        sd=[2.0723153551e-3, 0.22031669222, 0.22175707739, 4.4861358114e-4, 8.9471996575e-4],
        residual_squares=5.4648946975e-5,
    ),
    "Thurber": Regression(
        cubics,
        [
            -3.067, -2.981, -2.921, -2.912, -2.84, -2.797, -2.702, -2.699, -2.633, -2.481, -2.363,
            -2.322, -1.501, -1.46, -1.274, -1.212, -1.1, -1.046, -0.915, -0.714, -0.566, -0.545,
            -0.4, -0.309, -0.109, -0.103, 0.01, 0.119, 0.377, 0.79, 0.963, 1.006, 1.115, 1.572,
            1.841, 2.047, 2.2,
        ],
        [
            80.574, 84.248, 87.264, 87.195, 89.076, 89.608, 89.868, 90.101, 92.405, 95.854,
            100.696, 101.06, 401.672, 390.724, 567.534, 635.316, 733.054, 759.087, 894.206,
            990.785, 1090.109, 1080.914, 1122.643, 1178.351, 1260.531, 1273.514, 1288.339,
            1327.543, 1353.863, 1414.509, 1425.208, 1421.384, 1442.962, 1464.35, 1468.705,
            1447.894, 1457.628,
        ],
        start=[1000, 1000, 400, 40, 0.7, 0.3, 0.03],
        certified=[
            1288.13968, 1491.0792535, 583.23836877, 75.416644291, 0.96629502864, 0.39797285797,
            4.9727297349e-2,
        ],
        sd=[
            4.6647963344, 39.571156086, 28.698696102, 5.567537027, 3.1333340687e-2,
            1.4984928198e-2, 6.5842344623e-3,
        ],
        residual_squares=5642.7082397,
    ),
}
# fmt: on


@pytest.mark.sweep
@pytest.mark.parametrize("name", SETS)
def test_certified_estimates_and_standard_errors_are_reproduced(name):
    regression = SETS[name]
    count, free = len(regression.y), len(regression.certified)
    names = [f"b{i + 1}" for i in range(free)]
    problem = Problem(
        {each: Parameter(start=value) for each, value in zip(names, regression.start, strict=True)},
        regression.model,
        Gaussian(sd=np.sqrt(regression.residual_squares / (count - free))),
        np.array(regression.y),
        inputs=np.array(regression.x, float),
    )
    result = fit(problem, starts=1)
    found = np.array([result.values[each] for each in names])
    assert result.converged
    # Estimates agree within 1e-6 of a standard error, and standard errors to six digits.
    np.testing.assert_array_less(
        np.abs(found - regression.certified), 1e-6 * np.array(regression.sd)
    )
    covariance = np.linalg.inv(result.optimum.information)
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance)), regression.sd, rtol=1e-6)
    assert result.misfit.chi_square == pytest.approx(count - free, rel=1e-8)
