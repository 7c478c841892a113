"""Compute the radiosity solution of a scene.

Irradiance and radiosity are in W m^-2, lengths in m. First, lights of any kind and emissive quads
illuminate the elements directly, with shadows. Then patches exchange the reflected light.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...core._arguments import takes_numbers
from ...core._loops.fusion import TILE, entries_per_step, one_program, vmap_in_tiles
from ...core._shown import Shown
from ...core._types import Colour
from ...core._vector import Vec
from ...geometry import Sorted
from ...lights import Quadrature, Rule, rules_of
from ...scene import Quad, Scene
from .._scene_warnings import warn_of_scene
from ._grid import Plan, parents_of
from ._receivers import mean_of_parts, receivers_of
from ._sources import (
    diffuse_of,
    emission_of,
    irradiance_at,
    largest_of,
    shapes_of,
    sources_of,
)
from .exchange import form_factor_table
from .patches import Patches, patch_means
from .solve import PatchSpectra, Product, solve_radiosity

DEFAULT_RULE = Quadrature(4)


class Solution(Shown):
    """The radiosity solution of a scene: the light that its patches exchange.

    Attributes:
        radiosity: (patches, bands) W m^-2.
        irradiance: (elements, bands) W m^-2 from all patches, without direct light.
        sent: (elements, bands) radiosity, W m^-2, without the emission of quads, which is treated
            as that of lights.
        covered: (elements,) whether the element lies inside another body, where there is no light.
    """

    radiosity: Float[Array, "patches bands"]
    irradiance: Float[Array, "elements bands"]
    sent: Float[Array, "elements bands"]
    covered: Bool[Array, " elements"]


@takes_numbers
def radiosity(
    scene: Scene,
    plan: Plan,
    *,
    table: Float[Array, "elements patches"] | Product | None = None,
    rule: Rule = DEFAULT_RULE,
    method: str = "direct",
    rays: int = 1,
) -> Solution:
    """Compute the light that the patches of a scene exchange.

    An emissive quad illuminates the scene as a `RectangleLight`. The light of any other emissive
    surface is exchanged between patches. The ambient term is a substitute for interreflections and
    is ignored here.

    Args:
        scene: bounded surfaces of `Lambert` material, and any lights.
        plan: from `plan_patches`.
        table: (elements, patches) from `form_factor_table`; give it if only colours change. If the
            table is too large for memory, give a function from the radiosity of patches, (patches,
            bands), to the irradiance of elements, (elements, bands), both W m^-2, such as
            `exchanged` of this scene and plan, with the method "iterative". None computes the
            table.
        rule: sampling rule for extended lights without a rule of their own, see
            `direct_irradiance`.
        method: static, see `solve_radiosity`.
        rays: static, shadow rays for each pair, used if the table is computed here.

    Returns:
        Radiosity and irradiance, W m^-2.

    Raises:
        ValueError: for a scene without surfaces, an unknown method, or a method that needs a table
            where a function is given.
    """
    # A function given by the caller may change from call to call, so it is not compiled and cached.
    warn_of_scene(scene)
    solve = _solve if callable(table) else _solved_by_table
    return solve(scene, plan, table, rule, method, rays)


def _solve(
    scene: Scene,
    plan: Plan,
    table: Float[Array, "elements patches"] | Product | None,
    rule: Rule,
    method: str,
    rays: int,
) -> Solution:
    shapes = shapes_of(scene)
    receivers = receivers_of(scene, plan, shapes)
    given = form_factor_table(scene, plan, rays=rays) if table is None else table
    parts = _direct_irradiance(scene, receivers.parts, rule, shapes)
    direct = mean_of_parts(parts, receivers.parts, plan)
    surface = receivers.patches.surface
    albedo = jnp.pi * diffuse_of(scene, direct)[surface]
    emitted = jnp.pi * emission_of(scene, direct)
    flat = jnp.asarray([isinstance(surface.shape, Quad) for surface in scene.surfaces])
    by_patches = jnp.where(flat[:, None], 0, emitted)[surface]
    by_lights = jnp.where(flat[:, None], emitted, 0)[surface]
    first = by_patches + albedo * patch_means(direct, receivers.elements, plan)

    def distribute(leaving: PatchSpectra) -> Float[Array, "elements bands"]:
        return given(leaving) if callable(given) else given @ leaving

    def mean_received(leaving: PatchSpectra) -> PatchSpectra:
        return patch_means(distribute(leaving), receivers.elements, plan)

    exchange = mean_received if callable(given) else patch_means(given, receivers.elements, plan)
    solved = solve_radiosity(exchange, albedo, first, method=method)
    irradiance, own = distribute(solved), jnp.asarray(parents_of(plan))
    sent = by_patches[own] + albedo[own] * (direct + irradiance)
    return Solution(solved + by_lights, irradiance, sent, receivers.elements.area <= 0)


_solved_by_table = one_program(_solve)


@one_program
def direct_irradiance(
    scene: Scene, elements: Patches, *, rule: Rule = DEFAULT_RULE
) -> Float[Array, "elements bands"]:
    """Compute the direct irradiance of each element from lights and emissive quads, with shadows.

    Args:
        scene: surfaces and lights.
        elements: from `patches_of`.
        rule: sampling rule that determines partial shadows. Light from unblocked rectangles is
            exact under any rule.

    Returns:
        (elements, bands) W m^-2.
    """
    return _direct_irradiance(scene, elements, rule, shapes_of(scene))


def _direct_irradiance(
    scene: Scene, elements: Patches, rule: Rule, shapes: Sorted
) -> Float[Array, "elements bands"]:
    lights = sources_of(scene, largest_of(shapes))

    def element_irradiance(point: Vec, normal: Vec, number: Int[Array, ""]) -> Colour:
        rules = rules_of(scene, rule, numbers=(number,), count=len(lights))
        return irradiance_at(lights, shapes, point, normal, rules)

    start = elements.centre + elements.bulge * elements.normal
    return vmap_in_tiles(
        element_irradiance,
        start,
        elements.normal,
        jnp.arange(len(elements.area)),
        size=entries_per_step(TILE),
    )
