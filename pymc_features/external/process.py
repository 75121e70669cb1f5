"""A simulator process: started, asked, and killed when it takes too long."""

import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

SCRIPT = Path(__file__).with_name("runner.py")
START_SECONDS = 300.0  # to import what a simulator needs may take long on a busy file system
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class UnusableSimulatorError(RuntimeError):
    """A simulator that cannot be loaded where it is to run."""


class SimulatorProcess:
    """One process that holds one simulator.

    Parameters
    ----------
    payload : bytes
        By cloudpickle: function, observed, shape and scratch folder.

    Raises
    ------
    UnusableSimulatorError
        If the function cannot be loaded there.
    """

    def __init__(self, payload: bytes):
        ours, theirs = socket.socketpair()
        self.log = tempfile.TemporaryFile()  # noqa: SIM115  as long as the process
        self.process = subprocess.Popen(
            [sys.executable, str(SCRIPT), str(theirs.fileno())],
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
            self.connection.send_bytes(pickle.dumps(sys.path))
            self.connection.send_bytes(payload)
        state, text, _ = self.receive(START_SECONDS)
        if state != "ready":
            self.close()
            raise UnusableSimulatorError(
                f"the simulator must be loadable in another process, got {text}. Define it in a module that "
                "can be imported there, or in the script itself."
            )

    def ask(self, arguments, timeout: float | None):
        """Run one simulation: (state, result or text, seconds), state ok, error, timeout or died."""
        try:
            self.connection.send(arguments)
        except OSError:
            text = self.last_words()
            self.close()
            return "died", text, 0.0
        return self.receive(timeout)

    def receive(self, timeout):
        """Wait for an answer; a process that gives none is killed."""
        try:
            if self.connection.poll(timeout):
                return self.connection.recv()
        except (EOFError, OSError):
            text = self.last_words()
            self.close()
            return "died", text, 0.0
        self.close()
        return "timeout", f"no result after {timeout:g} s", float(timeout)

    def last_words(self) -> str:
        """How the process ended, and the last line it printed."""
        code = self.process.wait()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        self.log.seek(max(0, os.fstat(self.log.fileno()).st_size - 2000))
        lines = self.log.read().decode(errors="replace").strip().splitlines()
        return f"the process ended with {how}" + (f": {lines[-1]}" if lines else "")

    @property
    def usable(self) -> bool:
        """Whether it can be asked again."""
        return not self.connection.closed

    def close(self):
        """Kill it and forget it."""
        if self.connection.closed:
            return
        self.connection.close()
        self.kill()
        self.process.wait()
        self.log.close()

    def kill(self):
        """Kill it and what it started."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
