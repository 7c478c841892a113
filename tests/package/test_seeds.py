"""Tests that the seed of a command reaches every random draw of every calibration, and is the
recorded one."""

import json
from functools import partial
from types import SimpleNamespace
from typing import cast

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from typer.testing import CliRunner

from fitting import Gaussian, Parameter, Problem, fit, folders
from fitting.cli import app
from fitting.demo.compare import calibrate_lab
from fitting.inference import posterior
from fitting.inference.emcee_run import Chain, Emcee
from fitting.joint import calibration as joint
from fitting.noise import calibration as noise
from fitting.noise.read import read_photon_transfer
from fitting.reflectance.from_files import calibration as from_files
from fitting.reflectance.from_files.fit import fit_model
from fitting.reflectance.from_files.read import from_samples
from fitting.reflectance.from_images import calibration as from_images
from fitting.reflectance.from_images.read import Photographs, read_reflectance_observation
from fitting.report.progress import reporting
from fitting.response import calibration as response
from fitting.response.read import read_exposure_stack
from fitting.rig import Rig, load_rig
from jaxvision.brdf.measured import BRDFSamples


def material():
    """Return a Lambertian sheet with noise, which has one parameter, so draws are short."""
    rng = np.random.default_rng(0)
    theta_i = np.repeat(np.radians([15.0, 30.0, 45.0, 60.0, 75.0]), 8)
    theta_o = np.tile(np.radians(np.linspace(0, 70, 8)), 5)
    values = 0.2 + 0.01 * rng.standard_normal((40, 1))
    columns = (theta_i, 0 * theta_i, theta_o, 0 * theta_o, values)
    samples = BRDFSamples(*(jnp.asarray(column) for column in columns), None)
    return from_samples("sheet", samples, weights=np.ones(40))


@pytest.fixture(scope="module")
def calibrations(lab):
    """Return {name: (calibration of (sampling, seed), its posteriors)}."""
    folder, _ = lab
    stack = read_exposure_stack(load_rig(folder / "response"))
    images = read_reflectance_observation(load_rig(folder / "brdf"))
    measurement = read_photon_transfer(folder / "noise")
    return {
        "noise": (partial(noise.calibrate, measurement), lambda c: [c.posterior]),
        "response": (
            partial(response.calibrate, stack),
            lambda c: [channel.gamma.posterior for channel in c.channels],
        ),
        "from images": (
            partial(from_images.calibrate, images, model="phong"),
            lambda c: [*c.posteriors.values()],
        ),
        "from files": (
            partial(from_files.calibrate, material(), model="lambert"),
            lambda c: [c.posterior],
        ),
    }


@pytest.fixture(autouse=True)
def one_model_of_files(monkeypatch):
    def fit(measured, *, objective, index):
        return {"lambert": fit_model(measured, "lambert", objective=objective, index=index)}

    monkeypatch.setattr(from_files, "fit_models", fit)


@pytest.mark.slow  # every calibration, twice
@pytest.mark.parametrize("name", ["noise", "response", "from images", "from files"])
def test_a_seed_reaches_every_draw(calibrations, name, monkeypatch):
    calibrate, posteriors = calibrations[name]
    first, again, other = (posteriors(calibrate(seed=seed)) for seed in (7, 7, 8))
    assert first
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a.draws, b.draws)
        assert (a.draws != c.draws).all()
        assert (a.seed, c.seed) == (7, 8)

    seeds = []

    def ensemble(log_density, mode, covariance, *, seed, **others):
        seeds.append(seed)
        drawn = np.random.default_rng(seed).multivariate_normal(mode, covariance, (60, 8))
        return Chain(drawn, np.zeros((60, 8)), np.ones(len(mode)), 0.5, 60, 0, ())

    monkeypatch.setattr(posterior, "run_ensemble", ensemble)
    sampled = posteriors(calibrate(sampling=Emcee(walkers=8), seed=9))
    assert seeds == [9] * len(first)
    assert {one.seed for one in sampled} == {9}


@pytest.mark.slow
def test_the_demo_draws_by_its_seed(lab):
    with reporting() as reporter:
        sections = calibrate_lab(lab[0], reporter.step, lambda *_: {"sampling": None, "seed": 3})
    seeds = [one.seed for section in sections for one in section.posteriors.values()]
    assert len(seeds) == 7
    assert set(seeds) == {3}


@pytest.mark.slow
def test_the_recorded_seed_is_the_one_that_drew(lab, tmp_path):
    arguments = ["brdf", str(lab[0] / "brdf"), "--out", str(tmp_path), "--seed", "7"]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert json.loads((tmp_path / "results.json").read_text())["seed"] == 7
    with xarray.open_dataset(tmp_path / "brdf_chains.nc", group="posterior") as chains:
        assert chains.attrs["seed"].tolist() == [7, 7, 7]


def test_a_seed_reaches_every_setting_and_the_joint_fit(monkeypatch):
    """The folder has several gains. Reading and fitting are replaced, and the seeds recorded."""
    seeds = []

    def calibrate_one(one, *, sampling, seed):
        seeds.append((one, seed))

    def calibrate_settings(frames, *, calibrations, seed):
        seeds.append(("all", seed))

    across = "fitting.noise.across_settings"
    monkeypatch.setattr(f"{across}.setting.reduce_by_setting", lambda rig, **_: ["low", "high"])
    monkeypatch.setattr(f"{across}.calibration.calibrate_one", calibrate_one)
    monkeypatch.setattr(f"{across}.calibration.calibrate_settings", calibrate_settings)
    monkeypatch.setattr(f"{across}.section.sections", lambda calibration: ["whole"])
    monkeypatch.setattr("fitting.report.inputs.add_inputs", lambda section, *_: section)
    rig = SimpleNamespace(camera=SimpleNamespace(sites=("",)))
    with reporting() as reporter:
        found = folders._noise_of_settings(
            cast(Rig, rig), reporter.step, lambda *_: {"sampling": None, "seed": 7}, ""
        )
    assert found == ["whole"]
    assert seeds == [("low", 7), ("high", 7), ("all", 7)]


def test_the_draws_of_a_fit_depend_on_its_seed():
    data = 2 + 0.1 * np.random.default_rng(1).standard_normal(20)
    level = {"level": Parameter(start=0.0)}
    problem = Problem(level, lambda level: level * jnp.ones(20), Gaussian(0.1), data)
    first, again, other = (fit(problem, starts=1, seed=seed).posterior for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.draws, again.draws)
    assert (first.draws != other.draws).all()
    assert (first.seed, other.seed) == (7, 8)


def test_a_joint_calibration_passes_its_seed_to_every_channel(monkeypatch):
    seeds = []

    def posterior(fit, robust, sampling, seed):
        seeds.append((fit.channel, seed))

    monkeypatch.setattr(joint, "fit_turned", lambda _, i, *__, **___: SimpleNamespace(channel=i))
    monkeypatch.setattr(joint, "is_determined", lambda fit: True)
    monkeypatch.setattr(joint, "image_sandwich", lambda *_: None)
    monkeypatch.setattr(joint, "drop_strangers", lambda observation: observation)
    monkeypatch.setattr(joint, "_posterior", posterior)
    monkeypatch.setattr(joint, "require_kind", lambda *_, **__: None)  # for the stand-in
    monkeypatch.setattr(joint, "_recognise_pixel_means", lambda observation, *_: observation)
    monkeypatch.setattr(joint, "_decode_photographs", lambda observation, *_: (observation, False))
    dn = np.ones((2, 1, 1))
    measurement = SimpleNamespace(channels=("red", "green"), within=None, dn=dn)
    joint.calibrate(cast(Photographs, measurement), seed=7)
    assert seeds == [(0, 7), (1, 7)]
