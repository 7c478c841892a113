"""Strict JAX for the whole suite: no silent promotion, warnings are errors, both dtypes at hand;
and quick compiles, which are most of its time."""

import gc
import itertools
import os
import pickle
import shutil
import threading
import time
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")  # by which tolerances were set, beside a GPU too
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # of workers, whose threads wait for each other

import jax
import jaxlib.version
import jaxtyping
import pytest

from jaxvision.programs import quick_flags

gc.set_threshold(20_000, 20, 100)  # what has been traced is much, and seldom garbage
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

DATA = Path(
    os.environ.get("JAXVISION_DATA", Path(__file__).parents[1].parent / "shared" / "data")
).resolve()
COMPILED_BYTES = 2**30  # what is compiled is kept between runs up to this size


def compiled_folder(config: pytest.Config) -> Path:
    """Where compiled programs are kept between runs: those of this version of XLA alone, and if
    they have grown too many, the newest half of them."""
    kept = config.rootpath / ".pytest_cache" / "xla"
    folder = kept / jaxlib.version.__version__
    folder.mkdir(parents=True, exist_ok=True)
    for other in set(kept.iterdir()) - {folder}:
        shutil.rmtree(other, ignore_errors=True)
    entries = sorted(folder.iterdir(), key=lambda file: file.stat().st_mtime)
    if sum(file.stat().st_size for file in entries) > COMPILED_BYTES:
        for file in entries[: len(entries) // 2]:
            file.unlink(missing_ok=True)
    return folder


def pytest_configure(config: pytest.Config) -> None:
    """The default run compiles quickly; long sweeps and benchmarks as users do. What one worker
    or an earlier run has compiled the others read, but for benchmarks, which time it. All this
    before the first use of XLA, which reads its flags then; workers inherit them."""
    if config.option.markexpr == "benchmark":
        return
    if "not slow" in config.option.markexpr:
        os.environ.setdefault("XLA_FLAGS", quick_flags())
    share_lowering_context()
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(compiled_folder(config))
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # a worker may meet an entry that another is still writing, or that a killed run left half
    # written: then it compiles its own
    config.addinivalue_line("filterwarnings", "ignore:Error (read|writ)ing persistent compilation")


def share_lowering_context() -> None:
    """One MLIR context for some hundred programs. JAX makes one for each, with all its dialects,
    which takes a quarter of the time of an operation that is compiled by itself. A new one now and
    then lets go of the constants that the last one keeps."""
    from jax._src.interpreters import mlir

    make = getattr(mlir, "make_ir_context", None)
    if make is None:  # another JAX: it makes its own
        return
    contexts = (context for _ in itertools.count() for context in itertools.repeat(make(), 256))
    one_at_a_time = threading.Lock()  # fits compile in threads

    def shared() -> object:
        try:
            inside = mlir.ir.Context.current is not None  # a program compiled while one is lowered
        except ValueError:
            inside = False
        if inside:
            return make()
        with one_at_a_time:
            return next(contexts)

    mlir.make_ir_context = shared


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a sweep over like cases the default run takes the first, and those whose ids hold a word
    that the mark names; the others are slow. Slow are hard cases in float64 too, the easier
    precision, and what needs the simulated afternoon."""
    begun = set()
    for item in items:
        hard = item.path.parent.name == "stability" and "float64" in item.name
        if hard or "lab" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)
        sweep = item.get_closest_marker("sweep")
        if sweep is not None and isinstance(item, pytest.Function):
            if item.function in begun and not any(word in item.name for word in sweep.args):
                item.add_marker("slow")
            begun.add(item.function)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The published measurements; tests that need them are skipped, saying so, when absent."""
    if not DATA.is_dir():
        pytest.skip(f"measurements not found at {DATA}; set JAXVISION_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def lab(tmp_path_factory, worker_id):
    """(folder, truth) of one simulated lab afternoon, which the first worker simulates for all."""
    from fitting.demo.lab import simulate_lab

    alone = worker_id == "master"
    base = tmp_path_factory.getbasetemp()
    folder = (base if alone else base.parent) / "lab"
    truth, waited = folder / "truth.pickle", 0
    try:
        folder.mkdir()
    except FileExistsError:  # another worker is at it
        while not truth.exists() and waited < 600:
            time.sleep(1)
            waited += 1
    else:
        part = folder / "truth.part"
        part.write_bytes(pickle.dumps(simulate_lab(folder / "files", seed=11)))
        part.rename(truth)
    return folder / "files", pickle.loads(truth.read_bytes())


@pytest.fixture
def as_for_users():
    """Without the suite's type checks, which would refuse first."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
