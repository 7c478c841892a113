# What `jaxvision.sensor` offers, each name where it is defined; see `jaxvision/__init__.pyi`.

from . import colour_filters as colour_filters
from ._registry import (
    register as register,
    register_curve as register_curve,
    stage_of as stage_of,
)
from .adc import digitise as digitise
from .brighter_fatter import (
    area_changes as area_changes,
    flat_covariances as flat_covariances,
    gathered as gathered,
)
from .ccd import bloomed as bloomed, transferred as transferred
from .correction import (
    Calibrated as Calibrated,
    Master as Master,
    Masters as Masters,
    Part as Part,
    correct as correct,
)
from .dark import dark_rate as dark_rate
from .expectation import (
    expected_of_count as expected_of_count,
    expected_of_defect as expected_of_defect,
    expected_of_reading as expected_of_reading,
)
from .exposure import (
    set_iso as set_iso,
    drifted as drifted,
    expected_charge as expected_charge,
    filtered as filtered,
    mean_photoelectrons as mean_photoelectrons,
    photon_rate as photon_rate,
    smeared as smeared,
)
from .fixed_pattern import (
    column_gains as column_gains,
    conversion_gains as conversion_gains,
    hot_rates as hot_rates,
    offsets as offsets,
    sensitivity as sensitivity,
)
from .mixing import even_mixing as even_mixing, mixed as mixed
from .moments import (
    QUANTISATION_VARIANCE as QUANTISATION_VARIANCE,
    Moments as Moments,
    censored as censored,
    clipped_moments as clipped_moments,
    expected_signal as expected_signal,
    neighbour_covariances as neighbour_covariances,
    pattern_variance as pattern_variance,
    signal_to_noise as signal_to_noise,
    signal_variance as signal_variance,
)
from .nonlinearity import (
    charge_of_signal as charge_of_signal,
    signal_of_charge as signal_of_charge,
)
from .raw import collect as collect, raw_image as raw_image
from .read_out import (
    read_out_noise as read_out_noise,
    read_out_variance as read_out_variance,
    reset_noise_rms as reset_noise_rms,
)
from .sampling import (
    aperture_mtf as aperture_mtf,
    light_share as light_share,
    pixel_means as pixel_means,
)
from .shot_noise import count as count
from .shutter import exposed as exposed, exposure_slots as exposure_slots, row_starts as row_starts
