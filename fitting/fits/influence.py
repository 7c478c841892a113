"""Compute how far each effect of a scene and a camera moves a fitted quantity.

L is the log posterior and L' the log posterior without an effect. By a step of Newton's method, the
maximum moves from the optimum v by

    -H'^-1 (grad L'(v) - grad L(v)) = H^-1 J^T W (change of the prediction) + ...,

where H and H' are the Hessians of L and L', J is the Jacobian of the prediction and W the weights
of the data. Each further step is smaller by about the same factor q, so the steps that are not
computed sum to at most q / (1 - q) times the last one. The bound is the shift by all computed steps
plus this remainder. If the steps do not contract, a search from the optimum finds the mode without
the effect.

Source:
    Becker and Rannacher, "An optimal control approach to a posteriori error estimation in finite
    element methods", Acta Numerica 10, 2001: the error of one number, by the adjoint at a solution.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxvision.core.in_notebooks import record_html
from jaxvision.errors import InputError, nearest
from jaxvision.rendering import PixelSamples

from ..inference.differences import correct_by_differences
from ..inference.formatting import format_with_error
from ..inference.given import require_kind
from ..inference.problem import Problem
from ..inference.search import derivatives, search
from ..inference.streams import chunks
from .depicted import removable_effects
from .information import Target, slope_of, target_name
from .result import Fit
from .solve import fit

_STEPS = 8  # steps of Newton's method before a search replaces them
_SHARE = 0.1  # share of a shift (or _LEAST standard errors) that may remain after the last step
_LEAST = 1e-4
_SLOWEST = 0.5  # ratio of two steps from which the remainder is not trusted


@dataclass(frozen=True)
class Moved:
    """How far an estimate moves if one effect is left out.

    Attributes:
        effect: name of the effect, as in `jaxvision.effects.inspect`.
        shift: change of the estimate without the effect, in standard errors.
        bound: largest possible shift, in standard errors; inf where nothing is known.
        ratio: standard error without the effect, relative to that with it.
        fall: decrease of the log density at the best fit without the effect.
    """

    effect: str
    shift: float
    bound: float
    ratio: float
    fall: float


@dataclass(frozen=True)
class Influence:
    """How far each effect of a scene and a camera moves a fitted quantity, largest bound first.
    Print the record to see the effects.

    Attributes:
        target: name of the fitted quantity.
        value: the quantity at the best fit, in its unit.
        sd: standard error of the quantity.
        effects: how far each effect moves the quantity if it is left out alone, the largest bound
            first.

    Example:
        >>> from fitting.fits.influence import Influence, Moved
        >>> dark = Moved("sensor.dark_current", 0.02, 0.021, 1.0, 0.1)
        >>> Influence("gain", 0.25, 0.001, (dark,)).shift_by("sensor.dark_current").bound
        0.021
    """

    target: str
    value: float
    sd: float
    effects: tuple[Moved, ...]

    def shift_by(self, effect: str) -> Moved:
        """Return how far the estimate moves without one effect.

        Args:
            effect: name of the effect.

        Returns:
            The shift and its bound, in standard errors.

        Raises:
            InputError: for an unknown effect.
        """
        known = {one.effect: one for one in self.effects}
        if effect not in known:
            raise InputError(f"No effect {effect!r}; {nearest(effect, known)}.")
        return known[effect]

    def of(self, effect: str) -> Moved:
        """Former name of `shift_by`."""
        warnings.warn("of is now shift_by.", DeprecationWarning, stacklevel=2)
        return self.shift_by(effect)

    def __str__(self) -> str:
        width = max((len(one.effect) for one in self.effects), default=0)
        rows = [
            "  ".join(["", name.ljust(width), f"{shift:>9}", most.ljust(15), *rest])
            for name, shift, most, *rest in self._rows()
        ]
        return "\n".join([self._heading(), *rows])

    def _heading(self) -> str:
        found = format_with_error(self.value, self.sd)
        return f"{self.target} = {found}; without an effect it moves by, in standard errors"

    def _rows(self) -> list[tuple[str, str, str, str, str]]:
        return [
            (
                one.effect,
                f"{one.shift:+.2g}",
                f"at most {one.bound:.2g}",
                f"s.e. x {one.ratio:.3g}",
                f"ln p {-one.fall:+.2g}",
            )
            if np.isfinite(one.bound)
            else (one.effect, "?", "not bounded", "", "")
            for one in self.effects
        ]

    def _repr_html_(self) -> str:
        heads = ("without", "moves by", "at most", "its standard error", "log density")
        return record_html(heads, self._rows(), title=self._heading())


def influence(
    fitted: Fit | Problem,
    target: Target,
    *,
    samples: PixelSamples | None = None,
    depth: int | None = None,
) -> Influence:
    """Compute how far a fitted quantity would move if each effect of the scene and the camera were
    left out.

    Usually no fit is repeated. From the change of every pixel's prediction and noise, a few
    gradients at the best fit give the shift and a bound on it. If an effect is so large that
    Newton's steps do not contract, a search from the best fit solves the problem without the
    effect. The bound assumes that the steps continue to contract as the last two did, and that no
    other optimum becomes better.

    Args:
        fitted: a fit, or a problem, which is fitted. It has one `Scene` and one `Camera` among its
            records, and `predict` renders them unchanged.
        target: a free number by its name or the last part of its path, or a JAX function that
            returns one number.
        samples, depth: of the images that `predict` renders, as in `jaxvision.effects.inspect`.

    Returns:
        For each effect that can be dropped: the shift of the target and its bound in standard
        errors, the ratio of standard errors, and the decrease of the log density.

    Raises:
        InputError: for records without a scene and a camera, an unknown target, and a fit that did
            not end at a maximum.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Gaussian, Parameter, Problem, influence
        >>> floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
        >>> lamps = [jv.PointLight([0, 0, 2], [8.0]), jv.PointLight([0, 0, 20], [8.0])]
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0, 0, 3], down, 0.2, resolution=(4, 4))
        >>> problem = Problem(
        ...     {"scene.lights[0].intensity": Parameter(lower=1.0, upper=20.0)},
        ...     predict=lambda scene, camera: jv.render(scene, camera.view),
        ...     likelihood=Gaussian(sd=0.01),
        ...     data=jv.render(jv.Scene(floor, lamps), view),
        ...     records={"scene": jv.Scene(floor, lamps), "camera": jv.Camera(view, jv.Sensor())},
        ... )
        >>> second = influence(problem, "intensity[0]").shift_by("lights[1]")
        >>> round(second.shift, 1)  # 1 % of 8 over .041
        2.0
    """
    found = fit(fitted) if isinstance(fitted, Problem) else fitted
    require_kind("influence: fitted", found, Fit, source="fit")
    value, sd, measure = measure_effects(found, target)
    effects, left = removable_effects(found.problem, samples=samples, depth=depth)
    alone = {name: left((name,)) for name in effects}
    moved = [measure(name, less) for name, less in alone.items() if less is not None]
    ranked = sorted(moved, key=lambda one: -one.bound)
    return Influence(target_name(target), value, sd, tuple(ranked))


def measure_effects(
    found: Fit, target: Target
) -> tuple[float, float, Callable[[str, Problem], Moved]]:
    """Return the value of the target, its standard error, and a function. The function takes a name
    for some effects and the problem without these effects, and returns how far the target moves.
    """
    problem, optimum = found.problem, found.optimum
    if optimum.saddle or not optimum.stationary:
        raise InputError(f"influence: the fit did not end at a maximum. {' '.join(found.failures)}")
    at, information = np.asarray(optimum.vector, np.float64), optimum.curvature
    value, slope = slope_of(problem, target, at)
    sd = float(np.sqrt(slope @ found.posterior.covariance @ slope))
    linear = float(np.sqrt(slope @ np.linalg.solve(information, slope)))
    begun, start = (x[0] for x in derivatives(at[None], problem, parts=chunks(problem))[:2])
    own = np.sqrt(2 * max(optimum.decrement, 0.0))  # standard errors from the maximum

    def measure_shift(
        name: str, end: np.ndarray, rest: float, cost: float, curvature: Any
    ) -> Moved:
        there, slope = slope_of(problem, target, end)
        ratio = float(np.sqrt(slope @ np.linalg.solve(curvature, slope))) / linear
        shift = (there - value) / sd
        return Moved(name, shift, abs(shift) + rest + own, ratio, float(cost - begun))

    def step_to_mode(name: str, less: Problem) -> Moved | None:
        by, before = np.zeros_like(at), np.inf
        for _ in range(_STEPS):
            cost, gradient, curvature = (
                x[0] for x in derivatives((at + by)[None], less, parts=chunks(less))
            )
            if not (np.isfinite(gradient).all() and np.linalg.eigvalsh(curvature)[0] > 0):
                return None
            step = -np.linalg.solve(curvature, gradient - start)
            by, size = by + step, float(np.sqrt(step @ information @ step))
            ratio = size / before if before > 0 else 0.0
            if np.isfinite(before) and ratio < _SLOWEST:
                found = measure_shift(name, at + by, size * ratio / (1 - ratio), cost, curvature)
                if found.bound - abs(found.shift) <= max(_SHARE * abs(found.shift), _LEAST) + own:
                    return found
            before = size
        return None

    def search_mode(name: str, less: Problem) -> Moved:
        end = correct_by_differences(less, search(less, at[None]))
        if not end.stationary or end.saddle or less.stream is not None:
            return Moved(name, np.nan, np.inf, np.nan, np.nan)
        rest = np.sqrt(2 * max(end.decrement, 0.0))
        return measure_shift(name, end.vector, rest, end.cost, end.curvature)

    def step_or_search(name: str, less: Problem) -> Moved:
        return (None if optimum.unseen else step_to_mode(name, less)) or search_mode(name, less)

    return value, sd, step_or_search
