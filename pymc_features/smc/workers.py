"""Places that evaluate parts of populations: local processes, a Dask cluster, or any executor."""

import hashlib
import os
import time
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import cloudpickle
import numpy as np

from pymc_features.exceptions import NoWorkersError, UnusableSimulatorError
from pymc_features.external.workers.executors import (
    Batch,
    LocalExecutor,
    Work,
    check_executor,
    open_executor,
    submitted,
)
from pymc_features.smc.density.evaluation import PopulationLogp
from pymc_features.smc.density.rows import ONE_CALL
from pymc_features.system import one_process_at_a_time

PER_PLACE = 2  # parts of what is left, for each place of work: large parts first, small ones at the end


def parts_of(n: int, unit: int, least: int, places: int | None) -> list[tuple[int, int]]:
    """First rows of parts of `n` particles, and the rows after their last ones.

    Parameters
    ----------
    n : int
        Particles.
    unit : int
        A population is cut at multiples of it, and no part is smaller.
    least : int
        Particles of a part that are worth a message.
    places : int or None
        How many parts are in work at once; None where nobody knows, and then all parts are small.

    Notes
    -----
    Guided self-scheduling (Polychronopoulos & Kuck, IEEE Trans. Comput. C-36 (1987), 1425-1439): each part is
    a fixed share of what is left, so that the last ones, for which nobody wants to wait, are small.

    Examples
    --------
    >>> parts_of(100, unit=8, least=10, places=2)
    [(0, 32), (32, 56), (56, 72), (72, 100)]
    >>> parts_of(15, unit=8, least=1, places=2)
    [(0, 15)]
    """
    smallest = -(-max(least, unit) // unit) * unit
    first, parts = 0, []
    while first < n:
        left = n - first
        share = 0 if places is None else left / (PER_PLACE * places)
        size = max(smallest, -(-int(share) // unit) * unit)
        end = n if left - size < smallest else first + size
        parts.append((first, end))
        first = end
    return parts


class ModelPart:
    """The evaluation of a model on a worker.

    Where it arrives, its functions are called once: machine code that no process of the machine has compiled
    yet is compiled by one of them, while the others wait, and found on disk by these.

    Parameters
    ----------
    logp : PopulationLogp
    """

    def __init__(self, logp: PopulationLogp):
        self.logp = logp

    def __call__(self, which: str, particles: np.ndarray | None) -> tuple[list, str, list] | None:
        """Raw outputs of `values` or `slopes` of particles (p, d); without any it only loads the model.

        Besides, what the model raised last, empty if nothing did, and types and texts of our warnings.
        """
        if particles is None:
            return None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            outputs = getattr(self.logp, which)(particles)
        ours = [w for w in caught if w.category.__module__.partition(".")[0] == "pymc_features"]
        return outputs, self.logp.last_error, [(w.category, str(w.message)) for w in ours]

    def __setstate__(self, state):
        self.__dict__.update(state)
        with one_process_at_a_time():
            for function in (self.logp.values, self.logp.slopes):
                if function is not None:
                    function(self.logp.start)


ATTEMPTS = 3  # at a part, in processes that die
# a part takes at least so long, that its message hardly counts [s]: to a process here, or elsewhere
HERE, ELSEWHERE = 0.005, 0.05
WHILE_WAITING = 0.2  # of evaluation here, until it is asked again whether a worker is ready [s]
FORGETS = 0.5  # weight of the last population in the time of a particle


class Workers:
    """An executor that is open, for the populations of any number of models and chains.

    Parameters
    ----------
    executor : int, str or object with submit()
        As `check_executor` allows.
    """

    def __init__(self, executor):
        self.executor, self._end = open_executor(executor)
        self.owner, self.process = uuid.uuid4().hex, os.getpid()
        self.told: set[str] = set()

    def run(self) -> "Run":
        """For the evaluations of one run."""
        return Run(self)

    def end(self):
        """End the processes, and the executor if it was opened here."""
        if self.process == os.getpid():
            self._end([self.owner])

    def tell(self, warned):
        """Warn here of what was warned of elsewhere, once for each sentence."""
        for category, sentence in warned:
            if sentence not in self.told:
                self.told.add(sentence)
                warnings.warn(sentence, category, stacklevel=2)


def check_workers(executor):
    """Refuse what `open_workers` cannot open."""
    if not isinstance(executor, Workers):
        check_executor(executor)


@contextmanager
def open_workers(executor) -> Iterator[Workers | None]:
    """Workers of an executor, ended at the end; those that are open stay so, and None stays None."""
    check_workers(executor)
    if executor is None or isinstance(executor, Workers):
        yield executor
        return
    workers = Workers(executor)
    try:
        yield workers
    finally:
        workers.end()


class Run:
    """The evaluations of some chains on workers, which end together.

    Populations are evaluated in parts, bit for bit as in one process. One that is not worth a message is
    evaluated here, and so is the beginning of one until the first worker has loaded the model, which takes
    seconds. How long a particle takes is measured, and decides how many particles a part has; where a
    population is cut makes no difference to its results.

    Parameters
    ----------
    workers : Workers
    """

    def __init__(self, workers: Workers):
        self.workers, self.stopped = workers, False
        self.works: dict[tuple[str, bool], Work] = {}  # by model, and whether it has got a gradient
        self.seconds: dict[tuple[str, str], float] = {}  # of a particle, by model and function
        self.loading: dict[str, list] = {}  # futures by digest

    def of(self, logp: PopulationLogp) -> PopulationLogp:
        """Return the evaluation by the workers.

        Raises
        ------
        ValueError
            If the model is parallel by itself, or draws random numbers.
        """
        if logp.is_expensive:
            raise ValueError(
                "`executor` must be left out for a model with an ExternalSimulator, which has its own. Pass "
                "it there: ExternalSimulator(..., executor=8)."
            )
        if logp.draws_random_numbers:
            raise ValueError(
                "`executor` must be left out for a model with random draws inside (`noise`), for they would "
                "not be the same again. Sample it without, or infer the noise by a likelihood."
            )
        return logp.spread_over(self)

    def stop(self):
        """Let evaluations under way end with an error, in whichever thread."""
        self.stopped = True

    def check(self):
        """Raise where the run has been stopped."""
        if self.stopped:
            raise NoWorkersError("`executor` must be open, got one whose run was stopped. Start again.")

    def __call__(self, logp: PopulationLogp, which: str, particles: np.ndarray) -> list[np.ndarray]:
        """Raw outputs of `values` or `slopes` of particles (p, d)."""
        function, outputs = getattr(logp, which), []
        if not len(particles):
            return function(particles)
        while len(particles):
            self.check()
            count = self.count_here(logp, which, len(particles))
            if not count:
                outputs.append(self.elsewhere(logp, which, particles))
                break
            start = time.thread_time()
            outputs.append(function(particles[:count]))
            self.learn(logp, which, (time.thread_time() - start) / count)
            particles = particles[count:]
        return [np.concatenate(column) for column in zip(*outputs, strict=True)]

    def count_here(self, logp, which, n) -> int:
        """How many of n particles are evaluated in this process before one looks again; none, if all go."""
        unit = few = getattr(logp, which).unit  # a first group tells how long one takes
        if seconds := self.seconds.get((logp.token, which)):
            if len(self.cut(logp, which, n)) == 1:
                return n
            if self.some_are_ready(self.work(logp)):
                return 0
            few *= max(1, int(WHILE_WAITING / seconds / unit))
        return few if n >= few + unit else n

    def cut(self, logp, which, n):
        """Parts of a population of n particles; one if they are not worth a message."""
        executor = self.workers.executor
        worth = HERE if isinstance(executor, LocalExecutor) else ELSEWHERE
        least = int(min(worth / self.seconds[logp.token, which], n)) + 1
        return parts_of(n, getattr(logp, which).unit, least, getattr(executor, "places", None))

    def some_are_ready(self, work):
        """Whether a worker has loaded the model; all are asked to, the first time."""
        if work.digest not in self.loading:
            executor, nothing = self.workers.executor, ("values", None)
            self.loading[work.digest] = [
                submitted(executor, work, nothing, work.payload)
                for _ in range(getattr(executor, "places", 1))
            ]
        return any(future.done() for future in self.loading[work.digest])

    def learn(self, logp, which, seconds):
        """Take in how long a particle took."""
        known = self.seconds.get((logp.token, which), seconds)
        self.seconds[logp.token, which] = max(FORGETS * seconds + (1.0 - FORGETS) * known, 1e-9)

    def elsewhere(self, logp, which, particles):
        """Evaluate by the workers, and put the parts together."""
        parts = self.cut(logp, which, len(particles))
        results, seconds = [None] * len(parts), 0.0

        def done(k, outcome):
            nonlocal seconds
            self.check()
            if outcome.state != "ok":
                refuse(outcome)
            results[k], last_error, warned = outcome.value
            seconds += outcome.seconds
            if last_error:
                getattr(logp, which).raised = last_error
            self.workers.tell(warned)

        calls = [(k, (which, np.ascontiguousarray(particles[i:j]))) for k, (i, j) in enumerate(parts)]
        try:
            Batch(self.workers.executor, self.work(logp), done, self.check).run(calls)
        except UnusableSimulatorError as error:
            raise NoWorkersError(
                f"`executor` must have workers that can load the model, got {error.reason}. Install there "
                "what is installed here, in the same versions, or define what the model calls in a module."
            ) from error
        self.learn(logp, which, seconds / len(particles))
        return [np.concatenate(column) for column in zip(*results, strict=True)]

    def work(self, logp) -> Work:
        """The model as it travels; anew when it has got a gradient."""
        key = logp.token, logp.slopes is not None
        with ONE_CALL:  # what is pickled is not to be in use
            if key not in self.works:
                part = ModelPart(logp)
                payload = cloudpickle.dumps({"function": part, "shape": None, "scratch": None})
                digest = f"{self.workers.owner}/{hashlib.sha256(payload).hexdigest()}"
                self.works[key] = Work(digest, payload, None, ATTEMPTS - 1)
            return self.works[key]


def refuse(outcome):
    """Say what became of a part that no worker evaluates."""
    if outcome.state == "died":
        raise NoWorkersError(
            f"`executor` must have workers that live, got {ATTEMPTS} that died with the same part of a "
            f"population: {outcome.message}. They may be out of memory: use fewer of them on a machine. What "
            "is finished is kept where there is a `checkpoint`."
        )
    raise NoWorkersError(f"`executor` must have workers that can evaluate the model, got {outcome.message}.")
