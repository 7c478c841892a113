"""The records that the modules of effects exchange. A stage is one step of image formation: the
scene, the lens (optics), motion, the sensor or the development. The function of each stage returns
a `Row` for each of its effects.

Each function also returns bounds on light, which the function of the next stage needs.
All numbers are NumPy float64, computed outside `jit`.

    scene_stage(scene, view)                -> rows, Arriving     radiance.py
    optics_stage(view, arriving, ...)       -> rows, OnSensor     optics.py
    motion_stage(scene, view, motion, ...)  -> rows               motion.py
    sensor_stage(sensor, light, shape=...)  -> rows, Response     sensor.py
    development_stage(development)          -> rows               development.py

Scenes and cameras are given as `Ends`: two copies of a record, `low` with the free parameters at
their smallest values and `high` with the largest values. If no parameter is free, both copies are
the same record. A bound uses the copy for which the bound is larger: `high` for sizes, albedos,
radiances, gains and noises, and `low` for distances and full wells. A bound that does not depend
monotonically on a field must be inf if the field differs between the copies. The functions need not
know which effects are free, because `prune` never drops a free effect.

A bound must be valid whichever other effects were dropped before. So the bounds on light ignore
effects that only remove light, such as shadows, rims and full wells.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from ..core._bounds import Ends as Ends
from ..scene import AmbientLight, Camera, Light, Surface
from .certificate import RADIANCE, Effect

# Without optimisation a small picture compiles in half the time, and still runs in an instant.
FAST = {"xla_backend_optimization_level": "0", "xla_llvm_disable_expensive_passes": "True"}


@dataclass(frozen=True)
class Draft:
    """The scene and camera during pruning. Lights and surfaces keep their original indices."""

    surfaces: tuple[Surface, ...]  # all surfaces, including those in `unmet`
    lights: tuple[Light | None, ...]  # each light, or None where it was dropped
    shadowless: frozenset[int]  # numbers of the lights whose shadows were dropped
    ambient: AmbientLight | None
    camera: Camera  # view, sensor and development
    samples: Any = None  # `PixelSamples` or None
    motion: Any = None
    moments: int | None = None  # number of moments of a motion, or None
    depth: int | None = None  # segments of a path, or None: direct light
    bands: tuple[np.ndarray, np.ndarray] | None = None  # (kept bands, expand) or None
    unmet: frozenset[int] = frozenset()  # numbers of the surfaces that were dropped
    threshold: float | None = None  # W m^-2 sr^-1, as in `render`, before bands were dropped

    @property
    def present_surfaces(self) -> tuple[Surface, ...]:
        """The surfaces of the scene that were not dropped."""
        return tuple(own for i, own in enumerate(self.surfaces) if i not in self.unmet)


Drop = Callable[[Draft], Draft]
Gone = frozenset[str]


@dataclass(frozen=True)
class Row:
    """An effect, a bound on the change if it is dropped, and the function that drops it."""

    name: str  # as in `Effect`, like `why`, `place`, `rare` and `present`
    # the bound in `unit`, (bands,) before the sensor, else (): at least 0, inf for NaN
    amount: np.ndarray
    why: str
    # returns a draft without the effect, by `dataclasses.replace`, so that the checks of every
    # record run; None if the effect cannot be dropped
    drop: Drop | None
    unit: str = RADIANCE  # of `amount`: "W m^-2 sr^-1", "W m^-2" or "DN"
    place: float = 0.0
    rare: float = 0.0
    present: bool = True
    estimated: bool = False  # whether `amount` is sampled or tabulated instead of proved
    # if the bound depends on earlier drops: a function from the names of dropped effects to
    # `amount`; None if `amount` does not depend on them
    after: Callable[[Gone], float | np.ndarray] | None = None
    assumes: str = ""  # an assumption of the bound, one sentence; "" if there is none
    saves: float = 0.05  # share of the picture's computation that it takes, from a table
    # names of effects that must all be present when this one is dropped
    instead_of: frozenset[str] = field(default_factory=frozenset)
    # names of effects that must be dropped before, such as a rim before its lens
    needs: frozenset[str] = field(default_factory=frozenset)
    # name of the effect that it belongs to, such as the lamp for a lamp's extent: it is dropped
    # with that effect, at no further cost; "" if there is none
    part_of: str = ""
    # rows with the same word here are dropped together or not at all; "": on its own
    together: str = ""
    # rows with the same word here are a ladder, in order of rising cost: at most one is dropped,
    # the first that fits, after all ordinary rows; "": an ordinary row
    ladder: str = ""
    grows: float = 1.0  # factor by which it magnifies the changes of other effects, >= 1

    def __post_init__(self) -> None:
        amount = np.asarray(self.amount, float)
        amount = np.maximum(np.where(np.isnan(amount), np.inf, amount), 0)
        object.__setattr__(self, "amount", amount)

    @property
    def bound(self) -> float:
        """The largest `amount` of any band, in `unit`."""
        return float(np.max(self.amount))

    @property
    def effect(self) -> Effect:
        """The `Effect` that `inspect` lists for this row, with the bound in the row's `unit`."""
        exact = self.bound == 0 and self.place == 0
        rank = "estimate" if self.estimated else "exact" if exact else "bound"
        what = self.name, self.present, self.why, self.bound, self.place, self.unit, rank
        return Effect(*what, saves=self.saves, rare=self.rare)


def unproved(row: Row, why: str) -> Row:
    """Return a copy of a `Row` that `prune` never drops because of `why`: its bound is inf."""
    amount = row.amount + np.inf
    return replace(row, why=why, amount=amount, estimated=False, after=None)


def field_functions(record: type, functions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the functions whose names are fields of a record type, in the order of the fields."""
    names = (field.name for field in fields(record))
    return {name: functions[name] for name in names if name in functions}


class Method(NamedTuple):
    """The arguments of `inspect` that describe how a picture is rendered."""

    whole: bool = True  # whether a sensor and a development follow the lens
    depth: int | None = None
    samples: Any = None
    motion: Any = None
    moments: int = 1
    estimates: bool = False
    whole_paths: bool = False
    caustics: bool = False


class Arriving(NamedTuple):
    """Bounds on the light from the scene to the camera. `radiance`, (bands,) W m^-2 sr^-1, is the
    supremum of the picture, or inf if there is no bound. `near` and `far`, in m along the camera's
    axis, are the smallest and largest depth that may be in view; `far` is inf for an infinite
    plane. `turning`, (bands,) W m^-2 sr^-1, is the largest difference between the radiances that a
    point sends to two points of the lens."""

    radiance: np.ndarray
    near: float
    far: float
    turning: np.ndarray


class OnSensor(NamedTuple):
    """Bounds on the light behind the lens. `irradiance`, (bands,) W m^-2, is the supremum over all
    pixels. `opening`, in W m^-2 per W m^-2 sr^-1, is the largest gain of any pixel if all parts
    that remove light are dropped."""

    irradiance: np.ndarray
    opening: float


class Response(NamedTuple):
    """The response of the sensor to a change of the light. `dn` takes a change of irradiance in any
    pixel, (bands,) W m^-2, and the names of the dropped effects. It returns the largest change of a
    pixel's distribution, in DN. `dn` needs the names because a change of the shot noise has a
    larger effect if there is less other noise. `dark` is the rms of all noise in the dark, in DN;
    the unit "sigma" means multiples of `dark`."""

    dn: Callable[[np.ndarray, Gone], float]
    dark: float
