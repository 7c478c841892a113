"""Least squares for each pixel under different lights, and estimates of errors that all pixels
share.

A wrong intensity of a light, another exposure of its image and a drifting lamp scale an image as a
whole. Room light and a wrong black level add the same offset to all readings. With few lights a
pixel has only one or two residuals, which cannot determine these errors, but the residuals of all
pixels can. The factors of the lights, or the offset, are those that minimise the sum of squares
over all pixels. The vector g, albedo times normal, of each pixel is a nuisance parameter (variable
projection; Golub & Pereyra, Inverse Problems 19, 2003). The errors of the factors or of the offset
come from a jackknife over parts of the image, because parts disagree if the surface is not
Lambertian.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

FLAT = 1e-6  # least over largest singular value below which lights lie in a plane
ROUNDS, DONE = 40, 1e-6  # Gauss-Newton steps; largest change of a factor at convergence
TAIL = 2.4  # standard deviations from which a residual counts less (Cauchy's weights)
NORMAL_MAD = 1.4826  # the standard deviation of a Gaussian over its median absolute deviation
PARTS = 10  # parts of the image, each left out once
MOST, FEWEST = 2_000, 100  # most and fewest pixels of the estimate
LIT = 0.1  # share of the brightest pixels' mean reading above which pixels are used
UNLIT = 0.1  # -n.l from which a pixel surely faces away from a light
SMALL = 1e-4  # of the albedo: an offset in the shadow too small to change normals
CLEAR = 5.0  # standard errors from which a factor or offset is significant
DETERMINED = 10.0  # ratio to the part of the information on a factor that noise in g adds
WIDEST = 10.0  # largest factor of a light; beyond it, the direction is wrong or the light off
AT_ONCE, ROUNDED = 500, 1e-12  # pixels computed together; of the largest variance: rounding
EXPLAINED = 0.5  # least share of the residuals' squares that must be explained
# E l: of each light, or of each light and pixel, with near lights or a model linearised at g
Rows = Float[np.ndarray, "lights 3"] | Float[np.ndarray, "lights pixels 3"]
Readings = Float[np.ndarray, "lights pixels"]
Counted = Bool[np.ndarray, "lights pixels"]
Vectors = Float[np.ndarray, "pixels 3"]
Matrices = Float[np.ndarray, "pixels 3 3"]
OfPixels = Float[np.ndarray, " pixels"]
OfLights = Float[np.ndarray, " lights"]
Images = Float[np.ndarray, "lights h w"]


@dataclass(frozen=True)
class Common:
    """Errors that the readings of all pixels share, relative to m = E rho n.l."""

    factors: OfLights  # true over stated irradiance
    # their standard errors; 0 where factors are not fitted
    factor_sds: OfLights
    offset: float  # of all readings, in their unit
    offset_sd: float  # its standard error, in the same unit
    explained: float  # share of the residuals' sum of squares

    def removed(self, readings: Readings) -> np.ndarray:
        """Return the readings after removing the common error."""
        return (readings - self.offset) / self.factors[:, None]


def strengths_of(rows: Rows) -> Float[np.ndarray, "lights pixels"]:
    """Return the irradiance on surfaces that face the light; one column for distant lights."""
    return np.linalg.norm(rows, axis=-1).reshape(len(rows), -1)


def directions_of(rows: Rows) -> Float[np.ndarray, "lights 3"]:
    """Return the unit directions of the lights, for near lights their mean over the pixels."""
    toward = rows / np.linalg.norm(rows, axis=-1, keepdims=True)
    toward = toward.reshape(len(rows), -1, 3).mean(axis=1)
    return toward / np.linalg.norm(toward, axis=-1, keepdims=True)


def take_pixels(rows: np.ndarray, some: np.ndarray | slice) -> np.ndarray:
    """Return the rows of some pixels."""
    return rows if rows.ndim == 2 else rows[:, some]


def predicted(rows: Rows, g: Vectors) -> Readings:
    """Return the readings that a linear model predicts."""
    return rows @ g.T if rows.ndim == 2 else np.einsum("lpi,pi->lp", rows, g)


def solved(rows: Rows, readings: Readings, weights: Readings) -> tuple[np.ndarray, np.ndarray]:
    """Solve the weighted least squares of each pixel, and return g and the inverse of the normal
    matrix.
    """
    if rows.ndim == 2:
        products = (rows[:, :, None] * rows[:, None, :]).reshape(len(rows), 9)
        matrix = (weights.T @ products).reshape(-1, 3, 3)
    else:
        by_pixel = np.swapaxes(rows, 0, 1)
        matrix = np.swapaxes(by_pixel * weights.T[:, :, None], 1, 2) @ by_pixel
    sizes = np.linalg.eigvalsh(matrix)
    regular = sizes[:, 0] > FLAT**2 * sizes[:, 2]
    inverse = np.full_like(matrix, np.nan)
    inverse[regular] = np.linalg.inv(matrix[regular])
    known = np.where(weights > 0, weights * readings, 0)
    right = known.T @ rows if rows.ndim == 2 else np.einsum("lp,lpi->pi", known, rows)
    return np.einsum("pij,pj->pi", inverse, right), inverse


def light_covariance(
    rows: Rows,
    weights: Readings,
    inverse: Matrices,
    g: Vectors,
    covariance: Float[np.ndarray, "lights 4 lights 4"],
    distances: Float[np.ndarray, "lights pixels"] | None,
) -> Matrices:
    """Return the covariance of g from errors of the lights' directions and logarithms of
    intensities. With the weights w of the readings, the normal matrix M, the irradiance E, the
    light direction l and r = E l, the change of g is dg = -M^-1 sum w r (E dl.g + r.g d ln E).
    With near lights, a change ds of a position at the distance d changes r.g by
    E (g - 3 l l.g).ds / d.
    """
    flat = covariance.reshape(4 * len(rows), -1)
    sizes, axes = np.linalg.eigh(flat)
    seen = sizes > ROUNDED * sizes[-1]
    root = (axes[:, seen] * np.sqrt(sizes[seen])).reshape(len(rows), 4, -1)
    found = np.empty_like(inverse)
    for start in range(0, len(g), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        own, seen = take_pixels(rows, part), predicted(take_pixels(rows, part), g[part])
        own = np.broadcast_to(own if own.ndim == 3 else own[:, None], (*seen.shape, 3))
        pull = np.einsum("pij,kpj,kp->pki", inverse[part], own, weights[:, part])
        strength = np.linalg.norm(own, axis=-1, keepdims=True)
        slope = strength * g[part]
        if distances is not None:
            slope = (slope - 3 * own / strength * seen[:, :, None]) / distances[:, part, None]
        read = np.einsum("kpc,kcr->pkr", slope, root[:, :3])
        read += np.einsum("kp,kr->pkr", seen, root[:, 3])
        moved = np.swapaxes(pull, 1, 2) @ read
        found[part] = moved @ np.swapaxes(moved, 1, 2)
    return found


def common_departure(rows: Rows, readings: Readings, counts: Counted) -> Common | None:
    """Return the factors of the lights, or the offset, that all pixels share; None if neither
    explains the residuals.
    """
    some = _bright(readings, counts)
    if some.size < FEWEST:
        return None
    some = some[:: -(-len(some) // MOST)]
    own, counted = readings[:, some], counts[:, some]
    rows = take_pixels(rows, some)
    found = [_fit_common(rows, own, counted, by_offset=by) for by in (True, False)]
    found = [one for one in found if one is not None and one.explained > EXPLAINED]
    return max(found, key=lambda one: one.explained, default=None)


def offset_in_shadow(
    rows: Rows, readings: Readings, counts: Counted, measured: Readings
) -> Common | None:
    """Return an offset of all readings, estimated from pixels that face away from a light and
    should therefore read 0. The normals come from `readings` without highlights, and the offset
    from the `measured` readings."""
    some = _bright(readings, counts)
    own, rows = measured[:, some], take_pixels(rows, some)
    g, _ = solved(rows, readings[:, some], counts[:, some].astype(float))
    shades = predicted(rows, g) / strengths_of(rows) / np.linalg.norm(g, axis=1)
    unlit = (shades < -UNLIT) & ~np.isnan(own)
    parts = [own[:, part][unlit[:, part]] for part in np.array_split(np.arange(some.size), PARTS)]
    if min(part.size for part in parts) < FEWEST // PARTS:
        return None
    offset = float(np.median(own[unlit]))
    sd = float(np.std([np.median(part) for part in parts]) / np.sqrt(PARTS))
    if abs(offset) <= max(CLEAR * sd, SMALL * float(np.median(np.linalg.norm(g, axis=1)))):
        return None
    return Common(np.ones(len(rows)), np.zeros(len(rows)), offset, sd, 0.0)


def _bright(readings: Readings, counts: Counted) -> Int[np.ndarray, " some"]:
    """Return the pixels that have more than three readings and are not much darker than the other
    pixels."""
    mean = np.where(counts, readings, 0).sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
    known = (counts.sum(axis=0) > 3) & (mean > 0)
    least = np.quantile(mean[known], 0.95) if known.any() else np.inf
    return np.flatnonzero(known & (mean > LIT * least))


def _fit_common(
    rows: np.ndarray, readings: np.ndarray, counts: np.ndarray, *, by_offset: bool
) -> Common | None:
    """Fit factors or an offset by Gauss-Newton with Cauchy weights; None if the result is not
    determined or not significant.
    """
    factors, offset, weights = np.ones(len(rows)), 0.0, counts.astype(float)
    normals, rights, residuals = np.zeros((3, 0))
    for _ in range(ROUNDS):
        scaled, moved = (rows.T * factors).T, readings - offset
        g, inverse = solved(scaled, moved, weights)
        known = np.isfinite(g[:, 0])
        if not known.any():
            return None
        counts, weights = counts & known, weights * known
        fitted = np.nan_to_num(predicted(scaled, g))
        inverse[~known] = 0
        residuals = np.where(counts, moved - fitted, 0)
        normals, rights = _normal_parts(scaled, weights, inverse, fitted, residuals, by_offset)
        step = np.linalg.pinv(normals.sum(axis=0), rcond=FLAT, hermitian=True) @ rights.sum(axis=0)
        if by_offset:
            if not fitted.any():
                return None
            offset += float(step[0])
            size = abs(float(step[0])) / float(np.abs(fitted).max())
        else:
            factors = factors * np.exp(np.clip(step, -1, 1))
            size = float(np.abs(step).max())
        if size < DONE:
            break
        spread = NORMAL_MAD * float(np.median(np.abs(residuals[counts])))
        weights = counts / (1 + (residuals / max(TAIL * spread, 1e-300)) ** 2)
    alone = predicted(rows, solved(rows, readings, weights)[0])
    plain = np.where(weights > 0, readings - alone, 0)
    least, most = (float((weights * r**2).sum()) for r in (residuals, plain))
    noise = least * readings.shape[1] / max(int((counts.sum(axis=0) - 3).sum()), 1)
    normal = normals.sum(axis=0)
    undetermined = np.linalg.eigvalsh(normal) < DETERMINED * noise
    if most == 0 or undetermined.sum() > (0 if by_offset else 1):
        return None
    away = [
        np.linalg.pinv(normal - part, rcond=FLAT, hermitian=True) @ (rights.sum(axis=0) - right)
        for part, right in zip(normals, rights, strict=True)
    ]
    sds = np.sqrt((PARTS - 1) * np.var(away, axis=0))
    if by_offset:
        seen = abs(offset) > CLEAR * sds[0]
        found = Common(np.ones(len(rows)), np.zeros(len(rows)), offset, float(sds[0]), 0.0)
    else:
        factors /= np.sort(factors)[(len(factors) - 1) // 2]
        off = np.abs(np.log(factors))
        seen = bool((off > CLEAR * sds).any() and off.max() < np.log(WIDEST))
        found = Common(factors, factors * sds, 0.0, 0.0, 0.0)
    return replace(found, explained=1 - least / most) if seen else None


def _normal_parts(
    rows: np.ndarray,
    weights: np.ndarray,
    inverse: np.ndarray,
    fitted: np.ndarray,
    residuals: np.ndarray,
    by_offset: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal matrices and right sides of the common errors for each part of the image,
    with g eliminated.
    """
    change = weights if by_offset else weights * fitted
    right = change * residuals
    normals, rights, letters = [], [], "li" if rows.ndim == 2 else "lpi"
    for part in np.array_split(np.arange(fitted.shape[1]), PARTS):
        own_rows = take_pixels(rows, part)
        if by_offset:
            across = np.einsum(f"{letters},lp->pi", own_rows, change[:, part])[:, None]
            own = change[:, part].sum()[None, None]
            rights.append(right[:, part].sum()[None])
        else:
            across = np.einsum(f"{letters},lp->pli", own_rows, change[:, part])
            own = np.diag((change * fitted)[:, part].sum(axis=1))
            rights.append(right[:, part].sum(axis=1))
        lost = np.tensordot(across @ inverse[part], across, axes=([0, 2], [0, 2]))
        normals.append(own - lost)
    return np.array(normals), np.array(rights)
