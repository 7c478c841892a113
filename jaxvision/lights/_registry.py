"""The registry of lights: the functions of each class of light.

A light without size (a point or a direction) registers `incident`. An extended light registers
`seen`, its radiance along a ray, and `sample`, a map from the unit square to directions.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ..core._bounds import Ends, Source
from ..core._kinds import Table, table_for
from ..core._shown import Shown
from ..core._types import Colour, Scalar
from ..core._vector import Direction, Vec
from ..geometry import Ray
from ..scene import Light
from ._nodes import square_nodes


class Incident(Shown):
    """The light that arrives at a point from one direction.

    Attributes:
        direction: (3,) unit, from the point toward the light.
        irradiance: (bands,) W m^-2 on a surface that faces the light; the cosine of incidence is
            applied by the receiver.
        distance: () m to the light, or None for a light at infinity.
        density: () sr^-1, sampling density of the direction, 0 where there is no light; None if it
            was not computed.

    Example:
        >>> arriving = jv.incident(jv.PointLight([3, 0, 4], [25.0]), jnp.zeros(3))
        >>> [round(float(x), 4) for x in arriving.direction]
        [0.6, 0.0, 0.8]
        >>> round(float(arriving.distance), 4), round(float(arriving.irradiance[0]), 4)  # 25 / 5^2
        (5.0, 1.0)
    """

    direction: Direction
    irradiance: Colour
    distance: Scalar | None = None
    density: Scalar | None = None


class Seen(Shown):
    """The radiance of an extended light along a ray, and the distance to the light.

    Attributes:
        distance: () m along the ray to the light; inf for a light at infinity or a miss.
        radiance: (bands,) W m^-2 sr^-1 against the ray, 0 for a miss; () if there is no light.
    """

    distance: Scalar
    radiance: Colour | Scalar


class Emitted(Shown):
    """A ray that leaves a light, with its flux.

    Attributes:
        ray: the ray, away from the light; its origin in m.
        flux: (bands,) W of the ray.
        normal: unit normal of the emitting surface; the zero vector if there is no surface.
    """

    ray: Ray
    flux: Colour
    normal: Vec


Bound = Callable[[Ends], Source]


class Discrete(NamedTuple):
    """The registered functions of a light without size, which `register` describes."""

    incident: Callable[..., Incident]
    emitted: Callable[..., Emitted] | None
    bound: Bound | None
    table: Table | None


class Extended(NamedTuple):
    """The registered functions of an extended light, which `register_extended` describes."""

    seen: Callable[..., Seen]
    sample: Callable[..., Incident]
    pdf: Callable[..., Scalar]
    node: Callable[..., Incident]
    nodes: Callable[[int], tuple[np.ndarray, np.ndarray]]
    emitted: Callable[..., Emitted] | None
    bound: Bound | None
    table: Table | None


_KINDS: dict[type, Discrete | Extended] = {}


def kinds() -> Mapping[type, Discrete | Extended]:
    """Return all registered lights, including those of the library.

    Returns:
        The registered functions of each record.
    """
    room = import_module(__package__ or "")
    for name in dir(room):
        getattr(room, name)
    return _KINDS


def register(
    light: type[Light],
    *,
    incident: Callable[..., Incident],
    emitted: Callable[..., Emitted] | None = None,
    bound: Bound | None = None,
    word: str | None = None,
    from_file: Callable[..., Any] | None = None,
) -> None:
    """Register a class of lights that reach a point from one direction, for use in all integrators.

    Args:
        light: the class of the light.
        incident: `incident(light, point) -> Incident`; at the position of the light the distance is
            0.
        emitted: `emitted(light, u) -> Emitted`, for light tracing: a ray from the light for `u`,
            (4,) uniform in [0, 1); the mean over `u` must be the emission of the light. If omitted,
            a light at a finite distance emits rays uniformly in all directions, with the flux that
            `incident` implies, and a light at infinity emits parallel rays through the whole scene.
        bound: `bound(ends) -> effects.Source`, an upper bound on the emission. `ends` contains the
            light twice, with its free parameters at their smallest and at their largest values.
            Without `bound`, `effects` drops nothing that depends on the light.
        word: the name of the `kind` in scene files. None takes the name of the class in snake case,
            without "Light"; "" excludes the light from scene files.
        from_file: function that makes the light from the keys of a file, if the keys are not the
            fields of the light. The names, defaults and docstring of its parameters define the
            keys; `**fields` takes all other fields of the light.
    """
    _KINDS[light] = Discrete(incident, emitted, bound, table_for(light, word, from_file))


def register_extended(
    light: type[Light],
    *,
    seen: Callable[..., Seen],
    sample: Callable[..., Incident],
    pdf: Callable[..., Scalar],
    node: Callable[..., Incident] | None = None,
    nodes: Callable[[int], tuple[np.ndarray, np.ndarray]] = square_nodes,
    emitted: Callable[..., Emitted] | None = None,
    bound: Bound | None = None,
    word: str | None = None,
    from_file: Callable[..., Any] | None = None,
) -> None:
    """Register a class of lights that reach a point from many directions, for use in all
    integrators.

    Args:
        light: the class of the light.
        seen: `seen(light, ray) -> Seen`.
        sample: `sample(light, point, u) -> Incident`, a map of the unit square, `u` (2,), onto
            directions toward the light. The irradiance of a sample is radiance divided by density,
            so that the mean over the square is the irradiance of the light.
        pdf: `pdf(light, point, wi)`, () in sr^-1, the density of the directions of `sample`.
        node: a map like `sample`, but smooth in `u`, for quadrature; by default `sample` itself.
        nodes: function from an order of quadrature to static nodes, (n, 2), and weights, (n,).
        emitted: as in `register`. If omitted, a light at a finite distance cannot be used in light
            tracing.
        bound, word, from_file: as in `register`.
    """
    smooth = sample if node is None else node
    table = table_for(light, word, from_file)
    _KINDS[light] = Extended(seen, sample, pdf, smooth, nodes, emitted, bound, table)


def kind_of(light: Light) -> Discrete | Extended:
    """Return the registered functions of a light.

    Args:
        light: any registered light.

    Returns:
        Its functions.

    Raises:
        ValueError: for an unknown light.
    """
    kind = _KINDS.get(type(light))
    if kind is None:
        known = ", ".join(sorted(known.__name__ for known in _KINDS))
        raise ValueError(f"a light must be one of {known} or registered, got {type(light)}.")
    return kind


def can_be_seen(light: Light) -> bool:
    """Return whether a ray can hit a light, which it cannot if the light has no size (a point or a
    direction).

    Args:
        light: any registered light.

    Returns:
        Whether a ray can hit the light, a Python bool, no unit.

    Example:
        >>> print(jv.lights.can_be_seen(jv.PointLight([0, 0, 2], [8.0])))
        False
    """
    return isinstance(kind_of(light), Extended)


def extended_kind(light: Light) -> Extended:
    """Return the registered functions of an extended light. Raise `ValueError` for a light without
    size."""
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        raise ValueError(f"an extended light is needed, got {type(light).__name__}.")
    return kind
