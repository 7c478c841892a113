"""A raw frame of 4000 x 3000 pixels, float32: what each source of noise costs, all of them, and a
CCD; the three ways to count electrons beside NumPy's.

    pytest tests/benchmarks/bench_sensor.py -m benchmark -s
"""

import time
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.sensors import OF_PHOTONS
from turns import in_turns

from jaxvision import as_dtype
from jaxvision import scene as s
from jaxvision.sensor import raw_image

ROUNDS = 5
SHAPE = (3000, 4000, 1)
AIM = 1.5  # seconds, all sources, on two cores
KEY, DIE = jax.random.split(jax.random.key(0))
ALL = replace(
    OF_PHOTONS,
    exposure_time=0.01,
    crosstalk=None,
    smear=None,
    blooming=None,
    charge_transfer=None,
    gain=0.4,
    bits=12,
)
LINEAR = s.Sensor(exposure_time=0.01, quantum_efficiency=0.5, gain=0.4, offset=64.0, bits=12)
ALONE = (
    "prnu",
    "dead_pixels",
    "hot_pixels",
    "conversion_prnu",
    "dsnu",
    "column_dsnu",
    "row_dsnu",
    "reset_noise",
    "read_noise",
    "telegraph_noise",
    "row_noise",
    "banding",
    "column_prnu",
)
COUNTING = {
    "shot, Gaussian": s.GaussianShotNoise(),
    "shot, fast Poisson": s.FastPoissonShotNoise(),
    "shot, exact Poisson": s.PoissonShotNoise(),
}


def compiled(sensor: s.Sensor, light: jax.Array):
    """(the call, seconds to compile, MB of memory beside input and output)."""
    sensor = as_dtype(sensor, jnp.float32)
    start = time.perf_counter()
    call = jax.jit(raw_image).lower(KEY, sensor, light, die_key=DIE).compile()
    taken = time.perf_counter() - start
    memory = call.memory_analysis().temp_size_in_bytes / 1e6
    return (lambda: call(KEY, sensor, light, die_key=DIE)), taken, memory


@pytest.mark.benchmark
@pytest.mark.parametrize("electrons", [5.0, 1000.0])
def test_a_frame_of_twelve_megapixels(electrons):
    light = jnp.full(SHAPE, electrons / 0.005, jnp.float32)
    sensors = {"no noise": LINEAR}
    sensors |= {name: replace(LINEAR, **{name: getattr(ALL, name)}) for name in ALONE}
    sensors |= {name: replace(LINEAR, shot_noise=kind) for name, kind in COUNTING.items()}
    sensors |= {
        "all, fast Poisson": ALL,
        "all, exact Poisson": replace(ALL, shot_noise=s.PoissonShotNoise()),
        "crosstalk": replace(LINEAR, crosstalk=0.01),
        "smear": replace(LINEAR, smear=1e-6),
        "blooming": replace(LINEAR, full_well=1e4, blooming=1.0),
        "charge transfer": replace(LINEAR, charge_transfer=s.ChargeTransfer(1e-5)),
    }
    calls, compile_seconds, memory = {}, {}, {}
    for name, sensor in sensors.items():
        calls[name], compile_seconds[name], memory[name] = compiled(sensor, light)
    rng = np.random.default_rng(0)
    calls["NumPy Poisson"] = lambda: rng.poisson(electrons, SHAPE)
    _, seconds = in_turns(calls, rounds=ROUNDS)
    print(f"\n4000 x 3000 at {electrons:g} electrons   seconds  more than none  compile  memory")
    for name, taken in seconds.items():
        print(
            f"{name:22s} {taken:21.3f} {taken - seconds['no noise']:15.3f} "
            f"{compile_seconds.get(name, 0):8.2f} {memory.get(name, 0):5.0f} MB"
        )
    fast, exact = (np.asarray(calls[f"shot, {kind} Poisson"]()) for kind in ("fast", "exact"))
    # 12 million draws know the mean to 3e-4 deviations: equal within 6 of these
    assert abs(fast.mean() - exact.mean()) < 6 * exact.std() * np.sqrt(2 / exact.size)
    assert seconds["all, fast Poisson"] < AIM
