"""Errors of a quadrature on receivers near a rectangle, by comparison with the closed form.

The samples of an edge of length s lie too far apart for receivers at a distance below about .02 s
at order 8.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..core._numerics import dot
from ..core._types import is_known
from ..core._vector import Vector, as_array, as_vec
from ..core._warnings import warn_caller
from ..scene import Box, Disc, Light, Plane, Quad, Shape, Sphere, Surface, TriangleMesh
from ._nodes import square_nodes
from .polygon import rectangle_irradiance
from .rectangle import RectangleLight, rectangle_sample
from .rules import Quadrature, Rule

# Errors of the irradiance above this fraction of the irradiance on surfaces that face the light are
# reported.
MISSED = 0.1
_ROUGH = 3  # there is no warning up to this order, which users choose for speed
_NEAR = 1 / 64  # of the longer edge; `window` maps the edges in the same way for all nearer points
_ON = 1e-5  # of the longer edge; the rectangle is mounted on a surface that is nearer
_SIDE = 9  # receivers along each side of a rectangle
_FACES = 256  # largest number of triangles on which each position of the light is projected


class Near(NamedTuple):
    """The receiver near a rectangle at which a quadrature has its largest error: its true
    irradiance, and the irradiance by the quadrature, W m^-2."""

    distance: float  # m, from the rectangle
    true: float
    found: float
    rule: Quadrature

    def sentence(self, name: str) -> str:
        """Describe the error of the quadrature for the light of this name."""
        return (
            f"{'Missing' if self.found < self.true else 'Too much'}: light of {name} at "
            f"{self.distance:.3g} m from it, where its irradiance is {self.true:.3g} W/m^2 and "
            f"quadrature of order {self.rule.order} finds {self.found:.3g}, "
            f"{self.found / self.true:.2g} times as much: so near, its samples lie too far apart."
        )


def found_near(
    light: RectangleLight,
    rule: Quadrature,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    least: float = 0.0,
) -> Near | None:
    """Compare a quadrature of a rectangle with the closed form. If the mean error over the
    receivers is large, return the receiver with the largest error, otherwise None. `points` are (n,
    3) m, and `normals` (n, 3) unit. Receivers whose distance is at most `least` times the longer
    edge are ignored. No ray is traced."""
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.edge_u, light.edge_v))
    size = max(np.linalg.norm(u), np.linalg.norm(v))
    across = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    height = (points - corner) @ across
    distances = _distances(points - corner, u, v)
    used = height > least * size
    if not used.any() or not _may_fail(distances[used].min() / size, rule.order):
        return None
    points, normals, distances = points[used], normals[used], distances[used]
    at, turned, back = (jnp.asarray(x, light.corner.dtype) for x in (points, normals, -across))
    compared = _compare_irradiances(light, at, turned, back, rule.order)
    true, found, facing = (np.asarray(x, float) for x in compared)
    if not np.abs(found - true).sum() > MISSED * facing.sum():
        return None
    worst = np.argmax(np.abs(found - true))
    return Near(float(distances[worst]), float(true[worst]), float(found[worst]), rule)


def _distances(offsets: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the distances of points from a rectangle, (n,) m, by their offsets from its corner."""
    for edge in (u, v):
        share = np.clip(offsets @ edge / (edge @ edge), 0, 1)
        offsets = offsets - share[:, None] * edge
    return np.linalg.norm(offsets, axis=-1)


def _may_fail(nearest: float, order: int) -> bool:
    """Whether the error at a distance, in units of the longer edge, may exceed 10 %, by the formula
    of `orders.order_for`."""
    pole = math.pi / 2 / math.asinh(0.5 / nearest)
    needed = math.log(100 / 0.1) / (2 * math.log(pole + math.hypot(1, pole)))
    return nearest < _NEAR or needed > order


@eqx.filter_jit
def _compare_irradiances(
    light: RectangleLight, points: Array, normals: Array, facing: Array, order: int
) -> tuple[Float[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Return three irradiances of each receiver, each (n,) W m^-2, averaged over the bands: the
    closed form, the result of a quadrature, and the closed form for a receiver that faces the
    light."""
    nodes, weights = (jnp.asarray(x, points.dtype) for x in square_nodes(order))

    def compare_receiver(point: Array, normal: Array) -> tuple[Array, Array, Array]:
        arriving = jax.vmap(lambda u: rectangle_sample(light, point, u))(nodes)
        cosines = jax.vmap(lambda wi: jnp.maximum(dot(normal, wi), 0))(arriving.direction)
        found = ((weights * cosines)[:, None] * arriving.irradiance).sum(0)
        true, most = (rectangle_irradiance(light, point, n) for n in (normal, facing))
        return true.mean(), found.mean(), most.mean()

    return jax.vmap(compare_receiver)(points, normals)


def warn_of_near_receiver(
    lights: Sequence[Light], rules: Sequence[Rule], point: Vector, normal: Vector, cure: str
) -> None:
    """Warn of the first rectangle for which a quadrature is far too dark or too bright at a
    receiver, m. Lights and receivers that JAX traces are not checked. `cure` is a sentence that
    says what to do."""
    point, normal = (as_array(as_vec(x)) for x in (point, normal))
    if not (is_known(point) and is_known(normal)) or point.ndim > 1:
        return
    receiver = np.asarray(point, float)[None], np.asarray(normal, float)[None]
    for i, light, rule in _sampled_rectangles(lights, rules):
        with jax.ensure_compile_time_eval():  # known values may occur inside a trace
            wrong = found_near(light, rule, *receiver)
        if wrong is not None:
            warn_caller(f"{wrong.sentence(f'lights[{i}]')} {cure}")
            return


def warn_of_near_surfaces(
    lights: Sequence[Light], rules: Sequence[Rule], surfaces: Sequence[Surface], cure: str
) -> None:
    """Warn of the first rectangle for which a quadrature is far too dark or too bright on a
    surface. Lights and surfaces that JAX traces are not checked. `cure` is a sentence that says
    what to do."""
    known = [s for s in surfaces if all(map(is_known, jax.tree.leaves(s.shape)))]
    for i, light, rule in _sampled_rectangles(lights, rules):
        with jax.ensure_compile_time_eval():
            wrong = found_on_surfaces(light, rule, known)
        if wrong is not None:
            warn_caller(f"{wrong.sentence(f'lights[{i}]')} {cure}")
            return


def found_on_surfaces(
    light: RectangleLight, rule: Quadrature, surfaces: Sequence[Surface]
) -> Near | None:
    """Return the result of `found_near` for the first surface on which the error is large; None if
    there is no such surface. Occlusion is ignored."""
    for surface in surfaces:
        for points, normals in _receivers(surface.shape, light):
            normals = _orient_normals(normals, light, surface)
            found = found_near(light, rule, points, normals, least=_ON)
            if found is not None:
                return found
    return None


def _sampled_rectangles(
    lights: Sequence[Light], rules: Sequence[Rule]
) -> Iterator[tuple[int, RectangleLight, Quadrature]]:
    """Yield the rectangles that a quadrature samples and JAX does not trace, with their indices and
    rules."""
    for i, (light, rule) in enumerate(zip(lights, rules, strict=True)):
        if not (isinstance(light, RectangleLight) and isinstance(rule, Quadrature)):
            continue
        if rule.order > _ROUGH and all(map(is_known, jax.tree.leaves(light))):
            yield i, light, rule


def _orient_normals(normals: np.ndarray, light: RectangleLight, surface: Surface) -> np.ndarray:
    """Return the normals of a surface, flipped toward the plane of the light if the surface is
    two-sided."""
    if not surface.two_sided:
        return normals
    u, v = (np.asarray(x, float) for x in (light.edge_u, light.edge_v))
    return np.where((normals @ np.cross(u, v) > 0)[:, None], -normals, normals)


def _receivers(shape: Shape, light: RectangleLight) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, for each flat part of a shape, the points nearest to a grid of positions on a light,
    (n, 3) m, and their normals, (n, 3) unit."""
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.edge_u, light.edge_v))
    t = (np.arange(_SIDE) + 0.5) / _SIDE
    places = (corner + t[:, None, None] * u + t[None, :, None] * v).reshape(-1, 3)
    match shape:
        case Sphere():
            centre = np.asarray(shape.centre, float)
            away = places - centre
            length = np.linalg.norm(away, axis=-1, keepdims=True)
            normals = away / np.where(length > 0, length, 1)
            yield centre + float(shape.radius) * normals, normals
        case Plane():
            yield _project(places, np.asarray(shape.point, float), _unit(shape.normal))
        case Disc():
            centre, normal = np.asarray(shape.centre, float), _unit(shape.normal)
            points, normals = _project(places, centre, normal)
            inside = np.linalg.norm(points - centre, axis=-1) <= float(shape.radius)
            yield (
                np.concatenate([points[inside], centre[None]]),
                np.concatenate([normals[inside], normal[None]]),
            )
        case Quad():
            start, a, b = (np.asarray(x, float) for x in (shape.corner, shape.edge_u, shape.edge_v))
            yield _feet_on_flat(places, start, a, b, 1.0)
        case Box():
            axes = np.eye(3) if shape.rotation is None else np.asarray(shape.rotation, float)
            centre = np.asarray(shape.centre, float)
            sides = axes * np.asarray(shape.half_extents, float)[:, None]
            for i in range(3):
                for sign in (-1, 1):
                    a, b = 2 * sides[(i + 1) % 3], 2 * sign * sides[(i + 2) % 3]
                    yield _feet_on_flat(places, centre + sign * sides[i] - (a + b) / 2, a, b, 1.0)
        case TriangleMesh():
            corners = np.asarray(shape.vertices, float)[np.asarray(shape.faces)]
            if len(corners) > _FACES:
                across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
                length = np.linalg.norm(across, axis=-1, keepdims=True)
                yield corners.mean(1), across / np.where(length > 0, length, 1)
                return
            parts = [_feet_on_flat(places, c[0], c[1] - c[0], c[2] - c[0], 0.5) for c in corners]
            points, normals = zip(*parts, strict=True)
            yield np.concatenate(points), np.concatenate(normals)


def _unit(x: ArrayLike) -> np.ndarray:
    vector = np.asarray(x, float)
    return vector / (np.linalg.norm(vector) or 1)


def _project(
    places: np.ndarray, start: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the feet of perpendiculars on a plane, m, and the plane's normal for each foot."""
    points = places - ((places - start) @ normal)[:, None] * normal
    return points, np.broadcast_to(normal, points.shape)


def _feet_on_flat(
    places: np.ndarray, start: np.ndarray, a: np.ndarray, b: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the feet of perpendiculars that lie in a parallelogram, or in half of it (a triangle)
    if `share` is 0.5, and the middle of this shape."""
    normal = _unit(np.cross(a, b))
    points, _ = _project(places, start, normal)
    (s, t), *_ = np.linalg.lstsq(np.stack([a, b], 1), (points - start).T, rcond=None)
    inside = (s >= 0) & (t >= 0) & ((s + t <= 1) if share < 1 else (s <= 1) & (t <= 1))
    middle = start + (a + b) * (1 / 2 if share == 1 else 1 / 3)
    points = np.append(points[inside], middle[None], 0)
    return points, np.broadcast_to(normal, points.shape)
