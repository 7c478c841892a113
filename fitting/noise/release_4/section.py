"""The report sections of the EMVA 1288 data sheet, release 4.0."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ...inference.estimates import QUANTILES, Estimate, not_determined, sampled_estimate
from ...inference.formatting import format_number, format_percent
from ...inference.precision import double_precision
from ...report.section import Section, Table
from ..calibration import BY_NAME
from ..findings import unequal_pixels
from ..levels import signal_of
from ..quantities import HEADINGS, QUANTITIES, Quantity
from ..regressions import sampling_errors
from ..section import replace_doubted, standard_estimate, why_missing
from .average_frames import outliers
from .figures import defect_images, pictures_of_images, signal_to_noise
from .nonuniformity import BORDER, FEWEST_LINES, Split, loss_of_filter
from .sheet import FILTERED, PARTS, PLAIN, Nonuniformity, Release4
from .stacks import Averages

KIND, TITLE = "noise_release_4", "EMVA 1288, release 4.0"
LINEAR, UNFILTERED, GENERAL = "EMVA 1288 R4", "no high-pass", "EMVA 1288 R4 General"
METHODS = {FILTERED: LINEAR, PLAIN: UNFILTERED}
LINEARITY = Quantity("linearity_error", "LE", "%")
GENERAL_QUANTITIES = (
    Quantity("output_snr_max", "SNR_y.max", "1"),
    Quantity("input_snr_max", "SNR_p.max", "1"),
    Quantity("input_snr_max_db", "SNR_p.max", "dB", False),
    Quantity("efficiency_bound", "η_least", "%"),
    *(BY_NAME[name] for name in ("threshold_photons", "dynamic_range", "dynamic_range_db")),
)
OF_PARTS = {
    (kind, part): Quantity(
        kind if part == "total" else f"{kind}_{part}",
        f"{kind.upper()}_1288" + ("" if part == "total" else f".{part}"),
        unit,
    )
    for kind, unit in (("dsnu", "e⁻"), ("prnu", "%"))
    for part in PARTS
}
LEAK = 0.1  # share of a part from which retained row and column noise is reported


def section(sheet: Release4) -> Section:
    """Return the sheets *Linear* and *General* as one section, for a notebook."""
    linear, general = sections(sheet)
    return replace(
        linear,
        kind=KIND,
        title=TITLE,
        estimates=(*linear.estimates, *general.estimates),
        pictures=(*linear.pictures, *general.pictures),
        tables=(*linear.tables, *general.tables),
    )


@double_precision
def sections(sheet: Release4) -> list[Section]:
    """Return the data sheet of release 4 as two sections of a report, *Linear* and *General*."""
    stacks, measurement = sheet.stacks, sheet.stacks.measurement
    settings = {"release": "4.0", "seed of the draws": sheet.seed}
    of_images, frames = (), {}
    averages = stacks.averages
    if averages is not None:
        of_images = (
            *(_variances(sheet, averages), _variances_of_levels(sheet, averages)),
            _outliers(averages),
        )
        frames = {
            "light of the bright average": float(measurement.bright.light[averages.level]),
            "frames of the bright average": averages.lit.frames,
            "frames of the dark average": averages.unlit.frames,
        }
    linear = Section(
        kind=f"{KIND}_linear",
        title=f"{TITLE} Linear",
        estimates=replace_doubted([*_linear(sheet), *_nonuniformities(sheet)], measurement),
        findings=_findings(sheet),
        pictures=pictures_of_images(sheet),
        tables=of_images,
        about="EMVA Standard 1288, release 4.0 Linear (2021), of all pixels.",
        headings=_headings(),
        settings=settings | frames,
    )
    general = Section(
        kind=f"{KIND}_general",
        title=f"{TITLE} General",
        estimates=replace_doubted(_general(sheet), measurement),
        pictures=(signal_to_noise(sheet),),
        tables=(_signal_to_noise(sheet),),
        about="EMVA Standard 1288, release 4.0 General (2021): no linear model, the measured "
        "response alone.",
        settings=settings,
    )
    return [linear, general]


def _headings() -> dict[str, tuple[str, ...]]:
    found = dict(HEADINGS)
    for kind, title in (("dsnu", "Dark signal"), ("prnu", "Photo response")):
        names = tuple(OF_PARTS[kind, part].name for part in PARTS)
        found[f"{title} nonuniformity"] = names
    del found["Spatial nonuniformity"]
    found["Linearity error"] = (LINEARITY.name,)
    return found


def _linear(sheet: Release4) -> list[Estimate]:
    args = sheet.stacks.measurement, sheet.within, sheet.linear, LINEAR
    absent = ("dsnu", "prnu", "linearity_error_min", "linearity_error_max")
    quantities = [one for one in (*QUANTITIES, LINEARITY) if one.name not in absent]
    return [standard_estimate(one, *args) for one in quantities]


def _nonuniformities(sheet: Release4) -> list[Estimate]:
    if not sheet.nonuniformity:
        reason = (
            "a table of temporal sums does not contain the pixels; give the frames in a rig folder"
        )
        return [not_determined(quantity, reason, method=LINEAR) for quantity in OF_PARTS.values()]
    relative = float(sheet.linear.errors["system_gain"]) / sheet.gain
    rng = np.random.default_rng(sheet.seed)
    listed = []
    for (kind, part), quantity in OF_PARTS.items():
        for method, one in sheet.nonuniformity.items():
            dark, bright = getattr(one.dark, part), getattr(one.bright, part)
            if kind == "dsnu":
                variance, draws, scale = dark, one.dsnu[part], 1 / sheet.gain
                spread = np.exp(relative * rng.standard_normal(len(draws)))
            else:
                variance, draws, scale = (bright - dark) / one.signal**2, one.prnu[part], 100.0
                spread = 1.0
            listed.append(_deviation(quantity, variance, draws, scale, spread, METHODS[method]))
    return listed


def _deviation(
    quantity: Quantity,
    variance: float,
    draws: Float[np.ndarray, " draws"],
    scale: float,
    spread: Float[np.ndarray, " draws"] | float,
    method: str,
) -> Estimate:
    """Return a standard deviation from draws of its variance, or a limit if they include 0."""
    drawn = scale * spread * np.sqrt(np.maximum(draws, 0))
    ends = np.quantile(drawn, QUANTILES)
    if ends[0] <= 0 or variance <= 0:
        reason = "not distinguishable from none: its variance comes out below 0"
        if ends[-1] > 0:
            reason = f"below {ends[-1]:.3g} {quantity.unit}: not distinguishable from none"
        return not_determined(quantity, reason, method=method)
    value = scale * float(np.sqrt(variance))
    return sampled_estimate(quantity, drawn, method=method, ends=ends, value=value)


def _general(sheet: Release4) -> list[Estimate]:
    listed = []
    for quantity in GENERAL_QUANTITIES:
        if quantity.name not in sheet.general.values:
            name = quantity.name.replace("efficiency_bound", "quantum_efficiency")
            reason = why_missing(sheet.stacks.measurement, name)
            listed.append(not_determined(quantity, reason, method=GENERAL))
            continue
        drawn, value = sheet.general.draws[quantity.name], sheet.general.values[quantity.name]
        listed.append(sampled_estimate(quantity, drawn, method=GENERAL, value=value))
    return listed


def _findings(sheet: Release4) -> tuple[str, ...]:
    stacks = sheet.stacks
    sentences = _findings_on_frames(sheet)
    if sheet.within.saturation is not None and not sheet.clipped:
        why = "no level has more than .15 % of its numbers at the end of the scale"
        if stacks.numbers is None:
            why = "a table of sums has no pixels to count at the end of the scale"
        sentences.append(
            f"The saturation point is that of the largest variance (release 3.1): {why}."
        )
    sentences.append(_noise_of_linearity(sheet))
    if stacks.averages is None:
        return tuple(sentences)
    if FILTERED not in sheet.nonuniformity:
        least = 2 * BORDER + FEWEST_LINES
        sentences.append(
            "The frames are too small for the high-pass of clause 8.1, which needs at least "
            f"{least} x {least} pixels, so uneven light counts as nonuniformity."
        )
    else:
        loss = loss_of_filter()
        lines, pixels = (
            format_percent(float(np.sqrt(x)), decimals=1) for x in (loss.lines, loss.pixels)
        )
        sentences.append(
            f"The high-pass leaves {lines} of the deviation of independent rows and columns and "
            f"{pixels} of that of independent pixels; figures after it are not corrected for that."
        )
        sentences += _unevenness(sheet.nonuniformity)
    return (*sentences, *_leaks(sheet, stacks.averages))


def _findings_on_frames(sheet: Release4) -> list[str]:
    """Return sentences on frames that were left out, pixels that differ, and the files."""
    measurement = sheet.stacks.measurement
    usable = np.flatnonzero(np.asarray(sheet.within.linearity))
    gone = (*measurement.bright.left_out, *measurement.dark.left_out)
    return [*gone, *unequal_pixels(measurement, usable, sheet.gain), *measurement.remarks]


def _noise_of_linearity(sheet: Release4) -> str:
    """Return a sentence on the linearity error that noise alone would give."""
    measurement = sheet.stacks.measurement
    bright, dark = measurement.bright, measurement.dark
    of_bright, of_dark = (np.asarray(sampling_errors(one).mean) for one in (bright, dark))
    own = np.asarray(measurement.dark_of)
    within = np.asarray(sheet.within.linearity)
    signal = signal_of(measurement)[within]
    errors = np.sqrt(of_bright + of_dark[own])[within] / signal
    alone = 100 * np.sqrt(2 / np.pi) * float(errors.mean())
    found = float(sheet.linear.values[LINEARITY.name])
    return (
        f"In a linear camera, the noise of the means alone would cause a linearity error of "
        f"{format_number(alone, 3)} %; this camera has {format_number(found, 3)} %."
    )


def _unevenness(found: Mapping[str, Nonuniformity]) -> list[str]:
    plain, filtered = (found[how].prnu["total"] for how in (PLAIN, FILTERED))
    low, high = np.quantile(plain, 0.025), np.quantile(filtered, 0.975)
    if low <= high / loss_of_filter().lines:
        return []
    without, behind = (100 * np.sqrt(max(float(np.median(x)), 0)) for x in (plain, filtered))
    return [
        f"PRNU is {format_number(without, 2)} % without the high-pass and "
        f"{format_number(behind, 2)} % with it: most of it varies over more than 10 pixels, as "
        "uneven light does."
    ]


def _leaks(sheet: Release4, averages: Averages) -> list[str]:
    """Return findings on noise of lines, and drift, that the standard misattributes."""
    measurement, unlit, sentences = sheet.stacks.measurement, averages.unlit, []
    shared, own = measurement.dark.shared, int(measurement.dark_of[averages.level])
    split: Split = sheet.nonuniformity[PLAIN].dark
    if shared is not None:
        of_lines = ("rows", shared.lines[0], split.row), ("columns", shared.lines[1], split.col)
        for name, varying, fixed in of_lines:
            kept = float(varying[own]) / unlit.frames
            if fixed > 0 and kept > LEAK * fixed:
                sentences.append(
                    f"The {name} of a dark share temporal noise, of which the average over "
                    f"{unlit.frames} frames keeps {format_number(np.sqrt(kept), 2)} DN. The "
                    f"standard counts that as DSNU of {name} "
                    f"({format_number(np.sqrt(fixed), 2)} DN in all); more frames lower it."
                )
    lost = unlit.drift / unlit.frames
    if lost > LEAK * max(split.total, 0.0) and lost > 0:
        sentences.append(
            f"The means of the darks differ by {format_number(np.sqrt(unlit.drift), 2)} DN rms, "
            "which (65) counts as noise of the pixels: spatial variances of the dark are too small "
            f"by {format_number(lost, 2)} DN²."
        )
    return sentences


def _signal_to_noise(sheet: Release4) -> Table:
    general = sheet.general
    none = (None,) * len(general.light)
    light = "photons" if sheet.stacks.measurement.photons_known else "s"
    return Table(
        "Signal to noise at all levels",
        (f"light [{light}]", "slope R [DN per unit]", "SNR_y", "SNR_p", "standard error",
         "total SNR_p", "nonuniformity of the input [%]"),
        tuple(
            zip(
                general.light.tolist(),
                general.slope.tolist(),
                general.output.tolist(),
                general.input.tolist(),
                general.input_errors.tolist(),
                none if general.total is None else general.total.tolist(),
                none if general.nonuniformity is None else general.nonuniformity.tolist(),
                strict=True,
            )
        ),
        "From the measured response alone; its slope is that of the parabola through the five "
        "nearest levels.",
    )  # fmt: skip


def _variances(sheet: Release4, averages: Averages) -> Table:
    rows = []
    lit, unlit = averages.lit, averages.unlit
    for how, one in sheet.nonuniformity.items():
        for name, split, stack in (("dark", one.dark, unlit), ("bright", one.bright, lit)):
            rows.append((name, how, *split, stack.noise + stack.drift, stack.frames))
    return Table(
        "Spatial variances of the average frames",
        ("average", "filter", *(f"s² {part} [DN²]" for part in PARTS), "σ² [DN²]", "frames"),
        tuple(rows),
        "By (36), (41), (42) and (65) of release 4.0 Linear; noise can make them negative.",
    )


def _variances_of_levels(sheet: Release4, averages: Averages) -> Table:
    stacks, rows = sheet.stacks, []
    bright, dark = stacks.measurement.bright, stacks.measurement.dark
    own = int(stacks.measurement.dark_of[averages.level])
    for levels, i, one in (
        (dark, own, stacks.dark[own]),
        *((bright, i, one) for i, one in enumerate(stacks.bright)),
    ):
        numbers = (levels.light[i], 1e3 * levels.exposure[i], levels.mean[i])
        last = float(levels.variance[i]), int(levels.frames[i])
        rows.append((*(float(x) for x in numbers), *one, *last))
    heads = ("light", "exposure [ms]", "mean [DN]", *(f"s² {part} [DN²]" for part in PARTS))
    how = "High-passed" if FILTERED in sheet.nonuniformity else "Not filtered"
    return Table(
        "Spatial variances of all levels",
        (*heads, "σ² [DN²]", "frames"),
        tuple(rows),
        f"{how}; the dark is that of the averages. The temporal noise that remains in few frames "
        "is subtracted.",
    )


def _outliers(averages: Averages) -> Table:
    rows = []
    for name, _, image, _ in defect_images(averages):
        for one in outliers(image):
            low, high = (100 * x for x in one.interval)
            rows.append(
                (
                    name,
                    one.beyond,
                    one.pixels,
                    100 * one.pixels / image.size,
                    f"{low:.3g} to {high:.3g}",
                    100 * one.expected,
                )
            )
    return Table(
        "Pixels that deviate",
        ("image", "standard deviations", "pixels", "share [%]", "95 % [%]", "Gaussian [%]"),
        tuple(rows),
        "Standard deviations are those of the middle 68 % of the pixels.",
    )
