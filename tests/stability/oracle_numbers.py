"""Numbers for oracles: with 64 binary digits, with 60 decimal digits, or plain float64.

An oracle is written once, as `oracle(m, *arguments)` over arrays, from the definition and
independent of the library, where `m` is `LONG`, `DIGITS` or `DOUBLE`. `LONG` is for long sweeps (it
needs a machine whose long double has 64 binary digits), `DIGITS` for hard cases and the worst
points of a sweep, and `DOUBLE` for sweeps over every float32. A constant is `m.c("0.055")`, never
0.055."""

from fractions import Fraction

import mpmath
import numpy as np

MP = mpmath.MPContext()
MP.dps = 60


NAMES = ("abs", "arccos", "arctan", "arctan2", "cbrt", "cos", "exp", "expm1", "floor", "hypot")
NAMES += ("log", "log1p", "maximum", "minimum", "power", "sin", "sqrt", "tan", "where")


class Floats:
    """Arrays of one of NumPy's floating-point types."""

    def __init__(self, dtype):
        self.dtype = dtype
        self.pi = dtype("3.14159265358979323846264338327950288420")
        for name in NAMES:
            setattr(self, name, getattr(np, name))

    def c(self, text):
        """Return the number given as a decimal text or a fraction."""
        return (
            self.dtype(text.numerator) / self.dtype(text.denominator)
            if isinstance(text, Fraction)
            else self.dtype(text)
        )

    def array(self, x):
        return np.asarray(x).astype(self.dtype)


def _each(function):
    return np.frompyfunc(function, function.__code__.co_argcount, 1)


class Digits:
    """Object arrays of numbers with 60 decimal digits."""

    pi = +MP.pi
    floor = staticmethod(_each(lambda x: MP.floor(x)))
    exp = staticmethod(_each(lambda x: MP.exp(x)))
    log = staticmethod(_each(lambda x: MP.log(x)))
    log1p = staticmethod(_each(lambda x: MP.log1p(x)))
    expm1 = staticmethod(_each(lambda x: MP.expm1(x)))
    sqrt = staticmethod(_each(lambda x: MP.sqrt(x)))
    cbrt = staticmethod(_each(lambda x: MP.cbrt(x) if x >= 0 else -MP.cbrt(-x)))
    sin = staticmethod(_each(lambda x: MP.sin(x)))
    cos = staticmethod(_each(lambda x: MP.cos(x)))
    tan = staticmethod(_each(lambda x: MP.tan(x)))
    arctan = staticmethod(_each(lambda x: MP.atan(x)))
    arctan2 = staticmethod(_each(lambda y, x: MP.atan2(y, x)))
    arccos = staticmethod(_each(lambda x: MP.acos(x)))
    hypot = staticmethod(_each(lambda x, y: MP.hypot(x, y)))
    power = staticmethod(_each(lambda x, y: MP.power(x, y)))
    abs = staticmethod(np.abs)
    where = staticmethod(np.where)
    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)

    @staticmethod
    def c(text):
        """Return the number given as a decimal text or a fraction."""
        if isinstance(text, Fraction):
            return MP.mpf(text.numerator) / text.denominator
        return MP.mpf(text)

    @staticmethod
    def array(x):
        x = np.asarray(x)
        out = np.empty(x.shape, object)
        out.ravel()[:] = [MP.mpf(float(v)) for v in x.ravel()]
        return out


LONG, DOUBLE, DIGITS = Floats(np.longdouble), Floats(np.float64), Digits()


def special(function):
    """Return a function of mpmath for arrays of `DIGITS`, as in `special(lambda x: MP.erfc(x))`."""
    return _each(function)
