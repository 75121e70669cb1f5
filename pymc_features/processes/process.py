"""A simulator process: started, asked, and killed when it takes too long."""

import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from pymc_features.exceptions import DiedAtStartError, UnusableSimulatorError
from pymc_features.processes.threads import ONE_THREAD

SCRIPT = Path(__file__).with_name("runner.py")
START_SECONDS = 300.0  # to import what a simulator needs may take long on a busy file system
LOOK_SECONDS = 1.0  # what a dead process started may hold its end of the socket open
LOADED_AT_MOST = 4  # payloads in a process; the one loaded first goes first
END_SECONDS = 5.0  # between the end of the connection and that of the process


class SimulatorProcess:
    """One process that holds one simulator.

    Parameters
    ----------
    payload : bytes
        By cloudpickle: function, observed, shape and scratch folder; without a shape the function's result is
        taken as it is.
    is_wanted : callable
        Asked about once a second while it starts; it is ended where it is not.

    Attributes
    ----------
    digests : list of str
        Of the payloads that it has loaded; whoever starts it names the first.

    Raises
    ------
    UnusableSimulatorError
        If the function cannot be loaded there.
    DiedAtStartError
        If the process ends before.
    """

    def __init__(self, payload: bytes, is_wanted: Callable[[], bool] = lambda: True):
        ours, theirs = socket.socketpair()
        self.log = tempfile.TemporaryFile()  # noqa: SIM115  as long as the process
        self.folder, self.digests, self.is_wanted = "", [], is_wanted
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(SCRIPT), str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env={**ONE_THREAD, **os.environ},  # as many processes as processors: threads would compete
            start_new_session=True,  # Ctrl-C is the parent's; and to kill it is to kill what it started
        )
        theirs.close()
        self.connection = Connection(ours.detach())
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
        text = os.pread(self.log.fileno(), 2000, max(0, size - 2000))
        self.close()
        code = self.process.returncode
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        lines = text.decode(errors="replace").strip().splitlines()
        return f"the process ended with {how}" + (f": {lines[-1]}" if lines else "")

    @property
    def usable(self) -> bool:
        """Return whether the process can be asked again."""
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
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def leave(self):
        """In a forked process: it is the parent's, whose end it must see."""
        self.connection.close()
        self.log.close()
        self.process.returncode = 0
