"""Messages about the light of a scene that an integrator cannot find.

The table lists the paths that each integrator finds, written from the lamp to the eye. L is a lamp
with a size, P a lamp without size (a point or a direction), D a surface with a BRDF, S a mirror or
glass, and E the eye. S* stands for any number of S, and S+ for one or more.

    direct      L D E, P D E, L E, L S E if S is an opaque mirror, and ambient light; glass is black
                and casts shadows
    rays        the same without ambient light, and (L | P) D S* E, L S* E
    path        all paths of L; those of P whose first surface is a D
    light       all paths whose last surface is a D, and L E
    radiosity   all paths of D alone; a scene with S raises an error

No integrator finds P S+ D S+ E, for example a surface behind a window that a point lamp
illuminates, and a camera sees, through the window.
"""

from collections.abc import Sequence
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..brdf import evaluate, is_body, is_delta
from ..brdf.blinn import Blinn, BlinnBRDF, NormalisedBlinn
from ..brdf.dichromatic import Dichromatic
from ..brdf.gaussian_lobe import GaussianLobe, GaussianLobeBRDF
from ..brdf.half_difference import HalfDifferenceTable
from ..brdf.measured import AnisotropicTable, IsotropicTable
from ..brdf.phong import NormalisedPhong, Phong, PhongBRDF
from ..brdf.rgl import RGL
from ..brdf.torrance_sparrow import TorranceSparrow
from ..core._maps import ENDS, maps_of, replace_maps
from ..core._numerics import norm, normalize
from ..core._types import check_choice, common_dtype
from ..core._vector import as_array, as_vec, where
from ..core.parallel_loops import scan
from ..geometry import Ray, ball_around, has_area, surface_area
from ..lights import (
    EnvironmentMap,
    Quadrature,
    RectangleLight,
    Rule,
    can_be_seen,
    incident,
    rules_of,
)
from ..lights.environment_quadrature import found_by_quadrature
from ..lights.near_rectangles import found_on_surfaces
from ..optics import view_ray
from ..rendering.scene_checks import reflects_ambient
from ..rendering.shadows import DEFAULT_RULE
from ..scene import Light, Material, Plane, Quad, Scene, Shape, Surface, TriangleMesh, View
from ._vertices import Surfaces, branches, leave, meet, surfaces_of
from .ray_tree import DEFAULT_RULE as RULE_OF_RAYS

Integrator = Literal["direct", "rays", "path", "light", "radiosity"]
RARE = 1e-3  # a lamp is reported if a smaller share of paths hits it by chance
_FACES = 24  # largest number of successive mirror and glass faces that are counted
_SIDE = 24  # rays along each side of the picture that are followed to count the faces
_NAMED = 3  # largest number of objects that a sentence names


def missing_light(
    scene: Scene,
    *,
    integrator: Integrator,
    depth: int | None = None,
    rule: Rule | None = None,
    samples: int | None = None,
    view: View | None = None,
    surfaces: Sequence[str] | None = None,
    lights: Sequence[str] | None = None,
) -> list[str]:
    """Return a message for each kind of light in a scene that an integrator neglects.

    `path` misses light from lamps without size (points, directions) that reaches a surface via
    mirrors and glass. `direct` and `rays` miss light that mirrors and glass cast onto other
    surfaces, and `light` misses mirrors and glass themselves. Quadrature may miss the sun of an
    environment that falls between its directions, and a narrow lobe that falls between its samples
    of a lamp. `path` finds the light that such a lobe casts onto other surfaces only by chance.
    Only `direct` adds ambient light.

    The positions of mirrors and glass are not checked, so the named light may be small.
    Interreflections between matte surfaces, which `direct` and `rays` neglect by definition, are
    not listed.

    Args:
        scene: surfaces and lights, not traced.
        integrator: "direct" (`render`), "rays" (`ray_traced`), "path" (`path_traced`), "light"
            (`light_traced`) or "radiosity".
        depth: largest number of segments of a path (no unit); for "rays" number of rays of the
            tree. With `view` it is compared with the number of glass faces and mirrors that a ray
            meets in succession. None omits this check.
        rule: sampling rule of lights without a rule of their own, for "direct", "rays" and
            "radiosity"; None for the integrator's default.
        samples: paths of each pixel, for "path". If it is given, a message about rarely sampled
            light states the share of pixels that sample the light; the standard errors of all other
            pixels omit it. If it is None, the message states the probability alone.
        view: the camera; None assumes that it sees every mirror and glass.
        surfaces: name of each surface; None for their indices in the scene.
        lights: name of each light; None for their indices in the scene.

    Returns:
        The sentences. Each names an integrator that includes the light, if there is one. The list
        is empty if no light is missing.

    Example:
        >>> floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert([0.2]))
        >>> pane = jv.Surface(jv.Box([0, 0, 1], [2, 2, 0.05]), jv.Glass(1.5))
        >>> scene = jv.Scene([floor, pane], [jv.PointLight([0, 0, 2], [4.0])])
        >>> for sentence in jv.transport.missing_light(scene, integrator="path"):
        ...     print(sentence.split(". ")[0])
        Missing: light of lights[0] that reaches other surfaces by way of surfaces[1]
    """
    check_choice("missing_light: integrator", integrator, get_args(Integrator))
    named = surfaces or [f"surfaces[{i}]" for i in range(len(scene.surfaces))]
    lamps = lights or [f"lights[{i}]" for i in range(len(scene.lights))]
    own = list(zip(named, scene.surfaces, strict=True))
    turning = [name for name, surface in own if is_delta(surface.material)]
    shining = [name for name, surface in own if _emits(surface)]
    placed = [n for n, light in zip(lamps, scene.lights, strict=True) if not can_be_seen(light)]
    sized = [n for n, light in zip(lamps, scene.lights, strict=True) if can_be_seen(light)]
    found = []
    if integrator != "direct" and reflects_ambient(scene):
        found.append(
            "Missing: the light of ambient. It stands for light that bounces, and integrator = "
            "'direct' alone adds it. Set that, or give a light of kind 'environment'."
        )
    if integrator == "direct" and shining:
        found.append(
            f"Missing: light of {_list(shining)} on other surfaces. Emission is only seen here. "
            "Set integrator = 'path', which has it."
        )
    if integrator in ("direct", "rays", "radiosity") and len(turning) < len(own):
        default = RULE_OF_RAYS if integrator == "rays" else DEFAULT_RULE
        rules = rules_of(scene, default if rule is None else rule)
        for name, light, its_rule in zip(lamps, scene.lights, rules, strict=True):
            if isinstance(light, EnvironmentMap) and isinstance(its_rule, Quadrature):
                found += _check_environment(name, light, its_rule, integrator)
            if isinstance(light, RectangleLight) and isinstance(its_rule, Quadrature):
                found += _too_near(name, light, its_rule, scene.surfaces, integrator)
            if isinstance(its_rule, Quadrature) and integrator != "radiosity":
                found += _too_narrow(name, light, its_rule, own, integrator)
    if integrator == "path":
        found += _rarely_in_lobe(scene, lamps, own, samples)
    if not turning or integrator == "radiosity":
        return found
    matt = len(turning) < len(own)
    faces = _list(turning)
    clear = [name for name, surface in own if is_body(surface.material)]
    opaque = [name for name in turning if name not in clear]
    before = behind = np.zeros(0, int)
    if view is not None:
        before, behind = (np.asarray(x) for x in _count_faces(scene, view, *_grid(view)))
    elsewhere = "Missing: light of {} that reaches other surfaces by way of " + faces + ". "
    match integrator:
        case "direct":
            if clear:
                found.append(
                    f"Missing: all light through {_list(clear)}, black here and with full shadows. "
                    "Set integrator = 'rays', which shows what is behind."
                )
            if opaque:
                found.append(
                    f"Missing: the surfaces that {_list(opaque)} would show. Set integrator = "
                    "'rays', which has them."
                )
            if matt:
                found.append(
                    elsewhere.format(_list([*placed, *sized, *shining]))
                    + "Direct light ends at mirrors and glass. "
                    + _advice(placed, sized + shining)
                )
        case "rays" if matt:
            found.append(
                elsewhere.format(_list([*placed, *sized, *shining]))
                + "Rays from the camera do not find caustics, nor any light behind glass. "
                + _advice(placed, sized + shining)
            )
        case "path" if placed and matt:
            found.append(
                elsewhere.format(_list(placed))
                + "A path that leaves a mirror or glass cannot meet a lamp without a size. "
                + _advice(placed, [])
            )
        case "light" if view is None or before.any():
            found.append(
                f"Missing: what the camera sees in or through {faces}, black here. Set integrator "
                "= 'path', which lacks only light of lamps without a size by way of mirrors or "
                "glass."
            )
    if integrator == "path" and matt:
        found += _check_rare_lamps(scene, lamps, own, faces, samples)
    found += [
        f"{name}: this mesh of glass is not closed, {gaps} of its edges belonging to one triangle: "
        "a ray that passes there is taken to stay inside; close the mesh."
        for name, surface in own
        if is_body(surface.material) and (gaps := _open_edges(surface))
    ]
    if depth is not None and view is not None:
        found += _cut_short(integrator, depth, faces, before, behind)
    return found


def _advice(placed: Sequence[str], sized: Sequence[str]) -> str:
    """Return the advice that ends a message about light that mirrors and glass cast onto other
    surfaces."""
    if not placed:
        return "Set integrator = 'path', which has it."
    of_sized = f"For that of {_list(sized)} set integrator = 'path'. " if sized else ""
    whose = f"For that of {_list(placed)} set" if sized else "Set"
    return (
        f"{of_sized}{whose} integrator = 'light', in which mirrors, glass and what they show are "
        f"black, or give {_list(placed)} a size and set integrator = 'path'."
    )


def _list(names: Sequence[str]) -> str:
    """Join names with commas and "and", for use in a sentence."""
    if len(names) > _NAMED + 1:
        names = [*names[:_NAMED], f"{len(names) - _NAMED} more"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _emits(surface: Surface) -> bool:
    return surface.emission is not None and bool(np.asarray(surface.emission).any())


def _check_environment(
    name: str, light: EnvironmentMap, rule: Quadrature, integrator: Integrator
) -> list[str]:
    """Return a message if a quadrature of an environment is far too dark or too bright, else an
    empty list."""
    if (wrong := found_by_quadrature(light, rule)) is None:
        return []
    cures = "" if integrator == "rays" else "rule = 'balanced' or 'monte_carlo', or "
    return [
        f"{wrong.sentence(name)} Set {cures}integrator = 'path', or take the sun out of the map "
        "and add a directional light."
    ]


def _too_near(
    name: str,
    light: RectangleLight,
    rule: Quadrature,
    surfaces: Sequence[Surface],
    integrator: Integrator,
) -> list[str]:
    """Return a message if a quadrature of a rectangle is far too dark or too bright on a surface
    near the rectangle."""
    if (wrong := found_on_surfaces(light, rule, surfaces)) is None:
        return []
    cure = "rule = 'balanced', or " if integrator == "direct" else ""
    return [f"{wrong.sentence(name)} Set {cure}integrator = 'path'."]


def _too_narrow(
    name: str,
    light: Light,
    rule: Quadrature,
    own: Sequence[tuple[str, Surface]],
    integrator: Integrator,
) -> list[str]:
    """Return a message for each surface whose specular lobe is narrower than the spacing of a
    quadrature's samples."""
    found = []
    for surface_name, surface in own:
        width = min(_lobe(surface.material))
        if width >= np.pi:
            continue
        match light:
            case RectangleLight():
                angle, wide = _angle(light, surface.shape), width
            case EnvironmentMap():  # light from all sides may be sampled at three lobe widths
                angle, wide = np.pi, 3 * width
            case _:
                return []
        if angle > rule.order * wide:
            cure = "integrator = 'path'" if integrator == "rays" else "rule = 'balanced'"
            found.append(
                f"Narrow: the reflection of {name} in {surface_name} is too bright or too dark. "
                f"Its lobe is {width:.2g} rad wide, and the samples of quadrature of order "
                f"{rule.order} lie {angle / rule.order:.2g} rad apart. Set {cure}, or order to "
                f"{int(np.ceil(angle / width))} or more."
            )
    return found


def _lobe(material: Material) -> tuple[float, float]:
    """Return the widths of a material's narrowest lobe, rad, along both tangents; pi if the lobe is
    broad or its width is unknown.

    The width of a microfacet lobe with roughness alpha is 2 alpha. Any other lobe has the width of
    the microfacet lobe with the same width at half maximum. In measured data, the lobe is located
    numerically.
    """
    if any(True for _ in maps_of(material)):
        return min(_lobe(replace_maps(material, end)) for end in ENDS)
    match material:
        case Dichromatic():
            return min(_lobe(material.body), _lobe(material.interface))
        case TorranceSparrow():
            along, across = np.broadcast_to(2 * np.asarray(material.roughness, float), 2)
        case Phong() | PhongBRDF() | NormalisedPhong():
            along = across = 2 / max(float(material.exponent), 1e-3) ** 0.5
        case Blinn() | BlinnBRDF() | NormalisedBlinn():  # a power of the cosine to the half vector
            along = across = 4 / max(float(material.exponent), 1e-3) ** 0.5
        case GaussianLobe() | GaussianLobeBRDF():
            along = across = 2**0.5 / max(float(material.concentration), 1e-3)
        case HalfDifferenceTable() | RGL() | IsotropicTable() | AnisotropicTable():
            return _lobe_of_table(material)
        case _:
            return np.pi, np.pi
    if not np.asarray(material.specular).any():
        return np.pi, np.pi
    return min(float(along), np.pi), min(float(across), np.pi)


def _lobe_of_table(material: Material) -> tuple[float, float]:
    """Return the widths of `_lobe` for measured data, from the half maximum around the mirror
    direction of light at 0.6 rad. A lobe that reflects less than a hundredth of the light is
    treated as broad."""
    away = np.concatenate([[0], np.geomspace(1e-4, 1, 80)])
    light = np.array([-np.sin(0.6), 0, np.cos(0.6)])
    along = np.stack([np.sin(0.6 - away), 0 * away, np.cos(0.6 - away)], -1)
    aside = along[0] + np.tan(away)[:, None] * np.array([0, 1, 0])
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    viewers = jnp.asarray(np.stack([along, aside]), common_dtype(material))
    seen = jax.vmap(jax.vmap(lambda wo: evaluate(material, jnp.asarray(light, wo.dtype), wo)))
    values = np.asarray(seen(viewers), float).mean(axis=-1)
    peak, body = values[0, 0], values.min()
    half = [away[np.argmax(row < (peak + body) / 2)] or np.pi for row in values]
    thrown = (peak - body) * half[0] * half[1]  # (sr^-1) times the half-widths in both directions
    if not (peak > 4 * body and thrown > 0.01 * (body + thrown)):
        return np.pi, np.pi
    width, other = (min(1.55 * float(x), np.pi) for x in half)  # 2 alpha of a facet lobe
    return width, other


def _angle(light: RectangleLight, shape: Shape) -> float:
    """Return the angle, rad, that the longer side of a lamp subtends at the middle of a surface.
    The distance is at least half the smallest extent of the surface."""
    middle = _parallelogram(light).mean(axis=0)
    if isinstance(shape, Plane):
        away = float(_heights(shape, middle))
    else:
        low, high = _corners(shape).min(axis=0), _corners(shape).max(axis=0)
        away = float(np.linalg.norm(middle - (low + high) / 2))
        away = max(away, float((high - low).min()) / 2)
    side = max(float(np.linalg.norm(np.asarray(x, float))) for x in (light.edge_u, light.edge_v))
    return 2 * float(np.arctan2(side / 2, away))


def _rarely_in_lobe(
    scene: Scene,
    lamps: Sequence[str],
    own: Sequence[tuple[str, Surface]],
    samples: int | None,
) -> list[str]:
    """Return a message for each surface whose lobe casts light on other surfaces in directions that
    paths rarely sample."""
    matt = [surface for _, surface in own if not is_delta(surface.material)]
    found = []
    for name, surface in own:
        along, across = _lobe(surface.material)
        if along * across >= RARE or len(matt) < 2:
            continue
        chances = [
            along * across + (_chance(light, matt) if can_be_seen(light) else 0)
            for light in scene.lights
        ]
        rare = [(lamp, c) for lamp, c in zip(lamps, chances, strict=True) if c < RARE]
        if rare:
            names, met = zip(*rare, strict=True)
            found.append(_rare(_list(names), name, max(met), samples))
    return found


def _rare(light: str, faces: str, chance: float, samples: int | None) -> str:
    """Return the message about light that a path hits only with a small probability `chance`."""
    shown = "Few samples show noise or nothing, and errors that are too small."
    if samples is not None:
        meets = -np.expm1(samples * np.log1p(-chance))
        shown = (
            f"At {samples} samples at most {meets:.2g} of the pixels meet it at all; errors of the "
            f"others leave it out. It takes {np.ceil(3 / chance):,.0f} samples to meet it in 95 %."
        )
    return (
        f"Rare: light of {light} on other surfaces by {faces} is met by chance alone, by at most "
        f"one path in {round(1 / chance):,}. {shown} Set integrator = 'light', which finds it on "
        "purpose."
    )


def _check_rare_lamps(
    scene: Scene,
    lamps: Sequence[str],
    own: Sequence[tuple[str, Surface]],
    faces: str,
    samples: int | None,
) -> list[str]:
    """Return a message for each lamp with a size that paths via mirrors and glass rarely hit."""
    matt = [surface for _, surface in own if not is_delta(surface.material)]
    chances = [
        (name, _chance(light, matt)) for name, light in zip(lamps, scene.lights, strict=True)
    ]
    chances += [
        (name, _share(float(surface_area(surface.shape)), _corners(surface.shape), matt))
        for name, surface in own
        if _emits(surface) and has_area(surface.shape)
    ]
    return [_rare(name, faces, chance, samples) for name, chance in chances if 0 < chance < RARE]


def _chance(light: Light, matt: Sequence[Surface]) -> float:
    """Return an estimate of the largest share of paths from a matte surface that hit a light; 1 if
    unknown."""
    match light:
        case RectangleLight():
            area = float(np.linalg.norm(np.cross(light.edge_u, light.edge_v)))
            return _share(area, _parallelogram(light), matt)
        case EnvironmentMap():  # share of the smallest solid angle that sends half of the light
            density, rows = np.asarray(light.density, float), light.density.shape[0]
            edges = np.cos(np.linspace(0, np.pi, rows + 1))
            solid = np.repeat((edges[:-1] - edges[1:])[:, None], density.shape[1], 1)
            solid *= 2 * np.pi / density.shape[1]
            order = np.argsort(density, axis=None)[::-1]
            light_within = np.cumsum((density * solid).flat[order])
            half = int(np.searchsorted(light_within, 0.5 * light_within[-1]))
            return float(min(solid.flat[order][: half + 1].sum() / np.pi, 1))
    return 1.0


def _share(area: float, corners: np.ndarray, matt: Sequence[Surface]) -> float:
    """Return the share of directions from a matte surface that hit a lamp, area / (pi d^2), at most
    1. Here d is the distance between the bounding box of the lamp's corners and that of the nearest
    matte surface."""
    nearest = np.inf
    low, high = corners.min(axis=0), corners.max(axis=0)
    for surface in matt:
        own = _corners(surface.shape)
        if isinstance(surface.shape, Plane):  # the distance along the plane's normal
            nearest = min(nearest, float(_heights(surface.shape, corners).min()))
            continue
        apart = np.maximum(np.maximum(own.min(axis=0) - high, low - own.max(axis=0)), 0)
        if apart.any():  # an emissive surface does not illuminate itself
            nearest = min(nearest, float(np.linalg.norm(apart)))
        elif not np.array_equal(own, corners):
            return 1.0
    return min(area / (np.pi * nearest**2), 1.0) if nearest > 0 else 1.0


def _heights(plane: Plane, points: np.ndarray) -> np.ndarray:
    """Return the distances, m, of points, (..., 3), from a plane."""
    normal = np.asarray(plane.normal, float)
    along = (points - np.asarray(plane.point, float)) @ normal
    return np.abs(along) / np.linalg.norm(normal)


def _parallelogram(sided: Quad | RectangleLight) -> np.ndarray:
    """Return the corners of a quad or a rectangular lamp, (4, 3) m."""
    corner, u, v = (np.asarray(x, float) for x in (sided.corner, sided.edge_u, sided.edge_v))
    return np.stack([corner, corner + u, corner + v, corner + u + v])


def _corners(shape: Shape) -> np.ndarray:
    """Return points whose bounding box contains a shape, (n, 3) m; no points for a plane."""
    match shape:
        case Plane():
            return np.zeros((0, 3))
        case Quad():
            return _parallelogram(shape)
        case TriangleMesh():
            return np.asarray(shape.vertices, float)
    ball = ball_around([shape])
    assert ball is not None  # only a plane has no bounding sphere
    return np.stack(
        [np.asarray(ball.centre, float) + sign * float(ball.radius) for sign in (-1, 1)]
    )


def _open_edges(surface: Surface) -> int:
    """Count the edges of a mesh that belong to one triangle only."""
    if not isinstance(surface.shape, TriangleMesh):
        return 0
    corners = np.asarray(surface.shape.vertices)[np.asarray(surface.shape.faces)].reshape(-1, 3)
    _, faces = np.unique(corners, axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return int((counts == 1).sum())


def _cut_short(
    integrator: Integrator, depth: int, faces: str, before: np.ndarray, behind: np.ndarray
) -> list[str]:
    """Return a message if a view through successive mirrors and glass surfaces needs more path
    segments than `depth` allows."""
    match integrator:
        case "path":  # one segment to the surface, one to the lamp, and one for each face between
            needed = before + 2 + np.where(behind >= 0, behind, 0)
        case "rays":
            needed = before + 1
        case "light":
            needed = 2 + np.where(behind >= 0, behind, 0)
        case _:
            return []
    cut = (needed > depth) & (before + np.maximum(behind, 0) > 0)
    if not cut.any():
        return []
    most = "at least " if needed.max() >= _FACES else "up to "
    share = f"{100 * cut.mean():.2g} %"
    return [
        f"Cut: depth = {depth} ends light on its way by {faces} in {share} of the pixels, "
        f"where {most}{needed.max()} pieces lie between eye and lamp; set depth to "
        f"{needed.max()} or more."
    ]


def _grid(view: View) -> tuple[Array, Array]:
    """Return the rows and columns of the pixels of a coarse grid."""
    axes = (
        (np.arange(min(size, _SIDE)) + 0.5) * size / min(size, _SIDE) - 0.5
        for size in view.resolution
    )
    rows, columns = np.meshgrid(*axes, indexing="ij")
    dtype = view.pixel_pitch.dtype
    return jnp.asarray(rows.ravel(), dtype), jnp.asarray(columns.ravel(), dtype)


@eqx.filter_jit
def _count_faces(
    scene: Scene, view: View, rows: Float[Array, " n"], columns: Float[Array, " n"]
) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """Return two numbers for each pixel. The first is the number of mirror and glass faces that its
    ray hits before another surface. The second is the largest number of glass faces on the straight
    line from that surface to a lamp, or -1 if every lamp is hidden."""
    surfaces = surfaces_of(scene)
    turning = jnp.asarray([is_delta(surface.material) for surface in scene.surfaces])
    glass = jnp.asarray([is_body(surface.material) for surface in scene.surfaces])

    def count_in_pixel(row: Array, column: Array) -> tuple[Array, Array]:
        ray = view_ray(view, row, column)
        everywhere = jnp.full_like(row, jnp.inf)
        ray, _, before = _follow(surfaces, ray, everywhere, turning, bent=True)
        met = meet(surfaces, ray)
        behind = jnp.full((), -1, jnp.int32)
        for light in scene.lights:
            if isinstance(light, RectangleLight):
                middle = light.corner + (light.edge_u + light.edge_v) / 2
                toward = as_vec(middle) - met.hit.point
                direction, distance = as_vec(normalize(toward)), norm(toward)
            elif not can_be_seen(light):
                arriving = incident(light, as_array(met.hit.point))
                direction = as_vec(arriving.direction)
                distance = everywhere if arriving.distance is None else arriving.distance
            else:
                continue
            away = leave(met, ray, direction, met.surface >= 0)
            last, left, count = _follow(surfaces, away, distance, glass, bent=False)
            ahead = meet(surfaces, last)
            free = (met.surface >= 0) & ((ahead.surface < 0) | (ahead.hit.distance >= left))
            behind = jnp.maximum(behind, jnp.where(free, count, -1))
        return before, behind

    return jax.vmap(count_in_pixel)(rows, columns)


def _follow(
    surfaces: Surfaces, ray: Ray, distance: Array, through: Array, *, bent: bool
) -> tuple[Ray, Array, Int[Array, ""]]:
    """Follow a ray through successive surfaces for which `through` is true, within a distance in m.
    If `bent`, the ray continues in the brighter of the mirrored and the refracted direction,
    otherwise straight on. Return the last ray, the remaining distance, and the number of surfaces
    passed."""

    def step(state: tuple[Ray, Array, Array], _: None) -> tuple[tuple[Ray, Array, Array], None]:
        ray, left, count = state
        met = meet(surfaces, ray)
        goes = (met.surface >= 0) & through[jnp.maximum(met.surface, 0)]
        goes &= met.hit.distance < left
        direction = as_vec(ray.direction)
        if bent:
            ways = branches(surfaces, met, -direction, bands=1)
            bright = ways.mirrored_weight.max() > ways.refracted_weight.max()
            direction = as_vec(where(bright, ways.mirrored, ways.refracted))
        left = jnp.where(goes, left - met.hit.distance, left)
        return (
            leave(met, ray, as_vec(direction), goes),
            left,
            count + goes.astype(jnp.int32),
        ), None

    ray = Ray(as_vec(ray.origin), as_vec(ray.direction))
    start = ray, distance, jnp.zeros((), jnp.int32)
    found, _ = scan(step, start, None, length=_FACES)
    return found
