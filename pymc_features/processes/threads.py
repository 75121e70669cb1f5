"""How many threads linear algebra takes while particles are sampled."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let linear algebra take one thread, in this process and in those that start inside.

    Its matrices have tens of rows: more threads gain nothing, and where several chains have as many as there
    are processors they wait for each other, which takes several times as long.
    """
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        with threadpool_limits(1, "blas"):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
