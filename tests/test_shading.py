"""The sum over sources: superposition, the ambient term, and the side that nobody lights."""

import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

from jaxvision.scene import AmbientLight, DirectionalLight, GaussianLobe, Lambert, Phong, PointLight
from jaxvision.shading import outgoing_radiance

KD, KS, KA = [0.2, 0.1, 0.05], [0.3, 0.4, 0.5], [0.9, 0.8, 0.7]
LIGHTS = [PointLight([1, 2, 3], [4.0, 5.0, 6.0]), DirectionalLight([0, 1, 1], [1.0, 2.0, 3.0])]
PLAIN_LIGHTS = [
    {"kind": "point", "position": np.array([1.0, 2, 3]), "intensity": [4.0, 5, 6]},
    {"kind": "directional", "direction": [0.0, 1, 1], "irradiance": [1.0, 2, 3]},
]
POINT, NORMAL = jnp.asarray([0.1, -0.2, 0.3]), jnp.asarray([0.0, 0.6, 0.8])
WO = jnp.asarray([0.36, 0.48, 0.8])
AMBIENT = AmbientLight([0.1, 0.2, 0.3])
MATERIALS = {
    "lambert": (Lambert(KD, ambient=KA), {}),
    "phong": (Phong(KD, KS, 9.0, ambient=KA), {"specular": KS, "exponent": 9.0}),
    "gaussian": (GaussianLobe(KD, KS, 2.0, ambient=KA), {"specular": KS, "concentration": 2.0}),
}


@pytest.mark.parametrize("kind", MATERIALS)
def test_against_the_naive_loop(kind):
    material, plain = MATERIALS[kind]
    got = outgoing_radiance(material, LIGHTS, POINT, NORMAL, WO, ambient=AMBIENT)
    expected = loops.shade(
        {"kind": kind, "diffuse": KD, "ambient": KA, **plain},
        PLAIN_LIGHTS,
        AMBIENT.radiance,
        np.asarray(POINT),
        np.asarray(NORMAL),
        np.asarray(WO),
    )
    assert (expected > 0.1).all()
    np.testing.assert_allclose(got, expected, rtol=1e-12)


def test_lights_superpose():
    material = MATERIALS["phong"][0]
    together = outgoing_radiance(material, LIGHTS, POINT, NORMAL, WO)
    apart = sum(outgoing_radiance(material, [light], POINT, NORMAL, WO) for light in LIGHTS)
    np.testing.assert_allclose(together, apart, rtol=1e-15)


def test_ambient_needs_both_the_light_and_the_reflectance():
    bare, ambient = Lambert(KD), Lambert(KD, ambient=KA)
    dark = jnp.zeros(3)
    np.testing.assert_array_equal(
        outgoing_radiance(bare, [], POINT, NORMAL, WO, ambient=AMBIENT), dark
    )
    np.testing.assert_array_equal(outgoing_radiance(ambient, [], POINT, NORMAL, WO), dark)
    np.testing.assert_allclose(
        outgoing_radiance(ambient, [], POINT, NORMAL, WO, ambient=AMBIENT),
        np.multiply(KA, [0.1, 0.2, 0.3]),
        rtol=1e-15,
    )


def test_seen_from_behind_or_lit_from_behind_is_black():
    material = MATERIALS["phong"][0]
    assert (outgoing_radiance(material, LIGHTS, POINT, NORMAL, -WO, ambient=AMBIENT) == 0).all()
    below = [PointLight([0, -3, -4], [1.0, 1.0, 1.0])]
    assert (outgoing_radiance(material, below, POINT, NORMAL, WO) == 0).all()
