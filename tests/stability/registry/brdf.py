"""Oracles for reflectance: Fresnel, facets, lobes."""

import jax.numpy as jnp
import numpy as np
from oracle_space import angle, inner, log_cos

from jaxvision.brdf import blinn, gaussian_lobe, glass, lambert, microfacet, phong
from jaxvision.brdf import fresnel as fr
from jaxvision.core._vector import as_array

from .entry import Columns, Entry, Range, Unit
from .vectors import NearTo

COSINE = Range(1e-5, 1.0)
ROUGH = Columns(Range(1e-3, 1.0), 2)
ABOVE = Unit(above=True)


def vec(*v):
    return np.array(v, float)


def unit(*v):
    return vec(*v) / np.linalg.norm(v)


def dielectric(m, c, eta):
    """Return the reflectance by the amplitudes of Fresnel's equations."""
    c = m.minimum(m.maximum(c, m.c("0")), m.c("1"))
    square = eta * eta - 1 + c * c
    passes = square > 0
    g = m.sqrt(m.where(passes, square, m.c("1")))
    r_s, r_p = (c - g) / (c + g), (eta * eta * c - g) / (eta * eta * c + g)
    return m.where(passes, (r_s * r_s + r_p * r_p) / 2, m.c("1"))


def conductor(m, c, eta, k):
    """Return the reflectance with (a + i b)^2 = (eta + i k)^2 - sin^2, Born and Wolf, section
    14.2."""
    c = m.minimum(m.maximum(c, m.c("0")), m.c("1"))
    s2 = 1 - c * c
    real, half = eta * eta - k * k - s2, eta * k
    modulus = m.sqrt(real * real + 4 * half * half)
    a, b = m.sqrt((modulus + real) / 2), m.sqrt((modulus - real) / 2)
    r_s = ((a - c) ** 2 + b * b) / ((a + c) ** 2 + b * b)
    r_p = ((a * c - s2) ** 2 + b * b * c * c) / ((a * c + s2) ** 2 + b * b * c * c)
    return r_s * (1 + r_p) / 2


def schlick(m, c, f0):
    return f0 + (1 - f0) * (1 - m.minimum(m.maximum(c, m.c("0")), m.c("1"))) ** 5


def spread(h, alpha):
    return (h[:, 0] / alpha[:, 0]) ** 2 + (h[:, 1] / alpha[:, 1]) ** 2


def ggx(m, h, alpha):
    square = spread(h, alpha) + h[:, 2] ** 2
    return 1 / (m.pi * alpha[:, 0] * alpha[:, 1] * square**2)


def beckmann(m, h, alpha):
    z2 = h[:, 2] ** 2
    return m.exp(-spread(h, alpha) / z2) / (m.pi * alpha[:, 0] * alpha[:, 1] * z2 * z2)


def hidden_ggx(m, w, alpha):
    square = (w[:, 0] * alpha[:, 0]) ** 2 + (w[:, 1] * alpha[:, 1]) ** 2
    return (m.sqrt(w[:, 2] ** 2 + square) - w[:, 2]) / 2


def half(m, wi, wo):
    both = wi + wo
    return both / m.sqrt(inner(both, both))[:, None]


def facet_pdf(m, wi, wo, alpha):
    return ggx(m, half(m, wi, wo), alpha) / (4 * (wo[:, 2] + hidden_ggx(m, wo, alpha)))


def smith_ggx(m, wi, wo, alpha):
    ci, co = wi[:, 2], wo[:, 2]
    return 1 / (4 * (ci * co + ci * hidden_ggx(m, wo, alpha) + co * hidden_ggx(m, wi, alpha)))


def v_cavity(m, wi, wo):
    h, ci, co = half(m, wi, wo), wi[:, 2], wo[:, 2]
    d = inner(wo, h) / (2 * h[:, 2])
    return 1 / (4 * m.maximum(ci * co, m.maximum(ci * d, co * d)))


def refracted(m, w, eta):
    return (
        -w[:, 0] / eta,
        -w[:, 1] / eta,
        -m.sqrt((eta * eta - 1 + w[:, 2] ** 2) / (eta * eta)),
    )


def log_cos_half(m, wi, wo):
    both = wi + wo
    return -m.log1p((both[:, 0] ** 2 + both[:, 1] ** 2) / both[:, 2] ** 2) / 2


def blinn_factor(m, n):
    return (n + 2) * (n + 4) / (8 * m.pi * (n + m.power(m.c("2"), -n / 2)))


def one(function):
    """Return a function of bands for a single band."""
    return lambda c, *bands: function(c, *(band[None] for band in bands))[0]


GRAZING = ((0.0, 1.5), (1e-6, 1.5), (1.0, 1.5), (0.5, 1.0 + 1e-6), (1.0, 1.0 + 1e-4), (0.3, 100.0))
TAIL = "the exponential of a large argument"
ENTRIES = [
    Entry(
        "brdf.fresnel.fresnel_dielectric",
        one(fr.fresnel_dielectric),
        dielectric,
        (COSINE, Range(1.0001, 100)),
        GRAZING,
        bound=14.0,
        gradient=1e-4,
        form="eta above 1",
        note="squares of quotients of squares",
    ),
    Entry(
        "brdf.fresnel.fresnel_dielectric",
        one(fr.fresnel_dielectric),
        dielectric,
        (COSINE, Range(0.01, 0.9999, log=False)),
        ((0.01, 0.5), (0.9, 0.5), (1.0, 0.9)),
        form="eta below 1",
        bound=105,
        conditioned=True,
        gradient=1e-3,
        note="near the critical angle",
    ),
    Entry(
        "brdf.fresnel.fresnel_conductor",
        one(fr.fresnel_conductor),
        conductor,
        (COSINE, Range(1.0001, 10), Range(0.01, 20)),
        ((1e-6, 3.0, 20.0), (0.5, 1.0, 1e-3), (1.0, 1.5, 1e-4)),
        form="eta above 1",
        bound=13.0,
        gradient=1e-4,
        note="squares of quotients of squares",
    ),
    Entry(
        "brdf.fresnel.fresnel_conductor",
        one(fr.fresnel_conductor),
        conductor,
        (COSINE, Range(0.01, 0.9999), Range(0.01, 20)),
        (
            (0.0, 0.2, 3.0),
            (1.0, 0.2, 3.0),
            (0.5902043581008911, 0.8119972944259644, 0.0020603977609425783),
        ),
        form="eta below 1",
        conditioned=True,
        gradient=1e-4,
        note="near the critical angle",
    ),
    Entry(
        "brdf.fresnel.fresnel_schlick",
        one(fr.fresnel_schlick),
        schlick,
        (COSINE, Range(1e-4, 1.0)),
        ((1.0, 0.04), (0.0, 0.04), (0.99, 1e-6)),
        note="a fifth power of a difference",
        bound=5.0,
    ),
    Entry(
        "brdf.fresnel.fresnel",
        lambda c, f0: fr.fresnel(fr.Schlick(f0[None]), c)[0],
        schlick,
        (COSINE, Range(1e-4, 1.0)),
        bound=5.0,
    ),
    Entry(
        "brdf.microfacet.normal_distribution",
        lambda h, a: microfacet.normal_distribution(h, a, distribution="ggx"),
        ggx,
        (ABOVE, ROUGH),
        ((vec(0, 0, 1), vec(2e-6, 2e-6)), (vec(0.8, 0, 0.6), vec(1, 1e-3))),
        form="ggx",
        bound=12.0,
        note="a square of a sum of squares",
    ),
    Entry(
        "brdf.microfacet.normal_distribution",
        lambda h, a: microfacet.normal_distribution(h, a, distribution="beckmann"),
        beckmann,
        (Unit(least=0.35), Columns(Range(0.35, 1.0), 2)),
        ((vec(0, 0, 1), vec(1e-3, 1e-3)), (vec(0.6, 0, 0.8), vec(0.5, 0.5))),
        form="beckmann",
        conditioned=True,
        gradient=1e-4,
        note=TAIL,
    ),
    Entry(
        "brdf.microfacet.hidden_cosine",
        lambda w, a: microfacet.hidden_cosine(w, a, distribution="ggx"),
        hidden_ggx,
        (ABOVE, ROUGH),
        ((vec(0.6, 0, 0.8), vec(1e-4, 1e-4)), (vec(1, 0, 0), vec(0.1, 0.1))),
        form="ggx",
        bound=6.0,
    ),
    Entry(
        "brdf.microfacet.visibility",
        lambda wi, wo, a: microfacet.visibility(
            wi, wo, microfacet.half_vector(wi, wo), a, distribution="ggx", shadowing="smith"
        ),
        smith_ggx,
        (ABOVE, ABOVE, ROUGH),
        ((unit(1, 0, 1e-4), unit(-1, 0, 1e-4), vec(0.1, 0.1)),),
        form="ggx, smith",
        bound=7.0,
    ),
    Entry(
        "brdf.microfacet.visibility",
        lambda wi, wo: microfacet.visibility(
            wi,
            wo,
            microfacet.half_vector(wi, wo),
            jnp.full(2, 0.3, wi.dtype),
            distribution="ggx",
            shadowing="v-cavity",
        ),
        v_cavity,
        (ABOVE, ABOVE),
        form="v-cavity",
        conditioned=True,
        gradient=None,
        note="includes the rounding of the half vector; the slope is along the sphere",
    ),
    Entry(
        "brdf.microfacet.half_vector",
        lambda wi, wo: as_array(microfacet.half_vector(wi, wo)),
        lambda m, wi, wo: tuple(half(m, wi, wo).T),
        (ABOVE, ABOVE),
        parts=("x", "y", "z"),
        conditioned=True,
        note="x and y, for opposite directions",
    ),
    Entry(
        "brdf.microfacet.facet_pdf",
        microfacet.facet_pdf,
        facet_pdf,
        (ABOVE, ABOVE, ROUGH),
        conditioned=True,
        bound=8,
        gradient=1e-3,
        note="the half vector of directions that nearly cancel",
    ),
    Entry(
        "brdf.microfacet.clamped_roughness",
        microfacet.clamped_roughness,
        lambda m, a: tuple(a.T),
        (ROUGH,),
        parts=("x", "y"),
        bound=0,
    ),
    Entry(
        "brdf.phong.phong_lobe",
        phong.phong_lobe,
        lambda m, x, n: m.exp(n * x),
        (Range(-1.0, -1e-6, log=False), Range(0.1, 80)),
        ((0.0, 1e6), (-1e-8, 1e6), (-1e-30, 1.0)),
        conditioned=True,
        note=TAIL,
    ),
    Entry(
        "brdf.phong.power_pdf",
        phong.power_pdf,
        lambda m, a, w, n: (n + 1) / (2 * m.pi) * m.exp(n * log_cos(m, a, w)),
        (NearTo(), NearTo(), Range(1, 50)),
        conditioned=True,
        gradient=None,
        note=TAIL + "; lengths of directions are taken as exactly 1",
    ),
    Entry(
        "brdf.gaussian_lobe.gaussian_lobe",
        gaussian_lobe.gaussian_lobe,
        lambda m, t, c: m.exp(-((c * t) ** 2)),
        (Range(1e-6, 1.0), Range(0.1, 8)),
        ((0.0, 1e6), (1e-30, 1.0)),
        conditioned=True,
        note=TAIL,
    ),
    Entry(
        "brdf.gaussian_lobe.squared_angle_between",
        gaussian_lobe.squared_angle_between,
        lambda m, u, v: angle(m, u, v) ** 2,
        (Unit(), Unit()),
        (
            (vec(0, 0, 1), unit(1e-6, 0, 1)),
            (vec(0, 0, 1), vec(1, 0, 0)),
            (vec(0, 0, 1), vec(0, 0, 1)),
        ),
        bound=8,
        gradient=None,
        note="lengths of directions are taken as exactly 1; the slope is along the sphere",
    ),
    Entry(
        "brdf.blinn.log_cos_half",
        blinn.log_cos_half,
        log_cos_half,
        (ABOVE, ABOVE),
        ((unit(1e-6, 0, 1), unit(-0.5e-6, 0, 1)),),
        conditioned=True,
        gradient=1e-4,
        note="directions that nearly cancel",
    ),
    Entry(
        "brdf.blinn.normalisation",
        blinn.normalisation,
        blinn_factor,
        (Range(1e-6, 1e6),),
        ((0.0,), (1e-30,), (1e10,), (1e20,)),
        bound=5,
    ),
    Entry(
        "brdf.glass.refracted_direction",
        lambda w, eta: as_array(glass.refracted_direction(w, eta)),
        refracted,
        (ABOVE, Range(1.0001, 10)),
        ((unit(1, 0, 1e-4), 1.5), (vec(0.6, 0, 0.8), 1.0 + 1e-6)),
        parts=("x", "y", "z"),
        gradient=1e-4,
    ),
    Entry(
        "brdf.lambert.lambert_shading",
        lambda n, w, k: lambert.lambert_shading(n, w, k[None])[0],
        lambda m, n, w, k: k * m.maximum(inner(n, w), m.c("0")),
        (Unit(), Unit(), Range(1e-3, 1)),
        conditioned=True,
        note="at the terminator",
    ),
]
