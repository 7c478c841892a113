"""The most likely figures of a camera over its settings, and which claims of the model hold.

What the settings tell is Normal with a covariance that their own fits know, so that the most likely
vector is that of generalised least squares; to first order it is that of all frames at once. Each
claim ("the quantum efficiency is the same at every gain") is judged by the score test: residuals r,
projected on what deviations D from the claim could explain beyond the parameters' own slopes J,

    D' = D - J J^+ D,    chi^2 = |P_D' r|^2    with rank(D') degrees of freedom,

which is what chi-square would fall by if the claim were given up, and needs no other fit. A claim
that fails (p < 0.1 %) is given up, the worst first, and all is fitted anew.

Source:
    Rao, Proc. Camb. Phil. Soc. 44, 1948 (score test); Chamberlain, J. Econometrics 18, 1982
    (minimum distance from unrestricted estimates).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import nnls

from ...inference.newton import NewtonSolution, minimise
from ...inference.parameters import ParameterSpace
from ..misfit import MISFIT, inflation, p_value
from ..settings import Setting
from .model import (
    BOLTZMANN_EV,
    SharedModel,
    assembled,
    cost,
    cost_and_slopes,
    knows,
    slopes,
    space_of,
)
from .setting import FROM_DARKS, TOLD, Told

Quantity = Literal["system_gain", "quantum_efficiency", "read_noise", "dark_current"]
Axis = Literal["gain", "temperature"]
Freed = frozenset[tuple[Quantity, Axis]]
Labels = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], tuple[str, ...]]

CLAIMS: tuple[tuple[Quantity, Axis], ...] = (
    ("system_gain", "temperature"),
    ("quantum_efficiency", "gain"),
    ("quantum_efficiency", "temperature"),
    ("read_noise", "gain"),
    ("read_noise", "temperature"),
    ("dark_current", "gain"),
    ("dark_current", "temperature"),
)
SEEN = 4.0  # standard errors of dark current at the warmest setting from which it has a law
ENERGIES = np.linspace(0.1, 1.9, 37)  # eV, from which the search of the law starts
EXPLAINED = 1e-6  # of a deviation's length, below which the parameters explain it


@dataclass(frozen=True)
class OwnDeviation:
    """How far the settings of one gain, or of one temperature, are off the others.

    Attributes:
        label: of the gain or temperature.
        value: relative; e-/s of a dark current over temperature.
        error: its standard error.
    """

    label: str
    value: float
    error: float


@dataclass(frozen=True)
class Claim:
    """A claim of the model, judged.

    Attributes:
        quantity: that is claimed to follow its law, or to be shared,
        axis: over these settings.
        chi_square: that giving it up would save.
        degrees: of freedom.
        own: deviation of each gain or temperature, where the frames know one.
        rivals: claims that failed with it, of a claim that was given up.
    """

    quantity: Quantity
    axis: Axis
    chi_square: float
    degrees: int
    own: tuple[OwnDeviation, ...]
    rivals: tuple[tuple[Quantity, Axis], ...] = ()

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, self.degrees)

    @property
    def holds(self) -> bool:
        return self.p_value >= MISFIT


@dataclass(frozen=True)
class SharedFit:
    """A camera over its settings.

    Attributes:
        settings: in the order of gain and temperature.
        told: by each of them.
        freed: claims that were given up.
        labels: what tells gains, efficiencies, read noises and dark currents apart.
        model: of the settings.
        space: its P parameters.
        solution: vector, information and convergence.
        residuals: (data,) standardised.
        claims: that could be judged; first those that failed, as they did.
        reference: T_ref, K; None where no temperature is told.
    """

    settings: tuple[Setting, ...]
    told: tuple[Told, ...]
    freed: Freed
    labels: Labels
    model: SharedModel
    space: ParameterSpace
    solution: NewtonSolution
    residuals: Float[np.ndarray, " data"]
    claims: tuple[Claim, ...]
    reference: float | None

    @property
    def chi_square(self) -> float:
        return float(self.residuals @ self.residuals)

    @property
    def degrees(self) -> int:
        return len(self.residuals) - len(self.space)

    @property
    def p_value(self) -> float:
        return p_value(self.chi_square, self.degrees)

    @property
    def inflation(self) -> float:
        """Factor on the covariance."""
        return inflation(self.chi_square, self.degrees)

    @property
    def covariance(self) -> np.ndarray:
        """(P, P) on the unconstrained scale, inflated."""
        return self.inflation * np.linalg.inv(np.asarray(self.solution.information))


def fitted(settings: Sequence[Setting], told: Sequence[Told]) -> SharedFit:
    """The fit after all claims that fail were given up.

    Args:
        settings: two or more.
        told: by each of them.

    Returns:
        The fit.
    """
    freed: Freed = frozenset()
    failed: list[Claim] = []
    while True:
        fit = _fitted(tuple(settings), tuple(told), freed)
        claims = judged(fit)
        worst = min(claims, key=lambda claim: claim.p_value, default=None)
        if worst is None or worst.holds:
            return replace(fit, claims=(*failed, *claims))
        others = [one for one in claims if one is not worst and not one.holds]
        rivals = tuple((one.quantity, one.axis) for one in others)
        failed.append(replace(worst, rivals=rivals))
        given_up: tuple[Quantity, Axis] = worst.quantity, worst.axis
        freed = freed | {given_up}


def _fitted(settings: tuple[Setting, ...], told: tuple[Told, ...], freed: Freed) -> SharedFit:
    temperatures = [s.temperature for s in settings if s.temperature is not None]
    reference = max(temperatures, default=None)
    model, labels = _model(settings, told, freed, reference)
    space = space_of(model, labels)
    args = (model, jnp.asarray(1.0))
    start = jnp.asarray(_start(model, told))
    solution = minimise(cost, start, args, derivatives=cost_and_slopes)
    missed, *_ = slopes(solution.vector, model)
    return SharedFit(
        *(settings, told, freed, labels, model, space, solution),
        residuals=np.asarray(missed),
        claims=(),
        reference=reference,
    )


def _model(
    settings: tuple[Setting, ...], told: tuple[Told, ...], freed: Freed, reference: float | None
) -> tuple[SharedModel, Labels]:
    """Which settings share what, and what tells the values apart."""
    gains = [setting.gain_label for setting in settings]
    warmth = [setting.temperature_label for setting in settings]
    both = [setting.label for setting in settings]
    keys: dict[Quantity, list[str]] = {
        "system_gain": gains,
        "quantum_efficiency": [""] * len(settings),
        "read_noise": gains,
        "dark_current": warmth,
    }
    if ("system_gain", "temperature") in freed:
        keys["system_gain"] = [both[i] for i in _nearest_with_flats(settings, told)]
    axes = {axis for quantity, axis in freed if quantity == "quantum_efficiency"}
    if axes:
        keys["quantum_efficiency"] = {
            frozenset({"gain"}): gains,
            frozenset({"temperature"}): warmth,
        }.get(frozenset(axes), both)
    if ("read_noise", "temperature") in freed:
        keys["read_noise"] = both
    if ("dark_current", "gain") in freed:
        keys["dark_current"] = both
    if not any(knows(told, "responsivity")):
        keys["quantum_efficiency"] = []
    current = [i for i, one in enumerate(told) if {"dark_current", FROM_DARKS[0]} & {*one.names}]
    if not current:
        keys["dark_current"] = []
    numbers = {name: _numbered(words, len(settings)) for name, words in keys.items()}
    table, whitening = assembled(told)
    colder = np.zeros(len(settings))
    if reference is not None:
        kelvin = np.array([setting.temperature or reference for setting in settings])
        colder = -(1 / kelvin - 1 / reference) / BOLTZMANN_EV
    own_read_noise = {("read_noise", "gain"), ("read_noise", "temperature")} & freed
    own_dark = {("dark_current", "gain"), ("dark_current", "temperature")} & freed
    model = SharedModel(
        told=jnp.asarray(table),
        whitening=jnp.asarray(whitening),
        colder=jnp.asarray(colder),
        gain_of=jnp.asarray(numbers["system_gain"][0]),
        efficiency_of=jnp.asarray(numbers["quantum_efficiency"][0]),
        read_noise_of=jnp.asarray(numbers["read_noise"][0]),
        dark_current_of=jnp.asarray(numbers["dark_current"][0]),
        sizes=tuple(len(numbers[name][1]) for name in keys),  # pyright: ignore
        read_noise_law=len({*gains}) > 1 and not own_read_noise,
        dark_current_law=not own_dark and _has_law(settings, told, current),
    )
    gain, efficiency, read_noise, dark = (numbers[name][1] for name in keys)
    return model, (gain, efficiency, read_noise, dark)


def _numbered(words: Sequence[str], count: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Which of the different words each is, and these, in the order of their first places."""
    different = tuple(dict.fromkeys(words))
    if not words:
        return np.zeros(count, int), ()
    return np.array([different.index(word) for word in words]), different


def _nearest_with_flats(settings: tuple[Setting, ...], told: tuple[Told, ...]) -> list[int]:
    """The setting itself; of darks alone that of the same gain and nearest temperature which has
    flats."""
    lit = knows(told, "system_gain")

    def distance(i: int, j: int) -> float:
        return abs((settings[i].temperature or 0) - (settings[j].temperature or 0))

    same = [
        [j for j in range(len(settings)) if lit[j] and settings[j].gain == settings[i].gain]
        for i in range(len(settings))
    ]
    return [min(same[i], key=lambda j: distance(i, j)) for i in range(len(settings))]


def _has_law(settings: tuple[Setting, ...], told: tuple[Told, ...], current: Sequence[int]) -> bool:
    """Whether dark current was seen at two temperatures, at the warmest beyond its error."""
    warmth = {settings[i].temperature for i in current}
    if len(warmth) < 2:
        return False
    warmest = max(x for x in warmth if x is not None)
    precision = total = 0.0
    for i in current:
        if settings[i].temperature == warmest:
            one = told[i]
            place = one.names.index(
                "dark_current" if "dark_current" in one.names else FROM_DARKS[0]
            )
            weight = 1 / one.covariance[place, place]
            precision, total = precision + weight, total + weight * one.values[place]
    # Of darks alone the rate is in DN; its sign and significance are the same.
    return bool(total > SEEN * np.sqrt(precision))


def _start(model: SharedModel, told: Sequence[Told]) -> np.ndarray:
    """From averages of what the settings tell one by one."""
    table = np.asarray(model.told)
    column = {name: table[:, i] for i, name in enumerate(TOLD)}
    has = {name: np.array(knows(told, name)) for name in TOLD}

    def averages(values: np.ndarray, known: np.ndarray, of: Array, count: int) -> np.ndarray:
        own = [values[known & (np.asarray(of) == i)] for i in range(count)]
        usual = float(np.mean(values[known])) if known.any() else 0.0
        return np.array([np.mean(one) if one.size else usual for one in own])

    gains, efficiencies, reads, darks = model.sizes
    log_gain = averages(column["system_gain"], has["system_gain"], model.gain_of, gains)
    at = np.exp(log_gain[np.asarray(model.gain_of)])
    both = has["system_gain"] & has["responsivity"]
    ratio = column["responsivity"] - column["system_gain"]
    start = [log_gain, averages(ratio, both, model.efficiency_of, efficiencies)]
    of_darks = np.maximum(column["read_variance"], 0.01) / at**2
    variance = np.where(has["read_noise"], np.exp(2 * column["read_noise"]), of_darks)
    known = has["read_noise"] | has["read_variance"]
    if model.read_noise_law:
        design = np.stack([np.ones_like(at), at**-2], axis=1) / variance[:, None]
        squares, _ = nnls(design[known], np.ones(known.sum()))
        start.append(np.maximum(squares, 1e-6))
    else:
        start.append(averages(np.log(variance) / 2, known, model.read_noise_of, reads))
    current = np.where(has["dark_current"], column["dark_current"], column[FROM_DARKS[0]] / at)
    known = has["dark_current"] | has[FROM_DARKS[0]]
    if darks and model.dark_current_law:
        start.append(_dark_law(np.asarray(model.colder)[known], current[known]))
    else:
        start.append(averages(current, known, model.dark_current_of, darks))
    return np.concatenate(start)


def _dark_law(colder: np.ndarray, current: np.ndarray) -> np.ndarray:
    """ln I_ref and E by least squares over a grid of E."""
    shapes = np.exp(ENERGIES[:, None] * colder)
    rates = shapes @ current / np.sum(shapes**2, axis=1)
    best = int(np.argmin(np.sum((rates[:, None] * shapes - current) ** 2, axis=1)))
    return np.array([np.log(max(rates[best], 1e-9)), ENERGIES[best]])


def judged(fit: SharedFit) -> tuple[Claim, ...]:
    """The claims that the frames can contradict.

    Args:
        fit: of the settings.

    Returns:
        Those that were not given up, and that the parameters do not fill.
    """
    missed, by_vector, off, at = slopes(fit.solution.vector, fit.model)
    basis, _ = np.linalg.qr(np.asarray(by_vector))
    words: Mapping[Axis, list[str]] = {
        "gain": [setting.gain_label for setting in fit.settings],
        "temperature": [setting.temperature_label for setting in fit.settings],
    }
    found = []
    for quantity, axis in CLAIMS:
        different = tuple(dict.fromkeys(words[axis]))
        if (quantity, axis) in fit.freed or len(different) < 2:
            continue
        by_setting = {
            "system_gain": off.gain,
            "quantum_efficiency": off.efficiency,
            "read_noise": off.read_noise,
            "dark_current": off.dark_current,
        }[quantity]
        columns = np.asarray(by_setting)
        if quantity == "dark_current" and axis == "gain" and at.dark_current is not None:
            columns = columns * np.asarray(at.dark_current)
        members = np.array([[word == one for one in different] for word in words[axis]], float)
        columns = columns @ members
        claim = _judged(quantity, axis, different, columns, basis, np.asarray(missed))
        if claim is not None:
            found.append(claim)
    return tuple(found)


def _judged(
    quantity: Quantity,
    axis: Axis,
    words: tuple[str, ...],
    columns: np.ndarray,
    basis: np.ndarray,
    missed: np.ndarray,
) -> Claim | None:
    unexplained = columns - basis @ (basis.T @ columns)
    length = np.linalg.norm(columns, axis=0)
    left, sizes, _ = np.linalg.svd(unexplained, full_matrices=False)
    seen = sizes > EXPLAINED * length.max(initial=0)
    if not seen.any():
        return None
    own = []
    for i, word in enumerate(words):
        size = np.linalg.norm(unexplained[:, i])
        if size > EXPLAINED * length[i]:
            value = -float(unexplained[:, i] @ missed / size**2)
            own.append(OwnDeviation(word, value, float(1 / size)))
    chi_square = float(np.sum((left[:, seen].T @ missed) ** 2))
    return Claim(quantity, axis, chi_square, int(seen.sum()), tuple(own))
