"""Simulations of many parameters: found in the cache, or run, counted, and kept."""

import hashlib
import os
import sys
import time
import uuid
from collections import deque
from concurrent.futures import Executor
from dataclasses import dataclass
from os import PathLike
from typing import TypedDict

import cloudpickle
import numpy as np

from pymc_features._checks import check_flag, check_integer, check_path, is_number, shown, single, to_float
from pymc_features.external import program
from pymc_features.external.cache import EvaluationCache
from pymc_features.external.workers.calls import Outcome
from pymc_features.external.workers.executors import Batch, Work, check_executor, open_executor
from pymc_features.fingerprint import fingerprint

FAILURES_KEPT = 1000
WORKS_KEPT = 8  # data sets for which the payload is kept
SILENT_SECONDS, EVERY_SECONDS = 5.0, 10.0  # of lines on the progress
STATES = ("ok", "error", "timeout", "died", "invalid", "cached")


def check_seconds(name: str, value) -> None:
    """Refuse a time that is given and not positive."""
    number = single(value)
    if value is not None and not (is_number(number) and 0 < to_float(number) < float("inf")):
        raise ValueError(f"`{name}` must be a positive number of seconds, got {shown(value)}.")


@dataclass(frozen=True)
class Failure:
    """A simulation that failed.

    Attributes
    ----------
    parameters : tuple
        As passed to the function.
    state : str
        "error" (an exception, an exit code, a result that is not finite), "timeout", "died", or "invalid"
        (parameters that are not finite: not run).
    message : str
        What is known about it.
    seconds : float
        Its time.
    """

    parameters: tuple
    state: str
    message: str
    seconds: float


@dataclass(frozen=True)
class Task:
    """A function of the parameters, the shape of what it returns, and its identity for the cache.

    With `observed` (sensor, time) the results are mean squares of its difference from what the function
    returns.
    """

    function: object
    shape: tuple[int, ...]
    observed: np.ndarray | None
    identity: str

    @property
    def result_shape(self):
        """Shape of what is kept."""
        return self.shape if self.observed is None else self.shape[:1]


class EvaluationOptions(TypedDict, total=False):
    """Arguments of `Evaluator`."""

    timeout: float | None
    retries: int
    scratch: bool | str | PathLike
    executor: int | str | Executor | None
    cache: str | PathLike | None
    progress: bool


class Evaluator:
    """Runs simulations, on processes of this machine or elsewhere, and remembers them.

    Parameters
    ----------
    timeout : float, optional
        Of a simulation [s]; then its process is killed.
    retries : int
        Further attempts after a failure. A process that died is tried once more in any case.
    scratch : bool or path-like
        Run each simulation in an empty folder of its own, its working directory: True, or the folder that
        will hold these.
    executor : int, str, dask Client or Executor, optional
        Number of local processes (as many as processors by default), address of a Dask scheduler, or any
        object with `submit` as of `concurrent.futures`.
    cache : path-like, optional
        SQLite file that keeps every result; several runs may share it.
    progress : bool
        Write lines about simulations done, failed and left to standard error.

    Raises
    ------
    ValueError, TypeError
        If an argument cannot be used.
    """

    def __init__(
        self,
        *,
        timeout: float | None = None,
        retries: int = 0,
        scratch: bool | str | PathLike = False,
        executor: int | str | Executor | None = None,
        cache: str | PathLike | None = None,
        progress: bool = True,
    ):
        check_seconds("timeout", timeout)
        check_executor(executor)
        self.timeout, self.executor = timeout, executor
        self.retries = check_integer(retries, "retries", least=0)
        self.lines = Lines(check_flag(progress, "progress"))
        # "" stands for the system's folder of temporary files
        usual = {True: "", False: None}
        is_flag = isinstance(scratch, bool)
        self.scratch = usual[scratch] if is_flag else str(check_path(scratch, "scratch").resolve())
        self.cache = None if cache is None else EvaluationCache(check_path(cache, "cache"))
        self.counts = dict.fromkeys(STATES, 0)
        self.failures: deque[Failure] = deque(maxlen=FAILURES_KEPT)
        self._opened = None  # process (id), token, executor, function that ends it
        self._works, self._digests = {}, set()

    def run(self, task: Task, rows: list[np.ndarray]) -> np.ndarray:
        """Results (particle, ...) for parameters with equally many rows; NaN where a simulation failed."""
        results = np.full((len(rows[0]), *task.result_shape), np.nan)
        own = fingerprint(task.identity, task.shape, task.observed)
        places: dict[str, list[int]] = {}  # equal parameters are simulated once
        calls = {}
        for i in range(len(rows[0])):
            arguments = tuple(r[i].item() if r.ndim == 1 else np.array(r[i]) for r in rows)
            key = call_key(own, arguments)
            if key in places:
                places[key].append(i)
                continue
            places[key] = [i]
            if not all(np.isfinite(a).all() for a in arguments):
                self.note(arguments, Outcome("invalid", message="the parameters are not finite"))
            elif self.cache is not None and (known := self.cache.find(key)) is not None:
                self.counts["cached"] += 1
                results[i] = known
            else:
                calls[key] = arguments
        if calls:
            self.simulate(task, own, calls, lambda key, value: results.__setitem__(places[key][0], value))
        for first, *others in places.values():
            results[others] = results[first]
        return results

    def simulate(self, task, own, calls, keep):
        """Run what is not known yet."""

        def done(key, outcome):
            if self.cache is not None:
                self.cache.add(key, calls[key], outcome)
            if outcome.state == "ok":
                self.counts["ok"] += 1
                keep(key, outcome.value)
            else:
                self.note(calls[key], outcome)
            self.lines.count(outcome.state == "ok")

        self.open()
        self.lines.begin(len(calls))
        try:
            Batch(self._opened[2], self.work(task, own), done, self.lines.tick).run(calls.items())
        except BaseException:
            self.close()  # nothing goes on behind the back of whoever pressed Ctrl-C
            raise

    def note(self, arguments, outcome):
        """Count and keep a failure."""
        self.counts[outcome.state] += 1
        self.failures.append(Failure(arguments, outcome.state, outcome.message, outcome.seconds))

    def work(self, task, own) -> Work:
        """The task as it travels, made once."""
        if own not in self._works or self._works[own][0] is not task.function:
            content = {"function": task.function, "observed": task.observed, "shape": task.shape}
            payload = packed(content | {"scratch": self.scratch})
            # processes are not shared, lest one evaluator ends those of another
            digest = hashlib.sha256(self._opened[1] + payload).hexdigest()
            while len(self._works) >= WORKS_KEPT:
                self._works.pop(next(iter(self._works)))
            self._works[own] = task.function, Work(digest, payload, self.timeout, self.retries)
            self._digests.add(digest)
        return self._works[own][1]

    def open(self):
        """Open the executor, in this process, if it is not."""
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = os.getpid(), uuid.uuid4().bytes, *open_executor(self.executor)
            self._works, self._digests = {}, set()

    def close(self):
        """End what was started here; it starts again when needed."""
        if self._opened is not None and self._opened[0] == os.getpid():
            self._opened[3](self._digests)
        self._opened = None
        if self.cache is not None:
            self.cache.close()

    def __getstate__(self):
        if not (self.executor is None or isinstance(self.executor, int | str)):
            raise TypeError(
                f"`executor` must be a number or an address to travel to another process, got "
                f"{type(self.executor).__name__}. Sample with cores=1, or pass an address."
            )
        return {**self.__dict__, "_opened": None, "_works": {}, "_digests": set()}


def packed(content) -> bytes:
    """Content as bytes that can be unpacked without this package, whose import takes seconds."""
    cloudpickle.register_pickle_by_value(program)
    try:
        return cloudpickle.dumps(content)
    finally:
        cloudpickle.unregister_pickle_by_value(program)


def call_key(own: str, arguments) -> str:
    """Key of a call in the cache."""
    digest = hashlib.sha256(own.encode())
    for a in arguments:
        digest.update(str(np.shape(a)).encode() + np.asarray(a, dtype=np.float64).tobytes())
    return digest.hexdigest()


class Lines:
    """Writes a line to standard error now and then: simulations done, failed, rate, time left.

    Plain lines do not disturb a progress bar.
    """

    def __init__(self, shown: bool):
        self.shown, self.last, self.done, self.failed = shown, None, 0, 0
        self.seconds = 0.0  # of the batches before: what lies between them does not count in the rate
        self.batch_start = self.latest = 0.0

    def begin(self, total: int):
        """A batch of calls begins."""
        now = time.monotonic()
        if self.last is None:
            self.last = now + SILENT_SECONDS - EVERY_SECONDS
        self.seconds += self.latest - self.batch_start
        self.latest = now
        self.total, self.before, self.batch_start = total, self.done, now

    def count(self, ok: bool):
        """A call is over."""
        self.done += 1
        self.failed += not ok
        self.latest = time.monotonic()

    def tick(self):
        """Write a line if it is time to."""
        now = time.monotonic()
        if not self.shown or now - self.last < EVERY_SECONDS:
            return
        self.last, done = now, self.done - self.before
        rate = self.done / max(self.seconds + now - self.batch_start, 1e-9)
        text = f"simulations: {self.done} done, {self.failed} failed, {rate:.3g}/s"
        if 0 < done < self.total:
            left = (now - self.batch_start) / done * (self.total - done)
            minutes, seconds = divmod(round(left), 60)
            text += f"; of this batch {done} of {self.total}, {minutes}:{seconds:02d} left"
        print(text, file=sys.stderr, flush=True)
