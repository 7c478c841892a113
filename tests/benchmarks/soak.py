"""Run mixed tasks on persistent workers, and record whether their memory stays constant.

    PYTHONPATH=tests python tests/benchmarks/soak.py --minutes 60 --workers 2 --out soak.csv

A round is a render of 12 tiles, 20 fits of a check, and 3 folders of a study with their reports, as
if many commands used one cluster. The script prints the median memory of the first and the last
sixth."""

import argparse
import csv
import shutil
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import psutil

import jaxvision as jv
from fitting.checks import noise
from fitting.checks.simulations import simulated
from fitting.study.outcomes import Settings
from fitting.study.run import study
from jaxvision import tasks
from jaxvision.files.scenes import read_scene
from jaxvision.programs import keep_programs
from jaxvision.render_command import change_resolution, render_to_file


def one_round(number: int, cameras: list[Path], folder: Path) -> None:
    """Run one task of each type with new seeds."""
    source = read_scene("cornell_box")
    source = replace(source, view=change_resolution(source.view, (24, 32)))
    settings = source.render.model_copy(update={"tile": 64, "samples": 1, "seed": number})
    render_to_file(source, folder / "box.exr", settings)
    (folder / "box.exr").unlink()
    seeds = partial(_of_round, number)
    simulated(seeds, 20, parameters=len(noise.NAMES))
    study(cameras, folder / "study", Settings("noise", seed=number))
    shutil.rmtree(folder / "study")


def _of_round(number: int, seed: int) -> np.ndarray:
    return noise.places(noise.CASES["clean"], 20 * number + seed)


def main() -> None:
    """Run rounds until the time is over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("soak.csv"))
    asked = parser.parse_args()
    from studies import write_camera

    rows = []
    with tempfile.TemporaryDirectory() as made, tasks.workers(asked.workers):
        folder = Path(made)
        cameras = [write_camera(folder / f"camera_{n}", seed=n) for n in range(3)]
        begun, number = time.monotonic(), 0
        while time.monotonic() - begun < 60 * asked.minutes:
            one_round(number, cameras, folder)
            number += 1
            own = psutil.Process()
            workers = [
                child
                for child in own.children(recursive=True)
                if "spawn_main" in " ".join(child.cmdline())
            ]
            taken = [process.memory_info().rss / 1e6 for process in (own, *workers)]
            pids = [process.pid for process in workers]
            rows.append((time.monotonic() - begun, number, *taken, *pids))
            with asked.out.open("w", newline="") as stream:
                csv.writer(stream).writerows(rows)
    seconds = np.array([row[0] for row in rows])
    memory = np.array([row[2 : 3 + asked.workers] for row in rows])
    first = seconds <= max(seconds[0], seconds[-1] / 6)
    last = seconds > seconds[-1] * 5 / 6
    print(f"{number} rounds in {seconds[-1] / 60:.0f} minutes, jaxvision {jv.__version__}")
    for name, column in zip(["command", *pids], memory.T, strict=True):
        a, b = np.median(column[first]), np.median(column[last])
        print(f"{name}: {a:.0f} MB in the first sixth, {b:.0f} MB in the last")


if __name__ == "__main__":
    keep_programs()
    main()
