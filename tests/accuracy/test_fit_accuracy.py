"""Tests that every approximation of a fit has a `Knob`, and that every `Knob` changes some
setting."""

import json
import shlex
from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from commands import called
from public_names import arguments_and_fields, ghosts, unknown, words
from scipy.stats import norm

import fitting
from fitting.accuracy import KNOBS, measured, problems
from fitting.accuracy.chains import ENDS, Density, chain_knobs
from fitting.accuracy.examples import EXAMPLES, example
from fitting.accuracy.knobs import RIG_KNOBS
from fitting.accuracy.rigs import fits_of
from fitting.cli import app
from fitting.inference.parameters import Parameter, scalars
from fitting.rig import load_rig
from jaxvision.accuracy import Knob, Problem, curve
from jaxvision.errors import InputError

# A public argument or field with one of these names trades error for time and needs a `Knob` ...
WORDS = words("""
tolerance rtol atol max_steps starts draws steps walkers chains acceptance coarse rounds count width
reach window sampling posterior most_bins simulations repeats iterations max_iterations terms nodes
knots panels subdivisions degree refine cutoff
""")
# ... except these, where the word means something else: a result, a number of things or of data,
# simulated repeats, a quantity shared by several fits, or the subject of a certificate.
OTHER = words("""
*.sensitivities.* *.samples.cells_of.width
*.Posterior.* *.Chain.* *.Bands.draws *.*Solution.steps *.Grouping.count *.Grid.count *.Cells.count
*.budget.posterior *.budget.count *.plan.posterior *.method_of.posterior *.price.count
*.beyond_chance.count *.SharedFit.posterior *.starts_about.* *.SamplingOptions.* *.NutsOptions.*
*.Misfit.count *.Stream.count *.Ends.count *.fit_side_by_side.starts
*.infinite_finding.count *.regressions.least_squares.terms
*.simulated.count *.simulations *.plan.repeats *.sphere_lights.count *.from_files.*
*.places_in.posterior *.corner_figure.* *.trace_figure.* *.check.posterior *.prior_share.posterior
*.search_findings.posterior *.posterior_findings.posterior *.chain_failures.posterior
*.estimates.posterior *.is_trusted.posterior *.Likelihood.posterior *.piled_at.draws
*.convergence_in_words.posterior *.*Calibration.* *.Fit.posterior *.GammaFit.posterior
*.fitted_material.* *.fit_separable.coarse *.exposure_jackknife.coarse *.scatter_log_density.count
*.quantised_moments.window *.sampled_estimate.* *.split_r_hat.draws *.effective_draws.draws
*.calibrate_lab.draws *.folders.*.draws *.commands.run.repeats
*.format_within.width *.plain_tables.width *.called_for.tolerance *.bands.bands.draws
*.bands.thinned_draws.* *.Window.nodes *.refuse_half.count *.prediction.*.draws
*.posterior_prior.posterior *.as_prior.draws *.refitted.terms *.histogram.steps *.General.draws
*.fixed_variance.count *.determined_estimates.posterior *.wavefront_from_edges.terms
*.SensorOfSites.draws *.from_edge.reach *.Photographs.reach *.prior_starts.*
""")


def approximations():
    """Return the public arguments and fields whose names contain one of `WORDS`."""
    apart = ("fitting.accuracy.",)
    found = arguments_and_fields(fitting)
    return [n for n in found if n.rpartition(".")[2] in WORDS and not n.startswith(apart)]


def test_every_approximation_has_a_knob():
    """A new argument or field with such a name fails here until a `Knob` includes it."""
    known = [pattern for knob in KNOBS.values() for pattern in knob.sets]
    found = approximations()
    assert len(found) > 40
    assert not unknown(found, known + OTHER)


def test_every_pattern_names_something_that_is_there():
    patterns = [pattern for knob in KNOBS.values() for pattern in knob.sets] + OTHER
    assert not ghosts(patterns, arguments_and_fields(fitting))


def test_every_knob_changes_some_setting():
    assert set(KNOBS) == set(RIG_KNOBS) | set(EXAMPLES)
    assert not set(RIG_KNOBS) & set(EXAMPLES)
    with pytest.raises(InputError, match="has no example of its own"):
        example("pixels")


def gaussian(vector, args):
    return -jnp.sum(vector**2) / 2


def test_interval_ends_of_a_gaussian_have_the_monte_carlo_error_of_quantiles():
    """The quantiles of two standard normal numbers are known, and their Monte Carlo error falls as
    draws^-1/2."""
    space = tuple(n for name in "ab" for n in scalars(Parameter(name=name), ()))
    density = Density(gaussian, space, jnp.zeros(2), np.eye(2), None)
    turned = chain_knobs(density)["Laplace draws"]
    exact = np.repeat(norm.ppf(ENDS)[:, None], 2, axis=1)
    problem = Problem("two", lambda s: turned(s["Laplace draws"]), exact=exact, level=1.0)
    found = curve(problem, KNOBS["Laplace draws"], seconds=1e5, seeds=32)
    assert found.order is not None
    np.testing.assert_allclose(found.order.exponent, -0.5, atol=0.1)
    # The variance of a quantile is p (1 - p) / (n density^2).
    p = np.array(ENDS)
    of_one = np.sqrt(np.mean(p * (1 - p) / norm.pdf(norm.ppf(p)) ** 2))
    for trial in found.trials:
        np.testing.assert_allclose(trial.error, of_one * trial.setting**-0.5, rtol=0.3)


def test_a_rig_without_anything_to_fit_is_a_sentence(tmp_path):
    (tmp_path / "rig.toml").write_text("[camera]\nbits = 8\n")
    with pytest.raises(InputError, match="nothing to fit"):
        fits_of(load_rig(tmp_path))
    status, _, error = called(app, "accuracy", tmp_path, "--seconds", 0)
    assert status == 2
    assert "give a time above 0" in error
    status, _, error = called(app, "accuracy", tmp_path, "--seconds", 1e-4)
    assert status == 2
    assert "--seconds 0.0001: libraries and rig took" in error


def test_the_command_measures_a_rig(lab, tmp_path):
    folder = lab[0] / "response"
    asked = ("accuracy", folder, "--knob", "curve rounds", "--seconds", 90, "--out", tmp_path / "p")
    status, said, _ = called(app, *asked)
    assert status == 0
    assert "curve rounds" in said
    sheet = json.loads((tmp_path / "p" / "accuracy.json").read_text())
    assert sheet["knobs"][0]["name"] == "curve rounds"
    assert "standard error" in (tmp_path / "p" / "accuracy.html").read_text()
    status, _, error = called(app, "accuracy", folder, "--knob", "cells")
    assert status == 2
    assert "knob 'cells' changes nothing here; use 'pixels'" in error
    status, _, error = called(app, "accuracy", folder, "--knob", "sampels")
    assert status == 2
    assert "knob 'sampels' changes nothing here; use 'solver tolerance'" in error


@pytest.fixture
def two_fits(tmp_path, monkeypatch):
    """Return a rig with two fits, each with a bias of 1 / n^2, and the fit at which an interrupt
    comes."""
    folder = tmp_path / "two fits"
    folder.mkdir()
    (folder / "rig.toml").write_text("[camera]\nbits = 8\n")
    knob = Knob("pixels", "", "pixels used", (1, 2, 4), (8, 16), order=-2.0)
    state = SimpleNamespace(folder=folder, stops={}, measured=[])

    def problem(name):
        return Problem(name, lambda s: lambda seed: np.full(3, 1 + s["pixels"] ** -2.0))

    def one_measured(problem, known, *, names, seconds):
        state.measured.append(problem.name)
        stop = state.stops.get(problem.name)
        if stop == "before":
            raise KeyboardInterrupt
        found = curve(problem, knob, seconds=1e5)
        return (replace(found, stopped=stop or ""),)

    fits = {name: (problem(name), ("pixels",)) for name in ("noise", "brdf")}
    monkeypatch.setattr("fitting.accuracy.problems", lambda *_, **__: fits)
    monkeypatch.setattr("fitting.accuracy.measured", one_measured)
    return state


def test_a_rig_of_two_fits_is_one_json_document(two_fits, tmp_path):
    """The command in the document repeats the call, with blanks in paths and the page's folder.
    Pages are in separate folders."""
    out = tmp_path / "a page"
    asked = ["accuracy", two_fits.folder, "--knob", "pixels", "--seconds", 9, "--out", out]
    status, said, _ = called(app, *asked, "--json")
    assert status == 0
    sheet = json.loads(said)
    assert list(sheet) == ["noise", "brdf"]
    assert [sheet[fit]["problem"] for fit in sheet] == ["noise", "brdf"]
    words = shlex.split(sheet["brdf"]["command"])
    assert words == ["jaxvision-fit", *map(str, asked)]
    assert (out / "brdf" / "accuracy.html").exists()
    assert (out / "noise" / "accuracy.html").exists()


@pytest.mark.parametrize(
    ("stops", "told"),
    [({"noise": "interrupted"}, ["noise"]), ({"brdf": "before"}, ["noise"])],
)
def test_an_interrupt_ends_the_command_and_keeps_what_was_measured(two_fits, stops, told):
    two_fits.stops.update(stops)
    _, said, _ = called(app, "accuracy", two_fits.folder, "--json")
    assert list(json.loads(said)) == told
    assert two_fits.measured[-1] == next(iter(stops))
    two_fits.stops["noise"] = "before"
    status, said, error = called(app, "accuracy", two_fits.folder)
    assert (status, said) == (130, "")
    assert error.endswith("interrupted.\n")
    assert "resumes" not in error


@pytest.mark.slow
@pytest.mark.parametrize("fit", ["noise", "response", "brdf"])
def test_the_knobs_of_a_fit_reach_their_references(lab, fit):
    """The finest setting of each knob is within half a standard error of the reference, except a
    third of the pixels. A deterministic finest setting equals the reference."""
    problem, known = problems(load_rig(lab[0] / fit))[fit]
    assert len(known) >= 3
    for name in known:
        knob = KNOBS[name]
        few = replace(knob, settings=(knob.settings[0], knob.settings[-1]))
        whole = problem.prepare({"pixels": 1.0})(0) if name == "pixels" else None
        found = curve(problem, few, reference=whole, seconds=1e5, seeds=3)
        assert knob.settings[-1] not in found.not_run  # a coarse one may be refused
        assert found.trials[-1].error < (3.0 if name == "pixels" else 0.9), name
        if name == "likelihood":
            assert found.trials[-1].error == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_the_error_of_an_example_is_known_and_falls(name):
    knob = KNOBS[name]
    found = measured(example(name), (name,), seconds=1e5)[0]
    assert found.trials[-1].error <= found.trials[0].error
    assert knob.random
