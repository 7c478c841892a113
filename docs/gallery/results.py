"""Plots of results

Six of the plots of `jaxvision.plots`: a picture, a false-colour map with its unit, a histogram,
spectra, lobes, and a curve with its uncertainty band and the true curve.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv
from jaxvision import plots

ball = jv.Surface(jv.Sphere((0, 0, 0), 1.0), jv.Phong([0.3, 0.2, 0.1], [0.3], 30.0))
view = jv.Orthographic((0, 0, 5.0), np.diag([1.0, -1, -1]), 2.2 / 128, resolution=(128, 128))
light = jv.render(jv.Scene([ball], [jv.PointLight((2.0, 2, 4), (30.0, 30, 30))]), view)
figure, axes = plt.subplots(3, 2, figsize=(5.8, 7.6))
axes[2, 1].remove()
plots.picture(light, axes=axes[0, 0])
plots.false_colour(light[..., 0], unit="W m$^{-2}$ sr$^{-1}$", axes=axes[0, 1])
plots.histogram(np.uint8(255 * jv.srgb_encode(light / light.max())), axes=axes[1, 0])
grid = np.linspace(380e-9, 780e-9, 81)
lamps = {name: jv.colour_spaces.illuminant(name, grid) for name in ("D65", "A", "FL2")}
plots.spectrum(grid, lamps, label="relative power", axes=axes[1, 1])
code = np.linspace(0, 1, 50)
found, sd = code**2.17, 0.02 + 0.03 * code
band = found - sd, found + sd
plots.curve(code, found, band=band, truth=code**2.2, names=("code", ""), axes=axes[2, 0])
black, glass = jnp.zeros(1), jv.Dielectric([1.5])
rough = {f"α = {a}": jv.TorranceSparrow(black, [1.0], a, interface=glass) for a in (0.2, 0.3)}
plots.lobe(rough, axes=figure.add_subplot(3, 2, 6, projection="polar"))
