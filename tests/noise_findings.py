"""Single findings of the noise calibration."""

from fitting.noise.findings import FINDINGS
from fitting.report.sentences import evaluate_findings


def told(calibration, *keys):
    """Return the sentences of these keys."""
    return evaluate_findings([one for one in FINDINGS if one.key in keys], calibration)
