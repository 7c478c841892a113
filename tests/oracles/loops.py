"""A renderer and tone curves as naive Python loops in NumPy float64, directly from the textbook.

They share neither code nor numerical methods with the library: arccos of inner products, the
quadratic formula, one pixel and one light at a time."""

import math

import numpy as np


def unit(v):
    return np.asarray(v, float) / np.linalg.norm(v)


def look_at(position, target, up):
    """Return the rows right, down and forward of a camera."""
    forward = unit(np.subtract(target, position))
    right = unit(np.cross(forward, up))
    return np.stack([right, np.cross(forward, right), forward])


def sphere(origin, direction, centre, radius):
    """Return (distance, normal), or None."""
    f = origin - centre
    b, c = 2 * f @ direction, f @ f - radius**2
    discriminant = b * b - 4 * c
    if discriminant <= 0:
        return None
    for t in ((-b - math.sqrt(discriminant)) / 2, (-b + math.sqrt(discriminant)) / 2):
        if t > 0:
            return t, (origin + t * direction - centre) / radius
    return None


def plane(origin, direction, point, normal):
    """Return (distance, normal), or None."""
    slope = normal @ direction
    if slope == 0:
        return None
    t = normal @ (point - origin) / slope
    return (t, normal) if t > 0 else None


def lobe(material, mirror, wo):
    """Return the specular factor of a material given as a dict."""
    theta = math.acos(min(1.0, max(-1.0, mirror @ wo)))
    if material["kind"] == "phong":
        return max(0.0, math.cos(theta)) ** material["exponent"] if theta < math.pi / 2 else 0.0
    return math.exp(-((material["concentration"] * theta) ** 2))


def shade(material, lights, ambient, point, normal, wo, others=()):
    """Return k_a L_a + sum E (k_d [n.l]+ + k_s lobe), black from behind, without light through
    `others`."""
    colour = np.zeros(len(material["diffuse"]))
    if normal @ wo <= 0:
        return colour
    if ambient is not None and material.get("ambient") is not None:
        colour += np.multiply(material["ambient"], ambient)
    for light in lights:
        if light["kind"] == "point":
            toward = light["position"] - point
            irradiance = np.asarray(light["intensity"]) / (toward @ toward)
        else:
            toward, irradiance = np.asarray(light["direction"], float), light["irradiance"]
        wi = unit(toward)
        cos_i = normal @ wi
        if cos_i <= 0:
            continue
        way = np.linalg.norm(toward) if light["kind"] == "point" else math.inf
        met = [intersect(point, wi) for intersect in others]
        if any(hit is not None and hit[0] < way for hit in met):
            continue
        value = np.multiply(material["diffuse"], cos_i)
        if material["kind"] != "lambert":
            mirror = 2 * (normal @ wi) * normal - wi
            value = value + np.multiply(material["specular"], lobe(material, mirror, wo))
        colour += np.multiply(irradiance, value)
    return colour


def render(surfaces, lights, ambient, rays, bands):
    """Render pairs `surfaces` of (intersect(origin, direction) -> (t, normal) | None, material
    dict), whose fronts are not in their own shadow. `rays` are (h, w) nested lists of (origin,
    direction)."""
    picture = np.zeros((len(rays), len(rays[0]), bands))
    for i, row in enumerate(rays):
        for j, (origin, direction) in enumerate(row):
            nearest = None
            for intersect, material in surfaces:
                hit = intersect(origin, direction)
                if hit is not None and (nearest is None or hit[0] < nearest[0]):
                    nearest = (*hit, material, intersect)
            if nearest is not None:
                t, normal, material, own = nearest
                point = origin + t * direction
                others = [intersect for intersect, _ in surfaces if intersect is not own]
                picture[i, j] = shade(material, lights, ambient, point, normal, -direction, others)
    return picture


def srgb_encode(x):
    """Encode one number by IEC 61966-2-1."""
    return 12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055


def srgb_decode(x):
    return x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4
