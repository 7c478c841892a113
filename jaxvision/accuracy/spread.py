"""What a few runs say about the next one: bounds on the error of a run with another seed.

The mean square error of a run is taken for a multiple of a chi-square variable whose degrees of
freedom nu follow from the scatter of the runs (Satterthwaite: nu = 2 mean^2 / variance), so that
the next one over their mean follows Fisher's F with nu and k nu degrees. One number has nu = 1, a
picture of many pixels a large one. The bound is never below the largest error that was seen.

Source: Satterthwaite, "An Approximate Distribution of Estimates of Variance Components",
Biometrics Bulletin 2(6) (1946).
"""

import numpy as np

CHANCE = 0.025  # of a run above the upper bound, and of one below the lower


def next_error(errors: np.ndarray) -> tuple[float, float, float]:
    """Root mean square over runs of their errors (k,), and between what the error of the next one
    lies in 95 of 100 cases, in their unit. One run, or equal ones: no spread is known."""
    from scipy.special import fdtri

    squares = np.square(np.asarray(errors, np.float64))
    mean, count = float(np.mean(squares)), len(squares)
    typical = float(np.sqrt(mean))
    if count < 2 or not np.isfinite(mean) or np.ptp(squares) == 0:
        return typical, typical, typical
    scatter = float(np.var(squares, ddof=1))
    freedom = float(np.clip(2 * mean**2 / scatter * (count - 1) / (count + 1), 1, 1e6))
    low, high = np.sqrt(fdtri(freedom, count * freedom, [CHANCE, 1 - CHANCE]))
    seen = np.abs(errors)
    return (
        typical,
        min(float(typical * low), float(seen.min())),
        max(float(typical * high), float(seen.max())),
    )
