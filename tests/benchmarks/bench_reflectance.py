"""Time `jaxvision-fit brdf` for photographs of a ball, in whole processes."""

from functools import partial
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from bench_first_picture import COMMAND, process
from oracles.sphere_photographs import expose, light_directions, shade, sphere_normals, write_rig
from turns import in_turns

pytestmark = pytest.mark.benchmark


def test_the_command_on_photographs(tmp_path):
    """Time all models under 10 lights, with empty caches and with the programs of a first run."""
    size, radius, directions = 160, 78.0, light_directions(10)
    normals, rng = sphere_normals(size, radius), np.random.default_rng(0)
    camera = {"bits": 12, "black_level": 60.0, "gain": 0.25, "read_noise": 6.0}
    channels = []
    for diffuse in (0.4, 0.3, 0.2):
        signal = 3000 * shade(normals, directions, "phong", diffuse, 0.45, 40.0)
        taken = expose(rng, signal, gain=0.25, read_noise=6.0, black=60.0, clip=4095)
        channels.append(taken)
    write_rig(tmp_path, np.stack(channels, -1), directions, [3000.0], radius=radius, camera=camera)
    command = COMMAND.format("fitting"), "brdf", str(tmp_path), "--compare-all"

    def first():
        with TemporaryDirectory() as home:
            process(*command, home=home)

    rivals = {"first": first, "again": partial(process, *command, home=tmp_path)}
    _, seconds = in_turns(rivals, rounds=3, settled=0)
    for name, taken in seconds.items():
        print(f"{name:8s} {taken:6.2f} s")
