"""Parameters, priors and likelihoods, searches and samplers, estimates with intervals: statistics
that know no physics and no calibration."""
