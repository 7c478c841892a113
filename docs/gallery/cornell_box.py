"""The Cornell box, path traced

The shipped scene, rendered with 256 paths per pixel of up to eight segments. The exposure puts 95 %
of the pixels below 0.8 of white, as in the previews of `jaxvision render`. The result, a `Traced`,
also contains the standard error of each pixel.
"""

from functools import partial

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.colour_spaces import luminance
from jaxvision.files import read_scene
from jaxvision.render_command import change_resolution

box = read_scene("cornell_box")
view = change_resolution(box.view, (256, 256))
scene, view = jv.as_dtype((box.scene, view), jnp.float32)
method = jv.Paths(256, 8, strategy="lights")
traced = jax.jit(partial(jv.path_traced, method=method))(jax.random.key(0), scene, view)
white = jnp.quantile(luminance(traced.radiance), 0.95) / 0.8
plt.imshow(jv.srgb_encode((traced.radiance / white).clip(0, 1)))
plt.axis("off")
