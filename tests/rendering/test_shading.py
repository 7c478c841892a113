"""Tests the rendering equation for every light and material: the sum over sources against loops,
and the integrals against each other and against independent quadrature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops
from scipy import integrate

import jaxvision as jv
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import NormalisedPhong
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.lights import Balanced, incident_samples, radiance_from
from jaxvision.lights.polygon import rectangle_irradiance
from jaxvision.rendering.hemisphere_integral import (
    hemisphere_radiance,
    lit_radiance,
    sampled_radiance,
)
from jaxvision.rendering.shading import outgoing_radiance

KD, KS, KA = [0.2, 0.1, 0.05], [0.3, 0.4, 0.5], [0.9, 0.8, 0.7]
LIGHTS = [
    jv.PointLight([1, 2, 3], [4.0, 5.0, 6.0]),
    jv.DirectionalLight([0, 1, 1], [1.0, 2.0, 3.0]),
]
PLAIN_LIGHTS = [
    {"kind": "point", "position": np.array([1.0, 2, 3]), "intensity": [4.0, 5, 6]},
    {"kind": "directional", "direction": [0.0, 1, 1], "irradiance": [1.0, 2, 3]},
]
POINT, NORMAL = jnp.asarray([0.1, -0.2, 0.3]), jnp.asarray([0.0, 0.6, 0.8])
WO = jnp.asarray([0.36, 0.48, 0.8])
AMBIENT = jv.AmbientLight([0.1, 0.2, 0.3])
MATERIALS = {
    "lambert": (jv.Lambert(KD, ambient=KA), {}),
    "phong": (jv.Phong(KD, KS, 9.0, ambient=KA), {"specular": KS, "exponent": 9.0}),
    "gaussian": (jv.GaussianLobe(KD, KS, 2.0, ambient=KA), {"specular": KS, "concentration": 2.0}),
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


def test_light_is_additive():
    material = MATERIALS["phong"][0]
    together = outgoing_radiance(material, LIGHTS, POINT, NORMAL, WO)
    apart = sum(outgoing_radiance(material, [light], POINT, NORMAL, WO) for light in LIGHTS)
    np.testing.assert_allclose(together, apart, rtol=1e-15)


def test_ambient_needs_both_the_light_and_the_reflectance():
    bare, ambient = jv.Lambert(KD), jv.Lambert(KD, ambient=KA)
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
    below = [jv.PointLight([0, -3, -4], [1.0, 1.0, 1.0])]
    assert (outgoing_radiance(material, below, POINT, NORMAL, WO) == 0).all()


# ------------------------------------------------ extended lights and integrals

TWO = ([0.2, 0.1], [0.3, 0.4])  # k_d, k_s of two bands
REFLECTING = {
    "lambert": jv.Lambert(TWO[0]),
    "phong shading": jv.Phong(*TWO, 12.0),
    "normalised phong": NormalisedPhong(TWO[0], [0.3, 0.3], 30.0),
    "torrance-sparrow": TorranceSparrow(*TWO, 0.3),
    "oren-nayar": OrenNayar(TWO[0], 0.5),
}
SKY = np.random.default_rng(4).gamma(1.0, size=(6, 12, 2)) + 0.3
WINDOW = jv.Window([-0.2, 0.4, 1.8], [0.9, 0, 0], [0, -0.8, 0])
SHINING = {
    "rectangle": jv.RectangleLight(WINDOW.corner, WINDOW.edge_u, WINDOW.edge_v, [3.0, 5.0]),
    "environment": jv.environment_map(SKY),
    "light field": jv.LightFieldLight(
        np.random.default_rng(5).uniform(1, 3, size=(2, 2, 3, 3, 2)),
        WINDOW,
        jv.Window([-20, 20, 4.0], [40, 0, 0], [0, -40, 0]),
    ),
}
KEY = jax.random.key(7)


@pytest.mark.slow  # each compiles seven ways
@pytest.mark.parametrize("light", SHINING)
@pytest.mark.parametrize("kind", REFLECTING)
def test_every_method_of_integration_agrees_for_every_pair(kind, light):
    """The methods are nodes on the light, nodes over the hemisphere, samples of the BRDF, and
    samples of both."""
    material, source = REFLECTING[kind], SHINING[light]

    @jax.jit
    def all_ways(material, source):
        def arriving(wi):
            return radiance_from(source, POINT, wi)

        def by(rule):
            return outgoing_radiance(material, [source], POINT, NORMAL, WO, rule=rule)

        return (
            by(jv.Quadrature(40)),
            by(jv.Quadrature(31)),
            by(jv.MonteCarlo(KEY, 3000)),
            by(Balanced(KEY, 1500)),
            hemisphere_radiance(material, arriving, NORMAL, WO, polar=64, azimuths=128),
            sampled_radiance(KEY, material, arriving, NORMAL, WO, samples=3000),
            lit_radiance(KEY, material, source, POINT, NORMAL, WO, samples=1500),
        )

    reference, coarser, drawn, balanced, hemisphere, sampled, both = all_ways(material, source)
    doubt = np.abs(reference - coarser) + 1e-9
    assert (reference > 0.02).all()
    assert (doubt < 0.02 * reference).all()
    np.testing.assert_allclose(drawn, reference, rtol=0.03)
    if light == "rectangle" and kind == "lambert":
        closed = material.diffuse * rectangle_irradiance(source, POINT, NORMAL)
        np.testing.assert_allclose(reference, closed, rtol=1e-9)
    assert (np.abs(hemisphere.value - reference) <= 2 * hemisphere.error + doubt).all()
    # a sky without edges; lights have edges between 64 x 128 nodes of the hemisphere
    assert (hemisphere.error < (0.02 if light == "environment" else 0.15) * reference).all()
    assert (np.abs(balanced - reference) <= 4.5 * both.error + doubt).all()
    for estimate in (sampled, both):
        assert (np.abs(estimate.value - reference) <= 4.5 * estimate.error + doubt).all()
    assert (both.error < 0.1 * reference).all()
    assert (both.error < 1.5 * sampled.error + 1e-3 * reference).all()


@pytest.mark.slow
def test_shading_equals_independent_quadrature():
    """A Gaussian patch of sky lights the textbook's Phong model. SciPy integrates the formula
    adaptively."""
    centre = np.array([0.3, 0.5, np.sqrt(1 - 0.34)])
    kd, ks, n = 0.2, 0.3, 12.0

    def integrand(phi, theta):
        wi = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        mirror = wi * [-1, -1, 1]
        radiance = np.exp(4 * (wi @ centre - 1))
        shading = kd * wi[2] + ks * max(mirror @ viewer, 0) ** n
        return radiance * shading * np.sin(theta)

    viewer = np.array([-0.36, -0.48, 0.8])
    truth, _ = integrate.dblquad(integrand, 0, np.pi / 2, 0, 2 * np.pi, epsabs=1e-8, epsrel=1e-8)
    sky, up = jnp.asarray(centre), jnp.asarray([0.0, 0, 1])
    got = hemisphere_radiance(
        jv.Phong([kd], [ks], n),
        lambda wi: jnp.exp(4 * (wi @ sky - 1))[None],
        up,
        jnp.asarray(viewer),
    )
    np.testing.assert_allclose(got.value, truth, rtol=1e-6)


@pytest.fixture(scope="module")
def highlight():
    """Return a square light with the highlight of GGX facets, alpha .05, in its centre, and the
    radiance by SciPy: D G_2 / (4 cos_o), Walter et al. (2007) and Heitz (2014), over the light's
    area."""
    alpha, viewer = 0.05, np.array([0.6, 0, 0.8])

    def hidden(cosine):
        return (np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2

    def integrand(y, x):
        place = np.array([x, y, 1.0])
        square = place @ place
        wi = place / np.sqrt(square)
        half = (wi + viewer) / np.linalg.norm(wi + viewer)
        facets = alpha**2 / (np.pi * (half[2] ** 2 * (alpha**2 - 1) + 1) ** 2)
        shadowed = 1 / (1 + hidden(wi[2]) + hidden(viewer[2]))
        return facets * shadowed / (4 * viewer[2]) * wi[2] / square

    # integrating each quarter of the plane puts the peak in a corner
    truth = sum(
        integrate.dblquad(integrand, *x, *y, epsabs=1e-7, epsrel=1e-7)[0]
        for x in ((-1.25, -0.75), (-0.75, -0.25))
        for y in ((-0.5, 0), (0, 0.5))
    )
    lamp = jv.RectangleLight([-1.25, 0.5, 1], [1, 0, 0], [0, -1, 0], [1.0])
    return TorranceSparrow([0.0], [1.0], alpha), lamp, jnp.asarray(viewer), truth


@pytest.mark.slow
def test_a_glossy_highlight_needs_balanced_samples(highlight):
    """The references are adaptive integration, and the errors that `Quadrature` states."""
    material, lamp, viewer, truth = highlight
    up, origin = jnp.asarray([0.0, 0, 1]), jnp.zeros(3)

    def by(rule):
        return outgoing_radiance(material, [lamp], origin, up, viewer, rule=rule)[0]

    keys = jax.random.split(KEY, 200)
    drawn = jax.jit(jax.vmap(lambda key: by(Balanced(key, 64))))(keys)
    error = drawn.std() / np.sqrt(len(keys))
    assert abs(drawn.mean() - truth) < 4 * error
    assert drawn.std() < 0.05 * truth
    for order, off in ((8, -0.155), (16, -0.008)):
        np.testing.assert_allclose(jax.jit(by)(jv.Quadrature(order)) / truth - 1, off, atol=1e-3)


@pytest.mark.slow
def test_a_mirror_shows_the_light_it_reflects():
    up, wo = jnp.asarray([0.0, 0, 1]), jnp.asarray([-0.1, 0, np.sqrt(0.99)])
    lights, mirror = [SHINING["environment"], SHINING["rectangle"]], Mirror([0.5, 0.9])
    look = jax.jit(outgoing_radiance)
    got = look(mirror, lights, jnp.zeros(3), up, wo)
    np.testing.assert_allclose(got, [1.5, 4.5], rtol=1e-12)  # the rectangle, in front of the sky
    sky = look(mirror, lights[:1], jnp.zeros(3), up, wo)
    reflected = radiance_from(lights[0], jnp.zeros(3), jnp.asarray([0.1, 0, np.sqrt(0.99)]))
    np.testing.assert_allclose(sky, reflected * jnp.asarray([0.5, 0.9]), rtol=1e-12)
    drawn = sampled_radiance(
        KEY, mirror, lambda wi: radiance_from(lights[0], POINT, wi), up, wo, samples=2
    )
    np.testing.assert_allclose(drawn.value, sky, rtol=1e-12)
    lit = lit_radiance(KEY, mirror, lights[0], POINT, up, wo, samples=2)
    np.testing.assert_allclose(lit.value, sky, rtol=1e-12)
    np.testing.assert_array_equal(lit.error, 0)
    balanced = look(mirror, lights[:1], POINT, up, wo, rule=Balanced(KEY, 2))
    np.testing.assert_allclose(balanced, sky, rtol=1e-12)


@pytest.mark.slow
def test_a_point_light_is_one_sample_under_any_rule():
    for light in LIGHTS:
        for rule in (jv.Quadrature(5), jv.MonteCarlo(KEY, 7), Balanced(KEY, 7)):
            arriving = incident_samples(light, POINT, rule)
            assert arriving.direction.shape == (1, 3)
            assert arriving.irradiance.shape == (1, 3)
        with pytest.raises(ValueError, match=r"extended light is needed, got"):
            lit_radiance(KEY, jv.Lambert(KD), light, POINT, NORMAL, WO, samples=2)


def test_a_neutral_material_takes_the_lights_bands_and_mismatches_are_named():
    grey = jv.Lambert([0.2])
    assert outgoing_radiance(grey, LIGHTS, POINT, NORMAL, WO).shape == (3,)
    with pytest.raises(ValueError, match=r"share one number of bands, got 2 from Lambert and \[3"):
        outgoing_radiance(REFLECTING["lambert"], LIGHTS, POINT, NORMAL, WO)
    with pytest.raises(ValueError, match=r"samples must be a whole number of at least 2, got 1"):
        sampled_radiance(KEY, grey, lambda wi: jnp.ones(1), NORMAL, WO, samples=1)
    with pytest.raises(ValueError, match=r"polar must be a whole number of at least 2, got 1"):
        hemisphere_radiance(grey, lambda wi: jnp.ones(1), NORMAL, WO, polar=1, azimuths=8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", REFLECTING)
def test_standard_errors_cover_the_true_value(kind):
    """In 500 repetitions, 2 standard errors cover 95.4 %, within four binomial standard
    deviations."""
    material, source = REFLECTING[kind], SHINING["rectangle"]
    rule = jv.Quadrature(40)
    truth = outgoing_radiance(material, [source], POINT, NORMAL, WO, rule=rule)[0]

    def one(key):
        both = lit_radiance(key, material, source, POINT, NORMAL, WO, samples=400)
        return both.value[0], both.error[0]

    value, error = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(1), 500))
    covered = np.mean(np.asarray(jnp.abs(value - truth) < 2 * error))
    assert abs(covered - 0.954) < 4 * np.sqrt(0.954 * 0.046 / 500)
