"""Runs every block of code and every command of the README and the page of commands. Printed
results are compared with the comments beside the code.

Two commands install the package first (the demo and the test command). CI runs them as written, and
also the slow tests below."""

import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from oracles.measured import merl_bytes
from page_blocks import blocks, run
from typer.testing import CliRunner

import fitting.cli
import jaxvision.cli
from jaxvision.files import write_image

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
COMMANDS_PAGE = (ROOT / "docs" / "how-to" / "commands.md").read_text()
COMMANDS = {"jaxvision": jaxvision.cli.app, "jaxvision-fit": fitting.cli.app}
# Smaller numbers for commands that take minutes as written, and files in place of the user's.
INSTEAD = {
    "--samples 64": "--samples 1 --resolution 16,16",
    "IMAGE ... --mask FILE": "b0.png b1.png b2.png --bits 16 --mask mask.png --kind matte",
    "FILE ...": "paint.binary",
    "CAMERA": "emva1288",
    "check brdf": "check brdf --simulations 4",
    "accuracy PATH": "accuracy PATH --knob 'curve rounds' --seconds 90",
    "cornell_box --seconds 60": "cornell_box --knob depth --seconds 40",
}


@pytest.mark.slow
def test_every_block_of_python_runs_and_keeps_its_promises(tmp_path):
    python = blocks(README, "python")
    kept = run(python, tmp_path, apart=True)
    assert kept, "no block promises a number"


def commands():
    """Return the lines of `sh` blocks and the commands of the table."""
    text = README + COMMANDS_PAGE
    lines = [line for block in blocks(text, "sh") for line in block.splitlines() if line.strip()]
    return lines + re.findall(r"^\| `([^`]+)` \|", COMMANDS_PAGE, flags=re.MULTILINE)


@pytest.fixture
def workplace(tmp_path, monkeypatch, lab):
    """Return a folder with the files of a user: a photo, a rig, a calibration and a measured
    BRDF."""
    monkeypatch.chdir(tmp_path)

    def grey(h, d, p):
        return np.broadcast_to(0.1 + 0.2 * np.exp(-9 * h * h)[..., None], (*np.shape(h), 3))

    (tmp_path / "paint.binary").write_bytes(merl_bytes(grey, (12, 10, 8))[0])
    write_image(tmp_path / "photo.png", np.arange(6000, dtype=np.uint16).reshape(40, 50, 3))
    for kind in ("noise", "response", "brdf"):
        (tmp_path / kind).symlink_to(lab[0] / kind)
    x, y = np.meshgrid(*2 * [np.linspace(-1.2, 1.2, 49)])
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    write_image(tmp_path / "mask.png", np.uint8(255 * (z > 0)))
    for i, light in enumerate([(0.5, 0.0, 0.866), (-0.5, 0.0, 0.866), (0.0, 0.6, 0.8)]):
        shading = np.maximum(light[0] * x - light[1] * y + light[2] * z, 0) * (z > 0)
        write_image(tmp_path / f"b{i}.png", np.uint16(30000 * shading))
    (tmp_path / "init").mkdir()
    for ms in (2, 4):
        write_image(tmp_path / "init" / f"flat_{ms}ms_0.tif", np.full((6, 8), 99 * ms, np.uint16))
    others = {"joint": "brdf", "plan": "brdf", "accuracy": "response"}
    others |= {"study": "noise", "predict": "noise"}
    for kind, of in others.items():
        (tmp_path / kind).symlink_to(lab[0] / of)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("command", commands())
def test_every_command_runs(command, workplace):
    if re.match(r"python3 -m venv .*(pytest|jaxvision-fit demo)|jaxvision-fit demo$", command):
        script = (ROOT / ".ci" / "run").read_text()
        assert "demo_command" in script
        assert "test_command" in script
        return
    for words, fewer in INSTEAD.items():
        command = command.replace(words, fewer)
    name, *arguments = shlex.split(command)
    arguments = [arguments[0] if word in ("PATH", "FOLDER") else word for word in arguments]
    result = CliRunner().invoke(COMMANDS[name], arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    for option, value in pairwise(arguments):
        assert option != "--out" or Path(value).exists()
