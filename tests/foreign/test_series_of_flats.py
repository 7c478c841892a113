"""Flats and darks of cameras that leak light, glow on, change their gain or move between frames."""

from types import SimpleNamespace

import numpy as np
import pytest

from fitting import noise
from fitting.noise import calibration as calibrations
from fitting.noise.findings import _glow
from fitting.noise.pattern import fitted_pattern
from fitting.noise.section import _why_hidden, section
from jaxvision.errors import InputError

K, READ, BLACK, SHAPE = 0.5, 3.0, 64.0, (64, 64)
ELECTRONS = np.linspace(300, 7000, 8)
EXPOSURES = ELECTRONS / ELECTRONS[-1]  # s


def exposed(rng, electrons, *, gain=K, prnu=1.0, offsets=0.0, dtype=np.uint16):
    """A frame of 12 bits."""
    e = rng.poisson(np.broadcast_to(electrons * prnu, SHAPE)) + READ * rng.standard_normal(SHAPE)
    return np.clip(np.rint(BLACK + gain * e + offsets), 0, 4095).astype(dtype)


def series(rng, *, frames=3, leak=0.0, count=None):
    """Flats and darks; `leak` is what each pixel collects without light, electrons a second."""
    prnu, offsets = 1 + 0.005 * rng.standard_normal(SHAPE), 0.5 * rng.standard_normal(SHAPE)
    own = {"prnu": prnu, "offsets": offsets}
    flats, darks = [], []
    for electrons, seconds in zip(ELECTRONS[:count], EXPOSURES, strict=False):
        more = leak * seconds
        flats.append([exposed(rng, electrons + more, **own) for _ in range(frames)])
        darks.append([exposed(rng, more, **own) for _ in range(frames)])
    return flats, darks


def measured(flats, darks, **others):
    times = list(EXPOSURES[: len(flats)])
    return noise.from_frames(flats, darks, times, camera=noise.Camera(bits=12), **others)


def test_light_that_leaks_is_named_by_darks_that_become_uneven():
    leak = 400 * np.linspace(0, 1, SHAPE[1]) ** 2
    found = measured(*series(np.random.default_rng(1), leak=leak))
    (told,) = _glow(SimpleNamespace(measurement=found))
    # Of t s the leak has a standard deviation of K t std(leak).
    uneven = float(told.split("by ")[1].split()[0])
    assert abs(uneven / (K * leak.std()) - 1) < 0.02
    assert "light leaks in" in told


def test_dark_current_of_hot_and_unequal_pixels_is_no_light_that_leaks():
    rng = np.random.default_rng(2)
    own = rng.exponential(200, SHAPE)
    found = measured(*series(rng, leak=own))
    assert _glow(SimpleNamespace(measurement=found)) == []


def test_figures_of_the_standard_stand_where_the_likelihood_has_no_maximum(monkeypatch):
    def none(*_):
        raise InputError("The best fit is no proper maximum, so it has no standard errors.")

    monkeypatch.setattr(calibrations, "choose_model", none)
    found = noise.calibrate(measured(*series(np.random.default_rng(3))))
    told = section(found)
    gain, missing = (one for one in told.estimates if one.name == "system_gain")
    assert gain.method == "EMVA 1288"
    assert abs(gain.value - K) < 3.5 * gain.standard_error < 0.1 * K
    assert missing.value is None
    assert "no maximum" in missing.reason
    assert any("no proper maximum" in one for one in told.findings)
    assert not told.records
    for picture in told.pictures:
        picture.draw()
    with pytest.raises(InputError, match="no proper maximum"):
        _ = found.chosen


def test_a_pattern_that_fits_no_model_is_not_called_hidden_under_noise():
    """Offsets of 70 DN at 1 s, and the likelihood's fit to all levels."""
    leak = 400 * np.linspace(0, 1, SHAPE[1]) ** 2
    found = measured(*series(np.random.default_rng(4), leak=leak))
    pattern = fitted_pattern(found, np.arange(len(ELECTRONS)))
    assert not pattern.dark.seen
    assert "no number of frames changes" in _why_hidden(pattern, pattern.dark)


def test_a_pattern_under_noise_is_called_hidden_under_noise():
    rng = np.random.default_rng(5)
    levels = [[[exposed(rng, x) for _ in range(2)] for x in own] for own in (ELECTRONS, 8 * [0.0])]
    pattern = fitted_pattern(measured(*levels), np.arange(len(ELECTRONS)))
    for spread in (pattern.dark, pattern.response):
        assert spread.seen or "take more frames" in _why_hidden(pattern, spread)
    assert not pattern.response.seen
