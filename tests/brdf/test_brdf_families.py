"""Tests all families of BRDFs with the same checks, each in one compiled function.

The checks are reciprocity, energy conservation and the reduction to the isotropic case where a
family promises them, and a measured value where it does not. Samples are compared with their
density, and the albedo with adaptive quadrature and with the sampler's own estimate."""

from functools import partial
from itertools import pairwise, product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import brdfs
from scipy import integrate, stats

import jaxvision as jv
from jaxvision import brdf
from jaxvision.brdf import microfacet
from jaxvision.brdf.blinn import Blinn, BlinnBRDF, NormalisedBlinn
from jaxvision.brdf.dichromatic import Dichromatic
from jaxvision.brdf.eon import EON
from jaxvision.brdf.fresnel import Conductor, Dielectric
from jaxvision.brdf.gaussian_lobe import GaussianLobe, GaussianLobeBRDF
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.oren_nayar import OrenNayar
from jaxvision.brdf.phong import NormalisedPhong, Phong, PhongBRDF, power_integrals
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.geometry.hemisphere import local_frame, product_nodes, to_world
from jaxvision.scene import Material

RNG = np.random.default_rng(17)
KD, KS, ONE = [0.06, 0.1], [0.5, 0.4], [1.0]
GLASS, GOLD = Dielectric([1.5, 1.5]), Conductor([0.2, 0.4], [3.1, 2.4])

# name: (material, the same reflectance in plain NumPy for one pair of directions)
FAMILIES = {
    "lambert": (Lambert(KD), partial(brdfs.lambert, kd=KD)),
    "phong shading": (
        Phong(KD, KS, 12.0),
        partial(brdfs.phong, kd=KD, ks=KS, n=12, kind="shading"),
    ),
    "phong brdf": (PhongBRDF(KD, KS, 12.0), partial(brdfs.phong, kd=KD, ks=KS, n=12, kind="brdf")),
    "normalised phong": (
        NormalisedPhong(KD, KS, 12.0),
        partial(brdfs.phong, kd=KD, ks=KS, n=12, kind="normalised"),
    ),
    "gaussian shading": (
        GaussianLobe(KD, KS, 2.5),
        partial(brdfs.gaussian, kd=KD, ks=KS, c=2.5, kind="shading"),
    ),
    "gaussian brdf": (
        GaussianLobeBRDF(KD, KS, 2.5),
        partial(brdfs.gaussian, kd=KD, ks=KS, c=2.5, kind="brdf"),
    ),
    "blinn shading": (
        Blinn(KD, KS, 40.0),
        partial(brdfs.blinn, kd=KD, ks=KS, n=40, kind="shading"),
    ),
    "blinn brdf": (BlinnBRDF(KD, KS, 40.0), partial(brdfs.blinn, kd=KD, ks=KS, n=40, kind="brdf")),
    "normalised blinn": (
        NormalisedBlinn(KD, KS, 40.0),
        partial(brdfs.blinn, kd=KD, ks=KS, n=40, kind="normalised"),
    ),
    "ggx": (
        TorranceSparrow(KD, ONE, 0.3, interface=GLASS),
        partial(brdfs.torrance_sparrow, kd=KD, ks=1, alpha=(0.3, 0.3), eta=[1.5, 1.5], k=[0, 0]),
    ),
    "anisotropic ggx": (
        TorranceSparrow(KD, ONE, [0.2, 0.6], interface=GOLD),
        partial(
            brdfs.torrance_sparrow, kd=KD, ks=1, alpha=(0.2, 0.6), eta=[0.2, 0.4], k=[3.1, 2.4]
        ),
    ),
    "anisotropic beckmann": (
        TorranceSparrow(KD, KS, [0.5, 0.25], distribution="beckmann"),
        partial(brdfs.torrance_sparrow, kd=KD, ks=KS, alpha=(0.5, 0.25), distribution="beckmann"),
    ),
    "v-cavity beckmann": (
        TorranceSparrow(KD, ONE, 0.4, distribution="beckmann", shadowing="v-cavity"),
        partial(
            brdfs.torrance_sparrow,
            kd=KD,
            ks=1,
            alpha=(0.4, 0.4),
            distribution="beckmann",
            shadowing="v-cavity",
        ),
    ),
    "oren-nayar": (OrenNayar(KD, 0.5), partial(brdfs.oren_nayar, kd=KD, sigma=0.5, full=False)),
    "full oren-nayar": (
        OrenNayar(KD, 0.5, form="full"),
        partial(brdfs.oren_nayar, kd=KD, sigma=0.5, full=True),
    ),
    "eon": (EON(KD, 0.7), partial(brdfs.eon, kd=KD, r=0.7)),
    "dichromatic": (
        Dichromatic(Lambert([0.3]), NormalisedPhong([0.0], ONE, 20.0), [0.2, 0.5], [0.6, 0.5]),
        partial(brdfs.phong, kd=[0.06, 0.15], ks=[0.6, 0.5], n=20, kind="normalised"),
    ),
}
NOT_RECIPROCAL = {"phong shading", "gaussian shading", "blinn shading"}
every_family = pytest.mark.parametrize("name", FAMILIES)

# One compiled function for all materials of one structure.
EVALUATE = jax.jit(jax.vmap(brdf.evaluate, in_axes=(None, 0, 0)))
PDF = jax.jit(jax.vmap(brdf.pdf, in_axes=(None, 0, None)))
SAMPLE = jax.jit(jax.vmap(brdf.sample, in_axes=(None, None, 0)))
ALBEDO = jax.jit(jax.vmap(brdf.albedo, in_axes=(None, 0)))


def towards(theta, phi):
    """Return unit vectors (..., 3) at polar angle and azimuth."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )


def random_pairs(count):
    theta, phi = RNG.uniform(0, 1.55, (2, count)), RNG.uniform(0, 2 * np.pi, (2, count))
    wi, wo = towards(theta, phi)
    return jnp.asarray(wi), jnp.asarray(wo)


PAIRS = random_pairs(200)
VIEWS = jnp.asarray(towards([0.0, 0.7, 1.2, 1.45], [0.0, 0.4, 2.0, 4.0]))


@every_family
def test_against_plain_numpy(name):
    material, plain = FAMILIES[name]
    pairs = zip(*map(np.asarray, PAIRS), strict=True)
    expected = np.array([plain(wi, wo) for wi, wo in pairs])
    got = EVALUATE(material, *PAIRS)
    assert got.shape == (200, 2)
    assert (got >= 0).all()
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-14)


@every_family
def test_dark_where_either_side_lies_below(name):
    material, _ = FAMILIES[name]
    wi, wo = PAIRS
    flip = jnp.asarray([[1.0, 1.0, -1.0]])
    for pair in ((wi * flip, wo), (wi, wo * flip), (wi * flip, wo * flip)):
        assert (EVALUATE(material, *pair) == 0).all()


@pytest.mark.sweep
@every_family
def test_nothing_is_seen_from_below(name):
    material, _ = FAMILIES[name]
    assert (ALBEDO(material, VIEWS * jnp.asarray([[1.0, 1.0, -1.0]])) == 0).all()


def test_bands_that_do_not_fit_are_named():
    with pytest.raises(ValueError, match="interface must have 1 band or 3, as the others, got 2"):
        TorranceSparrow([0.1] * 3, ONE, 0.3, interface=Conductor([1.0, 2], [3.0, 4]))
    for interface in (Dielectric([1.5]), Dielectric([1.5] * 3), None):
        TorranceSparrow([0.1] * 3, ONE, 0.3, interface=interface)
    TorranceSparrow([0.1], ONE, 0.3, interface=Dielectric([1.5] * 3))


@every_family
def test_reciprocity(name):
    """Reciprocal families are reciprocal up to rounding. For the shading forms the ratio is the
    ratio of the cosines."""
    material, _ = FAMILIES[name]
    wi, wo = PAIRS
    there, back = EVALUATE(material, wi, wo), EVALUATE(material, wo, wi)
    if name in NOT_RECIPROCAL:
        specular = there - jnp.asarray([KD]), back - jnp.asarray([KD])
        sides = specular[0] * wi[:, 2:], specular[1] * wo[:, 2:]
        np.testing.assert_allclose(*sides, rtol=1e-9, atol=1e-14)
        assert float(jnp.abs(there / back - 1).max()) > 0.5
    else:
        np.testing.assert_allclose(there, back, rtol=1e-11, atol=1e-15)


@every_family
def test_rotating_both_directions_about_the_normal(name):
    """Rotating both directions about the normal changes nothing, unless the surface is
    anisotropic."""
    material, _ = FAMILIES[name]
    c, s = np.cos(1.1), np.sin(1.1)
    turn = jnp.asarray([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    wi, wo = PAIRS
    before, after = EVALUATE(material, wi, wo), EVALUATE(material, wi @ turn.T, wo @ turn.T)
    if "anisotropic" in name:
        assert float(jnp.abs(after / before - 1).max()) > 0.5
    else:
        np.testing.assert_allclose(after, before, rtol=1e-10, atol=1e-15)


@pytest.mark.sweep
@every_family
def test_albedo_against_adaptive_quadrature(name):
    """Closed forms in azimuth are exact, and the two-dimensional rules have at most their stated
    error."""
    material, plain = FAMILIES[name]
    got = ALBEDO(material, VIEWS)
    tolerance = 2e-4 if isinstance(material, TorranceSparrow | OrenNayar) else 1e-6
    for view in (1, 2):
        expected = brdfs.albedo(plain, np.asarray(VIEWS[view]))
        np.testing.assert_allclose(got[view], expected, rtol=tolerance)


@pytest.mark.sweep("v-cavity beckmann")
@every_family
def test_the_density_integrates_to_one(name):
    """The integral is over the whole sphere, because samples below the surface, which carry no
    light, also have density."""
    material, _ = FAMILIES[name]
    node, weight = np.polynomial.legendre.leggauss(128)
    theta = np.pi / 2 * (node + 1)
    weights = np.repeat(np.pi / 2 * weight * np.sin(theta) * 2 * np.pi / 128, 128)
    around = towards(theta[:, None], 2 * np.pi * np.arange(128) / 128).reshape(-1, 3)
    for wo in VIEWS[:3]:  # about the viewer, where half vectors are dense or sparse
        nodes = jax.vmap(to_world, in_axes=(None, 0))(local_frame(wo), jnp.asarray(around))
        density = PDF(material, nodes, wo)
        assert (density >= 0).all()
        np.testing.assert_allclose(density @ weights, 1, atol=2e-3)


@pytest.mark.sweep
@every_family
def test_samples_follow_their_density(name):
    """A chi-square test over 12 x 16 cells of equal solid angle on the whole sphere."""
    material, _ = FAMILIES[name]
    wo, count, rows, columns, fine = VIEWS[1], 40_000, 12, 16, 12
    u = jnp.asarray(RNG.uniform(size=(count, 3)))
    w = np.asarray(SAMPLE(material, wo, u))
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1, rtol=1e-9)
    phi = np.arctan2(w[:, 1], w[:, 0]) % (2 * np.pi)
    observed, *_ = np.histogram2d(
        w[:, 2], phi, bins=(rows, columns), range=((-1, 1), (0, 2 * np.pi))
    )
    z = -1 + (np.arange(rows * fine) + 0.5) * 2 / (rows * fine)
    azimuth = (np.arange(columns * fine) + 0.5) * 2 * np.pi / (columns * fine)
    grid = towards(np.arccos(z)[:, None], azimuth).reshape(-1, 3)
    density = np.asarray(PDF(material, jnp.asarray(grid), wo))
    expected = density.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    expected *= count * 4 * np.pi / (rows * columns)
    assert likelihood(observed, expected) > 1e-4


def likelihood(observed, expected):
    """Return the probability of a chi-square at least this large, with cells of few samples merged
    into one."""
    many = expected > 10
    few_seen, few_meant = observed[~many].sum(), expected[~many].sum()
    chi = ((observed - expected)[many] ** 2 / expected[many]).sum()
    if few_meant > 1:
        chi += (few_seen - few_meant) ** 2 / few_meant
    return stats.chi2.sf(chi, many.sum())


every_microfacet = pytest.mark.parametrize(
    ("distribution", "shadowing"), list(product(("ggx", "beckmann"), ("smith", "v-cavity")))
)


@pytest.mark.sweep
@every_microfacet
@pytest.mark.parametrize("cos_o", [0.9, 0.05])
def test_samples_of_narrow_lobes_follow_their_density(distribution, shadowing, cos_o):
    """The lobe (alpha 0.1) is seen near the normal and at a grazing angle, and drawn in float32."""
    lobe = TorranceSparrow([0.0], ONE, 0.1, distribution=distribution, shadowing=shadowing)
    count, rows, columns, fine, reach = 40_000, 16, 12, 8, 0.3
    wo = jnp.asarray([np.sqrt(1 - cos_o**2), 0, cos_o])
    u = jnp.asarray(RNG.uniform(size=(count, 3)), jnp.float32)
    drawn = SAMPLE(jv.as_dtype(lobe, jnp.float32), wo.astype(jnp.float32), u)
    h = np.asarray(drawn, np.float64) + np.asarray(wo)
    slopes = h[:, :2] / h[:, 2:]
    observed, *_ = np.histogram2d(*slopes.T, bins=(rows, columns), range=((-reach, reach),) * 2)
    p, q = (reach * (2 * (np.arange(n * fine) + 0.5) / (n * fine) - 1) for n in (rows, columns))
    p, q = (x.ravel() for x in np.meshgrid(p, q, indexing="ij"))
    h = np.stack([p, q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p * p + q * q)[:, None]
    d = h @ np.asarray(wo)
    density = PDF(lobe, jnp.asarray(2 * d[:, None] * h - np.asarray(wo)), wo)
    # dwi = 4 wo.h dh and dh = h.z^3 dp dq; facets that face away reflect nothing.
    density = np.where(d > 0, np.asarray(density) * 4 * d * h[:, 2] ** 3, 0)
    expected = density.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    expected *= count * (2 * reach) ** 2 / (rows * columns)
    cells = (np.append(x, count - x.sum()) for x in (observed, expected))
    assert likelihood(*cells) > 1e-4


@pytest.mark.sweep
@every_microfacet
def test_the_weight_of_a_sample_is_bounded(distribution, shadowing):
    """The weight f_r cos / pdf is at most k_s if visible facets are drawn. It is at most 2.7 k_s
    for Smith's Beckmann facets, which are drawn as GGX, at the largest roughness and grazing
    angles."""
    lobe = TorranceSparrow([0.0], ONE, 1.0, distribution=distribution, shadowing=shadowing)
    most = 2.7 if (distribution, shadowing) == ("beckmann", "smith") else 1 + 1e-12
    u = jnp.asarray(RNG.uniform(size=(4000, 3)))
    for cos_o in (1e-4, 0.01, 0.3, 1.0):
        wo = jnp.asarray([np.sqrt(1 - cos_o**2), 0, cos_o])
        wi = SAMPLE(lobe, wo, u)
        value = EVALUATE(lobe, wi, jnp.broadcast_to(wo, wi.shape))[:, 0]
        assert (value * wi[:, 2] <= most * PDF(lobe, wi, wo)).all()


@pytest.mark.sweep
@every_microfacet
def test_albedo_of_the_roughest_facets(distribution, shadowing):
    """With alpha = 1 along the normal, one integral over the polar angle remains (1 - ln 2 for
    Smith's GGX). At a cosine of 0.02, half of the directions that a facet could reflect to are
    below the horizon."""
    lobe = TorranceSparrow([0.0], ONE, 1.0, distribution=distribution, shadowing=shadowing)
    views = towards(np.arccos([1.0, 0.02]), 0.3)
    got = np.asarray(ALBEDO(lobe, jnp.asarray(views)))[:, 0]
    plain = partial(
        brdfs.torrance_sparrow,
        kd=[0.0],
        ks=1,
        alpha=(1, 1),
        distribution=distribution,
        shadowing=shadowing,
    )

    def ring(theta):
        wi = np.array([np.sin(theta), 0, np.cos(theta)])
        return np.pi * np.sin(2 * theta) * plain(wi, np.array([0, 0, 1.0]))[0]

    truth, _ = integrate.quad(ring, 0, np.pi / 2, points=[np.pi / 3])
    closely, roughly = (1e-8, 1e-4) if shadowing == "smith" else (4e-4, 4e-4)  # a kinked min
    np.testing.assert_allclose(got[0], truth, atol=closely)
    if (distribution, shadowing) == ("ggx", "smith"):
        np.testing.assert_allclose(got[0], 1 - np.log(2), rtol=1e-13)
    np.testing.assert_allclose(got[1], brdfs.albedo(plain, views[1])[0], atol=roughly)


# ------------------------------------------------ energy


CLOSED = {  # families that promise albedo <= pi k_d + k_s, at pi k_d + k_s = 1
    **{f"normalised phong {n}": NormalisedPhong([0.0], ONE, n) for n in (0.0, 1.0, 10.0, 1e3, 1e6)},
    **{f"normalised blinn {n}": NormalisedBlinn([0.0], ONE, n) for n in (0.0, 1.0, 10.0, 1e3, 1e6)},
    **{
        f"{d} {s} {a}": TorranceSparrow([0.0], ONE, a, distribution=d, shadowing=s)
        for d in ("ggx", "beckmann")
        for s in ("smith", "v-cavity")
        for a in (1e-3, 0.1, 0.5, 1.0)
    },
}


@pytest.mark.sweep
@pytest.mark.parametrize("name", CLOSED)
def test_albedo_is_at_most_one(name):
    """The albedo is at most 1 from the normal to grazing angles, with coefficients at the limit of
    the promise."""
    grazing = np.arccos([0.02, 1e-3, 1e-4])
    views = jnp.asarray(towards(np.concatenate([np.linspace(0, 1.5, 11), grazing]), 0.3))
    got = np.asarray(ALBEDO(CLOSED[name], views))
    assert (got > 0).all()
    assert got.max() <= 1 + 1e-9


@pytest.mark.slow
def test_albedo_of_a_bright_body_under_glass():
    """The body is not attenuated by the interface, so the albedo exceeds 1 and is bounded by pi k_d
    + k_s."""
    cos_o = np.array([1, 0.5, 0.2, 0.05, 0.02, 1e-4])
    bright = TorranceSparrow([0.9 / np.pi], ONE, 0.1, interface=Dielectric([1.5]))
    got = np.asarray(ALBEDO(bright, jnp.asarray(towards(np.arccos(cos_o), 0.3))))[:, 0]
    np.testing.assert_allclose(got[:5], [0.940, 0.986, 1.137, 1.254, 1.284], atol=1e-3)
    assert got.max() <= 0.9 + 1


@pytest.mark.sweep
@pytest.mark.parametrize("r", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("cos_o", [1.0, 0.5, 0.05, 1e-4])
def test_white_facets_with_multiple_scattering_return_all_light(r, cos_o):
    """For EON with albedo 1, the integral of f_r cos(theta_i) by adaptive quadrature between the
    kinks is 1, and so is the closed form. For grey facets the two agree."""
    wo = jnp.asarray([np.sqrt(1 - cos_o**2), 0, cos_o])
    edges = np.unique(np.clip([0, cos_o / 2, cos_o, 2 * cos_o, 20 * cos_o, 1], 0, 1))
    x, w = np.polynomial.legendre.leggauss(60)
    nodes = np.concatenate([(b + a) / 2 + (b - a) / 2 * x for a, b in pairwise(edges)])
    weights = np.concatenate([(b - a) / 2 * w for a, b in pairwise(edges)])
    phi = np.concatenate([middle + np.pi / 2 * x for middle in (0, np.pi)])
    turn = np.tile(np.pi / 2 * w, 2)
    wi = jnp.asarray(towards(np.arccos(nodes)[:, None], phi).reshape(-1, 3))
    weight = ((weights * nodes)[:, None] * turn).ravel()
    for rho in (1.0, 0.5):
        material = EON([rho / np.pi], r)
        values = np.asarray(EVALUATE(material, wi, jnp.broadcast_to(wo, wi.shape)))[:, 0]
        got = np.asarray(ALBEDO(material, wo[None]))[0, 0]
        np.testing.assert_allclose(values @ weight, got, atol=1e-9)
        assert rho < 1 or abs(got - 1) < 1e-12


@pytest.mark.parametrize(
    ("n", "plain", "cosine"),
    [(0.1, 2e-5, 1.1e-8), (0.5, 3e-6, 3e-9), (1.5, 3e-9, 1e-11), (2.3, 1e-10, 1e-10)],
)
def test_a_blunt_lobe_about_the_normal(n, plain, cosine):
    """The integrals are 2 pi / (n + 1) and 2 pi / (n + 2), within the docstring's error if n is not
    an integer."""
    got = jax.jit(power_integrals)(jnp.asarray(1.0), jnp.asarray(n))
    np.testing.assert_allclose(got[0], 2 * np.pi / (n + 1), rtol=plain)
    np.testing.assert_allclose(got[1], 2 * np.pi / (n + 2), rtol=cosine)


@pytest.mark.slow
def test_energy_of_the_textbook_lobes_and_the_full_oren_nayar():
    """These families promise no energy conservation, and the test pins the measured values."""
    grazing = jnp.asarray(towards(np.array([1.5]), 0.0))
    nodes, weights = product_nodes(64, 128)

    def sent_out(material):
        wi = jnp.broadcast_to(grazing, nodes.shape)
        return float((weights * nodes[:, 2]) @ EVALUATE(material, wi, jnp.asarray(nodes))[:, 0])

    # k_s for which a normal view sees an albedo of 1
    np.testing.assert_allclose(sent_out(Phong([0.0], [11 / (2 * np.pi)], 10.0)), 2.09, atol=0.01)
    np.testing.assert_allclose(
        sent_out(PhongBRDF([0.0], [12 / (2 * np.pi)], 10.0)), 0.161, atol=0.001
    )
    views = jnp.asarray(towards(np.linspace(0, 1.57, 14), 0.3))
    for form, sigma, highest in (("qualitative", 0.2, 1.015), ("full", 0.3, 1.051)):
        rough = ALBEDO(OrenNayar([1 / np.pi], sigma, form=form), views)
        np.testing.assert_allclose(rough.max(), highest, atol=0.002)


# ------------------------------------------------ a family of the user's own


class Unregistered(Material):
    """A material that no table knows."""


def test_the_table_names_what_is_missing():
    with pytest.raises(TypeError, match="Unregistered is no known material"):
        brdf.evaluate(Unregistered(), *(w[0] for w in PAIRS))
    with pytest.raises(ValueError, match="pdf without sample"):
        brdf.register(Unregistered, evaluate=brdf.evaluate, pdf=brdf.pdf)


# ------------------------------------------------ the mirror


def test_a_mirror_reflects_all_light_into_one_direction():
    """The mirror has no density. Its sample is the mirror direction, weighted by the albedo."""
    material, wo = Mirror([0.9, 0.8]), VIEWS[1]
    s = brdf.sample(material, wo, jnp.asarray([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(s, jv.mirror_direction(jnp.asarray([0.0, 0, 1]), wo), rtol=1e-15)
    np.testing.assert_array_equal(brdf.albedo(material, wo), [0.9, 0.8])
    np.testing.assert_array_equal(brdf.evaluate(material, s, wo), [0, 0])
    np.testing.assert_array_equal(brdf.pdf(material, s, wo), 0)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_projected_areas_of_facets_and_of_visible_facets(distribution):
    """Checks the integrals that define D and G1 (Heitz 2014, equations 3 and 14)."""
    t, dt = np.polynomial.legendre.leggauss(200)
    theta = np.pi / 4 * (t + 1)
    weights = np.repeat(np.pi / 4 * dt * np.sin(theta) * 2 * np.pi / 128, 128)
    h = jnp.asarray(towards(theta[:, None], 2 * np.pi * np.arange(128) / 128).reshape(-1, 3))
    alpha = jnp.asarray([0.3, 0.5])
    d = jax.jit(
        jax.vmap(partial(microfacet.normal_distribution, alpha=alpha, distribution=distribution))
    )(h)
    np.testing.assert_allclose(weights @ (d * h[:, 2]), 1, rtol=1e-9)
    for wo in VIEWS[1:]:
        seen = float(wo[2]) + float(microfacet.hidden_cosine(wo, alpha, distribution=distribution))
        facing = weights @ (d * jnp.maximum(h @ wo, 0))
        np.testing.assert_allclose(seen, facing, rtol=2e-4)


def test_neutral_and_shared_coefficients():
    """A k_s of one band applies to all bands. If one array is both k_a and k_d, its gradient is the
    sum of both."""
    wi, wo = PAIRS[0][0], PAIRS[1][0]
    neutral = brdf.evaluate(PhongBRDF(KD, [0.3], 5.0), wi, wo)
    spelled = brdf.evaluate(PhongBRDF(KD, [0.3, 0.3], 5.0), wi, wo)
    np.testing.assert_array_equal(neutral, spelled)

    def seen(shared, ambient):
        material = Phong(shared, [0.3], 5.0, ambient=ambient)
        light = jv.DirectionalLight(wi, [1.0, 1.0])
        up = jnp.asarray([0.0, 0.0, 1.0])
        return jv.outgoing_radiance(
            material, [light], jnp.zeros(3), up, wo, ambient=jv.AmbientLight([0.5, 0.5])
        ).sum()

    kd = jnp.asarray(KD)
    apart = jax.grad(seen, argnums=(0, 1))(kd, kd)
    np.testing.assert_allclose(jax.grad(lambda k: seen(k, k))(kd), sum(apart), rtol=1e-15)


def test_the_tangent_rotates_an_anisotropic_surface():
    """Rotating the tangent is equivalent to rotating light and view by the opposite angle."""
    material, _ = FAMILIES["anisotropic ggx"]
    up = jnp.asarray([0.0, 0.0, 1.0])
    wi, wo = PAIRS[0][0], PAIRS[1][0]
    tangent = jnp.asarray([np.cos(0.8), np.sin(0.8), 0.4])  # z is ignored
    c, s = np.cos(-0.8), np.sin(-0.8)
    turn = jnp.asarray([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    got = brdf.reflect(material, up, wi, wo, tangent=tangent)
    np.testing.assert_allclose(got, brdf.shading(material, turn @ wi, turn @ wo), rtol=1e-12)
    assert float(jnp.abs(got / brdf.reflect(material, up, wi, wo) - 1).max()) > 0.01
