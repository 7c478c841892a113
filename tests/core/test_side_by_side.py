"""Tests work on all cores, and sums over blocks of samples."""

import contextvars
import threading
import time
from functools import partial

import jax
import jax.numpy as jnp
import pytest

from jaxvision.core.side_by_side import cores, side_by_side


def test_results_keep_the_order_of_the_pieces_and_progress_counts_them():
    begun, said = threading.Event(), []

    def first():
        assert cores() == 1 or begun.wait(30), "the second piece begins beside the first"
        return "first"

    def second():
        begun.set()
        return "second"

    found = side_by_side([first, second], progress=lambda *done: said.append(done))
    assert found == ["first", "second"]
    assert said == [(1, 2), (2, 2)]
    assert side_by_side([]) == []


def test_the_first_failure_is_raised_and_pieces_not_begun_are_left_out():
    done = []

    def fails():
        raise ValueError("no light")

    def works(piece):
        time.sleep(0.01)
        done.append(piece)

    with pytest.raises(ValueError, match="no light"):
        side_by_side([fails] + [partial(works, piece) for piece in range(1000)])
    assert len(done) < 1000


def test_pieces_have_the_precision_and_the_context_of_the_caller():
    name = contextvars.ContextVar("name", default="none")
    name.set("caller's")

    def found():
        return jnp.asarray(1.0, float).dtype.name, name.get()

    for double in (True, False):
        with jax.enable_x64(double):
            assert side_by_side([found]) == [("float64" if double else "float32", "caller's")]
