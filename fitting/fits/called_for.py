"""A problem without negligible effects of its scene and camera.

`jaxvision.effects` bounds the change that each effect makes in a pixel's distribution, over the
whole box of the fitted parameters. Effects below a tolerance are dropped from the records, and so
from the prediction and from the likelihood of the sensor. The problem has the certificate, and the
report of a fit lists it.
"""

from collections.abc import Iterator
from typing import Any

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
from ..inference.parameters import Parameter, scalars
from ..inference.problem import Problem, likelihood_at, prediction, values_at
from ..inference.records import head, is_path, reach, read, replaced

BEYOND = 1e-9  # probability that a prior leaves to either side of the box

Box = dict[str, tuple[Any, Any]]


def called_for(
    problem: Problem,
    *,
    tolerance: float = 0.1,
    samples: PixelSamples | None = None,
    depth: int | None = None,
) -> Problem:
    """Drop the effects of a problem's scene and camera that no fit of it can detect.

    An error that all n data share is not averaged over them, so each datum may change by the
    tolerance over sqrt(n). To first order, no estimate then changes by more than the tolerance in
    its standard deviations.

    Args:
        problem: has one `Scene` and one `Camera` among its records, and `predict` must render them
            unchanged. Each parameter whose path leads into them has bounds or a prior.
        tolerance: largest change of the expected data, in standard deviations of the noise of all
            data together, as the sensor has it in the dark.
        samples, depth: of the images that `predict` renders, as in `jaxvision.effects.inspect`.

    Returns:
        The problem with the reduced records; its certificate is in `left_out`. Parameters that are
        free, fixed or tied by a path are kept, and lights keep their indices up to the last index
        in a path.

    Raises:
        InputError: for records without a scene and a camera, for a parameter without an end, and
            where simulated data of the two problems differ: then `predict` renders something else.

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
    seen, camera = _named(problem, Scene), _named(problem, Camera)
    fixed = {name: value for name, value in problem.fixed.items() if is_path(name)}
    records = replaced(problem.records, fixed)
    box = dict(_boxes(problem, records, (seen, camera)))
    box |= _lights_before(records[seen], box)
    count = problem.data.size if problem.present is None else int(problem.present.sum())
    if problem.stream is not None:  # of which the data are a sample
        count *= problem.stream.count / problem.data.shape[0]
    each = Tolerance(tolerance / np.sqrt(max(count, 1)), "sigma", place=0.0)
    pruned = prune(records[seen], records[camera], each, free=box, samples=samples, depth=depth)
    left = problem.records | {seen: pruned.scene, camera: pruned.camera}
    smaller = problem.with_records(left, left_out=pruned.certificate)
    _refuse_another_law(problem, smaller, 1 + 10 * tolerance)
    return smaller


def _refuse_another_law(whole: Problem, left: Problem, limit: float) -> None:
    """`InputError` if the log ratio of the two likelihoods on simulated data exceeds the limit. If
    only small effects were dropped, the ratio is about the tolerance."""
    if not abs(float(_log_ratio(whole, left))) <= limit:
        raise InputError(
            "called_for: without what was left out, simulated data would be quite another; predict "
            "must show the scene through the camera as the records hold them."
        )


@eqx.filter_jit
def _log_ratio(whole: Problem, left: Problem) -> Array:
    """ln of the likelihood ratio for data drawn from the first likelihood, at the middle of the
    priors."""
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


def _named(problem: Problem, kind: type) -> str:
    found = [name for name, record in problem.records.items() if isinstance(record, kind)]
    if len(found) != 1:
        raise InputError(
            f"called_for: the records hold {len(found)} of {kind.__name__}; exactly one is needed."
        )
    return found[0]


def _boxes(
    problem: Problem, records: dict[str, Any], among: tuple[str, ...]
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Return the range of each free field, by name. Fixed fields, and fields that depend on others,
    have one value or none."""
    for name in problem.tied:
        if is_path(name) and head(name) in among:
            raise InputError(f"called_for: {name} is tied, so that nothing is known of its range.")
    known = {p.name: _ends(p) for p in problem.free} | {n: (v, v) for n, v in problem.fixed.items()}
    fields: dict[str, list[np.ndarray]] = {}
    for path, ends in known.items():
        if not is_path(path) or head(path) not in among:
            continue
        field, within = _field(records, path)
        own = np.asarray(read(records, field), float)
        low, high = fields.setdefault(field, [own.copy(), own.copy()])
        low[within], high[within] = ends
    for field, (low, high) in fields.items():
        yield field[len(head(field)) + 1 :], (low, high)


def _field(records: dict[str, Any], path: str) -> tuple[str, Any]:
    """The array to which or into which a path leads, and the index in it."""
    parent, _, last = path.rpartition("[")
    if parent and last[:-1].isdigit() and isinstance(reach(records, parent), Array):
        return parent, int(last[:-1])
    return path, ...


def _ends(parameter: Parameter) -> tuple[np.ndarray, np.ndarray]:
    """The smallest and largest value that bounds and priors allow."""
    shape = parameter.shape or ()
    each = np.array([_ends_of(number) for number in scalars(parameter, shape)])
    if not np.isfinite(each).all():
        raise InputError(
            f"called_for: {parameter.name} has no end; give it bounds or a prior, so that what is "
            "left out stays small wherever the fit may go."
        )
    low, high = each.T
    return low.reshape(shape), high.reshape(shape)


def _ends_of(number: Parameter) -> tuple[float, float]:
    low = max(float(np.asarray(number.lower)), 0.0 if number.transform == "log" else -np.inf)
    high = float(np.asarray(number.upper))
    if number.prior is None:
        return low, high
    least, most = number.prior.quantile(np.array([BEYOND, 1 - BEYOND]))
    return max(low, float(least)), min(high, float(most))


def _lights_before(scene: Scene, box: Box) -> Box:
    """Boxes with a single value, for lights before the last one that a path names, so that the
    indices stay valid."""
    numbers = [int(name[7:].partition("]")[0]) for name in box if name.startswith("lights[")]
    found = {}
    for k in range(max(numbers, default=0)):
        name = scene.lights[k].spectra[0]
        value = np.asarray(getattr(scene.lights[k], name))
        found.setdefault(f"lights[{k}].{name}", (value, value))
    return {name: ends for name, ends in found.items() if name not in box}
