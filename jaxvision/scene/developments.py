"""What turns raw numbers into a picture."""

import equinox as eqx

from .._types import Scalar, as_float, as_optional_float, check_shape


class Gamma(eqx.Module):
    """Encoding by x ** (1 / gamma). `gamma`: () > 0, no unit."""

    gamma: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Gamma.gamma", self.gamma, ())


class SRGB(eqx.Module):
    """The piecewise sRGB encoding of IEC 61966-2-1."""


class Development(eqx.Module):
    """From raw to picture. `None` leaves a step out.

    `black_level`: () DN subtracted. `white_level`: () DN that becomes 1; None keeps DN.
    `tone`: `Gamma(2.2)` or `SRGB()`, applied to the scaled values.
    """

    black_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    white_level: Scalar | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)
    tone: Gamma | SRGB | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_shape("Development.black_level", self.black_level, ())
        check_shape("Development.white_level", self.white_level, ())
