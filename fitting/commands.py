"""Options, registration and execution of the sub-commands of `jaxvision-fit`.

For bad input, a command prints one sentence on standard error and exits with status 2. After an
interrupt it exits with status 130. A command prints and writes its results only when all of them
are complete.
"""

import inspect
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial, update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxvision.cli.command_line import command_app, failures_as_sentences, leave, sub_command
from jaxvision.errors import InputError
from jaxvision.programs import compile_quickly, keep_programs

from .reflectance.names import MODELS
from .report.progress import Progress, Reporter, reporting

if TYPE_CHECKING:
    import numpy as np

    from .report.section import Section

COMMAND = "jaxvision-fit"
CHECKPOINT = "checkpoint"
STEPS, WALKERS = 20_000, 64  # default steps and walkers of a chain

failures = partial(
    failures_as_sentences,
    COMMAND,
    interrupted="interrupted; with --out the same command resumes a chain, a check or a study.",
)


@dataclass(frozen=True)
class Options:
    """The options that every sub-command has."""

    out: Annotated[
        Path | None,
        typer.Option(help="Write report, results and chains to this folder.", metavar="DIR"),
    ] = None
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False
    mcmc: Annotated[bool, typer.Option("--mcmc", help="Sample the posterior with emcee.")] = False
    seed: Annotated[int, typer.Option(help="Seed of every random draw.", min=0)] = 0
    steps: Annotated[
        int | None,
        typer.Option(help=f"Largest number of steps of --mcmc (default: {STEPS}).", min=1),
    ] = None
    walkers: Annotated[
        int | None,
        typer.Option(
            help="Number of walkers of --mcmc: at least twice the number of parameters plus two "
            f"(default: {WALKERS}).",
            min=4,
        ),
    ] = None

    @property
    def chain(self) -> dict[str, int]:
        """Return the numbers of steps and walkers of the chain, or an empty dictionary for
        Laplace's approximation.
        """
        if not self.mcmc:
            return {}
        return {"steps": self.steps or STEPS, "walkers": self.walkers or WALKERS}

    def draws(self, kind: str, progress: Progress) -> dict[str, Any]:
        """Return the sampler of a calibration (None for Laplace's approximation) and its seed."""
        from .inference.emcee_run import Emcee

        if not self.mcmc:
            return {"sampling": None, "seed": self.seed}
        chain = self.chain
        sampling = Emcee(
            walkers=chain["walkers"],
            steps=chain["steps"],
            block=min(100, chain["steps"]),
            checkpoint=None if self.out is None else self.out / CHECKPOINT / kind,
            progress=progress,
        )
        return {"sampling": sampling, "seed": self.seed}


Calibrate = Callable[[Reporter], "tuple[list[Section], dict[str, np.ndarray]]"]

app = command_app(
    COMMAND,
    "Calibrate camera noise, camera response and surface reflectance from images.",
    elsewhere=dict.fromkeys(("inspect", "render", "effects"), "jaxvision"),
)


def refuse_mcmc(options: Options, why: str) -> None:
    """Raise if `--mcmc` is given to a command that runs no Markov chain."""
    if options.mcmc:
        raise InputError(f"--mcmc: {why}; leave it out.")


def typed_path(text: str) -> Path:
    """Return a path from the command line. An empty path ends the command, because `Path("")` is
    the working folder.
    """
    if not text:
        leave(COMMAND, "a path is empty; name a folder or a file.", 2)
    return Path(text)


RigPath = Annotated[
    Path,
    typer.Argument(
        help="Folder with a rig.toml (or the rig file itself).", metavar="PATH", parser=typed_path
    ),
]

INDEX_OPTION = typer.Option(help="Index of refraction of Torrance-Sparrow's clear facets.")


def model_option(meaning: str) -> Any:
    """Return the option `--model`, whose help lists the names of the models."""
    return typer.Option(help=f"{meaning} One of {', '.join(MODELS)}.", metavar="MODEL")


def command(*examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that registers a sub-command and shows `examples` in its help. The options
    that all commands share reach the sub-command as one argument, `options`.
    """
    shared = inspect.signature(Options).parameters

    def add(function: Callable[..., None]) -> Callable[..., None]:
        own = dict(inspect.signature(function).parameters)
        del own["options"]

        def run_command(**given: Any) -> None:
            options = Options(**{name: given.pop(name) for name in shared})
            function(options, **given)

        parameters = [p.replace(kind=p.KEYWORD_ONLY) for p in (*own.values(), *shared.values())]
        update_wrapper(run_command, function)
        run_command.__signature__ = inspect.Signature(parameters)
        run_command.__annotations__ = {p.name: p.annotation for p in parameters}
        sub_command(app, *examples)(run_command)
        return function

    return add


def run(
    title: str, path: Path, options: Options, calibrate: Calibrate, *, repeats: bool = False
) -> None:
    """Calibrate, write the requested files, and print the result. If a section has no results, its
    reason is printed and the exit status is that of bad input. With `repeats`, the compiler
    optimises the programs, which pays only if a command runs the same fit many times.
    """
    if not repeats:
        compile_quickly()
    keep_programs()
    with failures(), reporting() as reporter:
        for name in ("steps", "walkers"):
            if getattr(options, name) is not None and not options.mcmc:
                raise InputError(f"--{name}: only a chain takes it; add --mcmc, or leave it out.")
        if options.out is not None and options.out.exists() and not options.out.is_dir():
            raise InputError(f"{options.out}: is a file; give --out a folder.")
        begun = time.perf_counter()
        with _folder(options.out):
            sections, images = calibrate(reporter)
        seconds = time.perf_counter() - begun
        from jaxvision.files.images import write_image

        from .inference.trust import cost_in_words
        from .report.console import output, print_section
        from .report.page import as_json, write_report
        from .report.section import drop_short_chains

        kept = options.out is not None
        costs = [cost_in_words(own.posteriors.values(), seconds, typed=True) for own in sections]
        sections = [
            replace(own, findings=(*own.findings, *filter(None, (cost,))))
            for own, cost in zip(sections, costs, strict=True)
        ]
        sections = [drop_short_chains(section, kept=kept) for section in sections]
        without = [section.failure for section in sections if section.failure]
        if len(without) == len(sections) > 0 and options.out is None:
            raise InputError(without[0])
        settings = {"input": path.name, **asdict(options), **options.chain}
        if options.out is not None:
            with reporter.step("writing the report"):
                for name, pixels in images.items():
                    write_image(options.out / name, pixels)
                write_report(
                    options.out, sections, title=title, seed=options.seed, settings=settings
                )
                if not without:
                    shutil.rmtree(options.out / CHECKPOINT, ignore_errors=True)
    if options.as_json:
        print(as_json(sections, seed=options.seed, settings=settings))
    else:
        console = output()
        for section in sections:
            print_section(console, section)
        if options.out is not None:
            console.print(f"\nReport: {options.out / 'report.html'}")
    if without:
        leave(COMMAND, without[0], 2)


@contextmanager
def _folder(out: Path | None) -> Iterator[None]:
    """Create the output folder before the work starts, so that no result is lost; remove it if the
    work fails and leaves it empty."""
    made = out is not None and not out.exists()
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        if out is not None and made and not any(out.iterdir()):
            out.rmdir()
        raise
