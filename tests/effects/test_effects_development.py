"""Tests the error factors of the steps of a development with pairs of raw pictures."""

from dataclasses import fields, replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import scene as s
from jaxvision.development import develop
from jaxvision.effects.development import BOUNDS, FILMIC_SLOPE, development_stage, lipschitz
from jaxvision.effects.stages import Draft, Ends
from jaxvision.sensor.colour_filters import bayer

MATRIX = [[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]]
STEPS = {
    "white_level": {"black_level": 60.0, "white_level": 1000.0},
    "bilinear": {"demosaicing": s.Demosaicing(bayer("RGGB"), method="bilinear")},
    "malvar": {"demosaicing": s.Demosaicing(bayer("GRBG"), method="malvar")},
    "normalised": {"demosaicing": s.Demosaicing(((0, 1), (1, 2)), method="normalised")},
    "white_balance": {"white_balance": s.WhiteBalance([2.0, 1.0, 1.5]), "saturation": 300.0},
    "colour_matrix": {"colour_matrix": MATRIX},
    "reinhard": {"tone_map": s.Reinhard()},
    "reinhard to white": {"tone_map": s.Reinhard(0.7)},
    "filmic": {"tone_map": s.Filmic()},
    "curve": {"tone_map": s.ToneCurve([0.0, 0.2, 0.5, 1.0], [0.0, 0.1, 0.8, 1.0])},
    "sRGB": {"tone": s.SRGB()},
    "sharpening": {"sharpening": s.UnsharpMask(1.0, 0.8)},
}
NONE = {
    "menon": {"demosaicing": s.Demosaicing(bayer("RGGB"), method="menon")},
    "grey world": {"white_balance": s.GreyWorld()},
    "bilateral": {"denoising": s.Bilateral(1.0, 0.1)},
    "nonlocal": {"denoising": s.NonLocalMeans(0.1)},
    "gamma": {"tone": s.Gamma(2.2)},
    "JPEG": {"compression": s.JPEG(90.0)},
}
IDENTITIES = {
    "black_level": {"black_level": 0.0},
    "white_level": {"white_level": 1.0},
    "white_balance": {"white_balance": s.WhiteBalance([1.0, 1.0, 1.0])},
    "denoising": {"denoising": s.Bilateral(1.0, 0.1, radius=0)},
    "colour_matrix": {"colour_matrix": np.eye(3)},
    "sharpening": {"sharpening": s.UnsharpMask(1.0, 0.0)},
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", STEPS)
def test_the_difference_of_two_pictures_grows_by_at_most_the_factor(name):
    """The pairs are random and, for linear steps, the worst case: the signs of a row of the
    filter."""
    steps = s.Development(**STEPS[name])
    rng = np.random.default_rng(3)
    mosaic = steps.demosaicing is not None
    shape = (12, 14, 1 if mosaic else 3)
    scale = 1000.0 if name in ("white_level", "white_balance") else 1.0
    factor, most = lipschitz(steps).value, 0.0
    pictures = [rng.uniform(0, scale, shape), rng.uniform(0, 0.3 * scale, shape)]
    moves = [1e-3 * scale * rng.choice([-1.0, 1.0], shape) for _ in range(20)]
    moves.append(1e-3 * scale * np.ones(shape))
    for picture in pictures:
        for move in moves:
            before = np.asarray(develop(jnp.asarray(picture), steps))
            after = np.asarray(develop(jnp.asarray(picture + move), steps))
            most = max(most, np.abs(after - before).max() / (1e-3 * scale))
    assert most <= factor * (1 + 1e-6)
    assert factor <= 4 * most


def test_factors_multiply():
    steps = s.Development(**STEPS["white_level"], colour_matrix=MATRIX, tone=s.SRGB())
    assert lipschitz(steps).value == pytest.approx(2.2 * 12.92 / 940)
    assert lipschitz(None).identity


@pytest.mark.parametrize("name", NONE)
def test_steps_without_a_factor_give_the_reason(name):
    factor = lipschitz(s.Development(**NONE[name]))
    assert factor.value == np.inf
    assert factor.why


def test_the_slope_of_the_film_curve_is_the_largest():
    x = np.linspace(0, 4, 400001)
    curve = x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
    assert FILMIC_SLOPE * 0.999 <= (np.diff(curve) / np.diff(x)).max() <= FILMIC_SLOPE


@pytest.mark.parametrize("name", IDENTITIES)
def test_a_step_that_changes_nothing_can_be_dropped(name):
    steps = s.Development(**IDENTITIES[name])
    (row,) = development_stage(Ends(steps, steps))
    assert (row.effect.name, row.effect.rank) == (f"development.{name}", "exact")
    view = s.Orthographic(np.zeros(3), np.eye(3), 1.0, resolution=(2, 2))
    draft = Draft((), (), frozenset(), None, s.Camera(view, s.Sensor(), steps))
    left = row.drop(draft).camera.development
    assert left == replace(steps, **{name: None})


def test_other_steps_stay():
    steps = s.Development(**STEPS["sRGB"], compression=s.JPEG(90.0))
    rows = development_stage(Ends(steps, steps))
    assert all(row.drop is None and row.effect.why for row in rows)


def test_every_step_has_its_row():
    assert set(BOUNDS) == {field.name for field in fields(s.Development)}
