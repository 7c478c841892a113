"""Commands killed at random moments by SIGKILL, which no program can answer, and run again: what
lies in their folder is whole at every moment, and ends like that of a run that nobody killed.

    python tests/killed.py [--moments 200] [--only render|chain|report]

Each moment is a seed; counts are printed as they grow.
"""

import argparse
import io
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from fuzz.seeds import TABLE

JOBS = {
    "render": "jaxvision render cornell_box --resolution 12,12 --samples 1 --tile 20 "
    "--out out/box.exr",
    "chain": "fitting noise levels.csv --mcmc --walkers 16 --steps 1000 --out out",
    "report": "fitting noise levels.csv --out out",
}
PASSING = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d UTC")  # when a report was made


class Job:
    """A command and what it writes if nobody kills it.

    Attributes:
        words: of the command.
        place: the folder where it runs, with its input.
        whole: files by name.
        seconds: how long it takes once its programs are compiled.
    """

    def __init__(self, name: str, place: Path) -> None:
        self.words, self.place = JOBS[name].split(), place
        place.mkdir(parents=True)
        (place / "levels.csv").write_text(TABLE)
        for _ in range(2):  # the first compiles
            self.start_over()
            begun = time.monotonic()
            assert self.run() == 0, name
            self.seconds = time.monotonic() - begun
        self.whole = self.written()

    def start_over(self) -> None:
        shutil.rmtree(self.place / "out", ignore_errors=True)

    def run(self, *, kill_after: float | None = None) -> int:
        """Exit status; that of SIGKILL is negative."""
        process = subprocess.Popen(
            [sys.executable, "-m", *self.words],
            cwd=self.place,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(self.place / "cache")},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            return process.wait(kill_after)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def written(self) -> dict[str, bytes]:
        """The files that lie under their final names."""
        return {
            file.name: PASSING.sub(b"", file.read_bytes())
            for file in sorted((self.place / "out").rglob("*"))
            if file.is_file() and "partial" not in file.name
        }

    def is_torn(self, name: str, content: bytes) -> bool:
        """A file differs from that of a whole run, or is a block of a chain, which a whole run
        removes, that cannot be read."""
        if name in self.whole:
            return content != self.whole[name]
        with np.load(io.BytesIO(content)) as block:
            return not [block[key] for key in block.files]  # the archive checks its sums

    def killed_at(self, moment: int) -> str:
        """What a run that is killed at a moment leaves behind: "nothing", "some files" or "all";
        `AssertionError` where a file is torn, or the next run ends otherwise."""
        self.start_over()
        self.run(kill_after=random.Random(moment).uniform(0, self.seconds))
        left = self.written()
        torn = [name for name, content in left.items() if self.is_torn(name, content)]
        assert not torn, (moment, torn)
        assert self.run() == 0, moment
        assert self.written() == self.whole, moment
        return "all" if left == self.whole else "some files" if left else "nothing"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--only", choices=JOBS)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        names = [asked.only] if asked.only else list(JOBS)
        jobs = {name: Job(name, Path(folder) / name) for name in names}
        counts: Counter[tuple[str, str]] = Counter()
        for moment in range(asked.moments):
            name = names[moment % len(names)]
            counts[name, jobs[name].killed_at(moment)] += 1
            print(sum(counts.values()), dict(sorted(counts.items())), flush=True)


if __name__ == "__main__":
    main()
