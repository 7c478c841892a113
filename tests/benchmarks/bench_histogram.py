"""Compare histogram, equalisation and CLAHE of an 8-bit image with OpenCV, and matching with
scikit-image: time, and the difference of the results in levels.

    pytest tests/benchmarks/bench_histogram.py -m benchmark -s
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision import histogram

ROUNDS = 41


@pytest.mark.benchmark
@pytest.mark.parametrize("side", [512, 2048])
def test_against_opencv_and_scikit_image(side):
    cv2 = pytest.importorskip("cv2")
    data = pytest.importorskip("skimage.data")
    exposure = pytest.importorskip("skimage.exposure")
    codes = np.ascontiguousarray(np.tile(data.camera(), (side // 512, side // 512)))
    other = np.ascontiguousarray(codes.T) // 2 + 30
    ours, others = jnp.asarray(codes), jnp.asarray(other)
    clahe = cv2.createCLAHE(2.0, (8, 8))
    pairs = {
        "histogram": (
            lambda: histogram.exact_histogram(ours).counts,
            lambda: cv2.calcHist([codes], [0], None, [256], [0, 256]).ravel(),
            0,
        ),
        "equalise": (lambda: histogram.equalise(ours), lambda: cv2.equalizeHist(codes), 3.0),
        "CLAHE 8 x 8": (lambda: histogram.equalise_locally(ours), lambda: clahe.apply(codes), 2.0),
        "match": (
            lambda: histogram.match_histogram(ours, others),
            lambda: exposure.match_histograms(codes, other),
            1.0,
        ),
    }
    print(f"\n{side} x {side}, 8 bit      ours      peer  ratio   aim  first call  levels apart")
    for name, (mine, theirs, aim) in pairs.items():
        apart = np.abs(np.asarray(mine(), int) - np.asarray(theirs(), int)).max()
        jax.clear_caches()
        rivals = {"ours": mine, "peer": theirs}
        first, seconds = in_turns(rivals, rounds=ROUNDS, title=name)
        fast, peer = seconds["ours"], seconds["peer"]
        print(
            f"{name:16s} {1e3 * fast:8.3f} ms {1e3 * peer:6.3f} ms {fast / peer:6.2f} "
            f"{aim or 3:5.1f} {first['ours']:9.2f} s {apart:9d}"
        )
        assert apart <= 1
