"""Render a scene file to an image file, tile by tile. The memory needed does not grow with the
picture. If a render is killed, the same command continues the render, and the pixels are
bit-identical to those of an uninterrupted render.

While the EXR file `out` is unfinished, its completed tiles are in `out.partial` next to it. A tile
is a sequence of pixels in row order. Every tile is computed by the same compiled code, and depends
only on the indices of its pixels and on the seed. Light tracing adds light to all parts of the
picture, so it has no tiles. Light tracing is divided into passes instead, and keeps the whole
picture in memory.
"""

import dataclasses
import math
import os
import platform
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .. import __version__
from ..colour_spaces import luminance
from ..core._warnings import warn
from ..core.interrupts import say_if_interrupted
from ..effects import Pruned, explain
from ..errors import InputError
from ..files.images import check_writable, write_exr, write_image
from ..files.scenes import SceneFile
from ..files.scenes.bands import colours_of
from ..files.scenes.schema import RenderEntry
from ..point_ops import srgb_encode
from ..scene import View
from ..tasks import PROGRAMS, map_ordered
from .cost import Clock, Cost, relative_error, time_block
from .integrators import BY_PIXEL, light_findings, passes_of, pixels_of
from .pruning import pruned_scene
from .tiles import PartialImage, PartialSum

ROWS = 64  # rows of the picture that are written or shown at once
_SHOWN = 1_000_000  # largest number of pixels from which the exposure of a preview is chosen
_QUANTILE, _LEVEL = 0.95, 0.8
_PASS = 32  # bytes of memory per value in a pass of light tracing, measured for 2048 x 2048 x 3

Advance = Callable[[int, int], None]
Rows = Callable[[], Iterator[np.ndarray]]
Part = tuple[np.ndarray, tuple[float, float], str]  # a result, its seconds, and who computed it
Seconds = tuple[float, float, int]  # s for all pixels, s for compiling, and the number of workers
_PROCESS = f"{platform.node()} {os.getpid()}"
ERROR = "error"  # the layer of standard errors


def render_to_file(
    source: SceneFile,
    out: Path,
    settings: RenderEntry,
    *,
    pruned: Pruned | None = None,
    preview: Path | None = None,
    fresh: bool = False,
    advance: Advance = lambda done, total: None,
) -> Cost:
    """Render a scene file to an EXR file, in W m^-2 sr^-1, tile by tile. Return the rms standard
    error over the rms radiance, and the time in s. With several samples, the file has a layer
    `error` of standard errors, which assume independent samples. `pruned` is a pruned scene to
    render in place of the whole scene. The certificate of `pruned` is written to the file's header.
    `preview` is the path of an 8-bit picture. `fresh` states whether to drop the finished tiles of
    an interrupted call. `advance(done, all)` is called after each tile. The message of a
    `KeyboardInterrupt` says how to continue. Any other failure raises `InputError`."""
    if out.suffix.lower() != ".exr":
        raise InputError(f"{out}: a render holds radiance and is written as EXR; name it so.")
    check_writable(out)
    if preview is not None:
        check_writable(preview, kind=np.uint8)
    unfinished = out.with_name(out.name + ".partial")
    _check_room(out, unfinished, source)
    whole = _render_tiles if settings.integrator in BY_PIXEL else _render_passes
    ending = f"{out}: interrupted."
    say_if_interrupted(ending)

    def count(done: int, total: int) -> None:
        nonlocal ending
        rest = "goes on from there" if done else "starts again: nothing was computed yet"
        ending = f"{out}: interrupted; the same command {rest}."
        say_if_interrupted(ending)
        advance(done, total)

    try:
        with (
            time_block() as clock,
            whole(source, settings, pruned, unfinished, fresh, count, clock) as (
                rows,
                seconds,
            ),
        ):
            names, error = band_names(source.bands, source.wavelengths), None
            if settings.samples > 1:
                names = (*names, *(f"{ERROR}.{name}" for name in names))
                error = relative_error(rows(), source.bands)
            write_exr(
                out,
                rows(),
                shape=(*source.view.resolution, len(names)),
                channels=names,
                attributes=_attributes(source, settings, pruned, Cost(error, *seconds)),
            )
            if preview is not None:
                write_image(preview, _display(rows, source))
            lost = sum(int((~np.isfinite(block)).any(axis=-1).sum()) for block in rows())
            if lost:
                warn(
                    f"{out}: {lost} pixels are infinite or NaN; reduce the power of the lamps, or "
                    "set render.dtype = 'float64'."
                )
            if not any((block != 0).any() for block in rows()):
                warn(
                    f"{out}: every pixel is black: the camera sees no surface, or no light reaches "
                    "what it sees; check its position and target, and the lamps."
                )
            ending = f"{out}: interrupted; the picture is written."
            say_if_interrupted(ending)
            return Cost(error, *seconds)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(ending) from None


def _check_room(out: Path, unfinished: Path, source: SceneFile) -> None:
    """Raise `InputError` if the picture needs more disk space than is free, where an earlier
    partial file counts as free.
    """
    height, width = source.view.resolution
    # radiance and error, of the partial file and of the picture made from it
    wanted = 2 * 2 * 4 * height * width * source.bands
    folder = next(folder for folder in out.resolve().parents if folder.exists())
    free = shutil.disk_usage(folder).free
    free += unfinished.stat().st_size if unfinished.exists() else 0
    if wanted > free:
        raise InputError(
            f"{out}: {height} x {width} pixels of {source.bands} bands take {wanted / 1e9:.3g} GB "
            f"while they are computed, and {free / 1e9:.3g} GB are free; lower the resolution, or "
            "write to another disk."
        )


@contextmanager
def _render_tiles(
    source: SceneFile,
    settings: RenderEntry,
    pruned: Pruned | None,
    unfinished: Path,
    fresh: bool,
    advance: Advance,
    clock: Clock,
) -> Iterator[tuple[Rows, Seconds]]:
    """Render the picture tile by tile, and yield its rows and times. The partial file is deleted at
    the end of the block."""
    height, width = source.view.resolution
    tile = min(settings.tile, height * width)
    tiles = math.ceil(height * width / tile)
    channels = source.bands * (1 + (settings.samples > 1))
    key, values = _key(source, settings, pruned), tile * channels
    with PartialImage(unfinished, key=key, values=values, fresh=fresh) as partial:
        work = _Work(source, settings, pruned)
        advance(partial.done, tiles)
        first, spent = partial.done, _Spent(clock)
        for part in map_ordered(_tile, work, range(first, tiles), memory=PROGRAMS):
            partial.append(spent.record(part))
            advance(partial.done, tiles)

        def rows() -> Iterator[np.ndarray]:
            return partial.rows(width, channels, height, at_once=ROWS)

        yield rows, spent.extrapolate(tiles, tiles - first)
        partial.delete()


@contextmanager
def _render_passes(
    source: SceneFile,
    settings: RenderEntry,
    pruned: Pruned | None,
    unfinished: Path,
    fresh: bool,
    advance: Advance,
    clock: Clock,
) -> Iterator[tuple[Rows, Seconds]]:
    """Render the picture as the mean of its passes, and yield its rows and times. The partial file
    is deleted at the end of the block."""
    height, _ = source.view.resolution
    bands, several = source.bands, settings.samples > 1
    shape = (*source.view.resolution, bands * (1 + several))
    partial = PartialSum(unfinished, key=_key(source, settings, pruned), shape=shape, fresh=fresh)
    work = _Work(source, settings, pruned)
    passes, _ = work.passes
    advance(partial.done, passes)
    memory, first = PROGRAMS + _PASS * math.prod(shape), partial.done
    spent = _Spent(clock)
    for part in map_ordered(_pass, work, range(first, passes), memory=memory):
        picture = spent.record(part)
        squares = [np.square(picture, dtype=np.float64)] if several else []
        partial.add(np.concatenate([picture, *squares], axis=-1))
        advance(partial.done, passes)
    found = partial.total / passes
    if several:
        spread = np.maximum(found[..., bands:] - found[..., :bands] ** 2, 0.0)
        found[..., bands:] = np.sqrt(spread / (passes - 1))
    picture = found.astype(np.float32)

    def rows() -> Iterator[np.ndarray]:
        return (picture[row : row + ROWS] for row in range(0, height, ROWS))

    yield rows, spent.extrapolate(passes, passes - first)
    partial.delete()


@dataclasses.dataclass
class _Work:
    """The scene and the settings that all tiles or passes of one picture share. Each process
    compiles the program once."""

    source: SceneFile
    settings: RenderEntry
    pruned: Pruned | None

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    @cached_property
    def radiance(self) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """The function from pixels to radiance of the pruned scene in all its bands, (n, bands),
        or, with several samples, to (n, 2 bands) with the standard errors last."""
        threshold = None if self.pruned is None else self.pruned.threshold
        left = pruned_scene(self.source, self.settings, self.pruned)
        compute = pixels_of(*left, threshold=threshold)
        expand = None if self.pruned is None else self.pruned.expand
        several = self.settings.samples > 1

        def compute_pixels(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
            radiance, error = compute(rows, columns)
            if expand is not None:
                radiance = radiance @ expand.T.astype(np.float32)
                error = error @ np.abs(expand).T.astype(np.float32) if several else error
            return np.concatenate([radiance, error], axis=1) if several else radiance

        return compute_pixels

    @cached_property
    def passes(self) -> tuple[int, Callable[[int], np.ndarray]]:
        """The passes of the pruned scene, from `passes_of`."""
        return passes_of(*pruned_scene(self.source, self.settings, self.pruned))


def _tile(work: _Work, index: int) -> Part:
    height, width = work.source.view.resolution
    tile = min(work.settings.tile, height * width)
    pixels = np.minimum(index * tile + np.arange(tile), height * width - 1)
    with time_block() as clock:
        radiance = work.radiance(pixels // width, pixels % width)
        return radiance, clock.read(), _PROCESS


def _pass(work: _Work, number: int) -> Part:
    with time_block() as clock:
        return work.passes[1](number), clock.read(), _PROCESS


class _Spent:
    """Adds up the time of a picture, by the clocks of this process or of the workers."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._there = np.zeros(2)
        self._workers: set[str] = set()

    def record(self, part: Part) -> np.ndarray:
        """Return the result of a tile or pass, and add its seconds to the total."""
        result, seconds, process = part
        if process != _PROCESS:
            self._there += seconds
            self._workers.add(process)
        return result

    def extrapolate(self, parts: int, here: int) -> Seconds:
        """Return the seconds of all tiles or passes, extrapolated from the parts computed in this
        run; the seconds of compilation; and the number of workers."""
        seconds, compiling = self._there if self._workers else self._clock.read()
        return float(seconds) * parts / max(here, 1), float(compiling), len(self._workers)


def change_resolution(view: View, resolution: tuple[int, int]) -> View:
    """Return a view with another resolution, whose pixel pitch, in m, keeps the width of the
    picture."""
    pitch = view.pixel_pitch * (view.resolution[1] / resolution[1])
    return dataclasses.replace(view, resolution=resolution, pixel_pitch=pitch)


def band_names(bands: int, wavelengths: np.ndarray | None) -> tuple[str, ...]:
    """Name one EXR channel for each band. Wavelengths, in m, give names with digits that sort, as
    in Fichet et al., "An OpenEXR Layout for Spectral Images", JCGT 10(3) (2021)."""
    if wavelengths is not None:
        longest = len(f"{wavelengths[-1] * 1e9:.1f}")
        names = (f"{w * 1e9:0{longest}.1f}".replace(".", ",") for w in wavelengths)
        return tuple(f"S0.{name}nm" for name in names)
    if bands in (1, 3):
        return ("Y",) if bands == 1 else ("R", "G", "B")
    return tuple(f"band.{i:0{len(str(bands - 1))}d}" for i in range(bands))


def _key(source: SceneFile, settings: RenderEntry, pruned: Pruned | None) -> dict[str, Any]:
    """Return everything on which the bits of the picture depend, including the size of the tiles,
    as the key of the partial file."""
    unused = set() if settings.integrator in BY_PIXEL else {"tile"}
    return {
        "scene": source.digest,
        "resolution": list(source.view.resolution),
        **settings.model_dump(exclude=unused),
        "version of jaxvision": __version__,
        "version of jax": jax.__version__,
        "device": jax.devices()[0].device_kind,
        **({} if pruned is None else {"certificate": explain(pruned.certificate)}),
    }


def _attributes(
    source: SceneFile, settings: RenderEntry, pruned: Pruned | None, cost: Cost
) -> dict[str, str | int]:
    lacks = " ".join(light_findings(source, settings))
    unit = "W m^-2 sr^-1" if source.wavelengths is None else "W m^-2 sr^-1 per m"
    return {
        "Software": f"jaxvision {__version__}",
        "jaxvision:unit": unit,
        "jaxvision:bands": source.bands,
        "jaxvision:scene": source.path.name,
        "jaxvision:sceneSha256": source.digest,
        **{f"jaxvision:{name}": value for name, value in settings.model_dump().items()},
        **({} if cost.error is None else {"jaxvision:relativeError": f"{cost.error:.3g}"}),
        "jaxvision:seconds": f"{cost.seconds:.3g}",
        **({"jaxvision:lacks": lacks} if lacks else {}),
        **({} if pruned is None else {"jaxvision:certificate": explain(pruned.certificate)}),
    }


def _display(rows: Rows, source: SceneFile) -> np.ndarray:
    """Convert the picture to 8-bit sRGB, or grey if its bands are not colours, so that 95 % of the
    lit pixels are below 0.8 of white."""
    height, width = source.view.resolution
    step = math.ceil(height * width / _SHOWN)
    to_rgb = linear_srgb(source.bands, source.wavelengths)
    bands = source.bands  # without their errors
    some = [block[..., :bands].reshape(-1, bands)[::step] @ to_rgb for block in rows()]
    brightness = np.asarray(jax.jit(luminance)(np.concatenate(some)))
    seen = brightness[np.isfinite(brightness) & (brightness > 0)]
    white = np.quantile(seen, _QUANTILE) / _LEVEL if len(seen) else 1.0
    encode = jax.jit(lambda rgb: jnp.round(255 * srgb_encode(jnp.clip(rgb, 0, 1))))
    to_white = (to_rgb / white).astype(np.float32)
    scaled = (np.nan_to_num(block[..., :bands] @ to_white) for block in rows())
    return np.concatenate([np.asarray(encode(block)).astype(np.uint8) for block in scaled])


def linear_srgb(bands: int, wavelengths: np.ndarray | None) -> Float[np.ndarray, "bands 3"]:
    """Return the colour of each band in linear sRGB, (bands, 3), relative. The colours of bands
    with wavelengths, in m, are those of the CIE standard observer. Bands without wavelengths are
    RGB if there are three, and grey otherwise."""
    if wavelengths is not None:
        return colours_of(wavelengths, "light")
    return np.eye(3) if bands == 3 else np.full((bands, 3), 1 / bands)
