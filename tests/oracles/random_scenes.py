"""Random scenes with every type of light, material and shape, which render quickly."""

from dataclasses import replace

import numpy as np

import jaxvision as jv
from jaxvision.lights import environment_map

PIXELS = 16
BLUNTEST = {"exponent": 10.0, "concentration": 2.2}


def spread(rng, low, high):
    """Return a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Draw:
    """The spectra of one scene, grey or not, and records made of them."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.bands = int(self.rng.choice([1, 3, 3, 6]))
        self.grey = self.rng.random() < 0.4

    def spectrum(self, scale):
        shape = np.ones(self.bands) if self.grey else self.rng.uniform(0.1, 1, self.bands)
        return scale * shape

    def material(self):
        rng = self.rng
        k_d = self.spectrum(rng.uniform(0.02, 0.3))
        strength = spread(rng, 1e-6, 0.3) * (rng.random() > 0.15)
        k_s = self.spectrum(strength)
        ambient = self.spectrum(0.3) if rng.random() < 0.3 else None
        n, c = spread(rng, 1, 200), spread(rng, 1, 20)
        interface = [
            None,
            jv.Dielectric([1.5]),
            jv.Schlick([0.04]),
            jv.Conductor([0.2], [3.0]),
        ][rng.integers(4)]
        kinds = [
            lambda: jv.Lambert(k_d, ambient=ambient),
            lambda: jv.Phong(k_d, k_s, n, ambient=ambient),
            lambda: jv.PhongBRDF(k_d, k_s, n),
            lambda: jv.NormalisedPhong(k_d, k_s, n),
            lambda: jv.GaussianLobe(k_d, k_s, c),
            lambda: jv.GaussianLobeBRDF(k_d, k_s, c),
            lambda: jv.Blinn(k_d, k_s, n),
            lambda: jv.BlinnBRDF(k_d, k_s, n),
            lambda: jv.NormalisedBlinn(k_d, k_s, n),
            lambda: jv.OrenNayar(k_d, spread(rng, 1e-3, 0.5)),
            lambda: jv.OrenNayar(k_d, spread(rng, 1e-3, 0.5), form="full"),
            lambda: jv.EON(k_d, spread(rng, 1e-3, 1)),
            lambda: jv.TorranceSparrow(
                k_d,
                k_s,
                rng.uniform(0.2, 0.9),
                interface=interface,
                distribution=str(rng.choice(["ggx", "beckmann"])),
                shadowing=str(rng.choice(["smith", "v-cavity"])),
            ),
            lambda: jv.Mirror([rng.uniform(0.2, 1)]),
            lambda: jv.Glass(1.5, absorption=self.spectrum(0.1)),
            lambda: jv.Dichromatic(jv.Lambert([0.3]), jv.BlinnBRDF([0.0], [0.5], n), k_d, k_s),
        ]
        return kinds[rng.integers(len(kinds))]()

    def shape(self):
        rng = self.rng
        c = rng.uniform(-0.7, 0.7, 3)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn = turn * np.sign(np.linalg.det(turn))
        ball = unit_mesh(c, spread(rng, 0.1, 0.3))
        kinds = [
            lambda: jv.Sphere(c, spread(rng, 0.05, 0.3)),
            lambda: jv.Box(c, rng.uniform(0.05, 0.25, 3)),
            lambda: jv.Box(c, rng.uniform(0.05, 0.25, 3), rotation=turn),
            lambda: jv.Disc(c, rng.normal(size=3), spread(rng, 0.1, 0.4)),
            lambda: jv.Quad(c, *rng.normal(size=(2, 3)) * 0.3),
            lambda: jv.TriangleMesh(*ball),
            lambda: jv.TriangleMesh(*ball, normals=ball[0] - c),
        ]
        return kinds[rng.choice(len(kinds), p=[0.35, 0.2, 0.1, 0.1, 0.1, 0.1, 0.05])]()

    def light(self):
        rng = self.rng
        power = spread(rng, 1e-6, 3) * (rng.random() > 0.1)
        near = rng.uniform([-0.9, -0.95, -2.5], [0.9, -0.5, -0.5])
        place = near if rng.random() < 0.7 else rng.uniform([-4, -4, -10], [4, 4, -2])
        chance = rng.random()
        if chance < 0.35:
            return jv.PointLight(place, self.spectrum(power))
        if chance < 0.45:
            return jv.SmallLight(place, rng.normal([0, 1, 1]), self.spectrum(power))
        if chance < 0.62:
            return jv.DirectionalLight(rng.normal([0, -0.5, -1.5]), self.spectrum(power))
        if chance < 0.7:
            rows = int(rng.integers(3, 6))
            table = rng.uniform(0.2, 1, (rows, 2 * rows, 1)) * self.spectrum(power)
            return environment_map(table)
        a, y = spread(rng, 0.002, 0.3), rng.choice([-0.99, -3.0, -8.0])
        scale = 3 / a**2 if y == -0.99 else 9 / a**2
        corner = [rng.uniform(-0.6, 0.4), y, rng.uniform(-0.6, 0.2)]
        edges = [0, 0, a * rng.uniform(0.5, 1.5)], [a, 0, 0]  # down, where y grows
        return jv.RectangleLight(corner, *edges, self.spectrum(power * scale))

    def surfaces(self):
        rng, found = self.rng, []
        if rng.random() < 0.5:  # a floor or a convex room
            wall = self.material()
            sides = [
                ([-1, 1, -1], [2, 0, 0], [0, 0, 2]),
                ([-1, -1, -1], [0, 0, 2], [2, 0, 0]),
                ([-1, -1, 1], [0, 2, 0], [2, 0, 0]),
                ([-1, -1, -1], [0, 2, 0], [0, 0, 2]),
                ([1, -1, -1], [0, 0, 2], [0, 2, 0]),
            ]
            found += [jv.Surface(jv.Quad(*side), wall) for side in sides[: rng.integers(1, 6)]]
        elif rng.random() < 0.2:
            found.append(jv.Surface(jv.Plane([0, 1, 0], [0, -1, 0]), self.material()))
        for _ in range(rng.integers(0 if found else 1, 4)):
            own = self.spectrum(spread(rng, 1e-6, 0.3)) if rng.random() < 0.2 else None
            two_sided = bool(rng.random() < 0.15)
            found.append(jv.Surface(self.shape(), self.material(), own, two_sided=two_sided))
        return found

    def view(self):
        rng = self.rng
        place = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.3), -3.0])
        rotation = np.asarray(jv.look_at(place, np.zeros(3), np.array([0.0, -1.0, 0.0])))
        rotation = np.linalg.qr(rotation.T)[0].T * np.sign(
            np.diag(np.linalg.qr(rotation.T)[1])
        ).reshape(3, 1)
        chance, size = rng.random(), (PIXELS, PIXELS)
        if chance < 0.1:
            return jv.Orthographic(place, rotation, 2.0 / PIXELS, resolution=size)
        pitch = 0.05 * rng.uniform(0.5, 1.3) / PIXELS
        if chance < 0.2:
            return jv.ThinLens(
                place, rotation, 0.05, pitch, resolution=size, f_number=np.inf, focus_distance=3.0
            )
        return jv.Pinhole(place, rotation, 0.05, pitch, resolution=size)


def unit_mesh(centre, radius):
    """Return vertices and faces of an octahedron."""
    vertices = centre + radius * np.concatenate([np.eye(3), -np.eye(3)])
    faces = [
        (0, 1, 2),
        (1, 3, 2),
        (3, 4, 2),
        (4, 0, 2),
        (1, 0, 5),
        (3, 1, 5),
        (4, 3, 5),
        (0, 4, 5),
    ]
    return vertices, np.array(faces)


def blunted(material):
    """Return the material with a lobe as broad as the nodes of a sky in `direct_light` resolve."""
    if isinstance(material, jv.Dichromatic):
        return replace(material, interface=blunted(material.interface))
    own = {
        n: np.minimum(getattr(material, n), m) for n, m in BLUNTEST.items() if hasattr(material, n)
    }
    return replace(material, **own)


def random_scene(seed):
    """Return a scene and a view."""
    draw = Draw(seed)
    surfaces = draw.surfaces()
    lights = [draw.light() for _ in range(draw.rng.integers(1, 5))]
    ambient = None
    if draw.rng.random() < 0.4:
        ambient = jv.AmbientLight(draw.spectrum(spread(draw.rng, 1e-6, 0.3)))
    if any(isinstance(light, jv.EnvironmentMap) for light in lights):
        surfaces = [replace(s, material=blunted(s.material)) for s in surfaces]
    return jv.Scene(surfaces, lights, ambient), draw.view()
