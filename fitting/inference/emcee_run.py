"""Run emcee's ensemble sampler in blocks until the chain is long enough.

The sampler (Foreman-Mackey et al. 2013) evaluates half of its walkers in one call. A chain shorter
than 50 autocorrelation times is marked as too short, as emcee's documentation advises, because its
estimated autocorrelation time is itself unreliable. A chain can continue from memory or from its
checkpoint, with the same result as without interruption.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError

from .blocks import Block, Progress, length, next_length, resume_blocks, stack_blocks, store
from .convergence import autocorrelation_times, correct_bias
from .given import require_progress, require_whole

TIMES_TAU = 50  # shortest chain that is trusted, in autocorrelation times
BURN_IN_TAU = 5  # length of the discarded burn-in, in autocorrelation times
PATIENCE = 1.25  # growth of the chain from one assessment to the next
# A density estimated from half of 64 walkers fails in many dimensions. tau of a banana, KDE + DE:
# 15 at P = 5, 52 at 10, 260 at 20; DE alone: 37, 70, 131; stretch moves: 95, 171, 369.
MOST_FOR_KDE = 10
KDE_WALKERS = 256  # most walkers for a density estimate, whose cost is quadratic in their number
FLAT_CONDITION = 1e6  # condition number of the scaled directions above which walkers lie in a plane
HALVINGS = 60  # halvings of a walker's distance to the mode, after which it is there
IMPROPER = 1e9  # standard deviations from the mode; only walkers of an improper posterior get there


class Unbounded(InputError):
    """The error raised if a chain diverges.

    Attributes:
        parameter: name of the parameter that moved furthest.
    """

    def __init__(self, parameter: str) -> None:
        super().__init__(
            f"the walkers diverged: the data do not bound {parameter} on both sides; "
            "give it bounds or a prior, or more data."
        )
        self.parameter = parameter


@dataclass(frozen=True)
class Emcee:
    """Options of emcee's ensemble sampler, which needs no gradient.

    Attributes:
        walkers: smallest number of walkers, even and at least 4; P parameters take at least 2 P +
            2.
        steps: largest number of steps; sampling stops earlier once the chain spans enough
            autocorrelation times.
        block: number of steps between two checkpoints, at most `steps`.
        checkpoint: folder for the blocks; None keeps them in memory.
        progress: called with (steps done, largest number) after each block.
        gives_up: whether to stop at a quarter of `steps` where the chain would need far more than
            `steps`.

    Raises:
        InputError: for unusable numbers.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Emcee, Gaussian, Parameter, Problem, fit
        >>> free = {"gain": Parameter(start=1.0), "bias": Parameter(start=0.0)}
        >>> line = {"x": np.array([-1.0, 0.0, 1.0]), **free}
        >>> problem = Problem(line, jv.gain_bias, Gaussian(sd=0.1), np.array([1.0, 3.0, 5.0]))
        >>> found = fit(problem, posterior=Emcee(walkers=8))
        >>> found.converged, len(found.draws["gain"])
        (True, 8)
    """

    walkers: int = 64
    steps: int = 20_000
    block: int = 100
    checkpoint: Path | str | None = None
    progress: Progress | None = None
    gives_up: bool = False

    def __post_init__(self) -> None:
        for name in ("walkers", "steps", "block"):
            require_whole(name, getattr(self, name))
        require_progress(self.progress)
        if self.walkers < 4 or self.walkers % 2:
            raise InputError(f"walkers = {self.walkers}: use an even number of at least 4.")
        if self.steps < self.block:
            raise InputError(
                f"steps = {self.steps} with blocks of {self.block}: use at least one block."
            )


class SamplingOptions(Emcee):
    """Deprecated: use `Emcee`, which has the same fields.

    Attributes:
        walkers: smallest number of walkers.
        steps: largest number of steps.
        block: number of steps between two checkpoints.
        checkpoint: folder for the blocks; None keeps them in memory.
        progress: called with (steps done, largest number).
        gives_up: whether to stop early where a chain would need far more steps.

    Example:
        >>> from fitting import Emcee
        >>> Emcee(walkers=8).walkers
        8
    """

    def __post_init__(self) -> None:
        warnings.warn(
            "SamplingOptions is deprecated: write Emcee(...), as in "
            "fit(problem, posterior=Emcee(walkers=64)).",
            DeprecationWarning,
            stacklevel=3,
        )
        super().__post_init__()


def group_options(options: Emcee | None, group: str) -> Emcee | None:
    """Return the options with a checkpoint folder for one group (a colour channel), or None."""
    if options is None or options.checkpoint is None:
        return options
    name = group.replace(" ", "_").replace("/", "_")
    return replace(options, checkpoint=Path(options.checkpoint) / name)


def enough_walkers(options: Emcee, dimension: int) -> int:
    """Return the number of walkers of an ensemble for a number of parameters."""
    return max(options.walkers, 2 * dimension + 2)


@dataclass(frozen=True)
class Chain:
    """The draws of an ensemble after its burn-in."""

    vectors: Float[np.ndarray, "draws walkers parameters"]  # unconstrained values
    log_density: Float[np.ndarray, "draws walkers"]  # log density of the vectors
    # autocorrelation times in steps; infinite where a walker never moved
    tau: Float[np.ndarray, " parameters"]
    acceptance: float  # share of accepted proposals
    steps: int  # number of all steps, including the burn-in
    # estimated number of further steps that the chain needs; 0 where it is long enough
    missing_steps: int
    blocks: tuple[Block, ...]  # the whole chain, from which a longer run continues


def run_ensemble(
    log_density: Callable[[np.ndarray], np.ndarray],
    mode: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    *,
    names: Sequence[str],
    options: Emcee,
    seed: int,
    fingerprint: str,
    before: Sequence[Block] = (),
) -> Chain:
    """Run or resume an ensemble until its chain is long enough or at the limit of steps."""
    import emcee

    walkers = enough_walkers(options, mode.size)
    half = walkers // 2

    def evaluate(vectors: np.ndarray) -> np.ndarray:
        # Always half an ensemble, the size of every proposal: one shape, one compilation.
        parts = [vectors[i : i + half] for i in range(0, len(vectors), half)]
        return np.concatenate([log_density(part) for part in parts])

    sampler = emcee.EnsembleSampler(
        walkers, mode.size, evaluate, vectorize=True, moves=_moves(mode.size)
    )
    blocks = resume_blocks(options.checkpoint, before, fingerprint)
    deviation = np.sqrt(np.diagonal(covariance))
    if blocks:
        last = blocks[-1]
        generator = ("MT19937", last["keys"], *(last["position"][:2]), float(last["gauss"]))
        state = emcee.State(last["coords"], log_prob=last["log_prob"], random_state=generator)
    else:
        random = np.random.RandomState(seed)
        spread = np.linalg.cholesky(np.asarray(covariance, np.float64))
        standard = random.standard_normal((walkers, mode.size))
        state = emcee.State(mode + standard @ spread.T, random_state=random.get_state())
        state.log_prob = _move_to_support(evaluate, state.coords, mode)
    while (chain := _chain_if_done(blocks, options)) is None:
        sampler.reset()
        steps = next_length(length(blocks), options.block, options.steps)
        with threadpool_limits(1, user_api="blas"):  # matrices are too small for threads
            for after in sampler.sample(state, iterations=steps, skip_initial_state_check=True):
                reached = np.max(np.abs(after.coords - mode), axis=0) / deviation
                if not np.all(reached < IMPROPER):  # improper, before walkers overflow in emcee
                    raise Unbounded(names[int(np.argmax(np.nan_to_num(reached, nan=np.inf)))])
                state = after
        blocks.append(_block(sampler, state, fingerprint))
        store(options.checkpoint, len(blocks) - 1, blocks[-1])
        if options.progress is not None:
            options.progress(length(blocks), options.steps)
    return chain


def _moves(dimension: int) -> list[tuple[Any, float]]:
    """Return emcee's moves and their shares, without the snooker move (biased in emcee 3.1.6)."""
    from emcee.moves import DEMove, KDEMove

    class KDEOfSome(KDEMove):
        """Propose from some of the walkers, or from their differences if they lie in a plane."""

        def get_proposal(self, s: Any, c: Any, random: Any) -> Any:
            still = np.concatenate(c, axis=0)
            deviation = still.std(axis=0)
            if (
                not deviation.all()
                or np.linalg.cond((still - still.mean(axis=0)) / deviation) > FLAT_CONDITION
            ):
                return differences.get_proposal(s, c, random)
            if len(still) > KDE_WALKERS:
                still = still[random.choice(len(still), KDE_WALKERS, replace=False)]
            return super().get_proposal(s, [still], random)

    differences = DEMove()
    differences.setup(np.empty((0, dimension)))
    return [(KDEOfSome(), 0.6), (DEMove(), 0.4)] if dimension <= MOST_FOR_KDE else [(DEMove(), 1.0)]


def _block(sampler: Any, state: Any, fingerprint: str) -> Block:
    """Return the sampler's results since its last reset, and the state from which to continue."""
    _, keys, position, has_gauss, gauss = state.random_state
    return {
        "fingerprint": np.array(fingerprint),
        "chain": sampler.get_chain(),
        "log_chain": sampler.get_log_prob(),
        "accepted": np.array(np.sum(sampler.backend.accepted)),
        "coords": state.coords,
        "log_prob": state.log_prob,
        "keys": keys,
        "position": np.array([position, has_gauss]),
        "gauss": np.array(gauss),
    }


def _move_to_support(
    evaluate: Callable[[np.ndarray], np.ndarray], walkers: np.ndarray, mode: np.ndarray
) -> np.ndarray:
    """Return the log density of walkers, moved towards the mode where their density is zero."""
    found = evaluate(walkers)
    for _ in range(HALVINGS):
        nowhere = ~np.isfinite(found)
        if not nowhere.any():
            return found
        walkers[nowhere] = (walkers[nowhere] + mode) / 2
        found = evaluate(walkers)
    raise InputError(
        "The posterior has no density about the best fit, so that no chain can start: the model "
        "does not describe these data."
    )


def _due(steps: int, block: int) -> bool:
    """Return whether to assess the chain. An assessment costs as much as many steps, so the
    intervals between assessments grow. They depend only on the number of steps, so that an
    interrupted run gives the same chain."""
    blocks, rest = divmod(steps, block)
    if rest or blocks < 2:
        return rest == 0 and blocks == 1
    return math.log(blocks, PATIENCE) // 1 > math.log(blocks - 1, PATIENCE) // 1


def _chain_if_done(blocks: list[Block], options: Emcee) -> Chain | None:
    """Return the chain if it is long enough or at the limit of steps; None otherwise."""
    steps = length(blocks)
    last = steps >= options.steps
    if not (last or _due(steps, options.block)):
        return None
    vectors = stack_blocks(blocks, "chain")
    slowest = np.max(autocorrelation_times(vectors))
    start = int(min(np.ceil(BURN_IN_TAU * slowest), steps // 2))
    tau = autocorrelation_times(vectors[start:])
    missing = _missing(steps, steps - start, float(np.max(tau)))
    hopeless = options.gives_up and steps >= options.steps / 4 and missing > options.steps
    if missing and not (last or hopeless):
        return None
    return Chain(
        vectors=vectors[start:],
        log_density=stack_blocks(blocks, "log_chain")[start:],
        tau=tau,
        acceptance=sum(int(block["accepted"]) for block in blocks) / (steps * vectors.shape[1]),
        steps=steps,
        missing_steps=missing,
        blocks=tuple(blocks),
    )


def _missing(steps: int, settled: int, tau: float) -> int:
    """Estimate the steps, in hundreds, up to `TIMES_TAU` autocorrelation times after burn-in."""
    if settled >= TIMES_TAU * tau:
        return 0
    needed = min((TIMES_TAU + BURN_IN_TAU) * correct_bias(tau, settled), 10 * steps)
    return max(math.ceil((needed - steps) / 100), 1) * 100
