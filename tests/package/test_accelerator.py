"""Tests the programs for accelerators: public JAX, many rays and several samples at once. Here a
CPU runs them, and the results must equal those of the CPU programs."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import filters
from jaxvision.core._loops import fusion
from jaxvision.transport import light_traced

KEY = jax.random.key(0)
SPECIAL = {"fuse", "one_step", "jaxvision_correlate"}  # primitives for CPUs only


def scene():
    floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert([0.2]))
    ball = jv.Surface(jv.Sphere([0, 0, 1], 1.0), jv.PhongBRDF([0.1], [0.3], 12.0))
    lamp = jv.Surface(jv.Disc([1, 1, 4], [0, 0, -1], 0.6), jv.Lambert([0.0]), [5.0])
    return jv.Scene([floor, ball, lamp], [jv.PointLight([2, -1, 3], [4.0])])


def view():
    down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    return jv.Pinhole([0, 0, 5], down, 1.0, 0.2, resolution=(6, 5))


def paths(scene, view):
    return jv.path_traced(KEY, scene, view, method=jv.Paths(6, 2))


def one_path(scene, view):
    ray = jv.Ray([0.0, 0.0, 5.0], [0.0, 0.0, -1.0])
    return jv.path_radiance(KEY, scene, ray, method=jv.Paths(8, 2))


def slope(scene, view):
    def loss(ks):
        ball = jv.Surface(scene.surfaces[1].shape, jv.PhongBRDF([0.1], ks, 12.0))
        surfaces = [scene.surfaces[0], ball, scene.surfaces[2]]
        return paths(jv.Scene(surfaces, scene.lights), view).radiance.mean()

    return jax.grad(loss)(jnp.array([0.3]))


def whole_and_trees(scene, view):
    samples = jv.PixelSamples(KEY, 7)
    ball = jv.Surface(jv.Sphere([0, 0, 1], 1.0), jv.Mirror([0.9]))
    mirrored = jv.Scene([scene.surfaces[0], ball, scene.surfaces[2]], scene.lights)
    return jv.render(scene, view, samples=samples), jv.ray_traced(
        mirrored, view, rays=3, samples=samples
    )


def from_the_lights(scene, view):
    return light_traced(KEY, scene, view, paths=40, depth=3)


def filtered(scene, view):
    picture = jnp.asarray(np.random.default_rng(0).uniform(size=(20, 24, 3)))
    kernels = [np.random.default_rng(n).uniform(size=(n, n)) for n in (5, 11)]
    return [filters.correlate(picture, kernel) for kernel in kernels]


LONG = [
    pytest.param(f, marks=pytest.mark.slow)
    for f in (one_path, slope, whole_and_trees, from_the_lights)
]


@pytest.mark.slow
@pytest.mark.parametrize("compute", [paths, filtered, *LONG])
def test_an_accelerators_program_gives_the_same(compute, monkeypatch):
    apart = 1e-12 if jax.default_backend() == "cpu" else 1e-9
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    jax.clear_caches()
    with jax.default_device(jax.devices("cpu")[0]):  # overrides the device found by JAX
        ours = compute(scene(), view())
        program = str(jax.make_jaxpr(compute)(scene(), view()))
    assert fusion.PLAIN or any(name in program for name in SPECIAL)
    other = compute(scene(), view())
    program = str(jax.make_jaxpr(compute)(scene(), view()))
    jax.clear_caches()
    # a sum by transforms defines its own derivative, because its loop over magnitudes has none
    program = re.sub(r"jaxvision_correlate\[[^\]]*method=fft\s*\]", "", program)
    assert not any(name in program for name in SPECIAL)
    for one, two in zip(jax.tree.leaves(ours), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(one, two, apart, apart * np.abs(one).max())
