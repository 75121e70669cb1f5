"""Kernels as parts of other kernels: their code goes into those that call them.

Numba optimises each function that it compiles, and makes machine code of it, together with all that the
function calls: code that is six calls deep is optimised six times. Here what a kernel calls is translated to
LLVM's language only; it is optimised and becomes machine code once, in the kernel that Python calls.
"""

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.types import Dispatcher as DispatcherType


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


class Kernel(CPUDispatcher):
    """A kernel as Python calls it: machine code of its own, kept on disk."""

    def __init__(self, py_func, locals=None, targetoptions=None):
        super().__init__(py_func, locals, targetoptions)
        alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        self.part = PartDispatcher(py_func, targetoptions=targetoptions | alone, pipeline_class=PartCompiler)
        self.enable_caching()

    def add_overload(self, cres):
        for environment in cres._find_referenced_environments():  # those of the parts
            cres.library.codegen.set_env(environment.env_name, environment)
        super().add_overload(cres)

    @property
    def _numba_type_(self):
        return DispatcherType(self.part)
