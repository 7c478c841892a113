"""Test whether normals belong to a surface in the axes of the image: x right, y up, z to the
camera.

The slopes p = -nx / nz and q = -ny / nz of a surface have no curl (Horn and Brooks, Computer
Vision, Graphics, and Image Processing 33, 1986). With the complex number g = p + i q, the
derivative (d/dx - i d/dy) g is therefore real at every pixel. If the axes of the lights are rotated
about the viewing axis, this derivative has the phase of the rotation angle at every pixel. If the
axes are mirrored, the derivative of the conjugate of g has that phase instead. If the signs of both
p and q are wrong, the slopes are those of the surface turned inside out, which has no curl either.
Only the border shows this: where a body ends steeply, its normals point outward.
"""

import numpy as np
from jaxtyping import Complex, Float
from scipy.ndimage import convolve

from ...inference.formatting import format_percent

STEEPEST = 0.3  # least nz: slopes at the rim of a body change too fast for differences
FEWEST = 50  # fewest cells of 2 x 2 blocks
BLOCKS = 24  # along the shorter side of the image
TURNING, LEFT = 0.2, 0.05  # share of the curl: reported in stated axes; largest in better ones
SMALLER = 2.5  # factor by which it is smaller in mirrored axes, for noisy normals
RIM, INWARD = 0.6, 0.9  # largest nz at a steep border; share that points inward in a hollow
AWAY = 0.5  # share of normals that point away from the camera


def axes_findings(
    normals: Float[np.ndarray, "h w 3"], viewer: Float[np.ndarray, "3"]
) -> tuple[str, ...]:
    """Return sentences on normals that point away from the camera, and on slopes with a curl."""
    facing = normals @ viewer
    known = np.isfinite(facing)
    away = float(np.mean(facing[known] < 0)) if known.any() else 0.0
    if away > AWAY:
        return (
            f"{format_percent(away)} of the normals point away from the camera, which lies at "
            f"viewer = {tuple(float(v) for v in viewer)}. Light directions point from the surface "
            "toward the light; if these point the other way, change the signs of all three "
            "numbers. If the axes are other ones, give viewer in them.",
        )
    if np.abs(viewer[:2]).max() > 1e-3:
        return ()
    across, along = _derivatives(normals, float(np.sign(viewer[2])))
    if len(across) < FEWEST:
        return ()
    slopes = float((np.abs(across) ** 2).sum())
    curl = float((np.imag(across) ** 2).sum()) / slopes if slopes > 0 else 0.0  # 0: a plane
    if curl < TURNING:
        return _hollow_finding(normals, float(np.sign(viewer[2])))
    up = "up" if viewer[2] > 0 else "down"
    found = []
    for mirrored, field in ((False, across), (True, along)):
        phasor = (field**2).sum() / max((np.abs(field) ** 2).sum(), np.finfo(float).tiny)
        found.append(((1 - abs(phasor)) / 2, mirrored, np.degrees(np.angle(phasor)) / 2))
    left, mirrored, angle = min(found)
    if left > (max(LEFT, curl / SMALLER) if mirrored else LEFT):
        return ()
    other = f"in axes that are rotated by {angle:.0f} or {angle + 180:.0f} degrees about z"
    if mirrored and abs(angle) < 20:
        other = f"in axes with x right and y {'down' if up == 'up' else 'up'} (or x left, y {up})"
    elif mirrored:
        other = "in mirrored axes, such as with x and y exchanged"
    return (
        f"In axes with x right and y {up} in the image, the normals belong to no surface: "
        f"{format_percent(curl)} of the squares of their derivatives are a curl. They belong to "
        f"one {other}. Check the axes of the lights and the order of the images.",
    )


def _hollow_finding(normals: Float[np.ndarray, "h w 3"], side: float) -> tuple[str, ...]:
    """Return a sentence on normals that point inward where the surface ends steeply."""
    known = np.isfinite(normals[..., 2])
    missing = np.pad(~known, 1, constant_values=False).astype(float)
    right, up = np.array([[1, 0, -1]] * 3), np.array([[-1] * 3, [0] * 3, [1] * 3])
    outward = [convolve(missing, kernel)[1:-1, 1:-1] for kernel in (right, up)]
    with np.errstate(invalid="ignore"):
        steep = known & (side * normals[..., 2] < RIM) & (np.hypot(*outward) > 0)
        along = normals[..., 0] * outward[0] + side * normals[..., 1] * outward[1]
    if steep.sum() < FEWEST or np.mean(along[steep] < 0) < INWARD:
        return ()
    return (
        "Where the surface ends, its normals point inward, as those of a bowl. If it is not hollow "
        "but bulges, x and y of the light directions have the wrong sign, or the images are "
        "rotated by 180 degrees.",
    )


def _derivatives(
    normals: Float[np.ndarray, "h w 3"], side: float
) -> tuple[Complex[np.ndarray, " cells"], Complex[np.ndarray, " cells"]]:
    """Return (d/dx - i d/dy) of g and of its conjugate, from means over blocks of pixels. The
    largest tenth of the values, which occur at edges of the surface, is reduced to the ninth
    decile.
    """
    nz = side * normals[..., 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        g = np.where(nz > STEEPEST, -(normals[..., 0] + 1j * side * normals[..., 1]) / nz, np.nan)
    block = max(1, min(g.shape) // BLOCKS)
    rows, columns = (length // block for length in g.shape)
    g = g[: rows * block, : columns * block].reshape(rows, block, columns, block).mean((1, 3))
    right = (g[1:, 1:] + g[:-1, 1:] - g[1:, :-1] - g[:-1, :-1]) / 2
    up = (g[:-1, 1:] + g[:-1, :-1] - g[1:, 1:] - g[1:, :-1]) / 2
    known = np.isfinite(right)
    right, up = right[known], up[known]
    fields = right - 1j * up, np.conj(right) - 1j * np.conj(up)
    if not known.any():
        return fields
    sizes = [np.abs(field) for field in fields]
    limits = [np.quantile(size, 0.9) / np.maximum(size, 1e-300) for size in sizes]
    return fields[0] * np.minimum(1, limits[0]), fields[1] * np.minimum(1, limits[1])
