"""Find a problem's scene and camera among its records, and the fields that its parameters set."""

from collections.abc import Callable, Collection, Iterator
from typing import Any

import numpy as np
from jaxtyping import Array

from jaxvision import Camera, Scene
from jaxvision.effects.certificate import Effect
from jaxvision.effects.pruning import removals
from jaxvision.errors import InputError
from jaxvision.rendering import PixelSamples

from ..inference.parameters import Parameter, scalars
from ..inference.problem import Problem
from ..inference.records import head, is_path, reach, read, replaced

BEYOND = 1e-9  # probability that a prior leaves to either side of the box

Box = dict[str, tuple[Any, Any]]


def named_record(problem: Problem, kind: type) -> str:
    """Return the name of the only record of a kind."""
    found = [name for name, record in problem.records.items() if isinstance(record, kind)]
    if len(found) != 1:
        raise InputError(
            f"The records of the problem hold {len(found)} {kind.__name__} records; exactly one "
            "is needed."
        )
    return found[0]


def records_of(problem: Problem) -> dict[str, Any]:
    """Return the problem's records, with the problem's fixed numbers inserted."""
    fixed = {name: value for name, value in problem.fixed.items() if is_path(name)}
    return replaced(problem.records, fixed)


def box_of(problem: Problem) -> Box:
    """Return the range of every number of the scene and the camera that a parameter sets."""
    seen, camera = named_record(problem, Scene), named_record(problem, Camera)
    records = records_of(problem)
    box = dict(_boxes(problem, records, (seen, camera)))
    return box | _lights_before(records[seen], box)


def removable_effects(
    problem: Problem, *, samples: PixelSamples | None = None, depth: int | None = None
) -> tuple[dict[str, Effect], Callable[[Collection[str]], Problem | None]]:
    """Return the effects that can be dropped from a problem's records, by name, and a function that
    takes some of these names and returns the problem without those effects. The function returns
    None if a parameter needs one of the effects or if they cannot be dropped together.
    """
    seen, camera = named_record(problem, Scene), named_record(problem, Camera)
    records = records_of(problem)
    named = (*(parameter.name for parameter in problem.free), *problem.fixed, *problem.tied)
    fields = (_field(records, n)[0] for n in named if is_path(n) and head(n) in (seen, camera))
    kept: dict[str, Any] = {field[len(head(field)) + 1 :]: () for field in fields}
    kept |= _lights_before(records[seen], kept)
    effects, left = removals(
        records[seen], records[camera], free=kept, samples=samples, depth=depth
    )

    def problem_without(names: Collection[str]) -> Problem | None:
        both = left(names)
        if both is None:
            return None
        changed = problem.records | {seen: both[0], camera: both[1]}
        return problem.with_records(changed, left_out=problem.left_out)

    return effects, problem_without


def _boxes(
    problem: Problem, records: dict[str, Any], among: tuple[str, ...]
) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield the name and the range of each free field. The range of a fixed field is one value; a
    tied field is refused.
    """
    for name in problem.tied:
        if is_path(name) and head(name) in among:
            raise InputError(f"called_for: {name} is tied, so its range is unknown.")
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
    """Return the path of the array that contains a number, and the number's index in it."""
    parent, _, last = path.rpartition("[")
    if parent and last[:-1].isdigit() and isinstance(reach(records, parent), Array):
        return parent, int(last[:-1])
    return path, ...


def _ends(parameter: Parameter) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and largest value that bounds and priors allow."""
    shape, each = parameter.shape or (), []
    for number in scalars(parameter, shape):
        low = max(float(np.asarray(number.lower)), 0.0 if number.transform == "log" else -np.inf)
        high = float(np.asarray(number.upper))
        if number.prior is not None:
            least, most = number.prior.quantile(np.array([BEYOND, 1 - BEYOND]))
            low, high = max(low, float(least)), min(high, float(most))
        each.append((low, high))
    if not np.isfinite(each).all():
        raise InputError(
            f"called_for: {parameter.name} has no end; give it bounds or a prior, so that the "
            "dropped effects stay small wherever the fit may go."
        )
    low, high = np.transpose(each)
    return low.reshape(shape), high.reshape(shape)


def _lights_before(scene: Scene, box: Box) -> Box:
    """Return single-valued ranges for the lights before the last one that a path names. These
    lights are thereby kept, so that the indices in the paths stay valid.
    """
    numbers = [int(name[7:].partition("]")[0]) for name in box if name.startswith("lights[")]
    found = {}
    for k in range(max(numbers, default=0)):
        name = scene.lights[k].spectra[0]
        value = np.asarray(getattr(scene.lights[k], name))
        found.setdefault(f"lights[{k}].{name}", (value, value))
    return {name: ends for name, ends in found.items() if name not in box}
