"""Suppression of results from chains that are too short."""

from ..inference.trust import convergence_in_words
from .section import Section


def without_short_chains(section: Section, *, kept: bool) -> Section:
    """Return the section, without its estimates if a chain is too short."""
    short = [(group, one) for group, one in section.posteriors.items() if one.missing_steps]
    if not short:
        return section
    group, worst = max(short, key=lambda pair: pair[1].missing_steps)
    steps = f"--steps {worst.steps + worst.missing_steps}"
    if kept:
        remedy = f"allow {steps} and run again: it goes on from here."
    else:
        remedy = f"allow {steps}; with --out it would go on from here."
    why = f"{group}{': ' if group else ''}{convergence_in_words(worst)[:-1]}; {remedy}"
    return Section(
        kind=section.kind,
        title=section.title,
        estimates=(),
        findings=(why,),
        about=section.about,
        settings=section.settings,
        inputs=section.inputs,
        failure=why,
    )
