"""Surfaces that no ray of direct light meets: neither a ray from the eye nor a shadow ray.

Rays from the eye stay in the cone of the picture. A shadow ray goes from a point in that cone to a
lamp, and so stays in the hull of both. Along a direction u in which the cone never falls, the hull
is nowhere lower than the cone's apex and the lamp. A body that is lower along u is not met,
whatever is in the picture. The directions tried are the normals of the cone's planes, and of the
planes through one of its edges and the lamp. Lengths in m; NumPy float64.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..scene import Scene, Surface
from .blocking import certain, reach_of, touching
from .bodies import Bodies, heights, stacked, surface_bodies
from .cells import Eye, in_view
from .illumination import Source
from .stages import Draft, Ends, Row
from .sums import Sums

# smallest cosine at which the cone certainly rises along a direction, in spite of rounding
_LEVEL = 1e-9


def unmet_rows(scene: Ends[Scene], sums: Sums) -> Iterator[Row]:
    """A row of bound 0 W m^-2 sr^-1 for each surface that no ray of direct light meets, if any
    other is met."""
    low, never = scene.low, unmet(sums.surfaces, sums.sources, sums.eye, scene.low.occluders)
    if never.all():
        return
    for i in map(int, np.flatnonzero(never)):
        why = "no pixel sees it, and no ray from what is seen to a lamp meets it"

        def drop(draft: Draft, i: int = i) -> Draft:
            return replace(draft, unmet=draft.unmet | {i})

        nothing, saves = np.zeros(sums.spectrum.shape[1]), 0.5 / len(low.surfaces)
        yield Row(f"surfaces[{i}]", nothing, why, drop, saves=saves, together="unmet")


def with_owners(rows: Iterable[Row], owners: Iterable[Row]) -> Iterator[Row]:
    """The rows; those of a surface with a row among `owners` go with it."""
    names = {row.name for row in owners}
    for row in rows:
        owner = row.name.partition(".")[0]
        yield replace(row, part_of=owner) if owner in names and not row.part_of else row


def unmet(
    surfaces: Sequence[Ends[Surface]],
    sources: Sequence[Source],
    eye: Eye,
    occluders: tuple[int, ...] | None,
) -> np.ndarray:
    """Return (n,) whether no ray from the eye and no shadow ray meets a surface. True is certain,
    False is not. `occluders` are the numbers of the surfaces that block light; None for all."""
    bodies, never = surface_bodies(surfaces)
    if eye.everywhere or not never.any():
        return np.zeros(len(surfaces), bool)
    reach = reach_of(surfaces, sources) + float(np.abs(eye.place).max())
    slack = (touching(surfaces) + 10 * _LEVEL) * reach + certain(reach)
    bodies = Bodies(bodies.points, bodies.radii + slack)
    never &= ~in_view(eye, bodies)
    blocks = np.ones(len(surfaces), bool)
    if occluders is not None:
        blocks[:] = False
        blocks[list(occluders)] = True
    edges = _edges(eye)
    for source in sources:
        never &= ~blocks | _beside(bodies, source, eye, edges)
    return never


def _edges(eye: Eye) -> np.ndarray:
    """(k, 3) unit directions to which a ray may go infinitely far within the picture: the edges of
    the cone, or the only direction of a parallel view."""
    forward = eye.rotation[2]
    if eye.parallel:
        return forward[None]
    # the planes after the forward one, in two pairs
    right, down = (eye.planes[[i, i + 1]] for i in (1, 3))
    found = [np.cross(a, b) for a in right for b in down]
    ahead = np.stack([d if d @ forward > 0 else -d for d in found])
    return ahead / np.linalg.norm(ahead, axis=1, keepdims=True)


def _beside(bodies: Bodies, source: Source, eye: Eye, edges: np.ndarray) -> np.ndarray:
    """(n,) whether a plane is between each body and the hull of cone and light."""
    count = len(bodies.points)
    if source.kind == "sky":
        return np.zeros(count, bool)
    ways = edges
    if source.body is None:  # a light infinitely far away: its rays rise along its direction
        ways = np.concatenate([edges, source.places])
        toward = source.places
    else:
        toward = (source.body[0].mean(0) - eye.place)[None]
    pairs = [(a, b) for a in edges for b in toward] + list(combinations(ways, 2))
    sides = np.array([np.cross(a, b) for a, b in pairs]).reshape(-1, 3)
    directions = np.concatenate([eye.planes, sides, -sides, eye.rotation, -eye.rotation])
    size = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = (directions / np.where(size > 0, size, 1))[size[:, 0] > 1e-12]
    wide = np.sin(min(float(source.size.max()), np.pi / 2)) if source.body is None else 0.0
    rises = (directions @ edges.T).min(1) >= -_LEVEL
    if source.body is None:
        rises &= (directions @ source.places.T).min(1) >= wide + _LEVEL
    directions = directions[rises]
    if not len(directions):
        return np.zeros(count, bool)
    least = directions @ eye.place + _apex(eye, directions) - eye.size
    if source.body is not None:
        lamp = stacked([source.body])
        least = np.minimum(least, -heights(lamp, -directions)[0])
    return np.any(heights(bodies, directions) < least, axis=1)


def _apex(eye: Eye, directions: np.ndarray) -> np.ndarray:
    """m, the least height over the eye of the points where rays of the picture may start."""
    if not eye.parallel:
        return np.zeros(len(directions))
    right, down = (np.abs(directions @ axis) for axis in eye.rotation[:2])
    return -(right * eye.offsets[0] + down * eye.offsets[2])
