"""Calls for the chain from light to digital numbers."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxvision import DirectionalLight, Lambert, Phong, PointLight
from jaxvision import scene as s
from jaxvision.geometry import Ray

RNG = np.random.default_rng(3)


def unit(*v):
    v = np.asarray(v, float)
    return jnp.asarray(v / np.linalg.norm(v))


N, WI, WO = unit(0.1, -0.2, 1), unit(0.5, 0.3, 0.9), unit(-0.4, -0.5, 0.8)
KD, KS, KA = jnp.asarray([0.2, 0.1]), jnp.asarray([0.3, 0.2]), jnp.asarray([0.5, 0.6])
X = jnp.asarray(RNG.uniform(0.1, 0.9, size=(2, 3, 2)))
ONE, TWO = jnp.asarray(0.7), jnp.asarray(2.3)
POINT = jnp.asarray([0.2, 0.1, -0.3])
PHONG = Phong(KD, KS, 9.0, ambient=KA)
SPHERE, PLANE = s.Sphere([0.1, 0.2, 3], 1.0), s.Plane([0, 0, 5], [0.1, 0.1, -1])
LAMP, SUN = PointLight([1, 2, -3], KS), DirectionalLight([0.3, 0.2, -1], KD)
AMBIENT = s.AmbientLight([0.1, 0.2])
SCENE = s.Scene([s.Surface(SPHERE, PHONG)], [LAMP], AMBIENT)
RAY = Ray(jnp.zeros(3), unit(0.05, 0.02, 1))
PINHOLE = s.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.05, resolution=(2, 3), f_number=4.0)
SENSOR = s.Sensor(
    photon_conversion=s.PhotonConversion([5e-7, 6e-7], 1e-11),
    exposure_time=0.01,
    quantum_efficiency=[0.5, 0.6],
    prnu=0.01,
    dark_current=100.0,
    shot_noise=s.GaussianShotNoise(),
    full_well=1e9,
    dsnu=1.0,
    read_noise=2.0,
    gain=0.1,
    offset=64.0,
)
DEVELOPMENT = s.Development(black_level=0.05, white_level=1.5, tone=s.SRGB())
KEY, DIE = jax.random.split(jax.random.key(0))
INDEX = jnp.asarray(1)

EXAMPLES = {
    "rendering.direct.can_shade": ((SCENE.surfaces,), {}),
    "rendering.direct.radiance_along": ((SCENE, RAY), {}),
    "rendering.direct.render": ((SCENE, PINHOLE), {}),
    "shot.capture": ((KEY, SCENE, s.Camera(PINHOLE, SENSOR, DEVELOPMENT)), {"die_key": DIE}),
    "point_ops.linear.gain_bias": ((X, TWO, ONE), {}),
    "point_ops.curves.gamma_encode": ((X, TWO), {}),
    "point_ops.curves.gamma_decode": ((X, TWO), {}),
    "point_ops.curves.srgb_encode": ((X,), {}),
    "point_ops.curves.srgb_decode": ((X,), {}),
    "rendering.maps.material_at": (
        (Lambert(jnp.asarray([0.1, 0.2])), jnp.asarray([0.3, 0.7])),  # of a map: `test_maps`
        {"width": jnp.asarray([0.9, 0.4])},
    ),
    "rendering.shading.outgoing_radiance": (
        (PHONG, [LAMP, SUN], POINT, N, WO),
        {"ambient": AMBIENT},
    ),
}
