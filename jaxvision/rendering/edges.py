"""The part of a picture's derivative that is due to moving edges: outlines of shapes and lamps, and
edges of shadows.

The value of a pixel is the mean of the radiance L over its square. If a parameter theta moves a
curve across which L is discontinuous, the derivative of the mean contains, besides the mean of dL /
d theta,

    sum of (L_behind - L_ahead) (dp / d theta . n) ds

over the part of the curve p in the pixel. Here ds is an element of the curve; the normal n points
from the side "behind" to the side "ahead". The curves are the outlines of shapes as seen from the
camera or a lamp, and have closed forms. The curve p(t) is differentiated with respect to theta at
fixed t. The discontinuity of L is measured by two rays, slightly to each side of the curve. An area
lamp is treated as a sum of point lamps: each node on an outline uses a different point of the lamp.

Source: Li, Aittala, Durand, Lehtinen, "Differentiable Monte Carlo Ray Tracing through Edge
Sampling", ACM TOG 37(6) (2018). Unlike in that paper, edges are sampled in proportion to their
length in the picture.

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
from ..core.parallel_loops import fori_loop
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
from .pixel_loop import PixelSamples

# Pieces of a curve; nodes are distributed in proportion to the pieces' lengths in the picture
_CELLS = 64
_PIECES = 8  # parts of the short straight stretch about a node; each adds to one pixel
_OF_AREA = 4  # factor for the number of nodes if the lamp has a size
_BESIDE = 1e-3  # distance from an outline to the rays that pass the shape, in sizes of the shape
# Distance, in pixels, from a shadow's edge to the rays that find the receiving surface
_SEEN_BESIDE = 1e-2
_SIDES = np.array([-1.0, 1.0])  # behind and ahead of an edge, in the direction of its normal
_TURNS = 6  # iterations of Newton's method
_STRAIGHT, _RING, _LIMB, _HORIZON = range(4)
# For each type of curve, in sizes of the shape: the largest distance along a ray beside the edge
# from the edge to the shape
_NEAR = (1e-2, 1e-2, 0.5, np.inf)
_NARROW = 3.0  # smallest width of a face's image, in pixels, that the rays of a picture resolve
_GRID = (np.arange(4) + 0.5) / 4  # points along each side of a face that estimate its importance
_GOLDEN = 0.6180339887498949  # step of a lattice in two dimensions
_MORE = 4  # further samples, per sample of the picture, in the pixels with the largest errors
# Steps of a Kronecker sequence in four dimensions, two for the lens and two for the lamp
_STEPS = np.array([0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101])


class Edges(Shown):
    """Include moving edges in the derivatives of `render`, which otherwise neglect them.

    The derivative is that of the mean radiance over the square of each pixel, even if `render`
    traces one ray per pixel. The derivative includes the outlines of spheres, discs, quads, boxes
    and rectangular lamps, the horizon of a plane, and the shadows of these shapes under lamps of
    all types. The derivative neglects the outlines of triangle meshes, lines where two surfaces
    intersect, the outlines of other lamps, and the shadow that a surface casts on itself.

    Between the edges, the derivative is a mean over the rays of a pixel. Few rays hit a face that
    is seen at a grazing angle, or the rim of a sphere, where the derivative is large. Points on
    these surfaces are therefore sampled as well. If `samples` are given, the pixels that the edges
    of highest contrast cross receive four times as many further samples for the derivative.

    Accuracy was measured on random scenes of a sphere, a disc, a quad and a box on a floor, each
    shape 3 to 8 pixels wide in a picture of 24 x 24 pixels with 16 samples. The directional
    derivative along random motions of the camera, of the lamp, of all shapes, and of their sizes
    was compared with central differences of pictures with at least 6144 samples, known to 0.2 %
    (median), after projection onto 16 cosines. Under a point lamp, the relative difference had the
    quartiles 0.7 %, 0.8 % and 1.3 % (56 motions in 14 scenes), and was at most 5.4 %. Under a
    rectangular lamp, where the central differences are known to 0.4 %, it had the quartiles 0.4 %,
    1.0 % and 1.8 % (20 motions in 4 scenes), and was at most 3.3 %. About half of the motions were
    within 1 %. Without the additional points and samples, the quartiles of 24 motions under a point
    lamp were 1.2 %, 2.6 % and 4.3 %. With `samples` through a thin lens, the derivatives of the sum
    and of the middle of a blurred disc are accurate to 1 %.

    The standard error of one derivative, from six or eight keys, was 0.4 %, 0.8 % and 1.1 %
    (quartiles of 24 motions in 6 such scenes under a point lamp), at most 2.2 %. With 64 samples it
    was 0.1 %, 0.3 % and 0.4 %, at most 0.8 %. To find the standard error in another scene, repeat
    the derivative with several keys. The choice of pixels causes no bias of the mean over keys. In
    6 other scenes, the relative difference of this mean from central differences had the quartiles
    0.6 %, 1.7 % and 2.6 % (24 motions). The finite steps of the central differences cause up to 2 %
    of this. If only the lamp moved, the difference was at most 0.5 %. The largest differences, 3 to
    8 %, occurred in a scene where the camera sees a face of the box edge-on (cosine 0.001), so that
    a step makes the face appear. With the camera moved sideways by 0.35 m, the error of the
    derivative with respect to the size of the box was 0.5 % instead of 13 %.

    The time for the edges is proportional to the side length of the picture in pixels, not to its
    area or the number of samples. For a sphere, a disc, a quad and a box on a floor in 64 x 64
    pixels with 16 samples, a gradient with edges took 1.9 times as long under a rectangular lamp (4
    x 4 points, 0.33 s on two cores) and 5 times as long under a point lamp (26 ms). With one sample
    under a point lamp it took 14 times as long (18 ms). Compilation took 40 s and 66 s instead of 3
    s and 7 s.

    Attributes:
        nodes: static, >= 1, rays on each side of an edge for each pixel that the edge crosses, if
            the total length of all edges equals the length of the picture's border. The total
            number of rays is fixed, so longer edges get fewer rays per pixel.

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


def _faces(scene: Scene) -> Curves:
    """Return the faces of all spheres, discs, quads and boxes. A face is a parallelogram, `start` +
    s `first` + t `second`; the inside of a ring; or the rim of a sphere."""
    found: list[tuple[Any, ...]] = []
    for number, surface in enumerate(scene.surfaces):
        match surface.shape:
            case Sphere() | Disc() as shape:
                row = _curves([(number, shape)])
                found.append(tuple(jax.tree.leaves(_row(row, 0))))
            case Quad(corner=c, edge_u=u, edge_v=v):
                found.append((c + (u + v) / 2, c, u, v, 0 * c[0], _STRAIGHT, number, True))
            case Box(centre=c, half_extents=half) as box:
                axes = jnp.eye(3, dtype=half.dtype) if box.rotation is None else box.rotation
                sides = half[:, None] * axes
                for k in range(3):
                    u, v = 2 * sides[(k + 1) % 3], 2 * sides[(k + 2) % 3]
                    for side in (sides[k], -sides[k]):
                        start = c + side - (u + v) / 2
                        found.append((c, start, u, v, 0 * c[0], _STRAIGHT, number, False))
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
    """Return a point slightly outside an outline, and this point moved slightly toward the eye,
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


def _image_point(
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

    def point_offset(place: Float[Array, "2"]) -> Float[Array, "2"]:
        ray = view_ray(view, place[0], place[1], u=u)
        way = safe - as_array(ray.origin)
        reach = divide(dot(forward, way), dot(forward, ray.direction))
        return view.rotation[:2] @ (way - reach * as_array(ray.direction)) / at.depth

    for _ in range(3):  # Newton's method; the last step has the derivatives
        place = jax.lax.stop_gradient(place)
        slope = jax.lax.stop_gradient(jax.jacfwd(point_offset)(place))
        place = place - jnp.linalg.solve(slope, point_offset(place))
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


def _row(tree: Any, index: Array | int) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _curve_normal(tangent: Float[Array, "2"]) -> Float[Array, "2"]:
    """Return the unit normal of a curve, given its tangent."""
    normal = jnp.stack([-tangent[1], tangent[0]])
    return divide(normal, safe_sqrt((normal * normal).sum()))


def _integral(
    view: View, place: Array, stretch: Array, velocity: Array, use: Array, jump: Array
) -> tuple[Image, Float[Array, "h w"]]:
    """Return the derivative of a picture due to n pieces of moving curves, given as vectors
    `stretch` (n, 2). A piece adds the area that it sweeps toward its normal, times the
    discontinuity of the radiance, `jump` (n, bands). The sum is distributed over the pixels along
    the piece, whose middle is `place` (n, 2). Also return the contrast: the sum of length times
    discontinuity in each pixel, for the band in which it is largest."""
    use = use & jnp.all(jnp.isfinite(jnp.concatenate([place, stretch], axis=1)), axis=1)
    swept = velocity[:, 1] * stretch[:, 0] - velocity[:, 0] * stretch[:, 1]
    shares = jnp.asarray((np.arange(_PIECES) + 0.5) / _PIECES - 0.5, place.dtype)
    pieces = place[:, None] + shares[None, :, None] * stretch[:, None]

    def spread(size: Array, step: Array) -> Image:
        value = jnp.where(use, size, 0)[:, None] * step / _PIECES
        value = jnp.broadcast_to(value[:, None], (*pieces.shape[:2], value.shape[1]))
        return _sums(view, pieces, value)

    length = jnp.linalg.norm(stretch, axis=1)
    return spread(swept, jump), spread(length, jnp.abs(jump)).max(-1)


def _sums(view: View, places: Float[Array, "*n 2"], values: Float[Array, "*n bands"]) -> Image:
    """Return the sums of the values whose places lie in each pixel."""
    row, column = jnp.moveaxis(jnp.round(places), -1, 0).astype(jnp.int32)
    height, width = view.resolution
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    number = jnp.where(inside, row * width + column, height * width)
    flat = jnp.zeros((height * width, values.shape[-1]), values.dtype)
    return flat.at[number].add(values, mode="drop").reshape(height, width, -1)


# (scene, ray, its encounter, index of the node, its hit, or None to compute the hit) -> the whole
# radiance along the ray, W m^-2 sr^-1
Seen = Callable[[Scene, Ray, Encounter, Array, Hit | None], Colour]
# (scene, view, rows and columns of pixels, samples, index of the first sample) -> the radiance of
# these pixels, W m^-2 sr^-1
Pixels = Callable[[Scene, View, tuple[Array, Array], PixelSamples, Array], Array]
# (scene, ray, its encounter and hit, light) -> radiance by that light alone, W m^-2 sr^-1
Under = Callable[[Scene, Ray, Encounter, Hit, Incident], Colour]


def moving_edges(
    scene: Scene,
    view: View,
    edges: Edges,
    seen: Seen,
    under: Under,
    rules: tuple[Rule, ...] | None,
    pixels: Pixels,
    *,
    picture: Image,
    samples: PixelSamples | None,
) -> Image:
    """Return a picture of zeros, (h, w, bands), whose derivative is the part due to moving edges of
    the `picture`. `rules` has one sampling rule for each lamp; it is None if no shape casts
    shadows."""
    if any(isinstance(surface.shape, TriangleMesh) for surface in scene.surfaces):
        warn_caller("render: edges has no outlines of triangle meshes, which are neglected.")
    moving, rest = eqx.partition((scene, view), _can_move(scene, view))
    others, static = eqx.partition((rest, samples), eqx.is_array)
    sampled, zeros = samples is not None, jnp.zeros_like(picture)

    @jax.custom_jvp
    def nothing(moving: Any, others: Any) -> Image:
        del moving, others
        return zeros

    def derivative(primals: Any, tangents: Any) -> tuple[Image, Image]:
        moving, others = primals
        is_zero = partial(_is, SymbolicZero)
        if all(map(is_zero, jax.tree.leaves(tangents[0], is_leaf=is_zero))):
            return zeros, zeros
        motion = jax.tree.map(
            lambda d: jnp.zeros(d.shape, d.dtype) if is_zero(d) else d,
            tangents[0],
            is_leaf=is_zero,
        )

        rest, samples = eqx.combine(others, static)

        def rebuild(moving: Any) -> tuple[Scene, View]:
            return eqx.combine(moving, rest)

        found, along = zeros, (rebuild, moving, motion, edges)
        if not all(isinstance(surface.shape, Plane | TriangleMesh) for surface in scene.surfaces):
            found = found + _face_integral(*along, seen, sampled=sampled)
        parts = []
        if _visible_outlines(scene):
            parts.append(_outline_integral(*along, seen, sampled=sampled))
        if rules is not None and _blocking_outlines(scene):
            for group in range(len(lights_by_rule(rebuild(moving)[0].lights, rules))):
                parts.append(_shadow_integral(*along, under, rules, group, sampled=sampled))
        for part, _ in parts:
            found = found + part
        if samples is not None and parts:
            contrast = jnp.sum(jnp.stack([own for _, own in parts]), axis=0)
            found = found + _sample_edge_pixels(rebuild, moving, motion, pixels, samples, contrast)
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


def _sample_edge_pixels(
    again: Callable[[Any], tuple[Scene, View]],
    moving: Any,
    motion: Any,
    pixels: Pixels,
    samples: PixelSamples,
    contrast: Float[Array, "h w"],
) -> Image:
    """Return the correction, by further samples, of the derivative along `motion` between the
    edges. Further samples are drawn in the pixels with the largest `contrast` of the edges that
    cross them. The pixels are not chosen by the standard errors of the first samples: errors and
    derivatives of the same samples are correlated, so that this choice would make the derivative
    biased."""
    height, width = contrast.shape
    _, chosen = jax.lax.top_k(contrast.ravel(), min(2 * (height + width), height * width))
    place = chosen // width, chosen % width

    def change(moving: Any) -> Array:
        def mean(first: Array) -> Array:
            return pixels(*again(moving), place, samples, first)

        means = jax.vmap(mean)(jnp.arange(1 + _MORE, dtype=jnp.uint32) * samples.count)
        return means.mean(0) - means[0]

    gain = jax.jvp(change, (moving,), (motion,))[1]
    return jnp.zeros((height, width, gain.shape[-1]), gain.dtype).at[place].add(gain)


def _outline_integral(
    again: Callable[[Any], tuple[Scene, View]],
    moving: Any,
    motion: Any,
    edges: Edges,
    seen: Seen,
    *,
    sampled: bool,
) -> tuple[Image, Float[Array, "h w"]]:
    """Return the derivative, along `motion`, due to outlines that the camera sees, and their
    contrast in each pixel."""
    scene, view = again(moving)
    dtype, shapes = view.pixel_pitch.dtype, sorted_shapes([s.shape for s in scene.surfaces])
    count, _, lens = _nodes(view, edges, sampled=sampled)

    def cells(curve: Curves) -> Array:
        eye = _eye(view, None)

        def end(t: Array) -> tuple[Array, Array, Array]:
            shown = _reaches(_point_outside(curve, t, eye)[1], eye, shapes) | (
                curve.kind == _HORIZON
            )
            return *_image_point(view, _curve_point(curve, t, eye), None), shown

        return _lengths(view, *jax.vmap(end)(jnp.linspace(0, 1, _CELLS + 1, dtype=dtype)))

    curves = _curves(_visible_outlines(scene))
    lengths = jax.vmap(cells)(curves)
    chosen, cell, within, share = jax.lax.stop_gradient(_place_nodes(lengths, count))
    t, step = (cell.astype(dtype) + within) / _CELLS, share / _CELLS

    def places(moving: Any, t: Array) -> tuple[Array, Array]:
        scene, view = again(moving)

        def place(curve: Curves, t: Array, u: Array | None) -> tuple[Array, Array]:
            return _image_point(view, _curve_point(curve, t, _eye(view, u)), u)

        return jax.vmap(place)(_row(_curves(_visible_outlines(scene)), chosen), t, lens)

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

        def shape_on_side(side: Scalar) -> tuple[Ray, Array, Colour, Array]:
            ray = view_ray(view, *(at + side * across), u=u)
            met = nearest_shape(ray, shapes)
            off = dot(ray.direction, point - ray.origin) - hit_shape(ray, shapes, met).distance
            ends = (met.shape == curve.shape) & (jnp.abs(off) <= near)
            return ray, met.shape, seen(scene, ray, met, number, None), ends

        rays, met, radiance, ends = jax.vmap(shape_on_side)(jnp.asarray(_SIDES, dtype))
        use = (curve.shape < 0) | jnp.any(ends)  # this shape's edge is there, not hidden
        # an edge that two shapes share is an outline of both, so each outline counts half
        through = jax.vmap(lambda ray, other: meets(ray, shapes, other))(rays, met[::-1])
        both = jnp.all(met >= 0) & (met[0] != met[1]) & ~jnp.any(through)
        return jnp.where(use, jnp.where(both, 0.5, 1.0), 0.0) * (radiance[0] - radiance[1])

    numbers = jnp.arange(count, dtype=jnp.uint32)
    jumps = jax.vmap(jump)(_row(curves, chosen), t, at, tangent, lens, numbers)
    return _integral(view, at, tangent * step[:, None], velocity, ahead, jumps)


def _extent(shape: Shape) -> tuple[Array, Array] | None:
    """Return the centre of a shape with faces, and the mean length of their sides, m."""
    match shape:
        case Sphere(centre=c, radius=r) | Disc(centre=c, radius=r):
            return c, 2 * r
        case Quad(corner=c, edge_u=u, edge_v=v):
            return c + (u + v) / 2, safe_sqrt(norm(u) * norm(v))
        case Box(centre=c, half_extents=half):
            return c, 2 * jnp.prod(half) ** (1 / 3)
    return None


def grazing_cosines(scene: Scene, view: View) -> Float[Array, " n"]:
    """Return for each surface the cosine of the angle of view below which `damped` acts, no unit.
    Where the cosine is smaller, the image of a face is at most `_NARROW` pixels wide, and the image
    of a sphere's rim at most half as wide. The result is 0 for planes and meshes."""
    scene, view = jax.lax.stop_gradient((scene, view))

    def limit(shape: Shape) -> Array:
        if (extent := _extent(shape)) is None:
            return jnp.zeros_like(view.pixel_pitch)
        centre, size = extent
        slopes = jax.jacfwd(lambda point: _image_point(view, point, None)[0])(centre)
        pixels = size * jnp.sqrt((slopes * slopes).sum() / 2)
        share = jnp.minimum(divide(_NARROW, pixels), 1)
        return safe_sqrt(share) if isinstance(shape, Sphere) else share

    return jnp.stack([limit(surface.shape) for surface in scene.surfaces])


def _undamped_part(limits: Array, ray: Ray, number: Array, hit: Hit) -> Array:
    """Return the part, from 0 to 1, of a hit's derivative that `damped` keeps."""
    limit = limits[jnp.maximum(number, 0)]
    cosine = jnp.abs(dot(hit.normal, ray.direction))
    return jax.lax.stop_gradient(jnp.where(limit > cosine, cosine / or_one(limit), 1))


@jax.custom_jvp
def damped(hit: Hit, ray: Ray, encounter: Encounter, limits: Array) -> Hit:
    """Return the hit, with smaller derivatives of its point and normal if the ray grazes a narrow
    face. The derivatives are proportional to 1 / cos there, and too few rays hit the face to
    integrate them. `moving_edges` adds the rest, integrated over points of the face."""
    del ray, encounter, limits
    return hit


def _damped_derivative(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Hit, Hit]:
    (hit, ray, encounter, limits), (change, *_) = primals, tangents
    kept = _undamped_part(limits, ray, encounter.shape, hit)
    moved = jax.tree.map(lambda x: kept * x, (change.point, change.normal))
    return hit, eqx.tree_at(lambda hit: (hit.point, hit.normal), change, moved)


damped.defjvp(_damped_derivative)


def _face_point(face: Curves, at: Float[Array, "2"], eye: Eye, limit: Scalar) -> Float[Array, "3"]:
    """Return the point at two parameters in [0, 1] of a face, m. The rim of a sphere is the part
    that `eye` sees at a cosine from 0 to `limit`."""
    straight, limb = face.kind == _STRAIGHT, face.kind == _LIMB
    (s, t), (sine, cosine), radius = at, sine_cosine(at[1]), safe_sqrt(at[0])
    first = jnp.where(straight, s, radius * cosine) * face.first
    second = jnp.where(straight, t, radius * sine) * face.second
    toward, ends = eye.direction(face.centre), (0 * limit, limit)
    if not eye.at_infinity:  # from the triangle of eye, centre and point
        near = divide(or_one(face.radius), norm(eye.place - face.centre))
        ways = [safe_sqrt(1 - near**2 * (1 - end**2)) - near * end for end in ends]
        ends = [near + way * end for way, end in zip(ways, ends, strict=True)]
    height = ends[0] + s * (ends[1] - ends[0])
    frame = local_frame(toward)
    around = cosine * as_array(frame.tangent) + sine * as_array(frame.bitangent)
    up = face.radius * (height * toward + safe_sqrt(1 - height**2) * around)
    return jnp.where(limb, face.centre + up, face.start + first + second)


def _face_integral(
    again: Callable[[Any], tuple[Scene, View]],
    moving: Any,
    motion: Any,
    edges: Edges,
    seen: Seen,
    *,
    sampled: bool,
) -> Image:
    """Return the part of the derivative, along `motion`, that `damped` removes."""
    scene, view = again(moving)
    dtype, shapes = view.pixel_pitch.dtype, sorted_shapes([s.shape for s in scene.surfaces])
    (count, _, lens), faces = _nodes(view, edges, sampled=sampled), _faces(scene)
    limits, bounds = grazing_cosines(scene, view), jnp.asarray(view.resolution, dtype) - 0.5

    def point(face: Curves, at: Array, u: Array | None) -> tuple[Array, Encounter, Array, Array]:
        """Return the position in the picture of a point of a face, its encounter, the area of the
        picture per unit of the parameters times the part that `damped` removes, and 1 / cos."""

        def place(at: Array) -> tuple[Array, Any]:
            point = _face_point(face, at, _eye(view, u), limits[face.shape])
            place, ahead = _image_point(view, point, u)
            return place, (place, point, ahead)

        slope, (where, point, ahead) = jax.jacfwd(place, has_aux=True)(at)
        ray = view_ray(view, where[0], where[1], u=u)
        met = nearest_shape(ray, shapes)
        hit = hit_shape(ray, shapes, met)
        use = ahead & (met.shape == face.shape) & jnp.all((where > -0.5) & (where < bounds))
        use = use & (norm(as_array(hit.point) - point) < 1e-2 * norm(point - face.centre))
        area = jnp.abs(slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0])
        removed = area * (1 - _undamped_part(limits, ray, met.shape, hit))
        cosine = jnp.abs(dot(hit.normal, ray.direction))
        return where, met, jnp.where(use, removed, 0), divide(1, cosine)

    grid = jnp.asarray(np.stack(np.meshgrid(_GRID, _GRID), -1).reshape(-1, 2), dtype)
    _, _, removed, steep = jax.vmap(jax.vmap(point, (None, 0, None)), (0, None, None))(
        faces, grid, None
    )
    lengths = safe_sqrt((removed * steep).mean(1))
    lengths = lengths + 0.05 * lengths.mean()  # other points of a face may be visible
    chosen, _, first, share = jax.lax.stop_gradient(_place_nodes(lengths[:, None], count))
    second = jnp.asarray((np.arange(count) + 0.5) * _GOLDEN % 1, dtype)
    nodes = _row(faces, chosen), jnp.stack([first, second], 1), lens
    where, met, removed, _ = jax.lax.stop_gradient(jax.vmap(point)(*nodes))

    def radiance(moving: Any) -> Array:
        moved, camera = again(moving)
        shapes = sorted_shapes([surface.shape for surface in moved.surfaces])

        def radiance_at(where: Array, u: Array | None, met: Encounter, number: Array) -> Colour:
            ray = view_ray(camera, where[0], where[1], u=u)
            hit = hit_shape(ray, shapes, met)
            fixed, ray = jax.lax.stop_gradient((hit, ray))
            hit = eqx.tree_at(lambda hit: (hit.point, hit.normal), fixed, (hit.point, hit.normal))
            return seen(scene, ray, met, number, hit)

        return jax.vmap(radiance_at)(where, lens, met, jnp.arange(count, dtype=jnp.uint32))

    change = jax.jvp(radiance, (moving,), (motion,))[1]
    weight = (removed * share)[:, None]
    return _sums(view, where, jnp.where(weight > 0, weight * change, 0))


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
) -> tuple[Image, Float[Array, "h w"]]:
    """Return the derivative, along `motion`, due to shadows under a group of lamps with the same
    structure, and the contrast of the shadows' edges in each pixel."""
    scene, view = again(moving)
    curves = _curves(_blocking_outlines(scene))
    members, lamps, rule = lights_by_rule(scene.lights, rules)[which]
    extended = can_be_seen(scene.lights[members[0]])
    shapes = sorted_shapes([surface.shape for surface in scene.surfaces])
    blocking = shapes
    if scene.occluders is not None:
        blocking = sorted_shapes([scene.surfaces[i].shape for i in scene.occluders])
    dtype, of_area = view.pixel_pitch.dtype, _OF_AREA if extended else 1
    count, lattice, lens = _nodes(view, edges, sampled=sampled, times=of_area)

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
        place, ahead = _image_point(again[1], shadow, u)
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
    if extended:  # the curve may cast a shadow from other points of the lamp
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

        def shape_on_side(side: Scalar) -> Array:
            return nearest_shape(view_ray(view, *(at + side * across), u=u), shapes).shape

        there = jax.vmap(shape_on_side)(_SEEN_BESIDE * jnp.asarray(_SIDES, dtype))
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
            own = _solve_direction(lambda u: eye_of(lamp, seen, u).direction(seen), toward, of_lamp)
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
            if extended:  # the camera's ray and the lamp's uniform numbers are fixed
                point = as_array(hit_shape(view_ray(view, *at, u=u), shapes, met).point)
            eye = eye_of(lamp, point, own)
            return cast(_curve_point(curve, t, eye), eye, met, u, (shapes, view))[0]

        lamps = lights_by_rule(scene.lights, rules)[which][1]
        rows = _row(lamps, lamp_number), _row(_curves(_blocking_outlines(scene)), chosen)
        return jax.vmap(place)(*rows, t, lens, met, at, own)

    velocity = jax.jvp(places, (moving,), (motion,))[1]
    return _integral(view, at, tangent * step[:, None], velocity, use, jumps)


def _solve_direction(
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

    u = fori_loop(0, _TURNS, turn, start)
    return jnp.where(norm(missing(u)) < 1e-3, u, start)


def _visible_outlines(scene: Scene) -> Sequence[tuple[int, Shape | RectangleLight]]:
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


def _nodes(
    view: View, edges: Edges, *, sampled: bool, times: int = 1
) -> tuple[int, Float[Array, "count 4"], Float[Array, "count 2"] | None]:
    """Return the number of nodes, points that cover the four-dimensional unit cube evenly, and
    their first two coordinates, which select points of a lens (None without a lens)."""
    count = times * edges.nodes * 2 * sum(view.resolution)
    steps = (np.arange(count)[:, None] + 0.5) * _STEPS % 1
    lattice = jnp.asarray(steps, view.pixel_pitch.dtype)
    return count, lattice, lattice[:, :2] if sampled and isinstance(view, ThinLens) else None


def _offset_of_rays(view: View) -> float:
    """Return the distance, in pixels, from an edge to the rays that measure the discontinuity of
    the radiance. The distance exceeds rounding errors. The distance is small enough for the limb of
    a sphere, near which the radiance changes like a square root."""
    eps = float(jnp.finfo(view.pixel_pitch.dtype).eps)
    return max(16 * eps * max(view.resolution), 0.3 * eps**0.5)
