"""When a chi-square is beyond chance, and what it then does to a covariance (Birge 1932)."""

from scipy.special import chdtrc

MISFIT = 1e-3  # p-value below which a model is not believed


def p_value(chi_square: float, degrees: float) -> float:
    """How often chance alone gives a chi-square as large."""
    return float(chdtrc(max(degrees, 1), chi_square))


def inflation(chi_square: float, degrees: float) -> float:
    """Factor on a covariance for a misfit."""
    beyond = degrees > 0 and p_value(chi_square, degrees) < MISFIT
    return chi_square / degrees if beyond else 1.0
