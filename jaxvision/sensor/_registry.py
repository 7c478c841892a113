"""The registry of sensor effects on charge: the functions for the records in `Sensor.own`,
`Sensor.mixing` and `Sensor.nonlinearity`."""

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..core._bounds import Ends
from ..core._types import Key, Scalars
from ..scene import Sensor, SensorEffect

Bound = Callable[[Ends, float], tuple[float, float]]
Curve = Callable[[Any, Scalars], Scalars]


class Stage(NamedTuple):
    """The registered functions of an effect on charge, which `register` and `register_curve`
    describe."""

    charge: Callable[[Key | None, Any, Scalars], Scalars]
    moments: Callable[[Any, Any], Any] | None
    bound: Bound | None
    curve: Curve | None = None
    inverse: Curve | None = None


_STAGES: dict[type, Stage] = {}


def register(
    effect: type[SensorEffect],
    *,
    charge: Callable[[Key | None, Any, Scalars], Scalars],
    moments: Callable[[Any, Any], Any] | None = None,
    bound: Bound | None = None,
) -> None:
    """Register an effect on charge, for use in sensors, camera files and `effects`.

    The effect acts on the charge of pixels after full wells and charge transfer, and before the
    read-out. In camera files the effect is a table `[[sensor.own]]` with its name as `kind`.

    Args:
        effect: the class of the record.
        charge: `charge(key, effect, electrons)`, (..., h, w, bands) electrons; `key` is None if no
            random key is passed.
        moments: `moments(effect, moments) -> Moments`, mean and variance of the charge of a pixel
            in uniform light; without it `expected_signal` and related functions reject the sensor.
        bound: `bound(ends, electrons) -> (moved, grows)`, for the effect at both ends of the range
            of a fit. `moved` is the largest RMS change of a pixel's electrons, if no pixel contains
            more than `electrons` RMS. `grows` is the largest factor by which the effect multiplies
            charge, or a change of charge, >= 1. Without `bound`, `effects` neglects no effect of
            the sensor that acts before this one.

    Example:
        >>> class Loss(jv.SensorEffect):
        ...     share: float
        >>> jv.sensor.register(Loss, charge=lambda key, loss, charge: (1 - loss.share) * charge)
        >>> jv.collect(None, jv.Sensor(own=(Loss(0.25),)), jnp.array([8.0])).tolist()
        [6.0]
    """
    _STAGES[effect] = Stage(charge, moments, bound)


def register_curve(
    effect: type[SensorEffect],
    *,
    curve: Curve,
    slopes: Callable[[Ends], tuple[float, float]] | None = None,
    inverse: Curve | None = None,
) -> None:
    """Register an effect that acts on each pixel separately, without random draws: a
    `Nonlinearity`.

    The moments after the effect follow from the derivatives of the curve. The mean is accurate to
    second order in the noise, and the variance to first order.

    Args:
        effect: the class of the record.
        curve: `curve(effect, electrons) -> electrons`, elementwise, with the value 0 at 0.
        slopes: `slopes(ends) -> (least, most)`, smallest and largest slope of the curve at any
            charge, over the whole range of a fit; without it `effects` neglects no effect of the
            sensor that acts before this one.
        inverse: `inverse(effect, signal) -> electrons`; without it `correct` rejects the sensor.

    Example:
        >>> class Square(jv.Nonlinearity):
        ...     share: float
        >>> jv.sensor.register_curve(Square, curve=lambda own, x: x * (1 - own.share * x))
        >>> sensor = jv.Sensor(nonlinearity=Square(1e-3), shot_noise=jv.PoissonShotNoise())
        >>> round(float(jv.signal_variance(sensor, jnp.array([100.0]))[0]), 3)  # 0.8^2 x 100
        64.0
    """

    def bound(ends: Ends, electrons: float) -> tuple[float, float]:
        assert slopes is not None
        least, most = slopes(ends)
        return max(1 - least, most - 1) * electrons, max(most, 1.0)

    _STAGES[effect] = Stage(
        lambda key, own, electrons: curve(own, electrons),
        lambda own, moments: _moments_after_curve(lambda x: curve(own, x), moments),
        None if slopes is None else bound,
        curve,
        inverse,
    )


def _moments_after_curve(curve: Callable[[Scalars], Scalars], moments: Any) -> Any:
    """Return the moments after a curve g: the mean g + g'' v / 2 and the variance g'^2 v, where v
    is the variance before the curve."""
    mean, one = moments.mean, jnp.ones_like(moments.mean)

    def slope(x: Scalars) -> Scalars:
        return jax.jvp(curve, (x,), (one,))[1]

    first, second = jax.jvp(slope, (mean,), (one,))
    return moments._replace(
        mean=curve(mean) + second * moments.variance / 2, variance=first**2 * moments.variance
    )


def stage_of(effect: SensorEffect) -> Stage:
    """Return the registered functions of an effect on charge.

    Args:
        effect: any registered effect.

    Returns:
        Its functions.

    Raises:
        ValueError: for an effect that is not registered.
    """
    kind = type(effect)
    if kind not in _STAGES:
        for name in ("mixing", "nonlinearity"):  # the effects of the library register themselves
            import_module(f"{__package__}.{name}")
    if kind not in _STAGES:
        raise ValueError(
            f"{kind.__name__} is no known effect: call jaxvision.sensor.register for it first."
        )
    return _STAGES[kind]


def charge_effects(sensor: Sensor) -> tuple[SensorEffect, ...]:
    """Return all effects on charge of a sensor, in the order in which they act."""
    last = (sensor.mixing, sensor.nonlinearity)
    return (*(sensor.own or ()), *(effect for effect in last if effect is not None))


def affected(key: Key | None, effects: tuple[SensorEffect, ...], electrons: Scalars) -> Scalars:
    """Return the electrons after all effects on charge, each of which draws with a different random
    key."""
    for i, effect in enumerate(effects):
        own = None if key is None else jax.random.fold_in(key, 0x0E00 + i)
        electrons = stage_of(effect).charge(own, effect, electrons)
    return electrons


def moments_after(effects: tuple[SensorEffect, ...], moments: Any) -> Any:
    """Return mean and variance of the charge after all effects. Raise `ValueError` for an effect
    without registered moments."""
    for effect in effects:
        own = stage_of(effect).moments
        if own is None:
            raise ValueError(
                f"{type(effect).__name__} was registered without moments; give them, or draw "
                "frames by raw_image."
            )
        moments = own(effect, moments)
    return moments
