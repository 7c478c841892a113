# What `jaxvision.development` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .colour_matrix import (
    CameraColour as CameraColour,
    camera_colour as camera_colour,
    fit_colour_matrix as fit_colour_matrix,
)
from .demosaicing import (
    demosaic as demosaic,
    demosaic_bilinear as demosaic_bilinear,
    demosaic_malvar as demosaic_malvar,
    demosaic_menon as demosaic_menon,
    demosaic_normalised as demosaic_normalised,
)
from .jpeg_loss import jpeg as jpeg, quantisation_tables as quantisation_tables
from .pipeline import develop as develop, to_integers as to_integers
from .tone import encode_tone as encode_tone, map_tone as map_tone, tone_curve as tone_curve
from .white_balancing import (
    grey_world_gains as grey_world_gains,
    neutral_gains as neutral_gains,
    white_balance as white_balance,
)
