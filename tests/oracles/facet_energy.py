"""Fit the polynomials of `jaxvision/brdf/facet_energy.npz` to quadratures in plain NumPy.

    python tests/oracles/facet_energy.py

The quadratures integrate a single reflection by Smith's facets (height-correlated), with slopes r
(cos psi, sin psi) in units of alpha, up to the horizon. Nodes are dense near psi = pi / 2 for
grazing views. The script takes two minutes."""

from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.special import erfc

LOW, HIGH = 1e-3, 1.0  # roughness
INDICES = 1.1, 2.5
DEGREES = {"ggx": (14, 10, 8), "beckmann": (18, 16, 8)}  # degrees in cosine, roughness and index
FILE = Path(__file__).parents[2] / "jaxvision" / "brdf" / "facet_energy.npz"


def legendre(n):
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def hidden(c, s, a, distribution):
    """Return cos(theta) Lambda."""
    if distribution == "ggx":
        return (a * s) ** 2 / np.maximum(2 * (np.sqrt(c * c + (a * s) ** 2) + c), 1e-300)
    t = np.maximum(a * s, 1e-150)
    bell = np.exp(-np.minimum((c / t) ** 2, 700)) / (2 * np.sqrt(np.pi))
    return np.maximum(t * bell - c * erfc(c / t) / 2, 0)


def fresnel(c, eta):
    g = np.sqrt(eta**2 - 1 + c * c)
    return (((c - g) / (c + g)) ** 2 + ((eta**2 * c - g) / (eta**2 * c + g)) ** 2) / 2


def single(mu, a, distribution, etas, radii=40, turns=48):
    """Return the reflectance of white facets, and of clear ones with each index, seen at the cosine
    `mu`."""
    s_o = np.sqrt(max(1 - mu * mu, 0))
    steep = a * s_o
    leap = max(mu / max(steep, mu / 8), 1e-3)
    crowding = np.arcsinh(np.pi / 2 / leap)
    t, dt = legendre(radii)
    s, ds = legendre(turns)
    beyond = leap * np.sinh(crowding * (2 * s - 1))
    turn = ds * 2 * crowding * np.sqrt(leap**2 + beyond**2) / (2 * np.pi)
    k = -steep * np.sin(beyond)
    root = np.sqrt(k * k + (mu * a) ** 2)
    above, below = np.where(k > 0, k + root, mu), np.where(k > 0, mu * a * a, root - k)
    if distribution == "ggx":
        end = np.arctan2(above, below)[:, None]
        r, area = np.tan(end * t), end * dt * np.sin(2 * end * t)
    else:
        end = np.minimum(above / below, 6.5)[:, None]
        r = end * t
        area = end * dt * 2 * r * np.exp(-r * r)
    facing, h_z = mu + r * k[:, None], 1 / np.sqrt(1 + (r * a) ** 2)
    c_i = np.clip((mu + r * (2 * k[:, None] - mu * r * a * a)) * h_z**2, 0, 1)
    hides = [hidden(c, np.sqrt(1 - c * c), a, distribution) for c in (c_i, np.float64(mu))]
    below = np.maximum(c_i * mu + c_i * hides[1] + mu * hides[0], 1e-300)
    share = 2 * turn[:, None] * area * facing * c_i / below
    cosine = np.clip(facing * h_z, 0, 1)
    return share.sum(), np.array([(share * fresnel(cosine, eta)).sum() for eta in etas])


def stretched(a):
    return np.arcsinh(np.sqrt(a / 0.3))


def fitted(distribution):
    counts = DEGREES[distribution]
    places = [(1 + np.cos(np.pi * (np.arange(n + 6) + 0.5) / (n + 6))) / 2 for n in counts]
    x, y, z = places
    ends = stretched(LOW), stretched(HIGH)
    alphas = 0.3 * np.sinh(ends[0] + y * (ends[1] - ends[0])) ** 2
    etas = INDICES[0] * (INDICES[1] / INDICES[0]) ** z
    lost, clear = np.zeros((len(x), len(y))), np.zeros((len(x), len(y), len(z)))
    for j, a in enumerate(alphas):
        for i, place in enumerate(x):
            mu = np.clip(2 * a * np.sinh(place ** (1 / 0.6) * np.arcsinh(0.5 / a)), 1e-6, 1)
            white, of_index = single(mu, a, distribution, etas)
            lost[i, j], clear[i, j] = 1 - white, of_index - fresnel(mu, etas)
    inverse = [
        np.linalg.pinv(chebvander(2 * p - 1, n - 1)) for p, n in zip(places, counts, strict=True)
    ]
    return (
        np.einsum("ai,bj,ij->ab", *inverse[:2], lost).astype(np.float32),
        np.einsum("ai,bj,ck,ijk->abc", *inverse, clear).astype(np.float32),
    )


if __name__ == "__main__":
    found = {name: fitted(name) for name in DEGREES}
    kept = {
        f"{name}_{part}": c
        for name, cs in found.items()
        for part, c in zip(("lost", "clear"), cs, strict=True)
    }
    np.savez_compressed(FILE, **kept)
    print(FILE, FILE.stat().st_size, "bytes")
