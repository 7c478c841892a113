"""Run independent tasks in sequence, or with Dask on many processes and machines.

Examples of independent tasks are the tiles or passes of a render, the folders of a study, and the
simulations of a check. Inside `with jaxvision.cluster(client)`, tasks run on the workers of a Dask
client. Results are returned in the order of the tasks, whichever task ends first. On the same type
of processor, a file made from the results has the same bytes with and without workers. If a worker
is lost, another worker repeats the unfinished tasks of the lost worker.
"""

import hashlib
import io
import logging
import math
import platform
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, TypeVar

from . import __version__
from .core._local_workers import CHECK_SECONDS, local_workers, replace_lost
from .core._moved import renamed
from .errors import InputError, install
from .programs import source_digest

if TYPE_CHECKING:
    from distributed import Client, Future

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 4  # bundles per thread that are sent before the first result is used
BUNDLE = 0.5  # s of work in one bundle, if tasks are shorter
PROGRAMS = 0.5e9  # bytes that JAX and small compiled programs take in a worker
TOO_LARGE = 3  # workers restarted for lack of memory while one result is awaited
_PATIENCE = 20.0  # s, for a scheduler to answer
_ASKED = 5  # times that lost workers are asked for their version
_LONELY = 120.0  # s without any worker
_INSTALL = f"install it with {install('cluster')}"

_client: ContextVar["Client | None"] = ContextVar("client", default=None)
_objects: dict[str, Any] = {}  # in a worker: the shared data of the current tasks, by digest


def __getattr__(name: str) -> Any:
    new = renamed(f"{__name__}.{name}")
    if new is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return globals()[new]


@contextmanager
def cluster(client: "Client") -> Iterator[None]:
    """Return a context in which independent tasks run on the workers of a Dask client.

    Args:
        client: `dask.distributed.Client`.

    Returns:
        A context manager.

    Raises:
        InputError: for a client without workers, and for a worker with another version of jaxvision
            (by number or by source), of jax, jaxlib or NumPy, or another kind of device. The error
            is raised before any task runs.

    Example:
        >>> from distributed import Client
        >>> with Client(processes=False, dashboard_address=":0") as client, jv.cluster(client):
        ...     print(list(jv.tasks.map_ordered(pow, 2, [1, 2, 3])))
        [2, 4, 8]
    """
    wanted = _environment()
    found = _answers(client, wanted)
    if not found:
        raise InputError("the Dask client has no workers; start at least one.")
    for address, answer in found.items():
        if isinstance(answer, OSError):
            raise InputError(f"worker {address} was lost before any work ({answer}); start it.")
        # A worker without jaxvision cannot describe the difference
        if isinstance(answer, BaseException):
            raise InputError(
                f"worker {address} cannot run jaxvision {wanted['jaxvision']}: {answer}; "
                "install the same on all machines."
            )
        if answer:
            raise InputError(f"worker {address} {answer}; install the same on all machines.")
    token = _client.set(client)
    try:
        yield
    finally:
        _client.reset(token)


def _answers(client: "Client", wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Return, for each worker, a description of how the worker differs from the client, or an error
    if the worker does not answer. If workers were lost a moment ago, ask again after other workers
    have replaced them."""
    found: Any = {}
    for _ in range(_ASKED):
        found = client.run(_difference, wanted, on_error="return")
        if not any(isinstance(answer, OSError) for answer in found.values()):
            break
        replace_lost(client)
        time.sleep(CHECK_SECONDS)
    return found


@contextmanager
def workers(count: int, *, scheduler: str = "") -> Iterator[None]:
    """Return a context in which tasks run on `count` processes of this machine or on the cluster at
    `scheduler` ("tcp://10.0.0.1:8786"), or in this process if neither is given. Raise `InputError`
    if both are given, if Dask is not installed, if no scheduler answers, and if there is too little
    memory."""
    if count and scheduler:
        raise InputError("--workers and --scheduler exclude each other; give one.")
    if not (count or scheduler):
        yield
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(f"workers need Dask; {_INSTALL}.") from error
    # Waiting that an error has ended is no error of its own.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    if scheduler:
        try:
            client = Client(scheduler, timeout=_PATIENCE)
        except (OSError, ValueError) as error:
            raise InputError(f"{scheduler}: no Dask scheduler answers; check the address.") from (
                error
            )
        with client, cluster(client):
            yield
        return
    with local_workers(count, memory=PROGRAMS) as client, cluster(client):
        yield


def map_ordered(
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Iterable[Item],
    *,
    memory: float = 0.0,
) -> Iterator[Result]:
    """Yield `function(shared, item)` for each item, in order, computed on the workers of `cluster`
    or in this process. `memory` is the number of bytes that a worker needs for the largest task, or
    0 for no check. Raise `InputError` for a worker of another version or with too little memory,
    and for a task during which too many workers were lost."""
    client = _client.get()
    if client is None:
        for item in items:
            yield function(shared, item)
        return
    if memory:
        _check_room(client, memory)
    yield from _run_on(client, function, shared, items)


def _run_on(
    client: "Client",
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Iterable[Item],
) -> Iterator[Result]:
    from distributed.scheduler import KilledWorker

    packed = _pack(shared)
    # The bytes go through the scheduler, which can hand them out again when a worker is lost.
    held = client.submit(bytes, packed, pure=False)
    task = _Task(function, _environment(), hashlib.sha256(packed).hexdigest())
    there: Any = client.nthreads()
    threads = sum(there.values())
    bundles = _Bundles(items, threads)
    waiting: deque[tuple[tuple[Item, ...], Future]] = deque()

    def send(bundle: tuple[Item, ...], *, priority: int = 0) -> "tuple[tuple[Item, ...], Future]":
        return bundle, client.submit(task, held, bundle, pure=False, priority=priority)

    def hand_out(count: int) -> None:
        for _ in range(count):
            bundle = bundles.next()
            if bundle:
                waiting.append(send(bundle))

    hand_out(AHEAD * max(threads, 1))
    try:
        while waiting:
            bundle, future = waiting[0]
            try:
                results, seconds = _await(client, future)
            except KilledWorker as error:
                raise InputError(
                    f"{error.allowed_failures + 1} workers were lost with one task, perhaps for "
                    "want of memory; use fewer workers or smaller tasks."
                ) from error
            waiting.popleft()
            bundles.measured(len(results), seconds)
            rest = bundle[len(results) :]
            if rest:
                waiting.appendleft(send(rest, priority=1))
            else:
                hand_out(1)
            yield from results
    finally:
        client.cancel([*(future for _, future in waiting), held])


def _check_room(client: "Client", needed: float) -> None:
    """Raise `InputError` if a worker has too little memory. The threads of a worker share its
    memory, and each thread works on one task."""
    rooms: Any = client.run(_room, on_error="ignore")  # a worker that was just lost is restarted
    for address, room in rooms.items():
        if room < needed:
            raise InputError(
                f"a task takes about {needed / 1e9:.2g} GB, and worker {address} has "
                f"{room / 1e9:.2g} GB for each; start fewer workers or give them more memory."
            )


def _room(dask_worker: Any) -> float:
    """Return the memory per thread of a worker in bytes, or infinity if the worker has no limit."""
    return (dask_worker.memory_manager.memory_limit or math.inf) / dask_worker.state.nthreads


def _pack(shared: Any) -> bytes:
    """Serialise the shared data of tasks to bytes. Records are rebuilt by `_record`, because
    Equinox 0.13 treats records that pickle creates as unfinished, and never frees them."""
    import cloudpickle
    from equinox import Module

    class Packer(cloudpickle.Pickler):
        def reducer_override(self, obj: Any) -> Any:
            if isinstance(obj, Module) and not isinstance(obj, type):
                return _record, (type(obj), vars(obj))
            return super().reducer_override(obj)

    with io.BytesIO() as stream:
        Packer(stream).dump(shared)
        return stream.getvalue()


def _record(kind: type, fields: Mapping[str, Any]) -> Any:
    """Rebuild an Equinox module from its type and fields, without calling its constructor."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def _await(client: "Client", future: "Future") -> Any:
    """Return the result. Raise `InputError` if all workers are lost or have too little memory for
    it."""
    missed, before = time.monotonic(), None
    while True:
        try:
            return future.result(timeout=CHECK_SECONDS)
        except TimeoutError:
            if future.done():  # finished just now, or failed with a TimeoutError
                return future.result()
        full: Any = client.get_events("worker-restart-memory")
        before = len(full) if before is None else before
        if len(full) - before >= TOO_LARGE:
            raise InputError(
                f"a worker took {full[-1][1]['rss'] / 1e9:.2g} GB, more than its share of memory, "
                f"and was started again, {TOO_LARGE} times; use fewer workers or smaller tasks."
            )
        replace_lost(client)
        if client.nthreads():
            missed = time.monotonic()
        elif time.monotonic() - missed > _LONELY:
            raise InputError(
                f"no worker has been there for {_LONELY:.0f} s; start some, and give the same "
                "command, which goes on from what is done."
            )


class _Bundles:
    """A queue of items, returned in bundles of about `BUNDLE` seconds of work, so that Dask's
    overhead per task is small in comparison. A bundle has at most twice as many items as the bundle
    before, and the last bundles are small."""

    def __init__(self, items: Iterable[Any], threads: int) -> None:
        self._left, self._threads = deque(items), max(threads, 1)
        self._size = 1

    def next(self) -> tuple[Any, ...]:
        """Return the next bundle of items, which is empty after the last item."""
        size = min(self._size, max(len(self._left) // (2 * self._threads), 1))
        return tuple(self._left.popleft() for _ in range(min(size, len(self._left))))

    def measured(self, count: int, seconds: float) -> None:
        """Record the duration of tasks, from which the size of the next bundles follows."""
        fitting = BUNDLE * count / max(seconds, 1e-6)
        self._size = int(min(2 * self._size, max(fitting, 1)))


class _Task:
    """A task that is sent to a worker: a function, and the digest of the shared data that the
    worker unpacks once. A worker that joined after the check of all workers is checked for
    differences from the client before its first task."""

    def __init__(
        self, function: Callable[..., Any], wanted: Mapping[str, Any], digest: str
    ) -> None:
        self.function, self.wanted, self.digest = function, wanted, digest

    def __call__(self, packed: bytes, items: Sequence[Any]) -> tuple[list[Any], float]:
        """Compute the results of the first items of a bundle (at least one), and their duration in
        seconds. If a task fails, or if the bundle's time is used up, return the results so far. The
        failed task is then the first task of another bundle, in which it raises its error."""
        import cloudpickle

        if self.digest not in _objects:
            difference = _difference(self.wanted)  # a worker that joined later
            if difference:
                raise InputError(f"a worker {difference}; install the same on all machines.")
            _objects.clear()
            _objects[self.digest] = cloudpickle.loads(packed)
        begun, results = time.perf_counter(), []
        for item in items:
            try:
                results.append(self.function(_objects[self.digest], item))
            except Exception:
                if not results:
                    raise
                break
            if time.perf_counter() - begun > 2 * BUNDLE:
                break
        return results, time.perf_counter() - begun


def _environment() -> dict[str, Any]:
    """Return everything besides the task on which results depend: versions, source, device, machine
    and precision.
    """
    import jax

    packages = ("jax", "jaxlib", "numpy")
    return {
        "jaxvision": __version__,
        **{name: version(name) for name in packages},
        "source": source_digest(),
        "device": jax.devices()[0].device_kind,
        "machine": platform.machine(),
        "x64": bool(jax.config.read("jax_enable_x64")),
    }


def _difference(wanted: Mapping[str, Any]) -> str:
    """Describe in words how a worker differs from the client. If the worker has another precision,
    its precision is changed, and this difference is not reported."""
    import jax

    jax.config.update("jax_enable_x64", wanted["x64"])
    own = _environment()
    words = [
        f"{name} {own[name]} where {wanted[name]} is wanted"
        for name in own
        if own[name] != wanted[name]
    ]
    return f"has {', '.join(words)}" if words else ""
