"""Light falls off towards the corners

Pictures through an 8 mm lens at f/2, with the cos⁴ law alone, and with a rim in front of the lens
that blocks part of the pupil for oblique rays.
"""

from dataclasses import replace

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

plain = jv.ThinLens((0, 0, 0), np.eye(3), 8e-3, 6e-5, resolution=(180, 180), f_number=2.0)
rimmed = replace(plain, rim=jv.Rim(6e-3, 5.5e-3))
even = jnp.ones((180, 180, 1))
figure, axes = plt.subplots(1, 2)
for axis, view, name in zip(axes, (plain, rimmed), ("cos⁴", "cos⁴ and a rim"), strict=True):
    light = jv.sensor_irradiance(view, even)[..., 0]
    axis.imshow(light / light.max(), cmap="gray", vmin=0, vmax=1)
    lines = axis.contour(light / light.max(), levels=(0.25, 0.5, 0.75), colors="tab:orange")
    axis.clabel(lines)
    axis.set_title(name)
    axis.axis("off")
