"""Light that goes on from surface to surface: what paths of so many pieces can add at most.

With T_ij = rho_i F_ij the light of one more piece is T of the last, in the sup norm over each
surface. A form factor F_ij is at most 1, at most (R / d)^2 of the ball about j seen from i, and 0
where i is flat and j wholly behind it; those of a row sum to at most 1, which is spent on the
brightest first. A mirror or glass may pass on all of the brightest. Proof is good in open scenes;
in a bright closed room it is far too large, and its paths are kept.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..scene import Box, Sphere, TriangleMesh
from .bodies import Bodies, body_of, heights, numbers
from .cells import plane_between
from .certificate import RADIANCE, Effect
from .illumination import times
from .stages import Draft, Row
from .sums import Sums, pictured, sent

DIRECT = 2  # pieces of a path of direct light: light to surface, surface to eye
_EACH = 16  # pieces up to which paths may be cut to any number
_SETTLED = 1e-12  # of a sum: what may be left of it when it is ended
_MOST = 400  # pieces after which a sum that does not settle has no bound


def bounce_rows(sums: Sums, depth: int | None) -> tuple[Row, ...]:
    """Rows "bounces", of the shortest paths first: what paths of more pieces than n add at most.

    Args:
        sums: of the scene.
        depth: pieces of the longest path that is followed; None: direct light, no rows.

    Returns:
        The rows; bounds in W m^-2 sr^-1.
    """
    if depth is None:
        return ()
    onward, n = Onward(sums, depth), len(sums.surfaces)
    first = np.searchsorted(sums.cells.surface, np.arange(n))
    shone = sums.own + sum(
        np.maximum.reduceat(sent(sums, k), first, axis=0) for k in range(len(sums.sources))
    )
    wanted = shorter(depth)
    tails = onward.tails(shone, [pieces - DIRECT + 1 for pieces in wanted], depth - DIRECT)
    return tuple(
        pieces_row(pictured(sums, tail[sums.cells.surface]), pieces, depth)
        for pieces, tail in zip(wanted, tails, strict=True)
    )


def shorter(depth: int) -> list[int]:
    """Numbers of pieces below `depth` that paths may be cut to: each up to 16, from there on in
    steps of a quarter."""
    found, pieces = [], DIRECT
    while pieces < depth:
        found.append(pieces)
        pieces = max(pieces + 1, pieces * 5 // 4 if pieces >= _EACH else 0)
    return found


def pieces_row(amount: np.ndarray, pieces: int, depth: int, *, assumes: str = "") -> Row:
    """The row of paths of at most so many pieces.

    Args:
        amount: (bands,) W m^-2 sr^-1 that longer ones add at most.
        pieces: that are left.
        depth: that were followed.
        assumes: "" where that is proved, else what an estimate rests on.
    """
    bound = float(np.max(amount))
    why = f"paths of at most {pieces} pieces"
    rank = "estimate" if assumes else "exact" if bound == 0 else "bound"
    effect = Effect("bounces", True, why, bound, unit=RADIANCE, rank=rank)

    def drop(draft: Draft) -> Draft:
        return replace(draft, depth=pieces)

    saves = 1 - pieces / depth
    return Row(effect, amount, drop, assumes=assumes, ladder="bounces", saves=saves)


class Onward:
    """From what each cell sends at first to the most that it sends after all further pieces."""

    def __init__(self, sums: Sums, depth: int | None) -> None:
        self.sums, self.depth = sums, depth
        if depth is not None:
            self.albedo, self.mirror, self.factors = _transport(sums)

    def __call__(self, cells: np.ndarray) -> np.ndarray:
        """(c, bands) W m^-2 sr^-1 to the same."""
        if self.depth is None:
            return cells
        n = len(self.sums.surfaces)
        first = np.searchsorted(self.sums.cells.surface, np.arange(n))
        least = np.maximum.reduceat(cells, first, axis=0)
        total = self.series(least, 1, self.depth - DIRECT)
        return cells + total[self.sums.cells.surface]

    def series(self, sent: np.ndarray, first: int, last: int) -> np.ndarray:
        """The sum of T^k of what is sent, (n, bands), k from `first` to `last`, inclusive."""
        return self.tails(sent, [first], last)[0]

    def tails(self, sent: np.ndarray, firsts: Sequence[int], last: int) -> np.ndarray:
        """The same for each of several `firsts`: (f, n, bands). T shrinks the largest of all by t
        at least, so that what follows a term is at most t / (1 - t) of its largest."""
        found, whole = np.zeros((len(firsts), *sent.shape)), np.zeros_like(sent)
        t = np.max(self.albedo * np.minimum(self.factors.sum(1), 1) + self.mirror)
        for k in range(1, min(last, _MOST) + 1):
            sent = np.stack([self._once(band) for band in sent.T], axis=1)
            whole = whole + sent
            found[np.array(firsts) <= k] += sent
            if not np.isfinite(sent).all():
                break
            rest = times(sent.max(0), t / (1 - t) if t < 1 else np.inf)
            if rest.max() <= _SETTLED * whole.max():
                return found + rest
        else:
            if last > _MOST:
                return np.full_like(found, np.inf)
        return np.where(np.isfinite(sent), found, np.inf)

    def _once(self, sent: np.ndarray) -> np.ndarray:
        order = np.argsort(-sent)
        taken = np.minimum(np.cumsum(self.factors[:, order], axis=1), 1)
        spent = np.diff(taken, axis=1, prepend=0)
        seen = times(spent, sent[order]).sum(1)
        return times(self.albedo, seen) + times(self.mirror, sent.max())


def _transport(sums: Sums) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) albedos and reflectances of mirrors, (n, n) suprema of form factors."""
    albedo = np.zeros(len(sums.surfaces))
    for i, own in enumerate(sums.reflections):
        lobe = 0.0 if own.lobe is None else float(np.max(own.lobe.spectrum)) * own.lobe.size
        albedo[i] = np.pi * (1 + own.grazing) * float(np.max(own.body)) + lobe
    return albedo, sums.k_mirror.max(1), _form_factors(sums)


def _form_factors(sums: Sums) -> np.ndarray:
    n = len(sums.surfaces)
    factors = np.ones((n, n))
    found = [body_of(surface.of("shape")) for surface in sums.surfaces]
    planes = [plane_between(surface.of("shape")) for surface in sums.surfaces]
    cells = sums.cells
    first = np.searchsorted(cells.surface, np.arange(n))
    for j, body in enumerate(found):
        if body is not None:
            points, radii = body
            middle = (points.min(0) + points.max(0)) / 2
            size = (np.linalg.norm(points - middle, axis=1) + radii).max()
            apart = np.linalg.norm(cells.centre - middle, axis=1) - cells.radius
            d = np.minimum.reduceat(apart, first)
            factors[:, j] = np.where(d > size, (size / np.where(d > size, d, 1)) ** 2, 1)
        for i, plane in enumerate(planes):
            if plane is not None and not sums.surfaces[i].low.two_sided:
                factors[i, j] *= _in_front(plane, body, planes[j])
    for i, surface in enumerate(sums.surfaces):
        shape = surface.low.shape
        dented = isinstance(shape, TriangleMesh) or (
            surface.low.two_sided and isinstance(shape, Sphere | Box)
        )
        factors[i, i] = float(dented)
    return factors


def _in_front(plane: tuple, body: tuple | None, other: tuple | None) -> bool:
    """Whether any of a body, or of an endless plane, lies before a flat surface."""
    point, normal = plane
    if body is None:
        if other is None or not np.allclose(np.abs(other[1] @ normal), 1):
            return True
        return bool((numbers(other[0]) - point) @ normal > 0)
    points, radii = body
    high = heights(Bodies((points - point)[None], radii[None]), normal[None])[0, 0]
    return bool(high > 0)
