"""Compare photon transfer of frames in memory with the EMVA 1288 reference code by the authors of
the standard: time, and the differences of the results from each other and from the simulated
camera.

    pip install emva1288 lxml
    pytest tests/benchmarks/bench_noise.py -m benchmark -s

Both reduce the same frames to moments and evaluate the same data sheet. jaxvision also makes the
likelihood fit, a standard error of each result, and tests for row noise, drift and correlated
neighbours."""

import logging

import numpy as np
import pytest
from oracles.cameras import CameraTruth, expose, make_die
from turns import in_turns

from fitting import noise

SHAPE = (240, 320)
LEVELS = 24
FRAMES = 16  # at the levels that measure the fixed pattern: the middle one and its dark
PHOTONS = np.linspace(600, 28_000, LEVELS)
EXPOSURES = np.full(LEVELS, 0.01)
CAMERA = CameraTruth(dsnu=6.0, prnu=0.01)
PATTERN_LEVEL = LEVELS // 2
SHARED = {
    "system_gain": "K",
    "quantum_efficiency": "QE",
    "responsivity": "R",
    "temporal_dark_noise": "sigma_y_dark",
    "read_noise": "sigma_d",
    "saturation_electrons": "u_e_sat",
    "snr_max": "SNR_max",
    "dynamic_range": "DR",
    "threshold_photons": "u_p_min",
    "dsnu": "DSNU1288",
    "prnu": "PRNU1288",
}
TRUTH = {
    "system_gain": CAMERA.gain,
    "quantum_efficiency": 100 * CAMERA.efficiency,
    "read_noise": np.hypot(CAMERA.read_noise, np.sqrt(CAMERA.dark_current * EXPOSURES[0])),
    "dsnu": CAMERA.dsnu,
    "prnu": 100 * CAMERA.prnu,
}


def frames():
    """Return (flats, darks): codes (frames, h, w) of each level, and one set of darks."""
    rng = np.random.default_rng(0)
    die = make_die(rng, CAMERA, SHAPE)

    def taken(photons, count):
        codes = expose(rng, CAMERA, photons, EXPOSURES[0], (count, *SHAPE), die=die)
        return codes.astype(np.uint16)

    counts = [FRAMES if i == PATTERN_LEVEL else 2 for i in range(LEVELS)]
    return [taken(p, n) for p, n in zip(PHOTONS, counts, strict=True)], taken(0.0, FRAMES)


def theirs(flats, darks):
    """Return the results of the reference code, from images prepared as by its own loader."""
    from emva1288.process import data, results, routines

    t = EXPOSURES[0]
    pairs = {0.0: darks[:2]} | {p: f[:2] for p, f in zip(PHOTONS, flats, strict=True)}
    temporal = {p: routines.get_int_imgs(images) for p, images in pairs.items()}
    for sums in temporal.values():  # in the form of its loader
        sums["sum"], sums["pvar"] = np.sum(sums["sum"]), np.sum(sums["pvar"])
    spatial = {
        0.0: routines.get_int_imgs(darks),
        PHOTONS[PATTERN_LEVEL]: routines.get_int_imgs(flats[PATTERN_LEVEL]),
    }
    height, width = SHAPE
    read = data.Data1288(
        {"width": width, "height": height, "temporal": {t: temporal}, "spatial": {t: spatial}}
    )
    sheet = results.Results1288(read.data, loglevel=logging.WARNING)
    found = {name: getattr(sheet, attribute) for name, attribute in SHARED.items()}
    return {name: float(x() if callable(x) else x) for name, x in found.items()}


def ours(flats, darks):
    measured = noise.from_frames(
        flats,
        [darks],
        EXPOSURES,
        PHOTONS,
        camera=noise.Camera(bits=12),
        dark_exposures=EXPOSURES[:1],
    )
    return noise.calibrate(measured)


def figures(calibration):
    """Return the values of our standard sheet, with the fixed pattern from the standard's two
    levels."""
    values = {name: float(x) for name, x in calibration.standard.values.items()}
    pattern, _ = calibration.patterns
    fixed = {
        "dsnu": np.sqrt(pattern.dark.variance) / values["system_gain"],
        "prnu": 100 * np.sqrt(pattern.response.variance),
    }
    return values | fixed


@pytest.mark.benchmark
def test_against_the_reference_code(monkeypatch):
    pytest.importorskip("emva1288")
    # NumPy 2 has removed the name, which the reference code still calls.
    monkeypatch.setattr(np, "asfarray", lambda x: np.asarray(x, float), raising=False)
    flats, darks = frames()
    rivals = {"ours": lambda: ours(flats, darks), "reference": lambda: theirs(flats, darks)}
    first, seconds = in_turns(rivals, rounds=3)
    for name, taken in seconds.items():
        print(f"{name:10s} first {first[name]:6.2f} s   later {taken:6.2f} s")
    calibration, reference = rivals["ours"](), rivals["reference"]()
    found = figures(calibration)
    for name, value in reference.items():
        error = float(calibration.standard.errors.get(name, np.nan))
        truth = f"   truth {TRUTH[name]:.5g}" if name in TRUTH else ""
        print(f"{name:22s} {found[name]:10.6g} +- {error:<8.2g} {value:10.6g}{truth}")
        # The reference code uses two frames of each level, jaxvision uses all.
        assert found[name] == pytest.approx(value, rel=0.01)
