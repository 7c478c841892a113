"""Reduce a problem to the effects of its scene and camera that are not negligible.

`jaxvision.effects` bounds the change that each effect makes in a pixel's distribution, over all
allowed values of the fitted parameters. Effects below a tolerance are dropped from the records of
scene and camera, so that neither the prediction nor the sensor's likelihood computes them. The new
problem keeps the bounds as a certificate, which the report of a fit lists. For a target quantity,
effects that hardly move its best estimate are dropped too.
"""

from collections.abc import Collection
from dataclasses import replace
from itertools import count, islice

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxvision import Camera, Scene
from jaxvision.effects import Tolerance, prune
from jaxvision.errors import InputError
from jaxvision.rendering import PixelSamples

from ..inference.given import require_kind
from ..inference.problem import Problem, likelihood_at, prediction, values_at
from .depicted import box_of, named_record, records_of, removable_effects
from .influence import measure_effects
from .information import Target, target_name
from .solve import fit

_PROVED = 0.1  # share of the tolerance for effects that are dropped before a fit


def called_for(
    problem: Problem,
    *,
    tolerance: float = 0.1,
    target: Target | None = None,
    samples: PixelSamples | None = None,
    depth: int | None = None,
) -> Problem:
    """Drop the effects of a problem's scene and camera that no fit of the problem can detect.

    An error that all n data share does not average out, so each datum may change by at most the
    tolerance over sqrt(n). To first order, no estimate then changes by more than the tolerance
    times its standard deviation.

    Args:
        problem: has one `Scene` and one `Camera` among its records, and `predict` must render them
            unchanged. Each parameter whose path leads into them has bounds or a prior.
        tolerance: largest change of the expected data, in standard deviations of the noise of all
            data together. The noise is that of the sensor in the dark.
        target: a fitted number, as in `influence`; None drops only effects that are negligible for
            every number, without a fit. For a target, the problem is fitted. Further effects are
            then dropped if together they move the target by at most the tolerance times its
            standard error, change the standard error by at most the same share, and do not worsen
            the description of the data. The bounds of these effects apply near the best fit, not
            over all ranges. In the certificate these effects have rank "estimate", and `bound` is
            the size of a change of all data that would move the target equally.
        samples, depth: of the images that `predict` renders, as in `jaxvision.effects.inspect`.

    Returns:
        The problem with the reduced records; its certificate is in `left_out`. Parameters that are
        free, fixed or tied by a path are kept, and lights keep their indices up to the last index
        in a path.

    Raises:
        InputError: for records without a scene and a camera, for a parameter without bounds or
            prior, and if simulated data of the two problems differ, which means that `predict` does
            not render the scene as the records describe it.

    Example:
        >>> import jaxvision as jv
        >>> from fitting import Parameter, Problem, SensorNoise, called_for
        >>> floor = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.25]))
        >>> lamps = [jv.PointLight([0, 0, z], [1.0]) for z in (2.0, 9000.0)]
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0, 0, 3], down, 0.2, resolution=(4, 4))
        >>> sensor = jv.Sensor(read_noise=3.0, gain=100.0)
        >>> problem = Problem(
        ...     {"scene.lights[0].intensity": Parameter(lower=0.5, upper=2.0)},
        ...     predict=lambda scene, camera: jv.render(scene, camera.view),
        ...     likelihood=SensorNoise("camera.sensor"),
        ...     data=np.ones((4, 4, 1)),
        ...     records={"scene": jv.Scene(floor, lamps), "camera": jv.Camera(view, sensor)},
        ... )
        >>> len(called_for(problem).records["scene"].lights)
        1
    """
    require_kind("called_for: problem", problem, Problem)
    seen, camera = named_record(problem, Scene), named_record(problem, Camera)
    records = records_of(problem)
    size = problem.data.size if problem.present is None else int(problem.present.sum())
    if problem.stream is not None:  # the data are a sample of the stream
        size *= problem.stream.count / problem.data.shape[0]
    share, each = 1.0 if target is None else _PROVED, tolerance / np.sqrt(max(size, 1))
    pruned = prune(
        records[seen],
        records[camera],
        Tolerance(share * each, "sigma", place=0.0),
        free=box_of(problem),
        samples=samples,
        depth=depth,
    )
    left = problem.records | {seen: pruned.scene, camera: pruned.camera}
    smaller = problem.with_records(left, left_out=pruned.certificate)
    if not abs(float(_log_ratio(problem, smaller))) <= _limit(tolerance):
        raise InputError(
            "called_for: simulated data change too much without the dropped effects; predict must "
            "render the scene and the camera of the records unchanged."
        )
    if target is None:
        return smaller
    left_over = (1 - _PROVED) * tolerance
    return _unseen_by(target, smaller, left_over, each / tolerance, samples, depth)


def _limit(tolerance: float) -> float:
    """Return the largest accepted change of the log density of all data without the dropped
    effects."""
    return 1 + 10 * tolerance


def _unseen_by(
    target: Target,
    problem: Problem,
    tolerance: float,
    each: float,
    samples: PixelSamples | None,
    depth: int | None,
) -> Problem:
    """Return the problem without the effects that together move a fitted quantity by at most the
    tolerance, in standard errors. `each` is the change of every datum, in standard deviations of
    its noise, that moves the quantity by one standard error.
    """
    _, _, measure = measure_effects(fit(problem), target)
    effects, left = removable_effects(problem, samples=samples, depth=depth)

    def shift(names: Collection[str]) -> float:
        """Return a bound on the shift in standard errors; inf if the data's distribution or the
        standard error changes.
        """
        less = left(names)
        if less is None:
            return np.inf
        found = measure("", less)
        same = abs(np.log(found.ratio)) <= tolerance and abs(found.fall) <= _limit(tolerance)
        return found.bound if same else np.inf

    bounds = {name: shift((name,)) for name in effects}
    ranked = sorted(bounds, key=lambda name: bounds[name])
    within = np.cumsum([bounds[name] for name in ranked]) <= tolerance
    gone = [name for name, fits in zip(ranked, within, strict=True) if fits]
    while gone and not shift(gone) <= tolerance:
        gone.pop()
    if not gone:
        return problem
    smaller, proved = left(gone), problem.left_out
    before = {effect.name for effect in proved.dropped}
    names = {_numbered_before(name, before): name for name in gone}
    dropped, kept = [], []
    for effect in proved.kept:
        name = names.get("shadows" if effect.name.startswith("shadows[") else effect.name)
        if name is None:
            kept.append(effect)
            continue
        why = f"moves {target_name(target)} by at most {bounds[name]:.2g} standard errors"
        dropped.append(replace(effect, bound=bounds[name] * each, rank="estimate", why=why))
    certificate = replace(
        proved,
        kept=tuple(kept),
        dropped=(*proved.dropped, *dropped),
        estimated=sum(bounds[name] for name in gone) * each,
        tolerance=proved.tolerance / _PROVED,
    )
    assert smaller is not None
    return smaller.with_records(smaller.records, left_out=certificate)


def _numbered_before(name: str, gone: set[str]) -> str:
    """Return the name of an effect with the index that its light or surface had before some were
    dropped.
    """
    kind, _, rest = name.partition("[")
    number, _, field = rest.partition("]")
    whole = "lights" if kind == "shadows" else kind
    if not number.isdigit() or whole not in ("lights", "surfaces"):
        return name
    left = (k for k in count() if f"{whole}[{k}]" not in gone)
    return f"{kind}[{next(islice(left, int(number), None))}]{field}"


@eqx.filter_jit
def _log_ratio(whole: Problem, left: Problem) -> Array:
    """Return the log likelihood ratio of the whole problem to the reduced one. The data are drawn
    from the whole problem at the middle of the priors. If only small effects were dropped, the
    result is of the order of the tolerance.
    """
    values = values_at(whole, jnp.zeros(len(whole.space)))
    seen = [prediction(problem, values) for problem in (whole, left)]
    known = [likelihood_at(problem, values) for problem in (whole, left)]
    drawn = known[0].draw(jax.random.key(0), seen[0])
    first, second = (
        likelihood.log_density(light, drawn) for likelihood, light in zip(known, seen, strict=True)
    )
    return jnp.sum(
        second - first if whole.present is None else jnp.where(whole.present, second - first, 0)
    )
