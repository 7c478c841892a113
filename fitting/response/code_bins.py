"""Bins of codes, in which a response curve is represented. Codes are DN."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

MAX_BINS = 512  # 8- and 9-bit codes have a bin each


@dataclass(frozen=True)
class CodeBins:
    """The bins of codes in which a response curve is represented."""

    edges: Float[np.ndarray, " edges"]  # DN, ascending, halfway between codes
    lookup: Int[np.ndarray, " codes"]  # bin of every code; -1 at or below black and where clipped
    black: float  # DN without light
    anchor: float | None = None  # DN where g = 0; None for mid-scale
    black_sd: float = 0.0  # standard deviation of the black level, DN; 0 where exact

    @property
    def full_scale(self) -> int:
        return len(self.lookup) - 1

    @property
    def centres(self) -> Float[np.ndarray, " bins"]:
        return (self.edges[1:] + self.edges[:-1]) / 2

    @property
    def log_codes(self) -> Float[np.ndarray, " bins"]:
        """Mean of ln (code - black) over each bin, for light that is log-uniform within the bin."""
        above = np.maximum(self.edges[:-1] - self.black, (self.centres - self.black) / 4)
        return (np.log(above) + np.log(self.edges[1:] - self.black)) / 2

    def pace(self, codes: Float[np.ndarray, " codes"]) -> Float[np.ndarray, " codes"]:
        """Return, per DN, the derivative of a scale of codes on which measured curves have about
        constant roughness. The derivative is 1 / z + sqrt(F) / (F - z)^1.5, with z the code above
        black and F the full scale above black."""
        z = codes - self.black
        full = self.edges[-1] - self.black + 0.5
        return 1 / z + np.sqrt(full) / (full - z) ** 1.5

    @property
    def middle(self) -> int:
        """Index of the bin at which g = 0: at mid-scale, or at the anchor."""
        halfway = (self.black + self.edges[-1]) / 2
        return int(np.searchsorted(self.centres, halfway if self.anchor is None else self.anchor))


def code_bins(
    bits: int,
    black: float,
    clip: float,
    *,
    count: int = MAX_BINS,
    step: int = 1,
    origin: int = 0,
    black_sd: float = 0.0,
) -> CodeBins:
    """Make bins: one for each code, or of equal width in sqrt(DN - black) above `count`."""
    first = int(np.floor((black - origin) / step)) + 1
    last = min(int(np.ceil((clip - origin) / step)), (2**bits - 1 - origin) // step) - 1
    if last - first + 1 <= count:
        starts = np.arange(first, last + 2)
    else:
        even = np.linspace(0, np.sqrt(last + 1 - first), count + 1)
        starts = np.unique(np.round(first + even**2).astype(int))
    edges = origin + (starts - 0.5) * step
    lookup = np.searchsorted(edges, np.arange(2**bits), side="right") - 1
    lookup[int(np.ceil(edges[-1])) :] = -1
    return CodeBins(edges, lookup.astype(np.int32), black, black_sd=black_sd)


def interval_variance(means: Float[np.ndarray, " bins"]) -> Float[np.ndarray, " bins"]:
    """Return the variance of ln X within each bin for log-uniform light."""
    return np.gradient(means) ** 2 / 12
