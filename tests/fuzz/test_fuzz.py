"""Tests damaged files of every type: each is read, or refused in one sentence, soon and in little
memory. Commands also end this way.

    pytest -m slow tests/fuzz/test_fuzz.py            # JAXVISION_FUZZ=5000: files of each type

A case is identified by its type and its number, which are the seed. Numbers start at
JAXVISION_FUZZ_FROM. `JAX_ENABLE_X64=0` reads in float32, where numbers that float64 holds can
overflow. A folder in memory, `--basetemp=/dev/shm/a`, halves the time. Counts are printed with
`-s`."""

import os
import resource
import shutil
import time
import zlib
from collections import Counter
from pathlib import Path

import jax
import numpy as np
import pytest
from commands import called

import fitting.cli
import jaxvision.cli
from fuzz.damage import damaged
from fuzz.folders import FOLDERS, copied
from fuzz.seeds import kinds
from jaxvision.errors import InputError

COUNT = int(os.environ.get("JAXVISION_FUZZ", "200"))
FIRST = int(os.environ.get("JAXVISION_FUZZ_FROM", "0"))
LONGEST, MEMORY, WORDS = 10.0, 12 * 2**30, 600  # CPU s, bytes, characters of a message
NAMES = ("camera", "scene", "material", "rig", "levels", "merl", "rgl", "cornell", "obj", "ply")
NAMES += ("png", "png16", "tiff", "jpeg", "exr", "hdr", "npy", "mitsuba", "gltf", "glb", "glb_mesh")
NAMES += ("stl", "fits", "dng", "draws", "tiles", "passes", "chain", "pgm", "ppm", "pfm", "tga")
NAMES += ("pbrt",)


TEXTS = (".toml", ".csv", ".brdf", ".obj", ".ply", ".xml", ".gltf", ".pbrt")


def content(name, kind, number):
    rng = np.random.default_rng([zlib.crc32(name.encode()), number])
    seed = kind.seeds[number % len(kind.seeds)]
    return damaged(seed, rng, text=kind.suffix in TEXTS)


def infinite(result):
    """Return whether a result contains numbers that are not finite."""
    leaves = [leaf for leaf in jax.tree.leaves(result) if hasattr(leaf, "dtype")]
    return any(leaf.dtype.kind == "f" and not np.isfinite(leaf).all() for leaf in leaves)


def outcome(kind, file):
    """Return "read", "refused", or a description of the fault."""
    begun = time.process_time()
    try:
        result = kind.read(file)
    except InputError as error:
        words = str(error)
        if len(words) > WORDS or "\n" in words or not words.endswith("."):
            return f"odd message {words[:WORDS]!r}"
        found = "refused"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:WORDS]
    else:
        found = "not finite" if kind.finite and infinite(result) else "read"
    seconds = time.process_time() - begun
    return found if seconds < LONGEST else f"took {seconds:.0f} s"


@pytest.fixture
def little_memory():
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.mark.slow
@pytest.mark.usefixtures("little_memory")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_read_or_refused(name, tmp_path):
    kind = kinds(tmp_path)[name]
    file = tmp_path / f"damaged{kind.suffix}"
    counts, wrong = Counter(), {}
    for number in range(FIRST, FIRST + COUNT):
        file.write_bytes(content(name, kind, number))
        found = outcome(kind, file)
        counts[found if found in ("read", "refused") else "wrong"] += 1
        if found not in ("read", "refused"):
            wrong[number] = found
    print(f"{name}: {COUNT} files from {FIRST}, {dict(counts)}")
    assert not wrong, wrong


# the command, its arguments, the types of its files or folders, and the divisor of the number of
# cases
COMMANDS = {
    "inspect": (jaxvision.cli.app, "inspect FILE", "png png16 tiff jpeg exr hdr npy", 20),
    "render": (
        jaxvision.cli.app,
        "render FILE --resolution 2,2 --samples 1 --depth 2 --no-preview --out OUT/picture.exr",
        "scene",
        20,
    ),
    "effects": (jaxvision.cli.app, "effects FILE", "scene", 20),
    "noise": (fitting.cli.app, "noise FILE --out OUT", "levels flats", 40),
    "response": (fitting.cli.app, "response FILE --out OUT", "stack", 20),
    "brdf": (fitting.cli.app, "brdf FILE --out OUT", "ball cornell merl rgl", 40),
    "joint": (fitting.cli.app, "joint FILE --out OUT", "ball", 20),
    "plan": (fitting.cli.app, "plan FILE --target exponent", "ball", 20),
    "init": (fitting.cli.app, "init FILE", "photographs", 10),
    "study": (fitting.cli.app, "study noise FILE --no-reports --out OUT", "flats", 20),
}


@pytest.mark.slow
@pytest.mark.usefixtures("little_memory")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_end_with_a_sentence(command, tmp_path):
    """The undamaged files and folders come first, and none is refused."""
    app, asked, names, share = COMMANDS[command]
    counts, wrong = Counter(), {}
    for name in names.split():
        sound = sound_input(name, tmp_path / name)
        for number in (-1, *range(FIRST, FIRST + max(COUNT // share, 1))):
            given, out = damaged_input(name, sound, number), tmp_path / "out"
            shutil.rmtree(out, ignore_errors=True)
            words = asked.replace("FILE", str(given)).replace("OUT", str(out)).split()
            found = ended(app, words)
            counts[found if found in ("done", "refused") else "wrong"] += 1
            if found not in (("done",) if number < 0 else ("done", "refused")):
                wrong[name, number] = found
    print(f"{command}: {sum(counts.values())} inputs, {dict(counts)}")
    assert not wrong, wrong


def sound_input(name, folder):
    """Return a folder, or a type of file and the folder with the files that it names."""
    if name in FOLDERS:
        FOLDERS[name](folder)
        return folder
    folder.mkdir()
    return kinds(folder)[name], folder


def damaged_input(name, sound, number):
    """Return a damaged input, or for -1 the undamaged one: the last seed of its type."""
    if name in FOLDERS:
        return copied(sound, sound.with_name(f"damaged_{name}"), number)
    kind, folder = sound
    file = folder / f"damaged{kind.suffix}"
    file.write_bytes(kind.seeds[-1] if number < 0 else content(name, kind, number))
    return file


def ended(app, words):
    """Return "done", "refused", or a description of the fault. "Done" includes a channel that
    failed if the report gives the reason."""
    try:
        status, said, error = called(app, *words)
    except Exception as failure:
        return f"{type(failure).__name__}: {failure}"[:WORDS]
    if status == 0 or (status == 3 and "Not determined" in said):
        return "done"
    sentence = error.strip().split("\n")[-1]
    good = status in (2, 3) and sentence.endswith(".") and "Traceback" not in error
    return "refused" if good else f"status {status}: {error[-WORDS:]!r}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*facets hide each other")
def test_undamaged_files_are_read(tmp_path):
    """Otherwise, not only damage would be refused."""
    every = kinds(tmp_path)
    assert set(every) == set(NAMES)
    for name, kind in every.items():
        for seed in kind.seeds:
            file = tmp_path / f"sound{kind.suffix}"
            file.write_bytes(seed)
            assert outcome(kind, file) == "read", name
