"""The response curve against OpenCV 5's createCalibrateDebevec (300 samples) and
createCalibrateRobertson on one RGB stack: time, and log-rms error of the curve.

    pytest tests/benchmarks/bench_response.py -m benchmark -s
"""

import numpy as np
import pytest
from oracles.stacks import exposure_stack, log_exposures, srgb
from turns import in_turns

from fitting.response.curve import fit_response_curve

TIMES = 2.0 ** np.arange(-4, 5)
SIDE = 128
ROUNDS = 7


def log_rms(found: np.ndarray, codes: np.ndarray) -> float:
    error = found - log_exposures(srgb, codes)
    return float(np.std(error - np.median(error)))


@pytest.mark.benchmark
def test_against_opencv():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(0)
    channels = [
        exposure_stack(srgb, TIMES, rng, pixels=SIDE**2, full_well=40_000.0)[1] for _ in range(3)
    ]
    images = np.stack(channels, axis=-1).reshape(len(TIMES), SIDE, SIDE, 3).astype(np.uint8)
    times32 = TIMES.astype(np.float32)
    debevec = cv2.createCalibrateDebevec(300, 10.0, False)
    robertson = cv2.createCalibrateRobertson(30, 0.01)
    rivals = {
        "ours": lambda: [fit_response_curve(codes, TIMES, bits=8) for codes in channels],
        "debevec": lambda: debevec.process(list(images), times32),
        "robertson": lambda: robertson.process(list(images), times32),
    }
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    curve = rivals["ours"]()[0]
    found = {"ours": np.interp(np.arange(256), curve.codes, curve.log_exposure)}
    for name in ("debevec", "robertson"):
        found[name] = np.log(np.maximum(rivals[name]()[:, 0, 0], 1e-12))
    middle, low = np.arange(20, 236), np.arange(5, 20)
    errors = {}
    for name, g in found.items():
        errors[name] = log_rms(g[middle], middle), log_rms(g[low], low)
        print(
            f"{name:10s} {1e3 * seconds[name]:7.1f} ms   log-rms {errors[name][0]:.5f} (20-235) "
            f"{errors[name][1]:.5f} (5-19)"
        )
    assert errors["ours"][0] < errors["debevec"][0]
    assert seconds["ours"] < seconds["debevec"]
