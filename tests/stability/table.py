"""The table of floating-point errors of every public function, as a page for `docs/`.

    python tests/stability/table.py [--out docs/errors.md] [--only WORD] [--kept DIR]

Each function of `registry/` that has an oracle is measured in float32 and float64: at its hard
cases, and at points drawn from its domain (1e6 in float32, 300 where the oracle needs mpmath; a
fifth of that in float64). The worst points are measured again with 60 digits. Compositions in
float32 are compared with themselves in float64. A run takes about ten minutes on one core.
`--compositions` adds the compositions that take seconds to compile. `--kept` stores the
measurements, so that an interrupted run continues, and a checksum of all results, which must not
depend on the number of threads.
"""

import argparse
import json
import os
import sys
import time
import zlib
from dataclasses import fields
from functools import partial
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")
sys.path.append(str(Path(__file__).parents[1]))

import registry
from every_float32 import recorded
from measure import MANY, SLOW, Row, measured
from public_names import LONG
from registry.composed import COMPOSED
from registry.elsewhere import ELSEWHERE, covered_names
from registry.entry import Entry
from searched import recorded as searched
from widened import calls, widened

HEAD = """# Floating-point errors, function by function

This page gives the rounding error of every public function. The unit is the ULP (unit in the last
place), the distance between neighbouring floating-point numbers at the true value. An ULP is at
most 2^-23 (float32) or 2^-52 (float64) of the value. `python tests/stability/table.py` writes the
page.

- **How it was measured.** Each function is compared with an oracle, which is written from the
  definition and shares no code with the library (`tests/stability/registry/`). The oracle computes
  with 64 binary digits or 60 decimal digits, from the same rounded arguments as the function. The
  points are hard cases and {many:,} random points of the domain in float32, and a fifth as many in
  float64. If the oracle needs mpmath, there are only {slow} and {few} points.
- **worst, mean**: the largest and the mean error in ULP, in float32 and float64. The mean error is
  measured against the oracle with 64 binary digits (60 decimal digits if the oracle needs mpmath).
  The largest error is measured against 60 decimal digits, at the hard cases and at the three worst
  points. There is no mean in float64 where 64 binary digits are too few to measure it.
- **‡**: a larger error than at those points, found by a search: 32 hill climbs in steps of ULP,
  from the worst of 200,000 points (`python tests/stability/searched.py`).
- **†**: the errors are divided by the condition number 1 + Σ |x ∂f/∂x| / |f|. In these rows the
  result is a difference or an exponential of rounded numbers, so the rounding of the arguments
  limits the accuracy of any formula.
- **slope**: the largest relative error of a derivative over the hard cases, float32 / float64. The
  error is relative to the largest slope with respect to the same argument, or to a hundredth of f /
  x if a note says so.
- **jit, one**: the largest differences in ULP, in float32. "jit" is between compiled and eager code
  at 32 points, and "one" is between `vmap` and a loop at 3 points.
- **bound**: the tests fail if an error exceeds this bound. {outside} Number of infinite or NaN
  results where the true one is finite: {non_finite} of {points:,} points; slopes: {endless}.
- **points**: the domain of each argument in turn, as a range. Points are drawn uniformly in the
  logarithm, or uniformly if the range begins at 0. ± means either sign, and "3 of" means three
  components of a vector. Outside the domain only hard cases were measured.
- **Not covered**: results below the smallest normal number, which may be 0. Random draws and
  iterative solvers are in the last tables.

JAX publishes the errors of its elementary functions on its page [Numerical
accuracy](https://docs.jax.dev/en/latest/accuracy.html). Some of them are much less accurate in one
region, such as `log1p` in float64 near -0.4 (128 ULP). In this region the library uses another
formula.

## Functions with an oracle

| function | float32 worst | mean | float64 worst | mean | slope | jit | one | bound | points |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""
SECOND = """
## Compositions

These functions are compositions of others. The float32 result of each function is compared with its
float64 result, on the examples of `tests/examples/`; other tests check the formulas. The column "of
the largest" gives errors in ULP of the largest number of the result, the column "of each" in ULP of
each number. The latter is meaningless for numbers that cancel to nearly 0, as in kernels and
Fourier transforms.

One example does not cover other sizes. `pytest -m slow tests/stability/test_scaled.py` therefore
scales the arguments by powers of ten between -3 and 2, eight times each. The test allows an error
of 32 times the error expected from the rounding of the arguments and of the result. The test file
lists ten exceptions, each with its reason.

| function | of the largest | of each | bound |
| --- | --- | --- | --- |
"""
THIRD = """
## Other functions

These functions compute no floating-point numbers, draw random numbers, or iterate to a stated
tolerance. The table gives the number of functions of each type, and the tests that
check them.

| functions | kind | tests |
| --- | --- | --- |
"""
EVERY = """
## Every float32

Functions of one variable were measured at every float32 number of their domain, by
`python tests/stability/every_float32.py --record`. The command takes ten minutes of one core. With
`--kept FOLDER` it can be interrupted and continued. The test suite repeats the measurement for
about one number in several thousand.

| function | numbers | worst, ULP | at | mean, ULP |
| --- | --- | --- | --- | --- |
"""
LAST = """
## Errors above four units

Errors above 4 ULP remain where a formula multiplies rounding errors by a small whole number. If
such errors matter, compute in float64 and convert the result to float32, which leaves an error of
half an ULP (`JAX_ENABLE_X64=1`, records by `as_dtype`). The computation then takes 2.5 times as
long for the dielectric, 2.1 times for the conductor and 1.5 times for GGX (a million points, two
cores, `tests/benchmarks/bench_precision.py`). Compensated float32 arithmetic, as in
`spectra.blackbody`, took 3 and 5 times as long and left errors of 6.5 and 2.3 units.

- `fresnel_dielectric`, `fresnel_conductor`: squares of quotients of squares. A relative error of
  the refracted cosine appears fourfold in the result, an error of the index contrast twofold. For
  an index below 1 the slope is infinite at the critical angle, and the rows are divided by the
  condition number. At a cosine of 0.98724 and an index of 0.16265, the reflectances of the two
  polarisations change 117 times as fast as the angle, in opposite directions, and their mean hardly
  changes. At that point a search found an error of 104 ULP, 6e-6 of the reflectance.
- `normal_distribution` of GGX: the square of a sum of squares of quotients.
- `parallel_rectangles` in float32: three terms of similar size. Two of them are differences of
  angles, which use a series where they are small.
- `angle_between`, `angle_over_sine`, `hidden_cosine` and `visibility`: arcs or roots of quotients
  of sums of squares, with five roundings.
- `perpendicular_rectangles`: as `parallel_rectangles`.
- `log_curve`: two logarithms of 1 + x, for which XLA's error is 2.5 units near x = 0.4.
- `depth_of_field`: seven roundings.
- `scaled_to_key`: the exponential of a mean of logarithms.
- `log_ndtr`, `Censored` and `StudentT` in float64: JAX's series, whose relative error is 1e-10
  where one series replaces another.

## Damaged files

`pytest -m slow tests/fuzz` changes, cuts and doubles bytes, lines and numbers of valid files. Each
damaged file must be read, or be rejected with a message of one sentence, within 10 s of CPU time
and 12 GiB. So far 1,691,980 files of 28 types were tested: cameras, scenes (also Mitsuba's and
glTF's), materials, rigs, tables, measured BRDFs, meshes, images, FITS, DNG and NPY files, and
unfinished renders and chains.

| run | files | read | wrong |
| --- | --- | --- | --- |
| longest | 980,000 | 178,970 | 47, with six causes, all fixed |
| next | 160,720 | | 1, fixed |
| last | 392,000 | 72,806 | 0 |
| after the last changes | 7,600 | | 0 |

Commands are also run on damaged folders of flats and darks, of an exposure stack, of a ball and of
photographs. Either the rig is damaged, or an image: it is a copy of another image, constant, dim,
full of outliers or of another size. The last run tried 2,090 damaged inputs on ten commands: 441
were processed, 1,649 were refused with a message, and no result was wrong.
`pytest -m slow tests/fuzz/test_fuzz_arguments.py` calls public functions with odd arguments. In its
last run, which did not include `transport`, eight calls failed with an error of JAX instead of one
of the function. These functions now check their arguments.

## Interrupted commands

`python tests/killed.py` interrupts a render, a chain and a report at random moments, and runs them
again.

- **SIGKILL** at 290 moments: no file was damaged. When run again, each command continued or started
  anew, and its results had the same bytes as without interruption.
- **Ctrl-C** at 324 moments before all files were written, on a busy machine: each command ended
  within 2 s with status 130 and one line. No file was damaged, and continued runs gave the same
  bytes. Of 36 commands interrupted after all files were written, at least 10 ended with status 0.
- **Files removed** at 84 moments of five commands (images, image folders, the folder of the results
  or the working folder): each command ended with its results, or with an error message of one
  sentence.

## Large data

`pytest -m slow tests/package/test_large.py` tests large inputs:

- Histograms, integral images, means, blurs, mosaics and a raw frame of 100 megapixels have the
  rounding errors of small inputs. Counts are exact, and sums in float32 are within 16 ULP.
- Least squares on 1e7 observations agree with the reference within .02 of a standard error.
- The form factors from one patch to the 1e6 patches of a closed room sum to 1 within 1e-4.
- The memory of chains of 1e6 steps is within 2 % of the predicted memory.
"""


def number(x):
    return "–" if x != x else "0" if x == 0 else f"{x:.2g}" if x < 100 else f"{x:.0f}"


def line(title, rows):
    by = {row.dtype: row for row in rows}
    one = rows[0]
    narrow, wide = by.get("float32"), by.get("float64")
    cells = [title + (" †" if one.entry.conditioned else "")]
    found = searched().get(title, {"worst": 0.0})
    for row in (narrow, wide):
        # otherwise the error is that of the oracle's own digits
        known = row is not None and row.mean <= row.worst * (1 + 1e-9)
        cells += ["–" if row is None else number(row.worst), number(row.mean) if known else "–"]
    if narrow is not None and found["worst"] > narrow.worst:
        cells[1] = f"{number(found['worst'])} ‡"
    slopes = [f"{row.gradient:.0e}" if row.gradient == row.gradient else "–" for row in rows]
    cells.append(" / ".join(slopes) if one.entry.gradient is not None else "–")
    cells += [number(one.compiled), number(one.one_by_one), number(one.entry.bound)]
    points = "; ".join(str(argument) for argument in one.entry.domain)
    points = points.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
    return "| " + " | ".join([*cells, " · ".join(filter(None, (points, one.entry.note)))]) + " |"


class Kept:
    """Results by name, stored in a folder or for this run alone.

    Attributes:
        folder: where each result is a file; None to store nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def of(self, name: str, measure):
        """Return the result stored under a name, otherwise that of `measure()`, as lists of
        numbers."""
        file = None if self.folder is None else self.folder / f"{zlib.crc32(name.encode())}.json"
        if file is not None and file.exists():
            return json.loads(file.read_text())
        found = measure()
        print(f"{time.process_time():6.1f} s  {name}", file=sys.stderr, flush=True)
        if file is not None:
            part = file.with_suffix(".part")
            part.write_text(json.dumps(found))
            part.replace(file)
        return found


def numbers_of(entry: Entry, dtype: str) -> list[dict]:
    """Return the rows of a function in one precision, without the function."""
    rows = measured(entry, dtype, eager=dtype == entry.precisions[0])
    names = [field.name for field in fields(Row) if field.name != "entry"]
    return [{name: getattr(row, name) for name in names} for row in rows]


def all_rows(only: str, kept: Kept) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for entry in registry.every_entry():
        for dtype in entry.precisions if only in entry.title else ():
            numbers = kept.of(f"{entry.title} {dtype}", partial(numbers_of, entry, dtype))
            for row in (Row(entry=entry, **known) for known in numbers):
                found.setdefault(f"`{entry.title}` {row.part}".strip(), []).append(row)
    return found


def page(rows, composed):
    every = [row for several in rows.values() for row in several]
    wrong = [row for row in every if not row.holds]
    outside = f"Rows that exceed it: {len(wrong)}." if wrong else "No row exceeds it."
    text = HEAD.format(
        many=MANY,
        slow=SLOW,
        few=SLOW // 5,
        outside=outside,
        non_finite=sum(row.non_finite for row in every),
        points=sum(row.points for row in every),
        endless=sum(row.endless_slopes for row in every),
    )
    text += "\n".join(line(title, several) for title, several in rows.items()) + "\n"
    text += SECOND
    text += "".join(
        f"| `{name}` | {number(largest)} | {number(each)} | {number(COMPOSED[name])} |\n"
        for name, (largest, each, _) in composed.items()
    )
    text += THIRD
    for group in ELSEWHERE:
        count, tests = len(covered_names(group)), ", ".join(f"`{t}`" for t in group.tests.split())
        text += f"| {count} of {group.rooms} | {group.kind} | {tests} |\n"
    text += EVERY
    text += "".join(
        f"| `{title}` | {found['numbers']:,} | {found['worst']:.2f} | {found['at']:.9g} | "
        f"{found['mean']:.3f} |\n"
        for title, found in recorded().items()
    )
    return text + LAST


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--compositions", action="store_true")
    parser.add_argument("--kept", type=Path)
    asked = parser.parse_args(arguments)
    kept = Kept(asked.kept)
    rows = all_rows(asked.only, kept)
    composed = {}
    for name, call in calls().items():
        wanted = name in COMPOSED and asked.only in name
        if wanted and (asked.compositions or name not in LONG):
            composed[name] = kept.of(f"composed {name}", partial(widened, name, call))
    text = page(rows, composed)
    if asked.out:
        asked.out.write_text(text)
    else:
        print(text)
    wrong = [row for several in rows.values() for row in several if not row.holds]
    for row in wrong:
        print(f"outside its bound: {row.entry.title} {row.part} {row.dtype}", file=sys.stderr)
    for name, (largest, _, kept) in composed.items():
        if largest > COMPOSED[name] or not kept:
            print(f"outside its bound: {name} {largest:.3g} ULP, float32: {kept}", file=sys.stderr)


if __name__ == "__main__":
    main()
