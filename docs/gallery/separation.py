"""Body and highlight separated

In Shafer's dichromatic model, the colours of a plastic ball lie in the plane spanned by the body's
colour and the lamp's colour. Each pixel is separated into these two parts.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

lamp = np.array([1.0, 0.9, 0.7])
gloss = jv.TorranceSparrow([0.0], [1.0], 0.2, interface=jv.Dielectric([1.5]))
plastic = jv.Dichromatic(jv.Lambert([1 / np.pi]), gloss, [0.7, 0.25, 0.06], [1.0])
ball = jv.Surface(jv.Sphere((0, 0, 0), 1.0), plastic)
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.1 / 200, resolution=(200, 200))
picture = jv.render(jv.Scene([ball], [jv.PointLight((-1.2, 1.5, 3), 25 * lamp)]), view)
parts = jv.separate(picture, lamp, valid=picture.max(axis=-1) > 0.01)
body = parts.body[..., None] * parts.body_colour
highlight = parts.interface[..., None] * parts.illuminant
figure, axes = plt.subplots(1, 3, figsize=(5.6, 2.2))
shown = {"picture": picture, "body": body, "highlight": highlight}
for axis, (name, part) in zip(axes, shown.items(), strict=True):
    axis.imshow(jv.srgb_encode((part / jnp.quantile(picture, 0.99)).clip(0, 1)))
    axis.set_title(name)
    axis.axis("off")
