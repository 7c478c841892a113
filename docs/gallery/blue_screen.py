"""A ball cut from a blue screen

The ball is rendered in front of a blue wall, keyed under the assumption that the foreground is
grey, and composited in linear light over another picture.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import jaxvision as jv
from jaxvision.matting import blue_screen_matte

ball = jv.Surface(jv.Sphere((0, 0, 0), 0.8), jv.PhongBRDF([0.15] * 3, [0.1] * 3, 50.0))
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.0 / 240, resolution=(240, 240))
lamp = jv.PointLight((-2, 2, 3), (30.0, 30.0, 30.0))
backing = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.6]), (240, 240, 3))
grey = jv.render(jv.Scene([ball], [lamp]), view)
rows, columns = jnp.mgrid[0:240, 0:240] - 119.5
cover = (96.5 - jnp.hypot(rows, columns)).clip(0, 1)[..., None]
shot = cover * grey + (1 - cover) * backing
alpha = blue_screen_matte(shot, backing)
behind = jv.srgb_decode(jnp.asarray(data.coffee()[60:300, 200:440] / 255))
picture = shot - (1 - alpha) * backing + (1 - alpha) * behind
plt.imshow(jnp.hstack([jv.srgb_encode(p.clip(0, 1)) for p in (shot, picture)]))
plt.axis("off")
