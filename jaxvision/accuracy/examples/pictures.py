"""Example problems for image processing: filters, mattes and curves, on a synthetic picture."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ... import filters
from ...matting import closed_form_matte, estimate_foreground
from ...optics import sample_image
from ...point_ops import gamma_decode, lookup
from ..records import Problem
from . import problem_of

SIDE = 96  # pixels
SIGMA = 2.0


@cache
def picture() -> np.ndarray:
    """Return a synthetic picture, (SIDE, SIDE, 3), relative, with ramps, a disc with a sharp edge,
    and a texture."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    disc = np.hypot(x - 0.5, y - 0.45) < 0.28
    texture = 0.08 * np.sin(40 * x) * np.cos(31 * y)
    bands = [0.2 + 0.5 * x, 0.5 * y + 0.1, 0.4 + 0.2 * x * y]
    return np.stack([np.where(disc, 0.9 - band, band) + texture for band in bands], axis=-1)


def _filter_problem(name: str, function: Callable[[Any, Any], Any], knob: str) -> Problem:
    """Make a problem that applies a function of an image and a setting to the synthetic picture."""

    return problem_of(
        name, knob, lambda setting: lambda x: function(x, setting), jnp.asarray(picture())
    )


def _method() -> Problem:
    kernel = np.random.default_rng(0).uniform(size=(15, 15))

    def function(image: jax.Array, method: str) -> jax.Array:
        return filters.correlate(image, jnp.asarray(kernel / kernel.sum()), method=method)

    return _filter_problem("15 x 15 kernel", function, "filter method")


def _cut() -> Problem:
    return _filter_problem(
        "Gaussian blur",
        lambda image, cut: filters.gaussian(image, SIGMA, truncate=cut),
        "Gaussian cut",
    )


def _rank() -> Problem:
    y, x = np.mgrid[-10:11, -10:11]
    disc = jnp.asarray(np.clip(9.5 - np.hypot(x, y), 0, 1))
    kernel = disc / disc.sum()

    def function(image: jax.Array, rank: int) -> jax.Array:
        return filters.correlate_low_rank(image, filters.low_rank(kernel, rank=rank))

    return _filter_problem("disc of 21 pixels", function, "kernel rank")


def _members() -> Problem:
    x = jnp.asarray(np.mgrid[:SIDE, :SIDE][1] / SIDE)

    def function(image: jax.Array, members: int) -> jax.Array:
        bank = filters.blur_sigmas(0.0, 6.0, members=members)
        return filters.gaussian_varying(image, 6 * x, sigmas=bank)

    return _filter_problem("blur that varies", function, "bank members")


def _bilateral() -> Problem:
    return _filter_problem(
        "bilateral filter",
        lambda image, radius: filters.bilateral_filter(image, SIGMA, 0.1, radius=radius),
        "bilateral radius",
    )


def _layer() -> tuple[np.ndarray, np.ndarray]:
    """Return an image of a soft-edged disc in front of a ramp, and the coverage of the disc."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    alpha = np.clip((0.3 - np.hypot(x - 0.5, y - 0.5)) * 20 + 0.5, 0, 1)[..., None]
    front = np.stack([0.8 + 0 * x, 0.2 + 0.3 * y, 0.1 + 0.2 * x], axis=-1)
    return alpha * front + (1 - alpha) * picture() * 0.5, alpha


def _matte() -> Problem:
    image, alpha = _layer()
    trimap = jnp.where(alpha <= 0.0, 0.0, jnp.where(alpha >= 1.0, 1.0, 0.5))[..., 0]
    solve = partial(closed_form_matte, trimap=trimap, max_steps=2000)
    return problem_of(
        "closed-form matte",
        "matting solver",
        lambda tolerance: lambda image: solve(image, tolerance=tolerance).alpha,
        jnp.asarray(image),
    )


def _foreground() -> Problem:
    def make(steps: int) -> Callable[[jax.Array, jax.Array], jax.Array]:
        return lambda image, alpha: alpha * estimate_foreground(image, alpha, fine_steps=steps)[0]

    return problem_of("foreground colours", "foreground steps", make, *map(jnp.asarray, _layer()))


def _power() -> Problem:
    return _filter_problem(
        "gamma of 2.2",
        lambda image, method: gamma_decode(jnp.clip(image, 0, 1), 2.2, method=method),
        "power method",
    )


def _interpolation() -> Problem:
    """Make a problem that interpolates sinusoids of 9 and 13 pixels."""
    places = np.linspace(4.0, SIDE - 5.0, SIDE)

    def waves(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (0.5 + 0.3 * np.sin(2 * np.pi * x / 9) * np.cos(2 * np.pi * y / 13))[..., None]

    image, within = waves(*np.mgrid[:SIDE, :SIDE]), np.meshgrid(places, places, indexing="ij")

    rows, columns = (jnp.asarray(axis) for axis in within)
    return problem_of(
        "waves between pixels",
        "interpolation",
        lambda word: lambda image: sample_image(image, rows, columns, interpolation=word),
        image,
        exact=waves(*within),
    )


def _table() -> Problem:
    def function(image: jax.Array, entries: int) -> jax.Array:
        table = jnp.sqrt(0.01 + jnp.linspace(0.0, 1.0, entries))
        return lookup(jnp.clip(image, 0, 1), table)

    return _filter_problem("tone curve", function, "curve table")


EXAMPLES = {
    "filter method": _method,
    "Gaussian cut": _cut,
    "kernel rank": _rank,
    "bank members": _members,
    "bilateral radius": _bilateral,
    "matting solver": _matte,
    "foreground steps": _foreground,
    "interpolation": _interpolation,
    "power method": _power,
    "curve table": _table,
}
