# What `jaxvision.point_ops` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from .across_picture import (
    correct_vignetting as correct_vignetting,
    graded_filter as graded_filter,
    vignette as vignette,
)
from .curves import (
    clip as clip,
    gamma_decode as gamma_decode,
    gamma_encode as gamma_encode,
    srgb_decode as srgb_decode,
    srgb_encode as srgb_encode,
)
from .linear import (
    blend as blend,
    contrast_brightness as contrast_brightness,
    cross_dissolve as cross_dissolve,
    exposure as exposure,
    gain_bias as gain_bias,
)
from .tables import (
    lookup as lookup,
    lookup_3d as lookup_3d,
    lookup_codes as lookup_codes,
)
from .tone_mapping import (
    filmic as filmic,
    log_curve as log_curve,
    reinhard as reinhard,
    scaled_to_key as scaled_to_key,
    set_luminance as set_luminance,
)
