"""The posterior of a fit: Laplace's approximation, or draws by emcee.

A log density is a module-level pure function of an unconstrained vector and its data. Laplace
takes its curvature at the mode. The ensemble sampler (Foreman-Mackey et al. 2013) evaluates half
of its walkers in one compiled call, works in blocks, and stores each block, so that a killed run
resumes and ends bit-identical. A chain shorter than 50 autocorrelation times is refused (Sokal's
window, as emcee documents it): its own autocorrelation time cannot be trusted.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError
from jaxvision.io import replaced_on_success

from .diagnostics import identifiability
from .estimates import QUANTILES, Estimate, sampled_estimate
from .parameters import ParameterSpace, names, to_natural

LogDensity = Callable[[Float[Array, " parameters"], Any], Float[Array, ""]]
Progress = Callable[[int, int], None]

TIMES_TAU = 50  # shortest chain that is reported, in autocorrelation times
BURN_IN_TAU = 5  # discarded before anything is read off, in autocorrelation times
BATCH = 8  # walkers evaluated at a time: blocks of 8 beat a full vmap on a CPU


@dataclass(frozen=True)
class SamplingOptions:
    """How to run the ensemble. `steps` is a ceiling: sampling stops once the chain holds enough
    autocorrelation times. Blocks go to the folder `checkpoint`, if given; `progress` is called
    with (steps done, ceiling)."""

    seed: int = 0
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
    """The same options with a checkpoint folder of its own for one group (a colour channel)."""
    if options is None or options.checkpoint is None:
        return options
    return replace(options, checkpoint=options.checkpoint / group.replace(" ", "_"))


@dataclass(frozen=True)
class Posterior:
    """Draws in natural units (chains, draws, P) with their provenance. `mode` is natural,
    `covariance` belongs to the unconstrained scale; `log_density`, `tau` (steps, per parameter) and
    `acceptance` are None for Laplace."""

    space: ParameterSpace
    method: Literal["Laplace", "emcee"]
    draws: Float[np.ndarray, "chains draws parameters"]
    mode: Float[np.ndarray, " parameters"]
    unconstrained_mode: Float[np.ndarray, " parameters"]
    covariance: Float[np.ndarray, "parameters parameters"]
    seed: int
    log_density: Float[np.ndarray, "chains draws"] | None = None
    tau: Float[np.ndarray, " parameters"] | None = None
    acceptance: float | None = None
    steps: int = 0

    @property
    def samples(self) -> Float[np.ndarray, "samples parameters"]:
        return self.draws.reshape(-1, len(self.space))


@eqx.filter_jit
def _information(log_density: LogDensity, vector: Array, args: Any) -> Array:
    return -jax.hessian(log_density)(vector, args)


@eqx.filter_jit
def _evaluate(log_density: LogDensity, vectors: Array, args: Any) -> Array:
    values = jax.lax.map(lambda vector: log_density(vector, args), vectors, batch_size=BATCH)
    return jnp.where(jnp.isnan(values), -jnp.inf, values)


def laplace(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    args: Any,
    *,
    covariance: Float[np.ndarray, "parameters parameters"] | None = None,
    inflation: float = 1.0,
    seed: int = 0,
    draws: int = 4000,
) -> Posterior:
    """Gaussian posterior on the unconstrained scale about its `mode` (unconstrained).

    The covariance is the inverse of the negative Hessian of `log_density` there, or the one given
    (a sandwich, say), times `inflation`. `InputError` when the data leave a direction open.
    """
    if covariance is None:
        information = np.asarray(_information(log_density, mode, args), np.float64)
        judged = identifiability(space, information)
        if not judged.determined:
            raise InputError(" ".join(judged.sentences))
        covariance = np.linalg.inv(information)
    covariance = inflation * np.asarray(covariance, np.float64)
    centre = np.asarray(mode, np.float64)
    rng = np.random.default_rng(seed)
    try:
        vectors = rng.multivariate_normal(centre, covariance, size=draws, method="cholesky")
    except np.linalg.LinAlgError as error:
        raise InputError(
            "The best fit is no proper maximum, so it has no standard errors: the model does not "
            "describe these data; check what the rig says of the camera and the images."
        ) from error
    return Posterior(
        space=space,
        method="Laplace",
        draws=np.asarray(to_natural(space, jnp.asarray(vectors)))[None],
        mode=np.asarray(to_natural(space, jnp.asarray(centre))),
        unconstrained_mode=centre,
        covariance=covariance,
        seed=seed,
    )


def sample(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *,
    options: SamplingOptions | None = None,
) -> Posterior:
    """Draws from `log_density` by emcee, the walkers starting from the Gaussian (mode, covariance)
    on the unconstrained scale.

    `InputError` when the ceiling of steps is reached before 50 autocorrelation times; with a
    checkpoint a longer run continues where this one stopped.
    """
    import emcee

    options = options or SamplingOptions()
    half = options.walkers // 2

    def evaluate(vectors: np.ndarray) -> np.ndarray:
        # Always half an ensemble, the size of every proposal: one shape, one compilation.
        halves = [vectors[i : i + half] for i in range(0, len(vectors), half)]
        values = [_evaluate(log_density, jnp.asarray(part, mode.dtype), args) for part in halves]
        return np.concatenate([np.asarray(value, np.float64) for value in values])

    sampler = emcee.EnsembleSampler(
        options.walkers,
        len(space),
        evaluate,
        vectorize=True,
        moves=[(emcee.moves.KDEMove(), 0.6), (emcee.moves.DEMove(), 0.4)],
    )
    run = _Run(options, _fingerprint(space, mode, covariance, args, options))
    state = run.resumed_state() or _first_state(options, mode, covariance)
    while not run.long_enough() and run.steps < options.steps:
        sampler.reset()
        block = min(options.block, options.steps - run.steps)
        with threadpool_limits(1, user_api="blas"):  # threads cost more than the move's matrices
            state = sampler.run_mcmc(state, block, skip_initial_state_check=True)
        run.append(sampler, state)
        if options.progress is not None:
            options.progress(run.steps, options.steps)
    run.refuse_short_chain()
    chain, log_values, tau = run.settled()
    return Posterior(
        space=space,
        method="emcee",
        draws=np.asarray(to_natural(space, jnp.asarray(np.swapaxes(chain, 0, 1)))),
        mode=np.asarray(to_natural(space, mode)),
        unconstrained_mode=np.asarray(mode, np.float64),
        covariance=np.cov(chain.reshape(-1, len(space)).T).reshape(len(space), len(space)),
        seed=options.seed,
        log_density=log_values.T,
        tau=tau,
        acceptance=run.acceptance(),
        steps=run.steps,
    )


def estimates(posterior: Posterior, *, group: str = "") -> tuple[Estimate, ...]:
    """Value, standard error and 68 / 95 % intervals of each parameter in its own unit.

    Laplace: the mode and the Gaussian's quantiles carried through the transform. emcee: median,
    standard deviation and quantiles of the draws.
    """
    if posterior.method == "emcee":
        return tuple(
            sampled_estimate(
                p.name, p.symbol, p.unit, posterior.samples[:, i], method="emcee", group=group
            )
            for i, p in enumerate(posterior.space)
        )
    deviation = np.sqrt(np.diagonal(posterior.covariance))
    low95, low68, _, high68, high95 = (
        np.asarray(
            to_natural(
                posterior.space, jnp.asarray(posterior.unconstrained_mode + norm.ppf(q) * deviation)
            )
        )
        for q in QUANTILES
    )
    centre = jnp.asarray(posterior.unconstrained_mode)
    slope = np.diagonal(np.asarray(jax.jacfwd(partial(to_natural, posterior.space))(centre)))
    spread = np.abs(slope) * deviation
    return tuple(
        Estimate(
            p.name,
            p.symbol,
            p.unit,
            float(posterior.mode[i]),
            float(spread[i]),
            (float(low68[i]), float(high68[i])),
            (float(low95[i]), float(high95[i])),
            method="Laplace",
            group=group,
        )
        for i, p in enumerate(posterior.space)
    )


def convergence_in_words(posterior: Posterior) -> str:
    """How far the draws can be trusted, as one sentence."""
    if posterior.tau is None:
        return "Intervals are Laplace's: Gaussian about the best fit on the scale of the transform."
    slowest = int(np.argmax(posterior.tau))
    independent = posterior.samples.shape[0] / posterior.tau[slowest]
    return (
        f"{posterior.steps} steps of {posterior.draws.shape[0]} walkers; the slowest parameter, "
        f"{names(posterior.space)[slowest]}, has an autocorrelation time of "
        f"{posterior.tau[slowest]:.1f} steps, so the chain is worth {independent:.0f} independent "
        f"draws; acceptance {posterior.acceptance:.2f}."
    )


def _first_state(options: SamplingOptions, mode: Array, covariance: np.ndarray) -> Any:
    from emcee import State

    random = np.random.RandomState(options.seed)
    spread = np.linalg.cholesky(np.asarray(covariance, np.float64))
    standard = random.standard_normal((options.walkers, mode.size))
    start = np.asarray(mode, np.float64) + standard @ spread.T
    return State(start, random_state=random.get_state())


def _fingerprint(
    space: ParameterSpace, mode: Array, covariance: np.ndarray, args: Any, options: SamplingOptions
) -> str:
    digest = hashlib.sha256()
    packages = [f"{name} {version(name)}" for name in ("emcee", "jax", "numpy", "scipy")]
    digest.update(repr((space, options.seed, options.walkers, packages)).encode())
    for leaf in jax.tree.leaves((mode, covariance, args)):
        digest.update(np.asarray(leaf).tobytes() if eqx.is_array_like(leaf) else b"static")
    return digest.hexdigest()


class _Run:
    """The chain so far and its checkpoint: one file a block, each complete or absent."""

    def __init__(self, options: SamplingOptions, fingerprint: str) -> None:
        self.options = options
        self.fingerprint = fingerprint
        self.blocks: list[dict[str, np.ndarray]] = []
        folder = options.checkpoint
        for file in sorted(folder.glob("block-*.npz")) if folder is not None else ():
            with np.load(file) as stored:
                block = dict(stored)
            if str(block["fingerprint"]) != fingerprint:
                raise InputError(
                    f"{folder}: holds the chain of another run (other data, seed, settings or "
                    "package versions); delete that folder or choose another output folder."
                )
            self.blocks.append(block)

    @property
    def steps(self) -> int:
        return sum(len(block["chain"]) for block in self.blocks)

    def resumed_state(self) -> Any:
        from emcee import State

        if not self.blocks:
            return None
        last = self.blocks[-1]
        random_state = ("MT19937", last["keys"], *(last["position"][:2]), float(last["gauss"]))
        return State(last["coords"], log_prob=last["log_prob"], random_state=random_state)

    def append(self, sampler: Any, state: Any) -> None:
        _, keys, position, has_gauss, gauss = state.random_state
        block = {
            "fingerprint": np.array(self.fingerprint),
            "chain": sampler.get_chain(),
            "log_chain": sampler.get_log_prob(),
            "accepted": np.array(np.sum(sampler.backend.accepted)),
            "coords": state.coords,
            "log_prob": state.log_prob,
            "keys": keys,
            "position": np.array([position, has_gauss]),
            "gauss": np.array(gauss),
        }
        if self.options.checkpoint is not None:
            file = self.options.checkpoint / f"block-{len(self.blocks):05d}.npz"
            with replaced_on_success(file) as partial, partial.open("wb") as stream:
                np.savez(stream, **block)
        self.blocks.append(block)

    def _stacked(self, name: str) -> np.ndarray:
        return np.concatenate([block[name] for block in self.blocks])

    def _tau(self, chain: np.ndarray) -> np.ndarray:
        from emcee.autocorr import integrated_time

        with np.errstate(invalid="ignore"):  # a walker that never moved has no autocorrelation
            tau = integrated_time(chain, tol=0, quiet=True)
        return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)

    def _settled_start(self) -> tuple[int, np.ndarray]:
        chain = self._stacked("chain")
        tau = self._tau(chain)
        start = int(min(np.ceil(BURN_IN_TAU * np.max(tau)), len(chain) // 2))
        return start, self._tau(chain[start:])

    def _length_in_tau(self) -> tuple[float, float]:
        start, tau = self._settled_start()
        slowest = float(np.max(tau))
        return (self.steps - start) / slowest, slowest

    def long_enough(self) -> bool:
        return bool(self.blocks) and self._length_in_tau()[0] >= TIMES_TAU

    def refuse_short_chain(self) -> None:
        length, tau = self._length_in_tau()
        if length >= TIMES_TAU:
            return
        resumes = " and run again: it resumes." if self.options.checkpoint else "."
        if not math.isfinite(tau):
            raise InputError(
                f"Some walkers have not moved in {self.steps} steps, so the chain cannot be "
                f"judged; allow about {10 * self.steps} steps{resumes}"
            )
        # Short chains underestimate their autocorrelation time, by up to 1.7 at 14 times tau.
        needed = math.ceil((TIMES_TAU + BURN_IN_TAU) * 1.7 * tau / 100) * 100
        raise InputError(
            f"The chain of {self.steps} steps is {length:.0f} autocorrelation times long (tau = "
            f"{tau:.0f} steps) and at least {TIMES_TAU} are needed to report it; allow about "
            f"{max(needed, self.steps + self.options.block)} steps{resumes}"
        )

    def settled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        start, tau = self._settled_start()
        return self._stacked("chain")[start:], self._stacked("log_chain")[start:], tau

    def acceptance(self) -> float:
        accepted = sum(int(block["accepted"]) for block in self.blocks)
        return accepted / (self.steps * self.options.walkers)
