"""Tests public functions with odd arguments: each returns, or says in one sentence of its own what
is wrong.

    pytest -m slow tests/fuzz/test_fuzz_arguments.py  # JAXVISION_FUZZ=100: cases per function

A case is identified by a function and a number, which are the seed. Numbers start at
JAXVISION_FUZZ_FROM. One array of the call in `examples/`, or one field of a record in it, is
replaced by 0, infinities, huge and tiny numbers, other shapes, lists, integers, codes, words or
None. JAX's own sentence about shapes that do not broadcast is accepted."""

import traceback
import warnings
import zlib
from collections import Counter
from functools import partial
from pathlib import Path

import jax
import pytest
from examples import ROOMS, examples_of
from public_names import doors

import jaxvision
from fuzz.arguments import odd_call, places, with_at
from fuzz.test_fuzz import COUNT, FIRST, WORDS

PACKAGE = Path(jaxvision.__file__).parent
OWN_WORDS = ("ncompatible shapes", "ncompatible types for broadcasting", "have the same shape")


def outcome(function, arguments, path, value):
    """Return "done", "refused", or a description of the fault."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            jax.block_until_ready(function(*with_at(arguments, path, value)))
    except (ValueError, TypeError) as error:
        words = str(error)
        raised_in = Path(traceback.extract_tb(error.__traceback__)[-1].filename)
        own = raised_in.is_relative_to(PACKAGE) and words.endswith(".") and len(words) < WORDS
        if own or any(part in words for part in OWN_WORDS):
            return "refused"
        return f"{type(error).__name__} in {raised_in.name}: {words}"[:WORDS]
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:WORDS]
    return "done"


@pytest.fixture
def as_for_users():
    """Use JAX's default promotion."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("as_for_users")
@pytest.mark.parametrize("room", ROOMS)
def test_odd_arguments_are_taken_or_refused(room):
    known, counts, wrong = doors(), Counter(), {}
    for name, (arguments, options) in examples_of(room).items():
        private = any(part.startswith("_") for part in name.split("."))  # checked through others
        if private or name not in known or not places(arguments):
            continue
        function = partial(known[name], **options)
        for number in range(FIRST, FIRST + COUNT):
            path, value = odd_call(arguments, number, zlib.crc32(name.encode()))
            found = outcome(function, arguments, path, value)
            counts[found if found in ("done", "refused") else "wrong"] += 1
            if found not in ("done", "refused"):
                wrong[name, number] = (jax.tree_util.keystr(path), found)
    print(f"{room}: {sum(counts.values())} calls, {dict(counts)}")
    assert not wrong, wrong
