"""Tests that a mosaic whose frames were mirrored or cropped is detected by its two greens."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting.noise.sites import COLOUR_SITES, unequal_greens

LIGHT = np.linspace(0.0, 1000.0, 5)  # the first has stray light only


def measured(signal):
    """Return a site with 60 DN without light."""
    return SimpleNamespace(
        bright=SimpleNamespace(light=LIGHT, mean=60 + signal * LIGHT),
        dark=SimpleNamespace(mean=np.array([60.0])),
        dark_of=np.zeros(5, int),
    )


@pytest.mark.parametrize(
    ("signals", "named"),
    [
        ((0.5, 1.0, 1.01, 0.3), False),  # RGGB, as stated
        ((1.0, 0.5, 0.3, 1.01), True),  # GRBG: a crop by one column
        ((1.0, 0.3, 0.5, 0.99), True),  # GBRG
        ((0.5, 1.0, 1.24, 0.37), False),  # rows of two amplifiers
        ((1.0, 1.0, 1.0, 1.0), False),  # a monochrome camera
    ],
)
def test_another_phase_of_a_mosaic_is_named(signals, named):
    sites = dict(zip(COLOUR_SITES, map(measured, signals), strict=True))
    said = unequal_greens(sites)
    assert bool(said) == named
    assert not unequal_greens({"green 1": sites["green 1"]})
    for own in sites.values():
        own.bright.light = 0 * LIGHT
    assert not unequal_greens(sites)
