"""Tests that messages tell users to install this distribution, with an existing extra."""

import re
import tomllib
from pathlib import Path

from jaxvision.errors import DISTRIBUTION, install

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def sources():
    for package in ("jaxvision", "fitting"):
        for file in sorted((ROOT / package).rglob("*.py")):
            yield file, file.read_text()


def test_the_name_is_the_distributions():
    assert PROJECT["name"] == DISTRIBUTION
    for extra, requirements in PROJECT["optional-dependencies"].items():
        own = [one for one in requirements if one.startswith("jaxvision")]
        assert all(one.startswith(f"{DISTRIBUTION}[") for one in own), extra


def test_every_hint_names_an_extra_of_this_distribution():
    hints = 0
    for file, text in sources():
        assert not re.search(r"pip install '?jaxvision(?!-)", text), file
        for extra in re.findall(r"\binstall\(['\"](\w+)['\"]\)", text):
            assert extra in PROJECT["optional-dependencies"], (file, extra)
            hints += 1
    assert hints >= 4
    assert install("raw") == "pip install 'jaxvision-imaging[raw]'"
