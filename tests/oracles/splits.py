"""Compare curves from disjoint parts of one stack with their stated errors."""

from collections.abc import Iterator

import numpy as np

from fitting.response.clipping import clear_of_clipping
from fitting.response.curve import ResponseCurve, fit_response_curve
from fitting.response.places import layout_of

Parts = tuple[np.ndarray, np.ndarray]


def halves(shape: tuple[int, int]) -> Iterator[Parts]:
    """Yield masks of left and right, top and bottom, and two checkerboards."""
    rows, columns = np.indices(shape)
    for square in (shape[0] // 2, shape[0] // 6, 8):
        first = (rows // square + columns // square) % 2 == 0
        if square == shape[0] // 2:
            yield columns < shape[1] // 2, columns >= shape[1] // 2
            first = rows < square
        yield first, ~first


def fitted(
    codes: np.ndarray, mask: np.ndarray, times: np.ndarray, *, black: float, clip: float
) -> ResponseCurve:
    """Return the curve of 8-bit codes (exposures, h, w) under a mask."""
    layout = layout_of(codes, mask, black=black, clip=clip)
    codes = clear_of_clipping(codes, clip, mask=mask)
    return fit_response_curve(codes[:, mask], times, bits=8, black=black, clip=clip, layout=layout)


def apart(one: ResponseCurve, other: ResponseCurve) -> tuple[np.ndarray, np.ndarray]:
    """Compare two curves at the codes seen in both, except mid-scale, where both are 0. Return the
    differences in standard errors, and whether they are within both 95 % intervals."""
    seen = one.seen & other.seen & (one.log_exposure != other.log_exposure)
    gap = (one.log_exposure - other.log_exposure)[seen]
    error = np.hypot(one.standard_error, other.standard_error)[seen]
    band = np.hypot(one.half_width, other.half_width)[seen]
    return gap / error, np.abs(gap) <= band


def split_tests(
    codes: np.ndarray, mask: np.ndarray, times: np.ndarray, *, black: float, clip: float
) -> tuple[float, float]:
    """Return (rms z, share of codes within their intervals) over halves, checkerboards and, for
    eight exposures and more, even and odd ones."""
    scores, inside = [], []
    known = {"black": black, "clip": clip}
    pairs = [
        (fitted(codes, mask & one, times, **known), fitted(codes, mask & other, times, **known))
        for one, other in halves(mask.shape)
    ]
    if len(times) >= 8:
        pairs.append(
            (
                fitted(codes[::2], mask, times[::2], **known),
                fitted(codes[1::2], mask, times[1::2], **known),
            )
        )
    for one, other in pairs:
        z, within = apart(one, other)
        scores.append(np.mean(z**2))
        inside.append(within.mean())
    return float(np.sqrt(np.mean(scores))), float(np.mean(inside))
