"""Every BRDF family as printed in its source, for one pair of directions in NumPy, with angles and
without the library's reformulations. Directions are in the local frame. Each function returns f_r
as a list of bands."""

import cmath
import math
from functools import lru_cache
from itertools import pairwise

import numpy as np


def angle(u, v):
    return math.acos(max(-1.0, min(1.0, float(np.dot(u, v)))))


def with_lobe(wi, kd, ks, lobe, kind, constant):
    factor = {"shading": 1 / wi[2], "brdf": 1.0, "normalised": constant}[kind]
    return np.asarray(kd) + np.asarray(ks) * lobe * factor


def lambert(wi, wo, *, kd):
    return np.asarray(kd)


def phong(wi, wo, *, kd, ks, n, kind):
    mirror = 2 * wi[2] * np.array([0, 0, 1.0]) - wi
    return with_lobe(wi, kd, ks, max(0.0, mirror @ wo) ** n, kind, (n + 2) / (2 * math.pi))


def gaussian(wi, wo, *, kd, ks, c, kind):
    theta = angle(2 * wi[2] * np.array([0, 0, 1.0]) - wi, wo)
    return with_lobe(wi, kd, ks, math.exp(-((c * theta) ** 2)), kind, None)


def blinn(wi, wo, *, kd, ks, n, kind):
    h = (wi + wo) / np.linalg.norm(wi + wo)
    constant = (n + 2) * (n + 4) / (8 * math.pi * (2 ** (-n / 2) + n))
    return with_lobe(wi, kd, ks, h[2] ** n, kind, constant)


def fresnel(cos_i, eta, k):
    """Return the unpolarised reflectance from the complex amplitudes; k = 0 is a dielectric."""
    m = complex(eta, k)
    cos_t = cmath.sqrt(1 - (1 - cos_i**2) / m**2)
    s = (cos_i - m * cos_t) / (cos_i + m * cos_t)
    p = (m * cos_i - cos_t) / (m * cos_i + cos_t)
    return (abs(s) ** 2 + abs(p) ** 2) / 2


def smith_lambda(w, alpha, distribution):
    """Return Heitz (2014), equations 68 and 72, with the roughness in the direction's azimuth."""
    sin_t = math.hypot(w[0], w[1])
    if sin_t == 0:
        return 0.0
    a_o = math.hypot(alpha[0] * w[0], alpha[1] * w[1]) / sin_t
    a = 1 / (a_o * (sin_t / w[2]))
    if distribution == "ggx":
        return (-1 + math.sqrt(1 + 1 / a**2)) / 2
    return (math.erf(a) - 1) / 2 + math.exp(-a * a) / (2 * a * math.sqrt(math.pi))


def facets(h, alpha, distribution):
    cos, phi = h[2], math.atan2(h[1], h[0])
    tan2 = (1 - cos**2) / cos**2
    e = tan2 * (math.cos(phi) ** 2 / alpha[0] ** 2 + math.sin(phi) ** 2 / alpha[1] ** 2)
    scale = math.pi * alpha[0] * alpha[1] * cos**4
    return math.exp(-e) / scale if distribution == "beckmann" else 1 / (scale * (1 + e) ** 2)


def torrance_sparrow(
    wi, wo, *, kd, ks, alpha, eta=None, k=None, distribution="ggx", shadowing="smith"
):
    h = (wi + wo) / np.linalg.norm(wi + wo)
    d = float(wo @ h)
    if shadowing == "smith":
        g = 1 / (1 + sum(smith_lambda(w, alpha, distribution) for w in (wi, wo)))
    else:
        g = min(1.0, 2 * h[2] * wo[2] / d, 2 * h[2] * wi[2] / d)
    f = 1.0 if eta is None else np.array([fresnel(d, *index) for index in zip(eta, k, strict=True)])
    lobe = f * facets(h, alpha, distribution) * g / (4 * wi[2] * wo[2])
    return np.asarray(kd) + np.asarray(ks) * lobe


def oren_nayar(wi, wo, *, kd, sigma, full):
    """Return the paper's equations 27 to 30, in angles."""
    t_i, t_o = math.acos(wi[2]), math.acos(wo[2])
    phi = math.atan2(wi[1], wi[0]) - math.atan2(wo[1], wo[0])
    a, b = max(t_i, t_o), min(t_i, t_o)
    v, rho = sigma**2, np.asarray(kd) * math.pi
    if not full:
        return np.asarray(kd) * (
            1
            - 0.5 * v / (v + 0.33)
            + 0.45 * v / (v + 0.09) * max(0, math.cos(phi)) * math.sin(a) * math.tan(b)
        )
    c1 = 1 - 0.5 * v / (v + 0.33)
    c2 = 0.45 * v / (v + 0.09) * math.sin(a)
    if math.cos(phi) < 0:
        c2 = 0.45 * v / (v + 0.09) * (math.sin(a) - (2 * b / math.pi) ** 3)
    c3 = 0.125 * v / (v + 0.09) * (4 * a * b / math.pi**2) ** 2
    l1 = c1 + math.cos(phi) * c2 * math.tan(b)
    l1 += (1 - abs(math.cos(phi))) * c3 * math.tan((a + b) / 2)
    l2 = 0.17 * rho * v / (v + 0.13) * (1 - math.cos(phi) * (2 * b / math.pi) ** 2)
    return np.maximum(rho / math.pi * (l1 + l2), 0)


def eon(wi, wo, *, kd, r):
    """Return listing 1 of Portsmouth, Kutz & Hill (2025). The albedo of a single reflection is by
    quadrature of the first term, not by the paper's closed form."""
    rho = np.asarray(kd) * math.pi
    s = float(np.dot(wi, wo)) - wi[2] * wo[2]
    single = 1 + r * (s / max(wi[2], wo[2]) if s > 0 else s)
    lost, mean = _lost(r, float(wi[2])) * _lost(r, float(wo[2])), _mean_lost(r)
    mixed = rho**2 * (1 - mean) / (1 - rho * mean)
    return (rho * single / _unit_facets(r) + mixed * lost / mean) / math.pi


def _unit_facets(r):
    return 1 + (0.5 - 2 / (3 * math.pi)) * r


def _lost(r, cos_o):
    """Return 1 - E of a white surface, by integration over rings of light at theta. The mean of
    each half of cos(phi), positive and negative, is 1 / pi."""
    theta_o, x = math.acos(cos_o), NODES[0]
    reflected = 0.0
    for low, high in ((0.0, theta_o), (theta_o, math.pi / 2)):
        theta = (low + high) / 2 + (high - low) / 2 * x
        part = np.sin(theta) * math.sin(theta_o) / math.pi
        ring = np.sin(2 * theta) * part * (1 / np.maximum(np.cos(theta), cos_o) - 1)
        reflected += (high - low) / 2 * NODES[1] @ ring
    return 1 - (1 + r * reflected) / _unit_facets(r)


@lru_cache
def _mean_lost(r):
    x, w = NODES
    cosines = (1 + x) / 2
    return float(w @ [c * _lost(r, c) for c in cosines])


NODES = np.polynomial.legendre.leggauss(64)


def albedo(plain, wo):
    """Return the integral of f_r cos over incident light, by rings of polar angle, split at the
    lobes' kinks."""
    theta_o, phi_o = math.acos(wo[2]), math.atan2(wo[1], wo[0])

    def ring(theta):
        phi = phi_o + np.linspace(0, 2 * np.pi, 200, endpoint=False)
        sine = math.sin(theta)
        directions = np.stack(
            [sine * np.cos(phi), sine * np.sin(phi), np.full_like(phi, math.cos(theta))], axis=-1
        )
        mean = np.mean([plain(wi, wo) for wi in directions], axis=0)
        return mean * 2 * np.pi * sine * math.cos(theta)

    nodes, weights = np.polynomial.legendre.leggauss(24)
    edges = [0.0, theta_o / 2, theta_o, (theta_o + math.pi / 2) / 2, math.pi / 2]
    total = 0.0
    for low, high in pairwise(edges):
        theta = (low + high) / 2 + (high - low) / 2 * nodes
        total += (high - low) / 2 * sum(w * ring(t) for t, w in zip(theta, weights, strict=True))
    return total
