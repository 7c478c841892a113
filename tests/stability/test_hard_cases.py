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
from precisions import both_precisions

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
    Ray,
    Scene,
    Sensor,
    Sphere,
    Surface,
    as_array,
    as_dtype,
    capture,
    incident,
    intersect,
    mirror_direction,
    photon_rate,
    raw_image,
    reflect,
    render,
)
from jaxvision.brdf.gaussian_lobe import gaussian_lobe
from jaxvision.brdf.phong import phong_lobe, phong_shading
from jaxvision.core._numerics import angle_between, log_cos_between

RNG = np.random.default_rng(5)
EYE = np.eye(3)


def eps(dtype):
    return float(jnp.finfo(dtype).eps)


def tilted(dtype, angle, around):
    """Unit vector `angle` from `around`, rounded to `dtype`."""
    side = np.cross(around, RNG.normal(size=3))
    side /= np.linalg.norm(side)
    return jnp.asarray(np.cos(angle) * np.asarray(around) + np.sin(angle) * side, dtype)


def assert_finite(tree):
    for leaf in jax.tree.leaves(tree):
        assert jnp.isfinite(leaf).all(), tree


# ------------------------------------------------ reflection


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("exponent", [1.0, 1e2, 1e4, 1e6])
def test_lobe_of_a_huge_exponent_in_ulps(dtype, exponent):
    """At the angle where the lobe is about exp(-1/2), from the two unit vectors to the value: the
    rounded vectors are the input, so only the formula errs. (The inner-product form is 4 % off at
    1e6 in float32, half a million units.)"""
    n = jnp.asarray(exponent, dtype)
    mirror = np.array([0.36, 0.48, 0.8])
    for _ in range(8):
        wo = tilted(dtype, 1 / np.sqrt(exponent), mirror)
        m = jnp.asarray(mirror, dtype)
        got = phong_lobe(log_cos_between(m, wo), n)
        truth = exact.cosine(exact.vector(m), exact.vector(wo)) ** exact.number(n)
        assert exact.ulps(got, truth) <= 8
        theta = exact.angle(exact.vector(m), exact.vector(wo))
        c = jnp.sqrt(n / 2)
        gauss = gaussian_lobe(angle_between(m, wo), c)
        assert exact.ulps(gauss, mp.exp(-((exact.number(c) * theta) ** 2))) <= 8


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


RAYS = {
    "tangent": ([1, 0, -5], [0, 0, 1]),
    "just inside the silhouette": ([1 - 1e-6, 0, -5], [0, 0, 1]),
    "from the centre": ([0, 0, 0], [0, 0, 1]),
    "from the surface, outward": ([0, 0, 1], [0, 0, 1]),
    "from the surface, along it": ([0, 0, 1], [1, 0, 0]),
    "from the surface, inward": ([0, 0, 1], [0, 0, -1]),
    "from far away": ([0, 0, -1e6], [0, 0, 1]),
    "past it, perpendicular": ([0, 2, 0], [1, 0, 0]),
}


@both_precisions
@pytest.mark.parametrize("name", RAYS)
def test_rays_at_the_edges_of_a_sphere(dtype, name):
    origin, direction = (jnp.asarray(v, dtype) for v in RAYS[name])
    sphere = as_dtype(Sphere([0, 0, 0], 1), dtype)
    distance = intersect(Ray(origin, direction), sphere).distance
    truth = exact.sphere_distance(*map(exact.vector, (origin, direction, [0, 0, 0])), mp.mpf(1))
    # on the silhouette the distance turns with the square root: eps becomes sqrt(eps)
    bound = np.sqrt(eps(dtype)) if "silhouette" in name else 4 * eps(dtype) * abs(float(origin[2]))
    if truth is None:
        assert jnp.isinf(distance)
    else:
        assert abs(float(distance) - float(truth)) <= max(bound, 2 * eps(dtype))

    def nearness(ray, ball):
        t = intersect(ray, ball)
        return jnp.where(jnp.isfinite(t.distance), t.distance, 0) + as_array(t.normal).sum()

    assert_finite(jax.grad(nearness, argnums=(0, 1))(Ray(origin, direction), sphere))


@both_precisions
@pytest.mark.parametrize("slope", [0.0, 1e-30, 1e-6, 1.0])
def test_rays_almost_along_a_plane(dtype, slope):
    along = np.array([1, 0, -slope]) / np.hypot(1, slope)
    ray = Ray(jnp.asarray([0, 0, 1], dtype), jnp.asarray(along, dtype))
    plane = as_dtype(Plane([0, 0, 0], [0, 0, 1]), dtype)
    distance = intersect(ray, plane).distance
    if slope >= 1e-6:
        assert exact.ulps(distance, -1 / exact.number(ray.direction.z)) <= 2
    assert_finite(
        jax.grad(lambda r: jnp.where(jnp.isfinite(distance), intersect(r, plane).distance, 0))(ray)
    )


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


@both_precisions
@pytest.mark.parametrize("irradiance", [1e-12, 1.0, 1e6])
def test_photons_in_ulps(dtype, irradiance):
    """h c is 2e-25 and h alone below the smallest float32: the order of factors matters."""
    e, wavelength, area = (jnp.asarray(x, dtype) for x in (irradiance, 5.5e-7, 1.2e-11))
    truth = exact.number(e) * exact.number(wavelength) * exact.number(area)
    truth /= mp.mpf("6.62607015e-34") * 299792458
    assert exact.ulps(photon_rate(e[None], wavelength, area)[0], truth) <= 4
    assert_finite(jax.grad(lambda w: photon_rate(e[None], w, area)[0])(wavelength))


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
