"""What an executor runs, in whichever thread, process or machine: one call of a simulator process.

Each place keeps its simulator processes and uses them again.
"""

import atexit
import os
import threading
from dataclasses import dataclass

from pymc_features.external.process import SimulatorProcess

# by process (id) and payload
_IDLE: dict[tuple[int, str], list[SimulatorProcess]] = {}
_BUSY: dict[tuple[int, str], set[SimulatorProcess]] = {}
_PAYLOADS: dict[str, bytes] = {}
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
    """Run one simulation of the simulator known by its digest, or sent along the first time."""
    if payload is not None:
        _PAYLOADS[digest] = payload
    if digest not in _PAYLOADS:
        return Outcome("no payload")
    place = os.getpid(), digest
    with _LOCK:
        idle = _IDLE.setdefault(place, [])
        process = idle.pop() if idle else None
    if process is None or process.process.poll() is not None:
        process = SimulatorProcess(_PAYLOADS[digest])
    with _LOCK:
        _BUSY.setdefault(place, set()).add(process)
    state, value, seconds = process.ask(arguments, timeout)
    with _LOCK:
        _BUSY[place].discard(process)
        if process.usable:
            _IDLE.setdefault(place, []).append(process)
    if state == "ok":
        return Outcome(state, value, seconds=seconds)
    return Outcome(state, message=value, seconds=seconds)


def end_processes(digest: str | None = None):
    """End the simulator processes of this process, of one simulator or of all; busy ones are killed."""
    with _LOCK:
        chosen = [p for p in {*_IDLE, *_BUSY} if p[0] == os.getpid() and digest in (None, p[1])]
        idle = [process for place in chosen for process in _IDLE.pop(place, ())]
        busy = [process for place in chosen for process in _BUSY.get(place, ())]
    for process in idle:
        process.close()
    for process in busy:
        if process.process.returncode is None:
            process.kill()  # who waits for it closes it


atexit.register(end_processes)
