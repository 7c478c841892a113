"""Glass and mirror

At glass each ray splits into a reflected and a refracted ray by Fresnel's equations, and at a
mirror it is reflected. Each pixel has a tree of at most 16 rays.
"""

from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.files import read_scene
from jaxvision.render_command import change_resolution

table = read_scene("glass_and_mirror")
scene, view = jv.as_dtype((table.scene, change_resolution(table.view, (270, 480))), jnp.float32)
tree = jax.jit(partial(jv.ray_traced, rays=16, rule=jv.Quadrature(6)))
plt.imshow(jv.srgb_encode(tree(scene, view).clip(0, 1)))
plt.axis("off")
