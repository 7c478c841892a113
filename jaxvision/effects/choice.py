"""Choose the effects to drop, in the order of increasing bound per saved time, until the tolerance
is used up.

Effects with bound 0 are dropped first. The bounds of dropped effects add, by the triangle
inequality. The bound of an effect is valid whichever other effects were dropped before.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import jax
import numpy as np

from ..core._maps import mean_of, replace_maps
from ..rendering.shadows import UNROLLED
from ..scene import Camera, Scene, TriangleMesh, View
from .boxes import keeps, setting
from .certificate import IRRADIANCE, RADIANCE, Certificate, Effect, Pruned, Tolerance
from .illumination import has_size
from .pixel import ASSUMED
from .reflection import fills
from .spectra import folded, select_bands
from .stages import Draft, Gone, Row

# names of the fields that have one number for each band
_SPECTRA = {"emission", "radiance", "intensity", "irradiance", "reflectance", "transmission"}
_SPECTRA |= {"diffuse", "specular", "ambient", "quantum_efficiency", "infrared_cut", "wavelength"}
_TRIES = 64  # largest number of thresholds, each at most half of the previous one


@dataclass(frozen=True)
class Chain:
    """The `Row` of every effect, with the factors that convert all bounds to one unit."""

    rows: tuple[Row, ...]  # of all effects
    opening: float = 1.0  # W m^-2 per W m^-2 sr^-1, the largest gain of the lens
    # from a change of irradiance, (bands,) W m^-2, and the names of dropped effects, to DN; None
    # without a sensor
    dn: Callable[[np.ndarray, Gone], float] | None = None
    dark: float = 0.0  # DN rms of the noise in the dark


def concerns(field: str, effect: str) -> bool:
    """Return whether a free field is the field of an effect, or a part of it."""
    return field == effect or field.startswith((f"{effect}.", f"{effect}["))


class Choice:
    """The state of the choice: the scene and camera with the remaining effects, the effects dropped
    so far, and the bound on their total change."""

    def __init__(
        self,
        chain: Chain,
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
        self.all_bands = ""  # why none of them can be dropped
        # tolerance for ordinary effects: half if lights may be left out in parts of the picture
        many = start.depth is None and not free and _many(finished(records[0], start))
        self.allowed = goal.value / 2 if many else goal.value

    def bound(self, row: Row) -> float:
        """Return the bound of the `Row` of an effect in the unit of the tolerance."""
        chain, gone = self.chain, frozenset(row.name for row in self.gone)
        value = np.atleast_1d(row.amount if row.after is None else row.after(gone))
        if not value.any():
            return 0.0
        if not np.all(np.isfinite(value)):
            return np.inf
        of_radiance, of_irradiance = (row.unit == unit for unit in (RADIANCE, IRRADIANCE))
        if self.level is not None:
            light = of_radiance or of_irradiance
            scale = self.level * (chain.opening if of_irradiance else 1)
            return float(value.max()) / scale if light and scale > 0 else np.inf
        if (of_radiance or of_irradiance) and chain.dn is not None:
            found = chain.dn(value * chain.opening if of_radiance else value, gone)
        else:
            found = float(value.max())
        if self.goal.unit == "sigma":
            found = found / chain.dark if chain.dark > 0 else np.inf
        return found if found >= 0 else np.inf

    def decide(self) -> None:
        """Drop the effects that the tolerance allows. Single effects come first, by bound per saved
        time. Then groups of alternative simplifications (`ladder`), such as limits on path length,
        are tried; at most one of each group is chosen."""
        plain = [row for row in self.chain.rows if not row.ladder and row.present]
        parties = [(row,) for row in plain if not row.together]
        joint = sorted((row for row in plain if row.together), key=lambda row: row.together)
        parties += [tuple(rows) for _, rows in groupby(joint, key=lambda row: row.together)]
        waiting, before = sorted(parties, key=self._price), -1
        # an effect that had to be dropped first may have been dropped since
        while len(self.gone) > before:
            before = len(self.gone)
            waiting = [party for party in waiting if not self._try(party)]
        ladders = sorted((row for row in self.chain.rows if row.ladder), key=lambda row: row.ladder)
        for _, steps in groupby(ladders, key=lambda row: row.ladder):
            next((step for step in steps if self._try((step,))), None)
        if self.allowed < self.goal.value:
            self.allowed = self.goal.value
            self._order_lights()

    def _order_lights(self) -> None:
        """Use the remaining tolerance to leave out, at each point of the scene, the lights that
        contribute least at that point."""
        scene = finished(self.records[0], self.draft)
        if not _many(scene):
            return
        why = f"traces {len(scene.lights)} lights in order of their largest contribution, until the"

        def row(threshold: float) -> Row:
            reason = f"{why} rest adds at most {threshold:.3g} W m^-2 sr^-1"
            # of the shape of the first row, which is for a light
            own = np.full_like(self.chain.rows[0].amount, threshold)
            return Row(
                "lights in order", own, reason, setting("threshold", to=threshold), saves=0.5
            )

        threshold, left = 1.0, self.goal.value - self.total - self.estimated
        for _ in range(_TRIES):
            bound = self.bound(row(threshold))
            if bound <= left and self._try((row(threshold),)):
                return
            threshold *= min(left / bound, 0.5) if bound > 0 and left > 0 else 0.5

    def _price(self, party: tuple[Row, ...]) -> tuple[bool, float]:
        cost = sum(self.bound(row) for row in party) / max(self.goal.value, 1e-300)
        cost += sum(row.place for row in party) / max(self.goal.place, 1e-300)
        return cost > 0, cost / sum(row.saves for row in party)

    def _try(self, party: tuple[Row, ...]) -> bool:
        """Drop all effects of a group if the tolerance allows it, and return whether it does."""
        gone = {row.name for row in self.gone}
        rows = [row for row in party if row.part_of not in gone]
        allowed = all(
            row.drop is not None
            and (self.estimates or not row.estimated)
            and row.needs <= gone
            and not row.instead_of & gone
            for row in rows
        )
        if not rows or not allowed:
            return False
        bounds = [self.bound(row) for row in rows]
        proved, estimated = self._sums(rows, bounds)
        place, rare = self.place + sum(row.place for row in rows), self.rare
        few = self.level is None and all(row.rare > 0 for row in rows)
        few = few and bool(np.isfinite(bounds).all())
        if few and proved + estimated > self.allowed:  # a few pixels may differ by any amount
            bounds = [0.0] * len(rows)
            rare += sum(row.rare for row in rows)
            proved, estimated = self._sums(rows, bounds)
        fits = proved + estimated <= self.allowed and place <= self.goal.place
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
        if bands_of(draft) != bands_of(self.draft):
            return False
        self.draft, self.total, self.estimated = draft, proved, estimated
        self.place, self.rare = place, rare
        self.gone += rows
        self.bounds |= {id(row): bound for row, bound in zip(rows, bounds, strict=True)}
        return True

    def _sums(self, rows: list[Row], bounds: list[float]) -> tuple[float, float]:
        """Return the proved and the estimated total change if these effects are dropped too."""
        grows = float(np.prod([row.grows for row in rows]))
        both = [self.total * grows, self.estimated * grows]
        for row, bound in zip(rows, bounds, strict=True):
            both[row.estimated] += bound
        return both[0], both[1]

    def _take_bands(self, draft: Draft) -> bool:
        """Return whether the number of bands can be reduced: no free spectrum loses bands, and the
        sensor, if there is one, works with the remaining bands."""
        if any(name.rpartition(".")[2] in _SPECTRA for name in self.free):
            self.all_bands = "a free spectrum has all of them"
            return False
        if draft.bands is None or self.chain.dn is None:
            return True
        taken = folded(draft.camera, *draft.bands) is not None
        self.all_bands = "" if taken else "the sensor cannot take fewer"
        return taken

    def result(self, scene: Scene, camera: Camera | View) -> Pruned:
        """Return the scene and the camera without the dropped effects, and the list of kept and
        dropped effects with their bounds."""
        draft, expand, own = self.draft, None, self.draft.camera
        threshold = draft.threshold
        left = finished(scene, draft)
        if draft.bands is not None:
            kept, expand = draft.bands
            left = select_bands(left, kept, len(expand))
            if threshold is not None:
                threshold /= max(float(np.abs(expand).sum(1).max()), 1.0)
            taking = folded(own, kept, expand) if self.chain.dn is not None else None
            own, expand = (own, expand) if taking is None else (taking, None)
        return Pruned(
            left,
            own if isinstance(camera, Camera) else own.view,
            draft.samples,
            draft.moments,
            expand,
            self._certificate(),
            draft.depth,
            threshold,
        )

    def _certificate(self) -> Certificate:
        names, unit = {row.name for row in self.gone}, self.goal.unit
        went = {id(row) for row in self.gone}
        dropped = [self._effect(row, self.bounds[id(row)], unit) for row in self.gone]
        kept = []
        for row in self.chain.rows:
            if id(row) in went or not row.present or (row.ladder and row.name in names):
                continue
            if row.part_of in names:
                row_effect = self._effect(row, 0.0, unit)
                dropped.append(
                    replace(row_effect, rank="exact", why=f"gone with {row.part_of}", saves=0.0)
                )
            elif not row.ladder or row.name not in {effect.name for effect in kept}:
                row_effect = self._effect(row, self.bound(row), unit)
                if row.ladder == "bands" and self.all_bands:
                    row_effect = replace(row_effect, why=f"{row_effect.why}; {self.all_bands}")
                kept.append(row_effect)
        assumed = dict.fromkeys(row.assumes for row in self.gone if row.assumes)
        if self.gone and self.level is None and self.chain.dn is not None:
            assumed[ASSUMED] = None
        assumed |= dict.fromkeys(_assumed_of(self.records[0]))
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

    def _effect(self, row: Row, bound: float, unit: str) -> Effect:
        free = any(concerns(name, row.name) for name in self.free) or id(row) in self.barred
        return replace(row.effect, bound=bound, unit=unit, free=free)


def _many(scene: Scene) -> bool:
    """Return whether ordering the lights by contribution saves more rays than it costs."""
    blocking = range(len(scene.surfaces)) if scene.occluders is None else scene.occluders
    shapes = [scene.surfaces[i].shape for i in blocking]
    meshes = any(isinstance(shape, TriangleMesh) for shape in shapes)
    return len(scene.lights) > UNROLLED and (len(shapes) > UNROLLED or meshes)


def _assumed_of(scene: Scene) -> Iterator[str]:
    """Yield the assumptions on which a scene's bounds rest, one sentence for each assumption."""
    if any(has_size(light) for light in scene.lights):
        yield (
            "bounds are of the exact integrals over lamps and skies; a rule with too few nodes for "
            "a narrow lobe or a near lamp may show more than these."
        )
    of_glass = (s.shape for s in scene.surfaces if fills(s.material))
    if any(isinstance(shape, TriangleMesh) for shape in of_glass):
        yield "closed meshes of glass do not cut through themselves."


def bands_of(draft: Draft) -> int:
    """Return the largest number of bands of any material, emission or light of a `Draft`."""
    counts = [1]
    for surface in draft.present_surfaces:
        material = surface.material
        counts += [getattr(material, name).shape[-1] for name in material.spectra]
        counts += [
            leaf.shape[-1]
            for leaf in jax.tree.leaves(replace_maps(surface.material, mean_of))
            if leaf.ndim > 0
        ] * (not material.spectra)
        counts += [] if surface.emission is None else [surface.emission.shape[-1]]
    for light in draft.lights:
        counts += [] if light is None else [getattr(light, n).shape[-1] for n in light.spectra]
    return max(counts)


def finished(scene: Scene, draft: Draft) -> Scene:
    """Return the scene of a `Draft`, with only the lights and surfaces that remain."""
    left = [k for k, light in enumerate(draft.lights) if light is not None]
    rules = scene.rules
    if rules is not None:
        changed = [draft.lights[k] is not scene.lights[k] for k in left]
        rules = tuple(None if new else rules[k] for k, new in zip(left, changed, strict=True))
    dark = draft.depth is None and draft.shadowless.issuperset(left)
    occluders = scene.occluders
    if occluders is not None:
        met = [i for i in range(len(scene.surfaces)) if i not in draft.unmet]
        occluders = tuple(met.index(i) for i in occluders if i in met)
    return replace(
        scene,
        surfaces=draft.present_surfaces,
        lights=tuple(draft.lights[k] for k in left),
        ambient=draft.ambient,
        occluders=() if dark else occluders,
        rules=rules,
    )
