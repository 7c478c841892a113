"""Bound the difference in the radiance of a point as seen from two points of a lens, in W m^-2
sr^-1.

Matte surfaces, emitters and lamps of uniform radiance look the same from all directions. A point in
focus on such a surface therefore looks the same through every part of the lens. The radiance of a
specular lobe changes by at most its slope times the angle that the lens subtends, and by at most
its largest value. The radiance of a diffuse part that is not Lambertian is that of a Lambertian
surface plus a difference. It changes by at most twice the bound of this difference, and by at most
its largest value. A mirror or glass may show
different objects to different parts of the lens, so there is no bound.
"""

import numpy as np

from .angles import cos_seen
from .bounces import Onward
from .illumination import times
from .sums import Sums, lobe_sent, picture_maximum, slopes


def lens_spread_bound(sums: Sums, onward: Onward) -> np.ndarray:
    """Bound the difference in the radiance of any visible point between two points of the lens,
    (bands,) W m^-2 sr^-1. The bound is 0 for a pinhole, and inf if a mirror or glass is in view.
    `onward` bounds the light after further reflections."""
    eye, cells, of_cell = sums.eye, sums.cells, sums.cells.surface
    radius = eye.size - eye.moves
    if radius <= 0:
        return np.zeros(sums.spectrum.shape[1])
    apart = np.linalg.norm(cells.centre - eye.place, axis=1) - cells.radius - eye.size
    near = apart <= radius / 2
    turn = np.where(near, np.pi, 2 * np.arcsin(radius / 2 / np.where(near, radius, apart)))
    steep = slopes(sums)[of_cell]
    grazing = np.array([own.grazing for own in sums.reflections])[of_cell]
    # a shading normal may face one part of the lens and not another
    smooth = np.array(
        [getattr(own.low.shape, "normals", None) is not None for own in sums.surfaces]
    )
    bent = (smooth[of_cell] & (cos_seen(cells, eye)[0] <= 0))[:, None]
    bands = sums.spectrum.shape[1]
    plain = np.array([np.broadcast_to(own.plain, bands) for own in sums.reflections])
    total = _interreflection_bound(sums, onward, plain, smooth)[of_cell]
    for k, spectrum in enumerate(sums.spectrum):
        even, facing = sums.body[k][:, None], sums.facing[k][:, None]
        of_body = times(sums.k_body, spectrum)[of_cell]
        lobe, body = lobe_sent(sums, k), times(even, of_body)
        along = times(facing, times(steep, turn)[:, None])
        turned = np.minimum(times(along, times(sums.k_lobe, spectrum)[of_cell]), lobe)
        uneven = times(even, times(plain, spectrum)[of_cell])
        uneven = uneven + times(facing, times(grazing[:, None], of_body))
        total = total + np.where(bent, lobe + body, turned + np.minimum(2 * uneven, body))
    total = np.where(sums.k_mirror.max(1)[of_cell, None] > 0, np.inf, total)
    lamps = [not source.even for source in sums.sources]
    return np.maximum(picture_maximum(sums, total), sums.shown[lamps].max(0, initial=0))


def _interreflection_bound(
    sums: Sums, onward: Onward, plain: np.ndarray, smooth: np.ndarray
) -> np.ndarray:
    """Bound this difference for light reflected between surfaces, (n, bands) W m^-2 sr^-1."""
    found = np.zeros_like(sums.sent_radiance)
    if onward.depth is None:
        return found
    for i, own in enumerate(sums.reflections):
        whole = np.pi * (1 + own.grazing) * sums.k_body[i]
        uneven = 2 * np.pi * (plain[i] + times(sums.k_body[i], 2 * own.grazing))
        found[i] = times(
            whole if smooth[i] else np.minimum(uneven, whole), onward.diffuse_radiance(i)
        )
        if own.lobe is not None:
            found[i] += times(own.lobe.size * sums.k_lobe[i], onward.lobe_radiance(i))
    return found
