"""Tests that frames of labels, masks or thresholded numbers are refused."""

import numpy as np
import pytest

from fitting import noise
from jaxvision.errors import InputError


@pytest.mark.parametrize("codes", [(0, 1), (0, 255), (10, 11, 12, 13)])
def test_frames_of_few_codes_are_refused(codes):
    """The codes are random, with a mean that rises with the light, and a variance that rises with
    the mean."""
    rng, light = np.random.default_rng(0), np.linspace(0.1, 0.45, 8)

    def frames(share):
        chances = [1 - share, *[share / (len(codes) - 1)] * (len(codes) - 1)]
        return [rng.choice(codes, (32, 32), p=chances).astype(np.uint8) for _ in range(2)]

    camera = noise.Camera(bits=8)
    flats, darks = [frames(one) for one in light], [frames(0.02) for _ in light]
    with pytest.raises(InputError, match="all flats together hold only the values"):
        noise.from_frames(flats, darks, list(light), 1000 * light, camera=camera)
