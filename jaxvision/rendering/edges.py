"""The part of a picture's derivative that is due to moving edges: outlines of shapes and lamps, and
edges of shadows.

The value of a pixel is the mean of the radiance L over its square. If a parameter theta moves a
curve across which L is discontinuous, the derivative of the mean contains, besides the mean of dL /
d theta,

    sum of (L_behind - L_ahead) (dp / d theta . n) ds

over the part of the curve p in the pixel. Here ds is an element of the curve; the normal n points
from the side "behind" to the side "ahead". The curves are the outlines of shapes as seen from the
camera or a lamp, and have closed forms. The curve p(t) is differentiated with respect to theta at
fixed t. The discontinuity of L is measured by rays slightly to each side. An area lamp is treated
as a sum of point lamps: each node on an outline uses another point of the lamp.

Source: Li, Aittala, Durand, Lehtinen, "Differentiable Monte Carlo Ray Tracing through Edge
Sampling", ACM TOG 37(6) (2018). Unlike there, edges are sampled in proportion to their length in
the picture.

Lengths are in m. Positions p in the picture are in pixels (row, column).
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float, Int

from ..core._numerics import divide, dot, norm, normalize, or_one, safe_sqrt, sine_cosine
from ..core._shown import Shown
from ..core._types import Colour, Image, Scalar, check_count
from ..core._vector import as_array
from ..core._warnings import warn_caller
from ..geometry import (
    Encounter,
    Hit,
    Ray,
    Sorted,
    hit_shape,
    nearest_shape,
    occluded,
    sorted_shapes,
)
from ..geometry.hemisphere import cross, local_frame
from ..geometry.nearest import meets
from ..lights import (
    Incident,
    RectangleLight,
    Rule,
    can_be_seen,
    incident_sample,
    lights_by_rule,
)
from ..lights import (
    radiance_along as radiance_of,
)
from ..optics import project, view_ray
from ..scene import (
    Box,
    Disc,
    Light,
    Orthographic,
    Plane,
    Quad,
    Scene,
    Shape,
    Sphere,
    ThinLens,
    TriangleMesh,
    View,
)

_CELLS = 64  # pieces of a curve; nodes are distributed by their lengths in the picture
_PIECES = 8  # parts of the short straight stretch about a node; each adds to one pixel
_OF_AREA = 4  # factor for the number of nodes if the lamp has a size
_BESIDE = 1e-3  # distance from an outline to the rays that pass the shape, in sizes of the shape
_SEEN_BESIDE = 1e-2  # distance, in pixels, from a shadow's edge to rays that find its surface
_SIDES = np.array([-1.0, 1.0])  # behind and ahead of an edge, in the direction of its normal
_TURNS = 6  # iterations of Newton's method
_STRAIGHT, _RING, _LIMB, _HORIZON = range(4)
# For each type of curve, in sizes of the shape: the largest distance along a ray beside the edge
# from the edge to the shape
_NEAR = (1e-2, 1e-2, 0.5, np.inf)
# Steps of a Kronecker sequence in four dimensions, two for the lens and two for the lamp
_STEPS = np.array([0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101])


class Edges(Shown):
    """Include moving edges in the derivatives of `render`, which otherwise neglect them.

    The derivative is that of the mean radiance over the square of each pixel, even if `render`
    traces one ray per pixel. The derivative includes the outlines of spheres, discs, quads, boxes
    and rectangular lamps, the horizon of a plane, and the shadows of these shapes under lamps of
    all types. The derivative neglects the outlines of triangle meshes, lines where two surfaces
    intersect, the outlines of other lamps, and the shadow that a surface casts on itself.

    Accuracy was measured on 19 scenes of a sphere, a disc, a quad and a box, each 2 to 4 pixels
    wide, on a floor under a point lamp. The directional derivative along a random direction was
    compared with central differences. In the median scene, the two differed by 0.3 %, 0.2 % and 0.4
    % to 1.2 % of the gradient's length with respect to the parameters of the camera, the lamp and
    the shapes. In the worst scene, the difference was 2 %, 0.3 % and 4 % to 19 %. More nodes make
    the derivatives for small shapes more accurate. The rest of the derivative, inside the edges, is
    a mean over the rays of a pixel and needs many `samples` where a surface is seen at a grazing
    angle: in 8 scenes of one shape, 7 to 12 pixels wide, the largest difference was 49 % with 16
    samples and 2.7 % with 1024; the median was 0.2 % with either. With `samples` through a thin
    lens, the derivatives of the sum and of the middle of a blurred disc are accurate to 1 %.

    The cost is proportional to the side of the picture, not to its area or the number of samples.
    For four shapes on a floor in 64 x 64 pixels, edges made a gradient 2.2 times slower with 16
    samples per pixel, and 4 to 10 times slower with one. Compilation takes half a minute to a
    minute longer.

    Attributes:
        nodes: static, rays on each side of an edge for each pixel that it crosses, >= 1, if all
            edges together are as long as the picture's border. The total number of rays is fixed,
            so longer edges get fewer rays per pixel.

    Raises:
        ValueError: for fewer than one node.

    Example:
        A white disc of radius r = 3 m fills part of a black picture of 100 m^2. The mean is
        pi r^2 / 100, and its derivative with respect to r is 2 pi r / 100 = .1885.

        >>> def mean(radius):
        ...     lamp = jv.Surface(jv.Disc([0, 0, 5], [0, 0, -1], radius), jv.Lambert([0.0]), [1.0])
        ...     view = jv.Orthographic([0, 0, 0], np.eye(3), 0.5, resolution=(20, 20))
        ...     return jv.render(jv.Scene(lamp, []), view, edges=jv.Edges()).mean()
        >>> print(jax.grad(mean)(3.0).round(4))
        0.1885
    """

    nodes: int = eqx.field(static=True, default=8)

    def __check_init__(self) -> None:
        check_count("Edges.nodes", self.nodes, 1)


class Curves(eqx.Module):
    """The outlines of several shapes, stacked. An outline is a straight line, `start` + t `first`;
    a ring, or the horizon of a plane, `start` + cos(phi) `first` + sin(phi) `second`; or the limb
    of a sphere."""

    centre: Float[Array, "c 3"]  # of the shape
    start: Float[Array, "c 3"]
    first: Float[Array, "c 3"]
    second: Float[Array, "c 3"]
    radius: Float[Array, " c"]  # of a sphere, else 0
    kind: Int[Array, " c"]
    shape: Int[Array, " c"]  # its number among the surfaces, -1 for a lamp
    flat: Bool[Array, " c"]  # whether the shape has no inside


def _curves(outlined: Sequence[tuple[int, Shape | RectangleLight]]) -> Curves:
    """Return the outlines of shapes, each with the index of its surface."""
    found: list[tuple[Any, ...]] = []
    for number, shape in outlined:
        match shape:
            case Sphere(centre=c, radius=r):
                found.append((c, c, 0 * c, 0 * c, r, _LIMB, number, False))
            case Disc(centre=c, normal=n, radius=r):
                frame = local_frame(normalize(n))
                u, v = (r * as_array(axis) for axis in (frame.tangent, frame.bitangent))
                found.append((c, c, u, v, 0 * r, _RING, number, True))
            case Plane(point=c, normal=n):
                frame = local_frame(normalize(n))
                u, v = map(as_array, (frame.tangent, frame.bitangent))
                found.append((c, c, u, v, 0 * c[0], _HORIZON, number, True))
            case Quad() | RectangleLight():
                c, u, v = shape.corner, shape.edge_u, shape.edge_v
                centre = c + (u + v) / 2
                for start, along in ((c, u), (c, v), (c + u, v), (c + v, u)):
                    edge = (centre, start, along, 0 * u, 0 * c[0], _STRAIGHT, number, True)
                    found.append(edge)
            case Box(centre=c, half_extents=half):
                axes = jnp.eye(3, dtype=half.dtype) if shape.rotation is None else shape.rotation
                sides = half[:, None] * axes
                for k in range(3):
                    for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                        across = i * sides[(k + 1) % 3] + j * sides[(k + 2) % 3]
                        start = c + across - sides[k]
                        edge = (c, start, 2 * sides[k], 0 * c, 0 * c[0], _STRAIGHT, number, False)
                        found.append(edge)
    return Curves(*(jnp.stack(list(x)) for x in zip(*found, strict=True)))


class Eye(eqx.Module):
    """A point from which outlines are seen, (3,) m, or the direction toward a point at infinity."""

    place: Float[Array, "3"]
    at_infinity: bool = eqx.field(static=True)

    def direction(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Return the unit direction from a point toward the eye."""
        return self.place if self.at_infinity else as_array(normalize(self.place - point))

    def distance(self, point: Float[Array, "3"]) -> Array:
        """Return the distance from a point to the eye, () m."""
        return 0 * point[0] + jnp.inf if self.at_infinity else norm(self.place - point)


def _curve_point(curve: Curves, t: Scalar, eye: Eye) -> Float[Array, "3"]:
    """Return the point at the parameter t in [0, 1] of an outline as seen from `eye`, m."""
    away = 0 * curve.radius
    if not eye.at_infinity:
        away = jnp.minimum(divide(curve.radius, norm(eye.place - curve.start)), 1)
    limb, horizon = curve.kind == _LIMB, curve.kind == _HORIZON
    toward = eye.direction(curve.start)
    frame, size = local_frame(toward), curve.radius * safe_sqrt(1 - away * away)
    start = curve.start + curve.radius * away * toward
    start = start if eye.at_infinity else jnp.where(horizon, eye.place, start)
    first = jnp.where(limb, size * as_array(frame.tangent), curve.first)
    second = jnp.where(limb, size * as_array(frame.bitangent), curve.second)
    sine, cosine = sine_cosine(t)
    straight = curve.kind == _STRAIGHT
    return start + jnp.where(straight, t, cosine) * first + jnp.where(straight, 0, sine) * second


def _point_outside(
    curve: Curves, t: Scalar, eye: Eye, side: float = 1.0, lifted: Any = 1.0
) -> tuple[Array, Array]:
    """Return a point slightly outside an outline, and the same point moved slightly toward the eye,
    m."""
    away = _curve_point(curve, t, eye) - curve.centre
    point = curve.centre + (1 + side * _BESIDE) * away
    return point, point + lifted * _BESIDE * norm(away) * eye.direction(point)


def _reaches(point: Float[Array, "3"], eye: Eye, blocking: Sorted) -> Array:
    """Return whether no shape blocks the line from a point to an eye."""
    return ~occluded(point, 0 * point, eye.direction(point), eye.distance(point), blocking)


def _eye(view: View, u: Float[Array, "2"] | None) -> Eye:
    if isinstance(view, Orthographic):
        return Eye(-view.rotation[2], True)
    zero = jnp.zeros_like(view.pixel_pitch)
    return Eye(as_array(view_ray(view, zero, zero, u=u).origin), False)


def _imaged(
    view: View, point: Float[Array, "3"], u: Float[Array, "2"] | None
) -> tuple[Float[Array, "2"], Array]:
    """Return the position in the picture of a point that is imaged through the point `u` of the
    lens, and whether the point is in front of the camera."""
    forward = view.rotation[2]
    ahead = dot(forward, point - view.position) > 0
    ahead = ahead & jnp.all(jnp.isfinite(point))
    safe = jnp.where(ahead, point, view.position + forward)
    at = project(view, safe)
    place = jnp.stack([at.row, at.column])
    if u is None or not isinstance(view, ThinLens):
        return place, ahead

    def aside(place: Float[Array, "2"]) -> Float[Array, "2"]:
        ray = view_ray(view, place[0], place[1], u=u)
        way = safe - as_array(ray.origin)
        reach = divide(dot(forward, way), dot(forward, ray.direction))
        return view.rotation[:2] @ (way - reach * as_array(ray.direction)) / at.depth

    for _ in range(3):  # Newton's method; the last step has the derivatives
        place = jax.lax.stop_gradient(place)
        slope = jax.lax.stop_gradient(jax.jacfwd(aside)(place))
        place = place - jnp.linalg.solve(slope, aside(place))
    return place, ahead


def _lengths(view: View, ends: Array, ahead: Array, shown: Array) -> Float[Array, " cells"]:
    """Return the lengths, in pixels, of the straight cells of a curve inside the picture and a
    margin of one pixel. `ends`, (cells + 1, 2), are the ends of the cells. The length of a cell
    whose ends are hidden is divided by 20, so that few nodes are placed there."""
    begin, way = ends[:-1], ends[1:] - ends[:-1]
    way = jnp.where(jnp.abs(way) < 1e-9, 1e-9, way)
    far = jnp.array([[size + 0.5 for size in view.resolution]], begin.dtype)
    sides = [(bound - begin) / way for bound in (-1.5, far)]
    enter = jnp.maximum(jnp.minimum(*sides).max(-1), 0)
    leave = jnp.minimum(jnp.maximum(*sides).min(-1), 1)
    lengths = jnp.maximum(leave - enter, 0) * jnp.linalg.norm(way, axis=-1)
    lengths = jnp.where(ahead[:-1] & ahead[1:], lengths, 0)
    return jnp.where(shown[:-1] | shown[1:], lengths, lengths / 20)


def _place_nodes(
    lengths: Float[Array, "curves cells"], count: int
) -> tuple[Array, Array, Array, Array]:
    """Place nodes at equal distances along curves, given the lengths of their cells. Return for
    each node the curve, the cell, the position in the cell from 0 to 1, and the share of the cell
    that the node represents, (count,) each. Each node represents a part of a single curve, because
    the curves of a shape meet at its corners."""
    whole = lengths.sum(axis=1)
    ends = jnp.cumsum(whole)
    last = jnp.round(count * (ends / or_one(ends[-1]))).astype(jnp.int32)
    node = jnp.arange(count, dtype=jnp.int32)
    curve = jnp.minimum(jnp.searchsorted(last, node, side="right"), len(whole) - 1)
    first = jnp.where(curve > 0, last[curve - 1], 0)
    share = whole[curve] / jnp.maximum(last[curve] - first, 1).astype(ends.dtype)
    reach = ((node - first).astype(ends.dtype) + 0.5) * share
    sums = jnp.cumsum(lengths, axis=1)[curve]
    cell = jnp.minimum((sums <= reach[:, None]).sum(axis=1), lengths.shape[1] - 1)
    own = lengths[curve, cell]
    begin = sums[node, cell] - own
    return curve, cell, jnp.clip((reach - begin) / or_one(own), 0, 1), share / or_one(own)


def _row(tree: Any, index: Array) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _curve_normal(tangent: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return the unit normal of a curve, given its tangent."""
    normal = jnp.stack([-tangent[1], tangent[0]])
    return divide(normal, safe_sqrt((normal * normal).sum()))


def _integral(
    view: View, place: Array, stretch: Array, velocity: Array, use: Array, jump: Array
) -> Image:
    """Return the derivative of a picture due to n pieces of moving curves, given as vectors
    `stretch` (n, 2). A piece adds the area that it sweeps toward its normal, times the
    discontinuity of the radiance, `jump` (n, bands). The sum is distributed over the pixels along
    the piece, whose middle is `place` (n, 2)."""
    use = use & jnp.all(jnp.isfinite(jnp.concatenate([place, stretch], axis=1)), axis=1)
    swept = velocity[:, 1] * stretch[:, 0] - velocity[:, 0] * stretch[:, 1]
    value = jnp.where(use, swept, 0)[:, None] * jump / _PIECES
    shares = jnp.asarray((np.arange(_PIECES) + 0.5) / _PIECES - 0.5, place.dtype)
    pieces = place[:, None] + shares[None, :, None] * stretch[:, None]
    row, column = jnp.moveaxis(jnp.round(pieces), -1, 0).astype(jnp.int32)
    height, width = view.resolution
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    number = jnp.where(inside, row * width + column, height * width)
    each = jnp.broadcast_to(value[:, None], (*number.shape, value.shape[-1]))
    flat = jnp.zeros((height * width, value.shape[-1]), value.dtype)
    return flat.at[number].add(each, mode="drop").reshape(height, width, -1)


# (scene, ray, its encounter, index of the node) -> the whole radiance along the ray, W m^-2 sr^-1
Seen = Callable[[Scene, Ray, Encounter, Array], Colour]
# (scene, ray, its encounter and hit, light) -> radiance by that light alone, W m^-2 sr^-1
Under = Callable[[Scene, Ray, Encounter, Hit, Incident], Colour]


def moving_edges(
    scene: Scene,
    view: View,
    edges: Edges,
    seen: Seen,
    under: Under,
    rules: tuple[Rule, ...] | None,
    *,
    bands: int,
    sampled: bool,
) -> Image:
    """Return a picture of zeros, (h, w, bands), whose derivative is the part due to moving edges.
    `sampled` tells whether rays are distributed over a lens. `rules` has one sampling rule for each
    lamp; it is None if no shape casts shadows."""
    if any(isinstance(surface.shape, TriangleMesh) for surface in scene.surfaces):
        warn_caller("render: edges has no outlines of triangle meshes, which are neglected.")
    moving, rest = eqx.partition((scene, view), _can_move(scene, view))
    others, static = eqx.partition(rest, eqx.is_array)

    @jax.custom_jvp
    def nothing(moving: Any, others: Any) -> Image:
        del moving, others
        return jnp.zeros((*view.resolution, bands), view.pixel_pitch.dtype)

    def derivative(primals: Any, tangents: Any) -> tuple[Image, Image]:
        (moving, others), zeros = primals, nothing(*primals)
        is_zero = partial(_is, SymbolicZero)
        if all(map(is_zero, jax.tree.leaves(tangents[0], is_leaf=is_zero))):
            return zeros, zeros
        motion = jax.tree.map(
            lambda d: jnp.zeros(d.shape, d.dtype) if is_zero(d) else d,
            tangents[0],
            is_leaf=is_zero,
        )

        def again(moving: Any) -> tuple[Scene, View]:
            return eqx.combine(moving, others, static)

        found, along = zeros, (again, moving, motion, edges)
        if _seen_outlines(scene):
            found = found + _outline_integral(*along, seen, sampled=sampled)
        if rules is not None and _blocking_outlines(scene):
            for group in range(len(lights_by_rule(again(moving)[0].lights, rules))):
                found = found + _shadow_integral(*along, under, rules, group, sampled=sampled)
        return zeros, found

    nothing.defjvp(derivative, symbolic_zeros=True)
    return nothing(moving, others)


def _is(kind: type, x: Any) -> bool:
    return isinstance(x, kind)


def _can_move(scene: Scene, view: View) -> Any:
    """Return, for each array of (scene, view), whether a change of the array can move an edge."""

    def moves(path: tuple[Any, ...], leaf: Any) -> bool:
        if not eqx.is_inexact_array(leaf) or path[0].idx == 1:
            return eqx.is_inexact_array(leaf)
        match path[1].name:
            case "surfaces":
                return path[3].name == "shape"
            case "lights":
                return path[3].name not in scene.lights[path[2].idx].spectra
        return False

    return jax.tree_util.tree_map_with_path(moves, (scene, view))


def _outline_integral(
    again: Callable[[Any], tuple[Scene, View]],
    moving: Any,
    motion: Any,
    edges: Edges,
    seen: Seen,
    *,
    sampled: bool,
) -> Image:
    """Return the derivative, along `motion`, due to outlines that the camera sees."""
    scene, view = again(moving)
    dtype, count = view.pixel_pitch.dtype, edges.nodes * 2 * sum(view.resolution)
    lens = _lattice(count, dtype)[:, :2] if sampled and isinstance(view, ThinLens) else None

    shapes = sorted_shapes([surface.shape for surface in scene.surfaces])

    def cells(curve: Curves) -> Array:
        eye = _eye(view, None)

        def end(t: Array) -> tuple[Array, Array, Array]:
            shown = _reaches(_point_outside(curve, t, eye)[1], eye, shapes) | (
                curve.kind == _HORIZON
            )
            return *_imaged(view, _curve_point(curve, t, eye), None), shown

        return _lengths(view, *jax.vmap(end)(jnp.linspace(0, 1, _CELLS + 1, dtype=dtype)))

    curves = _curves(_seen_outlines(scene))
    lengths = jax.vmap(cells)(curves)
    chosen, cell, within, share = jax.lax.stop_gradient(_place_nodes(lengths, count))
    t, step = (cell.astype(dtype) + within) / _CELLS, share / _CELLS

    def places(moving: Any, t: Array) -> tuple[Array, Array]:
        scene, view = again(moving)

        def place(curve: Curves, t: Array, u: Array | None) -> tuple[Array, Array]:
            return _imaged(view, _curve_point(curve, t, _eye(view, u)), u)

        return jax.vmap(place)(_row(_curves(_seen_outlines(scene)), chosen), t, lens)

    at, tangent, ahead = jax.jvp(
        lambda t: places(moving, t), (t,), (jnp.ones_like(t),), has_aux=True
    )
    velocity = jax.jvp(lambda moving: places(moving, t)[0], (moving,), (motion,))[1]

    def jump(
        curve: Curves, t: Array, at: Array, tangent: Array, u: Array | None, number: Array
    ) -> Colour:
        across = _offset_of_rays(view) * _curve_normal(tangent)
        point = _curve_point(curve, t, _eye(view, u))
        near = jnp.array(_NEAR, dtype)[curve.kind] * norm(point - curve.centre)

        def beside(side: Scalar) -> tuple[Ray, Array, Colour, Array]:
            ray = view_ray(view, *(at + side * across), u=u)
            met = nearest_shape(ray, shapes)
            off = dot(ray.direction, point - ray.origin) - hit_shape(ray, shapes, met).distance
            ends = (met.shape == curve.shape) & (jnp.abs(off) <= near)
            return ray, met.shape, seen(scene, ray, met, number), ends

        rays, met, radiance, ends = jax.vmap(beside)(jnp.asarray(_SIDES, dtype))
        use = (curve.shape < 0) | jnp.any(ends)  # the shape has an edge there, in front of others
        # an edge that two shapes share is an outline of both, so each counts half
        through = jax.vmap(lambda ray, other: meets(ray, shapes, other))(rays, met[::-1])
        both = jnp.all(met >= 0) & (met[0] != met[1]) & ~jnp.any(through)
        return jnp.where(use, jnp.where(both, 0.5, 1.0), 0.0) * (radiance[0] - radiance[1])

    numbers = jnp.arange(count, dtype=jnp.uint32)
    jumps = jax.vmap(jump)(_row(curves, chosen), t, at, tangent, lens, numbers)
    return _integral(view, at, tangent * step[:, None], velocity, ahead, jumps)


def _shadow_integral(
    again: Callable[[Any], tuple[Scene, View]],
    moving: Any,
    motion: Any,
    edges: Edges,
    under: Under,
    rules: tuple[Rule, ...],
    which: int,
    *,
    sampled: bool,
) -> Image:
    """Return the derivative, along `motion`, due to shadows under a group of lamps with the same
    structure."""
    scene, view = again(moving)
    curves = _curves(_blocking_outlines(scene))
    members, lamps, rule = lights_by_rule(scene.lights, rules)[which]
    extended = can_be_seen(scene.lights[members[0]])
    shapes = sorted_shapes([surface.shape for surface in scene.surfaces])
    blocking = shapes
    if scene.occluders is not None:
        blocking = sorted_shapes([scene.surfaces[i].shape for i in scene.occluders])
    dtype, count = view.pixel_pitch.dtype, edges.nodes * 2 * sum(view.resolution)
    count = _OF_AREA * count if extended else count
    lattice = _lattice(count, dtype)
    lens = lattice[:, :2] if sampled and isinstance(view, ThinLens) else None

    def eye_of(lamp: Light, point: Array, u: Array) -> Eye:
        """Return the position on a lamp that the uniform numbers `u` select for a receiving point,
        as an `Eye`."""
        arriving = incident_sample(lamp, rule, point, u, jnp.ones((), dtype))
        toward = as_array(arriving.direction)
        if arriving.distance is None:
            return Eye(toward, True)
        return Eye(point + arriving.distance * toward, False)

    def receiver(curve: Curves, t: Array, eye: Eye) -> Encounter:
        point, start = _point_outside(curve, t, eye)
        return nearest_shape(Ray(start, -eye.direction(point)), shapes)

    def cast(
        point: Array, eye: Eye, met: Encounter, u: Array | None, again: tuple[Sorted, View]
    ) -> tuple[Array, Array, Array]:
        """Return the position in the picture of a point's shadow, whether the camera sees this
        shadow, and the position of the shadow in the scene, m."""
        hit = hit_shape(Ray(point, -eye.direction(point)), again[0], met)
        shadow = as_array(hit.point)
        place, ahead = _imaged(again[1], shadow, u)
        return place, ahead & (hit.distance < jnp.inf), shadow

    def cells(lamp: Light, curve: Curves, u: Array) -> Array:
        """Return the lengths, in pixels of the picture, of the cells of an outline's shadow."""
        eye = eye_of(lamp, curve.centre, u)

        def end(t: Array) -> tuple[Array, Array, Array]:
            shown = _reaches(_point_outside(curve, t, eye)[1], eye, blocking)
            met = receiver(curve, t, eye)
            return *cast(_curve_point(curve, t, eye), eye, met, None, (shapes, view))[:2], shown

        return _lengths(view, *jax.vmap(end)(jnp.linspace(0, 1, _CELLS + 1, dtype=dtype)))

    some = lattice[:4, 2:] if extended else lattice[:1, 2:]
    each = jax.vmap(jax.vmap(jax.vmap(cells, (None, None, 0)), (None, 0, None)), (0, None, None))
    lengths = each(lamps, curves, some).mean(2).reshape(-1, _CELLS)
    if extended:  # a curve that casts no shadow from these points of the lamp may do so from others
        lengths = lengths + 0.2 * lengths.mean()
    number, cell, within, share = jax.lax.stop_gradient(_place_nodes(lengths, count))
    t, step = (cell.astype(dtype) + within) / _CELLS, share / _CELLS
    chosen, lamp_number = number % len(curves.kind), number // len(curves.kind)

    def node(
        lamp: Light, curve: Curves, t: Array, u: Array | None, of_lamp: Array
    ) -> tuple[Any, ...]:
        eye = eye_of(lamp, curve.centre, of_lamp)
        met = receiver(curve, t, eye)

        def place(at: Array) -> tuple[Array, Any]:
            away = _curve_point(curve, at[0], eye) - curve.centre
            place, *rest = cast(curve.centre + (1 + at[1]) * away, eye, met, u, (shapes, view))
            return place, (place, *rest)

        slope, (at, ahead, shadow) = jax.jacfwd(place, has_aux=True)(jnp.stack([t, 0 * t]))
        tangent, outward = slope.T
        ray, across = view_ray(view, at[0], at[1], u=u), _curve_normal(tangent)
        hit = hit_shape(ray, shapes, met)
        seen = as_array(hit.point)
        # the camera must see the receiving surface on both sides of the shadow's edge
        use = ahead & (met.shape >= 0) & (met.shape != curve.shape)
        use = use & (norm(shadow - seen) < 1e-3 * norm(seen - as_array(ray.origin)))

        def beside(side: Scalar) -> Array:
            return nearest_shape(view_ray(view, *(at + side * across), u=u), shapes).shape

        there = jax.vmap(beside)(_SEEN_BESIDE * jnp.asarray(_SIDES, dtype))
        use = use & jnp.all(there == met.shape)
        # The lamp must shine past the outline, on both sides of it. The ray from `inside` is free
        # if the box's surface is lit there, and blocked if it lies in the box's own shadow.
        outside = _point_outside(curve, t, eye)[1]
        inside = _point_outside(curve, t, eye, -0.1, jnp.where(curve.flat, 1.0, 10.0))[1]
        starts = jnp.stack([outside, jnp.where(curve.kind == _LIMB, outside, inside)])
        use = use & jnp.all(jax.vmap(lambda start: _reaches(start, eye, blocking))(starts))
        # the light from that point of the lamp, per unit of the uniform numbers `of_lamp`
        own, arriving = of_lamp, incident_sample(lamp, rule, seen, of_lamp, jnp.ones((), dtype))
        if extended and not eye.at_infinity:
            toward = eye.direction(seen)
            own = _same_direction(lambda u: eye_of(lamp, seen, u).direction(seen), toward, of_lamp)
            slopes = jax.jacfwd(lambda v: normalize(eye_of(lamp, curve.centre, v).place - seen))
            first, second = slopes(of_lamp).T
            shines = radiance_of(lamp, Ray(seen, toward)).radiance
            arriving = Incident(toward, shines * norm(as_array(cross(first, second))))
        lit_ahead = jnp.sign((across * outward).sum())
        jump = -lit_ahead * under(scene, ray, met, hit, arriving)
        return met, at, tangent, own, use, jnp.where(use, jump, 0)

    nodes = _row(lamps, lamp_number), _row(curves, chosen), t, lens, lattice[:, 2:]
    met, at, tangent, own, use, jumps = jax.vmap(node)(*nodes)

    def places(moving: Any) -> Array:
        scene, view = again(moving)
        shapes = sorted_shapes([surface.shape for surface in scene.surfaces])

        def place(
            lamp: Light, curve: Curves, t: Array, u: Array | None, met: Encounter, at: Any, own: Any
        ) -> Array:
            point = curve.centre
            if extended:  # the point on the camera's fixed ray; the lamp keeps its uniform numbers
                point = as_array(hit_shape(view_ray(view, *at, u=u), shapes, met).point)
            eye = eye_of(lamp, point, own)
            return cast(_curve_point(curve, t, eye), eye, met, u, (shapes, view))[0]

        lamps = lights_by_rule(scene.lights, rules)[which][1]
        rows = _row(lamps, lamp_number), _row(_curves(_blocking_outlines(scene)), chosen)
        return jax.vmap(place)(*rows, t, lens, met, at, own)

    velocity = jax.jvp(places, (moving,), (motion,))[1]
    return _integral(view, at, tangent * step[:, None], velocity, use, jumps)


def _same_direction(
    direction: Callable[[Array], Array], wanted: Array, start: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Solve for the numbers, (2,) in the unit square, at which `direction` returns the `wanted`
    direction, by the Gauss-Newton method. Return `start` if there is no solution."""

    def missing(u: Array) -> Array:
        return direction(u) - wanted

    def turn(_: Array, u: Array) -> Array:
        slope = jax.jacfwd(missing)(u)
        size = jnp.linalg.norm(slope)
        slope, rest = slope / size, missing(u) / size
        return jnp.clip(u - jnp.linalg.solve(slope.T @ slope, slope.T @ rest), 0, 1)

    u = jax.lax.fori_loop(0, _TURNS, turn, start)
    return jnp.where(norm(missing(u)) < 1e-3, u, start)


def _seen_outlines(scene: Scene) -> Sequence[tuple[int, Shape | RectangleLight]]:
    """Return the shapes whose outlines a camera can see, each with the index of its surface, or -1
    for a lamp."""
    shapes = [surface.shape for surface in scene.surfaces]
    lamps = [(-1, light) for light in scene.lights if isinstance(light, RectangleLight)]
    return [(i, s) for i, s in enumerate(shapes) if not isinstance(s, TriangleMesh)] + lamps


def _blocking_outlines(scene: Scene) -> Sequence[tuple[int, Shape]]:
    """Return the shapes that have an outline as seen from a lamp, which excludes planes."""
    numbers = range(len(scene.surfaces)) if scene.occluders is None else scene.occluders
    own = [(i, scene.surfaces[i].shape) for i in numbers]
    return [(i, shape) for i, shape in own if not isinstance(shape, Plane | TriangleMesh)]


def _lattice(count: int, dtype: Any) -> Float[Array, "count 4"]:
    """Return `count` points that cover the four-dimensional unit cube evenly."""
    return jnp.asarray((np.arange(count)[:, None] + 0.5) * _STEPS % 1, dtype)


def _offset_of_rays(view: View) -> float:
    """Return the distance, in pixels, from an edge to the rays that measure the discontinuity of
    the radiance. The distance exceeds rounding errors. The distance is small enough for the limb of
    a sphere, near which the radiance changes like a square root."""
    eps = float(jnp.finfo(view.pixel_pitch.dtype).eps)
    return max(16 * eps * max(view.resolution), 0.3 * eps**0.5)
