"""Tests that stated errors of a rig widen a reflectance fit by as much as refits change."""

from dataclasses import replace
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from scipy import stats

from fitting.checks import reflectance
from fitting.checks.coverage import coverage
from fitting.checks.reflectance import Sphere
from fitting.checks.simulations import simulated
from fitting.inference.clustering import Robustness
from fitting.inference.left_out import TOLERANCE
from fitting.reflectance.from_images.calibration import open_parameters
from fitting.reflectance.from_images.comparison import relative_rms, squares_by_light
from fitting.reflectance.from_images.fit import fit_channel
from fitting.reflectance.from_images.lights import (
    StatedErrors,
    add_stated_errors,
    information_on_turns,
    likeliest_turns,
    marginalise_directions,
)
from fitting.reflectance.from_images.samples import (
    Selection,
    View,
    log_likelihoods,
    predict,
    scores_and_slopes,
)
from fitting.reflectance.from_images.signal import Form
from fitting.report.left_out import left_out_tables

SPHERE = Sphere(lights=5, read_noise=1.0)


@pytest.fixture(scope="module")
def fitted():
    observation, chosen, cells = SPHERE.observed

    def fit(**changed):
        view = View(replace(observation, **changed), 0, chosen)
        return fit_channel(view, Form("phong"), cells)

    return observation, fit


@pytest.mark.slow
def test_each_error_has_the_effect_of_a_refit(fitted):
    """The refits have one light 1 % brighter, and the black level 2 DN higher."""
    observation, fit = fitted
    sizes = {"intensity_sd": np.full(5, 0.01)}
    plain = fit(uncertain=sizes, black_sd=2.0)
    inverse = np.linalg.inv(plain.information)
    brighter = observation.intensity.copy()
    brighter[0, 1] *= 1.01
    moved = fit(intensity=brighter).vector - plain.vector
    error = np.sqrt(np.diagonal(inverse))
    np.testing.assert_allclose(
        -plain.stated.of_lights[1] @ inverse / error, moved / error, atol=0.2
    )
    assert np.abs(moved / error).max() > 1
    moved = fit(black=observation.black + 2.0).vector - plain.vector
    np.testing.assert_allclose(-plain.stated.common[0] @ inverse / error, moved / error, atol=0.2)
    assert np.abs(moved / error).max() > 1


def turned_by_hand(observation, size, about):
    """Return an observation with the third light rotated about either axis perpendicular to it."""
    light = observation.wi[2, 0]
    axis = np.cross(light, np.eye(3)[np.argmin(np.abs(light))])
    axis = axis if about == 0 else np.cross(light, axis)
    turned = light + size * axis / np.linalg.norm(axis)
    turned /= np.linalg.norm(turned)
    changed = {name: getattr(observation, name).copy() for name in ("wi", "cosine")}
    changed["wi"][2] = turned
    changed["cosine"][2] = observation.normals @ turned
    return changed


@pytest.mark.parametrize("about", [0, 1])
@pytest.mark.sweep
def test_a_rotated_light_is_estimated(fitted, about):
    """The rig states three times the rotation as its error. The remaining rotation is within the
    fit's error."""
    observation, fit = fitted
    size, known = 5e-3, np.zeros(5)
    known[2] = 3 * size
    right = fit()
    error = np.sqrt(np.diagonal(np.linalg.inv(right.information)))
    wrong = turned_by_hand(observation, size, about)
    believed = (fit(**wrong).vector - right.vector) / error
    assert (np.abs(believed).max() > 1) == (about == 0)
    doubted = fit(**wrong, uncertain={"direction_sd": known})
    rig = replace(observation, **wrong, uncertain={"direction_sd": known})
    missed = relative_rms(squares_by_light(rig, doubted, doubted.selection))
    expected = relative_rms(squares_by_light(observation, right, right.selection))
    assert missed == pytest.approx(expected, rel=1e-3)
    left = np.linalg.inv(doubted.stated.marginal_information(doubted.information))
    slopes = scores_and_slopes(predict(doubted.vector, doubted.samples), doubted.samples)[1]
    beyond = np.diagonal(left - np.linalg.inv(slopes @ slopes.T))
    np.testing.assert_array_less(
        np.abs(doubted.vector - right.vector) / error, 3 * np.sqrt(beyond) / error + 0.05
    )


@pytest.mark.slow
def test_lights_are_as_uncertain_as_their_images_show(fitted):
    """A light with an error four times the stated one is estimated, and gets this larger error."""
    observation, fit = fitted
    wrong, known = turned_by_hand(observation, 0.01, 0), np.zeros(5)
    known[2] = 0.01
    told = fit(**wrong, uncertain={"direction_sd": known})
    assert told.turned.followed
    assert told.turned.widened == 1
    wide = fit(**wrong, uncertain={"direction_sd": known / 4})
    assert wide.turned.followed
    assert wide.turned.widened > 1
    np.testing.assert_allclose(wide.turned.turns / 4, told.turned.turns, atol=0.05)
    error = np.sqrt(np.diagonal(told.robustness.covariance))
    wider = np.sqrt(np.diagonal(wide.robustness.covariance))
    np.testing.assert_allclose(wider / error, 1, atol=0.1)
    far = fit(**wrong, uncertain={"direction_sd": known / 10})
    alone = fit(**wrong)
    assert not far.turned.followed
    np.testing.assert_array_equal(far.vector, alone.vector)
    assert far.stated.of_lights.reshape(2, 5, -1)[:, 2].any()
    assert set(open_parameters(far, alone)) >= {"specular", "exponent"}


@pytest.mark.slow
def test_light_rotations_converge_from_a_partial_fit(fitted, monkeypatch):
    _, fit = fitted
    uncertain = {"direction_sd": np.full(5, 5e-3)}
    whole = fit(uncertain=uncertain)
    monkeypatch.setattr("fitting.reflectance.from_images.lights.ENOUGH", 1300)
    found = fit(uncertain=uncertain)
    np.testing.assert_allclose(found.turned.turns, whole.turned.turns, atol=0.03)
    error = np.sqrt(np.diagonal(np.linalg.inv(whole.information)))
    np.testing.assert_allclose(found.vector / error, whole.vector / error, atol=0.1, rtol=0)


@pytest.mark.parametrize("core", [0.0, 0.6])
def test_rotations_take_the_information_of_a_joint_fit(fitted, core):
    """Parameters and two rotations are differentiated numerically, and their normal equations
    inverted."""
    observation, fit = fitted
    known = np.zeros(5)
    known[2] = 5e-3
    brighter = core * observation.dn.max() * np.maximum(np.cos(observation.mirror_angle), 0) ** 400
    observation = replace(observation, dn=observation.dn + brighter * (observation.cosine > 0))
    found = fit(dn=observation.dn, uncertain={"direction_sd": known})
    samples, vector = found.samples, found.vector
    deviation = np.asarray(samples.deviation, float)

    def slope(low, high, step):
        return (np.asarray(high, float) - np.asarray(low, float)) / step / deviation

    columns = []
    for one in np.eye(3) * 1e-4:
        columns.append(
            slope(predict(vector - one, samples).dn, predict(vector + one, samples).dn, 2e-4)
        )
    for about in (0, 1):
        ends = []
        for size in (-1e-4, 1e-4):
            moved = replace(observation, **turned_by_hand(observation, size, about))
            ends.append(predict(vector, View(moved, 0, found.selection).samples(found.form)).dn)
        columns.append(slope(ends[0], ends[1], 2e-4 / 5e-3))
    design = np.stack(columns, axis=1)
    whole = design.T @ design + np.diag([0, 0, 0, 1, 1])
    gauss = found.stated.marginal_information(found.information)
    np.testing.assert_allclose(np.linalg.inv(gauss), np.linalg.inv(whole)[:3, :3], rtol=0.1, atol=0)


@pytest.mark.slow
@pytest.mark.parametrize(("degrees", "lights"), [(0.5, 12), (1.0, 4), (1.0, 24)])
def test_intervals_cover_if_highlights_are_smeared(degrees, lights):
    """With the stated directions, 36 and 14 % of the intervals of k_s covered, for 12 and 24 lights
    with errors of one degree."""
    sphere = Sphere(direction_sd=np.radians(degrees), lights=lights, stated=("direction_sd",))
    places = np.array([reflectance.places(sphere, seed) for seed in range(60)])
    for found in coverage(places, reflectance.NAMES):
        assert not found.faults, found


def test_stated_errors_take_the_place_of_few_lights_unless_these_show_more():
    information, known = np.diag([4.0, 1.0]), np.arange(2)
    stated = StatedErrors(np.array([[4.0, 0.0]]), np.array([[0.0, 2.0]]))
    freedom = np.array([2.0, 3.0])
    narrow = Robustness(np.diag([0.5, 0.5]), freedom, (1.0, 1.0), 1.0)
    found = add_stated_errors(narrow, stated, information, known)
    np.testing.assert_allclose(found.covariance, np.diag([0.25 + 1, 1 + 4]))
    assert np.isinf(found.freedom).all()
    wide = replace(narrow, covariance=np.diag([100.0, 0.5]))
    found = add_stated_errors(wide, stated, information, known)
    np.testing.assert_allclose(found.covariance, np.diag([100, 0.5 + 4]))
    np.testing.assert_allclose(found.freedom, [2, 3 / (0.5 / 4.5) ** 2])
    none = StatedErrors(np.empty((0, 2)), np.empty((0, 2)))
    found = add_stated_errors(wide, none, information, known)
    np.testing.assert_array_equal(found.covariance, wide.covariance)
    np.testing.assert_array_equal(found.freedom, wide.freedom)


def test_negligible_errors_are_left_out_with_their_bound(fitted):
    """The bound is computed for single samples: the black level changes all samples together, and a
    light those of its image. Both are negligible and left out, and the larger errors of the
    directions stay."""
    _, fit = fitted
    sizes = {"exposure_sd": np.full(5, 1e-5), "direction_sd": np.full(5, 5e-3)}
    found = fit(uncertain=sizes, black_sd=1e-3)
    samples, light = found.samples, found.selection.light
    noise = np.asarray(samples.deviation, float)
    signal = predict(found.vector, samples).signal  # the files are linear
    of_light = [np.sum((1e-5 * signal / noise)[light == k] ** 2) for k in range(5)]
    of_black = np.sum((1e-3 / noise) ** 2)
    bounds = {
        "exposure_sd": np.sqrt(np.sum((np.sqrt(1 + np.array(of_light)) - 1) ** 2)),
        "black_sd": np.sqrt(1 + of_black) - 1,
    }
    gone = {own.name: (own.size, own.bound) for own in found.stated.left_out}
    assert gone.keys() == bounds.keys()
    assert gone["black_sd"] == (1e-3, pytest.approx(bounds["black_sd"], rel=1e-5))
    assert gone["exposure_sd"] == (1e-5, pytest.approx(bounds["exposure_sd"], rel=1e-3))
    assert 0 < sum(bounds.values()) <= TOLERANCE
    assert not len(found.stated.of_lights)
    assert found.stated.slopes is not None
    assert not len(found.stated.common)
    (table,) = left_out_tables([("grey", found.stated.left_out)])
    assert {row[1] for row in table.rows} == bounds.keys()
    (unnamed,) = left_out_tables([("", found.stated.left_out)])
    assert unnamed.columns == table.columns[1:]
    assert not fit(uncertain=sizes, black_sd=2.0).stated.left_out[1:]


def test_the_likelihood_traces_no_stated_error(fitted):
    """Errors widen the covariance of a fit. Its likelihood is the same program with and without
    them."""
    _, fit = fitted
    found = [fit(), fit(uncertain={"exposure_sd": np.full(5, 0.01)}, black_sd=2.0)]
    plain, stated = (str(jax.make_jaxpr(log_likelihoods)(own.vector, own.samples)) for own in found)
    assert plain == stated


@pytest.mark.slow
@pytest.mark.parametrize("case", ["4 lights off by 1 %, as stated", "black off by 3 DN, as stated"])
def test_intervals_under_stated_errors_cover(case):
    sphere = reflectance.CASES[case]
    places = simulated(lambda seed: reflectance.places(sphere, seed), 200, parameters=3)
    for one in coverage(places, reflectance.NAMES):
        assert not one.faults, one
        assert 0.8 < one.z_sd < 1.25


def test_eliminating_rotations_equals_the_dense_inverse(fitted):
    """The reference multiplies gradients and residuals by the inverse of 1 + S S^T."""
    _, fit = fitted
    found, rng = fit(), np.random.default_rng(0)
    count, light = len(found.selection.light), found.selection.light
    deviation = np.asarray(found.samples.deviation, float)
    shifts = deviation * rng.standard_normal((2, count)) * np.exp(rng.uniform(-8, 1, count))
    values = rng.standard_normal((3, count))
    left = marginalise_directions(values, shifts, found.samples, found.selection, 5)
    expected = np.zeros((3, 3))
    for one in range(5):
        own = light == one
        s = (shifts / deviation)[:, own].T
        expected += values[:, own] @ np.linalg.solve(np.eye(own.sum()) + s @ s.T, values[:, own].T)
    np.testing.assert_allclose(left @ left.T, expected, rtol=1e-10, atol=1e-9)


def test_rotations_and_parameters_are_fitted_together(fitted):
    """One step from the true optimum of both equals dense least squares, for five lights whose
    errors are partly shared."""
    found, rng = fitted[1](), np.random.default_rng(3)
    samples, light = found.samples, found.selection.light
    prediction = predict(found.vector + 0.1, samples)
    deviation = np.asarray(samples.deviation, float)
    slopes = scores_and_slopes(prediction, samples)[1]
    shifts = deviation * (0.5 * slopes[:2] + 0.01 * rng.standard_normal((2, len(light))))
    root = np.tril(rng.uniform(0.5, 1, (10, 10)))
    before = 0.1 * rng.standard_normal((5, 2))
    turns = likeliest_turns(shifts, before, prediction, samples, found.selection, root @ root.T)
    moves = np.zeros((len(light), 5, 2))
    moves[np.arange(len(light)), light] = (shifts / deviation).T
    moves = moves.reshape(len(light), 10)
    left = (np.asarray(samples.dn) - prediction.dn) / deviation + moves @ before.ravel()
    whole = np.block([[moves, slopes.T], [np.linalg.inv(root), np.zeros((10, len(slopes)))]])
    best = np.linalg.lstsq(whole, np.append(left, np.zeros(10)))[0][:10]
    np.testing.assert_allclose(turns.ravel(), best, rtol=1e-6, atol=1e-8)


def test_the_evidence_with_rotations_equals_their_integral(fitted):
    """For residuals r = S e + noise of three lights, the reference is SciPy's normal density of r
    with covariance 1 + S S^T, or S S^T / 4 if four samples count as one."""
    fit = fitted[1]()
    rng, light = np.random.default_rng(4), np.repeat(np.arange(3), 20)
    deviation, moves = rng.uniform(1, 3, 60), 2 * rng.standard_normal((2, 60))
    samples = SimpleNamespace(deviation=deviation, saturated=None)
    selection = Selection(light, np.arange(60))
    told = information_on_turns(moves * deviation, samples, selection, 3)  # pyright: ignore[reportArgumentType]
    for effect in (1.0, 4.0):
        left, turns, exact = rng.standard_normal(60), np.empty((3, 2)), 0.0
        for one in range(3):
            own = light == one
            s = moves[:, own].T / np.sqrt(effect)
            turns[one] = np.linalg.solve(np.eye(2) + s.T @ s, s.T @ left[own])
            exact += stats.multivariate_normal(cov=np.eye(20) + s @ s.T).logpdf(left[own])
            exact -= stats.norm.logpdf(left[own] - s @ turns[one]).sum()
        of_turns = replace(fit, turns_and_information=(turns, told))
        found = of_turns.log_evidence(effect) - fit.log_evidence(effect)
        assert found == pytest.approx(exact)
        assert fit.log_evidence(effect) == fit.log_likelihood / effect


def test_light_in_shadows_widens_by_its_effect_on_all_pixels(fitted):
    """The unstated black level is wrong by 20 DN. Without widening the amplitude is outside its
    errors, and with it inside. Black shadows change nothing."""
    observation, fit = fitted
    plain = fit()
    wrong = fit(black=observation.black - 20.0)
    moved = wrong.vector - plain.vector
    narrow = np.sqrt(np.diagonal(np.linalg.inv(wrong.information)))
    wide = np.sqrt(np.diagonal(wrong.robustness.covariance))
    assert abs(moved[0]) > 3 * narrow[0]
    assert abs(moved[0]) < 1.96 * wide[0]
    assert not len(plain.stated.common)
    assert not any(error.name == "black_sd" for error in plain.stated.left_out)
    stated = fit(black=observation.black - 20.0, black_sd=10.0)  # explains the light
    np.testing.assert_allclose(stated.stated.common, wrong.stated.common / 2, rtol=1e-3)
