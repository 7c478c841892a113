"""Calls for spectra on a grid of five bands."""

import jax.numpy as jnp
import numpy as np

RNG = np.random.default_rng(8)
GRID = jnp.asarray([4.0, 4.6, 5.1, 5.7, 6.3, 6.9]) * 1e-7
EVEN = jnp.linspace(4e-7, 7e-7, 7)
WANTED = jnp.asarray([4.13, 5.02, 6.61]) * 1e-7
VALUES = jnp.asarray(RNG.uniform(0.2, 0.9, size=(2, 6)))
SMOOTH = jnp.asarray(RNG.uniform(0.2, 0.9, size=(2, 7)))
THREE = jnp.asarray(RNG.uniform(0.2, 0.9, size=(6, 3)))
LAMP = jnp.asarray(RNG.uniform(0.5, 1.5, size=6))

EXAMPLES = {
    "spectra.interpolate_spectrum": ((SMOOTH, EVEN, WANTED), {"method": "sprague"}),
    "spectra.band_widths": ((GRID,), {}),
    "spectra.integrate_spectrum": ((VALUES, GRID), {}),
    "spectra.spectrum_to_camera": ((VALUES, GRID, THREE), {}),
    "spectra.spectrum_to_xyz": ((VALUES, GRID, THREE), {}),
    "spectra.reflectance_to_xyz": ((VALUES, GRID, THREE, LAMP), {}),
    "spectra.rgb_to_reflectance": ((THREE, THREE), {}),
    "spectra.blackbody": ((GRID, jnp.asarray(3200.0)), {}),
    "spectra.daylight": ((THREE, jnp.asarray(6500.0)), {}),
}
