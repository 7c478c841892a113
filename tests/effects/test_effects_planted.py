"""Tests bounds that the true change nearly reaches, so that half of the bound would be caught.
Those of scene and sensor are in `test_effects` and `test_effects_sensor`, and of a motion in
`test_effects_motion`."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision import scene as s
from jaxvision.development import develop
from jaxvision.effects.bounces import Onward, bounce_rows
from jaxvision.effects.cells import eye_of
from jaxvision.effects.development import lipschitz
from jaxvision.effects.optics import optics_stage
from jaxvision.effects.probes import tails_of
from jaxvision.effects.stages import Arriving, Ends
from jaxvision.effects.sums import sums_of
from jaxvision.optics import sensor_irradiance

DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])


def caught(change, bound):
    """Return whether the bound holds and half of it does not."""
    return 0.5 * bound < change <= bound * (1 + 1e-6)


def test_bound_on_bounces_in_a_closed_sphere():
    """Every surface emits L and reflects rho. Then k more segments add L rho^k, which the bound
    must equal."""
    grey, depth = jv.Lambert([0.7 / np.pi]), 9
    wall = jv.Surface(jv.Sphere([0, 0, 0], 1.0), grey, [0.5], two_sided=True)
    scene = jv.Scene(wall, [])
    view = jv.Pinhole([0, 0, 0], DOWN, 0.05, 0.01, resolution=(4, 4))
    sums = sums_of(Ends(scene, scene), eye_of(Ends(view, view)), bounces=True)
    for pieces, row in enumerate(bounce_rows(Onward(sums, depth)), 2):
        assert caught(sum(0.5 * 0.7**k for k in range(pieces, depth)), row.effect.bound)


@pytest.mark.slow
def test_bound_on_diffraction_of_a_lit_pixel():
    bare = s.ThinLens(np.zeros(3), np.eye(3), 0.05, 4e-6, resolution=(7, 7), f_number=8.0)
    view = replace(bare, diffraction=s.Diffraction(6e-7, size=5))
    rows, _ = optics_stage(Ends(view, view), Arriving(np.array([2.0]), 1.0, np.inf, np.zeros(1)))
    spot = jnp.zeros((7, 7, 1)).at[3, 3].set(2.0)
    change = np.abs(sensor_irradiance(view, spot) - sensor_irradiance(bare, spot)).max()
    (bound,) = (row.effect.bound for row in rows if row.effect.name == "view.diffraction")
    assert caught(float(change), bound)


def test_bound_on_a_development():
    steps = s.Development(black_level=60.0, white_level=1000.0, white_balance=s.WhiteBalance([2.0]))
    raw = jnp.full((3, 3, 1), 200.0)
    moved = np.abs(develop(raw + 1, steps) - develop(raw, steps)).max()
    assert caught(float(moved), lipschitz(steps).value)


def test_extrapolated_tails_of_a_geometric_series():
    """The tail is the geometric series exactly. It is infinite if the light does not decrease, and
    zero without light."""
    own = np.random.default_rng(0).uniform(0.5, 1, (4, 4, 1)) * [1.0, 2.0]
    n, depth, r = 4, 12, 0.6
    shown = [own * (1 - r**k) / (1 - r) for k in (n, n + 1, n + 2)]
    for m, tail in enumerate(tails_of(*shown, n=n, depth=depth), 2):
        exact = own.max((0, 1)) * (r**m - r**depth) / (1 - r)
        assert tail == pytest.approx(exact, rel=1e-6)
    for growing, end in ((own, np.inf), (0 * own, 0.0)):
        found = tails_of(own, own + growing, own + 3 * growing, n=n, depth=depth)
        assert np.all(np.array(found) == end)


@pytest.mark.slow
def test_long_paths_are_cut_by_an_unproved_estimate():
    """In the Cornell box, the estimate holds for a picture of other paths. The proof alone keeps
    more segments."""
    source = jv.files.scenes.read_scene("cornell_box")
    whole = effects.prune(source.scene, source.view, "5%", depth=40, estimates=True)
    assert whole.certificate.estimated > 0
    assert whole.certificate.total == 0
    level = whole.certificate.level
    proved = effects.prune(source.scene, source.view, "5%", depth=40, level=level)
    assert whole.depth < proved.depth
    pixel_pitch = source.view.pixel_pitch * max(source.view.resolution) / 16
    view = replace(source.view, resolution=(16, 16), pixel_pitch=pixel_pitch)
    few, all_ = (
        jax.jit(jv.transport.path_traced)(
            jax.random.key(7), source.scene, view, method=jv.transport.Paths(512, depth)
        ).radiance
        for depth in (whole.depth, 40)
    )
    assert np.abs(all_ - few).max() / level <= whole.certificate.estimated
