"""A turning blade under a rolling shutter

Rows are exposed one after another, 0.1 ms apart, while the blade turns 40 times per second. The
scene is a function of time, which the camera evaluates for the exposure of each group of rows.
"""

from dataclasses import replace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

bar = jv.Box((0.0, 0.0, 5.0), (0.42, 0.06, 0.01), rotation=np.eye(3))
scene = jv.Scene([jv.Surface(bar, jv.Lambert([0.0]), [1.0])], [])
view = jv.Pinhole((0, 0, 0), np.eye(3), 10e-3, 1.4e-5, resolution=(160, 160), f_number=4.0)


def turning(scene, view, time):
    cos, sin = jnp.cos(80 * jnp.pi * time), jnp.sin(80 * jnp.pi * time)
    turn = jnp.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    return jv.Scene([replace(scene.surfaces[0], shape=replace(bar, rotation=turn))], []), view


sensor = jv.Sensor(exposure_time=1e-3, shutter=jv.RollingShutter(1e-4))
shot = jv.capture(None, scene, jv.Camera(view, sensor), motion=turning, moments=64)
plt.imshow(shot.radiance[..., 0], cmap="gray")
plt.axis("off")
