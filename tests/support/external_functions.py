"""Simulators for the tests, and a look at their processes; what runs in these imports nothing else."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

SHAPE = (2, 5)
TIMES = np.arange(1.0, 6.0)
SCALE = 2.0
SECONDS = 60.0  # for what should be over at once, on a busy machine


def beam(k):
    """Response (2, 5)."""
    return np.outer([1.0, SCALE], TIMES) / k


DATA = 2.0 * beam(1.0)


def beam_squares(k):
    """e_j of `beam` and `DATA`."""
    return np.mean((DATA - beam(k)) ** 2, axis=1)


def beam_gradient(k, cotangent):
    """Of sum(cotangent * beam(k))."""
    return -np.sum(cotangent * beam(k)) / k


def beam_squares_gradient(k, cotangent):
    """Of sum(cotangent * beam_squares(k))."""
    misfit = DATA - beam(k)
    return np.sum(cotangent * np.mean(2.0 * misfit * beam(k) / k, axis=1))


def two(a, b):
    """Response of a number and an array (2,)."""
    return a * beam(1.0) + np.reshape(b, (2, 1)) ** 2


def lives(pid) -> bool:
    """Whether a process is there and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_until(condition):
    """Wait for something that should happen at once."""
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def note(path, text):
    """Add a line to a file, whole even if others do the same."""
    with open(path, "ab", buffering=0) as file:
        file.write(f"{text}\n".encode())


class Counted:
    """`beam`, that writes down each call: process (id) and parameter."""

    def __init__(self, path, seconds=0.0):
        self.path, self.seconds = str(path), seconds

    def __call__(self, k):
        note(self.path, f"{os.getpid()} {float(k)!r}")
        time.sleep(self.seconds)
        return beam(k)

    def calls(self):
        """Processes and parameters so far."""
        if not Path(self.path).exists():
            return []
        lines = Path(self.path).read_text().split("\n")[:-1]
        return [(int(pid), float(k)) for pid, k in map(str.split, lines)]


class Hanging:
    """Writes down its process and one that it started, and does not end."""

    def __init__(self, path):
        self.path = str(path)

    def __call__(self, k):
        child = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(100)"])
        note(self.path, f"{os.getpid()} {child.pid}")
        time.sleep(100)


def lot(k):
    """A number between 0 and 1 that only the digits of k decide."""
    return int.from_bytes(hashlib.sha256(np.float64(k).tobytes()).digest()[:4]) / 2**32


def troubled_line(a):
    """a times `beam(1)` for 85 % of the a; 10 % raise, 5 % hang."""
    chance = lot(a)
    if chance < 0.1:
        raise ValueError("no equilibrium")
    if chance < 0.15:
        time.sleep(100)
    return a * beam(1.0)


def ways_to_fail(k):
    """A failure for each whole k, and the response for others."""
    match k:
        case 1.0:
            raise ZeroDivisionError("first line\nsecond line")
        case 2.0:
            return np.full(SHAPE, np.nan)
        case 3.0:
            return beam(k)[:, :-1]
        case 4.0:
            return beam(k) + 1j
        case 5.0:
            sys.exit("no licence")
        case 6.0:
            print("last words", file=sys.stderr)
            os._exit(3)
        case 7.0:
            os.kill(os.getpid(), signal.SIGKILL)
        case 8.0:
            time.sleep(100)
    return beam(k)


class FailsAtFirst:
    """Fails the first `n` times that it is called with a parameter."""

    def __init__(self, folder, n, died=False):
        self.folder, self.n, self.died = str(folder), n, died

    def __call__(self, k):
        path = Path(self.folder) / f"{k!r}"
        note(path, "call")
        if len(path.read_text().splitlines()) <= self.n:
            if self.died:
                os.kill(os.getpid(), signal.SIGKILL)
            raise OSError("no licence free")
        return beam(k)


def curious(k):
    """Says where it runs and what it finds there, leaves a file behind; (2, 5) numbers."""
    found = len(os.listdir())
    Path("left.txt").write_text("left")
    result = np.zeros(SHAPE)
    result[0, 0], result[0, 1] = found, Path.cwd().name.startswith("simulation-")
    return result


def chain_response(theta, acceleration, dt):
    """Absolute accelerations (3, time) of three unit masses on springs of 100 N/m, the first scaled by theta.

    Rayleigh damping of 0.1 / s and 1e-3 s; exact for an excitation that is linear between its samples, by the
    exponential of the matrix of states, excitation and its slope.
    """
    k = 100.0 * np.array([theta, 1.0, 1.0])
    stiffness = np.diag(k) + np.diag([k[1], k[2], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    damping = 0.1 * np.eye(3) + 1e-3 * stiffness
    a = np.zeros((8, 8))
    a[:3, 3:6] = np.eye(3)
    a[3:6, :3], a[3:6, 3:6], a[3:6, 6] = -stiffness, -damping, -1.0
    a[6, 7] = 1.0
    a = a * dt / 2**10
    term, step = np.eye(8), np.eye(8)
    for n in range(1, 12):
        term = term @ a / n
        step += term
    for _ in range(10):
        step = step @ step
    states = np.zeros((len(acceleration), 8))
    states[0, 6], states[:-1, 7] = acceleration[0], np.diff(acceleration) / dt
    for i in range(1, len(states)):
        states[i, :7] = (step @ states[i - 1])[:7]
    return -stiffness @ states[:, :3].T - damping @ states[:, 3:6].T
