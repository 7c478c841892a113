"""Choose how programs are compiled: with options for a CPU or an accelerator, with a cache of
compiled programs between runs, and with quick compilation if most programs run once. JAX and XLA
read the settings of the cache and of quick compilation from the environment before their first use.

JAX's cache stores what XLA compiles, but every process traces and lowers each program again.
`store_whole` stores the compiled program under a name that is known before tracing.
"""

import dataclasses
import hashlib
import os
import pickle
import platform
import sys
import warnings
import zlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

Options = dict[str, bool | int | str]  # options of the compiler, by XLA's names

_QUICKLY: Options = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,
}
_OLDER_EMITTERS: Options = {"xla_cpu_use_fusion_emitters": False}
_HAVE_OLDER_EMITTERS = ("0.10.", "0.11.0", "0.11.1")  # versions of jaxlib
# Vectors of 512 bits, if the processor has them, save a tenth to a fifth of the time for tracing
# rays.
_OF_RAYS: Options = {"xla_cpu_prefer_vector_width": 512}
# With this option, XLA does not store, for all rays, values that are equal at all vertices of a
# path. The Cornell box then takes two thirds of the time, and other scenes as long as before.
# Programs without a loop over vertices take twice to four times as long.
_OF_PATHS: Options = {"xla_disable_hlo_passes": "while-loop-invariant-code-motion"}
# XLA ends the process at an unknown flag, so untested versions get no flags.
_TRIED = ("0.10.", "0.11.", "0.12.")
_MOST_BYTES = 2**29
_OWN = ("jaxvision", "fitting")  # packages whose files `source_digest` covers
_BESIDE = ("jax", "jaxlib", "numpy", "equinox")  # other modules on which a program depends
_WRITABLE_BY_OTHERS = 0o022
# Only commands set it: a user of the library may change values on which programs depend
_keeps_whole = False


def targets_cpu() -> bool:
    """Return whether programs are now traced for a CPU. The answer follows from
    `jax.default_device` if it is set, and otherwise from the devices that JAX found."""
    import jax  # imported here, because the rest of this module runs before JAX's first use

    device = getattr(jax.config, "jax_default_device", None)
    return (getattr(device, "platform", device) or jax.default_backend()) == "cpu"


def quick_options() -> Options:
    """Return XLA's options for programs that run once and take longer to compile than to run. The
    options turn off optimisation and select the older emitters. For an untested version of jaxlib,
    or with an accelerator's plugin, there are no options."""
    if not _is_tried():
        return {}
    older = version("jaxlib").startswith(_HAVE_OLDER_EMITTERS)
    return _QUICKLY | (_OLDER_EMITTERS if older else {})


def _is_tried() -> bool:
    return version("jaxlib").startswith(_TRIED) and find_spec("jax_plugins") is None


def ray_options(*, paths: bool) -> Options | None:
    """Return `compiler_options` of `jax.jit` for a program that computes many rays, or many paths.
    Return None if the user has set XLA_FLAGS (even if empty), and for an untested version of
    jaxlib.
    """
    if not _is_tried() or "XLA_FLAGS" in os.environ:
        return None
    return _OF_RAYS | (_OF_PATHS if paths else {})


def quick_flags() -> str:
    """Return `quick_options` as a string for XLA_FLAGS."""
    return " ".join(f"--{name}={str(x).lower()}" for name, x in quick_options().items())


def compile_quickly() -> None:
    """Compile all programs of this process with `quick_options`, unless the user has set XLA_FLAGS
    (even if empty)."""
    if quick_flags():
        os.environ.setdefault("XLA_FLAGS", quick_flags())


def short_run_options() -> Options | None:
    """Return `compiler_options` of `jax.jit` for a program that runs for less time than XLA takes
    to optimise it: `quick_options`, or None if the user has set XLA_FLAGS (even if empty).
    """
    return None if "XLA_FLAGS" in os.environ else quick_options() or None


def medium_run_options() -> Options | None:
    """Return `compiler_options` of `jax.jit` for a program that runs about as long as XLA takes to
    optimise it: `quick_options` with optimisation level 1, or None if the user has set XLA_FLAGS.
    """
    given, options = os.environ.get("XLA_FLAGS"), quick_options()
    ours = given is None or given == quick_flags()
    return options | {"xla_backend_optimization_level": 1} if ours and options else None


def keep_programs() -> None:
    """Store compiled programs in the user's cache folder if it is writable, unless
    JAX_COMPILATION_CACHE_DIR is set.
    """
    global _keeps_whole
    _keeps_whole = True
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = program_folder()
    if not folder:
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    # If another process is writing an entry, or was killed while writing it, the program is
    # compiled.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")


def program_folder() -> str:
    """Return the folder in which the commands store compiled programs, or an empty string if there
    is none.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return os.environ["JAX_COMPILATION_CACHE_DIR"]
    try:
        return str(_folder())
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return ""


def _folder() -> Path:
    """Create and return the folder for programs of this version of XLA and this processor. If the
    programs of all versions take too many bytes, delete the older half.
    """
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxvision"
    folder = kept / f"{version('jaxlib')}-{_processor()}"
    folder.mkdir(parents=True, exist_ok=True)
    files = [(path.stat(), path) for path in kept.glob("*/*")]
    if sum(status.st_size for status, _ in files) > _MOST_BYTES:
        for _, path in sorted(files, key=lambda file: file[0].st_mtime)[: len(files) // 2]:
            path.unlink(missing_ok=True)
    return folder


def _processor() -> str:
    """Return an identifier of the processor in eight letters, because machines with different
    processors may share a home folder.
    """
    described = f"{sys.platform} {platform.machine()} {platform.processor()}"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        described += next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        pass
    return hashlib.sha256(described.encode()).hexdigest()[:8]


@cache
def source_digest() -> str:
    """Return a digest of the files of this distribution. The digest differs between builds of one
    version."""
    here, found = Path(__file__).parent, hashlib.sha256()
    for package in _OWN:
        for file in sorted((here.parent / package).rglob("*")):
            if file.is_file() and file.suffix != ".pyc":
                found.update(f"{file.relative_to(here.parent).as_posix()}\n".encode())
                found.update(file.read_bytes())
    return found.hexdigest()[:8]


def store_whole(function: Any, about: str) -> Callable[..., Any]:
    """Wrap a `jax.jit` of arrays and this distribution's records so that the next run reads the
    compiled program without tracing. `about` describes everything else on which the program
    depends.
    """
    import jax

    programs: dict[str, Callable[..., Any]] = {}

    def call(*args: Any) -> Any:
        folder = Path(program_folder()) if _keeps_whole and program_folder() else None
        if folder is None or not folder.is_dir():
            return function(*args)
        try:
            name = _name_of_program(args, about)
        # Also if another version of JAX stores its settings elsewhere
        except (AttributeError, KeyError, TypeError):
            return function(*args)
        if name not in programs:
            kept = _read_program(folder / name, args)
            if kept is not None:
                # A program that this machine cannot run is compiled again
                with suppress(Exception):
                    found = jax.block_until_ready(kept(*args))
                    programs[name] = kept
                    return found
            programs[name] = _compile_to_file(folder / name, function.lower(*args))
        return programs[name](*args)

    return call


def _name_of_program(args: tuple[Any, ...], about: str) -> str:
    """Return a file name, a digest of everything on which the program depends. Raise `TypeError` if
    the program depends on a value of an unknown type."""
    import jax

    if not targets_cpu() or jax.device_count() > 1 or jax.config.values["jax_disable_jit"]:
        raise TypeError("only programs for one processor are kept whole.")
    flags = {n: x for n, x in os.environ.items() if n.startswith(("XLA", "JAXVISION"))}
    settings = {n: x for n, x in jax.config.values.items() if "cache" not in n}
    known = (
        *(f"{name} {sys.modules[name].__version__}" for name in _BESIDE if name in sys.modules),
        sys.version,
        source_digest(),
        _processor(),
        str(getattr(os, "geteuid", int)()),  # users may share a folder
        repr(sorted(flags.items())),
        repr(sorted(settings.items())),
        about,
        *(_describe(x) for x in args),
    )
    return f"whole-{hashlib.sha256(chr(0).join(known).encode()).hexdigest()}"


def _describe(x: Any, *, static: bool = False) -> str:
    """Describe the properties of an argument on which a program depends: dtype and shape of arrays,
    and the value of everything else. Raise `TypeError` for types that this distribution does not
    define.
    """
    if type(x) in (tuple, list):
        return f"({','.join(_describe(part, static=static) for part in x)})"
    if dataclasses.is_dataclass(x) and type(x).__module__.partition(".")[0] in _OWN:
        parts = (
            _describe(getattr(x, field.name), static=static or field.metadata.get("static", False))
            for field in dataclasses.fields(x)
        )
        return f"{type(x).__module__}.{type(x).__qualname__}({','.join(parts)})"
    if x is None or (static and type(x) in (bool, int, float, str)):
        return repr(x)
    if not static and (dtype := getattr(x, "dtype", None)) is not None:
        return f"{dtype}{getattr(x, 'shape', None)}{getattr(x, 'weak_type', False)}"
    raise TypeError(f"{type(x)} is not known.")


def _compile_to_file(path: Path, lowered: Any) -> Any:
    """Compile a program, write it to the file completely or not at all, and return it."""
    import jax
    from jax.experimental.compilation_cache.compilation_cache import reset_cache
    from jax.experimental.serialize_executable import serialize

    # XLA 0.10 would write the program without its functions if JAX's cache had read the program.
    before = jax.config.values["jax_enable_compilation_cache"]
    try:
        jax.config.update("jax_enable_compilation_cache", False)
        reset_cache()
        compiled = lowered.compile()
    finally:
        jax.config.update("jax_enable_compilation_cache", before)
        reset_cache()
    with suppress(Exception):  # a program that cannot be stored is compiled again next time
        program, _, results = serialize(compiled)
        data = zlib.compress(pickle.dumps((program, results)), level=1)
        with NamedTemporaryFile(dir=path.parent, delete=False) as file:  # only its owner may write
            file.write(hashlib.sha256(data).digest() + data)
        os.replace(file.name, path)
    return compiled


def _read_program(path: Path, args: tuple[Any, ...]) -> Any:
    """Read a compiled program from a file. Return None if the file is missing or damaged, or if
    another user could have written it, because loading a program can run any code in the file.
    """
    import jax
    from jax.experimental.serialize_executable import deserialize_and_load

    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            own = not hasattr(os, "geteuid") or status.st_uid == os.geteuid()
            if not own or status.st_mode & _WRITABLE_BY_OTHERS:
                return None
            digest, data = file.read(32), file.read()
        if hashlib.sha256(data).digest() != digest:
            return None
        program, results = pickle.loads(zlib.decompress(data))
        return deserialize_and_load(program, jax.tree.structure((args, {})), results)
    except Exception:  # no file, or a program that this machine cannot load
        return None
