"""Sensor effects from outside: what each record of `Sensor.own` does to charge."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

from ..core._bounds import Ends
from ..core._types import Key, Scalars
from ..scene import SensorEffect

Bound = Callable[[Ends, float], tuple[float, float]]


class Stage(NamedTuple):
    """What an effect has registered; `register` describes the functions."""

    charge: Callable[[Key | None, Any, Scalars], Scalars]
    moments: Callable[[Any, Any], Any] | None
    bound: Bound | None


_STAGES: dict[type, Stage] = {}


def register(
    effect: type[SensorEffect],
    *,
    charge: Callable[[Key | None, Any, Scalars], Scalars],
    moments: Callable[[Any, Any], Any] | None = None,
    bound: Bound | None = None,
) -> None:
    """Makes an effect on charge known to sensors, and with it to camera files and `effects`.

    It acts on what the pixels hold, behind full wells and charge transfer and before anything is
    read. In camera files it is a table `[[sensor.own]]` with its name as `kind`.

    Args:
        effect: the class of the record.
        charge: `charge(key, effect, electrons)`, (..., h, w, bands) electrons; `key` is None where
            the frame has none.
        moments: `moments(effect, moments) -> Moments`, mean and variance of the charge of a pixel
            in even light; without it `expected_signal` and its kin refuse the sensor.
        bound: `bound(ends, electrons) -> (moved, grows)`, of the effect at both ends of what a fit
            may change: the root mean square of the electrons by which it moves any pixel, none of
            which holds more than `electrons` rms, and by how much it multiplies a change of charge
            at most, >= 1. Without it `effects` keeps all of the sensor before it.

    Example:
        >>> class Loss(jv.SensorEffect):
        ...     share: float
        >>> jv.sensor.register(Loss, charge=lambda key, loss, charge: (1 - loss.share) * charge)
        >>> jv.collect(None, jv.Sensor(own=(Loss(0.25),)), jnp.array([8.0])).tolist()
        [6.0]
    """
    _STAGES[effect] = Stage(charge, moments, bound)


def stage_of(effect: SensorEffect) -> Stage:
    """What an effect has registered.

    Args:
        effect: any registered effect.

    Returns:
        Its functions.

    Raises:
        ValueError: for one that was not registered.
    """
    kind = type(effect)
    if kind not in _STAGES:
        raise ValueError(
            f"{kind.__name__} is no known effect: call jaxvision.sensor.register for it first."
        )
    return _STAGES[kind]


def affected(key: Key | None, effects: tuple[SensorEffect, ...], electrons: Scalars) -> Scalars:
    """The electrons after all effects, each with a key of its own."""
    for i, effect in enumerate(effects):
        own = None if key is None else jax.random.fold_in(key, 0x0E00 + i)
        electrons = stage_of(effect).charge(own, effect, electrons)
    return electrons


def moments_after(effects: tuple[SensorEffect, ...], moments: Any) -> Any:
    """Mean and variance after all effects; `ValueError` for one that has registered none."""
    for effect in effects:
        own = stage_of(effect).moments
        if own is None:
            raise ValueError(
                f"{type(effect).__name__} was registered without moments; give them, or draw "
                "frames by raw_image."
            )
        moments = own(effect, moments)
    return moments
