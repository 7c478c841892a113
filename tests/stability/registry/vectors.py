"""Oracles for vectors, directions and rays."""

import jax.numpy as jnp
import numpy as np
from oracle_space import angle, crossed, inner, length, log_cos

from jaxvision import as_dtype, scene
from jaxvision import geometry as g
from jaxvision.core._numerics import angle_between, dot, log_cos_between, norm, normalize, safe_sqrt
from jaxvision.core._vector import as_array
from jaxvision.geometry import hemisphere
from jaxvision.lights import PointLight, incident
from jaxvision.lights.harmonics import harmonics

from .entry import FRACTION, Columns, Entry, Range, Unit

ANY = Columns(Range(1e-6, 1e6, signed=True))
HUGE = Columns(Range(1e-30, 1e30, signed=True))
Z = np.array([0.0, 0.0, 1.0])


def vec(*v):
    return np.array(v, float)


def unit(*v):
    return vec(*v) / np.linalg.norm(v)


class NearTo:
    """Unit vectors near (0, 0, 1): log-uniform angles from 1e-5 to 0.7 rad."""

    def __str__(self):
        return "unit, 1e-05…0.7 rad from z"

    def draw(self, rng, n):
        angle, turn = Range(1e-5, 0.7).draw(rng, n), rng.uniform(0, 2 * np.pi, size=n)
        sine = np.sin(angle)
        return np.stack([sine * np.cos(turn), sine * np.sin(turn), np.cos(angle)], axis=-1)


def sphere_hit(m, origin, direction):
    """Return the distance to the unit sphere about the origin along a ray from outside of any
    length."""
    a, b = inner(direction, direction), inner(origin, direction)
    c = inner(origin, origin) - 1
    return (-b - m.sqrt(b * b - a * c)) / a


class Toward:
    """Unit directions from (0, 0, 5) that meet the unit sphere well inside its outline."""

    def __str__(self):
        return "unit, toward a sphere"

    def draw(self, rng, n):
        sine, turn = 0.15 * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, size=n)
        return np.stack([sine * np.cos(turn), sine * np.sin(turn), -np.sqrt(1 - sine**2)], axis=-1)


EYE = np.array([0.0, 0.0, 5.0])


def eye(m, like):
    return np.broadcast_to(m.array(EYE), like.shape)


def harmonic_values(m, d):
    x, y, z = d.T
    c1, c2 = m.sqrt(m.c("0.75") / m.pi), m.sqrt(m.c("3.75") / m.pi)
    return (
        m.c("0.5") / m.sqrt(m.pi) + 0 * x,
        c1 * y,
        c1 * z,
        c1 * x,
        c2 * x * y,
        c2 * y * z,
        c2 / m.sqrt(m.c("12")) * (3 * z * z - 1),
        c2 * x * z,
        c2 / 2 * (x * x - y * y),
    )


SPHERE = scene.Sphere(centre=(0.0, 0.0, 0.0), radius=1.0)


ENTRIES = [
    Entry(
        "core._numerics.dot",
        dot,
        lambda m, u, v: inner(u, v),
        (ANY, ANY),
        ((vec(1, 1e-4, 0), vec(1e-4, -1, 0)), (vec(1, 1, 1), vec(1, 1, 1))),
        conditioned=True,
        gradient=1e-6,
        note="at right angles",
    ),
    Entry(
        "core._numerics.norm",
        norm,
        length,
        (HUGE,),
        (
            (vec(1e-30, 1e-30, 0),),
            (vec(1e30, 3e30, 1e20),),
            (vec(0, 0, 1e-37),),
            (vec(2e38, 2e38, 0),),
        ),
    ),
    Entry(
        "core._numerics.normalize",
        normalize,
        lambda m, v: tuple(v[:, i] / length(m, v) for i in range(3)),
        (ANY,),
        ((vec(1e-30, 1e-30, 2e-30),), (vec(1e30, 3e30, 1e30),), (vec(3e38, 3e38, 1e37),)),
        parts=("x", "y", "z"),
        of_quotient=0.01,
        note="the slope of a component along its own axis is 1 minus its square",
        bound=5.0,
    ),
    Entry(
        "core._numerics.safe_sqrt",
        safe_sqrt,
        lambda m, x: m.sqrt(m.maximum(x, m.c("0"))),
        (Range(1e-37, 1e37),),
        ((1e-37,), (2.0,)),
        bound=1,
    ),
    Entry(
        "core._numerics.angle_between",
        angle_between,
        angle,
        (Unit(), Unit()),
        (
            (Z, unit(1e-7, 0, 1)),
            (Z, unit(1e-20, 0, 1)),
            (Z, unit(1e-6, 0, -1)),
            (Z, unit(1, 0, 0)),
        ),
        bound=6.0,
        gradient=1e-4,
    ),
    Entry(
        "core._numerics.log_cos_between",
        log_cos_between,
        log_cos,
        (NearTo(), NearTo()),
        ((Z, unit(1e-5, 0, 1)), (Z, unit(0.6, 0, 0.8)), (Z, unit(1, 0, 1e-4))),
        conditioned=True,
        gradient=None,
        note="lengths of directions are taken as exactly 1, in spite of rounding; the slope is "
        "along the sphere",
    ),
    Entry(
        "geometry.hemisphere.cross",
        lambda u, v: as_array(hemisphere.cross(u, v)),
        lambda m, u, v: crossed(u, v),
        (Unit(), Unit()),
        ((Z, unit(1e-6, 0, 1)),),
        parts=("x", "y", "z"),
        conditioned=True,
        gradient=1e-6,
        note="nearly parallel vectors",
    ),
    Entry(
        "geometry.hemisphere.direction_at",
        lambda t, phi: as_array(hemisphere.direction_at(t, phi)),
        lambda m, t, phi: (
            m.sqrt(t * (2 - t)) * m.cos(phi),
            m.sqrt(t * (2 - t)) * m.sin(phi),
            1 - t,
        ),
        (Range(1e-10, 1.99), Range(0.01, 6.2, log=False)),
        ((1e-30, 1.0), (2.0, 1.0), (1.0, 0.5)),
        parts=("x", "y", "z"),
        conditioned=True,
        gradient=1e-4,
        note="near the zeros of sine and cosine, and at the horizon",
    ),
    Entry(
        "geometry.hemisphere.cosine_direction",
        lambda u: as_array(hemisphere.cosine_direction(u)),
        lambda m, u: (
            m.sqrt(u[:, 0]) * m.cos(2 * m.pi * u[:, 1]),
            m.sqrt(u[:, 0]) * m.sin(2 * m.pi * u[:, 1]),
            m.sqrt(1 - u[:, 0]),
        ),
        (Columns(FRACTION, 2),),
        ((np.array([1e-30, 0.3]),), (np.array([0.9999, 0.5]),)),
        parts=("x", "y", "z"),
        conditioned=True,
        gradient=1e-4,
        note="next to quarter turns",
    ),
    Entry(
        "geometry.hemisphere.uniform_direction",
        lambda u: as_array(hemisphere.uniform_direction(u)),
        lambda m, u: (
            m.sqrt(u[:, 0] * (2 - u[:, 0])) * m.cos(2 * m.pi * u[:, 1]),
            m.sqrt(u[:, 0] * (2 - u[:, 0])) * m.sin(2 * m.pi * u[:, 1]),
            1 - u[:, 0],
        ),
        (Columns(FRACTION, 2),),
        ((np.array([1e-30, 0.3]),), (np.array([0.9999, 0.5]),)),
        parts=("x", "y", "z"),
        conditioned=True,
        gradient=1e-4,
        note="next to quarter turns",
    ),
    Entry(
        "geometry.hemisphere.cosine_pdf",
        hemisphere.cosine_pdf,
        lambda m, w: w[:, 2] / m.pi,
        (Unit(above=True),),
    ),
    Entry(
        "geometry.hemisphere.uniform_pdf",
        hemisphere.uniform_pdf,
        lambda m, w: 1 / (2 * m.pi) + 0 * w[:, 2],
        (Unit(above=True),),
    ),
    Entry(
        "geometry.hemisphere.local_frame",
        lambda n: as_array(hemisphere.local_frame(n).tangent),
        lambda m, n: (
            1 - n[:, 0] ** 2 / (1 + m.abs(n[:, 2])),
            m.where(n[:, 2] < 0, 1, -1)
            * n[:, 0]
            * n[:, 1]
            / (1 + m.abs(n[:, 2]))
            * m.where(n[:, 2] < 0, -1, 1),
            -n[:, 0] * m.where(n[:, 2] < 0, -1, 1),
        ),
        (Unit(),),
        ((vec(0, 0, -1),), (unit(1e-10, 0, 1),)),
        form="tangent",
        parts=("x", "y", "z"),
        conditioned=True,
        gradient=1e-4,
        note="where the tangent is far from x",
    ),
    Entry(
        "geometry.rays.mirror_direction",
        g.mirror_direction,
        lambda m, n, w: tuple(2 * inner(n, w) * n[:, i] - w[:, i] for i in range(3)),
        (Unit(), Unit()),
        ((Z, unit(1e-6, 0, 1)), (Z, unit(1, 0, 1e-6))),
        parts=("x", "y", "z"),
        conditioned=True,
        note="a difference",
    ),
    Entry(
        "geometry.sphere.intersect_sphere",
        lambda d: (
            g.intersect(g.Ray(jnp.asarray(EYE, d.dtype), d), as_dtype(SPHERE, d.dtype)).distance
        ),
        lambda m, d: sphere_hit(m, eye(m, d), d),
        (Toward(),),
        ((vec(0, 0, -1),),),
        bound=8,
        gradient=None,
        note="the length of the direction is taken as exactly 1, so its rounding shows",
        conditioned=True,
    ),
    Entry(
        "lights.point.from_point_light",
        lambda p: incident(PointLight(jnp.zeros(3, p.dtype), jnp.ones(1, p.dtype)), p).irradiance[
            0
        ],
        lambda m, p: 1 / inner(p, p),
        (Columns(Range(1e-6, 1e6, signed=True)),),
        ((vec(1e-8, 0, 0),), (vec(1e8, 1e8, 0),)),
        bound=4,
        form="irradiance",
    ),
    Entry(
        "lights.harmonics.harmonics",
        harmonics,
        harmonic_values,
        (Unit(),),
        parts=tuple("012345678"),
        conditioned=True,
        note="near the zeros of the quadratic polynomials",
    ),
]
