"""Tests reflectance from simulated photographs: right values, right errors, and refusals.

The photographs are from NumPy (`oracles.sphere_photographs`), and optima are checked against
SciPy."""

import dataclasses
import json
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from oracles.sphere_photographs import (
    expose,
    light_directions,
    shade,
    sphere_normals,
    write_rig,
)
from scipy.stats import norm

from fitting.inference.emcee_run import Emcee
from fitting.inference.estimates import find
from fitting.inference.posterior import Posterior
from fitting.reflectance.from_images.calibration import (
    USUAL,
    ReflectanceCalibration,
    open_parameters,
)
from fitting.reflectance.from_images.calibration import calibrate as calibrate_reflectance
from fitting.reflectance.from_images.comparison import (
    compare,
    equally_good,
    relative_rms,
    squares_by_light,
)
from fitting.reflectance.from_images.findings import findings
from fitting.reflectance.from_images.fit import (
    adjusted_log_density,
    channel_posterior,
    composite,
    fit_channel,
    predicted_image,
)
from fitting.reflectance.from_images.read import read_reflectance_observation
from fitting.reflectance.from_images.samples import (
    View,
    average,
    cost_and_information,
    group,
    log_likelihoods,
    predict,
    select,
)
from fitting.reflectance.from_images.section import determined_estimates
from fitting.reflectance.from_images.section import section as reflectance_section
from fitting.reflectance.from_images.signal import Form, parameter_space
from fitting.report.page import as_json
from jaxvision.errors import InputError

SIZE, RADIUS, LIGHTS, WHITE = 28, 13.0, 16, 3000.0
GAIN, READ, BLACK = 0.25, 6.0, 60.0
CAMERA = {"bits": 12, "black_level": BLACK, "gain": GAIN, "read_noise": READ}
DIRECTIONS = light_directions(LIGHTS)
NORMALS = sphere_normals(SIZE, RADIUS)
PHONG = (0.4, 0.45, 40.0)


def photographs(rng, *, model="phong", truth=PHONG, white=WHITE, clip=4095.0, lights=None):
    """Return digital numbers (lights, h, w). `lights` are factors of each light's true
    intensity."""
    signal = white * shade(NORMALS, DIRECTIONS, model, *truth)
    if lights is not None:
        signal = signal * lights[:, None, None]
    return expose(rng, signal, gain=GAIN, read_noise=READ, black=BLACK, clip=clip)


def observe(folder, frames, *, white=WHITE, camera=CAMERA, **options):
    """Return an observation whose pixels are points, as computed by `shade`."""
    write_rig(folder, frames, DIRECTIONS, [white], radius=RADIUS, camera=camera, **options)
    return dataclasses.replace(read_reflectance_observation(folder), within=None)


def with_frames(observation, frames):
    """Return the same rig with other photographs."""
    return dataclasses.replace(
        observation, dn=frames[None][:, :, observation.rows, observation.columns]
    )


def fit(observation, model="phong", **options):
    form = Form(model, **options)
    chosen = select(observation, held_out=False, form=form)
    view = View(observation, 0, chosen)
    return fit_channel(view, form, cells(observation, chosen))


def cells(observation, chosen, width=1.0):
    return group(
        chosen.light,
        observation.cosine[chosen.light, chosen.pixel],
        observation.mirror_angle[chosen.light, chosen.pixel],
        width=width,
    )


def calibrated(observation, *fits):
    """Return a calibration of given fits, the first one reported, without posteriors."""
    fitted, held_out = (
        select(observation, held_out=kept, form=fits[0].requested) for kept in (False, True)
    )
    by_model = {found.requested.model: (found,) for found in fits}
    return ReflectanceCalibration(
        observation=observation,
        model=fits[0].requested.model,
        fits=by_model,
        scores=compare(observation, by_model, held_out),
        open_parameters={"grey": {}},
        posteriors={},
        fitted=fitted,
        held_out=held_out,
        minimum_cosine=0.0,
    )


def cosines(samples):
    """Return n.l, and the log cosine of the angle between view and mirror direction."""
    wi, wo = (np.array([v.x, v.y, v.z]) for v in (samples.geometry.wi, samples.geometry.wo))
    mirrored = 2 * wi[2] * wo[2] - (wi * wo).sum(axis=0)
    return wi[2], np.log(np.maximum(mirrored, 1e-300))


def deviations(found):
    """Return the standard errors of the logarithms."""
    return np.sqrt(np.diagonal(found.robustness.covariance))


@pytest.fixture(scope="module")
def observation(tmp_path_factory):
    frames = photographs(np.random.default_rng(0))
    return observe(tmp_path_factory.mktemp("sphere"), frames)


@pytest.mark.parametrize(
    ("model", "truth"),
    [
        ("lambert", (0.4, 0, 1)),
        ("phong", PHONG),
        ("gaussian-lobe", (0.3, 0.5, 6)),
        pytest.param("blinn", (0.4, 0.45, 90.0), marks=pytest.mark.slow),
        pytest.param("normalised-phong", (0.4, 0.15, 20.0), marks=pytest.mark.slow),
        pytest.param("torrance-sparrow-beckmann", (0.4, 1.5, 0.25), marks=pytest.mark.slow),
        pytest.param("torrance-sparrow", (0.4, 4.0, 0.25), marks=pytest.mark.slow),
        pytest.param("normalised-blinn", (0.4, 0.15, 80.0), marks=pytest.mark.slow),
        pytest.param("torrance-sparrow-metal", (0.4, 0.3, 0.3), marks=pytest.mark.slow),
    ],
)
def test_the_true_values_are_recovered(observation, model, truth):
    frames = photographs(np.random.default_rng(1), model=model, truth=truth)
    found = fit(with_frames(observation, frames), model)
    assert found.converged
    wanted = np.array(truth[: len(found.space)])
    np.testing.assert_allclose((np.log(found.natural / wanted)) / deviations(found), 0, atol=4)
    assert np.all(deviations(found) < 0.01)
    assert abs(found.chi_square - 1) < 5 * np.sqrt(2 / found.samples.dn.size)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["oren-nayar", "eon"])
def test_the_roughness_of_a_diffuse_surface_is_found(observation, model):
    frames = photographs(np.random.default_rng(7), model=model, truth=(0.6, 0, 0.5))
    found = fit(with_frames(observation, frames), model)
    assert [p.name for p in found.space] == ["diffuse", "roughness"]
    z = np.log(found.natural / (0.6, 0.5)) / deviations(found)
    np.testing.assert_allclose(z, 0, atol=4)
    assert np.all(deviations(found) < 0.03)


@pytest.mark.slow
def test_a_rough_matte_ball_is_distinguished_from_lamberts_by_default(observation):
    """The two rough bodies are compared without `compare_all`, and one of them predicts best."""
    frames = photographs(np.random.default_rng(9), model="eon", truth=(0.6, 0, 0.6))
    found = calibrate_reflectance(with_frames(observation, frames), model="eon")
    assert equally_good(found.scores)[0] in ("eon", "oren-nayar")


@pytest.mark.slow
def test_facets_of_another_index_change_k_s_and_little_else(observation):
    """k_s and the reflectance at normal incidence enter as a product."""
    frames = photographs(
        np.random.default_rng(8), model="torrance-sparrow-beckmann", truth=(0.4, 1.5, 0.25)
    )
    again = with_frames(observation, frames)
    right, wrong = (fit(again, "torrance-sparrow-beckmann", index=index) for index in (1.5, 1.8))
    expected = 1.5 * (0.5 / 2.5) ** 2 / (0.8 / 2.8) ** 2
    np.testing.assert_allclose(wrong.natural[1], expected, rtol=0.05)
    assert wrong.chi_square < 1.02 * right.chi_square


def test_the_optimum_equals_scipys(observation):
    found = fit(observation)
    s = found.samples
    cosine, mirror = cosines(s)
    dn, deviation = np.asarray(s.dn), np.asarray(s.deviation)

    def residuals(p):
        lobe = np.exp(np.exp(p[2]) * mirror)
        return (BLACK + WHITE * (np.exp(p[0]) * cosine + np.exp(p[1]) * lobe) - dn) / deviation

    reference = scipy.optimize.least_squares(residuals, np.log([0.3, 0.3, 20]), xtol=1e-14)
    np.testing.assert_allclose((found.vector - reference.x) / deviations(found), 0, atol=1e-3)


@pytest.mark.slow
def test_saturated_highlights_are_censored(observation):
    clip = BLACK + 0.6 * WHITE  # 1 % of the samples
    frames = photographs(np.random.default_rng(2), clip=clip)
    again = with_frames(observation, frames)
    censored = fit(dataclasses.replace(again, clip=clip))
    assert np.sum(censored.samples.saturated) > 50
    z = np.log(censored.natural / PHONG) / deviations(censored)
    np.testing.assert_allclose(z, 0, atol=4)
    believed = fit(again)
    assert believed.natural[1] < 0.9 * PHONG[1]


def test_the_censored_optimum_equals_scipys(observation):
    clip = BLACK + 0.6 * WHITE
    again = with_frames(observation, photographs(np.random.default_rng(2), clip=clip))
    found = fit(dataclasses.replace(again, clip=clip))
    s = found.samples
    cosine, mirror = cosines(s)
    dn, deviation, saturated = (np.asarray(x) for x in (s.dn, s.deviation, s.saturated))

    def cost(p):
        lobe = np.exp(np.exp(p[2]) * mirror)
        predicted = BLACK + WHITE * (np.exp(p[0]) * cosine + np.exp(p[1]) * lobe)
        z = (predicted - dn) / deviation
        tail = scipy.special.log_ndtr((predicted - clip) / deviation)
        return np.where(saturated, -tail, z * z / 2).sum()

    reference = scipy.optimize.minimize(
        cost, found.vector + 0.01, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-8}
    )
    np.testing.assert_allclose((found.vector - reference.x) / deviations(found), 0, atol=2e-3)


@pytest.mark.slow
def test_errors_of_light_intensities_widen_the_errors(observation):
    """Intensities have errors of 3 %. The robust error of k_d equals the scatter over repetitions,
    and the error for independent pixels is a small part of it."""
    logs, robust, naive = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        lights = np.exp(0.03 * rng.standard_normal(LIGHTS))
        found = fit(with_frames(observation, photographs(rng, lights=lights)))
        logs.append(found.vector[0])
        robust.append(deviations(found)[0])
        naive.append(np.sqrt(np.linalg.inv(found.information)[0, 0]))
        assert found.robustness.light_design_effect > 10
    scatter = np.std(logs, ddof=1)
    # 15 fitted lights and 3 parameters widen the error by up to sqrt(15 / 12 * 12 / 10) = 1.22,
    # less the correction for shrunk residuals. The scatter of 40 has a relative error of 0.11.
    ratio = np.sqrt(np.mean(np.square(robust))) / scatter
    assert 1 - 2.5 * 0.11 < ratio < 1.22 * (1 + 2.5 * 0.11)
    assert np.mean(naive) < scatter / 5


@pytest.mark.slow
def test_without_the_highlight_its_parameters_are_not_determined(observation):
    far = observation.mirror_angle.min(axis=0) > np.radians(35)
    kept = {
        name: getattr(observation, name)[..., far]
        for name in ("dn", "falloff", "cosine", "mirror_angle", "rows", "columns")
    }
    cut = dataclasses.replace(
        observation, normals=observation.normals[far], wi=observation.wi[:, far], **kept
    )
    calibration = calibrate_reflectance(cut, model="phong")
    section = reflectance_section(calibration)
    specular = find(section.estimates, "specular")
    assert specular.value is None
    assert specular.reason
    assert any("specular" in sentence for sentence in section.findings)
    diffuse = find(section.estimates, "diffuse")
    assert abs(diffuse.value - PHONG[0]) < 4 * diffuse.standard_error
    assert not calibration.posteriors


def test_a_matte_sphere_has_no_highlight_parameters(observation):
    frames = photographs(np.random.default_rng(3), model="lambert", truth=(0.4, 0.0, 1.0))
    frames -= np.round(0.02 * WHITE * shade(NORMALS, DIRECTIONS, "phong", 0, 1, 20))
    again = with_frames(observation, frames)
    found = fit(again)
    assert found.form.model == "lambert"
    assert set(open_parameters(found, fit(again, "lambert"))) == {"specular", "exponent"}


@pytest.mark.slow
def test_ambient_light_is_estimated_from_shadows(observation):
    frames = np.minimum(photographs(np.random.default_rng(4)) + 25, 4095)
    found = fit(with_frames(observation, frames), ambient=True)
    assert [p.name for p in found.space] == ["diffuse", "specular", "exponent", "ambient"]
    z = np.log(found.natural / [*PHONG, 25.0]) / deviations(found)
    np.testing.assert_allclose(z, 0, atol=4)


def encoded(frames, gamma):
    white = 4095 - BLACK
    return np.round(BLACK + white * np.maximum((frames - BLACK) / white, 0) ** (1 / gamma))


@pytest.mark.slow
def test_gamma_known_or_free(observation):
    frames = encoded(photographs(np.random.default_rng(5)), 2.2)
    again = with_frames(observation, frames)
    known = fit(dataclasses.replace(again, gamma=2.2))
    z = np.log(known.natural / PHONG) / deviations(known)
    np.testing.assert_allclose(z, 0, atol=4)
    free = fit(again, free_gamma=True)
    z = np.log(free.natural / [*PHONG, 2.2]) / deviations(free)
    np.testing.assert_allclose(z, 0, atol=4)
    # Unknown parameters cost precision, as long as nothing else widens the errors.
    costly, cheap = (np.diagonal(np.linalg.inv(f.information))[:3] for f in (free, known))
    assert np.all(costly > cheap)


def log_likelihood_of_pixels(vector, samples):
    """Return Phong's formula with Tobin's likelihood for each pixel, by NumPy."""
    diffuse, specular, exponent = np.exp(vector)
    cosine, mirror = cosines(samples)
    lobe = np.where(cosine > 0, np.exp(exponent * mirror), 0)
    signal = samples.geometry.irradiance * (diffuse * cosine + specular * lobe)
    predicted, sd = np.asarray(signal + samples.black), np.asarray(samples.deviation)
    found = norm.logpdf(samples.dn, predicted, sd)
    if samples.saturated is None:
        return found.sum()
    above = norm.logcdf((predicted - samples.clip) / sd)
    return np.where(samples.saturated, above, found).sum()


@pytest.mark.sweep
@pytest.mark.parametrize("width", [1.0, 4.0])
def test_cells_have_the_mode_and_density_of_all_pixels(observation, width):
    """At the mode both gradients vanish. Two standard errors away, where the log density has fallen
    by 2, the usual cells agree within 0.02, and cells four times as wide do not."""
    found = fit(observation)
    usual = cells(observation, found.selection, width=width)
    data = dataclasses.replace(composite(found, usual), stretch=jnp.eye(3))
    widths = np.sqrt(np.diagonal(np.linalg.inv(found.information)))
    at_mode = (
        adjusted_log_density(data.mode, data),
        log_likelihood_of_pixels(found.vector, found.samples),
    )
    for direction in np.eye(3):
        step = direction * widths
        slopes = [
            log_likelihood_of_pixels(found.vector + 0.01 * step, found.samples)
            - log_likelihood_of_pixels(found.vector - 0.01 * step, found.samples),
            adjusted_log_density(data.mode + 0.01 * step, data)
            - adjusted_log_density(data.mode - 0.01 * step, data),
        ]
        np.testing.assert_allclose(slopes, 0, atol=2e-5)
    worst = 0.0
    for direction in np.random.default_rng(0).standard_normal((6, 3)):
        root = np.linalg.cholesky(np.linalg.inv(found.information))
        away = root @ (2 * direction / np.linalg.norm(direction))
        falls = [
            adjusted_log_density(data.mode + away, data) - at_mode[0],
            log_likelihood_of_pixels(found.vector + away, found.samples) - at_mode[1],
        ]
        np.testing.assert_allclose(falls[1], -2, atol=0.1)
        worst = max(worst, abs(float(falls[0] - falls[1])))
    assert (worst < 0.02) == (width == 1.0)


@pytest.mark.slow
def test_draws_agree_with_laplace(observation):
    found = fit(observation)
    grouping = cells(observation, found.selection)
    laplace = channel_posterior(found, grouping, sampling=None, seed=0)
    options = Emcee(walkers=24, steps=6000)
    drawn = channel_posterior(found, grouping, sampling=options, seed=1)
    assert (laplace.method, drawn.method) == ("Laplace", "emcee")
    width = np.sqrt(np.diagonal(laplace.covariance))
    np.testing.assert_allclose(
        (np.log(np.median(drawn.samples, axis=0)) - laplace.unconstrained_mode) / width, 0, atol=0.3
    )
    wider = np.sqrt(np.diagonal(found.robustness.gaussian_covariance))
    np.testing.assert_allclose(np.sqrt(np.diagonal(drawn.covariance)), wider, rtol=0.06)


def test_the_basis_of_the_errors_is_named(observation):
    """There are few lights, so that more would help, or a fixed number of regions of lights."""
    found, matt = fit(observation), fit(observation, "lambert")
    few = dataclasses.replace(found.robustness, freedom=np.full(3, 3.6))
    lights = len(np.unique(found.selection.light))
    alone, alike = dataclasses.replace(found), dataclasses.replace(found)
    vars(alone).update(robustness=few, regions=found.regions)  # otherwise computed when used
    vars(alike).update(robustness=few, regions=np.arange(LIGHTS) // 2)
    told = {}
    for name, one in {"alone": alone, "alike": alike}.items():
        said = [s for s in findings(calibrated(observation, one, matt)) if "freedom, so" in s]
        told[name] = said[0]
    assert f"agreement of {lights} fitted lights" in told["alone"]
    assert "to either side; more lights make them narrower." in told["alone"]
    assert f"agreement of 8 regions of the {lights} fitted lights" in told["alike"]
    assert told["alike"].endswith("standard errors to either side.")


@pytest.mark.parametrize("model", ["torrance-sparrow-beckmann", "blinn", "torrance-sparrow"])
def test_facets_and_both_axes_are_compared_by_default(model):
    assert model in USUAL


def test_a_better_model_than_the_reported_one_is_named(observation):
    """The sentence has its numbers and the option that reports it, and names models that were not
    compared."""
    bright, matt = fit(observation), fit(observation, "lambert")
    told = findings(calibrated(observation, matt, bright))
    said = next(s for s in told if s.startswith("The reported model, Lambert"))
    numbers = r"it has \d\S* ± \S+ percentage points more error on unseen lights than Phong"
    assert re.search(numbers, said)
    assert said.endswith("--model phong reports that one (model='phong' in Python).")
    assert any(s.startswith("Not compared: Oren-Nayar, EON, normalised Phong,") for s in told)
    told = findings(calibrated(observation, bright, matt))
    assert not any("The reported model" in s for s in told)


def test_held_out_images_do_not_affect_the_fit(observation):
    frames = observation.dn.copy()
    frames[:, observation.held_out] = BLACK + 500
    changed = fit(dataclasses.replace(observation, dn=frames))
    np.testing.assert_array_equal(changed.vector, fit(observation).vector)


def test_the_error_of_a_prediction_leaves_out_saturated_samples(observation):
    """Some pixels of the held-out lights are clipped. The reference computes the ratio of two
    RMS."""
    found = fit(observation)
    frames, held_out = observation.dn.copy(), np.flatnonzero(observation.held_out)
    frames[0, held_out[0], np.flatnonzero(observation.cosine[held_out[0]] > 0.3)] = 4095
    clipped = dataclasses.replace(observation, dn=frames)
    missed, signal = [], []
    for light in held_out:
        trusted = (observation.cosine[light] > 0) & (frames[0, light] < 4095)
        measured = frames[0, light][trusted]
        missed.append(predicted_image(observation, found, int(light))[trusted] - measured)
        signal.append(measured - BLACK)
    expected = np.linalg.norm(np.concatenate(missed)) / np.linalg.norm(np.concatenate(signal))
    chosen = select(clipped, held_out=True, form=Form("phong"))
    assert relative_rms(squares_by_light(clipped, found, chosen)) == pytest.approx(
        expected, rel=1e-10
    )


@pytest.mark.slow
def test_the_section_names_the_right_model_and_draws(observation):
    calibration = calibrate_reflectance(observation, model="gaussian-lobe")
    section = reflectance_section(calibration)
    assert [e.name for e in section.estimates] == ["diffuse", "specular", "concentration"]
    errors = {score.model: score.predicted_error for score in calibration.scores}
    assert errors["phong"] < 0.3 * errors["lambert"]
    assert "held-out lights" in section.findings[0]
    assert section.findings[0].count("Lambert") == 1
    assert json.loads(as_json([section], seed=0, settings={}))["sections"][0]["kind"] == "brdf"
    for picture in section.pictures:
        figure = picture.draw()
        assert all(axis.has_data() for axis in figure.axes)


def test_bad_options_are_refused(observation):
    with pytest.raises(InputError, match="minimum_cosine"):
        calibrate_reflectance(observation, model="phong", minimum_cosine=1.0)
    with pytest.raises(InputError, match="samples have"):
        calibrate_reflectance(observation, model="phong", minimum_cosine=0.9999)


def test_fits_are_double_where_jax_computes_in_single_precision(observation):
    double = fit(observation)
    with jax.enable_x64(False):
        found = fit(observation)
    np.testing.assert_array_equal(found.vector, double.vector)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "vector", "changes"),
    [
        (Form("lambert"), [0.4], {}),
        (Form("oren-nayar", ambient=True), [0.4, 0.3, 20.0], {"gamma": 1.8}),
        (Form("phong", ambient=True, free_gamma=True), [0.4, 0.4, 30.0, 20.0, 2.0], {}),
        (Form("torrance-sparrow", index=1.4), [0.4, 3.0, 0.2], {"clip": 1000.0}),
    ],
)
def test_derivatives_equal_those_of_the_density_by_jax(observation, form, vector, changes):
    """The gradients are of pixels or, with an offset, of cells, some of them saturated."""
    seen = dataclasses.replace(observation, **{"clip": 1500.0, **changes})
    chosen = select(seen, held_out=False, form=form)
    samples = View(seen, 0, chosen).samples(form)
    deviation = np.random.default_rng(0).uniform(5, 20, len(chosen.light))
    samples = dataclasses.replace(samples, deviation=deviation)
    at = np.log(vector)
    averaged = average(samples, cells(seen, chosen), exact_at=predict(at + 0.1, samples))
    assert np.sum(samples.saturated) > 50
    for own in (samples, averaged):

        @jax.jit
        def cost_and_slopes(v, own=own):
            cost = lambda v: -jnp.sum(log_likelihoods(v, own))  # noqa: E731
            return cost(v), jax.grad(cost)(v), jax.hessian(cost)(v)

        wanted = cost_and_slopes(at)
        found = cost_and_information(predict(at, own), own)
        curvature = np.abs(np.diagonal(wanted[2]))
        size = 1.0, np.sqrt(curvature), np.sqrt(np.outer(curvature, curvature))
        for ours, jaxs, unit in zip(found, wanted, size, strict=True):
            np.testing.assert_allclose(ours / unit, jaxs / unit, rtol=1e-10, atol=1e-10)


@pytest.mark.slow
def test_programs_grow_neither_with_pixels_nor_with_lights_nor_with_channels(tmp_path):
    """A second calibration with other photographs compiles only the density of its cells and the
    angles of its pixels. All models together compile one program for each lobe, and few others."""

    def photographed(folder, channels, lights, size):
        folder.mkdir()
        normals, directions = sphere_normals(size, 0.46 * size), light_directions(lights)
        signal = WHITE * shade(normals, directions, "phong", *PHONG)
        rng = np.random.default_rng(0)
        taken = [
            expose(rng, signal * (1 - 0.1 * i), gain=GAIN, read_noise=READ, black=BLACK, clip=2000)
            for i in range(channels)
        ]
        frames = taken[0] if channels == 1 else np.stack(taken, axis=-1)
        camera = CAMERA | {"saturation": 2000.0}
        write_rig(folder, frames, directions, [WHITE], radius=0.46 * size, camera=camera)
        return folder

    compiled = []

    def listen(event, seconds, **of):
        if event.endswith("backend_compile_duration"):
            compiled.append(of.get("fun_name"))

    def calibrated(folder):
        compiled.clear()
        seen = read_reflectance_observation(folder)
        reflectance_section(calibrate_reflectance(seen, model="phong", compare_all=True))
        return len(compiled)

    grey = photographed(tmp_path / "grey", 1, 9, 24)
    colour = photographed(tmp_path / "colour", 3, 13, 28)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        assert calibrated(grey) <= 20, compiled
        assert calibrated(colour) <= 4, compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_a_positional_option_gets_a_message_with_its_name():
    said = "calibrate takes 1 of its arguments by their place; write model='torrance-sparrow'."
    with pytest.raises(TypeError, match=re.escape(said)):
        calibrate_reflectance(None, "torrance-sparrow")


def test_a_parameter_bounded_on_one_side_only_gets_no_value():
    space, mode = parameter_space(Form("phong")), np.array([0.4, 0.3, 30.0])
    draws = mode * np.exp(0.1 * np.random.default_rng(0).standard_normal((1, 400, 3)))
    known = (space, "Laplace", draws, mode, np.log(mode), 0.01 * np.eye(3), 0)
    for endless, missing in (("", []), ("exponent", ["exponent"])):
        rows = determined_estimates(Posterior(*known, endless=endless), "grey", {})
        assert [row.name for row in rows if row.value is None] == missing
