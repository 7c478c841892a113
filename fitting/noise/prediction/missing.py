"""Identification of the effect that a camera file lacks, among candidates with known signatures in
means, variances and covariances.

Each candidate adds its signature, times a fitted size, to the prediction of the camera. Random
scatter of the levels in light, black level or variance is also considered. Because scatter can
explain any misfit, its sizes (variance components by restricted likelihood) are fitted together
with each candidate. The merit of a candidate is the additional decrease of -2 log likelihood that
it gives. The best candidate is added, then the next, until the remaining misfit is insignificant or
no candidate exceeds the threshold of that decrease. Scatter that exceeds the threshold is reported
last.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from ...inference.formatting import format_with_error
from .comparison import PARTS, Agreement, Comparison
from .moments import Expected, Lit, noise

ALL_NOISE = "all_noise"  # of processed frames, whose numbers are rounded a second time
GAIN, BEHIND_GAIN = "gain", ("black_level", "read_noise")  # the latter in DN
MOST = 4  # most effects that are named
PRICE = 15.0  # decrease of -2 log likelihood needed for an effect: once in 10,000 by chance
REFINEMENTS = 5  # updates of the prediction, and of the frames' noise, with an effect
LEAST_SHARE = 1e4  # largest factor by which an effect may lower the variance that gives the errors
FEWEST_AVERAGED = 1.5
SIGNIFICANT = 2.0  # standard errors of an effect that is still named beside all others
FINEST = 1e-8  # squared, of the largest scatter that residuals allow; counts as none

Shape = Float[np.ndarray, "quantities levels"]


class Size(NamedTuple):
    """The size of an effect, with its standard error."""

    value: float
    error: float

    def format(self, scale: float = 1.0) -> str:
        return format_with_error(abs(scale * self.value), abs(scale) * self.error)

    def root(self, scale: float = 1.0) -> str:
        """Format the square root of a size that is a variance."""
        deviation = np.sqrt(abs(self.value))
        return format_with_error(scale * deviation, scale * self.error / (2 * deviation))

    def word(self, more: str, less: str) -> str:
        return more if self.value > 0 else less


class Candidate(NamedTuple):
    """An effect that a camera may lack.

    Attributes:
        key: the name of the effect, one word.
        shape: change of mean, variance and covariance along rows and along columns for a size of 1;
            None where there is no change. For a scatter, its standard deviation.
        sentence: function that names the missing effect with its size, as a clause.
        positive: whether its size must be positive.
    """

    key: str
    shape: Callable[[Expected, Lit], tuple[np.ndarray | float | None, ...]]
    sentence: Callable[[Size, Expected], str]
    positive: bool = False


def _noise_factor(size: Size, found: Expected) -> str:
    """Name a factor by which all noise is smaller or larger, in the dark as in light."""
    how = "as in frames that were sharpened, or in differences of frames"
    if -1 < size.value < 0:
        count = Size(1 / (1 + size.value), size.error / (1 + size.value) ** 2)
        how = "as in frames that were denoised or resized"
        if count.value > FEWEST_AVERAGED:
            how += f", or in means of {count.format()} frames or pixels (binning)"
    return (
        f"variances {size.word('larger', 'smaller')} by {size.format(100)} % at every level, "
        f"dark or light, {how}"
    )


def _filtering(along: str) -> Callable[[Size, Expected], str]:
    """Make the function that names covariances of neighbours in proportion to all noise."""
    return lambda a, e: (
        f"covariances of neighbours along {along} of {a.word('', '-')}{a.format(100)} % of the "
        "predicted variance at every level, dark or light, as in frames that were "
        f"{a.word('smoothed, resized or interpolated', 'sharpened or resized')}"
    )


def _neighbour_mixing(neighbours: str) -> Callable[[Size, Expected], str]:
    """Make the function that names mixing which the fitted gain did not include."""
    return lambda a, e: (
        f"{neighbours} {a.format(100)} % of the signal's variance (mixing of pixels, by "
        "capacitance between them or by interpolation), by which the camera's gain is then too "
        "small"
    )


CANDIDATES = (
    Candidate(
        "light",
        lambda e, at: (*e.by_light[:2], None, None),
        lambda a, e: (
            f"{a.format(100)} % {a.word('more', 'less')} light than stated, or a quantum "
            f"efficiency {a.word('larger', 'smaller')} by that"
        ),
    ),
    Candidate(
        GAIN,
        lambda e, at: (e.signal, 2 * e.values[1], None, None),
        lambda a, e: f"a gain {a.word('larger', 'smaller')} by {a.format(100)} %",
    ),
    Candidate(
        "compression",
        lambda e, at: (-e.signal * e.share, -4 * e.share * e.shot, None, None),
        lambda a, e: (
            f"a response that is not linear: at the brightest level the mean is "
            f"{a.format(100)} % {a.word('below', 'above')} the line"
        ),
    ),
    Candidate(
        "light_offset",
        lambda e, at: (*e.by_light[:2] / np.where(at.light > 0, at.light, 1), None, None),
        lambda a, e: (
            f"{a.format()} photons {a.word('more', 'less')} in every exposure with light, as "
            "with a shutter that is late or light that leaks"
        ),
    ),
    Candidate(
        "black_level",
        lambda e, at: (1.0, None, None, None),
        lambda a, e: f"a black level {a.word('higher', 'lower')} by {a.format()} DN",
    ),
    Candidate(
        "dark_current",
        lambda e, at: (e.step * at.exposure, e.step**2 * at.exposure, None, None),
        lambda a, e: f"{a.format()} e⁻/s {a.word('more', 'less')} dark current",
    ),
    Candidate(
        "dark_subtraction",
        lambda e, at: (-e.dark_current * e.step * at.exposure, None, None, None),
        lambda a, e: (
            f"means lower by {a.format(100)} % of the dark current, though not the variances, as "
            "after a dark frame was subtracted"
        ),
        positive=True,
    ),
    Candidate(
        ALL_NOISE,
        lambda e, at: (None, *e.values[1:]),
        _noise_factor,
    ),
    Candidate(
        "filter_along_rows",
        lambda e, at: (None, None, e.before_rounding, None),
        _filtering("a row"),
    ),
    Candidate(
        "filter_along_columns",
        lambda e, at: (None, None, None, e.before_rounding),
        _filtering("a column"),
    ),
    Candidate(
        "read_noise",
        lambda e, at: (None, 1.0, None, None),
        lambda a, e: (
            f"noise of {a.root()} DN {a.word('more', 'less')} at every level, light or "
            "dark: read noise"
        ),
    ),
    Candidate(
        "row_noise",
        lambda e, at: (None, 1.0, 1.0, None),
        lambda a, e: (
            f"noise of {a.root(1 / float(e.step[0]))} e⁻ rms that the pixels of a row "
            "share, new in every frame (row noise)"
        ),
        positive=True,
    ),
    Candidate(
        "column_noise",
        lambda e, at: (None, 1.0, None, 1.0),
        lambda a, e: (
            f"noise of {a.root(1 / float(e.step[0]))} e⁻ rms that the pixels of a column "
            "share, new in every frame (column noise)"
        ),
        positive=True,
    ),
    Candidate(
        "brighter_fatter",
        lambda e, at: (None, -e.share * e.shot, e.share * e.shot / 4, e.share * e.shot / 4),
        lambda a, e: (
            "charges that repel each other (the brighter-fatter effect), which removes "
            f"{a.format(100)} % of the brightest level's variance"
        ),
        positive=True,
    ),
    Candidate(
        "mixing",
        lambda e, at: (None, -e.shot, e.shot / 4, e.shot / 4),
        lambda a, e: (
            f"neighbours that share {a.format(100)} % of the signal's variance (mixing of "
            "pixels, as by capacitance between them or by interpolation)"
        ),
        positive=True,
    ),
    Candidate(
        "sharing",
        lambda e, at: (None, None, e.shot / 4, e.shot / 4),
        _neighbour_mixing("neighbours that share"),
        positive=True,
    ),
    Candidate(
        "sharing_along_rows",
        lambda e, at: (None, None, e.shot / 2, None),
        _neighbour_mixing("neighbours along a row that share"),
        positive=True,
    ),
    Candidate(
        "sharing_along_columns",
        lambda e, at: (None, None, None, e.shot / 2),
        _neighbour_mixing("neighbours along a column that share"),
        positive=True,
    ),
    Candidate(
        "flicker_of_rows",
        lambda e, at: (None, e.by_light[0] ** 2, e.by_light[0] ** 2, None),
        lambda a, e: (
            f"light that differs by {a.root(100)} % rms from row to row of a frame, as with a "
            "flickering lamp and a rolling shutter"
        ),
        positive=True,
    ),
    Candidate(
        "shot_noise",
        lambda e, at: (None, e.by_light[1], None, None),
        lambda a, e: (
            f"shot noise whose variance is {a.format(100)} % {a.word('larger', 'smaller')} "
            "at the same mean, as if frames were "
            f"{a.word('sharpened, or electrons multiplied', 'averaged, denoised or compressed')}"
        ),
    ),
)
SCATTERS = (  # new at every level
    Candidate(
        "light_scatter",
        lambda e, at: (e.by_light[0], None, None, None),
        lambda a, e: f"light that scatters by {a.format(100)} % rms from level to level",
    ),
    Candidate(
        "black_scatter",
        lambda e, at: (1.0, None, None, None),
        lambda a, e: f"a black level that varies by {a.format()} DN rms from level to level",
    ),
    Candidate(
        "variance_scatter",
        lambda e, at: (None, e.values[1], None, None),
        lambda a, e: f"variances that scatter by {a.format(100)} % rms from level to level",
    ),
    Candidate(
        "", lambda e, at: (None, None, e.values[1], e.values[1]), lambda a, e: ""
    ),  # of unknown cause
)


# A linear camera calibrated on a curved response also has wrong slopes: each of these effects
# explains little without the others.
TOGETHER = (
    ("gain", "light"),
    ("compression", "light"),
    ("compression", "gain"),
    ("compression", "gain", "light"),
    ("filter_along_rows", "filter_along_columns"),
    (ALL_NOISE, "filter_along_rows", "filter_along_columns"),
)


@dataclass(frozen=True)
class Missing:
    """An effect that the camera file lacks and that the frames show.

    Attributes:
        key: of the candidate for the effect.
        clause: a clause that names the missing effect and its size.
        strength: significance of the effect, in standard errors.
        after: agreement of each quantity when this effect and those before it are included.
    """

    key: str
    clause: str
    strength: float
    after: dict[str, Agreement]


def missing_effects(comparison: Comparison) -> tuple[Missing, ...]:
    """Find the missing effects that explain a camera's misfit; () without a misfit."""
    agreement = comparison.agreement
    if all(one.ratio <= 1 for one in agreement.values() if one.is_missed):
        return ()
    fit, found = _Fit(comparison), []
    while len(found) < MOST and fit.is_missed:
        left = {one.key: one for one in CANDIDATES}
        for named in found:
            left.pop(named.key, None)
        tried = [(one,) for one in left.values()]
        tried += [tuple(left[key] for key in keys) for keys in TOGETHER if left.keys() >= set(keys)]
        gains = [fit.gain_of(*some) for some in tried]
        earned = [gain - PRICE * len(some) for some, gain in zip(tried, gains, strict=True)]
        best = int(np.argmax(earned))
        if earned[best] < 0:
            break
        if len(tried[best]) == 1:
            found.append(fit.take(tried[best][0], gains[best]))
            continue
        alone = {
            one: gains[best] - fit.gain_of(*(other for other in tried[best] if other is not one))
            for one in tried[best]
        }
        for one in sorted(alone, key=lambda one: -alone[one]):
            found.append(fit.take(one, alone[one]))
    for place, scatter in enumerate(SCATTERS):
        gain = fit.gain_of_scatter(place) if scatter.key else 0.0
        if gain >= PRICE and fit.is_missed:
            found.append(fit.take_scatter(place, gain))
    return fit.restated(found)


class _Fit:
    """A generalised least-squares fit of the chosen effects to the residuals of all quantities."""

    def __init__(self, comparison: Comparison) -> None:
        self._comparison, self._found, self._taken = comparison, comparison.found, []
        self._values = np.zeros(0)
        self._apply_effects(self._values)
        self._named = np.zeros(len(SCATTERS), bool)
        self._take_noise()
        most = np.log(np.sum(self._missed**2) + 1)
        self._bounds = [(most + np.log(FINEST), most)] * len(SCATTERS)
        self._logs = np.full(len(SCATTERS), most - 5)
        self._logs = self._fit_scatters(self._columns)

    def _take_noise(self) -> None:
        """Divide residuals, covariances and signatures by the frames' expected noise."""
        comparison = self._comparison
        self._unit = np.sqrt(noise(comparison.levels, self._found)).ravel()
        self._known = np.eye(self._unit.size)
        self._known = self._known + comparison.camera / np.outer(self._unit, self._unit)
        squares = np.array([self._shape(one) ** 2 for one in SCATTERS])
        self._scales = np.maximum(squares.max(axis=1), 1e-300)
        self._squares = squares / self._scales[:, None]
        shapes = [self._shape(one) for one in self._taken]
        self._columns = np.array(shapes).reshape(-1, self._unit.size).T
        left = (comparison.measured - self._found.values).ravel() / self._unit
        self._missed = left + self._columns @ self._values  # linear about the current sizes

    @property
    def is_missed(self) -> bool:
        """Whether a significant misfit remains with the chosen effects."""
        return any(one.is_missed and one.ratio > 1 for one in self.agreement().values())

    def gain_of(self, *some: Candidate) -> float:
        """Return the decrease of -2 log likelihood if these effects are added together."""
        shapes = np.array([self._shape(one) for one in some]).T
        sizes = np.sqrt(np.sum(shapes**2, axis=0))
        if not sizes.all():
            return -np.inf
        columns = np.column_stack([self._columns, shapes / sizes])
        logs = self._fit_scatters(columns)
        fitted = self._sizes(columns, self._covariance(logs))[0][-len(some) :]
        if any(one.positive and size < 0 for one, size in zip(some, fitted, strict=True)):
            return -np.inf
        # Restricted likelihoods with different columns are comparable after a common correction.
        return self._fit_unrestricted(self._columns, self._logs) - self._fit_unrestricted(
            columns, logs
        )

    def take(self, one: Candidate, gain: float) -> Missing:
        """Add an effect to the fit, and update the noise of the frames that it changes."""
        self._taken.append(one)
        self._values = np.append(self._values, 0.0)
        for _ in range(REFINEMENTS):
            self._take_noise()
            self._logs = self._fit_scatters(self._columns)
            self._values = self._sizes(self._columns, self._covariance(self._logs))[0]
            self._found = self._apply_effects(self._values)
        self._take_noise()
        return self._missing(one, self._chosen_sizes()[one.key], gain)

    def _chosen_sizes(self) -> dict[str, Size]:
        """Return the sizes of all chosen effects, fitted together."""
        sizes, covariance = self._sizes(self._columns, self._covariance(self._logs))
        both = zip(self._taken, sizes, np.sqrt(np.diagonal(covariance)), strict=True)
        return {one.key: Size(float(size), float(error)) for one, size, error in both}

    def restated(self, found: list[Missing]) -> tuple[Missing, ...]:
        """Return the effects that stay significant in the regression on all of them."""
        sizes, named = self._chosen_sizes() if self._taken else {}, []
        by_key = {one.key: one for one in self._taken}
        for one in found:
            size = sizes.get(one.key)
            if size is None:  # a scatter
                named.append(one)
            elif abs(size.value) > SIGNIFICANT * size.error:
                clause = by_key[one.key].sentence(size, self._comparison.found)
                named.append(replace(one, clause=clause))
        return tuple(named or found)

    def _apply_effects(self, sizes: np.ndarray) -> Expected:
        """Return the prediction with effects of these sizes, that of the gain last."""
        found = self._comparison.found
        lines = {"row_noise": found.rows, "column_noise": found.columns}
        values, behind, gain = found.values.copy(), np.zeros_like(found.values), 0.0
        for one, size in zip(self._taken, sizes, strict=True):
            if one.key == GAIN:
                gain = float(size)
                continue
            total = behind if one.key in BEHIND_GAIN else values
            total += float(size) * self._shape_of(one).reshape(values.shape)
            if one.key == ALL_NOISE:
                values[1] += found.rounding
            if one.key in lines:
                lines[one.key] += max(float(size), 0.0)
        self._gain, self._signal = gain, found.signal + values[0] - found.values[0]
        self._noise = np.concatenate([values[1:2] - found.rounding, values[2:]])
        values[0] += gain * self._signal
        values[1:] += (2 + gain) * gain * self._noise
        values += behind
        values[1] = np.maximum(values[1], found.values[1] / LEAST_SHARE)
        rows, columns = lines.values()
        return replace(found, values=values, rows=rows, columns=columns)

    def gain_of_scatter(self, place: int) -> float:
        """Return the decrease of -2 log likelihood by a scatter beside the chosen effects."""
        logs = np.where(np.arange(len(SCATTERS)) == place, -np.inf, self._logs)
        return self._fit_unrestricted(self._columns, logs) - self._fit_unrestricted(
            self._columns, self._logs
        )

    def take_scatter(self, place: int, gain: float) -> Missing:
        """Report a scatter as an effect, and include it in the agreement."""
        self._named[place] = True
        value = float(np.sqrt(np.exp(self._logs[place]) / self._scales[place]))
        levels = np.count_nonzero(self._squares[place])
        return self._missing(SCATTERS[place], Size(value, value / np.sqrt(2 * levels)), gain)

    def agreement(self) -> dict[str, Agreement]:
        """Return each quantity's agreement with the chosen effects and scatters."""
        levels, found = self._comparison.noise.shape[1], {}
        own = self._covariance(np.where(self._named, self._logs, -np.inf))
        left = self._missed - self._columns @ self._sizes(self._columns, own)[0]
        for name, before in self._comparison.agreement.items():
            place = np.ravel([np.arange(levels) + row * levels for row in PARTS[name]])
            part = own[np.ix_(place, place)]
            chi_square = float(left[place] @ np.linalg.solve(part, left[place]))
            used = np.any(self._columns[place] != 0, axis=0).sum()
            found[name] = Agreement(chi_square, max(before.degrees - float(used), 1.0))
        return found

    def _missing(self, one: Candidate, size: Size, gain: float) -> Missing:
        clause = one.sentence(size, self._comparison.found)
        return Missing(one.key, clause, float(np.sqrt(gain)), self.agreement())

    def _shape(self, one: Candidate) -> np.ndarray:
        """Return a candidate's signature at the current gain, over the frames' noise."""
        gain = 1 + self._gain
        if one.key == GAIN:
            return np.concatenate([self._signal, *(2 * gain * self._noise)]) / self._unit
        factors = np.full(len(self._comparison.noise), gain**2)
        factors[0] = gain
        if one.key in BEHIND_GAIN:
            factors[:] = 1.0
        return self._shape_of(one) * np.repeat(factors, len(self._signal)) / self._unit

    def _shape_of(self, one: Candidate) -> np.ndarray:
        """Return the signature of a candidate, DN and DN^2."""
        rows = one.shape(self._comparison.found, self._comparison.lit)[
            : len(self._comparison.noise)
        ]
        none = np.zeros(self._comparison.noise.shape[1])
        return np.concatenate([none if row is None else none + row for row in rows])

    def _covariance(self, logs: np.ndarray) -> np.ndarray:
        return self._known + np.diag(np.exp(logs) @ self._squares)

    def _fit_scatters(self, columns: np.ndarray) -> np.ndarray:
        """Fit the log variances of the scatters by restricted likelihood, beside `columns`."""

        def cost(logs: np.ndarray) -> tuple[float, np.ndarray]:
            covariance = self._covariance(logs)
            inverse = np.linalg.inv(covariance)
            of = inverse @ columns
            inner = columns.T @ of
            apart = inverse - of @ np.linalg.pinv(inner) @ of.T
            left = apart @ self._missed
            slope = self._squares @ (np.diagonal(apart) - left**2) * np.exp(logs)
            _, size = np.linalg.slogdet(covariance)
            _, more = np.linalg.slogdet(inner) if columns.size else (1.0, 0.0)
            return float(self._missed @ left + size + more), slope

        start = np.clip(self._logs, *np.transpose(self._bounds))
        found = minimize(cost, start, jac=True, bounds=self._bounds, method="L-BFGS-B")
        return found.x

    def _fit_unrestricted(self, columns: np.ndarray, logs: np.ndarray) -> float:
        covariance = self._covariance(logs)
        sizes, _ = self._sizes(columns, covariance)
        left = self._missed - columns @ sizes
        return float(left @ np.linalg.solve(covariance, left)) + float(
            np.linalg.slogdet(covariance)[1]
        )

    def _sizes(self, columns: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fit sizes of effects by generalised least squares; return them and their covariance."""
        unit = np.sqrt(np.sum(columns**2, axis=0))
        scaled = columns / unit
        of = np.linalg.solve(covariance, scaled)
        inverse = np.linalg.pinv(scaled.T @ of)
        return inverse @ (of.T @ self._missed) / unit, inverse / np.outer(unit, unit)
