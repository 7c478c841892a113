"""Interfaces and paths at their limits: grazing, critical angle, equal indices, empty scenes, any
scale."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from precisions import both_precisions

from jaxvision import Lambert, Mirror, PointLight, as_dtype
from jaxvision.brdf import specular
from jaxvision.brdf.glass import Glass
from jaxvision.core._random import Stream
from jaxvision.geometry import Ray, hit_shape, nearest_shape, occluded
from jaxvision.scene import Box, Quad, Scene, Sphere, Surface, TriangleMesh
from jaxvision.transport import Paths, path_radiance, path_sample, ray_tree_radiance

mp.mp.dps = 50
CORNERS = (0, 0), (1, 0), (1, 1), (0, 1)


def direction(theta, dtype):
    return jnp.asarray([np.sin(theta), 0, np.cos(theta)], dtype)


CRITICAL = float(np.arcsin(2 / 3))


@both_precisions
@pytest.mark.parametrize("index", [1.0, 1.5, 1 / 1.5])
def test_gradients_of_an_interface_are_finite(dtype, index):
    """Gradients are finite at the normal, along the surface, at the critical angle and for the zero
    vector."""

    def total(w, index):
        split = specular(Glass(index), w)
        return split.reflectance[0] + sum(jax.tree.leaves((split.mirrored, split.refracted)))

    slope = jax.jit(jax.grad(total, argnums=(0, 1)))
    for theta in (0.0, CRITICAL, np.pi / 2, np.pi - CRITICAL, np.pi):
        for w in (direction(theta, dtype), 0 * direction(theta, dtype)):
            for leaf in jax.tree.leaves(slope(w, jnp.asarray(index, dtype))):
                assert jnp.isfinite(leaf).all()


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_closed_box_of_any_scale_loses_no_light_in_float32(scale):
    """In a box of albedo .5 whose walls emit .5, the radiance is 1 from every wall."""
    half = np.array([1.0, 0.7, 0.4]) * scale
    wall = Surface(Box(half * 3, half), Lambert([0.5 / np.pi]), [0.5], two_sided=True)
    scene = as_dtype(Scene([wall], []), jnp.float32)
    method = Paths(1, 20, strategy="surfaces")

    def one(number, target):
        ray = Ray(jnp.asarray(half * 3, jnp.float32), target)
        stream = Stream(number, jnp.uint32(0), jnp.asarray([1, 2], jnp.uint32))
        return path_sample(scene, ray, stream, method=method)[0]

    directions = np.random.default_rng(0).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    numbers = jnp.arange(len(directions), dtype=jnp.uint32)
    seen = jax.jit(jax.vmap(one))(numbers, jnp.asarray(directions, jnp.float32))
    assert seen.dtype == jnp.float32
    np.testing.assert_allclose(seen, 1, atol=1e-5)


@both_precisions
def test_a_ray_that_starts_on_a_mesh_hits_what_lies_ahead(dtype):
    """A ray that starts in the plane of the first of two parallel sheets of 128 triangles in one
    mesh meets the second."""
    pytest.importorskip("embreex")
    place = np.linspace(-1, 1, 9)
    x, y = (v.ravel() for v in np.meshgrid(place, place, indexing="ij"))
    sheets = [np.stack([x, y, np.full_like(x, z)], axis=1) for z in (0, 1)]
    a, b, c, d = (np.arange(81).reshape(9, 9)[i : i + 8, j : j + 8].ravel() for i, j in CORNERS)
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    mesh = as_dtype(
        TriangleMesh(np.concatenate(sheets), np.concatenate([faces, faces + 81])), dtype
    )
    up, free = jnp.asarray([0, 0, 1.0], dtype), jnp.zeros(3, dtype)

    def ahead(start):
        ray = Ray(start, up)
        distance = hit_shape(ray, [mesh], nearest_shape(ray, [mesh])).distance
        before, behind = (
            occluded(start, free, up, jnp.asarray(far, dtype), [mesh]) for far in (0.5, 1.5)
        )
        return distance, before, behind

    start = np.random.default_rng(0).uniform(-1, 1, (1000, 3)) * [1, 1, 0]
    distance, before, behind = jax.jit(jax.vmap(ahead))(jnp.asarray(start, dtype))
    np.testing.assert_allclose(distance, 1, rtol=1e-6)
    assert not before.any()
    assert behind.all()


HARD = {
    "a lamp in the floor, one without area, and a body that is black": Scene(
        [
            Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), Lambert([0.2])),
            Surface(Quad([0.0, 0, 1], [1.0, 0, 0], [2.0, 0, 0]), Lambert([0.0]), [1.0]),
            Surface(Sphere([0.0, 0, 0.2], 0.1), Lambert([0.0])),
        ],
        [PointLight([0.3, 0.0, 0.0], [1.0])],
    ),
    "inside glass, and mirrors that face each other": Scene(
        [
            Surface(Sphere([0.0, 0, 1], 2.0), Glass(1.0, absorption=[0.0])),
            Surface(Quad([-1.0, -1, 0], [2.0, 0, 0], [0, 2.0, 0]), Mirror([1.0])),
            Surface(Quad([-1.0, -1, 2], [0, 2.0, 0], [2.0, 0, 0]), Mirror([1.0])),
        ],
        [PointLight([0.0, 0.0, 5.0], [1.0])],
    ),
}


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("name", sorted(HARD))
@pytest.mark.parametrize("tracer", ["paths", "tree"])
def test_values_and_gradients_are_finite(dtype, name, tracer):
    """The rays go along an axis, to a corner, along a surface, and away from everything."""
    scene = as_dtype(HARD[name], dtype)

    def total(scene, direction):
        ray = Ray(jnp.asarray([0, 0, 1], dtype), direction)
        if tracer == "tree":
            return ray_tree_radiance(scene, ray, rays=6).sum()
        method = Paths(4, 5, strategy="lights")
        return path_radiance(jax.random.key(0), scene, ray, method=method).radiance.sum()

    slope = jax.jit(jax.value_and_grad(total, argnums=(0, 1), allow_int=True))
    for d in ([0, 0, -1.0], [0, 0, 1.0], [-0.57735027, -0.57735027, -0.57735027], [1.0, 0, 0]):
        value, gradient = slope(scene, jnp.asarray(d, dtype))
        assert value.dtype == dtype
        for leaf in jax.tree.leaves((value, gradient)):
            if jnp.issubdtype(leaf.dtype, jnp.floating):
                assert jnp.isfinite(leaf).all()
