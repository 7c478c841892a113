"""Tests the commands as a user calls them: tables, JSON, and one sentence with status 2 for bad
input, which leaves no files behind."""

import html
import json
import os
import re
import shlex
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import typer
from commands import called

import jaxvision.cli
from fitting.cli import app
from fitting.report.page import as_json
from jaxvision.errors import InputError
from jaxvision.files.images import read_image, write_image

run = partial(called, app)


def one_sentence(stderr):
    """Return the message of a refused command, which must be a single line and no traceback."""
    lines = [line for line in stderr.strip().splitlines() if line.startswith("jaxvision-fit:")]
    assert len(lines) == 1, stderr
    assert "Traceback" not in stderr
    return lines[0]


def broken_rig(folder, **sections):
    """Write a folder that contains only a rig, with `[camera]` and the given TOML text."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text("\n".join(["[camera]", "bits = 12", *sections.values()]))
    return folder


@pytest.mark.parametrize("command", ["noise", "response", "brdf", "joint"])
def test_a_folder_without_rig(command, tmp_path):
    status, _, stderr = run(command, tmp_path, "--out", tmp_path / "out")
    assert status == 2
    assert "no such rig file" in one_sentence(stderr)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("command", "section"),
    [
        ("noise", "[[flat]]"),
        ("response", "[[exposure]]"),
        ("brdf", "[[light]]"),
        ("joint", "[[light]]"),
    ],
)
def test_a_rig_without_the_section_a_command_needs(command, section, tmp_path):
    status, _, stderr = run(command, broken_rig(tmp_path / "rig"))
    assert status == 2
    assert section in one_sentence(stderr)


def test_misspelt_words_say_which_to_write(tmp_path):
    """The message names the right word. It is printed in a frame, wrapped."""

    def said(app, *words):
        status, _, stderr = called(app, *words)
        assert status == 2
        return " ".join(re.sub("[│╭╮╰╯─]", " ", stderr).split())

    error = said(app, "brdf", tmp_path, "--model", "pong")
    assert error.endswith("Invalid value for '--model': 'pong' is unknown; the nearest is 'phong'.")
    assert said(app, "inspect", "x").endswith("No such command 'inspect'. Write jaxvision inspect.")
    for option in ("-v", "--verbose"):
        error = said(jaxvision.cli.app, "render", "x.toml", option)
        assert error.endswith("-v stands before the command: jaxvision -v COMMAND.")
    own, others = (
        {one.callback.__name__ for one in each.registered_commands}
        for each in (app, jaxvision.cli.app)
    )
    assert {*app.info.context_settings["obj"]} == others - own


def test_words_and_the_working_folder_are_text(tmp_path, monkeypatch):
    foreign = tmp_path / os.fsdecode(b"\xcf")
    status, _, stderr = run("noise", foreign)
    assert status == 2
    assert r"\udccf': the path is not UTF-8; rename that." in one_sentence(stderr)
    foreign.mkdir()
    monkeypatch.chdir(foreign)
    assert r"\udccf': the path is not UTF-8" in one_sentence(run("noise", ".")[2])
    foreign.rmdir()
    assert "the working folder was removed" in one_sentence(run("noise", ".")[2])


def test_unknown_options_and_models_exit_with_2(tmp_path):
    assert run("noise", tmp_path, "--nonsense")[0] == 2
    assert run("brdf", tmp_path, "--model", "mirror")[0] == 2
    assert run("noise", tmp_path, "--mcmc", "--walkers", "2")[0] == 2
    assert "--steps: only a chain takes it; add --mcmc" in run("noise", tmp_path, "--steps", "9")[2]


@pytest.mark.slow
def test_noise_writes_report_results_and_chains_and_prints_json(lab, tmp_path):
    folder, truth = lab
    status, stdout, _ = run("noise", folder / "noise", "--out", tmp_path / "out", "--json")
    assert status == 0
    printed = json.loads(stdout)
    stored = json.loads((tmp_path / "out" / "results.json").read_text())
    assert printed["sections"] == stored["sections"]
    names = {path.name for path in (tmp_path / "out").iterdir()}
    sensor = {"sensor.toml", "sensor.npz"}
    assert names == {"report.html", "results.json", "noise_chains.nc"} | sensor
    gain = next(e for e in stored["sections"][0]["estimates"] if e["name"] == "system_gain")
    assert gain["interval_95"][0] < truth.system_gain < gain["interval_95"][1]


def test_the_output_folder_that_is_a_file_is_named(lab, tmp_path):
    folder, _ = lab
    (tmp_path / "out").write_text("in the way")
    status, _, stderr = run("noise", folder / "noise", "--out", tmp_path / "out")
    assert status == 2
    assert "out" in one_sentence(stderr)
    assert (tmp_path / "out").read_text() == "in the way"


def rig_with(folder, target, edit):
    """Link every image of a rig folder into `target`, and write its rig through `edit`."""
    target.mkdir()
    for file in folder.iterdir():
        if file.name != "rig.toml":
            (target / file.name).symlink_to(file)
    (target / "rig.toml").write_text(edit((folder / "rig.toml").read_text()))
    return target


def same(text):
    return text


@pytest.mark.parametrize(
    ("section", "image", "pixels", "expected"),
    [
        ("noise", "flat_03_00.tif", None, "no such image file"),
        ("noise", "flat_03_00.tif", np.zeros((4, 4), np.uint16), "size"),
        ("noise", "flat_03_00.tif", np.zeros((240, 320), np.uint8), "8-bit data"),
        ("response", "stack_03.png", b"junk", "not readable"),
        ("response", "stack_03.png", np.zeros((4, 4, 3), np.uint8), "size"),
        ("response", "stack_03.png", np.zeros((96, 128, 3), np.uint16) + 300, "do not fit"),
        ("brdf", "light_03.tif", None, "no such image file"),
    ],
)
def test_bad_images_are_named(lab, tmp_path, section, image, pixels, expected):
    rig = rig_with(lab[0] / section, tmp_path / "rig", same)
    (rig / image).unlink()
    if isinstance(pixels, bytes):
        (rig / image).write_bytes(pixels)
    elif pixels is not None:
        write_image(rig / image, pixels)
    status, _, stderr = run(section, rig, "--out", tmp_path / "out")
    assert status == 2
    sentence = one_sentence(stderr)
    assert image in sentence
    assert expected in sentence
    assert not (tmp_path / "out").exists()


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("section", "pattern", "level"),
    [
        ("response", "stack_*.png", 255),
        ("response", "stack_*.png", 0),
        ("brdf", "light_*.tif", 4095),
        ("brdf", "light_*.tif", 0),
        ("noise", "flat_*.tif", 4095),
        ("noise", "flat_*.tif", 0),
    ],
)
def test_images_without_information_are_refused(lab, tmp_path, section, pattern, level):
    rig = rig_with(lab[0] / section, tmp_path / "rig", same)
    for file in rig.glob(pattern):
        shape = read_image(file).shape
        dtype = read_image(file).dtype
        file.unlink()
        write_image(file, np.full(shape, level, dtype))
    status, _, stderr = run(section, rig, "--out", tmp_path / "out")
    assert status == 2
    sentence = one_sentence(stderr)
    page = tmp_path / "out" / "report.html"
    if page.exists():  # if a calibration had begun
        assert sentence.split("; ")[0].split(": ", 2)[-1][:40] in html.unescape(page.read_text())


def test_equal_exposures_are_refused(lab, tmp_path):
    def equal(text):
        lines = text.splitlines()
        return "\n".join("exposure = 0.01" if "exposure =" in line else line for line in lines)

    rig = rig_with(lab[0] / "response", tmp_path / "rig", equal)
    status, _, stderr = run("response", rig)
    assert status == 2
    assert "exposure" in one_sentence(stderr)


def test_the_installed_command_shows_no_traceback(tmp_path):
    command = Path(sys.executable).with_name("jaxvision-fit")
    ran = subprocess.run([command, "noise", tmp_path], capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    one_sentence(ran.stderr)
    assert ran.stdout == ""


@pytest.mark.slow
def test_chains_that_are_too_short_are_refused_and_can_be_continued(lab, tmp_path):
    """The report says that the chains are too short, the draws are kept, and following the advice
    succeeds."""
    command = ("response", lab[0] / "response", "--mcmc", "--walkers", "16", "--out", tmp_path)
    status, _, stderr = run(*command, "--steps", "20")
    assert status == 2
    advised = re.search(r"more steps are missing; allow --steps (\d+) and run again", stderr)
    assert advised, one_sentence(stderr)
    assert advised[0] in (tmp_path / "report.html").read_text()
    (section,) = json.loads((tmp_path / "results.json").read_text())["sections"]
    assert section["estimates"] == []
    assert [*(tmp_path / "checkpoint").rglob("block-*.npz")]
    while status == 2:  # a short chain underestimates its own length, and may ask again
        asked = int(advised[1])
        status, _, stderr = run(*command, "--steps", asked)
        advised = re.search(r"allow --steps (\d+) and run again", stderr) or advised
        assert status == 0 or int(advised[1]) > asked
    assert status == 0
    assert (tmp_path / "report.html").exists()


def test_a_fit_that_fails_is_a_section_with_the_reason(monkeypatch, tmp_path, lab):
    from fitting.noise import calibration

    def fails(measurement, **options):
        raise InputError("the fit has no maximum; give more light.")

    monkeypatch.setattr(calibration, "calibrate", fails)
    status, printed, stderr = run("noise", lab[0] / "noise", "--out", tmp_path / "out")
    assert status == 2
    assert stderr.rstrip().endswith("jaxvision-fit: the fit has no maximum; give more light.")
    assert "• the fit has no maximum" in printed
    assert "the fit has no maximum" in (tmp_path / "out" / "report.html").read_text()
    (section,) = json.loads((tmp_path / "out" / "results.json").read_text())["sections"]
    assert section["estimates"] == []
    assert len(section["inputs"]) > 4


def test_json_without_results_is_valid():
    assert json.loads(as_json([], seed=0, settings={}))["sections"] == []


def test_one_flat_that_cannot_be_read_is_left_out_by_name(lab, tmp_path):
    rig = rig_with(lab[0] / "noise", tmp_path / "rig", same)
    (rig / "flat_03_00.tif").unlink()
    (rig / "flat_03_00.tif").write_bytes(b"junk")
    status, _, _ = run("noise", rig, "--out", tmp_path / "out")
    assert status == 0
    (section,) = json.loads((tmp_path / "out" / "results.json").read_text())["sections"]
    assert any("flat_03_00.tif" in said for said in section["findings"])


@pytest.mark.parametrize(("level", "state"), [(4095, "saturated"), (0, "dark")])
def test_one_image_without_information_is_named(lab, tmp_path, level, state):
    rig = rig_with(lab[0] / "brdf", tmp_path / "rig", same)
    image = rig / "light_05.tif"
    shape = read_image(image).shape
    image.unlink()
    write_image(image, np.full(shape, level, np.uint16))
    status, _, _ = run("brdf", rig, "--model", "phong", "--out", tmp_path / "out")
    assert status == 0
    (section,) = json.loads((tmp_path / "out" / "results.json").read_text())["sections"]
    assert any("light_05.tif" in said and state in said for said in section["findings"])


@pytest.mark.slow
def test_eight_bit_numbers_in_sixteen_bit_files_are_refused(lab, tmp_path):
    rig = rig_with(lab[0] / "noise", tmp_path / "rig", same)
    for file in rig.glob("*.tif"):
        pixels = read_image(file)
        file.unlink()
        write_image(file, pixels >> 4)
    status, _, stderr = run("noise", rig)
    assert status == 2
    assert "no flat exceeds 255 DN" in one_sentence(stderr)


def test_a_misspelt_key_is_named(tmp_path):
    (tmp_path / "rig.toml").write_text("[camera]\nbitz = 12\n")
    assert "camera.bitz is not a key" in one_sentence(run("noise", tmp_path)[2])


def test_answers_without_computation_import_no_jax(tmp_path):
    """Help, the version, and unusable paths, rigs and images are tried in one process, which must
    not import JAX or NumPy."""
    images_missing = broken_rig(
        tmp_path / "missing",
        flat='[[flat]]\nfiles = ["a.tif", "b.tif"]\nexposure = 1',
        dark='[[dark]]\nfiles = ["c.tif", "d.tif"]\nexposure = 1',
        exposure='[[exposure]]\nfile = "a.tif"\nexposure = 1',
        light='[[light]]\nfile = "a.tif"\ndirection = [0, 0, 1]',
        geometry='[geometry]\nnormals = "a.npy"',
    )
    attempts = [
        ["--help"],
        ["--version"],
        ["brdf", "--help"],
        ["noise", str(tmp_path / "none")],
        ["noise", str(tmp_path / "none.csv")],
        ["response", str(tmp_path)],
        ["brdf", str(tmp_path / "none.bsdf")],
        ["brdf", str(broken_rig(tmp_path / "rig") / "rig.txt")],
        ["noise", "--nonsense"],
        ["noise", str(broken_rig(tmp_path / "no_flat"))],
        *([command, str(images_missing)] for command in ("noise", "response", "brdf")),
    ]
    program = (
        "import sys, json\n"
        "from fitting.cli import main\n"
        "ends = []\n"
        f"for arguments in {attempts}:\n"
        "    sys.argv = ['jaxvision-fit', *arguments]\n"
        "    try: main()\n"
        "    except SystemExit as end: ends.append(end.code)\n"
        "loaded = {name.split('.')[0] for name in sys.modules}\n"
        "print(json.dumps([ends, sorted(loaded)]))\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    ends, loaded = json.loads(ran.stdout.splitlines()[-1])
    assert ends == [0, 0, 0] + 10 * [2]
    assert ran.stderr.count("a.tif: no such image file") == 3
    assert "jaxvision" in loaded
    assert not set(loaded) & {"jax", "numpy", "equinox", "scipy", "emcee", "xarray"}


@pytest.mark.parametrize("program", [jaxvision.cli.app, app])
def test_examples_of_the_help_are_arguments_that_a_command_takes(program):
    group = typer.main.get_command(program)
    for name, command in group.commands.items():
        examples = re.findall(r"Example: (.+)", command.epilog)
        assert examples, name
        for example in examples:
            _, typed, *arguments = shlex.split(example)
            assert typed == name
            command.make_context(name, arguments)


@pytest.mark.parametrize("program", [jaxvision.cli.app, app])
def test_help_says_in_words_what_options_take(program):
    for name in typer.main.get_command(program).commands:
        status, shown, _ = called(program, name, "--help")
        assert status == 0
        assert not re.search(r"<[\w| -]+>", shown), name
        assert "}" not in shown, name
        assert "SECONDS" in shown or "--seconds" not in shown


def test_a_closed_pipe_ends_a_command_silently():
    """The reader of the output has closed the pipe, as `| head -1` does. The command prints neither
    a sentence about a full disk nor a traceback."""
    script = (
        "import sys\n"
        "from jaxvision.cli.command_line import command_app, failures_as_sentences\n"
        "app = command_app('jaxvision', 'about')\n"
        "@app.command()\n"
        "@failures_as_sentences('jaxvision')\n"
        "def say() -> None:\n"
        "    sys.stdin.read()\n"
        "    print('much', flush=True)\n"
        "app(['say'])\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    process.stdout.close()  # before anything is written
    assert process.stdin is not None
    process.stdin.close()
    process.stdin = process.stdout = None
    said = process.communicate(timeout=60)[1]
    assert (process.returncode, said) == (141, b"")


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
@pytest.mark.slow
def test_a_command_with_closed_streams_works(tmp_path, closed):
    """Files that the command opens must not reuse the numbers of streams that the shell closed."""
    np.save(tmp_path / "a.npy", np.ones((4, 4, 3)))
    for words in ("-m jaxvision inspect a.npy", "-m fitting --version"):
        line = f"{shlex.quote(sys.executable)} {words} {closed}"
        ran = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, text=True)
        assert (ran.returncode, ran.stderr) == (0, "")
