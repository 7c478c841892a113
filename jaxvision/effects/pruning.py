"""`inspect` and `prune`: the rows of all stages in one unit, and what to leave out of them.

Effects go in order of what they can change over what they save, those of bound 0 first, until the
tolerance is used up. Bounds add, for the distance obeys the triangle inequality; each holds on
every picture on the way from the full to the pruned one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..rendering import PixelSamples, render
from ..scene import Camera, Scene, Sensor, View
from .bounces import bounce_rows
from .boxes import Box, ends_of, keeps, refuse_tracers
from .certificate import Certificate, Effect, Pruned, Tolerance, parse
from .radiance import scene_stage
from .spectra import band_rows, folded, with_bands
from .stages import Draft, Ends, Gone, Row
from .sums import Sums

_PROBE = 16  # pixels along each side of the picture that finds the level


@dataclass(frozen=True)
class _Chain:
    """The rows of all stages, and what turns a bound of theirs into DN."""

    rows: tuple[Row, ...]
    sums: Sums
    opening: float
    dn: Callable[[np.ndarray, Gone], float] | None
    dark: float


def _chain(
    scene: Ends[Scene],
    camera: Ends[Camera],
    *,
    depth: int | None,
    samples: PixelSamples | None,
    motion: Any,
    moments: int,
    whole: bool,
) -> _Chain:
    """The rows from the scene to the picture; of a bare view those of the scene alone."""
    view = camera.of("view")
    rows, arriving, sums = scene_stage(scene, view, depth=depth)
    rows += band_rows(sums, direct=depth is None) + bounce_rows(sums, depth)
    return _Chain(rows, sums, 1.0, None, 0.0)


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
) -> tuple[Effect, ...]:
    """Every effect of a scene and a camera, and the most that it does to the picture.

    Args:
        scene: surfaces and lights.
        camera: what the whole camera does; a bare view: only what reaches the lens.
        free: names of fields that a fit may change, each with its least and its largest value, in
            the field's unit; all bounds hold over the whole box.
        samples: as in `capture`; a thin lens defocuses with them.
        motion: as in `capture`, or None.
        moments: of a motion, as in `capture`.
        depth: pieces of the longest path that is followed, as `transport.Paths` counts them; None:
            direct light, as `render` shows it.

    Returns:
        One `Effect` each, its bound in the unit of its stage: W m^-2 sr^-1 of a scene, W m^-2 of a
        lens, DN of a sensor; places in pixels.

    Raises:
        ValueError: for records with traced numbers.
        InputError: for an unknown name in `free`.

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
    refuse_tracers(scene, camera)
    chain = _chain(
        *ends_of(scene, _camera_of(camera), free),
        depth=depth,
        samples=samples,
        motion=motion,
        moments=moments,
        whole=isinstance(camera, Camera),
    )
    named = frozenset(free or ())
    return tuple(
        replace(row.effect, free=any(_concerns(name, row.effect.name) for name in named))
        for row in chain.rows
    )


def _concerns(field: str, effect: str) -> bool:
    """Whether a free field is that of an effect, or within it."""
    return field == effect or field.startswith((f"{effect}.", f"{effect}["))


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
) -> Pruned:
    """A scene and a camera without the effects that a tolerance allows to leave out.

    Args:
        scene, camera, free, samples, motion, moments, depth: as in `inspect`. What is free is never
            left out.
        tolerance: or its text, as `parse` reads it. "relative" is of `level`, and leaves the sensor
            as it is; "DN" and "sigma" need a whole camera.
        level: W m^-2 sr^-1 that "relative" refers to; None: the brightest pixel of a small picture,
            which is rendered for it.
        estimates: whether effects may go by an estimate of what they do, which is no proof.

    Returns:
        What remains, with a certificate of what does not.

    Raises:
        ValueError: for records with traced numbers.
        InputError: for an unknown name in `free`, a unit that a bare view has not, and a picture
            without light as level.

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
    refuse_tracers(scene, camera)
    goal = parse(tolerance) if isinstance(tolerance, str) else tolerance
    whole = isinstance(camera, Camera)
    if goal.unit != "relative" and not whole:
        raise InputError(f"a tolerance in {goal.unit} needs a camera with a sensor, got a view.")
    own = _camera_of(camera)
    chain = _chain(
        *ends_of(scene, own, free),
        depth=depth,
        samples=samples,
        motion=motion,
        moments=moments,
        whole=whole,
    )
    if goal.unit == "relative":
        level = _level(scene, own.view) if level is None else float(level)
        if not level > 0:
            raise InputError(f"the level of a relative tolerance must be above 0, got {level:g}.")
    else:
        level = None
    start = Draft(
        scene.surfaces,
        scene.lights,
        frozenset(),
        scene.ambient,
        own,
        samples,
        motion,
        moments,
        depth,
    )
    choice = _Choice(chain, goal, level, start, (scene, own), tuple(free or ()), estimates)
    choice.decide()
    return choice.result(scene, camera)


def _level(scene: Scene, view: View) -> float:
    """W m^-2 sr^-1 of the brightest of a few pixels."""
    rows, columns = view.resolution
    scale = max(rows, columns) / _PROBE
    small = (max(round(rows / scale), 1), max(round(columns / scale), 1))
    coarse = replace(view, resolution=small, pixel_pitch=view.pixel_pitch * scale)
    if hasattr(coarse, "focus_distance"):
        coarse = replace(coarse, f_number=coarse.f_number * np.inf)
    picture = np.asarray(jax.jit(render)(scene, coarse))
    return float(np.max(picture, initial=0, where=np.isfinite(picture)))


class _Choice:
    """What is left, what is gone, and what that changed so far."""

    def __init__(
        self,
        chain: _Chain,
        goal: Tolerance,
        level: float | None,
        start: Draft,
        records: tuple[Scene, Camera],
        free: Sequence[str],
        estimates: bool,
    ) -> None:
        self.chain, self.goal, self.level, self.draft = chain, goal, level, start
        self.records, self.free, self.estimates = records, free, estimates
        self.total = self.estimated = self.place = self.rare = 0.0
        self.gone: list[Row] = []
        self.bounds: dict[int, float] = {}
        self.barred: set[int] = set()

    def bound(self, row: Row) -> float:
        """What a row changes at most, in the unit of the tolerance."""
        chain, gone = self.chain, frozenset(row.effect.name for row in self.gone)
        value = row.amount if row.after is None else row.after(gone)
        match row.effect.unit, self.goal.unit:
            case _ if np.max(value) == 0:
                return 0.0
            case "W m^-2 sr^-1", "relative":
                found = np.max(value) / self.level
            case "W m^-2", "relative":
                found = np.max(value) / chain.opening / self.level
            case _, "relative":
                return np.inf
            case "W m^-2 sr^-1", _:
                found = self._in_dn(value * chain.opening, gone)
            case "W m^-2", _:
                found = self._in_dn(value, gone)
            case _:
                found = float(np.max(value))
        if self.goal.unit == "sigma":
            found = found / chain.dark if chain.dark > 0 else np.inf
        return float(found) if found >= 0 else np.inf

    def _in_dn(self, change: np.ndarray, gone: Gone) -> float:
        assert self.chain.dn is not None
        return self.chain.dn(change, gone) if np.all(np.isfinite(change)) else np.inf

    def decide(self) -> None:
        """Drops what fits: ordinary rows by what they change over what they save, then ladders."""
        plain = [row for row in self.chain.rows if not row.ladder and row.effect.present]
        parties = [(row,) for row in plain if not row.together]
        joint = sorted((row for row in plain if row.together), key=lambda row: row.together)
        parties += [tuple(rows) for _, rows in groupby(joint, key=lambda row: row.together)]
        waiting, before = sorted(parties, key=self._price), -1
        while len(self.gone) > before:  # what had to go first may have gone since
            before = len(self.gone)
            waiting = [party for party in waiting if not self._try(party)]
        ladders = sorted((row for row in self.chain.rows if row.ladder), key=lambda row: row.ladder)
        for _, steps in groupby(ladders, key=lambda row: row.ladder):
            next((step for step in steps if self._try((step,))), None)

    def _price(self, party: tuple[Row, ...]) -> tuple[bool, float]:
        cost = sum(self.bound(row) for row in party) / max(self.goal.value, 1e-300)
        cost += sum(row.effect.place for row in party) / max(self.goal.place, 1e-300)
        return cost > 0, cost / sum(row.saves for row in party)

    def _try(self, party: tuple[Row, ...]) -> bool:
        """Drops the rows of a party if all of them fit."""
        gone = {row.effect.name for row in self.gone}
        rows = [row for row in party if row.part_of not in gone]
        allowed = all(
            row.drop is not None
            and (self.estimates or row.effect.rank != "estimate")
            and row.needs <= gone
            and not row.instead_of & gone
            for row in rows
        )
        if not rows or not allowed:
            return False
        bounds = [self.bound(row) for row in rows]
        proved, estimated = self._sums(rows, bounds)
        place = self.place + sum(row.effect.place for row in rows)
        rare = self.rare + sum(row.effect.rare for row in rows)
        fits = proved + estimated <= self.goal.value and place <= self.goal.place
        if not fits or rare > self.goal.rare:
            return False
        draft = self.draft
        for row in rows:
            assert row.drop is not None
            draft = row.drop(draft)
        if not all(keeps(draft, name, *self.records) for name in self.free):
            self.barred |= {id(row) for row in rows}
            return False
        if rows[0].ladder == "bands" and not self._take_bands(draft):
            return False
        if _bands_of(draft) != _bands_of(self.draft):
            return False
        self.draft, self.total, self.estimated = draft, proved, estimated
        self.place, self.rare = place, rare
        self.gone += rows
        self.bounds |= {id(row): bound for row, bound in zip(rows, bounds, strict=True)}
        return True

    def _sums(self, rows: list[Row], bounds: list[float]) -> tuple[float, float]:
        """What is proved and what is estimated once these have gone too."""
        grows = float(np.prod([row.grows for row in rows]))
        both = [self.total * grows, self.estimated * grows]
        for row, bound in zip(rows, bounds, strict=True):
            both[row.effect.rank == "estimate"] += bound
        return both[0], both[1]

    def _take_bands(self, draft: Draft) -> bool:
        """Whether a camera with a sensor can take fewer bands, and no free spectrum is cut."""
        if any(_is_spectrum(name, *self.records) for name in self.free):
            return False
        return self.chain.dn is None or folded(draft.camera, *draft.bands) is not None

    def result(self, scene: Scene, camera: Camera | View) -> Pruned:
        """The records of what is left, and the certificate."""
        draft, expand, own = self.draft, None, self.draft.camera
        left = finished(scene, draft)
        if draft.bands is not None:
            kept, expand = draft.bands
            left = with_bands(left, kept, len(expand))
            if self.chain.dn is not None:
                own, expand = folded(own, kept, expand), None
        return Pruned(
            left,
            own if isinstance(camera, Camera) else own.view,
            draft.samples,
            draft.moments,
            expand,
            self._certificate(),
            draft.depth,
        )

    def _certificate(self) -> Certificate:
        names, unit = {row.effect.name for row in self.gone}, self.goal.unit
        went = {id(row) for row in self.gone}
        dropped = [self._told(row, self.bounds[id(row)], unit) for row in self.gone]
        kept = []
        for row in self.chain.rows:
            if (
                id(row) in went
                or not row.effect.present
                or (row.ladder and row.effect.name in names)
            ):
                continue
            if row.part_of in names:
                told = self._told(row, 0.0, unit)
                dropped.append(replace(told, rank="exact", why=f"gone with {row.part_of}"))
            elif not row.ladder or row.effect.name not in {effect.name for effect in kept}:
                kept.append(self._told(row, self.bound(row), unit))
        assumed = dict.fromkeys(row.assumes for row in self.gone if row.assumes)
        return Certificate(
            tuple(kept),
            tuple(dropped),
            self.total,
            self.estimated,
            self.place,
            self.goal.value,
            unit,
            self.level,
            tuple(assumed),
            self.rare,
        )

    def _told(self, row: Row, bound: float, unit: str) -> Effect:
        free = any(_concerns(name, row.effect.name) for name in self.free) or id(row) in self.barred
        return replace(row.effect, bound=bound, unit=unit, free=free)


def _is_spectrum(name: str, scene: Scene, camera: Camera) -> bool:
    """Whether a field holds one number a band."""
    word = name.rpartition(".")[2]
    words = "emission radiance intensity irradiance diffuse specular ambient reflectance"
    return word in f"{words} transmission quantum_efficiency infrared_cut wavelength".split()


def _bands_of(draft: Draft) -> int:
    """How many bands the picture has by what is left: neutral mirrors alone do not say."""
    counts = [1]
    for surface in draft.surfaces:
        material = surface.material
        counts += [getattr(material, name).shape[-1] for name in material.spectra]
        counts += [
            leaf.shape[-1] for leaf in jax.tree.leaves(surface.material) if leaf.ndim > 0
        ] * (not material.spectra)
        counts += [] if surface.emission is None else [surface.emission.shape[-1]]
    for light in draft.lights:
        counts += [] if light is None else [getattr(light, n).shape[-1] for n in light.spectra]
    return max(counts)


def finished(scene: Scene, draft: Draft) -> Scene:
    """The scene of what a draft still holds; `()` occludes where no light has shadows left."""
    left = [k for k, light in enumerate(draft.lights) if light is not None]
    rules = scene.rules
    if rules is not None:
        changed = [draft.lights[k] is not scene.lights[k] for k in left]
        rules = tuple(None if new else rules[k] for k, new in zip(left, changed, strict=True))
    dark = draft.depth is None and draft.shadowless.issuperset(left)
    return replace(
        scene,
        surfaces=draft.surfaces,
        lights=tuple(draft.lights[k] for k in left),
        ambient=draft.ambient,
        occluders=() if dark else scene.occluders,
        rules=rules,
    )
