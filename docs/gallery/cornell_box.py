"""The Cornell box, path traced

The shipped scene by 64 paths a pixel of up to eight segments. `Traced` also holds the standard
error of each pixel.
"""

from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.render_command import with_resolution
from jaxvision.scene_files import read_scene

box = read_scene("cornell_box")
view = with_resolution(box.view, (256, 256))
scene, view = jv.as_dtype((box.scene, view), jnp.float32)
method = jv.Paths(64, 8, strategy="lights")
traced = jax.jit(partial(jv.path_traced, method=method))(jax.random.key(0), scene, view)
plt.imshow(jv.srgb_encode(traced.radiance.clip(0, 1)))
plt.axis("off")
