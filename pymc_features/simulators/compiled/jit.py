"""How kernels are compiled, and how their machine code is kept on disk.

Numba's own disk cache notices a change of the file that holds a function, not of the functions it calls in
other files: after an upgrade it can run old machine code. Here the cache folder of a function is named after
a hash of its own file and of all files of this package that this one depends on (`dependencies.py`): an edit
compiles anew what it can change, and nothing else. The same hash goes into the cache keys of the PyTensor
Ops (`pymc_features.ops`).
"""

from pathlib import Path

from numba import config, njit
from numba.core.caching import CacheImpl, _CacheLocator
from numba.misc.appdirs import AppDirs

from pymc_features.simulators.compiled.dependencies import source_hash
from pymc_features.simulators.compiled.parts import Kernel

# Everything but `nnan` and `ninf`: the kernels rely on NaN and infinity to reject bad parameters.
FASTMATH = {"arcp", "contract", "afn", "reassoc", "nsz"}


class KernelCacheLocator(_CacheLocator):
    """Keeps the machine code of a kernel in a directory named after the hash of its source."""

    def __init__(self, py_func):
        base = config.CACHE_DIR or AppDirs("pymc_features", appauthor=False).user_cache_dir
        self._stamp = source_hash(py_func.__module__)
        self._path = Path(base) / "kernels" / self._stamp[:24]
        self._name = f"{py_func.__module__}.{py_func.__qualname__}"
        self._py_file = py_func.__code__.co_filename  # named where Numba warns that it cannot keep code

    def get_cache_path(self):
        return str(self._path)

    def get_source_stamp(self):
        return self._stamp

    def get_disambiguator(self):
        return self._name

    @classmethod
    def from_function(cls, py_func, py_file):
        if not py_func.__module__.startswith("pymc_features.simulators."):
            return None
        locator = cls(py_func)
        try:
            locator.ensure_cache_path()
        except OSError:  # read-only home: compile anew in each process
            return None
        return locator


CacheImpl._locator_classes.insert(0, KernelCacheLocator)


def jit(function):
    """Compile a kernel: no Python objects, one thread, machine code kept on disk.

    Division by zero gives infinity or NaN, as in NumPy, never an exception in the middle of sampling.
    """
    options = {"nopython": True, "fastmath": FASTMATH, "error_model": "numpy"}
    return Kernel(function, targetoptions=options)


def unrolled(function):
    """As `jit`, for a part that goes into its callers: loops are written out for known arguments."""
    options = {"nopython": True, "fastmath": FASTMATH, "error_model": "numpy", "forceinline": True}
    return Kernel(function, targetoptions=options)


def inline(function):
    """Put a kernel's code into those that call it, and do not compile it by itself, which takes as long."""
    return njit(function, fastmath=FASTMATH, error_model="numpy", inline="always")
