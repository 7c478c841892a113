"""Each public function stands in the registry of errors, and what is measured lies in its bound.

The default run takes each function's hard cases for some of them, and few numbers of every curve;
`pytest -m slow` takes all. `table.py` writes the page, `every_float32.py` leaves no number out.
"""

import numpy as np
import pytest
import registry
from every_float32 import recorded, swept
from measure import HARD, SLOW, measured
from public_names import functions, records
from registry.composed import COMPOSED
from registry.elsewhere import ELSEWHERE, covered_names
from widened import calls, widened

import fitting
import jaxvision

ENTRIES = registry.every_entry()
CURVES = [entry for entry in ENTRIES if entry.is_curve]
STRIDE = 12  # of the functions the default run measures each so many


def public():
    found = [*functions(jaxvision), *functions(fitting)]
    return {name.removeprefix("jaxvision.") for name in found}


def owner(entry):
    """The public function of a row, or the module that holds the record whose method it is."""
    parts = entry.name.split(".")
    method = next((i for i, part in enumerate(parts) if part[0].isupper()), None)
    return entry.name if method is None else ".".join(parts[:method])


def test_every_public_function_is_in_the_registry():
    beside = {owner(entry) for entry in ENTRIES}
    elsewhere = [name for group in ELSEWHERE for name in covered_names(group)]
    assert len(elsewhere) == len(set(elsewhere)), "a function stands in two groups"
    assert public() - beside - set(COMPOSED) - set(elsewhere) == set(), "no entry in the registry"
    assert not beside & set(COMPOSED)


def test_the_registry_names_what_there_is(pytestconfig):
    names, held = public(), public() | set(records(fitting))
    modules = {name.rpartition(".")[0] for name in held}
    assert {owner(entry) for entry in ENTRIES} <= names | modules
    assert set(COMPOSED) <= names
    assert all(covered_names(group) for group in ELSEWHERE)
    tests = pytestconfig.rootpath / "tests"
    files = {file.stem for file in tests.rglob("test_*.py")}
    assert {test.rpartition("/")[2] for g in ELSEWHERE for test in g.tests.split()} <= files
    titles = [(entry.title, entry.parts) for entry in ENTRIES]
    assert len(titles) == len(set(titles))


def check(entry, dtype, n):
    for row in measured(entry, dtype, n=n):
        assert row.holds, (
            f"{row.worst:.3g} ULP at {row.at}: {row.got!r}, true {row.true!r}, "
            f"bound {entry.bound}; "
            f"{row.non_finite} not finite; slope off by {row.gradient:.2g}, {row.endless_slopes} "
            "not finite"
        )


@pytest.mark.parametrize("entry", ENTRIES[::STRIDE], ids=lambda e: e.title)
def test_hard_cases(entry):
    check(entry, np.dtype(entry.precisions[0]), HARD)


@pytest.mark.slow
@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e.title)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_hard_cases_and_drawn_ones(entry, precision):
    if precision in entry.precisions:
        check(entry, np.dtype(precision), SLOW if entry.of_digits else 20_000)


@pytest.mark.parametrize("entry", CURVES[:2], ids=lambda e: e.title)
def test_one_float32_in_many(entry):
    assert swept(entry, stride=20_011)["worst"] <= entry.bound


@pytest.mark.slow
@pytest.mark.parametrize("entry", CURVES, ids=lambda e: e.title)
def test_one_float32_in_hundreds(entry):
    found = swept(entry, stride=1009)
    assert found["worst"] <= entry.bound
    assert not found["not_finite"]
    every = recorded().get(entry.title)
    if every is not None:  # of one processor; another may contract a product and a sum
        assert found["worst"] <= 1.1 * every["worst"] + 0.5
        assert every["worst"] <= entry.bound


# Another processor, or another degree of optimisation, rounds at other places: without any, a few
# are at 2.7 times the bounds of the table, which are those of its machine.
OTHERWISE_COMPILED = 3


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(COMPOSED))
def test_compositions_in_float32(name):
    of_largest, _, kept = widened(name, calls()[name])
    assert kept, "float32 does not stay float32"
    assert of_largest <= OTHERWISE_COMPILED * COMPOSED[name]
