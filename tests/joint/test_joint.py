"""Tests joint fits of surface, response and sensor: the marginal density against dense covariances,
the terms of the likelihood, and the recovery of simulated labs."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
import xarray
from typer.testing import CliRunner

from fitting.checks.joint import Lab, photographed
from fitting.checks.reflectance import Sphere
from fitting.cli import app
from fitting.demo.lab import sphere_lights
from fitting.inference.clustering import Robustness
from fitting.inference.importance import TOLERATED
from fitting.inference.parameters import names, to_unconstrained
from fitting.joint import calibrate, from_photographs, marginal, read_joint_measurement
from fitting.joint.cells import make_grid, reduce_images
from fitting.joint.findings import OF_CHANNEL, findings
from fitting.joint.fit import fit_channel, fit_turned
from fitting.joint.misfit import (
    Halves,
    _image_scores,
    degrees_of_freedom,
    image_sandwich,
    laplace_miss,
    unequal_pixels,
    widened,
)
from fitting.joint.model import Cells, JointData, log_likelihood, parameters, scatter_scales
from fitting.joint.prediction import score
from fitting.joint.section import section as joint_section
from fitting.reflectance.from_images.read import set_light_covariance
from fitting.reflectance.from_images.signal import Form, Geometry
from fitting.report.sentences import evaluate_findings
from fitting.rig import Camera, SphereGeometry
from jaxvision import Phong, Vec, read_material
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

RNG = np.random.default_rng(4)


def table(images=3, cells=5, errors=2):
    """Return residuals, weights with two cells unseen, and errors."""
    weight = RNG.uniform(0.5, 2.0, (images, cells))
    weight[0, 1] = weight[2, 4] = 0
    seen = weight > 0
    shared = RNG.standard_normal((images, errors, cells)) * seen[:, None]
    gains = RNG.standard_normal((images, cells)) * seen
    return RNG.standard_normal((images, cells)) * 2, weight, shared, gains


def dense(weight, shared, gains):
    """Return the covariance of the seen cells, entry by entry."""
    places = np.argwhere(weight > 0)
    matrix = np.zeros((len(places), len(places)))
    for a, (i, c) in enumerate(places):
        for b, (j, d) in enumerate(places):
            if a == b:
                matrix[a, b] += 1 / weight[i, c]
            if i == j and shared is not None:
                matrix[a, b] += shared[i, :, c] @ shared[i, :, d]
            if c == d and gains is not None:
                matrix[a, b] += gains[i, c] * gains[j, d]
    return tuple(places.T), matrix


@pytest.mark.sweep("True-True")
@pytest.mark.parametrize("with_images", [False, True])
@pytest.mark.parametrize("with_cells", [False, True])
def test_shared_errors_are_marginalised(with_images, with_cells):
    residual, weight, shared, gains = table()
    kept = {"image_errors": shared if with_images else None}
    kept |= {"cell_errors": gains if with_cells else None}
    places, matrix = dense(weight, *kept.values())
    given = {k: None if v is None else jnp.asarray(v) for k, v in kept.items()}
    of = marginal.Residuals(jnp.asarray(residual), jnp.asarray(weight), **given)
    found = jax.jit(marginal.log_density)(of)
    normal = scipy.stats.multivariate_normal(np.zeros(len(matrix)), matrix)  # pyright: ignore
    expected = normal.logpdf(residual[places]) + len(matrix) * np.log(2 * np.pi) / 2
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    square = marginal.chi_square(of)
    solved = np.linalg.solve(matrix, residual[places])
    np.testing.assert_allclose(square, residual[places] @ solved, rtol=1e-12)


@pytest.mark.parametrize("with_cells", [False, True])
def test_the_errors_of_images_are_their_conditional_means(with_cells):
    residual, weight, shared, gains = table()
    places, matrix = dense(weight, shared, gains if with_cells else None)
    given = (residual, weight, shared, gains)[: 4 if with_cells else 3]
    mean, spread = marginal.image_error_means(marginal.Residuals(*map(jnp.asarray, given)))
    for image, error in np.ndindex(mean.shape):
        loading = np.where(places[0] == image, shared[image, error, places[1]], 0)
        solved = np.linalg.solve(matrix, loading)
        np.testing.assert_allclose(mean[image, error], solved @ residual[places], rtol=1e-10)
        np.testing.assert_allclose(spread[image, error] ** 2, 1 - solved @ loading, rtol=1e-10)


def test_the_scatter_of_pixels_and_their_mean_are_sufficient():
    """Count, mean and products give the same density as a dense normal distribution of all
    pixels."""
    images, pixels = 3, 7
    variance, gains = RNG.uniform(1, 3, images), RNG.uniform(1, 2, images)
    y = RNG.standard_normal((images, pixels)) * 2
    covariance = np.diag(variance) + np.outer(gains, gains)
    normal = scipy.stats.multivariate_normal(np.zeros(images), covariance)  # pyright: ignore
    expected = normal.logpdf(y.T).sum()
    mean, n = y.mean(axis=1), pixels
    left = y - mean[:, None]
    column = {"variance": variance, "gains": gains, "mean": mean}
    column = {name: jnp.asarray(values)[:, None] for name, values in column.items()}
    gains = column["gains"] / np.sqrt(n)
    means = marginal.Residuals(column["mean"], n / column["variance"], cell_errors=gains)
    of_means = marginal.log_density(means)
    of_scatter = marginal.scatter_log_density(
        jnp.asarray((left**2).sum(axis=1))[:, None],
        jnp.full((images, 1), float(n)),
        column["variance"],
        pixel_errors=column["gains"],
        products=jnp.asarray(left @ left.T)[None],
    )
    constant = -images * n * np.log(2 * np.pi) / 2 - images * np.log(n) / 2
    np.testing.assert_allclose(of_means + of_scatter + constant, expected, rtol=1e-12)


BLACK, GAIN, READ, GAMMA = 64.0, 0.25, 6.0, 2.2
DIFFUSE, SPECULAR, EXPONENT, LIGHT = 0.42, 0.45, 40.0, 3000.0
SIZE = 28
CENTRE, RADIUS = (SIZE - 1) / 2, 0.45 * SIZE
TRUTH = {
    "diffuse": DIFFUSE,
    "specular": SPECULAR,
    "exponent": EXPONENT,
    "gamma": GAMMA,
    "system_gain": GAIN,
    "read_noise": READ,
    "black_level": BLACK,
}


def photographs(
    rng, *, lights=7, scatter=0.01, turn=0.0, stray=0.0, prnu=0.0, gamma=GAMMA,
    exponent=EXPONENT, body=1.0, size=SIZE,
):  # fmt: skip
    """Return photographs of a Phong ball under lights that differ from the stated ones."""
    nodes, shares = np.polynomial.legendre.leggauss(4)  # positions in a pixel, along each side
    at = (np.arange(size)[:, None] + nodes / 2).ravel()
    row, column = np.meshgrid(at, at, indexing="ij")
    centre, radius = (size - 1) / 2, 0.45 * size
    x, y = (column - centre) / radius, (centre - row) / radius
    inside = np.hypot(x, y) < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    own = 1 + prnu * rng.standard_normal((size, size))
    directions, images = sphere_lights(count=lights), []
    for stated in directions:
        light = stated + turn * np.cross(stated, rng.standard_normal(3))
        light = light / np.linalg.norm(light)
        cosine = x * light[0] + y * light[1] + z * light[2]
        mirror = np.maximum(2 * cosine * z - light[2], 0)
        shading = DIFFUSE * np.maximum(cosine, 0) ** body + SPECULAR * mirror**exponent
        strength = LIGHT * np.exp(scatter * rng.standard_normal())
        shading = np.where(inside & (cosine > 0), shading, 0)
        shading = shading.reshape(size, 4, size, 4)
        signal = strength * np.einsum("iajb,a,b->ij", shading, shares / 2, shares / 2) * own
        signal = np.maximum(signal + LIGHT * stray * rng.standard_normal(), 0)
        noise = GAIN * READ * rng.standard_normal(signal.shape)
        linear = np.maximum(GAIN * rng.poisson(signal / GAIN) + noise, 0 if gamma != 1 else -BLACK)
        white = 4095 - BLACK
        stored = linear if gamma == 1 else white * (linear / white) ** (1 / gamma)
        images.append(np.clip(np.round(BLACK + stored), 0, 4095).astype(np.uint16))
    return images, directions


BALL: dict[str, Any] = {
    "sphere": SphereGeometry(centre=(CENTRE, CENTRE), radius=RADIUS),
    "intensities": np.full(7, LIGHT),
    "held_out": [6],
}
ENCODED = Camera(bits=12, black_level=BLACK, black_sd=0.5, gamma=GAMMA, gamma_sd=0.5)


def primitives(jaxpr):
    """Return the names of all operations, including inner ones."""
    found = []
    for equation in jaxpr.eqns:
        found.append(equation.primitive.name)
        for value in jax.tree.leaves(equation.params, is_leaf=lambda v: hasattr(v, "eqns")):
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                found += primitives(inner)
    return found


def likelihood_of(measurement):
    """Return the operations in the log likelihood of a measurement, for two empty cells."""
    form, start = Form("phong"), {"gamma": GAMMA} if measurement.camera.gamma else {}
    space, known = parameters(measurement, 0, form, start)
    seven = jnp.full((7, 2), 0.5)
    up = Vec(jnp.zeros((7, 2)), jnp.zeros((7, 2)), jnp.ones((7, 2)))
    scales = scatter_scales(measurement)
    data = JointData(
        space=space,
        form=form,
        known={name: jnp.asarray(value) for name, value in known.items()},
        cells=Cells(
            Geometry(
                up,
                up,
                seven,
                (up, up) if "direction_scatter" in scales else None,
            ),
            *(4 * seven, seven, seven, seven, seven),
            jnp.ones((2, 7, 7)) if "prnu" in scales else None,
        ),
        levels=None,
        white=jnp.asarray(4000.0),
        relative={name: jnp.asarray(size) for name, (_, size) in scales.items()},
    )
    return primitives(jax.make_jaxpr(log_likelihood)(jnp.zeros(len(space)), data).jaxpr)


def test_only_effects_stated_by_the_rig_are_in_the_likelihood():
    """Without light errors there is no Cholesky factor, and without encoding no power."""
    images, lights = photographs(np.random.default_rng(0), gamma=1)
    exact = Camera(bits=12, black_level=BLACK, gain=GAIN, read_noise=READ)

    def operations(camera, **uncertain):
        return likelihood_of(from_photographs(images, lights, camera=camera, **BALL, **uncertain))

    bare = operations(exact)
    lit = operations(exact, intensity_sd=0.01)
    strayed = operations(exact, intensity_sd=0.01, stray_sd=0.001)
    turned = operations(exact, intensity_sd=0.01, direction_sd=0.01)
    uneven = operations(exact.model_copy(update={"prnu_sd": 0.01}))
    assert "cholesky" not in bare
    assert "cholesky" not in uneven
    assert "cholesky" in lit
    assert len(bare) < len(lit) < len(strayed) < len(turned)
    assert len(bare) < len(uneven)
    assert "pow" not in bare
    encoded = exact.model_copy(update={"gamma": GAMMA})
    assert "pow" in operations(encoded)


def test_unusable_measurements_are_refused_in_one_sentence():
    images, lights = photographs(np.random.default_rng(0))
    with pytest.raises(InputError, match="values of intensity_sd for 7 images"):
        from_photographs(images, lights, camera=ENCODED, **BALL, intensity_sd=[0.01, 0.02])
    flat = [np.full((4, 4), 100), np.full((4, 4), 100)]
    with pytest.raises(InputError, match="equal in every pixel"):
        from_photographs(images, lights, camera=ENCODED, **BALL, flats=[flat])
    bright = [np.full((4, 4), 4095), np.full((4, 4), 4000)]
    with pytest.raises(InputError, match="saturated pixels; leave this level"):
        from_photographs(images, lights, camera=ENCODED, **BALL, flats=[bright])
    with pytest.raises(InputError, match=r"intensity_sd\[0\] = -1.0: must be greater"):
        from_photographs(images, lights, camera=ENCODED, **BALL, intensity_sd=-1.0)
    with pytest.raises(InputError, match="index = 0"):
        calibrate(from_photographs(images, lights, camera=ENCODED, **BALL), index=0.0)


def rig_folder(folder, images, lights, flat, dark):
    """Write the same measurement as files."""
    text = f"[camera]\nbits = 12\nblack_level = {BLACK}\nblack_sd = 0.5\nprnu_sd = 0\n"
    text += f"[geometry]\nsphere = {{centre = [{CENTRE}, {CENTRE}], radius = {RADIUS}}}\n"
    for i, (image, light) in enumerate(zip(images, lights, strict=True)):
        write_image(folder / f"light_{i}.tif", image)
        text += f'[[light]]\nfile = "light_{i}.tif"\ndirection = {light.tolist()}\n'
        text += f"intensity = [{LIGHT}]\nintensity_sd = 0.01\nstray_sd = {0.001 * (1 + i)}\n"
        text += "held_out = true\n" if i == 6 else ""
    for kind, frames in (("flat", flat), ("dark", dark)):
        files = [f"{kind}_{i}.tif" for i in range(len(frames))]
        for name, frame in zip(files, frames, strict=True):
            write_image(folder / name, frame)
        text += f"[[{kind}]]\nfiles = {files}\nexposure = 1.0\n"
    (folder / "rig.toml").write_text(text)
    return folder


def uniform(rng, electrons):
    light = rng.poisson(electrons, (2, 40, 50)) + READ * rng.standard_normal((2, 40, 50))
    return list(np.round(BLACK + GAIN * light).astype(np.uint16))


def test_images_in_memory_equal_files(tmp_path):
    rng = np.random.default_rng(1)
    images, lights = photographs(rng, gamma=1)
    flat, dark = uniform(rng, 4000), uniform(rng, 0)
    ours = from_photographs(
        images,
        lights,
        camera=Camera(bits=12, black_level=BLACK, black_sd=0.5),
        **BALL,
        intensity_sd=0.01,
        stray_sd=0.001 * (1 + np.arange(7)),
        flats=[flat],
        darks=[dark],
    )
    theirs = read_joint_measurement(rig_folder(tmp_path, images, lights, flat, dark))
    np.testing.assert_array_equal(ours.dn, theirs.dn)
    np.testing.assert_array_equal(ours.wi, theirs.wi)
    for name, sizes in theirs.uncertain.items():
        np.testing.assert_array_equal(ours.uncertain[name], sizes)
    assert ours.levels is not None
    assert theirs.levels is not None
    (mine,), (other,) = ours.levels, theirs.levels
    for field in ("mean", "variance", "freedom", "mean_error", "dark"):
        np.testing.assert_array_equal(getattr(mine, field), getattr(other, field))
    pair = np.stack(flat).astype(float)
    spread = np.var(pair[0] - pair[1], ddof=1) / 2
    np.testing.assert_allclose(mine.variance[0], spread, rtol=1e-6)
    np.testing.assert_allclose(mine.mean, [pair.mean(), np.mean(dark)], rtol=1e-12)


@pytest.mark.slow
def test_the_command_writes_report_results_and_chains(tmp_path):
    rng = np.random.default_rng(1)
    images, lights = photographs(rng, gamma=1)
    (tmp_path / "rig").mkdir()
    rig = rig_folder(tmp_path / "rig", images, lights, uniform(rng, 4000), uniform(rng, 0))
    done = CliRunner().invoke(app, ["joint", str(rig), "--out", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.stderr
    names_ = {path.name for path in (tmp_path / "out").iterdir()}
    material = {"material.toml", "material.npz"}
    assert names_ == {"report.html", "results.json", "joint_chains.nc"} | material
    (section,) = json.loads((tmp_path / "out" / "results.json").read_text())["sections"]
    found = {estimate["name"]: estimate for estimate in section["estimates"]}
    for name in ("diffuse", "specular", "exponent", "system_gain", "read_noise", "black_level"):
        error = found[name]["value"] - TRUTH[name]
        assert abs(error) < 4 * found[name]["standard_error"], name
    chains = tmp_path / "out" / "joint_chains.nc"
    with xarray.open_dataset(chains, group="posterior", engine="h5netcdf") as drawn:
        assert set(found) == set(drawn.data_vars)
    best = read_material(tmp_path / "out" / "material.toml")
    assert isinstance(best, Phong)
    for name in ("diffuse", "specular", "exponent"):
        # the mode, where the report gives the median of draws
        apart = float(np.ravel(getattr(best, name))[0]) - found[name]["value"]
        assert abs(apart) < 0.1 * found[name]["standard_error"]
    many = read_material(tmp_path / "out" / "material.toml", draws=200)
    assert isinstance(many, Phong)
    assert many.exponent.shape == (200,)
    spread = float(np.std(many.exponent)) / found["exponent"]["standard_error"]
    assert 0.8 < spread < 1.25


def z_scores(calibration, truth):
    """Return the error of each parameter in standard deviations of the posterior."""
    posterior = calibration.posteriors["grey"]
    known = [parameter for parameter in posterior.space if parameter.name in truth]
    places = [names(posterior.space).index(parameter.name) for parameter in known]
    vector = to_unconstrained(tuple(known), jnp.asarray([truth[p.name] for p in known]))
    deviation = np.sqrt(np.diagonal(posterior.covariance))[places]
    return (posterior.unconstrained_mode[places] - np.asarray(vector)) / deviation


@pytest.mark.slow
def test_a_simulated_lab_is_recovered_with_its_errors():
    """Surface, encoding, sensor and the sizes of all four shared errors are within four standard
    deviations, and the pixels agree with the noise."""
    images, lights = photographs(
        np.random.default_rng(2), turn=0.005, stray=0.002, prnu=0.01, gamma=1
    )
    camera = Camera(bits=12, black_level=BLACK, black_sd=0.5, prnu_sd=0.01)
    sizes: dict[str, Any] = {"intensity_sd": 0.01, "direction_sd": 0.005, "stray_sd": 0.002}
    found = calibrate(from_photographs(images, lights, camera=camera, **BALL, **sizes))
    scales = {
        "light_scatter": 0.01,
        "direction_scatter": 0.005,
        "stray_scatter": 0.002,
        "prnu": 0.01,
    }
    scores = z_scores(found, {k: v for k, v in TRUTH.items() if k != "gamma"} | scales)
    assert len(scores) == 10
    assert np.abs(scores).max() < 4
    (fit,) = found.fits
    assert fit.converged
    assert fit.unexplained is None
    assert abs(fit.chi_square - 1) < 4 * np.sqrt(2 / fit.cells)


@pytest.mark.slow
def test_an_interval_from_few_lights_has_their_degrees_of_freedom():
    """k_d depends on the lights' common error and on little else, so it has few more degrees of
    freedom than the scale of these errors. Parameters that do not depend on the lights' strengths
    have many."""
    images, lights = photographs(np.random.default_rng(5))
    found = calibrate(from_photographs(images, lights, camera=ENCODED, **BALL, intensity_sd=0.01))
    (fit,), posterior = found.fits, found.posteriors["grey"]
    assert posterior.method == "importance sampling"  # Laplace's Gaussian would not show it
    covariance = np.linalg.inv(fit.information)
    degrees = degrees_of_freedom(fit, covariance)
    assert degrees is not None
    freedom = dict(zip(names(posterior.space), degrees.tolist(), strict=True))
    scale = names(posterior.space).index("light_scatter")
    assert laplace_miss(fit, covariance)[scale] > TOLERATED
    of_scale = 1 / (2 * covariance[scale, scale])
    assert of_scale < freedom["diffuse"] < 2 * of_scale
    assert 4 < of_scale < 12  # from six lights and the prior
    assert freedom["exponent"] > 100
    assert freedom["black_level"] > 100


@pytest.mark.slow
def test_flats_and_darks_reduce_errors_of_gain_read_noise_and_black():
    rng = np.random.default_rng(5)
    images, lights = photographs(rng, gamma=1)
    camera = Camera(bits=12, black_level=BLACK, black_sd=0.5)

    given: dict[str, Any] = {"camera": camera, **BALL, "intensity_sd": 0.01}
    alone = calibrate(from_photographs(images, lights, **given)).posteriors["grey"]
    flats, darks = [uniform(rng, 2000), uniform(rng, 8000)], [uniform(rng, 0)]
    beside: dict[str, Any] = {"flats": flats, "darks": darks}
    both = calibrate(from_photographs(images, lights, **given, **beside))
    names_ = names(alone.space)
    spread = [np.sqrt(np.diagonal(p.covariance)) for p in (alone, both.posteriors["grey"])]
    ratio = dict(zip(names_, spread[1] / spread[0], strict=True))
    assert ratio["system_gain"] < 0.7
    assert ratio["read_noise"] < 0.2
    assert ratio["black_level"] < 0.2
    assert np.abs(z_scores(both, TRUTH)).max() < 4


def large_ball(rng, **of_surface):
    """Return a measurement with many pixels per degree of the normal, under exact lights."""
    size = 120
    images, lights = photographs(rng, scatter=0.0, gamma=1, size=size, **of_surface)
    sphere = SphereGeometry(centre=((size - 1) / 2, (size - 1) / 2), radius=0.45 * size)
    given = BALL | {"sphere": sphere, "camera": Camera(bits=12, black_level=BLACK)}
    return from_photographs(images, lights, **given)


@pytest.mark.slow
def test_cells_are_wide_except_in_highlights_and_near_saturation():
    """Every pixel is in one cell of an image. In a divided image, the lobe varies within a wide
    cell by at most a twentieth of its peak, and the finest cells have the given width."""
    measurement = large_ball(np.random.default_rng(4), exponent=200.0)
    of = measurement
    reference = TRUTH | {"diffuse": DIFFUSE, "exponent": 200.0}
    del reference["gamma"]
    at = {name: jnp.asarray(value) for name, value in reference.items()}
    form, width = Form("phong"), 0.0125
    grid, shared = (
        make_grid(of, 0, at, form, width=width, turns=False, shared=s) for s in (False, True)
    )
    pixels = len(of.normals)
    for own in (grid, shared):
        assert own.cell.shape == (6, pixels)
        assert (own.count.sum(axis=1) == pixels).all()
    assert (shared.cell == shared.cell[0]).all()
    used = (grid.count > 0).sum(axis=1)
    assert (used < 0.9 * (shared.count > 0).sum(axis=1)).all(), used
    assert (used < 0.6 * pixels).all(), (used, pixels)
    plane = of.normals[:, :2] * np.sqrt(2 / (1 + of.normals[:, 2:]))
    for image, light in enumerate(grid.lights):
        mirror = 2 * of.cosine[light] * of.normals[:, 2] - of.wi[light, :, 2]
        lobe = np.where(of.cosine[light] > 0, np.maximum(mirror, 0) ** 200.0, 0)
        for cell in range(used[image]):
            inside = grid.cell[image] == cell
            if np.ptp(plane[inside], axis=0).max() > width * 1.001:
                assert np.ptp(lobe[inside]) < 0.05 * 1.001


@pytest.mark.slow
def test_wide_cells_give_the_results_of_fine_ones():
    """The estimates agree within a quarter of a standard deviation, and their errors within a
    tenth, with a third of the cells of a uniformly fine division."""
    measurement = large_ball(np.random.default_rng(4), exponent=100.0)
    fits = []
    for widest in (0.05, 0.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("fitting.joint.fit.cell_width", lambda form, shape: 0.02)
            patch.setattr("fitting.joint.cells.WIDEST", widest or 0.02)
            fits.append(fit_channel(measurement, 0, Form("phong")))
    wide, fine = fits
    assert wide.cells < 0.4 * fine.cells
    assert wide.unexplained is None
    deviation, other = (np.sqrt(np.diagonal(np.linalg.inv(fit.information))) for fit in fits)
    np.testing.assert_allclose(wide.vector / other, fine.vector / other, atol=0.25, rtol=0)
    np.testing.assert_allclose(deviation, other, rtol=0.1)


@pytest.mark.slow
def test_a_misfit_of_the_surface_is_not_attributed_to_noise():
    """The body falls as the cosine to the power 1.2."""
    measurement = large_ball(np.random.default_rng(5), body=1.2)
    found = calibrate(measurement)
    (fit,) = found.fits
    assert fit.converged
    assert fit.unexplained is not None
    assert fit.unexplained > 2
    assert abs(float(fit.values["system_gain"]) / GAIN - 1) < 0.05
    assert any("A misfit of" in sentence for sentence in findings(found))
    scored = score(measurement, fit, found.posteriors["grey"].covariance)
    assert scored.unseen_share is not None
    assert 0.9 < scored.unseen_share < 0.99


@pytest.mark.slow
def test_cells_of_many_pixels_give_the_results_of_pixels():
    """If every pixel is lit by every light, cells half as wide as the lobe give the mode and the
    standard deviations of single pixels."""
    images, lights = photographs(np.random.default_rng(7), exponent=4.0, scatter=0.0)
    row, column = np.indices((SIZE, SIZE))
    given = BALL | {
        "mask": np.hypot(column - CENTRE, row - CENTRE) < 0.65 * RADIUS,
        "intensities": np.full(4, LIGHT),
        "held_out": [3],
    }
    measurement = from_photographs(images[:4], lights[:4], camera=ENCODED, **given)
    fits = []
    for width in (0.05, 0.12):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("fitting.joint.fit.cell_width", lambda form, shape, width=width: width)
            fits.append(fit_channel(measurement, 0, Form("phong")))
    fine, wide = fits
    assert wide.cells < fine.cells / 1.5
    assert np.sum(wide.data.cells.count) == np.sum(fine.data.cells.count)
    deviation, other = (np.sqrt(np.diagonal(np.linalg.inv(fit.information))) for fit in fits)
    np.testing.assert_allclose(wide.vector / deviation, fine.vector / deviation, atol=0.15, rtol=0)
    np.testing.assert_allclose(other, deviation, rtol=0.05)


@pytest.mark.slow
def test_intervals_with_a_misfit_cover_the_results_of_other_images():
    """The body falls as the cosine to the power 1.2, and the lights have unstated errors of 3 %.
    Fits to disjoint halves of 16 images differ by what their intervals allow, but by more than the
    inverse information allows."""
    images, lights = photographs(
        np.random.default_rng(8), lights=17, scatter=0.03, gamma=1, size=80, body=1.2
    )
    sphere = SphereGeometry(centre=(39.5, 39.5), radius=36.0)
    given: dict[str, Any] = {"sphere": sphere, "camera": Camera(bits=12, black_level=BLACK)}
    measured = from_photographs(
        images, lights, intensities=np.full(17, LIGHT), held_out=[16], **given
    )
    modes, widths, narrow = [], [], []
    for first in (0, 1):
        held_out = np.arange(17) % 2 != first
        held_out[16] = True
        half = replace(measured, held_out=held_out)
        found = calibrate(half)
        (fit,), posterior = found.fits, found.posteriors["grey"]
        assert fit.unexplained is not None
        assert posterior.freedom is not None
        assert any("is correlated within an image" in sentence for sentence in findings(found))
        modes.append(fit.vector)
        widths.append(np.sqrt(np.diagonal(posterior.covariance)))
        narrow.append(np.sqrt(np.diagonal(np.linalg.inv(fit.information))))
        assert (widths[-1] >= narrow[-1] * (1 - 1e-9)).all()
    surface = slice(0, 3)  # k_d, k_s and the exponent
    z, too_large = (
        (modes[0] - modes[1])[surface] / np.hypot(*w)[surface] for w in (widths, narrow)
    )
    assert np.abs(z).max() < 3
    assert np.abs(too_large).max() > 3


@pytest.mark.slow
@pytest.mark.parametrize("waves", [0.0, 0.05])
@pytest.mark.parametrize("prnu", [0.0, 0.01])
def test_structure_shared_by_cells_is_not_attributed_to_sensor_noise(waves, prnu):
    """Each pixel has its own cell. Gain and read noise absorb waves over each image as photon
    noise, so chi-square is 1. The scores of the images reveal them, and the intervals cover the
    true values."""
    lab = Lab(Sphere(prnu=prnu), gamma=1.0)
    rng = np.random.default_rng(3)
    seen = photographed(lab, 3)
    turns, phases = rng.uniform(0, 2 * np.pi, (2, len(seen.files), 1))
    along = np.cos(turns) * seen.normals[:, 0] + np.sin(turns) * seen.normals[:, 1]
    wave = 1 + waves * np.sin(4 * along + phases)
    measurement = replace(seen, dn=np.round(seen.black + (seen.dn - seen.black) * wave))
    fit = fit_channel(measurement, 0, Form("phong"))
    robust = image_sandwich(measurement, fit)
    assert robust is not None
    assert (robust.design_effect == 1) == (waves == 0)
    if waves == 0:
        return
    own = [i for i, p in enumerate(fit.space) if p.name in ("diffuse", "specular", "exponent")]
    truth = np.log([lab.truth[fit.space[i].name] for i in own])
    alone, wider = (
        np.sqrt(np.diagonal(c))[own]
        for c in (np.linalg.inv(fit.information), robust.gaussian_covariance)
    )
    off = fit.vector[own] - truth
    assert np.sqrt(np.mean((off / wider) ** 2)) < 1.6
    assert (wider > 1.5 * alone)[[0, 2]].all()  # gain and read noise affect k_s as much


@pytest.mark.slow
@pytest.mark.parametrize("together", [False, True])
def test_images_with_rotated_lights_are_judged_one_by_one(together):
    """The last axis of the angles of the lights is that of images."""
    lab = Lab(Sphere(direction_sd=np.radians(1.0)), gamma=1.0)
    measurement = photographed(lab, 0)
    if together:
        count = len(measurement.files)
        shared = (1 + np.eye(count))[:, None, :, None] * np.diag([1, 1, 1, 0])[:, None] / 2
        shared *= lab.sphere.direction_sd**2
        measurement = set_light_covariance(measurement, shared, False)
    fit = fit_turned(measurement, 0, Form("phong"))
    assert fit.data.cells.geometry.about is not None
    vector = jnp.asarray(fit.vector)
    scores, _ = _image_scores(vector, fit.data)
    whole = jax.grad(log_likelihood)(vector, replace(fit.data, levels=None))
    size = np.sqrt(np.diagonal(fit.information))
    np.testing.assert_allclose((np.asarray(scores).sum(axis=0) - whole) / size, 0, atol=1e-6)
    robust = image_sandwich(measurement, fit)
    assert robust is None or robust.design_effect == 1


@pytest.mark.slow
def test_halves_of_the_images_are_fitted_and_reported():
    """Images of two surfaces alternate, under lights with errors, and are fitted as one surface."""
    given: dict[str, Any] = {"scatter": 0.03, "gamma": 1, "size": 80, "lights": 17}
    truth = (12.0, 60.0)
    images, others = (
        photographs(np.random.default_rng(6), exponent=exponent, **given)[0] for exponent in truth
    )
    lights = photographs(np.random.default_rng(6), **given)[1]
    measured = from_photographs(
        [(images, others)[i % 2][i] for i in range(17)],
        lights,
        sphere=SphereGeometry(centre=(39.5, 39.5), radius=36.0),
        camera=Camera(bits=12, black_level=BLACK),
        intensities=np.full(17, LIGHT),
        held_out=[16],
    )
    found = calibrate(measured)
    (fit,) = found.fits
    halves, posterior = found.halves["grey"], found.posteriors["grey"]
    at = halves.names.index("exponent")
    np.testing.assert_allclose(halves.values[:, at], truth, rtol=0.05)
    assert any("exponent (12.1 and 58.6)" in sentence for sentence in findings(found))
    middle, sd = fit.vector[at], math.sqrt(posterior.covariance[at, at])
    low, high = np.exp([middle - 1.96 * sd, middle + 1.96 * sd])
    assert low < truth[0] < truth[1] < high
    equal = replace(halves, deviations=halves.deviations / 10)
    told = findings(replace(found, halves={"grey": equal}))
    assert any("agree within these intervals" in sentence for sentence in told)


@pytest.mark.slow
def test_a_fit_left_with_few_cells_has_not_converged(monkeypatch):
    """With as many cells as parameters there is no degree of freedom, and chi-square would be
    divided by 0."""
    images, lights = photographs(np.random.default_rng(0), lights=5, gamma=1, size=40)
    measured = from_photographs(
        images,
        lights,
        sphere=SphereGeometry(centre=(19.5, 19.5), radius=17.0),
        camera=Camera(bits=12, black_level=BLACK),
        intensities=np.full(5, LIGHT),
        held_out=[4],
    )
    calls = []

    def few(*args, **kwargs):
        cells = reduce_images(*args, **kwargs)
        calls.append(cells)
        seen = np.cumsum(np.asarray(cells.count).ravel() > 0).reshape(cells.count.shape)
        kept = ((seen <= 4) | (len(calls) == 1)).astype(float)
        return replace(cells, count=cells.count * kept, scatter=cells.scatter * kept)

    monkeypatch.setattr("fitting.joint.fit.reduce_images", few)
    found = fit_channel(measured, 0, Form("lambert"))
    assert len(found.space) == found.cells == 4
    assert np.isfinite(found.chi_square)
    assert not found.converged


@pytest.mark.parametrize(
    ("deviations", "told"),
    [
        (None, "too few, or too different"),
        ([0.0, 1.0, 0.0], "agree within these intervals"),
        ([0.0, 7.4, 0.0], "differ in exponent (1 and 2), by up to 7 standard deviations"),
    ],
)
def test_images_that_disagree_are_checked_by_their_halves(deviations, told):
    values = np.array([[1.0, 1.0, 1.0], [1.0, 2.0, 1.0]])
    halves = {}
    if deviations is not None:
        labels = ("diffuse", "exponent", "gamma")
        halves["grey"] = Halves(labels, values, values[1] - values[0], np.array(deviations))
    robust = SimpleNamespace(design_effect=2.0, gaussian_covariance=np.eye(3))
    of_fit = {"posteriors": {"grey": ()}, "robust": {"grey": robust}, "halves": halves}
    rows = [row for row in OF_CHANNEL if "halves" in row.key]
    fit = SimpleNamespace(channel="grey", information=np.eye(3))
    (sentence,) = evaluate_findings(rows, (SimpleNamespace(**of_fit), fit))
    assert told in sentence


@pytest.mark.parametrize("effect", [1.02, 2.0])
def test_insignificantly_larger_scores_are_not_reported(effect):
    robust = SimpleNamespace(design_effect=effect, gaussian_covariance=effect * np.eye(3))
    of_fit = {"posteriors": {"grey": ()}, "robust": {"grey": robust}, "halves": {}}
    rows = [row for row in OF_CHANNEL if row.key == "images disagree"]
    fit = SimpleNamespace(channel="grey", information=np.eye(3))
    told = evaluate_findings(rows, (SimpleNamespace(**of_fit), fit))
    assert len(told) == (effect > 1.1)


def test_halves_that_differ_count_as_two_random_groups():
    """The variance of a mean from two groups is a quarter of their squared difference (Wolter)."""
    rng = np.random.default_rng(2)
    covariance = np.diag(rng.uniform(1, 2, 3)) * 1e-4
    robust = Robustness(covariance, np.full(3, np.inf), (math.nan, math.nan), 1.0)
    values = rng.standard_normal((2, 3))
    difference = values[0] - values[1]
    deviations = difference / (2 * np.sqrt(np.diagonal(covariance)))
    halves = Halves(("a", "b", "c"), values, difference, deviations)
    assert not halves.agree
    groups = np.cov(values.T, ddof=1) / 2
    np.testing.assert_allclose(widened(robust, halves).covariance, covariance + groups)
    close = Halves(("a", "b", "c"), values, difference * 0, deviations * 0)
    assert widened(robust, close) is robust


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize(("prnu", "stated"), [(0.0, None), (0.0, 0.0), (0.01, None)])
def test_pixels_of_unequal_gains_are_named(prnu, stated):
    """The size of the PRNU is estimated from a fit that assumes equal pixels."""
    rng = np.random.default_rng(12)
    images, lights = photographs(rng, lights=4, scatter=0.0, gamma=1, size=90, prnu=prnu)
    given: dict[str, Any] = {
        "sphere": SphereGeometry(centre=(44.5, 44.5), radius=0.45 * 90),
        "camera": Camera(bits=12, black_level=BLACK, prnu_sd=stated),
        "intensities": np.full(4, LIGHT),
        "held_out": [3],
    }
    found = calibrate(from_photographs(images, lights, **given))
    (seen,) = [unequal_pixels(fit) for fit in found.fits]
    said = [s for s in findings(found) if "ive the rig camera.prnu_sd" in s]
    printed = {e.name for e in joint_section(found).estimates if e.value is not None}
    assert ({"system_gain", "read_noise"} <= printed) == (stated is not None)
    assert {"diffuse", "specular", "exponent"} <= printed
    if prnu:
        assert abs(seen.size / prnu - 1) < 0.25
        assert len(said) == 1
    else:
        assert abs(seen.deviations) < 4
        assert len(said) == (stated is None)
