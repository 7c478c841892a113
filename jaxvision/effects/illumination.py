"""How much light reaches each cell at most.

A light is a few places, each a ball with an intensity: a point is one, a rectangle is cut into
pieces. E, the irradiance of a facing surface, is at most I cos(theta) / d^2 of each, with d a lower
bound of the distance and the cosines at their largest; of a light of radiance L no more than pi L
arrives with the receiver's cosine, and no more than 2 pi L without. Without spectra: E is per unit
of the light's own `spectrum`. Lengths in m.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ..lights.directional import DirectionalLight
from ..lights.environment import EnvironmentMap
from ..lights.light_field import LightFieldLight
from ..lights.point import PointLight
from ..lights.rectangle import RectangleLight
from ..lights.small import SmallLight
from ..scene import Light
from .angles import Angles, angle, cosine, half_width, lobe_angles
from .bodies import box_about, numbers, unit
from .cells import Cells, Eye
from .reflection import Lobe
from .stages import Ends

_PIECES = 5  # along each side of a rectangle


class Source(NamedTuple):
    """One light as what a bound needs to know of it.

    Attributes:
        spectrum: (bands,) intensity W sr^-1, irradiance W m^-2 or radiance W m^-2 sr^-1, the
            largest.
        places: (s, 3) m, or unit directions of a light that is infinitely far away.
        size: (s,) m, the radius of each; rad for directions.
        weight: (s,) m^2 of area, 1 for a light of intensity or irradiance.
        normal: (3,) unit, of a light that shines to one side; None: to all.
        body: points, (p, 3) m, and radii, (p,) m, that hold the light; None: infinitely far away.
        kind: "place", "area", "direction" or "sky".
        share: of 2 pi times `spectrum`, what a sky sends at most, no unit.
        why: "" or why there is no bound.
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

    @property
    def extended(self) -> bool:
        """Whether it has a radiance, and a ray may meet it."""
        return self.kind in ("area", "sky")


def _peak(light: Ends[Any], name: str) -> np.ndarray:
    both = np.maximum(*(np.abs(numbers(getattr(end, name))) for end in light))
    return both.reshape(-1, both.shape[-1]).max(0)


def _at_one_place(light: Ends[Any]) -> Source:
    points = box_about(numbers(light.low.position), numbers(light.high.position))
    middle = points.mean(0)
    size = np.linalg.norm(points - middle, axis=1).max()
    normal = None
    if isinstance(light.low, SmallLight) and np.array_equal(light.low.normal, light.high.normal):
        normal = unit(numbers(light.low.normal))
    body = points, np.zeros(len(points))
    own = np.array([1.0])
    return Source(_peak(light, "intensity"), middle[None], own * size, own, normal, body, "place")


def _from_far(light: Ends[DirectionalLight]) -> Source:
    low, high = numbers(light.low.direction), numbers(light.high.direction)
    points = unit(box_about(low, high))
    middle = unit(points.mean(0))
    width = angle(points, middle).max() if len(points) > 1 else 0.0
    own = np.array([1.0])
    if width >= np.pi / 2 or (len(points) > 1 and np.all(low * high <= 0)):
        width = np.pi
    return Source(
        _peak(light, "irradiance"), middle[None], own * width, own, None, None, "direction"
    )


def _of_window(light: Ends[Any], windows: Ends[Any]) -> Source:
    low, high = windows
    corner, u, v = (numbers(getattr(low, name)) for name in ("corner", "edge_u", "edge_v"))
    fixed = all(
        np.array_equal(getattr(low, name), getattr(high, name))
        for name in ("corner", "edge_u", "edge_v")
    )
    spectrum = _peak(light, "radiance")
    if fixed:
        across = np.cross(u, v)
        area = np.linalg.norm(across)
        t = (np.arange(_PIECES) + 0.5) / _PIECES
        s, t = (x.ravel()[:, None] for x in np.meshgrid(t, t))
        places, count = corner + s * u + t * v, _PIECES**2
        size = max(np.linalg.norm(u + v), np.linalg.norm(u - v)) / (2 * _PIECES)
        points = corner + np.stack([0 * u, u, v, u + v])
        body = points, np.zeros(4)
        each = np.full(count, 1.0)
        return Source(
            spectrum, places, each * size, each * area / count, unit(across), body, "area"
        )
    ends = [
        numbers(end.corner)
        + np.stack(
            [
                0 * u,
                *(numbers(e) for e in (end.edge_u, end.edge_v)),
                numbers(end.edge_u) + numbers(end.edge_v),
            ]
        )
        for end in windows
    ]
    points = box_about(np.minimum(*ends), np.maximum(*ends))
    middle = points.mean(0)
    size = np.linalg.norm(points - middle, axis=1).max()
    area = max(
        np.linalg.norm(a) * np.linalg.norm(b)
        for a in box_about(numbers(low.edge_u), numbers(high.edge_u))
        for b in box_about(numbers(low.edge_v), numbers(high.edge_v))
    )
    own, body = np.array([1.0]), (points, np.zeros(len(points)))
    return Source(spectrum, middle[None], own * size, own * area, None, body, "area")


def _rectangle(light: Ends[RectangleLight]) -> Source:
    return _of_window(light, light)


def _light_field(light: Ends[LightFieldLight]) -> Source:
    return _of_window(light, light.of("aperture"))


def _sky(light: Ends[EnvironmentMap]) -> Source:
    """The sum over the pixels of the largest radiance beside each, and all of the largest."""
    radiance = np.maximum(*(np.abs(numbers(end.radiance)) for end in light))
    peak = radiance.reshape(-1, radiance.shape[-1]).max(0)
    rows, columns, _ = radiance.shape
    wide = np.concatenate([radiance[:1], radiance, radiance[-1:]])
    near = np.maximum.reduce([wide[k : k + rows] for k in range(3)])
    near = np.maximum.reduce([np.roll(near, k, axis=1) for k in (-1, 0, 1)])
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    solid = (edges[:-1] - edges[1:])[:, None, None] * (2 * np.pi / columns)
    sent = (near * solid).sum((0, 1))
    if rows < 3:  # the poles are means of whole rows
        sent = 4 * np.pi * peak
    share = np.max(sent / np.where(peak > 0, 2 * np.pi * peak, np.inf))
    none = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    return Source(peak, *none, None, None, "sky", share=float(min(share, 1.0)))


SOURCES: dict[type[Light], Callable[[Any], Source]] = {
    PointLight: _at_one_place,
    SmallLight: _at_one_place,
    DirectionalLight: _from_far,
    RectangleLight: _rectangle,
    LightFieldLight: _light_field,
    EnvironmentMap: _sky,
}


def source_of(light: Ends[Any]) -> Source:
    """A light between its two ends; inf for a kind of one's own."""
    own = SOURCES.get(type(light.low))
    if own is not None:
        return own(light)
    kind, bands = (
        type(light.low).__name__,
        [numbers(getattr(light.low, name)).shape[-1] for name in light.low.spectra],
    )
    none = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    spectrum = np.full(max(bands, default=1), np.inf)
    return Source(spectrum, *none, None, None, "sky", why=f"no bound of {kind} is known")


class Arrived(NamedTuple):
    """The light of a source on c cells, from each of its s places.

    Attributes:
        wi: (c, s, 3) unit, toward the middle of each place; None of a sky.
        width: (c, s) rad, by how much that varies.
        cos_i: (c, s), the largest cosine of incidence.
        e: (c, s), the largest irradiance of a facing surface per unit of the source's spectrum.
        body: (c,) the largest sum of e cos.
        facing: (c,) the largest sum of e.
    """

    wi: np.ndarray | None
    width: np.ndarray
    cos_i: np.ndarray
    e: np.ndarray
    body: np.ndarray
    facing: np.ndarray


def arriving(source: Source, cells: Cells, least: np.ndarray) -> Arrived:
    """What a source sends to cells; `least`: (c,) m, a lower bound of their distance that is known
    from elsewhere."""
    count = len(cells.radius)
    if source.kind == "sky":
        e = np.full((count, 1), 2 * np.pi * source.share)
        one = np.ones((count, 1))
        return Arrived(None, one * np.pi, one, e, np.minimum(e[:, 0], np.pi), e[:, 0])
    if source.kind == "direction":
        wi = np.broadcast_to(source.places, (count, 1, 3))
        width = np.broadcast_to(source.size, (count, 1))
        off = angle(cells.axis[:, None], wi) - cells.spread[:, None] - width
        cos_i = cosine(np.maximum(off, 0))
        e = (cos_i > 0).astype(float)
    else:
        wi, width, cos_i, e = _from_places(source, cells, least)
    body, facing = times(e, cos_i).sum(1), e.sum(1)
    if source.kind == "area":
        body, facing = np.minimum(body, np.pi), np.minimum(facing, 2 * np.pi)
    return Arrived(wi, width, cos_i, e, body, facing)


def of_lobes(
    arrived: Arrived, source: Source, lobes: Sequence[Lobe | None], cells: Cells, eye: Eye
) -> np.ndarray:
    """(c,) sup of E f_r cos / k_s, per unit of the source's spectrum, toward the eye.

    Args:
        arrived: of the cells, from `source`.
        source: the light.
        lobes: of each surface; None: none.
        cells: of all surfaces; lengths in m.
        eye: where they are seen from.
    """
    found, e = np.zeros(len(cells.radius)), arrived.e
    has = np.array([own is not None for own in lobes], bool)[cells.surface]
    angles = None
    if arrived.wi is not None and has.any():
        there = Cells(*(x[has] for x in cells))
        e, seen = e[has], (x[has] for x in (arrived.wi, arrived.width, arrived.cos_i))
        angles = lobe_angles(there, eye, *seen)
    sent, start = np.zeros(has.sum()), 0
    for own, count in zip(lobes, np.bincount(cells.surface, minlength=len(lobes)), strict=True):
        if own is None:
            continue
        part, start = slice(start, start + count), start + count
        sent[part] = own.size if source.extended else np.inf
        if angles is not None:
            most = own.most(Angles(*(x[part] for x in angles)))
            by_place = times(e[part], np.broadcast_to(most, e[part].shape))
            sent[part] = np.minimum(by_place.sum(1), sent[part])
    found[has] = sent
    return found


def times(a: np.ndarray, b: np.ndarray | float) -> np.ndarray:
    """The product in which 0 times inf is 0: no light, or nothing that reflects it."""
    nothing = (a == 0) | (b == 0)
    return np.where(nothing, 0, np.where(nothing, 1, a) * np.where(nothing, 1, b))


def _from_places(
    source: Source, cells: Cells, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Toward each place the unit direction, (c, s, 3), by how much that varies, rad, the largest
    cosine of incidence and the largest E, (c, s)."""
    apart = source.places - cells.centre[:, None]
    distance = np.linalg.norm(apart, axis=-1)
    wi, size = unit(apart), cells.radius[:, None] + source.size
    width = half_width(size, distance)
    flat = (cells.spread == 0)[:, None]
    # above a flat cell: d^2 = height^2 + along^2, each at its least
    height = (apart * cells.axis[:, None]).sum(-1)
    along = np.sqrt(np.maximum(distance**2 - height**2, 0))
    lateral = np.maximum(along - np.where(np.isinf(size), along, size), 0)
    above = np.hypot(np.maximum(np.abs(height) - source.size, 0), lateral)
    ball = np.maximum(distance - size, 0)
    d = np.maximum(np.where(flat, above, ball), least[:, None])
    some = np.where(d > 0, d, 1)
    off = np.maximum(angle(cells.axis[:, None], wi) - cells.spread[:, None] - width, 0)
    level = np.clip((height + source.size) / some, 0, 1)
    cos_i = np.where(flat, np.where(d > 0, level, height + source.size > 0), cosine(off))
    e = np.where(d > 0, source.weight / some**2, np.inf) * (cos_i > 0)
    if source.normal is not None:  # the receiver's height over the lamp's plane
        over = -(apart * source.normal).sum(-1)
        leaning = np.sqrt(np.maximum(1 - (cells.axis @ source.normal) ** 2, 0))[:, None]
        reach = np.where(flat, leaning, 1) * np.where(np.isinf(size), 1e300, cells.radius[:, None])
        reach = np.where(flat & (leaning == 0), 0, reach)
        over = over + reach + (source.size if source.kind == "place" else 0)
        e = times(e, np.where(d > 0, np.clip(over / some, 0, 1), over > 0))
    return wi, width, cos_i, e
