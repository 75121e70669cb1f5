"""Runs simulations in a process of its own; started as a script, it imports nothing of the package.

A process that hangs can be killed, and one that crashes takes nothing with it. Its arguments are the file
`system.py`, with what systems do differently, and what names the connection through which it talks to its
parent; what a simulator prints goes to its standard error.
"""

import os
import pickle
import runpy
import shutil
import sys
import tempfile
import threading
import time

import cloudpickle
import numpy as np


def one_call(work, arguments):
    """Result of one simulation as an array; as it is where no shape is asked for."""
    result = work["function"](*arguments)
    if work["shape"] is None:
        return result
    if np.iscomplexobj(result):
        raise TypeError("the simulator must return real numbers, got complex ones. Return their parts.")
    result = np.array(result, dtype=np.float64)
    if len(work["shape"]) == 1 and result.ndim == 2 and 1 in result.shape:
        result = result.ravel()  # one line, or one column, of a file
    if result.shape != work["shape"]:
        raise ValueError(
            f"the simulator must return an array of shape {work['shape']}, got {result.shape}. Time is the "
            "last axis."
        )
    if work["observed"] is not None:
        misfit = np.where(np.isnan(work["observed"]), 0.0, work["observed"] - result)  # NaN is a gap
        result = np.mean(misfit**2, axis=-1)
    return result


def answer(work, arguments, scratch):
    """("ok", result, seconds) or ("error", text, seconds) of one call, in an empty folder in `scratch`."""
    home = folder = None
    start = time.perf_counter()
    try:
        home = os.getcwd()
        if scratch:
            folder = tempfile.mkdtemp(prefix="simulation-", dir=scratch)
            os.chdir(folder)
        result = one_call(work, arguments)
        if work["shape"] is not None and not np.isfinite(result).all():
            return "error", "the result is not finite", time.perf_counter() - start
        return "ok", result, time.perf_counter() - start
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a solver may fail in its own way, and even try to exit
        text = f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"
        return "error", text, time.perf_counter() - start
    finally:
        if home is not None:
            os.chdir(home)
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def end_with_parent(connection, scratch):
    """Wait until the parent is gone; then end this process and what it started, whatever it is doing."""
    SYSTEM["wait_for_parent"](connection)
    remove(scratch)
    SYSTEM["end_with_all"]()


def remove(scratch):
    """Remove a folder, if there is one."""
    if scratch:
        shutil.rmtree(scratch, ignore_errors=True)


def own_folder(work) -> str:
    """A folder for the scratch folders of this process; empty if it needs none."""
    if work["scratch"] is None:
        return ""
    if work["scratch"]:
        os.makedirs(work["scratch"], exist_ok=True)
    return tempfile.mkdtemp(prefix="simulator-", dir=work["scratch"] or None)


def main():
    """Load the function, then answer calls, and load others, until the parent is gone."""
    connection = SYSTEM["connection_of"](sys.argv[2])
    sys.path[:] = pickle.loads(connection.recv_bytes())
    try:
        works = [cloudpickle.loads(connection.recv_bytes())]
        scratch = own_folder(works[0])
        connection.send(("ready", scratch, 0.0))
    except BaseException as error:
        connection.send(("unusable", f"{type(error).__name__}: {error}", 0.0))
        return
    threading.Thread(target=end_with_parent, args=(connection, scratch), daemon=True).start()
    try:
        while True:
            kind, first, second = connection.recv()
            if kind == "load":
                connection.send(load_more(works, first, second))
            else:
                connection.send(answer(works[first], second, scratch))
    except (EOFError, OSError):
        remove(scratch)


def load_more(works, payload, drop):
    """Add one more payload, in place of the first one if that is to go; an answer for the parent."""
    start = time.perf_counter()
    if drop:
        del works[0]
    try:
        works.append(cloudpickle.loads(payload))
    except BaseException as error:
        return "unusable", f"{type(error).__name__}: {error}", 0.0
    return "ready", "", time.perf_counter() - start


if __name__ == "__main__":
    SYSTEM = runpy.run_path(sys.argv[1])
    main()
