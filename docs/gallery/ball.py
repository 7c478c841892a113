"""A ball under three lamps

A sphere shaded by Phong's model, with body, highlight and ambient light in three bands. The picture
can be differentiated with respect to each of them.
"""

import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

material = jv.Phong((0.35, 0.12, 0.08), (0.4, 0.4, 0.4), 40.0, ambient=(0.1, 0.1, 0.1))
ball = jv.Surface(jv.Sphere((0.0, 0.0, 0.0), 1.0), material)
lamps = [
    jv.PointLight((-2.0, 2.0, 3.0), (14.0, 13.0, 11.0)),
    jv.PointLight((3.0, 0.5, 1.0), (2.0, 3.0, 8.0)),
    jv.DirectionalLight((0.0, -1.0, 0.3), (0.3, 0.1, 0.1)),
]
scene = jv.Scene([ball], lamps, jv.AmbientLight((0.2, 0.2, 0.2)))
front = np.diag([1.0, -1.0, -1.0])  # rows: right, down, forward
view = jv.Orthographic((0.0, 0.0, 5.0), front, 2.2 / 320, resolution=(320, 320))
plt.imshow(jv.srgb_encode(jv.render(scene, view).clip(0, 1)))
plt.axis("off")
