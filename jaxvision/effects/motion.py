"""Bound the displacement of points in the picture by motion during an exposure.

Rendering evaluates a motion at a few times, and the bound is computed for exactly these times. A
body is the convex hull of its corners x_i. A point x = sum w_i x_i of the body, with weights w_i,
moves to x' = sum w_i x'_i, where x'_i are the moved corners. With coordinates X across and Z along
the camera's axis, a visible point with |X / Z| <= M moves in the picture by

    |X' / Z' - X / Z| = |(X' - X) - (X / Z)(Z' - Z)| / Z' <= (max |dX_i| + M max |dZ_i|) / min Z_i,

times the distance to the sensor over the pixel pitch, in pixels. Rays through a point of the
aperture at most r from the axis have slopes up to M + r / z_f, with the focus distance z_f. There
is no bound on the change of shading: a body that rotates or passes a lamp changes its own shading
and the shadows around it. Therefore the result is ranked "estimate" instead of "bound", unless
nothing moves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..optics import chief_slope, focus_vergence, sensor_vergence
from ..scene import (
    Orthographic,
    Scene,
    Sensor,
    ThinLens,
    TriangleMesh,
    View,
)
from ..sensor import exposure_slots
from .bodies import corners as corners_of
from .boxes import same, setting
from .cells import lens_radius
from .certificate import IRRADIANCE
from .illumination import has_size, source_of
from .optics import stretch
from .pixel import INF, clean
from .stages import Draft, Drop, Ends, Row

Motion = Callable[[Scene, View, jax.Array], tuple[Scene, View]]


def motion_stage(
    scene: Ends[Scene],
    view: Ends[View],
    motion: Motion | None,
    *,
    sensor: Ends[Sensor],
    moments: int | None,
) -> tuple[Row, ...]:
    """Return a `Row` "motion" and a `Row` "sensor.shutter" if the scene moves or the sensor has a
    shutter. Both bounds compare the scene at rest with the scene at `moments` times of the
    exposure, over the range of the free parameters."""
    shutter = sensor.high.shutter
    if motion is None:
        why = "nothing moves: all rows see the same scene"
        return () if shutter is None else (_shutter_row(0.0, why, True),)
    ends_agree = all(same(end.low, end.high) for end in (scene, view, sensor))
    if not ends_agree or sensor.high.exposure_time is None:
        rolling = global_ = INF
        still, why = False, "a free parameter may change the motion"
    else:
        rows = view.high.resolution[0]
        rolling, still, why = moved(
            motion, scene.high, view.high, moments_of(sensor.high, rows, moments or 1)
        )
        once = replace(sensor.high, shutter=None)
        global_, still_once, _ = moved(
            motion, scene.high, view.high, moments_of(once, rows, moments or 1)
        )
        still = still and still_once

    def drop(draft: Draft) -> Draft:
        return replace(draft, motion=None, moments=None)

    found = [_row("motion", rolling, why, still, drop, 0.7)]
    if shutter is not None:
        found.append(_shutter_row(rolling + global_, why, still))
    return tuple(found)


def moments_of(sensor: Sensor, rows: int, moments: int) -> np.ndarray:
    """Return the times, (moments,) s, at which a motion is evaluated."""
    assert sensor.exposure_time is not None
    times, _ = exposure_slots(sensor.shutter, sensor.exposure_time, rows=rows, slots=moments)
    return np.asarray(times, float)


def moved(
    motion: Motion, scene: Scene, view: View, times: Sequence[float] | np.ndarray
) -> tuple[float, bool, str]:
    """Return the largest displacement, in pixels, from the scene at rest at any of the times, in s.
    Also return whether nothing changes, and a reason. The displacement is inf if there is no bound.
    """
    farthest, still = 0.0, True
    dtype = view.pixel_pitch.dtype
    for time in times:
        now, seen = motion(scene, view, jnp.asarray(time, dtype))
        if same((scene, view), (now, seen)):
            continue
        still = False
        pixels, why = _displacement_at(scene, view, now, seen)
        if pixels == INF:
            return INF, False, why
        farthest = max(farthest, pixels)
    if still:
        return 0.0, True, "nothing moves at any moment of the exposure"
    return farthest, False, f"{farthest:.3g} pixels from rest; the change of shading is not bounded"


def _displacement_at(scene: Scene, view: View, now: Scene, seen: View) -> tuple[float, str]:
    """Return the largest displacement, pixels, from rest at one time, and why it is inf."""
    if jax.tree.structure((scene, view)) != jax.tree.structure((now, seen)):
        return INF, "the motion changes kinds, not only numbers"
    if not same(_static_parts(scene, view), _static_parts(now, seen)):
        return INF, "the motion changes light or materials, not only places"
    turned = not same(view, seen)
    bodies: list[tuple[Any, Any]] = [
        (a.shape, b.shape) for a, b in zip(scene.surfaces, now.surfaces, strict=True)
    ]
    if turned:
        for light in scene.lights:
            source = source_of(Ends(light, light)) if has_size(light) else None
            if source is not None and source.small is not None and source.body is not None:
                bodies.append((source.body[0], source.body[0]))
            elif source is not None:
                return INF, "a sky or a light field turns about a moving camera"
    farthest = 0.0
    for rest, moment in bodies:
        if not turned and same(rest, moment):
            continue
        points, others = _points(rest), _points(moment)
        if points is None or others is None:
            return INF, "an endless plane moves"
        farthest = max(farthest, _displacement(view, seen, points, others))
    if farthest == INF:
        return INF, "something passes the camera"
    return farthest, ""


def _displacement(view: View, seen: View, points: np.ndarray, others: np.ndarray) -> float:
    """Return the displacement, pixels, of a convex hull that moves from `points` to `others`."""
    rest, now = _camera_coordinates(view, points), _camera_coordinates(seen, others)
    across = float(np.hypot(*(now - rest)[:, :2].T).max())
    if isinstance(view, Orthographic):
        return across / float(view.pixel_pitch)
    nearest = float(min(rest[:, 2].min(), now[:, 2].min()))
    if nearest <= 0:
        return INF
    steepest = steepest_slope(view)
    if isinstance(view, ThinLens):
        steepest += lens_radius(view) * float(focus_vergence(view))
    along = float(np.abs(now[:, 2] - rest[:, 2]).max())
    per_slope = float(view.pixel_pitch) * float(sensor_vergence(view))
    pixels = (across + steepest * along) / nearest / per_slope
    return clean(pixels * stretch(view, steepest))


def steepest_slope(view: View) -> float:
    """Return the largest slope of a chief ray, at the border of the picture."""
    assert not isinstance(view, Orthographic)
    height, width = view.resolution
    across, down = np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5
    rows = np.concatenate([0 * across - 0.5, 0 * across + height - 0.5, down, down])
    columns = np.concatenate([across, across, 0 * down - 0.5, 0 * down + width - 0.5])
    if view.distortion is None:
        rows, columns = rows[[0, width]], columns[[0, width]]
    dtype = view.pixel_pitch.dtype
    slope = jax.vmap(lambda row, column: chief_slope(view, row, column))
    x, y = slope(jnp.asarray(rows, dtype), jnp.asarray(columns, dtype))
    return float(np.hypot(np.asarray(x, float), np.asarray(y, float)).max())


def _camera_coordinates(view: View, points: np.ndarray) -> np.ndarray:
    """Convert points, (n, 3) m, to coordinates along a camera's right, down and forward."""
    return (points - np.asarray(view.position, float)) @ np.asarray(view.rotation, float).T


def _points(shape: Any) -> np.ndarray | None:
    """Return corners, (n, 3) m, of a convex body around a shape, or None for an unbounded one."""
    if isinstance(shape, TriangleMesh):
        return np.asarray(shape.vertices, float)
    if isinstance(shape, np.ndarray):
        return shape
    return corners_of(shape)


def _static_parts(scene: Scene, view: View) -> tuple[Any, ...]:
    """Return the parts of a scene and a view that do not change if objects only move."""
    surfaces = [(s.material, s.emission) for s in scene.surfaces]
    optics = {k: v for k, v in vars(view).items() if k not in ("position", "rotation")}
    return scene.lights, scene.ambient, surfaces, optics


def _shutter_row(pixels: float, why: str, still: bool) -> Row:
    return _row("sensor.shutter", pixels, why, still, setting("camera.sensor.shutter"), 0.02)


def _row(name: str, pixels: float, why: str, still: bool, drop: Drop, saves: float) -> Row:
    more = {"unit": IRRADIANCE, "place": pixels, "estimated": not still, "saves": saves}
    return Row(name, np.zeros(1), why, drop if pixels < INF else None, **more)
