"""Tests data read in chunks: the fit equals the one in memory, from a file and from a function, and
unreadable data are refused."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Censored, Clustered, Emcee, Gaussian, Parameter, Problem, fit
from fitting.inference.misfit import judge, judge_sums, sums
from fitting.inference.search import search, search_read, spread_starts
from fitting.inference.streams import chunks
from jaxvision.errors import InputError

COUNT, CHUNK = 10_300, 1_000  # the last chunk has 300 rows
TIME = np.linspace(0.0, 3.0, COUNT)
RNG = np.random.default_rng(0)
DECAY = 2 * np.exp(-1.3 * TIME) + 0.02 * RNG.standard_normal(COUNT)
DECAY[17] = np.nan
SD = 0.02 * (1 + 0.1 * np.sin(np.arange(COUNT)))
FREE = {
    "height": Parameter(lower=0, upper=10),
    "rate": Parameter(lower=0.01, upper=50, transform="log"),
}
SMALL = Gaussian(0.02)
CLIPPED = Censored(0.02, low=0.1)


def decay(height, rate, inputs):
    return height * jnp.exp(-rate * inputs)


def problem(data=DECAY, likelihood=SMALL, inputs=TIME, **options):
    return Problem(FREE, decay, likelihood, data, inputs=inputs, **options)


def ignored(done, whole):
    """Ignore the progress."""


def yielded():
    """Yield pieces of other lengths than a chunk, one of them longer."""
    for begin, end in [(0, 777), (777, 800), (800, 4000), (4000, COUNT)]:
        yield DECAY[begin:end], TIME[begin:end]


def line(base, slope, inputs):
    return base + slope * inputs["time"] + 0 * inputs["knots"].sum()


@pytest.mark.slow
def test_a_line_in_chunks_equals_weighted_least_squares(tmp_path):
    """The reference is NumPy's closed form, for a memory-mapped file, an error of each datum, and
    inputs not ordered by rows."""
    values = 1.0 - 0.2 * TIME + SD * RNG.standard_normal(COUNT)
    values[[17, 10_299]] = np.nan
    np.save(tmp_path / "data.npy", values)
    found = fit(
        Problem(
            {"base": Parameter(start=0.0), "slope": Parameter(start=0.0)},
            line,
            Gaussian(SD),
            np.load(tmp_path / "data.npy", mmap_mode="r"),
            inputs={"time": TIME, "knots": np.arange(3.0)},
            chunk=CHUNK,
        ),
        starts=1,
    )
    there = ~np.isnan(values)
    design = (np.stack([np.ones(COUNT), TIME], axis=1) / SD[:, None])[there]
    best, chi_square, *_ = np.linalg.lstsq(design, (values / SD)[there], rcond=None)
    covariance = np.linalg.inv(design.T @ design)
    missed = np.array([e.value for e in found.estimates]) - best
    # A step with a predicted gain of 1e-7 in log density is not taken, which is sqrt(2e-7) standard
    # errors.
    assert (np.abs(missed) < 5e-4 * np.sqrt(np.diag(covariance))).all()
    np.testing.assert_allclose(found.posterior.covariance, covariance, rtol=1e-9)
    np.testing.assert_allclose(found.misfit.chi_square, chi_square[0], rtol=1e-8)
    assert found.misfit.count == COUNT - 2
    assert found.residuals.shape == (CHUNK,)
    assert found.converged


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", [CLIPPED, SMALL])
def test_a_generator_gives_the_fit_in_memory(likelihood):
    """The results agree within the search's tolerance, a thousandth of a standard error."""
    found = fit(problem(yielded, likelihood, None, chunk=CHUNK), starts=4)
    expected = fit(problem(likelihood=likelihood), starts=4)
    for one, other in zip(found.estimates, expected.estimates, strict=True):
        assert abs(one.value - other.value) < 1e-3 * other.standard_error
    np.testing.assert_allclose(found.posterior.covariance, expected.posterior.covariance, rtol=1e-5)
    np.testing.assert_allclose(found.misfit.chi_square, expected.misfit.chi_square, rtol=1e-5)
    np.testing.assert_allclose(found.misfit.correlation, expected.misfit.correlation, rtol=1e-4)
    assert found.misfit.count == COUNT - 1
    assert found.converged


def test_chunks_have_one_shape_and_every_datum_once():
    told = []
    parts = list(
        chunks(problem(yielded, inputs=None, chunk=CHUNK), advance=lambda *x: told.append(x))
    )
    assert {part.data.shape for part in parts} == {(CHUNK,)}
    there = [np.asarray(part.present) for part in parts]
    read = np.concatenate([part.data[known] for part, known in zip(parts, there, strict=True)])
    times = np.concatenate([part.inputs[known] for part, known in zip(parts, there, strict=True)])
    np.testing.assert_array_equal(read, DECAY[~np.isnan(DECAY)])
    np.testing.assert_array_equal(times, TIME[~np.isnan(DECAY)])
    assert told == [(i + 1, 11) for i in range(11)]


def test_a_sample_is_spread_over_all_data():
    drawn = problem(chunk=CHUNK)
    times = np.asarray(drawn.inputs)
    assert (np.diff(times) > 0).all()
    # For a thousand of 10,300 data, evenly drawn, the 99.9 % quantile of the largest deviation is
    # 1.95 / sqrt(1000).
    assert np.abs(times / 3 - (np.arange(CHUNK) + 0.5) / CHUNK).max() < 0.062
    few = problem(DECAY[:300], inputs=TIME[:300], chunk=CHUNK)
    assert int(few.present.sum()) == 299
    again = drawn.with_data(DECAY[:300], inputs=TIME[:300])
    assert again.stream.count == 300


def test_sums_over_parts_judge_like_the_whole():
    residuals = RNG.standard_normal((50, 7)).cumsum(axis=0)
    residuals[20, 3] = np.nan
    parts = sums(residuals[:20]) + sums(residuals[20:], before=residuals[19])
    whole, found = judge(residuals, 2.0), judge_sums(parts, 2.0)
    np.testing.assert_allclose(found.correlation, whole.correlation, rtol=1e-12)
    np.testing.assert_allclose(found.significance, whole.significance, rtol=1e-12)
    np.testing.assert_allclose(found.chi_square, whole.chi_square, rtol=1e-12)
    assert found.faults == whole.faults != ()


def test_inputs_with_as_many_rows_as_a_chunk_by_chance_are_given_whole():
    """The last chunk has twelve rows, like a table among the inputs."""
    table, time = np.linspace(1, 2, 12), TIME[:112]
    data = 2 * time + table.sum()

    def pieces():
        for begin in (0, 100):
            part = slice(begin, begin + 100)
            yield data[part], {"time": time[part], "knots": table}

    free = {"base": Parameter(start=0.0), "slope": Parameter(start=0.0)}
    for source, inputs in ((data, {"time": time, "knots": table}), (pieces, None)):
        stated = Problem(free, line, SMALL, source, inputs=inputs, chunk=100)
        read = list(chunks(stated))
        assert len(read) == 2
        for part in (stated, *read):
            np.testing.assert_array_equal(part.inputs["knots"], table)
            assert part.inputs["time"].shape == (100,)


class Changing:
    """Yields fewer data at every call."""

    def __init__(self):
        self.count = 100

    def __call__(self):
        self.count -= 1
        yield np.ones(self.count), np.ones(self.count)


@pytest.mark.parametrize(
    ("data", "options", "expected"),
    [
        (yielded(), {}, "an iterator ends after one reading"),
        (DECAY, {"likelihood": Clustered(SMALL, np.zeros(COUNT, int))}, "leave chunk out"),
        (DECAY, {"chunk": 0}, "number of rows"),
        (DECAY, {"chunk": 7.5}, "whole number of rows"),
        (lambda: iter(()), {}, "there are none"),
        (lambda: iter([(np.ones(3), np.ones(3)), (np.ones((3, 2)), np.ones(3))]), {}, "row has"),
        (np.array([1.0, np.inf]), {"inputs": np.ones(2)}, "infinite"),
        (lambda: iter([(np.ones(3), np.ones(3)), (np.ones(2), np.ones(3))]), {}, "as many rows"),
        (lambda: iter([(np.ones(3), 1.0), (np.ones(3), 2.0)]), {}, "unchanged"),
    ],
)
def test_unreadable_data_are_named(data, options, expected):
    with pytest.raises(InputError, match=expected):
        problem(data, **({"chunk": CHUNK} | options))


def test_data_that_change_and_chains_are_refused():
    changing = problem(Changing(), inputs=None, chunk=64)
    with pytest.raises(InputError, match="the same data each time"):
        list(chunks(changing))
    with pytest.raises(InputError, match="reads all data at every step"):
        fit(problem(chunk=CHUNK), posterior=Emcee())


@pytest.mark.parametrize(
    ("again", "expected"),
    [
        (lambda rows: rows[:80], "80 rows were read, and 100 at first"),
        (lambda rows: rows + 1e-9, "100 rows were read as at first, but with other numbers"),
        (lambda rows: rows[::-1], None),  # another order is allowed
    ],
)
def test_a_source_is_compared_with_its_first_reading(again, expected):
    """The first call is already the first reading of the data."""
    rows, calls = np.arange(100.0), []

    def source():
        calls.append(0)
        own = rows if len(calls) == 1 else again(rows)
        yield from ((part, part) for part in np.array_split(own, 2 + len(calls)))

    stated = problem(source, inputs=None, chunk=64)
    assert stated.stream is not None
    assert stated.stream.count == 100
    if expected is None:
        assert len(list(chunks(stated))) == 2
        return
    with pytest.raises(InputError, match=expected):
        list(chunks(stated))


@pytest.mark.slow
def test_ends_that_a_sample_cannot_distinguish_count_as_one():
    """Searches on a sample stop within its precision, which is coarser than that of all data."""
    own = problem(chunk=CHUNK)
    sampled = search(own, jnp.asarray(spread_starts(own, 4, seed=0)))
    sd = 1 / np.sqrt(np.diagonal(sampled.information))
    moved = sampled.ends + 0.05 * sd * np.array([[0.0], [1.0], [-1.0], [1000.0]])
    found = search_read(own, replace(sampled, ends=moved), ignored)
    assert (found.costs[:3] == 0).all()
    assert found.costs[3] > 1
