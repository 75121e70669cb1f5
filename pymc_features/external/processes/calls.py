"""What an executor runs, in whichever thread, process or machine: one call of a simulator process.

Each place keeps its simulator processes and uses them again.
"""

import atexit
import os
import threading
from dataclasses import dataclass

from pymc_features.exceptions import DiedAtStartError, UnusableSimulatorError
from pymc_features.external.processes.process import SimulatorProcess

STARTS = 3  # attempts at a process that dies before it is ready: the cause may have come from outside
IDLE_KEPT = 64  # processes of all simulators, and payloads; where nobody says that one is not needed any more

_IDLE: dict[str, list[SimulatorProcess]] = {}  # by payload
_BUSY: dict[str, set[SimulatorProcess]] = {}
_PAYLOADS: dict[str, bytes] = {}
_ENDED: set[str] = set()
_LOCK = threading.Lock()


@dataclass(frozen=True)
class Outcome:
    """What became of a call.

    Attributes
    ----------
    state : str
        "ok", "error", "timeout", "died" or "no payload".
    value : array or None
        The result.
    message : str
        What went wrong.
    seconds : float
        The simulation's own time.
    """

    state: str
    value: object = None
    message: str = ""
    seconds: float = 0.0


def call(digest: str, arguments, timeout: float | None, payload: bytes | None = None) -> Outcome:
    """Run one simulation of the simulator known by its digest, or sent along."""
    with _LOCK:
        payload = _PAYLOADS.get(digest, payload)
        if payload is None:
            return Outcome("no payload")
        _PAYLOADS[digest] = payload
        while len(_PAYLOADS) > IDLE_KEPT:
            _PAYLOADS.pop(next(iter(_PAYLOADS)))
    process = take(digest) or start(payload)
    with _LOCK:
        if digest not in _ENDED:
            _BUSY.setdefault(digest, set()).add(process)
    try:
        if digest in _ENDED:
            return Outcome("died", message="the simulator was closed")
        state, value, seconds = process.ask(arguments, timeout)
    except BaseException:
        process.close()
        raise
    finally:
        give(digest, process)
    if state == "ok":
        return Outcome(state, value, seconds=seconds)
    return Outcome(state, message=value, seconds=seconds)


def take(digest) -> SimulatorProcess | None:
    """A process that waits for work, if there is one that lives."""
    while True:
        with _LOCK:
            idle = _IDLE.get(digest)
            process = idle.pop() if idle else None
        if process is None or process.process.poll() is None:
            return process
        process.close()


def start(payload) -> SimulatorProcess:
    """A new process."""
    for _ in range(STARTS):
        try:
            return SimulatorProcess(payload)
        except DiedAtStartError as error:
            reason = str(error)
    raise UnusableSimulatorError(reason)


def give(digest, process):
    """A process that has done its work waits for more, or is ended."""
    with _LOCK:
        _BUSY.get(digest, set()).discard(process)
        if process.usable and digest not in _ENDED:
            _IDLE.setdefault(digest, []).append(process)
            process = None
        surplus = [process] if process is not None else []
        if sum(map(len, _IDLE.values())) > IDLE_KEPT:
            surplus.append(next(idle for idle in _IDLE.values() if idle).pop(0))
    for one in surplus:
        one.close()


def end_processes(digests=None):
    """End the processes of some simulators, or of all; busy ones are killed, and none starts any more."""
    with _LOCK:
        chosen = {*_IDLE, *_BUSY} if digests is None else digests
        _ENDED.update(chosen)
        for digest in chosen:
            _PAYLOADS.pop(digest, None)
        idle = [process for digest in chosen for process in _IDLE.pop(digest, ())]
        busy = [process for digest in chosen for process in _BUSY.pop(digest, ())]
    for process in idle:
        process.close()
    for process in busy:
        if process.process.returncode is None:
            process.kill()  # who waits for it closes it


def forget():
    """In a forked process: what the parent started is not ours."""
    for process in [p for kept in (_IDLE, _BUSY) for processes in kept.values() for p in processes]:
        process.leave()
    _IDLE.clear()
    _BUSY.clear()
    _LOCK.release()


atexit.register(end_processes)
os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=forget)
