"""Compare the cost of surface functions in float32 with that in float64 rounded to float32.

    pytest tests/benchmarks/bench_precision.py -m benchmark --benchmark-enable -s

The errors are those at a million random points against float64, in ULP."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision.brdf.fresnel import fresnel_conductor, fresnel_dielectric
from jaxvision.brdf.microfacet import normal_distribution

COUNT, ROUNDS = 1_000_000, 15
ROUGHNESS = 0.3

FUNCTIONS = {
    "fresnel_dielectric": lambda c, eta, k, h: fresnel_dielectric(c, eta),
    "fresnel_conductor": lambda c, eta, k, h: fresnel_conductor(c, eta, k),
    "normal_distribution (ggx)": lambda c, eta, k, h: normal_distribution(
        h, jnp.full(2, ROUGHNESS, h.dtype), distribution="ggx"
    ),
}


def drawn():
    """Return random cosines, refractive indices and normals above the horizon, in float32."""
    rng = np.random.default_rng(0)
    h = rng.normal(size=(COUNT, 3))
    h[:, 2] = np.abs(h[:, 2])
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    indices = rng.uniform(1.1, 3, (COUNT, 1)), rng.uniform(0.1, 4, (COUNT, 1))
    return [jnp.asarray(x, jnp.float32) for x in (rng.uniform(0, 1, COUNT), *indices, h)]


@pytest.mark.benchmark
@pytest.mark.parametrize("name", FUNCTIONS)
def test_digits_against_time(name, capsys):
    many, given = jax.vmap(FUNCTIONS[name]), drawn()

    def widened(*args):
        return many(*(x.astype(jnp.float64) for x in args))

    programs = {
        "float32": jax.jit(many),
        "float64 inside": jax.jit(lambda *args: widened(*args).astype(jnp.float32)),
    }
    exact = np.asarray(jax.jit(widened)(*given))
    unit = np.spacing(np.abs(exact).astype(np.float32)).astype(float)
    rivals = {which: lambda run=run: run(*given) for which, run in programs.items()}
    _, seconds = in_turns(rivals, rounds=ROUNDS, title=name)
    errors = {
        w: np.max(np.abs(np.asarray(r(), np.float64) - exact) / unit) for w, r in rivals.items()
    }
    assert errors["float64 inside"] <= 0.5 < errors["float32"]
    with capsys.disabled():
        for which in rivals:
            print(
                f"\n{name}, {which}: {errors[which]:.2f} ULP, {1e3 * seconds[which]:.2f} ms", end=""
            )
