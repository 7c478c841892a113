"""The rows of a moving scene, each with its largest bound over all moments of the exposure."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..scene import Scene, Sensor, View
from .bounces import bounce_rows
from .motion import moments_of
from .probes import probed_rows
from .radiance import scene_stage
from .spectra import band_rows
from .stages import Arriving, Ends, Row
from .unmet import unmet_rows, with_owners

Motion = Callable[[Scene, View, Any], tuple[Scene, View]]


def scene_rows(
    scene: Ends[Scene],
    view: Ends[View],
    *,
    depth: int | None,
    motion: Motion | None,
    sensor: Sensor,
    moments: int,
    estimates: bool = False,
    whole_paths: bool = False,
    caustics: bool = False,
) -> tuple[tuple[Row, ...], Arriving]:
    """Return all rows of a scene between the two ends of its free parameters, at rest, and a bound
    on the light at the camera.

    The sensor's exposure time and shutter determine the times of a motion, s. `depth` is the
    longest path; None: direct light. `estimates`: also estimate long paths with a small picture.
    `whole_paths`: paths have no largest depth, so none can be shortened. `caustics`: paths start at
    the lights, too. A moving scene keeps its lights and bands, because a motion may refer to them
    by number.
    """
    rows, arriving, sums = scene_stage(scene, view, depth=depth, caustics=caustics)
    if motion is None or sensor.exposure_time is None:
        further = bounce_rows(sums, depth)
        if depth is None:
            bodies = tuple(unmet_rows(scene, sums))
            rows = (*with_owners(rows, bodies), *bodies)
        rows += band_rows(sums, direct=depth is None)
        if whole_paths:
            return rows + tuple(_uncut(row) for row in further[:1]), arriving
        rows += further
        if estimates:
            rows += probed_rows(scene.high, view.high, depth)
            rows = tuple(sorted(rows, key=_ladder_order))
        return rows, arriving
    if scene.low is not scene.high or view.low is not view.high:
        free = tuple(_free(row) for row in rows)
        unknown = np.full_like(arriving.radiance, np.inf)
        return free, Arriving(unknown, 0.0, np.inf, unknown)
    times = moments_of(sensor, view.high.resolution[0], moments)
    moved = _moved(scene, view, motion, times)
    found = [scene_stage(*ends, depth=depth, caustics=caustics)[:2] for ends in moved]
    everywhere = _unique_rows([rows, *(own for own, _ in found)])
    seen = [arriving, *(own for _, own in found)]
    brightest = np.max([own.radiance for own in seen], axis=0)
    near, far = min(own.near for own in seen), max(own.far for own in seen)
    turning = np.max([own.turning for own in seen], axis=0)
    return tuple(everywhere), Arriving(brightest, near, far, turning)


def _uncut(row: Row) -> Row:
    """All longer paths as a row that is kept."""
    effect = replace(
        row.effect, why="the integrator follows paths to their end, so they cannot be shortened"
    )
    return replace(row, effect=effect, drop=None, saves=0.0)


def _free(row: Row) -> Row:
    """Rows for a scene with free parameters and motion. The motion of a value inside the box may be
    outside the motions of its ends, so there is no bound."""
    why = f"{row.effect.why}; the motion of a free parameter is not bounded"
    effect = replace(row.effect, why=why, bound=np.inf, rank="bound")
    return replace(row, effect=effect, amount=0 * row.amount + np.inf, after=None, drop=None)


def _ladder_order(row: Row) -> float:
    """Rows in their order, with the rows of paths last, from short to long."""
    return -row.saves if row.ladder == "bounces" else -2.0


def _moved(
    scene: Ends[Scene], view: Ends[View], motion: Motion, times: Sequence[float] | np.ndarray
) -> Iterator[tuple[Ends[Scene], Ends[View]]]:
    """Return the scene and the view at each time, s, without free parameters."""
    dtype = view.low.pixel_pitch.dtype
    for time in times:
        there, seen = motion(scene.low, view.low, jnp.asarray(time, dtype))
        yield Ends(there, there), Ends(seen, seen)


def _unique_rows(moments: Sequence[Sequence[Row]]) -> Iterator[Row]:
    """Return the rows of all moments, each once. Objects that a motion adds or removes are kept."""
    found: dict[str, list[Row]] = {}
    for rows in moments:
        for row in rows:
            found.setdefault(row.effect.name, []).append(row)
    for own in found.values():
        most = _most(own)
        if len(own) < len(moments):
            why = f"{most.effect.why}; at some moments only"
            most = replace(most, drop=None, effect=replace(most.effect, why=why))
        yield most


def _most(rows: Sequence[Row]) -> Row:
    """One row with the largest bound of all moments."""
    amount = np.max([row.amount for row in rows], axis=0)
    bound = float(np.max(amount))
    first = rows[0]
    effect = replace(first.effect, bound=bound, rank="exact" if bound == 0 else "bound")
    of_light = effect.name.startswith("lights[")
    return replace(
        first, effect=effect, amount=amount, after=None, drop=None if of_light else first.drop
    )
