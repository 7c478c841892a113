"""Aberrations

The image of a star through a lens at f/8: the Airy pattern, the patterns with four aberrations of a
fifth of a wave (RMS), and the pattern of an iris of six blades. Each picture is scaled to its
brightest pixel, whose share of the light is given.
"""

import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv

wave = 550e-9  # m
terms = {"none": 1, "defocus": 4, "astigmatism": 6, "coma": 8, "spherical": 11, "six blades": 1}
figure, axes = plt.subplots(1, 6, figsize=(9, 1.9))
for axis, (name, j) in zip(axes, terms.items(), strict=True):
    error = np.eye(j)[-1] * wave / 5
    iris = jv.PolygonalAperture(6) if name == "six blades" else jv.CircularAperture()
    star = jv.optics.wavefront_kernel(error, wave, 8.0, 1e-6, size=41, aperture=iris)
    axis.imshow(np.sqrt(star), cmap="gray")
    axis.set(title=f"{name}\n{100 * float(star.max()):.2g} %", xticks=[], yticks=[])
