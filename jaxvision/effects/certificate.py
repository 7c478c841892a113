"""Records that list which effects were kept and which were dropped, with upper bounds on the change
of the picture.

A bound is a supremum over all pixels. The change of a pixel is the distance between the
distributions of its value before rounding, with and without an effect: sqrt((m_1 - m_2)^2 + (s_1 -
s_2)^2) with means m and standard deviations s. For Gaussian distributions this is the 2-Wasserstein
distance; the docstring of the module `pixel` discusses other distributions. A shift of the mean by
d gives the distance d. Noise that is dropped gives the difference of the two standard deviations.
The distance obeys the triangle inequality, so the bounds of effects that are dropped one after
another add. `place` is a separate bound: the largest displacement in the picture, in pixels. A
displacement is bounded separately because, at an edge, even a small one may change a pixel by any
amount. The bounds are for exact integrals over the area of lights, not for a sampling rule.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from ..core._shown import aligned_columns
from ..core.in_notebooks import record_html
from ..errors import InputError
from ..scene import Camera, Scene, View

Rank = Literal["exact", "bound", "estimate"]
Unit = Literal["relative", "DN", "sigma"]

RADIANCE, IRRADIANCE, DN = "W m^-2 sr^-1", "W m^-2", "DN"
_WORDS = {
    "%": ("relative", 0.01),
    "": ("relative", 1.0),
    "dn": ("DN", 1.0),
    "sigma": ("sigma", 1.0),
}
_NUMBER = re.compile(r"([0-9.]+(?:e[+-]?[0-9]+)?)\s*(%|dn|sigma|)", re.IGNORECASE)


@dataclass(frozen=True)
class Tolerance:
    """The largest change of a picture that dropped effects may cause.

    Attributes:
        value: largest distance, as defined in `effects.certificate`, >= 0, in `unit`.
        unit: "relative": radiance divided by the reference radiance `level` of the certificate;
            "DN"; "sigma": the sensor's noise in the dark, which is its smallest noise.
        place: largest displacement in the image, pixels; None for 0.1, or 0 if the value is 0.
        rare: largest expected number of pixels that differ by any amount, such as dead ones; None
            for 0.01, or 0 if the value is 0.

    Raises:
        InputError: for a number below 0 or NaN, an infinite value, or an unknown unit.
    """

    value: float
    unit: Unit = "relative"
    place: float = None  # pyright: ignore[reportAssignmentType]
    rare: float = None  # pyright: ignore[reportAssignmentType]

    def __post_init__(self) -> None:
        for name, usual in (("place", 0.1), ("rare", 0.01)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, usual if self.value > 0 else 0.0)
        for name in ("value", "place", "rare"):
            number = getattr(self, name)
            if not number >= 0:
                raise InputError(f"Tolerance.{name} must be at least 0, got {number}.")
        if math.isinf(self.value):
            raise InputError(
                "Tolerance.value must be finite: effects without a bound are never dropped."
            )
        if self.unit not in get_args(Unit):
            words = ", ".join(get_args(Unit))
            raise InputError(f"Tolerance.unit must be one of {words}, got {self.unit!r}.")


def parse(text: str, *, place: float | None = None, rare: float | None = None) -> Tolerance:
    """Read a tolerance from text, as on a command line.

    Args:
        text: a number and its unit: "1%" or "0.01" of the level of radiance, "0.5DN", "0.1sigma".
        place: largest displacement in the image, pixels; None for 0.1, or 0 for a tolerance of 0.
        rare: largest expected number of pixels that differ by any amount; None for 0.01, or 0 for a
            tolerance of 0.

    Returns:
        The tolerance.

    Raises:
        InputError: for any other text, and for a number of 1 or more without a unit: it would mean
            at least 100 %, so a "%" is probably missing.

    Example:
        >>> from jaxvision import effects
        >>> print(effects.parse("0.5DN"))
        Tolerance(value=0.5, unit='DN', place=0.1, rare=0.01)
    """
    found = _NUMBER.fullmatch(text.strip())
    unit, scale = _WORDS[found[2].lower()] if found else ("", 0.0)
    try:
        value = float(found[1]) * scale if found else np.inf
    except ValueError:
        value = np.inf
    if not np.isfinite(value):
        raise InputError(
            f"a tolerance is a number and its unit, as in 1%, 0.5DN or 0.1sigma, got {text!r}."
        )
    if found and not found[2] and value >= 1:
        instead = f"write {value:g}% or {value / 100:g}" if value < 100 else "give less, as in 1%"
        raise InputError(
            f"a tolerance of {value:g} without a unit is {100 * value:g} %; {instead}."
        )
    return Tolerance(value, unit, place, rare)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Effect:
    """One effect of a scene or a camera, with a bound on its change of the picture.

    Attributes:
        name: path of the field in the original scene: "lights[2]", "shadows[2]",
            "surfaces[0].material.specular", "sensor.read_noise".
        present: whether the scene or camera contains the effect.
        why: reason for the bound, or for there being none, in a few words.
        bound: largest change of the result without the effect, in `unit`; inf where there is no
            bound.
        place: largest displacement in the image without the effect, pixels.
        unit: unit of `bound`. In a certificate, "relative", "DN" or "sigma"; in the list of
            `inspect`, "W m^-2 sr^-1" for effects of the scene, "W m^-2" for effects of the lens,
            and "DN" for effects of the sensor.
        rank: "exact": proved to change nothing; "bound": `bound` is proved; "estimate": `bound` is
            only an estimate from samples or tables.
        saves: share of the rendering time that the effect takes, from a table of benchmarks; 0 for
            an effect that is removed together with another effect.
        free: whether a fit may change the effect; then it is never removed.
        rare: expected number of pixels that the effect changes by any amount.
        seconds: rendering time that dropping the effect saves, s, as `inspect(..., time=True)`
            measured it on this machine; None if not measured.
    """

    name: str
    present: bool
    why: str
    bound: float
    place: float = 0.0
    unit: str = RADIANCE
    rank: Rank = "bound"
    saves: float = 0.0
    free: bool = False
    rare: float = 0.0
    seconds: float | None = None


@dataclass(frozen=True)
class Certificate:
    """The kept and the dropped effects of a pruned scene and camera, with a bound on the change of
    the picture by all dropped effects together.

    Attributes:
        kept: the effects that remain, with bounds in `unit`.
        dropped: the removed effects in the order of removal, with bounds in `unit`.
        total: proved bound of all removed effects together, in `unit`.
        estimated: estimate for the effects that were removed without proof, in `unit`.
        place: largest displacement in the image, pixels.
        tolerance: the allowed distance, in `unit`.
        unit: "relative", "DN" or "sigma".
        level: radiance by which bounds in the unit "relative" are divided, W m^-2 sr^-1; None for
            other units.
        assumptions: assumptions of the bounds, one sentence each.
        rare: expected number of pixels that differ by any amount.
    """

    kept: tuple[Effect, ...]
    dropped: tuple[Effect, ...]
    total: float
    estimated: float
    place: float
    tolerance: float
    unit: str
    level: float | None
    assumptions: tuple[str, ...] = ()
    rare: float = 0.0

    @property
    def saves(self) -> float:
        """The share of the rendering time that dropping the effects saves. If the effects are
        dropped one after another, each effect saves its share of the time that remains."""
        return 1 - math.prod(1 - effect.saves for effect in self.dropped)

    def _repr_html_(self) -> str:
        """Return the HTML table that a notebook shows."""
        rows = [(word, *cells) for word, cells in _rows(self)]
        last = summary(self)
        return record_html(("", *_headings(self)), rows, summary=last, notes=self.assumptions)


@dataclass(frozen=True)
class Pruned:
    """A scene and a camera from which negligible effects were dropped, ready for `render` and
    `capture`.

    Attributes:
        scene: the reduced scene.
        camera: the reduced camera; a view where only a view was given.
        samples: `PixelSamples` for `render`, or None.
        moments: number of times at which a motion is rendered.
        expand: (bands, r) no unit; the radiance of all bands is the radiance of the r bands of
            `scene` times the transpose of `expand`. None if the bands are unchanged.
        certificate: certificate of the kept and removed effects.
        depth: number of segments of a path, or None for direct light.
        threshold: argument of `render`, W m^-2 sr^-1: at each point, lights that together
            contribute at most this radiance are left out. None: all lights are used.
    """

    scene: Scene
    camera: Camera | View
    samples: Any
    moments: int | None
    expand: np.ndarray | None
    certificate: Certificate
    depth: int | None = None
    threshold: float | None = None


def _headings(certificate: Certificate) -> tuple[str, ...]:
    unit = "of level" if certificate.unit == "relative" else certificate.unit
    return "effect", f"bound ({unit})", "pixels", "saves", "rank", "why"


def _rows(certificate: Certificate) -> Iterable[tuple[str, tuple[str, ...]]]:
    """Yield "kept" or "dropped" and the cells of the table row of each effect."""
    for word, found in (("dropped", certificate.dropped), ("kept", certificate.kept)):
        for effect in found:
            why = f"free; {effect.why}" if effect.free else effect.why
            bound = "not bounded" if math.isinf(effect.bound) else f"{effect.bound:.3g}"
            if certificate.unit == "relative" and math.isfinite(effect.bound):
                bound = f"{100 * effect.bound:.2g} %" if effect.bound <= 1 else "> 100 %"
            numbers = bound, f"{effect.place:.2g}", f"{100 * effect.saves:.0f} %"
            yield word, (effect.name, *numbers, effect.rank, why)


def summary(certificate: Certificate) -> str:
    """Summarise a certificate in one sentence: the number of dropped effects, and the bound on
    their total change in the unit of the certificate (relative, DN or sigma)."""
    c, unit = certificate, "" if certificate.unit == "relative" else f" {certificate.unit}"
    count = len(c.dropped) + len(c.kept)
    line = (
        f"Dropped {len(c.dropped)} of {count}: at most {c.total:.3g}{unit} of "
        f"{c.tolerance:.3g}{unit} proved"
    )
    line += f" + {c.estimated:.3g}{unit} estimated" if c.estimated > 0 else ""
    line += f", {c.place:.2f} px"
    line += f", {c.rare:.2g} pixels by any amount" if c.rare > 0 else ""
    line += f"; relative to {c.level:.4g} W m^-2 sr^-1" if c.level is not None else ""
    line += f"; saves about {100 * c.saves:.0f} % of the work" if c.dropped else ""
    return f"{line}."


def explain(certificate: Certificate) -> str:
    """Describe a certificate in words: a line for each effect, the assumptions of the bounds, and a
    summary.

    Args:
        certificate: as `prune` returns it.

    Returns:
        Text of several lines; bounds in the certificate's unit (relative, DN or sigma),
        displacements in pixels.
    """
    table = [(word, *cells) for word, cells in _rows(certificate)]
    table = [("", *_headings(certificate)), *table]
    notes = [f"Assumed: {note}" for note in certificate.assumptions]
    return "\n".join([aligned_columns(table), *notes, summary(certificate)])
