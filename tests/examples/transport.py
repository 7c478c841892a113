"""Calls for multiple reflections: paths, trees of rays, and light tracing."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxvision import Lambert, Mirror, PointLight, RectangleLight
from jaxvision import scene as s
from jaxvision.brdf.glass import Glass
from jaxvision.core._random import Stream
from jaxvision.core._vector import as_vec
from jaxvision.geometry import Ray
from jaxvision.transport import Paths

KEY = jax.random.key(3)
W = jnp.asarray([0.36, 0.48, 0.8])
U = jnp.asarray([0.3, 0.6, 0.7])
GLASS = Glass(1.5, absorption=[0.3, 0.5])
FLOOR = s.Surface(s.Quad([-2.0, -2, 0], [4.0, 0, 0], [0, 4.0, 0]), Lambert([0.2, 0.1]))
WALL = s.Surface(s.Quad([1.0, -2, 0], [0, 0, 2.0], [0, 4.0, 0]), Lambert([0.1, 0.2]), [0.1, 0.3])
LAMPS = [
    RectangleLight([-0.5, -0.5, 1.5], [0, 1.0, 0], [1.0, 0, 0], [3.0, 2]),
    PointLight([0, 0.2, 1], [1.0, 2]),
]
DIFFUSE = s.Scene([FLOOR, WALL], LAMPS)
MIRRORS = s.Scene(
    [
        FLOOR,
        s.Surface(s.Sphere([0.3, 0.1, 0.5], 0.3), GLASS),
        s.Surface(s.Sphere([-0.5, 0.1, 0.4], 0.3), Mirror([0.9, 0.8])),
    ],
    LAMPS,
)
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = s.Pinhole([0.05, 0.02, 1.3], DOWN, 1.0, 0.3, resolution=(2, 3))
RAY = Ray(jnp.asarray([0.27, 0.05, 1.4]), jnp.asarray([0.0, 0.0, -1.0]))
# The ray is at the mirror, because a direction that is 1e-6 too short is no valid ray in glass,
# where it would start behind its surface. The view's rays, always of unit length, hit glass.
REFLECTED = Ray(jnp.asarray([-0.48, 0.12, 1.4]), jnp.asarray([0.0, 0.0, -1.0]))
RAYS = jax.tree.map(lambda *x: jnp.stack(x), REFLECTED, REFLECTED)
STREAM = Stream(jnp.uint32(5), jnp.uint32(2), jnp.asarray([7, 9], jnp.uint32))
METHOD = {"method": Paths(2, 3, strategy="lights")}
ROW, COLUMN = jnp.asarray([1, 0]), jnp.asarray([2, 1])

EXAMPLES = {
    "rendering.pixel_loop.sample_ray": ((VIEW, *jnp.asarray([1.0, 2.0]), STREAM), {}),
    "brdf.glass.refracted_direction": ((W, jnp.asarray(1.4)), {}),
    "brdf.glass.specular": ((GLASS, as_vec(W)), {}),
    "transport.paths.path_sample": ((DIFFUSE, RAY, STREAM), METHOD),
    "transport.paths.path_radiance": ((KEY, DIFFUSE, RAY), METHOD),
    "transport.paths.path_traced_pixels": ((KEY, DIFFUSE, VIEW, ROW, COLUMN), METHOD),
    "transport.paths.path_traced": ((KEY, DIFFUSE, VIEW), METHOD),
    "transport.ray_tree.ray_tree_radiance": ((MIRRORS, REFLECTED), {"rays": 4}),
    "transport.ray_tree.ray_tree_radiances": ((MIRRORS, RAYS), {"rays": 3}),
    "transport.ray_tree.ray_traced": ((MIRRORS, VIEW), {"rays": 3}),
    "transport.light_paths.light_traced": ((KEY, DIFFUSE, VIEW), {"paths": 64, "depth": 3}),
}
