"""Light on a sensor to digital numbers: photons, electrons, noise, charge, gain and ADC.

The linear model of EMVA 1288 with what real sensors add to it, CCD and CMOS; one file a stage, in
the order of the light's path:

    sampling -> exposure -> dark -> shot_noise -> ccd -> fixed_pattern -> read_out -> adc

`raw` composes them for one exposure, `moments` gives mean and variance in closed form, `shutter`
averages over an exposure what moves. A sensor's parameter that is None is not traced.

Gradients pass through exact Poisson draws and rounding as through their expectations, through
Gaussian draws along the draw itself (so that near 0 electrons they are noisy), and are 0 where
clipped.
"""

from .adc import digitise
from .ccd import bloomed, transferred
from .dark import dark_rate
from .exposure import (
    drifted,
    expected_charge,
    filtered,
    mean_photoelectrons,
    photon_rate,
    smeared,
)
from .fixed_pattern import column_gains, conversion_gains, hot_rates, offsets, sensitivity
from .moments import (
    QUANTISATION_VARIANCE,
    Moments,
    censored,
    clipped_moments,
    expected_signal,
    pattern_variance,
    signal_variance,
)
from .raw import collect, raw_image
from .read_out import read_out_noise, read_out_variance, reset_noise_rms
from .sampling import aperture_mtf, light_share, pixel_means
from .shot_noise import count
from .shutter import exposed, exposure_slots, row_starts

__all__ = [
    "QUANTISATION_VARIANCE",
    "Moments",
    "aperture_mtf",
    "bloomed",
    "censored",
    "clipped_moments",
    "collect",
    "column_gains",
    "conversion_gains",
    "count",
    "dark_rate",
    "digitise",
    "drifted",
    "expected_charge",
    "expected_signal",
    "exposed",
    "exposure_slots",
    "filtered",
    "hot_rates",
    "light_share",
    "mean_photoelectrons",
    "offsets",
    "pattern_variance",
    "photon_rate",
    "pixel_means",
    "raw_image",
    "read_out_noise",
    "read_out_variance",
    "reset_noise_rms",
    "row_starts",
    "sensitivity",
    "signal_variance",
    "smeared",
    "transferred",
]
