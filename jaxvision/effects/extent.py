"""Bound the change if a rectangular light is replaced by a small light at its centre.

The irradiance of a receiver point x is an integral over the lamp's points y. Its integrand is cos_l
cos_s / r^2 = H (n.(y - x)) / r^4, where r is the distance |y - x|, cos_l and cos_s are the cosines
at lamp and receiver, n is the receiver's normal, and H is the height of x above the lamp's plane.
The second derivative of the integrand with respect to y, along a unit vector t in the lamp's plane,
is H r^-5 [(24 c^2 - 4) cos_s - 8 c n.t], with c = t.(y - x) / r. For any normal n, this derivative
is at most H r^-5 sqrt((16 c^2 - 4)^2 + 64 c^2 (1 - c^2)), which is at most 12 H r^-5, its value at
c = 1. The error of the midpoint rule is at most half of 12 H r^-5 times m2 = (u^2 + v^2) / 12. Here
u and v are the lamp's sides, and m2 is the mean square distance of lamp points from the centre. So
the irradiance E of the lamp and E_middle of the small light differ by

    |E - E_middle| <= L A / d^2 (H / d) [6 m2 / (d^2 (1 - q)^5) + kink],   q = half diagonal / d

Here L is the lamp's radiance, A its area, and d the distance of x from its centre. The term kink =
sqrt(m2) / (2 d (1 - q)^4) is needed only if the receiver's horizon can cross the lamp. The light of
a specular lobe changes by its slope along the lamp, and by at most its largest value under either
light. This largest value is also the bound for points in a penumbra, and for lobes that become 0 at
a horizon which can cross the lamp. Lengths in m.
"""

import numpy as np

from ..core._bounds import Ends, Source
from ..scene import Light
from .cells import Cells
from .illumination import source_of, times
from .sums import Sums, geometry_of, lobe_sent, reflected_light, slopes

_MAX_RATIO = 0.9  # largest ratio of half the diagonal to the distance


def extent_change(sums: Sums, k: int) -> tuple[np.ndarray, Light | None, str]:
    """Bound the change of radiance of each cell, (c, bands) W m^-2 sr^-1, if a small light replaces
    the rectangular light k. Also return the small light and a description of the bound. If the
    rectangular light must not be replaced, return None and the reason instead."""
    nothing = np.zeros((len(sums.seen), sums.spectrum.shape[1]))
    own = sums.sources[k]
    if not own.even:
        return nothing, None, "a light field is not even"
    if own.small is None:
        return nothing, None, "a fit may change the lamp"
    if sums.visible[k]:
        return nothing, None, "the lamp may be seen"
    u, v, small = own.small
    place = source_of(Ends(small, small))
    half = float(max(np.linalg.norm(u + v), np.linalg.norm(u - v))) / 2
    m2 = (u @ u + v @ v) / 12
    d = _distance(place, sums.cells)
    q = np.where(d > 0, half / np.where(d > 0, d, 1), np.inf)
    near = q >= _MAX_RATIO
    q, some = np.where(near, 0, q), np.where(near | (d <= 0), 1, d)
    area = float(np.linalg.norm(np.cross(u, v)))
    over = _height(place, sums.cells)
    peak = area / some**2 * np.clip(over / some, 0, 1)
    crossed = _crosses(sums.cells, place, half)
    kink = np.where(crossed, np.sqrt(m2) / (2 * some * (1 - q) ** 4), 0)
    relative = 6 * m2 / (some**2 * (1 - q) ** 5) + kink
    of_cell, spectrum = sums.cells.surface, sums.spectrum[k]
    body = times((peak * relative)[:, None], times(sums.k_body, spectrum)[of_cell])
    at_place, lobe_at_place = _small_light_suprema(sums, k, place, area)
    either = np.maximum(reflected_light(sums, k), at_place + lobe_at_place)
    lobes = np.maximum(lobe_sent(sums, k), lobe_at_place)
    moved = _lobes(sums, k, lobes, peak, (q, some, float(np.sqrt(m2))))
    cut = np.array([own.lobe is not None and own.lobe.step for own in sums.reflections])[of_cell]
    total = body + np.where((cut & crossed)[:, None], lobes, moved)
    rough = np.array([np.any(own.plain) or own.grazing > 0 for own in sums.reflections])[of_cell]
    penumbra = sums.shaded[k]
    changed = np.where((rough | near | penumbra)[:, None], either, np.minimum(total, either))
    # even a dark lamp hides objects in a mirror
    mirrors = sums.mirrored[k] & (sums.k_mirror.max(1)[of_cell] > 0)
    changed = np.where(mirrors[:, None], np.inf, changed)
    return changed, small, "a rectangle as a place at its middle"


def _distance(place: Source, cells: Cells) -> np.ndarray:
    """Return the smallest distance, (c,) m, from the lamp's centre to the ball around each cell,
    or, for a flat cell, to the disc in its plane."""
    apart = place.places[0] - cells.centre
    ball = np.maximum(np.linalg.norm(apart, axis=1) - cells.radius, 0)
    height = np.abs((apart * cells.axis).sum(-1))
    along = np.sqrt(np.maximum((apart**2).sum(-1) - height**2, 0))
    reach = np.where(np.isinf(cells.radius), along, cells.radius)
    return np.where(cells.spread == 0, np.hypot(height, np.maximum(along - reach, 0)), ball)


def _height(place: Source, cells: Cells) -> np.ndarray:
    """Return the largest distance of a point of each cell above the lamp's plane, (c,) m."""
    over = (cells.centre - place.places[0]) @ place.normal
    return np.maximum(over + cells.radius, 0)


def _crosses(cells: Cells, place: Source, half: float) -> np.ndarray:
    """Return flags, (c,): whether the horizon of a receiver in each cell may cross the lamp."""
    apart = place.places[0] - cells.centre
    height = (apart * cells.axis).sum(-1)
    slack = half * np.sqrt(np.maximum(1 - (cells.axis @ place.normal) ** 2, 0))
    flat = (height > -slack) & (height < slack)
    distance = np.linalg.norm(apart, axis=1)
    tilt = np.arccos(np.clip(height / np.where(distance > 0, distance, 1), -1, 1))
    width = np.arcsin(np.clip((cells.radius + half) / np.maximum(distance, 1e-300), 0, 1))
    curved = np.abs(tilt - np.pi / 2) <= cells.spread + width
    return np.where(cells.spread == 0, flat, curved | (distance <= cells.radius + half))


def _lobes(
    sums: Sums,
    k: int,
    either: np.ndarray,
    peak: np.ndarray,
    lamp: tuple[np.ndarray, np.ndarray, float],
) -> np.ndarray:
    """Bound the change of the light of specular lobes, (c, bands), by the lobe's slope along the
    lamp and by the change of the irradiance. `either` bounds the light of the lobes under the
    rectangular lamp and under the small light."""
    q, d, rms = lamp
    of_cell = sums.cells.surface
    along = times(slopes(sums)[of_cell], peak * rms / (d * (1 - q)))
    moved = times(along[:, None], times(sums.k_lobe, sums.spectrum[k])[of_cell])
    return np.minimum(moved + times(either, (4 * q / (1 - q) ** 5)[:, None]), either)


def _small_light_suprema(
    sums: Sums, k: int, place: Source, area: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the suprema, (c, bands), of the radiance that a light of small size adds to each cell:
    by diffuse reflection and by lobes."""
    lobes = [own.lobe for own in sums.reflections]
    body, lobe = geometry_of(sums, place, np.zeros(len(lobes)), lobes)
    of_cell, spectrum = sums.cells.surface, sums.spectrum[k]
    return (
        times((area * body)[:, None], times(sums.k_body, spectrum)[of_cell]),
        times((area * lobe)[:, None], times(sums.k_lobe, spectrum)[of_cell]),
    )
