"""The shape of a point out of focus

A point of light takes the shape of the aperture: a disc, five and eight blades, and the ring of a
lens with a mirror in its middle.
"""

import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.optics import aperture_kernel

shapes = {
    "circle": jv.CircularAperture(),
    "5 blades": jv.PolygonalAperture(5),
    "8 blades": jv.PolygonalAperture(8),
    "ring": jv.AnnularAperture(0.5),
}
figure, axes = plt.subplots(2, 2)
for axis, (name, shape) in zip(axes.flat, shapes.items(), strict=True):
    axis.imshow(aperture_kernel(shape, 20.0, size=47), cmap="gray")
    axis.set_title(name)
    axis.axis("off")
