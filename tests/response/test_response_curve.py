"""Tests the response curve against stacks simulated from known curves."""

import numpy as np
import pytest
from oracles.splits import apart, fitted, split_tests
from oracles.stacks import (
    exposure_stack,
    gamma,
    jpeg_stack,
    log_exposures,
    processed_stack,
    s_shaped,
    srgb,
)

from fitting.response.calibration import calibrate
from fitting.response.clipping import clear_of_clipping
from fitting.response.code_bins import code_bins
from fitting.response.code_pairs import (
    _pull_of_noise,
    pair_statistics,
    statistics_of_parts,
    total,
)
from fitting.response.curve import fit_response_curve, ripple
from fitting.response.places import layout_of
from fitting.response.read import from_stack
from fitting.response.section import section
from fitting.response.solve import (
    Hyperparameters,
    bin_centre_curve,
    exponent_increments,
    shutter_basis,
    solve,
)
from fitting.response.weights import NoiseModel, hat_rule, noise_rule, observe, undithered_share
from fitting.rig import Camera
from jaxvision.errors import InputError

TIMES = 2.0 ** np.arange(-4, 5)
STOPS = TIMES[:-1]
CURVES = {"gamma 2.2": gamma(2.2), "srgb": srgb, "s-shaped": s_shaped, "linear": gamma(1.0)}


def log_rms(found: np.ndarray, truth: np.ndarray) -> float:
    """Return the RMS of ln exposure errors, up to a common factor."""
    error = found - truth
    return float(np.std(error - np.median(error)))


@pytest.mark.sweep("s-shaped")
@pytest.mark.parametrize("name", CURVES)
def test_curve_is_recovered_between_codes_20_and_235(name):
    _, codes = exposure_stack(CURVES[name], TIMES, np.random.default_rng(1))
    curve = fit_response_curve(codes, TIMES, bits=8)
    judged = (curve.codes >= 20) & (curve.codes <= 235)
    truth = log_exposures(CURVES[name], curve.codes)
    assert log_rms(curve.log_exposure[judged], truth[judged]) < 0.004
    assert curve.monotone
    assert curve.shutter_error is None


def test_low_codes_of_a_low_noise_camera():
    _, codes = exposure_stack(
        srgb, TIMES, np.random.default_rng(2), full_well=60_000.0, read_noise=2.0
    )
    curve = fit_response_curve(codes, TIMES, bits=8)
    low = (curve.codes >= 5) & (curve.codes < 20)
    truth = log_exposures(srgb, curve.codes)
    assert log_rms(curve.log_exposure[low], truth[low]) < 0.03


@pytest.mark.slow
def test_interval_covers_the_true_curve_and_widens_with_shutter_errors():
    inside, widths = [], []
    for shutter_error in (0.0, 0.02):
        for seed in range(4):
            _, codes = exposure_stack(
                s_shaped,
                TIMES,
                np.random.default_rng(seed),
                pixels=4000,
                shutter_error=shutter_error,
            )
            curve = fit_response_curve(codes, TIMES, bits=8)
            judged = (curve.codes >= 20) & (curve.codes <= 235)
            truth = log_exposures(s_shaped, curve.codes)
            gap = (curve.log_exposure - truth + truth[127])[judged]
            inside.append(np.mean(np.abs(gap) < 3 * curve.standard_error[judged] + 1e-3))
            widths.append(curve.standard_error[230])  # far from mid-scale, low noise
    assert np.mean(inside) > 0.99
    assert np.mean(widths[4:]) > 2 * np.mean(widths[:4])


@pytest.mark.slow
def test_hand_held_jpeg_photographs():
    """The stack has half a pixel of misregistration, 1 % shutter errors, moving leaves, and
    JPEG."""
    codes = jpeg_stack(s_shaped, TIMES[::2], np.random.default_rng(1))
    everywhere, known = np.ones(codes.shape[1:], bool), {"black": 0.0, "clip": 255.0}
    curve = fitted(codes, everywhere, TIMES[::2], **known)
    assert curve.design_effect > 2
    assert curve.held_out is not None
    assert np.isfinite(curve.held_out.standard_error)
    judged = (curve.codes >= 20) & (curve.codes <= 235)
    truth = log_exposures(s_shaped, curve.codes)
    assert log_rms(curve.log_exposure[judged], truth[judged]) < 0.03
    gap = curve.log_exposure - truth + truth[curve.bins.middle]
    assert np.mean(np.abs(gap) <= curve.half_width + 1e-9) > 0.9
    squares = np.indices(everywhere.shape).sum(axis=0) // 16 % 2 == 0
    one, other = (fitted(codes, part, TIMES[::2], **known) for part in (squares, ~squares))
    assert apart(one, other)[1].mean() > 0.9


@pytest.mark.slow
def test_parts_of_jpeg_stacks_agree_within_their_errors():
    """The curves are from halves, checkerboards and every other exposure."""
    found = [
        split_tests(
            jpeg_stack(response, TIMES, np.random.default_rng(seed), shape=(200, 260)),
            np.ones((200, 260), bool),
            TIMES,
            black=0.0,
            clip=255.0,
        )
        for seed, response in enumerate((srgb, s_shaped, gamma(1.8)))
    ]
    scores, inside = np.array(found).T
    assert np.sqrt(np.mean(scores**2)) < 1.2
    assert inside.mean() > 0.9


@pytest.mark.slow
def test_known_shutter_errors_widen():
    """Nine images cannot determine the `exposure_sd` of the rig, nor the exponent that it
    affects."""
    _, codes = exposure_stack(gamma(2.2), TIMES, np.random.default_rng(11), pixels=4000)
    plain = fit_response_curve(codes, TIMES, bits=8)
    doubted = fit_response_curve(codes, TIMES, bits=8, least_error=0.05)
    spread = np.sum((np.log(TIMES) - np.log(TIMES).mean()) ** 2)
    exponent = np.abs(plain.log_exposure[40]) * 0.05 / np.sqrt(spread)
    assert doubted.standard_error[40] > 0.95 * exponent
    assert doubted.standard_error[40] > 2 * plain.standard_error[40]


def test_shutter_errors_are_detected():
    rng = np.random.default_rng(3)
    _, codes = exposure_stack(gamma(2.2), TIMES, rng, shutter_error=0.03)
    curve = fit_response_curve(codes, TIMES, bits=8)
    assert curve.shutter_error is not None
    assert 0.01 < curve.shutter_error < 0.09
    # They are detectable only beyond a common factor and exponent.
    assert np.abs(shutter_basis(np.log(TIMES)).T @ np.log(TIMES)).max() < 1e-12


def test_twelve_bit_codes_with_a_pedestal():
    rng = np.random.default_rng(4)
    _, codes = exposure_stack(gamma(1.0), TIMES, rng, bits=12, pedestal=64)
    curve = fit_response_curve(codes, TIMES, bits=12, black=64.0)
    assert len(curve.codes) <= 512
    bright = (curve.codes > 300) & (curve.codes < 3800)
    assert log_rms(curve.log_exposure[bright], np.log(curve.codes[bright] - 64)) < 0.004


def test_pair_statistics_are_the_profiled_energy():
    """theta^T A theta equals the residuals of the explicit least-squares problem."""
    rng = np.random.default_rng(5)
    _, codes = exposure_stack(gamma(2.2), TIMES, rng, pixels=300)
    bins, log_t = code_bins(8, 0.0, 255.0), np.log(TIMES)
    g, s = np.sort(rng.normal(size=254)), log_t + rng.normal(0, 0.1, len(log_t))
    weight = np.append(hat_rule(bins).by_bin[0], 0.0)
    energy = 0.0
    for pixel in bins.lookup[codes].T:
        w = weight[pixel]
        if np.count_nonzero(w) >= 2:
            y = g[pixel] - s
            energy += np.sum(w * (y - np.average(y, weights=w)) ** 2)
    one = np.zeros(codes.shape[1], int)
    found = pair_statistics(codes, one, log_t, bins, hat_rule(bins), g)
    theta = np.concatenate([g, s])
    assert theta @ found.matrix @ theta == pytest.approx(energy, rel=1e-10)


def test_statistics_do_not_depend_on_chunks(monkeypatch):
    _, codes = exposure_stack(srgb, TIMES, np.random.default_rng(6), pixels=3000)
    bins, means = code_bins(8, 0.0, 255.0), np.linspace(-5, 2, 254)
    rule = noise_rule([NoiseModel(1e-2, 1e-3, 1e-4)], means)
    one = np.zeros(codes.shape[1], int)
    whole = pair_statistics(codes, one, np.log(TIMES), bins, rule, means)
    monkeypatch.setattr("fitting.response.code_pairs.CHUNK", 700)
    parts = pair_statistics(codes, one, np.log(TIMES), bins, rule, means)
    np.testing.assert_allclose(parts.matrix, whole.matrix, atol=1e-9 * np.abs(whole.matrix).max())
    np.testing.assert_allclose(parts.score, whole.score, atol=1e-9 * np.abs(whole.score).max())
    assert parts.pixels == whole.pixels


def test_sets_of_pixels_add_up_to_all_pixels():
    """A few pixels alone cannot determine the order of codes, but all of them together can."""
    _, codes = exposure_stack(srgb, TIMES, np.random.default_rng(7), pixels=3000)
    bins, means = code_bins(8, 0.0, 255.0), np.linspace(-5, 2, 254)
    rule = noise_rule([NoiseModel(1e-2, 1e-3, 1e-4)], means)
    one = np.zeros(codes.shape[1], int)
    whole = pair_statistics(codes, one, np.log(TIMES), bins, rule, means)
    parts = np.array_split(np.arange(codes.shape[1]), 30)
    of_parts = statistics_of_parts(codes, one, parts, np.log(TIMES), bins, rule, means)
    together = total(of_parts)
    np.testing.assert_allclose(together.matrix, whole.matrix, atol=1e-9 * whole.matrix.max())
    np.testing.assert_allclose(together.score, whole.score, atol=1e-9 * np.abs(whole.score).max())
    assert together.pixels == whole.pixels


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("rate", [-3.0, 0.0, 5.0])
def test_noise_shifts_codes_by_the_density_at_the_ends_of_bins(bits, rate):
    """The response is a power law, whose codes are exponentially distributed, in bins that are 1 to
    16 codes wide at 12 bits."""
    full = 2.0**bits - 1
    bins = code_bins(bits, 0.0, full)
    falling = np.exp(rate * bins.edges / full)
    counts = np.diff(falling) * full / rate if rate else np.diff(bins.edges)
    below, above = _pull_of_noise(counts, bins, 1.8 * bins.log_codes)
    found = below * counts[:-1] + above * counts[1:]
    inner = slice(1, -1)
    far = bins.edges[inner] > 4  # below, the mean over a code is not the mean of its ends
    exact = falling[inner] * bins.edges[inner] / 1.8
    np.testing.assert_allclose(found[far], exact[far], rtol=1e-3)


def test_clipped_and_black_codes_have_no_weight():
    bins = code_bins(8, 10.0, 250.0)
    assert (bins.lookup[:11] == -1).all()
    assert (bins.lookup[250:] == -1).all()
    assert bins.lookup[11] == 0
    codes = np.array([[5], [60], [255], [120]])
    one = np.zeros(1, int)
    seen = observe(bins.lookup[codes], one, np.zeros(4), np.linspace(-3, 1, 239), hat_rule(bins))
    np.testing.assert_array_equal(seen.weights[:, 0] > 0, [False, True, False, True])


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_g_at_a_centre_follows_from_its_means_over_codes_of_any_width(bits):
    """For a power law, the mean over log-uniform light is the mean of the ends."""
    bins = code_bins(bits, 0.0, 2.0**bits - 1)
    means = 1.8 * (np.log(bins.edges[1:]) + np.log(bins.edges[:-1])) / 2
    exact = 1.8 * np.log(bins.centres / bins.centres[bins.middle])
    np.testing.assert_allclose(bin_centre_curve(means, bins), exact, atol=1e-12)
    bent = np.log(bins.edges / bins.edges[-1]) ** 2
    found = bin_centre_curve((bent[1:] + bent[:-1]) / 2, bins)
    exact = np.log(bins.centres / bins.edges[-1]) ** 2
    far = bins.centres > 20
    np.testing.assert_allclose(found[far], (exact - exact[bins.middle])[far], atol=1e-3)


@pytest.mark.sweep
@pytest.mark.parametrize("well", [40e3, 100e3, 400e3])
def test_intervals_cover_if_rounding_is_coarser_than_noise(well):
    """The noise of a linear 8-bit camera does not dither its codes, one stop apart."""
    times = 2.0 ** np.arange(-4, 4)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        _, codes = exposure_stack(gamma(1.0), times, rng, full_well=well)
        curve = fit_response_curve(codes, times, bits=8)
        gap = curve.log_exposure - np.log(curve.codes / curve.codes[curve.bins.middle])
        held = np.abs(gap) <= curve.half_width + 1e-9
        assert np.mean(held[curve.seen]) > 0.9


def test_a_pure_gamma_has_no_cost_in_the_prior():
    bins = code_bins(8, 0.0, 255.0)
    pure = 2.2 * bins.log_codes
    increments = exponent_increments(bins)
    scale = np.abs(increments).max() * np.abs(pure).max()
    assert np.abs(increments @ pure).max() < 1e-12 * scale
    bent = pure + 0.1 * bins.log_codes**2
    assert np.sum((increments @ bent) ** 2) > 1e-3


@pytest.mark.parametrize("most_bins", [140, 512])
def test_a_linear_camera_has_the_largest_smoothness(most_bins):
    """The quadratic form for a pure gamma is 0 up to rounding of either sign."""
    rng = np.random.default_rng(4)
    light = np.geomspace(400, 32_000, 4800)
    times = np.array([1 / 16, 1 / 4, 1.0])
    codes = np.round(60 + 0.25 * rng.poisson(light * times[:, None])).astype(int)
    curve = fit_response_curve(
        np.minimum(codes, 4095), times, bits=12, black=60.0, most_bins=most_bins
    )
    assert curve.smoothness > 5e7


@pytest.mark.parametrize("level", [0, 3, 255])
def test_images_without_information_are_refused(level):
    codes = np.full((9, 5000), level, np.uint16)
    with pytest.raises(InputError, match="well exposed"):
        fit_response_curve(codes, TIMES, bits=8)


def test_copies_of_one_image_are_refused():
    codes = np.tile(np.random.default_rng(8).integers(5, 250, 5000).astype(np.uint16), (9, 1))
    with pytest.raises(InputError, match="exposure 0 and exposure 1 are equal at every pixel"):
        fit_response_curve(codes, TIMES, bits=8)


def test_exposures_without_common_pixels_are_refused():
    rng = np.random.default_rng(8)
    codes = np.zeros((4, 4000), np.uint16)
    codes[:2, :2000] = rng.integers(60, 200, (2, 2000))
    codes[2:, 2000:] = rng.integers(60, 200, (2, 2000))
    with pytest.raises(InputError, match="share no unclipped"):
        fit_response_curve(codes, np.array([1.0, 2.0, 100.0, 200.0]), bits=8)


@pytest.mark.slow
def test_measured_curves_are_recovered(data_folder):
    """The test takes every fortieth of the 201 DoRF curves (Grossberg & Nayar 2003)."""
    import scipy.io

    measured = scipy.io.loadmat(data_folder / "camera_response" / "201_CRF_data.mat")
    errors = []
    for k in range(0, 201, 40):
        light, value = measured["I"][k], np.maximum.accumulate(measured["B"][k])

        def response(x, light=light, value=value):
            return np.interp(x, light, value)

        rng = np.random.default_rng(k)
        _, codes = exposure_stack(response, TIMES, rng, full_well=20_000.0)
        curve = fit_response_curve(codes, TIMES, bits=8)
        rising = value + 1e-9 * np.arange(len(value))
        truth = np.log(np.interp(curve.codes / 255, rising, np.maximum(light, 1e-6)))
        judged = (curve.codes >= 20) & (curve.codes <= 235)
        errors.append(log_rms(curve.log_exposure[judged], truth[judged]))
    assert np.median(errors) < 0.01
    assert max(errors) < 0.05


def test_neighbours_of_clipped_codes_count_as_clipped():
    """The reference is a loop over the pixels."""
    codes = np.random.default_rng(0).integers(0, 254, (2, 30, 40)).astype(np.uint16)
    codes[0, 3, 5] = codes[0, 29, 39] = codes[1, 15, 0] = 254
    found = clear_of_clipping(codes, 253.5)
    for (frame, row, column), code in np.ndenumerate(codes):
        near = codes[frame, max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5]
        assert found[frame, row, column] == (254 if (near == 254).any() else code)
    assert found.dtype == codes.dtype


def in_band(codes: np.ndarray, response, *, lowest: float = 0) -> float:
    """Return the share of seen codes, from the lowest, whose interval covers the true value."""
    everywhere = np.ones(codes.shape[1:], bool)
    layout = layout_of(codes, everywhere, black=0.0, clip=255.0)
    flat = codes.reshape(len(codes), -1)
    curve = fit_response_curve(flat, STOPS, bits=8, layout=layout)
    truth = log_exposures(response, curve.codes)
    gap = curve.log_exposure - truth + truth[curve.bins.middle]
    judged = curve.seen & (curve.codes >= lowest)
    return float(np.mean(np.abs(gap) <= curve.half_width + 1e-9, where=judged))


@pytest.mark.slow
def test_hidden_clipped_peaks_are_left_out():
    """A blur after clipping darkens bright codes, without codes at full scale."""
    codes = processed_stack(gamma(2.2), STOPS, np.random.default_rng(1002), blurred=0.6)
    visible = clear_of_clipping(codes, 254.5, hidden=False)
    strict = clear_of_clipping(codes, 254.5)
    assert in_band(visible, gamma(2.2), lowest=204) < 0.2
    assert in_band(strict, gamma(2.2), lowest=204) > 0.9
    assert in_band(strict, gamma(2.2)) > 0.9


def test_sharp_pictures_have_no_hidden_peaks():
    for seed in range(6):
        codes = processed_stack(s_shaped, STOPS, np.random.default_rng(seed))
        visible = clear_of_clipping(codes, 254.5, hidden=False)
        np.testing.assert_array_equal(clear_of_clipping(codes, 254.5), visible)


@pytest.mark.slow
def test_a_camera_that_sharpens_is_measured_in_uniform_areas():
    """The camera adds half of the difference to a Gaussian of one pixel, with an S-shaped
    response."""
    codes = processed_stack(s_shaped, STOPS, np.random.default_rng(3000), sharpened=0.5)
    everywhere = np.ones(codes.shape[1:], bool)
    curve = fitted(codes, everywhere, STOPS, black=0.0, clip=254.5)
    truth = log_exposures(s_shaped, curve.codes)
    gap = curve.log_exposure - truth + truth[curve.bins.middle]
    judged = curve.seen & (curve.codes >= 20) & (curve.codes <= 235)
    assert np.abs(curve.busy_places[judged]).max() > 0.005
    assert log_rms(curve.log_exposure[judged], truth[judged]) < 0.004
    assert log_rms((curve.log_exposure + curve.busy_places)[judged], truth[judged]) > 0.004
    assert np.mean(np.abs(gap) <= curve.half_width + 1e-9, where=judged) > 0.8


@pytest.mark.slow
def test_all_areas_of_a_plain_camera_give_one_curve():
    """By noise alone, one stack in forty fails the F test. Misaligned stacks are not judged."""
    plain = [
        processed_stack(s_shaped, STOPS, np.random.default_rng(seed), shape=(80, 120))
        for seed in range(3)
    ]
    everywhere = np.ones((80, 120), bool)
    by_hand = jpeg_stack(s_shaped, STOPS, np.random.default_rng(1), shape=(80, 120))
    for codes in [*plain, by_hand]:
        curve = fitted(codes, everywhere, STOPS, black=0.0, clip=254.5)
        np.testing.assert_array_equal(curve.busy_places, 0)


def test_smoothness_converges_from_either_side():
    """The suggested smoothness equals the used one, and a pure gamma has the largest."""
    _, codes = exposure_stack(CURVES["s-shaped"], TIMES, np.random.default_rng(3), pixels=1500)
    bins = code_bins(8, 0.0, 255.0, count=60)
    means = 2.2 * np.log(bins.centres)
    means -= means[bins.middle]
    one = np.zeros(codes.shape[1], int)
    found = pair_statistics(codes, one, np.log(TIMES), bins, hat_rule(bins), means)
    ends = [
        solve([found], np.log(TIMES), bins, Hyperparameters(start, 1e-3), rounds=30)
        for start in (40.0, 1e5)
    ]
    low, high = (end.used.smoothness for end in ends)
    assert low == pytest.approx(high, rel=0.2)
    for end in ends:
        assert end.suggested.smoothness == pytest.approx(end.used.smoothness, rel=0.1)


def test_pixels_with_shared_errors_count_as_one(monkeypatch):
    """This holds for any limit of the number of pixels."""
    monkeypatch.setattr("fitting.response.solve.COUNTED", 100)
    _, codes = exposure_stack(CURVES["gamma 2.2"], TIMES, np.random.default_rng(4), pixels=2000)
    bins = code_bins(8, 0.0, 255.0, count=60)
    means = 2.2 * (bins.log_codes - bins.log_codes[bins.middle])
    rule = noise_rule([NoiseModel(1e-4, 1e-4, 1e-6)], means)
    found = []
    for copies in (1, 8):
        repeated, one = np.repeat(codes, copies, axis=1), np.zeros(2000 * copies, int)
        parts = np.array_split(np.arange(len(one)), 200)
        tiles = statistics_of_parts(repeated, one, parts, np.log(TIMES), bins, rule, means)
        counted = sum(tile.pixels for tile in tiles) / 100
        start = Hyperparameters(1e4, 1e-3, counted)
        found.append(solve(tiles, np.log(TIMES), bins, start))
        assert found[-1].used.design_effect == found[-1].suggested.design_effect == counted
    once, often = found
    assert often.clustering == pytest.approx(8 * once.clustering, rel=1e-3)


def test_rounding_follows_the_light_until_noise_dithers_it():
    """The reference uses random rounded draws."""
    rng = np.random.default_rng(0)
    light = rng.uniform(0, 10, 200_000)
    for deviation in (0.05, 0.2, 0.4, 1.0):
        noisy = light + deviation * rng.standard_normal(light.size)
        within = light - np.round(light)
        follows = -12 * np.mean((np.round(noisy) - noisy) * within)
        assert undithered_share(np.array([deviation**2]))[0] == pytest.approx(follows, abs=0.04)


def test_codes_three_stops_apart_give_a_pure_gamma():
    """Only their noise connects such codes with those between them."""
    times = 8.0 ** np.arange(-2, 2)
    for seed in range(2):
        rng = np.random.default_rng(seed)
        _, codes = exposure_stack(gamma(2.2), times, rng, full_well=20_000.0)
        curve = fit_response_curve(codes, times, bits=8)
        judged = curve.seen & (curve.codes >= 40) & (curve.codes <= 230)
        gap = curve.log_exposure - 2.2 * np.log(curve.codes / curve.codes[curve.bins.middle])
        assert np.abs(gap[judged]).max() < 0.003


@pytest.mark.slow
def test_visible_peaks_are_fitted_if_hidden_ones_leave_too_few_pixels(monkeypatch):
    """The report also says that bright codes may be too low."""
    codes = processed_stack(gamma(2.2), STOPS, np.random.default_rng(1002), blurred=0.6)
    calls = []

    def refuses_once(*args, **keywords):
        calls.append(args)
        if len(calls) == 1:
            raise InputError("too few")
        return fit_response_curve(*args, **keywords)

    monkeypatch.setattr("fitting.response.calibration.fit_response_curve", refuses_once)
    calibration = calibrate(from_stack(list(codes), STOPS, camera=Camera(bits=8)))
    (channel,) = calibration.channels
    assert channel.hidden_peaks
    assert not channel.clear_of_hidden
    assert np.count_nonzero(calls[1][0] != calls[0][0]) > 0
    assert any("bright codes may be too low" in s for s in section(calibration).findings)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["s", "linear"])
def test_intervals_cover_the_curve_of_a_large_picture(shape):
    """700,000 pixels are as good as 20,000. Earlier, residual systematic errors dominated with more
    pixels, until .3 and .2 of the codes were in the interval, and a linear camera's curve had
    ripples of 1 %."""
    response = s_shaped if shape == "s" else gamma(1.0)
    codes = processed_stack(response, STOPS, np.random.default_rng(0), shape=(720, 960))
    assert in_band(clear_of_clipping(codes, 254.5), response) > 0.9


def test_a_decreasing_curve_is_refused():
    """A linear camera at 2.6 stops with much noise has a wrong curve, which is detected."""
    times = 6.0 ** np.arange(-2, 2)
    _, codes = exposure_stack(gamma(1.0), times, np.random.default_rng(8), full_well=2000.0)
    with pytest.raises(InputError, match=r"the exposure falls by .* exposures a stop from these"):
        fit_response_curve(codes, times, bits=8)


def test_intervals_allow_for_ripples_with_exposures_three_stops_apart():
    """If the response is not a gamma, no pixel determines the ripple. An additional exposure, one
    stop from another, does."""
    three, four = 8.0 ** np.arange(-1, 2), np.array([0.125, 0.5, 1.0, 8.0])
    _, codes = exposure_stack(s_shaped, three, np.random.default_rng(0), full_well=20_000.0)
    curve = fit_response_curve(codes, three, bits=8)
    truth = log_exposures(s_shaped, curve.codes)
    gap = curve.log_exposure - truth + truth[curve.bins.middle]
    judged = curve.seen & (curve.codes >= 20) & (curve.codes <= 235)
    assert np.mean(np.abs(gap[judged]) <= curve.half_width[judged] + 1e-9) > 0.95
    assert ripple(three, curve.smoothness) > 0.03
    assert ripple(four, curve.smoothness) == 0
    assert ripple(three, 1e6) < 5e-4
