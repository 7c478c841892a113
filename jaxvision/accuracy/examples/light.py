"""Paths, patches, area lights, tables of directions and spectra."""

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...brdf.measured import IsotropicTable, samples_of, tabulate_sampler
from ...brdf.torrance_sparrow import TorranceSparrow
from ...colour_spaces.colour_data import illuminant, observer
from ...core._vector import as_vec
from ...files.scenes import SceneFile, read_scene
from ...lights import RectangleLight
from ...lights.adaptive import adaptive_irradiance
from ...lights.polygon import rectangle_irradiance
from ...render_command import with_resolution
from ...rendering.hemisphere_integral import hemisphere_radiance, sampled_radiance
from ...spectra import integrate_spectrum
from ...transport import Paths, path_traced
from ...transport.radiosity import (
    form_factor_table,
    plan_patches,
    polygon_to_polygon,
    solve_radiosity,
)
from ..records import Compute, Problem

SIDE = 48  # pixels
PATCH = 0.15  # m, in the Cornell box
UP = np.array([0.0, 0.0, 1.0])
VIEWER = np.array([0.6, 0.0, 0.8])


@cache
def _box() -> SceneFile:
    return read_scene("cornell_box")


def _paths(method: Callable[[Any], Paths], knob: str) -> Problem:
    """The Cornell box by path tracing, cropped below its lamp, whose edges would dominate the
    error."""
    view = with_resolution(_box().view, (SIDE, SIDE))

    def prepare(settings: Mapping[str, Any]) -> Compute:
        chosen = method(settings[knob])
        run = jax.jit(
            lambda key: path_traced(key, _box().scene, view, method=chosen).radiance[SIDE // 3 :]
        )
        return lambda seed: run(jax.random.key(seed))

    return Problem("Cornell box, 16 paths a pixel", prepare)


def _form_factors() -> Problem:
    scene = _box().scene
    plan = plan_patches(scene, size=PATCH)

    def prepare(settings: Mapping[str, Any]) -> Compute:
        rays = settings["form factor rays"]
        run = jax.jit(lambda scene: form_factor_table(scene, plan, rays=rays))
        return lambda seed: run(scene)

    return Problem("patches of the Cornell box", prepare)


def _progressive() -> Problem:
    """A closed cube of 96 patches, with equal form factors except within a wall."""
    rng = np.random.default_rng(0)
    factors = rng.uniform(0.5, 1.5, (96, 96))
    factors = (factors + factors.T) * (1 - np.eye(96))
    table = jnp.asarray(factors / factors.sum(axis=1).max())
    albedo = jnp.asarray(rng.uniform(0.2, 0.8, (96, 3)))
    sent = jnp.asarray(np.eye(96)[:, :1] * np.ones(3))

    def prepare(settings: Mapping[str, Any]) -> Compute:
        tolerance = settings["radiosity solver"]
        run = jax.jit(
            partial(solve_radiosity, method="progressive", tolerance=tolerance, limit=100_000)
        )
        return lambda seed: run(table, albedo, sent)

    exact = np.asarray(solve_radiosity(table, albedo, sent))
    return Problem("96 patches", prepare, exact=exact)


def _adaptive() -> Problem:
    """A floor under a lamp, compared with Lambert's closed form."""
    lamp = RectangleLight((-0.5, -0.5, 0.6), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), radiance=(1.0,))
    x, y = np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(-1, 1, SIDE))
    points = jnp.asarray(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1))

    def prepare(settings: Mapping[str, Any]) -> Compute:
        tolerance = settings["adaptive nodes"]
        run = jax.jit(partial(adaptive_irradiance, tolerance=tolerance))
        return lambda seed: run(lamp, points, jnp.asarray(UP))

    exact = jax.vmap(lambda point: rectangle_irradiance(lamp, point, jnp.asarray(UP)))(points)
    return Problem("a floor under a lamp", prepare, exact=np.asarray(exact))


def _gloss(alpha: float) -> TorranceSparrow:
    return TorranceSparrow([0.1], [1.0], alpha)


def _hemisphere() -> Problem:
    def sky(wi: Any) -> jax.Array:
        return (1 + wi[2] + 0.5 * wi[0])[None]

    def prepare(settings: Mapping[str, Any]) -> Compute:
        polar = settings["hemisphere"]
        run = jax.jit(
            lambda wo: (
                hemisphere_radiance(
                    _gloss(0.3), sky, jnp.asarray(UP), wo, polar=polar, azimuths=2 * polar
                ).value
            )
        )
        return lambda seed: run(jnp.asarray(VIEWER))

    return Problem("gloss under a sky", prepare)


def _polygons() -> Problem:
    """Two squares that touch at a right angle."""
    floor = [as_vec(jnp.asarray(c, float)) for c in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))]
    wall = [as_vec(jnp.asarray(c, float)) for c in ((0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1))]

    def prepare(settings: Mapping[str, Any]) -> Compute:
        order = settings["polygon form factor"]
        run = jax.jit(
            lambda first, second: polygon_to_polygon(first, second, order=order).value[None]
        )
        return lambda seed: run(tuple(floor), tuple(wall))

    return Problem("floor and wall", prepare)


def _sampler() -> Problem:
    """The light of a sky reflected by a tabulated lobe, from 64 directions drawn from its own
    table."""
    angles = jnp.asarray(np.linspace(0.01, 1.5, 16))
    samples = samples_of(_gloss(0.2), angles, angles, jnp.asarray(np.linspace(0, np.pi, 19)))

    def sky(wi: Any) -> jax.Array:
        return (1 + wi[2])[None]

    values = np.asarray(samples.values).reshape(16, 16, 19, -1)
    table = IsotropicTable(angles, angles, jnp.asarray(np.linspace(0, np.pi, 19)), values)

    def prepare(settings: Mapping[str, Any]) -> Compute:
        rows = settings["sampler table"]
        material = tabulate_sampler(table, rows=rows, columns=3 * rows)

        @jax.jit
        def run(keys: jax.Array) -> jax.Array:
            def one(key: Any) -> jax.Array:
                return sampled_radiance(
                    key, material, sky, jnp.asarray(UP), jnp.asarray(VIEWER), samples=64
                ).value

            return jax.vmap(one)(keys)

        return lambda seed: run(jax.random.split(jax.random.key(seed), 256))

    fine = hemisphere_radiance(
        table, sky, jnp.asarray(UP), jnp.asarray(VIEWER), polar=256, azimuths=512
    )
    return Problem("a measured lobe under a sky", prepare, exact=np.asarray(fine.value))


def _bands() -> Problem:
    """Tristimulus values of D65 through a filter, from samples at the given number of
    wavelengths."""

    def prepare(settings: Mapping[str, Any]) -> Compute:
        wavelengths = jnp.linspace(380e-9, 780e-9, settings["bands"])
        light, eye = illuminant("D65", wavelengths), observer(wavelengths)

        @jax.jit
        def run(light: jax.Array) -> jax.Array:
            passed = jnp.exp(-(((wavelengths - 560e-9) / 60e-9) ** 2))
            return integrate_spectrum((light * passed)[None, :] * eye.T, wavelengths)

        return lambda seed: run(light)

    return Problem("D65 through a filter", prepare)


EXAMPLES = {
    "roulette": lambda: _paths(lambda from_: Paths(16, 16, roulette=from_), "roulette"),
    "strategy": lambda: _paths(lambda word: Paths(16, 6, strategy=word), "strategy"),
    "form factor rays": _form_factors,
    "radiosity solver": _progressive,
    "adaptive nodes": _adaptive,
    "hemisphere": _hemisphere,
    "polygon form factor": _polygons,
    "sampler table": _sampler,
    "bands": _bands,
}
