"""Names, symbols and units: lines of the EMVA 1288 data sheet, and parameters of the likelihood."""

from typing import NamedTuple

from ..inference.parameters import Parameter


class Quantity(NamedTuple):
    """A line of the sheet.

    Attributes:
        name: a word.
        symbol: the standard's.
        unit: of the value.
        positive: whether its intervals are symmetric in the logarithm.
    """

    name: str
    symbol: str
    unit: str
    positive: bool = True


QUANTITIES = (
    Quantity("system_gain", "K", "DN/e⁻"),
    Quantity("inverse_gain", "1/K", "e⁻/DN"),
    Quantity("quantum_efficiency", "η", "%"),
    Quantity("responsivity", "R", "DN/photon"),
    Quantity("temporal_dark_noise", "σ_y.dark", "DN"),
    Quantity("read_noise", "σ_d", "e⁻"),
    Quantity("dark_current_mean", "μ_I.mean", "e⁻/s", False),
    Quantity("dark_current_variance", "μ_I.var", "e⁻/s", False),
    Quantity("saturation_photons", "μ_p.sat", "photons"),
    Quantity("saturation_electrons", "μ_e.sat", "e⁻"),
    Quantity("snr_max", "SNR_max", "1"),
    Quantity("snr_max_db", "SNR_max", "dB", False),
    Quantity("snr_max_bits", "SNR_max", "bit", False),
    Quantity("threshold_photons", "μ_p.min", "photons"),
    Quantity("threshold_electrons", "μ_e.min", "e⁻"),
    Quantity("dynamic_range", "DR", "1"),
    Quantity("dynamic_range_db", "DR", "dB", False),
    Quantity("usable_bits", "log₂ DR", "bit", False),
    Quantity("linearity_error_min", "LE_min", "%", False),
    Quantity("linearity_error_max", "LE_max", "%", False),
    Quantity("dsnu", "DSNU", "e⁻"),
    Quantity("prnu", "PRNU", "%"),
)
NEED_PHOTONS = ("quantum_efficiency", "responsivity", "saturation_photons", "threshold_photons")
NEED_SATURATION = tuple(
    quantity.name
    for quantity in QUANTITIES
    if quantity.name.startswith(("saturation", "snr_max", "dynamic_range", "usable_bits"))
)
ON_GAIN = (
    *("system_gain", "inverse_gain", "quantum_efficiency", "read_noise", "dsnu"),
    *("saturation_electrons", "threshold_electrons", "threshold_photons"),
    *("dark_current_mean", "dark_current_variance", "dark_current"),
)
HEADINGS = {  # of the sheet, in the order of the standard's summary
    "Quantum efficiency": ("quantum_efficiency", "responsivity"),
    "Overall system gain": ("system_gain", "inverse_gain"),
    "Temporal dark noise": ("read_noise", "temporal_dark_noise"),
    "Signal to noise ratio": ("snr_max", "snr_max_db", "snr_max_bits"),
    "Absolute sensitivity threshold": ("threshold_photons", "threshold_electrons"),
    "Saturation capacity": ("saturation_photons", "saturation_electrons"),
    "Dynamic range": ("dynamic_range", "dynamic_range_db", "usable_bits"),
    "Spatial nonuniformity": ("dsnu", "prnu"),
    "Linearity error": ("linearity_error_min", "linearity_error_max"),
    "Dark current": ("dark_current_mean", "dark_current_variance", "dark_current"),
}

SYSTEM_GAIN = Parameter("system_gain", symbol="K", unit="DN/e⁻", transform="log")
RESPONSIVITY = Parameter("responsivity", symbol="R", unit="DN/photon", transform="log")
SIGNAL_RATE = Parameter("signal_rate", symbol="R_t", unit="DN/s", transform="log")
OFFSET = Parameter("black_level", symbol="μ_y.dark", unit="DN")
READ_NOISE = Parameter("read_noise", symbol="σ_d", unit="e⁻", transform="log")
DARK_CURRENT = Parameter("dark_current", symbol="μ_I", unit="e⁻/s")
OFFSET_SPREAD = Parameter("offset_spread", symbol="s_dark", unit="DN", transform="log")
COMPRESSION = Parameter("compression", symbol="c₁", unit="1")
COMPRESSION_2 = Parameter("compression_2", symbol="c₂", unit="1")
BRIGHTER_FATTER = Parameter("brighter_fatter", symbol="β", unit="1")
PIXEL_MIXING = Parameter("pixel_mixing", symbol="κ", unit="1")
LIGHT_OFFSET = Parameter("light_offset", symbol="δ", unit="photons")
SHUTTER_OFFSET = Parameter("light_offset", symbol="δ", unit="s")
LIGHT_SCATTER = Parameter("light_scatter", symbol="τ_H", unit="1", transform="log")
VARIANCE_SCATTER = Parameter("variance_scatter", symbol="τ_V", unit="1", transform="log")
BLACK_SCATTER = Parameter("black_scatter", symbol="τ₀", unit="DN", transform="log")
SCATTERS = ("light_scatter", "variance_scatter", "black_scatter")
