"""Tests what the numbers in frames reveal about the converter, with simulated grids."""

import numpy as np
import pytest

from fitting.codes import Codes, Converter, converter_of

RNG = np.random.default_rng(0)
LEVELS = [RNG.normal(level, np.sqrt(level), (60, 80)) for level in (64, 200, 500, 1200, 2600)]
FRAMES = [np.round(level) for level in LEVELS]  # 12 bits


def folded(values: np.ndarray) -> np.ndarray:
    """Return codes with steps of 1.2 and .8 DN in turn: odd ones extend .1 DN into their
    neighbours."""
    nearest = np.round(values)
    take = (nearest % 2 == 0) & (np.abs(values - nearest) > 0.4)
    return np.where(take, nearest + np.sign(values - nearest), nearest)


@pytest.mark.parametrize(
    ("frames", "step", "origin", "rounding"),
    [
        (FRAMES, 1, 0, 1 / 12),
        ([16 * frame for frame in FRAMES], 16, 0, 256 / 12),
        ([16 * frame + 8 for frame in FRAMES], 16, 8, 256 / 12),
        ([64 * np.floor(frame / 4) for frame in FRAMES], 64, 0, 64**2 / 12),
        ([frame / 16 for frame in FRAMES], 1 / 16, 0, 1 / 16**2 / 12),
        ([(frame / np.float32(4095)) for frame in FRAMES], 1 / 4095, 0, 1 / 4095**2 / 12),
        ([sum(FRAMES[i : i + 3]) / np.float32(3) for i in range(3)], 1 / 3, 0, 1 / 9 / 12),
        ([np.round(x * 65535 / 4095) for x in FRAMES], 65535 / 4095, 0, (16.0037**2 + 1) / 12),
        (LEVELS, 0, 0, 0),
    ],
    ids=["plain", "left", "offset", "10 bits", "divided", "unit", "averaged", "scaled", "none"],
)
def test_the_grid_of_the_converter_is_found(frames, step, origin, rounding):
    found = converter_of(frames)
    assert found.even
    assert found.step == pytest.approx(step, rel=1e-4)
    assert found.origin == pytest.approx(origin, abs=1e-9)
    assert found.rounding == pytest.approx(rounding, rel=1e-3)


@pytest.mark.parametrize("stretch", [1.3, 2.3])
def test_a_stretched_histogram_lacks_codes(stretch):
    frames = [np.round(stretch * np.round(RNG.normal(400, 20, (200, 200)))) for _ in range(8)]
    found = converter_of(frames)
    assert not found.even
    assert found.missing == pytest.approx(1 - 1 / stretch, abs=0.03)
    assert found.rounding == pytest.approx((stretch**2 + 1) / 12, rel=0.06)


def test_unequal_steps_are_found():
    signals = [RNG.normal(400, 20, (200, 200)) for _ in range(4)]
    found = converter_of([folded(signal) for signal in signals])
    left = np.concatenate([folded(signal) - signal for signal in signals])
    assert found.imbalance == pytest.approx(0.2, abs=0.01)
    assert found.rounding == pytest.approx(left.var(), rel=0.02)
    assert converter_of([np.round(signal) for signal in signals]).imbalance == 0


@pytest.mark.parametrize("scale", [1, 16, 1 / 16])
def test_an_accumulation_at_the_largest_number_is_clipping(scale):
    bright = np.minimum(np.round(RNG.normal(4080, 64, (60, 80))), 4095)
    assert converter_of([scale * frame for frame in [*FRAMES, bright]]).clips_at == scale * 4095
    assert converter_of([scale * frame for frame in FRAMES]).clips_at is None


@pytest.mark.parametrize("most", [2**18, 1000])
def test_numbers_on_no_grid_may_be_clipped_too(monkeypatch, most):
    """The frames were averaged, or had a dark subtracted."""
    monkeypatch.setattr("fitting.codes.MOST_VALUES", most)
    smooth = [np.minimum(RNG.normal(80, 16, (60, 80)), 110) for _ in range(3)]
    assert converter_of(smooth) == Converter(0.0, clips_at=110)
    assert converter_of([RNG.normal(80, 16, (60, 80))]) == Converter(0.0)


def test_few_numbers_are_uninformative():
    assert converter_of([np.array([[64.0, 80.0]])]) == Converter()
    quiet = [np.round(RNG.normal(64.4, 0.2, (60, 80))) for _ in range(4)]
    assert converter_of(quiet) == Converter()


def clean_camera(rng: np.random.Generator) -> list[np.ndarray]:
    """Return flats and darks of random size, gain, light, black level and bit depth, some of them
    clipped."""
    size, bits = rng.choice([32, 64, 100]), rng.choice([8, 10, 12, 14])
    full, count = 2.0**bits - 1, rng.choice([6, 10, 14, 25])
    top = rng.choice([0.02, 0.1, 0.6, 0.95, 1.2]) * full
    gain, read = 2.0 ** (bits - 12) * np.exp(rng.uniform(-4, 1)), rng.uniform(0.3, 8)
    rise = np.linspace if rng.random() < 0.5 else np.geomspace
    light = [*rise(top / gain / 30, top / gain, count), *[0] * 4]
    falls = 1 - rng.choice([0, 0.3]) * np.linspace(0, 1, size)[:, None]
    unequal = 1 + rng.choice([0, 0.02]) * rng.standard_normal((size, size))
    black = rng.choice([0, 2, 0.03 * full])
    return [
        np.clip(
            np.round(
                gain * (rng.poisson(x * (falls * unequal).clip(0)))
                + gain * read * rng.standard_normal((size, size))
                + black
            ),
            0,
            full,
        )
        for x in light
        for _ in range(2)
    ]


def patches(rng: np.random.Generator) -> list[np.ndarray]:
    """Return a stack of one scene with few tones and little noise."""
    light = np.kron(np.exp(0.5 * rng.standard_normal((6, 8))), np.ones((10, 10)))
    light = light * np.geomspace(1, 300, 80)
    noise = rng.normal(0, rng.choice([0.3, 1, 2]), (5, 60, 80))
    counted = rng.poisson(40 * light * 4.0 ** np.arange(-3, 2)[:, None, None])
    return list(np.clip(np.round(60 + counted / 4 + noise), 0, 4095))


def without_alarm(frames: list[np.ndarray], full: tuple[float, ...]) -> bool:
    found = converter_of(frames)
    plain = found.step == 1 and found.even and not found.missing and not found.imbalance
    return plain and found.clips_at in (None, *full)


@pytest.mark.parametrize("kind", [clean_camera, patches])
@pytest.mark.parametrize("count", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_a_good_camera_causes_no_false_alarm(kind, count):
    rng = np.random.default_rng(count)
    ends = tuple(2.0**bits - 1 for bits in (8, 10, 12, 14))
    assert sum(not without_alarm(kind(rng), ends) for _ in range(count)) == 0


@pytest.mark.parametrize("size", [64, 100])
@pytest.mark.parametrize(
    ("changed", "missing"),
    [
        (lambda x: np.round(1.05 * x), 1 - 1 / 1.05),
        (lambda x: np.round(1.3 * x), 1 - 1 / 1.3),
        (lambda x: np.where(x % 8 == 3, x + 1, x), 1 / 8),
        (lambda x: np.round(4095 * (x / 4095) ** (1 / 2.2)), 0.09),
        (lambda x: np.round(65535 * (x / 4095) ** (1 / 2.2)), 0.91),
    ],
    ids=["a little wider", "wider", "no eighth code", "gamma", "gamma in 16 bits"],
)
def test_codes_that_a_table_leaves_out_are_missed(changed, missing, size):
    rng = np.random.default_rng(2)
    light = [x for x in np.linspace(250, 9000, 14) for _ in range(2)]
    flats = [np.round(0.4 * rng.poisson(x, (size, size)) + 64) for x in light]
    found = converter_of([changed(flat) for flat in flats])
    assert not found.even
    assert found.missing == pytest.approx(missing, abs=0.02)


@pytest.mark.parametrize("cut", [-2.0, -1.0, 0.0, 0.5])
@pytest.mark.parametrize("step", [1, 16])
def test_an_accumulation_at_the_smallest_number_of_darks_is_clipped_black(cut, step):
    rng, codes = np.random.default_rng(0), Codes()
    lowest = np.round(64 + 2 * cut)
    for _ in range(8):
        codes.add(step * np.maximum(np.round(rng.normal(64.2, 2.0, (64, 64))), lowest))
    assert codes.clips_below() == step * lowest


def test_unclipped_black_has_no_accumulation_at_its_smallest_number():
    """The darks have low or high noise, with unequal, hot and cold pixels, few electrons and row
    noise."""
    rng = np.random.default_rng(0)
    for i in range(60):
        noise, codes = 10 ** rng.uniform(-1.2, 1.5), Codes()
        die = noise * rng.choice([0, 0.3, 1, 3]) * rng.standard_normal((64, 64))
        die += (
            10 ** rng.uniform(0, 2)
            * rng.exponential(size=die.shape)
            * (rng.random(die.shape) < 0.01)
        )
        die -= 3 * noise * (rng.random(die.shape) < 0.05 * (i % 5 == 0))
        electrons = rng.uniform(0, 3) * (i % 3 == 0)
        for _ in range(4):
            frame = rng.uniform(60, 61) + die + noise * rng.standard_normal(die.shape)
            frame += 10 ** rng.uniform(-2, 1) * rng.poisson(electrons, die.shape)
            frame += noise * rng.choice([0, 1]) * rng.standard_normal((64, 1))
            codes.add(np.clip(np.round(frame), 0, 4095))
        assert codes.clips_below() in (None, 0)
