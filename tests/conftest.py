"""Strict JAX for all tests: no silent promotion, warnings are errors, and both dtypes are
available. Quick compilation, because compilation takes most of the time."""

import gc
import itertools
import os
import pickle
import shutil
import threading
import time
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")  # for which tolerances were set
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # workers' threads would wait for each other

import jax
import jaxlib.version
import jaxtyping
import pytest

from jaxvision.programs import quick_flags

gc.set_threshold(20_000, 20, 100)  # tracing makes many objects, which are seldom garbage
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

DATA = Path(
    os.environ.get("JAXVISION_DATA", Path(__file__).parents[1].parent / "shared" / "data")
).resolve()
COMPILED_BYTES = 2**30  # maximum size of the compiled programs that are kept between runs


def compiled_folder(config: pytest.Config) -> Path:
    """Return the folder where compiled programs are kept between runs. It is for this version of
    XLA only, and if it has grown too large, only the newest half is kept."""
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
    """Set flags before the first use of XLA, which reads them then; workers inherit them. The
    default run compiles quickly, and slow tests and benchmarks as for users. Programs compiled by
    one worker or an earlier run are shared, except in benchmarks, which time compilation."""
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
    # A worker may read an entry that another is still writing, or that a killed run left
    # incomplete. Then it compiles the program itself.
    config.addinivalue_line("filterwarnings", "ignore:Error (read|writ)ing persistent compilation")


def share_lowering_context() -> None:
    """Share one MLIR context between 256 programs. JAX makes one for each program, with all its
    dialects, which takes a quarter of the time of a small program. A new context now and then frees
    the constants that the last one keeps."""
    from jax._src.interpreters import mlir

    make = getattr(mlir, "make_ir_context", None)
    if make is None:  # another version of JAX
        return
    contexts = (context for _ in itertools.count() for context in itertools.repeat(make(), 256))
    one_at_a_time = threading.Lock()  # fits compile in threads

    def shared() -> object:
        try:
            inside = mlir.ir.Context.current is not None  # another program is being lowered
        except ValueError:
            inside = False
        if inside:
            return make()
        with one_at_a_time:
            return next(contexts)

    mlir.make_ir_context = shared


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests as slow. Of a sweep over similar cases the default run takes the first, and those
    whose ids contain a word that the mark names; the others are slow. Hard cases in float64, the
    easier precision, and tests that need the simulated afternoon are slow, too."""
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
    """Return the folder of published measurements, or skip the test with a reason if there is
    none."""
    if not DATA.is_dir():
        pytest.skip(f"measurements not found at {DATA}; set JAXVISION_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def lab(tmp_path_factory, worker_id):
    """Return (folder, true values) of one simulated lab afternoon, which the first worker simulates
    for all."""
    from fitting.demo.lab import simulate_lab

    alone = worker_id == "master"
    base = tmp_path_factory.getbasetemp()
    folder = (base if alone else base.parent) / "lab"
    truth, waited = folder / "truth.pickle", 0
    try:
        folder.mkdir()
    except FileExistsError:  # another worker is simulating it
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
    """Switch off the suite's type checks, which would refuse bad input before the library does."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
