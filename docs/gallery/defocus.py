"""Three balls through a thin lens

Rays pass through all points of the aperture of a 50 mm lens at f/1.4, focused at 2 m. The near and
the far ball are blurred by the circle of confusion.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

colours = ([0.25, 0.05, 0.04], [0.05, 0.2, 0.06], [0.05, 0.1, 0.28])
places = ((-0.26, 0.03, 1.4), (0.0, 0.05, 2.0), (0.45, 0.0, 3.2))
balls = [
    jv.Surface(jv.Sphere(c, 0.17), jv.PhongBRDF(kd, [0.05] * 3, 60.0))
    for c, kd in zip(places, colours, strict=True)
]
wall = jv.Surface(jv.Plane((0, 0, 4.5), (0, 0, -1)), jv.Lambert([0.2] * 3))
scene = jv.Scene([*balls, wall], [jv.PointLight((-1, -2, 0), (12.0, 12.0, 12.0))])
view = jv.ThinLens(
    (0, 0, 0), np.eye(3), 0.05, 1e-4, resolution=(180, 280), f_number=1.4, focus_distance=2.0
)
radiance = jax.jit(jv.render)(scene, view, samples=jv.PixelSamples(jax.random.key(0), 64))
plt.imshow(jv.srgb_encode((radiance / jnp.quantile(radiance, 0.998)).clip(0, 1)))
plt.axis("off")
