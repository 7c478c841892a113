"""Tests lights sorted by their contribution: no pixel lacks more than the threshold, in any
scene."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from oracles.direct_light import picture

import jaxvision as jv
from jaxvision import effects
from jaxvision.rendering import direct

VIEW = jv.Pinhole([0, 1.5, -6], np.diag([-1.0, -1, 1]), 0.05, 0.05 / 12, resolution=(16, 16))


def crowded(seed, *, lamps=12, bands=2):
    """Return balls, boxes and lamps of several types on a floor. All seeds share one program."""
    rng = np.random.default_rng(seed)

    def material(glossy):
        k_d, k_s = rng.uniform(0.02, 0.3, bands), rng.uniform(0.0, 0.3, bands)
        return jv.Phong(k_d, k_s, rng.uniform(3, 40)) if glossy else jv.Lambert(k_d)

    def place(low=0.2):
        return rng.uniform([-4, low, -3], [4, 4, 6])

    def power():
        return np.exp(rng.uniform(-3, 3)) * rng.uniform(0.2, 1, bands)

    surfaces = [jv.Surface(jv.Quad([-9, 0, -9], [0, 0, 18], [18, 0, 0]), material(False))]
    surfaces += [
        jv.Surface(jv.Sphere(place(), rng.uniform(0.1, 0.8)), material(True)) for _ in "abcd"
    ]
    surfaces += [
        jv.Surface(jv.Box(place(), rng.uniform(0.1, 0.8, 3)), material(False)) for _ in "ab"
    ]
    lights = [jv.PointLight(place(1.0), power()) for _ in range(lamps)]
    lights += [jv.SmallLight(place(2.0), [0, -1, 0], power()) for _ in range(3)]
    lights += [jv.DirectionalLight(np.array([0.6, 0.8, 0]), 0.1 * power())]
    return jv.Scene(surfaces, lights)


def missing(seeds):
    """Return (least, largest) of full minus sorted radiance in thresholds, over all pixels and
    seeds."""
    ordered = jax.jit(lambda scene, least: jv.render(scene, VIEW, threshold=least))
    least, most, reduced = np.inf, -np.inf, 0
    for seed in seeds:
        scene = crowded(seed)
        full = picture(*jax.tree.map(np.asarray, (scene, VIEW)))
        threshold = full.max() * 10 ** np.random.default_rng(seed).uniform(-3, -1)
        plain = np.asarray(ordered(scene, 0.0))
        found = full - np.asarray(ordered(scene, threshold))
        # at an edge, where rays differ by rounding, the oracle may hit another surface
        edge = (np.abs(plain - full) > 1e-9 * full.max()).any(-1)
        assert edge.mean() < 0.05
        found = found[~edge] / threshold
        least, most = min(least, found.min()), max(most, found.max())
        reduced += found.max() > 1e-6
    return least, most, reduced / len(seeds)


@pytest.mark.slow
def test_no_pixel_lacks_more_than_the_threshold():
    least, most, reduced = missing(range(60))
    assert least > -1e-6
    assert 0.3 < most <= 1 + 1e-9
    assert reduced > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("rule", [jv.Quadrature(2), jv.MonteCarlo(jax.random.key(2), 3)])
def test_behind_a_lens_with_extended_lamps(rule):
    """The result is within the threshold of the picture with all shadow rays."""
    scene = crowded(3, lamps=9)
    lamp = jv.RectangleLight([-3, 3, 0], [0.5, 0, 0], [0, 0, 0.5], [4.0, 2.0])
    lens = jv.ThinLens([0, 1.5, -6], VIEW.rotation, 0.05, 0.004, resolution=(16, 16), f_number=0.2)
    samples = jv.PixelSamples(jax.random.key(1), 4)

    def seen(power, threshold):
        lit = replace(lamp, radiance=power)
        whole = replace(scene, lights=(*scene.lights, lit, replace(lit, corner=lamp.corner * -1)))
        return jv.render(whole, lens, rule=rule, samples=samples, threshold=threshold)

    ordered = jax.jit(seen)
    plain = np.asarray(jax.jit(lambda power: seen(power, None))(lamp.radiance))
    assert np.asarray(ordered(lamp.radiance, 0.0)) == pytest.approx(plain, rel=1e-12)
    threshold = 0.02 * plain.max()
    lacks = (plain - ordered(lamp.radiance, threshold)) / threshold
    assert lacks.min() > -1e-9
    assert 0.01 < lacks.max() <= 1
    total = jax.jit(jax.grad(lambda power, least: seen(power, least).sum()), static_argnums=1)
    slopes = [np.asarray(total(lamp.radiance, least)) for least in (0.0, None)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-9)


def street(lamps=100, houses=60):
    """Return two rows of lamps and houses along a street, seen from its end."""
    rng = np.random.default_rng(0)
    long, grey = 10.0 * lamps, jv.Lambert(np.full(3, 0.3 / np.pi))
    surfaces = [jv.Surface(jv.Quad([-9, 0, -5], [0, 0, long + 20], [18, 0, 0]), grey)]
    lights = []
    for side in (-1, 1):
        for i in range(houses // 2):
            each, high = long / (houses // 2), rng.uniform(6, 14)
            half = [4, high / 2, 0.4 * each]
            surfaces.append(jv.Surface(jv.Box([13 * side, high / 2, (i + 0.5) * each], half), grey))
        for i in range(lamps // 2):
            power = np.array([120.0, 90, 50]) * rng.uniform(0.7, 1.3)
            lights.append(jv.PointLight([6.0 * side, 6, 20 * (i + 0.5)], power))
    view = jv.Pinhole([1, 1.7, 0], VIEW.rotation, 0.024, 0.036 / 64, resolution=(64, 64))
    return jv.Scene(surfaces, lights), view


@pytest.mark.slow
def test_a_street_of_100_lamps_needs_few_shadow_rays(monkeypatch):
    scene, view = street()
    pruned = effects.prune(scene, view, "1%")
    (dropped,) = [e for e in pruned.certificate.dropped if e.name == "lights in order"]
    assert 0.002 < dropped.bound <= pruned.certificate.total <= 0.01
    traced, whole = [], direct.visible_in_order

    def counted(*args):
        flags, needed = whole(*args)
        jax.debug.callback(lambda n: traced.append(int(n)), needed.sum())
        return flags, needed

    monkeypatch.setattr(direct, "visible_in_order", counted)
    found = jv.render(pruned.scene, view, threshold=pruned.threshold)
    jax.effects_barrier()
    found = found if pruned.expand is None else found @ pruned.expand.T
    lacks = np.abs(jv.render(scene, view) - found).max()
    assert lacks <= pruned.certificate.total * (pruned.certificate.level or 0)
    assert sum(traced) * direct.TOGETHER < 0.15 * len(scene.lights) * found[..., 0].size


@pytest.mark.slow
def test_few_lights_few_shapes_and_fits_use_all_shadow_rays():
    few, view = street(lamps=8, houses=8)
    assert effects.prune(few, view, "1%", level=1.0).threshold is None
    many, _ = street(lamps=10, houses=8)
    assert (effects.prune(many, view, "1%", level=1.0).threshold or 0) > 0
    bare = replace(many, surfaces=many.surfaces[:8])
    assert effects.prune(bare, view, "1%", level=1.0).threshold is None
    free = {"lights[0].intensity": (0.0, 500.0)}
    assert effects.prune(many, view, "1%", level=1.0, free=free).threshold is None
