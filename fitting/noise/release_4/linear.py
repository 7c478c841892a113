"""Release 4 *Linear*: the temporal figures by the regressions of release 3.1, with these
differences:

    threshold   mu_e.min = sqrt(sigma_d^2 + sigma_q^2 / K^2 + 1/4) + 1/2      (26, 27)
    saturation  .1 to .2 % of the numbers at the end of the scale             (clause 6.6)
    linearity   LE = mean of |deviation|, 5 % to 95 % of saturation           (62, 63)

Release 3.1 has no 1/4 under the root of the threshold, takes saturation at the largest variance,
and states the extreme deviations from linearity. Gain, responsivity, dark noise and dark current
are the same in both releases.
"""

import jax.numpy as jnp

from .. import emva1288
from ..emva1288 import Ranges, Sheet, Statistics, linearity_deviation
from ..levels import PhotonTransfer
from ..quantities import NEED_PHOTONS


def figures(stats: Statistics, measurement: PhotonTransfer, within: Ranges) -> Sheet:
    """Return the figures of release 4 Linear; those that the measurement cannot give are missing.

    Source:
        EMVA Standard 1288, release 4.0 Linear (2021).
    """
    found = emva1288.sheet(stats, measurement, within)
    gain = found["system_gain"]
    threshold = jnp.sqrt((found["temporal_dark_noise"] / gain) ** 2 + 0.25) + 0.5
    changed = {"threshold_electrons": threshold}
    if "quantum_efficiency" in found:
        changed["threshold_photons"] = threshold / (found["quantum_efficiency"] / 100)
    if "saturation_electrons" in found:
        dynamic_range = found["saturation_electrons"] / threshold
        changed |= {
            "dynamic_range": dynamic_range,
            "dynamic_range_db": 20 * jnp.log10(dynamic_range),
            "usable_bits": jnp.log2(dynamic_range),
        }
    signal = stats.bright_mean - stats.dark_mean[measurement.dark_of]
    off = linearity_deviation(measurement.bright.light, signal, within.linearity)
    count = jnp.sum(within.linearity, dtype=signal.dtype)
    changed["linearity_error"] = jnp.sum(
        jnp.where(within.linearity, jnp.abs(off), 0)
    ) / jnp.maximum(count, 1)
    for name in ("linearity_error_min", "linearity_error_max"):
        del found[name]
    if not measurement.photons_known:
        changed = {name: x for name, x in changed.items() if name not in NEED_PHOTONS}
    return found | changed
