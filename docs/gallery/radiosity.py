"""The Cornell box by radiosity

The patches measure 6 cm. Form factors are closed forms between patches with nothing in between, and
each pixel sums over the patches. The picture has no noise, and one solution can be used for every
view.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.colour_spaces import luminance
from jaxvision.files import read_scene
from jaxvision.render_command import change_resolution
from jaxvision.transport.radiosity import plan_patches, radiosity, radiosity_image

box = read_scene("cornell_box")
scene, view = jv.as_dtype((box.scene, change_resolution(box.view, (384, 384))), jnp.float32)
plan = plan_patches(scene, size=0.06)


@jax.jit
def picture(scene, view):
    samples = jv.PixelSamples(jax.random.key(0), 4)
    return radiosity_image(scene, plan, radiosity(scene, plan), view, samples=samples)


radiance = picture(scene, view)
white = jnp.quantile(luminance(radiance), 0.95) / 0.8
clipped = (radiance / white).clip(0, 1)  # before the mean, so that the lamp's edge is smooth
plt.imshow(jv.srgb_encode(clipped.reshape(192, 2, 192, 2, 3).mean((1, 3))))
plt.axis("off")
