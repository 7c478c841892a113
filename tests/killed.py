"""End commands at random moments, by SIGKILL or Ctrl-C, and run them again.

    python tests/killed.py [--moments 200] [--first 0] [--only render|chain|report] [--interrupt]

At every moment the files in the folder must be complete, and a repeated run must end like an
uninterrupted one. After Ctrl-C the command must end within 2 s, with status 130 and one line.

Each moment is a seed. Counts are printed as they grow. Moments after everything was written do not
count among the `--moments`. Interrupted runs of odd moments compile all programs again, and one in
four is repeated."""

import argparse
import io
import itertools
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from fuzz.seeds import TABLE

from jaxvision.files.images import write_image

JOBS = {
    "render": "jaxvision render cornell_box --resolution 12,12 --samples 1 --tile 20 "
    "--out out/box.exr",
    "chain": "fitting noise levels.csv --mcmc --walkers 16 --steps 1000 --out out",
    "report": "fitting noise levels.csv --out out",
    "taps": "fitting noise rig --mcmc --walkers 16 --steps 3000 --out out",
}
AT_ONCE = 2.0  # s from Ctrl-C to the end
# when a report was made, and how long it took
PASSING = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d UTC|The fit took \S+ s")


def write_rig_of_two_taps(folder: Path) -> None:
    """Write flats of even and odd columns with gains of .25 and .32 DN/e-, which the rig does not
    state."""
    folder.mkdir()
    rng, gain = np.random.default_rng(0), np.where(np.arange(64) % 2, 0.32, 0.25)
    text = "[camera]\nbits = 12\n"
    for i, photons in enumerate([0.0, *np.linspace(1000, 16_000, 8)]):
        names = [f"{i}_{j}.tif" for j in range(4)]
        for name in names:
            electrons = rng.poisson(photons / 2, (64, 64)) + 5 * rng.standard_normal((64, 64))
            write_image(folder / name, np.round(64 + gain * electrons).astype(np.uint16))
        text += f"[[{'flat' if photons else 'dark'}]]\nfiles = {names}\nexposure = 0.01\n"
        text += f"photons = {photons}\n" if photons else ""
    (folder / "rig.toml").write_text(text)


class Job:
    """A command and the files of an uninterrupted run.

    Attributes:
        words: arguments of the command.
        place: folder where it runs, with its input.
        whole: files by name.
        seconds: duration once its programs are compiled.
    """

    def __init__(self, name: str, place: Path) -> None:
        self.words, self.place = JOBS[name].split(), place
        place.mkdir(parents=True)
        (place / "levels.csv").write_text(TABLE)
        if "rig" in self.words:
            write_rig_of_two_taps(place / "rig")
        for _ in range(2):  # the first run compiles
            self.start_over()
            begun = time.monotonic()
            assert self.run() == 0, name
            self.seconds = time.monotonic() - begun
        self.whole = self.written()

    def start_over(self) -> None:
        shutil.rmtree(self.place / "out", ignore_errors=True)

    def begun(self, *, cache: str = "cache") -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", *self.words],
            cwd=self.place,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(self.place / cache)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *, kill_after: float | None = None) -> int:
        """Return the exit status, which is negative for SIGKILL."""
        process = self.begun()
        try:
            process.communicate(timeout=kill_after)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        return process.returncode

    def interrupt(self, after: float, *, cache: str) -> float | None:
        """Return the seconds that the command took to end, or None if it had ended, or almost
        ended, before."""
        process = self.begun(cache=cache)
        try:
            process.communicate(timeout=after)
        except subprocess.TimeoutExpired:
            begun = time.monotonic()
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=60)
            seconds = time.monotonic() - begun
            if process.returncode == 0:
                return None
            last = error.strip().split("\n")[-1]
            assert process.returncode == 130, (process.returncode, error)
            assert "interrupted" in last or "goes on from here" in last, error
            assert "Traceback" not in error, error
            partial = [file.name for file in self.place.rglob(".partial-*")]
            assert not partial, (partial, error)
            return seconds
        assert process.returncode == 0
        return None

    def written(self) -> dict[str, bytes]:
        """Return the files under their final names."""
        return {
            file.name: PASSING.sub(b"", file.read_bytes())
            for file in sorted((self.place / "out").rglob("*"))
            if file.is_file() and "partial" not in file.name
        }

    def is_torn(self, name: str, content: bytes) -> bool:
        """Return whether a file differs from that of an uninterrupted run. A block of a chain,
        which such a run removes, must be readable."""
        if name in self.whole:
            return content != self.whole[name]
        with np.load(io.BytesIO(content)) as block:
            return not [block[key] for key in block.files]  # reading checks the archive's checksums

    def interrupted_at(self, moment: int) -> str:
        """Do as `killed_at`, by Ctrl-C."""
        rng = random.Random(f"interrupt {moment}")
        anew = moment % 2 == 1
        self.start_over()
        shutil.rmtree(self.place / "anew", ignore_errors=True)
        seconds = self.interrupt(
            rng.uniform(0, (1 + anew) * self.seconds), cache="anew" if anew else "cache"
        )
        if seconds is None:
            assert self.written() == self.whole, moment
        else:
            assert seconds <= AT_ONCE, (moment, seconds)
        return self.compared(moment, again=moment % 4 == 0)

    def killed_at(self, moment: int) -> str:
        """Kill a run at a moment, and return whether it wrote "nothing", "some files" or "all"."""
        self.start_over()
        self.run(kill_after=random.Random(moment).uniform(0, self.seconds))
        return self.compared(moment, again=True)

    def compared(self, moment: int, *, again: bool) -> str:
        """Check the files, run the command `again` if asked, and return how much was written."""
        left = self.written()
        torn = [name for name, content in left.items() if self.is_torn(name, content)]
        assert not torn, (moment, torn)
        if again:
            assert self.run() == 0, moment
            assert self.written() == self.whole, moment
        return "all" if left == self.whole else "some files" if left else "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=JOBS)
    parser.add_argument("--interrupt", action="store_true")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        names = [asked.only] if asked.only else list(JOBS)
        jobs = {name: Job(name, Path(folder) / name) for name in names}
        counts: Counter[tuple[str, str]] = Counter()
        for moment in itertools.count(asked.first):
            early = sum(count for (_, left), count in counts.items() if left != "all")
            if early == asked.moments:
                break
            name = names[moment % len(names)]
            job = jobs[name]
            try:
                left = job.interrupted_at(moment) if asked.interrupt else job.killed_at(moment)
            except AssertionError as error:
                left = f"wrong: {error}"
            counts[name, left] += 1
            print(sum(counts.values()), dict(sorted(counts.items())), flush=True)


if __name__ == "__main__":
    main()
