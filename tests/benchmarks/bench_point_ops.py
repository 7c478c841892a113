"""Compare a chain of point operators in one pass with the same chain in OpenCV, NumPy and kornia
(PyTorch), all in float32 RGB, with both methods of the power function.

    pytest tests/benchmarks/bench_point_ops.py -m benchmark -s
"""

import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision.colour_spaces import apply_matrix
from jaxvision.matting.compositing import over
from jaxvision.point_ops import blend, clip, exposure, gain_bias, gamma_encode

ROUNDS = 15
SIZES = ((512, 512), (2048, 2048))
RNG = np.random.default_rng(0)
MATRIX = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]], np.float32)
LUMA = np.array(
    [[0.2126, 0.7152, 0.0722], [-0.114572, -0.385428, 0.5], [0.5, -0.454153, -0.045847]]
)


def f32(x: float) -> jax.Array:
    return jnp.asarray(x, jnp.float32)


def compiled(name: str, function: Callable, *arrays: np.ndarray) -> Callable[[], jax.Array]:
    """Return the call compiled ahead, and print the time that compiling took."""
    inputs = [jnp.asarray(a) for a in arrays]
    start = time.perf_counter()
    call = jax.jit(function).lower(*inputs).compile()
    print(f"    {name}: traced and compiled in {time.perf_counter() - start:.2f} s")
    return lambda: jax.block_until_ready(call(*inputs))


def report(
    title: str, rivals: dict[str, Callable[[], object]], tolerance: float
) -> dict[str, float]:
    """Check that all results are equal, then print and return the seconds."""
    first = np.asarray(next(iter(rivals.values()))())
    for name, run in rivals.items():
        np.testing.assert_allclose(np.asarray(run()), first, atol=tolerance, err_msg=name)
    _, seconds = in_turns(rivals, rounds=ROUNDS, title=title)
    best = min(s for name, s in seconds.items() if not name.startswith("ours"))
    for name, s in seconds.items():
        print(f"  {title:24s} {name:12s} {1e3 * s:8.2f} ms   {s / best:5.2f} of the best peer")
    return seconds


@pytest.mark.benchmark
@pytest.mark.parametrize("size", SIZES)
def test_chain_of_exposure_matrix_gain_gamma(size):
    """The chain is exposure, colour matrix, gain and bias, clip and gamma. jaxvision does the five
    calls in one pass."""
    cv2 = pytest.importorskip("cv2")
    image = RNG.uniform(0, 1, size=(*size, 3)).astype(np.float32)

    def chain(x: jax.Array, method: str) -> jax.Array:
        x = apply_matrix(exposure(x, f32(0.5)), jnp.asarray(MATRIX))
        x = clip(gain_bias(x, f32(0.9), f32(0.02)), f32(0.0), f32(1.0))
        return gamma_encode(x, f32(2.2), method=method)

    def opencv() -> np.ndarray:
        x = cv2.transform(image, MATRIX * np.float32(2**0.5 * 0.9))
        x = cv2.addWeighted(x, 1.0, x, 0.0, 0.02)
        x = cv2.threshold(cv2.threshold(x, 0, 0, cv2.THRESH_TOZERO)[1], 1, 1, cv2.THRESH_TRUNC)[1]
        return cv2.pow(x, 1 / 2.2)

    def numpy() -> np.ndarray:
        x = image @ (MATRIX * np.float32(2**0.5 * 0.9)).T + np.float32(0.02)
        return np.clip(x, 0, 1) ** np.float32(1 / 2.2)

    rivals = {
        "ours, power": compiled("power", lambda x: chain(x, "power"), image),
        "ours, exp2": compiled("exp2", lambda x: chain(x, "exp2"), image),
        "opencv": opencv,
        "numpy": numpy,
    }
    # near black the power turns a rounding of 6e-8 into 5e-4
    seconds = report(f"chain {size[0]}x{size[1]}", rivals, 5e-4)
    assert seconds["ours, exp2"] < min(seconds["opencv"], seconds["numpy"])


@pytest.mark.benchmark
@pytest.mark.parametrize("size", SIZES)
def test_single_operators(size):
    cv2 = pytest.importorskip("cv2")
    first, second = RNG.uniform(0, 1, size=(2, *size, 3)).astype(np.float32)
    front, back = RNG.uniform(0, 1, size=(2, *size, 4)).astype(np.float32)
    title = f"{size[0]}x{size[1]}"
    report(
        f"gain, bias {title}",
        {
            "ours": compiled("gain", lambda x: gain_bias(x, f32(1.2), f32(0.1)), first),
            "opencv": lambda: cv2.addWeighted(first, 1.2, first, 0.0, 0.1),
            "numpy": lambda: np.float32(1.2) * first + np.float32(0.1),
        },
        1e-6,
    )
    report(
        f"blend {title}",
        {
            "ours": compiled("blend", lambda a, b: blend(a, b, f32(0.3)), first, second),
            "opencv": lambda: cv2.addWeighted(first, 0.7, second, 0.3, 0.0),
            "numpy": lambda: np.float32(0.7) * first + np.float32(0.3) * second,
        },
        1e-6,
    )
    report(
        f"over {title}",
        {
            "ours": compiled("over", over, front, back),
            "numpy": lambda: front + (1 - front[..., 3:]) * back,
        },
        1e-6,
    )


@pytest.mark.benchmark
def test_gamma_against_kornia():
    torch = pytest.importorskip("torch")
    kornia = pytest.importorskip("kornia")
    image = RNG.uniform(0.01, 1, size=(3, 512, 512)).astype(np.float32)
    tensor = torch.from_numpy(image)
    report(
        "gamma 512x512",
        {
            "ours, power": compiled("power", lambda x: gamma_encode(x, f32(2.2)), image),
            "ours, exp2": compiled(
                "exp2", lambda x: gamma_encode(x, f32(2.2), method="exp2"), image
            ),
            "kornia": lambda: kornia.enhance.adjust_gamma(tensor, 1 / 2.2).numpy(),
        },
        2e-6,
    )
