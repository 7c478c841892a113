"""Measure the error against the time of every knob, and write the pages of the atlas for `docs/`.

    python tests/benchmarks/atlas.py [--minutes 60] [--kept DIR] [--out docs/atlas] [--only WORD]

The problems are shipped scenes, the examples of `jaxvision.accuracy` and `fitting.accuracy`, and
the rigs of a simulated afternoon. Points of other programs that do the same job are added. Programs
that are not installed (OpenCV, Mitsuba) are left out; Mitsuba needs `DRJIT_LIBLLVM_PATH`.

All knobs share the time, compilation included; scenes and fits have larger shares. Time that a knob
does not use is not given to others, so the run takes less than `--minutes`. Curves and compiled
programs are stored in `--kept`, so a run that was killed continues there."""

import argparse
import io
import os
import pickle
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")

import jax
import matplotlib
import numpy as np
from atlas_defaults import defaults
from atlas_peers import PEERS, Peer, sine_problem, stack_problem
from matplotlib.figure import Figure

from fitting.accuracy import KNOBS as FIT_KNOBS
from fitting.accuracy import measured as fit_measured
from fitting.accuracy import problems
from fitting.accuracy.examples import EXAMPLES as FIT_EXAMPLES
from fitting.accuracy.examples import example as fit_example
from fitting.demo.lab import simulate_lab
from fitting.rig import load_rig
from jaxvision.accuracy import KNOBS, Curve, Problem, curve, knobs_of, measured, plot
from jaxvision.accuracy.examples import cameras, example, examples, light, pictures
from jaxvision.accuracy.scene_settings import machine
from jaxvision.accuracy.tables import rows
from jaxvision.errors import InputError
from jaxvision.files.scenes import read_scene
from jaxvision.files.scenes.schema import override_settings
from jaxvision.render_command import change_resolution

STYLE = (
    "<style>svg{color:#1b1f24;background:#fff}@media (prefers-color-scheme:dark)"
    "{svg{color:#e6edf3;background:#0d1117}}</style>"
)
INK = "#010203"
SCENES = (  # name, pixels a side, `[render]`, knobs or all
    ("cornell_box", 128, {"integrator": "path"}, ()),
    ("cornell_box", 256, {"integrator": "direct"}, ()),
    ("cornell_box", 256, {"integrator": "direct", "rule": "monte_carlo"}, ("light samples",)),
    ("cornell_box", 128, {"integrator": "radiosity"}, ()),
    ("cornell_box", 128, {"integrator": "radiosity", "gather": 16}, ("gather",)),
    ("glass_and_mirror", 128, {"integrator": "rays"}, ()),
)
SHARES = {"Pictures": 1, "Cameras": 1, "Light": 1, "Fits": 1.5, "Scenes": 6}  # of the time


@dataclass(frozen=True)
class Sheet:
    """One measured knob.

    Attributes:
        page: title of the page.
        problem: its name.
        curve: error against time.
        peers: points of other programs.
        seconds: s, the time that the knob was given.
        load: the machine's load average, including this process."""

    page: str
    problem: str
    curve: Curve
    peers: tuple[Peer, ...]
    seconds: float = 12.0
    load: float = np.nan

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the cells of the knob's row in the table."""
        return rows(Problem(self.problem, lambda settings: lambda seed: None), [self.curve])[1]


Job = Callable[[float], tuple[Problem, Curve]]


def jobs(kept: Path) -> dict[str, tuple[str, Job]]:
    """Return the page and the measurement of every knob, by a name that is valid for files."""
    found: dict[str, tuple[str, Job]] = {}
    for page, room in (("Pictures", pictures), ("Cameras", cameras), ("Light", light)):
        for knob in room.EXAMPLES:
            found[f"example {knob}"] = page, _of_example(example, KNOBS, knob)
    assert {f"example {knob}" for knob in examples()} <= found.keys()
    for knob in FIT_EXAMPLES:
        found[f"fit {knob}"] = "Fits", _of_example(fit_example, FIT_KNOBS, knob)
    for name, made in (("stack pixels", stack_problem), ("sine chain length", sine_problem)):
        found[name] = "Fits", _of_peers(made)
    for fit in ("noise", "response", "brdf"):
        for knob in _OF_FITS[fit]:
            found[f"{fit} {knob}"] = "Fits", _of_rig(kept / "lab", fit, knob)
    for name, side, settings, knobs in SCENES:
        source = _replaced(read_scene(name), settings, side)
        for knob in knobs or knobs_of(source, source.render):
            found[f"{name} {settings['integrator']} {knob}"] = "Scenes", _of_scene(source, knob)
    return found


_CHAINS = ("solver tolerance", "pixels", "posterior", "chain length", "NUTS draws")
_OF_FITS = {
    "noise": ("likelihood", *_CHAINS),
    "response": ("pixels", "code bins", "curve rounds"),
    "brdf": ("cells", *_CHAINS),
}


def _replaced(source, settings, side):
    view = change_resolution(source.view, (side, side))
    return replace(source, render=override_settings(source.render, settings), view=view)


def _of_scene(source, knob: str) -> Job:
    def job(seconds: float) -> tuple[Problem, Curve]:
        problem, (found,) = measured(source, source.render, names=(knob,), seconds=seconds)
        return problem, found

    return job


def _of_example(make, knobs, knob: str) -> Job:
    def job(seconds: float) -> tuple[Problem, Curve]:
        problem = make(knob)
        return problem, curve(problem, knobs[knob], seconds=seconds)

    return job


_KNOWN: dict[Path, dict] = {}


def _of_rig(lab: Path, fit: str, knob: str) -> Job:
    def job(seconds: float) -> tuple[Problem, Curve]:
        if not (lab / "brdf" / "rig.toml").exists():
            simulate_lab(lab)
        if lab / fit not in _KNOWN:
            _KNOWN[lab / fit] = problems(load_rig(lab / fit))
        problem, known = _KNOWN[lab / fit][fit]
        (found,) = fit_measured(problem, known, names=(knob,), seconds=seconds)
        return problem, found

    return job


def _of_peers(made) -> Job:
    def job(seconds: float) -> tuple[Problem, Curve]:
        problem, knob = made()
        return problem, curve(problem, knob, seconds=seconds)

    return job


def measure(name: str, page: str, job: Job, kept: Path, seconds: float) -> Sheet:
    """Return the sheet of a knob, from its stored file if there is one."""
    file = kept / f"{slug(name)}.pickle"
    if file.exists():
        return pickle.loads(file.read_bytes())
    problem, found = job(seconds)
    sheet = Sheet(page, problem.name, found, (), seconds, os.getloadavg()[0])
    _keep(file, sheet)  # stored before other programs run, because one of them may end the process
    if name in PEERS:
        sheet = replace(sheet, peers=tuple(PEERS[name](problem, found)))
        _keep(file, sheet)
    print(f"{name}: {found.taken:.0f} s", *sheet.cells, flush=True)
    return sheet


def _keep(file: Path, sheet: Sheet) -> None:
    part = file.with_suffix(".part")
    part.write_bytes(pickle.dumps(sheet))
    part.rename(file)


def slug(name: str) -> str:
    return re.sub(r"\W+", "_", name)


def drawn(sheet: Sheet) -> str:
    """Return the curve and the points of other programs as SVG that follows the page's theme."""
    inked = "text.color axes.edgecolor axes.labelcolor axes.titlecolor xtick.color ytick.color"
    style = dict.fromkeys(inked.split(), INK)
    with matplotlib.rc_context(
        {**style, "svg.fonttype": "none", "font.size": 9, "svg.hashsalt": "jaxvision"}
    ):
        figure = Figure(figsize=(3.6, 2.8), layout="constrained")
        axes = figure.add_subplot()
        axes.patch.set_alpha(0)
        figure.patch.set_alpha(0)
        others = [(peer.name, peer.seconds, peer.error) for peer in sheet.peers]
        plot(sheet.curve, others=others, axes=axes)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    head, rest = svg.split(">", 1)
    shorter = re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\.\d\d)\d+", r"\1", d[0]), rest)
    return head + ">" + STYLE + shorter


def written(sheets: dict[str, Sheet], missing: Sequence[str], out: Path) -> None:
    """Write pages and plots, and name the knobs that are not measured yet."""
    out.mkdir(parents=True, exist_ok=True)
    given, load = (_range(getattr(s, n) for s in sheets.values()) for n in ("seconds", "load"))
    pages: dict[str, list[str]] = {}
    for name, sheet in sheets.items():
        (out / f"{slug(name)}.svg").write_text(drawn(sheet), encoding="utf-8")
        pages.setdefault(sheet.page, []).append(name)
    lines = [
        "# Atlas of accuracy: error against time",
        "",
        "Every approximation of the library has a setting that trades error for time. This atlas",
        "measures the error and the time of each setting on a small problem.",
        "",
        f"- **How it was measured.** The machine was {machine()}. `python",
        f"  tests/benchmarks/atlas.py` took at most {given} s for each approximation.",
        f"  The machine was shared (a load of up to {load.split()[-1]}), so absolute times are",
        "  long and vary between approximations. Settings of one approximation were timed in",
        "  alternation, so that their times can be compared.",
        "- **Time** is without compilation. For scenes, the time of the whole picture is given.",
        "- **Error** is the relative RMS error. For fits the error is in units of the standard",
        "  error.",
        '- **Order** is the measured law of the error: an exponent of the setting, as in "-0.5 ±',
        '  0.1", or a factor for each unit of the setting, as in "× 0.3". "Unknown" means that no',
        "  law fitted.",
        "- **10 %, 1 %, 0.1 %** give the fastest setting whose error is at most this large, also",
        "  for other seeds, and its time. The choice uses an upper bound of the error, which is",
        '  larger than the measured error in the section Defaults. "Inferred" settings are',
        '  between or beyond the measured settings. "Not reached" may also mean that there was',
        "  too little time for finer settings.",
        "- **Plots**: labels are settings. The dashed line is the error of the reference. Points",
        "  with less than three times this error are hollow. Points on the lower axis (`: 0`)",
        "  equal the reference. Triangles are other programs.",
        "- **Not covered**: other problems. Each approximation was measured on one problem only,",
        "  and error and time depend on the scene, the picture's size and the machine.",
        "  `jaxvision accuracy SCENE` and `jaxvision-fit accuracy RIG` measure your own.",
        "",
    ]
    for page, names in pages.items():
        lines += [f"## {page}", ""]
        if page == "Pictures":
            lines += [f"All pictures have {pictures.SIDE} x {pictures.SIDE} pixels.", ""]
        lines += ["| problem | approximation | order | 10 % | 1 % | 0.1 % |"]
        lines.append("| --- | --- | --- | --- | --- | --- |")
        for name in names:
            sheet = sheets[name]
            lines.append(f"| {sheet.problem} | {' | '.join(sheet.cells)} |")
            told = ", ".join(
                f"{p.name} {100 * p.error:.2g} % in {1e3 * p.seconds:.3g} ms" for p in sheet.peers
            )
            if told:
                lines.append(f"| | other programs, {sheet.curve.knob.name} | {told} | | | |")
        lines.append("")
        lines += [
            f'<img src="atlas/{slug(n)}.svg" width="300" class="curve" alt="{n}">' for n in names
        ]
        lines.append("")
    lines += defaults(sheet.curve for sheet in sheets.values())
    if missing:
        lines += [f"Not measured yet: {', '.join(missing)}.", ""]
    (out.parent / f"{out.name}.md").write_text("\n".join(lines), encoding="utf-8")


def _range(numbers: Iterable[float]) -> str:
    """Return the smallest and the largest finite number as text."""
    known = sorted(one for one in numbers if np.isfinite(one))
    ends = [f"{known[0]:.0f}", f"{known[-1]:.0f}"] if known else ["?"]
    return " to ".join(dict.fromkeys(ends))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="for all, at most")
    parser.add_argument("--kept", type=Path, default=Path(".atlas"))
    parser.add_argument("--out", type=Path, default=Path("docs/atlas"))
    parser.add_argument("--only", default="")
    parser.add_argument("--write", action="store_true", help="pages of what is kept already")
    asked = parser.parse_args(arguments)
    asked.kept.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(asked.kept / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    every = jobs(asked.kept)
    share = 60 * asked.minutes / sum(SHARES[page] for page, _ in every.values())
    sheets: dict[str, Sheet] = {}
    for name, (page, job) in every.items():
        known = (asked.kept / f"{slug(name)}.pickle").exists()
        if asked.only not in name or (asked.write and not known):
            continue
        try:
            sheets[name] = measure(name, page, job, asked.kept, SHARES[page] * share)
        except InputError as error:  # such as a program that takes longer than its knob may
            print(f"{name}: {error}", flush=True)
    if asked.write or not asked.only:
        missing = [name for name in every if name not in sheets]
        written(sheets, missing, asked.out)


if __name__ == "__main__":
    main()
