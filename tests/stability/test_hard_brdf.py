"""BRDFs where naive formulas fail: grazing, opposite and coincident directions, roughness from 1e-4
to 1, exponents to a million. In both precisions, values are compared with 50-digit results for the
same floating-point inputs, and gradients are finite.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from precisions import both_precisions

from jaxvision import as_dtype, brdf
from jaxvision.brdf import microfacet
from jaxvision.brdf.blinn import Blinn, BlinnBRDF, NormalisedBlinn
from jaxvision.brdf.coated import Coated
from jaxvision.brdf.dichromatic import Dichromatic
from jaxvision.brdf.dichromatic_separation import (
    body_colour,
    illuminant_from_planes,
    plane_normal,
    separate,
)
from jaxvision.brdf.eon import EON
from jaxvision.brdf.fresnel import Conductor, Dielectric
from jaxvision.brdf.gaussian_lobe import GaussianLobe, GaussianLobeBRDF
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import NormalisedPhong, Phong, PhongBRDF
from jaxvision.brdf.torrance_sparrow import TorranceSparrow

RNG = np.random.default_rng(23)


def near_mirror(spread, count=24):
    """Return pairs whose half vectors lie about `spread` radians from the normal, from normal to
    grazing incidence."""
    pairs = []
    while len(pairs) < count:
        theta = 0.02 + 1.54 * len(pairs) / (count - 1)
        turn = RNG.uniform(0, 2 * np.pi)
        wo = np.array([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)])
        h = np.append(RNG.normal(size=2) * spread, 1)
        h /= np.linalg.norm(h)
        wi = 2 * (h @ wo) * h - wo
        if wi[2] > 0:
            pairs.append((wi, wo))
    return np.array(pairs)


def half(wi, wo):
    total = [a + b for a, b in zip(wi, wo, strict=True)]
    return [c / exact.length(total) for c in total]


def hidden(w, alpha, distribution):
    """Return z Lambda of Heitz (2014)."""
    t = mp.hypot(alpha[0] * w[0], alpha[1] * w[1])
    a = w[2] / t
    if distribution == "ggx":
        return w[2] * (mp.sqrt(1 + 1 / a**2) - 1) / 2
    return w[2] * ((mp.erf(a) - 1) / 2 + mp.exp(-a * a) / (2 * a * mp.sqrt(mp.pi)))


def torrance_sparrow(wi, wo, alpha, distribution, shadowing):
    h = half(wi, wo)
    across = (h[0] / alpha[0]) ** 2 + (h[1] / alpha[1]) ** 2
    scale = mp.pi * alpha[0] * alpha[1]
    if distribution == "ggx":
        d = 1 / (scale * (across + h[2] ** 2) ** 2)
    else:
        d = mp.exp(-across / h[2] ** 2) / (scale * h[2] ** 4)
    if shadowing == "smith":
        parts = [hidden(w, alpha, distribution) / w[2] for w in (wi, wo)]
        g = 1 / (1 + parts[0] + parts[1])
    else:
        facing = exact.dot(wo, h)
        g = min(1, 2 * h[2] * wo[2] / facing, 2 * h[2] * wi[2] / facing)
    steepness = across / h[2] ** 2
    return d * g / (4 * wi[2] * wo[2]), steepness


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize("roughness", [1e-4, 1e-2, 0.3, 1.0])
@pytest.mark.parametrize(
    ("distribution", "shadowing"), [("ggx", "smith"), ("beckmann", "smith"), ("ggx", "v-cavity")]
)
def test_torrance_sparrow_in_ulps(dtype, roughness, distribution, shadowing):
    """Given the two rounded directions, f_r has an error of a few ulps; the exponential of a
    Beckmann distribution magnifies rounding by its argument. (A half vector's angle by arccos would
    be off by half at 1e-4.)"""
    alpha = roughness * np.array([1.0, 1.3])
    material = as_dtype(
        TorranceSparrow([0.0], [1.0], alpha, distribution=distribution, shadowing=shadowing),
        dtype,
    )
    pairs = jnp.asarray(near_mirror(roughness), dtype)
    got = jax.jit(jax.vmap(brdf.evaluate, in_axes=(None, 0, 0)))(
        material, pairs[:, 0], pairs[:, 1]
    )[:, 0]
    rounded = [exact.number(a) for a in material.roughness]
    for (wi, wo), value in zip(pairs, got, strict=True):
        truth, steepness = torrance_sparrow(
            exact.vector(wi), exact.vector(wo), rounded, distribution, shadowing
        )
        assert exact.ulps(value, truth) <= 32 + 8 * float(steepness)


@both_precisions
def test_masking_at_grazing_angles(dtype):
    """z Lambda(w) is right to a few eps down to z = 1e-7, where Lambda itself is 1e7."""
    alpha = jnp.asarray([0.1, 0.4], dtype)
    for z in (1e-7, 1e-4, 0.05, 0.5):
        w = jnp.asarray(np.array([0.6, 0.8, z]) / np.hypot(1, z), dtype)
        for distribution in ("ggx", "beckmann"):
            got = microfacet.hidden_cosine(w, alpha, distribution=distribution)
            truth = hidden(exact.vector(w), exact.vector(alpha), distribution)
            error = abs(exact.number(got) - truth)
            assert error <= 8 * float(jnp.finfo(dtype).eps) * (truth + exact.number(w[2]) / 4)


@pytest.mark.slow
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_albedo_of_a_polished_surface_at_grazing_views(distribution):
    """Down to alpha cos(theta) of 1e-9, where two rounded directions no longer determine the facet
    between them, float32 agrees with float64, since no half vector is computed from them."""
    cases = np.array([[1e-4, 1e-4], [1e-6, 0.01], [1e-5, 1e-4], [1e-3, 1e-6]], np.float32)

    def albedo(case):
        alpha, cos_o = case
        wo = jnp.stack([jnp.sqrt(1 - cos_o**2), 0 * cos_o, cos_o])
        material = TorranceSparrow([0.0], [1.0], alpha, distribution=distribution)
        return brdf.albedo(as_dtype(material, cos_o.dtype), wo)[0]

    single, double = (
        jax.jit(jax.vmap(albedo))(jnp.asarray(cases, dtype)) for dtype in (jnp.float32, jnp.float64)
    )
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, rtol=3e-6)


@pytest.mark.slow
@pytest.mark.parametrize("record", [NormalisedPhong, NormalisedBlinn])
def test_albedo_of_the_sharpest_lobes(record):
    """At exponents up to 1e7 the float32 albedo is k_s along the normal, where the horizon cuts
    nothing off."""
    exponents = np.array([0.0, 1.0, 1e3, 1e5, 1e6, 1e7], np.float32)
    cosines = np.array([1.0, 0.9, 0.1, 1e-3], np.float32)

    def albedo(n, cos_o):
        wo = jnp.stack([jnp.sqrt((1 - cos_o) * (1 + cos_o)), 0 * cos_o, cos_o])
        return brdf.albedo(as_dtype(record([0.0], [1.0], n), cos_o.dtype), wo)[0]

    every = jax.jit(jax.vmap(jax.vmap(albedo, (0, None)), (None, 0)))
    single, double = (
        every(jnp.asarray(exponents, dtype), jnp.asarray(cosines, dtype))
        for dtype in (jnp.float32, jnp.float64)
    )
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single[0], 1, rtol=1e-6)
    np.testing.assert_allclose(single, double, rtol=1e-6)
    assert single.max() <= 1 + 1e-6


@pytest.mark.slow
@both_precisions
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_gradients_in_the_roughness_at_grazing_angles(dtype, distribution):
    """The gradient of the distribution for normals at cosines down to 1e-7, and alphas from below
    1e-6 to 10, is right."""
    cosines = jnp.logspace(-7, 0, 29, dtype=dtype)
    alphas = jnp.logspace(-6.5, 1, 31, dtype=dtype)

    def density(alpha, h):
        both = jnp.stack([alpha, alpha])
        return microfacet.normal_distribution(h, both, distribution=distribution)

    def of(cos, alpha):
        h = jnp.stack([jnp.sqrt((1 - cos) * (1 + cos)), 0 * cos, cos])
        return jax.value_and_grad(density, argnums=(0, 1))(alpha, h)

    every = jax.vmap(jax.vmap(of, (None, 0)), (0, None))
    values, (slopes, turns) = jax.jit(every)(cosines, alphas)
    for leaf in (values, slopes, turns):
        assert jnp.isfinite(leaf).all()
        assert leaf.dtype == dtype
    cos, alpha = np.asarray(cosines, float)[:, None], np.asarray(alphas, float)[None]
    ratio = (1 - cos) * (1 + cos) / (cos * alpha) ** 2
    if distribution == "beckmann":
        expected = 2 * ratio - 2
        there = (cos > 1e-4) & (alpha > 1.1e-6) & (ratio < 20)
    else:
        expected = 4 * ratio / (1 + ratio) - 2
        there = (alpha > 1.1e-6) & (ratio > 0) & (np.asarray(values) > 1e-25)
    found = np.asarray(slopes, float) * alpha / np.where(there, np.asarray(values, float), 1)
    assert there.sum() > 40
    tolerance = 40 * float(jnp.finfo(dtype).eps)
    error = np.abs(found - expected)[there] / (1 + ratio[there] * (distribution == "beckmann"))
    assert error.max() <= tolerance


def microfacets(**options):
    return [TorranceSparrow([0.1], [1.0], alpha, **options) for alpha in (0.0, 1e-4, 1.0)]


# Materials of one structure, at the extremes of each parameter.
MATERIALS = {
    "lambert": [Lambert([0.3])],
    "mirror": [Mirror([0.9])],
    "phong": [Phong([0.3], [0.5], 1e6), Phong([0.0], [0.0], 0.0)],
    "phong brdf": [PhongBRDF([0.3], [0.5], 1e6), PhongBRDF([0.0], [1.0], 0.0)],
    "normalised phong": [NormalisedPhong([0.3], [0.5], n) for n in (0.0, 1e6)],
    "gaussian": [GaussianLobe([0.3], [0.5], c) for c in (0.0, 1e3)],
    "gaussian brdf": [GaussianLobeBRDF([0.3], [0.5], c) for c in (0.0, 1e3)],
    "blinn": [Blinn([0.3], [0.5], n) for n in (0.0, 1e6)],
    "normalised blinn": [NormalisedBlinn([0.3], [0.5], n) for n in (0.0, 1e6)],
    "ggx": microfacets(interface=Conductor([0.2], [3.0])),
    "beckmann, v-cavity": microfacets(
        interface=Dielectric([1.5]), distribution="beckmann", shadowing="v-cavity"
    ),
    "oren-nayar": [OrenNayar([0.3], sigma) for sigma in (0.0, 1.0)],
    "full oren-nayar": [OrenNayar([0.3], sigma, form="full") for sigma in (0.0, 1.0)],
    "coated": [
        Coated(EON([0.3], 1.0), Dielectric([1.5]), a, optical_depth=[0.1]) for a in (0.0, 1.0)
    ],
    "multiple scattering": microfacets(multiple_scattering="kulla-conty"),
    "eon": [EON([0.3], r) for r in (0.0, 1.0)],
    "dichromatic": [Dichromatic(Lambert([0.3]), Blinn([0.0], [1.0], 9.0), [1.0], [0.0])],
    "beckmann": microfacets(distribution="beckmann"),
}
LONG = "beckmann", "coated", "multiple scattering"  # to compile
EDGES = {
    "both along the normal": ([0, 0, 1], [0, 0, 1]),
    "mirror": ([0.6, 0, 0.8], [-0.6, 0, 0.8]),
    "retro": ([0.6, 0, 0.8], [0.6, 0, 0.8]),
    "grazing light": ([1, 0, 1e-7], [0, 0, 1]),
    "grazing view": ([0, 0, 1], [0, 1, 1e-7]),
    "grazing both, across": ([1, 0, 1e-7], [-1, 0, 1e-7]),
    "grazing both, back": ([1, 0, 1e-7], [1, 0, 1e-7]),
    "light below": ([0, 0, -1], [0, 0, 1]),
    "opposite": ([0.6, 0, -0.8], [-0.6, 0, 0.8]),
    "in the surface": ([1, 0, 0], [-1, 0, 0]),
    "no direction": ([0, 0, 0], [0, 0, 1]),
}


@pytest.mark.sweep
@both_precisions
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in MATERIALS],
)
def test_all_five_functions_are_finite_at_every_edge(dtype, name):
    """Values are not negative, and the gradients by the material and both directions are finite."""
    materials = as_dtype(jax.tree.map(lambda *x: jnp.stack(x), *MATERIALS[name]), dtype)
    wi, wo = (jnp.asarray([pair[i] for pair in EDGES.values()], dtype) for i in (0, 1))
    corners = jnp.asarray(
        [[a, b, c] for a in (0, 0.999) for b in (0, 0.5) for c in (0, 0.999)], dtype
    )

    def of_a_pair(m, i, o):
        return jnp.stack([brdf.evaluate(m, i, o)[0], brdf.shading(m, i, o)[0], brdf.pdf(m, i, o)])

    def of_a_view(m, o):
        return brdf.albedo(m, o)[0]

    def of_a_sample(m, o, u):
        return jnp.stack(brdf.sample(m, o, u))

    def everything(m):
        each = jax.vmap(jax.jacrev(of_a_pair, argnums=(0, 1, 2)), in_axes=(None, 0, 0))
        samples = jax.vmap(jax.jacrev(of_a_sample, argnums=(0, 1)), in_axes=(None, 0, None))
        return (
            jax.vmap(of_a_pair, in_axes=(None, 0, 0))(m, wi, wo),
            each(m, wi, wo),
            jax.vmap(samples, in_axes=(None, None, 0))(m, wo, corners),
        )

    def albedos(m):
        views = jax.vmap(jax.value_and_grad(of_a_view, argnums=(0, 1)), in_axes=(None, 0))
        return views(m, wo)

    values, *slopes = jax.jit(jax.vmap(everything))(materials)
    assert (values >= 0).all()
    shine, *albedo_slopes = jax.jit(jax.vmap(albedos))(materials)
    assert (shine >= 0).all()
    for leaf in jax.tree.leaves((values, slopes, shine, albedo_slopes)):
        assert jnp.isfinite(leaf).all()
        assert leaf.dtype == dtype


@pytest.mark.slow
@both_precisions
def test_reflectance_separation_of_degenerate_pictures_is_finite(dtype):
    """Separation has finite results for pictures that are black, of one colour, along the
    illuminant, or negative by noise."""
    light = jnp.asarray([1, 0.9, 0.7], dtype)
    rows = jnp.stack([0 * light, light, 1 - light, -light / 100])

    def everything(image):
        normal, sizes = plane_normal(image)
        return (
            separate(image, light),
            separate(image, light, body=light),
            body_colour(image, light),
            normal,
            sizes,
        )

    slope = jax.grad(lambda x: separate(x, light).residual.sum())
    degenerate = jax.jit(jax.vmap(everything))(
        jnp.stack([0 * rows, jnp.broadcast_to(light, rows.shape), rows])
    )
    firmness = jax.jit(illuminant_from_planes)(0 * rows[:2])
    for leaf in jax.tree.leaves((degenerate, jax.jit(slope)(rows), firmness)):
        assert jnp.isfinite(leaf).all()
        assert leaf.dtype == dtype


@both_precisions
def test_gradient_of_the_share_of_a_tiny_albedo_is_finite(dtype):
    """The square of 1e-30 underflows in float32; the specular share of a single lobe is still 1,
    with a finite gradient."""
    up = jnp.asarray([0, 0, 1], dtype)
    zero, n = jnp.zeros(1, dtype), jnp.ones((), dtype)

    @jax.jit
    @jax.grad
    def slope(k):
        families = (PhongBRDF(k, zero, n), BlinnBRDF(k, zero, n), PhongBRDF(k, 2 * k, n))
        return sum(brdf.pdf(material, up, up) for material in families)

    assert jnp.isfinite(slope(jnp.asarray([1e-30], dtype))).all()


@both_precisions
def test_gradients_of_degenerate_illuminant_planes_are_finite(dtype):
    """With equal eigenvalues, for one plane given twice, no plane, or a black picture, gradients
    are finite."""

    def total(normals):
        colour, spread = illuminant_from_planes(normals)
        return colour.sum() + spread

    twice = np.array([[1, 0, 0], [1, 0, 0]], dtype)
    slopes = jax.jit(jax.vmap(jax.grad(total)))(np.stack([twice, 0 * twice]))
    assert np.isfinite(slopes).all()
    black = np.zeros((2, 2, 3), dtype)
    slope = jax.jit(jax.grad(lambda x: sum(map(jnp.sum, plane_normal(x)))))(black)
    assert np.isfinite(slope).all()


def test_gradients_of_illuminant_planes_match_differences():
    normals = RNG.normal(size=(4, 3))

    def first(normals):
        return illuminant_from_planes(normals)[0][0]

    first = jax.jit(first)
    slope = np.asarray(jax.jit(jax.grad(first))(normals))
    step = 1e-6 * RNG.normal(size=(4, 3))
    ahead, behind = (float(first(normals + sign * step)) for sign in (1, -1))
    np.testing.assert_allclose((slope * step).sum(), (ahead - behind) / 2, rtol=1e-6)
