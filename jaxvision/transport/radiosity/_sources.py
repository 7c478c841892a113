"""Tables of the reflectances and emissions of a scene's surfaces, and the direct irradiance from
its lights.

Emission is in W m^-2 sr^-1, irradiance in W m^-2, lengths are in m.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...brdf.lambert import Lambert
from ...core._loops.fusion import materialise
from ...core._numerics import divide, dot, normalize
from ...core._types import Colour, Scalar
from ...core._vector import Vec, as_array, as_vec
from ...core.parallel_loops import scan
from ...geometry import Shapes, Sorted, occluded, offset_origin, sorted_shapes
from ...geometry.hemisphere import cross
from ...lights import RectangleLight, Rule, incident_sample, light_nodes, lights_by_rule
from ...lights.polygon import rectangle_irradiance
from ...scene import Light, Quad, Scene

Table = Float[Array, "surfaces bands"]


def diffuse_of(scene: Scene, like: Array) -> Table:
    """Return `Lambert.diffuse` of all surfaces, sr^-1, broadcast to the bands of `like`."""
    materials = [surface.material for surface in scene.surfaces]  # all Lambertian
    return _stack([m.diffuse for m in materials if isinstance(m, Lambert)], like)


def emission_of(scene: Scene, like: Array) -> Table:
    """Return the emission of each surface (0 for a surface that emits no light), broadcast to the
    bands of `like`."""
    nothing = jnp.zeros(1, like.dtype)
    values = [surface.emission for surface in scene.surfaces]
    return _stack([nothing if value is None else value for value in values], like)


def _stack(values: Sequence[Array], like: Array) -> Table:
    bands = np.broadcast_shapes(like.shape[-1:], *(value.shape for value in values))
    return jnp.stack([jnp.broadcast_to(value, bands) for value in values])


def shapes_of(scene: Scene) -> Sorted:
    """Return all shapes of a scene, m, sorted for intersection with many rays."""
    return materialise(sorted_shapes, [surface.shape for surface in scene.surfaces])


def largest_of(shapes: Sorted) -> Scalar:
    """Return the largest coordinate of all shapes, m. Raise `ValueError` if there are no shapes."""
    if shapes.size is None:
        raise ValueError("radiosity needs at least one surface, got none.")
    return shapes.size


def sources_of(scene: Scene, size: Scalar) -> list[Light]:
    """Return the lights of a scene, and its emissive quads as rectangular lights slightly above
    their surfaces. `size` is the largest coordinate of all shapes, m."""
    lights = list(scene.lights)
    for surface in scene.surfaces:
        if surface.emission is None or not isinstance(surface.shape, Quad):
            continue
        quad = surface.shape
        edges = [(quad.edge_u, quad.edge_v), (quad.edge_v, quad.edge_u)]
        for u, v in edges[: 2 if surface.two_sided else 1]:
            normal = normalize(cross(u, v))
            above = offset_origin(quad.corner, normal, normal, size=4 * size)
            lights.append(RectangleLight(as_array(above), u, v, surface.emission))
    return lights


def irradiance_at(
    lights: Sequence[Light], shapes: Shapes, point: Vec, normal: Vec, rules: Sequence[Rule]
) -> Colour:
    """Return the direct irradiance of one point, (bands,), with shadows. For a rectangular light
    the irradiance is the exact contour integral times the visible share of the light. The sampling
    rule estimates this share, so it matters only in penumbras. Visibility has no gradient."""
    total = jnp.zeros(1, point.x.dtype)
    for _, group, rule in lights_by_rule(lights, rules):

        def light_irradiance(_: None, light: Light, rule: Rule = rule) -> tuple[None, Colour]:
            if not isinstance(light, RectangleLight):
                return None, _sum_nodes(light, shapes, point, normal, rule)[1]
            white = eqx.tree_at(lambda light: light.radiance, light, jnp.ones(1, point.x.dtype))
            met, passed = jax.lax.stop_gradient(_sum_nodes(white, shapes, point, normal, rule))
            share = divide(passed, met, met != 0)
            return None, rectangle_irradiance(light, point, normal) * share

        total = total + scan(light_irradiance, None, group)[1].sum(axis=0)
    return total


def _sum_nodes(
    light: Light, shapes: Shapes, point: Vec, normal: Vec, rule: Rule
) -> tuple[Colour, Colour]:
    """Return the irradiance from a light, as a sum over the nodes of a rule, without shadows and
    with shadows."""
    dtype = point.x.dtype

    def node_sum(node: tuple[Array, Array]) -> tuple[Colour, Colour]:
        arriving = incident_sample(light, rule, point, *node)
        wi = as_vec(arriving.direction)
        far = jnp.full((), jnp.inf, dtype)
        distance = far if arriving.distance is None else arriving.distance
        blocked = occluded(point, normal, wi, distance, shapes)
        met = arriving.irradiance * jnp.maximum(dot(normal, wi), 0)
        return met, jnp.where(blocked, 0, met)

    def add(sums: tuple[Colour, Colour], node: tuple[Array, Array]) -> tuple:
        return jax.tree.map(jnp.add, sums, node_sum(node)), None

    nodes = light_nodes(light, rule, dtype)
    nothing = jax.eval_shape(node_sum, jax.tree.map(lambda x: x[0], nodes))
    start = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), nothing)
    return scan(jax.checkpoint(add), start, nodes)[0]
