"""Make an accuracy problem of a scene file: the radiance of some of its pixels as a function of its
`[render]` settings and a seed."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..colour_spaces import rgb_to_xyz, xyz_to_lab
from ..colour_spaces.colour_data import white_point
from ..core._types import as_dtype
from ..errors import InputError
from ..files.scenes import SceneFile
from ..files.scenes.schema import RenderEntry
from ..lights import DirectionalLight, PointLight, SmallLight
from ..render_command import (
    change_resolution,
    light_findings,
    linear_srgb,
    seeded_passes_of,
    seeded_pixels_of,
)
from .deadlines import OutOfTime, TooLittleTime, run_within
from .records import Compute, Problem
from .session import Clock

PROBE = 64  # computed pixels along each side
NODES = {"quadrature": 8, "monte_carlo": 64, "balanced": 64}  # orders of 64 samples a light
SCALING = 0.1  # share of the whole time that a program for the scaling of times may take
FEW = 16  # samples of a problem while other knobs are varied
SEPARATE_KNOBS = ("rule",)  # compared at its own number of samples, independent of the other knobs
# random, but not in the position of rays within a pixel
OF_LIGHT = ("light samples", "rule", "gather")
_ABOUT = (
    "Times are those of the whole picture, errors root mean squares over its pixels relative to "
    "that of the picture."
)
_HEADROOM = 2.0  # factor on the quantile below, at which radiance is clipped
_QUANTILE, _SHOWN = 0.95, 0.8  # quantile of brightness, and its value in the developed picture


def knobs_of(source: SceneFile, settings: RenderEntry) -> tuple[str, ...]:
    """List the settings that change the picture of a scene file.

    Args:
        source: the scene and its view.
        settings: settings of `[render]`; only the integrator and the quadrature rule are used.

    Returns:
        Names in `KNOBS`, the most influential first.
    """
    extended = any(
        not isinstance(light, PointLight | DirectionalLight | SmallLight)
        for light in source.scene.lights
    )
    of_lights = ["order" if settings.rule == "quadrature" else "light samples"]
    lights = [*of_lights, "rule"] if extended else []
    several = ["samples"] if settings.samples > 1 else []
    match settings.integrator:
        case "path" | "light":
            found = ["samples", "depth"]
        case "direct":
            found = [*several, *lights]
        case "rays":
            found = [*several, "depth", *(of_lights if extended else [])]
        case _:
            gather = ["gather"] if settings.gather > 0 else []
            found = [*several, "patches", *gather, *(of_lights if extended else [])]
    return (*found, "dtype")


def entry_of(settings: RenderEntry, turned: Mapping[str, Any]) -> RenderEntry:
    """Return the `[render]` entry with the given settings replaced."""
    update: dict[str, Any] = {}
    for name, value in turned.items():
        if name == "rule":
            update |= {"rule": value, "order": NODES[value]}
        else:
            update["order" if name == "light samples" else name] = value
    return settings.model_copy(update=update)


def base_of(settings: RenderEntry, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the value that each setting keeps while another setting is measured. There are at most
    16 samples, to save time."""
    found = {}
    for name in (name for name in names if name not in SEPARATE_KNOBS):
        value = getattr(settings, "order" if name == "light samples" else name)
        found[name] = min(value, FEW) if name == "samples" else value
    return found


def scene_problem(
    source: SceneFile,
    *,
    settings: RenderEntry | None = None,
    expand: np.ndarray | None = None,
    probe: int = PROBE,
    seconds: float = np.inf,
    clock: Clock | None = None,
) -> Problem:
    """Make a problem of a scene file.

    The problem computes the pixels on a regular grid of the picture, or, for light tracing, the
    whole picture at a lower resolution. The time of the grid is multiplied by a factor to estimate
    the time of the whole picture. This factor is measured with the cheapest settings. If the
    measurement would take too long, the factor is the ratio of the numbers of pixels. Radiance is
    clipped at twice its 95 % quantile, because visible lamps would otherwise dominate the error.

    Args:
        source: the scene and its view.
        settings: settings of `[render]`; None for those of the file.
        expand: (all bands, bands), the matrix that reconstructs all bands of a scene with fewer
            bands, as in `effects.Pruned`, or None.
        probe: pixels along each side of the grid.
        seconds: time budget, s; a small part of it calibrates the time scale.
        clock: function that returns seconds; None for the machine's clock.

    Returns:
        The problem; radiance in W m^-2 sr^-1.

    Raises:
        InputError: for a scene that cannot be rendered with these settings, or not within that
            time.
    """
    own = settings or source.render
    if probe < 2:
        raise InputError(f"a probe of {probe} pixels a side is too small; give at least 2.")
    names = knobs_of(source, own)
    base = base_of(own, names)
    height, width = source.view.resolution
    counts = (min(probe, height), min(probe, width))  # numbers of evenly spread rows and columns
    rows, columns = (
        ((np.arange(n) + 0.5) * size / n).astype(int)
        for n, size in zip(counts, (height, width), strict=True)
    )
    places = tuple(axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))

    compiled: dict[str, Callable[..., Callable[..., np.ndarray]]] = {}
    once = 0.0
    now = clock or time.perf_counter

    def program(entry: RenderEntry) -> RenderEntry:
        more = {"depth": 2} if entry.integrator == "path" and entry.depth > 2 else {}
        return entry.model_copy(update={"samples": _samples_a_call(entry), **more})

    def is_compiled(turned: Mapping[str, Any]) -> bool:
        return program(entry_of(own, turned)).model_dump_json() in compiled

    def prepare(turned: Mapping[str, Any], *, within_pixels: int | None = None) -> Compute:
        entry = entry_of(own, turned)
        scene, view = as_dtype((source.scene, source.view), entry.dtype)
        given = replace(source, scene=scene, view=view)
        if own.integrator == "light":
            return _compute_passes(given, entry, (len(rows), len(columns)), expand)
        few = program(entry)
        if few.model_dump_json() not in compiled:
            compiled[few.model_dump_json()] = seeded_pixels_of(given, few)
        seeded = compiled[few.model_dump_json()]
        firsts = range(0, entry.samples, few.samples)

        def compute(seed: int) -> np.ndarray:
            nonlocal once
            start = now()
            pixels = seeded(seed, within_pixels)
            once = now() - start
            total = sum(pixels(*places, first, entry.depth).astype(np.float64) for first in firsts)
            return _expand_bands(np.asarray(total) / len(firsts), expand)

        return compute

    begun = now()
    compute = prepare(base)
    try:
        picture = run_within(lambda: compute(0), lambda: seconds + begun - now())
    except OutOfTime:
        raise TooLittleTime(
            f"{source.path}: the first program was not compiled and run within {seconds:.3g} s; "
            "allow more time to measure."
        ) from None
    first, begun = now() - begun, now()
    compute(0)
    compiling = max(first + begun - now(), 0.0)
    brightest = _brightest(picture)
    bands = source.bands if expand is None else len(expand)
    to_rgb = linear_srgb(bands, source.wavelengths)
    problem = Problem(
        f"{source.path.stem}, {own.integrator}, {height} × {width}",
        prepare,
        settings=base,
        developed=lambda radiance, exposed: _develop(radiance, exposed, to_rgb),
        compiled=None if own.integrator == "light" else is_compiled,
        compiling=compiling,
        once=lambda: once,
        about=" ".join([_ABOUT, *light_findings(source, own)]),
        compared=lambda radiance: np.minimum(radiance, brightest),
        alone=dict.fromkeys(OF_LIGHT, partial(prepare, within_pixels=0)),
    )
    everything = np.divmod(np.arange(min(own.tile, height * width)), width)
    pixels = height * width / len(places[0])
    if own.integrator == "light" or pixels == 1 or compiling > SCALING * seconds:
        return replace(problem, whole=pixels)
    cheap = {**base, **({"samples": 1} if "samples" in base else {})}
    part = _seconds_of(prepare(cheap), clock) - once
    pixels_at = seeded_pixels_of(source, entry_of(own, cheap))(0)
    tile = _seconds_of(lambda seed: pixels_at(*everything), clock)
    tiles = height * width / len(everything[0])
    return replace(problem, whole=float(np.clip(tile / max(part, 1e-9) * tiles, 1.0, pixels)))


def _samples_a_call(entry: RenderEntry) -> int:
    """Return the number of samples per pixel in one call; further samples are computed by further
    calls. For path tracing, a call has one sample. Other integrators would place a single sample at
    the centre of the pixel, so a call has two samples, or all samples if their number is odd."""
    if entry.integrator == "path":
        return 1
    return 2 if entry.samples % 2 == 0 else entry.samples


def _compute_passes(
    source: SceneFile, entry: RenderEntry, shape: tuple[int, int], expand: np.ndarray | None
) -> Compute:
    small = replace(source, view=change_resolution(source.view, shape))
    passes = seeded_passes_of(small, entry)

    def compute(seed: int) -> np.ndarray:
        total = sum(passes(seed, number) for number in range(entry.samples))
        return _expand_bands(np.asarray(total) / entry.samples, expand)

    return compute


def _expand_bands(radiance: np.ndarray, expand: np.ndarray | None) -> np.ndarray:
    flat = radiance.reshape(-1, radiance.shape[-1])
    return flat if expand is None else flat @ expand.T.astype(flat.dtype)


def _seconds_of(compute: Compute, clock: Clock | None) -> float:
    """Measure the median time of three warm calls, in s."""
    now = clock or time.perf_counter
    compute(0)
    taken = []
    for _ in range(3):
        start = now()
        compute(0)
        taken.append(now() - start)
    return max(float(np.median(taken)), 1e-9)


def _brightest(picture: np.ndarray) -> float:
    """Return the radiance of clipping: twice the 95 % quantile, or infinity if that is 0."""
    quantile = float(np.quantile(picture.max(axis=1), _QUANTILE)) if picture.size else 0.0
    return _HEADROOM * quantile if quantile > 0 else np.inf


def _develop(radiance: np.ndarray, exposed: np.ndarray, to_rgb: np.ndarray) -> np.ndarray:
    """Develop to CIELAB, with 0.8 of white at the 95 % quantile of the exposed luminance."""
    bright = exposed @ to_rgb @ np.array([0.2126, 0.7152, 0.0722])
    white = float(np.quantile(bright, _QUANTILE)) / _SHOWN if bright.size else 1.0
    rgb = np.clip(radiance @ to_rgb / (white if white > 0 else 1.0), 0, 1)
    lab = xyz_to_lab(rgb_to_xyz(jnp.asarray(rgb)), jnp.asarray(white_point("D65"), rgb.dtype))
    return np.asarray(lab)
