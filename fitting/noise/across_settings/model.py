"""The laws by which a camera's figures depend on gain and temperature.

At setting s of gain g and temperature T,

    K        = K_g                                      conversion gain, one for each gain
    R        = eta K_g                                  quantum efficiency, shared
    sigma_d  = sqrt(sigma_0^2 + (sigma_1 / K_g)^2)      read noise, e-
    I        = I_ref exp(-E / k (1 / T - 1 / T_ref))    dark current, e-/s

sigma_0: noise before the amplifier of variable gain, e-; sigma_1: noise behind it, DN, of the
converter above all. E: activation energy, between half of silicon's band gap (generation in the
depletion region) and all of it (diffusion). Each line is a claim, which the frames can contradict;
a quantity that is not shared gets values of its own (`groups`).

Source:
    Janesick, "Photon Transfer", 2007, chapters 7 and 11; EMVA 1288, release 4.0 (linear model);
    Healey & Kondepudy, PAMI 16, 1994 (noise before and behind the gain); Widenhorn, Blouke, Weber,
    Rest & Bodegom, Proc. SPIE 4669, 2002 (activation energy).
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...inference.parameters import Parameter, ParameterSpace
from .setting import TOLD, Told

BOLTZMANN_EV = 1.380649e-23 / 1.602176634e-19  # eV/K

Vector = Float[Array, " parameters"]


class SharedModel(eqx.Module):
    """Which parameters the settings share, and the estimates that each setting supplies.

    Attributes:
        told: (settings, told) in the order of `TOLD`; 0 where nothing is told.
        whitening: (data, settings * told), by which residuals become standard normal.
        colder: (settings,) -(1 / T - 1 / T_ref) / k, 1/eV.
        gain_of: (settings,) which conversion gain.
        efficiency_of: (settings,) which quantum efficiency.
        read_noise_of: (settings,) which read noise, where it follows no law.
        dark_current_of: (settings,) which dark current, where it follows no law.
        sizes: how many of these four there are; of efficiencies 0 where photons are not known, of
            dark currents 0 where none is told.
        read_noise_law: whether read noise follows its law.
        dark_current_law: whether dark current follows its law.
    """

    told: Float[Array, "settings told"]
    whitening: Float[Array, "data both"]
    colder: Float[Array, " settings"]
    gain_of: Int[Array, " settings"]
    efficiency_of: Int[Array, " settings"]
    read_noise_of: Int[Array, " settings"]
    dark_current_of: Int[Array, " settings"]
    sizes: tuple[int, int, int, int] = eqx.field(static=True)
    read_noise_law: bool = eqx.field(static=True)
    dark_current_law: bool = eqx.field(static=True)


class Deviations(eqx.Module):
    """How far single settings are off the shared laws, all 0 where these hold.

    Attributes:
        gain: (settings,) of ln K.
        efficiency: (settings,) of ln eta.
        read_noise: (settings,) of ln sigma_d.
        dark_current: (settings,) e-/s.
    """

    gain: Float[Array, " settings"]
    efficiency: Float[Array, " settings"]
    read_noise: Float[Array, " settings"]
    dark_current: Float[Array, " settings"]


def no_deviations(settings: int) -> Deviations:
    """Every setting as the laws say.

    Args:
        settings: how many.

    Returns:
        Zeros.
    """
    return Deviations(*(jnp.zeros(settings) for _ in range(4)))


class Figures(eqx.Module):
    """A camera's figures at each setting.

    Attributes:
        log_gain: (settings,) ln DN/e-.
        log_efficiency: (settings,) ln electrons per photon; None where photons are not known.
        read_variance: (settings,) e-^2.
        dark_current: (settings,) e-/s; None where none is told.
    """

    log_gain: Float[Array, " settings"]
    log_efficiency: Float[Array, " settings"] | None
    read_variance: Float[Array, " settings"]
    dark_current: Float[Array, " settings"] | None


def parts(model: SharedModel, vector: Vector) -> tuple[Array, Array, Array, Array]:
    """The vector cut into ln K, ln eta, read noise (sigma_0^2 and sigma_1^2, or ln sigma_d) and
    dark current (ln I_ref and E, or I).

    Args:
        model: whose vector.
        vector: (P,) unconstrained.

    Returns:
        Four vectors.
    """
    gains, efficiencies, reads, _ = model.sizes
    ends = np.cumsum([gains, efficiencies, 2 if model.read_noise_law else reads])
    first, second, third, fourth = jnp.split(vector, ends)
    return first, second, third, fourth


def figures(model: SharedModel, vector: Vector, off: Deviations) -> Figures:
    """What the laws give at each setting.

    Args:
        model: which settings share what.
        vector: (P,) unconstrained.
        off: deviations from the laws.

    Returns:
        The figures.
    """
    gains, efficiencies, reads, darks = parts(model, vector)
    log_gain = gains[model.gain_of] + off.gain
    log_efficiency = dark = None
    if efficiencies.size:
        log_efficiency = efficiencies[model.efficiency_of] + off.efficiency
    if model.read_noise_law:
        variance = reads[0] + reads[1] * jnp.exp(-2 * gains[model.gain_of])
    else:
        variance = jnp.exp(2 * reads[model.read_noise_of])
    if darks.size:
        if model.dark_current_law:
            dark = jnp.exp(darks[0] + darks[1] * model.colder)
        else:
            dark = darks[model.dark_current_of]
        dark = dark + off.dark_current
    return Figures(log_gain, log_efficiency, variance * jnp.exp(2 * off.read_noise), dark)


def expected(model: SharedModel, vector: Vector, off: Deviations) -> Float[Array, "settings told"]:
    """What each setting would tell without noise.

    Args:
        model: which settings share what.
        vector: (P,) unconstrained.
        off: deviations from the laws.

    Returns:
        (settings, told) in the order of `TOLD`.
    """
    at = figures(model, vector, off)
    zero = jnp.zeros_like(at.log_gain)
    responsivity = zero if at.log_efficiency is None else at.log_efficiency + at.log_gain
    dark = zero if at.dark_current is None else at.dark_current
    gain = jnp.exp(at.log_gain)
    rows = (
        at.log_gain,
        responsivity,
        jnp.log(at.read_variance) / 2,
        dark,
        gain * dark,
        gain**2 * at.read_variance,
        gain**2 * dark,
    )
    return jnp.stack(rows, axis=1)


def residuals(vector: Vector, off: Deviations, model: SharedModel) -> Float[Array, " data"]:
    """Standardised residuals, each standard normal if the laws hold.

    Args:
        vector: (P,) unconstrained.
        off: deviations from the laws.
        model: with what the settings tell.

    Returns:
        (data,).
    """
    missed = expected(model, vector, off) - model.told
    return model.whitening @ missed.ravel()


def log_density(vector: Vector, args: tuple[SharedModel, Array]) -> Array:
    """Log posterior density, up to a constant; flat on the unconstrained scale.

    Args:
        vector: (P,) unconstrained.
        args: (model, weight); weight: the inverse of the factor by which misfit inflates a
            covariance.

    Returns:
        ().
    """
    model, weight = args
    off = no_deviations(model.told.shape[0])
    return -weight * jnp.sum(residuals(vector, off, model) ** 2) / 2


def cost(vector: Vector, args: tuple[SharedModel, Array]) -> Array:
    """Less `log_density`."""
    return -log_density(vector, args)


def cost_and_slopes(vector: Vector, args: tuple[SharedModel, Array]) -> tuple[Array, Array, Array]:
    """The cost, its gradient, and Gauss and Newton's curvature.

    Args:
        vector: (P,) unconstrained.
        args: as of `log_density`.

    Returns:
        (), (P,) and (P, P).
    """
    model, weight = args
    off = no_deviations(model.told.shape[0])
    missed = residuals(vector, off, model)
    slope = jax.jacfwd(residuals)(vector, off, model)
    return weight * missed @ missed / 2, weight * slope.T @ missed, weight * slope.T @ slope


@eqx.filter_jit
def slopes(vector: Vector, model: SharedModel) -> tuple[Array, Array, Deviations, Figures]:
    """Residuals, how they change, and the figures.

    Args:
        vector: (P,) unconstrained.
        model: of the settings.

    Returns:
        (data,) residuals, (data, P) slopes, (data, settings) slopes by each deviation, and the
        figures at each setting.
    """
    off = no_deviations(model.told.shape[0])
    by_vector, by_deviation = jax.jacfwd(residuals, argnums=(0, 1))(vector, off, model)
    missed, at = residuals(vector, off, model), figures(model, vector, off)
    return missed, by_vector, by_deviation, at


def assembled(told: Sequence[Told]) -> tuple[np.ndarray, np.ndarray]:
    """What settings tell in one table, and the whitening of its residuals.

    Args:
        told: of each setting.

    Returns:
        (settings, told) and (data, settings * told).
    """
    table = np.zeros((len(told), len(TOLD)))
    rows = []
    for s, one in enumerate(told):
        index = [TOLD.index(name) for name in one.names]
        table[s, index] = one.values
        block = np.zeros((len(index), *table.shape))
        block[:, s, index] = np.linalg.cholesky(np.linalg.inv(one.covariance)).T
        rows.append(block.reshape(len(index), -1))
    return table, np.concatenate(rows)


def knows(told: Sequence[Told], name: str) -> list[bool]:
    """Which settings tell a quantity.

    Args:
        told: of each setting.
        name: one of `TOLD`.

    Returns:
        True or false, one each.
    """
    return [name in one.names for one in told]


def space_of(
    model: SharedModel, labels: tuple[Sequence[str], Sequence[str], Sequence[str], Sequence[str]]
) -> ParameterSpace:
    """The parameters of a model.

    Args:
        model: which settings share what.
        labels: what tells gains, efficiencies, read noises and dark currents apart; "" for none.

    Returns:
        The space.
    """

    def several(name: str, words: Sequence[str], **about: str) -> list[Parameter]:
        return [
            Parameter(f"{name}[{word}]" if word else name, **about)  # pyright: ignore
            for word in words
        ]

    gains, efficiencies, reads, darks = labels
    space = several("system_gain", gains, symbol="K", unit="DN/e⁻", transform="log")
    space += several("quantum_efficiency", efficiencies, symbol="η", unit="1", transform="log")
    if model.read_noise_law:
        space.append(Parameter("variance_before_gain", symbol="σ₀²", unit="e⁻²"))
        space.append(Parameter("variance_behind_gain", symbol="σ₁²", unit="DN²"))
    else:
        space += several("read_noise", reads, symbol="σ_d", unit="e⁻", transform="log")
    if darks and model.dark_current_law:
        space.append(Parameter("dark_current", symbol="I_ref", unit="e⁻/s", transform="log"))
        space.append(Parameter("activation_energy", symbol="E", unit="eV"))
    else:
        space += several("dark_current", darks, symbol="μ_I", unit="e⁻/s")
    return tuple(space)
