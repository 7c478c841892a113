"""Estimate the light of long paths from small pictures, because the proved bound may be far too
large.

In the Cornell box, a bright closed room, the proved bound of `bounces` requires tens of path
segments. For an estimate, pictures of 16 x 16 pixels with 64 paths each are rendered with n, n + 1
and n + 2 segments and the same random numbers. The differences of the pictures give the light D
that one further segment adds, and the factor r by which D decreases with each further segment. The
factor is assumed to be the same for all further segments, so paths of more than m segments add

    sum over k > m of D r^(k - n - 1) = D r^(m - n) (1 - r^(depth - m)) / (1 - r)

where D is taken from the brightest pixel, and r is two standard errors above the observed factor.
Light is given as radiance in W m^-2 sr^-1.
"""

from dataclasses import replace

import jax
import numpy as np

from ..scene import Scene, View
from ..transport import Paths, path_traced
from .bounces import DIRECT, pieces_row, shorter
from .stages import FAST, Row

_SIDE, _PATHS = 16, 64
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
    coarse = replace(
        view,
        resolution=(_SIDE, _SIDE),
        pixel_pitch=view.pixel_pitch * (max(view.resolution) / _SIDE),
    )
    pictures = [
        np.asarray(_probe(scene, coarse, Paths(_PATHS, pieces)), float)
        for pieces in (n, n + 1, n + 2)
    ]
    tails = tails_of(*pictures, n=n, depth=depth)
    return tuple(
        pieces_row(tail, pieces, depth, assumes=ASSUMED)
        for pieces, tail in zip(shorter(depth), tails, strict=True)
    )


def _traced(scene: Scene, view: View, method: Paths) -> jax.Array:
    return path_traced(jax.random.key(0), scene, view, method=method).radiance


_probe = jax.jit(_traced, compiler_options=FAST)


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
