"""What an executor runs, in whichever thread, process or machine: one call of a simulator process.

A simulator process is started, asked, and killed with all that it has started when it takes too long. Each
place keeps its processes and uses them again. A digest names a payload. Processes belong to what stands
before the slash in it, their owner, and take one payload after another of that owner; without a slash each
payload has processes of its own.
"""

import atexit
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from pymc_features import system
from pymc_features.exceptions import DiedAtStartError, UnusableSimulatorError

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
SCRIPT = Path(__file__).with_name("runner.py")
START_SECONDS = 300.0  # to import what a simulator needs may take long on a busy file system
LOOK_SECONDS = 1.0  # what a dead process started may hold its end of the socket open
LOADED_AT_MOST = 4  # payloads in a process; the one loaded first goes first
END_SECONDS = 5.0  # between the end of the connection and that of the process
STARTS = 3  # attempts at a process that dies before it is ready: the cause may have come from outside
IDLE_KEPT = 64  # processes of all simulators, and payloads; where nobody says that one is not needed any more


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let linear algebra take one thread, in this process and in those that start inside.

    Its matrices have tens of rows: more threads gain nothing, and those of several chains wait for each
    other.
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


class SimulatorProcess:
    """One process that holds one simulator.

    `payload` is by cloudpickle: function, observed, shape and scratch folder; without a shape the function's
    result is taken as it is. `is_wanted` is asked about once a second while it starts: where it is not, it is
    ended. `digests` are those of the payloads that it has loaded; whoever starts it names the first.
    """

    def __init__(self, payload: bytes, is_wanted: Callable[[], bool] = lambda: True):
        self.log = tempfile.TemporaryFile()  # noqa: SIM115  as long as the process
        self.folder, self.digests, self.is_wanted = "", [], is_wanted
        self.process, self.connection = system.start_connected(
            [sys.executable, "-P", str(SCRIPT), system.__file__],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env={**ONE_THREAD, **os.environ},  # as many processes as processors: threads would compete
        )
        with suppress(OSError):  # it died; said below
            self.connection.send_bytes(pickle.dumps([os.path.abspath(p) for p in sys.path]))
            self.connection.send_bytes(payload)
        state, text, _ = self.receive(START_SECONDS)
        if state == "ready":
            self.folder, self.is_wanted = text, lambda: True
            return
        self.close()
        raise (UnusableSimulatorError if state == "unusable" else DiedAtStartError)(text)

    def load(self, digest: str, payload: bytes):
        """Take one more payload, if it is not there: (state, text, seconds), state ready or died."""
        if digest in self.digests:
            return "ready", "", 0.0
        drop = len(self.digests) >= LOADED_AT_MOST
        try:
            self.connection.send(("load", payload, drop))
        except OSError:
            return "died", self.last_words(), 0.0
        answer = self.receive(START_SECONDS)
        if answer[0] == "unusable":
            self.close()
            raise UnusableSimulatorError(answer[1])
        self.digests = [*self.digests[drop:], digest]
        return answer

    def ask(self, digest: str, arguments, timeout: float | None):
        """Run one simulation: (state, result or text, seconds), state ok, error, timeout or died."""
        os.lseek(self.log.fileno(), 0, os.SEEK_SET)  # both sides share the position
        os.ftruncate(self.log.fileno(), 0)
        try:
            self.connection.send(("call", self.digests.index(digest), arguments))
        except OSError:
            return "died", self.last_words(), 0.0
        return self.receive(timeout)

    def receive(self, timeout):
        """Wait for an answer; a process that gives none is killed."""
        start = time.monotonic()
        try:
            if self.answers(timeout):
                return self.connection.recv()
        except (EOFError, OSError):
            return "died", self.last_words(), time.monotonic() - start
        self.close()
        return "timeout", f"no result after {timeout:g} s", float(timeout)

    def answers(self, timeout) -> bool:
        """Whether something comes in time."""
        end = float("inf") if timeout is None else time.monotonic() + timeout
        while True:
            left = min(LOOK_SECONDS, end - time.monotonic())
            if self.connection.poll(max(left, 0.0)):
                return True
            if self.process.poll() is not None or not self.is_wanted():
                raise EOFError
            if left < LOOK_SECONDS:
                return False

    def last_words(self) -> str:
        """Close it, and say how it ended and the last line it printed."""
        if not self.is_wanted():
            self.kill()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(END_SECONDS)
        size = os.fstat(self.log.fileno()).st_size
        os.lseek(self.log.fileno(), max(0, size - 2000), os.SEEK_SET)
        text = os.read(self.log.fileno(), 2000)
        self.close()
        code = self.process.returncode
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        lines = text.decode(errors="replace").strip().splitlines()
        return f"the process ended with {how}" + (f": {lines[-1]}" if lines else "")

    @property
    def usable(self) -> bool:
        """Whether the process can take another task."""
        return not self.connection.closed

    def close(self):
        """Kill it and forget it."""
        if self.connection.closed:
            return
        self.connection.close()
        self.kill()
        self.process.wait()
        self.log.close()
        if self.folder:
            shutil.rmtree(self.folder, ignore_errors=True)

    def kill(self):
        """Kill it and what it started; before it is waited for, or at once after, while its number is its."""
        system.kill_with_all(self.process)

    def leave(self):
        """In a forked process: it is the parent's, whose end it must see."""
        self.connection.close()
        self.log.close()
        self.process.returncode = 0


_IDLE: dict[str, list[SimulatorProcess]] = {}  # by owner
_BUSY: dict[str, set[SimulatorProcess]] = {}
_PAYLOADS: dict[str, bytes] = {}
_ENDED: set[str] = set()
_LOCK = threading.Lock()


@dataclass(frozen=True)
class Outcome:
    """What became of a call: state "ok", "error", "timeout", "died" or "no payload", result, what went wrong,
    and the simulation's own time [s].
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
system.at_fork(_LOCK.acquire, _LOCK.release, forget)
