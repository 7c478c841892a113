"""The `jaxvision-fit` command: calibration of noise, response and reflectance from a folder of
images, separately or together; reflectance from files of measured BRDFs; and a demo with simulated
images.

The numerical libraries are imported after the arguments, the paths and the rig have been checked,
so `--help` and mistakes are answered immediately.
"""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from jaxvision.cli.command_line import (
    AsJson,
    KnobNames,
    PageFolder,
    Scheduler,
    Workers,
    sub_command,
)
from jaxvision.core.interrupts import ending_on_interrupt, is_handled
from jaxvision.core.memory import keep_memory
from jaxvision.errors import InputError
from jaxvision.programs import keep_programs

from . import folders
from .commands import (
    INDEX_OPTION,
    Options,
    RigPath,
    app,
    command,
    failures,
    model_option,
    refuse_mcmc,
    run,
    typed_path,
)
from .reflectance.names import INDEX, Model, Objective, is_measured_brdf
from .reflectance.paths import check_files, check_index_of, check_one_rig
from .report.progress import Reporter

BitsOfTable = Annotated[
    int | None, typer.Option(help="ADC bits of the camera, for a CSV.", min=1, max=16)
]
Channel = Annotated[
    str, typer.Option(help="Site of a mosaic, or tap, to use (default: each separately).")
]
INCOMPLETE = 3  # exit status if some channels could not be calibrated and the others were written


@command(
    "jaxvision-fit noise camera --out noise",
    "jaxvision-fit noise camera --release 4.0",
    "jaxvision-fit noise sums.csv --bits 12",
)
def noise(
    options: Options,
    path: Annotated[
        Path,
        typer.Argument(
            help="Rig folder, or a CSV of sums per exposure.", metavar="PATH", parser=typed_path
        ),
    ],
    bits: BitsOfTable = None,
    channel: Channel = "",
    release: Annotated[
        Literal["3.1", "4.0"],
        typer.Option(
            help="Release of EMVA 1288: 3.1, or 4.0 for the data sheets of both releases."
        ),
    ] = "3.1",
) -> None:
    """Calibrate a camera's noise by photon transfer: the EMVA 1288 sheet with standard errors."""

    def calibrate_noise(reporter: Reporter) -> folders.Found:
        asked = {"bits": bits, "channel": channel, "release": release}
        return folders.noise(path, reporter.step, options.draws, **asked)

    run("Photon transfer", path, options, calibrate_noise)


@command(
    "jaxvision-fit predict noise/sensor.toml frames --out predicted",
    "jaxvision-fit predict noise sums.csv",
)
def predict(
    options: Options,
    camera: Annotated[
        str,
        typer.Argument(
            help="Camera file, the folder that noise --out wrote, or a shipped camera.",
            metavar="CAMERA",
        ),
    ],
    path: Annotated[
        Path,
        typer.Argument(
            help="Flats of 4 levels or more, and darks: a rig folder, or a CSV of sums.",
            metavar="FRAMES",
            parser=typed_path,
        ),
    ],
    bits: BitsOfTable = None,
    channel: Channel = "",
    light_error: Annotated[
        float,
        typer.Option(help="Relative error of the light of a level, .01 for 1 %.", min=0, max=0.99),
    ] = 0.0,
) -> None:
    """Compare frames with the prediction from a camera file alone: mean, variance and covariance of
    neighbouring pixels at each level. Where they differ, name the effect that the camera lacks."""

    def compare_frames(reporter: Reporter) -> folders.Found:
        refuse_mcmc(options, "nothing is fitted")
        kept = {"bits": bits, "channel": channel, "light_error": light_error}
        return folders.predict(camera, path, reporter.step, **kept)

    run("Prediction of frames", path, options, compare_frames)


@command("jaxvision-fit response stack --out response")
def response(options: Options, path: RigPath) -> None:
    """Estimate gamma and the whole response curve of a camera from an exposure stack, and merge the
    stack into a radiance map."""

    skipped: list[str] = []

    def calibrate_response(reporter: Reporter) -> folders.Found:
        return folders.response(path, reporter.step, options.draws, skipped=skipped.append)

    run("Camera response", path, options, calibrate_response)
    if skipped:
        raise typer.Exit(INCOMPLETE)


@command(
    "jaxvision-fit brdf paint --out paint",
    "jaxvision-fit brdf red.binary blue.binary --objective cube-root",
)
def brdf(
    options: Options,
    paths: Annotated[
        list[Path],
        typer.Argument(
            help="A rig folder, or files of measured reflectance: .brdf (Cornell), .bsdf (RGL), "
            ".binary (MERL).",
            metavar="PATH",
            parser=typed_path,
        ),
    ],
    model: Annotated[
        Model | None,
        model_option(
            "Model to report in full (default: phong for a rig, the best for files); facets of "
            "torrance-sparrow are GGX."
        ),
    ] = None,
    index: Annotated[float, INDEX_OPTION] = INDEX,
    compare_all: Annotated[
        bool,
        typer.Option(
            "--compare-all",
            help="Rig: fit all eleven models instead of the usual eight, in about twice the time.",
        ),
    ] = False,
    ambient: Annotated[
        bool, typer.Option("--ambient", help="Rig: fit a constant ambient light per channel.")
    ] = False,
    fit_gamma: Annotated[
        bool, typer.Option("--fit-gamma", help="Rig: fit the encoding exponent of the images.")
    ] = False,
    minimum_cosine: Annotated[
        float, typer.Option(help="Rig: leave out samples with a smaller n.l.", min=0.0, max=0.99)
    ] = 0.0,
    objective: Annotated[
        Objective | None,
        typer.Option(
            help="Files: least squares of f_r cos (cosine, the default) or its cube root."
        ),
    ] = None,
) -> None:
    """Fit reflectance models to images of a known shape or to measured BRDFs, and compare them on
    held-out lights or angles."""
    of_rigs = {
        "compare_all": compare_all,
        "ambient": ambient,
        "fit_gamma": fit_gamma,
        "minimum_cosine": minimum_cosine,
    }

    def calibrate_images(reporter: Reporter) -> folders.Found:
        check_one_rig(paths, objective)
        settings = {"model": model or "phong", "index": index, **of_rigs}
        return folders.brdf(paths[0], reporter.step, options.draws, **settings)

    def calibrate_files(reporter: Reporter) -> folders.Found:
        check_files([folders.require_path(path) for path in paths], of_rigs)
        from .reflectance.from_files.calibration import calibrate
        from .reflectance.from_files.read import read_measured_brdf
        from .reflectance.from_files.section import materials_section, section

        with reporter.step("reading samples"):
            materials = [read_measured_brdf(path) for path in paths]
        names = [material.name for material in materials]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{name}: two files have this name; rename one of them.")
        calibrations = []
        by = {"model": model, "objective": objective or "cosine", "index": index}
        for material in materials:
            with reporter.step(f"fitting {material.name}") as progress:
                calibrations.append(calibrate(material, **by, **options.draws("brdf", progress)))
        compared = [materials_section(calibrations)] if len(calibrations) > 1 else []
        return [*compared, *(section(calibration) for calibration in calibrations)], {}

    if any(is_measured_brdf(path) for path in paths):
        run("Measured reflectance", paths[0], options, calibrate_files)
    else:
        run("Reflectance", paths[0], options, calibrate_images)


@command(
    "jaxvision-fit lights ball/*.png --mask ball/mask.png --out lights",
    "jaxvision-fit lights ball/*.tif --mask ball/mask.tif --kind matte --black-level 64",
)
def lights(
    options: Options,
    images: Annotated[
        list[Path],
        typer.Argument(
            help="Linear photographs of a ball, one per light.", metavar="IMAGE", parser=typed_path
        ),
    ],
    mask: Annotated[
        list[Path],
        typer.Option(
            help="Image that is non-zero where the ball is; give two, of mirror balls, "
            "for positions.",
            parser=typed_path,
            metavar="FILE",
        ),
    ],
    kind: Annotated[
        Literal["mirror", "matte"], typer.Option(help="Highlights of a mirror, or shading.")
    ] = "mirror",
    bits: Annotated[
        int | None, typer.Option(help="ADC bits of the images (default: 8).", min=1, max=16)
    ] = None,
    black_level: Annotated[
        float | None, typer.Option(help="DN without light (default: 0).", min=0)
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="Rig whose [camera] is used in place of --bits and --black-level: taps, mosaic.",
            parser=typed_path,
            metavar="RIG",
        ),
    ] = None,
    focal_length: Annotated[
        float | None,
        typer.Option(help="Focal length, pixels (default: an orthographic view).", min=1.0),
    ] = None,
    radius: Annotated[float | None, typer.Option(help="Radius of two balls, m.", min=1e-6)] = None,
    outline_sd: Annotated[
        float,
        typer.Option(
            help="Standard deviation of the outline's centre and radius, pixels.",
            min=0.0,
            max=100.0,
        ),
    ] = 0.5,
) -> None:
    """Estimate directions or positions of lights, and their intensities, from photographs of a
    ball, with one joint covariance. --out writes lights.npz and a rig that brdf and joint read."""

    def calibrate_lights(reporter: Reporter) -> folders.Found:
        refuse_mcmc(options, "the covariance is Gaussian")
        if rig is not None and (bits, black_level) != (None, None):
            raise InputError("give either --rig, or --bits and --black-level.")
        known = {"bits": bits or 8, "black_level": black_level or 0.0}
        asked = {"focal_length": focal_length, "radius": radius, "outline_sd": outline_sd}
        return folders.lights(
            images, mask, reporter.step, known, rig=rig, out=options.out, kind=kind, **asked
        )

    run("Lights", images[0].parent, options, calibrate_lights)


@command("jaxvision-fit plan paint --target exponent")
def plan(
    options: Options,
    path: Annotated[Path, typer.Argument(help="Rig folder.", metavar="PATH", parser=typed_path)],
    target: Annotated[str, typer.Option(help="Parameter whose error to reduce, such as exponent.")],
    model: Annotated[Model, model_option("Model of the reflectance.")] = "phong",
    index: Annotated[float, INDEX_OPTION] = INDEX,
) -> None:
    """Rank the lights to photograph next by how much each would reduce the error of a reflectance
    parameter."""

    def plan_images(reporter: Reporter) -> folders.Found:
        refuse_mcmc(options, "lights are ranked by Laplace's approximation")
        check_index_of(model, index)
        rig = folders.read_rig(path, "a reflectance calibration")
        from .reflectance.from_images.calibration import calibrate
        from .reflectance.from_images.plan import check_target, plan_section
        from .reflectance.from_images.read import read_reflectance_observation
        from .reflectance.from_images.signal import Form

        check_target(target, Form(model))
        with reporter.step("reading images"):
            observation = read_reflectance_observation(
                rig, channel="green" if rig.camera.pattern else ""
            )
        with reporter.step("fitting reflectance"):
            calibration = calibrate(observation, model=model, index=index, seed=options.seed)
        with reporter.step("ranking lights"):
            return [plan_section(calibration, target)], {}

    run("What to photograph next", path, options, plan_images)


@command("jaxvision-fit joint paint --fit-gamma --out joint")
def joint(
    options: Options,
    path: RigPath,
    model: Annotated[Model, model_option("Model of the surface.")] = "phong",
    index: Annotated[float, INDEX_OPTION] = INDEX,
    fit_gamma: Annotated[
        bool, typer.Option("--fit-gamma", help="Fit the encoding exponent of the images.")
    ] = False,
) -> None:
    """Fit surface, response, gain and noise together to images of a known shape. Numbers with an
    _sd in the rig are uncertain, others exact."""

    def calibrate_joint(reporter: Reporter) -> folders.Found:
        check_index_of(model, index)
        settings = {"model": model, "index": index, "fit_gamma": fit_gamma}
        return folders.joint(path, reporter.step, options.draws, **settings)

    run("Joint calibration", path, options, calibrate_joint)


@command("jaxvision-fit demo --out demo")
def demo(options: Options) -> None:
    """Simulate images of an afternoon in a laboratory, calibrate from these images alone, and
    compare the results with the simulated values. All files are in jaxvision-demo or --out."""
    out = options.out or Path("jaxvision-demo")
    options = replace(options, out=out)

    def calibrate_demo(reporter: Reporter) -> folders.Found:
        from .demo.compare import calibrate_lab, mark_truth
        from .demo.lab import simulate_lab
        from .demo.section import against_truth

        with reporter.step("simulating the lab") as progress:
            truth = simulate_lab(out / "lab", seed=options.seed, progress=progress)
        sections = calibrate_lab(out / "lab", reporter.step, options.draws)
        marked = (mark_truth(found, truth) for found in sections)
        return [against_truth(sections, truth), *marked], {}

    run("A simulated lab afternoon", out, options, calibrate_demo)


@sub_command(app, "jaxvision-fit init photos")
@failures()
def init(
    folder: Annotated[
        Path, typer.Argument(help="Folder of images.", metavar="FOLDER", parser=typed_path)
    ],
) -> None:
    """Write the rig.toml of a folder of images, from their names and metadata (times, ISO, dates),
    and list missing values."""
    path, found = folders.init(folder)
    print(f"Rig: {path}")
    for sentence in found.left_out:
        print(f"Left out: {sentence}")
    for sentence in found.missing:
        print(f"To do: {sentence}")
    if found.kind:
        print(f"Then: jaxvision-fit {found.kind} {folder}")


@sub_command(app, "jaxvision-fit study noise cameras/* --out study --workers 4")
@failures()
def study(
    kind: Annotated[
        Literal["noise", "response", "brdf", "joint"],
        typer.Argument(help="Calibration to run in each folder."),
    ],
    paths: Annotated[
        list[Path],
        typer.Argument(help="Folders, each with a rig.toml.", metavar="PATH", parser=typed_path),
    ],
    out: Annotated[
        Path, typer.Option(help="Folder for the reports, the table and the page.", metavar="DIR")
    ],
    seed: Annotated[int, typer.Option(help="Seed of every random draw.", min=0)] = 0,
    no_reports: Annotated[
        bool, typer.Option("--no-reports", help="Write only the numbers, in a tenth of the time.")
    ] = False,
    workers: Workers = 0,
    scheduler: Scheduler = "",
) -> None:
    """Calibrate the folders of many cameras: a report for each, one table for all, and a page that
    names outliers and drift. The same command resumes an interrupted study."""
    keep_programs()
    from jaxvision.tasks import workers as workers_of

    from .report.progress import reporting
    from .study.outcomes import Settings
    from .study.run import study as studied

    with (
        workers_of(workers, scheduler=scheduler),
        reporting() as reporter,
        reporter.step(kind) as progress,
    ):
        found = studied(paths, out, Settings(kind, seed, reports=not no_reports), progress=progress)
    failed = [outcome for outcome in found.outcomes if outcome.failed]
    for outcome in failed:
        print(f"{outcome.camera}: not calibrated: {outcome.failed}", file=sys.stderr)
    print(f"Calibrated: {len(found.outcomes) - len(failed)} of {len(found.outcomes)} folders")
    for one in found.quantities:
        if one.outliers:
            where = f" {one.channel}" if one.channel else ""
            print(f"Unlike the others in {one.quantity}{where}: {', '.join(one.outliers)}")
    print(f"Table: {out / 'study.nc'}\nPage: {out / 'study.html'}")
    if failed:
        raise typer.Exit(INCOMPLETE)


@command("jaxvision-fit check noise --simulations 200 --out check")
def check(
    options: Options,
    kind: Annotated[
        Literal["brdf", "emva1288", "joint", "noise", "response"],
        typer.Argument(help="Fits to check."),
    ],
    simulations: Annotated[int, typer.Option(help="Simulations of each case.", min=2)] = 200,
    workers: Workers = 0,
    scheduler: Scheduler = "",
) -> None:
    """Simulate data, fit them, and count how often intervals contain the true value. --out keeps
    the fits, so an interrupted check continues, as does a finished check with more
    --simulations."""

    def run_check(reporter: Reporter) -> folders.Found:
        refuse_mcmc(options, "the check uses the intervals of Laplace's approximation")
        from jaxvision.tasks import workers as workers_of

        from .checks.command import run as simulated

        kept = options.out and options.out / "fits"
        with workers_of(workers, scheduler=scheduler):
            return [simulated(kind, simulations, kept, reporter, seed=options.seed)], {}

    run("Check", Path(kind), options, run_check, repeats=True)


@sub_command(
    app,
    "jaxvision-fit accuracy paint --seconds 60",
    "jaxvision-fit accuracy stack --knob pixels --out accuracy",
)
@failures(interrupted="interrupted.")
def accuracy(
    rig: RigPath,
    knob: KnobNames = None,
    seconds: Annotated[float, typer.Option(help="Time for a fit, with its calibration, s.")] = 60.0,
    out: PageFolder = None,
    as_json: AsJson = False,
) -> None:
    """Measure error against time for each approximation in a rig's fits: the cheapest settings for
    a tenth, a hundredth and a thousandth of a standard error. An interrupt ends it and keeps the
    measurements. --json prints one object, with a key for each fit."""
    begun = time.perf_counter()
    from .rig import load_rig

    described = load_rig(rig)
    keep_programs()
    from jaxvision.accuracy.console import check_request, keep, print_json, repeating, show
    from jaxvision.accuracy.curves import LEAST, asked_knobs

    from .accuracy import measured, problems
    from .accuracy.knobs import RIG_KNOBS

    check_request(seconds, out)
    names = asked_knobs(str(rig), knob, RIG_KNOBS)
    left = seconds - (time.perf_counter() - begun)
    if left <= LEAST:
        raise InputError(
            f"--seconds {seconds:g}: libraries and rig took {seconds - left:.2g} s to load; allow "
            "more."
        )
    found = problems(described, seconds=left)
    left = seconds - (time.perf_counter() - begun) / len(found)
    if knob:
        asked_knobs(str(rig), names, [name for _, known in found.values() for name in known])
    asked = {"knobs": knob or (), "seconds": seconds, "out": out}
    command = repeating("jaxvision-fit accuracy", rig, **asked)
    sheets: dict[str, Any] = {}
    try:
        for fit, (problem, known) in found.items():
            turned = tuple(name for name in names if name in known)
            if not turned:
                continue
            curves = measured(problem, known, names=turned, seconds=left)
            folder = out / fit if out is not None and len(found) > 1 else out
            sheets[fit] = show(problem, curves, command=command, as_json=as_json)
            keep(folder, problem, curves, command=command, as_json=as_json)
            if any(curve.stopped == "interrupted" for curve in curves):
                break
    except KeyboardInterrupt:
        if not sheets:
            raise
        is_handled()
    finally:
        if as_json and sheets:
            print_json(sheets)


def start() -> None:
    """Run the command in double precision, which calibration needs. The environment variable is set
    here and not at the package's import, which must leave JAX's settings alone. JAX is imported
    only after this.
    """
    os.environ["JAX_ENABLE_X64"] = "1"
    keep_memory()
    app()


def main() -> None:
    """Run the command, and end it with one line at a keyboard interrupt."""
    ending_on_interrupt("jaxvision-fit", start)


if __name__ == "__main__":
    main()
