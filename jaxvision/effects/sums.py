"""Bound the light from each cell of a scene to the camera, separately for each light and term.

The radiance L of a point x in the band b is a sum of terms. Each term is a geometrical factor times
spectra:

    L(x, b) = sum_l E_l(x) s_l(b) k_d(b) + sum_l lobe_l(x) s_l(b) k_s(b) + emission + ambient

Here l counts the lights, E_l is the irradiance, s_l the light's spectrum, lobe_l the shading of the
specular lobe over its reflectance k_s, and k_d the diffuse reflectance. This module computes the
supremum of each geometrical factor over each cell. A bound is the largest sum of some terms over
the visible cells. Radiance is in W m^-2 sr^-1; computed in NumPy float64.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..core._bounds import angle, peak
from ..rendering.direct import can_shade
from ..scene import Light, Scene, Surface
from .angles import cos_seen, lobe_angles
from .blocking import may_block
from .bodies import body_of, gap, is_closed, select_bodies, stacked, surface_bodies
from .cells import Cells, Eye, anywhere, bodies_of, cells_of, starts, visible_flags
from .illumination import Source, light_on, lobe_products, source_of, times
from .reflection import Lobe, Reflection, fills, reflection_of
from .stages import Ends
from .umbra import covered, hidden, shaded, umbra_flags

_ROUNDING = 1e-6  # rad, largest rounding error of a mirrored direction in float32


class Sums(NamedTuple):
    """Upper bounds on the light in a scene of n surfaces, l lights and c cells."""

    # surfaces, lights: the records, each at the two ends of its free parameters
    surfaces: tuple[Ends[Surface], ...]
    lights: tuple[Ends[Light], ...]
    # sources, reflections: the bounds of each
    sources: tuple[Source, ...]
    reflections: tuple[Reflection, ...]
    cells: Cells  # of all surfaces
    seen: np.ndarray  # (c,) whether a pixel may see the cell
    # body, lobe: (l, c) the suprema of E f_r cos / k_d and of E f_r cos / k_s, per unit of the
    # light's spectrum
    body: np.ndarray
    lobe: np.ndarray
    # (l, c) as `lobe`, but toward any viewer, for light that continues to other surfaces
    lobe_around: np.ndarray
    facing: np.ndarray  # (l, c) the suprema of E, for a facing surface
    # (l, c) whether the cell, if it belongs to a mirror, may show the light to the eye
    mirrored: np.ndarray
    # k_body, k_lobe, k_mirror: (n, bands), the factors of `body` and `lobe`, and the
    # reflectance of mirrors
    k_body: np.ndarray
    k_lobe: np.ndarray
    k_mirror: np.ndarray
    # emission, ambient: (n, bands) W m^-2 sr^-1, of each surface; reflected ambient light is 0 if
    # light continues from surface to surface
    emission: np.ndarray
    ambient: np.ndarray
    spectrum: np.ndarray  # (l, bands) of each light
    shown: np.ndarray  # (l, bands) W m^-2 sr^-1 if the light may be visible in a pixel, else 0
    visible: np.ndarray  # (l,) whether the light may be visible
    blocked: np.ndarray  # (l, n, n) whether a surface (last) may shade a surface (middle)
    # (l, c) whether anything may shade the cell; for direct light, only for visible cells
    shaded: np.ndarray
    dark: np.ndarray  # (l, c) whether the cell lies in full shadow
    searched: bool  # whether shadow rays are traced at all
    nearest: np.ndarray  # (l, n) m, lower bounds of the distances of lights and surfaces
    eye: Eye  # the viewer
    caustics: bool  # whether mirrors and glass may focus light of lamps without size

    @property
    def sent_radiance(self) -> np.ndarray:
        """The radiance that surfaces send by emission and ambient light, (n, bands)."""
        return self.emission + self.ambient


def sums_of(scene: Ends[Scene], eye: Eye, *, bounces: bool, caustics: bool = False) -> Sums:
    """Compute all suprema of a scene over the range of its free parameters; lengths in m. With
    `bounces`, light is reflected between surfaces, so that glass and mirrors may show any part of
    the scene."""
    low, high = scene
    surfaces = tuple(map(Ends, low.surfaces, high.surfaces))
    lights = tuple(map(Ends, low.lights, high.lights))
    sources = tuple(source_of(light) for light in lights)
    reflections = tuple(reflection_of(surface.field("material")) for surface in surfaces)
    cells = cells_of(surfaces, about=eye.place)
    facing = cos_seen(cells, eye)[1] > 0
    if bounces:  # also from inside
        glass = [fills(surface.low.material) for surface in surfaces]
        facing |= np.array(glass, bool)[cells.surface]
    seen = facing & visible_flags(eye, bodies_of(cells))
    if not bounces:
        seen &= ~hidden(surfaces, cells, eye)
    nearest = _nearest(sources, surfaces)
    lobes = [own.lobe for own in reflections]

    def geometry(viewer: Eye) -> np.ndarray:
        """Compute `body`, `lobe` and `facing` of `Sums`, (3, l, c), for a viewer."""
        shape = len(sources), 3, len(cells.radius)
        each = zip(sources, nearest, strict=True)
        found = [_geometry(s, least, reflections, lobes, cells, viewer) for s, least in each]
        return np.array(found).reshape(shape).swapaxes(0, 1)

    body, lobe, facing = geometry(eye)
    around = geometry(anywhere(eye))[1] if bounces else lobe
    bands = _bands(scene, sources, reflections)
    k_body = _table(bands, [own.body for own in reflections])
    k_lobe = _table(bands, [None if own is None else own.spectrum for own in lobes])
    k_mirror = _table(
        bands,
        [
            own.mirror * _growth(surface, own, eye)
            if own.mirror is not None and (bounces or not fills(surface.low.material))
            else None
            for surface, own in zip(surfaces, reflections, strict=True)
        ],
    )
    spectrum = _table(bands, [own.spectrum for own in sources])
    emission = emitted(surfaces, bands)
    ambient = 0 * emission if bounces else ambient_reflected(scene, surfaces, bands)
    visible = np.array([_may_be_seen(source, eye, surfaces) for source in sources], bool)
    extended = np.array([source.extended for source in sources], bool)
    shown = extended[:, None] & (k_mirror > 0).any(1)
    viewer = anywhere(eye) if bounces else eye
    mirrored = _compute_mirrored(sources, nearest, k_mirror.max(1) > 0, cells, viewer)
    lit = (body + around > 0) | (shown[:, cells.surface] & mirrored)
    wanted = np.maximum.reduceat(lit, starts(cells), axis=-1)
    blocked = may_block(sources, surfaces, occluders=low.occluders, wanted=wanted)
    within = shaded(sources, surfaces, cells, may=blocked, wanted=lit & (seen | bounces))
    return Sums(
        surfaces,
        lights,
        sources,
        reflections,
        cells,
        seen,
        body,
        lobe,
        around,
        facing,
        mirrored,
        k_body,
        k_lobe,
        k_mirror,
        emission,
        ambient,
        spectrum,
        np.where(visible[:, None], spectrum, 0.0),
        visible,
        blocked,
        within,
        umbra_flags(sources, surfaces, cells, occluders=low.occluders),
        low.occluders != () and can_shade(low.surfaces),
        nearest,
        eye,
        caustics,
    )


def _growth(surface: Ends[Surface], own: Reflection, eye: Eye) -> float:
    """Return the largest factor by which radiance may grow at a mirror or at an interface of glass,
    no unit. Radiance over the squared refractive index is constant. So radiance is unchanged after
    light has entered and left a body with an index above 1. An eye inside such a body sees a larger
    radiance, and a body with an index below 1 may also give a larger radiance. Radiance may also
    grow at a surface that does not bound a body and is hit only from behind."""
    if own.indices is None:
        return 1.0
    (least, most), body = own.indices, body_of(surface.field("shape"))
    viewer = eye.place[None], np.array([eye.size])
    if least < 1 or body is None or eye.parallel or not is_closed(surface.field("shape")):
        return max(most, 1 / least) ** 2
    outside = gap(stacked([body]), stacked([viewer]))[0] > 0
    return 1.0 if outside else most**2


def _table(bands: int, spectra: Sequence[np.ndarray | None]) -> np.ndarray:
    """Return a table, (n, bands), of spectra. None becomes 0, and neutral spectra are repeated."""
    table = np.zeros((len(spectra), bands))
    for row, spectrum in enumerate(spectra):
        table[row] = 0 if spectrum is None else spectrum
    return table


def _bands(scene: Ends[Scene], sources: Sequence[Source], reflections: Sequence[Reflection]) -> int:
    """Return the number of bands in a picture of the scene."""
    counts = [len(source.spectrum) for source in sources]
    counts += [len(reflection.body) for reflection in reflections]
    for surface in scene.low.surfaces:
        counts += [] if surface.emission is None else [surface.emission.shape[-1]]
        names = surface.material.spectra + surface.material.neutral_spectra
        counts += [getattr(surface.material, name).shape[-1] for name in names]
    if scene.low.ambient is not None:
        counts.append(scene.low.ambient.radiance.shape[-1])
    return max(counts)


def emitted(surfaces: Sequence[Ends[Surface]], bands: int) -> np.ndarray:
    """Return the largest radiance that surfaces emit, (n, bands) W m^-2 sr^-1."""
    lit = [None if own.low.emission is None else peak(own, "emission") for own in surfaces]
    return _table(bands, lit)


def ambient_reflected(
    scene: Ends[Scene], surfaces: Sequence[Ends[Surface]], bands: int
) -> np.ndarray:
    """Return the largest reflected ambient light k_a L_a, (n, bands) W m^-2 sr^-1."""
    if scene.low.ambient is None:
        return np.zeros((len(surfaces), bands))
    around = peak(scene.field("ambient"), "radiance")
    materials = [surface.field("material") for surface in surfaces]
    dark = [getattr(material.low, "ambient", None) is None for material in materials]
    shares = zip(dark, materials, strict=True)
    return _table(bands, [None if no else around * peak(own, "ambient") for no, own in shares])


def _geometry(
    source: Source,
    nearest: np.ndarray,
    reflections: Sequence[Reflection],
    lobes: Sequence[Lobe | None],
    cells: Cells,
    eye: Eye,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute `body`, `lobe` and `facing` of `Sums` for one light and the given lobes. For the
    share `grazing` of the diffuse part, the supremum of E f_r cos / k_d is the supremum of E; for
    the remaining share, it is the supremum of E times the cosine."""
    grazing = np.array([own.grazing for own in reflections])[cells.surface]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        arrived = light_on(source, cells, nearest[cells.surface])
        body = times(1 - grazing, arrived.body) + times(grazing, arrived.facing)
        return body, lobe_products(arrived, source, lobes, cells, eye), arrived.facing


def _compute_mirrored(
    sources: Sequence[Source], nearest: np.ndarray, mirrors: np.ndarray, cells: Cells, eye: Eye
) -> np.ndarray:
    """Compute `Sums.mirrored` from the cone of directions mirrored by `mirrors`, (n,)."""
    found, own = np.ones((len(sources), len(cells.radius)), bool), mirrors[cells.surface]
    there = Cells(*(x[own] for x in cells))
    for k, source in enumerate(sources):
        narrow = source.extended and len(source.places) > 0
        if narrow and own.any() and not eye.everywhere:
            to = light_on(source, there, nearest[k, there.surface])
            assert to.wi is not None
            off = lobe_angles(there, eye, to.wi, to.width, to.cos_i).off_mirror
            found[k, own] = (off <= _ROUNDING).any(1)
    return found


def geometry_of(
    sums: Sums, source: Source, nearest: np.ndarray, lobes: Sequence[Lobe | None]
) -> tuple[np.ndarray, np.ndarray]:
    """Compute `Sums.body` and `Sums.lobe` of one light for the given lobes. `nearest`, (n,) m, are
    lower bounds on the distances of the light from the surfaces."""
    return _geometry(source, nearest, sums.reflections, lobes, sums.cells, sums.eye)[:2]


def slopes(sums: Sums) -> np.ndarray:
    """Return the largest slopes of lobes over directions, (n,) sr^-1 rad^-1; inf if unknown."""
    lobes = [own.lobe for own in sums.reflections]
    found = [0.0 if own is None else own.slope for own in lobes]
    return np.array([np.inf if slope is None else slope for slope in found])


def _nearest(sources: Sequence[Source], surfaces: Sequence[Ends[Surface]]) -> np.ndarray:
    """Return lower bounds on distances of lights and surfaces, (l, n) m; 0 if unbounded."""
    found = np.zeros((len(sources), len(surfaces)))
    bodies, bounded = surface_bodies(surfaces)
    near = [k for k, source in enumerate(sources) if source.body is not None]
    if near:
        lamps = stacked([body for source in sources if (body := source.body) is not None])
        k, i = np.indices((len(near), len(surfaces))).reshape(2, -1)
        apart = gap(select_bodies(lamps, k), select_bodies(bodies, i)).reshape(len(near), -1)
        found[near] = np.where(bounded, apart, 0)
    return found


def _may_be_seen(source: Source, eye: Eye, surfaces: Sequence[Ends[Surface]]) -> bool:
    """Return whether a pixel may see a light, judged by its geometry and not by its brightness."""
    if source.kind == "sky":
        return not len(source.places) or _may_see_direction(eye, source)
    if source.kind != "area" or source.body is None:
        return False
    points, _ = source.body
    if source.normal is not None and not eye.everywhere:
        if eye.parallel and eye.rotation[2] @ source.normal >= 0:
            return False
        if not eye.parallel and (eye.place - points[0]) @ source.normal + eye.size <= 0:
            return False
    in_picture = bool(visible_flags(eye, stacked([source.body]))[0])
    return in_picture and not covered(source.body, eye, surfaces)


def _may_see_direction(eye: Eye, source: Source) -> bool:
    """Return whether a pixel may see a cone of directions at infinity."""
    if eye.everywhere:
        return True
    wide = np.sin(min(float(source.size[0]), np.pi / 2)) + _ROUNDING
    if eye.parallel:
        return bool(angle(eye.rotation[2], source.places[0]) <= source.size[0] + _ROUNDING)
    return bool(np.all(eye.planes @ source.places[0] >= -wide))


def reflected_light(
    sums: Sums, k: int, *, around: bool = False, only: np.ndarray | None = None
) -> np.ndarray:
    """Bound the light of source k that each cell reflects, (c, bands) W m^-2 sr^-1, toward the eye
    or, if `around`, toward any viewer. `only`, (c,), flags the cells to include, all if None."""
    of_cell = sums.cells.surface
    total = times(sums.body[k][:, None] * np.ones(1), times(sums.k_body, sums.spectrum[k])[of_cell])
    total = total + lobe_sent(sums, k, around=around)
    if sums.sources[k].extended:
        shown = times(sums.k_mirror, sums.spectrum[k])[of_cell]
        total = total + (shown if around else np.where(sums.mirrored[k][:, None], shown, 0))
    elif sums.caustics:  # a focus has no largest value
        total = total + times(times(sums.k_mirror, np.inf), sums.spectrum[k])[of_cell]
    return total if only is None else np.where(only[:, None], total, 0)


def lobe_sent(sums: Sums, k: int, *, around: bool = False, part: slice = slice(None)) -> np.ndarray:
    """Bound the light of source k that the lobe of each cell of a slice reflects, (c, bands), as in
    `reflected_light`."""
    own = times(sums.k_lobe[sums.cells.surface[part]], sums.spectrum[k])
    return times((sums.lobe_around if around else sums.lobe)[k][part, None], own)


def direct_radiance(sums: Sums, radiance: np.ndarray) -> np.ndarray:
    """Return the largest radiance, (bands,), that a ray may receive directly from lights of the
    given radiances, (l, bands). A light at a finite distance hides the lights behind it, but the
    radiances of skies add."""
    skies = np.array([source.kind == "sky" for source in sums.sources], bool)[:, None]
    around = np.where(skies, radiance, 0).sum(0)
    return np.maximum(around, np.where(skies, 0, radiance).max(0, initial=0))


def picture_maximum(sums: Sums, values: np.ndarray) -> np.ndarray:
    """Return the maximum of the values, (c, bands), over the visible cells, (bands,)."""
    return np.max(values[sums.seen], axis=0, initial=0)
