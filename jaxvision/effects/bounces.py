"""Bound interreflections: the largest radiance from paths of more than a given number of segments.

One more path segment applies an operator T to the largest radiance L_j of each surface j:

    T_i L = rho_i sum_j F_ij L_j + s_i sum_j G_ij L_j + m_i max L

Here rho_i, s_i and m_i are the reflectances of the diffuse part, the specular lobe, and the mirror
or glass of surface i. A mirror or glass may show the brightest radiance of the scene. F_ij is the
largest form factor from a point of i to j, by which the diffuse part of i weights the radiance of
j. F_ij is at most 1, and at most (R / d)^2 if the bounding ball of j has radius R and distance d
from i. F_ij is 0 if i is flat and j is entirely behind i. A specular lobe of i may point toward j,
which subtends a solid angle of at most 2 pi (R / d)^2. The lobe weights the radiance of j by at
most G_ij = min(1, g_i F_ij) with g_i = 2 pi sup(f_r cos) / s_i, where f_r cos is the shading of the
lobe. The weights of one surface sum to at most 1. The bound gives the brightest senders their
largest weights. A path from an emitting surface to the eye has one segment. A path from a lamp by
one reflection to the eye has two segments. The bound is sharp in open scenes with dark surfaces. In
a bright closed room the bound is far too large, so that long paths are not dropped.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..scene import Box, Sphere, TriangleMesh
from .bodies import Bodies, bounding_balls, heights, numbers, plane_of, surface_bodies
from .boxes import setting
from .cells import Cells, starts
from .illumination import times
from .stages import Row
from .sums import Sums, picture_maximum, reflected_light

EMITTED = 1  # segments of a path from an emitter: surface to eye
DIRECT = 2  # segments of a path of direct light: light to surface, surface to eye
_ORDERED = 2**16  # pairs of surfaces up to which the brightest senders are taken first
_EXACT_LENGTHS = 16  # segments up to which every path length is tried
_REMAINDER = 1e-12  # relative remainder at which a sum is truncated
_MAX_SEGMENTS = 400  # segments after which a sum that has not converged has no bound


def bounce_rows(onward: "Onward") -> tuple[Row, ...]:
    """Return a `Row` "bounces" for each of several limits n on the number of path segments,
    smallest n first. The bound of the `Row` is on the radiance of all paths of more than n
    segments, in W m^-2 sr^-1. The result is empty for direct light."""
    sums, depth = onward.sums, onward.depth
    if depth is None:
        return ()
    wanted = shorter(depth)
    emitted, lit = (
        onward.tails(light, [pieces - own + 1 for pieces in wanted], depth - own)
        for light, own in ((sums.sent_radiance, EMITTED), (onward.lamps, DIRECT))
    )
    return tuple(
        pieces_row(picture_maximum(sums, tail[sums.cells.surface]), pieces, depth)
        for pieces, tail in zip(wanted, emitted + lit, strict=True)
    )


def shorter(depth: int) -> list[int]:
    """List the numbers of segments to try below `depth`: all up to 16, then steps of a quarter."""
    found, pieces = [], DIRECT
    while pieces < depth:
        found.append(pieces)
        pieces = max(pieces + 1, pieces * 5 // 4 if pieces >= _EXACT_LENGTHS else 0)
    return found


def pieces_row(amount: np.ndarray, pieces: int, depth: int, *, assumes: str = "") -> Row:
    """Return the `Row` of a limit on path length: paths have at most `pieces` segments instead of
    `depth`. The dropped paths contribute at most `amount`, (bands,) W m^-2 sr^-1. `amount` is a
    proved bound if `assumes` is "". Otherwise `amount` is an estimate under the assumption
    `assumes`."""
    why, estimated = f"paths of at most {pieces} segments", bool(assumes)
    more = {"estimated": estimated, "assumes": assumes, "saves": 1 - pieces / depth}
    return Row("bounces", amount, why, setting("depth", to=pieces), ladder="bounces", **more)


class Transport(NamedTuple):
    """The operator T that one more path segment applies, between n surfaces; no units."""

    # body, lobe, mirror: (n,) the largest reflected share of light from all directions
    body: np.ndarray
    lobe: np.ndarray
    mirror: np.ndarray
    factors: np.ndarray  # (n, n) suprema of the shares of bodies, F
    of_lobes: np.ndarray  # (n, n) suprema of the shares of lobes, G

    @property
    def norm(self) -> float:
        """The operator norm of T in the maximum norm: the largest factor by which T changes the
        maximum of its argument."""
        body, lobe = (
            times(share, np.minimum(part.sum(1), 1))
            for share, part in ((self.body, self.factors), (self.lobe, self.of_lobes))
        )
        return float(np.max(body + lobe + self.mirror))

    def apply(self, sent: np.ndarray) -> np.ndarray:
        """Apply T to radiances, (n, bands) W m^-2 sr^-1."""
        return (
            times(self.body[:, None], gathered(self.factors, sent))
            + times(self.lobe[:, None], gathered(self.of_lobes, sent))
            + times(self.mirror[:, None], sent.max(0))
        )


class Onward:
    """Bounds the radiance of each cell after further reflections of its direct light."""

    def __init__(self, sums: Sums, depth: int | None) -> None:
        self.sums, self.depth = sums, depth
        if depth is not None:
            self.transport = _transport(sums)

    def __call__(
        self, cells: np.ndarray, around: np.ndarray | None = None, *, pieces: int = DIRECT
    ) -> np.ndarray:
        """Bound the radiance from cells to the eye after further reflections, (c, bands) W m^-2
        sr^-1. `cells` is the light that the cells send to the eye by paths of `pieces` segments.
        `around` is the largest light of this kind toward any viewer; None if it equals `cells`."""
        if self.depth is None:
            return cells
        least = largest(self.sums.cells, cells if around is None else around)
        total = self.series(least, self.depth - pieces)
        return cells + total[self.sums.cells.surface]

    def radiance_from(self, i: int, sent: np.ndarray) -> np.ndarray:
        """Bound the radiance of each surface, (n, bands), by later reflections of light that
        surface i reflects from the lamps, `sent` (bands,)."""
        assert self.depth is not None
        least = np.zeros_like(self.sums.sent_radiance)
        least[i] = sent
        return self.series(least, self.depth - DIRECT)

    @cached_property
    def may_be_seen(self) -> np.ndarray:
        """Flags, (n,): whether a pixel may see a cell of each surface."""
        return np.logical_or.reduceat(self.sums.seen, starts(self.sums.cells))

    @cached_property
    def norm(self) -> float:
        """The norm of the operator T."""
        return self.transport.norm

    @cached_property
    def lamps(self) -> np.ndarray:
        """A bound, (n, bands) W m^-2 sr^-1, on the light of lamps that each surface reflects."""
        found = np.zeros_like(self.sums.sent_radiance)
        for k in range(len(self.sums.sources)):
            found += largest(self.sums.cells, reflected_light(self.sums, k, around=True))
        return found

    @cached_property
    def earlier(self) -> np.ndarray:
        """A bound, (n, bands) W m^-2 sr^-1, on the radiance of each surface by paths of fewer than
        `depth` segments, whose light can reach another surface; 0 for direct light."""
        found = np.zeros_like(self.sums.sent_radiance)
        if self.depth is None:
            return found
        for own, pieces in ((self.sums.sent_radiance, EMITTED), (self.lamps, DIRECT)):
            if pieces < self.depth:
                found += own + self.series(own, self.depth - 1 - pieces)
        return found

    def diffuse_radiance(self, i: int) -> np.ndarray:
        """Bound the mean radiance, (bands,), that the diffuse part of surface i receives from
        others."""
        if self.depth is None:
            return self.earlier[i]
        return gathered(self.transport.factors[i : i + 1], self.earlier)[0]

    def lobe_radiance(self, i: int) -> np.ndarray:
        """Bound the mean radiance, (bands,), that the lobe of surface i receives from others."""
        return self.earlier[i] if self.depth is None else self._lobe_bounds[i]

    @cached_property
    def _lobe_bounds(self) -> np.ndarray:
        return _brightest_first(self.transport.of_lobes, self.earlier)

    def series(self, sent: np.ndarray, last: int) -> np.ndarray:
        """Return the sum of T^k `sent` over k from 1 to `last`, (n, bands). In a large scene all
        terms from the second on are bounded by the norm of T."""
        if self.transport.factors.size <= _ORDERED or last < 2:
            return self.tails(sent, [1], last)[0]
        once, t = self.transport.apply(sent), self.norm
        with np.errstate(over="ignore"):
            more = last - 1 if t == 1 else t * (1 - np.float64(t) ** (last - 1)) / (1 - t)
        return once + times(once.max(0), more)

    def tails(self, sent: np.ndarray, firsts: Sequence[int], last: int) -> np.ndarray:
        """Return, for each of the f starts in `firsts`, the sum of T^k `sent` over k from the start
        to `last`: (f, n, bands). The operator T multiplies the maximum by at most a factor t, its
        norm. So if t < 1, all later terms sum to at most t / (1 - t) times the maximum of the
        current term."""
        found, whole = np.zeros((len(firsts), *sent.shape)), np.zeros_like(sent)
        t = self.norm
        for k in range(1, min(last, _MAX_SEGMENTS) + 1):
            sent = self.transport.apply(sent)
            whole = whole + sent
            found[np.array(firsts) <= k] += sent
            if not np.isfinite(sent).all():
                break
            rest = times(sent.max(0), t / (1 - t) if t < 1 else np.inf)
            if rest.max() <= _REMAINDER * whole.max():
                return found + rest
        else:
            if last > _MAX_SEGMENTS:
                return np.full_like(found, np.inf)
        return np.where(np.isfinite(sent), found, np.inf)


def largest(cells: Cells, values: np.ndarray) -> np.ndarray:
    """Return the maximum of values, (c, bands), over the cells of each surface, (n, bands)."""
    return np.maximum.reduceat(values, starts(cells), axis=0)


def gathered(shares: np.ndarray, sent: np.ndarray) -> np.ndarray:
    """Return an upper bound on the light that arrives at each of i receiving surfaces, (i, bands),
    from n sending surfaces of radiance `sent`, (n, bands). The light on a receiver is a weighted
    sum of the senders' radiances. Each weight is at most `shares`, (i, n), and the weights of one
    receiver sum to at most 1. The bound gives the brightest senders their largest weights. In a
    large scene the bound is the radiance of the brightest sender, or the sum of all radiances times
    `shares` if that is less."""
    if shares.size > _ORDERED and np.isfinite(sent).all():
        lit = sent.any(axis=1)
        return np.minimum(shares[:, lit] @ sent[lit], sent.max(0))
    return _brightest_first(shares, sent)


def _brightest_first(shares: np.ndarray, sent: np.ndarray) -> np.ndarray:
    """Return the bound of `gathered` in which the brightest senders have the largest shares."""
    found = np.zeros((len(shares), sent.shape[1]))
    for band, own in enumerate(sent.T):
        order = np.argsort(-own)
        taken = np.minimum(np.cumsum(shares[:, order], axis=1), 1)
        found[:, band] = times(np.diff(taken, axis=1, prepend=0), own[order]).sum(1)
    return found


def _transport(sums: Sums) -> Transport:
    n, factors = len(sums.surfaces), _form_factors(sums)
    body, lobe, of_lobes = np.zeros(n), np.zeros(n), np.zeros((n, n))
    for i, own in enumerate(sums.reflections):
        body[i] = np.pi * (1 + own.grazing) * float(np.max(own.body))
        if own.lobe is not None:
            lobe[i] = float(np.max(own.lobe.spectrum)) * own.lobe.size
            of_lobes[i] = np.minimum(times(factors[i], own.lobe.gain), 1)
    return Transport(body, lobe, sums.k_mirror.max(1), factors, of_lobes)


def _form_factors(sums: Sums) -> np.ndarray:
    n, cells = len(sums.surfaces), sums.cells
    factors, first = np.ones((n, n)), starts(cells)
    bodies, bounded = surface_bodies(sums.surfaces)
    (middles, sizes), places = bounding_balls(bodies), cells.centre.T.copy()
    for j in np.flatnonzero(bounded):
        x, y, z = places - middles[j][:, None]
        apart = np.sqrt(x * x + y * y + z * z) - cells.radius
        d, size = np.minimum.reduceat(apart, first), sizes[j]
        factors[:, j] = np.where(d > size, (size / np.where(d > size, d, 1)) ** 2, 1)
    planes = [plane_of(surface.field("shape")) for surface in sums.surfaces]
    for i, plane in enumerate(planes):
        if plane is not None and not sums.surfaces[i].low.two_sided:
            point, normal = plane
            ahead = heights(Bodies(bodies.points - point, bodies.radii), normal[None])[:, 0] > 0
            for j in np.flatnonzero(~bounded):
                ahead[j] = _lies_in_front(plane, planes[j])
            factors[i] *= ahead
    for i, surface in enumerate(sums.surfaces):
        shape = surface.low.shape
        dented = isinstance(shape, TriangleMesh) or (
            surface.low.two_sided and isinstance(shape, Sphere | Box)
        )
        factors[i, i] = float(dented)
    return factors


def _lies_in_front(plane: tuple, other: tuple | None) -> bool:
    """Return whether a part of an unbounded surface lies in front of a plane. `other` is the plane
    of that surface, None if it is curved."""
    point, normal = plane
    if other is None or not np.allclose(np.abs(other[1] @ normal), 1):
        return True
    return bool((numbers(other[0]) - point) @ normal > 0)
