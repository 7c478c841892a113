"""The report of a fit."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from jaxvision.effects.certificate import Certificate, summary

from ..report.section import Picture, Section, Table
from .words import prior_share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .result import Fit


def section(fit: "Fit", title: str) -> Section:
    """A fit as its reader sees it.

    Args:
        fit: of any problem.
        title: heading.

    Returns:
        Estimates, findings, the prior beside the posterior, and the residuals.
    """
    before, share = prior_share(fit.problem.space, fit.posterior)
    rows = tuple(
        (parameter.name, None if np.isinf(width) else float(width), float(part))
        for parameter, width, part in zip(fit.problem.space, before, share, strict=True)
    )
    table = Table(
        "Before and after the data",
        ("parameter", "s.d. before", "after / before"),
        rows,
        "A ratio near 1: only the prior or the bounds are seen.",
    )
    terms = Table(
        "Candidate terms",
        ("term", "stays", "standard errors from absent", "needed"),
        tuple((one.name, str(one.kept), one.ratio, one.needed) for one in fit.choices),
        "A term stays if it pays for its numbers by BIC and is no chance.",
    )
    left_out = fit.problem.left_out
    gone = () if left_out is None else (left_out_table(left_out),)
    state = ("The fit did not converge.",) if fit.failures else ()
    picture = Picture(
        "residuals",
        "Residuals",
        "In standard deviations; a model that describes its data leaves even noise.",
        partial(residual_figure, fit.residuals),
    )
    return Section(
        kind="fit",
        title=title,
        estimates=fit.estimates,
        findings=(*state, *fit.failures, f"{fit.summary()}.", *fit.findings),
        pictures=(picture,),
        tables=(table, *(terms,) * bool(fit.choices), *gone),
        posteriors={"": fit.posterior},
        arrays={p.name: p.shape for p in fit.problem.free if p.shape},
    )


def left_out_table(certificate: Certificate) -> Table:
    """What `called_for` left out, with its bounds.

    Args:
        certificate: of the problem.

    Returns:
        A row for each effect, bounds in the certificate's unit.
    """
    rows = tuple((e.name, e.bound, e.place, e.rank, e.why) for e in certificate.dropped)
    heads = ("effect", f"bound [{certificate.unit}]", "moves by [pixels]", "rank", "why")
    return Table("Left out", heads, rows, summary(certificate))


def residual_figure(residuals: np.ndarray) -> "Figure":
    """Standardised residuals: a picture of the first channel, or points in order.

    Args:
        residuals: of any shape, in standard deviations.

    Returns:
        The figure.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axis = figure.subplots()
    if residuals.ndim >= 2 and min(residuals.shape[:2]) > 2:
        picture = residuals.reshape(*residuals.shape[:2], -1)[..., 0]
        shown = axis.imshow(picture, cmap="RdBu_r", vmin=-4, vmax=4)
        figure.colorbar(shown, ax=axis, label="standard deviations")
    else:
        axis.plot(residuals.ravel(), ".", ms=4)
        axis.axhline(0, color="black", lw=0.5)
        axis.set_xlabel("datum")
        axis.set_ylabel("standard deviations")
    return figure
