"""List the effects of a moving scene, each with its largest bound over all times at which the
exposure is sampled."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from ..scene import Scene, Sensor, View
from .bounces import bounce_rows
from .motion import Motion, moments_of
from .probes import probed_rows
from .radiance import scene_stage
from .spectra import band_rows
from .stages import Arriving, Ends, Method, Row, unproved
from .unmet import mark_owned_parts, unmet_rows


def scene_rows(
    scene: Ends[Scene], view: Ends[View], sensor: Sensor, method: Method
) -> tuple[tuple[Row, ...], Arriving]:
    """Return a `Row` for every effect of a scene, over the range of its free parameters, and a
    bound on the light at the camera.

    If the scene moves, the sensor's exposure time and shutter determine the times, in s, of the
    bounds. No light and no band of a moving scene is dropped, because the motion may refer to
    lights and bands by index.
    """
    depth, caustics, motion = method.depth, method.caustics, method.motion
    rows, arriving, onward = scene_stage(scene, view, depth=depth, caustics=caustics)
    if motion is None or sensor.exposure_time is None:
        further, sums = bounce_rows(onward), onward.sums
        if depth is None:
            bodies = tuple(unmet_rows(scene, sums))
            rows = (*mark_owned_parts(rows, bodies), *bodies)
        rows += band_rows(sums, direct=depth is None)
        if method.whole_paths:
            why = "the integrator follows paths to their end, so they cannot be shortened"
            whole = (replace(row, why=why, drop=None, saves=0.0) for row in further[:1])
            return (*rows, *whole), arriving
        rows += further
        if method.estimates:
            rows += probed_rows(scene.high, view.high, depth)
            # the limits on path length last, shortest first
            rows = sorted(rows, key=lambda row: -row.saves if row.ladder == "bounces" else -2.0)
        return tuple(rows), arriving
    if scene.low is not scene.high or view.low is not view.high:
        # the motion of a value inside the box may be outside the motions of its ends
        why = "the motion of a free parameter is not bounded"
        free = tuple(unproved(row, f"{row.why}; {why}") for row in rows)
        unknown = np.full_like(arriving.radiance, np.inf)
        return free, Arriving(unknown, 0.0, np.inf, unknown)
    times = moments_of(sensor, view.high.resolution[0], method.moments)
    moved = _pose_at_times(scene, view, motion, times)
    found = [scene_stage(*ends, depth=depth, caustics=caustics)[:2] for ends in moved]
    everywhere = _unique_rows([rows, *(own for own, _ in found)])
    seen = [arriving, *(own for _, own in found)]
    brightest = np.max([own.radiance for own in seen], axis=0)
    near, far = min(own.near for own in seen), max(own.far for own in seen)
    turning = np.max([own.turning for own in seen], axis=0)
    return tuple(everywhere), Arriving(brightest, near, far, turning)


def _pose_at_times(
    scene: Ends[Scene], view: Ends[View], motion: Motion, times: Sequence[float] | np.ndarray
) -> Iterator[tuple[Ends[Scene], Ends[View]]]:
    """Yield the scene and the view at each time, in s, with all parameters fixed."""
    dtype = view.low.pixel_pitch.dtype
    for time in times:
        there, seen = motion(scene.low, view.low, jnp.asarray(time, dtype))
        yield Ends(there, there), Ends(seen, seen)


def _unique_rows(moments: Sequence[Sequence[Row]]) -> Iterator[Row]:
    """Yield the largest bound of each effect over all times. An effect that is present at some
    times only is never dropped."""
    found: dict[str, list[Row]] = {}
    for rows in moments:
        for row in rows:
            found.setdefault(row.name, []).append(row)
    for own in found.values():
        most = replace(own[0], amount=np.max([row.amount for row in own], axis=0), after=None)
        if len(own) < len(moments):
            most = replace(most, drop=None, why=f"{most.why}; at some moments only")
        yield replace(most, drop=None) if most.name.startswith("lights[") else most
