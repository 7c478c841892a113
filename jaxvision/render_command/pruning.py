"""Implement `jaxvision effects` and `render --tolerance`: list the effects of a scene file, and
drop the negligible ones."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from .. import effects
from ..core._shown import aligned_columns
from ..effects import Effect, Pruned, Tolerance
from ..effects.pruning import WORTH, looking_pays
from ..errors import InputError
from ..files.scenes import SceneFile
from ..files.scenes.schema import RenderEntry
from ..rendering import PixelSamples
from ..rendering.band_count import band_count
from ..scene import Camera, View
from .integrators import named_text

CUT = "path", "light"  # integrators whose paths may be limited to fewer segments
_NAMED = 4  # largest number of effects named in one line
_ENDLESS = 400  # number of segments that stands for paths followed to their end, as by radiosity
Box = dict[str, tuple[Any, Any]]


def _parse_request(settings: RenderEntry) -> dict[str, Any]:
    """Return the arguments `samples` and `depth` of `effects.inspect` for the integrator of a scene
    file."""
    samples, depth = None, None
    if settings.samples > 1 or settings.integrator == "path":
        samples = PixelSamples(jax.random.key(settings.seed), settings.samples)
    match settings.integrator:
        case "path" | "light":
            depth = settings.depth
        case "rays":
            depth = settings.depth + 1
        case "radiosity":
            depth = _ENDLESS
    whole = depth is not None and settings.integrator not in CUT
    caustics = settings.integrator == "light"
    return {"samples": samples, "depth": depth, "whole_paths": whole, "caustics": caustics}


def _combine_camera(source: SceneFile, camera: Camera | None) -> Camera | View:
    """Return the view of the scene, combined with the sensor of a camera if one is given."""
    if camera is None:
        return source.view
    conversion, scene = camera.sensor.photon_conversion, source.scene
    own = 1 if conversion is None else np.size(conversion.wavelength)
    bands = band_count([surface.material for surface in scene.surfaces], scene.lights)
    if own not in (1, bands):
        raise InputError(
            f"the camera has {own} bands and the scene {bands}; give the scene file [bands] with "
            "its spectra, or take a camera of one wavelength, as ideal."
        )
    return replace(camera, view=source.view)


def inspect_scene(
    source: SceneFile, settings: RenderEntry, *, camera: Camera | None = None, **asked: Any
) -> tuple[Effect, ...]:
    """List the effects of a scene file and, if a camera is given, of its sensor. Times are measured
    for direct light and paths; `InputError` for the times of another integrator. Further arguments
    are passed to `effects.inspect`."""
    if asked.get("time") and settings.integrator not in ("direct", "path"):
        raise InputError(f"--time measures direct light and paths; this is {settings.integrator}.")
    seen = _combine_camera(source, camera)
    return effects.inspect(source.scene, seen, **_parse_request(settings), **asked)


def prune_scene(
    source: SceneFile,
    settings: RenderEntry,
    tolerance: Tolerance | str,
    *,
    camera: Camera | None = None,
    **asked: Any,
) -> Pruned:
    """Return the scene without the effects whose change is within a tolerance, with a certificate.
    Further arguments are passed to `effects.prune`."""
    seen = _combine_camera(source, camera)
    try:
        return effects.prune(source.scene, seen, tolerance, **_parse_request(settings), **asked)
    except InputError as error:
        raise InputError(named_text(source, str(error))) from error


def prune_losslessly(source: SceneFile, settings: RenderEntry) -> Pruned | None:
    """Return the scene without the effects that provably change nothing, with bounds of 0 W m^-2
    sr^-1, or None. The result is None for an integrator other than "direct" and "rays", if lamps
    are sampled at random, if the search would take more than a twentieth of the rendering time, or
    if dropping the effects saves less than 3 % of the rendering time. These times are estimated
    from the numbers of rays and surfaces, not measured, so that a resumed render makes the same
    choice."""
    if settings.integrator not in ("direct", "rays") or settings.rule != "quadrature":
        return None
    rays = math.prod(source.view.resolution) * settings.samples
    if not looking_pays(source.scene, rays=rays, nodes=settings.order**2):
        return None
    pruned = prune_scene(source, settings, Tolerance(0.0), level=1.0)
    return pruned if pruned.certificate.saves > WORTH else None


def lossless_sentence(source: SceneFile, pruned: Pruned) -> str:
    """Describe in one line which effects `prune_losslessly` has dropped from `source`, by the names
    in the file."""
    names = [name_effect(source, effect).name for effect in pruned.certificate.dropped]
    shown = ", ".join(names[:_NAMED])
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"Left out what changes nothing: {shown}{more} (--keep-all keeps it)."


def pruned_scene(
    source: SceneFile, settings: RenderEntry, pruned: Pruned | None
) -> tuple[SceneFile, RenderEntry]:
    """Return the scene file and the settings with the pruned scene, with lengths in m, or unchanged
    if `pruned` is None. The pruned scene has fewer bands if `pruned.expand` reconstructs the
    others."""
    if pruned is None:
        return source, settings
    gone = {effect.name for effect in pruned.certificate.dropped}
    lights, surfaces = (
        tuple(own for k, own in enumerate(names) if f"{kind}[{k}]" not in gone)
        for kind, names in (("lights", source.lights), ("surfaces", source.surfaces))
    )
    view = pruned.camera.view if isinstance(pruned.camera, Camera) else pruned.camera
    bands = source.bands if pruned.expand is None else pruned.expand.shape[1]
    left = replace(source, scene=pruned.scene, view=view, bands=bands)
    left = replace(left, lights=lights, surfaces=surfaces)
    if pruned.depth is None or settings.integrator not in CUT:
        return left, settings
    return left, settings.model_copy(update={"depth": min(pruned.depth, settings.depth)})


def box_of(free: Sequence[str]) -> Box:
    """Convert repeated arguments `NAME=LOW,HIGH` to the ranges of free parameters, in the unit of
    each field."""
    found: Box = {}
    for text in free:
        name, _, ends = text.partition("=")
        try:
            low, high = (float(end) for end in ends.split(","))
        except ValueError:
            raise InputError(
                f"--free {text}: give a name and two numbers, as in "
                "--free lights[0].intensity=0,10."
            ) from None
        found[name.strip()] = low, high
    return found


def name_effect(source: SceneFile, effect: Effect) -> Effect:
    """Add, to the name of an effect, the name that the scene file gives to the surface or light."""
    place = re.match(r"(surfaces|lights|shadows)\[(\d+)\]", effect.name)
    if place is None:
        return effect
    names = source.surfaces if place[1] == "surfaces" else source.lights
    _, quoted, own = names[int(place[2])].partition(' "')
    return replace(effect, name=f'{effect.name} "{own}') if quoted else effect


def listed(found: Iterable[Effect]) -> str:
    """Format effects as lines of text: each bound in its own unit, displacements in pixels, and
    measured times in ms."""
    found = list(found)
    timed = any(effect.seconds is not None for effect in found)
    rows = [("effect", "bound", "", "pixels", "ms" if timed else "saves", "rank", "why")]
    for effect in found:
        none = math.isinf(effect.bound)
        bound, unit = ("not bounded", "") if none else (f"{effect.bound:.3g}", effect.unit)
        why = effect.why if effect.present else "absent"
        taken = f"{100 * effect.saves:.0f} %"
        if timed:
            taken = "" if effect.seconds is None else f"{1e3 * effect.seconds:.2f}"
        rows.append((effect.name, bound, unit, f"{effect.place:.2g}", taken, effect.rank, why))
    return aligned_columns(rows)


def smaller(source: SceneFile, pruned: Pruned) -> str:
    """Return the end of a sentence, which states by how many per cent dropping the effects makes
    the program for direct light smaller."""
    left, _ = pruned_scene(source, source.render, pruned)
    before, after = (effects.equations(own.scene, own.view) for own in (source, left))
    share = 1 - after / np.maximum(before, 1)
    return f"; program {100 * share:.0f} % smaller."
