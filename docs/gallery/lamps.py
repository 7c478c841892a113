"""Lamps from photometric files

A wall lit by a spot light, by a point light with a measured angular distribution, and by the same
distribution from a long luminous opening, as its photometric file describes it. Photometric files
are read by `jv.files.read_luminaire`.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

gamma, planes = np.radians(np.arange(0, 91, 15)), np.radians(np.arange(0, 361, 45))
wide = np.cos(gamma)[:, None] * (1 + 3 * np.sin(gamma)[:, None] ** 2 * np.sin(planes) ** 2)
sold = jv.Luminaire(800 * wide, gamma, planes, [1.2, 0.3, 0.0], 4000.0, 40.0)
wall = jv.Surface(jv.Quad((-2, 0.0, 0), (4.0, 0, 0), (0, 0, 2.5)), jv.Lambert([0.8 / np.pi]))
place = (0.0, -0.4, 2.4)
lamps = {
    "spot": jv.SpotLight(place, (0, 0.2, -1), [1.6], np.radians(15), np.radians(40)),
    "point": jv.goniometric_light(sold, place),
    "opening of 1.2 m": jv.goniometric_light(sold, place, opening=True),
}
view = jv.Orthographic(
    (0, -5, 1.25), [[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], 0.01, resolution=(250, 400)
)
figure, axes = plt.subplots(3, 1, figsize=(4, 7.5))
for axis, (name, lamp) in zip(axes, lamps.items(), strict=True):
    picture = jax.jit(jv.render)(jv.Scene([wall], [lamp]), view, rule=jv.Quadrature(6))
    axis.imshow(jv.srgb_encode(jnp.clip(picture[..., 0] / 0.6, 0, 1)), cmap="gray", vmin=0, vmax=1)
    axis.set(title=name, xticks=[], yticks=[])
