"""Detection of classes of pixels that differ although the rig does not state it: several
amplifiers, colour mosaics, interlaced rows, halves with separate converters, and gains that vary
with the distance from the centre.

If neighbouring columns have different amplifiers, or if pixels form a colour mosaic, properties of
rows or columns repeat with a period of 2 to 8. Therefore means are computed for classes of pixels:
by row and by column, each modulo 16 and modulo 30, and by position in a cell of 4 x 4. For a period
p, classes whose numbers are equal modulo p form one group and are replicates of each other. The
scatter of replicates comes from noise and from differences of rows or columns without this period.
Therefore an F-test of the differences between the p groups against this scatter detects the period.
If two classes have different gains K, a common K is the gain of neither class."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtrc, ndtr, stdtr

from ..inference.formatting import format_number
from .levels import PhotonTransfer
from .live_pixels import LivePixels
from .shared import LINES, significant_lines

RESIDUES = 16  # rows or columns modulo it; also places in a cell of 4 x 4
LONG_MODULUS = 30  # modulus that reveals periods of 3, 5 and 6
CELL = 4
PERIODS = (2, 4, 8)
CENTRE, QUARTERS = "centre and border", "quadrants"
HALVES = ("left and right", "top and bottom")
STEPS = (*HALVES, QUARTERS)
SIGNS = np.array([[-1, 1, -1, 1], [-1, -1, 1, 1], [-1, 1, 1, -1]]) / 2  # of a step in each quarter
PARTS_OF = {  # quarters of a frame in each part
    HALVES[0]: ([0, 2], [1, 3]),
    HALVES[1]: ([0, 1], [2, 3]),
    QUARTERS: ([0], [1], [2], [3]),
}
CONTRASTS = (
    (HALVES[0], [0, 2], [1, 3]),
    (HALVES[1], [0, 1], [2, 3]),
    (QUARTERS, [0, 3], [1, 2]),
    (CENTRE, [4], [5]),
)
BLOCKS = 24  # blocks of lines along a side for the detection of steps
FEWEST_STEPS = 6  # needed to estimate chance differences between blocks of lines
FALSE_ALARM_PROBABILITY = 1e-4  # probability of a false finding
LEAST_DARK_NOISE = 0.5  # steps of the converter; a smaller noise differs by the place between codes
NEGLIGIBLE_NOISE_SHARE = 0.1  # of a pixel's temporal noise, below which structure is negligible
# Largest gain difference that nonlinearity makes of a signal difference, relative to it
NONLINEARITY_GAIN_SHARE = 0.2
WORDS = {
    2: "Even and odd {0}",
    3: "The {0} of every three",
    4: "The {0} of every four",
    5: "The {0} of every five",
    6: "The {0} of every six",
    8: "The {0} of every eight",
}


WHOLES = {
    "mosaic": "The four sites of a cell of 2 x 2 pixels",
    CENTRE: "The centre and the border of the frame",
    QUARTERS: "The quarters of the frame",
}


def residues(
    average: np.ndarray, temporal: np.ndarray, live: LivePixels
) -> Float[np.ndarray, "2 5 residues"]:
    """Return means of the average frame, and of the temporal variance, over five kinds of classes:
    row and column modulo 16, position in a cell of 4 x 4, and row and column modulo 30.
    """
    found = np.full((2, 5, LONG_MODULUS), np.nan)
    if min(average.shape) < 2 * RESIDUES:
        return found
    for own, plane in zip(found, (average, temporal), strict=True):
        rows, columns = (live.line_means(plane, axis) for axis in (0, 1))
        cell = _quotient(_cell_sums(live.zero_invalid(plane)), _cell_sums(live.mask))
        own[:3, :RESIDUES] = _modulo(rows, RESIDUES), _modulo(columns, RESIDUES), cell
        if min(average.shape) >= 2 * LONG_MODULUS:
            own[3:] = _modulo(rows, LONG_MODULUS), _modulo(columns, LONG_MODULUS)
    return found


def _modulo(lines: np.ndarray, count: int) -> np.ndarray:
    place, known = np.arange(len(lines)) % count, np.isfinite(lines)
    sums = np.bincount(place, np.where(known, lines, 0.0), count)
    return _quotient(sums, np.bincount(place, known, count))


def _cell_sums(plane: np.ndarray) -> np.ndarray:
    rows = np.array([plane[i::CELL].sum(axis=0) for i in range(CELL)])
    return np.array([rows[:, j::CELL].sum(axis=1) for j in range(CELL)]).T.ravel()


def _quotient(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    return np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0)


def _mean(values: np.ndarray, count: np.ndarray) -> float:
    return float(np.where(count, values, 0.0).sum() / count.sum()) if count.any() else np.nan


def quarters(
    average: np.ndarray, temporal: np.ndarray, live: LivePixels
) -> Float[np.ndarray, "2 12"]:
    """Return two rows of 12 numbers. The first six numbers of each row are means over the quarters
    of the frame (top left, top right, bottom left, bottom right) and over its inner and outer half.
    The first row contains means of the average frame, the second row means of the temporal
    variance. Then come steps in the first row, with their p-values in the second: of the average
    frame at the vertical and at the horizontal middle line, half the difference of the steps at the
    vertical line in the upper and lower half, and the same three steps of the temporal variance.
    """
    (h, w), found = average.shape, np.full((2, 12), np.nan)
    if min(h, w) > 1:
        inner = _inner_half(h, w)
        for own, plane in zip(found, (average, temporal), strict=True):
            places = [
                (i, j)
                for i in (np.s_[: h // 2], np.s_[h // 2 :])
                for j in (np.s_[: w // 2], np.s_[w // 2 :])
            ]
            own[:4] = [_mean(plane[place], live.mask[place]) for place in places]
            own[4:6] = [_mean(plane, live.mask & zone) for zone in (inner, ~inner)]
        for first, plane in ((6, average), (9, temporal)):
            for i, axis in enumerate((1, 0)):
                found[:, first + i] = _step(live.line_means(plane, axis))
            found[:, first + 2] = _step(_upper_less_lower(plane, live) / 2)
    return found


def _upper_less_lower(plane: np.ndarray, live: LivePixels) -> np.ndarray:
    """Return the mean of each column in the upper half of the frame minus that in the lower."""
    middle, valid = -(-len(plane) // 2), live.zero_invalid(plane)
    upper, lower = (
        _quotient(valid[half].sum(axis=0), live.mask[half].sum(axis=0))
        for half in (np.s_[:middle], np.s_[middle:])
    )
    return upper - lower


@lru_cache(maxsize=1)
def _inner_half(h: int, w: int) -> Bool[np.ndarray, "h w"]:
    row, column = np.ogrid[:h, :w]
    distance = (row - (h - 1) / 2) ** 2 + (column - (w - 1) / 2) ** 2
    return distance <= np.median(distance)


def _step(lines: np.ndarray) -> tuple[float, float]:
    """Return the step of line means at the frame's middle, and its two-sided p-value."""
    size = max(len(lines) // BLOCKS // 2 * 2, 2)  # even, for structure that repeats after two lines
    before = -(-len(lines) // 2) - size
    start = before % (2 * size)
    count = (len(lines) - start) // (2 * size)
    pairs = lines[start : start + count * 2 * size].reshape(count, 2, size).mean(axis=2)
    rises = pairs[:, 1] - pairs[:, 0]
    middle = (before - start) // (2 * size)
    others = np.delete(rises, middle)
    others = others[np.isfinite(others)]
    if len(others) < FEWEST_STEPS or not others.std():
        return np.nan, np.nan
    step = float(rises[middle] - others.mean())
    error = float(others.std(ddof=1)) * np.sqrt(1 + 1 / len(others))
    return step, 2 * float(stdtr(len(others) - 1, -abs(step) / error))


@dataclass(frozen=True)
class Periodic:
    """A structure in which classes of pixels differ from each other."""

    # "rows", "columns", "mosaic", "left and right", "top and bottom", "quadrants" or "centre and
    # border"
    where: str
    period: int  # in rows or columns; 2 for a mosaic; 0 for parts of the frame
    gains: tuple[float, ...] = ()  # DN/e-, of each class; empty where the classes do not differ
    offsets: tuple[float, ...] = ()  # DN, of each class in the dark; empty where they do not differ
    noises: tuple[float, ...] = ()  # DN rms, of each class in the dark; empty where equal
    # of each class relative to their mean; empty where they do not differ
    signals: tuple[float, ...] = ()

    @property
    def unequal(self) -> float:
        """Relative rms deviation of the gains of the classes."""
        return float(np.std(self.gains) / np.mean(self.gains)) if self.gains else 0.0


def periodic_structure(
    measurement: PhotonTransfer, usable: Int[np.ndarray, " usable"]
) -> tuple[Periodic, ...]:
    """Find rows, columns, sites and parts of the frame that differ enough to matter."""
    bright, dark = measurement.bright, measurement.dark
    if bright.residues is None or dark.residues is None or not len(usable):
        return ()
    matched = np.asarray(measurement.dark_of)[usable]
    lit, unlit = np.asarray(bright.residues)[usable], np.asarray(dark.residues)
    signal, shot = np.moveaxis(lit - unlit[matched], 1, 0)  # (levels, 5, residues) each
    weight = 1 / np.asarray(bright.variance)[usable][:, None, None] ** 2
    gains = np.sum(weight * signal * shot, axis=0) / np.sum(weight * signal**2, axis=0)
    share = np.mean(signal / signal[:, :1, :RESIDUES].mean(axis=2, keepdims=True), axis=0)
    black = unlit[:, 0].mean(axis=0)
    top = int(np.argmax(np.asarray(bright.mean)[usable]))
    of_dark = float(np.sqrt(np.median(np.asarray(dark.variance))))
    of_top = float(
        np.sqrt(np.asarray(bright.variance)[usable][top]) / signal[top, 0, :RESIDUES].mean()
    )
    of_rows = gains[0, :RESIDUES]
    known = float(np.std(of_rows, ddof=1) / np.mean(of_rows) / np.sqrt(RESIDUES))
    least = {
        "gains": known,
        "offsets": NEGLIGIBLE_NOISE_SHARE * of_dark,
        "signals": NEGLIGIBLE_NOISE_SHARE * of_top,
        "noises": NEGLIGIBLE_NOISE_SHARE / 2,
    }
    values = {"gains": gains, "offsets": black, "signals": share}
    if of_dark > LEAST_DARK_NOISE * (measurement.converter.step or 1):
        values["noises"] = np.sqrt(unlit[:, 1].mean(axis=0))
    if not np.isfinite(gains[:3, :RESIDUES]).all():
        return tuple(_unequal_parts(measurement, usable, matched))

    def that_matter(classes: dict[str, tuple[float, ...]], signals: tuple[float, ...]) -> dict:
        """Return the quantities whose differences between classes are large enough to matter."""
        bent = NONLINEARITY_GAIN_SHARE * _spread("signals", signals)
        small = least | {"gains": max(least["gains"], bent)}
        return {name: own for name, own in classes.items() if _spread(name, own) > small[name]}

    found: list[Periodic] = []
    cells = {name: own for name, one in values.items() if (own := _cell_classes(one[2, :RESIDUES]))}
    of_cells = tuple(share[2, :RESIDUES].reshape(2, 2, 2, 2).mean(axis=(0, 2)).ravel().tolist())
    if cells := that_matter(cells, of_cells):
        found.append(Periodic("mosaic", 2, **cells))
    for kind, where in enumerate(LINES):
        periods = {name: _period(one, kind) for name, one in values.items() if name not in cells}
        period = max(periods.values(), default=0)
        if not period:
            continue
        lines = {
            name: _classes(values[name], kind, period)
            for name, own in periods.items()
            if own and period % own == 0
        }
        if lines := that_matter(lines, _classes(share, kind, period)):
            found.append(Periodic(where, period, **lines))
    return (*found, *_unequal_parts(measurement, usable, matched))


def _spread(name: str, values: tuple[float, ...]) -> float:
    """Return the rms deviation between classes, for gains and noises relative to their mean."""
    return float(np.std(values) / (np.mean(values) if name in ("gains", "noises") else 1.0))


def _classes(values: Float[np.ndarray, "5 residues"], kind: int, period: int) -> tuple[float, ...]:
    own = values[kind, :RESIDUES] if RESIDUES % period == 0 else values[3 + kind]
    return tuple(own.reshape(-1, period).mean(axis=0).tolist())


def _period(values: Float[np.ndarray, "5 residues"], kind: int) -> int:
    """Return the shortest period of rows (0) or columns (1) that explains all; 0 if none."""
    found, longer = _shortest(values[kind, :RESIDUES], PERIODS), values[3 + kind]
    if found > 2 or not np.isfinite(longer).all():
        return found
    if found == 2:
        return max(found, _shortest(longer, (2, 6)))
    # A period of 6 also explains one of 2 or 3. It is real if neither explains all structure.
    sixths = [_shortest(longer, (two_or_three, 6)) for two_or_three in (2, 3)]
    return max(min(filter(None, sixths), default=0), _shortest(longer, (5,)))


def _shortest(values: Float[np.ndarray, " residues"], periods: tuple[int, ...]) -> int:
    """Return the shortest of nested `periods` that explains all differences; 0 if none."""
    count = len(values)
    chosen, explained = 0, np.full(count, values.mean())
    for period in periods:
        fitted = np.tile(values.reshape(-1, period).mean(axis=0), count // period)
        more = period - (chosen or 1)
        gain, left = np.sum((fitted - explained) ** 2), np.sum((values - fitted) ** 2)
        degrees = count - period
        if (
            gain > 0
            and fdtrc(more, degrees, gain / more / max(left / degrees, 1e-300))
            < FALSE_ALARM_PROBABILITY
        ):
            chosen, explained = period, fitted
    return chosen


def _cell_classes(values: Float[np.ndarray, " residues"]) -> tuple[float, ...]:
    """Return means of the sites of a 2 x 2 cell that rows and columns do not explain; else ()."""
    cell = values.reshape(CELL // 2, 2, CELL // 2, 2)  # (., row, ., column)
    sites = cell.mean(axis=(0, 2))
    contrast = sites[0, 0] + sites[1, 1] - sites[0, 1] - sites[1, 0]
    left = float(np.sum((cell - sites[None, :, None, :]) ** 2)) / 12
    ratio = contrast**2 / max(4 * left / 4, 1e-300)
    return tuple(sites.ravel().tolist()) if fdtrc(1, 12, ratio) < FALSE_ALARM_PROBABILITY else ()


def _unequal_parts(
    measurement: PhotonTransfer, usable: np.ndarray, matched: np.ndarray
) -> list[Periodic]:
    """Find halves or quarters of the frame with different gains or with a step between their black
    levels, dark noises or signals, and a centre whose gain differs from that of the border.
    Smoothly uneven light cannot cause such differences."""
    bright, dark = measurement.bright, measurement.dark
    if bright.quarters is None or dark.quarters is None:
        return []
    lit, unlit = np.asarray(bright.quarters)[usable], np.asarray(dark.quarters)
    black = np.median(unlit[:, 0, :4], axis=0)
    of_dark = float(np.sqrt(np.median(np.asarray(dark.variance))))
    signal = np.asarray(bright.mean)[usable] - np.asarray(dark.mean)[matched]
    top = int(np.argmax(signal))
    of_top = float(np.sqrt(np.asarray(bright.variance)[usable][top]) / signal[top])
    share = np.median((lit[:, 0, 6:9] - unlit[matched][:, 0, 6:9]) / signal[:, None], axis=0)
    steps = np.median(unlit[:, 0, 6:], axis=0)
    stepped = _steps_that_matter(steps[:3], unlit[:, 1, 6:9], of_dark)
    unlike = _steps_that_matter(share, lit[:, 1, 6:9], of_top)
    noisier: list[str] = []
    if of_dark > LEAST_DARK_NOISE * (measurement.converter.step or 1):
        noisier = _steps_that_matter(steps[3:], unlit[:, 1, 9:], 2 * of_dark**2)
    gains, unequal = _gains_of_parts(measurement, usable, lit[..., :6], unlit[:, :, :6][matched])
    found = [Periodic(CENTRE, 0, gains=tuple(gains[4:]))] if CENTRE in unequal else []
    parts = {*unequal, *stepped, *unlike, *noisier} - {CENTRE}
    if not parts:
        return found
    where = parts.pop() if parts < {*HALVES} else QUARTERS
    own = PARTS_OF[where]
    of_gains = where in unequal or (where == QUARTERS and unequal)
    signals = 1 + (share * [part in unlike for part in STEPS]) @ SIGNS
    noises = np.sqrt(np.median(unlit[:, 1, :4], axis=0))
    return [
        Periodic(
            where,
            0,
            gains=tuple(float(gains[one].mean()) for one in own) if of_gains else (),
            offsets=tuple(float(black[one].mean()) for one in own) if stepped else (),
            noises=tuple(float(noises[one].mean()) for one in own) if noisier else (),
            signals=tuple(float(signals[one].mean()) for one in own) if unlike else (),
        ),
        *found,
    ]


def _steps_that_matter(
    step: Float[np.ndarray, "3"], p_values: Float[np.ndarray, "levels 3"], noise: float
) -> list[str]:
    """Return the parts between which frames have a significant, not negligible step."""
    rare = np.median(p_values, axis=0)
    return [
        part
        for part, p, size in zip(STEPS, rare, np.abs(step), strict=True)
        if p < FALSE_ALARM_PROBABILITY and size > NEGLIGIBLE_NOISE_SHARE * noise
    ]


def _gains_of_parts(
    measurement: PhotonTransfer, usable: np.ndarray, lit: np.ndarray, unlit: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """Return K of each quarter, centre and border, and which `CONTRASTS` are significant."""
    bright = measurement.bright
    signal, shot = np.moveaxis(lit - unlit, 1, 0)  # (levels, places) each
    variance, frames = np.asarray(bright.variance)[usable], np.asarray(bright.frames)[usable]
    weight = ((frames - 1) / variance**2)[:, None]
    squares = np.sum(weight * signal**2, axis=0)
    gains = np.sum(weight * signal * shot, axis=0) / squares
    # Noise shared by rows or columns increases the error of the variances of halves.
    if bright.flicker is not None or significant_lines(measurement.dark):
        return gains, []
    pixels = float(bright.pixels) / np.array([4, 4, 4, 4, 2, 2])
    errors = np.sqrt(2 / (squares * pixels))
    found = []
    for where, one, other in CONTRASTS:
        pair = gains[one].mean(), gains[other].mean()
        error = np.sqrt(sum(np.mean(errors[half] ** 2) / len(half) for half in (one, other)))
        lights = signal[:, one].sum(), signal[:, other].sum()
        bent = NONLINEARITY_GAIN_SHARE * abs(lights[0] - lights[1]) / (lights[0] + lights[1])
        apart = abs(pair[0] - pair[1])
        if not np.isfinite(error) or apart / (pair[0] + pair[1]) < bent:
            continue
        if 2 * ndtr(-apart / error) < FALSE_ALARM_PROBABILITY:
            found.append(where)
    return gains, found


def taps_in_words(taps: tuple[int, int] | str | None) -> str:
    """Write `taps` as a rig file states them."""
    return f'"{taps}"' if isinstance(taps, str) else str(list(taps or ()))


def taps_of(found: tuple[Periodic, ...], *, apart: int = 1) -> tuple[int, int] | str | None:
    """Return the value of `camera.taps` that describes the classes of differing pixels; None if no
    value does. `apart` is the distance in the frame between neighbouring pixels of these data: 2
    for one site of a mosaic, else 1."""
    periods = {one.where: apart * one.period for one in found if one.period}
    if "mosaic" in periods:
        return (2 * apart, 2 * apart)
    if periods:
        return periods.get("rows", 1), periods.get("columns", 1)
    return next((one.where for one in found if one.where != CENTRE), None)


def unequal_gains_of(found: tuple[Periodic, ...]) -> float:
    """Return the relative rms deviation of the gains of all classes together."""
    return float(np.sqrt(sum(one.unequal**2 for one in found)))


def periodic_in_words(
    found: tuple[Periodic, ...],
    gain: float,
    *,
    apart: bool = False,
    spacing: int = 1,
    fitted: bool = True,
) -> list[str]:
    """Return one or two sentences for each periodic structure. `spacing` is the distance in the
    frame between neighbouring pixels of these data; `fitted` is false where no gain is reported."""
    sentences = []
    for one in found:
        who = WHOLES.get(one.where, f"The {one.where} halves")
        if one.where in LINES:
            who = WORDS[one.period].format(one.where)
        parts = []
        if one.gains:
            span = 100 * (max(one.gains) / min(one.gains) - 1)
            listed = ", ".join(f"{x:.4g}" for x in one.gains)
            parts.append(f"in gain by {span:.3g} % ({listed} DN/e⁻)")
        if one.offsets:
            span = max(one.offsets) - min(one.offsets)
            parts.append(f"in black level by {span:.3g} DN ({format_number(span / gain, 1)} e⁻)")
        if one.noises:
            span = 100 * (max(one.noises) / min(one.noises) - 1)
            parts.append(f"in dark noise by {span:.3g} %")
        if one.signals and not one.gains:
            span = 100 * (max(one.signals) / min(one.signals) - 1)
            parts.append(f"in signal by {span:.3g} %")
        taps = taps_in_words(taps_of((one,), apart=spacing))
        cause, remedy = "several amplifiers", f"give camera.taps = {taps}"
        if one.where == CENTRE:
            cause, remedy = "a correction of lens shading in the camera", "give frames without it"
        elif (
            one.period
            and one.signals
            and spacing == 1
            and not (one.gains or one.offsets or one.noises)
        ):
            cause = {"rows": "interlaced rows, or a mosaic", "mosaic": "a colour mosaic"}.get(
                one.where, "several amplifiers, or a mosaic"
            )
            remedy = f"give camera.pattern of a mosaic, or {remedy.removeprefix('give ')}"
        differ = f"{who} differ {' and '.join(parts)}, as with {cause}"
        if apart and one.where != CENTRE:
            sentences.append(f"{differ}, and were calibrated separately; {remedy} to state it.")
            continue
        sentences.append(
            f"{differ}; {remedy}{'' if one.where == CENTRE else ' to calibrate each separately'}."
        )
        if one.gains and fitted:
            sentences.append(
                "K is between their gains and is not the gain of any pixel. Its error, and those "
                "of figures that depend on it, include the deviation of the gains, "
                f"{100 * one.unequal:.2g} %."
            )
    return sentences
