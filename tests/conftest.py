"""Strict JAX for the whole suite: no silent promotion, warnings are errors, both dtypes at hand."""

import os
from pathlib import Path

os.environ.setdefault("JAX_ENABLE_X64", "1")

import jax
import pytest

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

DATA = Path(
    os.environ.get("JAXVISION_DATA", Path(__file__).parents[1].parent / "shared" / "data")
).resolve()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The published measurements; tests that need them are skipped, saying so, when absent."""
    if not DATA.is_dir():
        pytest.skip(f"measurements not found at {DATA}; set JAXVISION_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """(folder, truth) of one simulated lab afternoon."""
    from fitting.lab import simulate_lab

    folder = tmp_path_factory.mktemp("lab")
    return folder, simulate_lab(folder, seed=11)
