"""A lens in plain NumPy by ray geometry: what a pixel sees, and its brightness.

Lengths are in m, and slopes in m to the side per m forward. A rim in front of the lens blocks rays
that pass outside it."""

import numpy as np
from scipy import special


def disc(radius, rings=60):
    """Return points of equal area in a disc, (n, 2)."""
    n = 3 * rings**2
    k = np.arange(n) + 0.5
    r, angle = np.sqrt(k / n), np.pi * (1 + 5**0.5) * k
    return radius * np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)


def slopes(shape, pitch, distance):
    """Return the slopes, (2, h, w), of rays through the centre of the lens without distortion."""
    h, w = shape
    x = (np.arange(w) - (w - 1) / 2) * pitch / distance
    y = (np.arange(h) - (h - 1) / 2) * pitch / distance
    return np.stack(np.meshgrid(x, y))


def undistorted(places, radial, tangential=(0.0, 0.0)):
    """Return the slopes that Brown's polynomial images to these positions, by fixed-point
    iteration."""
    u = places.copy()
    for _ in range(400):
        x, y = u
        r2 = x * x + y * y
        s = 1 + sum(k * r2 ** (i + 1) for i, k in enumerate(radial))
        p1, p2 = tangential
        dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u = (places - np.stack([dx, dy])) / s
    return u


def spread(u, radial, tangential=(0.0, 0.0), step=1e-6):
    """Return the area of the distorted image over that of the ideal one, by differences."""

    def image(x, y):
        r2 = x * x + y * y
        s = 1 + sum(k * r2 ** (i + 1) for i, k in enumerate(radial))
        p1, p2 = tangential
        return np.stack(
            [
                x * s + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * s + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ]
        )

    x, y = u
    a = (image(x + step, y) - image(x - step, y)) / (2 * step)
    b = (image(x, y + step) - image(x, y - step)) / (2 * step)
    return a[0] * b[1] - a[1] * b[0]


def clear(u, radius, focus, rim_distance, rim_radius):
    """Return the share of the lens, (h, w), whose rays pass the rim: the overlap of two discs."""
    r, d = radius * abs(1 - rim_distance * focus), rim_distance * np.hypot(*u)
    near = np.clip(np.abs(rim_radius - r), None, d)  # the lens is inside the rim, or around it
    d = np.clip(d, near * (1 + 1e-15) + 1e-300, rim_radius + r)
    half = np.arccos(np.clip((d**2 + r**2 - rim_radius**2) / (2 * d * r), -1, 1))
    other = np.arccos(np.clip((d**2 + rim_radius**2 - r**2) / (2 * d * rim_radius), -1, 1))
    area = r**2 * (half - np.sin(2 * half) / 2) + rim_radius**2 * (other - np.sin(2 * other) / 2)
    return area / (np.pi * r**2)


def through(points, slope, depth, focus):
    """Return where rays from points of the lens, aimed at the plane in focus, cross a depth, (n,
    2)."""
    return points * (1 - depth * focus) + depth * slope


def airy(wavelength, f_number, pitch, size, fine=61):
    """Return the shares of a point's light on the pixels around it, (size, size), by midpoints,
    with sum 1."""
    middle = (np.arange(size * fine) + 0.5) / fine - size / 2
    r = np.hypot(*np.meshgrid(middle, middle)) * pitch
    x = np.pi * r / (wavelength * f_number)
    light = np.where(x > 0, 2 * special.j1(x) / np.where(x > 0, x, 1), 1) ** 2
    kernel = light.reshape(size, fine, size, fine).sum((1, 3))
    return kernel / kernel.sum()
