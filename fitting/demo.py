"""`jaxvision-fit demo`: simulate a lab afternoon to files, calibrate from the files alone, and set
truth beside estimate."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .formatting import format_interval, format_unit, format_value
from .lab import Truth, rgb
from .results import Estimate, Section, Table

Key = tuple[str, str, str]  # section kind, estimate name, group


@dataclass(frozen=True)
class Comparison:
    """An estimate beside the value it was simulated with."""

    kind: str
    estimate: Estimate
    truth: float

    @property
    def inside_68(self) -> bool:
        return _inside(self.truth, self.estimate.interval_68)

    @property
    def inside_95(self) -> bool:
        return _inside(self.truth, self.estimate.interval_95)


def _inside(value: float, interval: tuple[float, float] | None) -> bool:
    return interval is not None and interval[0] <= value <= interval[1]


def truths(truth: Truth) -> dict[Key, float]:
    """What the lab was simulated with, under the names of the estimates."""
    values: dict[Key, float] = {
        ("noise", "system_gain", ""): truth.system_gain,
        ("noise", "quantum_efficiency", ""): truth.quantum_efficiency,
        ("noise", "read_noise", ""): truth.read_noise,
        ("noise", "dsnu", ""): truth.dsnu,
        ("noise", "prnu", ""): truth.prnu,
    }
    for channel in rgb(truth.diffuse):
        values["response", "gamma", channel] = truth.gamma
        values["brdf", "exponent", channel] = truth.exponent
        values["brdf", "diffuse", channel] = rgb(truth.diffuse)[channel]
        values["brdf", "specular", channel] = rgb(truth.specular)[channel]
    return values


def compare(sections: Iterable[Section], truth: Truth) -> list[Comparison]:
    """Every estimate whose truth is known, with that truth."""
    known = truths(truth)
    return [
        Comparison(section.kind, estimate, known[section.kind, estimate.name, estimate.group])
        for section in sections
        for estimate in section.estimates
        if (section.kind, estimate.name, estimate.group) in known and estimate.value is not None
    ]


def comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """Truth against estimate with its 68 and 95 % intervals, and how many of them hold it."""
    rows = tuple(
        (
            c.estimate.group,
            c.estimate.name.replace("_", " "),
            f"{c.truth:g}",
            format_value(c.estimate),
            format_unit(c.estimate.unit),
            format_interval(c.estimate, 68),
            format_interval(c.estimate, 95),
            "68 %" if c.inside_68 else "95 %" if c.inside_95 else "outside",
            c.estimate.method,
        )
        for c in comparisons
    )
    held_68, held_95 = (
        sum(getattr(c, name) for c in comparisons) for name in ("inside_68", "inside_95")
    )
    count = len(comparisons)
    return Table(
        "Truth against estimate",
        ("channel", "quantity", "truth", "estimate", "unit", "68 %", "95 %", "truth in", "method"),
        rows,
        f"{held_68} of {count} truths lie in their 68 % interval (about {0.68 * count:.0f} are "
        f"expected) and {held_95} in their 95 % interval (about {0.95 * count:.0f}).",
    )


def lab_folder(out: Path) -> Path:
    """Where the simulated images go."""
    return out / "lab"
