"""Light that the parts of a surface send each other, from the normals and the images.

A matte facet i of albedo rho_i receives sum_j F_ij B_j from the facets that it sees, with form
factors F and radiosities B. If a surface that reflects all light has the albedo `white`, in the
unit of rho, the readings m_j of the facets are `white` B_j. In each image, interreflection
therefore adds rho_i / white sum_j F_ij m_j to the reading of facet i. The sum contains measured
readings only, so shadows and several reflections need no model. The shape comes from the normals:
slopes are integrated over a coarse grid of facets. The normals after subtraction of the added light
give the next shape.

Source:
    Nayar, Ikeuchi and Kanade, "Shape from Interreflections", International Journal of Computer
    Vision 6 (1991).
"""

from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float
from scipy import ndimage, sparse
from scipy.sparse.linalg import lsqr

from jaxvision import as_vec
from jaxvision.core.parallel_loops import map_
from jaxvision.transport.radiosity import point_to_polygon

from .lights import Images

ACROSS = 32  # facets along the longer side of the image
STEEPEST = 0.1  # least nz of a facet
STEPS = 24  # places on the line between two facets where it may be blocked
BELOW = 0.05  # of a facet's side: depth of a line below the surface that blocks it
FLAT = 0.01  # largest sum of form factors of a surface whose interreflection is neglected

Normals = Float[np.ndarray, "h w 3"]


@dataclass(frozen=True)
class Exchange:
    """Form factors between the facets of a surface.

    Attributes:
        block: side of a facet in pixels.
        known: (rows, columns) whether a block of pixels has a facet.
        table: (facets, facets) form factors F, no unit.
    """

    block: int
    known: np.ndarray
    table: Float[np.ndarray, "facets facets"]

    def irradiance(self, images: Images) -> Images:
        """Return sum_j F_ij m_j in each pixel, in the unit of the images: the readings of a white
        surface that only the other facets illuminate."""
        sent = _block_means(images, self.block)[:, self.known]
        received = np.zeros((len(images), *self.known.shape))
        received[:, self.known] = np.nan_to_num(sent) @ self.table.T
        nearest: Any = ndimage.distance_transform_edt(
            ~self.known, return_distances=False, return_indices=True
        )
        received = received[:, nearest[0], nearest[1]]
        places = (np.indices(images.shape[1:]) + 0.5) / self.block - 0.5
        return np.stack(
            [ndimage.map_coordinates(one, places, order=1, mode="nearest") for one in received]
        )


def side_of_facets(shape: tuple[int, ...]) -> int:
    """Return the default side of facets, in pixels, for images of this shape (h, w)."""
    return -(-max(shape) // ACROSS)


def exchange_of(normals: Normals, *, scale: int = 1) -> Exchange | None:
    """Return the form factors of the surface with these normals (x right, y up, z to the camera);
    None if its facets send each other at most a hundredth of their light. Facets have `scale` times
    the default side."""
    block = scale * side_of_facets(normals.shape[:2])
    mean = np.moveaxis(_block_means(np.moveaxis(normals, -1, 0), block), 0, -1)
    with np.errstate(invalid="ignore"):
        mean /= np.linalg.norm(mean, axis=-1, keepdims=True)
    known = mean[..., 2] > STEEPEST
    if known.sum() < 2:
        return None
    height, parts = _integrated(mean, known, block)
    row, column = np.nonzero(known)
    place = np.stack([block * column, -block * row, height[known]], axis=1)
    normal = mean[known]
    first, second = _facing(place, normal, parts[known], block)
    lines = np.stack([np.stack([row[k], column[k]]) for k in (first, second)])
    seen = _unblocked(height, block, lines, place[first, 2], place[second, 2])
    table = np.zeros((len(place), len(place)))
    first, second = first[seen], second[seen]
    if first.size == 0:
        return None
    half = block / 2
    corners = [
        place + np.stack([x, y, -(normal[:, 0] * x + normal[:, 1] * y) / normal[:, 2]], axis=1)
        for x, y in (half * np.broadcast_to(turn, (len(place), 2)).T for turn in _CORNERS)
    ]
    receiver, sender = np.r_[first, second], np.r_[second, first]
    filled = -(-receiver.size // _AT_ONCE) * _AT_ONCE - receiver.size
    pairs = [np.pad(k, (0, filled)).reshape(-1, _AT_ONCE) for k in (receiver, sender)]
    tables = [np.asarray(x, np.float32) for x in (place, normal, np.stack(corners))]
    found = np.asarray(_form_factors(*tables, *pairs)).ravel()
    table[receiver, sender] = found[: receiver.size]
    return Exchange(block, known, table) if table.sum(axis=1).max() > FLAT else None


_CORNERS = (-1, -1), (1, -1), (1, 1), (-1, 1)  # right and up, counterclockwise from above
_AT_ONCE = 16384


@jax.jit
def _form_factors(
    place: Float[Array, "facets 3"],
    normal: Float[Array, "facets 3"],
    corners: Float[Array, "4 facets 3"],
    receivers: Array,
    senders: Array,
) -> Array:
    def factor(receiver: Array, sender: Array) -> Array:
        a, b, c, d = (as_vec(corner[sender]) for corner in corners)
        return point_to_polygon(as_vec(place[receiver]), as_vec(normal[receiver]), (a, b, c, d))

    return map_(lambda pair: jax.vmap(factor)(*pair), (receivers, senders))


def _block_means(images: Float[np.ndarray, "n h w"], block: int) -> Float[np.ndarray, "n r c"]:
    """Return the means of the known pixels of each block; NaN if fewer than half are known."""
    beyond = [(0, 0), *((0, -size % block) for size in images.shape[1:])]
    padded = np.pad(images, beyond, constant_values=np.nan)
    shape = [size // block for size in padded.shape[1:]]
    cells = padded.reshape(len(images), shape[0], block, shape[1], block)
    finite = np.isfinite(cells)
    count = finite.sum(axis=(2, 4))
    mean = np.where(finite, cells, 0).sum(axis=(2, 4)) / np.maximum(count, 1)
    return np.where(2 * count >= block**2, mean, np.nan)


def _integrated(normals: Normals, known: np.ndarray, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Return heights in pixels, NaN where unknown, and labels of the connected parts. The heights
    fit the differences of neighbours, which are the means of their slopes, by least squares."""
    facing = np.where(known, normals[..., 2], 1)
    number = np.where(known, np.cumsum(known).reshape(known.shape) - 1, -1)
    starts, ends, rise = [], [], []
    for before, after, slope in (
        (np.s_[:-1], np.s_[1:], normals[..., 1] / facing),  # y falls with the row
        (np.s_[:, :-1], np.s_[:, 1:], -normals[..., 0] / facing),
    ):
        both = known[before] & known[after]
        starts.append(number[before][both])
        ends.append(number[after][both])
        rise.append(block / 2 * (slope[before] + slope[after])[both])
    start, end, difference = (np.concatenate(x) for x in (starts, ends, rise))
    rows = np.arange(start.size)
    matrix = sparse.csr_matrix(
        (np.r_[np.ones(rows.size), -np.ones(rows.size)], (np.r_[rows, rows], np.r_[end, start])),
        (rows.size, known.sum()),
    )
    height = np.full(known.shape, np.nan)
    height[known] = lsqr(matrix, difference, atol=1e-10, btol=1e-10)[0]
    parts: Any = ndimage.label(known)
    return height, parts[0]


def _facing(
    place: np.ndarray, normal: np.ndarray, part: np.ndarray, block: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of facets of one part that face each other, first before second."""
    first, second = np.triu_indices(len(place), 1)
    toward = place[second] - place[first]
    ahead = np.einsum("pi,pi->p", toward, normal[first])
    back = -np.einsum("pi,pi->p", toward, normal[second])
    some = (ahead > 0) & (back > 0) & (part[first] == part[second])
    return first[some], second[some]


def _unblocked(
    height: np.ndarray, block: int, ends: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Return whether the line between the middles of two facets stays above the surface."""
    seen = np.ones(first.size, bool)
    for share in (np.arange(STEPS) + 0.5) / STEPS:
        under = ndimage.map_coordinates(
            height, (1 - share) * ends[0] + share * ends[1], order=1, mode="nearest"
        )
        seen &= ~((1 - share) * first + share * second < under - BELOW * block)  # NaN: no surface
    return seen
