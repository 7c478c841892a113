"""Calls for the development from raw to picture."""

import jax.numpy as jnp
import numpy as np

from jaxvision import scene as s
from jaxvision.sensor.colour_filters import bayer

RNG = np.random.default_rng(5)

PATTERN = bayer("GRBG")
RAW = jnp.asarray(RNG.uniform(0.1, 0.9, size=(6, 7)))
PICTURE = jnp.asarray(RNG.uniform(0.1, 0.9, size=(9, 10, 3)))
GAINS = jnp.asarray([1.9, 1.0, 1.4])
ONE = jnp.asarray(0.95)
SIX = jnp.asarray(6.0)
QUALITY = jnp.asarray(71.3)
CAMERA, WANTED = (jnp.asarray(RNG.uniform(0.1, 0.9, size=(8, 3))) for _ in range(2))
WAVELENGTHS = jnp.linspace(4e-7, 7e-7, 9)
SENSITIVITIES, OBSERVER = (jnp.asarray(RNG.uniform(0.1, 0.9, size=(9, 3))) for _ in range(2))
ILLUMINANT = jnp.asarray(RNG.uniform(0.5, 1.0, size=9))
REFLECTANCES = jnp.asarray(RNG.uniform(0.1, 0.9, size=(8, 9)))
WHITE = jnp.asarray([0.95, 1.0, 1.09])
CURVE = s.ToneCurve([0.0, 0.3, 0.7, 1.1], [0.0, 0.2, 0.7, 1.0])
DEVELOPMENT = s.Development(
    black_level=0.05,
    white_level=1.5,
    demosaicing=s.Demosaicing(PATTERN),
    white_balance=s.WhiteBalance(GAINS),
    saturation=1.0,
    denoising=s.Bilateral(1.2, 0.3, radius=1),
    colour_matrix=[[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]],
    tone_map=CURVE,
    tone=s.SRGB(),
    sharpening=s.UnsharpMask(1.0, 0.4, size=3),
)

EXAMPLES = {
    "sensor.colour_filters.mosaic": ((PICTURE,), {"pattern": PATTERN}),
    "development.colour_matrix.camera_colour": (
        (SENSITIVITIES, ILLUMINANT, REFLECTANCES, WAVELENGTHS, OBSERVER, WHITE),
        {},
    ),
    "development.colour_matrix.fit_colour_matrix": ((CAMERA, WANTED), {}),
    "development.demosaicing.demosaic": ((RAW,), {"pattern": PATTERN}),
    "development.demosaicing.demosaic_bilinear": ((RAW,), {"pattern": PATTERN}),
    "development.demosaicing.demosaic_malvar": ((RAW,), {"pattern": PATTERN, "border": "mirror"}),
    "development.demosaicing.demosaic_menon": ((RAW,), {"pattern": PATTERN}),
    "development.demosaicing.demosaic_normalised": ((RAW,), {"pattern": ((0, 1, 2), (2, 0, 1))}),
    "development.jpeg_loss.jpeg": ((PICTURE, QUALITY), {"rounding": "cubic"}),
    "development.jpeg_loss.quantisation_tables": ((QUALITY,), {"rounding": "cubic"}),
    "development.pipeline.develop": ((RAW, DEVELOPMENT), {}),
    "development.pipeline.to_integers": ((PICTURE,), {}),
    "development.tone.encode_tone": ((PICTURE, s.Gamma(2.2)), {}),
    "development.tone.map_tone": ((PICTURE, CURVE), {}),
    "development.tone.tone_curve": ((PICTURE, CURVE.inputs, CURVE.outputs), {}),
    "development.white_balancing.grey_world_gains": ((PICTURE,), {"norm": SIX, "saturation": ONE}),
    "development.white_balancing.neutral_gains": ((PICTURE,), {}),
    "development.white_balancing.white_balance": ((PICTURE, GAINS), {"saturation": ONE}),
}
