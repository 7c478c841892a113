"""Tests that the page of foreign inputs names tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_test_that_the_page_names_exists():
    page = (ROOT / "docs" / "foreign_inputs.md").read_text()
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)", page)
    assert len(named) > 150
    assert len(named) == page.count(".py::")  # each is in backticks
    for file, test in named:
        assert f"def {test}(" in (ROOT / file).read_text(), (file, test)
