"""Median and bilateral filter against OpenCV and scipy, non-local means against scikit-image,
pyramids and integral images against OpenCV: time, and that the results are equal.

    pytest tests/benchmarks/bench_nonlinear.py -m benchmark -s
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxvision.filters.bilateral import bilateral_filter
from jaxvision.filters.integral import integral_image
from jaxvision.filters.median import median_filter
from jaxvision.filters.nonlocal_means import nonlocal_means_filter
from jaxvision.filters.pyramid import reduce_by_two

ROUNDS = 7
RNG = np.random.default_rng(0)
SINGLE = RNG.random((512, 512), dtype=np.float32)
COLOUR = RNG.random((512, 512, 3), dtype=np.float32)
CODES = RNG.integers(0, 256, size=(512, 512), dtype=np.uint8)


def milliseconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return 1e3 * (time.perf_counter() - start)


def compared(name: str, ours: Callable, theirs: Callable, *, inside: int, atol: float) -> None:
    """One row: first call, medians of interleaved rounds, their ratio, the largest difference."""
    first = milliseconds(ours)
    cut = slice(inside, -inside or None)
    apart = np.abs(np.asarray(ours(), float) - np.asarray(theirs(), float))[cut, cut].max()
    rounds = [(milliseconds(ours), milliseconds(theirs)) for _ in range(ROUNDS)]
    mine, peer = np.median(rounds, axis=0)
    print(f"{name:44s} {mine:8.2f} {peer:8.2f} {mine / peer:6.2f} {first:8.0f} {apart:9.1e}")
    assert apart <= atol


@pytest.mark.benchmark
def test_against_the_peers():
    cv2 = pytest.importorskip("cv2")
    restoration = pytest.importorskip("skimage.restoration")
    single, colour, codes = jnp.asarray(SINGLE), jnp.asarray(COLOUR), jnp.asarray(CODES)
    print(f"\n{'512 x 512, ms':44s} {'ours':>8} {'peer':>8} {'ratio':>6} {'first':>8} {'apart':>9}")
    for size in (3, 5):
        compared(
            f"median {size}, float32, OpenCV",
            lambda size=size: median_filter(single, size=size, border="clamp"),
            lambda size=size: cv2.medianBlur(SINGLE, size),
            inside=0,
            atol=0,
        )
    for size in (3, 5, 7, 9):
        compared(
            f"median {size}, uint8, OpenCV",
            lambda size=size: median_filter(codes, size=size, border="clamp"),
            lambda size=size: cv2.medianBlur(CODES, size),
            inside=0,
            atol=0,
        )
    compared(
        "median 7, float32, scipy",
        lambda: median_filter(single, size=7),
        lambda: ndimage.median_filter(SINGLE, size=7, mode="reflect"),
        inside=0,
        atol=0,
    )
    compared(
        "bilateral, disc of radius 5, RGB, OpenCV",
        lambda: bilateral_filter(
            colour, 2.0, 0.1, radius=5, window="disc", difference="sum", border="clamp"
        ),
        lambda: cv2.bilateralFilter(COLOUR, 11, 0.1, 2.0, borderType=cv2.BORDER_REPLICATE),
        inside=0,
        atol=1e-5,
    )
    small = colour[:128, :128]
    compared(
        "non-local means 5 / 6, RGB 128 x 128, skimage",
        lambda: nonlocal_means_filter(
            small, 0.3, patch=5, radius=6, profile="gaussian", cutoff=5.0
        ),
        lambda: restoration.denoise_nl_means(
            COLOUR[:128, :128], 5, 6, 0.3, fast_mode=False, channel_axis=-1
        ),
        inside=9,
        atol=0.03,
    )
    compared(
        "reduce by two, RGB, OpenCV",
        lambda: reduce_by_two(colour),
        lambda: cv2.pyrDown(COLOUR, borderType=cv2.BORDER_REFLECT),
        inside=0,
        atol=1e-6,
    )
    compared(
        "integral image in pairs, OpenCV in float64",
        lambda: integral_image(single).high,
        lambda: cv2.integral(SINGLE),
        inside=0,
        atol=0.02,
    )
