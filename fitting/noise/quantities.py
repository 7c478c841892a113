"""Names, symbols and units of the figures on the EMVA 1288 data sheet, and the parameters of the
likelihood."""

from typing import NamedTuple

from ..inference.parameters import Parameter


class Quantity(NamedTuple):
    """The description of one figure (result) on the EMVA 1288 data sheet: its name, symbol and
    unit."""

    name: str  # a word
    symbol: str  # the standard's
    unit: str  # of the value
    positive: bool = True  # whether its intervals are symmetric in the logarithm


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


def _number(name: str, symbol: str, unit: str, *, positive: bool = False) -> Parameter:
    """Make a scalar parameter of the likelihood; a positive one is fitted by its logarithm."""
    transform = "log" if positive else "identity"
    return Parameter(name, symbol=symbol, unit=unit, transform=transform, shape=())


SYSTEM_GAIN = _number("system_gain", "K", "DN/e⁻", positive=True)
RESPONSIVITY = _number("responsivity", "R", "DN/photon", positive=True)
SIGNAL_RATE = _number("signal_rate", "R_t", "DN/s", positive=True)
OFFSET = _number("black_level", "μ_y.dark", "DN")
READ_NOISE = _number("read_noise", "σ_d", "e⁻", positive=True)
DARK_CURRENT = _number("dark_current", "μ_I", "e⁻/s")
OFFSET_SPREAD = _number("offset_spread", "s_dark", "DN", positive=True)
COMPRESSION = _number("compression", "c₁", "1")
COMPRESSION_2 = _number("compression_2", "c₂", "1")
BRIGHTER_FATTER = _number("brighter_fatter", "β", "1")
PIXEL_MIXING = _number("pixel_mixing", "κ", "1")
LIGHT_OFFSET = _number("light_offset", "δ", "photons")
SHUTTER_OFFSET = _number("light_offset", "δ", "s")
LIGHT_DRIFT = _number("light_drift", "d", "1")
LIGHT_SCATTER = _number("light_scatter", "τ_H", "1", positive=True)
VARIANCE_SCATTER = _number("variance_scatter", "τ_V", "1", positive=True)
BLACK_SCATTER = _number("black_scatter", "τ₀", "DN", positive=True)
SCATTERS = ("light_scatter", "variance_scatter", "black_scatter")
