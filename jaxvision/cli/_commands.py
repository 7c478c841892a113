"""The `jaxvision` command: inspect image files, render scene files, measure accuracy, and bound the
effects of a scene.

Bad input ends the command with one sentence on standard error and exit status 2. An interrupt ends
it with status 130. Numerical libraries are imported only when a command starts its work, so that
`--help` and mistyped options are answered immediately.
"""

import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from ..core._warnings import warn
from ..core.interrupts import ending_on_interrupt
from ..core.memory import keep_memory
from ..core.progress import progress_bar
from ..errors import InputError
from ..files.shipped import existing_file
from ..programs import keep_programs
from .command_line import (
    AsJson,
    KnobNames,
    PageFolder,
    Scheduler,
    Workers,
    command_app,
    failures_as_sentences,
    print_table,
    sub_command,
)

MEASURED = 240.0  # s, default time of the measurement before --accuracy or --seconds choose
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")
SceneArgument = Annotated[
    str,
    typer.Argument(
        help="Scene in TOML, Mitsuba's XML, pbrt or glTF, or a shipped one.", metavar="SCENE"
    ),
]

app = command_app(
    "jaxvision", "Photometric image formation: inspect images as numbers, render scenes."
)


@sub_command(
    app,
    "jaxvision inspect photo.png --out look.png",
    "jaxvision inspect photo.png --at 120,80 --json",
)
@failures_as_sentences("jaxvision")
def inspect(
    file: Annotated[
        Path,
        typer.Argument(
            help="PNG, TIFF, JPEG, EXR, HDR, PGM, PPM, TGA, NPY, raw or FITS image.", metavar="FILE"
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Draw the figure to this PNG, PDF or SVG.", metavar="FIGURE"),
    ] = None,
    row: Annotated[
        int | None, typer.Option("--row", help="Row of the scan line (default: the row of --at).")
    ] = None,
    at: Annotated[
        str, typer.Option("--at", help="Pixel to print (default: the middle).", metavar="ROW,COL")
    ] = "",
    white: Annotated[
        float | None,
        typer.Option(
            "--white", help="Value of saturated pixels (default: largest code; 1 for floats)."
        ),
    ] = None,
    part: Annotated[
        str,
        typer.Option(
            help="Picture of a file that holds several: its number, from 0, or its name.",
            metavar="PART",
        ),
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Print range, moments and saturation of each channel. With --out, draw the picture,
    histograms, a scan line, a grid of values and the surface in one figure."""
    from ..files.image_settings import largest_code
    from ..files.images import read_channels, replaced_on_success

    pixel = _pair("--at", at) if at else None
    if out is not None and out.suffix.lower() not in FIGURE_SUFFIXES:
        known = ", ".join(FIGURE_SUFFIXES)
        raise InputError(f"{out}: unknown figure suffix {out.suffix!r}; use one of {known}.")
    image, names = read_channels(file, part=int(part) if part.isdecimal() else part or None)
    if white is None and image.dtype.kind in "iu" and image.size:
        white = largest_code(file, image)
    _prepare()
    from .. import plots

    try:
        bands = plots.summarise(image, white=white, names=names)
        figure = plots.inspect(image, row=row, at=pixel, white=white, title=file.name, names=names)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if row is not None and out is None:
        warn("--row has no effect without --out, which draws it.")
    if out is not None:
        with replaced_on_success(out) as partial:
            figure.savefig(partial, dpi=130)
    if as_json:
        sheet = {
            "file": str(file),
            "shape": image.shape,
            "dtype": str(image.dtype),
            "bands": [_finite_or_null(asdict(band)) for band in bands],
        }
        print(json.dumps(sheet, indent=2, allow_nan=False))
        return
    print_table(f"{file.name}: {' × '.join(map(str, image.shape))}, {image.dtype}", bands)
    if out is not None:
        print(f"Figure: {out}")


@sub_command(
    app,
    "jaxvision render cornell_box --out box.exr --samples 64",
    "jaxvision render scene.toml --out picture.exr --accuracy 2%",
)
@failures_as_sentences("jaxvision")
def render(
    scene: SceneArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out", help="EXR of radiance to write; missing folders are made.", metavar="EXR"
        ),
    ],
    integrator: Annotated[
        str | None,
        typer.Option(
            help="direct, path, rays, light or radiosity (default: the scene's). For another "
            "integrator, the scene's samples and depth are replaced by its defaults.",
            metavar="WORD",
        ),
    ] = None,
    samples: Annotated[
        int | None, typer.Option(help="Samples per pixel (default: the scene's).")
    ] = None,
    depth: Annotated[
        int | None, typer.Option(help="Longest path, in segments (default: the scene's).")
    ] = None,
    gather: Annotated[
        int | None,
        typer.Option(
            help="Rays of radiosity's final gather, 0 for none (default: the scene's, 0)."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of the random numbers (default: the scene's, 0).")
    ] = None,
    tile: Annotated[
        int | None, typer.Option(help="Pixels computed at once (default: the scene's, 65536).")
    ] = None,
    resolution: Annotated[
        str,
        typer.Option(
            help="Resolution of the same view, instead of the scene's.", metavar="ROWS,COLUMNS"
        ),
    ] = "",
    preview: Annotated[
        Path | None,
        typer.Option(
            help="8-bit PNG, TIFF or JPEG of the picture (default: a PNG beside the EXR).",
            metavar="FILE",
        ),
    ] = None,
    no_preview: Annotated[bool, typer.Option("--no-preview", help="Write the EXR only.")] = False,
    tolerance: Annotated[
        str | None,
        typer.Option(
            help="Leave out effects that change no pixel by more than this share of the "
            "brightest pixel (default: only what is proved to change nothing).",
            metavar="SHARE%",
        ),
    ] = None,
    keep_all: Annotated[
        bool,
        typer.Option("--keep-all", help="Compute every effect, also those that change no pixel."),
    ] = False,
    accuracy: Annotated[
        str,
        typer.Option(
            help="Choose settings by measurement: the fastest whose relative rms error is at most "
            "this. Measured once, then remembered.",
            metavar="SHARE%",
        ),
    ] = "",
    seconds: Annotated[
        float | None,
        typer.Option(help="Choose settings by measurement: the most accurate in this time."),
    ] = None,
    measure: Annotated[
        float | None,
        typer.Option(help="Time of the measurement for --accuracy or --seconds, s (default: 240)."),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Start again and discard an earlier render.")
    ] = False,
    workers: Workers = 0,
    scheduler: Scheduler = "",
) -> None:
    """Render a scene to an EXR of radiance, W m^-2 sr^-1, and a preview, tile by tile. The same
    command resumes a render that was interrupted or killed."""
    file = existing_file(scene, "scene")
    _prepare()
    from ..effects.certificate import summary
    from ..files.scenes import read_scene
    from ..files.scenes.schema import idle, override_settings
    from ..render_command import (
        change_resolution,
        cost_sentence,
        light_findings,
        lossless_sentence,
        prune_losslessly,
        prune_scene,
        render_to_file,
    )
    from ..tasks import workers as workers_of

    source = read_scene(file)
    given = {
        "integrator": integrator,
        "samples": samples,
        "depth": depth,
        "gather": gather,
        "seed": seed,
        "tile": tile,
    }
    settings = override_settings(source.render, given)
    for name in idle(settings.integrator, given):
        warn(f"--{name} has no effect with the integrator {settings.integrator!r}.")
    shown = None if no_preview else preview or out.parent / f"{out.stem}.png"
    if resolution:
        wanted = _pair("--resolution", resolution)
        if min(wanted) < 1:
            raise InputError(f"--resolution {resolution}: a picture has at least one pixel.")
        source = replace(source, view=change_resolution(source.view, wanted))
    pruned = None if tolerance is None else prune_scene(source, settings, tolerance)
    if measure is not None and not accuracy and seconds is None:
        warn("--measure has no effect without --accuracy or --seconds.")
    if keep_all and tolerance is not None:
        raise InputError("--keep-all and --tolerance exclude each other; give one.")
    if no_preview and preview is not None:
        raise InputError("--preview and --no-preview exclude each other; give one.")
    if accuracy or seconds is not None:
        refused = {"samples": samples, "depth": depth, "gather": gather, "tolerance": tolerance}
        taken = [f"--{name}" for name, value in refused.items() if value]
        if taken or (accuracy and seconds is not None):
            other = taken[0] if taken else "--seconds"
            raise InputError(f"{other} and a choice of settings exclude each other; give one.")
        from ..accuracy import settings as settings_for
        from ..accuracy.deadlines import TooLittleTime
        from ..accuracy.tables import choice_in_words

        measure = MEASURED if measure is None else measure
        if not measure > 0:
            raise InputError(f"--measure {measure:g}: give a time above 0.")
        share = _share(accuracy) if accuracy else None
        if seconds is not None and not seconds > 0:
            raise InputError(f"--seconds {seconds:g}: give a time above 0.")
        print("Measuring what accuracy costs; the result is remembered.", file=sys.stderr)
        source = replace(source, render=settings)
        try:
            chosen = settings_for(source, tolerance=share, render_seconds=seconds, seconds=measure)
        except TooLittleTime as error:
            print(f"{error} Rendered with the scene's own settings.", file=sys.stderr)
        else:
            settings, pruned = chosen.render, None if keep_all else chosen.effects
            print(choice_in_words(chosen))
    unchanged = None
    if tolerance is None and pruned is None and not keep_all:
        unchanged = pruned = prune_losslessly(source, settings)
    for sentence in light_findings(source, settings):
        print(sentence, file=sys.stderr)
    title = f"{source.path.stem}, {settings.integrator}"
    with workers_of(workers, scheduler=scheduler), progress_bar(title) as advance:
        cost = render_to_file(
            source, out, settings, pruned=pruned, preview=shown, fresh=fresh, advance=advance
        )
    if unchanged is not None:
        print(lossless_sentence(source, unchanged))
    elif pruned is not None:
        print(summary(pruned.certificate))
    print(f"Radiance: {out}")
    if shown is not None:
        print(f"Preview: {shown}")
    print(cost_sentence(cost, settings))


@sub_command(
    app,
    "jaxvision accuracy cornell_box --seconds 60",
    "jaxvision accuracy scene.toml --knob samples --out accuracy",
)
@failures_as_sentences("jaxvision")
def accuracy(
    scene: SceneArgument,
    knob: KnobNames = None,
    seconds: Annotated[float, typer.Option(help="Time to measure, s.")] = 60.0,
    out: PageFolder = None,
    as_json: AsJson = False,
) -> None:
    """Measure error against time for each approximation of a scene. The report gives the cheapest
    setting for an error of 10, 1 and 0.1 %, of each approximation and of all together. An interrupt
    keeps the measurements."""
    begun = time.perf_counter()
    file = existing_file(scene, "scene")
    _prepare()
    from ..accuracy.console import check_request, keep, print_json, repeating, show
    from ..accuracy.curves import LEAST
    from ..accuracy.scene_settings import measured_together
    from ..files.scenes import read_scene

    check_request(seconds, out)
    source = read_scene(file)
    norms = ("rms", "p99", "max", "delta_e")
    left = seconds - (time.perf_counter() - begun)
    if left <= LEAST:
        raise InputError(
            f"--seconds {seconds:g}: libraries and scene took {seconds - left:.2g} s to load; "
            "allow more."
        )
    problem, curves, together = measured_together(source, names=knob, seconds=left, metrics=norms)
    command = repeating("jaxvision accuracy", scene, knobs=knob or (), seconds=seconds, out=out)
    said: dict[str, Any] = {"together": together, "command": command, "as_json": as_json}
    sheet = show(problem, curves, **said)
    keep(out, problem, curves, **said)
    if as_json:
        print_json(sheet)


def _share(text: str) -> float:
    """Parse a relative tolerance above 0 and below 1, such as "1%"."""
    from ..effects import parse

    goal = parse(text)
    if goal.unit != "relative" or not goal.value > 0:
        raise InputError(f"--accuracy {text}: give a share of the picture above 0, as in 1%.")
    if goal.value >= 1:
        raise InputError(
            f"--accuracy {text}: even a black picture errs by no more than 100 %; give less, as in "
            "1%."
        )
    return goal.value


@sub_command(
    app,
    "jaxvision effects cornell_box --tolerance 25%",
    "jaxvision effects cornell_box --camera emva1288 --tolerance 0.5DN",
)
@failures_as_sentences("jaxvision")
def effects(
    scene: SceneArgument,
    camera: Annotated[
        str,
        typer.Option(
            help="TOML camera file, or the name of a shipped camera, whose sensor is combined "
            "with the scene's view.",
            metavar="CAMERA",
        ),
    ] = "",
    tolerance: Annotated[
        str | None,
        typer.Option(
            help="List effects that may be left out: 1% of the brightest pixel, 0.5DN or 0.1sigma.",
            metavar="AMOUNT",
        ),
    ] = None,
    place: Annotated[
        float | None,
        typer.Option(
            help="Displacement allowed, in pixels (default: 0.1; 0 for a tolerance of 0)."
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            help="Free parameter of a fit, with its range; can be repeated.",
            metavar="NAME=LOW,HIGH",
        ),
    ] = None,
    estimates: Annotated[
        bool,
        typer.Option(
            "--estimates",
            help="Also estimate the light of long paths and effects without a bound, from small "
            "pictures and without proof.",
        ),
    ] = False,
    timed: Annotated[
        bool, typer.Option("--time", help="Measure the time that each effect takes.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Bound the change that each effect of a scene and a camera makes in the picture."""
    file = existing_file(scene, "scene")
    camera_file = existing_file(camera, "camera") if camera else None
    _prepare()
    from ..effects import explain, parse
    from ..files.cameras import read_camera
    from ..files.scenes import read_scene
    from ..render_command import inspect_scene, light_findings, prune_scene
    from ..render_command.pruning import box_of, listed, name_effect, smaller

    goal = None
    if place is not None and tolerance is None:
        warn("--place has no effect without --tolerance.")
    if tolerance is not None:
        goal = parse(tolerance, place=place)
        if timed:
            raise InputError("--time lists all effects as they are; leave --tolerance out.")
    source = read_scene(file)
    bands: Any = source.wavelengths
    sensor = None if camera_file is None else read_camera(camera_file, wavelengths=bands)
    asked: dict[str, Any] = {"camera": sensor, "free": box_of(free or []), "estimates": estimates}
    for sentence in light_findings(source, source.render):
        print(sentence, file=sys.stderr)
    if goal is None:
        with progress_bar("measuring programs", shown=timed) as advance:
            found = inspect_scene(source, source.render, time=timed, advance=advance, **asked)
        rows = [_finite_or_null(asdict(effect)) for effect in found]
        if as_json:
            print(json.dumps(rows, indent=2))
            return
        print(listed(name_effect(source, effect) for effect in found))
        if estimates:
            count = sum(effect.rank == "estimate" for effect in found)
            which = "is an estimate" if count < 2 else "are estimates"
            print(f"{count or 'None'} of {len(found)} bounds {which}.")
        elif any(effect.bound == float("inf") for effect in found):
            print("Not bounded: --estimates adds the change of a small picture.")
        return
    pruned = prune_scene(source, source.render, goal, **asked)
    certificate = pruned.certificate
    if as_json:
        sheet = {name: getattr(certificate, name) for name in ("total", "estimated", "place")}
        sheet |= {"tolerance": goal.value, "unit": goal.unit, "level": certificate.level}
        for name in ("dropped", "kept"):
            sheet[name] = [_finite_or_null(asdict(e)) for e in getattr(certificate, name)]
        print(json.dumps(sheet, indent=2, allow_nan=False))
        return
    kept, dropped = (
        tuple(name_effect(source, effect) for effect in effects)
        for effects in (certificate.kept, certificate.dropped)
    )
    named = replace(certificate, kept=kept, dropped=dropped)
    print(explain(named)[:-1] + smaller(source, pruned))


def _pair(option: str, text: str) -> tuple[int, int]:
    try:
        row, column = (int(part) for part in text.split(","))
    except ValueError:
        message = f"{option} {text}: give a row and a column, as in {option} 120,80."
        raise InputError(message) from None
    return row, column


def _finite_or_null(values: dict[str, Any]) -> dict[str, Any]:
    """Make numbers compatible with JSON: NaN and infinity become null."""
    return json.loads(json.dumps(values), parse_constant=lambda _: None)


def _prepare() -> None:
    """Enable the cache of compiled programs and double precision. Histograms of 16-bit and
    floating-point images need double precision. Importing the package enables neither the cache nor
    double precision."""
    keep_programs()
    import jax

    jax.config.update("jax_enable_x64", True)


def start() -> None:
    """Run the command."""
    keep_memory()
    app()


def main() -> None:
    """Run the shell command `jaxvision`; an interrupt ends it at once."""
    ending_on_interrupt("jaxvision", start)


if __name__ == "__main__":
    main()
