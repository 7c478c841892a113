"""The `jaxvision-fit` command: noise, response and reflectance from a folder of images, and a demo
that simulates such a folder first.

Bad input ends with one sentence on standard error and exit status 2; an interrupt with status 130.
"""

import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import jax
import numpy as np
import typer

from jaxvision.errors import InputError

from .console import Reporter, output, print_section, reporting
from .posterior import Progress, SamplingOptions
from .results import Section

STEPS, WALKERS = 20_000, 64


class Model(StrEnum):
    """Reflectance models that `brdf` reports in full."""

    LAMBERT = "lambert"
    PHONG = "phong"
    GAUSSIAN_LOBE = "gaussian-lobe"


@dataclass(frozen=True)
class Options:
    """What every sub-command shares."""

    out: Path | None
    as_json: bool
    mcmc: bool
    seed: int
    steps: int
    walkers: int

    def sampling(self, kind: str, progress: Progress) -> SamplingOptions | None:
        """How to sample, or None for Laplace."""
        if not self.mcmc:
            return None
        return SamplingOptions(
            seed=self.seed,
            walkers=self.walkers,
            steps=self.steps,
            block=min(100, self.steps),
            checkpoint=None if self.out is None else self.out / CHECKPOINT / kind,
            progress=progress,
        )


CHECKPOINT = "checkpoint"
Images = dict[str, np.ndarray]
Calibrate = Callable[[Reporter], tuple[list[Section], Images]]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Calibrate camera noise, camera response and surface reflectance from images.",
)
RigPath = Annotated[
    Path, typer.Argument(help="Folder with a rig.toml (or the rig file itself).", metavar="PATH")
]
Out = Annotated[
    Path | None,
    typer.Option("--out", help="Write report, results and chains to this folder.", metavar="DIR"),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Mcmc = Annotated[
    bool, typer.Option("--mcmc", help="Sample the posterior with emcee instead of Laplace.")
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of every random draw.", min=0)]
Steps = Annotated[int, typer.Option("--steps", help="Most steps of a chain (--mcmc).", min=1)]
Walkers = Annotated[int, typer.Option("--walkers", help="Walkers (--mcmc).", min=4)]


@app.command()
def noise(
    path: Annotated[
        Path,
        typer.Argument(help="Rig folder, or a CSV of sums per exposure.", metavar="PATH"),
    ],
    bits: Annotated[
        int | None, typer.Option(help="ADC bits of a CSV's camera.", min=1, max=16)
    ] = None,
    channel: Annotated[
        str, typer.Option(help="Site of a Bayer mosaic to use (default: the first green).")
    ] = "",
    out: Out = None,
    as_json: Json = False,
    mcmc: Mcmc = False,
    seed: Seed = 0,
    steps: Steps = STEPS,
    walkers: Walkers = WALKERS,
) -> None:
    """Photon transfer: the EMVA 1288 sheet, each figure with its standard error."""
    from .noise import calibrate_noise, noise_section
    from .photon_transfer import read_photon_transfer

    options = Options(out, as_json, mcmc, seed, steps, walkers)

    def calibrate(reporter: Reporter) -> tuple[list[Section], Images]:
        with reporter.step("reading frames"):
            measurement = read_photon_transfer(path, bits=bits, channel=channel)
        with reporter.step("fitting photon transfer") as progress:
            sampling = options.sampling("noise", progress)
            calibration = calibrate_noise(measurement, sampling=sampling, seed=seed)
        return [noise_section(calibration)], {}

    _run("Photon transfer", path, options, calibrate)


@app.command()
def response(
    path: RigPath,
    out: Out = None,
    as_json: Json = False,
    mcmc: Mcmc = False,
    seed: Seed = 0,
    steps: Steps = STEPS,
    walkers: Walkers = WALKERS,
) -> None:
    """Gamma, the whole response curve and the merged radiance map of an exposure stack."""
    from .exposures import read_exposure_stack
    from .response import calibrate_response, radiance_images, response_section
    from .rig import load_rig

    options = Options(out, as_json, mcmc, seed, steps, walkers)

    def calibrate(reporter: Reporter) -> tuple[list[Section], Images]:
        with reporter.step("reading exposures"):
            stack = read_exposure_stack(load_rig(path))
        with reporter.step("fitting response") as progress:
            sampling = options.sampling("response", progress)
            calibration = calibrate_response(stack, sampling=sampling, seed=seed)
        images = {
            f"radiance_{group}.exr" if group else "radiance.exr": radiance
            for group, radiance in radiance_images(calibration).items()
        }
        return [response_section(calibration)], images

    _run("Camera response", path, options, calibrate)


@app.command()
def brdf(
    path: RigPath,
    model: Annotated[Model, typer.Option(help="Model to report in full.")] = Model.PHONG,
    ambient: Annotated[
        bool, typer.Option("--ambient", help="Fit a constant ambient light per channel.")
    ] = False,
    gamma: Annotated[
        bool, typer.Option("--fit-gamma", help="Fit the encoding exponent of the images.")
    ] = False,
    minimum_cosine: Annotated[
        float, typer.Option(help="Leave out samples lit at a smaller n.l.", min=0.0)
    ] = 0.0,
    out: Out = None,
    as_json: Json = False,
    mcmc: Mcmc = False,
    seed: Seed = 0,
    steps: Steps = STEPS,
    walkers: Walkers = WALKERS,
) -> None:
    """Reflectance of a known shape under known lights, with models compared on held-out lights."""
    from .reflectance import calibrate_reflectance, reflectance_section
    from .reflectance_observation import read_reflectance_observation
    from .rig import load_rig

    options = Options(out, as_json, mcmc, seed, steps, walkers)

    def calibrate(reporter: Reporter) -> tuple[list[Section], Images]:
        with reporter.step("reading images"):
            observation = read_reflectance_observation(load_rig(path))
        with reporter.step("fitting reflectance") as progress:
            sampling = options.sampling("brdf", progress)
            calibration = calibrate_reflectance(
                observation,
                model=model.value,
                sampling=sampling,
                ambient=ambient,
                fit_gamma=gamma,
                minimum_cosine=minimum_cosine,
            )
        return [reflectance_section(calibration)], {}

    _run("Reflectance", path, options, calibrate)


@app.command()
def demo(
    out: Annotated[
        Path, typer.Option("--out", help="Where images and report go.", metavar="DIR")
    ] = Path("jaxvision-demo"),
    as_json: Json = False,
    mcmc: Mcmc = False,
    seed: Seed = 0,
    steps: Steps = STEPS,
    walkers: Walkers = WALKERS,
) -> None:
    """Simulate a lab afternoon to files, calibrate from the files alone, compare with the truth."""
    from .demo import calibrate_lab, demo_section
    from .lab import simulate_lab

    options = Options(out, as_json, mcmc, seed, steps, walkers)

    def calibrate(reporter: Reporter) -> tuple[list[Section], Images]:
        with reporter.step("simulating the lab") as progress:
            truth = simulate_lab(out / "lab", seed=seed, progress=progress)
        sections = calibrate_lab(out / "lab", reporter.step, options.sampling)
        return [demo_section(sections, truth), *sections], {}

    _run("A simulated lab afternoon", out, options, calibrate)


def _run(title: str, path: Path, options: Options, calibrate: Calibrate) -> None:
    """Calibrates, writes what was asked for, prints the result."""
    from jaxvision.io import write_image

    from .report import as_json, write_report

    with _failures_as_sentences(), reporting() as reporter:
        if options.out is not None and options.out.exists() and not options.out.is_dir():
            raise InputError(f"{options.out}: is a file; give --out a folder.")
        sections, images = calibrate(reporter)
        settings = {"input": path.name, **asdict(options)}
        if options.out is not None:
            with reporter.step("writing the report"):
                for name, pixels in images.items():
                    write_image(options.out / name, pixels)
                write_report(
                    options.out, sections, title=title, seed=options.seed, settings=settings
                )
                shutil.rmtree(options.out / CHECKPOINT, ignore_errors=True)
    if options.as_json:
        print(as_json(sections, seed=options.seed, settings=settings))
        return
    console = output()
    for section in sections:
        print_section(console, section)
    if options.out is not None:
        console.print(f"\nReport: {options.out / 'report.html'}")


@contextmanager
def _failures_as_sentences() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        _leave(str(error), 2)
    except OSError as error:
        where = error.filename or "a file"
        _leave(f"{where}: {error.strerror or error}; choose another path or make room.", 2)
    except KeyboardInterrupt:
        _leave("interrupted; with --mcmc and --out the same command resumes.", 130)


def _leave(sentence: str, status: int) -> NoReturn:
    print(f"jaxvision-fit: {sentence}", file=sys.stderr)
    raise typer.Exit(status)


def main() -> None:
    """Entry point. Calibration needs double precision, so it is switched on here, never on
    import."""
    jax.config.update("jax_enable_x64", True)
    app()
