"""What Linux, macOS and Windows do differently, in one place: locks, processes and how they end.

Nothing here imports more than the standard library, for processes of simulators load this file by itself.
"""

import getpass
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

IS_WINDOWS = sys.platform == "win32"
FAR = 2**40  # byte of a file that nobody writes, by which Windows locks it
SYNCHRONIZE, FOREVER = 0x00100000, 0xFFFFFFFF  # of a process of Windows that is waited for


def lock_file(file) -> None:
    """Take an open binary file for this process alone, until it is closed.

    Raises
    ------
    OSError
        If another process has it.
    """
    if not IS_WINDOWS:
        import fcntl

        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt

    position = file.tell()
    file.seek(FAR)
    try:
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    finally:
        file.seek(position)


@contextmanager
def one_process_at_a_time() -> Iterator[None]:
    """Wait for other processes of this user and machine; without a place for a lock go on."""
    from filelock import FileLock

    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # of a container
        user = "user"
    lock = FileLock(Path(tempfile.gettempdir()) / f"pymc_features-{user}.lock")
    with suppress(OSError):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def start_connected(command: list[str], **options) -> tuple[subprocess.Popen, Connection]:
    """Start a process that has the other end of a connection, see `connection_of`, and a group of its own.

    Ctrl-C is this process's alone. `command` gets one argument more, by which the process finds its end.
    """
    ours, theirs = Pipe()
    if IS_WINDOWS:
        os.set_handle_inheritable(theirs.fileno(), True)
        startup = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [theirs.fileno()]})
        options |= {"startupinfo": startup, "creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    else:
        options |= {"pass_fds": [theirs.fileno()], "start_new_session": True}
    try:
        return subprocess.Popen([*command, str(theirs.fileno())], **options), ours
    finally:
        theirs.close()


def connection_of(argument: str) -> Connection:
    """The connection of a process that `start_connected` has started, from its last argument."""
    if IS_WINDOWS:
        from multiprocessing.connection import PipeConnection

        return PipeConnection(int(argument))
    connection = Connection(int(argument))
    os.set_inheritable(connection.fileno(), False)
    return connection


def wait_for_parent(connection: Connection) -> None:
    """Wait until the process that started this one is gone."""
    if IS_WINDOWS:
        import _winapi

        parent = _winapi.OpenProcess(SYNCHRONIZE, False, os.getppid())
        _winapi.WaitForSingleObject(parent, FOREVER)
        return
    import select

    hangup = select.poll()
    hangup.register(connection.fileno(), 0)
    hangup.poll()


def kill_with_all(process: subprocess.Popen) -> None:
    """Kill a process of `start_connected` and what it has started, if it is still there."""
    if IS_WINDOWS:
        command = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
        return
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def end_with_all() -> None:
    """End this process, one of `start_connected`, at once, and what it has started."""
    if IS_WINDOWS:
        subprocess.run(["taskkill", "/F", "/T", "/PID", str(os.getpid())], check=False)
        return
    os.killpg(0, signal.SIGKILL)


def at_fork(before: Callable, after_in_parent: Callable, after_in_child: Callable) -> None:
    """Register what is to be done around a fork, where the system has one."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=before, after_in_parent=after_in_parent, after_in_child=after_in_child)
