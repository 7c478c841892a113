"""Time a user's first fit of their own model, in a new process with empty caches.

    pytest tests/benchmarks/bench_first_fit.py -m benchmark -s

The model has seven bounded parameters (a Phong lobe, an offset and a gamma), 4,800 data and 16
starts. SciPy's `least_squares` from one start is timed for comparison."""

from functools import partial

import pytest
from bench_first_picture import by_a_new_user
from turns import in_turns

MODEL = """
import numpy as np
y, x = np.mgrid[-.7:.7:60j, -.7:.7:80j]
normal = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], -1)
truth = dict(diffuse=.5, specular=.35, shininess=18., azimuth=.7, tilt=.5, offset=.04, gamma=1.9)
low, high = [.01, .001, 1, -3.1, .01, 0, .8], [2, 2, 300, 3.1, 1.5, .5, 3.5]

def predict(diffuse, specular, shininess, azimuth, tilt, offset, gamma, inputs, xp=np):
    sine = xp.sin(tilt)
    light = xp.stack([sine * xp.cos(azimuth), sine * xp.sin(azimuth), xp.cos(tilt)])
    cos = inputs @ light
    lobe = xp.maximum(2 * cos * inputs[..., 2] - light[2], 1e-6) ** shininess
    radiance = offset + diffuse * xp.maximum(cos, 0) + specular * lobe
    return xp.maximum(radiance, 1e-6) ** (1 / gamma)

data = predict(**truth, inputs=normal)
data = data + .01 * np.random.default_rng(0).standard_normal(data.shape)
"""
OURS = """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp
from fitting import Gaussian, Parameter, Problem, fit
free = {name: Parameter(lower=a, upper=b) for name, a, b in zip(truth, low, high)}

def model(diffuse, specular, shininess, azimuth, tilt, offset, gamma, inputs):
    every = diffuse, specular, shininess, azimuth, tilt, offset, gamma
    return predict(*every, inputs, xp=jnp)

problem = Problem(free, model, Gaussian(sd=.01), data, inputs=normal)
for _ in range(FITS):
    assert fit(problem).converged
"""
SCIPY = """
from scipy.optimize import least_squares
start = np.array(list(truth.values())) * 1.2
least_squares(lambda p: (predict(*p, normal) - data).ravel() / .01, start, bounds=(low, high))
"""


@pytest.mark.benchmark
def test_first_fit():
    rivals = {
        "ours, first": partial(by_a_new_user, MODEL + OURS.replace("FITS", "1")),
        "ours, six": partial(by_a_new_user, MODEL + OURS.replace("FITS", "6")),
        "SciPy, one start": partial(by_a_new_user, MODEL + SCIPY),
    }
    _, seconds = in_turns(rivals, rounds=3, settled=0)
    for name, taken in seconds.items():
        print(f"{name:18s} {taken:6.2f} s")
