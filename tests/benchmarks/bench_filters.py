"""Compare linear filters of float32 RGB with OpenCV 5, `scipy.ndimage` and kornia: time and ratio.

    pytest tests/benchmarks/bench_filters.py -m benchmark -s

All programs run in alternation in one process, after a first call. Compilation is timed separately
and results are compared. OpenCV and XLA share the same cores."""

import os
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from turns import in_turns

from jaxvision import filters

# Idle threads of torch must not spin while the others are timed.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]


def table(title: str, rivals: dict[str, Callable[[], object]], *, rounds: int = 31) -> None:
    first, seconds = in_turns(rivals, rounds=rounds, title=title)
    ours = seconds["jaxvision"]
    others = "  ".join(
        f"{name} {1e3 * taken:8.2f} ms (ours / it {ours / taken:5.2f})"
        for name, taken in seconds.items()
        if name != "jaxvision"
    )
    took = f"jaxvision {1e3 * ours:8.2f} ms, first {first['jaxvision']:5.2f} s"
    print(f"{title:34s} {took}   {others}")


def picture(rows: int, columns: int, bands: int = 3) -> np.ndarray:
    return np.random.default_rng(rows).uniform(size=(rows, columns, bands)).astype(np.float32)


def wait(function: Callable, *arguments: object, **options: object) -> Callable[[], np.ndarray]:
    return lambda: jax.block_until_ready(function(*arguments, **options))


def agree(rivals: dict[str, Callable], names: list[str], tolerance: float = 2e-6) -> None:
    truth = np.asarray(rivals["jaxvision"]())
    for name in names:
        np.testing.assert_allclose(np.asarray(rivals[name]()), truth, atol=tolerance)


@pytest.mark.parametrize("size", [7, 15, 31])
@pytest.mark.parametrize("shape", [(512, 512), (2048, 2048), (3072, 4096)])
def test_separable(shape, size):
    cv2 = pytest.importorskip("cv2")
    f, sigma = picture(*shape), size / 6
    x = jnp.asarray(f)
    k = cv2.getGaussianKernel(size, sigma, cv2.CV_32F)
    rivals = {
        "jaxvision": wait(filters.gaussian, x, sigma, size=size),
        "opencv": lambda: cv2.sepFilter2D(f, -1, k, k, borderType=cv2.BORDER_REFLECT),
    }
    same = ["opencv"]
    if shape == (512, 512):
        rivals["scipy"] = lambda: ndimage.gaussian_filter(
            f, sigma, axes=(0, 1), radius=size // 2, mode="reflect"
        )
        same.append("scipy")
    agree(rivals, same)
    table(f"separable {shape} k {size}", rivals)
    if shape == (512, 512):
        kornia, t = _kornia(f)
        pair = {
            "jaxvision": rivals["jaxvision"],
            "kornia": lambda: kornia.filters.gaussian_blur2d(t, (size, size), (sigma, sigma)),
        }
        table(f"separable {shape} k {size}", pair)


def _kornia(f):
    """Return kornia and the picture as a tensor. It is timed separately, because its threads
    disturb the others."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        kornia, torch = pytest.importorskip("kornia"), pytest.importorskip("torch")
    torch.set_num_threads(os.cpu_count())
    return kornia, torch.from_numpy(np.ascontiguousarray(f.transpose(2, 0, 1)))[None]


@pytest.mark.parametrize("size", [3, 7, 15, 31])
def test_non_separable(size):
    cv2 = pytest.importorskip("cv2")
    f = picture(512, 512)
    k = np.random.default_rng(1).uniform(size=(size, size)).astype(np.float32)
    k /= k.sum()
    x = jnp.asarray(f)
    rivals = {
        "jaxvision": wait(filters.correlate, x, k),
        "opencv": lambda: cv2.filter2D(f, -1, k, borderType=cv2.BORDER_REFLECT),
    }
    if size <= 7:
        rivals["scipy"] = lambda: ndimage.correlate(f, k[:, :, None], mode="reflect")
    agree(rivals, ["opencv"])
    table(f"non-separable 512 k {size}", rivals)


@pytest.mark.parametrize("size", [3, 5, 7, 9, 11, 13, 15, 17, 21, 31])
def test_methods(size):
    """Time the methods among which `auto` chooses, to find the sizes where each is the fastest."""
    x = jnp.asarray(picture(512, 512))
    k = np.random.default_rng(1).uniform(size=(size, size)).astype(np.float32) / size**2
    column = k[0]
    rank_one = np.outer(column, column)
    rivals = {"jaxvision": wait(filters.correlate, x, k)}
    rivals |= {m: wait(filters.correlate, x, k, method=m) for m in ("direct", "fft")}
    rivals["separable, rank 1"] = wait(filters.correlate, x, rank_one, method="separable")
    table(f"methods 512 k {size}", rivals)
