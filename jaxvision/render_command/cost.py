"""Measure the standard error and the time of a render, and state them in one line."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import NamedTuple

import jax
import numpy as np

from ..files.scenes.schema import RenderEntry

_FEW = 4  # samples below which the error of half of the pictures of two scenes was larger
_TARGETS = tuple(step * 10.0**power for power in range(0, -9, -1) for step in (3, 1))


class Cost(NamedTuple):
    """The time of a render and its standard error.

    Attributes:
        error: rms standard error of the pixels divided by the rms radiance; None for one ray per
            pixel.
        seconds: time to compute all pixels of the picture, without compilation, s. If there are
            workers, this is the sum of the times of all workers.
        compiling: time of tracing and compilation, s.
        workers: number of worker processes that computed the picture; 0 if this process computed
            it.
    """

    error: float | None
    seconds: float
    compiling: float
    workers: int = 0


class Clock:
    """Measures the time of a `with` block, in s, divided into compilation and the rest."""

    def __init__(self) -> None:
        self._started = monotonic()
        self._spans: list[tuple[float, float]] = []

    def add(self, event: str, duration_secs: float, **_: object) -> None:
        """Record the duration of a compilation event of JAX. Events are nested, so the start and
        the end of each are recorded."""
        if event.startswith("/jax/core/compile/"):
            now = monotonic()
            self._spans.append((now - duration_secs, now))

    def read(self) -> tuple[float, float]:
        """Return the seconds so far without compilation, and the seconds of compilation."""
        compiling, reached = 0.0, self._started
        for start, end in sorted(self._spans):
            compiling += max(end - max(start, reached), 0.0)
            reached = max(end, reached)
        return max(monotonic() - self._started - compiling, 0.0), compiling


@contextmanager
def time_block() -> Iterator[Clock]:
    """Yield a `Clock` for a `with` block, which also records the times of JAX's compilations."""
    clock = Clock()
    jax.monitoring.register_event_duration_secs_listener(clock.add)
    try:
        yield clock
    finally:
        jax.monitoring.unregister_event_duration_listener(clock.add)


def relative_error(rows: Iterable[np.ndarray], bands: int) -> float | None:
    """Return the rms standard error divided by the rms radiance, over all pixels and bands with
    finite numbers. Return None for a picture without light. The option `--accuracy` refers to the
    same norm."""
    light, squares = 0.0, 0.0
    for block in rows:
        radiance, error = np.split(block.astype(np.float64), [bands], axis=-1)
        finite = np.isfinite(radiance) & np.isfinite(error)
        light += float((radiance[finite] ** 2).sum())
        squares += float((error[finite] ** 2).sum())
    return float(np.sqrt(squares / light)) if light > 0 else None


def cost_sentence(cost: Cost, settings: RenderEntry) -> str:
    """Make the last line of a render's output: the samples, the error in %, the time in s, and the
    time that a smaller error would take."""
    took = _seconds(cost.seconds)
    if cost.workers:
        took += f" of work on {cost.workers} worker{'s' * (cost.workers != 1)}"
    if cost.compiling >= 0.1:
        took += f" and {_seconds(cost.compiling)} of compiling"
    samples = f"{settings.samples} sample{'s' * (settings.samples != 1)} a pixel"
    if cost.error is None:
        return f"{samples}: no standard error, {took}."
    # The passes of "light" are independent. Other samples are stratified, so that the error is
    # usually smaller, unless the samples are too few to meet the rare bright paths
    few = settings.samples < _FEW
    bound = "" if settings.integrator == "light" else "about " if few else "usually at most "
    sentence = f"{samples}: standard error {bound}{100 * cost.error:.2g} % of the rms radiance"
    sentence += f", {took}"
    target = next((t for t in _TARGETS if 0 < 1.5 * t <= cost.error), None)
    if target is not None:
        longer = _seconds(cost.seconds * (cost.error / target) ** 2)
        share = f"{100 * target:.3g}"
        sentence += f"; {share} % would take about {longer} (--accuracy {share}%)"
    return f"{sentence}.{_BESIDE.get(_kind(settings), '')}"


_BESIDE = {
    "radiosity": " The error of its patches is not included; --accuracy measures both.",
    "rule": " The error of the quadrature over lights is not included; --accuracy measures both.",
}


def _kind(settings: RenderEntry) -> str:
    """Return a word for the part of a picture's error that does not depend on the number of
    samples; "" if there is none."""
    if settings.integrator == "radiosity":
        return "radiosity"
    by_rule = settings.integrator in ("direct", "rays") and settings.rule == "quadrature"
    return "rule" if by_rule else ""


def _seconds(seconds: float) -> str:
    """Format a time in a readable unit."""
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 100 else f"{seconds:.0f} s"
    return f"{seconds / 60:.2g} min" if seconds < 5400 else f"{seconds / 3600:.2g} h"
