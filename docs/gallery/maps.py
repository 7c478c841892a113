"""Maps of a material, averaged over pixels

A checkered floor with one ray for each pixel. If the map is sampled at points, distant tiles cause
false patterns (aliasing). If it is averaged over the footprint of the pixel, they become grey.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

tiles = np.kron(np.indices((2, 2)).sum(0) % 2, np.ones((32, 32)))[..., None]
floor = jv.Surface(
    jv.Plane([0, 0, 0], [0, 0, 1]),
    jv.Lambert(jv.Map(0.02 + 0.25 * tiles, [[1, 0, 0, 0], [0, 1, 0, 0]])),
)
ball = jv.Surface(
    jv.Sphere([0.6, 3.2, 0.5], 0.5),
    jv.Lambert(jv.Map(0.02 + 0.25 * tiles, [[6, 0, 0], [0, 3, 0]])),
)
scene = jv.Scene([floor, ball], jv.DirectionalLight([-0.5, -0.4, 1], [3.0]))
axes = np.array([[1, 0, 0], [0, -0.2, -0.98], [0, 0.98, -0.2]])
view = jv.Pinhole([0, 0, 1], axes, 1.0, 0.0125, resolution=(100, 110))
middles = jax.vmap(jax.vmap(lambda r, c: jv.radiance_along(scene, jv.view_ray(view, r, c))))
rows, columns = np.meshgrid(np.arange(100.0), np.arange(110.0), indexing="ij")
pictures = {"at points": middles(rows, columns), "over pixels": jv.render(scene, view)}
figure, pair = plt.subplots(1, 2, figsize=(4.4, 2.2))
for place, (name, picture) in zip(pair, pictures.items(), strict=True):
    place.imshow(jv.srgb_encode(np.clip(picture[..., 0], 0, 1)), cmap="gray", vmin=0, vmax=1)
    place.set(title=name, xticks=[], yticks=[])
