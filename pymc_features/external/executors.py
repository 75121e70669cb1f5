"""Where simulations run: local processes, a Dask cluster, or any executor."""

import os
from concurrent.futures import Executor, ThreadPoolExecutor

ADVICE = (
    "Give a number of local processes, the address of a Dask scheduler, or an object with submit() like "
    "those of concurrent.futures."
)


def check_executor(executor):
    """Refuse what cannot run simulations."""
    whole = isinstance(executor, int) and not isinstance(executor, bool) and executor >= 1
    if not (executor is None or whole or isinstance(executor, str | Executor)) and not callable(
        getattr(executor, "submit", None)
    ):
        raise TypeError(f"`executor` must be something that runs simulations, got {executor!r}. {ADVICE}")


def open_executor(executor):
    """Return an object with `submit`, and a function that ends it, or does nothing if it is not ours."""
    if executor is None or isinstance(executor, int):
        # threads that wait, each for a process of its own
        pool = ThreadPoolExecutor(executor or processors(), thread_name_prefix="simulation")
        return pool, lambda: pool.shutdown(wait=False, cancel_futures=True)
    if isinstance(executor, str):
        client = dask_client(executor)
        return DaskExecutor(client), client.close
    if hasattr(executor, "scheduler_info") and hasattr(executor, "map"):  # a dask.distributed.Client
        return DaskExecutor(executor), lambda: None
    return executor, lambda: None


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


class DaskExecutor:
    """`submit` on a Dask cluster; a worker that dies hands its tasks to others."""

    def __init__(self, client):
        self.executor = client.get_executor(pure=False)

    def submit(self, function, *arguments):
        """A `concurrent.futures.Future`."""
        return self.executor.submit(function, *arguments)
