"""Tests that an interrupt ends a command at once, with one line and status 130, and leaves no
partial file."""

import random
import signal
import subprocess
import sys
import time

import pytest
from fuzz.seeds import TABLE

HEAD = """
import signal, sys, time
from pathlib import Path
from jaxvision.core.interrupts import (
    ending_on_interrupt, is_handled, raised_interrupts, removed_if_interrupted, say_if_interrupted
)
def ready():
    print("ready", flush=True)
"""


def interrupted(work, *arguments, times=1):
    """Return (status, standard output, standard error) after sending signals to work that would
    take an hour."""
    script = f"{HEAD}\ndef work():\n{work}\nending_on_interrupt('name', work)"
    process = subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.readline()  # ready
    time.sleep(0.1)
    for _ in range(times):
        process.send_signal(signal.SIGINT)
        time.sleep(0.2 if times > 1 else 0)
    try:
        out, error = process.communicate(timeout=600)
    finally:
        process.kill()
    return process.returncode, out, error


def test_work_that_never_returns_to_python_ends_with_one_line():
    work = "    import ctypes; ready()\n    ctypes.CDLL(None).sleep(3600)"
    status, _, error = interrupted(work)
    assert (status, error) == (130, "name: interrupted.\n")


def test_a_file_that_is_being_written_is_removed_and_the_line_says_how_to_go_on(tmp_path):
    file, kept = tmp_path / "half", tmp_path / "kept"
    work = """
    half, kept = map(Path, sys.argv[1:])
    kept.write_text("all")
    say_if_interrupted("stopped; go on.")
    with removed_if_interrupted(half):
        half.write_text("ha")
        ready()
        time.sleep(3600)
"""
    status, _, error = interrupted(work, file, kept)
    assert (status, error) == (130, "name: stopped; go on.\n")
    assert not file.exists()
    assert kept.exists()


def test_code_that_asks_for_the_exception_keeps_its_results():
    work = """
    try:
        with raised_interrupts():
            ready()
            time.sleep(3600)
    except KeyboardInterrupt:
        is_handled()
        print("what there is")
"""
    status, out, _ = interrupted(work)
    assert (status, out) == (130, "what there is\n")


def test_code_that_asks_keeps_its_results_however_late_the_thread_looks():
    work = """
    import threading
    from jaxvision import interrupts
    seen = interrupts._ending.seen
    own, main = seen.set, threading.current_thread()
    seen.set = lambda: (threading.current_thread() is main or time.sleep(0.3), own())
    try:
        with raised_interrupts():
            ready()
            time.sleep(3600)
    except KeyboardInterrupt:
        is_handled()
        time.sleep(0.6)
        print("what there is")
"""
    status, out, _ = interrupted(work)
    assert (status, out) == (130, "what there is\n")


def test_a_second_interrupt_ends_code_that_asked_for_the_exception():
    work = """
    with raised_interrupts():
        ready()
        while True:
            try:
                time.sleep(3600)
            except KeyboardInterrupt:
                pass
"""
    status, _, error = interrupted(work, times=2)
    assert (status, error) == (130, "name: interrupted.\n")


def test_without_an_interrupt_nothing_changes():
    script = f"{HEAD}\nending_on_interrupt('name', lambda: sys.exit(3))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (3, b"")


@pytest.mark.parametrize("end", ["sys.exit(3)", "None"])
def test_an_interrupt_after_the_work_changes_nothing(end):
    """The interrupt comes while Python shuts down, which takes JAX a part of a second."""
    late = "atexit.register(lambda: signal.raise_signal(signal.SIGINT))"
    script = f"{HEAD}\nimport atexit; {late}\nending_on_interrupt('name', lambda: {end})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (3 if end != "None" else 0, b"")


COMMANDS = {
    "jaxvision": "render cornell_box --out box.exr --samples 1",
    "fitting": "noise levels.csv --mcmc --out out",
}


@pytest.mark.slow
@pytest.mark.parametrize("module", COMMANDS)
@pytest.mark.parametrize("moment", range(20))
def test_a_command_ends_at_any_moment(tmp_path, module, moment):
    """The interrupt comes at a random moment during imports, tracing, compilation, computation or
    writing."""
    (tmp_path / "levels.csv").write_text(TABLE)
    delay = random.Random(moment).uniform(0.5, 12)
    process = subprocess.Popen(
        [sys.executable, "-m", module, *COMMANDS[module].split()],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        process.wait(delay)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=10)
        assert process.returncode == 130
        last = error.strip().split("\n")[-1]
        assert "interrupted" in last or "goes on from here" in last
        assert "Traceback" not in error
        assert not list(tmp_path.rglob(".partial-*"))
