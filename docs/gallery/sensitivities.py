"""Spectral sensitivities from a chart

Spectral sensitivities estimated from readings of 24 patches under daylight, with noise of half a
per cent. The plot shows the true curves (dashed) and the 68 % and 95 % intervals.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxvision as jv
from fitting import sensitivities

wavelengths = 1e-9 * np.arange(400, 701, 10)
at = jnp.asarray(wavelengths)
light = jv.colour_spaces.chart_reflectances(at) * jv.colour_spaces.illuminant("D65", at) / 100
true = np.asarray(jv.colour_spaces.camera_sensitivities("Nikon 5100 (NPL)", at))
readings = np.asarray(light @ true)
noise = 0.005 * readings
readings = readings + noise * np.random.default_rng(0).normal(size=readings.shape)
found = sensitivities.from_patches(readings, light, wavelengths, sd=noise)
figure, axes = plt.subplots()
for i, colour in enumerate(["#c43b3b", "#2f8f4e", "#3b62c4"]):
    for ends, alpha in ((found.curves.interval_95, 0.2), (found.curves.interval_68, 0.3)):
        axes.fill_between(1e9 * wavelengths, *ends[..., i], color=colour, alpha=alpha, linewidth=0)
    axes.plot(1e9 * wavelengths, true[:, i], "--", color=colour)
axes.set(xlabel="wavelength, nm", ylabel="sensitivity", ylim=(0, None))
