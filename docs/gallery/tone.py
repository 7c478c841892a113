"""A high range on a screen

A cup in a patch of sunlight a hundred times as bright as the shade. The picture is shown clipped,
with Reinhard's curve and with a filmic curve.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from skimage import data

import jaxvision as jv
from jaxvision.point_ops import filmic, reinhard

room = jv.srgb_decode(jnp.asarray(data.coffee()[:320, 100:420] / 255))
rows, columns = jnp.mgrid[0:320, 0:320]
sun = jnp.exp(-((rows - 60) ** 2 + (columns - 250) ** 2) / 2 / 70**2)[..., None]
radiance = room * (0.3 + 30 * sun)
pictures = {
    "clipped": radiance,
    "Reinhard": reinhard(radiance, white=12.0),
    "filmic": filmic(radiance),
}
figure, axes = plt.subplots(1, 3, figsize=(5.6, 2.2))
for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
    axis.imshow(jv.srgb_encode(picture.clip(0, 1)))
    axis.set_title(name)
    axis.axis("off")
