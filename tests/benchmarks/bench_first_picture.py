"""Time whole processes that a user of the command waits for.

    pytest tests/benchmarks/bench_first_picture.py -m benchmark -s

The processes are the first picture of the Cornell box (256 x 256 pixels, 64 samples, paths of up to
6 segments, as EXR and PNG), the import with a first small call, help, and the answer to a wrong
path. The picture is timed with empty caches and with the compiled programs of an earlier run, and
Mitsuba 3 (`llvm_ad_rgb`) for comparison."""

import atexit
import os
import subprocess
import sys
from functools import partial
from shutil import rmtree
from tempfile import TemporaryDirectory, mkdtemp

import pytest
from mitsuba_scenes import mitsuba
from turns import in_turns

ROUNDS = 3
COMMAND = "from {}.__main__ import main; main()"
RENDER = "render cornell_box --out a.exr --resolution 256,256 --samples 64 --depth 6 --fresh"
MITSUBA = """
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
box = mi.cornell_box()
box["integrator"] = {"type": "path", "max_depth": 6, "rr_depth": 1000}
picture = mi.render(mi.load_dict(box), spp=64)
mi.Bitmap(picture).write("a.exr")
mi.util.write_bitmap("a.png", picture)
"""
CALL = """
import numpy as np
import jaxvision as jv
up, wi = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])
print(jv.lambert_shading(up, wi, np.array([0.1])))
"""
OURS = ("JAX", "XLA", "XDG")  # variables that set how to compile and where programs are stored
# pip compiles installed sources to bytecode; sources in a working folder are compiled here instead
BYTECODE = mkdtemp()
atexit.register(partial(rmtree, BYTECODE, ignore_errors=True))


def process(program, *arguments, home, status=0):
    """Run a process to its end as a user with this home folder."""
    environment = {name: x for name, x in os.environ.items() if not name.startswith(OURS)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    environment |= {"HOME": str(home), "PYTHONPATH": os.pathsep.join(sys.path)}
    environment |= {"PYTHONPYCACHEPREFIX": BYTECODE}
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], env=environment, cwd=home, capture_output=True
    )
    assert done.returncode == status, done.stderr.decode()


def by_a_new_user(*command):
    with TemporaryDirectory() as home:
        process(*command, home=home)


@pytest.mark.benchmark
def test_first_picture(tmp_path):
    mitsuba()
    ours = COMMAND.format("jaxvision"), *RENDER.split()
    rivals = {
        "ours, first": partial(by_a_new_user, *ours),
        "Mitsuba, first": partial(by_a_new_user, MITSUBA),
        "ours, again": partial(process, *ours, home=tmp_path),
        "Mitsuba, again": partial(process, MITSUBA, home=tmp_path),
    }
    _, seconds = in_turns(rivals, rounds=ROUNDS, settled=0)
    for name, taken in seconds.items():
        print(f"{name:16s} {taken:6.2f} s")


@pytest.mark.benchmark
def test_import_and_a_small_call(tmp_path):
    rivals = {
        "import": partial(process, "import jaxvision", home=tmp_path),
        "first call": partial(process, CALL, home=tmp_path),
        "import jax": partial(process, "import jax", home=tmp_path),
    }
    _, seconds = in_turns(rivals, rounds=7, settled=0)
    for name, taken in seconds.items():
        print(f"{name:14s} {taken:6.2f} s")


@pytest.mark.benchmark
@pytest.mark.parametrize("package", ["jaxvision", "fitting"])
def test_help_and_a_wrong_path(package, tmp_path):
    program = COMMAND.format(package)
    rivals = {
        "help": partial(process, program, "--help", home=tmp_path),
        "a wrong path": partial(process, program, "accuracy", "no", home=tmp_path, status=2),
    }
    _, seconds = in_turns(rivals, rounds=7, settled=0)
    for name, taken in seconds.items():
        print(f"{package:10s} {name:14s} {taken:6.2f} s")
