"""Kernels as parts of other kernels: their code goes into those that call them.

Numba optimises each function that it compiles, and makes machine code of it, together with all that the
function calls: code that is six calls deep is optimised six times. Here what a kernel calls is translated to
LLVM's language only; it is optimised and becomes machine code once, in the kernel that Python calls. There
LLVM's level 2 is asked for: of level 3, which is Numba's, the machine code is as fast, and takes half as long
again to make.
"""

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.types import Dispatcher as DispatcherType

LEVEL = 2  # of optimisation


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


class KernelLibrary(JITCodeLibrary):
    """Code that is optimised at LLVM's level 2."""

    def _optimize_functions(self, ll_module):
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            passes, builder = self._codegen._function_pass_manager(opt=LEVEL)
            passes.run(function, builder)

    def _optimize_final_module(self):
        for settings in (
            {"opt": 0, "loop_vectorize": False, "slp_vectorize": False, "cost": "cheap"},
            {"opt": LEVEL},
        ):
            passes, builder = self._codegen._module_pass_manager(**settings)
            passes.run(self._final_module, builder)


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


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(NativeLowering):
    """The last pass of a compilation, into a `KernelLibrary`."""

    _name = "kernel_lowering"

    def run_pass(self, state):
        state.library = KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return super().run_pass(state)


class PartCompiler(CompilerBase):
    """Numba's compiler with another last pass."""

    last_pass = PartLowering

    def define_pipelines(self):
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [
            (self.last_pass if step is NativeLowering else step, why) for step, why in manager.passes
        ]
        manager.finalize()
        return [manager]


class KernelCompiler(PartCompiler):
    """The same for kernels."""

    last_pass = KernelLowering


class PartDispatcher(CPUDispatcher):
    """A kernel as compiled code calls it; Python cannot."""

    def add_overload(self, cres):
        self.overloads[tuple(cres.signature.args)] = cres


class Kernel(CPUDispatcher):
    """A kernel as Python calls it: machine code of its own, kept on disk."""

    def __init__(self, py_func, locals=None, targetoptions=None):
        super().__init__(py_func, locals, targetoptions, pipeline_class=KernelCompiler)
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
