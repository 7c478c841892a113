"""Tests aberrations estimated from edges, blurred by point images integrated along the edge."""

import jax
import numpy as np
import pytest
from test_from_edge import NODES, noisy, places

import jaxvision as jv
from fitting import resolution
from fitting.resolution import aberrations
from jaxvision.errors import InputError

WAVE, F_NUMBER, PITCH = 550e-9, 8.0, 4e-6
TRUTH = {4: 20.0, 5: 30.0, 6: -25.0, 7: -35.0, 8: 20.0, 11: 40.0}  # nm


def edge_spread(angle, coefficients, pitch=PITCH):
    """Return distances in pixels, and the edge spread.

    The point image at x, summed along the edge, is the integral over all chords across the edge of
    |integral of exp(2 pi i W / lambda - i pi u x / (lambda N)) du|^2 (Parseval). Beyond 20 lambda N
    both sides have equal shares."""
    nodes, weights = np.polynomial.legendre.leggauss(110)
    t, outer = np.polynomial.legendre.leggauss(40)
    v, half = np.sin(np.pi / 2 * t), np.cos(np.pi / 2 * t)
    outer = np.pi / 2 * half * outer
    u = half[:, None] * nodes
    turn = np.radians(angle)
    x = u * np.cos(turn) - v[:, None] * np.sin(turn)
    y = u * np.sin(turn) + v[:, None] * np.cos(turn)
    z = np.asarray(jv.optics.zernike(x, y, count=11))
    error = sum(1e-9 * value * z[..., term - 1] for term, value in coefficients.items())
    pupil = half[:, None] * weights * np.exp(2j * np.pi * error / WAVE)
    place = np.linspace(-20, 20, 801)  # in lambda N
    line = np.array(
        [outer @ np.abs((pupil * np.exp(-1j * np.pi * u * s)).sum(1)) ** 2 for s in place]
    )
    line /= 2 * np.pi  # its integral over s is 2 pi
    step = place[1] - place[0]
    share = np.r_[0, np.cumsum((line[1:] + line[:-1]) / 2)] * step
    return place * WAVE * F_NUMBER / pitch, share + (1 - share[-1]) / 2


def picture(angle, place, coefficients, shape=(40, 40), low=100.0, high=2000.0):
    """Return the edge in square pixels, with means over 16 x 16 positions."""
    distance = places(shape, angle, place)
    x, y = np.meshgrid(NODES, NODES)
    inside = np.cos(np.radians(angle)) * x + np.sin(np.radians(angle)) * y
    fine = np.linspace(distance.min(), distance.max(), 1500)
    spread = edge_spread(angle, coefficients)
    light = np.interp(fine[:, None] + inside.ravel(), *spread).mean(axis=1)
    return low + (high - low) * np.interp(distance, fine, light)


def pictures(seed, focus=(-60e-9, 60e-9), angles=(5.0, 65.0, 125.0), side=32):
    """Return edges at each angle for each known defocus, in m."""
    rng, found, defocus = np.random.default_rng(seed), [], []
    for added in focus:
        own = TRUTH | {4: TRUTH[4] + 1e9 * added}
        for angle in angles:
            mean = picture(angle, rng.uniform(-0.5, 0.5), own, (side, side))
            found.append(noisy(mean, rng))
            defocus.append(added)
    return found, defocus


def test_the_edge_spread_is_the_integral_of_the_point_image():
    """Predicted pixels equal those of `picture`, whose edge spread does not use the transfer
    function."""
    own = [[50.0, 0.2, 100.0, 2000.0, 0.0, 0.0, 0.0]]
    y, x = np.indices((20, 20)) - 9.5
    with jax.enable_x64(True):
        predict = aberrations._aberrated_edges(tuple(TRUTH), 24.0, PITCH / (WAVE * F_NUMBER))
        inputs = {
            "wave": np.array([WAVE]),
            "f_number": F_NUMBER,
            "pitch": PITCH,
            "defocus": np.zeros(1),
            "black": 0.0,
            "aperture": None,
            "own": np.stack([own, np.zeros_like(own)], axis=-1),
            "x": x.reshape(1, -1),
            "y": y.reshape(1, -1),
        }
        named = {f"z{term}": value for term, value in TRUTH.items()}
        found = jax.jit(predict)(inputs, np.zeros((1, 7)), **named).reshape(20, 20)
    wanted = picture(50.0, 0.2, TRUTH, (20, 20))
    np.testing.assert_allclose(found, wanted, atol=0.002 * 1900)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"terms": (2, 4)}, "terms are"),
        ({"defocus": [1e-8, 0.0]}, "give one number for each of 1 images"),
        ({"wavelength": -WAVE}, "above 0"),
    ],
)
def test_impossible_lenses_are_refused(options, words):
    lens: dict = {"wavelength": WAVE, "f_number": F_NUMBER, "pixel_pitch": PITCH} | options
    with pytest.raises(InputError, match=words):
        resolution.wavefront_from_edges([np.ones((32, 32))], **lens)


@pytest.mark.parametrize(
    ("terms", "angles", "one_focus", "words"),
    [
        ((4, 7), (5.0, 65.0, 125.0), True, r"sign of the terms \[4\]; give pictures at two known"),
        ((4, 5, 6, 11), (5.0, 5.1), False, r"do not determine the terms \[4, 5, 6\] separately"),
    ],
)
def test_undetermined_aberrations_are_refused(terms, angles, one_focus, words):
    with pytest.raises(InputError, match=words):
        aberrations._refuse_undetermined(terms, np.array(angles), one_focus)


@pytest.mark.parametrize(
    ("terms", "angles", "one_focus"),
    [((7, 8, 9, 10), (5.0, 65.0, 125.0), True), ((4, 5, 6, 11), (5.0, 65.0, 125.0), False)],
)
def test_determined_aberrations_are_accepted(terms, angles, one_focus):
    aberrations._refuse_undetermined(terms, np.array(angles), one_focus)


@pytest.mark.slow
def test_intervals_of_aberrations_cover_the_true_values():
    z = []
    lens: dict = {"wavelength": WAVE, "f_number": F_NUMBER, "pixel_pitch": PITCH}
    for seed in range(10):
        images, defocus = pictures(seed)
        found = resolution.wavefront_from_edges(images, **lens, defocus=defocus)
        assert found.converged
        z += [
            (e.value - TRUTH.get(int(e.name[1:]), 0.0)) / e.standard_error
            for e in found.estimates
            if e.name[0] == "z" and e.value is not None and e.standard_error is not None
        ]
    assert len(z) == 80
    assert np.mean(np.abs(z) < 1.96) > 0.88
    assert 0.6 < np.mean(np.square(z)) < 1.5
