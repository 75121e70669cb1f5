"""Executors of simulations: local processes, a Dask cluster, or any other."""

import os
import threading
import time
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import suppress

from pymc_features._checks import shown
from pymc_features.processes.calls import end_processes

MOST_PROCESSES = 10_000
PAYLOADS_KEPT = 8  # on a cluster, for each client
COUNTED_FOR = 10.0  # seconds until the workers of a cluster are counted again
ADVICE = (
    "Give a number of local processes, the address of a Dask scheduler, or an object with submit() like "
    "those of concurrent.futures."
)


def check_executor(executor):
    """Refuse what cannot run simulations."""
    whole = isinstance(executor, int) and not isinstance(executor, bool) and 1 <= executor <= MOST_PROCESSES
    address = isinstance(executor, str) and executor
    runs = isinstance(executor, Executor) or callable(getattr(executor, "submit", None))
    if not (executor is None or whole or address or runs) or isinstance(executor, type):
        raise TypeError(
            f"`executor` must be something that runs simulations, got {shown(executor)}. {ADVICE}"
        )


def open_executor(executor):
    """Return an object with `submit`, and a function of owners that ends what runs and what is ours."""
    if executor is None or isinstance(executor, int):
        pool = LocalExecutor(executor or processors())
        return pool, pool.end
    if isinstance(executor, str):
        pool = DaskExecutor(dask_client(executor), ours=True)
        return pool, pool.end
    if hasattr(executor, "scheduler_info") and hasattr(executor, "map"):  # a dask.distributed.Client
        pool = DaskExecutor(executor, ours=False)
        return pool, pool.end
    return executor, end_processes


class LocalExecutor(ThreadPoolExecutor):
    """Threads that wait, each for a process of its own.

    Each has one call in work and one in reserve. So a run that is killed loses no more than two results of
    each, however slowly they are written down.

    Attributes
    ----------
    places : int
        How many calls run at once.
    """

    brings = True

    def __init__(self, n_processes: int):
        super().__init__(n_processes, thread_name_prefix="simulation")
        self.places, self.at_most = n_processes, 2 * n_processes

    def end(self, owners):
        """Drop what has not begun, and kill what has."""
        self.shutdown(wait=False, cancel_futures=True)
        end_processes(owners)


class DaskExecutor:
    """`submit` on a Dask cluster; a worker that dies hands its tasks to others.

    Parameters
    ----------
    client : dask.distributed.Client
    ours : bool
        Whether it is to be closed at the end.
    """

    brings = True

    def __init__(self, client, ours: bool):
        self.client, self.ours = client, ours
        self.executor = client.get_executor(pure=False)
        self.payloads, self.lock = {}, threading.Lock()
        self._counted = -COUNTED_FOR, 1

    @property
    def places(self) -> int:
        """Threads of all workers; workers may come and go."""
        if time.monotonic() - self._counted[0] > COUNTED_FOR:
            self._counted = time.monotonic(), max(1, sum(self.client.nthreads().values()))
        return self._counted[1]

    def submit(self, function, digest, arguments, timeout, payload):
        """A `concurrent.futures.Future`; the payload goes to each worker once, and again to a new one."""
        if self.client.status not in ("running", "connecting"):
            raise RuntimeError(f"the Dask client is {self.client.status}")
        with self.lock:
            sent = self.payloads.get(digest) or self.client.submit(bytes, payload, key=f"simulator-{digest}")
            self.payloads[digest] = sent
            while len(self.payloads) > PAYLOADS_KEPT:
                self.payloads.pop(next(iter(self.payloads)))
        return self.executor.submit(function, digest, arguments, timeout, sent)

    def end(self, owners):
        """End the processes on all workers."""
        self.payloads.clear()
        with suppress(Exception):  # there may be no cluster any more
            self.client.run(end_processes, owners, on_error="ignore")
        if self.ours:
            self.client.close()


def dask_client(address: str):
    """A client of the Dask scheduler at an address."""
    try:
        from distributed import Client
    except ImportError:
        raise ImportError(
            f"`executor` must be reachable, got the address {address!r} without Dask. Install distributed."
        ) from None
    try:
        return Client(address, timeout="30s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"`executor` must be the address of a Dask scheduler, got {address!r} ({error}). Is it running?"
        ) from None


def processors() -> int:
    """Number of processors that this process may use."""
    return os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
