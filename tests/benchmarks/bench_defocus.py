"""What defocus costs: the lens sampled ray by ray, at growing numbers of rays, against the blur of
one sharp picture by its depth map. Error against time, on a foreground before a background.

    pytest tests/benchmarks/bench_defocus.py -m benchmark -s
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision import optics
from jaxvision import scene as s

ROUNDS = 5
RADIUS = 12
SIDES = (2, 4, 8, 16)  # squared, the rays of a pixel
REFERENCE = 48
VIEW = s.ThinLens(
    np.zeros(3, np.float32),
    np.eye(3, dtype=np.float32),
    np.float32(0.05),
    np.float32(3e-5),
    resolution=(192, 256),
    f_number=np.float32(2),
    focus_distance=np.float32(2),
)
# (depth, end of what it covers, how fine its pattern is)
PLANES = ((1.3, 0.0, 1.0), (3.0, np.inf, 1.5))


def along(ray) -> tuple[jax.Array, jax.Array]:
    """(colour, depth) of the first plane that the ray meets."""
    colour, depth = jnp.zeros(3, jnp.float32), jnp.asarray(jnp.inf, jnp.float32)
    for distance, end, fine in reversed(PLANES):
        x = ray.origin.x + ray.direction.x / ray.direction.z * distance
        y = ray.origin.y + ray.direction.y / ray.direction.z * distance
        phase = 400 * fine / distance * jnp.stack([x, y, x + y])
        colour = jnp.where(x < end, 0.5 + 0.4 * jnp.sin(phase), colour)
        depth = jnp.where(x < end, distance, depth)
    return colour, depth


def over_pixels(pixel: Callable) -> Callable[[], jax.Array]:
    lines = jax.vmap(jax.vmap(pixel, in_axes=(None, 0)), in_axes=(0, None))
    return partial(jax.jit(lines), *optics.pixel_grid(VIEW))


def sampled(side: int) -> Callable[[], jax.Array]:
    """The mean of side^2 rays a pixel, one at a time."""
    grid = (jnp.arange(side, dtype=jnp.float32) + 0.5) / side
    places = jnp.stack(jnp.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)

    def pixel(row, column):
        def add(i, total):
            return total + along(optics.view_ray(VIEW, row, column, u=places[i]))[0]

        return jax.lax.fori_loop(0, side * side, add, jnp.zeros(3, jnp.float32)) / side**2

    return over_pixels(pixel)


@pytest.mark.benchmark
def test_error_against_time():
    sharp, depth = over_pixels(lambda row, column: along(optics.view_ray(VIEW, row, column)))()
    rivals: dict[str, Callable[[], jax.Array]] = {
        f"lens, {side * side} rays": sampled(side) for side in SIDES
    }
    forms = {
        "gather": partial(optics.gather_defocus, radius=RADIUS),
        "scatter": partial(optics.scatter_defocus, radius=RADIUS),
        "layers, 2": partial(optics.layered_defocus, radius=RADIUS, layers=2),
        "layers, 8": partial(optics.layered_defocus, radius=RADIUS, layers=8),
    }
    rivals |= {
        name: partial(jax.jit(partial(form, VIEW)), sharp, depth) for name, form in forms.items()
    }
    truth = np.asarray(sampled(REFERENCE)())
    inner = (slice(RADIUS, -RADIUS), slice(RADIUS, -RADIUS))
    first, seconds = in_turns(rivals, rounds=ROUNDS)
    for name, run in rivals.items():
        error = np.sqrt(((np.asarray(run()) - truth)[inner] ** 2).mean())
        print(
            f"  {name:16s} {1e3 * seconds[name]:8.1f} ms   rms error {error:.4f}   "
            f"first call {first[name]:.1f} s"
        )
        assert error < np.sqrt(((np.asarray(sharp) - truth)[inner] ** 2).mean())
