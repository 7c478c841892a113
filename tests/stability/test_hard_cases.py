"""Each function at the edges where a naive formula breaks, in both precisions.

Values against 50 digits on the very floating-point inputs, in units of the last place where the
problem is well conditioned; otherwise the bound is the conditioning, written out. Gradients are
finite everywhere.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import assert_finite, both_precisions, eps

from jaxvision import (
    Camera,
    DirectionalLight,
    GaussianLobe,
    GaussianShotNoise,
    Lambert,
    Orthographic,
    Phong,
    PhotonConversion,
    Pinhole,
    Plane,
    PointLight,
    PoissonShotNoise,
    Scene,
    Sensor,
    Sphere,
    Surface,
    as_dtype,
    capture,
    incident,
    mirror_direction,
    raw_image,
    reflect,
    render,
)
from jaxvision.brdf.phong import phong_shading

RNG = np.random.default_rng(5)
EYE = np.eye(3)


def tilted(dtype, angle, around):
    """Unit vector `angle` from `around`, rounded to `dtype`."""
    side = np.cross(around, RNG.normal(size=3))
    side /= np.linalg.norm(side)
    return jnp.asarray(np.cos(angle) * np.asarray(around) + np.sin(angle) * side, dtype)


# ------------------------------------------------ reflection


@both_precisions
def test_shading_with_exponent_a_million(dtype):
    """Through the mirror direction: rounding it turns it by up to 2 eps, which the lobe magnifies
    by n theta, relative. That is all that is lost."""
    n, kd, ks = 1e6, 0.1, 0.5
    values = []
    for _ in range(20):
        normal = jnp.asarray(tilted(jnp.float64, 0.4, [0, 0, 1]), dtype)
        wi = tilted(dtype, 0.7, [0, 0, 1])
        theta = RNG.uniform(0.1, 2) / np.sqrt(n)
        s = np.asarray(mirror_direction(normal, wi), np.float64)
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


SPECIAL_GEOMETRY = {
    "retro": ([0, 0, 1], [0, 0, 1]),
    "mirror": ([0.6, 0, 0.8], [-0.6, 0, 0.8]),
    "lobe at a right angle": ([0, 0, 1], [1, 0, 0]),
    "lobe behind": ([0.8, 0, 0.6], [0.8, 0, 0.6]),
    "grazing light": ([1, 0, 1e-7], [0, 0, 1]),
    "grazing both": ([1, 0, 1e-7], [-1, 0, 1e-7]),
    "light below": ([0, 0, -1], [0, 0, 1]),
    "no direction": ([0, 0, 0], [0, 0, 1]),
}


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("geometry", SPECIAL_GEOMETRY)
@pytest.mark.parametrize("sharpness", [0.0, 1.0, 1e6])
def test_reflection_at_special_geometry(dtype, geometry, sharpness):
    normal, wi, wo = (jnp.asarray(v, dtype) for v in ([0, 0, 1], *SPECIAL_GEOMETRY[geometry]))
    cos_i = float(wi[2])
    for material in (
        Lambert([0.3]),
        Phong([0.3], [0.5], sharpness),
        GaussianLobe([0.3], [0.5], sharpness),
    ):
        material = as_dtype(material, dtype)
        value, gradient = jax.value_and_grad(
            lambda m, n, i, o: reflect(m, n, i, o)[0], argnums=(0, 1, 2, 3)
        )(material, normal, wi, wo)
        assert_finite((value, gradient))
        assert 0 <= value <= 0.8 * (1 + 2 * eps(dtype))
        if cos_i <= 0:
            assert value == 0
        if geometry == "mirror" and not isinstance(material, Lambert):
            np.testing.assert_allclose(value, 0.3 * 0.8 + 0.5, rtol=sharpness * 1e-14 + 2e-7)
        if geometry == "lobe behind" and isinstance(material, Phong):
            np.testing.assert_allclose(value, 0.3 * 0.6, rtol=4 * eps(dtype))


# ------------------------------------------------ light and geometry


@both_precisions
@pytest.mark.parametrize("distance", [0.0, 1e-37, 1e-12, 1e-3, 1e6])
def test_point_light_at_any_distance(dtype, distance):
    light = as_dtype(PointLight([0, 0, 0], [1.0]), dtype)
    point = jnp.asarray([0, 0, distance], dtype)
    arriving = incident(light, point)
    assert_finite(arriving)
    assert_finite(jax.grad(lambda p: incident(light, p).irradiance[0])(point))
    if distance >= 1e-3:
        assert exact.ulps(arriving.irradiance[0], 1 / exact.number(point[2]) ** 2) <= 4
    if distance == 0 or (distance == 1e-37 and dtype == jnp.float32):
        assert arriving.irradiance[0] == 0


@pytest.mark.slow
@both_precisions
def test_a_picture_of_everything_awkward_has_finite_gradients(dtype):
    """Coincident spheres, a light on a surface and one inside, a plane seen edge-on, a camera in
    the plane: pixel rays that are tangent, parallel, and start on a surface."""
    shapes = [
        Sphere([0, 0, 4], 1),
        Sphere([0, 0, 4], 1),
        Sphere([0, 0, 4], 0),
        Plane([0, 0, 0], [0, 1, 0]),
    ]
    material = Phong([0.2], [0.3], 1e6)
    lights = [
        PointLight([0, 0, 3], [1.0]),
        PointLight([0, 0, 4], [1.0]),
        PointLight([0, 0, 0], [1.0]),
        DirectionalLight([0, 0, -1], [1.0]),
        DirectionalLight([0, 0, 0], [1.0]),
    ]
    scene = as_dtype(Scene([Surface(shape, material) for shape in shapes], lights), dtype)
    pinhole = Pinhole([0, 0, 0], EYE, 1, 0.125, resolution=(5, 5), f_number=4)
    parallel = Orthographic([0, 0, 0], EYE, 0.5, resolution=(5, 5))

    def both(scene, view):
        picture, pull = jax.vjp(render, scene, view)
        return picture, pull(jnp.ones_like(picture))

    for view in (pinhole, parallel) if dtype == jnp.float32 else (pinhole,):
        view = as_dtype(view, dtype)
        picture, gradient = jax.jit(both)(scene, view)
        assert picture.dtype == dtype
        assert_finite((picture, gradient))
        assert (picture >= 0).all()
        assert picture.max() > 0


# ------------------------------------------------ sensor


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("level", [0.0, 1e-30, 0.1, 1e4, 1e30])
def test_sensor_from_no_photon_to_far_too_many(dtype, level):
    sensor = Sensor(
        exposure_time=1.0,
        quantum_efficiency=0.5,
        prnu=0.01,
        dark_current=0.0,
        full_well=1e4,
        dsnu=0.0,
        read_noise=0.0,
        gain=1.0,
        offset=0.0,
        bits=12,
    )
    x = jnp.full((4, 1), level, dtype)
    key = jax.random.key(1)
    for noise in (PoissonShotNoise(), GaussianShotNoise(), None):
        one = as_dtype(
            Sensor(**{name: getattr(sensor, name) for name in SENSOR_NUMBERS}, shot_noise=noise),
            dtype,
        )

        def shoot(s, i):
            return raw_image(key, s, i, die_key=key)

        dn, pull = jax.vjp(shoot, one, x)
        assert dn.dtype == dtype
        assert ((dn >= 0) & (dn <= 4095)).all()
        assert_finite((dn, pull(jnp.ones_like(dn))))
        if level == 0:
            assert (dn == 0).all()
        if level == 1e30:
            assert (dn == 4095).all()


SENSOR_NUMBERS = (
    "exposure_time",
    "quantum_efficiency",
    "prnu",
    "dark_current",
    "full_well",
    "dsnu",
    "read_noise",
    "gain",
    "offset",
    "bits",
)


@pytest.mark.slow
def test_a_whole_camera_in_the_dark():
    camera = Camera(
        Pinhole([0, 0, 0], EYE, 1, 0.1, resolution=(3, 3), f_number=2),
        Sensor(
            photon_conversion=PhotonConversion(5e-7, 1e-11),
            shot_noise=PoissonShotNoise(),
            bits=8,
        ),
    )
    scene = Scene([Surface(Sphere([0, 0, 3], 1), Lambert([0.3]))], [])
    shot = jax.jit(capture)(jax.random.key(0), scene, camera)
    assert (shot.raw == 0).all()
