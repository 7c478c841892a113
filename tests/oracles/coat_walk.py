"""A random walk of photons through GGX facets onto a Lambertian body and up again, by NumPy.

Facets are drawn from those that are visible (Heitz, "Sampling the GGX Distribution of Visible
Normals", 2018) and reflect with Fresnel's probability. A photon that another facet stops on its way
continues on the body's side, so no light is lost.
"""

import numpy as np


def fresnel(c, eta):
    """Return the reflectance at the cosine c of a surface, where eta is the index behind over that
    in front."""
    root = np.sqrt(np.maximum(eta**2 - 1 + c * c, 0))
    s, p = (c - root) / (c + root), (eta**2 * c - root) / (eta**2 * c + root)
    return np.where(eta**2 - 1 + c * c <= 0, 1.0, (s * s + p * p) / 2)


def visible_normals(w, alpha, rng):
    v = w * [alpha, alpha, 1]
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    across = np.stack([-v[:, 1], v[:, 0], 0 * v[:, 0]], axis=1)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    first = np.where(size > 1e-9, across / np.maximum(size, 1e-9), [1.0, 0, 0])
    r, phi, blend = np.sqrt(rng.random(len(w))), 2 * np.pi * rng.random(len(w)), (1 + v[:, 2]) / 2
    a = r * np.cos(phi)
    b = (1 - blend) * np.sqrt(1 - a * a) + blend * r * np.sin(phi)
    c = np.sqrt(np.maximum(1 - a * a - b * b, 0))
    h = a[:, None] * first + b[:, None] * np.cross(v, first) + c[:, None] * v
    h = np.concatenate([alpha * h[:, :2], np.maximum(h[:, 2:], 1e-9)], axis=1)
    return h / np.linalg.norm(h, axis=1, keepdims=True)


def at_facets(w, alpha, eta, rng):
    """Return whether photons from w (photons, 3), z > 0, are reflected, and whether they are
    refracted."""
    h = visible_normals(w, alpha, rng)
    c = np.sum(w * h, axis=1)
    mirrored = 2 * c[:, None] * h - w
    inside = np.sqrt(np.maximum(1 - (1 - c * c) / eta**2, 0))
    refracted = (c / eta - inside)[:, None] * h - w / eta
    reflects = rng.random(len(w)) < fresnel(c, eta)

    def passes(out):
        slope = np.sum(out[:, :2] ** 2, axis=1) / np.maximum(out[:, 2] ** 2, 1e-30)
        return rng.random(len(out)) < 2 / (1 + np.sqrt(1 + alpha**2 * slope))

    up, down = reflects & (mirrored[:, 2] > 0), ~reflects & (refracted[:, 2] < 0)
    return up & passes(mirrored), down & passes(refracted)


def albedo(cosine, alpha, rho, *, eta=1.5, count=400_000, seed=0, most=None, stops=False):
    """Return the share of the light at a cosine that a coat of this roughness over a body of albedo
    rho returns. As in pbrt, a walk may end after `most` reflections by the body, and light that
    facets block may be lost."""
    rng = np.random.default_rng(seed)
    w = np.tile([np.sqrt(1 - cosine**2), 0, cosine], (count, 1))
    back, through = at_facets(w, alpha, eta, rng)
    escaped = int(back.sum())
    inside = int(through.sum()) if stops else count - escaped
    while inside and most != 0:
        most = None if most is None else most - 1
        inside = rng.binomial(inside, rho)
        c, phi = np.sqrt(rng.random(inside)), 2 * np.pi * rng.random(inside)
        s = np.sqrt(1 - c * c)
        w = np.stack([s * np.cos(phi), s * np.sin(phi), c], axis=1)
        returned, out = at_facets(w, alpha, 1 / eta, rng)
        escaped += int(out.sum())
        inside = int(returned.sum()) if stops else inside - int(out.sum())
    return escaped / count


def metal_albedo(cosine, alpha, f0, *, eta=1.5, depth=0.0, count=400_000, seed=0):
    """Return the share of the light at a cosine that GGX facets of Schlick's reflectance return
    through a smooth coat. Light that facets block is lost, as in a lobe of single scattering."""
    rng = np.random.default_rng(seed)
    escaped = rng.binomial(count, fresnel(cosine, eta))
    sine = np.sqrt(1 - cosine**2) / eta
    w = np.tile([sine, 0, np.sqrt(1 - sine**2)], (count - escaped, 1))
    while len(w):
        w = w[rng.random(len(w)) < np.exp(-depth / w[:, 2])]
        h = visible_normals(w, alpha, rng)
        c = np.sum(w * h, axis=1)
        out = 2 * c[:, None] * h - w
        slope = np.sum(out[:, :2] ** 2, axis=1) / np.maximum(out[:, 2] ** 2, 1e-30)
        seen = 2 / (1 + np.sqrt(1 + alpha**2 * slope))
        share = (f0 + (1 - f0) * (1 - c) ** 5) * seen * np.exp(-depth / np.maximum(out[:, 2], 1e-9))
        out = out[(out[:, 2] > 0) & (rng.random(len(w)) < share)]
        back = rng.random(len(out)) < fresnel(out[:, 2], 1 / eta)
        escaped += int((~back).sum())
        w = out[back] * [-1, -1, 1]
    return escaped / count
