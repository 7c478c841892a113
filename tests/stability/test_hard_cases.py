"""Functions at inputs where a naive formula fails, in both precisions.

Values are compared with 50-digit results for the same floating-point inputs, in units of the last
place where the problem is well conditioned; otherwise the bound is the conditioning, written out.
Gradients are finite everywhere.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import assert_finite, both_precisions, eps

import jaxvision as jv
from jaxvision.brdf.phong import phong_shading

RNG = np.random.default_rng(5)
EYE = np.eye(3)


def tilted(dtype, angle, around):
    """Return a unit vector at `angle` from `around`, rounded to `dtype`."""
    side = np.cross(around, RNG.normal(size=3))
    side /= np.linalg.norm(side)
    return jnp.asarray(np.cos(angle) * np.asarray(around) + np.sin(angle) * side, dtype)


# ------------------------------------------------ reflection


@both_precisions
def test_shading_with_exponent_a_million(dtype):
    """Rounding turns the mirror direction by up to 2 eps, which the lobe magnifies by n theta,
    relative; no more digits are lost."""
    n, kd, ks = 1e6, 0.1, 0.5
    values = []
    for _ in range(20):
        normal = jnp.asarray(tilted(jnp.float64, 0.4, [0, 0, 1]), dtype)
        wi = tilted(dtype, 0.7, [0, 0, 1])
        theta = RNG.uniform(0.1, 2) / np.sqrt(n)
        s = np.asarray(jv.mirror_direction(normal, wi), np.float64)
        wo = tilted(dtype, theta, s / np.linalg.norm(s))
        got = phong_shading(
            normal,
            wi,
            wo,
            jnp.asarray([kd], dtype),
            jnp.asarray([ks], dtype),
            jnp.asarray(n, dtype),
        )
        truth = exact.phong(
            *map(exact.vector, (normal, wi, wo)),
            exact.number(jnp.asarray(kd, dtype)),
            exact.number(jnp.asarray(ks, dtype)),
            mp.mpf(n),
        )
        values.append(float(abs(exact.number(got[0]) / truth - 1)))
        assert values[-1] <= 6 * eps(dtype) * n * theta + 4 * eps(dtype)
    assert np.median(values) < 1e-4


# ------------------------------------------------ light and geometry


@both_precisions
@pytest.mark.parametrize("distance", [0.0, 1e-37, 1e-12, 1e-3, 1e6])
def test_point_light_at_any_distance(dtype, distance):
    light = jv.as_dtype(jv.PointLight([0, 0, 0], [1.0]), dtype)
    point = jnp.asarray([0, 0, distance], dtype)
    arriving = jv.incident(light, point)
    assert_finite(arriving)
    assert_finite(jax.grad(lambda p: jv.incident(light, p).irradiance[0])(point))
    if distance >= 1e-3:
        assert exact.ulps(arriving.irradiance[0], 1 / exact.number(point[2]) ** 2) <= 4
    if distance == 0 or (distance == 1e-37 and dtype == jnp.float32):
        assert arriving.irradiance[0] == 0


@pytest.mark.slow
@both_precisions
def test_gradients_of_a_degenerate_scene_are_finite(dtype):
    """The scene has coincident spheres, a light on a surface and one inside, a plane seen edge-on
    and a camera in the plane, so that pixel rays are tangent, parallel, or start on a surface."""
    shapes = [
        jv.Sphere([0, 0, 4], 1),
        jv.Sphere([0, 0, 4], 1),
        jv.Sphere([0, 0, 4], 0),
        jv.Plane([0, 0, 0], [0, 1, 0]),
    ]
    material = jv.Phong([0.2], [0.3], 1e6)
    lights = [
        jv.PointLight([0, 0, 3], [1.0]),
        jv.PointLight([0, 0, 4], [1.0]),
        jv.PointLight([0, 0, 0], [1.0]),
        jv.DirectionalLight([0, 0, -1], [1.0]),
        jv.DirectionalLight([0, 0, 0], [1.0]),
    ]
    scene = jv.as_dtype(jv.Scene([jv.Surface(shape, material) for shape in shapes], lights), dtype)
    pinhole = jv.Pinhole([0, 0, 0], EYE, 1, 0.125, resolution=(5, 5), f_number=4)
    parallel = jv.Orthographic([0, 0, 0], EYE, 0.5, resolution=(5, 5))

    def both(scene, view):
        picture, pull = jax.vjp(jv.render, scene, view)
        return picture, pull(jnp.ones_like(picture))

    for view in (pinhole, parallel) if dtype == jnp.float32 else (pinhole,):
        view = jv.as_dtype(view, dtype)
        picture, gradient = jax.jit(both)(scene, view)
        assert picture.dtype == dtype
        assert_finite((picture, gradient))
        assert (picture >= 0).all()
        assert picture.max() > 0


# ------------------------------------------------ sensor
