"""The shape of a point out of focus

A point of light out of focus has the shape of the aperture: a disc, polygons of five and eight
blades, and the ring of a mirror lens.
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
