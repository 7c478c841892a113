"""Tests how the commands compile: settings of the user are kept, and incomplete entries of a killed
run do no harm."""

import os
import subprocess
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from fitting.inference import compiled
from jaxvision import programs

OURS = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")


@pytest.fixture
def untouched(monkeypatch, tmp_path):
    """Return an empty cache folder, in an environment without settings."""
    for name in (*OURS, "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"):
        monkeypatch.setenv(name, "")  # restored after the test
        monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def test_flags_are_set_only_where_the_user_sets_none_and_xla_knows_them(untouched, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "")
    programs.compile_quickly()
    assert os.environ["XLA_FLAGS"] == ""
    assert programs.short_run_options() is programs.medium_run_options() is None
    monkeypatch.delenv("XLA_FLAGS")
    monkeypatch.setattr(programs, "version", lambda name: "0.99.0")
    programs.compile_quickly()
    assert "XLA_FLAGS" not in os.environ
    monkeypatch.setattr(programs, "version", lambda name: "0.10.9")
    monkeypatch.setattr(programs, "find_spec", lambda name: name)  # a pretended accelerator
    programs.compile_quickly()
    assert "XLA_FLAGS" not in os.environ
    monkeypatch.setattr(programs, "find_spec", lambda name: None)
    assert programs.short_run_options()["xla_backend_optimization_level"] == 0
    moderate = programs.short_run_options() | {"xla_backend_optimization_level": 1}
    assert programs.medium_run_options() == moderate
    programs.compile_quickly()
    assert programs.medium_run_options() == moderate  # whatever the flags for all programs
    assert programs.short_run_options() is None  # the flags already say so for all programs
    assert "optimization_level=0" in os.environ["XLA_FLAGS"]
    assert "fusion_emitters=false" in os.environ["XLA_FLAGS"]
    monkeypatch.delenv("XLA_FLAGS")
    monkeypatch.setattr(programs, "version", lambda name: "0.12.0.1")  # exits at that flag
    programs.compile_quickly()
    assert "fusion_emitters" not in os.environ["XLA_FLAGS"]


def test_a_program_compiled_briefly_may_be_part_of_another(monkeypatch):
    monkeypatch.setattr(programs, "find_spec", lambda name: None)  # no accelerator
    monkeypatch.setattr(compiled, "short_run_options", programs.quick_options)
    assert programs.quick_options()
    cubed = compiled.compiled_briefly(lambda x, power: x**power)
    x = jnp.array([1.0, 2.0])
    np.testing.assert_array_equal(cubed(x, 3), [1, 8])
    np.testing.assert_array_equal(jax.jit(lambda x: cubed(x, 3) + 1)(x), [2, 9])
    np.testing.assert_array_equal(jax.grad(lambda x: cubed(x, 3).sum())(x), [3, 12])
    np.testing.assert_array_equal(jax.vmap(lambda x: cubed(x, power=3))(x), [1, 8])


def test_programs_are_kept_where_they_may_be(untouched, monkeypatch):
    programs.keep_programs()
    folder = os.environ.pop("JAX_COMPILATION_CACHE_DIR")
    assert folder.startswith(str(untouched / "jaxvision"))
    assert os.path.isdir(folder)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "")
    programs.keep_programs()
    assert os.environ.pop("JAX_COMPILATION_CACHE_DIR") == ""
    (untouched / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(untouched / "file"))
    programs.keep_programs()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


def test_of_too_many_programs_the_older_half_is_removed(untouched, monkeypatch):
    other = untouched / "jaxvision" / "0.1-ab"
    other.mkdir(parents=True)
    for age in range(10):
        (other / f"{age}").write_bytes(b"x" * 100)
        os.utime(other / f"{age}", (2e9 - age, 2e9 - age))
    monkeypatch.setattr(programs, "_MOST_BYTES", 1000)
    programs.keep_programs()
    assert len(list(other.iterdir())) == 10
    monkeypatch.setattr(programs, "_MOST_BYTES", 999)
    programs.keep_programs()
    del os.environ["JAX_COMPILATION_CACHE_DIR"]
    programs.keep_programs()
    assert sorted(path.name for path in other.iterdir()) == ["0", "1", "2", "3", "4"]


class _Own(NamedTuple):
    """A record type that the package does not know."""

    x: jax.Array


@pytest.fixture
def kept(untouched, monkeypatch):
    """Return a folder with the stored program of 2 x + 1, and a function that calls it again."""
    monkeypatch.setattr(programs, "_keeps_whole", False)
    programs.keep_programs()

    def call(x, about="2 x + 1", *, traced=False):
        traces = []

        def function(x):
            traces.append(x)
            return 2 * jax.tree.leaves(x)[0] + 1, jnp.zeros(3)

        value, _ = programs.store_whole(jax.jit(function), about)(x)
        assert bool(traces) == traced
        return value

    call(jnp.arange(3.0), traced=True)
    (file,) = untouched.rglob("whole-*")
    yield call, file
    del os.environ["JAX_COMPILATION_CACHE_DIR"]


def test_a_whole_program_is_read_without_tracing(kept):
    call, _ = kept
    np.testing.assert_array_equal(call(jnp.array([5.0, 6.0, 7.0])), [11, 13, 15])
    scene = jv.Sphere([0, 0, 0], 1.0)
    call(scene, traced=True)
    assert call(jv.Sphere([2, 0, 0], 1.0))[0] == 5


def test_another_program_is_traced(kept, monkeypatch):
    call, _ = kept
    np.testing.assert_array_equal(call(jnp.arange(4.0), traced=True), [1, 3, 5, 7])
    call(jnp.arange(3), traced=True)
    call(jnp.arange(3.0), "of another setting", traced=True)
    call(_Own(jnp.arange(3.0)), traced=True)
    call(_Own(jnp.arange(3.0)), traced=True)  # a program with an unknown type is never stored
    monkeypatch.setattr(programs, "source_digest", lambda: "another source")
    call(jnp.arange(3.0), traced=True)
    monkeypatch.setattr(programs, "_keeps_whole", False)
    call(jnp.arange(3.0), traced=True)


@pytest.mark.parametrize(
    "harm", ["cut", "changed", "of another shape", "writable", "of another user"]
)
def test_a_damaged_or_foreign_stored_program_is_compiled_again(kept, harm, monkeypatch):
    call, file = kept
    if harm == "cut":
        file.write_bytes(file.read_bytes()[:1000])
    elif harm == "changed":
        data = bytearray(file.read_bytes())
        data[500] ^= 1
        file.write_bytes(data)
    elif harm == "of another shape":
        call(jnp.arange(4.0), traced=True)
        (other,) = set(file.parent.glob("whole-*")) - {file}
        file.write_bytes(other.read_bytes())
    elif harm == "writable":
        file.chmod(0o666)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: file.stat().st_uid + 1)
    np.testing.assert_array_equal(call(jnp.arange(3.0), traced=True), [1, 3, 5])
    if harm != "of another user":
        call(jnp.arange(3.0))  # it was written again


PROGRAM = """
from jaxvision.programs import compile_quickly, keep_programs
compile_quickly()
keep_programs()
import jax.numpy as jnp
print(float(jnp.linspace(0, 1, 7).sum()))
"""


@pytest.mark.slow
def test_half_written_programs_are_compiled_anew(untouched):
    def run():
        environment = dict(os.environ)
        return subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True
        )

    first = run()
    kept = list(untouched.rglob("*-cache"))
    assert len(kept) == 2
    for entry in kept:
        entry.write_bytes(entry.read_bytes()[:20])
    again = run()
    assert (first.stdout, first.stderr) == ("3.5\n", "")
    assert (again.stdout, again.stderr) == ("3.5\n", "")


def test_programs_are_made_for_the_default_device(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert not programs.targets_cpu()
    for named in ("cpu", jax.devices("cpu")[0]):
        with jax.default_device(named):
            assert programs.targets_cpu()
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert programs.targets_cpu()
