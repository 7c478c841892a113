"""Records and helper functions for bounds on light. Each type of light defines a bound on the light
that a lamp sends. Each type of material defines bounds on its shading.

A bound is computed outside `jit` in NumPy float64. The argument of a bound is `Ends`: two copies of
a record, with the free parameters at their smallest and at their largest values. For each field, a
bound uses the copy that makes it larger.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from itertools import product
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from jax.tree_util import register_dataclass

T = TypeVar("T")

SIGNS = np.array([*product((-1.0, 1.0), repeat=3)])


@register_dataclass
@dataclass(frozen=True, eq=False)
class Ends(Generic[T]):
    """Two copies of a record, with the free parameters at their smallest and at their largest
    values. The copies are equal if no parameter is free.

    Attributes:
        low: the record with the smallest value of each free parameter.
        high: the record with the largest value of each free parameter.
    """

    low: T
    high: T

    def __iter__(self) -> Iterator[T]:
        return iter((self.low, self.high))

    def field(self, name: str) -> "Ends[Any]":
        """Return one field of both copies, as `Ends`. Repeated calls return the same object."""
        key = f"of {name}"
        if key not in self.__dict__:
            self.__dict__[key] = Ends(getattr(self.low, name), getattr(self.high, name))
        return self.__dict__[key]


def cached(function: Callable[[Ends[Any]], T]) -> Callable[[Ends[Any]], T]:
    """Decorate a function of `Ends` so that its result is computed once and stored in the
    argument."""

    @wraps(function)
    def look_up(ends: Ends[Any]) -> T:
        if function.__name__ not in ends.__dict__:
            ends.__dict__[function.__name__] = function(ends)
        return ends.__dict__[function.__name__]

    return look_up


def numbers(x: object) -> np.ndarray:
    """Convert the values of a field to a float64 array."""
    return np.asarray(x, np.float64)


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the corners, (8 n, 3) in m, of the boxes from `low` to `high`, (n, 3) each. If `low`
    and `high` are equal, return the points `low` themselves."""
    if np.array_equal(low, high):
        return np.atleast_2d(low)
    middle, half = (low + high) / 2, np.abs(high - low) / 2
    return (np.atleast_2d(middle)[:, None] + SIGNS * np.atleast_2d(half)[:, None]).reshape(-1, 3)


def unit(v: np.ndarray) -> np.ndarray:
    """Scale vectors (..., 3) to length 1; zero vectors stay 0."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle between unit vectors, rad."""
    chord = np.linalg.norm(a - b, axis=-1)
    return 2 * np.arcsin(np.minimum(chord / 2, 1))


class Angles(NamedTuple):
    """Bounds on the angles of light and viewer at c surface cells, for s light positions, from
    which a specular lobe is bounded. Shapes are (c, s) unless stated otherwise.

    Attributes:
        off_mirror: rad, the smallest angle between the mirrored light direction and the viewer.
        cos_half: the largest cosine between the normal and the half vector.
        cos_between: the smallest cosine between the viewer and the half vector.
        cos_i: the largest cosine of incidence.
        cos_o: (c, 1), the smallest cosine of the viewing angle.
        cos_o_most: (c, 1), the largest cosine of the viewing angle.
    """

    off_mirror: np.ndarray
    cos_half: np.ndarray
    cos_between: np.ndarray
    cos_i: np.ndarray
    cos_o: np.ndarray
    cos_o_most: np.ndarray


class Lobe(NamedTuple):
    """Bounds on the specular lobe of a material.

    Attributes:
        spectrum: (bands,) or (1,), the specular reflectance k_s.
        most: function from angles to the largest f_r cos / k_s, (c, s) in sr^-1.
        size: the largest integral of f_r cos / k_s over all light directions, no unit.
        slope: sr^-1 rad^-1, the largest derivative of f_r cos / k_s with respect to the light
            direction above the horizon; None if unknown.
        neutral: whether the shape of the lobe is the same for all bands.
        step: whether the lobe jumps to 0 at the horizon instead of falling like the cosine.
    """

    spectrum: np.ndarray
    most: Callable[[Angles], np.ndarray]
    size: float
    slope: float | None
    neutral: bool
    step: bool

    @property
    def gain(self) -> float:
        """The largest value of f_r cos / k_s, divided by the mean of f_r cos / k_s over the
        hemisphere. A small solid angle w contains at most the share gain w / (2 pi) of the lobe.
        The gain has no unit."""
        one = np.ones((1, 1))
        peak = self.most(Angles(0 * one, one, 0 * one, one, 0 * one, one))
        return 2 * np.pi * float(peak.max()) / self.size if self.size > 0 else np.inf


def power_of(cosines: np.ndarray, n: float) -> np.ndarray:
    """Return max(cos, 0)^n; for n = 0 the result is 1 at every angle."""
    return np.where(cosines > 0, np.maximum(cosines, 1e-300) ** n, 0 if n > 0 else 1)


class Reflection(NamedTuple):
    """Upper bounds on the shading of one material.

    Attributes:
        body: (bands,) sr^-1, upper bound on f_r of the diffuse part.
        lobe: bounds on the specular lobe, or None.
        plain: (bands,) sr^-1, the largest difference between the diffuse part (without its share
            `grazing`) and a Lambertian BRDF of the same k_d; 0 for a Lambertian surface.
        mirror: (bands,) or (1,), reflectance of a mirror; None for other materials.
        why: the reason why there is no bound, in which case `body` is inf; "" if there is a bound.
        grazing: share of the diffuse part for which `body` bounds f_r cos(theta_i) instead of f_r,
            because this share does not vanish toward the horizon.
        rough: the field whose removal makes the diffuse part Lambertian, and the name of this
            simplification; or None.
        facets: for a lobe with an interface, the smallest reflectance over bands and angles, and
            the lobe of facets with reflectance 1; or None.
        indices: the smallest and the largest refractive index of a transparent body, or None.
        angular: whether the angular dependence of the diffuse part differs between bands.
    """

    body: np.ndarray
    lobe: Lobe | None = None
    plain: np.ndarray | float = 0.0
    mirror: np.ndarray | None = None
    why: str = ""
    grazing: float = 0.0
    rough: tuple[str, str] | None = None
    facets: tuple[float, Lobe] | None = None
    indices: tuple[float, float] | None = None
    angular: bool = False


def peak(x: Any, name: str) -> np.ndarray:
    """Return the largest magnitude of a spectrum at both ends, for each band."""
    return np.maximum(*(np.abs(numbers(getattr(end, name))) for end in x))


def cone(light: Ends[Any]) -> tuple[np.ndarray, float]:
    """Return the middle, (1, 3) unit, of a light's directions, and the largest angle to it, rad."""
    low, high = numbers(light.low.direction), numbers(light.high.direction)
    points = unit(box_corners(low, high))
    middle = unit(points.mean(0))
    width = float(angle(points, middle).max()) if len(points) > 1 else 0.0
    if width >= np.pi / 2 or (len(points) > 1 and np.all(low * high <= 0)):
        width = np.pi
    return middle[None], width


def least(x: Any, name: str) -> float:
    return min(float(numbers(getattr(end, name)).min()) for end in x)


def most(x: Any, name: str) -> float:
    return max(float(numbers(getattr(end, name)).max()) for end in x)


class Source(NamedTuple):
    """The properties of one light from which the irradiance by this light is bounded.

    Attributes:
        spectrum: (bands,) largest intensity W sr^-1, irradiance W m^-2 or radiance W m^-2 sr^-1.
        places: (s, 3) m, or unit directions for a light at infinity; a "sky" has none, or the
            middle of the cone from which all its light comes.
        size: (s,) radius of each place, m; rad for directions.
        weight: (s,) m^2 of area, 1 for a light of intensity or irradiance.
        normal: (3,) unit, for a light that shines to one side; None for all directions.
        body: points, (p, 3) m, and radii, (p,) m, of spheres that contain the light; None for a
            light at infinity.
        kind: "place", "area", "direction" or "sky".
        even: whether the radiance of the light is the same in all directions.
        small: for a flat lamp both edges, (3,) m each, and a light without size at its centre that
            has the same flux.
        share: largest flux of a sky divided by 2 pi times `spectrum`, no unit.
        why: the reason why there is no bound; "" if there is one.
    """

    spectrum: np.ndarray
    places: np.ndarray
    size: np.ndarray
    weight: np.ndarray
    normal: np.ndarray | None
    body: tuple[np.ndarray, np.ndarray] | None
    kind: str
    share: float = 1.0
    why: str = ""
    even: bool = False
    small: tuple[np.ndarray, np.ndarray, Any] | None = None

    @property
    def extended(self) -> bool:
        """Whether the light has a radiance, so that a ray can hit it: an area light or a sky."""
        return self.kind in ("area", "sky")
