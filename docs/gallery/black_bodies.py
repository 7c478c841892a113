"""The colours of black bodies

Spectra by Planck's law, converted to sRGB by the CIE observer, from the glow of a candle to a blue
star.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv
from jaxvision.colour_spaces import observer, wavelength_grid, xyz_to_rgb
from jaxvision.spectra import blackbody, spectrum_to_xyz

wavelengths = wavelength_grid()
kelvin = jnp.linspace(1500, 12_000, 256)
spectra = jax.vmap(lambda t: blackbody(wavelengths, t))(kelvin)
xyz = spectrum_to_xyz(spectra, wavelengths, observer(wavelengths))
rgb = xyz_to_rgb(xyz).clip(0)
colours = jv.srgb_encode(rgb / rgb.max(axis=-1, keepdims=True))
plt.figure(figsize=(4.4, 1.8))
plt.imshow(colours[None], extent=(1500, 12_000, 0, 2000))
plt.xlabel("temperature [K]")
plt.yticks([])
