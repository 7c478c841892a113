"""The joint fit to all settings of a camera, as a `Problem` whose data are the estimates from each
setting's separate fit.

At setting s of gain g and temperature T,

    K        = K_g                                      conversion gain, one for each gain
    R        = eta K_g                                  quantum efficiency, shared
    sigma_d  = sqrt(sigma_0^2 + (sigma_1 / K_g)^2)      read noise, e-
    I        = I_ref exp(-E / k (1 / T - 1 / T_ref))    dark current, e-/s

sigma_0 is the noise before the amplifier of variable gain, e-. sigma_1 is the noise behind it, DN,
mainly of the converter. For silicon, the activation energy E lies between half the band gap
(generation in the depletion region) and the whole gap (diffusion).

Each setting's estimates are treated as Gaussian with the covariance of its own fit, so the joint
fit is generalised least squares. To first order it equals a single fit to all frames. Each law is
an assumption, such as "the quantum efficiency is the same at every gain", and has a score test. Let
r be the residuals, J their derivatives with respect to the parameters, and D their derivatives with
respect to deviations from the assumption, all whitened. The test projects r on the part D' of D
that the parameters cannot explain:

    D' = D - J J^+ D,    chi^2 = |P_D' r|^2 with rank(D') degrees of freedom,

where P_D' is the projection on the columns of D'. This chi^2 is the decrease of chi-square that
dropping the assumption would give, computed without a second fit. Of the assumptions that fail (p <
0.1 %), the most significant is dropped, and the fit and the tests are repeated.

Source:
    Janesick, "Photon Transfer", 2007, chapters 7 and 11; EMVA 1288, release 4.0 (linear model);
    Healey & Kondepudy, PAMI 16, 1994 (noise before and behind the gain); Widenhorn, Blouke, Weber,
    Rest & Bodegom, Proc. SPIE 4669, 2002 (activation energy); Rao, Proc. Camb. Phil. Soc. 44, 1948
    (score test); Chamberlain, J. Econometrics 18, 1982 (minimum distance).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtrc

from ...fits.result import Fit
from ...fits.solve import fit
from ...inference.likelihoods import Gaussian
from ...inference.parameters import Parameter, names
from ...inference.posterior import Posterior
from ...inference.problem import Problem, Values, prediction, values_at
from ...inference.search import search, start_at
from ..regressions import MISFIT, p_value
from ..settings import Setting
from .setting import ESTIMATED, SettingEstimates

BOLTZMANN_EV = 1.380649e-23 / 1.602176634e-19  # eV/K
# Standard errors of dark current at the warmest setting from which it has a law
SIGNIFICANCE_SIGMAS = 4.0
USUAL_ENERGY = 0.6  # eV, start of the search
EXPLAINED = 1e-6  # share of a deviation's length below which the parameters explain it

Quantity = Literal["system_gain", "quantum_efficiency", "read_noise", "dark_current"]
Axis = Literal["gain", "temperature"]
Law = tuple[Quantity, Axis]
QUANTITIES: tuple[Quantity, ...] = (
    *("system_gain", "quantum_efficiency"),
    *("read_noise", "dark_current"),
)
CLAIMS: tuple[Law, ...] = (
    ("system_gain", "temperature"),
    *((quantity, axis) for quantity in QUANTITIES[1:] for axis in ("gain", "temperature")),
)
PARAMETERS = {
    "system_gain": Parameter(symbol="K", unit="DN/e⁻", transform="log"),
    "quantum_efficiency": Parameter(symbol="η", unit="1", transform="log"),
    "variance_before_gain": Parameter(symbol="σ₀²", unit="e⁻²"),
    "variance_behind_gain": Parameter(symbol="σ₁²", unit="DN²"),
    "read_noise": Parameter(symbol="σ_d", unit="e⁻", transform="log"),
    "dark_current": Parameter(symbol="μ_I", unit="e⁻/s"),
    "activation_energy": Parameter(symbol="E", unit="eV"),
}
REFERENCE_CURRENT = Parameter(symbol="I_ref", unit="e⁻/s", transform="log")


class Figures(eqx.Module):
    """The camera at each setting: ln K (K in DN/e-), ln eta (None if photons are unknown), variance
    of read noise (e-^2), and dark current (e-/s, None if undetermined)."""

    log_gain: Float[Array, " settings"]
    log_efficiency: Float[Array, " settings"] | None
    read_variance: Float[Array, " settings"]
    dark_current: Float[Array, " settings"] | None


def figures(values: Values, inputs: Mapping[str, Array]) -> Figures:
    """Return the camera at each setting by the laws, plus `deviations` from them."""
    off_gain, off_efficiency, off_read_noise, off_dark = values["deviations"]
    log_gain = jnp.log(values["system_gain"])[inputs["system_gain"]]
    log_efficiency = dark = None
    if "quantum_efficiency" in values:
        efficiency = values["quantum_efficiency"][inputs["quantum_efficiency"]]
        log_efficiency = jnp.log(efficiency) + off_efficiency
    if "read_noise" in values:
        variance = values["read_noise"][inputs["read_noise"]] ** 2
    else:
        behind = values["variance_behind_gain"] * jnp.exp(-2 * log_gain)
        variance = values["variance_before_gain"] + behind
    if "activation_energy" in values:
        dark = values["dark_current"] * jnp.exp(values["activation_energy"] * inputs["colder"])
    elif "dark_current" in values:
        dark = values["dark_current"][inputs["dark_current"]]
    return Figures(
        log_gain + off_gain,
        log_efficiency,
        variance * jnp.exp(2 * off_read_noise),
        None if dark is None else dark + off_dark,
    )


def predict(values: Values, inputs: Mapping[str, Array]) -> Float[Array, " data"]:
    """Return the model's prediction of the estimates of all settings, whitened."""
    at = figures(values, inputs)
    nothing, gain = jnp.zeros_like(at.log_gain), jnp.exp(at.log_gain)
    dark = nothing if at.dark_current is None else at.dark_current
    estimates = (
        at.log_gain,
        nothing if at.log_efficiency is None else at.log_efficiency + at.log_gain,
        jnp.log(at.read_variance) / 2,
        dark,
        gain * dark,
        gain**2 * at.read_variance,
        gain**2 * dark,
    )
    return inputs["whitening"] @ jnp.stack(estimates, axis=1).ravel()


@dataclass(frozen=True)
class OwnDeviation:
    """The deviation of one gain, or of one temperature, from an assumption such as a common value
    for all settings. The deviation `value` and its standard `error` are differences of logarithms,
    with two exceptions. Deviations of dark current are relative (over gain) or in e-/s (over
    temperature), and deviations from proportionality of gains are relative."""

    label: str
    value: float
    error: float


@dataclass(frozen=True)
class Claim:
    """An assumption of the model, with the result of its test."""

    quantity: Quantity  # the claim is that it follows its law, or that settings share it
    axis: Axis  # over these settings
    chi_square: float  # its decrease if the claim were dropped
    degrees: int  # degrees of freedom that dropping it would cost
    # deviation of each gain or temperature, where the frames determine one
    own: tuple[OwnDeviation, ...]
    rivals: tuple[Law, ...] = ()  # for a dropped claim, the other claims that failed with it

    @property
    def law(self) -> Law:
        return self.quantity, self.axis

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, self.degrees)

    @property
    def significance(self) -> float:
        """The test's chi-square as an equivalent number of standard deviations of a normal
        variable. This number is finite even where p underflows to 0 (Wilson & Hilferty, PNAS 17,
        1931)."""
        spread = 2 / (9 * self.degrees)
        return ((self.chi_square / self.degrees) ** (1 / 3) - (1 - spread)) / spread**0.5

    @property
    def holds(self) -> bool:
        return self.p_value >= MISFIT


@dataclass(frozen=True)
class SharedFit:
    """The joint fit to all settings of a camera."""

    settings: tuple[Setting, ...]  # in the order of gain and temperature
    by_setting: tuple[SettingEstimates, ...]  # estimates of each setting
    freed: frozenset[Law]  # claims that were dropped
    # by parameter, the gains, temperatures or settings that have their own value
    labels: dict[str, tuple[str, ...]]
    fit: Fit  # values of the P parameters
    posterior: Posterior  # of the same parameters, each named by its gain, temperature or setting
    figures: Figures  # of the best fit at each setting
    # claims that could be tested; the failed ones first, in the order of failure
    claims: tuple[Claim, ...]
    reference: float | None  # T_ref, K; None where no temperature is stated

    @property
    def vector(self) -> Float[np.ndarray, " parameters"]:
        """(P,) parameters of the best fit on the unconstrained scale."""
        return self.fit.optimum.vector

    @property
    def degrees(self) -> int:
        return len(self.fit.residuals) - len(self.vector)

    @property
    def p_value(self) -> float:
        return p_value(self.fit.misfit.chi_square, self.degrees)

    @property
    def covariance(self) -> Float[np.ndarray, "parameters parameters"]:
        """(P, P) covariance on the unconstrained scale, inflated by a significant misfit."""
        return self.fit.noise**2 * np.linalg.inv(self.fit.optimum.information)


def fit_settings(
    settings: Sequence[Setting], estimates: Sequence[SettingEstimates], *, seed: int = 0
) -> SharedFit:
    """Fit all settings together, and drop assumptions until none fails."""
    freed: frozenset[Law] = frozenset()
    failed: list[Claim] = []
    reference = max((s.temperature for s in settings if s.temperature is not None), default=None)
    while True:
        problem, start, labels = _make_problem(settings, estimates, freed, reference)
        begin = np.concatenate([np.ravel(start[parameter.name]) for parameter in problem.free])
        optimum = search(problem, np.asarray(start_at(problem.space, begin))[None])
        claims = _test_assumptions(problem, optimum.vector, settings, freed)
        worst = max(claims, key=lambda claim: claim.significance, default=None)
        if worst is None or worst.holds:
            break
        rivals = tuple(one.law for one in claims if one is not worst and not one.holds)
        failed.append(replace(worst, rivals=rivals))
        freed = freed | {worst.law}
    found = fit(problem, start=start, seed=seed)
    if found.misfit.p < MISFIT:
        found = fit(problem, start=start, misfit="inflate", seed=seed)
    values = {name: jnp.asarray(value) for name, value in found.values.items()}
    return SharedFit(
        *(tuple(settings), tuple(estimates), freed, labels, found, _name_posterior(found, labels)),
        figures=jax.tree.map(np.asarray, figures(values, problem.inputs)),
        claims=(*failed, *claims),
        reference=reference,
    )


def _name_posterior(found: Fit, labels: Mapping[str, Sequence[str]]) -> Posterior:
    """Return the posterior with parameters named by setting instead of an index."""
    space = tuple(
        replace(parameter, name=parameter.name + f"[{label}]" * bool(label), shape=())
        for parameter in found.problem.free
        for label in labels.get(parameter.name, ("",))
    )
    missed = found.posterior.missed
    if missed:
        missed = space[names(found.problem.space).index(missed)].name
    return replace(found.posterior, space=space, missed=missed)


def _make_problem(
    settings: Sequence[Setting],
    estimates: Sequence[SettingEstimates],
    freed: frozenset[Law],
    reference: float | None,
) -> tuple[Problem, dict[str, Any], dict[str, tuple[str, ...]]]:
    """Return the problem without the claims `freed`, its start, and labels of its vectors."""
    table = np.array(
        [[one.estimate(name) for name in ESTIMATED] for one in estimates]
    )  # (settings, quantities, 2)
    column = dict(zip(ESTIMATED, table[..., 0].T, strict=True))
    gains = [setting.gain_label for setting in settings]
    warmth = [setting.temperature_label for setting in settings]
    both = [setting.label for setting in settings]
    shared: dict[str, list[str]] = {"system_gain": gains}
    if ("system_gain", "temperature") in freed:
        shared["system_gain"] = [
            both[_nearest_with_flats(settings, estimates, i)] for i in range(len(both))
        ]
    if np.isfinite(column["responsivity"]).any():
        axes = {axis for quantity, axis in freed if quantity == "quantum_efficiency"}
        keys = {"": [""] * len(both), "gain": gains, "temperature": warmth}
        shared["quantum_efficiency"] = both if len(axes) > 1 else keys["".join(axes)]
    if ("read_noise", "temperature") in freed:
        shared["read_noise"] = both
    elif ("read_noise", "gain") in freed or len({*gains}) < 2:
        shared["read_noise"] = gains

    inputs: dict[str, np.ndarray] = {}
    labels: dict[str, tuple[str, ...]] = {}

    def averages(name: str, values: np.ndarray) -> np.ndarray:
        """For each value of a parameter, average the estimates `values` over the settings that
        share it. If none of these settings has an estimate, average over all settings."""
        labels[name] = tuple(dict.fromkeys(shared[name]))
        inputs[name] = np.array([labels[name].index(word) for word in shared[name]])
        known = np.isfinite(values)
        count = np.bincount(inputs[name], known)
        total = np.bincount(inputs[name], np.where(known, values, 0))
        return np.where(count, total / np.maximum(count, 1), total.sum() / max(known.sum(), 1))

    start: dict[str, Any] = {}
    start["system_gain"] = np.exp(averages("system_gain", column["system_gain"]))
    gain = start["system_gain"][inputs["system_gain"]]
    if "quantum_efficiency" in shared:
        ratio = column["responsivity"] - column["system_gain"]
        start["quantum_efficiency"] = np.exp(averages("quantum_efficiency", ratio))
    of_darks = np.maximum(column["read_variance"], 0.01) / gain**2
    log_noise = np.where(np.isfinite(of_darks), np.log(of_darks) / 2, column["read_noise"])
    if "read_noise" in shared:
        start["read_noise"] = np.exp(averages("read_noise", log_noise))
    else:
        half = np.exp(2 * log_noise) / 2
        start["variance_before_gain"] = np.nanmin(half, initial=1e6)
        start["variance_behind_gain"] = np.nanmin(half * gain**2, initial=1e6)

    dark = [one.dark_current(k) for one, k in zip(estimates, gain, strict=True)]
    current, error = np.array(dark).T
    weight, known = error**-2.0, np.isfinite(current)
    hottest = reference or 1.0
    kelvin = np.array([setting.temperature or hottest for setting in settings])
    warmest = known & (kelvin == np.max(kelvin, where=known, initial=0))
    own_dark = [("dark_current", "gain") in freed, ("dark_current", "temperature") in freed]
    seen = np.sum((weight * current)[warmest]) > SIGNIFICANCE_SIGMAS * np.sqrt(
        np.sum(weight[warmest])
    )
    if seen and len({*kelvin[known]}) > 1 and not any(own_dark):
        inputs["colder"] = -(1 / kelvin - 1 / hottest) / BOLTZMANN_EV
        start["dark_current"] = np.average(current[warmest], weights=weight[warmest])
        start["activation_energy"] = USUAL_ENERGY
    elif known.any():
        shared["dark_current"] = both if own_dark[0] else warmth
        start["dark_current"] = averages("dark_current", current)

    whitening = np.zeros((sum(len(one.names) for one in estimates), *table.shape[:2]))
    row = 0
    for s, one in enumerate(estimates):
        index = [ESTIMATED.index(name) for name in one.names]
        whitening[row : row + len(index), s, index] = np.linalg.cholesky(
            np.linalg.inv(one.covariance)
        ).T
        row += len(index)
    whitening = whitening.reshape(row, -1)
    free: dict[str, Any] = {
        name: replace(PARAMETERS[name], shape=np.shape(start[name])) for name in start
    }
    if "activation_energy" in start:
        free["dark_current"] = REFERENCE_CURRENT
    problem = Problem(
        free | {"deviations": np.zeros((len(QUANTITIES), len(settings)))},
        predict,
        Gaussian(sd=1.0),
        data=whitening @ np.nan_to_num(table[..., 0]).ravel(),
        inputs=jax.tree.map(jnp.asarray, inputs | {"whitening": whitening}),
    )
    return problem, start, labels


def _nearest_with_flats(
    settings: Sequence[Setting], estimates: Sequence[SettingEstimates], i: int
) -> int:
    """Return the index of the setting with flats of the same gain, nearest in temperature."""

    def distance(j: int) -> float:
        return abs((settings[i].temperature or 0) - (settings[j].temperature or 0))

    lit = [j for j, one in enumerate(estimates) if "system_gain" in one.names]
    return min((j for j in lit if settings[j].gain == settings[i].gain), key=distance)


@eqx.filter_jit
def _slopes(vector: Array, problem: Problem) -> tuple[Array, Array, Array, Array]:
    """Return residuals, derivatives with respect to parameters and deviations, and dark current."""

    def residuals(vector: Array, deviations: Array) -> Array:
        values = values_at(problem, vector) | {"deviations": deviations}
        return prediction(problem, values) - problem.data

    deviations = problem.fixed["deviations"]
    at = figures(values_at(problem, vector), problem.inputs)
    dark = jnp.zeros_like(at.log_gain) if at.dark_current is None else at.dark_current
    return (
        residuals(vector, deviations),
        *jax.jacfwd(residuals, argnums=(0, 1))(vector, deviations),
        dark,
    )


def _test_assumptions(
    problem: Problem, vector: np.ndarray, settings: Sequence[Setting], freed: frozenset[Law]
) -> tuple[Claim, ...]:
    """Test the assumptions that were not dropped and that the data could contradict."""
    missed, by_vector, by_deviation, dark = (
        np.asarray(x) for x in _slopes(jnp.asarray(vector), problem)
    )
    basis, _ = np.linalg.qr(by_vector)
    found = []
    for quantity, axis in CLAIMS:
        words = [getattr(setting, f"{axis}_label") for setting in settings]
        different = tuple(dict.fromkeys(words))
        if (quantity, axis) in freed or len(different) < 2:
            continue
        columns = by_deviation[:, QUANTITIES.index(quantity)]
        if (quantity, axis) == ("dark_current", "gain"):
            columns = columns * dark  # relative
        columns = columns @ np.array([[word == one for one in different] for word in words], float)
        unexplained = columns - basis @ (basis.T @ columns)
        length, size = (np.linalg.norm(x, axis=0) for x in (columns, unexplained))
        left, sizes, _ = np.linalg.svd(unexplained, full_matrices=False)
        seen = sizes > EXPLAINED * length.max(initial=0)
        if not seen.any():
            continue
        own = tuple(
            OwnDeviation(
                word, -float(unexplained[:, i] @ missed / size[i] ** 2), float(1 / size[i])
            )
            for i, word in enumerate(different)
            if size[i] > EXPLAINED * length[i]
        )
        chi_square = float(np.sum((left[:, seen].T @ missed) ** 2))
        found.append(Claim(quantity, axis, chi_square, int(seen.sum()), own))
    return tuple(found)


def proportional_gain(fit: SharedFit) -> tuple[float, float, tuple[OwnDeviation, ...]] | None:
    """Test by generalised least squares of ln K whether the measured gains K are proportional to
    the stated gains. While the test fails, the gain that deviates most significantly is left out
    and the test is repeated. Return the factor c in K = c times the stated gain, in DN/e- per
    stated unit, from the remaining gains; the p-value of the first test; and the relative
    deviations of the gains left out, the most significant first. Return None if there is only one
    gain."""
    labels = fit.labels["system_gain"]
    index = np.asarray(fit.fit.problem.inputs["system_gain"])
    first = [int(np.argmax(index == i)) for i in range(len(labels))]
    factors = np.array([fit.settings[i].gain_factor for i in first])
    if len(np.unique(factors)) < 2:
        return None
    ratio = fit.vector[: len(labels)] - np.log(factors)
    covariance = fit.covariance[: len(labels), : len(labels)]
    rest, off, p_values = [*range(len(labels))], [], []
    while True:
        precision = np.linalg.inv(covariance[np.ix_(rest, rest)])
        weights = precision.sum(axis=0) / precision.sum()
        missed = ratio[rest] - weights @ ratio[rest]
        p_values.append(float(chdtrc(len(rest) - 1, missed @ precision @ missed)))
        if p_values[-1] >= MISFIT or len(rest) == 1:
            break
        # One gain deviates, all others are proportional: the score of its indicator.
        score = precision @ missed
        size = np.diag(precision) - weights * precision.sum(axis=1)
        off.append(rest.pop(int(np.argmax(score**2 / size))))
    mean = np.zeros(len(labels))
    mean[rest] = weights
    contrasts = np.eye(len(labels))[off] - mean
    relative = np.exp(contrasts @ ratio)
    errors = relative * np.sqrt(np.einsum("ij,jk,ik->i", contrasts, covariance, contrasts))
    own = zip((labels[i] for i in off), relative - 1, errors, strict=True)
    return float(np.exp(mean @ ratio)), p_values[0], tuple(OwnDeviation(*one) for one in own)
