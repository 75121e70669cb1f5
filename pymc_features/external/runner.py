"""Runs simulations in a process of its own; started as a script, it imports nothing of the package.

A process that hangs can be killed, and one that crashes takes nothing with it. Talks to its parent through
the socket whose number is its first argument; what a simulator prints goes to its standard error.
"""

import os
import pickle
import shutil
import sys
import tempfile
import time
from multiprocessing.connection import Connection

import cloudpickle
import numpy as np


def one_call(work, arguments, folder):
    """Result of one simulation as an array, and its seconds; in a scratch folder if there is to be one."""
    function, observed = work["function"], work["observed"]
    start = time.perf_counter()
    if folder is not None:
        os.chdir(folder)
    result = function(*arguments)
    if np.iscomplexobj(result):
        raise TypeError("the simulator must return real numbers, got complex ones. Return their parts.")
    result = np.array(result, dtype=np.float64)
    if result.shape != work["shape"]:
        raise ValueError(
            f"the simulator must return an array of shape {work['shape']}, got {result.shape}. Time is the "
            "last axis."
        )
    if observed is not None:
        result = np.mean((observed - result) ** 2, axis=-1)
    return result, time.perf_counter() - start


def answer(work, arguments):
    """("ok", result, seconds) or ("error", text, seconds) of one call."""
    folder = None
    if work["scratch"] is not None:
        folder = tempfile.mkdtemp(prefix="simulation-", dir=work["scratch"] or None)
    home, start = os.getcwd(), time.perf_counter()
    try:
        result, seconds = one_call(work, arguments, folder)
        if not np.isfinite(result).all():
            return "error", "the result is not finite", seconds
        return "ok", result, seconds
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a solver may fail in its own way, and even try to exit
        text = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        return "error", text, time.perf_counter() - start
    finally:
        os.chdir(home)
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def main():
    """Load the function, then answer calls until the parent is gone."""
    connection = Connection(int(sys.argv[1]))
    sys.path[:] = pickle.loads(connection.recv_bytes())
    try:
        work = cloudpickle.loads(connection.recv_bytes())
        connection.send(("ready", "", 0.0))
    except BaseException as error:
        connection.send(("unusable", f"{type(error).__name__}: {error}", 0.0))
        return
    while True:
        try:
            arguments = connection.recv()
        except (EOFError, OSError):
            return
        connection.send(answer(work, arguments))


if __name__ == "__main__":
    main()
