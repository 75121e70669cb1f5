"""How kernels are compiled, and how their machine code is kept on disk.

Numba's own disk cache notices a change of the file that holds a function, not of the functions it calls in
other files: after an upgrade it can run old machine code. Here the cache folder of a function is named after
a hash of its own file and of all files of this package that this one depends on (`dependencies.py`): an edit
compiles anew what it can change, and nothing else. The same hash goes into the cache keys of the PyTensor
Ops (`pymc_features.ops`).

Kernels as parts of other kernels: their code goes into those that call them.

Numba optimises each function that it compiles, and makes machine code of it, together with all that the
function calls: code that is six calls deep is optimised six times. Here what a kernel calls is translated to
LLVM's language only; it is optimised and becomes machine code once, in the kernel that Python calls.
"""

import logging
from pathlib import Path

from numba import config, njit
from numba.core import event
from numba.core.caching import CacheImpl, FunctionCache, _CacheLocator
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.imputils import lower_constant
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.types import Dispatcher as DispatcherType
from numba.extending import models, register_model
from numba.misc.appdirs import AppDirs

from pymc_features.simulators.compiled.dependencies import source_hash


class PartLibrary(JITCodeLibrary):
    """Code to be linked into other code, neither optimised nor made machine code."""

    def finalize(self):
        self._raise_if_finalized()
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._final_module.verify()
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class PartLowering(NativeLowering):
    """The last pass of a compilation, into a `PartLibrary`."""

    _name = "part_lowering"

    def run_pass(self, state):
        state.library = PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        key = object()  # by which compiled code finds the function
        state["cr"] = state["cr"]._replace(cfunc=key)
        state.targetctx.insert_user_function(key, state["cr"].fndesc, [state.library])
        return True


class PartCompiler(CompilerBase):
    """Numba's compiler with that pass."""

    def define_pipelines(self):
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [
            (PartLowering if step is NativeLowering else step, why) for step, why in manager.passes
        ]
        manager.finalize()
        return [manager]


class PartDispatcher(CPUDispatcher):
    """A kernel as compiled code calls it; Python cannot."""

    def add_overload(self, cres):
        self.overloads[tuple(cres.signature.args)] = cres


class PartType(DispatcherType):
    """Type of a part. It may be an argument of another part, of which code is kept on disk all the same.

    Numba would put an address into that code, which no other process knows; who calls reads the type only.
    """


register_model(PartType)(models.OpaqueModel)


@lower_constant(PartType)
def _part_constant(context, builder, kind, value):
    return context.get_dummy_value()


class KernelCache(FunctionCache):
    """Machine code on disk."""

    def load_overload(self, sig, target_context):
        """None, too, where the named tuples that a kernel takes stood elsewhere when its code was kept."""
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            self.flush()
            return None


class Kernel(CPUDispatcher):
    """A kernel as Python calls it: machine code of its own, kept on disk."""

    def __init__(self, py_func, locals=None, targetoptions=None):
        super().__init__(py_func, locals, targetoptions)
        alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self.part = PartDispatcher(py_func, targetoptions=targetoptions | alone, pipeline_class=PartCompiler)
        self._cache = KernelCache(py_func)

    def add_overload(self, cres):
        for environment in cres._find_referenced_environments():  # those of the parts
            cres.library.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)

    @property
    def _numba_type_(self):
        return PartType(self.part)


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


class FirstUse(event.Listener):
    """Says once in a process that kernels are compiled, and that the next process need not."""

    is_told = False

    def on_start(self, event):
        if isinstance(event.data["dispatcher"], Kernel) and not self.is_told:
            self.is_told = True
            logging.getLogger("pymc_features").info(
                "Compiling for this machine, once: the first model of a kind takes up to a minute longer. "
                "`pymc-features warm-up` compiles ahead."
            )

    def on_end(self, event):
        pass


FIRST_USE = FirstUse()
event.register("numba:compile", FIRST_USE)


def jit(function):
    """Compile a kernel: no Python objects, one thread, machine code kept on disk.

    Division by zero gives infinity or NaN, as in NumPy, never an exception in the middle of sampling.
    """
    options = {"nopython": True, "fastmath": FASTMATH, "error_model": "numpy"}
    return Kernel(function, targetoptions=options)


def unrolled(function):
    """Compile a part that goes into its callers: loops are written out for known arguments."""
    options = {"nopython": True, "fastmath": FASTMATH, "error_model": "numpy", "forceinline": True}
    return Kernel(function, targetoptions=options)


def inline(function):
    """Put a kernel's code into those that call it, and do not compile it by itself, which takes as long."""
    return njit(function, fastmath=FASTMATH, error_model="numpy", inline="always")
