"""What an executor runs, in whichever thread, process or machine: one call of a simulator process.

Each place keeps its simulator processes and uses them again. A digest names a payload. Processes belong to
what stands before the slash in it, their owner, and take one payload after another of that owner; without a
slash each payload has processes of its own.
"""

import atexit
import os
import threading
from dataclasses import dataclass

from pymc_features.exceptions import DiedAtStartError, UnusableSimulatorError
from pymc_features.processes.process import SimulatorProcess

STARTS = 3  # attempts at a process that dies before it is ready: the cause may have come from outside
IDLE_KEPT = 64  # processes of all simulators, and payloads; where nobody says that one is not needed any more

_IDLE: dict[str, list[SimulatorProcess]] = {}  # by owner
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
    owner = owner_of(digest)
    with _LOCK:
        payload = _PAYLOADS.get(digest, payload)
        if payload is None:
            return Outcome("no payload")
        _PAYLOADS[digest] = payload
        while len(_PAYLOADS) > IDLE_KEPT:
            _PAYLOADS.pop(next(iter(_PAYLOADS)))
    process = take(owner, digest) or start(digest, payload)
    if process is None:
        return Outcome("died", message="the simulator was closed")
    with _LOCK:
        if owner not in _ENDED:
            _BUSY.setdefault(owner, set()).add(process)
    try:
        if owner in _ENDED:
            return Outcome("died", message="the simulator was closed")
        state, value, seconds = process.load(digest, payload)
        if state == "ready":
            state, value, seconds = process.ask(digest, arguments, timeout)
    except BaseException:
        process.close()
        raise
    finally:
        give(owner, process)
    if state == "ok":
        return Outcome(state, value, seconds=seconds)
    return Outcome(state, message=value, seconds=seconds)


def owner_of(digest) -> str:
    """Whose processes run what a digest names."""
    return digest.partition("/")[0]


def take(owner, digest) -> SimulatorProcess | None:
    """A process that waits for work, if there is one that lives; rather one that has loaded the digest."""
    while True:
        with _LOCK:
            idle = _IDLE.get(owner)
            process = None
            if idle:
                loaded = [i for i, one in enumerate(idle) if digest in one.digests]
                process = idle.pop(loaded[-1] if loaded else -1)
        if process is None or process.process.poll() is None:
            return process
        process.close()


def start(digest, payload) -> SimulatorProcess | None:
    """A new process; None where its owner wants none any more."""
    owner = owner_of(digest)
    for _ in range(STARTS):
        try:
            process = SimulatorProcess(payload, lambda: owner not in _ENDED)
            process.digests = [digest]
            return process
        except DiedAtStartError as error:
            if owner in _ENDED:
                return None
            reason = str(error)
    raise UnusableSimulatorError(reason)


def give(owner, process):
    """A process that has done its work waits for more, or is ended."""
    with _LOCK:
        _BUSY.get(owner, set()).discard(process)
        if process.usable and owner not in _ENDED:
            _IDLE.setdefault(owner, []).append(process)
            process = None
        surplus = [process] if process is not None else []
        if sum(map(len, _IDLE.values())) > IDLE_KEPT:
            surplus.append(next(idle for idle in _IDLE.values() if idle).pop(0))
    for one in surplus:
        one.close()


def end_processes(owners=None):
    """End the processes of some simulators, or of all; busy ones are killed, and none starts any more."""
    with _LOCK:
        chosen = {*_IDLE, *_BUSY} if owners is None else set(owners)
        _ENDED.update(chosen)
        for digest in [digest for digest in _PAYLOADS if owner_of(digest) in chosen]:
            del _PAYLOADS[digest]
        idle = [process for owner in chosen for process in _IDLE.pop(owner, ())]
        busy = [process for owner in chosen for process in _BUSY.pop(owner, ())]
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
