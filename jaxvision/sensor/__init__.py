"""Light on a sensor to digital numbers: photons, electrons, noise, charge, gain and ADC.

The linear model of EMVA 1288, extended by the further effects of real CCD and CMOS sensors. Each
stage has its own file, in the order of the light's path:

    sampling -> exposure -> dark -> shot_noise -> ccd -> fixed_pattern -> read_out -> adc

`raw` composes them for one exposure, `moments` gives mean and variance in closed form, and
`shutter` averages a moving scene over the exposure. A parameter of the sensor that is None is not
traced.

Exact Poisson draws and rounding have the gradients of their expectations. Gaussian draws are
differentiated along the draw itself, so their gradients are noisy near 0 electrons. Clipping has
gradient 0.
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
