"""The table of lights: what each kind can say about itself.

A light at one place only (a point, a direction) registers `incident`. An extended one registers
how it looks along a ray and maps of the unit square onto its directions.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import numpy as np

from .._types import Colour, Scalar
from .._vector import Vector
from ..scene import Light
from ._nodes import square_nodes


class Incident(eqx.Module):
    """`direction`: (3,) unit, from the point toward the light. `irradiance`: (bands,) W m^-2 on a
    surface facing it; the receiver applies its own cosine. `distance`: () m to the light, or None:
    it is infinitely far."""

    direction: Vector
    irradiance: Colour
    distance: Scalar | None = None


class Seen(eqx.Module):
    """`distance`: () m along the ray to the light, inf where it is infinitely far or missed.
    `radiance`: (bands,) W m^-2 sr^-1 against the ray, 0 where missed; () where nothing shines."""

    distance: Scalar
    radiance: Colour | Scalar


class Discrete(NamedTuple):
    """`incident(light, point) -> Incident`."""

    incident: Callable[..., Incident]


class Extended(NamedTuple):
    """`seen(light, ray) -> Seen`. `sample(light, point, u) -> Incident`: a map of the unit square
    whose irradiance is per unit of the square's area, so that its mean over the square is the
    light's. `pdf(light, point, wi) -> ()`: the density of its directions in sr^-1. `node`, `nodes`:
    the map, smooth in u, and the static (n, 2) nodes and (n,) weights of an order, for
    quadrature."""

    seen: Callable[..., Seen]
    sample: Callable[..., Incident]
    pdf: Callable[..., Scalar]
    node: Callable[..., Incident]
    nodes: Callable[[int], tuple[np.ndarray, np.ndarray]]


_KINDS: dict[type, Discrete | Extended] = {}


def register(light: type[Light], *, incident: Callable[..., Incident]) -> None:
    """Enters a kind of light that reaches a point from one direction."""
    _KINDS[light] = Discrete(incident)


def register_extended(
    light: type[Light],
    *,
    seen: Callable[..., Seen],
    sample: Callable[..., Incident],
    pdf: Callable[..., Scalar],
    node: Callable[..., Incident] | None = None,
    nodes: Callable[[int], tuple[np.ndarray, np.ndarray]] = square_nodes,
) -> None:
    """Enters a kind of light that reaches a point from many directions; see `Extended`. Without
    `node` the map that samples also serves quadrature."""
    _KINDS[light] = Extended(seen, sample, pdf, sample if node is None else node, nodes)


def kind_of(light: Light) -> Discrete | Extended:
    """What a light has registered, else `ValueError`."""
    kind = _KINDS.get(type(light))
    if kind is None:
        known = ", ".join(sorted(known.__name__ for known in _KINDS))
        raise ValueError(f"a light must be one of {known} or registered, got {type(light)}.")
    return kind


def can_be_seen(light: Light) -> bool:
    """Whether a ray can meet the light: points and directions have no size."""
    return isinstance(kind_of(light), Extended)


def extended_kind(light: Light) -> Extended:
    """What an extended light has registered; `ValueError` for one at one place."""
    kind = kind_of(light)
    if isinstance(kind, Discrete):
        raise ValueError(f"an extended light is needed, got {type(light).__name__}.")
    return kind
