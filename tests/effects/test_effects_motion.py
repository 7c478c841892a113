"""Tests the bound on displacements by a motion, against pictures of bright bodies traced in
NumPy."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import Lambert, PointLight
from jaxvision import scene as s
from jaxvision.effects.motion import moments_of, motion_stage
from jaxvision.effects.stages import Ends

SHAPE, PITCH, FOCAL = (24, 32), 1e-4, 0.004
BALL, CARD = np.array([0.3, -0.1, 3.0]), np.array([-0.6, -0.5, 4.0])
SENSOR = s.Sensor(exposure_time=0.02, shutter=s.RollingShutter(1e-3))


def scene():
    matt = Lambert([0.5])
    card = s.Surface(s.Quad(CARD, [0.8, 0.0, 0.3], [0.0, 0.9, 0.0]), matt)
    ball = s.Surface(s.Sphere(BALL, 0.4), matt)
    return s.Scene(surfaces=(ball, card), lights=(PointLight([0, 0, 0], [1.0]),))


def pinhole(**changes):
    return s.Pinhole(np.zeros(3), np.eye(3), FOCAL, PITCH, resolution=SHAPE, **changes)


def turned(angle):
    c, k = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, k], [0, 1, 0], [-k, 0, c]])


class Moving:
    """A ball that moves, and a camera that moves and rotates, at constant speeds."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.ball = rng.normal(0, 6, 3)
        self.camera = rng.normal(0, 2, 3) * (seed % 3 > 0)
        self.turn = rng.normal(0, 1.5) * (seed % 3 > 1)

    def __call__(self, scene, view, time):
        t = float(time)
        ball, card = scene.surfaces
        ball = replace(ball, shape=replace(ball.shape, centre=BALL + t * self.ball))
        moved = replace(scene, surfaces=(ball, card))
        return moved, replace(view, position=t * self.camera, rotation=turned(t * self.turn))

    def picture(self, time, rows, columns):
        """Return the colours 0 (nothing), 1 (the ball) and 2 (the card) at pixel coordinates, by
        intersection."""
        x = (columns - (SHAPE[1] - 1) / 2) * PITCH / FOCAL
        y = (rows - (SHAPE[0] - 1) / 2) * PITCH / FOCAL
        d = np.stack([x, y, np.ones_like(x)], -1) @ turned(time * self.turn)
        d = d / np.linalg.norm(d, axis=-1, keepdims=True)
        o = time * self.camera
        to = BALL + time * self.ball - o
        along = d @ to
        inside = 0.4**2 - (to @ to - along**2)
        ball = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), np.inf)
        u, v = np.array([0.8, 0, 0.3]), np.array([0, 0.9, 0])
        n = np.cross(u, v)
        depth = ((CARD - o) @ n) / (d @ n)
        at = o + depth[..., None] * d - CARD
        a, b = at @ u / (u @ u), at @ v / (v @ v)
        card = np.where((a > 0) & (a < 1) & (b > 0) & (b < 1) & (depth > 0), depth, np.inf)
        return np.where(np.minimum(ball, card) == np.inf, 0, np.where(ball < card, 1, 2))


def rows_of(motion, sensor=SENSOR, view=None, moments=4):
    view = pinhole() if view is None else view
    rest = scene()
    rows = motion_stage(
        Ends(rest, rest), Ends(view, view), motion, sensor=Ends(sensor, sensor), moments=moments
    )
    return {row.effect.name: row for row in rows}


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(60), marks=pytest.mark.slow)])
def test_no_outline_moves_farther_than_its_bound(seeds):
    """The colour that a pixel sees at any moment is visible at rest within `place` pixels of it."""
    rng = np.random.default_rng(0)
    for seed in seeds:
        motion = Moving(seed)
        row = rows_of(motion)["motion"]
        assert row.effect.rank == "estimate"
        place = row.effect.place
        reach = place * np.sqrt((np.arange(900) + 0.5) / 900)
        angle = np.pi * (1 + 5**0.5) * np.arange(900)
        slots = moments_of(SENSOR, SHAPE[0], 4)
        for time in slots:
            r, c = rng.uniform(0, SHAPE[0] - 1, 80), rng.uniform(0, SHAPE[1] - 1, 80)
            seen = motion.picture(time, r, c)
            around = motion.picture(
                0.0, r[:, None] + reach * np.sin(angle), c[:, None] + reach * np.cos(angle)
            )
            # the outermost ring of samples is slightly inside the distance `place`
            here = (around == seen[:, None]).any(1)
            wider = motion.picture(
                0.0,
                r[:, None] + 1.02 * place * np.sin(angle),
                c[:, None] + 1.02 * place * np.cos(angle),
            )
            assert (here | (wider == seen[:, None]).any(1)).all()


def test_the_bound_on_displacement_is_at_most_a_few_times_too_large():
    """The centre of a ball that moves sideways moves by v t z_i / (z p) pixels."""
    motion = Moving(0)
    motion.ball = np.array([5.0, 0.0, 0.0])
    last = moments_of(SENSOR, SHAPE[0], 4)[-1]
    exact = 5 * last * FOCAL / 3.0 / PITCH
    assert exact <= rows_of(motion)["motion"].effect.place <= 1.2 * exact


def test_a_motion_that_does_not_move_is_proved_to():
    rows = rows_of(lambda scene, view, time: (scene, view))
    assert [row.effect.rank for row in rows.values()] == ["exact", "exact"]
    assert rows["motion"].drop is not None


def test_a_rolling_shutter_without_motion_is_no_effect():
    (row,) = rows_of(None).values()
    assert (row.effect.name, row.effect.rank, row.effect.place) == ("sensor.shutter", "exact", 0)


def test_a_shutter_reaches_as_far_as_both_exposures():
    rows = rows_of(Moving(1))
    alone = rows_of(Moving(1), sensor=replace(SENSOR, shutter=None))["motion"].effect.place
    both = rows["motion"].effect.place + alone
    assert rows["sensor.shutter"].effect.place == pytest.approx(both)


@pytest.mark.parametrize(
    "motion",
    [
        lambda scene, view, time: (replace(scene, ambient=s.AmbientLight(time[None])), view),
        lambda scene, view, time: (replace(scene, lights=()), view),
        lambda scene, view, time: (scene, replace(view, position=jnp.array([0, 0, 4.0]))),
    ],
    ids=["light", "kinds", "through the card"],
)
def test_a_motion_that_changes_more_than_positions_is_kept(motion):
    row = rows_of(motion)["motion"]
    assert row.drop is None
    assert row.effect.place == math.inf
    assert row.effect.why
