"""Efficiency of fits to histograms of codes: the variance of the estimates compared with the
Cramer-Rao bound.

    python -m fitting.checks.counts

For each value of read noise, histograms of codes at two levels of light are simulated and fitted by
`fit_map`, with one gain, read noise and black level for both levels. If read noise hides single
electrons, these two histograms do not determine black level, read noise and light. In that case a
third histogram, of darks, is fitted together with these two. The bound is the inverse of the Fisher
information of the exact distribution of the codes, summed over the codes in NumPy. The derivatives
of the codes' probabilities are central differences.
"""

from dataclasses import dataclass
from itertools import product

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import norm, poisson

from jaxvision import PoissonShotNoise, Sensor

from ..fits.pixels import fit_map
from ..inference.parameters import Parameter
from ..inference.precision import double_precision
from ..inference.problem import Problem
from ..sensor_likelihoods import SensorCounts

NAMES = ("gain", "read_noise", "black", "electrons[0]", "electrons[1]")
BLACK, ELECTRONS = 40.0, (1.0, 6.0)
GAINS = {0.2: 3.0, 0.5: 3.0, 1.0: 3.0, 5.0: 0.5}  # DN/e-, by read noise in e-
HIDING = 2.0  # read noise, e-, above which a table without light is fitted, too
CHUNK = 50  # fits at once
NUMBERS = (200_000, 20_000)  # of each table
FITS, SEED = 3000, 7  # of the page of coverage
DIFFERENCE = 1e-4  # relative step of the derivatives
REACH = 8.5  # half-width of the sum, in read noises


@dataclass(frozen=True)
class Efficiency:
    """The Cramer-Rao bound divided by the variance of the estimates, at one read noise."""

    read_noise: float  # of the simulated sensor, e-
    fits: int  # number of fits that converged
    # the bound over the variance of the estimates, in the order of `NAMES`
    ratios: Float[np.ndarray, " parameters"]
    # the bound over the variance of the estimates for all parameters together, from their whitened
    # squared errors. These are errors of the black level and of the logarithms of all other
    # parameters.
    whole: float
    # mean of the variances that the fits report, divided by the variance of the estimates
    claimed: Float[np.ndarray, " parameters"]


def shares(
    values: Float[np.ndarray, " parameters"], codes: np.ndarray, *, dark: bool
) -> np.ndarray:
    """Return the (levels, codes) probability of each code by a direct sum over electrons."""
    gain, read_noise, black, *electrons = values
    electrons = [*[0.0] * dark, *electrons]
    n = np.arange(200)
    law = norm(black + gain * n[:, None], gain * read_noise)
    inside = law.cdf(codes + 0.5) - law.cdf(codes - 0.5)
    return np.stack([poisson.pmf(n, mean) @ inside for mean in electrons])


def information(
    values: Float[np.ndarray, " parameters"], codes: np.ndarray, numbers: int, *, dark: bool
) -> Float[np.ndarray, "parameters parameters"]:
    """Return the Fisher information of several histograms that each contain `numbers` codes."""
    slopes = []
    for i, value in enumerate(values):
        step = np.where(np.arange(len(values)) == i, DIFFERENCE * value, 0)
        moved = shares(values + step, codes, dark=dark) - shares(values - step, codes, dark=dark)
        slopes.append(moved / (2 * DIFFERENCE * value))
    probability = np.maximum(shares(values, codes, dark=dark), 1e-300)
    return numbers * np.einsum("ilc,jlc->ij", np.stack(slopes) / probability, np.stack(slopes))


@double_precision
def efficiency(
    read_noise: float, simulations: int, *, numbers: int = NUMBERS[0], seed: int = 0
) -> Efficiency:
    """Simulate and fit histograms; compare the variance of estimates with the bound."""
    gain, dark = GAINS[read_noise], read_noise > HIDING
    truth = np.array([gain, read_noise, BLACK, *ELECTRONS])
    beyond = REACH * gain * read_noise
    codes = np.arange(np.floor(BLACK - beyond), np.ceil(BLACK + gain * 26 + beyond))
    law = shares(truth, codes, dark=dark)
    rng = np.random.default_rng(seed)
    drawn = np.stack([rng.multinomial(numbers, p / p.sum(), simulations) for p in law])
    sensor = Sensor(shot_noise=PoissonShotNoise(), read_noise=read_noise, gain=gain, offset=BLACK)
    free = {
        "sensor.gain": Parameter(transform="log"),
        "sensor.read_noise": Parameter(transform="log"),
        "sensor.offset": Parameter(),
        "electrons": Parameter(shape=(2,), transform="log", start=ELECTRONS),
    }
    problem = Problem(
        free,
        lambda electrons, inputs: jnp.pad(electrons, (dark, 0))[:, None] * inputs,
        SensorCounts("sensor", int(np.ceil(REACH * read_noise + 1 / gain)), codes=codes),
        drawn[:, 0],
        inputs=np.ones_like(law),
        records={"sensor": sensor},
    )
    found = fit_map(problem, np.moveaxis(drawn, 1, 2), starts=1, chunk=CHUNK)
    estimates, errors = (
        np.concatenate([np.reshape(of[name], (-1, simulations)) for name in free])
        for of in (found.estimate, found.sd)
    )
    there = np.isfinite(estimates).all(axis=0)
    missed = estimates[:, there] - truth[:, None]
    bound = information(truth, codes, numbers, dark=dark)
    # In logarithms, in which a constant product of gain and light is a straight line.
    scale = np.where(np.isin(NAMES, ["black"]), 1.0, truth)
    relative = np.log(estimates[:, there] / truth[:, None])
    relative[NAMES.index("black")] = missed[NAMES.index("black")]
    squares = np.einsum("in,ij,jn->n", relative, bound * np.outer(scale, scale), relative)
    scatter = np.mean(missed**2, axis=1)
    return Efficiency(
        read_noise=read_noise,
        fits=int(there.sum()),
        ratios=np.diagonal(np.linalg.inv(bound)) / scatter,
        whole=len(truth) / float(squares.mean()),
        claimed=np.mean(errors[:, there] ** 2, axis=1) / scatter,
    )


if __name__ == "__main__":
    for noise, numbers in product(GAINS, NUMBERS):
        one = efficiency(noise, FITS, numbers=numbers, seed=SEED)
        figures = " | ".join(f"{ratio:.3f}" for ratio in (*one.ratios, one.whole))
        print(f"| {noise:g} | {numbers:,} | {one.fits} | {figures} |")
