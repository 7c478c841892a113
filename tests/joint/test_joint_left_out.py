"""Tests stated errors that are negligible in a fit: their bound from pixels in NumPy, and what is
traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_joint import BALL, BLACK, GAIN, READ, photographs, primitives

from fitting.joint import calibrate, from_photographs
from fitting.joint.model import log_likelihood
from fitting.joint.section import section
from fitting.rig import Camera


@pytest.mark.slow
def test_a_negligible_error_is_left_out_of_the_likelihood():
    """The bound equals the one from single pixels. The error is not traced, and the report lists
    it."""
    images, lights = photographs(np.random.default_rng(0), gamma=1, scatter=0.0)
    exact = Camera(bits=12, black_level=BLACK, gain=GAIN, read_noise=READ)
    ball: dict = BALL
    measured = from_photographs(images, lights, camera=exact, **ball, intensity_sd=1e-5)
    found = calibrate(measured, model="phong")
    (gone,) = found.fits[0].left_out
    signal = np.maximum(np.asarray(images[:6], float) - BLACK, 0)
    signal[signal < 20] = 0
    scale = 1e-5 * 1.6**3
    of_images = (scale**2 * signal**2 / (GAIN * signal + (GAIN * READ) ** 2 + 1 / 12)).sum((1, 2))
    moved = np.sqrt(((np.sqrt(1 + of_images) - 1) ** 2).sum())
    assert gone.name == "light_scatter"
    assert gone.bound == pytest.approx(moved, rel=0.15)
    assert gone.bound <= 0.1
    fit = found.fits[0]
    traced = primitives(jax.make_jaxpr(log_likelihood)(jnp.asarray(fit.vector), fit.data).jaxpr)
    assert "cholesky" not in traced
    (table,) = (t for t in section(found).tables if t.title == "Left out")
    assert table.rows == (("grey", "light_scatter", gone.size, gone.bound),)
