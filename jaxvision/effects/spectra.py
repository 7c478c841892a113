"""Reduce the number of bands: all bands of the picture are reconstructed from a few.

The radiance of a pixel is a sum of terms (module `sums`). Each term is a geometrical factor, equal
in all bands, times a product of spectra. A few bands determine all bands if every product of
spectra is nearly the same linear function of its values in the few bands. The few bands are
selected by pivoted QR of the table of products, each weighted by the supremum of its geometrical
factor. Least squares reconstructs the other bands. The error of a pixel is at most the sum of the
weighted residuals of the products over the terms of a cell.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..scene import Camera, Map, Scene
from .boxes import setting
from .cells import part_of
from .illumination import times
from .stages import Row
from .sums import Sums

_DECADES = 7  # residuals from 0.1 to 1e-7 of the picture, one row each
_ROUNDING = 1e-15  # relative rounding error of each term, and so of each pixel, for each band


def band_rows(sums: Sums, *, direct: bool) -> tuple[Row, ...]:
    """Return a `Row` "bands" for each of several reduced numbers of bands, the smallest number
    first. At most one of these rows is chosen. The bounds are in W m^-2 sr^-1."""
    bands = sums.sent_radiance.shape[1]
    if bands == 1:
        return ()
    why = _refusal_reason(sums, direct)
    if why:
        unknown = np.full(bands, np.inf)
        return (Row("bands", unknown, f"{bands} bands; {why}", None, ladder="bands"),)
    terms = _terms(sums)
    picture = max(float(np.max(np.abs(_largest(terms, bands)))), 1e-300)
    rows: list[Row] = []
    limit = 0.1 * picture
    for kept, expand in _ladder(terms, bands):
        missed = [p - p[:, kept] @ expand.T for _, p in terms]
        residual = _largest([(g, m) for (g, _), m in zip(terms, missed, strict=True)], bands)
        if residual.max() > limit and len(kept) < bands:
            continue
        exact = all(
            (np.abs(m) <= _ROUNDING * bands * np.abs(p)).all()
            for (_, p), m in zip(terms, missed, strict=True)
        )
        rows.append(_step(bands, kept, expand, 0 * residual if exact else residual))
        if exact or len(rows) == _DECADES:
            break
        limit = min(0.1 * limit, residual.max())
    return tuple(rows)


def _refusal_reason(sums: Sums, direct: bool) -> str:
    """Return the reason why the number of bands cannot be reduced, or "" if it can."""
    if not direct:
        return "light that bounces takes the colour of every surface that it meets"
    if not sums.lights:
        return "no lamp: reconstructing the bands would cost as much as it saves"
    for i, own in enumerate(sums.reflections):
        angular = own.angular or np.isinf(own.plain).any()
        if angular or (own.lobe is not None and not own.lobe.neutral):
            return f"the angles of surfaces[{i}] differ between bands"
    for k, source in enumerate(sums.sources):
        light = sums.lights[k].low
        for name in light.spectra:
            table = np.asarray(getattr(light, name), np.float64).reshape(
                -1, sums.sent_radiance.shape[1]
            )
            if len(table) > 1 and np.linalg.matrix_rank(table) > 1:
                return f"lights[{k}] has many spectra"
        if source.why:
            return source.why
    return ""


# (c, t) geometry and (t, bands) spectra, one pair for each surface
Terms = list[tuple[np.ndarray, np.ndarray]]


def _terms(sums: Sums) -> Terms:
    """Return the terms of the radiance of each visible surface and of each visible light."""
    found: Terms = []
    for i in range(len(sums.surfaces)):
        own = part_of(sums.cells, i)
        part = np.arange(own.start, own.stop)[sums.seen[own]]
        if not part.size:
            continue
        # Separate terms, because one may be dropped, or be the only visible one, without the other.
        geometry = [np.ones(part.size), np.ones(part.size)]
        spectra = [sums.emission[i], sums.ambient[i]]
        for k, spectrum in enumerate(sums.spectrum):
            mirror = sums.mirrored[k, part] * float(sums.sources[k].extended)
            geometry += [sums.body[k, part], sums.lobe[k, part], mirror]
            spectra += [table[i] * spectrum for table in (sums.k_body, sums.k_lobe, sums.k_mirror)]
        table, used = np.stack(spectra), [bool(np.any(s)) for s in spectra]
        found.append((np.stack(geometry, 1)[:, used], table[used]))
    skies = np.array([source.kind == "sky" for source in sums.sources], bool)
    found += [(np.ones((1, 1)), shown[None]) for shown in sums.shown[~skies] if shown.any()]
    if skies.any():  # they add
        found.append((np.ones((1, skies.sum())), sums.shown[skies]))
    return [(g, p) for g, p in found if p.size]


def _largest(terms: Terms, bands: int) -> np.ndarray:
    """Return the largest sum of the terms of any cell, (bands,)."""
    found = [times(g[:, :, None], np.abs(p)[None]).sum(1).max(0) for g, p in terms]
    return np.max([np.zeros(bands), *found], axis=0)


def _ladder(terms: Terms, bands: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the kept bands and the matrix that reconstructs all bands, for each number of kept
    bands below the number of all bands. Pivoted QR chooses the bands."""
    weighted = []
    for g, p in terms:
        weight = g.max(0)
        finite = weight[np.isfinite(weight)]
        weighted.append(p * np.where(np.isfinite(weight), weight, finite.max(initial=1.0))[:, None])
    table = np.concatenate(weighted) if weighted else np.zeros((1, bands))
    order = _pivots(table)
    for r in range(1, bands):
        kept = np.sort(order[:r])
        expand, *_ = np.linalg.lstsq(table[:, kept], table, rcond=None)
        expand[:, kept] = np.eye(r)
        yield kept, expand.T


def _pivots(table: np.ndarray) -> np.ndarray:
    """Return the indices of a table's columns in the order of pivoted QR: each column is the
    farthest from the span of the columns before it. The computation is in NumPy, because loading
    `scipy.linalg` takes longer than all bounds of a scene."""
    rest, order = table.astype(float), []
    for _ in range(table.shape[1]):
        size = (rest**2).sum(0)
        size[order] = -1
        order.append(int(size.argmax()))
        way = rest[:, order[-1]] / max(np.sqrt(size.max()), 1e-300)
        rest = rest - np.outer(way, way @ rest)
    return np.array(order)


def _step(bands: int, kept: np.ndarray, expand: np.ndarray, residual: np.ndarray) -> Row:
    why, drop = f"{bands} bands from {len(kept)}", setting("bands", to=(kept, expand))
    grows = max(float(np.abs(expand).sum(1).max()), 1.0)
    more = {"ladder": "bands", "grows": grows, "saves": 1 - len(kept) / bands}
    return Row("bands", residual, why, drop, **more)


def select_bands(scene: Scene, kept: np.ndarray, bands: int) -> Scene:
    """Return a scene with only these bands of every spectrum of `bands` numbers."""

    def cut(spectrum: Any) -> Any:
        if spectrum is None or spectrum.shape[-1] != bands:
            return spectrum
        if isinstance(spectrum, Map):
            return replace(spectrum, values=cut(spectrum.values))
        return jnp.asarray(np.asarray(spectrum)[..., kept])  # indexing by JAX would compile

    def cut_material(material: Any) -> Any:
        names = {"ambient", "specular", *material.spectra, *material.neutral_spectra}
        own = {n: cut(getattr(material, n)) for n in names if hasattr(material, n)}
        return replace(material, **own)

    surfaces = tuple(
        replace(s, material=cut_material(s.material), emission=cut(s.emission))
        for s in scene.surfaces
    )
    lights = tuple(
        replace(light, **{n: cut(getattr(light, n)) for n in light.spectra})
        for light in scene.lights
    )
    ambient = scene.ambient
    if ambient is not None:
        ambient = replace(ambient, radiance=cut(ambient.radiance))
    return replace(scene, surfaces=surfaces, lights=lights, ambient=ambient)


def folded(camera: Camera, kept: np.ndarray, expand: np.ndarray) -> Camera | None:
    """Return a camera whose colour filter has r bands instead of all bands, so that the r kept
    bands give the same electrons as all bands.

    The transmission T of the filter becomes (T w) @ expand / w for the kept bands, where w is the
    number of electrons per unit of irradiance in each band without the filter.

    The result is None in three cases: the camera has no colour filter, so each band has separate
    raw numbers; diffraction differs between bands; or a transmission would be negative.
    """
    sensor, diffraction = camera.sensor, getattr(camera.view, "diffraction", None)
    filters = sensor.colour_filter
    if filters is None or (diffraction is not None and diffraction.wavelength.ndim):
        return None
    response, conversion = np.ones(len(expand)), sensor.photon_conversion
    fields: dict[str, Any] = {}
    for name in ("infrared_cut", "quantum_efficiency"):
        spectrum: Any = getattr(sensor, name)
        if spectrum is not None:
            response = response * np.asarray(spectrum, np.float64)
            fields[name] = spectrum[kept] if spectrum.ndim else spectrum
    if conversion is not None:
        response = response * np.asarray(conversion.wavelength, np.float64)
        if conversion.wavelength.ndim:
            fields["photon_conversion"] = replace(
                conversion, wavelength=conversion.wavelength[kept]
            )
    with np.errstate(divide="ignore", invalid="ignore"):
        passed = (np.asarray(filters.transmission, np.float64) * response) @ expand
        passed = passed / response[kept]
    if not np.all(np.isfinite(passed)) or np.any(passed < 0):
        return None
    fields["colour_filter"] = replace(
        filters, transmission=passed.astype(filters.transmission.dtype)
    )
    return replace(camera, sensor=replace(sensor, **fields))
