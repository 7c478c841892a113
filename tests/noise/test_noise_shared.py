"""Tests noise shared by rows, columns and frames: found if present, not found if absent, and
named."""

from types import SimpleNamespace

import numpy as np
import pytest
from noise_findings import told
from oracles.frames import level_of, levels_sharing, shared_variance

from fitting import noise
from fitting.noise.calibration import calibrate, extra_in_flats, subtract_flicker
from fitting.noise.emva1288 import ranges, sheet, statistics
from fitting.noise.level_sums import SquareSums, fixed_variance, temporal_variance
from fitting.noise.levels import linear_levels, shot_of, signal_of
from fitting.noise.live_pixels import LivePixels
from fitting.noise.pattern import fitted_pattern, pattern_variance, unequal_gains
from fitting.noise.regressions import sampling_errors
from fitting.noise.shared import (
    drift,
    extra_lines,
    fixed_lines,
    shared_noise,
    temporal_lines,
)
from fitting.noise.statement import base_space, fit_model, make_problem, noise_data
from fitting.rig import Camera

H, W, FRAMES, LEVELS = 24, 40, 3, 4


def dark_levels(rng, *, rows=0.0, columns=0.0, fixed=0.0, fixed_rows=0.0, frames=0.0):
    """Return four levels of dark frames with a pixel noise of 2 DN."""
    banding = fixed * rng.standard_normal(W)
    if fixed_rows:
        banding = banding + fixed_rows * rng.standard_normal((H, 1))
    kept = []
    for _ in range(LEVELS):
        stack = (
            100
            + 2 * rng.standard_normal((FRAMES, H, W))
            + rows * rng.standard_normal((FRAMES, H, 1))
            + columns * rng.standard_normal((FRAMES, 1, W))
            + frames * rng.standard_normal((FRAMES, 1, 1))
            + banding
        )
        average, variance, lines = level_of(stack)
        kept.append((variance, average.var(ddof=1), *lines))
    variance, spatial, *lines = np.array(kept).T
    return levels_sharing(shared_variance(np.array(lines), (H, W)), variance, FRAMES, spatial)


def judged(rng, **planted):
    darks = dark_levels(rng, **planted)
    return {
        "rows": temporal_lines(darks, 0),
        "columns": temporal_lines(darks, 1),
        "fixed": fixed_lines(darks, 1),
        "fixed rows": fixed_lines(darks, 0),
        "frames": drift(darks),
    }


def test_independent_pixels_share_nothing():
    rng = np.random.default_rng(0)
    found = [judged(rng) for _ in range(120)]
    for name in found[0]:
        z = np.array([one[name].significance for one in found])
        assert abs(z.mean()) < 0.25, name
        assert 0.8 < z.std() < 1.2, name
        assert np.mean(z > 4) <= 0.01, name


@pytest.mark.sweep
@pytest.mark.parametrize(("name", "size"), [("rows", 1.0), ("columns", 0.7), ("fixed", 1.0)])
def test_simulated_shared_noise_is_estimated(name, size):
    rng = np.random.default_rng(1)
    found = [judged(rng, **{name: size})[name] for _ in range(100)]
    variance = np.array([one.variance for one in found])
    assert variance.mean() == pytest.approx(size**2, rel=0.05)
    z = (variance - size**2) / np.array([one.error for one in found])
    assert 0.8 < z.std() < 1.25
    assert all(one.is_significant for one in found)


@pytest.mark.slow
def test_row_noise_is_not_banding():
    """The average over a few frames keeps some row noise, which is no fixed pattern."""
    rng = np.random.default_rng(5)
    noisy = [judged(rng, rows=4.0) for _ in range(300)]
    z = np.array([one["fixed rows"].variance / one["fixed rows"].error for one in noisy])
    assert abs(z.mean()) < 0.4
    assert np.mean([one["fixed rows"].is_significant for one in noisy]) < 0.01
    banded = [judged(rng, rows=4.0, fixed_rows=6.0)["fixed rows"] for _ in range(100)]
    assert np.mean([one.is_significant for one in banded]) > 0.95
    variance = np.array([one.variance for one in banded])
    z = np.log(variance / 36) * variance / np.array([one.error for one in banded])
    assert 0.8 < z.std() < 1.25  # on a log scale, because the error grows with the variance


def test_drifting_frames_are_found():
    rng = np.random.default_rng(2)
    found = [judged(rng, frames=2.0)["frames"] for _ in range(100)]
    assert np.mean([one.variance for one in found]) == pytest.approx(4.0, rel=0.2)
    assert np.mean([one.is_significant for one in found]) > 0.95


def test_row_noise_widens_the_pattern():
    """DSNU's variance, with temporal noise subtracted, has the error that the rows allow."""
    rng, z = np.random.default_rng(3), []
    for _ in range(200):
        pattern, by_noise = pattern_variance(dark_levels(rng, rows=2.0))
        z += list(pattern / np.sqrt(by_noise))
    assert abs(np.mean(z)) < 0.1
    assert 0.8 < np.std(z) < 1.2


def camera_frames(rng, photons, size, *, rows=0.0, wander=0.0, gain=0.25):
    """Return four frames with 64 DN black, 6 e- of pixel noise, row noise, and a drift between
    frames."""
    shape = (4, *size)
    electrons = rng.poisson(0.5 * photons, shape) + 6 * rng.standard_normal(shape)
    electrons += rows * rng.standard_normal((4, size[0], 1))
    electrons += wander * rng.standard_normal((4, 1, 1))
    return list(np.round(64 + gain * electrons))


def test_errors_of_a_level_include_shared_noise():
    """Means and variances of levels scatter as their errors state, with row noise and drift."""
    rng, kept = np.random.default_rng(6), []
    stacks = rng.standard_normal((400, FRAMES, H, W)) + 2 * rng.standard_normal((400, FRAMES, H, 1))
    stacks += rng.standard_normal((400, FRAMES, 1, 1))
    for stack in stacks:
        average, variance, lines = level_of(stack)
        kept.append((variance, average.mean(), *lines))
    variance, mean, *lines = np.array(kept).T
    levels = levels_sharing(shared_variance(np.array(lines), (H, W)), variance, FRAMES)
    errors = sampling_errors(levels, shared=shared_noise(levels))
    # The scatter of 400 has a relative error of 3.5 %; the limit is four of them.
    for found, claimed in ((mean, errors.mean), (variance, errors.variance)):
        assert abs(np.sqrt(np.mean(claimed)) / found.std(ddof=1) - 1) < 0.14


@pytest.mark.slow
def test_a_drifting_black_level_is_within_its_errors():
    """The black level drifts by 6 e- between frames of one exposure, and the camera stays
    linear."""
    rng, photons, size = np.random.default_rng(7), np.linspace(200, 8000, 6), (40, 60)
    z = []
    for _ in range(24):
        measured = noise.from_frames(
            [camera_frames(rng, p, size, wander=6.0) for p in photons],
            [camera_frames(rng, 0.0, size, wander=6.0) for _ in photons],
            [0.01] * 6,
            list(photons),
            camera=Camera(bits=12),
        )
        space = base_space(measured, ranges(measured))
        problem = make_problem(space, *noise_data(measured, linear_levels(measured)))
        start = sheet(statistics(measured, None), measured, ranges(measured))
        fit = fit_model(problem, start)
        black, rate = (float(fit.values[name]) for name in ("black_level", "responsivity"))
        off = (black - 64) / fit.errors["black_level"]
        z.append((off, np.log(rate / 0.125) / fit.errors["responsivity"]))
        assert fit.p_value > 1e-3
    # The scatter of 24 has a relative error of 15 %; the limit is three of them.
    assert np.all(np.abs(np.std(z, axis=0) - 1) < 0.45)
    assert np.all(np.mean(np.abs(np.array(z)) < 1.96, axis=0) > 0.8)


@pytest.mark.slow
def test_unequal_column_gains_have_the_error_of_few_columns():
    """With 1 % of random column gains, PRNU is within its errors, and columns are named, but not
    rows."""
    rng, photons, size = np.random.default_rng(8), np.linspace(2000, 20_000, 4), (40, 60)
    z, found = [], []
    for _ in range(40):
        gains = 1 + 0.01 * rng.standard_normal((1, size[1]))
        measured = noise.from_frames(
            [camera_frames(rng, p * gains, size) for p in photons],
            [camera_frames(rng, 0.0, size) for _ in photons],
            [0.01] * 4,
            list(photons),
            camera=Camera(bits=12),
        )
        usable = np.arange(4)
        pattern = fitted_pattern(measured, usable)
        z.append((pattern.response.variance - 1e-4) / pattern.response.error)
        found.append(unequal_gains(measured, usable))
    assert np.mean(np.abs(z) < 1.96) > 0.85
    assert 0.7 < np.std(z) < 1.4
    assert not any(rows.is_significant for rows, _ in found)
    assert all(columns.is_significant for _, columns in found)
    assert np.mean([columns.variance for _, columns in found]) == pytest.approx(1e-4, rel=0.1)


def test_a_flat_without_light_does_not_hide_unequal_gains():
    rng, photons, size = np.random.default_rng(11), np.linspace(2000, 20_000, 4), (40, 60)
    gains = 1 + 0.02 * rng.standard_normal((1, size[1]))
    flats = [camera_frames(rng, p * gains, size) for p in photons]
    darks = [camera_frames(rng, 0.0, size)]

    def of(flats, photons):
        times = [0.01] * len(photons)
        camera = Camera(bits=12)
        return noise.from_frames(
            flats, darks, times, list(photons), dark_exposures=[0.01], camera=camera
        )

    lit, whole = of(flats, photons), of([darks[0], *flats], [0.0, *photons])
    _, columns = unequal_gains(whole, np.arange(5))
    assert columns.is_significant
    assert columns == unequal_gains(lit, np.arange(4))[1]
    assert not unequal_gains(whole, np.arange(1))[1].is_significant


@pytest.mark.slow
def test_row_noise_of_flats_only_is_distinguished_from_that_of_darks():
    rng, photons, size = np.random.default_rng(9), np.linspace(200, 20_000, 5), (40, 60)

    def found(of_flats, of_darks):
        measured = noise.from_frames(
            [camera_frames(rng, p, size, rows=of_flats) for p in photons],
            [camera_frames(rng, 0.0, size, rows=of_darks) for _ in photons],
            [0.01] * 5,
            list(photons),
            camera=Camera(bits=14),
        )
        return extra_in_flats(measured, np.arange(5))

    for rows in (0.0, 7.5):
        assert sum(bool(found(rows, rows)) for _ in range(20)) == 0
    for _ in range(10):
        only = found(7.5, 0.0)
        assert list(only) == ["rows"]
        assert abs(only["rows"].variance - (0.25 * 7.5) ** 2) < 4 * only["rows"].error


@pytest.mark.parametrize(("count", "turned"), [(2, False), (4, True)])
def test_moving_bands_over_uneven_light_do_not_change_the_gain(count, turned):
    """Bands of 8 %, with another phase in every frame, are on light that falls by 30 % to the
    border.

    Where the light within a row is uneven, the part e P of a band e remains beyond the row's mean,
    here 4 % of the shot variance."""
    rng, side, photons = np.random.default_rng(4), 96, np.linspace(600, 8_000, 8)
    y, x = np.mgrid[:side, :side] / side - 0.5
    light = 1 - 0.6 * (x**2 + y**2)

    def frame(mean):
        bands = 1 + 0.08 * np.sin(2 * np.pi * (3.3 * y + rng.random()))
        electrons = rng.poisson(mean * light * bands) + 5 * rng.standard_normal(y.shape)
        one = np.clip(np.round(64 + 0.4 * electrons), 0, 4095)
        return one.T if turned else one

    measured = noise.from_frames(
        [[frame(p) for _ in range(count)] for p in photons],
        [[frame(0.0) for _ in range(count)] for _ in photons],
        [0.01] * 8,
        list(photons),
        camera=Camera(bits=12),
    )
    assert measured.bright.left_out == ()
    usable = linear_levels(measured)
    measured = subtract_flicker(measured, extra_in_flats(measured, usable))
    gain = np.sum(shot_of(measured)[usable]) / np.sum(signal_of(measured)[usable])
    error = np.sqrt(2 / (count - 1) / len(usable)) / side
    assert abs(gain / 0.4 - 1) < 3 * error


@pytest.mark.slow
def test_flicker_is_subtracted_row_by_row():
    """Rows of flats have errors of 3 %, new in every frame, which are nine tenths of the
    variance."""
    rng, photons = np.random.default_rng(2), np.linspace(0.02, 1, 8) * 20_000

    def frames(mean):
        rows = 1 + 0.03 * rng.standard_normal((4, 48, 1))
        electrons = rng.poisson(mean / 2 * rows * np.ones((4, 48, 64)))
        electrons = electrons + 6 * rng.standard_normal((4, 48, 64))
        electrons += 7.5 * rng.standard_normal((4, 48, 1))
        return list(np.clip(np.round(64 + 0.25 * electrons), 0, 4095))

    measured = noise.from_frames(
        [frames(p) for p in photons],
        [frames(0.0) for _ in photons],
        [0.01] * 8,
        list(photons),
        camera=Camera(bits=12),
    )
    calibration = calibrate(measured)
    truth = {"system_gain": 0.25, "quantum_efficiency": 50.0, "read_noise": np.hypot(6, 7.5)}
    for one in calibration.sheet:
        if one.name in truth:
            assert abs(one.value - truth[one.name]) < 3 * one.standard_error, one
            assert one.standard_error < 0.02 * one.value
    shown = calibration.section
    assert shown.findings[0].startswith("The rows of a flat share noise of ")
    assert "90 % of a flat's variance" in shown.findings[0]
    assert "sensor" in shown.records


@pytest.mark.slow
def test_few_frames_of_few_rows_cause_no_false_alarm():
    """A variance with one or three degrees of freedom exceeds its mean by four errors in one of a
    hundred cameras that share nothing, and as often if flats and darks share the same."""
    rng, shape, alarms = np.random.default_rng(10), (4, 60), np.zeros(3, int)

    def told(sigma, count):
        stacks = sigma * rng.standard_normal((count, 2, *shape))
        stacks += rng.standard_normal((count, 2, shape[0], 1))  # the same in flats and darks
        _, variance, lines = zip(*map(level_of, stacks), strict=True)
        return levels_sharing(shared_variance(np.array(lines).T, shape), np.array(variance), 2)

    def quiet():
        _, variance, lines = level_of(rng.standard_normal((2, *shape)))
        return levels_sharing(shared_variance(np.array([lines]).T, shape), np.array([variance]), 2)

    for _ in range(500):
        dark, flat, one = told(1.0, 1), told(2.0, 5), quiet()
        alarms += [
            extra_lines(flat, dark, np.arange(5), 0).is_significant,
            drift(one).is_significant,
            temporal_lines(one, 0).is_significant,
        ]
    assert (alarms <= 1).all(), alarms


@pytest.mark.slow
def test_flicker_that_grows_with_light_is_reported_at_the_brightest():
    """The flicker is .3 % in flats from 20 to 20,000 photons. It is hidden in faint ones, whose
    variance is known best, and is 7.5 DN at the brightest."""
    rng, photons, size = np.random.default_rng(12), np.geomspace(20, 20_000, 8), (40, 60)
    for _ in range(20):
        flats = [
            camera_frames(rng, p * (1 + 0.003 * rng.standard_normal((4, size[0], 1))), size)
            for p in photons
        ]
        measured = noise.from_frames(
            flats,
            [camera_frames(rng, 0.0, size) for _ in photons],
            [0.01] * 8,
            list(photons),
            camera=Camera(bits=14),
        )
        found = extra_in_flats(measured, np.arange(8))["rows"]
        size_of = 0.25 * 0.5 * 20_000 * 0.003
        assert abs(found.variance - size_of**2) < 4 * found.error
        steady = subtract_flicker(measured, {"rows": found})
        (said,) = told(SimpleNamespace(measurement=steady, flicker={"rows": found}), "flicker")
        assert said.startswith("The rows of a flat share noise of ")


@pytest.mark.filterwarnings("error")
def test_levels_of_identical_frames_are_uninformative():
    """If rounding hides the read noise, some darks have no two different frames."""
    rng = np.random.default_rng(7)
    stacks = [100 + rng.standard_normal((FRAMES, H, W)) for _ in range(3)]
    still = np.full((FRAMES, H, W), 100.0)

    def found(levels):
        _, variance, lines = zip(*map(level_of, levels), strict=True)
        shared, variance = shared_variance(np.array(lines).T, (H, W)), np.array(variance)
        darks = levels_sharing(shared, variance, FRAMES, variance / FRAMES)
        return [
            *(temporal_lines(darks, axis) for axis in (0, 1)),
            fixed_lines(darks, 0),
            drift(darks),
        ]

    for one, other in zip(found(stacks), found([still, *stacks]), strict=True):
        assert one.variance == pytest.approx(other.variance)
        assert one.significance == pytest.approx(other.significance)
    assert not any(one.is_significant or one.variance for one in found([still, still]))


@pytest.mark.parametrize(("size", "dead"), [((12, 30), 0.0), ((8, 8), 0.0), ((12, 30), 0.2)])
@pytest.mark.slow
def test_components_of_the_variance_add_up_on_average(size, dead):
    """With contributions of rows, columns, pixels and frames, each estimate scatters about its true
    value, also without one column and a fifth of the pixels."""
    rng, (h, w), frames = np.random.default_rng(9), size, 6
    truth = {"pixels": 4.0, "rows": 9.0, "columns": 1.0, "frames": 2.25}
    stays = {"rows": 4.0, "columns": 0.25}
    found, fixed = [], []
    for _ in range(1500):
        lines = 2 * rng.standard_normal((h, 1)) + 0.5 * rng.standard_normal((1, w))
        stack = (
            2 * rng.standard_normal((frames, h, w))
            + 3 * rng.standard_normal((frames, h, 1))
            + rng.standard_normal((frames, 1, w))
            + 1.5 * rng.standard_normal((frames, 1, 1))
            + lines
        )
        live = rng.permuted(np.arange(h * w)).reshape(h, w) >= dead * h * w
        live[:, 2] &= dead == 0
        pixels, sums = LivePixels(live), SquareSums(LivePixels(live))
        shifts = stack[:, live].mean(axis=1)
        still = (stack - shifts[:, None, None]) * live
        for frame in still[1:]:
            sums.add(frame - still[0])
        total = (still - still[0]).sum(axis=0)
        of = {name: sums.variance(name, total, frames) for name in ("pixels", "rows", "columns")}
        lines = (np.nanmean(of[name]) for name in ("rows", "columns"))
        parts = temporal_variance(pixels, of["pixels"][live].mean(), *lines, shifts.var(ddof=1))
        found.append([getattr(parts, name) for name in truth] + [parts.pixel_variance])
        fixed.append(fixed_variance(pixels, stack.mean(axis=0), parts, frames))
    for values, true in (
        (found, [*truth.values(), 14.0]),
        (fixed, list(stays.values())),
    ):
        error = np.std(values, axis=0) / np.sqrt(len(values))
        assert np.all(np.abs(np.mean(values, axis=0) - true) < 3.5 * error)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 600), (600, 1)])
def test_a_line_sensor_has_no_lines(shape):
    rng = np.random.default_rng(4)
    light = [400, 1000, 2000, 4000]
    flats = [list(64 + 0.5 * rng.poisson(photons / 2, (3, *shape))) for photons in light]
    darks = [list(64 + 2 * rng.standard_normal((3, *shape)))]
    measured = noise.from_frames(
        *(flats, darks, [0.01] * 4, light), camera=Camera(bits=12), dark_exposures=[0.01]
    )
    for levels in (measured.bright, measured.dark):
        assert not np.any(levels.shared.lines)
    assert calibrate(measured).estimates["system_gain"].value == pytest.approx(0.5, rel=0.2)
