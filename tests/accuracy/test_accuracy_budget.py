"""Tests of time budgets: growing times are predicted, and a measurement that exceeds its prediction
is abandoned."""

import subprocess
import sys
import threading
from dataclasses import replace

import jax
import numpy as np
import pytest
from commands import called
from scene_texts import BALL

from jaxvision.accuracy import Knob, Problem, choose, combined, curve, deadlines, plot
from jaxvision.accuracy.curves import KEPT, LEAST, WORTH, measure_in_turn
from jaxvision.accuracy.deadlines import OutOfTime, run_within
from jaxvision.accuracy.pages import write_page
from jaxvision.accuracy.scenes import scene_problem
from jaxvision.accuracy.tables import json_sheet, notes, rows
from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.scenes import read_scene

KNOB = Knob("n", "nodes", "", (1, 2, 3, 4, 5), (6, 8))
DRAWS = replace(KNOB, random=True, order=-0.5)


class Clock:
    """A clock that advances when a waiting caller reads it, by a thousandth of a 60 s budget, while
    a call still has time to spend."""

    def __init__(self):
        self.now, self.spent, self.done = 0.0, 0.0, threading.Event()

    def __call__(self):
        step = min(self.spent, 0.06)
        self.now, self.spent = self.now + step, self.spent - step
        if self.spent <= 0:
            self.done.set()
        return self.now

    def spend(self, seconds):
        self.done, self.spent = threading.Event(), seconds
        self.done.wait()


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that stops when a call is abandoned."""
    kept, leave = Clock(), deadlines._Hand.leave

    def left_behind(hand, job):
        kept.spent = 0.0
        kept.done.set()
        leave(hand, job)
        job.ended.wait()

    monkeypatch.setattr(deadlines, "TICK", 1e-4)
    monkeypatch.setattr(deadlines._Hand, "leave", left_behind)
    return kept


def growing(clock, *, compiling=lambda n: 0.0, running=lambda n: 1e-3):
    """Return a problem with an error of 1 / n^2 and given times to compile and to run."""

    def prepare(settings):
        n, state = settings["n"], {"first": True}

        def compute(seed):
            clock.spend(running(n) + (compiling(n) if state.pop("first", False) else 0.0))
            return np.full(4, 1 + n**-2.0) + 1e-9 * seed

        return compute

    return Problem("growing", prepare)


@pytest.mark.parametrize("knob", [KNOB, DRAWS])
@pytest.mark.parametrize(
    "growth",
    [
        {"compiling": lambda n: 0.02 * 30.0**n},
        {"running": lambda n: 1e-3 * 30.0**n},
        {"compiling": lambda n: 0.1 * n**4, "running": lambda n: 0.02 * n**3},
        {"compiling": lambda n: 20.0},
    ],
)
@pytest.mark.parametrize("seconds", [10.0, 60.0])
def test_growth_is_foreseen_and_the_budget_kept(clock, knob, growth, seconds):
    """The time grows by a factor of 30 from each setting to the next, or by a power law."""
    found = curve(growing(clock, **growth), knob, seconds=seconds, clock=clock)
    assert clock.now <= 1.1 * seconds
    run = [trial.setting for trial in found.trials]
    assert run == list(KNOB.settings[: len(run)])
    assert found.not_run == KNOB.settings[len(run) :]
    assert not found.not_run or found.stopped.startswith("out of time")


def test_one_program_from_a_cache_does_not_look_like_growth(clock):
    """The first setting compiles in no time, as from a cache, and the others in 8 s each. All of
    them fit into two minutes."""
    first = growing(clock, compiling=lambda n: 0.05 if n == 1 else 8.0)
    found = curve(first, KNOB, seconds=120.0, clock=clock)
    assert not found.not_run


def hanging(clock, at):
    """Return a problem that never finishes compiling one setting, without any sign of it in earlier
    settings."""
    plain = growing(clock)

    def prepare(settings):
        if settings["n"] != at:
            return plain.prepare(settings)

        return lambda seed: clock.spend(np.inf)

    return Problem("hanging", prepare)


@pytest.mark.parametrize("knob", [KNOB, DRAWS])
@pytest.mark.parametrize("at", [3, 5, 6, 8])
def test_a_setting_that_exceeds_its_prediction_is_given_up_and_the_rest_kept(clock, knob, at):
    """A setting or a reference takes longer than predicted. The errors of the settings that were
    run are still known."""
    assumed = replace(knob, reference=(at,)) if at > 5 else knob
    found = curve(hanging(clock, at), assumed, seconds=60.0, clock=clock)
    assert clock.now <= 66.0
    assert found.stopped.startswith(f"out of time ({at} was given up after ")
    assert found.not_run == tuple(n for n in KNOB.settings if n >= at)
    assert np.isfinite(found.reference.error)
    told = notes([found])
    assert f"n: {found.stopped}" in told[-1]


def test_the_first_setting_is_given_up_and_the_other_knobs_still_have_their_time(clock):
    hangs, runs = hanging(clock, 1), growing(clock)
    other = replace(KNOB, name="other")
    problems = {"n": (hangs, KNOB), "other": (Problem("runs", _renamed(runs)), other)}

    def measure(name, share):
        return curve(*problems[name], seconds=share, clock=clock)

    first, second = measure_in_turn(["n", "other"], measure, seconds=100.0, clock=clock)
    assert clock.now <= 110.0
    assert (first.trials, first.reference.how, first.not_run) == ((), "none", KNOB.settings)
    assert len(second.trials) == 5
    both = replace(runs, settings={"n": 2, "other": 2})
    assert rows(both, [first, second])[1][2] == "not reached: no error is known"
    assert "n: out of time (1 was given up" in notes([first])[0]
    assert json_sheet(both, [first, second])["knobs"][0]["trials"] == []
    assert combined([first, second], both.settings, tolerance=0.3).unknown == ("n",)
    assert plot(first).texts
    for asked in ({"tolerance": 0.1}, {"seconds": 1.0}):
        with pytest.raises(InputError, match=r"no error is known|none was run"):
            choose(first, **asked)


def _renamed(problem):
    return lambda settings: problem.prepare({"n": settings["other"]})


def test_a_budget_that_is_used_up_begins_nothing():
    def prepare(settings):
        raise AssertionError

    assert curve(Problem("late", prepare), KNOB, seconds=LEAST, clock=Clock()).trials == ()


def test_an_interrupt_before_a_later_knob_keeps_the_earlier_ones(clock):

    def measure(name, share):
        if name == "b":
            raise KeyboardInterrupt
        return curve(growing(clock), KNOB, seconds=share, clock=clock)

    (kept,) = measure_in_turn(["a", "b", "c"], measure, seconds=60.0, clock=clock)
    assert kept.stopped == "interrupted"
    with pytest.raises(KeyboardInterrupt):
        measure_in_turn(["b"], measure, seconds=60.0, clock=clock)


def test_unused_time_of_other_knobs_goes_to_a_knob_whose_share_was_too_short(clock):
    """Each setting of one knob compiles for 8 s, so none fits into a third of 45 s, and all but one
    fit into the time that two quick knobs do not use."""
    slow, quick = growing(clock, compiling=lambda n: 8.0), growing(clock)
    shares = []

    def measure(name, share):
        shares.append((name, share))
        problem = replace(slow, compiling=8.0) if name == "slow" else quick
        return curve(problem, KNOB, seconds=share, clock=clock)

    found = measure_in_turn(["slow", "quick", "other"], measure, seconds=45.0, clock=clock)
    assert [name for name, _ in shares] == ["slow", "quick", "other", "slow"]
    assert clock.now <= 1.1 * 45.0
    assert len(found[0].trials) >= 2
    assert np.isfinite(found[0].reference.error)

    def interrupted(name, share):
        if len(shares) == 7:
            raise KeyboardInterrupt
        return measure(name, share)

    kept = measure_in_turn(["slow", "quick", "other"], interrupted, seconds=45.0, clock=clock)
    assert [one.stopped for one in kept] == ["interrupted", "", ""]


def test_programs_that_are_kept_are_not_compiled_again_when_a_knob_is_measured_again(clock):
    """The second measurement then has time for more settings within half of the knob's share."""
    programs, plain = set(), growing(clock)

    def prepare(settings):
        compute, name = plain.prepare(settings), settings["n"]

        def compiling(seed):
            clock.now += 0.0 if name in programs else 6.0
            programs.add(name)
            return compute(seed)

        return compiling

    kept = replace(plain, prepare=prepare, compiled=lambda s: s["n"] in programs, compiling=6.0)

    def measure(name, share):
        return curve(kept if name == "kept" else plain, KNOB, seconds=share, clock=clock)

    def settings_run(worth):
        programs.clear()
        begun = clock.now
        first, _ = measure_in_turn(
            ["kept", "quick"], measure, seconds=60.0, worth=worth, clock=clock
        )
        assert clock.now - begun <= 1.1 * 60.0
        return len(first.trials)

    assert settings_run(KEPT) > settings_run(WORTH)


def test_work_within_a_time_limit_behaves_as_in_the_caller(monkeypatch):
    """`run_within` passes on the result, the errors and the precision of the caller, and abandoned
    work ends."""
    monkeypatch.setattr(deadlines, "TICK", 1e-3)
    assert run_within(lambda: 3, lambda: 1.0) == 3
    with pytest.raises(InputError, match="wrong"):
        run_within(lambda: _raise(InputError("wrong")), lambda: 1.0)
    before = bool(jax.config.jax_enable_x64)
    with jax.enable_x64(not before):
        assert run_within(lambda: bool(jax.config.jax_enable_x64), lambda: 1.0) != before
    assert run_within(lambda: bool(jax.config.jax_enable_x64), lambda: 1.0) == before
    may_end, ended, left = threading.Event(), threading.Event(), iter([1.0, 1.0, 0.0])

    def endless():
        may_end.wait()
        ended.set()

    with pytest.raises(OutOfTime):
        run_within(endless, lambda: next(left))
    assert not ended.is_set()
    may_end.set()
    ended.wait()
    assert run_within(lambda: 4, lambda: 1.0) == 4


def _raise(error):
    raise error


def test_a_reference_of_another_shape_is_a_sentence():
    problem = Problem("four", lambda settings: lambda seed: np.full(4, 1 + settings["n"] ** -2.0))
    assert curve(problem, KNOB, reference=np.ones(4), seconds=np.inf).trials
    for shape in ((3,), (2, 4), (4, 1)):
        with pytest.raises(InputError, match=r"a result has shape \(4,\)"):
            curve(problem, KNOB, reference=np.ones(shape), seconds=np.inf)


def test_a_scene_that_cannot_be_begun_in_time_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(deadlines, "TICK", 1e-4)  # even if its program is cached by an earlier test
    (tmp_path / "ball.toml").write_text(BALL)
    with pytest.raises(InputError, match=r"was not compiled and run within 0\.001 s"):
        scene_problem(read_scene(tmp_path / "ball.toml"), seconds=1e-3)
    status, _, said = called(app, "accuracy", tmp_path / "ball.toml", "--seconds", 1e-3)
    assert status == 2
    assert "allow more" in said


@pytest.mark.parametrize(
    ("result", "sentence"),
    [
        (lambda n: np.ones(n), r"has shape \(2,\), that of others \(1,\)"),
        (lambda n: np.zeros(0), "is empty; give at least one number"),
        (lambda n: np.ones(2) * 1j, "is complex128; give real numbers"),
        (lambda n: np.array(["a"]), "give real numbers"),
        (lambda n: ([1.0], [1.0, 2.0]), "is no array; give real numbers"),
    ],
)
def test_results_that_cannot_be_compared_are_sentences(result, sentence):
    problem = Problem("odd", lambda settings: lambda seed: result(settings["n"]))
    with pytest.raises(InputError, match=sentence):
        curve(problem, KNOB, seconds=np.inf)


def test_wrong_limits_and_settings_are_sentences(clock):
    problem = growing(clock)
    found = curve(problem, KNOB, clock=clock)
    for asked in ({"tolerance": -1.0}, {"tolerance": np.nan}, {"seconds": -1.0}):
        with pytest.raises(InputError, match="of at least 0"):
            choose(found, **asked)
        with pytest.raises(InputError, match="of at least 0"):
            combined([found], {"n": 2}, **asked)
    with pytest.raises(InputError, match="base has no setting of 'n'"):
        combined([found], {}, tolerance=0.1)
    with pytest.raises(InputError, match="a number, a word or a tuple"):
        curve(problem, KNOB, settings=([1], [2]))
    with pytest.raises(InputError, match="at least 2 seeds"):
        curve(problem, KNOB, seeds=2.5)


@pytest.mark.parametrize("end", ["pass", "raise SystemExit(3)", "sys.exit('wrong')"])
def test_a_command_ends_without_waiting_for_abandoned_work(end):
    """The process ends with its own status, although an abandoned thread would run for another
    hour."""
    script = f"""
import sys, threading
from jaxvision.core.interrupts import ending_on_interrupt, leaves_work_behind
def work():
    threading.Thread(target=threading.Event().wait, args=(3600,)).start()
    leaves_work_behind()
    print("said")
    {end}
ending_on_interrupt("jaxvision", work)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "said\n"
    assert done.returncode == {"pass": 0, "raise SystemExit(3)": 3}.get(end, 1)


def test_timings_beside_abandoned_work_are_marked(monkeypatch, tmp_path):
    """Abandoned work outlasts the waiting time, so timings made while it runs are marked. Later
    ones are not."""
    monkeypatch.setattr(deadlines, "TICK", 1e-3)
    may_end = threading.Event()

    def prepare(settings):
        n = settings["n"]

        def compute(seed):
            if n == 3:
                may_end.wait()
            return np.full(4, 1 + n**-2.0) + 1e-9 * seed

        return compute

    held = Problem("held", prepare)
    slow = curve(held, KNOB, seconds=0.4)
    assert slow.stopped.startswith("out of time (3 was given up")
    other = curve(held, replace(KNOB, settings=(1, 2)), seconds=0.2)
    assert [trial.beside for trial in other.trials] == [True, True]
    said = "n: abandoned work was still running during these timings, so they are too long: 1, 2."
    assert said in notes([other])[-1]
    assert said in json_sheet(held, [other])["notes"][-1]
    write_page(tmp_path, held, [other], command="")
    assert said in (tmp_path / "accuracy.html").read_text()
    threading.Timer(0.05, may_end.set).start()
    after = curve(held, KNOB, seconds=np.inf)
    assert [trial.beside for trial in after.trials] == [False] * 5
