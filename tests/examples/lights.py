"""Calls for lights of every type, and integrals over them."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxvision as jv
from jaxvision.lights.harmonics import irradiance_coefficients
from jaxvision.lights.skies import cie_sky

RNG = np.random.default_rng(6)


def unit(*v):
    v = np.asarray(v, float)
    return jnp.asarray(v / np.linalg.norm(v))


N, WO = unit(0.1, -0.2, 1), unit(-0.4, -0.5, 0.8)
POINT = jnp.asarray([0.2, 0.1, -0.3])
UP, U = unit(0.05, 0.1, 1), jnp.asarray([0.31, 0.62])
WINDOW = jv.Window([-0.5, 0.6, 1], [1.1, 0.1, 0], [-0.1, -1.2, 0.1])
FOCAL = jv.Window([-2, 2.1, 2], [4.4, 0.4, 0], [-0.34, -4.08, 0.34])
RECTANGLE = jv.RectangleLight(WINDOW.corner, WINDOW.edge_u, WINDOW.edge_v, [0.4, 0.7])
SKY = jv.environment_map(RNG.uniform(0.2, 1, size=(3, 6, 2)))
FIELD = jv.LightFieldLight(RNG.uniform(0.2, 1, size=(2, 2, 2, 3, 2)), WINDOW, FOCAL)
RAY = jv.Ray(POINT, UP)
RULE = jv.Quadrature(2)
PHONG = jv.Phong([0.2, 0.1], [0.3, 0.2], 9.0)
KEY = jax.random.key(5)
LAMP, SUN = jv.PointLight([1, 2, -3], [0.3, 0.2]), jv.DirectionalLight([0.3, 0.2, -1], [0.2, 0.1])
BALL = jv.Scene([jv.Surface(jv.Sphere([0.1, 0.2, 3], 1.0), jv.Lambert([0.2, 0.1]))], [RECTANGLE])

TURNS = [0, 2.0, 4.0, 2 * np.pi]
SPREAD = np.array([[1.0, 1, 1, 1], [0.5, 0.9, 0.7, 0.5], [0.2, 0.1, 0.4, 0.2]])
SOLD = jv.GoniometricLight([1, 2, -3], [0.3, 0.2], SPREAD, [0, 1.0, np.pi], TURNS)
DISC = jv.SunDisc([0.3, 0.2, 1], [0.2, 0.1], 0.5)
SPOT = jv.SpotLight([1, 2, -3], [-0.4, -0.9, 1.2], [0.3, 0.2], 0.2, 1.5)
SMALL = jv.SmallLight([1, 2, -3], [-0.4, -0.9, 1.2], [0.3, 0.2])


def arriving(wi):
    return jnp.stack([1 + wi[2], 2 - wi[0]])


OPTIONS = {"incident_radiance": arriving, "normal": N, "wo": WO}

EXAMPLES = {
    "rendering.light_field.render_light_field": (
        (BALL, WINDOW, FOCAL),
        {"resolution": (1, 2, 1, 2), "rule": RULE},
    ),
    "lights._emission.emitted": ((SMALL, jnp.asarray([0.2, 0.4, 0.6, 0.8])), {"around": None}),
    "lights._emission.emitted_from_point": (
        (jv.as_vec(POINT), jv.as_vec(UP), jnp.asarray([3.0, 2])),
        {},
    ),
    "lights._emission.emitted_from_surface": (
        (jv.Sphere([0.1, 0.2, 3], 1.0), jnp.asarray([3.0, 2]), jnp.asarray([0.2, 0.4, 0.6, 0.8])),
        {},
    ),
    "lights._nodes.shifted_lattice": ((KEY,), {"samples": 3, "dtype": np.float64}),
    "lights._samples.incident_sample": ((RECTANGLE, RULE, POINT, U, jnp.asarray(0.25)), {}),
    "lights._samples.light_nodes": ((RECTANGLE, jv.MonteCarlo(KEY, 2)), {"dtype": np.float64}),
    "lights.incidence.direction_pdf": ((RECTANGLE, POINT, UP), {}),
    "lights.incidence.direction_sample": ((RECTANGLE, POINT, U), {}),
    "lights.incidence.incident": ((LAMP, jv.as_vec(POINT)), {}),
    "lights.incidence.incident_samples": ((FIELD, POINT), {"rule": RULE}),
    "lights.incidence.irradiance": ((RECTANGLE, POINT, N), {"rule": jv.MonteCarlo(KEY, 2)}),
    "lights.incidence.nearest_seen": (([RECTANGLE, SKY], RAY), {}),
    "lights.incidence.radiance_from": ((SKY, POINT, UP), {}),
    "lights.incidence.radiance_along": ((FIELD, RAY), {}),
    "lights.adaptive.adaptive_irradiance": (
        (RECTANGLE, jnp.stack([POINT, 2 * POINT]), N),
        {"tolerance": 1e-3},
    ),
    "lights.directional.from_directional_light": ((SUN, POINT), {}),
    "lights.environment.environment_node": ((SKY, POINT, U), {}),
    "lights.environment.environment_pdf": ((SKY, POINT, UP), {}),
    "lights.environment.environment_radiance": ((SKY, UP), {}),
    "lights.environment.environment_sample": ((SKY, POINT, U), {}),
    "lights.goniometric.flux": ((SOLD,), {}),
    "lights.goniometric.from_goniometric_light": ((SOLD, POINT), {}),
    "lights.goniometric.relative_intensity": ((SOLD, UP), {}),
    "lights.harmonics.harmonic_irradiance": ((SKY, irradiance_coefficients(SKY), N), {}),
    "lights.harmonics.harmonics": ((N,), {}),
    "lights.harmonics.irradiance_coefficients": ((SKY,), {}),
    "lights.light_field.light_field_pdf": ((FIELD, POINT, UP), {}),
    "lights.light_field.light_field_radiance": ((FIELD, RAY), {}),
    "lights.light_field.light_field_ray": ((WINDOW, FOCAL, jnp.asarray([0.3, 0.4, 0.5, 0.6])), {}),
    "lights.light_field.light_field_sample": ((FIELD, POINT, U), {}),
    "lights.light_field.light_field_seen": ((FIELD, RAY), {}),
    "lights.light_field.refocus": ((FIELD, jnp.asarray([0.1, 0.2, 1.9])), {"order": 2}),
    "lights.point.from_point_light": ((LAMP, POINT), {}),
    "lights.polygon.angle_over_sine": ((jnp.asarray([0.3, 1e-9]), jnp.asarray([-0.2, 0.9])), {}),
    "lights.polygon.nodes_integral": (
        (
            jv.as_vec(3 * UP),
            jv.as_vec(unit(1.0, 0.2, 0.1)),
            jv.as_vec(unit(0.2, -1.0, 0.0)),
            jv.as_vec(N),
        ),
        {"order": 3},
    ),
    "lights.polygon.rectangle_irradiance": ((RECTANGLE, POINT, unit(0.9, 0.1, 0.2)), {}),
    "lights.rectangle.rectangle_pdf": ((RECTANGLE, POINT, UP), {}),
    "lights.rectangle.rectangle_sample": ((RECTANGLE, POINT, U), {}),
    "lights.rectangle.rectangle_seen": ((RECTANGLE, RAY), {}),
    "lights.rectangle.window_of": ((RECTANGLE,), {}),
    "lights.small.from_small_light": ((SMALL, POINT), {}),
    "lights.spot.from_spot_light": ((SPOT, POINT), {}),
    "lights.skies.sky_radiance": ((jnp.asarray(cie_sky(12)), N, UP), {}),
    "lights.sun_disc.sun_pdf": ((DISC, POINT, UP), {}),
    "lights.sun_disc.sun_sample": ((DISC, POINT, U), {}),
    "lights.window.crossing": ((RAY, WINDOW), {}),
    "lights.window.hit_window": ((RAY, WINDOW), {}),
    "lights.window.window_pdf": ((WINDOW, POINT, UP), {}),
    "lights.window.window_sample": ((WINDOW, POINT, U), {}),
    "rendering.hemisphere_integral.hemisphere_radiance": (
        (PHONG,),
        OPTIONS | {"polar": 4, "azimuths": 8},
    ),
    "rendering.hemisphere_integral.lit_radiance": (
        (KEY, PHONG, RECTANGLE, POINT, N, WO),
        {"samples": 3},
    ),
    "rendering.hemisphere_integral.sampled_radiance": ((KEY, PHONG), OPTIONS | {"samples": 3}),
}
