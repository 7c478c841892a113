"""List the effects of a scene and a camera (`inspect`), and drop effects within a tolerance
(`prune`). `inspect` and `prune` cannot be traced by JAX. Radiance is in W m^-2 sr^-1."""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..rendering import PixelSamples, render
from ..scene import Camera, Scene, Sensor, ThinLens, TriangleMesh, View
from ..transport import missing_light
from .boxes import Box, ends_of, keeps, refuse_tracers, same, unbounded
from .certificate import Effect, Pruned, Tolerance, parse
from .choice import Chain, Choice, bands_of, concerns, finished
from .development import development_stage
from .illumination import has_size
from .moments import scene_rows
from .motion import moments_of, motion_stage
from .optics import optics_stage
from .probes import SIDE, coarse_view, paired_effects
from .seconds import Advance, seconds_of
from .sensor import sensor_stage
from .stages import FAST, Draft, Ends, Method, Row, unproved

_MOVABLE = "surfaces[", "shadows[", "ambient", "view."  # effects of fields that a motion may change
WORTH = 0.03  # share of the work, below which an effect that changes nothing is kept
_probe = jax.jit(render, compiler_options=FAST)


def _chain(scene: Ends[Scene], camera: Ends[Camera], method: Method) -> Chain:
    """Return a `Row` for every effect. For a view, only the effects of the scene and the lens are
    included."""
    view, sensor = camera.field("view"), camera.field("sensor")
    rows, arriving = scene_rows(scene, view, sensor.high, method)
    aperture = sensor.low.pixel_aperture
    finer = 1 if aperture is None else aperture.oversampling
    of_lens, on_sensor = optics_stage(view, arriving, samples=method.samples, oversampling=finer)
    rows += of_lens
    if not method.whole:
        return Chain(rows, on_sensor.opening)
    rows += motion_stage(scene, view, method.motion, sensor=sensor, moments=method.moments)
    shape = view.low.resolution
    of_sensor, response = sensor_stage(sensor, on_sensor.irradiance, shape=shape)
    rows += of_sensor + development_stage(camera.field("development"))
    return Chain(rows, on_sensor.opening, response.dn, response.dark)


def _chain_of(scene: Scene, camera: Camera, free: Box | None, method: Method) -> Chain:
    """Return a `Row` for every effect. There are no bounds if a number is not finite or if a
    surface has a normal map."""
    refuse_tracers(scene, camera)
    depth = method.depth
    if depth is not None and (depth < 1 or depth != int(depth)):
        raise InputError(
            "depth must be a whole number of segments, at least 1, or None for direct light; got "
            f"{depth}."
        )
    if method.moments < 1:
        raise InputError(f"moments must be at least 1, got {method.moments}.")
    if method.motion is not None and camera.sensor.exposure_time is None:
        raise InputError(
            "a motion is bounded at the moments of an exposure; give a Camera whose sensor has an "
            "exposure_time, or leave the motion out."
        )
    ends, wrong = ends_of(scene, camera, free), unbounded(scene, camera)
    wrong = wrong and f"{wrong} is not finite"
    for i, surface in enumerate(scene.surfaces):
        if surface.normals is not None:
            wrong = wrong or f"surfaces[{i}].normals turns the shading by any angle"
    if not wrong:
        return _chain(*ends, method)
    with np.errstate(all="ignore"):
        chain = _chain(*ends, method)
    why = f"{wrong}, and nothing is proved"
    return replace(
        chain, rows=tuple(unproved(row, why) if row.present else row for row in chain.rows)
    )


def _camera_of(camera: Camera | View) -> Camera:
    return camera if isinstance(camera, Camera) else Camera(camera, Sensor())


def inspect(
    scene: Scene,
    camera: Camera | View,
    *,
    free: Box | None = None,
    samples: PixelSamples | None = None,
    motion: Any = None,
    moments: int = 8,
    depth: int | None = None,
    estimates: bool = False,
    whole_paths: bool = False,
    caustics: bool = False,
    time: bool = False,
    advance: Advance | None = None,
) -> tuple[Effect, ...]:
    """List every effect of a scene and a camera, with a bound on its change of the picture.

    Args:
        scene: surfaces and lights.
        camera: a whole camera, or a view; with a view, only effects of the scene and the lens are
            listed.
        free: names of fields that a fit may change, each with its smallest and its largest value,
            in the field's unit; all bounds are valid over this whole range.
        samples: as in `capture`; a thin lens needs them for defocus.
        motion: as in `capture`, or None; a motion needs a camera whose sensor has an exposure time.
        moments: number of times at which a motion is evaluated, as in `capture`.
        depth: number of segments of the longest path, as in `transport.Paths`; None for direct
            light, as in `render`.
        estimates: whether changes of radiance are also estimated from small pictures: for long
            paths, and with and without each effect that has no bound below the brightest pixel. An
            estimate follows the bound as an `Effect` of rank "estimate". It is for the scene as
            given, whatever is free.
        whole_paths: whether the integrator follows all paths to their end, as radiosity does, so
            that the number of path segments cannot be reduced.
        caustics: whether paths start at the lights, as in `light_traced`: mirrors and glass then
            focus the light of lamps without size, for which there is no bound.
        time: whether to measure the rendering time of each effect too. Pictures of at most 256
            pixels along each side, with and without the effect, are timed alternately. Each effect
            that changes the program needs a compilation.
        advance: with `time`, a function that is called with two numbers: of programs compiled so
            far, and of all programs.

    Returns:
        An `Effect` for each effect. Bounds are in W m^-2 sr^-1 for effects of the scene, in W m^-2
            for effects of the lens, and in DN for effects of the sensor; displacements are in
            pixels.

    Raises:
        ValueError: for records with traced numbers.
        InputError: for an unknown name in `free`, a motion without an exposure time, and numbers of
            segments or moments below 1.

    Example:
        >>> from jaxvision import effects
        >>> floor = jv.Surface(jv.Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), jv.Lambert([0.25]))
        >>> scene = jv.Scene(floor, jv.PointLight([0.5, 0.5, 2.0], [8.0]))
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0.5, 0.5, 3], down, 0.1, resolution=(8, 8))
        >>> for effect in effects.inspect(scene, view):
        ...     print(effect.name, round(effect.bound, 3), effect.rank)
        lights[0] 0.5 bound
        shadows[0] 0.0 exact
        ambient 0.0 exact
    """
    whole, own = isinstance(camera, Camera), _camera_of(camera)
    paths = estimates, whole_paths, caustics
    method = Method(whole, depth, samples, motion, moments, *paths)
    chain = _chain_of(scene, own, free, method)
    rows, start, found = chain.rows, _start(scene, own, method), []
    taken, paired = [None] * len(rows), [None] * len(rows)
    if time:
        taken = seconds_of(rows, start, scene, whole=whole, advance=advance)
    if estimates:
        paired = list(paired_effects(rows, start, scene))
    for row, seconds, estimate in zip(rows, taken, paired, strict=True):
        fixed = not any(concerns(name, row.name) for name in free or ())
        found += [
            replace(effect, free=not fixed, seconds=seconds)
            for effect in (row.effect, estimate)
            if effect is not None
        ]
    return tuple(found)


def _start(scene: Scene, camera: Camera, method: Method) -> Draft:
    """Return the `Draft` that contains all effects."""
    everything = scene.surfaces, scene.lights, frozenset[int](), scene.ambient, camera
    return Draft(*everything, method.samples, method.motion, method.moments, method.depth)


def prune(
    scene: Scene,
    camera: Camera | View,
    tolerance: Tolerance | str,
    *,
    free: Box | None = None,
    level: float | None = None,
    samples: PixelSamples | None = None,
    motion: Any = None,
    moments: int = 8,
    depth: int | None = None,
    estimates: bool = False,
    whole_paths: bool = False,
    caustics: bool = False,
) -> Pruned:
    """Drop the effects of a scene and a camera whose total change is within a tolerance.

    Args:
        scene, camera, free, samples, motion, moments, depth: as in `inspect`. Free fields are never
            removed.
        tolerance: the record, or its text for `parse`. A "relative" tolerance is a fraction of
            `level`, and no effect of the sensor is dropped; "DN" and "sigma" need a whole camera.
        level: reference radiance of a "relative" tolerance, W m^-2 sr^-1; None renders a small
            picture and uses its brightest pixel.
        estimates: whether to also remove effects whose bound is an estimate, not a proof; the
            estimates for long paths come from small pictures.
        whole_paths, caustics: as in `inspect`.

    Returns:
        The remaining scene and camera, with a certificate of the removed effects. The indices of
        lights and surfaces after a removed one decrease.

    Raises:
        ValueError: for records with traced numbers.
        InputError: as for `inspect`, for a unit that needs a camera where only a view is given, and
            for a black picture if `level` is None.

    Example:
        >>> from jaxvision import effects
        >>> floor = jv.Surface(jv.Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), jv.Lambert([0.25]))
        >>> lamps = [jv.PointLight([0.5, 0.5, z], [8.0]) for z in (2.0, 200.0)]
        >>> down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
        >>> view = jv.Orthographic([0.5, 0.5, 3], down, 0.1, resolution=(8, 8))
        >>> pruned = effects.prune(jv.Scene(floor, lamps), view, "1%", level=0.5)
        >>> print(len(pruned.scene.lights), pruned.scene.occluders)
        1 ()
    """
    goal = parse(tolerance) if isinstance(tolerance, str) else tolerance
    if not isinstance(goal, Tolerance):
        raise InputError(
            f'tolerance must be a Tolerance or its text, as in "1%" or "0.5DN"; got {goal!r}.'
        )
    whole = isinstance(camera, Camera)
    if goal.unit != "relative" and not whole:
        raise InputError(f"a tolerance in {goal.unit} needs a camera with a sensor, got a view.")
    own = _camera_of(camera)
    paths = estimates, whole_paths, caustics
    method = Method(whole, depth, samples, motion, moments, *paths)
    chain = _chain_of(scene, own, free, method)
    if goal.unit == "relative":
        level = _level(scene, own.view) if level is None else float(level)
        if level == 0:
            why = " ".join(["", *missing_light(scene, integrator="direct", view=own.view)])
            raise InputError(
                "the small picture by direct light from which a relative tolerance takes its level "
                "is black; leave the tolerance out, or give a level above 0 or a tolerance in DN."
                + why
            )
        if not 0 < level < np.inf:
            raise InputError(
                f"the level of a relative tolerance must be above 0 and finite, got {level:g}."
            )
    else:
        level = None
    start = _start(scene, own, method)
    while True:
        choice = Choice(chain, goal, level, start, (scene, own), tuple(free or ()), estimates)
        choice.decide()
        alone = _new_kinds(scene, choice.draft)
        why = "without it, its surface would need a program of its own"
        bare = any(row.name.startswith(_MOVABLE) for row in choice.gone)
        if not alone and bare and not _has_same_motion(motion, choice, start, scene):
            alone, why = _MOVABLE, "the motion changes more than this"
        if not alone:
            return choice.result(scene, camera)
        chain = replace(
            chain,
            rows=tuple(
                replace(row, drop=None, why=f"{row.why}; {why}".removeprefix("; "))
                if row.drop is not None and row.name.startswith(alone)
                else row
                for row in chain.rows
            ),
        )


def looking_pays(scene: Scene, *, rays: int, nodes: int) -> bool:
    """Return whether pruning probably pays: `prune` must take less than a twentieth of the time to
    render direct light, without compilation. Rendering is assumed to take a nanosecond for each ray
    and surface, and the time of `prune` is a rough estimate too. `nodes` is the number of nodes of
    the rule for lamps with a size."""
    meshes = (s.shape for s in scene.surfaces if isinstance(s.shape, TriangleMesh))
    each = 2.5e-4 + 1.5e-4 * len(scene.lights)
    looking = 0.15 + each * len(scene.surfaces) + 5e-6 * sum(len(mesh.faces) for mesh in meshes)
    lamps = sum(nodes if has_size(light) else 1 for light in scene.lights)
    return looking <= 1e-9 * rays * (1 + lamps) * (len(scene.surfaces) + 4) / 20


def removals(
    scene: Scene, camera: Camera, **asked: Any
) -> tuple[dict[str, Effect], Callable[[Collection[str]], tuple[Scene, Camera] | None]]:
    """Return the effects that can be dropped, by name, and a function that drops effects. The
    function maps names of effects to the scene and camera without these effects, whatever their
    bounds, and returns None if the effects cannot be dropped together. `asked` holds `free`,
    `samples` and `depth`, as in `inspect`."""
    free, method = tuple(asked.pop("free", None) or ()), Method(**asked)
    chain, start = _chain_of(scene, camera, None, method), _start(scene, camera, method)
    parties: dict[str, list[Row]] = {}
    for row in chain.rows:
        if row.present and row.drop is not None and not row.ladder:
            parties.setdefault(row.together or row.name, []).append(row)

    def drop_names(names: Collection[str]) -> tuple[Scene, Camera] | None:
        rows = [row for name in parties if name in names for row in parties[name]]
        gone, draft = {row.name for row in rows}, start
        if not all(row.needs <= gone and not row.instead_of & gone for row in rows):
            return None
        for row in rows:
            if row.part_of not in gone and row.drop is not None:
                draft = row.drop(draft)
        whole = all(keeps(draft, name, scene, camera) for name in free)
        whole = whole and bands_of(draft) == bands_of(start)
        return (finished(scene, draft), draft.camera) if whole else None

    return {name: rows[0].effect for name, rows in parties.items()}, drop_names


def _new_kinds(scene: Scene, draft: Draft) -> tuple[str, ...]:
    """Return the materials that changed to a new type, which needs a program of its own."""
    before, after = (
        [jax.tree.structure(surface.material) for surface in surfaces]
        for surfaces in (scene.surfaces, draft.present_surfaces)
    )
    if len(set(after)) <= len(set(before)):
        return ()
    numbers = [k for k in range(len(before)) if k not in draft.unmet]
    new = [k for k, kind in zip(numbers, after, strict=True) if kind not in before]
    parted = [k for k in new if before[k] in after]
    return tuple(f"surfaces[{k}].material" for k in parted or new)


def _has_same_motion(motion: Any, choice: Choice, start: Draft, scene: Scene) -> bool:
    """Return whether the motion changes the pruned scene as it changes the full scene. The answer
    may be False because a motion may refer to a dropped surface or light, which raises an error, or
    add the dropped record again, or move another surface in its place."""
    draft = choice.draft
    if motion is None or draft.motion is None:
        return True
    sensor, view = draft.camera.sensor, draft.camera.view
    at_rest, left = (scene, start.camera.view), (finished(scene, draft), view)
    for time in moments_of(sensor, view.resolution[0], start.moments or 1):
        at = jnp.asarray(time, view.pixel_pitch.dtype)
        moved, seen = motion(*at_rest, at)
        own = replace(start, surfaces=moved.surfaces, lights=moved.lights, ambient=moved.ambient)
        own = replace(own, camera=replace(start.camera, view=seen))
        try:
            now = motion(*left, at)
            for row in choice.gone:
                own = row.drop(own) if row.drop is not None else own
        except Exception:  # an error of the caller's own function, for any reason
            return False
        if not same((finished(moved, own), own.camera.view), now):
            return False
    return True


def _level(scene: Scene, view: View) -> float:
    """Return the radiance, in W m^-2 sr^-1, of the brightest pixel of a coarse picture."""
    coarse = coarse_view(view, SIDE)
    if isinstance(coarse, ThinLens):
        coarse = replace(coarse, f_number=np.inf)
    picture = np.asarray(_probe(scene, coarse))
    finite = np.isfinite(picture)
    brightest = float(np.max(picture, initial=0, where=finite))
    if not brightest and not finite.all():
        raise InputError(
            "no pixel of the picture is finite and lit, so that there is no light to take a share "
            "of; look for a number in the scene that is not finite, or give a level."
        )
    return brightest
