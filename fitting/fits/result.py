"""`Fit`: the result of fitting a problem, and its report."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.core.in_notebooks import record_html
from jaxvision.errors import InputError, nearest

from ..inference.candidates import Choice
from ..inference.design import Plan
from ..inference.estimates import Estimate
from ..inference.formatting import format_interval, format_p, format_unit, format_value
from ..inference.joint_prior import JointPrior, Selection, posterior_prior
from ..inference.misfit import Misfit
from ..inference.on_host import to_host
from ..inference.posterior import Posterior, estimates
from ..inference.problem import Problem, as_arrays, records_at, values_from
from ..inference.search import Optimum
from ..inference.trust import cost_in_words
from ..report.figures import empty_panels
from ..report.section import Picture, Section, Table
from .bands import Bands, bands, evaluate_draws, simulate_data, thinned_draws
from .budget import Budget, Noise, budget
from .information import Target, plan
from .words import agreeing, prior_share

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxvision.effects.certificate import Certificate


@dataclass(frozen=True)
class Fit:
    """The result of fitting a problem. Print it, or show it in a notebook.

    Attributes:
        problem: the problem that was fitted.
        optimum: the mode of the unconstrained values, and where the searches ended.
        posterior: draws of the parameters.
        misfit: chi-square and the correlation of neighbouring residuals.
        residuals: standardised residuals, of the data's shape; for data in chunks, those of a
            sample. NaN where a datum is missing.
        failures: why the fit did not converge, in sentences; empty if it did.
        findings: further sentences for the reader.
        noise: factor by which the noise of the data was widened because of a misfit; 1 for none.
        settings: settings of the fit, for its report.
        choices: whether each candidate was kept, and the evidence.
        seconds: time that the fit took, s.

    Example:
        >>> from fitting import Gaussian, Parameter, Problem, fit
        >>> likelihood, data = Gaussian(sd=0.2), np.array([1.9, 2.0, 2.0, 2.1])
        >>> mean = Problem({"m": Parameter(start=1.0)}, lambda m: m * jnp.ones(4), likelihood, data)
        >>> found = fit(mean)
        >>> one, = found.estimates
        >>> round(one.value, 4), round(one.standard_error, 4)  # 0.2 / sqrt(4)
        (2.0, 0.1)
    """

    problem: Problem
    optimum: Optimum
    posterior: Posterior
    misfit: Misfit
    residuals: Float[np.ndarray, "..."]
    failures: tuple[str, ...]
    findings: tuple[str, ...]
    noise: float = 1.0
    settings: dict[str, Any] = field(default_factory=dict)
    choices: tuple[Choice, ...] = ()
    seconds: float = float("nan")

    @property
    def converged(self) -> bool:
        """Return whether the fit can be used. The search must have ended at a maximum that
        describes the data within their noise or with an allowed misfit, and a sampler's draws must
        be reliable.
        """
        return not self.failures

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Return the value, standard error, and 68 and 95 % intervals of every free number, in its
        unit.
        """
        return estimates(self.posterior)

    @property
    def values(self) -> dict[str, np.ndarray]:
        """Return the best-fit values by name, in natural units; fixed and tied numbers are
        included.
        """
        found = values_from(self.problem, jnp.asarray(self.posterior.mode))
        return {name: np.asarray(value) for name, value in found.items()}

    @property
    def draws(self) -> dict[str, np.ndarray]:
        """Return the posterior draws (chains, draws, ...) of every free parameter by name, in its
        unit.
        """
        found, begin = {}, 0
        for parameter in self.problem.free:
            shape = parameter.shape or ()
            size = int(np.prod(shape))
            part = self.posterior.draws[..., begin : begin + size]
            found[parameter.name] = part.reshape(*part.shape[:2], *shape)
            begin += size
        return found

    def record(self, name: str) -> Any:
        """Return a record of the problem, such as a camera, with the best-fit values.

        Args:
            name: name of the record in the problem.

        Returns:
            The record.

        Raises:
            InputError: for an unknown name.
        """
        return self._record_of(name, jnp.asarray(self.posterior.mode))

    def records(self, name: str, *, draws: int = 200) -> Any:
        """Return posterior draws of a record: the record with a leading axis at every number.

        `jax.vmap` over the result propagates the uncertainty through any function of the record.
        `jaxvision.write_camera(fit.record("camera"), file, draws=fit.records("camera"))` stores it.

        Args:
            name: name of the record in the problem.
            draws: number of draws.

        Returns:
            The record; every number has the shape (draws, ...).

        Raises:
            InputError: for an unknown name.
        """
        thinned = jnp.asarray(thinned_draws(self.posterior, draws))
        return eqx.filter_vmap(lambda natural: self._record_of(name, natural))(thinned)

    def _record_of(self, name: str, natural: Array) -> Any:
        records = records_at(self.problem, values_from(self.problem, natural))
        if name not in records:
            raise InputError(f"There is no record {name!r}; {nearest(name, records)}.")
        return jax.tree.map(jnp.asarray, records[name])

    def as_prior(self, names: Selection = "*") -> JointPrior:
        """Return the posterior of some parameters, with its correlations, as a prior for another
        problem.

        The density is Gaussian on the unconstrained scale, or Student's t if the standard errors
        were estimated from few groups. Intervals that were widened for a misfit stay wide. The
        other parameters of the earlier fit are marginalised. The new problem must have new data,
        because data used in both fits would count twice.

        Args:
            names: a name, a pattern such as "camera.*", several of them, or new names by old ones
                ({"gain": "camera.sensor.gain"}, {"camera.*": "left.*"}).

        Returns:
            The prior, for `Problem(..., prior=...)`.

        Raises:
            InputError: for a name that matches nothing, a fit that did not converge, and a
                posterior that is not Gaussian.

        Example:
            >>> from fitting import Gaussian, Parameter, Problem, fit
            >>> def level(data, prior=None):
            ...     like, free = Gaussian(sd=0.2), {"m": Parameter(start=1.0)}
            ...     return Problem(free, lambda m: m * jnp.ones(2), like, data, prior=prior)
            >>> first = fit(level([1.9, 2.0]))
            >>> second = fit(level([2.0, 2.1], first.as_prior("m")))
            >>> one, = second.estimates
            >>> round(one.value, 4), round(one.standard_error, 4)  # of four data, 0.2 / sqrt(4)
            (2.0, 0.1)
        """
        if self.failures:
            raise InputError(
                f"as_prior: the fit did not converge, so that it cannot be a prior: "
                f"{self.failures[0]}"
            )
        shapes = {parameter.name: parameter.shape or () for parameter in self.problem.free}
        return posterior_prior(self.posterior, shapes, names, words=self._widening_remark())

    def _widening_remark(self) -> tuple[str, ...]:
        """Return a remark if the prior from this fit is wider than its data alone imply."""
        before = () if self.problem.prior is None else self.problem.prior.words
        if self.noise > 1:
            return (
                *before,
                "The prior comes from a fit with a misfit; the errors from its data are multiplied "
                f"by {self.noise:.3g}.",
            )
        if self.posterior.freedom is not None:
            return (
                *before,
                "The prior comes from a fit whose groups share errors; its intervals include them.",
            )
        return before

    def derived(self, function: Callable[..., Any], *, draws: int = 1000) -> Bands:
        """Compute a function of the parameters, with intervals from the posterior draws.

        Args:
            function: any JAX function that returns one array. Its arguments are named like those of
                `predict`; `**given` receives all parameters (paths too) and records by name.
            draws: number of draws.

        Returns:
            Mean, standard deviation and intervals, in the unit of the returned array.

        Raises:
            InputError: for a function with an unknown argument, and for one that returns no array.

        Example:
            >>> from fitting import Gaussian, Parameter, Problem, fit
            >>> problem = Problem(
            ...     {"a": Parameter(start=0.0), "b": Parameter(start=0.0)},
            ...     predict=lambda a, b: jnp.stack([a, b]),
            ...     likelihood=Gaussian(sd=0.1),
            ...     data=[1.0, 2.0],
            ... )
            >>> total = fit(problem).derived(lambda a, b: a + b)
            >>> abs(float(total.sd) - 0.1 * 2**0.5) < 0.01
            True
        """
        thinned = thinned_draws(self.posterior, draws)
        return bands(to_host(evaluate_draws(self.problem, function, jnp.asarray(thinned))))

    def predictive(self, inputs: Any = None, *, draws: int = 1000) -> Bands:
        """Predict data, with the uncertainty of the parameters and the noise.

        Args:
            inputs: arrays that replace the problem's inputs; None for the fitted data.
            draws: number of draws; the ends of 95 % intervals need many.

        Returns:
            Mean and bands, in the unit of the data. A new datum lies within `interval_95` in 95 of
            100 cases. Where a misfit has widened the noise, the widened noise is used. An error
            that the groups of `Clustered` share is not included.
        """
        thinned = jnp.asarray(thinned_draws(self.posterior, draws))
        keys = jax.random.split(jax.random.key(self.posterior.seed), len(thinned))
        given = self.problem.inputs
        if inputs is not None:
            given = jax.tree.map(jnp.asarray, as_arrays(inputs))
        return bands(
            to_host(simulate_data(self.problem, keys, thinned, given, jnp.asarray(self.noise)))
        )

    def plan(self, candidates: Mapping[str, Any], target: Target, *, repeats: int = 1) -> Plan:
        """Rank candidate measurements by how much each would reduce the uncertainty of a quantity.

        Args:
            candidates: inputs of each candidate by its name, as `predict` takes them.
            target: the quantity whose error is to decrease: a free number by its name or the last
                part of its path, or a JAX function that returns one number.
            repeats: number of times that each candidate would be measured.

        Returns:
            Expected standard deviation of the target after each candidate, the smallest first.

        Raises:
            InputError: for inputs that `predict` cannot use, and for an unknown target.

        Example:
            >>> from fitting import Gaussian, Parameter, Problem, fit
            >>> line = Problem(
            ...     {"base": Parameter(start=0.0), "slope": Parameter(start=0.0)},
            ...     predict=lambda base, slope, inputs: base + slope * inputs,
            ...     likelihood=Gaussian(sd=0.1),
            ...     data=[1.0, 2.1],
            ...     inputs=np.array([0.0, 1.0]),
            ... )
            >>> places = {"at 0.5": np.array([0.5]), "at 3": np.array([3.0])}
            >>> fit(line).plan(places, target="slope").best
            'at 3'
        """
        fitted = self.problem, self.optimum, self.posterior
        return plan(*fitted, candidates, target, widened=self.noise, repeats=repeats)

    def budget(
        self,
        target: Target,
        *,
        noise: Noise | None = None,
        nuisances: Mapping[str, Sequence[str]] | None = None,
    ) -> Budget:
        """Divide the variance of an estimated quantity among its sources.

        Args:
            target: a free number by its name or the last part of its path, or a JAX function that
                returns one number.
            noise: variance of a datum by source, in the square of the data's unit: a number, an
                array of the data's shape, or a function of the prediction. None takes the noise
                sources of the sensor in `SensorNoise`; for any other likelihood all noise is one
                source.
            nuisances: names of parameters whose priors count together as one source ({"lights":
                [...]}); every other parameter with a prior is a source of its own.

        Returns:
            Shares of the variance, which sum to 1.

        Raises:
            InputError: for sources that exceed the noise of the likelihood, and unknown names.
        """
        return budget(
            *(self.problem, self.optimum, self.posterior, target),
            count=self.misfit.count,
            widened=self.noise,
            noise=noise,
            nuisances=nuisances,
        )

    def to_arviz(self) -> Any:
        """Return the draws for ArviZ as a DataTree (InferenceData before ArviZ 1.0). Array
        parameters keep their dimensions.

        Returns:
            Groups `posterior`, `observed_data` and, for a sampled posterior, `sample_stats`.

        Raises:
            InputError: when ArviZ is not installed.
        """
        try:
            import arviz
        except ImportError as error:
            raise InputError("to_arviz needs ArviZ: pip install arviz.") from error
        density = self.posterior.log_density
        data = to_host(self.problem.data)
        if self.problem.present is not None:
            data = np.where(to_host(self.problem.present), data, np.nan)
        groups: dict[str, Any] = {"posterior": self.draws, "observed_data": {"data": data}}
        if density is not None:
            groups["sample_stats"] = {"lp": density}
        if arviz.__version__.startswith("0."):
            return arviz.from_dict(**groups)
        return arviz.from_dict(groups)

    def write(self, folder: Path | str, *, title: str = "Fit") -> list[Path]:
        """Write the report: `report.html`, `results.json` and the draws as NetCDF.

        Args:
            folder: folder for the report, created if needed.
            title: title of the page.

        Returns:
            Paths of the files.
        """
        from ..report.page import write_report

        return write_report(
            Path(folder),
            [section(self, title)],
            title=title,
            seed=self.posterior.seed,
            settings=self.settings,
        )

    def summary(self) -> str:
        """Return one line with chi-square and the number of searches that agree."""
        checks, starts = self.misfit, len(self.optimum.costs)
        p = f" ({format_p(checks.p)})" if np.isfinite(checks.p) else ""
        left = f"{checks.dof:.5g} degrees" if checks.dof >= 1 else "less than one degree"
        return (
            f"chi-square {checks.chi_square:.5g} for {left} of freedom{p}; "
            f"{agreeing(self.optimum)} of {starts} starts reached this optimum"
        )

    def _heading(self) -> str:
        state = "converged" if self.converged else "NOT CONVERGED"
        count = len(self.problem.space)
        free = f"{count} parameter{'s' * (count > 1)}"
        return f"Fit of {free} to {self.misfit.count} data: {state}"

    def _rows(self) -> list[tuple[str, ...]]:
        before, _ = prior_share(self.problem.space, self.posterior)
        return [
            (
                estimate.name,
                format_value(estimate),
                format_unit(estimate.unit),
                format_interval(estimate, 68),
                format_interval(estimate, 95),
                "" if np.isinf(width) else f"{width:.3g}",
            )
            for estimate, width in zip(self.estimates, before, strict=True)
        ]

    def __str__(self) -> str:
        rows = [HEADS, *self._rows()]
        widths = [max(len(row[i]) for row in rows) for i in range(len(HEADS))]
        lines = [
            "  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            for row in rows
        ]
        cost = cost_in_words([self.posterior], self.seconds)
        remarks = [f"• {sentence}" for sentence in (*self.failures, *self.findings, cost)]
        text = [self._heading(), *lines, self.summary(), *remarks]
        return "\n".join(line.rstrip() for line in text)

    def __repr__(self) -> str:
        return f"<{self._heading()}>"

    def _repr_html_(self) -> str:
        return record_html(
            HEADS,
            self._rows(),
            title=self._heading(),
            summary=self.summary(),
            notes=(
                *(*self.failures, *self.findings),
                cost_in_words([self.posterior], self.seconds),
            ),
        )


HEADS = ("parameter", "value ± s.e.", "unit", "68 %", "95 %", "s.d. before")


def section(fit: Fit, title: str) -> Section:
    """Return a fit's section of the report."""
    before, share = prior_share(fit.problem.space, fit.posterior)
    rows = tuple(
        (parameter.name, None if np.isinf(width) else float(width), float(part))
        for parameter, width, part in zip(fit.problem.space, before, share, strict=True)
    )
    table = Table(
        "Before and after the data",
        ("parameter", "s.d. before", "after / before"),
        rows,
        "A ratio near 1: the estimate comes from the prior or the bounds, not from the data.",
    )
    terms = Table(
        "Candidate terms",
        ("term", "stays", "standard errors from absent", "needed"),
        tuple((one.name, str(one.kept), one.ratio, one.needed) for one in fit.choices),
        "A term is kept if BIC favours it and chance does not explain it.",
    )
    left_out = fit.problem.left_out
    gone = () if left_out is None else (left_out_table(left_out),)
    cost = cost_in_words([fit.posterior], fit.seconds)
    state = ("The fit did not converge.",) if fit.failures else ()
    picture = Picture(
        "residuals",
        "Residuals",
        "In standard deviations. If the model describes the data, they show no pattern.",
        partial(residual_figure, fit.residuals),
    )
    return Section(
        kind="fit",
        title=title,
        estimates=fit.estimates,
        findings=(*state, *fit.failures, f"{fit.summary()}.", *fit.findings, cost),
        pictures=(picture,),
        tables=(table, *(terms,) * bool(fit.choices), *gone),
        posteriors={"": fit.posterior},
        arrays={p.name: p.shape for p in fit.problem.free if p.shape},
    )


def left_out_table(certificate: "Certificate") -> Table:
    """Tabulate the effects that `called_for` dropped, with bounds in the certificate's unit."""
    from jaxvision.effects.certificate import summary

    rows = tuple((e.name, e.bound, e.place, e.rank, e.why) for e in certificate.dropped)
    heads = ("effect", f"bound [{certificate.unit}]", "moves by [pixels]", "rank", "why")
    return Table("Left out", heads, rows, summary(certificate))


def residual_figure(residuals: np.ndarray) -> "Figure":
    """Draw the standardised residuals: an image of the first channel for picture data, points in
    order for other data.
    """
    figure, axis = empty_panels((6, 4))
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
