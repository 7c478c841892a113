"""Chains that cannot be trusted yet."""

from collections.abc import Sequence

from jaxvision.errors import InputError

from ..inference.trust import convergence_in_words
from .section import Section


def refuse_short_chains(sections: Sequence[Section], *, asked: bool, kept: bool) -> None:
    """No report is written from chains that cannot be trusted.

    Args:
        sections: whose posteriors are to be reported.
        asked: whether the chains were, by `--mcmc`; else Laplace's approximation did not hold.
        kept: whether the chains are, so that the same command goes on from them.

    Raises:
        InputError: for a chain that is too short, with the steps that it lacks.
    """
    posteriors = [pair for section in sections for pair in section.posteriors.items()]
    short = [(group, posterior) for group, posterior in posteriors if posterior.missing_steps]
    if not short:
        return
    group, worst = max(short, key=lambda pair: pair[1].missing_steps)
    steps = f"--steps {worst.steps + worst.missing_steps}"
    if not asked:
        remedy = f"Laplace's approximation does not hold here, so add --mcmc {steps}."
    elif kept:
        remedy = f"allow {steps} and run again: it goes on from here."
    else:
        remedy = f"allow {steps}; with --out it would go on from here."
    raise InputError(f"{group}{': ' if group else ''}{convergence_in_words(worst)[:-1]}; {remedy}")
