"""Calibration of the response from an exposure stack: the curve, gamma and the merged radiance map,
for each colour channel (or Bayer site) and group of images."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Integer

from jaxvision.errors import InputError

from ..frame_checks.dialled import LESS, exact_times, worst_in_words
from ..inference.emcee_run import Emcee, group_options
from ..inference.given import require_kind
from ..inference.precision import double_precision
from ..report.notebook import ShownInNotebooks
from .clipping import clear_of_clipping
from .colour_rounding import COLOURS, add_shared_rounding, shared_rounding
from .curve import ResponseCurve, fit_response_curve
from .gamma import GammaFit, fit_gamma
from .places import layout_of
from .radiance_map import RadianceMap, merge
from .read import ExposureStack, Plane
from .solve import STEADIEST

FEWEST_TO_LEAVE_OUT = 4  # exposures: any two of three agree on some curve
GOOD_SHUTTER, AS_GOOD = 0.005, 3.0  # errors of ln t: of a good shutter; ratio to the least error
MOST_ROUNDING = 2.0  # ratio to the scatter of rounded times from which other causes are likely
MOST_PIXELS = 100_000  # pixels of a plane used to find a suspect image


@dataclass(frozen=True)
class ChannelResponse:
    """The results for one plane (a channel of a group of images).

    Attributes:
        plane: the codes and exposures.
        curve: log exposure of every code.
        gamma: fit of the best pure gamma curve.
        radiance: the merged map.
        clear: whether the fit of the curve omits pixels near clipped pixels. False if too few
            pixels would remain.
        hidden_peaks: whether the images have clipped peaks that a blur reduced to codes below the
            clip level.
        clear_of_hidden: whether the fit of the curve also omits pixels near such hidden peaks.
        shared_rounding: rms error, in DN, from JPEG's colour rounding that all pixels of a code
            share; 0 if there is none.
    """

    plane: Plane
    curve: ResponseCurve
    gamma: GammaFit
    radiance: RadianceMap
    clear: bool
    hidden_peaks: bool = False
    clear_of_hidden: bool = False
    shared_rounding: float = 0.0


@dataclass(frozen=True, repr=False)
class ResponseCalibration(ShownInNotebooks):
    """The calibration of an exposure stack.

    Attributes:
        stack: the calibrated exposures.
        channels: the planes that could be calibrated.
        skipped: (plane, reason) of the other planes.
        sampling: settings of the sampler of gamma; None for exact integrals.
        seed: of every draw.
    """

    stack: ExposureStack
    channels: tuple[ChannelResponse, ...]
    skipped: tuple[tuple[Plane, str], ...]
    sampling: Emcee | None
    seed: int


@double_precision
def calibrate(
    stack: ExposureStack, *, sampling: Emcee | None = None, seed: int = 0
) -> ResponseCalibration:
    """Calibrate the response of every plane of a stack.

    A plane that cannot be calibrated, for example because all its pixels are clipped, is listed in
    `skipped` with the reason.

    Args:
        stack: exposures of still scenes.
        sampling: settings for draws of gamma by emcee; None for exact integrals.
        seed: of every draw.

    Returns:
        The calibration.

    Raises:
        InputError: when no plane can be calibrated.
    """
    require_kind("response.calibrate: stack", stack, ExposureStack, source="from_stack")
    channels, skipped = [], []
    for plane in stack.planes:
        try:
            channels.append(_calibrate(plane, stack, sampling, seed))
        except InputError as error:
            skipped.append((plane, str(error)))
    if not channels:
        plane, reason = skipped[0]
        raise InputError(f"This stack ({plane.label}): {reason}{_suspects(plane, stack, seed)}")
    stack, channels = _recalibrate_with_exact_times(stack, channels, sampling, seed)
    return ResponseCalibration(stack, tuple(channels), tuple(skipped), sampling, seed)


def _recalibrate_with_exact_times(
    stack: ExposureStack, channels: list[ChannelResponse], sampling: Emcee | None, seed: int
) -> tuple[ExposureStack, list[ChannelResponse]]:
    """Return stack and calibration, with exact times if the stated times are rounded."""
    stated = _shutter_error_of(channels)
    times = np.unique(np.concatenate([channel.plane.exposures for channel in channels]))
    for exact in exact_times(times) if stated else ():
        if stated > MOST_ROUNDING * np.std(np.log(exact / times)):
            continue
        own = [
            replace(c.plane, exposures=exact[np.searchsorted(times, c.plane.exposures)])
            for c in channels
        ]
        try:
            found = [_calibrate(plane, stack, sampling, seed) for plane in own]
        except InputError:
            continue
        left = _shutter_error_of(found)
        if left < LESS * stated:
            rest = f"by {100 * left:.2g} % rms" if left else "by no more than noise"
            said = (
                "The exposure times are rounded as cameras print them: with whole fractions of a "
                f"stop ({worst_in_words(times, exact)}, and so on), which were used, the images "
                f"disagree on their times {rest}, with the stated times by "
                f"{100 * stated:.2g} %."
            )
            planes = {id(c.plane): plane for c, plane in zip(channels, own, strict=True)}
            used = tuple(planes.get(id(plane), plane) for plane in stack.planes)
            return replace(stack, planes=used, remarks=(*stack.remarks, said)), found
    return stack, channels


def _shutter_error_of(channels: Sequence[ChannelResponse]) -> float:
    """Return the largest shutter error of the channels; 0 if none is measurable."""
    return max(channel.curve.shutter_error or 0.0 for channel in channels)


def _suspects(plane: Plane, stack: ExposureStack, seed: int) -> str:
    """Name the images without which all others agree on a curve; "" without any."""
    count = len(plane.files)
    if count < FEWEST_TO_LEAVE_OUT:
        return ""
    coarse = int(np.ceil(np.sqrt(plane.mask.size / MOST_PIXELS)))
    left: dict[str, float] = {}
    for i, name in enumerate(plane.files):
        others = np.arange(count) != i
        without = replace(
            plane,
            files=tuple(other for other in plane.files if other != name),
            exposures=plane.exposures[others],
            codes=plane.codes[others, ::coarse, ::coarse],
            mask=plane.mask[::coarse, ::coarse],
        )
        with contextlib.suppress(InputError):
            left[name] = _calibrate(without, stack, None, seed).curve.shutter_error or 0.0
    least = max(min(left.values(), default=0.0), GOOD_SHUTTER)
    names = [name for name, error in left.items() if error <= AS_GOOD * least]
    if not names:
        return ""
    if len(names) == 1:
        return f" Without {names[0]} the others agree: check its exposure time and gain first."
    several = f"{', '.join(names[:-1])} or {names[-1]}"
    return (
        f" Without {several} the others agree: check the exposure times and gains of these first."
    )


def _calibrate(
    plane: Plane, stack: ExposureStack, sampling: Emcee | None, seed: int
) -> ChannelResponse:
    layout = layout_of(plane.codes, plane.mask, black=plane.black, clip=plane.clip)

    def curve_of(codes: Integer[np.ndarray, "exposures h w"], *, dim: bool) -> ResponseCurve:
        return fit_response_curve(
            codes[:, plane.mask],
            plane.exposures,
            bits=stack.bits,
            black=plane.black,
            clip=plane.clip,
            layout=layout,
            least_error=max(STEADIEST, plane.exposure_sd),
            step=stack.step,
            origin=stack.origin,
            black_sd=plane.black_sd,
            dim=dim,
        )

    visible = clear_of_clipping(plane.codes, plane.clip, hidden=False)
    strict = clear_of_clipping(plane.codes, plane.clip, mask=plane.mask)
    hidden = not np.array_equal(strict, visible)
    attempts = [strict, visible, plane.codes] if hidden else [visible, plane.codes]
    curve, used = _first_that_fits(curve_of, attempts)
    shared = None
    of_group = {one.channel: one.codes for one in stack.planes if one.group == plane.group}
    if tuple(of_group) == COLOURS:
        shared = shared_rounding(list(of_group.values()), plane.channel, plane.clip)
    if shared is not None:
        curve = add_shared_rounding(curve, shared)
    gamma = fit_gamma(
        curve,
        label=plane.label,
        black_sd=plane.black_sd,
        exposure_sd=plane.exposure_sd,
        sampling=group_options(sampling, plane.label),
        seed=seed,
    )
    radiance = merge(plane.codes, plane.exposures, curve, signed=plane.black_measured)
    seen = np.rint(curve.codes[curve.seen]).astype(int)
    return ChannelResponse(
        plane,
        curve,
        gamma,
        radiance,
        clear=used is not plane.codes,
        hidden_peaks=hidden,
        clear_of_hidden=hidden and used is strict,
        shared_rounding=0.0 if shared is None else float(np.sqrt(np.mean(shared[seen] ** 2))),
    )


def _first_that_fits(
    curve_of: Callable[..., ResponseCurve], attempts: Sequence[np.ndarray]
) -> tuple[ResponseCurve, np.ndarray]:
    """Return the first curve that can be fitted, and its codes; dim images are allowed last."""
    *others, (last, dim) = [(codes, dim) for dim in (False, True) for codes in attempts]
    for codes, may_be_dim in others:
        with contextlib.suppress(InputError):
            return curve_of(codes, dim=may_be_dim), codes
    return curve_of(last, dim=dim), last


def radiance_images(calibration: ResponseCalibration) -> dict[str, Float[np.ndarray, "h w *rgb"]]:
    """Return the radiance map of each group of images."""
    images = {}
    for group in dict.fromkeys(channel.plane.group for channel in calibration.channels):
        of_colour: dict[str, list[ChannelResponse]] = {}
        for channel in calibration.channels:
            if channel.plane.group == group:
                name = channel.plane.channel.partition("tap ")[0].strip() or "grey"
                of_colour.setdefault(name, []).append(channel)
        names = tuple(of_colour)
        maps = dict(
            zip(names, crop_alike([_side_by_side(of_colour[n]) for n in names]), strict=True)
        )
        greens = [maps[site] for site in ("green 1", "green 2") if site in maps]
        if greens:
            maps["green"] = np.mean(greens, axis=0)
        if "grey" in maps:
            images[group] = maps["grey"]
        else:
            absent = np.full_like(next(iter(maps.values())), np.nan)
            colours = [maps.get(colour, absent) for colour in ("red", "green", "blue")]
            images[group] = np.stack(colours, axis=-1)
    return images


def crop_alike(planes: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Crop planes to the smallest; sites of a frame of odd size differ by a row or column."""
    rows, columns = (min(plane.shape[axis] for plane in planes) for axis in (0, 1))
    return [plane[:rows, :columns] for plane in planes]


def _side_by_side(taps: Sequence[ChannelResponse]) -> Float[np.ndarray, "h w"]:
    """Combine a colour's taps to one map, by ratios of neighbouring pixels."""
    first = taps[0]
    bins, factor = first.curve.bins, np.float32(1)
    if bins.anchor is not None:  # no pixel is at mid-scale, where relative exposure is 1
        halfway = (bins.black + bins.edges[-1]) / 2
        factor = np.float32(np.exp(-np.interp(halfway, bins.centres, first.curve.log_exposure)))
    if len(taps) == 1:
        return first.radiance.radiance * factor
    (down, across), shape = first.plane.step, [0, 0]
    for tap in taps:
        for axis, size in enumerate(tap.radiance.radiance.shape):
            last = tap.plane.start[axis] + tap.plane.step[axis] * (size - 1) + 1
            shape[axis] = max(shape[axis], last)
    whole = np.full(shape, np.nan, np.float32)
    reference = min(taps, key=lambda tap: tap.plane.start)
    for tap in taps:
        row, column = tap.plane.start
        if tap.plane.step == (1, 1):  # one tap reads one part of the frame
            _insert_map(whole, tap)
            continue
        ahead = (
            (row - reference.plane.start[0]) / down,
            (column - reference.plane.start[1]) / across,
        )
        one, other = crop_alike([_further(_log_radiance(reference), *ahead), _log_radiance(tap)])
        known = np.isfinite(one - other)
        ratio = np.exp(np.median((one - other)[known])) if known.any() else np.nan
        whole[row::down, column::across] = tap.radiance.radiance * np.float32(ratio)
    return whole * factor


def _insert_map(whole: Float[np.ndarray, "h w"], part: ChannelResponse) -> None:
    """Insert the map of a part of the frame, scaled so that the border has no step."""
    own = part.radiance.radiance
    (row, column), (height, width) = part.plane.start, own.shape
    rows, columns = np.s_[row : row + height], np.s_[column : column + width]
    apart = []
    for start, inside, before in (
        (row, own, whole[:row, columns][::-1]),
        (column, own.T, whole[rows, :column].T[::-1]),
    ):
        if start:
            with np.errstate(divide="ignore", invalid="ignore"):
                apart.append(_border_values(np.log(before)) - _border_values(np.log(inside)))
    first = np.isnan(whole).all()
    known = np.zeros(1) if first else np.concatenate(apart)
    known = known[np.isfinite(known)]
    whole[rows, columns] = own * np.float32(np.exp(np.median(known)) if known.size else np.nan)


def _border_values(lines: np.ndarray) -> np.ndarray:
    """Extrapolate the first two lines to the border, half a line before the first."""
    return lines[0] if len(lines) < 2 else 1.5 * lines[0] - 0.5 * lines[1]


def _log_radiance(channel: ChannelResponse) -> np.ndarray:
    """Return ln of the radiance; NaN if no exposure determines it."""
    found = channel.radiance
    known = (found.coverage > 0) & (found.radiance > 0)
    return np.log(np.where(known, found.radiance, np.nan))


def _further(values: np.ndarray, rows: float, columns: float) -> np.ndarray:
    """Shift values by a fraction of a pixel (0 to 1) along each axis, by linear interpolation."""
    for axis, part in ((0, rows), (1, columns)):
        if part > 0:
            one, next_one = np.moveaxis(values, axis, 0)[:-1], np.moveaxis(values, axis, 0)[1:]
            values = np.moveaxis((1 - part) * one + part * next_one, 0, axis)
    return values
