"""Tests that options without effect, and numbers that are clipped to their range, are named in one
sentence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import filters
from jaxvision.filters.padding import pad

PICTURE = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
CODES = np.arange(12, dtype=np.uint8).reshape(3, 4)
ONES = jnp.ones(3)
IDLE = {
    "fill of pad": (
        lambda: pad(PICTURE, ((1, 1), (1, 1)), border="mirror", fill=0.5),
        "fill has no",
    ),
    "fill of correlate": (lambda: filters.correlate(PICTURE, np.ones((3, 3)), fill=0.5), "fill"),
    "fill of gaussian": (lambda: filters.gaussian(PICTURE, 1.0, border="zero", fill=0.5), "fill"),
    "fill of warp": (lambda: filters.warp(PICTURE, CODES / 9.0, CODES / 9.0, fill=0.5), "fill"),
    "fill of gaussian_varying": (
        lambda: filters.gaussian_varying(PICTURE, PICTURE, sigmas=(0.5, 1.0), fill=0.5),
        "fill",
    ),
    "truncate": (lambda: filters.gaussian(PICTURE, 1.0, size=5, truncate=3.0), "beside a size"),
    "first_to_zero": (
        lambda: jv.histogram.equalise(PICTURE, value_range=(0, 1), first_to_zero=False),
        "not of integers",
    ),
    "quantile": (
        lambda: jv.separate(jnp.ones((1, 3)), ONES, body=jnp.eye(3)[0], quantile=0.1),
        "beside a body colour",
    ),
}


@pytest.mark.parametrize("case", IDLE)
def test_an_option_without_effect_is_named(case):
    call, words = IDLE[case]
    with pytest.warns(UserWarning, match=words) as said:
        call()
    assert len(said) == 1


def test_an_option_with_effect_or_at_its_default_is_not_named():
    pad(PICTURE, ((1, 1), (1, 1)), border="constant", fill=0.5)
    filters.gaussian(PICTURE, 1.0, border="mirror", fill=0.0, truncate=3.0)
    jax.jit(lambda fill: filters.gaussian(PICTURE, 1.0, border="zero", fill=fill))(0.5)
    jv.histogram.equalise(CODES, first_to_zero=False)


@pytest.mark.parametrize("quality", [0.9, 0, 101])
def test_a_quality_outside_of_its_range_is_named(quality):
    """0.9 of 1 is not 90 of 100."""
    with pytest.warns(UserWarning, match=f"from 1 to 100, got {quality:g}"):
        jv.development.quantisation_tables(quality)
