"""Tests spectral sensitivities from simulated charts, against the true cameras and colour-science's
recovery."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from fitting import sensitivities
from jaxvision import colour_spaces
from jaxvision.errors import InputError

NM = np.arange(400, 701, 10)
AT = jnp.asarray(1e-9 * NM)
DAY, NIGHT = (np.asarray(colour_spaces.illuminant(name, AT), float) / 100 for name in ("D65", "A"))
CHART = np.asarray(colour_spaces.chart_reflectances(AT), float)
NAMES = "Nikon 5100 (NPL)", "Sigma SDMerill (NPL)"


def camera(name):
    return np.asarray(colour_spaces.camera_sensitivities(name, AT), float)


def random_camera(seed):
    """Return a camera of dyes with random edges, crosstalk, and a filter in front."""
    rng = np.random.default_rng(1000 + seed)

    def rise(low, high, steep, wide, sign=1):
        return expit(sign * (NM - rng.uniform(low, high)) / rng.uniform(steep, wide))

    red = rise(572, 598, 3, 9) * np.clip(1 - (NM - 600) / rng.uniform(150, 400), 0, None)
    green = rise(470, 505, 6, 18) * rise(565, 595, 6, 18, -1)
    blue = rise(485, 520, 6, 18, -1) * rise(380, 430, 8, 25)
    mixed = np.stack([red, green, blue], -1) @ (np.eye(3) + rng.uniform(0, 0.08, (3, 3)))
    return mixed * (rise(640, 700, 2, 10, -1) * rise(395, 425, 2, 8))[:, None]


def chart(true, seed):
    """Return readings of a chart in daylight, and their noise."""
    mean = (CHART * DAY) @ true
    sd = np.hypot(0.005 * mean, 0.002 * mean.max())
    return mean + sd * np.random.default_rng(seed).normal(size=mean.shape), sd


def holds(bands, truth):
    return (bands.interval_95[0] <= truth) & (truth <= bands.interval_95[1])


def test_curves_matrix_and_balance_equal_the_cameras():
    true = camera(NAMES[0])
    readings, sd = chart(true, 0)
    found = sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=sd, draws=100)
    assert np.mean(holds(found.curves, true)) > 0.8
    assert (found.draws >= 0).all()
    raw = NIGHT @ true
    balance = found.white_balance(NIGHT)
    assert (np.abs(balance.mean - raw[1] / raw) <= 3.5 * balance.sd).all()
    xyz = (NIGHT * CHART) @ np.asarray(colour_spaces.observer(AT), float)
    white = NIGHT @ np.asarray(colour_spaces.observer(AT), float)
    matrix = found.matrix(NIGHT)
    sd = (matrix.draws @ raw).std(axis=0)
    assert (np.abs(matrix.mean @ raw - white / white[1]) <= 3 * sd).all()
    assert (sd < 0.01).all()
    shown = ((NIGHT * CHART) @ true) @ matrix.mean.T
    error = np.asarray(
        colour_spaces.delta_e_2000(
            *(
                colour_spaces.xyz_to_lab(
                    jnp.asarray(np.maximum(x, 0)), jnp.asarray(white / white[1])
                )
                for x in (shown, xyz / white[1])
            )
        )
    )
    said = found.delta_e(NIGHT)
    assert abs(error.mean() - said.draws.mean(1).mean()) < 4 * said.draws.mean(1).std()
    assert "red: peak" in str(found)


def test_narrow_bands_determine_the_curve_at_their_wavelengths():
    true = camera(NAMES[0])
    bands = np.exp(-(((NM - np.arange(410, 700, 20)[:, None]) / 8.0) ** 2))
    readings = bands @ true
    found = sensitivities.from_patches(readings, bands, 1e-9 * NM, sd=1e-3, draws=60)
    np.testing.assert_allclose(found.curves.mean, true, atol=0.07)


@pytest.mark.sweep
@pytest.mark.parametrize("off", [-10.0, 0.0, -40.0])
def test_wrong_wavelengths_of_bands_are_named(off):
    """Readings of a chart show it, which bands alone cannot. A finding gives the shift that
    matters."""
    true, rng = camera(NAMES[0]), np.random.default_rng(0)
    bands = np.exp(-(((NM - np.arange(410, 700, 20)[:, None]) / 8.0) ** 2))
    moved = np.array([np.interp(NM + off, NM, one) for one in true.T]).T
    light = np.concatenate([bands, CHART * DAY])
    readings = np.concatenate([bands @ moved, CHART * DAY @ true])
    sd = 0.005 * readings.max()
    readings = readings + sd * rng.normal(size=readings.shape)
    alone, both = (
        sensitivities.from_patches(readings[:n], light[:n], 1e-9 * NM, sd=sd, draws=20)
        for n in (len(bands), None)
    )
    assert "wavelengths of narrow bands are taken as exact" in " ".join(alone.findings)
    told = " ".join(both.findings)
    assert ("agree best if" in told) == (off != 0)
    if off < -25:  # beyond the searched range
        assert "25 nm or more below the stated wavelengths" in told
    elif off:
        assert float(told.split("bands lie ")[1].split()[0]) == pytest.approx(off, abs=2.5)


@pytest.mark.slow
def test_noise_a_thousand_times_the_stated_one_widens_the_intervals():
    """This also holds if the standard deviations are in another unit than the readings."""
    true, covered = camera(NAMES[0]), []
    for seed in range(2):
        readings, sd = chart(true, seed)
        right, tiny = (
            sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=s, draws=60)
            for s in (sd, sd / 1000)
        )
        np.testing.assert_allclose(tiny.noise, 1000 * right.noise, rtol=0.6)
        covered.append(np.mean(holds(tiny.curves, true)))
    assert np.mean(covered) > 0.8


def test_larger_noise_is_estimated_and_reported():
    true = camera(NAMES[1])
    readings, sd = chart(true, 3)
    stated = sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=sd / 5, draws=20)
    assert (stated.noise > 3).all()
    assert "red: readings differ from any smooth sensitivity by" in str(stated)
    free = sensitivities.from_patches(readings[:, :1], CHART * DAY, 1e-9 * NM, channels=["y"])
    assert free.noise[0] == pytest.approx(np.sqrt(np.mean(sd[:, 0] ** 2)), rel=0.6)
    with pytest.raises(InputError, match="needs three channels"):
        free.matrix(DAY)


@pytest.mark.sweep("True")
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda readings: readings, ""),
        (lambda readings: -readings, "no sensitivity of at least 0 explains the readings"),
        (lambda readings: readings[::-1], "any smooth sensitivity"),
        (lambda readings: readings**0.45, "any smooth sensitivity"),
    ],
)
@pytest.mark.parametrize("stated", [False, True])
def test_readings_that_no_sensitivity_explains_are_named(change, said, stated):
    readings, _ = chart(camera(NAMES[0]), 0)
    wrong = change(readings)
    found = sensitivities.from_patches(
        wrong, CHART * DAY, 1e-9 * NM, sd=0.01 * np.abs(wrong).max() if stated else None, draws=20
    )
    assert len(found.findings) == (3 if said else 0)
    assert all(said in one for one in found.findings)


def test_clipped_readings_are_named():
    """Only green is clipped. 8-bit readings of which two are equal by chance are not called
    clipped."""
    readings, _ = chart(camera(NAMES[0]), 0)
    most = 0.6 * readings.max()
    for seen, said in (
        (np.minimum(readings, most), ["green: 2 readings are equal to the largest"]),
        (np.minimum(np.round(255 * readings / readings.max()), 255), []),
    ):
        of = {"sd": 0.02 * seen.max(), "draws": 20}
        found = sensitivities.from_patches(seen, CHART * DAY, 1e-9 * NM, **of)
        told = [one for one in found.findings if "equal to the largest" in one]
        assert [one.split(",")[0] for one in told] == said


def test_a_black_level_and_channels_in_another_order_are_named():
    readings, _ = chart(camera(NAMES[0]), 0)
    for seen, said in (
        (readings, ""),
        (readings + 0.02 * readings.max(), "Without light the readings of red, green and blue"),
        (readings[:, ::-1], "the readings are in the order blue, green, red"),
    ):
        found = sensitivities.from_patches(seen, CHART * DAY, 1e-9 * NM, draws=20)
        told = " ".join(found.findings)
        assert said in told if said else "Without" not in told and "order blue" not in told


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"wavelengths": NM}, "in metres"),
        ({"light": CHART[:5]}, "give \\(patches, 3\\), \\(patches, bands\\) and \\(bands,\\)"),
        ({"sd": 0.0}, "sd must be above 0"),
        ({"readings": np.full((24, 3), np.nan)}, "red: 0 readings are numbers"),
        ({"light": -CHART}, "light must be finite and at least 0"),
        ({"light": 0 * CHART}, "red: light is 0 in all bands"),
        ({"draws": 0}, "draws = 0: give a whole number of at least 2"),
    ],
)
def test_unusable_readings_are_one_sentence(change, said):
    given = {"readings": np.ones((24, 3)), "light": CHART, "wavelengths": 1e-9 * NM}
    with pytest.raises(InputError, match=said):
        sensitivities.from_patches(**{**given, **change})


def test_intervals_cover_behind_a_filter_with_an_edge():
    """The edge is 10 nm wide, between 650 and 660 nm. A smooth process alone covered none of
    these."""
    true = camera(NAMES[1])
    covered = []
    for seed in range(2):
        readings, sd = chart(true, seed)
        found = sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=sd, draws=60)
        covered.append(holds(found.curves, true))
    assert np.mean(np.array(covered)[:, (NM > 630) & (NM < 680)]) > 0.85


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMES, "random"])
def test_intervals_cover_the_true_curves(name):
    """The curves are not drawn from a Gaussian process. There are twelve random cameras."""
    rng = np.random.default_rng(99)
    middle = rng.uniform(400, 700, (20, 1))
    others = 0.05 + rng.uniform(0, 1, (20, 1)) * np.exp(-(((NM - middle) / 80) ** 2))
    of_curves, of_readings = [], []
    for seed in range(12):
        true = random_camera(seed) if name == "random" else camera(name)
        readings, sd = chart(true, seed)
        found = sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=sd, seed=seed)
        of_curves.append(holds(found.curves, true))
        of_readings.append(holds(found.readings(others * DAY), (others * DAY) @ true))
    assert np.mean(of_curves) > 0.92
    assert np.mean(of_readings) > 0.93


@pytest.mark.slow
def test_it_is_as_good_as_a_basis_of_measured_cameras():
    """The reference is Jiang's recovery with Dyer's basis, by colour-science, for the Sigma, which
    is not in that basis."""
    import colour

    true = camera(NAMES[1]) / camera(NAMES[1]).max(0)
    shape = colour.SpectralShape(400, 700, 10)
    readings, sd = chart(true, 0)
    ours = sensitivities.from_patches(readings, CHART * DAY, 1e-9 * NM, sd=sd).curves.mean
    theirs = colour.recovery.RGB_to_msds_camera_sensitivities_Jiang2013(
        readings,
        colour.SDS_ILLUMINANTS["D65"].copy().align(shape),
        colour.MultiSpectralDistributions(CHART.T, NM),
        colour.recovery.BASIS_FUNCTIONS_DYER2017,
        shape=shape,
    ).values
    errors = [np.sqrt(np.mean((x / x.max(0) - true) ** 2)) for x in (ours, theirs)]
    assert errors[0] < 0.6 * errors[1]
