"""Bound the change of radiance by each effect of a scene.

Each function has the name of an effect and returns the `Row` of that effect. A bound is the
supremum over all cells of the surfaces that a pixel may see. A bound ignores effects that only
remove light, so that it is valid for every scene between the full and the pruned one. Radiance is
in W m^-2 sr^-1, lengths in m; computed in NumPy float64.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..brdf import lambertian
from ..core._maps import ENDS, is_map, maps_of, mean_of, replace_maps
from ..scene import AmbientLight, Scene, TriangleMesh, View
from .bodies import body_of, heights, is_closed, numbers, stacked
from .bounces import EMITTED, Onward
from .boxes import setting, value_at
from .cells import anywhere, eye_of, part_of, visible_flags
from .directions import lens_spread_bound
from .extent import extent_change
from .illumination import times
from .reflection import Lobe, absorbs, reflection_of
from .stages import Arriving, Draft, Drop, Ends, Gone, Row
from .sums import (
    Sums,
    ambient_reflected,
    direct_radiance,
    emitted,
    geometry_of,
    lobe_sent,
    picture_maximum,
    reflected_light,
    sums_of,
)

# The share of a picture's computation that an effect takes, as measured by the benchmarks.
_SAVES = {"light": 0.3, "shadows": 0.4, "lobe": 0.2, "extent": 0.9}
_REST = 0.02  # the same for every other effect


def scene_stage(
    scene: Ends[Scene], view: Ends[View], *, depth: int | None = None, caustics: bool = False
) -> tuple[tuple[Row, ...], Arriving, Onward]:
    """Return a `Row` for every effect of a scene over the range of its free parameters. Also return
    bounds on the light at the camera, in W m^-2 sr^-1, and the suprema from which all bounds
    follow, with bounds on further reflections (`Onward`).

    `depth` is the largest number of path segments, or None for direct light, as in `render`. With
    `caustics`, paths also start at the lights.
    """
    eye, whole = eye_of(view), scene.low.surfaces
    varied = [[place for place, _ in maps_of(own)] for own in whole]
    if any(varied):
        low, high = (
            # `pruning` returns no bounds for a scene with a map of normals
            replace(
                end,
                surfaces=replace_maps(
                    tuple(replace(own, normals=None) for own in end.surfaces), pick
                ),
            )
            for end, pick in zip(scene, ENDS, strict=True)
        )
        scene = Ends(low, high)
    sums = sums_of(scene, eye, bounces=depth is not None, caustics=caustics)
    onward = Onward(sums, depth)
    rows = [
        *(
            row(sums, onward, k)
            for k, source in enumerate(sums.sources)
            for row in (light, shadows, extent)[: 3 if source.kind == "area" else 2]
        ),
        *(row for i in range(len(sums.surfaces)) for row in _surface_rows(sums, onward, i)),
        *(varied_by(sums, onward, i, place) for i, own in enumerate(varied) for place in own),
        ambient(scene, sums, onward),
    ]
    found = Arriving(top(sums, onward), *depths(sums), lens_spread_bound(sums, onward))
    return tuple(rows), found, onward


def top(sums: Sums, onward: Onward) -> np.ndarray:
    """Return the supremum of the picture's radiance, (bands,), visible lamps included."""
    found = onward(sums.sent_radiance[sums.cells.surface], pieces=EMITTED)
    for k in range(len(sums.sources)):
        found = found + onward(reflected_light(sums, k), reflected_light(sums, k, around=True))
    return np.maximum(picture_maximum(sums, found), direct_radiance(sums, sums.shown))


def depths(sums: Sums) -> tuple[float, float]:
    """Return the smallest and largest depth, m along the axis, of all that may be in view."""
    eye = sums.eye
    found = [body_of(surface.field("shape")) for surface in sums.surfaces]
    lamps = [
        source.body if source.kind == "area" else None
        for source, visible in zip(sums.sources, sums.visible, strict=True)
        if visible
    ]
    near, far = np.inf, 0.0
    for body in [*found, *lamps]:
        if body is None or eye.everywhere:
            near, far = 0.0, np.inf
        elif visible_flags(eye, bodies := stacked([body]))[0]:
            moved = bodies._replace(points=bodies.points - eye.place)
            forward = eye.rotation[2][None]
            near = min(near, max(float(-heights(moved, -forward)[0, 0]) - eye.moves, 0.0))
            far = max(far, float(heights(moved, forward)[0, 0]) + eye.moves)
    return near, far


# ---------------------------------------------------------------- lights


def light(sums: Sums, onward: Onward, k: int) -> Row:
    """Bound the effect of dropping a light. A visible light also hides the objects behind it, even
    if the light is dark. A pixel that sees the light changes by at most the larger of the light's
    radiance and the largest radiance of the picture. Likewise, a mirror may show other lights that
    were hidden behind the dropped light. As long as the light's shadows are not dropped, cells in
    its full shadow are excluded."""
    source, dark = sums.sources[k], sums.dark[k]
    why = source.why or type(sums.lights[k].low).__name__
    hides = source.kind == "area" and (sums.visible[k] or onward.depth is not None)
    least = np.maximum(sums.shown[k], top(sums, onward) if hides else 0)
    why += ", may be seen" if hides else ""

    def amount(within: np.ndarray) -> np.ndarray:
        lamp, around = (
            reflected_light(sums, k, around=any_viewer, only=within) for any_viewer in (False, True)
        )
        lit = picture_maximum(sums, onward(lamp, around))
        return np.maximum(np.maximum(lit, _mirrored_radiance(sums, k, within)), least)

    name = f"lights[{k}]"
    whole = amount(np.ones(len(dark), bool))
    row = Row(name, whole, why, setting(name), saves=_SAVES["light"])
    if onward.depth is not None or not dark.any():
        return row
    why += f"; {100 * np.mean(dark[sums.seen]):.0f} % in full shadow" if sums.seen.any() else ""
    lit, shadows = amount(~dark), f"shadows[{k}]"

    def bound_without(gone: Gone) -> np.ndarray:
        return whole if shadows in gone else lit

    return replace(row, amount=lit, why=why, after=bound_without)


def _mirrored_radiance(sums: Sums, k: int, within: np.ndarray) -> np.ndarray:
    """Return the largest radiance, (bands,), that mirrors may show in place of a dropped lamp."""
    if sums.sources[k].kind != "area":
        return np.zeros(sums.spectrum.shape[1])
    extended = np.array([own.extended for own in sums.sources])[:, None]
    behind = times(direct_radiance(sums, np.where(extended, sums.spectrum, 0)), sums.k_mirror)
    shown = within & sums.mirrored[k]
    return picture_maximum(sums, np.where(shown[:, None], behind[sums.cells.surface], 0))


def shadows(sums: Sums, onward: Onward, k: int) -> Row:
    """Bound the effect of a lamp's shadows by all light that the lamp sends to surfaces that may be
    in shadow. The bound is 0 if no surface can be in shadow."""
    count, whole = int(sums.blocked[k].sum()), sums.blocked[k].size
    amount = picture_maximum(sums, reflected_light(sums, k, only=sums.shaded[k]))
    why = f"{count} of {whole} pairs of receiver and occluder may block"
    if onward.depth is not None:
        why = "path tracing includes shadows; they cannot be dropped separately"
        return Row(f"shadows[{k}]", amount + np.inf, why, None, saves=_REST, part_of=f"lights[{k}]")

    def drop(draft: Draft) -> Draft:
        return replace(draft, shadowless=draft.shadowless | {k})

    saves = _SAVES["shadows"] if sums.searched else _REST
    owner = f"lights[{k}]"
    return Row(f"shadows[{k}]", amount, why, drop, saves=saves, part_of=owner, together="shadows")


def extent(sums: Sums, onward: Onward, k: int) -> Row:
    """Bound the change if a rectangular lamp is replaced by a `SmallLight` at its centre."""
    amount, small, why = extent_change(sums, k)
    if onward.depth is not None:
        amount, why = amount + np.inf, "paths meet the lamp, which hides the objects behind it"
    name, lamp = f"lights[{k}].extent", f"lights[{k}]"
    if small is None:
        return Row(name, _unknown(sums), why, None, saves=_REST, part_of=lamp)
    change = picture_maximum(sums, amount)
    if np.isinf(change).any():
        why += "; it is visible in a mirror, glass or a material without a bound"
    return Row(name, change, why, setting(lamp, to=small), saves=_SAVES["extent"], part_of=lamp)


def _unknown(sums: Sums) -> np.ndarray:
    """Return inf for each band, (bands,), because no bound is known."""
    return np.full(sums.spectrum.shape[1], np.inf)


# ---------------------------------------------------------------- surfaces


def _surface_rows(sums: Sums, onward: Onward, i: int) -> Iterator[Row]:
    surface, reflection = sums.surfaces[i], sums.reflections[i]
    name, material = f"surfaces[{i}]", surface.low.material
    if reflection.lobe is not None:
        yield lobe(sums, onward, i)
    if reflection.facets is not None:
        yield interface(sums, onward, i)
    if np.any(reflection.plain) or reflection.rough is not None:
        yield roughness(sums, onward, i)
    if reflection.mirror is not None:
        why = "a mirror or glass, replaced by black, shows the scene no longer: no bound is known"
        black = _make_lambertian(i, sums.spectrum.shape[1])
        yield Row(f"{name}.material", _unknown(sums), why, black, saves=_REST)
    if absorbs(material):
        yield absorption(sums, onward, i)
    if surface.low.emission is not None:
        yield emission(sums, onward, i)
    if isinstance(surface.low.shape, TriangleMesh) and surface.low.shape.normals is not None:
        why = "rotates the shading normals of a mesh: no bound is known"
        flat = setting(f"{name}.shape.normals")
        yield Row(f"{name}.shape.normals", _unknown(sums), why, flat, saves=_REST)


def _largest_sent(
    sums: Sums,
    onward: Onward,
    i: int,
    reflect_light: Callable[[int, bool, slice], np.ndarray],
    others: np.ndarray,
) -> np.ndarray:
    """Bound the light in the picture, (bands,), that surface i reflects from all lights and from
    other surfaces. `others`, (bands,), bounds the light from other surfaces. `reflect_light(k,
    around, part)` bounds the light of lamp k that each cell of a slice reflects, (p, bands), toward
    the eye or, if `around`, toward any viewer."""
    part = part_of(sums.cells, i)

    def sent_radiance(around: bool) -> np.ndarray:
        none = np.zeros((part.stop - part.start, sums.spectrum.shape[1])) + others
        return sum((reflect_light(k, around, part) for k in range(len(sums.sources))), none)

    cells, seen = sent_radiance(False), sums.seen[part, None]
    if onward.depth is None:
        return np.max(cells, axis=0, initial=0, where=seen)
    later = onward.radiance_from(i, sent_radiance(True).max(0))
    found = np.max(later, axis=0, initial=0, where=onward.may_be_seen[:, None])
    return np.maximum(found, np.max(cells + later[i], axis=0, initial=0, where=seen))


def _make_lambertian(i: int, bands: int = 1) -> Drop:
    """Return a function that reduces a surface to its diffuse part, or to black in that many
    bands."""
    name = f"surfaces[{i}].material"
    return lambda draft: setting(name, to=lambertian(value_at(draft, name), bands=bands))(draft)


def lobe(sums: Sums, onward: Onward, i: int) -> Row:
    """Bound the change of the picture if a specular lobe is dropped and a Lambertian surface with
    the same k_d remains. The bound is the largest radiance that the lobe reflects."""
    material = sums.surfaces[i].low.material
    others = times(_size(sums.reflections[i].lobe) * sums.k_lobe[i], onward.lobe_radiance(i))

    def reflect_light(k: int, around: bool, part: slice) -> np.ndarray:
        return lobe_sent(sums, k, around=around, part=part)

    amount = _largest_sent(sums, onward, i, reflect_light, others)
    plain = hasattr(material, "diffuse") and hasattr(material, "specular")
    why = f"the peak of the {type(material).__name__} lobe under all light"
    if not plain:
        why += ", whose body is not Lambertian"
    drop = _make_lambertian(i) if plain else None
    field = "material.specular" if hasattr(material, "specular") else "material"
    return Row(f"surfaces[{i}].{field}", amount, why, drop, saves=_SAVES["lobe"])


def _size(lobe: Lobe | None) -> float:
    return 0.0 if lobe is None else lobe.size


def interface(sums: Sums, onward: Onward, i: int) -> Row:
    """Bound the Fresnel reflectance of facets by the gain if they reflected all light."""
    facets = sums.reflections[i].facets
    assert facets is not None
    full: list[Lobe | None] = [None] * len(sums.surfaces)
    least, full[i] = facets
    own = sums if onward.depth is None else sums._replace(eye=anywhere(sums.eye))
    others = times(_size(full[i]) * sums.k_lobe[i], onward.earlier.max(0))
    each = zip(sums.sources, sums.nearest, sums.spectrum, strict=True)
    found = [
        times(geometry_of(own, source, near, full)[1][:, None], times(sums.k_lobe[i], spectrum))
        for source, near, spectrum in each
    ]
    amount = _largest_sent(sums, onward, i, lambda k, _, part: found[k][part], others) * (1 - least)
    name, why = f"surfaces[{i}].material", f"facets reflect at least {least:.3g}; costs little"
    return Row(f"{name}.interface", amount, why, None, saves=_REST, part_of=f"{name}.specular")


def roughness(sums: Sums, onward: Onward, i: int) -> Row:
    """Bound the difference between a rough or measured diffuse part and a Lambertian surface."""
    reflection, material = sums.reflections[i], sums.surfaces[i].low.material
    plain = np.broadcast_to(reflection.plain, sums.k_body.shape[1:])
    grazing = times(np.array(reflection.grazing), sums.k_body[i])

    def reflect_light(k: int, _: bool, part: slice) -> np.ndarray:
        even = times(sums.body[k][part, None], times(plain, sums.spectrum[k]))
        return even + times(sums.facing[k][part, None], times(grazing, sums.spectrum[k]))

    others = times(np.pi * (plain + 2 * grazing), onward.diffuse_radiance(i))
    amount = _largest_sent(sums, onward, i, reflect_light, others)
    name = f"surfaces[{i}].material"
    if np.isinf(plain).any() or not hasattr(material, "diffuse"):
        why = reflection.why or f"{type(material).__name__} has no Lambertian part"
        return Row(name, amount + np.inf, why, None, saves=_REST)
    field, why = reflection.rough or ("", f"{type(material).__name__} to Lambert")
    name = f"{name}.{field}" if field else name
    return Row(name, amount, why, _make_lambertian(i), saves=_SAVES["lobe"])


def varied_by(sums: Sums, onward: Onward, i: int, place: str) -> Row:
    """Bound the change if a map is replaced by its mean. If the light of the diffuse part is
    proportional to k_d, a map of k_d changes this light by at most the relative range of the map.
    The same holds for the specular lobe and k_s. For any other map, the bound is all light that the
    surface reflects."""
    own, material = sums.reflections[i], sums.surfaces[i].field("material")
    bands, field = sums.k_body.shape[1], place.removeprefix("material.")
    of_body = of_lobe = np.ones(bands)
    why = "replaced by its mean: at most all light that the surface reflects"
    if field in ("diffuse", "specular") and _is_proportional(material, field):
        low, high = (numbers(getattr(end, field)) * np.ones(bands) for end in material)
        share = np.divide(high - low, high, out=np.zeros(bands), where=high > 0)
        of_body, of_lobe = (share, 0 * share) if field == "diffuse" else (0 * share, share)
        why = f"replaced by its mean, within {share.max():.3g} of its largest value"
    k_body = of_body * sums.k_body[i]
    others = times(np.pi * (1 + own.grazing) * k_body, onward.diffuse_radiance(i))
    others = others + times(_size(own.lobe) * of_lobe * sums.k_lobe[i], onward.lobe_radiance(i))

    def reflect_light(k: int, around: bool, part: slice) -> np.ndarray:
        body = times(sums.body[k][part, None], times(k_body, sums.spectrum[k]))
        return body + times(of_lobe, lobe_sent(sums, k, around=around, part=part))

    amount = _largest_sent(sums, onward, i, reflect_light, others)
    if field == "ambient":
        amount = sums.ambient[i]
    if own.mirror is not None or not place.startswith("material."):
        amount, why = amount + np.inf, "a map of a mirror or of normals has no bound"

    name = f"surfaces[{i}].{place}"

    def drop(draft: Draft) -> Draft:
        found = value_at(draft, name)
        return setting(name, to=mean_of(found))(draft) if is_map(found) else draft

    drops = None if place == "normals" else drop
    return Row(f"{name}.map", amount, why, drops, saves=_REST)


def _is_proportional(material: Ends[Any], field: str) -> bool:
    """Return whether the upper bound on the light that a material reflects, by its body or by its
    lobe, doubles if a field doubles."""
    twice = Ends(*(replace(end, **{field: 2 * getattr(end, field)}) for end in material))
    one, other = reflection_of(material), reflection_of(twice)
    if field == "diffuse":
        return bool(np.allclose(other.body, 2 * one.body, rtol=1e-6, atol=0))
    if one.lobe is None or other.lobe is None:
        return False
    return bool(np.allclose(other.lobe.spectrum, 2 * one.lobe.spectrum, rtol=1e-6, atol=0))


def emission(sums: Sums, onward: Onward, i: int) -> Row:
    """Bound the effect of the radiance that a surface emits."""
    own = emitted(sums.surfaces, sums.sent_radiance.shape[1])
    own[np.arange(len(own)) != i] = 0
    amount = picture_maximum(sums, onward(own[sums.cells.surface], pieces=EMITTED))
    name = f"surfaces[{i}].emission"
    return Row(name, amount, "emits light", setting(name), saves=_REST)


def absorption(sums: Sums, onward: Onward, i: int) -> Row:
    """Bound the effect of absorption in glass: the share 1 - exp(-a x) of the largest radiance of
    the picture, with the absorption coefficient a. The length x of a path inside the glass is at
    most the number of segments times the diameter of the glass body. There is no bound for a
    surface that is not closed. Under direct light, glass is black, and the effect is 0."""
    material, shape = sums.surfaces[i].field("material"), sums.surfaces[i].field("shape")
    a = np.max([numbers(end.absorption).max() for end in material])
    body = body_of(shape)
    if onward.depth is None:
        amount, why = np.zeros(sums.sent_radiance.shape[1]), "direct light does not pass glass"
    elif body is None or a > 0:
        length = np.inf
        if body is not None and is_closed(shape):
            points, radii = body
            middle = points.mean(0)
            length = 2 * (np.linalg.norm(points - middle, axis=1) + radii).max() * onward.depth
        share = -np.expm1(-a * length)
        amount, why = top(sums, onward) * share, f"absorbs at most {share:.3g} along a path"
    else:
        amount, why = np.zeros(sums.sent_radiance.shape[1]), "absorbs nothing"
    name = f"surfaces[{i}].material.absorption"
    return Row(name, amount, why, setting(name), saves=_REST)


def ambient(scene: Ends[Scene], sums: Sums, onward: Onward) -> Row:
    """Bound the effect of ambient light by the largest k_a L_a of a visible surface, with the
    ambient reflectance k_a and the ambient radiance L_a. Light transport ignores ambient light."""
    present = scene.low.ambient is not None
    own = ambient_reflected(scene, sums.surfaces, sums.sent_radiance.shape[1])
    if onward.depth is not None:
        own = 0 * own
    amount = picture_maximum(sums, own[sums.cells.surface])
    kind = AmbientLight.__name__ if present else "absent"
    return Row("ambient", amount, kind, setting("ambient"), saves=_REST, present=present)
