"""The table of floating-point errors of every public function, as a page for `docs/`.

    python tests/stability/table.py [--out docs/errors.md] [--only WORD] [--kept DIR]

Each function of `registry/` that has an oracle is measured in float32 and float64: over its hard
cases, and over points drawn from its domain (1e6 in float32, 300 where the oracle needs mpmath; a
fifth of that in float64); 60 digits look at the worst again. Compositions are measured in float32
against themselves in float64. About ten minutes of one core; `--compositions` adds those that take
seconds to compile. `--kept` holds what has been measured, so that a killed run goes on, with a
checksum of all results, which must not depend on the number of threads.
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
from widened import calls, widened

HEAD = """# Floating-point errors, function by function

Written by `python tests/stability/table.py`. The error of a result is in units of the last place
(ULP): the distance of neighbouring numbers of its precision at the true value, 2^-23 and 2^-52 of
it at most. Each oracle is written from the definition, apart from the library
(`tests/stability/registry/`), in 64 binary digits or 60 decimal ones, for the very numbers that the
function is given. Points: hard cases, and {many:,} drawn from the domain in float32, a fifth of
that in float64 ({slow} and {few} where the oracle needs mpmath). A result below the smallest normal
number may be 0.

- *worst*, *mean*: ULP, in float32 and float64. Rows marked † are over 1 + Σ |x ∂f/∂x| / |f|: there
  the result is a difference, or an exponential, of rounded numbers, and no formula does better.
- *slope*: the largest relative error of a derivative over the hard cases, float32 and float64
  (relative to the largest slope by the same argument; where the note says so, or to a hundredth of
  f / x).
- *jit*, *one*: the largest ULP, in float32, between compiled and eager at 32 points, hard cases
  first, and between `vmap` and a loop at 3.
- *bound*: what the tests hold the row to; {outside} Infinite and NaN results where the true
  one is finite: {non_finite} of {points:,} points; slopes: {endless}.
- *points*: what each argument is drawn from, one after the other: between two ends, uniform in the
  logarithm but for those from 0; ± of either sign; "3 of" for the components of a vector. Of
  arguments outside of these a row knows only its hard cases.
- Functions of one variable are measured at every float32 of their domain, too: see below.
- Which oracle: *mean* is against the oracle in 64 binary digits (60 decimal ones where it needs
  mpmath), *worst* against the oracle in 60 decimal digits, at the hard cases and at the three worst
  points. Where an oracle itself takes a difference, 64 binary digits are too few for the mean in
  float64, which is then left out.

## Beside an oracle

| function | float32 worst | mean | float64 worst | mean | slope | jit | one | bound | points |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""
SECOND = """
## Compositions

Float32 against the same function in float64 on the example of `tests/examples/`, whose formula
other tests check: ULP of the largest number of the result, and of each number itself, which is
meaningless for numbers that a sum leaves near 0, as in kernels and Fourier transforms.

One example says little of other sizes. `pytest -m slow tests/stability/test_scaled.py` scales the
arguments of these functions by powers of ten between -3 and 2, eight times each. A result in
float32 may be off by 32 times what the last digits of its arguments and its own rounding explain;
the ten functions that it leaves out stand there, each with its reason.

| function | of the largest | of each | bound |
| --- | --- | --- | --- |
"""
THIRD = """
## Elsewhere

Functions without a floating-point result of their own, draws, and solvers that stop at a stated
tolerance: what they are, how many, and the tests that check them.

| functions | | tests |
| --- | --- | --- |
"""


EVERY = """
## Every float32

Functions of one variable at each float32 of their domain, without exception, by `python
tests/stability/every_float32.py --record` (ten minutes of one core; killed, it goes on where it
was with `--kept FOLDER`). The suite takes one in some thousands again.

| function | numbers | worst, ULP | at | mean, ULP |
| --- | --- | --- | --- | --- |
"""
LAST = """
## Above four units

What is left is rounding that the formula magnifies by a small whole number. Where it counts,
float64 inside and float32 outside leave half a unit (`JAX_ENABLE_X64=1`, records by `as_dtype`):
the dielectric takes 2.5 times its time, the conductor 2.1, GGX 1.5 (a million points, two cores, by
`tests/benchmarks/bench_precision.py`). Rounding put back into float32, as `spectra.blackbody` does,
took three times and five, and left 6.5 and 2.3 units.

- `fresnel_dielectric`, `fresnel_conductor`: squares of quotients of squares. A relative error of
  the cosine within counts four times, that of the contrast of the indices twice. Below an index
  of 1 the result changes without bound at the critical angle: the rows are over that.
- `normal_distribution` of GGX: the square of a sum of squares of quotients.
- `parallel_rectangles` in float32: three terms of one size. Two of them are differences of angles,
  by a series where these are small.
- `angle_between`, `angle_over_sine`, `hidden_cosine` and `visibility`: arcs, or roots, of quotients
  of sums of squares: five roundings.
- `perpendicular_rectangles`: as `parallel_rectangles`.
- `log_curve`: XLA's logarithm of 1 + x is 2.5 units off about x = 0.4, and there are two.
- `depth_of_field`: seven roundings.
- `scaled_to_key`: the exponential of a mean of logarithms.
- `log_ndtr`, `Censored` and `StudentT` in float64: JAX's own series, 1e-10 of the result where one
  takes over from another.

## Damaged files

`pytest -m slow tests/fuzz` changes, cuts and doubles bytes, lines and numbers of sound files; each
must be read, or refused in one sentence, in 10 s of CPU and 12 GiB. 1,691,980 files were given so
far. The longest run, of 980,000 files of 28 kinds (cameras, scenes, Mitsuba's and glTF's,
materials, rigs, tables, MERL, RGL, Cornell, OBJ, PLY, STL, PNG, TIFF, JPEG, EXR, HDR, FITS, DNG,
NPY, and what renders, chains and cameras leave unfinished): 178,970 were read, and 47 outcomes were
wrong, of six causes, which are mended: camera files whose lists are tables (a traceback), names of
PNG chunks, columns and scenes with a line break in the sentence, and a sky whose density was not
finite in float32. The next 160,720 found one more, a NumPy header whose keys are bytes. The closing
run: 392,000 files, 72,806 of them read, none wrong; nor were 7,600 after the last changes.

Commands are given files and whole folders (flats and darks, a stack, a ball, photographs) after
damage to the rig or to an image, which may be another one's copy, constant, dim, full of outliers
or of another size. Of the last 2,090, of ten commands, 441 were done and 1,649 refused; none was
wrong. Before these, four were: a level that scatters by 1e11 DN (memory), a maker's name that is no
text, a negative error of a table, and a chain of minutes that could not become long enough. `pytest
-m slow tests/fuzz/test_fuzz_arguments.py` gives public functions odd arguments. The last dozen for
each, but for those of `transport`, found eight sentences that were JAX's own (axes of size 0,
pictures of two sizes, a table that is not square); they are the functions' now.

## Commands that are ended

`python tests/killed.py` ends a render, a chain and a report at random moments and runs them again.
By SIGKILL at 290 moments: no file was torn, and each run went on, or began again, to the same
bytes. By Ctrl-C at 324 moments before all was written, on a busy machine: each ended within 2 s
with status 130 and one line, nothing was torn, and runs went on to the same bytes. Of 36 more,
which came after all was written, at least 10 finished with status 0.

Images, whole folders of them, the folder of the results and the working folder were removed at 84
random moments of five commands: each run ended with its results, or in one sentence. Images that
were removed once a calibration had read them cost the results at first, for the sake of the small
pictures of a report; now the report says that they are gone.

## Large data

`pytest -m slow tests/package/test_large.py`: histograms, integral images, means, blurs, mosaics and
a raw frame of 100 megapixels, rounded as their parts are (counts to the last one; sums in float32
within 16 units); least squares on 1e7 observations within .02 of a standard error; rows of form
factors to 1e6 patches of a closed room, which sum to 1 within 1e-4; the memory of chains of 1e6
steps within 2 %.
"""


def number(x):
    return "–" if x != x else "0" if x == 0 else f"{x:.2g}" if x < 100 else f"{x:.0f}"


def line(title, rows):
    by = {row.dtype: row for row in rows}
    one = rows[0]
    narrow, wide = by.get("float32"), by.get("float64")
    cells = [title + (" †" if one.entry.conditioned else "")]
    for row in (narrow, wide):
        # else the oracle's own digits show
        known = row is not None and row.mean <= row.worst * (1 + 1e-9)
        cells += ["–" if row is None else number(row.worst), number(row.mean) if known else "–"]
    slopes = [f"{row.gradient:.0e}" if row.gradient == row.gradient else "–" for row in rows]
    cells.append(" / ".join(slopes) if one.entry.gradient is not None else "–")
    cells += [number(one.compiled), number(one.one_by_one), number(one.entry.bound)]
    points = "; ".join(str(argument) for argument in one.entry.domain)
    points = points.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
    return "| " + " | ".join([*cells, " · ".join(filter(None, (points, one.entry.note)))]) + " |"


class Kept:
    """Results by name, in a folder or for this run alone.

    Attributes:
        folder: of one file a name; None to keep nothing.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def of(self, name: str, measure):
        """What was kept under a name, else what `measure()` gives, lists of plain numbers."""
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
    """The rows of a function in one precision, without the function."""
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
    outside = f"rows that lie outside: {len(wrong)}." if wrong else "no row lies outside."
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
