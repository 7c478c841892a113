"""Settings for compiling programs: for a processor or an accelerator, with compiled programs kept
between runs, and with quick compilation if most programs run once. JAX and XLA read the last two
from the environment before their first use.
"""

import hashlib
import os
import platform
import sys
import warnings
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

Options = dict[str, bool | int]  # of the compiler, by XLA's names

_QUICKLY: Options = {
    "xla_backend_optimization_level": 0,
    "xla_cpu_parallel_codegen_split_count": 1,
}
_OLDER_EMITTERS: Options = {"xla_cpu_use_fusion_emitters": False}
_HAVE_OLDER_EMITTERS = ("0.10.", "0.11.0", "0.11.1")  # versions of jaxlib
# XLA ends the process at a flag that it does not know, so it gets none in versions not tried yet.
_TRIED = ("0.10.", "0.11.", "0.12.")
_MOST_BYTES = 2**29


def on_processor() -> bool:
    """Whether programs are now traced for a processor and not for an accelerator, from
    `jax.default_device` or else the devices that JAX found. The place of the arguments is not known
    during tracing."""
    import jax  # here: what else this module does comes before JAX's first use

    device = getattr(jax.config, "jax_default_device", None)
    return (getattr(device, "platform", device) or jax.default_backend()) == "cpu"


def quick_options() -> Options:
    """XLA's options for programs that run once and take most of their time to compile: no
    optimisation, and the older emitters if this XLA still has them. Fits of 470,000 samples run a
    fifth longer with them. They are empty for an untested version, and with an accelerator's
    plugin."""
    if not version("jaxlib").startswith(_TRIED) or find_spec("jax_plugins") is not None:
        return {}
    older = version("jaxlib").startswith(_HAVE_OLDER_EMITTERS)
    return _QUICKLY | (_OLDER_EMITTERS if older else {})


def quick_flags() -> str:
    """`quick_options` in the form for XLA_FLAGS."""
    return " ".join(f"--{name}={str(x).lower()}" for name, x in quick_options().items())


def compile_quickly() -> None:
    """Compile all programs of this process with `quick_options`, unless the user has set XLA_FLAGS
    (even if empty)."""
    if quick_flags():
        os.environ.setdefault("XLA_FLAGS", quick_flags())


def briefly() -> Options | None:
    """`compiler_options` of `jax.jit` for a program that runs for less time than XLA takes to
    optimise it: `quick_options`, unless the user has set XLA_FLAGS (even if empty)."""
    return None if "XLA_FLAGS" in os.environ else quick_options() or None


def thoroughly() -> Options | None:
    """`compiler_options` of `jax.jit` for a long-running program, which is compiled with
    optimisation even after `compile_quickly`; read them after that call."""
    flags = os.environ.get("XLA_FLAGS", "")
    if not flags or flags != quick_flags():
        return None
    emitters = {name: True for name in _OLDER_EMITTERS if name in quick_options()}
    return {"xla_backend_optimization_level": 3, **emitters}


def keep_programs() -> None:
    """Keep compiled programs for the next run in the user's cache folder, unless
    JAX_COMPILATION_CACHE_DIR names another folder or is empty. If the folder is not writable,
    nothing is kept."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = kept_in()
    if not folder:
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    # Another process may be writing an entry, or have been killed at it: then it is compiled.
    warnings.filterwarnings("ignore", "Error (reading|writing) persistent compilation cache")


def kept_in() -> str:
    """The folder in which the commands keep compiled programs; empty if there is none."""
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return os.environ["JAX_COMPILATION_CACHE_DIR"]
    try:
        return str(_folder())
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return ""


def _folder() -> Path:
    """The folder for programs of this version of XLA and this processor. If there are too many
    programs of all versions, the older half is deleted."""
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxvision"
    folder = kept / f"{version('jaxlib')}-{_processor()}"
    folder.mkdir(parents=True, exist_ok=True)
    files = [(path.stat(), path) for path in kept.glob("*/*")]
    if sum(status.st_size for status, _ in files) > _MOST_BYTES:
        for _, path in sorted(files, key=lambda file: file[0].st_mtime)[: len(files) // 2]:
            path.unlink(missing_ok=True)
    return folder


def _processor() -> str:
    """An identifier of the processor in eight letters, because machines with different programs may
    share a home folder."""
    described = f"{sys.platform} {platform.machine()} {platform.processor()}"
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        described += next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        pass
    return hashlib.sha256(described.encode()).hexdigest()[:8]
