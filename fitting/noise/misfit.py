"""The significance of a chi-square, and Birge's factor (1932) on the covariance."""

from scipy.special import chdtrc

MISFIT = 1e-3  # p-value below which a model is rejected


def p_value(chi_square: float, degrees: float) -> float:
    """The probability that chance gives a chi-square at least as large."""
    return float(chdtrc(max(degrees, 1), chi_square))


def inflation(chi_square: float, degrees: float) -> float:
    """Factor on a covariance for a misfit."""
    beyond = degrees > 0 and p_value(chi_square, degrees) < MISFIT
    return chi_square / degrees if beyond else 1.0
