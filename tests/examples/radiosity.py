"""Calls for radiosity: a small closed box, patches of its walls, and rectangles that see each
other."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxvision import Lambert, MonteCarlo, Pinhole, Ray, RectangleLight, Scene, Surface
from jaxvision.core._vector import Vec
from jaxvision.scene import Quad
from jaxvision.transport.radiosity import Solution, patches_of, plan_patches

AXES = np.eye(3)
RHO = Lambert(jnp.asarray([0.15, 0.1]))
FLOOR, LID = Quad(np.zeros(3), AXES[0], AXES[1]), Quad(AXES[2], AXES[1], AXES[0])
SIDE = Quad(np.zeros(3), AXES[1], AXES[2])
LAMP = RectangleLight([0.2, 0.3, 0.9], [0.0, 0.3, 0.0], [0.4, 0.0, 0.0], [2.0, 3.0])
GLOW = jnp.asarray([0.2, 0.3])
SCENE = Scene([Surface(FLOOR, RHO), Surface(LID, RHO, GLOW), Surface(SIDE, RHO)], [LAMP])
PLAN = plan_patches(SCENE, size=0.6, split=1)
VIEW = Pinhole([0.55, 0.42, 0.5], AXES, 1.0, 0.3, resolution=(2, 3))
ELEMENTS = patches_of(SCENE, PLAN)
N = len(ELEMENTS.area)
RNG = np.random.default_rng(1)
TABLE = jnp.asarray(RNG.uniform(size=(N, N)) / N)
ALBEDO, SENT = (jnp.asarray(RNG.uniform(0.2, 0.8, (N, 2))) for _ in range(2))
FIRST, SECOND = jnp.asarray([[0.0, 1.0], [0.0, 0.7]]), jnp.asarray([[0.4, 1.5], [0.1, 0.8]])
SIDES = tuple(jnp.asarray(x) for x in (0.7, 1.3, 0.4))
POINT, UP = (Vec(*(jnp.asarray(float(c)) for c in v)) for v in ((0.2, 0.3, 0), (0, 0, 1)))


RAY = Ray(jnp.asarray([0.6, 0.4, 0.5]), jnp.asarray([0.48, 0.36, -0.8]))
KEY = jax.random.key(3)
SOLUTION = Solution(SENT, SENT, SENT, jnp.zeros(N, bool))


def polygon(*corners):
    return tuple(Vec(*(jnp.asarray(float(c)) for c in corner)) for corner in corners)


ABOVE = polygon((0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1))
CORNERS = polygon((-0.5, -0.2, 0.8), (0.6, -0.3, 0.8), (0.5, 0.7, 0.8), (-0.4, 0.6, 0.8))
BELOW = polygon((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))

ROOM = "transport.radiosity"
EXAMPLES = {
    f"{ROOM}.form_factors.parallel_rectangles": (SIDES, {}),
    f"{ROOM}.form_factors.perpendicular_rectangles": (SIDES, {}),
    f"{ROOM}.form_factors.parallel_exchange": ((FIRST, SECOND, SIDES[0]), {}),
    f"{ROOM}.form_factors.perpendicular_exchange": ((FIRST, SECOND), {}),
    f"{ROOM}.form_factors.point_to_polygon": ((POINT, UP, ABOVE), {}),
    f"{ROOM}.form_factors.polygon_to_polygon": ((BELOW, ABOVE), {"order": 2}),
    f"{ROOM}.patches.patches_of": ((SCENE,), {"plan": PLAN}),
    f"{ROOM}.patches.patches_at": ((SCENE,), {"plan": PLAN, "splits": (1, 2)}),
    f"{ROOM}.exchange.form_factor_table": ((SCENE,), {"plan": PLAN}),
    f"{ROOM}.exchange.exchanged": ((SCENE,), {"plan": PLAN, "sent": SENT}),
    f"{ROOM}.patches.patch_means": ((SENT, ELEMENTS), {"plan": PLAN}),
    f"{ROOM}.exchange.closure_error": ((TABLE,), {}),
    f"{ROOM}.exchange.reciprocity_error": ((TABLE / 100, ELEMENTS.area), {}),
    f"{ROOM}.solve.solve_radiosity": ((TABLE, ALBEDO, SENT), {}),
    f"{ROOM}.solve.bounce": ((TABLE, ALBEDO, SENT), {"count": 2}),
    f"{ROOM}.solve.ambient_estimate": ((ALBEDO, SENT, ELEMENTS.area), {}),
    f"{ROOM}.solution.direct_irradiance": ((SCENE, ELEMENTS), {}),
    f"{ROOM}.solution.radiosity": ((SCENE,), {"plan": PLAN}),
    f"{ROOM}.gather.radiosity_along": (
        (SCENE,),
        {"plan": PLAN, "solution": SOLUTION, "ray": RAY, "gather": MonteCarlo(KEY, 2)},
    ),
    f"{ROOM}.gather.radiosity_image": (
        (SCENE,),
        {"plan": PLAN, "solution": SOLUTION, "view": VIEW},
    ),
    "lights.polygon.contour_integral": ((CORNERS, UP), {}),
}
