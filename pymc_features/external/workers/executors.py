"""Executors of simulations: local processes, a Dask cluster, or any other; and many calls on one of them."""

import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError, Executor, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from queue import Empty, SimpleQueue

from pymc_features._checks import shown
from pymc_features.exceptions import NoWorkersError, UnusableSimulatorError
from pymc_features.external.workers.calls import Outcome, call, end_processes

MOST_PROCESSES = 10_000
PAYLOADS_KEPT = 8  # on a cluster, for each client
COUNTED_FOR = 10.0  # seconds until the workers of a cluster are counted again
ADVICE = (
    "Give a number of local processes, the address of a Dask scheduler, or an object with submit() like "
    "those of concurrent.futures."
)
LOST_AT_MOST = 5  # times that a place of work may vanish under one and the same call
SMALL = 2**16  # bytes that travel with every call; more of them only where they are missing


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
    each, however slowly they are written down. `places` is how many calls run at once.
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
    """`submit` on a Dask cluster; a worker that dies hands its tasks to others. Our own client is closed."""

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


@dataclass(frozen=True)
class Work:
    """What is to be simulated: the payload of a `SimulatorProcess` and its digest, the time limit of a call
    [s], and how often one that failed is tried again.
    """

    digest: str
    payload: bytes
    timeout: float | None
    retries: int


def submitted(executor, work: Work, arguments, payload):
    """The future of one call; NoWorkersError if the executor takes none."""
    try:
        return executor.submit(call, work.digest, arguments, work.timeout, payload)
    except (BrokenExecutor, RuntimeError) as error:
        raise NoWorkersError(
            f"`executor` must run simulations, got {type(error).__name__}: {error}. What is finished is "
            "kept where there is a cache; start again with a new executor."
        ) from error


class Batch:
    """Runs calls on an executor, and those again that failed or were lost.

    A call whose process died is tried once more whatever `retries` says, for the cause may have come from
    outside. An executor with a true `brings` takes the payload to each place once; one with `at_most` gets no
    more calls than that before their outcomes are taken. `done` is called with the number of each call and
    its Outcome, in any order; `tick` about once a second meanwhile.
    """

    def __init__(self, executor, work: Work, done: Callable, tick: Callable):
        self.executor, self.work, self.done, self.tick = executor, work, done, tick
        brings = getattr(executor, "brings", False) or len(work.payload) <= SMALL
        self.first_payload = work.payload if brings else None
        self.running: dict = {}  # future -> number, arguments, attempts, times lost
        self.over: SimpleQueue = SimpleQueue()
        self.at_most = getattr(executor, "at_most", sys.maxsize)

    def run(self, calls):
        """Run all of (number, arguments); Ctrl-C drops those that have not begun."""
        waiting = iter(calls)
        try:
            while True:
                for number, arguments in islice(waiting, self.at_most - len(self.running)):
                    self.submit(number, arguments, 1, 0, self.first_payload)
                if not self.running:
                    return
                with suppress(Empty):
                    self.settle(self.over.get(timeout=1.0))
                self.tick()
        finally:
            for future in self.running:
                future.cancel()

    def submit(self, number, arguments, attempt, lost, payload):
        """Hand one call to the executor."""
        future = submitted(self.executor, self.work, arguments, payload)
        self.running[future] = number, arguments, attempt, lost
        future.add_done_callback(self.over.put)

    def settle(self, future):
        """Take the outcome of a call, or try again."""
        number, arguments, attempt, lost = self.running.pop(future)
        try:
            outcome = future.result()
        except UnusableSimulatorError:
            raise
        except (Exception, CancelledError) as error:  # the place of work is gone, not the simulation wrong
            if lost >= LOST_AT_MOST:
                outcome = Outcome("died", message=f"lost {lost + 1} times, last with {error!r}")
            else:
                self.submit(number, arguments, attempt, lost + 1, self.work.payload)
                return
        if outcome.state == "no payload":
            self.submit(number, arguments, attempt, lost, self.work.payload)
            return
        allowed = self.work.retries + 1
        if outcome.state == "died":
            allowed = max(allowed, 2)
        if outcome.state != "ok" and attempt < allowed:
            self.submit(number, arguments, attempt + 1, lost, self.first_payload)
            return
        self.done(number, outcome)
