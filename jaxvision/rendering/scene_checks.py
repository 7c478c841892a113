"""Checks of a scene before rendering. Each finding is one sentence.

The checks use NumPy and need concrete numbers. Scenes that JAX traces are not checked; they render
to finite values.
"""

from collections.abc import Sequence

import jax
import numpy as np

from ..brdf import is_body
from ..geometry.checks import invalid
from ..lights import DirectionalLight, PointLight, RectangleLight, SmallLight
from ..scene import (
    Box,
    Disc,
    Light,
    Plane,
    Quad,
    Scene,
    Shape,
    Sphere,
    Surface,
    TriangleMesh,
    View,
)

_ROUNDING = 1e-6  # relative rounding error of a length in float32


def scene_problems(
    scene: Scene, view: View, surfaces: Sequence[str], lights: Sequence[str]
) -> list[str]:
    """Return one finding for each problem of a scene. A finding begins with the name of the surface
    or light.

    Findings cover the problems of each shape (`geometry.problems`, except positions far from the
    origin); closed meshes turned inside out; emitters without area and lights without direction; a
    scene without any light; a light, an emitter or the camera inside an opaque closed surface; and
    a point light on a surface other than a mesh, which the light would not illuminate. Objects
    inside glass or a two-sided surface are allowed, because the inside is visible there. A ray that
    starts in glass is treated as a ray inside the glass.
    """
    found = [
        f"{name}: {problem}"
        for name, surface in zip(surfaces, scene.surfaces, strict=True)
        for problem in invalid(surface.shape)
    ]
    if found:  # the checks below need valid shapes
        return found
    hiding = [
        (name, surface)
        for name, surface in zip(surfaces, scene.surfaces, strict=True)
        if not surface.two_sided and not is_body(surface.material)
    ]
    for name, surface in hiding:
        if _is_inside_out(surface.shape):
            found.append(
                f"{name}: the triangles of this closed mesh face inwards; set flip = true, or "
                "two_sided = true to see both sides."
            )
    shining = [
        (name, _corners_around(surface.shape))
        for name, surface in zip(surfaces, scene.surfaces, strict=True)
        if _shines(surface)
    ]
    for name, light in zip(lights, scene.lights, strict=True):
        shining.append((name, _places(light)))
        found += [
            f"{name}: lies on {under}, which it cannot light from there; move it off."
            for under, surface in zip(surfaces, scene.surfaces, strict=True)
            if isinstance(light, PointLight) and _lies_on(surface.shape, _array(light.position))
        ]
    found += [
        f"{name}: lies inside {around}, which hides it; move it, or set two_sided = true."
        for name, places in shining
        for around, surface in hiding
        if around != name and len(places) and all(is_inside(surface.shape, p) for p in places)
    ]
    found += [
        f"camera: lies inside {around}, whose inside is not seen; move it, or set two_sided = true."
        for around, surface in hiding
        if is_inside(surface.shape, np.asarray(view.position, float))
    ]
    if not (scene.lights or scene.ambient is not None or any(map(_shines, scene.surfaces))):
        found.append("the scene has no light; add a [[light]] or an emission.")
    return found


def idle_lamps(scene: Scene, *, lights: Sequence[str] | None = None) -> list[str]:
    """Return one finding for each lamp that illuminates no surface even without shadows. A finding
    begins with the lamp's name or its index in the scene.

    A lamp is idle if its radiance is 0, if it is flat and all surfaces are behind it, or if all
    surfaces show their backs to it. Ambient light is idle if no material has an ambient
    reflectance. Skies, light fields and user-defined lamps are not checked.

    Example:
        >>> floor = jv.Surface(jv.Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), jv.Lambert([0.25]))
        >>> lamp = jv.SmallLight([0.5, 0.5, 2.0], [0.0, 0.0, 1.0], [8.0])
        >>> jv.rendering.scene_checks.idle_lamps(jv.Scene(floor, lamp))
        ['lights[0]: shines away from every surface; turn it round.']
    """
    names = lights or [f"lights[{i}]" for i in range(len(scene.lights))]
    found = []
    for name, light in zip(names, scene.lights, strict=True):
        power = [np.asarray(getattr(light, field)).any() for field in light.spectra]
        if power and not any(power):
            found.append(f"{name}: has no power.")
            continue
        front = _front(light)
        if front is not None and not any(_reaches(s.shape, *front) for s in scene.surfaces):
            found.append(f"{name}: shines away from every surface; turn it round.")
            continue
        places = _places(light)
        if isinstance(light, DirectionalLight):
            places = [_array(light.direction)]
        far = isinstance(light, DirectionalLight)
        if places and not any(_faces(surface, places, far) for surface in scene.surfaces):
            found.append(f"{name}: lies behind every surface, which shows it its back; move it.")
    if scene.ambient is not None and not np.asarray(scene.ambient.radiance).any():
        found.append("ambient: has no power.")
    elif scene.ambient is not None and not reflects_ambient(scene):
        found.append(
            "ambient: lights no surface, as no material has an ambient reflectance; give materials "
            "one, or give a light of kind 'environment'."
        )
    return found


def reflects_ambient(scene: Scene) -> bool:
    """Return whether a scene has ambient light and a material that reflects it."""
    reflected = (getattr(surface.material, "ambient", None) for surface in scene.surfaces)
    return (
        scene.ambient is not None
        and bool(np.asarray(scene.ambient.radiance).any())
        and any(one is not None and np.asarray(one).any() for one in reflected)
    )


def _front(light: Light) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a point and the normal of a flat lamp; None for other lamps."""
    match light:
        case SmallLight():
            return _array(light.position), _array(light.normal)
        case RectangleLight():
            normal = np.cross(_array(light.edge_u), _array(light.edge_v))
            return _array(light.corner), normal
    return None


def _reaches(shape: Shape, point: np.ndarray, normal: np.ndarray) -> bool:
    """Return whether any part of a shape lies in front of the plane through `point` with
    `normal`."""
    if isinstance(shape, Plane):
        across = np.linalg.norm(np.cross(_array(shape.normal), normal))
        size = np.linalg.norm(shape.normal) * np.linalg.norm(normal)
        return bool(across > _ROUNDING * size or (_array(shape.point) - point) @ normal > 0)
    corners = np.stack(_corners_around(shape))
    if isinstance(shape, Sphere | Disc):  # the whole ball; `corners` has only some points of it
        centre, radius = _array(shape.centre), float(shape.radius)
        return bool((centre - point) @ normal > -radius * np.linalg.norm(normal))
    return bool(((corners - point) @ normal > 0).any())


def _plane_of(shape: object) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a point, m, and a normal of any length of a flat shape; None for other shapes."""
    match shape:
        case Plane():
            return _array(shape.point), _array(shape.normal)
        case Disc():
            return _array(shape.centre), _array(shape.normal)
        case Quad():
            normal = np.cross(_array(shape.edge_u), _array(shape.edge_v))
            return _array(shape.corner), normal
    return None


def _faces(surface: Surface, places: Sequence[np.ndarray], far: bool) -> bool:
    """Return whether any part of a surface faces one of a lamp's `places`, which are positions in
    m, or directions if `far` is true."""
    if (flat := _plane_of(surface.shape)) is None:
        return True
    start, normal = flat
    heights = [(place if far else place - start) @ normal for place in places]
    both = surface.two_sided or is_body(surface.material)
    return bool(max(map(abs, heights) if both else heights) > 0)


def lost_numbers(exact: object, kept: object) -> list[str]:
    """Return one finding for each field of `exact` that overflows to infinity, or underflows to all
    zeros, in the dtype of `kept`."""
    found = []
    fields = jax.tree_util.tree_leaves_with_path(exact)
    for (place, before), after in zip(fields, map(np.asarray, jax.tree.leaves(kept)), strict=True):
        if not np.issubdtype(after.dtype, np.floating):
            continue
        wide, changed = np.asarray(before), np.isinf(after)
        if (np.abs(after) < np.finfo(after.dtype).tiny).all():
            changed = wide != 0
        if changed.any():
            name = jax.tree_util.keystr(place, simple=True, separator=".")
            found.append(
                f"{name} holds {wide[changed].flat[0]:g}, which {after.dtype} cannot; change it, "
                "or set render.dtype = 'float64'."
            )
    return found


def is_inside(shape: Shape, point: np.ndarray) -> bool:
    """Return whether a point, (3,) m, is inside a closed shape.

    A point is inside a mesh if the mesh's triangles cover more than half of all directions from the
    point.

    Source:
        van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", IEEE Transactions on
        Biomedical Engineering 30 (1983).
    """
    match shape:
        case Sphere():
            return bool(np.linalg.norm(point - _array(shape.centre)) < float(shape.radius))
        case Box():
            axes = np.eye(3) if shape.rotation is None else _array(shape.rotation)
            within = np.abs(axes @ (point - _array(shape.centre)))
            return bool((within < _array(shape.half_extents)).all())
        case TriangleMesh():
            a, b, c = np.moveaxis(_corners(shape) - point, 1, 0)
            la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
            volume = np.einsum("ij,ij->i", a, np.cross(b, c))
            rest = la * lb * lc + sum(
                np.einsum("ij,ij->i", x, y) * length
                for x, y, length in ((a, b, lc), (b, c, la), (c, a, lb))
            )
            solid_angle = 2 * np.arctan2(volume, rest).sum()
            return bool(abs(solid_angle) > 2 * np.pi)
    return False


def _is_inside_out(shape: Shape) -> bool:
    """Return whether a mesh is closed (each edge belongs to two triangles) and its signed volume is
    negative."""
    if not isinstance(shape, TriangleMesh):
        return False
    corners = _corners(shape)
    # merge vertices by position, because files repeat a vertex where the texture or the normal is
    # discontinuous
    _, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    if not (counts == 2).all():
        return False
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return bool(np.einsum("ij,ij->", a, np.cross(b, c)) < 0)


def _places(light: Light) -> list[np.ndarray]:
    """Return the position of a light, or its corners, as a list of points; an empty list for other
    lights."""
    match light:
        case PointLight() | SmallLight():
            return [_array(light.position)]
        case RectangleLight():
            corner, u, v = (_array(x) for x in (light.corner, light.edge_u, light.edge_v))
            return [corner, corner + u, corner + v, corner + u + v]
    return []


def _corners_around(shape: Shape) -> list[np.ndarray]:
    """Return points on the boundary of a shape, or its corners, in m; an empty list for a plane."""
    match shape:
        case Sphere() | Disc():
            axes = np.eye(3)
            if isinstance(shape, Disc):
                axes = np.linalg.svd(_array(shape.normal)[None])[2][1:]  # across the normal
            sides = np.concatenate([axes, -axes]) * float(shape.radius)
            return list(_array(shape.centre) + sides)
        case Quad():
            corner, u, v = (_array(x) for x in (shape.corner, shape.edge_u, shape.edge_v))
            return [corner, corner + u, corner + v, corner + u + v]
        case Box():
            axes = np.eye(3) if shape.rotation is None else _array(shape.rotation)
            signs = np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T
            return list(_array(shape.centre) + (signs * _array(shape.half_extents)) @ axes)
        case TriangleMesh():
            return list(_array(shape.vertices))
    return []


def _lies_on(shape: Shape, point: np.ndarray) -> bool:
    """Return whether a point, (3,) m, is on the surface of a shape, up to rounding in float32;
    False for a mesh."""
    match shape:
        case Sphere():
            centre, radius = _array(shape.centre), float(shape.radius)
            size = max(np.abs(point).max(), np.abs(centre).max(), radius)
            return bool(abs(np.linalg.norm(point - centre) - radius) <= _ROUNDING * size)
        case Box():
            centre, half = _array(shape.centre), _array(shape.half_extents)
            size = max(np.abs(point).max(), np.abs(centre).max(), half.max())
            axes = np.eye(3) if shape.rotation is None else _array(shape.rotation)
            outside = np.abs(axes @ (point - centre)) - half
            return bool(abs(outside.max()) <= _ROUNDING * size)
        case _:
            if (flat := _plane_of(shape)) is None:
                return False
            start, normal = flat
    away = point - start
    size = max(np.abs(point).max(), np.abs(start).max(), np.linalg.norm(away))
    if abs(away @ normal) > _ROUNDING * size * np.linalg.norm(normal):
        return False
    match shape:
        case Disc():
            return bool(np.linalg.norm(away) <= float(shape.radius))
        case Quad():
            edges = np.stack([_array(shape.edge_u), _array(shape.edge_v)], axis=1)
            u, v = np.linalg.lstsq(edges, away, rcond=None)[0]
            return bool(min(u, v) >= 0 and max(u, v) <= 1)
    return True


def _shines(surface: Surface) -> bool:
    return surface.emission is not None


def _corners(mesh: TriangleMesh) -> np.ndarray:
    """Return the corners of each triangle of a mesh, (faces, 3, 3) m."""
    return _array(mesh.vertices)[np.asarray(mesh.faces)]


def _array(x) -> np.ndarray:
    return np.asarray(x, float)
