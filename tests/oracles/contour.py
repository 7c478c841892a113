"""Irradiance from a uniform rectangle with 50 digits, by mpmath only: the polygon is clipped at the
horizon (Sutherland and Hodgman), and Lambert's contour sum is taken with arc cosines."""

import mpmath as mp
from oracles.exact import dot


def cross(a, b):
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]


def irradiance(corner, edge_u, edge_v, point, normal):
    """Return the irradiance per unit of radiance. Every argument is a list of three mpmath
    numbers."""
    first = [c - p for c, p in zip(corner, point, strict=True)]
    along = [a + b for a, b in zip(first, edge_u, strict=True)]
    across = [a + b for a, b in zip(first, edge_v, strict=True)]
    opposite = [a + b for a, b in zip(along, edge_v, strict=True)]
    if dot(cross(edge_u, edge_v), first) >= 0:
        return mp.mpf(0)
    polygon = [first, across, opposite, along]  # counterclockwise as seen by the receiver
    kept = []
    for i, b in enumerate(polygon):
        a = polygon[i - 1]
        height_a, height_b = dot(normal, a), dot(normal, b)
        if (height_a > 0) != (height_b > 0):
            t = height_a / (height_a - height_b)
            kept.append([x + t * (y - x) for x, y in zip(a, b, strict=True)])
        if height_b > 0:
            kept.append(b)
    total = mp.mpf(0)
    for i, b in enumerate(kept):
        a = kept[i - 1]
        area = cross(a, b)
        size = mp.sqrt(dot(area, area))
        if size == 0:
            continue
        angle = mp.acos(dot(a, b) / mp.sqrt(dot(a, a) * dot(b, b)))
        total += angle * dot(normal, area) / size
    return total / 2


def gradient(corner, edge_u, edge_v, point, normal):
    """Return the derivatives with respect to the same fifteen numbers, in this order, by
    differences that are accurate to 20 digits."""
    numbers = [*corner, *edge_u, *edge_v, *point, *normal]

    def of(i, x):
        moved = [*numbers[:i], x, *numbers[i + 1 :]]
        return irradiance(*(moved[j : j + 3] for j in range(0, 15, 3)))

    step = mp.mpf(10) ** -15
    return [(of(i, x + step) - of(i, x - step)) / (2 * step) for i, x in enumerate(numbers)]
