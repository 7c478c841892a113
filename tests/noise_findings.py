"""Single findings of the noise calibration."""

from fitting.noise.findings import FINDINGS
from fitting.report.sentences import said


def told(calibration, *keys):
    """The sentences of these keys."""
    return said([one for one in FINDINGS if one.key in keys], calibration)
