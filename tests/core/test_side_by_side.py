"""Work on all cores, and sums over blocks of samples."""

import contextvars
import threading
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting.inference.in_blocks import mapped, summed
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


class _Samples(eqx.Module):
    value: jax.Array
    error: jax.Array | None
    scale: jax.Array


@pytest.mark.parametrize("count", [1, 7, 8, 9, 100])
def test_blocks_sum_and_map_as_all_samples_at_once(count):
    rng = np.random.default_rng(count)
    value, scale = rng.normal(size=count), 3.0
    samples = _Samples(jnp.asarray(value), None, jnp.asarray(scale))

    def terms(part, counts):
        each = jnp.cos(part.scale * part.value)
        each = each if counts is None else jnp.where(counts, each, 0)
        return jnp.sum(each), jnp.stack([jnp.sum(each), jnp.sum(each**2)])

    one, two = summed(terms, samples, block=8)
    each = np.cos(scale * value)
    np.testing.assert_allclose(one, each.sum(), rtol=1e-13)
    np.testing.assert_allclose(two, [each.sum(), (each**2).sum()], rtol=1e-13)
    found = mapped(lambda part: jnp.stack([part.value, part.scale * part.value]), samples, block=8)
    np.testing.assert_allclose(found, [value, scale * value], rtol=1e-15)
