"""Runs of emcee's ensemble sampler in blocks, each stored as soon as it is complete.

The sampler (Foreman-Mackey et al. 2013) evaluates half of its walkers in one call. A killed run
resumes from its last block and ends bit-identical. A chain shorter than 50 autocorrelation times is
refused (Sokal's window, as emcee documents it): its autocorrelation time cannot be trusted.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError
from jaxvision.io import replaced_on_success

Progress = Callable[[int, int], None]
Block = dict[str, np.ndarray]

TIMES_TAU = 50  # shortest chain that is reported, in autocorrelation times
BURN_IN_TAU = 5  # discarded before anything is read off, in autocorrelation times


@dataclass(frozen=True)
class SamplingOptions:
    """How to run the ensemble.

    Attributes:
        walkers: how many, even and at least 4.
        steps: ceiling; sampling stops once the chain holds enough autocorrelation times.
        block: steps between two checkpoints, at most `steps`.
        checkpoint: folder of the blocks, None to keep them in memory.
        progress: called with (steps done, ceiling) after each block.

    Raises:
        InputError: for unusable numbers.
    """

    walkers: int = 64
    steps: int = 20_000
    block: int = 100
    checkpoint: Path | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        if self.walkers < 4 or self.walkers % 2:
            raise InputError(f"walkers = {self.walkers}: use an even number of at least 4.")
        if self.block < 1 or self.steps < self.block:
            raise InputError(
                f"steps = {self.steps} with blocks of {self.block}: use at least one block of one."
            )


def for_group(options: SamplingOptions | None, group: str) -> SamplingOptions | None:
    """The same options with a checkpoint folder of its own for one group (a colour channel).

    Args:
        options: of all groups; None stays None.
        group: its name, made fit for a folder.

    Returns:
        The options of the group.
    """
    if options is None or options.checkpoint is None:
        return options
    name = group.replace(" ", "_").replace("/", "_")
    return replace(options, checkpoint=options.checkpoint / name)


@dataclass(frozen=True)
class Chain:
    """A chain that is long enough, burn-in removed.

    Attributes:
        vectors: (steps, walkers, parameters).
        log_density: (steps, walkers).
        tau: (parameters,) autocorrelation times in steps.
        acceptance: share of accepted proposals.
        steps: all that were taken, burn-in included.
    """

    vectors: Float[np.ndarray, "draws walkers parameters"]
    log_density: Float[np.ndarray, "draws walkers"]
    tau: Float[np.ndarray, " parameters"]
    acceptance: float
    steps: int


def run_ensemble(
    log_density: Callable[[np.ndarray], np.ndarray],
    mode: Float[np.ndarray, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    *,
    options: SamplingOptions,
    seed: int,
    fingerprint: str,
) -> Chain:
    """Runs, or resumes, an ensemble until its chain is long enough.

    Args:
        log_density: (walkers / 2, parameters) to (walkers / 2,), -inf where impossible.
        mode: (parameters,) about which the walkers start.
        covariance: (parameters, parameters) of the Gaussian from which they start.
        options: walkers, ceiling, block, checkpoint and progress.
        seed: of every draw.
        fingerprint: of everything that decides the chain; stored with each block.

    Returns:
        The settled part of the chain.

    Raises:
        InputError: when the ceiling is reached before 50 autocorrelation times (with a checkpoint
            a longer run continues where this one stopped), and for a checkpoint of another run.
    """
    import emcee

    half = options.walkers // 2

    def evaluate(vectors: np.ndarray) -> np.ndarray:
        # Always half an ensemble, the size of every proposal: one shape, one compilation.
        parts = [vectors[i : i + half] for i in range(0, len(vectors), half)]
        return np.concatenate([log_density(part) for part in parts])

    sampler = emcee.EnsembleSampler(
        options.walkers,
        len(mode),
        evaluate,
        vectorize=True,
        moves=[(emcee.moves.KDEMove(), 0.6), (emcee.moves.DEMove(), 0.4)],
    )
    blocks = _stored_blocks(options, fingerprint)
    state = _resumed(blocks[-1]) if blocks else _start(options, mode, covariance, seed)
    while not _long_enough(blocks) and _steps(blocks) < options.steps:
        sampler.reset()
        block = min(options.block, options.steps - _steps(blocks))
        with threadpool_limits(1, user_api="blas"):  # threads cost more than the move's matrices
            state = sampler.run_mcmc(state, block, skip_initial_state_check=True)
        blocks.append(_block(sampler, state, fingerprint))
        if options.checkpoint is not None:
            file = options.checkpoint / f"block-{len(blocks) - 1:05d}.npz"
            with replaced_on_success(file) as partial, partial.open("wb") as stream:
                np.savez(stream, **blocks[-1])  # type: ignore[arg-type]
        if options.progress is not None:
            options.progress(_steps(blocks), options.steps)
    _refuse_short_chain(blocks, options)
    start, tau = _settled_start(blocks)
    accepted = sum(int(block["accepted"]) for block in blocks)
    return Chain(
        vectors=_stacked(blocks, "chain")[start:],
        log_density=_stacked(blocks, "log_chain")[start:],
        tau=tau,
        acceptance=accepted / (_steps(blocks) * options.walkers),
        steps=_steps(blocks),
    )


def _stored_blocks(options: SamplingOptions, fingerprint: str) -> list[Block]:
    blocks: list[Block] = []
    folder = options.checkpoint
    for file in sorted(folder.glob("block-*.npz")) if folder is not None else ():
        with np.load(file) as stored:
            block = dict(stored)
        if str(block["fingerprint"]) != fingerprint:
            raise InputError(
                f"{folder}: holds the chain of another run (other data, seed, settings or "
                "package versions); delete that folder or choose another output folder."
            )
        blocks.append(block)
    return blocks


def _block(sampler: Any, state: Any, fingerprint: str) -> Block:
    """What the sampler has done since its last reset, and the state to go on from."""
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


def _resumed(last: Block) -> Any:
    from emcee import State

    random_state = ("MT19937", last["keys"], *(last["position"][:2]), float(last["gauss"]))
    return State(last["coords"], log_prob=last["log_prob"], random_state=random_state)


def _start(options: SamplingOptions, mode: np.ndarray, covariance: np.ndarray, seed: int) -> Any:
    from emcee import State

    random = np.random.RandomState(seed)
    spread = np.linalg.cholesky(np.asarray(covariance, np.float64))
    standard = random.standard_normal((options.walkers, mode.size))
    return State(mode + standard @ spread.T, random_state=random.get_state())


def _steps(blocks: list[Block]) -> int:
    return sum(len(block["chain"]) for block in blocks)


def _stacked(blocks: list[Block], name: str) -> np.ndarray:
    return np.concatenate([block[name] for block in blocks])


def _tau(chain: np.ndarray) -> np.ndarray:
    from emcee.autocorr import integrated_time

    with np.errstate(invalid="ignore"):  # a walker that never moved has no autocorrelation
        tau = integrated_time(chain, tol=0, quiet=True)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


def _settled_start(blocks: list[Block]) -> tuple[int, np.ndarray]:
    """Where burn-in ends, and the autocorrelation times from there on."""
    chain = _stacked(blocks, "chain")
    start = int(min(np.ceil(BURN_IN_TAU * np.max(_tau(chain))), len(chain) // 2))
    return start, _tau(chain[start:])


def _length_in_tau(blocks: list[Block]) -> tuple[float, float]:
    start, tau = _settled_start(blocks)
    slowest = float(np.max(tau))
    return (_steps(blocks) - start) / slowest, slowest


def _long_enough(blocks: list[Block]) -> bool:
    return bool(blocks) and _length_in_tau(blocks)[0] >= TIMES_TAU


def _refuse_short_chain(blocks: list[Block], options: SamplingOptions) -> None:
    length, tau = _length_in_tau(blocks)
    if length >= TIMES_TAU:
        return
    steps = _steps(blocks)
    resumes = " and run again: it resumes." if options.checkpoint else "."
    if not math.isfinite(tau):
        raise InputError(
            f"Some walkers have not moved in {steps} steps, so the chain cannot be "
            f"judged; allow about {10 * steps} steps{resumes}"
        )
    # Short chains underestimate their autocorrelation time, by up to 1.7 at 14 times tau.
    needed = math.ceil((TIMES_TAU + BURN_IN_TAU) * 1.7 * tau / 100) * 100
    raise InputError(
        f"The chain of {steps} steps is {length:.0f} autocorrelation times long (tau = "
        f"{tau:.0f} steps) and at least {TIMES_TAU} are needed to report it; allow about "
        f"{max(needed, steps + options.block)} steps{resumes}"
    )
