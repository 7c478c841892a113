"""A photon transfer measurement from a CSV table: one row per level, bright and dark at the same
exposure.

The table has these columns:

- `photons_per_pixel`.
- `exposure_s`, `exposure_ms`, `exposure_us` or `exposure_ns`.
- Either the moments `mean_bright_DN`, `var_bright_DN2`, `mean_dark_DN` and `var_dark_DN2`, or the
  sums `bright_sum`, `bright_pvar`, `dark_sum` and `dark_pvar`. A `sum` is the sum of S1 over the
  pixels, and a `pvar` is the sum of L (L S2 - S1^2) over the pixels, where S1 is the sum of a
  pixel's numbers over the frames and S2 the sum of their squares.
- `frames`, the number L of frames (default 2).
- `pixels`, which may be missing if both sums and means are given.

Lines that start with # are skipped.
"""

import csv
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxvision.errors import InputError, plain_text

from .levels import FEWEST_PIXELS, Levels, PhotonTransfer, rounding_step

FEWEST_FOR_POWER, LIGHTS = 4, 4.0  # levels, and range of signals, needed to find a power law
STRAIGHT, CURVED = 0.05, 4.0  # relative scatter of variance over signal; ratio to its root's
COUNT_COLUMNS = ("bright_sum", "bright_pvar", "dark_sum", "dark_pvar")
MOMENT_COLUMNS = ("mean_bright_DN", "var_bright_DN2", "mean_dark_DN", "var_dark_DN2")
PIXELS_COLUMN, FRAMES_COLUMN = "pixels", "frames"
EXPOSURE_UNITS = {"exposure_s": 1.0, "exposure_ms": 1e-3, "exposure_us": 1e-6, "exposure_ns": 1e-9}


def read_table(file: Path, bits: int | None) -> PhotonTransfer:
    """Read a photon transfer measurement from a CSV table."""
    columns = _columns(file)
    units = [name for name in EXPOSURE_UNITS if name in columns]
    if not units:
        raise InputError(
            f"{file}: has no exposure column; name one of {', '.join(EXPOSURE_UNITS)}."
        )
    light = _column(file, columns, "photons_per_pixel")
    exposure = _column(file, columns, units[0]) * EXPOSURE_UNITS[units[0]]
    for name in units[1:]:
        if not np.allclose(columns[name] * EXPOSURE_UNITS[name], exposure, rtol=1e-3, atol=0):
            raise InputError(
                f"{file}: columns {units[0]} and {name} contradict each other; delete the "
                "wrong one."
            )
    frames = columns.get(FRAMES_COLUMN, np.full(len(light), 2.0))
    pixels = _pixels(file, columns, frames)
    moments = _moments(file, columns, frames, pixels)
    _refuse_deviations(file, *moments)
    order = np.argsort(light, kind="stable")
    size = jnp.asarray(float(pixels))
    bright, dark = (
        Levels(
            light=jnp.asarray(amount[order]),
            exposure=jnp.asarray(exposure[order]),
            mean=jnp.asarray(mean[order]),
            variance=jnp.asarray(variance[order]),
            frames=jnp.asarray(frames[order]),
            pixels=size,
        )
        for amount, mean, variance in (
            (light, moments[0], moments[1]),
            (np.zeros_like(light), moments[2], moments[3]),
        )
    )
    full_scale, remarks = _depth(file, bits, moments[0], moments[1])
    return PhotonTransfer(
        bright=bright,
        dark=dark,
        dark_of=jnp.arange(len(light)),
        light_step=jnp.asarray(rounding_step(light)),
        full_scale=full_scale,
        remarks=remarks,
    )


def _columns(file: Path) -> dict[str, np.ndarray]:
    try:
        lines = plain_text(file).splitlines(keepends=True)
        rows = [row for row in csv.reader(lines) if row and not row[0].startswith("#")]
    except FileNotFoundError as error:
        raise InputError(f"{file}: no such table; check the name and the folder.") from error
    except csv.Error as error:
        raise InputError(f"{file}: not a CSV table ({error}); export it again.") from error
    if any("\n" in cell for row in rows for cell in row):
        raise InputError(f"{file}: a quotation mark is not closed on its line; take it away.")
    if len(rows) < 2:
        raise InputError(f"{file}: holds no rows under its heads; give one row per level of light.")
    heads = [name.strip() for name in rows[0]]
    for mark, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(heads) == 1 and mark in heads[0]:
            raise InputError(f"{file}: its cells stand between {word}; separate them by commas.")
    if twice := [name for name in heads if name and heads.count(name) > 1]:
        raise InputError(f"{file}: has column {twice[0]} more than once; delete the wrong one.")
    numbers = np.empty((len(rows) - 1, len(heads)))
    for i, row in enumerate(rows[1:]):
        if len(row) != len(heads):
            raise InputError(
                f"{file}: row {i + 1} has {len(row)} cells under {len(heads)} heads; correct it."
            )
        for j, cell in enumerate(row):
            try:
                numbers[i, j] = float(cell)
            except ValueError as error:
                raise InputError(
                    f"{file}: {cell!r} in row {i + 1} of column {heads[j]} is not a number."
                ) from error
    with np.errstate(over="ignore"):
        finite = np.isfinite(numbers.astype(jnp.result_type(float)))
    if not finite.all():
        i, j = np.argwhere(~finite)[0]
        raise InputError(f"{file}: row {i + 1} of column {heads[j]} is not finite; correct it.")
    return dict(zip(heads, numbers.T, strict=True))


def _column(file: Path, columns: dict[str, np.ndarray], name: str) -> np.ndarray:
    if name not in columns:
        raise InputError(f"{file}: has no column {name}; add it (it has {', '.join(columns)}).")
    return columns[name]


def _pixels(file: Path, columns: dict[str, np.ndarray], frames: np.ndarray) -> int:
    """Return the number of pixels, stated or implied by sums and means."""
    if PIXELS_COLUMN in columns:
        counts = columns[PIXELS_COLUMN]
    elif "bright_sum" in columns and "mean_bright_DN" in columns:
        counts = columns["bright_sum"] / (frames * columns["mean_bright_DN"])
    else:
        raise InputError(
            f"{file}: does not give the number of pixels, on which every error depends; add a "
            f"column {PIXELS_COLUMN}."
        )
    count = round(float(np.median(counts)))
    if count < FEWEST_PIXELS or np.any(np.abs(counts / count - 1) > 1e-6):
        raise InputError(
            f"{file}: its rows state {counts.min():g} to {counts.max():g} pixels; all need the "
            f"same number, at least {FEWEST_PIXELS}."
        )
    return count


def _moments(
    file: Path, columns: dict[str, np.ndarray], frames: np.ndarray, pixels: int
) -> tuple[np.ndarray, ...]:
    """Return bright and dark means and variances of each row, from exact sums if there are any."""
    if not any(name in columns for name in COUNT_COLUMNS):
        return tuple(_column(file, columns, name) for name in MOMENT_COLUMNS)
    sums = [_column(file, columns, name) for name in COUNT_COLUMNS]
    total, within = frames * pixels, frames**2 * (frames - 1) * pixels
    return sums[0] / total, sums[1] / within, sums[2] / total, sums[3] / within


def _refuse_deviations(
    file: Path, mean: np.ndarray, variance: np.ndarray, unlit: np.ndarray, of_dark: np.ndarray
) -> None:
    """Refuse standard deviations in place of variances, which are proportional to the signal."""
    signal = mean - unlit
    seen = (signal > 0) & (variance > of_dark) & (mean <= mean[np.argmax(variance)])
    if seen.sum() < FEWEST_FOR_POWER or np.ptp(np.log(signal[seen])) < np.log(LIGHTS):
        return

    def scatter(power: int) -> float:
        rates = ((variance**power - of_dark**power) / signal)[seen]
        return float(np.std(rates) / np.mean(rates))

    if scatter(2) < min(STRAIGHT, scatter(1) / CURVED):
        raise InputError(
            f"{file}: its variances are not in proportion to the signal, but their squares are, as "
            "those of standard deviations; give variances, DN²."
        )


def _depth(
    file: Path, bits: int | None, mean: np.ndarray, variance: np.ndarray
) -> tuple[float | None, tuple[str, ...]]:
    """Return full scale, DN, from `bits` or from saturated levels, and remarks."""
    brightest = float(mean.max())
    if bits is not None:
        if brightest > 2**bits - 1:
            raise InputError(
                f"{file}: means reach {brightest:g} DN, more than {bits} bits hold; correct the "
                "number of bits."
            )
        return float(2**bits - 1), ()
    clipped = np.isclose(mean, brightest) & (variance == 0)
    implied = np.log2(brightest + 1)
    if clipped.any() and float(implied).is_integer():
        return brightest, (
            f"A bit depth of {implied:.0f} was inferred from {clipped.sum()} levels at which every "
            f"pixel reads {brightest:.0f} DN.",
        )
    return None, ("The table does not show the bit depth, so clipping by the ADC is not detected.",)
