"""Reading of a photon transfer measurement from the frames of a rig, or from a table of sums."""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError
from jaxvision.files.images import read_image
from jaxvision.sensor import photon_rate

from ..codes import Codes, Converter
from ..frame_checks.frame import ALONE, FrameSample, OddFrames, refuse_half
from ..frame_checks.heads import Stated, odd_heads, series_times
from ..frame_checks.levels import odd_frames
from ..inference.formatting import format_percent
from ..inference.precision import double_precision
from ..observation import Load, read_frame, split_channels
from ..rig import Camera, Dark, Flat, Rig, load_rig, require
from .counted import code_tables, dim_levels
from .dark_pattern import dark_pattern_in_words
from .doubts import doubts
from .level_sums import LevelSums, ReducedLevel, Unlit
from .levels import (
    FEWEST_PIXELS,
    Levels,
    PhotonTransfer,
    SharedVariance,
    finer,
    rounding_step,
)
from .levels_table import read_table
from .live_pixels import BULK, LARGEST_LAG, DeadPixels, LivePixels, dead_pixels
from .settings import require_one_setting
from .usable import check

DARK_MATCH = 0.05  # relative difference in exposure up to which a dark is a flat's own
BRIGHTEST = 2  # levels used to find dead pixels


@double_precision
def read_photon_transfer(
    path: str | os.PathLike[str] | Rig, *, bits: int | None = None, channel: str = ""
) -> PhotonTransfer:
    """Read a photon transfer measurement from a rig's `[[flat]]` and `[[dark]]` frames, or from a
    table.

    Args:
        path: a rig, the folder or file of a rig, or a table of sums with the suffix `.csv`.
        bits: ADC bits of the camera of a table. None to use the bits that the rig states, or to
            infer them from saturated levels of the table.
        channel: site of a rig's Bayer mosaic; empty for the first green site.

    Returns:
        The measurement.

    Raises:
        InputError: for files that cannot be used.
    """
    file = Path(path.folder if isinstance(path, Rig) else path)
    if file.suffix.lower() == ".csv":
        if channel:
            raise InputError(f"{file}: is a table of one channel; leave out {channel!r}.")
        measurement = read_table(file, bits)
    elif bits is not None:
        raise InputError(f"{file}: camera.bits of the rig counts; leave out the bits, {bits}.")
    else:
        rig = path if isinstance(path, Rig) else load_rig(file)
        measurement = reduce_rig(rig, channel=channel)
    check(file, measurement)
    return measurement


@dataclass(frozen=True)
class Reduced:
    """A rig's photon transfer measurement, with the names of the frames and a function that reads
    the frames again."""

    measurement: PhotonTransfer  # the measurement, before the checks that may refuse it
    flats: list[list[str]]  # names of the used frames, by bright level
    darks: list[list[str]]  # names of the used frames, by dark level
    plane: Callable[[str], np.ndarray]  # function from a frame's name to its (h, w) DN


def reduce_rig(rig: Rig, *, channel: str = "", load: Load = read_image) -> PhotonTransfer:
    """Compute the statistics of all frames of a rig, with one frame in memory at a time."""
    return reduced_rig(rig, channel=channel, load=load).measurement


@threadpool_limits.wrap(limits=1, user_api="blas")  # threads wait longer than they compute
def reduced_rig(rig: Rig, *, channel: str = "", load: Load = read_image) -> Reduced:
    """Compute the statistics as `reduce_rig` does, and also return the names of the used frames."""
    require(rig, "photon transfer")
    require_one_setting(rig, "read them with fitting.noise.read_by_setting")
    rig, odd, remarks = _drop_odd_heads(rig)
    flats = sorted(rig.flat, key=lambda flat: (_light(rig, flat) or flat.exposure, flat.exposure))
    darks = _pool_darks(rig.dark)
    light = [_light(rig, flat) for flat in flats]
    known = [value is not None for value in light]
    if any(known) and not all(known):
        first = flats[known.index(False)].files[0]
        raise InputError(
            f"{rig.folder}: the flat of {first} has no photons, but others have; give photons (or "
            "irradiance) for every [[flat]] or for none."
        )
    if not all(known) and len({flat.exposure for flat in flats}) < 3:
        raise InputError(
            f"{rig.folder}: the flats have neither photons nor three different exposures; give "
            "photons (or irradiance) for every [[flat]], or vary the exposure."
        )
    channel = channel or _first_site(rig.camera)
    dead = _dead(rig, flats, darks, channel, load)
    if dead is not None:
        remarks.append(_dead_in_words(rig, dead, channel))
    source = _Source(rig, channel, load, None if dead is None else ~dead.all)
    dark, of_darks, unlit = _reduce_levels(source, darks, odd=odd["dark"])
    amounts = np.array(light if all(known) else [flat.exposure for flat in flats], float)
    bright, of_flats, lit = _reduce_levels(source, flats, odd=odd["flat"], light=amounts, dark=dark)
    labels, rise = lit.few, float(bright.mean.max() - dark.mean.max())
    if len(labels) > 1 and rise > 0.02 * (labels[-1] - labels[0]):
        *first, last = (f"{value:g}" for value in labels)
        listed = f"{', '.join(first)} and {last}" if first else last
        raise InputError(
            f"{rig.folder}: all flats together hold only the values {listed}, as masks, labels or "
            "thresholded frames do; noise cannot be measured with so few codes. Give raw frames "
            "over the range of the camera."
        )
    taken = series_times([rig.path(shown[0].name) for shown in of_flats])
    if taken is not None:
        bright = replace(bright, taken=_array(taken))
    of_each = 2 * [(lit + unlit).converter()]
    if {lit.whole, unlit.whole} == {True, False}:  # some were averaged or divided
        of_each = [lit.converter(), unlit.converter()]
    if (clips_below := unlit.clips_below()) is not None and clips_below > of_each[0].origin:
        of_each = [replace(one, clips_below=clips_below) for one in of_each]
        remarks.append(
            f"No value of the darks is below {clips_below:g} DN, and many pixels have exactly this "
            "value: it counts as the end of the scale, as after a subtraction whose result was "
            "clipped. Figures of the standard are biased there."
        )
    bright, dark = (replace(x, converter=y) for x, y in zip((bright, dark), of_each, strict=True))
    converter = finer(bright, dark)
    if float(bright.pixels) != float(dark.pixels):
        raise InputError(f"{rig.folder}: flats and darks differ in size; crop them alike.")
    if rig.camera.pattern is not None:
        remarks.append(f"The {channel} sites of the {rig.camera.pattern} mosaic were used.")
    elif len(rig.camera.sites) > 1:
        remarks.append(f"The pixels of {channel} were used, of {len(rig.camera.sites)} taps.")
    darkest, black = int(np.argmin(dark.exposure)), rig.camera.at(channel).black_level
    seen, scatter = float(dark.mean[darkest]), float(np.sqrt(dark.variance[darkest]))
    if black is not None and abs(seen - black) > scatter:
        remarks.append(
            f"camera.black_level states {black:g} DN, but the darks have {seen:.4g} DN, which was "
            "used here. Other calibrations of this rig subtract the stated one: correct it."
        )
    site = rig.camera.at(channel)
    known_too = (
        ("gain", "system_gain", site.gain, site.gain_sd),
        ("read_noise", "read_noise", site.read_noise, site.read_noise_sd),
    )
    stated = site.clip_level
    if converter.clips_at is not None and converter.clips_at < stated - max(converter.step, 1.0):
        remarks.append(
            f"No value is above {converter.clips_at:g}, and many pixels have exactly this value: "
            f"it counts as the end of the scale instead of {stated:g}. Correct camera.bits, or "
            "give saturation."
        )
    lit_for, unlit_for = np.asarray(bright.exposure), np.asarray(dark.exposure)
    scale = np.where(lit_for > 0, lit_for, max(lit_for.max(), unlit_for.max()) or 1.0)
    gap = np.abs(unlit_for - lit_for[:, None]) / scale[:, None]  # relative, of darks from flats
    if float(gap.min(axis=1).max()) > DARK_MATCH:
        remarks.append(
            "Some flats have no dark frames of their own exposure; the nearest were subtracted, so "
            "dark current between the two exposures counts as light."
        )
    found = PhotonTransfer(
        bright=bright,
        dark=dark,
        dark_of=jnp.asarray(np.argmin(gap, axis=1)),
        light_step=_array(rounding_step(np.asarray(bright.light)) if all(known) else 0.0),
        photons_known=all(known),
        full_scale=_full_scale(stated, converter),
        remarks=tuple(remarks),
        lossy=tuple(
            name
            for one in (*flats, *darks)
            for name in one.files
            if Path(name).suffix.lower() in (".jpg", ".jpeg")
        ),
        site=channel if len(rig.camera.sites) > 1 else None,
        pattern=rig.camera.pattern,
        stated=tuple((key, of, x, sd or 0.0) for key, of, x, sd in known_too if x is not None),
    )
    found = replace(found, doubts=doubts(found, of_flats, of_darks))
    same = dark_pattern_in_words(found, of_flats, of_darks)
    found = replace(found, remarks=(*found.remarks, *same))
    flats_used, darks_used = (
        [[one.name for one in shown] for shown in of] for of in (of_flats, of_darks)
    )
    counted = dim_levels(found)
    if isinstance(counted, str):
        found = replace(found, remarks=(*found.remarks, counted))
    elif len(counted):
        again = {"plane": source.plane, "live": source.live}
        tables = code_tables(found, counted, flats_used, darks_used, **again)
        found = replace(found, tables=tables)
    return Reduced(found, flats_used, darks_used, source.plane)


@threadpool_limits.wrap(limits=1, user_api="blas")  # threads wait longer than they compute
def reduce_darks(rig: Rig, *, channel: str = "", load: Load = read_image) -> Levels:
    """Compute the statistics of the darks of a rig alone."""
    rig, odd, _ = _drop_odd_heads(rig)
    channel = channel or _first_site(rig.camera)
    entries = _pool_darks(rig.dark)
    dead = _dead(rig, [], entries, channel, load)
    source = _Source(rig, channel, load, None if dead is None else ~dead.all)
    darks, _, codes = _reduce_levels(source, entries, odd=odd["dark"])
    remarks = () if dead is None else (_dead_in_words(rig, dead, channel),)
    return replace(darks, converter=codes.converter(), left_out=(*remarks, *darks.left_out))


@dataclass(frozen=True)
class _Source:
    """The source of a measurement's frames: its rig, its channel and its valid pixels."""

    rig: Rig  # the rig that lists the files
    channel: str  # mosaic site or amplifier tap
    load: Load  # function that reads an image from its path
    live: np.ndarray | None  # (h, w) true where a pixel is used; None for all
    # the valid pixels of frames of each size
    live_of: dict[tuple[int, ...], LivePixels] = field(default_factory=dict)

    def plane(self, name: str) -> np.ndarray:
        """Return the (h, w) DN of a frame."""
        return _plane(self.rig, name, self.channel, self.load)

    def count(self, codes: Codes, frame: np.ndarray) -> None:
        """Count the codes of a frame, without dead pixels."""
        live = self.pixels(frame.shape)
        codes.add(np.where(live.mask, frame, np.nan) if live.count < frame.size else frame)

    def pixels(self, shape: tuple[int, ...]) -> LivePixels:
        """Return the valid pixels of a frame of this shape."""
        known = self.live_of.get(shape)
        if known is None:
            mask = self.live
            if mask is None or mask.shape != shape:
                mask = np.ones(shape, bool)
            known = self.live_of[shape] = LivePixels(mask)
        return known


def _dead(
    rig: Rig, flats: Sequence[Flat], darks: Sequence[Dark], channel: str, load: Load
) -> DeadPixels | None:
    """Find dead pixels in the brightest flats and the longest darks."""

    def planes(entries: Sequence[Flat] | Sequence[Dark]) -> list[np.ndarray]:
        found = []
        for name in (name for entry in entries for name in entry.files):
            with suppress(InputError):
                found.append(_plane(rig, name, channel, load))
        return found

    unlit = planes(darks[-1:])
    return dead_pixels(planes(flats[-BRIGHTEST:]), unlit) if len(unlit) > 1 else None


def _dead_in_words(rig: Rig, dead: DeadPixels, channel: str) -> str:
    sentence = dead.sentence
    if len(rig.camera.sites) > 1:
        sentence += f" Rows and columns count those of {channel} alone."
    if rig.camera.region is not None:
        sentence += " They begin at the corner of camera.region."
    return sentence


def _full_scale(stated: float, converter: Converter) -> float:
    """Return the largest code of the ADC, DN, from the rig or, if frames clip at a lower code, from
    these frames."""
    top = stated if converter.clips_at is None else min(stated, converter.clips_at)
    step, origin = converter.step, converter.origin
    return origin + step * float(np.floor((top - origin) / step + 1e-6)) if step else top


def _first_site(camera: Camera) -> str:
    """Return the first green site of a mosaic, else the first tap, else `grey`."""
    greens = [site for site in camera.sites if site.startswith("green 1")]
    return (greens or camera.sites)[0]


def _pool_darks(darks: Sequence[Dark]) -> list[Dark]:
    """Combine the darks of equal exposure, in the order of exposure."""
    files: dict[float, tuple[str, ...]] = {}
    for dark in darks:
        files[dark.exposure] = files.get(dark.exposure, ()) + dark.files
    return [Dark(files=files[exposure], exposure=exposure) for exposure in sorted(files)]


def _light(rig: Rig, flat: Flat) -> float | None:
    """Return a flat's photons per pixel, stated or from its irradiance; None without."""
    if flat.photons is not None or flat.irradiance is None:
        return flat.photons
    camera = rig.camera
    if camera.wavelength is None or camera.pixel_pitch is None:
        raise InputError(
            f"{rig.folder}: an irradiance needs camera.wavelength and camera.pixel_pitch to become "
            "photons; add both, or give photons."
        )
    irradiance = jnp.asarray([flat.irradiance])
    wavelength, area = jnp.asarray(camera.wavelength), jnp.asarray(camera.pixel_pitch**2)
    return float(photon_rate(irradiance, wavelength, area)[0]) * flat.exposure


def _drop_odd_heads(rig: Rig) -> tuple[Rig, dict[str, list[OddFrames]], list[str]]:
    """Return the rig without frames that contradict their metadata, these frames, and remarks."""
    entries = {"flat": rig.flat, "dark": rig.dark}
    stated = [
        Stated(name, rig.path(name), entry.exposure, group)
        for group, entry in enumerate((*rig.flat, *rig.dark))
        for name in entry.files
    ]
    found, remarks = odd_heads(rig.folder, stated)
    gone = {name for one in found for name in one.names}
    kept: dict[str, list[Any]] = {}
    odd: dict[str, list[OddFrames]] = {}
    for kind, of_kind in entries.items():
        names = {name for entry in of_kind for name in entry.files}
        odd[kind] = [one for one in found if names.intersection(one.names)]
        refuse_half(rig.folder, odd[kind], len(names))
        kept[kind] = []
        for entry in of_kind:
            files = tuple(name for name in entry.files if name not in gone)
            if len(files) == 1:
                odd[kind].append(OddFrames(files, ALONE))
            if len(files) > 1:
                kept[kind].append(entry.model_copy(update={"files": files}))
    return rig.model_copy(update={k: tuple(own) for k, own in kept.items()}), odd, remarks


def _reduce_levels(
    source: _Source,
    entries: Sequence[Flat] | Sequence[Dark],
    *,
    odd: Sequence[OddFrames],
    light: Float[np.ndarray, " levels"] | None = None,
    dark: Levels | None = None,
) -> tuple[Levels, list[tuple[FrameSample, ...]], Codes]:
    """Compute each level's statistics (without deviating frames), frame summaries, and codes."""
    rig, gone, codes = source.rig, list(odd), Codes()
    count = sum(len(entry.files) for entry in entries)
    times = np.array([entry.exposure for entry in entries])
    black, unlit = None, [None] * len(entries)
    if dark is not None:
        nearest = np.abs(times[:, None] - np.asarray(dark.exposure)).argmin(axis=1)
        black = np.asarray(dark.mean)[nearest]
        of = [dark.mean, dark.variance]
        of += [] if dark.shared is None else [*dark.shared.lines]
        unlit = [Unlit(*own) for own in np.array(of)[:, nearest].T.tolist()]
    found = [
        _level(source, codes, entry.files, own, gone)
        for entry, own in zip(entries, unlit, strict=True)
    ]
    _leave_out_sizes(rig, found, gone)
    shows = [() if level is None else level.shown for level in found]
    amounts = np.zeros(len(found)) if light is None else light
    compared = odd_frames(shows, light=times if dark is None else amounts, black=black)
    gone += compared
    refuse_half(rig.folder, gone, count)
    names = {name for one in compared for name in one.names}
    for i in range(len(entries)):
        kept = [frame.name for frame in shows[i] if frame.name not in names]
        if len(kept) < len(shows[i]):
            found[i] = _level(source, codes, kept, unlit[i], []) if kept else None
    there = [i for i, level in enumerate(found) if level is not None]
    if not there:
        raise InputError(f"{rig.folder}: no level has two frames; {gone[0].sentence}")
    rows = [level for level in found if level is not None]
    live, of_lines = rows[0].live, np.array([row.lines for row in rows]).T
    shared = of_lines[:2], of_lines[2:4], of_lines[4], np.array(live.shape, float)
    numbers: dict[str, Any] = {
        name: _array([row.numbers[name] for row in rows]) for name in rows[0].numbers
    }
    # In a mosaic the nearest sites of one colour are two pixels apart.
    if rig.camera.cell != (1, 1) or min(live.shape) <= 2 * LARGEST_LAG:
        numbers |= dict.fromkeys(("covariances", "blocks", "combs"))
    levels = Levels(
        light=jnp.asarray(amounts[there]),
        exposure=jnp.asarray(times[there]),
        pixels=_array(float(live.count)),
        shared=SharedVariance(*map(_array, shared)),
        left_out=(*(one.sentence for one in gone), *_hits_in_words(rows, dark is None)),
        **numbers,
    )
    if levels.left_out:  # the values of these frames contain no information on the ADC
        codes = Codes()
        for name in (frame.name for row in rows for frame in row.shown):
            source.count(codes, source.plane(name))
    return levels, [row.shown for row in rows], codes


def _array(values: Any) -> Array:
    """Convert numbers to a JAX array by NumPy, without a program for each list."""
    return jnp.asarray(np.asarray(values))


def _hits_in_words(levels: Sequence[ReducedLevel], unlit: bool) -> list[str]:
    """Return a finding if outlying pixels of single frames were replaced; else an empty list."""
    what = "dark" if unlit else "flat"
    count = sum(level.hits for level in levels)
    if not count:
        return []
    most = max(levels, key=lambda level: level.hits / len(level.shown))
    share = most.hits / (len(most.shown) * most.live.count)
    return [
        f"{count} pixels of single {what}s, up to {format_percent(share, decimals=2)} of a frame "
        f"({most.shown[0].name} and others of its level), jump by more than {BULK:g} standard "
        "deviations, because of cosmic rays, a dark current that switches, or electron "
        "multiplication. They were left out."
    ]


def _leave_out_sizes(rig: Rig, found: list[ReducedLevel | None], gone: list[OddFrames]) -> None:
    """Drop levels whose frames differ in size from those of the majority of levels."""
    sizes = Counter(level.live.mask.shape for level in found if level is not None)
    if len(sizes) < 2:
        return
    shape, count = sizes.most_common(1)[0]
    if 2 * count <= sizes.total():
        raise InputError(f"{rig.folder}: frames differ in size from level to level; crop them.")
    for i, level in enumerate(found):
        if level is not None and (own := level.live.mask.shape) != shape:
            names = tuple(frame.name for frame in level.shown)
            gone.append(OddFrames(names, f"they are {own}, the frames of other levels {shape}"))
            found[i] = None


def _level(
    source: _Source, codes: Codes, files: Sequence[str], unlit: Unlit | None, odd: list[OddFrames]
) -> ReducedLevel | None:
    """Compute a level's statistics from frames of the usual size; None for fewer than two."""
    rig, of_size = source.rig, {}
    for name in files:
        try:
            frame = source.plane(name)
        except _Unreadable as error:
            reason = str(error).removeprefix(f"{rig.path(name)}: ").removesuffix(".")
            odd.append(OddFrames((name,), f"it cannot be read ({reason})"))
            continue
        source.count(codes, frame)
        if frame.shape not in of_size:
            top, corner = rig.camera.at(source.channel).clip_level, rig.camera.region
            own = source.pixels(frame.shape), unlit
            of_size[frame.shape] = LevelSums(frame, top, *own, corner=(corner or (0, 0))[:2])
        of_size[frame.shape].add(name, frame)
    if not of_size:
        return None
    first, *others = of_size.values()
    sums = max(of_size.values(), key=lambda own: len(own.shown))
    if others and 2 * len(sums.shown) <= sum(len(own.shown) for own in of_size.values()):
        raise InputError(
            f"{rig.path(others[0].shown[0].name)}: is {others[0].first.shape}, but "
            f"{first.shown[0].name} is {first.first.shape}; all frames of one level need the same "
            "size."
        )
    for shape, own in of_size.items():
        if own is not sums:
            why = f"it is {shape}, the others of its level {sums.first.shape}"
            odd.extend(OddFrames((frame.name,), why) for frame in own.shown)
    if len(sums.shown) < 2:
        odd.append(OddFrames((sums.shown[0].name,), ALONE))
        return None
    if sums.live.count < FEWEST_PIXELS:
        raise InputError(
            f"{rig.path(files[0])}: has {sums.live.count} pixels; a variance needs at least "
            f"{FEWEST_PIXELS}."
        )
    return sums.level()


class _Unreadable(InputError):
    """The error for a frame whose file is not an image."""


def _plane(rig: Rig, name: str, channel: str, load: Load) -> np.ndarray:
    try:
        stored = load(rig.path(name))
    except InputError as error:
        raise _Unreadable(str(error)) from error
    frame = read_frame(rig.path(name), rig.camera, load=lambda path: stored)
    if frame.ndim == 3:
        raise InputError(
            f"{rig.path(name)}: is a colour picture {frame.shape}; photon transfer needs raw data, "
            "grey or a mosaic with camera.pattern."
        )
    planes = split_channels(frame, rig.camera)
    if channel not in planes:
        raise InputError(f"{rig.path(name)}: has no channel {channel!r}; use {', '.join(planes)}.")
    return planes[channel]
