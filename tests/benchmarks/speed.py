"""Compare the speed of jaxvision with other programs, and write `docs/speed.md`.

    python tests/benchmarks/speed.py [--only WORD] [--kept FILE] [--beside FILE --named TEXT]
        [--out docs/speed.md]

Each row runs one benchmark in its own process. `--beside` adds a column from the `--kept` file of
another Python version, which `--named` describes. A run that was killed continues with the rows
that `--kept` lacks; delete the file to measure again. The whole run takes about a quarter of an
hour on two cores. Install the other programs with `pip install '.[bench]'`. Mitsuba needs an LLVM
library in `DRJIT_LIBLLVM_PATH`, for example LLVM 19 (15 cannot compile its programs). A row without
its other program says so."""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from turns import KEPT

from jaxvision.accuracy.scene_settings import machine

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PEERS = ("mitsuba", "opencv-python-headless", "numpy", "pymatting")


@dataclass(frozen=True)
class Row:
    """One comparison.

    Attributes:
        about: the task.
        test: its benchmark.
        ours, peer: names of the two programs in that benchmark; None if no other program does this.
        title: distinguishes several comparisons in one benchmark.
    """

    about: str
    test: str
    ours: str
    peer: str | None
    title: str = ""


def _rows() -> list[Row]:
    first, path = "bench_first_picture.py::test_first_picture", "bench_path_tracing.py"
    box = "Cornell box, 256 x 256, 64 paths a pixel"
    rows = [
        Row(f"{box}: new process, nothing kept", first, "ours, first", "Mitsuba, first"),
        Row(f"{box}: new process, second time", first, "ours, again", "Mitsuba, again"),
    ]
    test = "bench_first_picture.py::test_import_and_a_small_call"
    rows.append(Row("`import jaxvision`", test, "import", None))
    rows.append(Row("import and `lambert_shading` of one point", test, "first call", None))
    fit, about = (
        "bench_first_fit.py::test_first_fit",
        "fit of one's own model, 7 parameters, 16 starts",
    )
    rows.append(
        Row(f"{about}: new process; SciPy: 1 start", fit, "ours, first", "SciPy, one start")
    )
    rows.append(Row(f"{about}: six in a new process", fit, "ours, six", None))
    for package, command in (("jaxvision", "jaxvision"), ("fitting", "jaxvision-fit")):
        test = f"bench_first_picture.py::test_help_and_a_wrong_path[{package}]"
        rows.append(Row(f"`{command} --help`", test, "help", None))
        rows.append(Row(f"`{command}`, a wrong path", test, "a wrong path", None))
    test = "bench_reflectance.py::test_the_command_on_photographs"
    about = "`jaxvision-fit brdf`, all models, photographs under 10 lights, 3 channels"
    rows.append(Row(f"{about}: nothing kept", test, "first", None))
    rows.append(Row(f"{about}: second time", test, "again", None))
    for rival in ("lights", "balance"):
        test, about = f"{path}::test_cornell_box", f"{box}: warm, equal error, {rival}"
        rows.append(Row(about, test, f"ours, {rival}", "Mitsuba path"))
    direct = "bench_direct_light.py::test_the_{}_beside_mitsuba"
    for shadows in (True, False):
        test = direct.format("sum_over_three_points") + f"[{shadows}]"
        about = f"direct light, 512 x 512, {'with' if shadows else 'without'} shadows"
        rows.append(Row(about, test, "jaxvision", "Mitsuba"))
    test = direct.format("gradient_in_the_reflectance")
    rows.append(Row("its gradient in the reflectances", test, "jaxvision", "Mitsuba"))
    for subdivisions in (3, 5, 6):
        test = f"bench_mesh.py::test_mesh_rays_beside_mitsuba[{subdivisions}]"
        about = f"rays on a mesh of {20 * 4**subdivisions:,} triangles"
        rows.append(Row(about, test, "jaxvision", "Mitsuba"))
    for number, side in enumerate((512, 2048)):
        for size in (7, 15):
            test = f"bench_filters.py::test_separable[shape{number}-{size}]"
            title = f"separable {(side, side)} k {size}"
            about = f"separable filter, {side} x {side} x 3, {size} taps"
            rows.append(Row(about, test, "jaxvision", "opencv", title))
    for size in (7, 15):
        test = f"bench_filters.py::test_non_separable[{size}]"
        about = f"filter of {size} x {size} taps, 512 x 512 x 3"
        rows.append(Row(about, test, "jaxvision", "opencv", f"non-separable 512 k {size}"))
    for side in (512, 2048):
        test = f"bench_histogram.py::test_against_opencv_and_scikit_image[{side}]"
        for title in ("histogram", "equalise", "CLAHE 8 x 8"):
            rows.append(Row(f"{title}, {side} x {side}, 8 bits", test, "ours", "peer", title))
    chain = "bench_point_ops.py::test_chain_of_exposure_matrix_gain_gamma"
    for number, side in enumerate((512, 2048)):
        about, title = f"five point operators, {side} x {side} x 3", f"chain {side}x{side}"
        test = f"{chain}[size{number}]"
        rows.append(Row(f"{about}, exact", test, "ours, power", "opencv", title))
        rows.append(Row(f"{about}, fast power", test, "ours, exp2", "opencv", title))
        test = f"bench_point_ops.py::test_single_operators[size{number}]"
        for name, peer in (("gain, bias", "opencv"), ("blend", "opencv"), ("over", "numpy")):
            about, title = f"{name}, {side} x {side}", f"{name} {side}x{side}"
            rows.append(Row(about, test, "ours", peer, title))
    for number, size in ((1, "2048 x 2048"), (2, "12 MP")):
        test = f"bench_develop.py::test_demosaicing[size{number}]"
        peer = "opencv, bilinear, 16 bit"
        rows.append(Row(f"bilinear demosaicing, {size}", test, "ours, bilinear", peer))
    response = "bench_response.py::test_beside_others"
    rows.append(
        Row("response curve of all pixels; peer: Debevec of 300", response, "ours", "debevec")
    )
    matting = "bench_matting.py::test_closed_form[512]"
    rows.append(Row("closed-form matting, 512 x 512", matting, "float32", "pymatting"))
    return rows


def measured(kept: Path) -> list[dict]:
    """Return the stored measurements in the order of time."""
    return list(map(json.loads, kept.read_text().splitlines())) if kept.is_file() else []


def found_for(row: Row, records: list[dict]) -> dict | None:
    """Return the last measurement of both programs of a row."""
    rivals = {row.ours, row.peer} - {None}
    for found in reversed(records):
        same = (found["test"], found["title"]) == (row.test, row.title)
        if same and rivals <= found["seconds"].keys():
            return found
    return None


def times_as_fast(row: Row, found: dict) -> np.ndarray:
    """Return the ratio of times of each round, at equal error if errors are known."""
    ours, peer = (np.asarray(found["seconds"][name]) for name in (row.ours, row.peer))
    errors = found["errors"] or dict.fromkeys((row.ours, row.peer), 1.0)
    return peer / ours * (errors[row.peer] / errors[row.ours]) ** 2


def cells(row: Row, found: dict | None) -> tuple[str, ...]:
    """Return the times of a row and the ratio to the other program."""
    if found is None:
        return "not run", "", ""
    ours = _duration(found["seconds"][row.ours])
    if row.peer is None:
        return ours, "", ""
    low, middle, high = np.quantile(times_as_fast(row, found), (0.25, 0.5, 0.75))
    times = f"{middle:.2g} ({low:.2g} to {high:.2g})"
    return ours, _duration(found["seconds"][row.peer]), times


def beside(row: Row, found: dict | None) -> str:
    """Return the ratio of a row under another Python version, or the time if no other program is
    compared."""
    own, _, times = cells(row, found)
    return times or own


def _duration(seconds: list[float]) -> str:
    middle = float(np.median(seconds))
    return f"{middle:.2g} s" if middle >= 1 else f"{1e3 * middle:.3g} ms"


def page(rows: list[Row], found: list[dict], other: list[dict], named: str) -> str:
    head = ("what", "jaxvision", "peer", "times as fast (interquartile range)")
    table = [(row.about, *cells(row, found_for(row, found))) for row in rows]
    if other:
        head += (f"times as fast, or time: {named}",)
        last = [beside(row, found_for(row, other)) for row in rows]
        table = [(*cell, x) for cell, x in zip(table, last, strict=True)]
    table = [head, ("---",) * len(head), *table]
    lines = "\n".join(f"| {' | '.join(row)} |" for row in table)
    installed = ", ".join(f"{name} {_version(name)}" for name in PEERS)
    return f"""# Speed compared with other programs

This table compares the speed of jaxvision with programs that do the same job. The peer
is Mitsuba 3 (`llvm_ad_rgb`) for rendering, OpenCV or NumPy for pictures, pymatting for
mattes, and SciPy for fits.

- **How it was measured.** Calls of jaxvision and of the peer alternate in one process,
  and times are medians. Compilation is not included, except in the rows about new
  processes, for which Python sources are compiled to bytecode in advance, as pip does. All
  programs compute in float32, and the benchmarks also compare the results.
  Both programs keep freed memory for reuse (`jaxvision.keep_memory`).
- **How to read it.** "Times as fast" above 1 means that jaxvision is faster. Read the
  ratios, not the milliseconds, which depend on the machine. Rows with "equal error"
  compare time multiplied by squared error. Rows without a peer give the time alone.
- **Not covered**: GPUs, because most of the other programs run on processors only
  ([decisions](decisions.md) has some times); and the first compilation of single
  functions, because it happens once for each shape of the arguments, and its program is
  kept for later runs.

{lines}

## What bounds the rows below 1

- **First picture.** Of the 2.8 s of the second process, importing JAX takes .45 s, importing
  jaxvision and its other libraries .4 s, reading the scene .25 s, loading the compiled program
  .4 s, and rendering .7 s. Mitsuba's whole process takes 1.4 s. The first process also compiles
  for 3 to 4 s.
- **First fit.** SciPy searches from one start, jaxvision from 16. jaxvision also imports JAX
  and compiles.
- **Meshes.** Embree traces the rays, but its Python binding passes them one by one, which took
  5.7 of 12 ms in a profile.
- **Histograms.** XLA adds the counts one after the other: .29 ms for 512 x 512 codes, on one core.
  `numpy.bincount` takes .30 ms, and OpenCV .10 ms.
- **Separable filters.** XLA stores the picture between the two passes, and a picture of
  2048 x 2048 x 3 does not fit into the cache. OpenCV does both passes row by row.
- **Response.** All pixels are used, which gives a tenth of the error of Debevec's 300 pixels.

{machine()}; {installed}. Made by `python tests/benchmarks/speed.py`.
"""


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default="", help="rows whose benchmark holds this word")
    parser.add_argument("--kept", type=Path, default=ROOT / ".pytest_cache" / "speed.jsonl")
    parser.add_argument("--beside", type=Path, default=Path(), help="rows of another Python")
    parser.add_argument("--named", default="another Python", help="what --beside was measured with")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "speed.md")
    given = parser.parse_args()
    rows = _rows()
    kept = given.kept.resolve()
    kept.parent.mkdir(parents=True, exist_ok=True)
    missing = [row.test for row in rows if found_for(row, measured(kept)) is None]
    for test in dict.fromkeys(missing):
        if given.only in test:
            print(test, flush=True)
            command = [sys.executable, "-m", "pytest", "-m", "benchmark", "--benchmark-enable"]
            environment = os.environ | {KEPT: str(kept)}
            subprocess.run([*command, "-q", "--no-header", str(HERE / test)], env=environment)
    given.out.write_text(page(rows, measured(kept), measured(given.beside), given.named))


if __name__ == "__main__":
    main()
