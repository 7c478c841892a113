"""The report of a coverage check."""

from collections.abc import Mapping

from ..inference.formatting import format_percent
from ..report.section import Section, Table
from .coverage import LEVELS, Coverage


def line(one: Coverage) -> str:
    """Describe the coverage of one parameter in one line of text."""
    shares = ", ".join(
        f"{format_percent(q)}: {share:.3f}" for q, share in zip(LEVELS, one.covered, strict=True)
    )
    return (
        f"{one.name}: {one.simulations} fits; {shares}; z {one.z_mean:+.2f} ± {one.z_sd:.2f}"
        f"{'' if not one.faults else '  OUTSIDE'}"
    )


def section(kind: str, cases: Mapping[str, tuple[Coverage, ...]], simulations: int) -> Section:
    """Return the report on the coverage in all simulated cases of one kind of fit."""
    faults = tuple(
        f"{case}, {one.name}: {'; '.join(one.faults)}."
        for case, parameters in cases.items()
        for one in parameters
        if one.faults
    )
    withheld = tuple(
        f"{case}: {simulations - most} of {simulations} fits gave no interval and are not counted."
        for case, parameters in cases.items()
        for most in [max(one.simulations for one in parameters)]
        if most < simulations
    )
    rows = tuple(
        (
            *(case, one.name, one.simulations, *one.covered),
            *(" to ".join(f"{end:.3f}" for end in one.band[-1]), one.z_mean, one.z_sd),
            *(one.departure, one.allowed),
        )
        for case, parameters in cases.items()
        for one in parameters
        if one.simulations
    )
    table = Table(
        title="Coverage",
        columns=(
            *("case", "parameter", "fits", "50 %", "68 %", "95 %"),
            *("95 %, by chance", "z mean", "z s.d.", "ranks", "ranks, by chance"),
        ),
        rows=rows,
        caption="Share of fits to simulated data whose interval contains the true value. `ranks` "
        "is the largest distance of the distribution of ranks (the cumulative probability of the "
        "true value in its posterior) from the uniform one. Of a hundred checks of correct fits, "
        "one has a figure outside its band.",
    )
    chance = "Every figure is within its band for this number of fits."
    return Section(
        kind="check",
        title=f"Check of {kind} on simulated data",
        estimates=(),
        findings=(*(faults or (chance,)), *withheld),
        pictures=(),
        tables=(table,),
        posteriors={},
        settings={"kind": kind, "simulations": simulations},
    )
