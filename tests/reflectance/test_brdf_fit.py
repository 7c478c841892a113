"""Tests lobes fitted to measured reflectance: optima against SciPy, recovery of true values,
predictions of held-out incidences, and refusals.

Samples are from `oracles.brdfs`, independent of the library."""

import dataclasses
import json
from pathlib import Path
from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from oracles import brdfs
from typer.testing import CliRunner

from fitting import cli
from fitting.inference.emcee_run import Emcee
from fitting.inference.separable import fit_separable
from fitting.reflectance.from_files.calibration import amplitudes
from fitting.reflectance.from_files.calibration import calibrate as calibrate_brdf
from fitting.reflectance.from_files.errors import (
    Errors,
    best,
    errors,
    prediction_of_held_out,
    ratio,
)
from fitting.reflectance.from_files.findings import findings, which_axis_wins
from fitting.reflectance.from_files.fit import LobeFit, ModelFit, fit_model
from fitting.reflectance.from_files.read import from_samples, read_measured_brdf
from fitting.reflectance.from_files.section import materials_section
from fitting.reflectance.from_files.section import section as material_section
from fitting.reflectance.models import REFLECTANCES, unit_brdf
from fitting.reflectance.names import INDEX, MODELS, OBJECTIVES
from fitting.report.page import as_json
from jaxvision.brdf import evaluate
from jaxvision.brdf.fresnel import Dielectric
from jaxvision.brdf.half_difference import HalfDifferenceTable
from jaxvision.brdf.measured import BRDFSamples
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.core._vector import as_vec
from jaxvision.errors import InputError
from jaxvision.files.measured import write_cornell, write_merl

KD, KS = np.array([0.05, 0.1, 0.2]), np.array([0.6, 0.5, 0.4])
SHAPES = {"exponent": 60.0, "concentration": 6.0, "roughness": 0.3}


def oracle(model, wi, wo, kd, ks, shape):
    """Return f_r of one pair of directions by `oracles.brdfs`, one band per amplitude."""
    k = {"kd": kd, "ks": ks}
    index = {"eta": [INDEX] * len(kd), "k": [0.0] * len(kd)}
    facets = {"alpha": (shape, shape), **k}
    return {
        "lambert": lambda: brdfs.lambert(wi, wo, kd=kd),
        "oren-nayar": lambda: brdfs.oren_nayar(wi, wo, kd=kd, sigma=shape, full=False),
        "eon": lambda: np.pi * kd * brdfs.eon(wi, wo, kd=1 / np.pi, r=shape),
        "phong": lambda: brdfs.phong(wi, wo, n=shape, kind="shading", **k),
        "normalised-phong": lambda: brdfs.phong(wi, wo, n=shape, kind="normalised", **k),
        "gaussian-lobe": lambda: brdfs.gaussian(wi, wo, c=shape, kind="shading", **k),
        "blinn": lambda: brdfs.blinn(wi, wo, n=shape, kind="shading", **k),
        "normalised-blinn": lambda: brdfs.blinn(wi, wo, n=shape, kind="normalised", **k),
        "torrance-sparrow-beckmann": lambda: brdfs.torrance_sparrow(
            wi, wo, distribution="beckmann", **index, **facets
        ),
        "torrance-sparrow": lambda: brdfs.torrance_sparrow(wi, wo, **index, **facets),
        "torrance-sparrow-metal": lambda: brdfs.torrance_sparrow(wi, wo, **facets),
    }[model]()


def angles():
    """Return five incidences with 40 views each, a third of them near the mirror direction."""
    rng = np.random.default_rng(0)
    theta_i = np.repeat(np.radians([10.0, 25, 40, 55, 70]), 40)
    theta_o, phi_o = rng.uniform(0.02, 1.3, 200), rng.uniform(-np.pi, np.pi, 200)
    near = np.arange(200) % 3 == 0
    theta_o[near] = np.clip(theta_i[near] + 0.15 * rng.standard_normal(near.sum()), 0.01, 1.35)
    phi_o[near] = np.pi + 0.2 * rng.standard_normal(near.sum())
    return theta_i, np.full(200, 0.3), theta_o, phi_o + 0.3


def directions(theta, phi):
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def samples_of(model, *, noise=0.0, seed=1):
    """Return samples of a model with relative noise, as in a Cornell file."""
    theta_i, phi_i, theta_o, phi_o = angles()
    shape = None if model == "lambert" else SHAPES[REFLECTANCES[model].shape.name]
    values = np.array(
        [
            oracle(model, i, o, KD, KS, shape)
            for i, o in zip(directions(theta_i, phi_i), directions(theta_o, phi_o), strict=True)
        ]
    )
    values *= np.exp(noise * np.random.default_rng(seed).standard_normal(values.shape))
    metres = jnp.asarray([450e-9, 550e-9, 650e-9])
    return BRDFSamples(*(jnp.asarray(a) for a in (theta_i, phi_i, theta_o, phi_o, values)), metres)


def measured(model, **options):
    return from_samples(model, samples_of(model, **options), weights=np.ones(200))


@pytest.fixture(scope="module")
def noisy_phong():
    return measured("phong", noise=0.05)


@pytest.fixture(scope="module")
def calibration(noisy_phong):
    return calibrate_brdf(noisy_phong)


def error_of(relative):
    """Return errors of five incidences with equal weights."""
    parts = np.full((5, 2), relative**2 / 5)
    return Errors(relative, relative, relative, np.full(5, relative), parts)


def errors_of(*by_incidence):
    """Return errors of five incidences, whose squares are a fifth of the given ones."""
    parts = np.array(by_incidence) ** 2 / 5
    whole = np.sqrt(parts.sum())
    return Errors(whole, whole, whole, np.array(by_incidence), np.stack([parts, parts], axis=1))


def verdict_of(calibration, **special):
    """Return the first sentences for errors of 10 % of Phong at each incidence and 99 % of others,
    except the given ones."""
    held_out = {m: error_of(0.1 if m == "phong" else 0.99) for m in MODELS} | special
    return findings(dataclasses.replace(calibration, held_out=held_out))[0]


@pytest.mark.slow
def test_a_much_larger_error_that_depends_on_one_incidence_is_explained(calibration):
    """One incidence causes the whole difference, and is named."""
    told = verdict_of(calibration, blinn=errors_of(0.1, 0.1, 0.1, 0.1, 2))
    assert "Not significantly worse, by leaving out each incidence in turn: Blinn (89.9 %)." in told
    assert (
        "its size depends on single incidences: Blinn (89.9 %: 8.99 times the error, 1.00 "
        "times without 70°, 10.04 times without 10°)."
    ) in told
    assert "Worse at significantly" not in told


@pytest.mark.slow
def test_a_model_can_be_worse_by_an_uncertain_amount(monkeypatch, calibration):
    """Without 70 degrees the error is 2.5 times as large, and without another sqrt((3 * 0.25^2 +
    2^2) / 4) / 0.1 = 10.23 times. The size depends on one incidence, but not the sign. Five of five
    have a probability of 2 / 2^5 = .0625, above the 5 % of the intervals, so the model is not
    called worse."""
    special = {"blinn": errors_of(0.25, 0.25, 0.25, 0.25, 2)}
    told = verdict_of(calibration, **special)
    assert "Worse at significantly" not in told
    assert "Not significantly worse, by leaving out each incidence in turn: Blinn (92.2 %)." in told
    monkeypatch.setattr("fitting.reflectance.from_files.errors.LIKELY", 0.0625)
    told = verdict_of(calibration, **special)
    assert "Not significantly worse" not in told
    assert (
        "depends on single incidences: Blinn (92.2 %: 9.22 times the error, 2.50 times without "
        "70°, 10.23 times without 10°; more at 5 of 5, p = 0.062)."
    ) in told


def test_the_probability_of_a_verdict_matches_that_of_the_intervals():
    """For six of six it is 2 / 2^6 = .031, below 5 %; for seven of eight 18 / 2^8 = .070, above."""
    parts = np.full((6, 2), 0.01 / 6)
    one, six = (Errors(e, e, e, np.full(6, e), parts * (e / 0.1) ** 2) for e in (0.1, 0.25))
    assert ratio(six, one, "cosine").chance == pytest.approx(2 / 2**6)
    assert ratio(six, one, "cosine").ordered
    better, worse = np.full(8, 0.1), np.append(np.full(7, 0.25), 0.05)
    of_eight = [
        Errors(np.sqrt(np.mean(e**2)), np.sqrt(np.mean(e**2)), 0, e, np.stack([e**2] * 2, 1) / 8)
        for e in (worse, better)
    ]
    assert ratio(*of_eight, "cosine").chance == pytest.approx(18 / 2**8)
    assert not ratio(*of_eight, "cosine").ordered


@pytest.mark.slow
def test_a_model_with_errors_beyond_the_signal_never_counts_as_equal(calibration):
    """The model equals the best one without 70 degrees, but overall its error of 134 % is larger
    than the signal."""
    told = verdict_of(calibration, blinn=errors_of(0.1, 0.1, 0.1, 0.1, 3))
    assert "Not significantly worse" not in told
    assert (
        "With errors larger than the signal, and thus no description of it, although the ratio to "
        "the best model depends on which incidence is left out: Blinn (134 %: 13.45 times the "
        "error, 1.00 times without 70°, 15.02 times without 10°)."
    ) in told


@pytest.mark.slow
def test_the_axes_of_a_pair_are_compared_by_their_errors(calibration):
    """The cases are: distinguished, ordered but of uncertain size, one or both useless, and
    undecided."""
    cases = [
        (errors_of(0.1, 0.1, 0.1, 0.1, 0.1), "Blinn beats Phong (10 % against 20 %)"),
        (
            errors_of(0.5, 0.5, 0.5, 0.5, 2),
            "Blinn does not differ significantly from Phong (100 % against 20 %)",
        ),
        (
            errors_of(0.2, 0.2, 0.2, 0.2, 3),
            "Blinn has errors larger than the signal, unlike Phong (135 % against 20 %)",
        ),
        (
            errors_of(0.2, 0.2, 0.2, 0.2, 1),
            "Blinn does not differ significantly from Phong (48.2 % against 20 %)",
        ),
    ]
    mirror = error_of(0.2)
    for half, expected in cases:
        held_out = {m: error_of(0.5) for m in MODELS} | {"phong": mirror, "blinn": half}
        told = findings(dataclasses.replace(calibration, held_out=held_out))[1]
        assert f"all else equal: {expected};" in told
    held_out |= {"phong": error_of(1.2), "blinn": error_of(1.1)}
    told = findings(dataclasses.replace(calibration, held_out=held_out))[1]
    assert "errors larger than the signal, and so has Phong (110 % against 120 %)" in told


# ---------------------------------------------------------------- fits


@pytest.mark.sweep
@pytest.mark.parametrize("model", MODELS)
def test_every_model_is_recovered(model):
    """Without noise there are no residuals, whichever incidence was left out."""
    fit = fit_model(measured(model), model, index=INDEX)
    lobe = REFLECTANCES[model].axis != "none"
    for found in (fit.whole, *fit.without):
        np.testing.assert_allclose(found.diffuse, KD, rtol=2e-3)
        np.testing.assert_allclose(found.specular, KS if lobe else 0, rtol=2e-3)
        if model != "lambert":
            np.testing.assert_allclose(
                found.shape, SHAPES[REFLECTANCES[model].shape.name], rtol=1e-3
            )
    assert errors(measured(model), prediction_of_held_out(measured(model), fit)).relative < 1e-3


@pytest.mark.parametrize("objective", ["cosine", "cube-root"])
def test_the_optimum_equals_scipys(noisy_phong, objective):
    """Blinn's lobe is fitted to Phong's samples, so residuals are not noise."""
    fit = fit_model(noisy_phong, "blinn", objective=objective, index=INDEX)
    wi, wo = (
        np.stack([np.asarray(c) for c in (v.x, v.y, v.z)]) for v in (noisy_phong.wi, noisy_phong.wo)
    )
    half = (wi + wo)[2] / np.linalg.norm(wi + wo, axis=0)

    def predicted(p):
        return np.exp(p[:3]) + np.exp(p[3:6]) * (half ** np.exp(p[6]) / wi[2])[:, None]

    def residuals(p):
        if objective == "cosine":
            return (wi[2][:, None] * (predicted(p) - noisy_phong.values)).ravel()
        x, y = (wi[2][:, None] * v for v in (predicted(p), noisy_phong.values))
        dark = 1e-3 * np.sqrt(np.mean(y**2))
        there, here = np.cbrt(x + dark), np.cbrt(y + dark)
        return (there - here).ravel()

    start = np.log([*KD, *KS, 240.0])
    reference = scipy.optimize.least_squares(residuals, start, xtol=1e-14, ftol=1e-14)
    found = np.log([*fit.whole.diffuse, *fit.whole.specular, fit.whole.shape])
    np.testing.assert_allclose(np.sum(residuals(found) ** 2), 2 * reference.cost, rtol=1e-5)
    np.testing.assert_allclose(found, reference.x, atol=5e-3)


def test_amplitudes_are_positive_and_bands_share_one_shape():
    """The reference is SciPy's NNLS at the fitted shape, with one band whose optimum is
    negative."""
    rng = np.random.default_rng(2)
    x = np.linspace(0, 3, 80)
    y = np.stack([1 + 2 * np.exp(-2 * x), 0.3 - np.exp(-2 * x), 3 * np.exp(-2 * x)], axis=1)
    y += 0.02 * rng.standard_normal(y.shape)
    weights = rng.uniform(0.5, 2, y.shape)

    def columns(logs):
        return jnp.exp(-jnp.exp(logs)[:, None] * x[None])

    found = fit_separable(
        columns, jnp.ones((1, 80)), jnp.asarray(y), jnp.asarray(weights), lower=-2.0, upper=3.0
    )
    np.testing.assert_allclose(np.exp(found.nonlinear), 2, rtol=0.05)
    design = np.column_stack([np.ones(80), np.exp(-np.exp(found.nonlinear) * x)])
    total = 0.0
    for band in range(3):
        root = np.sqrt(weights[:, band])
        expected, norm = scipy.optimize.nnls(design * root[:, None], y[:, band] * root)
        np.testing.assert_allclose(found.amplitudes[band], expected, rtol=1e-7, atol=1e-9)
        total += norm**2
    np.testing.assert_allclose(found.cost, total, rtol=1e-9)


def test_a_held_out_incidence_does_not_affect_its_prediction(noisy_phong):
    samples = samples_of("phong", noise=0.05)
    own = noisy_phong.incidence == 2
    other = 7 + np.arange(len(own))[:, None] / 100  # not all equal, as clipped ones are
    values = np.where(own[:, None], other, np.asarray(samples.values))
    changed = BRDFSamples(
        *(getattr(samples, n) for n in ("theta_i", "phi_i", "theta_o", "phi_o")),
        jnp.asarray(values),
    )
    again = from_samples("changed", changed, weights=np.ones(200))
    before, after = (fit_model(m, "phong", index=INDEX) for m in (noisy_phong, again))
    np.testing.assert_array_equal(before.without[2].predicted, after.without[2].predicted)
    assert not np.allclose(before.without[1].predicted, after.without[1].predicted)


# ---------------------------------------------------------------- what is reported


def test_metrics_by_hand():
    """Two bands with a constant error: RMS, relative RMS and cube roots, with unequal weights."""
    theta = np.repeat(np.radians([0.0, 20, 40, 60]), 6)
    values = np.tile([0.125, 1.0], (24, 1)) / np.cos(theta)[:, None]
    arrays = [jnp.asarray(a) for a in (theta, 0 * theta, theta, 0 * theta, values)]
    weights = np.linspace(1, 2, 24)
    of = from_samples("flat", BRDFSamples(*arrays), weights=weights)
    found = errors(of, np.tile([1.0, 8.0], (24, 1)) / np.cos(theta)[:, None])
    np.testing.assert_allclose(found.rms, np.sqrt((0.875**2 + 7**2) / 2), rtol=1e-12)
    np.testing.assert_allclose(found.relative, 7, rtol=1e-12)
    np.testing.assert_allclose(found.by_incidence, 7, rtol=1e-12)
    np.testing.assert_allclose(found.cube_root, np.sqrt((0.5**2 + 1**2) / 2), rtol=1e-12)


def test_no_model_is_best_by_rounding():
    """A constant is predicted exactly, up to rounding, and with an error of 1e-6. The first two
    count as equal."""
    of = measured("lambert")
    exact, rounded, off = (errors(of, of.values * (1 + e)) for e in (0, 1e-13, 1e-6))
    for name in ("rms", "relative", "cube_root"):
        assert getattr(exact, name) == getattr(rounded, name)
        assert 0 < getattr(exact, name) < getattr(off, name) / 100
    np.testing.assert_allclose(off.relative, 1e-6, rtol=1e-6)
    assert best({"phong": exact, "lambert": rounded, "blinn": off}, "cosine") == "phong"


@pytest.mark.parametrize("count", [3, 5, 12])
def test_errors_differ_significantly_by_the_jackknife(count):
    """Each incidence is left out in turn, by a loop. The ratio is of the total errors."""
    rng = np.random.default_rng(count)
    both = []
    for excess in np.linspace(0, 3, 60):
        theirs = rng.uniform(0.5, 2, count)
        ours = theirs * (1 + excess * rng.uniform(0, 2, count))
        one, other = (
            Errors(*(3 * [np.sqrt(p.sum())]), np.sqrt(p), np.stack([p, p], axis=1))
            for p in (ours, theirs)
        )
        left_out = [np.delete(ours, i).sum() / np.delete(theirs, i).sum() for i in range(count)]
        logs = np.log(left_out) / 2
        error = np.sqrt((count - 1) / count * np.sum((logs - logs.mean()) ** 2))
        log = np.log(ours.sum() / theirs.sum()) / 2
        wanted = 2 * scipy.stats.t.sf(log / error, count - 1) < 0.05 if error > 0 else False
        assert ratio(one, other, "cosine").significant == wanted
        assert ratio(other, one, "cosine").significant == wanted
        both.append(wanted)
    assert 0 < sum(both) < 60


@pytest.mark.slow
def test_the_right_model_is_best_and_its_intervals_cover(calibration):
    # Phong and a Gaussian lobe of c^2 = n / 2 are similar, and both are right here.
    assert calibration.model in ("phong", "gaussian-lobe")
    assert calibration.held_out["phong"].relative < 0.1
    assert calibration.held_out["torrance-sparrow-beckmann"].relative > 0.15
    again = calibrate_brdf(calibration.measured, model="phong")
    truth = np.log([KD.mean(), KS.mean(), SHAPES["exponent"]])
    deviation = np.sqrt(np.diagonal(again.covariance))
    assert np.all(np.abs(np.log(again.mean) - truth) < 4 * deviation)
    assert np.all(deviation < 0.2)
    assert again.posterior.method == "Laplace"
    np.testing.assert_allclose(again.amplitudes.diffuse.mean(), again.mean[0])


def test_errors_of_amplitudes_are_jackknife_errors():
    """For means with one of six numbers left out, the jackknife gives the error of the mean, s /
    sqrt(6) by NumPy, widened to Student's t with five degrees of freedom, whose variance is 5 /
    3."""
    numbers = np.random.default_rng(9).uniform(1, 2, (6, 3))
    without = [np.delete(numbers, i, axis=0).mean(axis=0) for i in range(6)]

    def lobe(mean):
        return LobeFit("lambert", mean, 0 * mean, None, np.zeros((6, 3)), 0.0, True)

    fit = ModelFit("lambert", "cosine", lobe(numbers.mean(axis=0)), tuple(map(lobe, without)))
    expected = numbers.std(axis=0, ddof=1) / np.sqrt(6) * np.sqrt(5 / 3)
    np.testing.assert_allclose(amplitudes(fit).diffuse_error, expected, rtol=1e-12)


@pytest.mark.slow
def test_the_precision_of_the_caller_does_not_matter():
    """In an earlier version, float32 fits of this material were wrong by up to a third of a
    standard error."""
    found = []
    for double in (True, False):
        with jax.enable_x64(double):
            given = measured("normalised-phong", noise=0.02)
            found.append(calibrate_brdf(given, model="normalised-phong"))
    deviation = np.sqrt(np.diagonal(found[0].covariance))
    away = (np.log(found[1].mean) - np.log(found[0].mean)) / deviation
    np.testing.assert_allclose(away, 0, atol=0.01)


@pytest.mark.slow
def test_misfit_widens_the_intervals(calibration):
    """The estimates of a wrong model depend on the incidences, so its jackknife errors are
    larger."""
    right = calibrate_brdf(calibration.measured, model="phong")
    wrong = calibrate_brdf(calibration.measured, model="torrance-sparrow-metal")
    widths = [np.sqrt(np.diagonal(c.covariance))[1:] for c in (right, wrong)]
    assert np.all(widths[1] > 2 * widths[0])


@pytest.mark.slow
def test_draws_have_the_jackknife_covariance(calibration):
    laplace = calibrate_brdf(calibration.measured, model="blinn")
    drawn = calibrate_brdf(
        calibration.measured, model="blinn", sampling=Emcee(walkers=16, steps=4000)
    )
    assert drawn.posterior.method == "emcee"
    logs = np.log(drawn.posterior.samples)
    width = np.sqrt(np.diagonal(laplace.covariance))
    np.testing.assert_allclose(logs.std(axis=0), width, rtol=0.25)
    np.testing.assert_allclose(
        (np.median(logs, axis=0) - np.log(laplace.mean)) / width, 0, atol=0.4
    )


@pytest.mark.slow
def test_a_matt_surface_reports_no_lobe():
    matt = calibrate_brdf(measured("lambert", noise=0.02), model="lambert")
    assert [p.name for p in matt.space] == ["diffuse"]
    shiny = calibrate_brdf(matt.measured, model="oren-nayar")
    assert "roughness" in shiny.open_parameters
    section = material_section(shiny)
    assert section.estimates[1].value is None
    assert abs(section.estimates[0].value / KD.mean() - 1) < 0.02
    assert any("roughness" in sentence for sentence in section.findings)


@pytest.mark.slow
@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_rough_body_includes_the_smooth_one(calibration, objective, noise):
    """Its range nearly includes zero roughness, so its fits to a matte surface cost no more than
    Lambert's, with little noise or none."""
    matt = measured("lambert", noise=noise)
    models = ("lambert", "oren-nayar", "phong")
    fits = {m: fit_model(matt, m, objective=objective, index=INDEX) for m in models}
    known = dataclasses.replace(
        calibration, measured=matt, objective=objective, fits=calibration.fits | fits
    )
    failed = [said for said in findings(known) if "did not reach a minimum" in said]
    assert not [said for said in failed if said.startswith(("Oren-Nayar:", "Phong:"))]


@pytest.mark.slow
def test_the_gain_by_fresnel_of_facets_is_stated(calibration):
    """Of the improvement over Lambert's 92.4 %, 48 % is lost without Fresnel's law: (68.2 - 45.5) /
    (92.4 - 45.5)."""
    values = {"lambert": 0.924, "torrance-sparrow": 0.455, "torrance-sparrow-metal": 0.682}
    held_out = {m: error_of(values.get(m, 0.95)) for m in MODELS}
    told = which_axis_wins([dataclasses.replace(calibration, held_out=held_out)])
    assert told[-1].endswith(
        "(metal) are, on phong 68.2 % instead of 45.5 %; this is 48 % of the improvement over "
        "Lambert's 92.4 %."
    )
    assert "most of it" not in told[-1]


@pytest.mark.parametrize(
    ("winners", "judgement"),
    [
        (("blinn", None), "confirm, where they are significant, the finding"),
        (("blinn", "phong"), "confirm only in part, where they are significant, the finding"),
        (("phong", None), "contradict, where they are significant, the finding"),
        ((None, None), "neither confirm nor contradict the finding"),
        # Facets differ from mirror-direction lobes in more than the axis.
        (("torrance-sparrow", None), "neither confirm nor contradict the finding"),
        (("torrance-sparrow", "blinn"), "confirm, where they are significant, the finding"),
        (("torrance-sparrow", "phong"), "neither confirm nor contradict the finding"),
        (("gaussian-lobe", "blinn"), "neither confirm nor contradict the finding"),
        (("gaussian-lobe", "phong"), "contradict, where they are significant, the finding"),
    ],
)
def test_the_axis_alone_is_judged_and_undecided_materials_do_not_count(
    calibration, winners, judgement
):
    told = which_axis_wins(
        [
            dataclasses.replace(
                calibration, held_out={m: error_of(0.1 if m == winner else 0.2) for m in MODELS}
            )
            for winner in winners
        ]
    )
    assert f"Together they {judgement} of Ngan" in told[1]
    assert "Ngan" not in told[0]


def test_two_wins_of_the_axis_alone_need_no_qualification(calibration):
    held_out = {m: error_of(0.1 if "blinn" in m else 0.2) for m in MODELS}
    told = which_axis_wins([dataclasses.replace(calibration, held_out=held_out)] * 2)
    assert "wins 4 of 4 comparisons" in told[1]
    assert "Together they confirm the finding" in told[1]
    assert "this alone says nothing" not in told[0]


def test_best_lobes_that_differ_in_more_than_the_axis_are_named(calibration):
    """As for car paint, facets have an error of 18 %, and all others about 100 %."""
    held_out = {m: error_of(0.18 if m == "torrance-sparrow" else 1.04) for m in MODELS}
    told = which_axis_wins([dataclasses.replace(calibration, held_out=held_out)])
    assert "half vector is better on 1 of 1 (phong). Where lobes differ" in told[0]
    assert told[0].endswith(
        "this alone says nothing about the axis: Torrance-Sparrow (GGX) against Phong on phong."
    )


def test_lobes_with_errors_beyond_the_signal_do_not_count_for_the_axis(calibration):
    held_out = {m: error_of(1.1 if "blinn" in m else 1.3) for m in MODELS}
    told = which_axis_wins([dataclasses.replace(calibration, held_out=held_out)])
    assert "the difference is not significant on 1 of 1" in told[0]
    assert "wins 0 of 2 comparisons, the mirror direction 0" in told[1]


@pytest.mark.slow
def test_sections_read_and_draw(calibration):
    other = calibrate_brdf(measured("torrance-sparrow-beckmann", noise=0.05))
    assert other.model in ("torrance-sparrow-beckmann", "torrance-sparrow")
    sections = [materials_section([calibration, other]), material_section(calibration)]
    words = " ".join(sections[0].findings)
    assert "on 1 of 2 (torrance-sparrow-beckmann)" in words
    assert "mirror direction is better on 1 of 2 (phong). Where lobes differ" in words
    assert "neither confirm nor contradict" in words
    assert json.loads(as_json(sections, seed=0, settings={}))["sections"][0]["tables"]
    for picture in (p for section in sections for p in section.pictures):
        assert all(axis.has_data() for axis in picture.draw().axes)


def test_the_facets_of_the_plain_name_are_the_records_default():
    wi, wo = directions(np.array([0.9]), np.zeros(1)), directions(np.array([0.7]), np.array([2.9]))
    own = TorranceSparrow([0.0], [1.0], 0.3, interface=Dielectric([INDEX]))
    expected = evaluate(own, *(as_vec(jnp.asarray(w[0])) for w in (wi, wo)))
    both = (as_vec(jnp.asarray(w)) for w in (wi, wo))
    found = unit_brdf("torrance-sparrow", jnp.asarray(0.3), *both, INDEX)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


# ---------------------------------------------------------------- bad input


def run(*arguments):
    result = CliRunner().invoke(cli.app, ["brdf", *(str(a) for a in arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    lines = [x for x in result.stderr.strip().splitlines() if x.startswith("jaxvision-fit:")]
    return result.exit_code, " ".join(lines)


def with_values(change):
    samples = samples_of("lambert")
    values = change(np.array(samples.values))
    angles = (samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o)
    return BRDFSamples(*angles, jnp.asarray(values), samples.wavelengths)


def with_first(values, value, count=1):
    return np.concatenate([np.full((count, values.shape[1]), value), values[count:]])


@pytest.mark.parametrize("factor", [1e-7, 1e5])
def test_the_unit_of_the_values_does_not_matter(factor):
    """The unit is far from one, within the accepted range. Amplitudes and errors are scaled by
    it."""
    samples = samples_of("phong", noise=0.05)
    angles = (samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o)
    scaled = BRDFSamples(*angles, samples.values * factor, samples.wavelengths)
    fits, found = [], []
    for one in (samples, scaled):
        of = from_samples("scaled", one, weights=np.ones(200))
        fits.append(fit_model(of, "phong", index=INDEX))
        found.append(errors(of, prediction_of_held_out(of, fits[-1])))
    np.testing.assert_allclose(fits[1].whole.shape, fits[0].whole.shape, rtol=1e-6)
    np.testing.assert_allclose(fits[1].whole.diffuse, factor * fits[0].whole.diffuse, rtol=1e-6)
    np.testing.assert_allclose(found[1].relative, found[0].relative, rtol=1e-6)
    np.testing.assert_allclose(found[1].rms, factor * found[0].rms, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda v: v * np.nan, "0 of 200 samples are finite"),
        (lambda v: -v, "no value is positive"),
        (lambda v: v * [1, 1, -1], "mean of a band is not positive"),
        (lambda v: v * 0 + 1e300, r"1e\+300 is beyond 1e\+06 sr\^-1"),
        (lambda v: v * 1e160, r"beyond 1e\+06 sr\^-1"),
        (lambda v: with_first(v, -9.9e37), r"-9.9e\+37 is beyond 1e\+06"),
        (lambda v: with_first(v, -2.0), "-2 lies farther below zero than any above"),
        (lambda v: v * 1e-200, "no value is above 1e-09 sr"),
        (lambda v: with_first(v, 0.0, 40), "no value at 10 degrees of incidence is above 1e-09"),
    ],
)
def test_implausible_values_are_refused(change, expected):
    with pytest.raises(InputError, match=expected):
        from_samples("bad", with_values(change), weights=np.ones(200))


def test_one_incidence_is_refused():
    samples = samples_of("lambert")
    same = BRDFSamples(
        0 * samples.theta_i + 0.5, samples.phi_i, samples.theta_o, samples.phi_o, samples.values
    )
    with pytest.raises(InputError, match="stands at 1 elevation;"):
        from_samples("one", same, weights=np.ones(200))


def test_bad_files_and_options_end_in_one_sentence(tmp_path):
    good, copy = tmp_path / "a" / "paint.brdf", tmp_path / "b" / "paint.brdf"
    for path in (good, copy):
        path.parent.mkdir()
        write_cornell(path, samples_of("lambert"))
    empty, junk, odd = (tmp_path / name for name in ("empty.brdf", "junk.bsdf", "paint.csv"))
    odd.write_text("1,2,3")
    empty.write_text("")
    junk.write_bytes(b"junk")
    folder = tmp_path / "folder.brdf"
    folder.mkdir()
    cases = [
        ((tmp_path / "none.brdf",), "no such file"),
        (("",), "a path is empty"),
        ((good, ""), "a path is empty"),
        ((folder,), "is a folder"),
        ((good, "--out", empty), "is a file; give --out a folder"),
        ((good, "--out", empty / "below"), "choose another path"),
        ((junk, "--out", tmp_path / "new"), "not an RGL tensor file"),
        ((empty,), "count of wavelengths"),
        ((junk,), "not an RGL tensor file"),
        ((good, tmp_path / "rig"), "no such file or folder"),
        ((good, tmp_path / "a"), "not a measured-BRDF file"),
        ((good, copy), "two files have this name"),
        ((good, "--index", "0.9"), "index = 0.9"),
        ((good, "--fit-gamma"), "--fit-gamma is for images"),
        ((tmp_path / "a", "--objective", "cosine"), "--objective is for files"),
        ((tmp_path / "a", tmp_path / "b"), "a second rig"),
        ((tmp_path / "none.txt",), "no such rig"),
        ((odd,), "neither a rig nor a file of measured reflectance"),
    ]
    for arguments, expected in cases:
        status, sentence = run(*arguments)
        assert status == 2, arguments
        assert sentence.count("jaxvision-fit:") == 1
        assert expected in sentence, sentence
    assert run(good, "--model", "mirror")[0] == 2
    assert not (tmp_path / "new").exists()


def test_a_table_is_sampled_by_solid_angle(tmp_path):
    """In a MERL file of f_r = 0.1 every value is 0.1, and the weights of each incidence integrate
    cos(theta_o) over views up to 80 degrees: (1 + cos 80) / 2 of the solid angle."""
    write_merl(tmp_path / "grey.binary", HalfDifferenceTable(jnp.full((6, 6, 12, 3), 0.1)))
    read = read_measured_brdf(tmp_path / "grey.binary")
    np.testing.assert_allclose(read.values, 0.1, rtol=1e-6)
    assert len(read.incidences) == 8
    assert read.bands == ("red", "green", "blue")
    for i in range(8):
        own = read.incidence == i
        mean = np.average(np.asarray(read.wo.z)[own], weights=read.weights[own])
        np.testing.assert_allclose(mean, (1 + np.cos(np.radians(80))) / 2, rtol=0.05)


def test_the_command_offers_every_model():
    assert set(get_args(cli.Model)) == set(MODELS)


def test_a_cornell_file_is_read_back(tmp_path):
    write_cornell(tmp_path / "paint.brdf", samples_of("phong"))
    read = read_measured_brdf(Path(tmp_path / "paint.brdf"))
    np.testing.assert_allclose(read.values, samples_of("phong").values, rtol=1e-12)
    np.testing.assert_allclose(np.degrees(read.incidences), [10, 25, 40, 55, 70], atol=1e-9)
    assert read.bands == ("450 nm", "550 nm", "650 nm")
    assert np.all((read.azimuth >= 0) & (read.azimuth <= np.pi))


def test_a_fit_that_did_not_move_is_reported(calibration):
    """One search stopped at its start, and one lobe costs more than the matte surface that it
    includes."""
    phong = calibration.fits["phong"]
    worse = dataclasses.replace(phong.whole, cost=2 * calibration.fits["lambert"].whole.cost)
    still = dataclasses.replace(phong.without[0], converged=False)
    broken = dataclasses.replace(phong, whole=worse, without=(still, *phong.without[1:]))
    told = findings(dataclasses.replace(calibration, fits={**calibration.fits, "phong": broken}))
    assert any("Phong: 2 of 6 fits did not reach a minimum" in sentence for sentence in told)
    told = findings(calibration)
    assert not any("did not reach a minimum" in sentence for sentence in told)
    assert "Oren-Nayar fits best without roughness, as Lambert's model." in told


@pytest.mark.slow
@pytest.mark.parametrize("model", ["oren-nayar", "phong", "gaussian-lobe", "blinn"])
def test_no_model_costs_more_than_the_matte_one_it_includes(noisy_phong, model):
    fits = [
        fit_model(noisy_phong, m, objective="cube-root", index=INDEX) for m in ("lambert", model)
    ]
    for matt, own in zip(*((f.whole, *f.without) for f in fits), strict=True):
        assert own.converged
        assert own.cost <= 1.001 * matt.cost
