"""Eight continuations of a picture beyond its border

The eight borders of every filter, which define how a picture continues outside.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle
from skimage import data

from jaxvision.filters import BORDERS, pad

eye = jnp.asarray(data.astronaut()[80:144, 190:254] / 255)
figure, axes = plt.subplots(2, 4, figsize=(5.6, 3.1))
for axis, border in zip(axes.flat, BORDERS, strict=False):
    axis.imshow(pad(eye, ((24, 24), (24, 24)), border=border, fill=0.5).clip(0, 1))
    axis.add_patch(Rectangle((24, 24), 64, 64, fill=False, ec="cyan"))
    axis.set_title(border, fontsize=8)
for axis in axes.flat:
    axis.axis("off")
