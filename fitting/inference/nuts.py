"""Sample a posterior by the No-U-Turn sampler (Hoffman & Gelman, JMLR 15, 2014) of blackjax, an
optional extra.

The chains use coordinates z in which Laplace's Gaussian is isotropic,

    vector = mode + L z,    L L^T = covariance,

so that only the step size has to be adapted. During the warm-up, dual averaging adapts it to the
mean acceptance of all chains. Draw i has its own random key, so neither the size of the blocks nor
an interruption changes a chain. Chains are accepted if they have at least 400 effective draws and
an R-hat of at most 1.01 (Vehtari et al., Bayesian Analysis 16, 2021).
"""

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxvision.errors import InputError, install

from .blocks import (
    Block,
    Progress,
    fingerprint,
    length,
    next_length,
    resume_blocks,
    stack_blocks,
    store,
)
from .convergence import effective_draws, split_r_hat
from .given import require_progress, require_whole
from .on_host import to_host
from .parameters import ParameterSpace, natural_numbers
from .posterior import LogDensity, Posterior

WARM_UP = 300  # steps that adapt the step size; draws follow
FIRST_STEP = 0.5  # in standard deviations
FEWEST_EFFECTIVE, LARGEST_R_HAT = 400.0, 1.01
FEWEST_DRAWS = 10
FACTORS = (1.0, 0.5, 0.25, 0.1, 0.0)  # factors on a start's distance from the mode, tried in turn


@dataclass(frozen=True)
class Nuts:
    """Options of the No-U-Turn sampler, whose chains follow the gradient (the `nuts` extra).

    Attributes:
        draws: number of draws of each chain, at least 10, after a warm-up of 300 steps.
        chains: number of independent chains, which are advanced together.
        acceptance: mean acceptance to which the warm-up adapts the step size, between 0 and 1.
            Raise it where trajectories diverge: steps become smaller.
        block: number of draws between two checkpoints.
        checkpoint: folder for the blocks; None keeps them in memory.
        progress: called with (steps done, steps in all) after each block.

    Raises:
        InputError: for unusable numbers.

    Example:
        >>> from fitting import Nuts
        >>> longer = Nuts(draws=500, chains=4)  # fit(problem, posterior=longer)
        >>> longer.draws * longer.chains, longer.acceptance
        (2000, 0.8)
    """

    draws: int = 1000
    chains: int = 4
    acceptance: float = 0.8
    block: int = 100
    checkpoint: Path | str | None = None
    progress: Progress | None = None

    def __post_init__(self) -> None:
        require_whole("draws", self.draws, least=FEWEST_DRAWS)
        require_whole("chains", self.chains)
        require_whole("block", self.block)
        require_progress(self.progress)
        if not (isinstance(self.acceptance, float | np.floating) and 0 < self.acceptance < 1):
            raise InputError(f"acceptance = {self.acceptance!r}: use a number between 0 and 1.")


class NutsOptions(Nuts):
    """Deprecated: use `Nuts`, which has the same fields.

    Attributes:
        draws: number of draws of each chain.
        chains: number of chains.
        acceptance: mean acceptance to which the warm-up adapts the step size.
        block: number of draws between two checkpoints.
        checkpoint: folder for the blocks; None keeps them in memory.
        progress: called with (steps done, steps in all).

    Example:
        >>> from fitting import Nuts
        >>> Nuts(draws=500).draws
        500
    """

    def __post_init__(self) -> None:
        warnings.warn(
            "NutsOptions is deprecated: write Nuts(...), as in "
            "fit(problem, posterior=Nuts(draws=1000)).",
            DeprecationWarning,
            stacklevel=3,
        )
        super().__post_init__()


class _State(eqx.Module):
    """The positions of the chains, and the adaptation of their step size. The adaptation holds the
    log of the step, the log of its average, the count, the mean error and the centre (Nesterov's
    dual averaging).
    """

    position: Float[Array, "chains parameters"]
    log_density: Float[Array, " chains"]
    gradient: Float[Array, "chains parameters"]
    adaptation: Float[Array, "5"]


def nuts(
    log_density: LogDensity,
    space: ParameterSpace,
    mode: Float[Array, " parameters"],
    covariance: Float[np.ndarray, "parameters parameters"],
    args: Any,
    *,
    options: Nuts | None = None,
    seed: int = 0,
    after: Posterior | None = None,
) -> Posterior:
    """Draw from a posterior by NUTS, in chains that start from the Gaussian (mode, covariance).

    Chains that are not yet reliable are returned too, and report how many draws they lack. To
    continue them, ask for more draws and give `after` or their checkpoint. The result is
    bit-identical to that of uninterrupted chains.
    """
    _ = require_blackjax()
    options = options or Nuts()
    chains, block = options.chains, options.block
    spread = jnp.asarray(np.linalg.cholesky(np.asarray(covariance, np.float64)), mode.dtype)
    settings = (space, seed, chains, WARM_UP, options.acceptance)
    run = fingerprint(log_density, mode, covariance, args, *settings, package="blackjax")
    blocks = resume_blocks(options.checkpoint, () if after is None else after.blocks, run)
    density = (log_density, mode, spread, args)
    starting, drawing = jax.random.split(jax.random.key(seed))
    if blocks:
        names = ("position", "log_density", "gradient", "adaptation")
        state = _State(*(jnp.asarray(blocks[-1][name]) for name in names))
    else:
        state = _draw_starts(*density, starting, chains)
        if not np.isfinite(to_host(state.log_density)).all():
            raise InputError(
                "The density is 0 or NaN at the mode, so no chain can start; fit first."
            )
    total = WARM_UP + options.draws
    while (done := length(blocks)) < total:
        steps = next_length(done, block, total)
        state, drawn = _advance(
            *density, state, drawing, jnp.asarray([done, steps]), block, options.acceptance
        )
        blocks.append(
            {"fingerprint": np.array(run)}
            | {name: to_host(values)[:steps] for name, values in drawn.items()}
            | {name: to_host(values) for name, values in vars(state).items()}
        )
        store(options.checkpoint, len(blocks) - 1, blocks[-1])
        if options.progress is not None:
            options.progress(length(blocks), total)
    return _posterior(space, np.asarray(mode, np.float64), np.asarray(spread), blocks, seed)


def require_blackjax() -> ModuleType:
    """Return the blackjax package, or raise an error that says how to install it."""
    try:
        import blackjax
    except ImportError as error:
        raise InputError(
            f"NUTS needs blackjax, which is not installed; run: {install('nuts')}."
        ) from error
    return blackjax


def _whiten(log_density: LogDensity, mode: Array, spread: Array, args: Any) -> Any:
    """Return the log density as a function of z; -inf where it is NaN."""

    def density(z: Array) -> Array:
        value = log_density(mode + spread @ z, args)
        return jnp.where(jnp.isnan(value), -jnp.inf, value)

    return density


@eqx.filter_jit
def _draw_starts(
    log_density: LogDensity, mode: Array, spread: Array, args: Any, key: PRNGKeyArray, chains: int
) -> _State:
    """Draw starts from Laplace's Gaussian, moved towards the mode until the density is positive."""
    density = _whiten(log_density, mode, spread, args)
    z = jax.random.normal(key, (chains, mode.size), mode.dtype)
    nearer = jnp.asarray(FACTORS, mode.dtype)[:, None, None] * z[None]
    possible = jnp.isfinite(jax.vmap(jax.vmap(density))(nearer))
    first = jnp.where(possible.any(axis=0), jnp.argmax(possible, axis=0), len(FACTORS) - 1)
    position = nearer[first, jnp.arange(chains)]
    value, gradient = jax.vmap(jax.value_and_grad(density))(position)
    adapt, _, _ = _adaptation(0.0)  # the initial state does not depend on the target
    begun = jnp.stack([jnp.asarray(x, mode.dtype) for x in adapt(FIRST_STEP)])
    return _State(position, value, gradient, begun)


def _adaptation(acceptance: float) -> Any:
    from blackjax.adaptation.step_size import dual_averaging_adaptation

    return dual_averaging_adaptation(acceptance)


@eqx.filter_jit
def _advance(
    log_density: LogDensity,
    mode: Array,
    spread: Array,
    args: Any,
    state: _State,
    key: PRNGKeyArray,
    range_: Int[Array, "2"],
    block: int,
    acceptance: float,
) -> tuple[_State, dict[str, Array]]:
    """Advance the chains by the steps of one block, (first, number), and return their draws."""
    from blackjax.adaptation.step_size import DualAveragingAdaptationState
    from blackjax.mcmc.hmc import HMCState

    kernel = require_blackjax().nuts.build_kernel()
    density = _whiten(log_density, mode, spread, args)
    round_metric = jnp.ones_like(mode)
    _, update, _ = _adaptation(acceptance)
    chains = len(state.log_density)
    first, steps = range_

    def step(i: Array, carry: tuple[_State, dict[str, Array]]) -> tuple[_State, dict[str, Array]]:
        now, drawn = carry
        adapting = first + i < WARM_UP
        size = jnp.exp(jnp.where(adapting, now.adaptation[0], now.adaptation[1]))
        keys = jax.random.split(jax.random.fold_in(key, first + i), chains)
        places = HMCState(now.position, now.log_density, now.gradient)  # type: ignore[arg-type]
        moved, info = jax.vmap(
            lambda k, place: kernel(k, place, density, size, round_metric),
        )(keys, places)
        adapted = update(
            DualAveragingAdaptationState(*now.adaptation), jnp.mean(info.acceptance_rate)
        )
        adaptation = jnp.where(adapting, jnp.stack(adapted), now.adaptation)
        new = {
            "chain": moved.position,
            "log_chain": moved.logdensity,
            "acceptances": info.acceptance_rate,
            "divergent": info.is_divergent,
        }
        drawn = {name: drawn[name].at[i].set(value) for name, value in new.items()}
        return _State(moved.position, moved.logdensity, moved.logdensity_grad, adaptation), drawn

    empty = {
        "chain": jnp.zeros((block, *state.position.shape), mode.dtype),
        "log_chain": jnp.zeros((block, chains), mode.dtype),
        "acceptances": jnp.zeros((block, chains), mode.dtype),
        "divergent": jnp.zeros((block, chains), bool),
    }
    return jax.lax.fori_loop(0, steps, step, (state, empty))


def _posterior(
    space: ParameterSpace, mode: np.ndarray, spread: np.ndarray, blocks: list[Block], seed: int
) -> Posterior:
    """Return the draws after the warm-up as a posterior, with the measures of their reliability."""
    settled = {
        name: stack_blocks(blocks, name)[WARM_UP:]
        for name in ("chain", "log_chain", "acceptances", "divergent")
    }
    vectors = np.swapaxes(mode + settled["chain"] @ spread.T, 0, 1)
    chains, draws = vectors.shape[:2]
    by_parameter = np.moveaxis(vectors, 2, 0)
    effective = np.array([effective_draws(x) for x in by_parameter])
    r_hat = np.array([split_r_hat(x) for x in by_parameter])
    return Posterior(
        space=space,
        method="NUTS",
        draws=natural_numbers(space, vectors),
        mode=natural_numbers(space, mode),
        unconstrained_mode=mode,
        covariance=np.cov(vectors.reshape(-1, len(space)).T).reshape(len(space), len(space)),
        seed=seed,
        log_density=settled["log_chain"].T,
        tau=chains * draws / effective,
        acceptance=float(settled["acceptances"].mean()),
        steps=length(blocks),
        missing_steps=_missing(draws, float(effective.min()), float(r_hat.max())),
        r_hat=r_hat,
        divergences=int(settled["divergent"].sum()),
        blocks=tuple(blocks),
    )


def _missing(draws: int, effective: float, r_hat: float) -> int:
    """Estimate how many more draws each chain needs, rounded up to hundreds. If the chains
    disagree, at least twice as many draws are needed."""
    if effective >= FEWEST_EFFECTIVE and r_hat <= LARGEST_R_HAT:
        return 0
    needed = draws * max(FEWEST_EFFECTIVE / effective, 2.0 if r_hat > LARGEST_R_HAT else 1.0)
    return max(math.ceil((needed - draws) / 100), 1) * 100
