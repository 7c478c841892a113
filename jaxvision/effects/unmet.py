"""Find the surfaces that no ray of direct light meets, neither a ray from the eye nor a shadow ray.

Rays from the eye stay in the picture's cone of view. A shadow ray goes from a point in that cone to
a lamp, so it stays in the convex hull of the cone and the lamp. Let u be a direction with a scalar
product u.d >= 0 with every ray direction d of the cone. Then u.x is smallest, over the points x of
the hull, at the cone's apex or at a point of the lamp. No ray meets a body whose points all have a
smaller u.x. The directions u that are tried are the normals of the planes that bound the cone, and
the normals of planes through the lamp and an edge of the cone. Lengths are in m; computed in NumPy
float64.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..scene import Scene, Surface
from .blocking import certain, reach_of, touching
from .bodies import Bodies, heights, stacked, surface_bodies
from .cells import Eye, visible_flags
from .illumination import Source
from .stages import Draft, Ends, Row
from .sums import Sums

# smallest cosine at which the cone certainly rises along a direction, in spite of rounding
_LEVEL = 1e-9


def unmet_rows(scene: Ends[Scene], sums: Sums) -> Iterator[Row]:
    """Yield a `Row` of bound 0 W m^-2 sr^-1 for each surface that no ray of direct light meets. If
    no ray meets any surface, yield nothing."""
    low, never = scene.low, unmet(sums.surfaces, sums.sources, sums.eye, scene.low.occluders)
    if never.all():
        return
    for i in map(int, np.flatnonzero(never)):
        why = "no pixel sees it, and no ray from what is seen to a lamp meets it"

        def drop(draft: Draft, i: int = i) -> Draft:
            return replace(draft, unmet=draft.unmet | {i})

        nothing, saves = np.zeros(sums.spectrum.shape[1]), 0.5 / len(low.surfaces)
        yield Row(f"surfaces[{i}]", nothing, why, drop, saves=saves, together="unmet")


def mark_owned_parts(rows: Iterable[Row], owners: Iterable[Row]) -> Iterator[Row]:
    """Yield every `Row`. If a `Row` is for a part of a surface, and `owners` has a `Row` for the
    whole surface, mark the part as dropped together with the whole."""
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
    """Return flags, (n,): True if it is proved that neither a ray from the eye nor a shadow ray
    meets the surface. `occluders` are the indices of the surfaces that may block light, all if
    None."""
    bodies, never = surface_bodies(surfaces)
    if eye.everywhere or not never.any():
        return np.zeros(len(surfaces), bool)
    reach = reach_of(surfaces, sources) + float(np.abs(eye.place).max())
    slack = (touching(surfaces) + 10 * _LEVEL) * reach + certain(reach)
    bodies = Bodies(bodies.points, bodies.radii + slack)
    never &= ~visible_flags(eye, bodies)
    blocks = np.ones(len(surfaces), bool)
    if occluders is not None:
        blocks[:] = False
        blocks[list(occluders)] = True
    edges = _edges(eye)
    for source in sources:
        never &= ~blocks | _has_separating_plane(bodies, source, eye, edges)
    return never


def _edges(eye: Eye) -> np.ndarray:
    """Return the unit directions, (k, 3), in which a ray of the picture may go to infinity at its
    border: the edges of the cone, or the one direction of a parallel view."""
    forward = eye.rotation[2]
    if eye.parallel:
        return forward[None]
    # the planes after the forward one, in two pairs
    right, down = (eye.planes[[i, i + 1]] for i in (1, 3))
    found = [np.cross(a, b) for a in right for b in down]
    ahead = np.stack([d if d @ forward > 0 else -d for d in found])
    return ahead / np.linalg.norm(ahead, axis=1, keepdims=True)


def _has_separating_plane(
    bodies: Bodies, source: Source, eye: Eye, edges: np.ndarray
) -> np.ndarray:
    """Return flags, (n,): whether a plane separates each body from the convex hull of the cone and
    the light."""
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
    """Return the smallest u.x, in m, over the points x where rays of the picture start, relative to
    the eye, for each direction u."""
    if not eye.parallel:
        return np.zeros(len(directions))
    right, down = (np.abs(directions @ axis) for axis in eye.rotation[:2])
    return -(right * eye.offsets[0] + down * eye.offsets[2])
