"""Tests that quantities with two roles are bounded separately: emission and ambient light, the box
of a parameter and its motion, negative counts, and refractive indices of several bands."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxvision as jv
from jaxvision import effects
from jaxvision.brdf.fresnel import _largest_dielectric as _dielectric

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
FACES = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])


def toward(place):
    """Return a view of the origin from a position."""
    forward = -np.asarray(place) / np.linalg.norm(place)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    return jv.Pinhole(place, axes, 1.0, 0.024, resolution=(32, 32))


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [0.0, 1e-6, 0.01])
def test_bands_are_joined_where_only_emission_is_visible(tolerance):
    """Shading normals of a mesh face away at its rim, where there is no ambient light."""
    mesh = jv.TriangleMesh(OCTAHEDRON, FACES, normals=OCTAHEDRON)
    material = jv.Lambert([0.1, 0.1, 0.1], ambient=[0.0, 1.0, 0.5])
    scene = jv.Scene(
        jv.Surface(mesh, material, [1.0, 0.0, 0.5]),
        jv.PointLight([3.0, 0, 5], [1.0, 1.0, 1.0]),
        ambient=jv.AmbientLight([1.0, 1.0, 1.0]),
    )
    view = toward([3, 1.1, 0.3])
    pruned = effects.prune(scene, view, effects.Tolerance(tolerance), level=1.0)
    full, cut = np.asarray(jv.render(scene, view)), np.asarray(jv.render(pruned.scene, view))
    cut = cut if pruned.expand is None else cut @ pruned.expand.T
    assert np.abs(full - cut).max() <= pruned.certificate.total + 1e-14
    assert (full.min(-1) == 0).any() == (full[..., 1] == 0).any()


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", ["0.05DN", "0.2DN", "1DN"])
def test_bands_are_not_joined_with_bands_dropped_for_the_sensor(tolerance):
    """The ambient light of a band that the sensor hardly sees may be dropped for a tenth of a
    DN."""
    even, far = np.ones(31), 10 * np.eye(31)[0]
    floor = jv.Surface(
        jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert(0.1 * even, ambient=even), even
    )
    lamp = jv.PointLight([0.0, 0, 5], 0.1 * (even + far))
    scene = jv.Scene(floor, lamp, ambient=jv.AmbientLight(far))
    camera = jv.Camera(
        jv.Pinhole([0, 0, 2.0], DOWN, 1.0, 0.01, resolution=(8, 8)),
        jv.Sensor(
            quantum_efficiency=np.where(far > 0, 1e-4, 1.0),
            colour_filter=jv.ColourFilter(np.ones((1, 31)), pattern=((0,),)),
            gain=100.0,
            exposure_time=1.0,
        ),
    )
    full = jv.capture(jax.random.key(0), scene, camera)
    cut = jv.capture(jax.random.key(0), scene, camera, tolerance=tolerance)
    raw = np.asarray(full.raw)
    assert cut.certificate is not None
    most = cut.certificate.total + 1e-12 * raw.max()
    assert np.abs(raw - np.asarray(cut.raw)).max() <= most
    assert raw.max() > 1000


def test_a_motion_of_a_free_parameter_drops_nothing():
    """Rotating the corners of a lamp's box moves them out of the box between its rotated ends."""
    floor = jv.Surface(jv.Quad([-3, -3, 0], [6, 0, 0], [0, 6, 0]), jv.Lambert([0.3]))
    gloss = jv.Surface(jv.Sphere([11.6, 0, 0.6], 0.1), jv.Phong([0.1], [0.2], 5.0))
    scene = jv.Scene((floor, gloss), jv.PointLight([0.0, 0.0, 0.6], [1.0]))
    view = jv.Pinhole([11.6, 0, 3.0], DOWN, 1.0, 0.02, resolution=(8, 8))
    camera = jv.Camera(view, jv.Sensor(exposure_time=1.0, gain=1.0))

    def turned(scene, view, time):
        lamp = scene.lights[0]
        x, y, z = lamp.position
        half = jnp.sqrt(0.5)
        place = jnp.stack([half * (x - y) + 10.0, half * (x + y), z])
        return replace(scene, lights=(replace(lamp, position=place),)), view

    box = {"lights[0].position": ([-1, -1, 0.6], [1, 1, 0.6])}
    asked = {"motion": turned, "moments": 2}
    found = effects.inspect(scene, camera, free=box, **asked)
    assert all(e.bound == np.inf for e in found if e.name.startswith("surfaces[1]"))
    pruned = effects.prune(scene, camera, effects.Tolerance(0.5), level=1.0, free=box, **asked)
    assert not [e for e in pruned.certificate.dropped if not e.name.startswith("sensor")]
    # only the sensor is free, which moves nothing
    ends = {"sensor.gain": (0.5, 1.0)}
    still = effects.inspect(scene, camera, free=ends, **asked)
    assert all(np.isfinite(e.bound) for e in still if e.name.startswith("surfaces[1].material"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "offset", "read", "mean"),
    [(10.0, 16.0, 0.2, 1.0), (1.0, 3.0, 0.5, 2.0), (100.0, 150.0, 0.02, 1.0), (3.0, 0.0, 1.0, 0.3)],
)
def test_negative_gaussian_counts_are_clipped(gain, offset, read, mean):
    """The reference is the mean square of the part that a converter cuts off at 0, by SciPy's
    normal distribution."""
    view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 1e-5, resolution=(256, 256))
    sensor = jv.Sensor(
        shot_noise=jv.GaussianShotNoise(), read_noise=read, gain=gain, offset=offset, bits=16
    )
    wall = jv.Surface(
        jv.Quad([-50, -50, 1], [0, 100, 0], [100, 0, 0]), jv.Lambert([0.0]), emission=[mean]
    )
    camera = jv.Camera(view, sensor)
    effect = {e.name: e for e in effects.inspect(jv.Scene(wall, ()), camera)}["sensor.bits"]
    electrons = float(np.max(jv.capture(jax.random.key(0), jv.Scene(wall, ()), camera).irradiance))
    spread = gain * np.hypot(np.sqrt(electrons), read)
    level = offset + gain * electrons
    cut = spread**2 * stats.norm.expect(
        lambda x: np.maximum(-x - level / spread, 0) ** 2, lb=-20, ub=-level / spread
    )
    assert np.sqrt(cut) <= effect.bound


def test_reflectance_of_all_indices_between_two():
    """The reference is the largest of many indices by Snell's law. At grazing angles it is not the
    last index."""
    rng = np.random.default_rng(0)
    for cosine in rng.uniform(0.005, 1, 300):
        low, high = np.sort(rng.uniform(1.0001, 4, 2))
        eta = np.linspace(low, high, 400)
        inside = np.sqrt(1 - (1 - cosine**2) / eta**2)
        s = (cosine - eta * inside) / (cosine + eta * inside)
        p = (eta * cosine - inside) / (eta * cosine + inside)
        most = np.max((s**2 + p**2) / 2)
        bound = float(_dielectric(cosine, low, high))
        assert most <= bound * (1 + 1e-12)
        assert bound < 1.3 * most
        one = float(_dielectric(cosine, high, high))
        np.testing.assert_allclose(one, ((s**2 + p**2) / 2)[-1], rtol=1e-10)


def test_the_unit_of_sigma_is_the_least_noise_of_a_box():
    """A spread of the conversion that may be 0 adds no noise to the unit."""
    camera = jv.Camera(
        jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 1e-5, resolution=(64, 64)),
        jv.Sensor(
            shot_noise=jv.PoissonShotNoise(),
            read_noise=2.0,
            dsnu=0.5,
            conversion_prnu=0.0,
            gain=1.0,
            dark_current=1.0,
            exposure_time=1.0,
        ),
    )
    wall = jv.Surface(
        jv.Quad([-50, -50, 1], [0, 100, 0], [100, 0, 0]), jv.Lambert([0.0]), emission=[50.0]
    )

    def dropped(**options):
        pruned = effects.prune(jv.Scene(wall, ()), camera, "0.3sigma", **options)
        return {effect.name for effect in pruned.certificate.dropped}

    free = dropped(free={"sensor.conversion_prnu": (0.0, 0.5)})
    assert free <= dropped()
    assert "sensor.read_noise" not in free
