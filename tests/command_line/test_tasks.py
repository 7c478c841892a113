"""Tests that independent tasks give the same results on workers as in one process, in the order of
the tasks."""

import gc
import os
import pickle
import signal
import time
import weakref
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import psutil
import pytest
from commands import called
from scene_texts import BALL
from studies import write_camera

import jaxvision as jv
from fitting.checks import noise
from fitting.study.outcomes import Settings, memory_of
from fitting.study.run import study
from jaxvision import programs, tasks
from jaxvision.cli import app
from jaxvision.core import _local_workers
from jaxvision.core._local_workers import replace_lost
from jaxvision.errors import InputError
from jaxvision.files.images import read_image
from jaxvision.files.scenes import read_scene
from jaxvision.files.scenes.schema import override_settings
from jaxvision.render_command import render_to_file

distributed = pytest.importorskip("distributed")
system = pytest.importorskip("distributed.system")


@pytest.fixture(scope="module")
def client():
    """Return a client of three threads of this process, each a worker."""
    made = distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=False, dashboard_address=":0"
    )
    with made, distributed.Client(made) as client:
        yield client


def late_first(shared, item):
    time.sleep(0.2 if item == 0 else 0)
    return shared["factor"] * item


def refusing(shared, item):
    if item == 3:
        raise InputError(f"folder {item} has no images")
    return item


def test_results_come_in_the_order_of_the_tasks(client):
    shared = {"factor": 7}
    alone = list(tasks.map_ordered(late_first, shared, range(40)))
    with jv.cluster(client):
        assert list(tasks.map_ordered(late_first, shared, range(40))) == alone
        assert list(tasks.map_ordered(late_first, shared, [])) == []
    assert alone == [7 * n for n in range(40)]


def test_a_task_that_fails_fails_here_and_the_rest_is_cancelled(client):
    found = []
    with jv.cluster(client), pytest.raises(InputError, match="folder 3 has no images"):
        found.extend(tasks.map_ordered(refusing, None, range(100)))
    with jv.cluster(client):
        some = tasks.map_ordered(refusing, None, range(3))
        assert next(some) == 0
        some.close()


class JustInTime:
    """A future that finishes at the moment when waiting for it times out."""

    def result(self, timeout=None):
        if timeout is not None:
            raise TimeoutError("timed out after 5 s.")
        return 7

    def done(self):
        return True


def out_of_time(shared, item):
    raise TimeoutError(f"the camera of {item} did not answer")


def test_a_timeout_while_waiting_is_no_failure_of_the_task(client):
    assert tasks._await(client, JustInTime()) == 7  # pyright: ignore[reportArgumentType]
    with jv.cluster(client), pytest.raises(TimeoutError, match="the camera of 0"):
        list(tasks.map_ordered(out_of_time, None, range(3)))


def uneven(shared, item):
    if item == shared:
        raise InputError(f"folder {item} has no images")
    time.sleep(2.5 * tasks.BUNDLE if item % 100 == 50 else 0)
    return item


def test_short_tasks_are_sent_in_bundles_without_losses(client, monkeypatch):
    """No task is lost if a bundle is split because one task is long, or if one task fails."""
    sent, found = [], []
    submit = client.submit
    monkeypatch.setattr(tasks, "BUNDLE", 0.1)
    monkeypatch.setattr(client, "submit", lambda *a, **k: sent.append(1) or submit(*a, **k))
    with jv.cluster(client), pytest.raises(InputError, match="folder 277 has no images"):
        found.extend(tasks.map_ordered(uneven, 277, range(400)))
    assert found == list(range(277))
    assert len(sent) < 100


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_bundles_are_all_items_in_order(threads):
    seconds = np.random.default_rng(threads).lognormal(-4, 2, 300)
    made, found, size = tasks._Bundles(range(len(seconds)), threads), [], 1
    lengths = []
    while bundle := made.next():
        assert 1 <= len(bundle) <= size
        assert len(bundle) == 1 or len(bundle) <= (len(seconds) - len(found)) / (2 * threads)
        found += bundle
        lengths.append(len(bundle))
        made.measured(len(bundle), sum(seconds[item] for item in bundle))
        size *= 2
    assert found == list(range(len(seconds)))
    assert max(lengths) > 5


def test_a_worker_of_another_version_is_refused_before_any_work():
    differs = "has jax 0.9.0 where 0.10.2 is wanted"
    other = SimpleNamespace(run=lambda *_, **__: {"tcp://a": "", "tcp://b": differs})
    with pytest.raises(InputError, match=f"worker tcp://b {differs}"), jv.cluster(other):
        pass
    wanted = tasks._environment() | {"jax": "0.0.1"}
    assert tasks._difference(wanted).endswith("where 0.0.1 is wanted")
    assert tasks._difference(tasks._environment()) == ""
    late = tasks._Task(refusing, wanted, "digest of another study")
    with pytest.raises(InputError, match="a worker has jax"):
        late(b"", 0)


def test_a_client_that_cannot_work_is_a_sentence():
    with (
        pytest.raises(InputError, match="client has no workers"),
        jv.cluster(SimpleNamespace(run=lambda *_, **__: {})),
    ):
        pass

    lacking = {"tcp://a": ModuleNotFoundError("No module named 'jaxvision'")}
    with (
        pytest.raises(InputError, match=r"worker tcp://a cannot run jaxvision .*No module named"),
        jv.cluster(SimpleNamespace(run=lambda *_, **__: lacking)),
    ):
        pass


def test_a_worker_that_is_lost_at_the_start_is_asked_again(monkeypatch):
    monkeypatch.setattr(tasks, "CHECK_SECONDS", 0.0)
    lost, there = {"tcp://a": ConnectionError("Stream is closed")}, {"tcp://b": ""}
    answers = [lost, lost, there]
    replaced = SimpleNamespace(run=lambda *_, **__: answers.pop(0), cluster=None, nthreads=dict)
    with jv.cluster(replaced):
        assert not answers
    for_ever = SimpleNamespace(run=lambda *_, **__: lost, cluster=None, nthreads=dict)
    with (
        pytest.raises(InputError, match="worker tcp://a was lost before any work"),
        jv.cluster(for_ever),
    ):
        pass


def test_the_source_of_a_version_counts(tmp_path, monkeypatch):
    for changed in ("alike", "other"):
        for package in ("jaxvision", "fitting"):
            (tmp_path / changed / package).mkdir(parents=True)
            (tmp_path / changed / package / "a.py").write_text("a = 1\n")
    (tmp_path / "other" / "fitting" / "a.py").write_text("a = 2\n")
    found = []
    for copy in ("alike", "other"):
        monkeypatch.setattr(programs, "__file__", str(tmp_path / copy / "jaxvision" / "a.py"))
        found.append(programs.source_digest.__wrapped__())
    assert found[0] != found[1]
    (tmp_path / "alike" / "fitting" / "a.pyc").write_text("compiled")
    monkeypatch.setattr(programs, "__file__", str(tmp_path / "alike" / "jaxvision" / "a.py"))
    assert programs.source_digest.__wrapped__() == found[0]


def test_more_workers_than_memory_are_refused_before_they_start():
    refused = pytest.raises(InputError, match=r"100000 workers take 5e\+04 GB .* at most \d+\.")
    with refused, tasks.workers(100_000):
        pass


def test_without_any_worker_left_it_does_not_wait_for_ever(monkeypatch):
    monkeypatch.setattr(tasks, "CHECK_SECONDS", 0.05)
    monkeypatch.setattr(tasks, "_LONELY", 0.2)
    made = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    )
    with made, distributed.Client(made) as client, jv.cluster(client):
        some = tasks.map_ordered(late_first, {"factor": 1}, range(9))
        assert next(some) == 0
        made.scale(0)
        with pytest.raises(InputError, match="no worker has been there"):
            list(some)


def test_a_task_larger_than_a_workers_memory_is_refused_before_any_work(client, tmp_path):
    limits = client.run(lambda dask_worker: dask_worker.memory_manager.memory_limit)
    with (
        jv.cluster(client),
        pytest.raises(InputError, match=r"a task takes about .* GB, and worker"),
    ):
        list(tasks.map_ordered(late_first, {}, [1], memory=2 * max(limits.values())))
    unlimited = SimpleNamespace(
        memory_manager=SimpleNamespace(memory_limit=None), state=SimpleNamespace(nthreads=2)
    )
    assert tasks._room(unlimited) == np.inf
    folder = write_camera(tmp_path / "camera", seed=0, levels=4, side=16)
    assert 0.7e9 < memory_of(folder) < 0.8e9


class Nanny:
    """Stands for the object that watches one process of a local cluster."""

    def __init__(self, pid, closed):
        self.pid, self.closed = pid, closed

    def close(self):
        self.closed.append(self)


def test_processes_lost_while_they_started_are_replaced_and_others_left_alone():
    closed, asked = [], []
    dead, alive = Nanny(None, closed), Nanny(7, closed)
    made = SimpleNamespace(
        worker_spec={0: {}, 1: {}},
        workers={0: dead, 1: alive},
        sync=lambda call: call(),
        scale=asked.append,
    )
    lost = SimpleNamespace(cluster=made, nthreads=lambda: {"tcp://b": 1})
    replace_lost(lost)  # pyright: ignore[reportArgumentType]
    assert closed == [dead]
    assert made.workers == {1: alive}
    assert asked == [2]
    whole = SimpleNamespace(cluster=made, nthreads=lambda: {"tcp://a": 1, "tcp://b": 1})
    elsewhere = SimpleNamespace(cluster=None, nthreads=dict)
    for client in (whole, elsewhere):
        replace_lost(client)  # pyright: ignore[reportArgumentType]
    assert (len(closed), asked) == (1, [2])


def test_workers_lost_while_they_start_are_tried_again(monkeypatch):
    tried, made = [], object()

    def start(**settings):
        tried.append(settings["n_workers"])
        if len(tried) < _local_workers.STARTS:
            raise RuntimeError("Nanny failed to start")
        return made

    monkeypatch.setattr(distributed, "LocalCluster", start)
    assert _local_workers._start(2) is made
    assert tried == [2] * _local_workers.STARTS
    tried.clear()
    monkeypatch.setattr(_local_workers, "STARTS", 0)
    with pytest.raises(InputError, match="2 workers could not be started"):
        _local_workers._start(2)


def test_wrong_options_are_sentences(tmp_path, monkeypatch):
    asked = ("render", "cornell_box", "--out", tmp_path / "a.exr", "--workers", 2)
    status, _, said = called(app, *asked, "--scheduler", "tcp://localhost:1")
    assert status == 2
    assert "--workers and --scheduler exclude each other" in said
    monkeypatch.setattr(tasks, "_PATIENCE", 0.2)
    status, _, said = called(app, *asked[:4], "--scheduler", "tcp://127.0.0.1:1")
    assert status == 2
    assert "tcp://127.0.0.1:1: no Dask scheduler answers" in said


def test_a_picture_has_the_same_bits(client, tmp_path):
    (tmp_path / "ball.toml").write_text(BALL)
    source = read_scene(tmp_path / "ball.toml")
    settings = replace(source, render=source.render.model_copy(update={"tile": 5})).render
    counted = []
    render_to_file(source, tmp_path / "alone.exr", settings)
    with jv.cluster(client):
        render_to_file(
            source, tmp_path / "many.exr", settings, advance=lambda *n: counted.append(n)
        )
    np.testing.assert_array_equal(*(read_image(tmp_path / f"{n}.exr") for n in ("alone", "many")))
    assert counted == [(n, 10) for n in range(11)]


@pytest.mark.slow
def test_records_shared_by_tasks_are_freed_after_them():
    """Equinox would keep every module that plain pickle makes, one scene for each render."""
    light = jv.PointLight([1.0, 2.0, 3.0], [4.0])
    made = pickle.loads(tasks._pack({"light": light, "add": lambda x: x + 1}))
    np.testing.assert_array_equal(made["light"].position, light.position)
    assert made["add"](1) == 2
    known = weakref.ref(made.pop("light"))
    gc.collect()
    assert known() is None


@pytest.mark.slow
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_tasks_like_earlier_ones_compile_nothing(tmp_path, caplog, every):
    """Repeated compilations, or caches of JAX that grow with each task, would add up in a
    worker."""
    (tmp_path / "ball.toml").write_text(BALL)
    folder = write_camera(tmp_path / "camera", seed=0, levels=4, side=16) if every else None

    def tasks_of(seed):
        for integrator in ("path", "light") if every else ("path",):
            source = read_scene(tmp_path / "ball.toml")
            given = {"integrator": integrator, "samples": 2, "seed": seed}
            render_to_file(
                source,
                tmp_path / f"{integrator}{seed}.exr",
                override_settings(source.render, given),
            )
        if folder is not None:
            noise.places(noise.CASES["5 levels"], seed)
            study([folder], tmp_path / str(seed), Settings("noise"))
        gc.collect()
        return jnp.true_divide._cache_size()

    with jax.enable_x64(True):
        tasks_of(0)
        before = tasks_of(1)
        caplog.clear()
        with jax.log_compiles():
            after = tasks_of(2)
    assert [record.message for record in caplog.records if "Compiling" in record.message] == []
    assert after == before


def greedy(shared, item):
    held = np.ones(shared)
    time.sleep(5)
    return held.sum()


@pytest.mark.slow
def test_a_task_too_large_for_its_workers_memory_is_a_sentence(monkeypatch):
    monkeypatch.setattr(_local_workers, "MEMORY", 700e6 / system.MEMORY_LIMIT)
    sentence = r"a worker took 0.* GB, more than its share of memory, and was started again, 3"
    with tasks.workers(1):
        assert list(tasks.map_ordered(greedy, 10, range(1))) == [10]
        with pytest.raises(InputError, match=sentence):
            list(tasks.map_ordered(greedy, 100_000_000, range(2)))


def slow_tile(shared, item):
    """Return the result of a tenth of a second of arithmetic, in which each number depends on the
    previous ones."""
    rng = np.random.default_rng((shared, item))
    time.sleep(0.1)
    return rng.standard_normal(1000).cumsum()


def worker_processes():
    children = psutil.Process(os.getpid()).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


@pytest.mark.slow
def test_killed_workers_are_replaced_and_nothing_is_lost_or_doubled():
    """One of two processes is killed at 20 random moments during 200 tasks."""
    alone = list(tasks.map_ordered(slow_tile, 3, range(200)))
    rng, found, kills = np.random.default_rng(0), [], 0
    with tasks.workers(2):
        until = time.monotonic()
        for result in tasks.map_ordered(slow_tile, 3, range(200)):
            found.append(result)
            if kills < 20 and time.monotonic() > until:
                rng.choice(worker_processes()).send_signal(signal.SIGKILL)
                kills, until = kills + 1, time.monotonic() + rng.uniform(0.1, 0.6)
    assert kills == 20
    np.testing.assert_array_equal(found, alone)
