"""Development: from the raw data of a sensor to the picture of a file."""

from .colour_matrix import CameraColour, camera_colour, fit_colour_matrix
from .demosaicing import (
    demosaic,
    demosaic_bilinear,
    demosaic_malvar,
    demosaic_menon,
    demosaic_normalised,
)
from .jpeg_loss import jpeg, quantisation_tables
from .pipeline import develop, to_integers
from .tone import encode_tone, map_tone, tone_curve
from .white_balancing import grey_world_gains, neutral_gains, white_balance

__all__ = [
    "CameraColour",
    "camera_colour",
    "demosaic",
    "demosaic_bilinear",
    "demosaic_malvar",
    "demosaic_menon",
    "demosaic_normalised",
    "develop",
    "encode_tone",
    "fit_colour_matrix",
    "grey_world_gains",
    "jpeg",
    "map_tone",
    "neutral_gains",
    "quantisation_tables",
    "to_integers",
    "tone_curve",
    "white_balance",
]
