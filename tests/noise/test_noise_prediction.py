"""Tests predictions by a calibrated camera's file, with frames of known cameras whose moments have
closed forms."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import called
from scipy.stats import norm

import fitting.noise.calibration as calibrations
import jaxvision as jv
from fitting.cli import app
from fitting.noise import Camera, calibrate, from_frames, predict
from fitting.noise import sensor as sensor_of
from fitting.noise.levels import Levels, PhotonTransfer, SharedVariance
from fitting.noise.prediction.comparison import compare
from fitting.noise.prediction.moments import Lit, clipped
from fitting.noise.prediction.predict import levels_kept_out, predict_own_frames
from fitting.noise.prediction.section import NOTHING_KNOWN, findings, section
from fitting.noise.sensor import fitted_sensor
from jaxvision.errors import InputError

GAIN, EFFICIENCY, READ, BLACK, CURRENT = 0.25, 0.5, 5.0, 64.0, 100.0
SIZE, FRAMES = 96, 4
PHOTONS = np.linspace(240.0, 24_000.0, 12)
EXPOSURES = np.linspace(0.001, 0.02, 12)
PLAIN = jv.Sensor(
    shot_noise=jv.PoissonShotNoise(),
    quantum_efficiency=EFFICIENCY,
    read_noise=READ,
    dark_current=CURRENT,
    gain=GAIN,
    offset=BLACK,
    bits=12,
)


def closed_form(photons, seconds, *, rows=0.0, curve=0.0, leak=0.0, mixed=0.0, repelled=0.0):
    """Return mean, variance, and covariances along rows and columns in DN, written out."""
    electrons = EFFICIENCY * (photons + leak * (photons > 0)) + CURRENT * seconds
    top = EFFICIENCY * PHOTONS[-1]
    slope = GAIN * (1 - 2 * curve * electrons / top)
    lost = repelled * electrons / top  # of the variance, to four neighbours
    own = slope**2 * electrons * (1 - mixed - lost)
    around = slope**2 * electrons * (mixed + lost) / 4
    mean = BLACK + GAIN * electrons * (1 - curve * electrons / top)
    noise = GAIN**2 * (READ**2 + rows**2) + 1 / 12
    return np.array([mean, own + noise, around + (GAIN * rows) ** 2, around])


def measured(rng, *, chance=1.0, **planted):
    """Return flats and darks whose statistics scatter about the closed form like those of
    frames."""
    n = SIZE**2
    shared = (GAIN * planted.get("rows", 0.0)) ** 2

    def levels(photons, seconds):
        found = closed_form(photons, seconds, **planted)
        total, count = found[1], len(photons)
        errors = [
            np.sqrt((total / n + shared / SIZE) / FRAMES),
            np.sqrt((2 * total**2 / n + 2 * shared**2 / SIZE) / (FRAMES - 1)),
            np.sqrt((total**2 / n + 2 * shared * (shared + total / SIZE) / SIZE) / (FRAMES - 1)),
            np.sqrt((total**2 / n + shared**2 / SIZE) / (FRAMES - 1)),
        ]
        found = found + chance * np.array(errors) * rng.standard_normal(found.shape)
        covariances = np.zeros((count, 4, 4))
        covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 0] = found[1:]
        none = jnp.zeros(count)
        of_rows = jnp.full(count, shared)
        return Levels(
            light=jnp.asarray(photons),
            exposure=jnp.asarray(seconds),
            mean=jnp.asarray(found[0]),
            variance=jnp.asarray(found[1]),
            frames=jnp.full(count, float(FRAMES)),
            pixels=jnp.asarray(float(n)),
            shared=SharedVariance(
                jnp.stack([of_rows, none]),
                jnp.zeros((2, none.size)),
                none,
                jnp.full(2, float(SIZE)),
            ),
            covariances=jnp.asarray(covariances),
        )

    return PhotonTransfer(
        bright=levels(PHOTONS, EXPOSURES),
        dark=levels(np.zeros(6), EXPOSURES[::2]),
        dark_of=jnp.arange(12) // 2,
        light_step=jnp.asarray(0.0),
        full_scale=4095.0,
    )


def test_a_sensor_predicts_the_closed_form_of_every_quantity():
    top = EFFICIENCY * PHOTONS[-1]
    sensor = replace(PLAIN, row_noise=6.0, nonlinearity=jv.Compression(0.04, electrons=top))
    sensor = replace(sensor, light_offset=30.0)
    planted = {"rows": 6.0, "curve": 0.04, "leak": 30.0}
    exact = measured(np.random.default_rng(0), chance=0.0, **planted)
    found = compare(sensor, None, exact, np.arange(12))
    np.testing.assert_allclose(found.found.values, found.measured, rtol=2e-3)
    np.testing.assert_allclose(found.found.values[0], found.measured[0], rtol=1e-5)


def test_a_true_camera_agrees_within_chance():
    """Chi-squares of 60 measurements follow their distribution."""
    chi_squares = {"means": [], "variances": [], "covariances of neighbours": []}
    sensor = replace(PLAIN, row_noise=6.0)
    for seed in range(60):
        made = measured(np.random.default_rng(seed), rows=6.0)
        for name, one in compare(sensor, None, made, np.arange(12)).agreement.items():
            chi_squares[name].append(one.chi_square)
            degrees = one.degrees
            assert degrees == (36 if name.startswith("cov") else 18)
    for name, found in chi_squares.items():
        degrees = 36 if name.startswith("cov") else 18
        assert abs(np.mean(found) / degrees - 1) < 4 * np.sqrt(2 / degrees / 60), name
        assert 0.5 < np.var(found) / (2 * degrees) < 2, name


PLANTED = {
    "row_noise": {"rows": 4.0},
    "compression": {"curve": 0.02},
    "light_offset": {"leak": 40.0},
    "mixing": {"mixed": 0.08},
    "brighter_fatter": {"repelled": 0.1},
}


@pytest.mark.parametrize("effect", PLANTED)
def test_a_simulated_effect_that_the_camera_lacks_is_named(effect):
    named = []
    for seed in range(2):
        prediction = predict(PLAIN, measured(np.random.default_rng(seed), **PLANTED[effect]))
        assert prediction.main_comparison.missed
        named.append([one.key for one in prediction.missing])
        assert not any(one.is_missed for one in prediction.missing[-1].after.values())
        told = findings(prediction)
        assert any("The most likely cause is" in sentence for sentence in told)
        assert NOTHING_KNOWN not in told
    assert named == [[effect]] * 2


def test_an_unknown_effect_is_not_named():
    made = measured(np.random.default_rng(1))
    waves = 1 + 0.02 * np.sin(np.arange(12.0))[:, None, None] ** 3
    covariances = np.asarray(made.bright.covariances).copy()
    covariances[:, 1, 0] += 40 * waves[:, 0, 0] * (-1.0) ** np.arange(12)
    bright = replace(made.bright, covariances=jnp.asarray(covariances))
    prediction = predict(PLAIN, replace(made, bright=bright))
    assert prediction.main_comparison.missed == ["covariances of neighbours"]
    assert NOTHING_KNOWN in findings(prediction)


def test_the_report_has_each_level_beside_its_prediction():
    """The table has measured and predicted mean and variance, and their difference over the
    error."""
    found = predict(PLAIN, measured(np.random.default_rng(1)))
    told = section(found)
    assert any("The frames agree with it within their errors" in one for one in told.findings)
    (levels,) = [one for one in told.tables if one.title == "Levels"]
    assert len(levels.rows) == found.main_comparison.lit.lit.size
    for row in (levels.rows[0], levels.rows[-1]):
        assert len(row) == len(levels.columns) == 8
    assert levels.rows[-1][0] == "dark"
    z = [row[4] for row in levels.rows]
    np.testing.assert_allclose(z, found.main_comparison.residuals[0])
    np.testing.assert_allclose(
        [row[3] for row in levels.rows], found.main_comparison.found.values[0]
    )
    np.testing.assert_allclose([row[5] for row in levels.rows], found.main_comparison.measured[1])


def test_averaged_frames_scatter_too_little():
    made = measured(np.random.default_rng(2), chance=0.05)
    told = findings(predict(PLAIN, made))
    assert any("scatter less about the prediction than independent frames" in one for one in told)


def test_an_error_of_the_light_widens_the_errors():
    made = measured(np.random.default_rng(3))
    off = 1 + 0.01 * np.random.default_rng(4).standard_normal(12)
    bright = replace(made.bright, light=made.bright.light / off)
    off_lights = replace(made, bright=bright)
    missed = predict(PLAIN, off_lights)
    assert missed.missing[0].key == "light_scatter"
    first, *others = findings(missed)
    assert first.startswith("The frames show light that scatters by")
    assert "With it the camera alone predicts 12 levels" in first
    assert "; without it they are " in first
    assert not any("differ significantly" in one for one in others)
    assert not predict(PLAIN, off_lights, light_error=0.01).main_comparison.missed


def test_without_photons_the_means_give_the_rate_of_the_light():
    made = measured(np.random.default_rng(5))
    light = made.bright.exposure * 1.3  # another lamp power, counted in seconds
    rate = PHOTONS / np.asarray(light)
    made = replace(made, bright=replace(made.bright, light=jnp.asarray(PHOTONS / rate.mean())))
    made = replace(made, photons_known=False)
    found = predict(PLAIN, made)
    assert found.unscaled
    assert not found.main_comparison.missed
    assert found.main_comparison.agreement["means"].degrees == 17
    assert any("the rate of the light was fitted" in one for one in findings(found))


def frames_of(sensor, key, photons, seconds, count=FRAMES, size=64):
    """Return frames of one level, drawn by the library."""
    keys = jax.random.split(jax.random.fold_in(jax.random.key(3), key), count)
    light = jnp.full((size, size, 1), photons / seconds)
    sensor = replace(sensor, exposure_time=seconds)
    draw = jax.jit(lambda one: jv.raw_image(one, sensor, light, die_key=jax.random.key(8))[..., 0])
    return [np.asarray(draw(one)) for one in keys]


@pytest.fixture(scope="module")
def afternoon():
    """Return the camera and its calibration, whose findings name row noise, unequal columns and the
    well."""
    sensor = replace(PLAIN, row_noise=7.5, column_dsnu=12.0, full_well=14_000.0)
    photons, seconds = np.linspace(600.0, 33_000.0, 11), np.full(11, 0.01)
    flats = [frames_of(sensor, i, light, 0.01) for i, light in enumerate(photons)]
    darks = [frames_of(sensor, 100 + i, 0.0, t) for i, t in enumerate((0.001, 0.01, 0.1))]
    made = from_frames(
        flats, darks, list(seconds), list(photons), camera=Camera(bits=12),
        dark_exposures=[0.001, 0.01, 0.1],
    )  # fmt: skip
    return sensor, calibrate(made)


@pytest.mark.slow
def test_every_effect_found_is_in_the_written_file(afternoon, tmp_path):
    truth, calibration = afternoon
    best, draws = fitted_sensor(calibration)
    jv.write_sensor(best, tmp_path / "sensor.toml", draws=draws)
    read = jv.read_sensor(tmp_path / "sensor.toml")
    many = jv.read_sensor(tmp_path / "sensor.toml", draws=500)
    for name in ("row_noise", "column_dsnu", "read_noise", "full_well", "gain"):
        value, drawn = float(getattr(read, name)), np.asarray(getattr(many, name))
        assert abs(value - float(getattr(truth, name))) < 4 * drawn.std(), name
        assert drawn.std() < 0.3 * value, name
    assert read.row_dsnu is None
    assert read.column_noise is None


@pytest.mark.slow
def test_levels_kept_out_of_the_fit_are_predicted(afternoon):
    _, calibration = afternoon
    kept_out = levels_kept_out(calibration)
    assert kept_out is not None
    assert kept_out[: len(calibration.usable)].sum() == len(calibration.usable) // 2
    prediction = predict_own_frames(calibration)
    assert prediction.labels[0] == "levels kept out of its fit"
    for comparison in prediction.comparisons:
        assert not comparison.missed
    told = calibration.section.findings
    assert any("predicts" in one and "held out in a second fit" in one for one in told)
    assert "prediction" in [picture.name for picture in calibration.section.pictures]


@pytest.mark.slow
def test_levels_that_do_not_determine_a_parameter_keep_its_posterior_error(afternoon, monkeypatch):
    """The inverse of an information that is not positive definite is no covariance."""
    _, calibration = afternoon
    left_out = levels_kept_out(calibration)
    mode, usual = sensor_of.mode_without(calibration, left_out)
    optimum = sensor_of.fit_without_levels(calibration.chosen, left_out)
    indefinite = optimum.information - 2 * np.diag(np.eye(len(mode))[0] * optimum.information[0, 0])
    optimum = replace(optimum, information=indefinite)
    monkeypatch.setattr(sensor_of, "fit_without_levels", lambda *_: optimum)
    found = sensor_of.mode_without(calibration, left_out)[1]
    np.linalg.cholesky(found)
    ratio = np.sqrt(np.diagonal(found) / np.diagonal(usual))
    assert (ratio > 0.3).all()
    assert (ratio < 3).all()


@pytest.mark.slow
def test_the_prediction_uses_the_file_and_no_fit(afternoon, monkeypatch):
    """A wrong gain in the file makes the prediction fail, whatever the fit found."""
    _, calibration = afternoon
    best, _ = fitted_sensor(calibration)
    wrong = replace(best, gain=1.02 * float(np.asarray(best.gain)))
    monkeypatch.setattr(calibrations, "choose_model", None)
    found = predict(wrong, calibration.measurement)
    assert "variances" in found.main_comparison.missed
    assert found.missing[0].key == "gain"


@pytest.mark.slow
def test_mixed_neighbours_are_found_although_moments_are_linear():
    made = measured(np.random.default_rng(7), mixed=0.06)
    calibration = calibrate(made)
    fit = calibration.chosen
    assert "pixel_mixing" in fit.values
    gain, error = float(fit.values["system_gain"]), fit.errors["system_gain"]
    assert abs(np.log(gain / GAIN)) < 4 * error
    best, _ = fitted_sensor(calibration)
    assert best.mixing is not None
    kernel = np.asarray(best.mixing.kernel)
    assert abs(kernel.sum() - 1) < 1e-6
    assert abs(1 - np.sum(kernel**2) - float(fit.values["pixel_mixing"])) < 2e-3


def test_bad_input_is_named(tmp_path):
    made = measured(np.random.default_rng(0))
    with pytest.raises(InputError, match=r"relative: give \.01 for 1 %"):
        predict(PLAIN, made, light_error=1.5)
    with pytest.raises(InputError, match="several bands"):
        predict(replace(PLAIN, quantum_efficiency=jnp.array([0.5, 0.6])), made)
    with pytest.raises(InputError, match=r"noise\.predict: measurement"):
        predict(PLAIN, np.zeros(3))  # type: ignore[arg-type]
    (tmp_path / "empty").mkdir()
    (tmp_path / "table.csv").write_text("exposure_s\n")
    status, _, stderr = called(app, "predict", tmp_path / "empty", tmp_path / "table.csv")
    assert status == 2
    assert "holds no sensor.toml (no calibration wrote a camera to it)" in stderr
    status, _, stderr = called(app, "predict", "emva1288", tmp_path / "none")
    assert status == 2
    assert "no such rig file" in stderr


@pytest.mark.slow
@pytest.mark.parametrize(("read", "dsnu"), [(0.3, 1.0), (0.3, 0.25), (0.2, 4.0), (0.3, 0.0)])
def test_rounded_darks_of_a_die_are_predicted(read, dsnu):
    """The reference takes codes at .8 DN/e- about 64.3 from the normal distribution function."""
    gain, black = 0.8, 64.3
    sensor = jv.Sensor(read_noise=read, dsnu=dsnu, gain=gain, offset=black, bits=12)
    dark = Lit(np.zeros(1), np.full(1, 0.01), np.zeros(1))
    found, die = clipped(sensor, dark)
    codes, places = np.arange(20, 110)[:, None], np.linspace(-6, 6, 4001)
    weights = norm.pdf(places) / norm.pdf(places).sum()
    edge = (codes - 0.5 - black - gain * dsnu * places) / (gain * read)
    share = np.diff(norm.cdf(edge), axis=0)
    mean, square = (codes[:-1] ** p * share for p in (1, 2))
    of_pixel = np.stack([mean.sum(axis=0), square.sum(axis=0) - mean.sum(axis=0) ** 2])
    np.testing.assert_allclose(found[:, 0], of_pixel @ weights, rtol=2e-6, atol=1e-6)
    fit = np.polynomial.polynomial.Polynomial.fit
    left = [x - fit(places, x, 2, w=np.sqrt(weights))(places) for x in of_pixel]
    np.testing.assert_allclose(die, (left * weights) @ np.transpose(left), rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("left_out", ["read_noise", "shot_noise"])
def test_a_camera_without_noise_predicts_only_means(left_out):
    made = measured(np.random.default_rng(3))
    found = predict(replace(PLAIN, **{left_out: None}), made)
    assert list(found.main_comparison.agreement) == ["means"]
    assert found.main_comparison.missed == []
    dark = np.sqrt(np.mean(made.dark.variance))
    assert any(
        f"states no {left_out}" in told and f"{dark:.3g} DN rms in the dark" in told
        for told in findings(found)
    )
    # The means still detect 2 % more light than stated, beyond its error.
    lit = replace(made, bright=replace(made.bright, light=made.bright.light / 1.02))
    (more,) = predict(replace(PLAIN, **{left_out: None}), lit).missing
    assert more.key == "light"
    assert "2.00" in more.clause or "1.99" in more.clause or "2.01" in more.clause


@pytest.mark.parametrize("read_noise", [READ, None])
def test_draws_of_a_sensor_widen_its_errors_with_and_without_a_read_noise(read_noise):
    sensor, made = replace(PLAIN, read_noise=read_noise), measured(np.random.default_rng(3))
    factors = jnp.exp(1e-3 * np.random.default_rng(4).standard_normal(50))
    draws = jax.tree.map(lambda number: number * factors, sensor)
    exact, drawn = (predict(sensor, made, draws=own).main_comparison for own in (None, draws))
    brightest = int(np.argmax(exact.found.electrons))
    added = np.sqrt(drawn.errors[0] ** 2 - exact.errors[0] ** 2)[brightest]
    scatter = float(np.std(np.asarray(factors) ** 2)) * exact.found.signal[brightest]
    np.testing.assert_allclose(added, scatter, rtol=0.05)


@pytest.mark.slow
def test_a_gain_that_saturates_every_level_is_refused_and_a_missing_one_is_said():
    made = measured(np.random.default_rng(3))
    with pytest.raises(InputError, match="predicts every level of light at an end of its scale"):
        predict(replace(PLAIN, gain=100.0), made)
    found = predict(replace(PLAIN, gain=None, bits=None), made)
    assert "states no gain: 1 DN/e⁻ was taken" in " ".join(findings(found))


@pytest.mark.slow
def test_one_camera_file_predicts_the_taps_of_a_folder(tmp_path):
    """Even and odd columns differ. A camera file of one amplifier names gain and black level of the
    other."""
    rng, odd = np.random.default_rng(0), np.arange(96) % 2
    text = "camera = {bits = 12, taps = [1, 2]}\n"
    levels = [("flat", f"photons = {light}", light) for light in np.linspace(500, 20_000, 10)]
    for i, (kind, light, photons) in enumerate([*levels, ("dark", "", 0.0)]):
        files = [f"{i}_{j}.npy" for j in range(3)]
        for file in files:
            electrons = rng.poisson(0.5 * photons, (96, 96)) + 5 * rng.standard_normal((96, 96))
            raw = np.round(64 + 6 * odd + (0.25 + 0.05 * odd) * electrons)
            np.save(tmp_path / file, np.clip(raw, 0, 4095).astype(np.uint16))
        text += f"[[{kind}]]\nfiles = {files}\nexposure = 0.01\n{light}\n"
    (tmp_path / "rig.toml").write_text(text)
    out = tmp_path / "out"
    assert called(app, "noise", tmp_path, "--out", out)[0] == 0
    status, told, _ = called(app, "predict", out, tmp_path)
    assert status == 0
    assert "missed" not in told
    assert [file.name for file in out.glob("sensor*.toml")] == ["sensor.toml"]
    plain = tmp_path / "plain"
    assert called(app, "noise", tmp_path, "--channel", "tap 0,0", "--out", plain)[0] == 0
    one = plain / "sensor.toml"
    assert "the camera of one channel" in called(app, "predict", one, tmp_path)[2]
    other = called(app, "predict", one, tmp_path, "--channel", "tap 0,1")[1]
    assert "a gain larger by 20." in other
    assert "a black level higher by 5.9" in other
