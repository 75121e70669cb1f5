"""Many simulations at once, whatever happens to single ones."""

import sys
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from queue import Empty, SimpleQueue

from pymc_features.exceptions import NoWorkersError, UnusableSimulatorError
from pymc_features.processes.calls import Outcome, call

LOST_AT_MOST = 5  # times that a place of work may vanish under one and the same call
SMALL = 2**16  # bytes that travel with every call; more of them only where they are missing


@dataclass(frozen=True)
class Work:
    """What is to be simulated.

    Attributes
    ----------
    digest : str
        Of the payload.
    payload : bytes
        Function, data and settings, for a `SimulatorProcess`.
    timeout : float or None
        Of one call [s].
    retries : int
        Further attempts at a call that failed.
    """

    digest: str
    payload: bytes
    timeout: float | None
    retries: int


def submitted(executor, work: Work, arguments, payload):
    """The future of one call.

    Raises
    ------
    NoWorkersError
        If the executor takes none.
    """
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
    outside.

    Parameters
    ----------
    executor : object with submit()
        Where. If it has `brings` that is true, it brings the payload to each place once; if it has `at_most`,
        it gets no more calls than that before their outcomes are taken.
    work : Work
        What.
    done : callable
        (number of the call, Outcome) -> None, for each call when it is over, in any order.
    tick : callable
        Called about once a second meanwhile.
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
