"""Photon transfer of cameras that are not the project's own: their sheets against the truth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, poisson

from fitting import noise
from fitting.noise.quantised import quantised_moments, window_for
from fitting.noise.section import section

K, QE, SHAPE, PHOTONS = 0.25, 0.5, (64, 64), np.linspace(300, 28_000, 8)


def camera(rng, *, read, dsnu=1.0, offset=64.0, bits=12, convert=np.asarray, light=None):
    """A calibrated camera of 12 bits, whose numbers go through `convert`; `light` is what each
    pixel of a flat gets of its mean."""
    die = dsnu * rng.standard_normal(SHAPE), 1 + 0.01 * rng.standard_normal(SHAPE)

    def frame(photons):
        own = die[1] if light is None else die[1] * light(rng)
        electrons = rng.poisson(QE * photons * own) + die[0] + read * rng.standard_normal(SHAPE)
        return convert(np.clip(np.round(K * electrons + offset), 0, 4095))

    flats = [[frame(p), frame(p)] for p in PHOTONS]
    darks = [[frame(0.0), frame(0.0)] for _ in PHOTONS]
    measured = noise.from_frames(
        flats, darks, [0.01] * len(PHOTONS), list(PHOTONS), camera=noise.Camera(bits=bits)
    )
    return noise.calibrate(measured)


def estimates(calibration):
    """By name, of the likelihood where there are two."""
    listed = section(calibration).estimates
    return {one.name: one for one in listed if one.method != "EMVA 1288"}


def assert_true(found, **truth):
    for name, value in truth.items():
        assert found[name].value is not None, found[name].reason
        assert abs(found[name].value - value) < 3.5 * found[name].standard_error, found[name]


def test_rounded_moments_of_unequal_pixels_are_those_of_a_sum_over_pixels():
    """Of 201 x 401 places of the offset and codes, with Poisson's law summed, by SciPy."""
    mu, gain, read, offset, spread = 3.0, 0.25, 0.7, 64.3, 0.3
    offsets = spread * np.linspace(-6, 6, 401)
    weight = norm.pdf(offsets / spread)
    weight /= weight.sum()
    codes, electrons = np.arange(58, 76), np.arange(40)
    edges = np.append(codes - 0.5, codes[-1] + 0.5)
    at = edges[:, None, None] - offset - offsets[None, :, None] - gain * electrons
    below = norm.cdf(at / (gain * read)) @ poisson.pmf(electrons, mu)
    chance = np.diff(below, axis=0)  # (codes, offsets)
    mean = codes @ chance
    variance = codes**2 @ chance - mean**2
    window = window_for(
        (0,), np.array([65.0]), deviation=0.8, read_noise=gain * read, spread=spread
    )
    own = jax.tree.map(lambda leaf: leaf[0], window)
    arguments = (jnp.asarray(x) for x in (mu, gain, read, offset))
    found = quantised_moments(*arguments, own, spread=jnp.asarray(spread))
    assert found.spatial is not None
    assert found.uneven is not None
    average = mean @ weight
    np.testing.assert_allclose(found.mean, average, atol=1e-6)
    np.testing.assert_allclose(found.variance, variance @ weight, atol=1e-6)
    np.testing.assert_allclose(found.spatial, (mean - average) ** 2 @ weight, atol=1e-6)
    np.testing.assert_allclose(
        found.uneven, (variance - variance @ weight) ** 2 @ weight, atol=1e-6
    )


@pytest.mark.long
@pytest.mark.parametrize(("dsnu", "offset"), [(1.0, 64.0), (1.0, 64.3), (2.0, 64.0)])
def test_unequal_offsets_of_a_quiet_sensor_are_no_read_noise(dsnu, offset):
    found = estimates(camera(np.random.default_rng(0), read=0.8, dsnu=dsnu, offset=offset))
    assert_true(found, system_gain=K, read_noise=0.8, dsnu=dsnu)
    assert found["read_noise"].standard_error < 0.03


def left_aligned(frame):
    return 16 * frame


@pytest.mark.long
@pytest.mark.parametrize(
    ("convert", "bits", "step", "said"),
    [
        (left_aligned, 16, 16, "multiple of 16: the converter has 12 bits"),
        (
            lambda frame: np.round(frame * 65535 / 4095),
            16,
            65535 / 4095,
            "scaled and rounded again",
        ),
        (lambda frame: (frame / 16).astype(np.float32), 12, 1 / 16, "multiple of 1/16"),
    ],
    ids=["left-aligned", "scaled", "divided"],
)
def test_the_step_of_the_converter_is_the_files_own(convert, bits, step, said):
    calibration = camera(np.random.default_rng(1), read=4.0, convert=convert, bits=bits)
    found = estimates(calibration)
    assert_true(found, system_gain=K * step, quantum_efficiency=50.0, read_noise=4.0, dsnu=1.0)
    assert any(said in sentence for sentence in section(calibration).findings)


@pytest.mark.long
def test_left_aligned_numbers_of_a_quiet_sensor_get_the_warnings_of_its_codes():
    calibration = camera(np.random.default_rng(2), read=0.8, convert=left_aligned, bits=16)
    assert_true(estimates(calibration), read_noise=0.8, dsnu=1.0, system_gain=16 * K)
    told = " ".join(section(calibration).findings)
    assert "Dark variance is below 61.4 DN²" in told
    assert "Black is clipped or read noise is too small" in told
    from fitting.noise.sensor import fitted_sensor

    sensor = fitted_sensor(calibration)[0]
    assert sensor.bits == pytest.approx(12)
    assert float(sensor.gain) == pytest.approx(K, rel=0.02)
    assert float(sensor.offset) == pytest.approx(64, abs=0.05)


@pytest.mark.long
def test_a_floor_is_a_limit_and_the_darks_show_their_own_noise():
    calibration = camera(np.random.default_rng(3), read=1.2, dsnu=0.0, offset=63.9)
    by_method = {(one.name, one.method): one for one in section(calibration).estimates}
    for name, side in (("temporal_dark_noise", "below 0.49 DN"), ("read_noise", "below 1.58 e⁻")):
        standard = by_method[name, "EMVA 1288"]
        assert standard.value is None
        assert standard.reason.startswith(side[:9])
    shown = by_method["temporal_dark_noise", "likelihood"]
    scatter = float(np.sqrt(np.mean(np.asarray(calibration.measurement.dark.variance))))
    assert abs(shown.value - scatter) < 4 * shown.standard_error
    assert_true(estimates(calibration), read_noise=1.2)
    for one in by_method.values():
        assert one.value is None or one.standard_error > 0, one


@pytest.mark.long
def test_a_read_noise_within_a_tenth_of_a_code_is_a_limit():
    calibration = camera(np.random.default_rng(4), read=0.1, dsnu=0.0, offset=64.49)
    read = estimates(calibration)["read_noise"]
    assert read.value is None
    assert read.reason.startswith("below ")
    assert 0.4 <= float(read.reason.split()[1]) < 1.5


@pytest.mark.long
def test_rows_that_flicker_by_a_tenth_of_a_percent_leave_the_sheet():
    def rows(rng):
        return 1 + 0.001 * rng.standard_normal((SHAPE[0], 1))

    calibration = camera(np.random.default_rng(5), read=4.0, light=rows)
    assert_true(
        estimates(calibration),
        system_gain=K, quantum_efficiency=50.0, read_noise=4.0, dsnu=1.0, prnu=1.0,
    )  # fmt: skip
    assert list(calibration.flicker) == ["rows"]
    assert "It was taken out, row by row" in section(calibration).findings[0]
