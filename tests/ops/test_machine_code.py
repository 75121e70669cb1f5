"""Machine code on disk: an edit compiles anew what it can change, and nothing else."""

import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest
from numba import njit
from numba.core.caching import FunctionCache

import pymc_features
from pymc_features.ops import (
    OPS,
    PopulationDiscrepancy,
    StructuralDiscrepancy,
    StructuralResponse,
    numba_dispatch,
)
from pymc_features.simulators import QUANTITIES
from pymc_features.simulators.chain.kernels import evaluate_chains
from pymc_features.simulators.compiled import dependencies
from pymc_features.simulators.compiled.jit import jit
from pymc_features.simulators.oscillators.arguments import n_outputs
from support.commands import run_python


def test_cache_key_holds_type_quantity_and_kernel_source(monkeypatch):
    keys = {numba_dispatch.cache_key(op(quantity)) for op in OPS for quantity in QUANTITIES}
    assert len(keys) == len(OPS) * len(QUANTITIES)
    given = SimpleNamespace(type=SimpleNamespace(shape=(5, 100)))  # data of few samples
    node = SimpleNamespace(inputs=[given] * 20, outputs=[pt.vector()])
    assert all(numba_dispatch.funcify(op(), node)[1] == numba_dispatch.cache_key(op()) for op in OPS)
    assert set(numba_dispatch.OPS) == set(OPS)
    monkeypatch.setattr(numba_dispatch, "source_hash", lambda module: "edited")
    compiled = [op for op in OPS if numba_dispatch.is_compiled(op())]  # others run no machine code of ours
    assert StructuralDiscrepancy in compiled and PopulationDiscrepancy not in compiled
    assert not keys & {numba_dispatch.cache_key(op(quantity)) for op in compiled for quantity in QUANTITIES}


def test_dependencies_are_the_files_that_can_change_a_kernel():
    def names(module):
        path = dependencies.module_path(f"pymc_features.simulators.{module}")
        return {str(file.relative_to(dependencies.ROOT)) for file in dependencies.dependencies(path)}

    chain = names("chain.kernels")
    assert {"simulators/chain/modes.py", "simulators/oscillators/march.py"} <= chain
    assert not any("linear/" in name or "nonlinear/" in name for name in chain)
    law = names("nonlinear.runge_kutta")  # which calls the laws by their type only
    assert {"simulators/nonlinear/bouc_wen/law.py", "simulators/nonlinear/duffing.py"} <= law


def test_one_kernel_serves_python_and_graphs():
    """And arrays that may not be written, and views."""
    op, mass, springs = StructuralDiscrepancy(), np.ones(4), np.full(4, 50.0)
    rest = np.zeros(2), np.full(4, 0.1), np.sin(np.arange(9.0)), *map(np.asarray, (0.02, 1, 1))
    rest = *rest, np.empty((0, 0, 0)), np.arange(4), np.asarray(4), np.ones((4, 9))
    [expected] = op.run([mass, springs, *rest])
    compiled = set(op.kernel.overloads)
    assert numba_dispatch.kernel_types(op) in compiled
    locked = np.ones(4)
    locked.flags.writeable = False
    np.testing.assert_array_equal(op.run([locked, np.full(8, 50.0)[::2], *rest])[0], expected)
    given = pt.vector()
    graph = pytensor.function([given], op(given, pt.constant(springs), *rest), mode="NUMBA")
    np.testing.assert_array_equal(graph(np.ones(8)[::2]), expected)
    assert set(op.kernel.overloads) == compiled


def test_responses_share_the_machine_code_of_populations():
    """README's model compiles one kernel; compiled graphs have another for responses."""
    op, parameters = PopulationDiscrepancy(), (np.ones(4), np.full(4, 50.0), np.zeros(2), np.full(4, 0.1))
    rest = (
        np.sin(np.arange(9.0)),
        *map(np.asarray, (0.02, 1, 1)),
        np.empty((0, 0, 0)),
        np.arange(4),
        np.asarray(4),
    )
    [history] = StructuralResponse().run([*parameters, *rest])
    [errors] = op.run([*(np.stack([x, x]) for x in parameters), *rest, np.zeros((4, 9))])
    np.testing.assert_allclose(errors, [np.mean(history**2, axis=1)] * 2, rtol=1e-12)
    assert len(evaluate_chains.overloads) == 1
    assert numba_dispatch.is_compiled(StructuralResponse()) and not numba_dispatch.is_compiled(op)


def test_kernels_are_parts_of_those_that_call_them():
    """The same numbers from Python and from compiled code, where they have no machine code of their own."""
    calling = njit(lambda n, substeps: n_outputs(n, substeps, 1))
    assert calling(11, 2) == n_outputs(11, 2, 1) == 21
    for part in n_outputs.part.overloads.values():
        engine, name = part.codegen._engine, part.fndesc.llvm_func_name
        assert any(function.name == name for function in part.library.get_defined_functions())
        assert not engine.is_symbol_defined(name)
    assert Path(n_outputs._cache._impl.locator._py_file).name == "arguments.py"  # named in warnings


def test_code_whose_arguments_have_moved_is_compiled_anew(monkeypatch):
    """As after an update in which a class of arguments stands in another module."""
    calls = []

    def moved(self, sig, target_context):
        calls.append(sig)
        raise ModuleNotFoundError("No module named 'pymc_features.simulators.elsewhere'")

    assert n_outputs(11, 2, 1) == 21
    monkeypatch.setattr(FunctionCache, "load_overload", moved)
    monkeypatch.setattr(FunctionCache, "flush", lambda self: calls.append("flush"))
    again = jit(n_outputs.py_func)
    assert again(11, 2, 1) == 21 and calls[1:] == ["flush"]


class Copy:
    """A copy of the package, with caches of its own, whose source can be edited."""

    def __init__(self, folder):
        self.folder, self.package = folder, folder / "pymc_features"
        source = Path(pymc_features.__file__).parent
        shutil.copytree(source, self.package, ignore=shutil.ignore_patterns("__pycache__"))
        of_kernel = Path(StructuralDiscrepancy().kernel._cache.cache_path)  # the source is the same as yet
        if any(of_kernel.glob("*.nbc")):
            shutil.copytree(of_kernel, folder / "numba" / "kernels" / of_kernel.name)

    def edit(self, file, old, new):
        source = (self.package / file).read_text()
        assert source.count(old) == 1
        (self.package / file).write_text(source.replace(old, new))

    def run(self):
        """The discrepancy of one particle, from a new process."""
        environment = {
            "PYTHONPATH": str(self.folder),
            "PYTENSOR_FLAGS": f"base_compiledir={self.folder / 'pytensor'}",
            "NUMBA_CACHE_DIR": str(self.folder / "numba"),
        }
        where, value = run_python(ONE, self.folder, **environment).split()
        assert Path(where).parent == self.package
        return float(value)

    def remove_bytecode(self):
        """Where it is not beside the source."""
        if sys.pycache_prefix is not None:
            shutil.rmtree(Path(sys.pycache_prefix, *self.folder.parts[1:]), ignore_errors=True)

    def machine_code(self):
        """Files of machine code, of kernels and of PyTensor's graphs, with the times they were written."""
        files = [*self.folder.rglob("*.nbc"), *self.folder.rglob("*.nbi")]
        return {str(file): file.stat().st_mtime_ns for file in files}


ONE = """
    import numpy as np, pytensor, pymc_features
    import pytensor.tensor as pt
    from pymc_features.ops import StructuralDiscrepancy
    mass, one = pt.vector("mass"), np.ones(1)
    e = StructuralDiscrepancy()(mass, 50 * one, 0 * np.ones(2), 0.1 * one, np.arange(3.0), 0.02, 1, 1,
                           np.empty((0, 0, 0)), np.arange(1), 1, np.ones((1, 3)))
    print(pymc_features.__file__, float(pytensor.function([mass], e[0], mode="NUMBA")(one)))
"""


@pytest.mark.processes
def test_edits_compile_what_they_change_and_nothing_else(tmp_path, request):
    """Edits that cannot change the kernel; then edits in its own file (twice), in that of a part of another
    folder (five times), and in its call from PyTensor (three times), compiled with it.
    """
    test_one_kernel_serves_python_and_graphs()  # its machine code goes into the copy
    copy = Copy(tmp_path)
    request.addfinalizer(copy.remove_bytecode)
    code = copy.machine_code()
    assert code
    without_kernels = ("simulators/simulate.py", "simulators/quantities.py", "ops/response.py")
    for file in (*without_kernels, "simulators/nonlinear/runge_kutta.py"):  # or with those of another family
        with open(copy.package / file, "a") as source:
            source.write("\n\ndef more():\n    return 1\n")
    value = copy.run()
    of_chains = {name: t for name, t in copy.machine_code().items() if "simulators.chain.kernels" in name}
    assert of_chains == code
    copy.edit(
        "simulators/chain/kernels.py", "wanted, observed, 1)[:, 0].copy()", "wanted, observed, 1)[:, 0] * 2.0"
    )
    copy.edit("simulators/oscillators/march.py", "own[0] = walk", "own[0] = 5.0 * walk")
    copy.edit(
        "ops/numba_dispatch.py",
        "return kernel((*assembled(given), *given[more:]))",
        "return 3.0 * kernel((*assembled(given), *given[more:]))",
    )
    assert copy.run() == pytest.approx(30.0 * value, rel=1e-14)
