"""Reading photon transfer: frames of a rig reduced one at a time, or a table of sums."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.errors import InputError
from jaxvision.io import read_image
from jaxvision.sensor import photon_rate

from ..codes import Codes, Converter
from ..frame_checks.frame import ALONE, Odd, Shown, listed, refuse_half, shown
from ..frame_checks.heads import Stated, odd_heads
from ..frame_checks.levels import odd_frames
from ..inference.precision import in_double
from ..observation import Load, read_frame, split_channels
from ..rig import Camera, Dark, Flat, Rig, load_rig, require
from .levels import FEWEST_PIXELS, REACH, Levels, PhotonTransfer, linear_levels, rounding_step
from .levels_table import read_table
from .neighbours import Neighbours
from .periodic import quarters, residues
from .raw_frames import (
    BLOCK,
    block_products,
    dead_in_words,
    dead_pixels,
    local_variance,
    tone_curve,
    without_dead,
)
from .settings import require_one_setting
from .shared import shared_variance
from .variance_parts import Moments

FEWEST_LEVELS = 4  # levels of light below saturation for a line, its error and its misfit
MOST_PHOTONS = 1e15  # a full well of 1e7 electrons at a quantum efficiency of 1e-8
SEEN = 3.0  # standard errors by which a level must vary more than its darks
FEWEST_FOR_BLACK = 6  # levels from which a parabola tells the flats' own black level
SURE_OF_BLACK = 6.0  # standard errors by which it must differ from the darks
MOST_OFF_BLACK = 0.1  # of the least signal; less changes no gain by more
DARK_MATCH = 0.05  # relative difference in exposure up to which a dark is a flat's own


@in_double
def read_photon_transfer(
    path: str | os.PathLike[str], *, bits: int | None = None, channel: str = ""
) -> PhotonTransfer:
    """A photon transfer measurement from a rig's `[[flat]]` and `[[dark]]` frames, or from a table.

    Args:
        path: a rig folder or file, or a table of sums with the suffix `.csv`.
        bits: ADC bits of a table's camera; None to infer them where the table saturates.
        channel: site of a Bayer mosaic; empty for the first green.

    Returns:
        The measurement.

    Raises:
        InputError: for what cannot be used.
    """
    file = Path(path)
    if file.suffix.lower() == ".csv":
        measurement = read_table(file, bits)
    else:
        measurement = reduce_rig(load_rig(file), channel=channel)
    check(file, measurement)
    return measurement


def reduce_rig(rig: Rig, *, channel: str = "", load: Load = read_image) -> PhotonTransfer:
    """Reduces all frames of a rig, one frame in memory at a time.

    Args:
        rig: with `[[flat]]` and `[[dark]]`.
        channel: site of a Bayer mosaic; empty for the first green.
        load: how an image is had by its path.

    Returns:
        The measurement, unchecked.

    Raises:
        InputError: for frames that do not belong together.
    """
    require(rig, "photon transfer")
    require_one_setting(rig, "read them with fitting.noise.read_by_setting")
    rig, odd, remarks = _without_odd_heads(rig)
    flats = sorted(rig.flat, key=lambda flat: (_light(rig, flat) or flat.exposure, flat.exposure))
    darks = _pooled(rig.dark)
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
    codes, top = Codes(), rig.camera.at(channel).clip_level
    dead = dead_pixels(_stored(rig, flats, darks, load), top)
    if dead is not None:
        remarks.append(dead_in_words(dead, top))
        load = _load_without(dead, load)
    dark = _reduced(rig, darks, channel, load, codes, odd=odd["dark"])
    amounts = np.array(light if all(known) else [flat.exposure for flat in flats], float)
    bright = _reduced(rig, flats, channel, load, codes, odd=odd["flat"], light=amounts, dark=dark)
    converter = codes.converter()
    bright, dark = (replace(levels, converter=converter) for levels in (bright, dark))
    if float(bright.pixels) != float(dark.pixels):
        raise InputError(f"{rig.folder}: flats and darks differ in size; crop them alike.")
    if rig.camera.pattern is not None:
        remarks.append(f"Of the {rig.camera.pattern} mosaic the {channel} sites were used.")
    elif len(rig.camera.sites) > 1:
        remarks.append(f"Of the {len(rig.camera.sites)} taps the pixels of {channel} were used.")
    lossy = [name for entry in (*flats, *darks) for name in entry.files if _is_jpeg(name)]
    if lossy:
        remarks.append(
            f"{listed(lossy)} are JPEG, which rounds and drops noise and mostly has a tone curve: "
            "gain, read noise and quantum efficiency are not the camera's. Give raw frames."
        )
    stated = rig.camera.at(channel).clip_level
    if converter.clips_at is not None and converter.clips_at < stated - max(converter.step, 1.0):
        remarks.append(
            f"No number is above {converter.clips_at:g}, at which pixels pile up: it counts as the "
            f"end of the scale in place of {stated:g}; correct camera.bits, or give saturation."
        )
    gap = _gaps(bright, dark)
    if float(gap.min(axis=1).max()) > DARK_MATCH:
        remarks.append(
            "Some flats have no dark frames of their own exposure; the nearest were subtracted, so "
            "dark current between the two exposures counts as light."
        )
    return PhotonTransfer(
        bright=bright,
        dark=dark,
        dark_of=jnp.argmin(gap, axis=1),
        light_step=jnp.asarray(rounding_step(np.asarray(bright.light)) if all(known) else 0.0),
        photons_known=all(known),
        full_scale=_full_scale(stated, converter),
        remarks=tuple(remarks),
    )


def reduce_darks(rig: Rig, *, channel: str = "", load: Load = read_image) -> Levels:
    """Reduces the darks of a rig alone.

    Args:
        rig: with `[[dark]]`.
        channel: site of a Bayer mosaic; empty for the first green.
        load: how an image is had by its path.

    Returns:
        Levels without light, in the order of their exposure.

    Raises:
        InputError: for frames that do not belong together.
    """
    rig, odd, _ = _without_odd_heads(rig)
    channel = channel or _first_site(rig.camera)
    codes = Codes()
    darks = _reduced(rig, _pooled(rig.dark), channel, load, codes, odd=odd["dark"])
    return replace(darks, converter=codes.converter())


def _stored(
    rig: Rig, flats: Sequence[Flat], darks: Sequence[Dark], load: Load
) -> Iterator[np.ndarray]:
    """All frames that can be read, of the brightest flats and of a dark the first ones first."""
    names = [entry.files[0] for entry in (flats[-1], darks[0])]
    names += [name for entry in (*flats, *darks) for name in entry.files if name not in names]
    for name in names:
        with suppress(InputError):
            yield load(rig.path(name))


def _load_without(dead: np.ndarray, load: Load) -> Load:
    return lambda path: without_dead(load(path), dead)


def _is_jpeg(name: str) -> bool:
    return Path(name).suffix.lower() in (".jpg", ".jpeg")


def _full_scale(stated: float, converter: Converter) -> float:
    """The largest number that the converter gives, as far as the camera or its frames say."""
    top = stated if converter.clips_at is None else min(stated, converter.clips_at)
    step, origin = converter.step, converter.origin
    return origin + step * float(np.floor((top - origin) / step + 1e-6)) if step else top


def _first_site(camera: Camera) -> str:
    """The first green of a mosaic, else the first tap, or `grey`."""
    greens = [site for site in camera.sites if site.startswith("green 1")]
    return (greens or camera.sites)[0]


def _pooled(darks: Sequence[Dark]) -> list[Dark]:
    """Entries of one exposure as one, ascending."""
    files: dict[float, tuple[str, ...]] = {}
    for dark in darks:
        files[dark.exposure] = files.get(dark.exposure, ()) + dark.files
    return [Dark(files=files[exposure], exposure=exposure) for exposure in sorted(files)]


def _light(rig: Rig, flat: Flat) -> float | None:
    """Photons per pixel of a flat, from its irradiance where that is what is known."""
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


def _gaps(bright: Levels, dark: Levels) -> Float[Array, "levels darks"]:
    """How far each dark's exposure is from each flat's, relative to that."""
    longest = jnp.maximum(jnp.max(bright.exposure), jnp.max(dark.exposure))
    scale = jnp.where(bright.exposure > 0, bright.exposure, jnp.where(longest > 0, longest, 1.0))
    return jnp.abs(dark.exposure[None, :] - bright.exposure[:, None]) / scale[:, None]


def _without_odd_heads(rig: Rig) -> tuple[Rig, dict[str, list[Odd]], list[str]]:
    """A rig without the frames whose heads speak against it; those of flats and of darks; and
    remarks."""
    entries = {"flat": rig.flat, "dark": rig.dark}
    stated = [
        Stated(name, rig.path(name), entry.exposure, group)
        for group, entry in enumerate((*rig.flat, *rig.dark))
        for name in entry.files
    ]
    found, remarks = odd_heads(rig.folder, stated)
    gone = {name for one in found for name in one.names}
    kept: dict[str, list[Any]] = {}
    odd: dict[str, list[Odd]] = {}
    for kind, of_kind in entries.items():
        names = {name for entry in of_kind for name in entry.files}
        odd[kind] = [one for one in found if names.intersection(one.names)]
        refuse_half(rig.folder, odd[kind], len(names))
        kept[kind] = []
        for entry in of_kind:
            files = tuple(name for name in entry.files if name not in gone)
            if len(files) == 1:
                odd[kind].append(Odd(files, ALONE))
            if len(files) > 1:
                kept[kind].append(entry.model_copy(update={"files": files}))
    return rig.model_copy(update={k: tuple(own) for k, own in kept.items()}), odd, remarks


def _reduced(
    rig: Rig,
    entries: Sequence[Flat] | Sequence[Dark],
    channel: str,
    load: Load,
    codes: Codes,
    *,
    odd: Sequence[Odd],
    light: Float[np.ndarray, " levels"] | None = None,
    dark: Levels | None = None,
) -> Levels:
    """Levels of frames that belong together; `odd` is what was left out before."""
    gone = list(odd)
    count = sum(len(entry.files) for entry in entries)
    found = [_level(rig, entry.files, channel, load, gone, codes) for entry in entries]
    _leave_out_sizes(rig, found, gone)
    shows = [() if level is None else level.shown for level in found]
    times = np.array([entry.exposure for entry in entries])
    amounts, black = np.zeros(len(found)) if light is None else light, None
    if dark is not None:
        nearest = np.abs(times[:, None] - np.asarray(dark.exposure)).argmin(axis=1)
        black = np.asarray(dark.mean)[nearest]
    compared = odd_frames(shows, light=times if dark is None else amounts, black=black)
    gone += compared
    refuse_half(rig.folder, gone, count)
    names = {name for one in compared for name in one.names}
    for i in range(len(entries)):
        kept = [frame for frame in shows[i] if frame.name not in names]
        if len(kept) < len(shows[i]):
            left = [frame.name for frame in kept]
            found[i] = _level(rig, left, channel, load, []) if left else None
    there = [i for i, level in enumerate(found) if level is not None]
    if not there:
        raise InputError(f"{rig.folder}: no level has two frames; {gone[0].sentence}")
    rows = [level for level in found if level is not None]
    shape, of_lines = rows[0].shape, np.array([row.lines for row in rows]).T
    mean, variance, spatial, frames = np.array([row[:4] for row in rows], float).T
    # In a mosaic the nearest sites of one colour are two pixels apart.
    adjacent = rig.camera.cell == (1, 1) and min(shape) > 2 * REACH
    covariances = jnp.asarray([row.covariances for row in rows]) if adjacent else None
    return Levels(
        light=jnp.asarray(amounts[there]),
        exposure=jnp.asarray(times[there]),
        mean=jnp.asarray(mean),
        variance=jnp.asarray(variance),
        frames=jnp.asarray(frames),
        pixels=jnp.asarray(float(np.prod(shape))),
        spatial_variance=jnp.asarray(spatial),
        shared=shared_variance(of_lines, shape),
        covariances=covariances,
        residues=jnp.asarray([row.residues for row in rows]),
        quarters=jnp.asarray([row.quarters for row in rows]),
        local_pattern=jnp.asarray([row.local_pattern for row in rows]),
        blocks=jnp.asarray([row.blocks for row in rows]) if adjacent else None,
        left_out=tuple(one.sentence for one in gone),
    )


def _leave_out_sizes(rig: Rig, found: "list[_Level | None]", gone: list[Odd]) -> None:
    """Levels of another size than that of most."""
    sizes = Counter(level.shape for level in found if level is not None)
    if len(sizes) < 2:
        return
    shape, count = sizes.most_common(1)[0]
    if 2 * count <= sizes.total():
        raise InputError(f"{rig.folder}: frames differ in size from level to level; crop them.")
    for i, level in enumerate(found):
        if level is not None and level.shape != shape:
            names = tuple(frame.name for frame in level.shown)
            gone.append(Odd(names, f"they are {level.shape}, the frames of other levels {shape}"))
            found[i] = None


class _Level(NamedTuple):
    """Statistics of the frames of one level, as `Levels` holds them of all, and what is kept of
    each frame."""

    mean: float
    variance: float
    spatial: float
    frames: float
    lines: tuple[float, ...]
    covariances: np.ndarray
    shape: tuple[int, ...]
    shown: tuple[Shown, ...]
    residues: np.ndarray
    quarters: np.ndarray
    local_pattern: float
    blocks: np.ndarray


def _level(
    rig: Rig,
    files: Sequence[str],
    channel: str,
    load: Load,
    odd: list[Odd],
    codes: Codes | None = None,
) -> _Level | None:
    """The statistics of a level, None where fewer than two frames are left; what cannot be used is
    added to `odd`, the numbers that occur to `codes`."""
    sums, others = None, {}
    for name in files:
        try:
            stored = load(rig.path(name))
        except InputError as error:
            reason = str(error).removeprefix(f"{rig.path(name)}: ").removesuffix(".")
            odd.append(Odd((name,), f"it cannot be read ({reason})"))
            continue
        frame = _plane(rig, name, channel, stored)
        if codes is not None:
            codes.add(frame)
        sums = sums or _Sums(frame, rig.camera.at(channel).clip_level)
        if frame.shape != sums.first.shape:
            others[name] = frame.shape
        else:
            sums.add(name, frame)
    if sums is None:
        return None
    if 2 * len(others) >= len(sums.shown) + len(others):
        return _of_most(rig, files, sums, others, channel, load, odd)
    for name, shape in others.items():
        odd.append(Odd((name,), f"it is {shape}, the others of its level {sums.first.shape}"))
    if len(sums.shown) < 2:
        odd.append(Odd((sums.shown[0].name,), ALONE))
        return None
    if sums.first.size < FEWEST_PIXELS:
        raise InputError(
            f"{rig.path(files[0])}: has {sums.first.size} pixels; a variance needs at least "
            f"{FEWEST_PIXELS}."
        )
    return sums.level()


def _of_most(
    rig: Rig,
    files: Sequence[str],
    sums: "_Sums",
    others: dict[str, tuple[int, ...]],
    channel: str,
    load: Load,
    odd: list[Odd],
) -> _Level | None:
    """The level of the size that most of its frames have, where the first has another."""
    shape, count = Counter(others.values()).most_common(1)[0]
    if 2 * count <= len(others) + len(sums.shown):
        name = next(iter(others))
        raise InputError(
            f"{rig.path(name)}: is {others[name]}, but {sums.shown[0].name} is "
            f"{sums.first.shape}; all frames of one level need the same size."
        )
    for name in files:
        if name in {one.name for one in sums.shown} or others.get(name, shape) != shape:
            size = others.get(name, sums.first.shape)
            odd.append(Odd((name,), f"it is {size}, the others of its level {shape}"))
    return _level(rig, [name for name in files if others.get(name) == shape], channel, load, odd)


class _Sums:
    """Sums over the frames of a level. Deviations from the first frame keep S2 and S1^2 small:
    little cancels in their difference."""

    def __init__(self, first: np.ndarray, top: float) -> None:
        self.first, self._top = first, top
        self.shown: list[Shown] = []
        self._total, self._squares = np.zeros_like(first), np.zeros_like(first)
        self._shifts: list[float] = []
        self._lines, self._neighbours = Moments(first), Neighbours(first.shape)
        self._blocks = np.zeros((2, BLOCK))

    def add(self, name: str, frame: np.ndarray) -> None:
        """One more frame, or the first."""
        self.shown.append(shown(name, frame, top=self._top))
        deviation = frame - self.first
        self._shifts.append(float(deviation.mean()))
        if len(self.shown) == 1:
            return
        self._lines.add(deviation)
        # Light that drifts between the frames moves all pixels together: no noise of pixels, and
        # products would mix it with that noise.
        deviation = deviation - self._shifts[-1]
        self._total += deviation
        self._squares += deviation**2
        self._neighbours.add(deviation)
        self._blocks += block_products(deviation)

    def level(self) -> _Level:
        """The statistics of two frames or more."""
        count, total = len(self.shown), self._total
        average = self.first + total / count + np.mean(self._shifts)
        temporal = (count * self._squares - total**2) / (count * (count - 1))
        wandering = float(np.var(self._shifts, ddof=1))
        parts = self._lines.temporal(float(temporal.mean()) + wandering, wandering)
        variance = parts.of_a_pixel
        # A frame's mean holds the noise of its own pixels, too, which went with it.
        lost = wandering - parts.frames
        temporal += lost
        covariances = self._neighbours.covariances(total, variance, lost)
        passing = variance - (covariances[0, 1] + covariances[1, 0]) / 2
        blocks = (count * self._blocks - block_products(total)) / (count * (count - 1))
        return _Level(
            mean=float(average.mean()),
            variance=variance,
            spatial=float(average.var(ddof=1)),
            frames=float(count),
            lines=(parts.rows, parts.columns, *self._lines.fixed(average, parts), parts.frames),
            covariances=covariances,
            shape=self.first.shape,
            shown=tuple(self.shown),
            residues=residues(average, temporal),
            quarters=quarters(average, temporal),
            local_pattern=local_variance(average) - passing / count,
            blocks=blocks + lost,
        )


def _plane(rig: Rig, name: str, channel: str, stored: np.ndarray) -> np.ndarray:
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


def check(file: Path, measurement: PhotonTransfer) -> None:
    """Refuses a measurement from which no photon transfer can be had.

    Args:
        file: where it comes from, for messages.
        measurement: bright and dark levels.

    Raises:
        InputError: for what is missing or wrong.
    """
    try:
        _check(file, measurement)
    except InputError as error:
        left_out = (*measurement.bright.left_out, *measurement.dark.left_out)
        raise InputError(" ".join([str(error), *left_out[:3]])) from None


def _check(file: Path, measurement: PhotonTransfer) -> None:
    bright, dark = measurement.bright, measurement.dark
    for name, levels in (("flat", bright), ("dark", dark)):
        if bool(jnp.any(levels.exposure < 0)):
            raise InputError(f"{file}: a {name} has a negative exposure; give it in seconds.")
        if bool(jnp.any(levels.frames < 2)):
            raise InputError(f"{file}: a {name} level has one frame; a variance needs two or more.")
        if bool(jnp.any(levels.variance < 0)):
            raise InputError(f"{file}: a {name} level has a negative variance; check its column.")
    if not bool(jnp.any(bright.exposure > 0)):
        raise InputError(f"{file}: no flat has a positive exposure; give it in seconds.")
    if bool(jnp.any(bright.light < 0)):
        raise InputError(f"{file}: a flat has negative light; correct its photons.")
    if measurement.photons_known and float(bright.light.max()) > MOST_PHOTONS:
        raise InputError(
            f"{file}: a flat has {float(bright.light.max()):.3g} photons per pixel, more than any "
            f"pixel can hold; correct the unit (at most {MOST_PHOTONS:g})."
        )
    lights, times = (np.unique(np.asarray(x)).size for x in (bright.light, bright.exposure))
    if lights < FEWEST_LEVELS:
        if measurement.photons_known and times >= FEWEST_LEVELS:
            raise InputError(
                f"{file}: the flats have {times} exposures, but {lights} different photons; these "
                "are photons per pixel and exposure, so multiply a rate per second by the exposure."
            )
        raise InputError(
            f"{file}: the flats have too few different levels of light; at least {FEWEST_LEVELS} "
            "are needed, so vary the exposure or the light."
        )
    if measurement.photons_known and float(bright.light.max()) <= 0:
        raise InputError(f"{file}: no flat has any photons; give the light of each level.")
    exponent = tone_curve(measurement)
    if exponent is not None:
        raise InputError(
            f"{file}: the signal grows as the light to the power of {exponent:.2g}, and its noise "
            "not with it, as after a tone curve (gamma, sRGB), from which no gain follows; give "
            "raw, linear frames."
        )
    if bool(jnp.all(dark.variance == 0)):
        raise InputError(
            f"{file}: no dark varies from frame to frame (mean {float(dark.mean.max()):g} DN), so "
            "black is clipped, the frames are copies, or compression (JPEG) took their noise; "
            "raise the camera's black level and give independent raw frames."
        )
    if bool(jnp.all(bright.variance == 0)):
        raise InputError(
            f"{file}: no flat varies from frame to frame, so all are saturated or copies of one; "
            "give independent frames at lower light."
        )
    signal = bright.mean - dark.mean[measurement.dark_of]
    if float(signal.max()) < 3 * float(jnp.sqrt(dark.variance.max() / bright.pixels)):
        raise InputError(f"{file}: the flats are as dark as the darks; give more light.")
    if _most_shot_noise(measurement) < SEEN:
        raise InputError(
            f"{file}: the flats vary no more from frame to frame than the darks do, so no shot "
            "noise is seen, from which the gain is read off; give raw frames, neither averaged, "
            "smoothed nor compressed, and more light."
        )
    brightest = float(bright.mean.max()) / min(measurement.converter.step or 1.0, 1.0)
    if (measurement.full_scale or 0) > 255 and brightest <= 255:
        raise InputError(
            f"{file}: no flat exceeds 255 DN, as in 8-bit data; correct camera.bits, or give more "
            "light."
        )
    usable = linear_levels(measurement)
    if len(usable) < FEWEST_LEVELS:
        raise InputError(
            f"{file}: {len(usable)} levels of light lie below 95 % of saturation; at least "
            f"{FEWEST_LEVELS} are needed, so add flats at lower light."
        )
    _refuse_other_black(file, measurement, usable)


def _refuse_other_black(file: Path, measurement: PhotonTransfer, usable: np.ndarray) -> None:
    """Refuses darks whose black level is not that of the flats: where these have no signal, by
    their variance and by their light alike."""
    bright, dark = measurement.bright, measurement.dark
    levels = usable[np.asarray(bright.light)[usable] > 0]
    if len(levels) < FEWEST_FOR_BLACK:
        return
    mean, variance, light, frames = (
        np.asarray(x)[levels] for x in (bright.mean, bright.variance, bright.light, bright.frames)
    )
    there = np.asarray(measurement.dark_of)[levels]
    black, noise = float(np.mean(dark.mean[there])), float(np.mean(dark.variance[there]))
    errors = variance * np.sqrt(2 / (float(bright.pixels) * (frames - 1)))
    by_variance, slope, error = _at_zero(mean, variance - noise, errors)
    by_variance, error = -by_variance / slope, np.hypot(error, noise) / abs(slope)
    by_light, _, light_error = _at_zero(light, mean, np.sqrt(variance))
    off = np.array([by_variance, by_light]) - black
    signal = float(mean.min() - by_variance)
    sure = np.all(np.abs(off) > SURE_OF_BLACK * np.array([error, light_error]))
    alike = abs(off[0] - off[1]) < 0.5 * np.abs(off).min()
    if sure and alike and np.abs(off).min() > MOST_OFF_BLACK * abs(signal):
        raise InputError(
            f"{file}: without light the flats would read {by_variance:.4g} DN by their variance "
            f"and {by_light:.4g} DN by their light, but the darks read {black:.4g} DN; give flats "
            "and darks with the same offset, none of them subtracted."
        )


def _at_zero(x: np.ndarray, y: np.ndarray, errors: np.ndarray) -> tuple[float, float, float]:
    """Value and slope at zero of a parabola, and the error of the value, by how y scatters."""
    design = np.stack([np.ones_like(x), x, x**2], axis=1) / errors[:, None]
    scale = np.sqrt(np.sum(design**2, axis=0))
    found, rest, *_ = np.linalg.lstsq(design / scale, y / errors)
    covariance = np.linalg.pinv((design / scale).T @ (design / scale))
    misfit = max(float(rest[0]) / (len(x) - 3), 1.0) if rest.size else 1.0
    value, slope, _ = found / scale
    return float(value), float(slope), float(np.sqrt(covariance[0, 0] * misfit) / scale[0])


def _most_shot_noise(measurement: PhotonTransfer) -> float:
    """By how much a level varies more than its dark frames, in standard errors, at most."""
    bright, dark = measurement.bright, measurement.dark
    there = dark.variance[measurement.dark_of]
    errors = jnp.hypot(
        bright.variance * jnp.sqrt(2 / (bright.pixels * (bright.frames - 1))),
        there * jnp.sqrt(2 / (dark.pixels * (dark.frames - 1)))[measurement.dark_of],
    )
    return float(jnp.max((bright.variance - there) / errors))
