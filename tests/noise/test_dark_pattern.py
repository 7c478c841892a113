"""Tests that darks taken at a higher temperature or another gain than the flats are detected by
their fixed pattern."""

import re

import numpy as np
import pytest

from fitting import noise

SIZE, BLACK, GAIN, READ = 64, 64.0, 0.25, 4.0
PHOTONS = np.linspace(300, 14000, 8)


def transfer(seed, *, warmer=1.0, gain=1.0, unequal=1.0, dsnu=1.0, prnu=0.01, count=2, taps=0):
    """Return flats whose light and dark current grow with time, and darks with another current or
    gain."""
    rng = np.random.default_rng(seed)
    shape = count, SIZE, SIZE
    offsets = dsnu * rng.standard_normal((SIZE, SIZE))
    currents = 50 * rng.gamma(1 / unequal**2, unequal**2, (SIZE, SIZE))  # e-/s
    odd = np.arange(SIZE) % 2
    offsets = offsets + 100 * taps * odd
    efficiency = 0.5 * (1 + taps * odd) * (1 + prnu * rng.standard_normal((SIZE, SIZE)))

    def frames(light, current, gain):
        electrons = rng.poisson(light + current, shape) + offsets + rng.normal(0, READ, shape)
        codes = np.clip(np.round(gain * GAIN * electrons + BLACK), 0, 4095).astype(np.uint16)
        codes[:, 5, 7:9] = 4095, 900  # stuck pixels
        return list(codes)

    times = PHOTONS / 7000
    flats = [frames(efficiency * p, currents * t, 1.0) for p, t in zip(PHOTONS, times, strict=True)]
    darks = [frames(0 * efficiency, warmer * currents * t, gain) for t in times]
    camera = noise.Camera(bits=12)
    return noise.from_frames(flats, darks, list(times), PHOTONS, camera=camera)


def share_of(measurement):
    told = " ".join(measurement.remarks)
    found = re.search(r"in the flats (\S+) ± (\S+) times", told)
    return None if found is None else tuple(map(float, found.groups()))


@pytest.mark.parametrize(
    ("options", "truth"), [({"warmer": 4.0}, 0.25), ({"gain": 1.3, "dsnu": 4.0}, 1 / 1.3)]
)
def test_darks_of_another_current_or_gain_are_named(options, truth):
    share, error = share_of(transfer(0, **options))
    assert abs(share - truth) < 4 * error + 0.03 * ("warmer" in options)  # with equal offsets


def test_matching_darks_are_not_named():
    for seed in range(2):
        assert share_of(transfer(seed)) is None


@pytest.mark.slow
def test_matching_darks_are_never_named():
    """This holds also with large offsets, unequal sensitivities, a uniform dark current, and
    taps."""
    for seed in range(8):
        for options in ({}, {"dsnu": 10.0}, {"prnu": 0.05}, {"unequal": 0.1}, {"taps": 0.2}):
            assert share_of(transfer(seed, **options)) is None
