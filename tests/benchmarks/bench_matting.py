"""Compare closed-form matting and foreground estimation with pymatting (Numba) on one picture,
trimap, epsilon and confidence: time, and error against the true matte.

    pytest tests/benchmarks/bench_matting.py -m benchmark -s
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision.matting import closed_form_matte

ROUNDS = 5
RNG = np.random.default_rng(0)


def scene(side: int) -> tuple[np.ndarray, ...]:
    """Return (picture, trimap, alpha) of a wavy disc with a soft edge over another smooth
    texture."""
    y, x = np.mgrid[:side, :side] / side
    edge = 0.3 + 0.04 * np.sin(9 * np.arctan2(y - 0.5, x - 0.5))
    outside = np.hypot(y - 0.5, x - 0.5) - edge
    alpha = np.clip(0.5 - outside * side / 8, 0, 1)
    front = np.stack([0.8 + 0.1 * np.sin(20 * x), 0.4 + 0.2 * y, 0.2 + 0.1 * x], axis=-1)
    behind = np.stack([0.1 + 0.2 * y, 0.3 + 0.2 * np.sin(15 * x) * y, 0.7 - 0.2 * x], axis=-1)
    front += RNG.normal(0, 0.01, size=front.shape)
    behind += RNG.normal(0, 0.01, size=front.shape)
    seen = alpha[..., None] * front + (1 - alpha[..., None]) * behind
    trimap = np.where(outside < -18 / side, 1.0, np.where(outside > 18 / side, 0.0, 0.5))
    return seen, trimap, alpha


def table(rivals: dict[str, Callable[[], object]], note: Callable[[str], str]) -> dict[str, float]:
    """Return the median seconds of each program, and print the first call separately."""
    first, seconds = in_turns(rivals, rounds=ROUNDS)
    for name, s in seconds.items():
        print(
            f"  {name:12s} {1e3 * s:8.1f} ms   {s / seconds['pymatting']:5.2f} of pymatting   "
            f"first call {first[name]:5.1f} s   {note(name)}"
        )
    return seconds


@pytest.mark.benchmark
@pytest.mark.parametrize("side", [256, 512])
def test_closed_form(side):
    pymatting = pytest.importorskip("pymatting")
    seen, trimap, alpha = scene(side)
    solve = jax.jit(closed_form_matte)
    double = [jnp.asarray(a) for a in (seen, trimap)]
    single = [a.astype(jnp.float32) for a in double]
    rivals = {
        "float64": lambda: solve(*double).alpha[..., 0],
        "float32": lambda: solve(*single).alpha[..., 0],
        "pymatting": lambda: pymatting.estimate_alpha_cf(seen, trimap),
    }
    unknown = trimap == 0.5
    errors = {
        name: float(np.abs(np.asarray(run()) - alpha)[unknown].mean())
        for name, run in rivals.items()
    }
    table(rivals, lambda name: f"mean error {errors[name]:.5f}")
    assert errors["float64"] < 1.05 * errors["pymatting"]
