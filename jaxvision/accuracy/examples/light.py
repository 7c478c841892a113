"""Example problems for light transport: paths, patches, area lights, tables of directions and
spectra."""

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
from ...render_command import change_resolution
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
from . import problem_of

SIDE = 48  # pixels
PATCH = 0.15  # m, in the Cornell box
UP = np.array([0.0, 0.0, 1.0])
VIEWER = np.array([0.6, 0.0, 0.8])


@cache
def _box() -> SceneFile:
    return read_scene("cornell_box")


def _paths(method: Callable[[Any], Paths], knob: str) -> Problem:
    """Make a problem of path tracing in the Cornell box. The rows of the picture with the lamp are
    left out, because errors at the lamp's edges would dominate."""
    view = change_resolution(_box().view, (SIDE, SIDE))

    def make(setting: Any) -> Callable[[jax.Array], jax.Array]:
        traced = partial(path_traced, scene=_box().scene, view=view, method=method(setting))
        return lambda key: traced(key).radiance[SIDE // 3 :]

    return problem_of("Cornell box, 16 paths a pixel", knob, make, seeded=True)


def _form_factors() -> Problem:
    scene = _box().scene
    plan = plan_patches(scene, size=PATCH)
    return problem_of(
        "patches of the Cornell box",
        "form factor rays",
        lambda rays: lambda scene: form_factor_table(scene, plan, rays=rays),
        scene,
    )


def _progressive() -> Problem:
    """Make a radiosity problem of a cube of 96 patches with random form factors."""
    rng = np.random.default_rng(0)
    factors = rng.uniform(0.5, 1.5, (96, 96))
    factors = (factors + factors.T) * (1 - np.eye(96))
    table = jnp.asarray(factors / factors.sum(axis=1).max())
    albedo = jnp.asarray(rng.uniform(0.2, 0.8, (96, 3)))
    sent = jnp.asarray(np.eye(96)[:, :1] * np.ones(3))
    solve = partial(solve_radiosity, method="progressive", limit=100_000)
    return problem_of(
        "96 patches",
        "radiosity solver",
        lambda tolerance: partial(solve, tolerance=tolerance),
        table,
        albedo,
        sent,
        exact=np.asarray(solve_radiosity(table, albedo, sent)),
    )


def _adaptive() -> Problem:
    """Make a problem of a floor under a lamp, compared with Lambert's closed form."""
    lamp = RectangleLight((-0.5, -0.5, 0.6), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), radiance=(1.0,))
    x, y = np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(-1, 1, SIDE))
    points = jnp.asarray(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1))
    exact = jax.vmap(lambda point: rectangle_irradiance(lamp, point, jnp.asarray(UP)))(points)
    return problem_of(
        "a floor under a lamp",
        "adaptive nodes",
        lambda tolerance: partial(adaptive_irradiance, tolerance=tolerance),
        lamp,
        points,
        jnp.asarray(UP),
        exact=np.asarray(exact),
    )


def _gloss(alpha: float) -> TorranceSparrow:
    return TorranceSparrow([0.1], [1.0], alpha)


def _hemisphere() -> Problem:
    def sky(wi: Any) -> jax.Array:
        return (1 + wi[2] + 0.5 * wi[0])[None]

    def make(polar: int) -> Callable[[jax.Array], jax.Array]:
        gloss, up = _gloss(0.3), jnp.asarray(UP)
        return lambda wo: (
            hemisphere_radiance(gloss, sky, up, wo, polar=polar, azimuths=2 * polar).value
        )

    return problem_of("gloss under a sky", "hemisphere", make, jnp.asarray(VIEWER))


def _polygons() -> Problem:
    """Make a problem of the form factor between two squares that meet at a right angle."""
    floor = [as_vec(jnp.asarray(c, float)) for c in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))]
    wall = [as_vec(jnp.asarray(c, float)) for c in ((0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1))]
    return problem_of(
        "floor and wall",
        "polygon form factor",
        lambda order: lambda a, b: polygon_to_polygon(a, b, order=order).value[None],
        tuple(floor),
        tuple(wall),
    )


def _sampler() -> Problem:
    """Make a problem of the sky light that a tabulated BRDF reflects. Each estimate uses 64
    directions drawn from a sampling table of the BRDF."""
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
            def estimate(key: Any) -> jax.Array:
                return sampled_radiance(
                    key, material, sky, jnp.asarray(UP), jnp.asarray(VIEWER), samples=64
                ).value

            return jax.vmap(estimate)(keys)

        return lambda seed: run(jax.random.split(jax.random.key(seed), 256))

    fine = hemisphere_radiance(
        table, sky, jnp.asarray(UP), jnp.asarray(VIEWER), polar=256, azimuths=512
    )
    return Problem("a measured lobe under a sky", prepare, exact=np.asarray(fine.value))


def _bands() -> Problem:
    """Make a problem of D65 through a filter, over the number of sampled wavelengths."""

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
