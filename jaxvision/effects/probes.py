"""Estimate changes of radiance from small pictures, because the proved bounds may be far too large.

The change by any single effect of a scene is estimated by a picture with the effect and a picture
without it. Both pictures use the same random numbers. The light of long paths is extrapolated.

In the Cornell box, a bright closed room, the proved bound of `bounces` requires tens of path
segments. For an estimate, pictures of 16 x 16 pixels with 64 paths each are rendered with n, n + 1
and n + 2 segments and the same random numbers. The differences of the pictures give the light D
that one further segment adds, and the factor r by which D decreases with each further segment. The
factor is assumed to be the same for all further segments, so paths of more than m segments add

    sum over k > m of D r^(k - n - 1) = D r^(m - n) (1 - r^(depth - m)) / (1 - r)

where D is taken from the brightest pixel, and r is two standard errors above the observed factor.
Light is given as radiance in W m^-2 sr^-1.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import jax
import numpy as np

from ..rendering import render
from ..rendering.pixel_loop import Traced
from ..scene import Scene, View
from ..transport import Paths, path_traced
from .bounces import DIRECT, pieces_row, shorter
from .certificate import RADIANCE, Effect
from .choice import finished
from .seconds import draft_without, party_of
from .stages import FAST, Draft, Row

SIDE = 16  # pixels along the longer side of a small picture
_FINE, _PATHS = 32, 64  # pixels along the longer side of a picture with and without an effect
_FIRST_GEOMETRIC = 4  # segments from which the light is assumed to fall by a constant factor
ASSUMED = "Each further segment of a path beyond the probed ones reduces its light by one factor."


def probed_rows(scene: Scene, view: View, depth: int | None) -> tuple[Row, ...]:
    """Return a `Row` "bounces" for each limit in `bounces.shorter` on the number of path segments,
    as `bounces.bounce_rows` but with rank "estimate". Free parameters have their largest values.
    The result is empty for direct light (`depth` None), or if `depth` is too small for an estimate.
    """
    n = min(_FIRST_GEOMETRIC, (depth or 0) - 2)
    if depth is None or n < DIRECT:
        return ()
    coarse = coarse_view(view, SIDE)
    pictures = [
        np.asarray(_probe(scene, coarse, Paths(_PATHS, pieces)).radiance, float)
        for pieces in (n, n + 1, n + 2)
    ]
    tails = tails_of(*pictures, n=n, depth=depth)
    return tuple(
        pieces_row(tail, pieces, depth, assumes=ASSUMED)
        for pieces, tail in zip(shorter(depth), tails, strict=True)
    )


def _trace_paths(scene: Scene, view: View, method: Paths) -> Traced:
    return path_traced(jax.random.key(0), scene, view, method=method)


_probe = jax.jit(_trace_paths, compiler_options=FAST)
_rendered = jax.jit(render, compiler_options=FAST)


def coarse_view(view: View, side: int) -> View:
    """Return a view of the same field with `side` pixels along the longer side."""
    scale = max(view.resolution) / side
    small = [max(round(pixels / scale), 1) for pixels in view.resolution]
    return replace(view, resolution=tuple(small), pixel_pitch=view.pixel_pitch * scale)


def paired_effects(rows: Sequence[Row], start: Draft, scene: Scene) -> Iterator[Effect | None]:
    """Yield, for each `Row`, the largest change of a small picture without the effect, as an
    `Effect` of rank "estimate". Yield None where the bound is at most the brightest pixel of that
    picture, for effects of the lens and the sensor, and for effects that cannot be dropped alone.
    `start` is the `Draft` with all effects."""
    of_scene = [row.unit == RADIANCE and not row.ladder and not start.motion for row in rows]
    picture, error = _small_picture(scene, start) if any(of_scene) else np.zeros((2, 1))
    brightest = np.max(picture, initial=0, where=np.isfinite(picture))
    for row, own_unit in zip(rows, of_scene, strict=True):
        wide = own_unit and row.bound > brightest
        draft = draft_without(party_of(row, rows), start) if wide else None
        if draft is None:
            yield None
            continue
        left, own = _small_picture(scene, draft)
        change = np.where(np.isfinite(left - picture), np.abs(left - picture), 0)
        most = np.unravel_index(np.argmax(change), change.shape)
        why = f"largest change of a picture of {' x '.join(map(str, change.shape[:2]))} pixels"
        if start.depth is not None:
            why += f", +- {np.hypot(own, error)[most]:.2g} by sampling"
        bound = min(float(change[most]), row.bound)  # others may have to be dropped together
        yield replace(row.effect, bound=bound, place=0.0, rank="estimate", why=why)


def _small_picture(scene: Scene, draft: Draft) -> tuple[np.ndarray, np.ndarray]:
    """Return a small picture of the scene of a `Draft`, and its standard errors, both (h, w, bands)
    W m^-2 sr^-1."""
    left, view = finished(scene, draft), coarse_view(draft.camera.view, _FINE)
    if draft.depth is None:
        samples = draft.samples
        some = None if samples is None else replace(samples, count=min(samples.count, SIDE))
        picture = np.asarray(_rendered(left, view, samples=some), float)
        return picture, np.zeros_like(picture)
    found = _probe(left, view, Paths(_PATHS, max(draft.depth, DIRECT)))
    return np.asarray(found.radiance, float), np.asarray(found.error, float)


def tails_of(
    short: np.ndarray, longer: np.ndarray, longest: np.ndarray, *, n: int, depth: int
) -> list[np.ndarray]:
    """Estimate the light of paths with more than m segments, (bands,) W m^-2 sr^-1, for each m of
    `bounces.shorter`. The three pictures, (h, w, bands), have n, n + 1 and n + 2 segments. The
    estimate is inf if the light of further segments does not decrease."""
    first, second = np.maximum(longer - short, 0), np.maximum(longest - longer, 0)
    total = first.sum((0, 1))
    some = np.where(total > 0, total, 1)
    ratio = second.sum((0, 1)) / some
    error = np.sqrt(((second - ratio * first) ** 2).sum((0, 1))) / some
    r = ratio + 2 * error
    falls = (r > 0) & (r < 1) & (total > 0)
    r = np.where(falls, r, 0.5)
    most = first.max((0, 1))
    dark = (total == 0) & (second.sum((0, 1)) == 0)
    found = []
    for m in shorter(depth):
        tail = most * r ** float(m - n) * (1 - r ** float(depth - m)) / (1 - r)
        found.append(np.where(dark, 0, np.where(falls, tail, np.inf)))
    return found
