"""Start Dask worker processes on this machine, and restart them.

Each process has one thread, also for XLA and BLAS, and a share of the memory. Each process inherits
the environment variables that affect JAX's results.
"""

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

LOSSES = 100  # a task is abandoned after this number of workers have died during it
CHECK_SECONDS = 5.0  # s between two checks of the workers while a result is awaited
MEMORY = 0.9  # fraction of the machine's memory for all workers together
STARTS = 3  # number of attempts to start all workers; a worker may die during its start


@contextmanager
def local_workers(count: int, *, memory: float) -> "Iterator[Client]":
    """Yield a Dask client with `count` worker processes on this machine. Each worker has one thread
    and needs `memory` bytes. All workers share the folder of compiled programs."""
    from dask import config
    from distributed import Client
    from distributed.system import MEMORY_LIMIT

    room = MEMORY * MEMORY_LIMIT
    if count * memory > room:
        raise InputError(
            f"{count} workers take {count * memory / 1e9:.3g} GB before any work, and this machine "
            f"has {room / 1e9:.3g} GB for them; start as many as it has cores, at most "
            f"{room // memory:.0f}."
        )

    single = {
        "NPROC": "1",  # size of XLA's thread pool
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
    }
    # variables that affect results, and the folder of compiled programs
    jax_variables = {k: v for k, v in os.environ.items() if k.startswith(("JAX_", "XLA_"))}
    options = {
        "distributed.nanny.pre-spawn-environ": single | jax_variables,
        "distributed.scheduler.allowed-failures": LOSSES,
        "distributed.deploy.lost-worker-timeout": f"{CHECK_SECONDS} s",
        # The profiler's samples of JAX's deep call stacks would fill the memory of a worker.
        "distributed.worker.profile.enabled": False,
        # Compiled programs cannot be moved to disk, so a worker that pauses for memory would wait
        # forever. A worker that takes more than its share is restarted.
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
    }
    # Python's resource tracker outlives an interrupted command and would warn of its resources.
    sys.warnoptions.append("ignore:resource_tracker")
    with config.set(options), _start(count) as made, Client(made) as client:
        yield client


def _start(count: int) -> "LocalCluster":
    """Start the workers, in up to three attempts, because a worker may die during its start."""
    from distributed import LocalCluster

    settings = {"processes": True, "threads_per_worker": 1, "memory_limit": MEMORY / count}
    quiet = {"dashboard_address": ":0", "silence_logs": logging.CRITICAL}
    lost = None
    for _ in range(STARTS):
        try:
            return LocalCluster(n_workers=count, **settings, **quiet)
        except RuntimeError as error:
            lost = error
    raise InputError(f"{count} workers could not be started ({lost}).") from lost


def replace_lost(client: "Client") -> None:
    """Restart workers that died during their start; Dask restarts later ones."""
    made: Any = client.cluster
    wanted = len(getattr(made, "worker_spec", ()))
    there: Any = client.nthreads()
    if len(there) >= wanted:
        return
    for name, nanny in list(made.workers.items()):
        if getattr(nanny, "pid", -1) is None:  # the task waits for a process that has died
            made.workers.pop(name, None)
            made.sync(nanny.close)
    made.scale(wanted)
