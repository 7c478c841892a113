"""Linear filters of float32 RGB against OpenCV 5, scipy.ndimage and kornia: time and ratio.

    pytest tests/benchmarks/bench_filters.py -m benchmark -s

All in one process, taking turns, warmed up, compile time apart, results shown equal. OpenCV and
XLA share the same cores. Large pictures page-fault on every call with the default allocator; run
again with `LD_PRELOAD=libtcmalloc.so` or `MALLOC_TOP_PAD_=1000000000 MALLOC_TRIM_THRESHOLD_=
1000000000 MALLOC_MMAP_THRESHOLD_=1000000000` for the tuned figure.
"""

import time
import warnings
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxvision import filters


pytestmark = [pytest.mark.benchmark, pytest.mark.filterwarnings("ignore")]
ROUNDS = 15


def interleaved(
    rivals: dict[str, Callable[[], object]], budget: float = 6.0
) -> dict[str, tuple[float, float]]:
    """(median ms, ms of the first call) of each, the rounds taking turns in random order."""
    first, once = {}, {}
    for name, run in rivals.items():
        for seconds in (first, once):
            start = time.perf_counter()
            run()
            seconds[name] = time.perf_counter() - start
    rounds = int(np.clip(budget / sum(once.values()), 5, 60))
    taken: dict[str, list[float]] = {name: [] for name in rivals}
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        for name in rng.permutation(list(rivals)):
            start = time.perf_counter()
            rivals[name]()
            taken[name].append(time.perf_counter() - start)
    return {name: (1e3 * float(np.median(t)), 1e3 * first[name]) for name, t in taken.items()}


def table(title: str, figures: dict[str, tuple[float, float]]) -> None:
    ours, first = figures["jaxvision"]
    others = "  ".join(
        f"{name} {ms:8.2f} ms (ours / it {ours / ms:5.2f})"
        for name, (ms, _) in figures.items()
        if name != "jaxvision"
    )
    print(f"{title:34s} jaxvision {ours:8.2f} ms, first {first:6.0f} ms   {others}")


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
        kornia = _kornia()
        if kornia:
            import torch

            torch.set_num_threads(2)
            t = torch.from_numpy(np.ascontiguousarray(f.transpose(2, 0, 1)))[None]
            rivals["kornia"] = lambda: kornia.filters.gaussian_blur2d(
                t, (size, size), (sigma, sigma), "reflect"
            )
    agree(rivals, same)
    table(f"separable {shape} k {size}", interleaved(rivals))


def _kornia():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import kornia
        except ImportError:
            return None
        return kornia


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
    kornia = _kornia()
    if kornia:
        import torch

        t = torch.from_numpy(np.ascontiguousarray(f.transpose(2, 0, 1)))[None]
        kt = torch.from_numpy(k)[None]
        rivals["kornia"] = lambda: kornia.filters.filter2d(t, kt, "reflect")
    agree(rivals, ["opencv"])
    table(f"non-separable 512 k {size}", interleaved(rivals))


@pytest.mark.parametrize("size", [3, 5, 7, 9, 11, 13, 15, 17, 21, 31])
def test_methods(size):
    """What `auto` chooses from: where each method begins to win."""
    x = jnp.asarray(picture(512, 512))
    k = np.random.default_rng(1).uniform(size=(size, size)).astype(np.float32) / size**2
    column = k[0]
    rank_one = np.outer(column, column)
    rivals = {"jaxvision": wait(filters.correlate, x, k)}
    rivals |= {m: wait(filters.correlate, x, k, method=m) for m in ("direct", "fft")}
    rivals["separable, rank 1"] = wait(filters.correlate, x, rank_one, method="separable")
    table(f"methods 512 k {size}", interleaved(rivals, 3.0))


@pytest.mark.parametrize("size", [7, 15, 31])
def test_gradient(size):
    """The gradient of a separable blur against what autodiff makes of shifted pictures."""
    x = jnp.asarray(picture(512, 512))
    k = np.asarray(filters.gaussian_kernel(jnp.float32(size / 6), size=size))

    def plain(f):
        n, p = size // 2, f
        for axis in (0, 1):
            width = [(n, n) if a == axis else (0, 0) for a in range(3)]
            q = jnp.pad(p, width, mode="symmetric")
            p = sum(
                k[i] * jax.lax.slice_in_dim(q, i, i + p.shape[axis], axis=axis) for i in range(size)
            )
        return p

    ours = jax.jit(jax.grad(lambda f: jnp.vdot(x, filters.correlate_separable(f, k, k))))
    other = jax.jit(jax.grad(lambda f: jnp.vdot(x, plain(f))))
    rivals = {"jaxvision": wait(ours, x), "plain autodiff": wait(other, x)}
    agree(rivals, ["plain autodiff"])
    table(f"gradient 512 k {size}", interleaved(rivals))


def test_small_call():
    """Micro-seconds of one call that is not inside a `jit`."""
    f = picture(16, 16)
    x, k = jnp.asarray(f), np.random.default_rng(0).uniform(size=(3, 3)).astype(np.float32)
    rivals = {
        "jaxvision": wait(filters.correlate, x, k),
        "gaussian": wait(filters.gaussian, x, 1.0),
        "uint8": wait(filters.correlate, (255 * f).astype(np.uint8), k),
    }
    table("16 x 16, one call", interleaved(rivals, 0.1))
