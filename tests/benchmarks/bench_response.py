"""Compare the response curve with OpenCV 5's `createCalibrateDebevec` (300 samples) and
`createCalibrateRobertson`, and colour-hdri's Debevec (1000 samples), on one RGB stack: time, and
log-RMS error of the curve.

    pytest tests/benchmarks/bench_response.py -m benchmark -s
"""

from collections.abc import Callable

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


def colour_hdri_debevec(images: np.ndarray) -> dict[str, Callable[[], np.ndarray]]:
    """Return colour-hdri's (256, 3) curves of a stack, or nothing if it is not installed."""
    try:
        import colour_hdri
    except ImportError:
        return {}
    stack = colour_hdri.ImageStack()
    for image, time in zip(images, TIMES, strict=True):
        # Its exposures are t ISO / (100 N^2) with the f-number N.
        taken = colour_hdri.Metadata(f_number=1.0, exposure_time=time, iso=100.0)
        stack.append(colour_hdri.Image(data=image / 255, metadata=taken))
    solve = colour_hdri.camera_response_functions_Debevec1997
    return {"colour-hdri": lambda: np.asarray(solve(stack, normalise=False))}


@pytest.mark.benchmark
def test_beside_others():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(0)
    channels = [
        exposure_stack(srgb, TIMES, rng, pixels=SIDE**2, full_well=40_000.0)[1] for _ in range(3)
    ]
    images = np.stack(channels, axis=-1).reshape(len(TIMES), SIDE, SIDE, 3).astype(np.uint8)
    times32 = TIMES.astype(np.float32)
    debevec = cv2.createCalibrateDebevec(300, 10.0, False)
    robertson = cv2.createCalibrateRobertson(30, 0.01)
    rivals = colour_hdri_debevec(images) | {
        "ours": lambda: [fit_response_curve(codes, TIMES, bits=8) for codes in channels],
        "debevec": lambda: debevec.process(list(images), times32),
        "robertson": lambda: robertson.process(list(images), times32),
    }
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    curve = rivals["ours"]()[0]
    found = {"ours": np.interp(np.arange(256), curve.codes, curve.log_exposure)}
    for name in set(rivals) - {"ours"}:
        found[name] = np.log(np.maximum(rivals[name]().reshape(256, 3)[:, 0], 1e-12))
    middle, low = np.arange(20, 236), np.arange(5, 20)
    errors = {}
    for name, g in found.items():
        errors[name] = log_rms(g[middle], middle), log_rms(g[low], low)
        print(
            f"{name:10s} {1e3 * seconds[name]:7.1f} ms   log-rms {errors[name][0]:.5f} (20-235) "
            f"{errors[name][1]:.5f} (5-19)"
        )
    assert errors["ours"][0] < errors["debevec"][0]
