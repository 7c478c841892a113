"""Oracles for form factors, and polygons seen from a point."""

import jax.numpy as jnp

from jaxvision.core._vector import Vec
from jaxvision.lights import RectangleLight
from jaxvision.lights.polygon import angle_over_sine, rectangle_irradiance
from jaxvision.transport.radiosity.form_factors import (
    parallel_rectangles,
    perpendicular_rectangles,
    point_to_polygon,
)

from .entry import Entry, Range

SIDE = Range(0.05, 30.0)


def parallel(m, width, height, gap):
    """Return the form factor of Howell, C-11."""
    x, y = width / gap, height / gap
    a, b = m.sqrt(1 + x * x), m.sqrt(1 + y * y)
    logs = m.log((1 + x * x) * (1 + y * y) / (1 + x * x + y * y)) / 2
    arcs = x * b * m.arctan(x / b) + y * a * m.arctan(y / a) - x * m.arctan(x) - y * m.arctan(y)
    return 2 / (m.pi * x * y) * (logs + arcs)


def perpendicular(m, edge, width, other):
    """Return the form factor of Howell, C-14."""
    w, h = width / edge, other / edge
    w2, h2 = w * w, h * h
    s = w2 + h2
    arcs = w * m.arctan(1 / w) + h * m.arctan(1 / h) - m.sqrt(s) * m.arctan(1 / m.sqrt(s))
    logs = (
        m.log((1 + w2) * (1 + h2) / (1 + s))
        + w2 * m.log(w2 * (1 + s) / ((1 + w2) * s))
        + h2 * m.log(h2 * (1 + s) / ((1 + h2) * s))
    )
    return (arcs + logs / 4) / (m.pi * w)


def above_corner(m, width, height, gap):
    """Return the form factor of an element to a parallel rectangle with a corner above it (Howell,
    B-3)."""
    x, y = width / gap, height / gap
    a, b = m.sqrt(1 + x * x), m.sqrt(1 + y * y)
    return (x / a * m.arctan(y / a) + y / b * m.arctan(x / b)) / (2 * m.pi)


def corners(width, height, gap):
    zero = jnp.zeros_like(gap)
    return tuple(
        Vec(x, y, gap) for x, y in ((zero, zero), (zero, height), (width, height), (width, zero))
    )


def from_point(width, height, gap):
    zero, one = jnp.zeros_like(gap), jnp.ones_like(gap)
    return point_to_polygon(
        Vec(zero, zero, zero), Vec(zero, zero, one), corners(width, height, gap)
    )


def under_light(width, height, gap):
    zero, one = jnp.zeros_like(gap), jnp.ones_like(gap)
    light = RectangleLight(
        jnp.stack([zero, zero, gap]),
        jnp.stack([zero, height, zero]),
        jnp.stack([width, zero, zero]),
        radiance=one[None],
    )
    return rectangle_irradiance(light, jnp.stack([zero, zero, zero]), jnp.stack([zero, zero, one]))[
        0
    ]


ENTRIES = [
    Entry(
        "transport.radiosity.form_factors.parallel_rectangles",
        parallel_rectangles,
        parallel,
        (SIDE, SIDE, Range(0.1, 10.0)),
        (
            *((0.01, 0.01, 1.0), (1e-4, 1e-4, 1.0), (1e4, 1e4, 1.0), (1e-3, 1e3, 1.0)),
            *((1.0, 1.0, 1e-6), (1.0, 1.0, 1e-7)),
        ),
        bound=9.0,
        gradient=2e-6,
        note="sides that are far smaller than the gap",
    ),
    Entry(
        "transport.radiosity.form_factors.perpendicular_rectangles",
        perpendicular_rectangles,
        perpendicular,
        (Range(0.1, 10.0), SIDE, SIDE),
        ((1.0, 0.01, 0.01), (1.0, 1e-3, 1e3), (1.0, 1e3, 1e-3), (1.0, 1.0, 1.0)),
        bound=6,
        gradient=2e-6,
    ),
    Entry(
        "transport.radiosity.form_factors.point_to_polygon",
        from_point,
        above_corner,
        (Range(0.3, 30.0), Range(0.3, 30.0), Range(0.3, 3.0)),
        ((1.0, 1.0, 1.0),),
        bound=1700,
        precisions=("float32",),
        gradient=None,
        note="1e-4 at a distance of 5 sizes, where nodes replace the contour integral",
    ),
    Entry(
        "transport.radiosity.form_factors.point_to_polygon",
        from_point,
        above_corner,
        (Range(0.3, 30.0), Range(0.3, 30.0), Range(0.3, 3.0)),
        ((1.0, 1.0, 1.0),),
        bound=1e4,
        form="nearer than 144 sizes",
        precisions=("float64",),
        gradient=None,
        note="about 15 (d / s)^2 for a polygon of size s at distance d",
    ),
    Entry(
        "lights.polygon.rectangle_irradiance",
        under_light,
        lambda m, *a: m.pi * above_corner(m, *a),
        (Range(0.3, 30.0), Range(0.3, 30.0), Range(0.3, 3.0)),
        ((1.0, 1.0, 1.0),),
        bound=32,
        gradient=None,
        note="a sum over edges, some of which cancel",
    ),
    Entry(
        "lights.polygon.angle_over_sine",
        lambda s, c: angle_over_sine(s * s, c),
        lambda m, s, c: m.arctan2(s, c) / s,
        (Range(1e-4, 1.0), Range(-0.9, 1.0, log=False)),
        ((1e-6, 1.0), (1.0, 0.0), (0.7071, 0.7071), (0.5, -0.8)),
        bound=7.0,
        gradient=1e-4,
        note="includes the square that is its argument",
    ),
]
