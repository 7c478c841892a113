"""Formulas with 50 digits, and differences in ULP, by mpmath and NumPy only."""

import mpmath as mp
import numpy as np

mp.mp.dps = 50


def number(x):
    """Return the exact value of a floating-point number."""
    return mp.mpf(float(x))


def vector(v):
    return [number(c) for c in np.asarray(v)]


def dot(u, v):
    return mp.fsum(a * b for a, b in zip(u, v, strict=True))


def length(v):
    return mp.sqrt(dot(v, v))


def cosine(u, v):
    """Return the cosine between vectors of any length."""
    return dot(u, v) / (length(u) * length(v))


def angle(u, v):
    return mp.acos(max(mp.mpf(-1), min(mp.mpf(1), cosine(u, v))))


def mirrored(normal, w):
    """Return `w` mirrored about the direction of `normal`, which need not have unit length."""
    twice = 2 * dot(normal, w) / dot(normal, normal)
    return [twice * n - c for n, c in zip(normal, w, strict=True)]


def phong(normal, wi, wo, kd, ks, exponent):
    cos_i = cosine(normal, wi)
    if cos_i <= 0:
        return mp.mpf(0)
    cos_s = max(mp.mpf(0), cosine(mirrored(normal, wi), wo))
    return kd * cos_i + ks * cos_s**exponent


def sphere_distance(origin, direction, centre, radius):
    """Return the smallest positive root of the textbook quadratic with 50 digits, or None for a
    miss."""
    f = [o - c for o, c in zip(origin, centre, strict=True)]
    a, half_b, c = dot(direction, direction), dot(f, direction), dot(f, f) - radius**2
    discriminant = half_b**2 - a * c
    if discriminant <= 0:
        return None
    roots = [(-half_b + sign * mp.sqrt(discriminant)) / a for sign in (-1, 1)]
    return min((root for root in roots if root > 0), default=None)


def ulps(got, exact):
    """Return |got - exact| in ULP of `got`'s dtype at `exact`."""
    got = np.asarray(got)
    spacing = float(np.spacing(got.dtype.type(abs(float(exact)))))
    return float(abs(number(got) - exact) / mp.mpf(spacing))
