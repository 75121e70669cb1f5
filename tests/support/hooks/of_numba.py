"""What is expected of each private hook of Numba."""

import functools
from types import SimpleNamespace

import numba
import numpy as np

from pymc_features.simulators.compiled.arrays import ascending
from pymc_features.simulators.compiled.jit import Kernel, KernelCacheLocator, PartLibrary, PartLowering, jit
from support.hooks.checks import attributes_read, check


@functools.cache
def compiled_pair():
    """A kernel, and what Numba has of its part and of a function that calls it."""

    def double(x):
        return 2.0 * x

    inner = jit(double)
    outer = numba.njit(lambda x: inner(x) + 1.0)
    assert outer(2.0) == 5.0
    return inner, next(iter(inner.part.overloads.values())), next(iter(outer.overloads.values()))


@check(
    "numba.core.registry.CPUDispatcher",
    "numba.core.registry.CPUDispatcher._numba_type_",
    "numba.core.types.Dispatcher",
)
def dispatcher():
    from numba.core.registry import CPUDispatcher

    assert issubclass(Kernel, CPUDispatcher)
    assert isinstance(CPUDispatcher._numba_type_, property)
    kernel, _, _ = compiled_pair()
    kind = numba.typeof(kernel)
    assert isinstance(kind, numba.core.types.Dispatcher)
    assert kind.dispatcher is kernel.part


@check(
    "numba.core.compiler.CompilerBase",
    "numba.core.compiler.DefaultPassBuilder",
    "numba.core.compiler_machinery.register_pass",
    "numba.core.typed_passes.NativeLowering",
    "numba.core.typed_passes.NativeLowering._name",
    "numba.core.codegen.JITCodeLibrary",
)
def passes():
    from numba.core import compiler, compiler_machinery, typed_passes
    from numba.core.codegen import JITCodeLibrary

    assert callable(compiler.CompilerBase.define_pipelines)
    assert callable(compiler_machinery.register_pass)
    assert compiler_machinery._pass_registry.is_registered(PartLowering)
    assert typed_passes.NativeLowering._name == "native_lowering"
    state = SimpleNamespace(flags=compiler.Flags(), func_ir=None)
    steps = [step for step, _ in compiler.DefaultPassBuilder.define_nopython_pipeline(state).passes]
    assert steps.count(typed_passes.NativeLowering) == 1
    _, part, whole = compiled_pair()
    assert type(part.library) is PartLibrary
    assert isinstance(whole.library, JITCodeLibrary)


LIBRARY = "numba.core.codegen.JITCodeLibrary"


@check(f"{LIBRARY}._raise_if_finalized", f"{LIBRARY}._finalized")
def end_of_a_library():
    from numba.core.codegen import JITCodeLibrary

    assert JITCodeLibrary._finalized is False
    _, part, _ = compiled_pair()
    assert part.library._finalized is True
    try:
        JITCodeLibrary._raise_if_finalized(part.library)
    except RuntimeError:
        return
    raise AssertionError("a finalized library may be finalized again")


@check(f"{LIBRARY}._linking_libraries", f"{LIBRARY}._reload_init")
def what_a_library_calls():
    _, part, whole = compiled_pair()
    assert part.library in whole.library._linking_libraries
    assert isinstance(whole.library._reload_init, set)


@check(f"{LIBRARY}._final_module", f"{LIBRARY}._get_module_for_linking")
def code_of_a_library():
    from numba.core.codegen import JITCodeLibrary

    _, part, _ = compiled_pair()
    names = {function.name for function in part.library._final_module.functions}
    assert part.fndesc.llvm_func_name in names
    linked = JITCodeLibrary._get_module_for_linking(part.library)
    assert part.fndesc.llvm_func_name in {function.name for function in linked.functions}


@check(f"{LIBRARY}._finalize_dynamic_globals")
def globals_of_a_library():
    from numba.core.codegen import JITCodeLibrary

    assert callable(JITCodeLibrary._finalize_dynamic_globals)
    calls = [attributes_read(kind) for kind in JITCodeLibrary.__mro__[:-1]]
    assert any("_finalize_dynamic_globals" in names for names in calls)


@check(f"{LIBRARY}.get_pointer_to_function")
def address_of_a_function():
    from numba.core.codegen import JITCodeLibrary

    _, _, whole = compiled_pair()
    assert JITCodeLibrary.get_pointer_to_function(whole.library, whole.fndesc.llvm_func_name) > 0


@check("numba.core.compiler.CompileResult._find_referenced_environments")
def environments():
    from numba.core.compiler import CompileResult

    _, part, whole = compiled_pair()
    assert part.environment in CompileResult._find_referenced_environments(whole)


@check(
    "numba.core.caching.CacheImpl",
    "numba.core.caching.CacheImpl._locator_classes",
    "numba.core.caching._CacheLocator",
    "numba.misc.appdirs.AppDirs",
)
def places_of_machine_code():
    from numba.core import caching
    from numba.misc import appdirs

    assert issubclass(KernelCacheLocator, caching._CacheLocator)
    assert caching._CacheLocator.__abstractmethods__ <= set(vars(KernelCacheLocator))
    first, *_ = [x for x in caching.CacheImpl._locator_classes if not x.__module__.startswith("pytensor.")]
    assert first is KernelCacheLocator  # PyTensor's takes the functions of its graphs only
    assert callable(appdirs.AppDirs)
    assert ascending.stats.cache_path == KernelCacheLocator(ascending.py_func).get_cache_path()


@check("numba.core.cgutils")
def code_of_vectors():
    import numba.core

    for name in ("create_struct_proxy", "get_or_insert_function", "if_unlikely", "unpack_tuple"):
        assert callable(getattr(numba.core.cgutils, name))
    order = ascending(np.array([2.0, 1.0]))
    assert order.tolist() == [1, 0]
