"""Raw to picture by hand, and the codes that a file holds."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision.develop import develop, to_integers
from jaxvision.scene import SRGB, Development, Gamma

RAW = jnp.asarray([[54.0, 64.0, 564.0, 1064.0]])


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ({}, [54, 64, 564, 1064]),
        ({"black_level": 64}, [-10, 0, 500, 1000]),
        ({"white_level": 1064}, [54 / 1064, 64 / 1064, 564 / 1064, 1]),
        ({"black_level": 64, "white_level": 1064}, [-0.01, 0, 0.5, 1]),
        ({"black_level": 64, "white_level": 1064, "tone": Gamma(2.0)}, [0, 0, np.sqrt(0.5), 1]),
        # 0.735357: sRGB of 0.5, as every converter gives it (code 188 of 255)
        ({"black_level": 64, "white_level": 1064, "tone": SRGB()}, [-0.1292, 0, 0.735357, 1]),
    ],
)
def test_steps(steps, expected):
    np.testing.assert_allclose(develop(RAW, Development(**steps))[0], expected, atol=5e-7)


def test_integers():
    x = jnp.asarray([-0.5, 0.0, 0.5 / 255, 1.2 / 255, 1.0, 7.0, np.nan])
    codes = to_integers(x)
    assert codes.dtype == jnp.uint8
    np.testing.assert_array_equal(codes, [0, 0, 0, 1, 255, 255, 0])
    deep = to_integers(jnp.asarray([0.5, 1.0], jnp.float32), bits=16)
    assert deep.dtype == jnp.uint16
    np.testing.assert_array_equal(deep, [32768, 65535])


def test_every_code_survives_a_round_trip():
    for bits in (8, 16):
        codes = np.arange(2**bits)
        back = to_integers(jnp.asarray(codes / (2**bits - 1), jnp.float32), bits=bits)
        np.testing.assert_array_equal(back, codes)


def test_other_depths_are_refused():
    with pytest.raises(ValueError, match="bits must be 8 or 16, got 12"):
        to_integers(RAW, bits=12)
