"""The records of effects that change the charge of pixels before read-out.

The range of each number is checked when a record is made. `ValueError` names the field, the value
and the allowed range. Values that JAX traces are not checked.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..core._shown import Shown
from ..core._types import (
    FINITE,
    POSITIVE,
    Scalar,
    as_float,
    as_optional_float,
    check_fields,
    is_known,
)

_SUM_OFF = 1e-4  # largest deviation of a kernel's sum from 1


class SensorEffect(Shown):
    """Base class of effects on charge. `jaxvision.sensor.register` registers user-defined effects.

    Example:
        >>> class Leak(jv.SensorEffect):
        ...     share: float
        >>> isinstance(Leak(0.01), jv.SensorEffect)
        True
    """


class Mixing(SensorEffect):
    """Linear mixing of the signals of neighbouring pixels after electrons are counted.

    Because of capacitance between pixels, or an amplifier that settles slowly, a share of a pixel's
    signal appears in its neighbours. Unlike `Sensor.crosstalk`, mixing acts on counted electrons.
    Mixing therefore multiplies the variance of a pixel by sum(kernel^2), and correlates neighbours.

    Attributes:
        kernel: (rows, columns) no unit, both odd: the shares of the middle pixel's electrons that
            each pixel receives. The sum is 1.

    Example:
        >>> shares = [[0.0, 0.02, 0.0], [0.02, 0.92, 0.02], [0.0, 0.02, 0.0]]
        >>> sensor = jv.Sensor(mixing=jv.Mixing(shares))
        >>> spot = jnp.array([0.0, 100.0, 0.0]).reshape(1, 3, 1)
        >>> [round(float(x)) for x in jv.raw_image(None, sensor, spot).ravel()]  # border gives back
        [2, 96, 2]
    """

    kernel: Float[Array, "rows columns"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self, kernel=FINITE)
        if not all(size % 2 for size in self.kernel.shape):
            raise ValueError(
                "Mixing.kernel must have odd numbers of rows and columns, got shape "
                f"{self.kernel.shape}."
            )
        total = float(np.asarray(self.kernel).sum()) if is_known(self.kernel) else 1.0
        if abs(total - 1) > _SUM_OFF:
            raise ValueError(f"Mixing.kernel must sum to 1, got {total:g}; divide it by that.")


class Nonlinearity(SensorEffect):
    """Base class of curves that describe the nonlinearity of a pixel's signal.

    A curve maps the charge of a pixel, in electrons, to the charge that gives the same signal in a
    linear sensor with the same gain at 0. The curve is applied before read-out noise is added.

    Example:
        >>> isinstance(jv.Compression(0.05, electrons=1e4), jv.Nonlinearity)
        True
    """


class Compression(Nonlinearity):
    """A polynomial nonlinearity: a charge e gives the signal e (1 - first u - second u^2), where u
    = e / electrons.

    Below 0 and above `electrons` the curve continues as a straight line.

    Attributes:
        first: () relative loss of signal at `electrons`, no unit.
        second: () additional relative loss of the next order, no unit, or None.
        electrons: () e-, upper end of the polynomial's range, > 0.

    Example:
        >>> sensor = jv.Sensor(nonlinearity=jv.Compression(0.04, electrons=1e4))
        >>> jv.raw_image(None, sensor, jnp.array([5e3, 1e4, 2e4])).tolist()
        [4900.0, 9600.0, 18800.0]
    """

    first: Scalar = eqx.field(converter=as_float)
    second: Scalar | None = eqx.field(converter=as_optional_float, default=None)
    electrons: Scalar = eqx.field(converter=as_float, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, first=FINITE, second=FINITE, electrons=POSITIVE)
        if not is_known(self.first) or not is_known(self.second):
            return
        c1, c2 = float(self.first), 0.0 if self.second is None else float(self.second)
        turn = [-c1 / (3 * c2)] if c2 and 0 < -c1 / (3 * c2) < 1 else []  # extremum of the slope
        least = min(1 - 2 * c1 * u - 3 * c2 * u * u for u in (0.0, 1.0, *turn))
        if not least > 0:
            raise ValueError(
                "Compression must rise up to its electrons, got a slope of "
                f"{least:g} with first {c1:g} and second {c2:g}."
            )


class ResponseTable(Nonlinearity):
    """A nonlinearity given by the signal at some charges, with straight lines between and beyond
    these points.

    Attributes:
        electrons: (entries,) e-, ascending, at least two.
        signal: (entries,) e-, ascending: codes above the black level, divided by the gain.

    Example:
        >>> table = jv.ResponseTable(electrons=[0.0, 100.0, 200.0], signal=[0.0, 100.0, 180.0])
        >>> jv.raw_image(None, jv.Sensor(nonlinearity=table), jnp.array([50.0, 150.0])).tolist()
        [50.0, 140.0]
    """

    electrons: Float[Array, " entries"] = eqx.field(converter=as_float)
    signal: Float[Array, " entries"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        _check_ascending(self)


class ResponseSpline(Nonlinearity):
    """A nonlinearity given by the signal at some charges, with a smooth monotone curve between
    these points.

    The curve is the cubic Hermite spline that SciPy calls PCHIP. Beyond the ends the curve
    continues as a straight line.

    Attributes:
        electrons: (entries,) e-, ascending, at least two.
        signal: (entries,) e-, ascending: codes above the black level, divided by the gain.

    Example:
        >>> curve = jv.ResponseSpline(electrons=[0.0, 100.0, 200.0], signal=[0.0, 100.0, 180.0])
        >>> jv.raw_image(None, jv.Sensor(nonlinearity=curve), jnp.array([100.0])).tolist()
        [100.0]
    """

    electrons: Float[Array, " entries"] = eqx.field(converter=as_float)
    signal: Float[Array, " entries"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        _check_ascending(self)


def _check_ascending(curve: ResponseTable | ResponseSpline) -> None:
    check_fields(curve, electrons=FINITE, signal=FINITE)
    kind = type(curve).__name__
    if curve.electrons.shape[0] < 2:
        raise ValueError(f"{kind}.electrons must have at least two entries, got one.")
    for name in ("electrons", "signal"):
        values = getattr(curve, name)
        if is_known(values) and not (np.diff(values) > 0).all():
            raise ValueError(f"{kind}.{name} must ascend, got {np.asarray(values)}.")
