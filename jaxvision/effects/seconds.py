"""Measure the time of each effect in a picture, in s, by alternating calls of programs with and
without it.

A picture is made by four programs, for the scene, the lens, the sensor and the development, with
separate records as arguments. Dropping an effect changes the records of some programs. The time of
the effect is the difference between the times of these programs with and without it. Programs whose
records have the same structure and sizes, in any order of the surfaces, are compiled and timed only
once. The program that traces paths is the same for all numbers of segments.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..development import develop
from ..optics import sensor_irradiance
from ..rendering import PixelSamples, photograph, render
from ..scene import Scene, Surface, View
from ..sensor import raw_image
from ..transport import Paths, path_along
from .bounces import DIRECT
from .choice import bands_of, finished
from .spectra import select_bands
from .stages import Draft, Row

_SIDE = 256  # pixels along the longer side of the measured picture
_ROUNDS = 5
_MAX_SECONDS = 20.0  # s, the time after which no further round of calls begins
Advance = Callable[[int, int], Any]


class _Part(NamedTuple):
    """One program that takes part in making a picture. Equal programs have the same `kind`. `run`
    calls the program once, and a picture takes `times` calls."""

    kind: Hashable
    run: Callable[[], Any]
    times: int


def seconds_of(
    rows: Sequence[Row], start: Draft, scene: Scene, *, whole: bool, advance: Advance | None = None
) -> list[float | None]:
    """Return the time, in s, that dropping each effect saves in a picture; a negative time means
    that the picture takes longer without the effect. The time is None if the effect cannot be
    dropped alone. Effects that can only be dropped together share the saved time equally.

    `start` is the `Draft` with all effects. `whole` states whether a sensor and a development
    follow the lens. `advance` is called with two numbers: of programs finished so far, and of all
    programs.
    """
    view = start.camera.view
    scale = max(max(view.resolution) / _SIDE, 1.0)
    small = view.resolution
    if scale > 1:  # even, for mosaics
        small = tuple(max(2 * round(n / scale / 2), 2) for n in small)
    coarse = replace(view, resolution=small, pixel_pitch=view.pixel_pitch * scale)
    start = replace(start, camera=replace(start.camera, view=coarse))
    parties = [party_of(row, rows) for row in rows]
    drafts = [draft_without(party, start) for party in parties]
    calls = _Calls(scene, start, whole=whole)
    full = calls.parts(start)
    found = [None if draft is None else calls.parts(draft) for draft in drafts]
    runs = {part.kind: part.run for parts in (full, *found) for part in parts or ()}
    taken = _median_seconds(runs, advance)
    pixels = np.prod(view.resolution) / np.prod(small)

    def seconds(parts: Sequence[_Part]) -> float:
        return sum(part.times * taken[part.kind] for part in parts) * float(pixels)

    return [
        None if parts is None else (seconds(full) - seconds(parts)) / len(party)
        for parts, party in zip(found, parties, strict=True)
    ]


def party_of(row: Row, rows: Sequence[Row]) -> list[Row]:
    """Return the rows that can only be dropped together with a given row, including that row."""
    return [own for own in rows if own.together == row.together] if row.together else [row]


def draft_without(party: Sequence[Row], start: Draft) -> Draft | None:
    """Return the `Draft` without effects that are dropped together; None if impossible."""
    draft = start
    for row in party:
        if row.drop is None or row.needs or not row.present:
            return None
        draft = row.drop(draft)
    return draft if bands_of(draft) == bands_of(start) else None


class _Calls:
    """The functions of a `Draft` to time, one for each part of a picture. Each function gets the
    same input for all drafts: what the parts before it return with all effects present."""

    def __init__(self, scene: Scene, start: Draft, *, whole: bool) -> None:
        self.scene, self.whole = scene, whole
        rows, columns = start.camera.view.resolution
        light = jnp.ones((rows, columns, bands_of(start)), start.camera.view.pixel_pitch.dtype)
        self.radiance = light
        if whole:
            self.irradiance = _lens(start.camera.view, light)
            self.raw = _sensor(start.camera.sensor, self.irradiance)

    def parts(self, draft: Draft) -> list[_Part]:
        camera, sensor = draft.camera, draft.camera.sensor
        left = finished(self.scene, draft)
        if draft.bands is not None:
            kept, expand = draft.bands
            left = select_bands(left, kept, len(expand))
        aperture = sensor.pixel_aperture
        fine = 1 if aperture is None else aperture.oversampling**2
        moments = 1 if draft.motion is None else draft.moments or 1
        samples = draft.samples
        rays = 1 if samples is None else samples.count
        samples = None if samples is None else replace(samples, count=1)
        seen = _sorted_scene(left), camera.view, samples
        found = [
            _part("scene", _picture, seen, fine * moments * rays, depth=draft.depth),
            _part("lens", _lens, (camera.view, self.radiance), fine * moments),
        ]
        if self.whole:
            found.append(_part("sensor", _sensor, (sensor, self.irradiance)))
        if self.whole and camera.development is not None:
            found.append(_part("development", _developed, (self.raw, camera.development)))
        return found


def _part(
    name: str, function: Callable[..., Any], records: tuple, times: int = 1, **static: Any
) -> _Part:
    leaves, tree = jax.tree.flatten(records)
    kind = name, tree, *map(np.shape, leaves), *static.items()
    return _Part(kind, lambda: function(*records, **static), times)


def _sorted_scene(scene: Scene) -> Scene:
    """Return the scene with surfaces sorted by kind, unless occluders refer to them."""
    if scene.occluders:
        return scene

    def kind(surface: Surface) -> str:
        leaves, tree = jax.tree.flatten(surface)
        return f"{tree} {[np.shape(leaf) for leaf in leaves]}"

    return replace(scene, surfaces=tuple(sorted(scene.surfaces, key=kind)))


def _median_seconds(
    runs: dict[Hashable, Callable[[], Any]], advance: Advance | None
) -> dict[Hashable, float]:
    """Return the median time of each program, in s; the first call, which compiles, is excluded."""
    found: dict[Hashable, list[float]] = {kind: [] for kind in runs}
    for done, run in enumerate(runs.values()):
        if advance is not None:
            advance(done, len(runs))
        jax.block_until_ready(run())
    if advance is not None:
        advance(len(runs), len(runs))
    start = time.perf_counter()
    for turn in range(_ROUNDS):
        if turn and time.perf_counter() - start > _MAX_SECONDS:
            break
        for kind, run in runs.items():
            begin = time.perf_counter()
            jax.block_until_ready(run())
            found[kind].append(time.perf_counter() - begin)
    return {kind: float(np.median(seconds)) for kind, seconds in found.items()}


@jax.jit
def _direct(scene: Scene, view: View, samples: PixelSamples | None) -> jax.Array:
    return render(scene, view, samples=samples)


@jax.jit
def _trace_program(scene: Scene, view: View, depth: jax.Array) -> jax.Array:
    along = path_along(scene, Paths(1), depth=depth)
    return photograph(along, view, PixelSamples(jax.random.key(0), 1)).radiance


def _picture(
    scene: Scene, view: View, samples: PixelSamples | None, *, depth: int | None
) -> jax.Array:
    if depth is None:
        return _direct(scene, view, samples)
    return _trace_program(scene, view, jnp.asarray(max(depth, DIRECT), jnp.int32))


_lens = jax.jit(sensor_irradiance)
_developed = jax.jit(develop)


@jax.jit
def _sensor(sensor: Any, irradiance: jax.Array) -> jax.Array:
    frame, die = jax.random.split(jax.random.key(0))
    return raw_image(frame, sensor, irradiance, die_key=die)
