"""Tests that copies of an image are named, and images that may be equal are not."""

import re

import numpy as np
import pytest

from fitting.copies import Copies
from fitting.noise import from_frames
from fitting.response import from_stack
from fitting.rig import Camera
from jaxvision.errors import InputError


def flats(levels=(200, 900, 1600, 1900, 2200, 2900, 5000)):
    """Return two 12-bit frames for each level of photons, and darks, with 1 DN per electron."""
    rng = np.random.default_rng(0)
    lit = [np.clip(64 + rng.poisson(level, (2, 24, 24)), 0, 4095) for level in levels]
    return lit, [np.round(rng.normal(64, 2, (2, 24, 24)))], levels


def photon_transfer(lit, dark, levels):
    return from_frames(
        lit, dark, [0.1] * len(levels), levels, dark_exposures=[0.1], camera=Camera(bits=12)
    )


def test_a_copied_flat_is_left_out_by_name_and_saturated_ones_are_not():
    lit, dark, levels = flats()
    assert np.ptp(lit[-1]) == 0  # saturated frames are equal and accepted
    assert photon_transfer(lit, dark, levels).bright.left_out == ()
    lit[2][1] = lit[2][0]
    left_out = photon_transfer(lit, dark, levels).bright.left_out
    assert left_out[0].startswith("flats[2][1] was left out: equal to flats[2][0] in every pixel")
    assert left_out[1].startswith("flats[2][0] was left out: it is the only remaining frame")


def test_a_flat_that_is_in_another_level_too_is_left_out_by_name():
    lit, dark, levels = flats((200, 500, 900, 1600, 1600, 1900, 2200, 2900, 5000))
    lit[3][1] = lit[4][0]
    bright = photon_transfer(lit, dark, levels).bright
    both = "flats[3][1] and flats[4][0] are equal in every pixel"
    assert bright.left_out[0].startswith(f"flats[3][1] was left out: {both}, so at most one")
    assert bright.left_out[1].startswith(f"flats[4][0] was left out: {both}, so at most one")
    assert len(bright.left_out) == 4  # with the others of their levels
    assert list(bright.light) == [200, 500, 900, 1900, 2200, 2900, 5000]


def test_frames_without_light_may_be_equal():
    lit, dark, levels = flats((50, 200, 900, 1600, 2200, 2900, 5000))
    die = np.arange(24 * 24).reshape(24, 24) % 3 + 63.0
    lit[0][:] = die
    assert photon_transfer(lit, dark, (0, *levels[1:])).bright.left_out == ()
    assert "in every pixel" in photon_transfer(lit, dark, levels).bright.left_out[0]


def test_a_copied_exposure_is_left_out_by_name():
    rng = np.random.default_rng(0)
    scene = rng.uniform(0, 60, (32, 32))
    times = [0.5, 1.0, 2.0, 4.0, 8.0]
    stack = [np.clip(scene * t + rng.normal(0, 1, scene.shape), 0, 255).round() for t in times]
    camera = Camera(bits=8)
    assert not from_stack(stack, times, camera=camera).remarks
    found = from_stack([*stack[:2], stack[1], *stack[3:]], times, camera=camera)
    told = [one for one in found.remarks if "equal in every pixel" in one]
    assert len(told) == 2
    assert list(found.planes[0].exposures) == [0.5, 4.0, 8.0]
    with pytest.raises(InputError, match=r"equal in every pixel.*Keep those that belong"):
        from_stack([stack[0], stack[1], stack[1]], times[:3], camera=camera)


def test_white_frames_with_dead_pixels_are_not_called_copies():
    rng, copies = np.random.default_rng(0), Copies()
    white = np.full((40, 40), 255.0)
    white[3, 4], white[7, 2] = 0, 31
    for name in ("a", "b"):
        copies.add(name, white)
    grey = rng.uniform(0, 255, (40, 40))
    for name in ("c", "d", "e"):
        copies.add(name, grey)
    assert copies.equal_groups == [["c", "d", "e"]]


def test_one_set_of_darks_under_all_exposures_gives_no_dark_current():
    """Earlier, a dark current of 40 e-/s was estimated as 0.00 +- 0.60."""
    rng = np.random.default_rng(0)
    levels, times = np.linspace(200, 3000, 7), np.linspace(0.1, 0.7, 7)

    def pair(electrons):
        return np.round(64 + rng.poisson(electrons, (2, 32, 32)) + rng.normal(0, 2, (2, 32, 32)))

    lit = [pair(level + 40 * t) for level, t in zip(levels, times, strict=True)]
    darks = [pair(40 * t) for t in times]
    for given, exposures, names in (
        ([darks[0]] * 7, times[:1], r"darks\[1\]\[0\], .* and 9 more"),
        (
            [*darks[:3], darks[2], *darks[4:]],
            times[[0, 1, 4, 5, 6]],
            r"darks\[2\]\[0\], .*\[3\]\[1\]",
        ),
    ):
        found = from_frames(lit, given, list(times), list(levels), camera=Camera(bits=12))
        np.testing.assert_allclose(found.dark.exposure, exposures)
        (told,) = found.dark.left_out
        assert re.match(names + " were left out: they are equal in every pixel to darks", told)
