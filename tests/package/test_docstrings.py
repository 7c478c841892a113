"""Tests the docstrings of the public API: every name has one, optional arguments are keywords,
`key` comes first, and exported names have sections for arguments and result, with units. The
examples in docstrings are executed."""

import dataclasses
import doctest
import importlib
import inspect
import pkgutil
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from public_names import defined, functions, home, modules, records, traced

import fitting
import jaxvision

UNIT = (
    r"(?<![\w'])"
    r"(DN|W m\^-2|W sr\^-1|sr\^-1|s|m|m\^-1|m\^2|metres|photons|electrons|e-|rad|radians|rad\^-1|"
    r"K|units?|pixels|codes|relative)\b"
)
HEADING = r"^(Args|Attributes|Returns|Raises|Source|Example|Yields):"


def exported(found):
    """Return the objects in the `__all__` of a package."""
    doors = [m for package in (jaxvision, fitting) for m in (package, *modules(package))]
    named = {id(getattr(m, n)) for m in doors for n in getattr(m, "__all__", ())}
    return {name: value for name, value in found.items() if id(value) in named}


def sections(thing):
    """Return {heading: text} of a docstring, with the text before headings under ''."""
    parts = re.split(HEADING, inspect.getdoc(thing) or "", flags=re.MULTILINE)
    return {"": parts[0]} | dict(zip(parts[1::2], parts[2::2], strict=True))


def entries(text):
    """Return the names that a section explains: `name:` or `one, two:` at the smallest indent."""
    lines = [line for line in text.splitlines() if line.strip()]
    indent = min((len(line) - len(line.lstrip()) for line in lines), default=0)
    heads = (re.match(rf" {{{indent}}}([\w*, ]+?)(?: \([^)]*\))?:", line) for line in lines)
    return {name.strip(" *") for head in heads if head for name in head[1].split(",")}


def function_faults(function):
    said = sections(function)
    signature = inspect.signature(function)
    missing = signature.parameters.keys() - entries(said.get("Args", ""))
    yield from (f"`Args:` does not name {name}" for name in sorted(missing))
    returns = signature.return_annotation not in (None, "None", inspect.Signature.empty)
    if returns and "Returns" not in said:
        yield "no `Returns:`"


def states_a_unit(function):
    return re.search(UNIT, inspect.getdoc(function) or "")


def record_faults(record):
    said = sections(record)
    missing = {field.name for field in dataclasses.fields(record)}
    missing -= entries(said.get("Attributes", ""))
    yield from (f"`Attributes:` does not name {name}" for name in sorted(missing))


def report(found):
    return "\n".join(f"{name}: {fault}" for name, faults in found.items() for fault in faults)


OPTIONAL_BY_PLACE = {"from_frames": ("photons",)}  # once required; callers pass it by position


def test_documented_with_optional_arguments_by_keyword_and_key_first():
    def faults(function):
        if len(inspect.getdoc(function) or "") < 10:
            yield "not documented"
        for i, parameter in enumerate(inspect.signature(function).parameters.values()):
            optional = parameter.default is not inspect.Parameter.empty
            by_place = parameter.name in OPTIONAL_BY_PLACE.get(function.__name__, ())
            if optional and parameter.kind is not inspect.Parameter.KEYWORD_ONLY and not by_place:
                yield f"{parameter} is optional and positional"
            if parameter.name == "key" and i:
                yield "key does not come first"

    both = functions(jaxvision) | functions(fitting)
    found = {name: list(faults(function)) for name, function in both.items()}
    assert not any(found.values()), report(found)


def test_exported_functions_explain_arguments_and_result():
    both = exported(functions(jaxvision) | functions(fitting))
    found = {name: list(function_faults(function)) for name, function in both.items()}
    assert not any(found.values()), report(found)


def test_units_are_stated_by_the_function_itself():
    assert not [name for name, function in traced().items() if not states_a_unit(function)]


def test_exported_records_explain_their_fields():
    both = exported(records(jaxvision) | records(fitting))
    found = {
        name: list(record_faults(record))
        for name, record in both.items()
        if dataclasses.is_dataclass(record)
    }
    assert not any(found.values()), report(found)


def test_the_lines_of_one_entry_are_indented_below_its_name():
    """A line at the indent of the names starts a new entry in the site's table."""
    faults = []
    for name, thing in (*defined(jaxvision), *defined(fitting)):
        for heading in ("Args", "Attributes", "Raises"):
            lines = [
                x for x in sections(thing).get(heading, "").splitlines() if x.startswith("    ")
            ]
            first = [x for x in lines if not x.startswith("     ")]
            faults += [
                (name, x) for x in first if not re.match(r" {4}[\w*, ]+( \(.*?\))?:( |$)", x)
            ]
    assert not faults


def test_records_are_documented():
    written_by_dataclasses = [
        name
        for name, record in records(jaxvision).items()
        if not record.__doc__ or record.__doc__.startswith(f"{record.__name__}(")
    ]
    assert not written_by_dataclasses


def test_everything_exported_exists_and_nothing_is_forgotten():
    for package in (jaxvision, fitting):
        assert all(hasattr(package, name) for name in package.__all__)
    public = {id(getattr(jaxvision, name)) for name in jaxvision.__all__}
    of_scenes = (jaxvision.Light, jaxvision.Material)
    missing = [
        name
        for name, kind in records(jaxvision).items()
        if (name.startswith("jaxvision.scene.") or issubclass(kind, of_scenes))
        and id(kind) not in public
    ]
    assert not missing


def examples(package):
    """Yield the examples in all docstrings of a package."""
    names = [name for _, name, _ in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]
    for name in (package.__name__, *names):
        module = importlib.import_module(name)
        given = {"jax": jax, "jnp": jnp, "np": np, "jv": jaxvision}
        for test in doctest.DocTestFinder().find(module, name, module, globs=given):
            if test.examples:
                yield test


def failures(tests):
    runner, said = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE), []
    for test in tests:
        with np.printoptions(legacy=False):  # colour-science sets 1.13 when imported
            runner.run(test, out=said.append)
    return "".join(said)


def test_every_name_at_a_root_has_an_example():
    """Functions and classes need one. Aliases of array types, which appear as defined by the
    package itself, and modules do not."""
    without = [
        f"{package.__name__}.{name}"
        for package in (jaxvision, fitting)
        for name in package.__all__
        if home(thing := getattr(package, name)) not in (None, package.__name__)
        and ">>>" not in (thing.__doc__ or "")
    ]
    assert not without


@pytest.mark.slow  # CI runs it
@pytest.mark.parametrize("package", ["jaxvision", "fitting"])
def test_examples_in_docstrings_give_what_they_say(package):
    said = failures(examples(importlib.import_module(package)))
    assert not said, said
