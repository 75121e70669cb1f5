"""What is expected of each private hook of PyTensor."""

import warnings

import numba
import numpy as np
import pytensor
import pytensor.tensor as pt
from numba import types

from pymc_features.ops.gradient import NoGradient
from support.commands import run_python
from support.hooks.checks import INTERPRETED, check


@check("pytensor.graph.replace._vectorize_node")
def batches():
    from pytensor.graph import replace

    assert callable(replace._vectorize_node.register)
    x = pt.dscalar("x")
    batched = replace.vectorize_graph(NoGradient("none")(x), {x: pt.dvector("xs")})
    assert isinstance(batched.owner.op, NoGradient)


@check("pytensor.graph.basic.Apply.tag")
def kept_with_a_node():
    node = pt.exp(pt.dvector("x")).owner
    node.tag.excited = "by this"
    assert node.tag.excited == "by this"


@check("pytensor.compile.executor.Function.maker")
def compiled_graph():
    x = pt.dvector("x")
    graph = pytensor.function([x], pt.exp(x), mode=INTERPRETED).maker.fgraph
    assert [node.op for node in graph.apply_nodes] == [pt.exp]
    assert len(graph.outputs) == 1


@check(
    "pytensor.link.numba.dispatch.basic.register_funcify_and_cache_key",
    "pytensor.link.numba.dispatch.basic.default_hash_key_from_props",
    "pytensor.link.numba.dispatch.basic.get_numba_type",
    "pytensor.link.numba.dispatch.basic.numba_njit",
    "pytensor.link.numba.dispatch.basic.generate_fallback_impl",
)
def dispatch_of_numba():
    from pytensor.link.numba.dispatch import basic

    class Own(NoGradient):
        """An Op with a dispatch of its own."""

    def funcify(op, node=None, **kwargs):
        return None

    basic.register_funcify_and_cache_key(Own)(funcify)
    assert basic.numba_funcify_and_cache_key.dispatch(Own) is funcify
    keys = [basic.default_hash_key_from_props(Own(r), kernel=k) for r in ("a", "b") for k in ("1", "2")]
    assert len(set(keys)) == 4
    assert keys[0] == basic.default_hash_key_from_props(Own("a"), kernel="1")
    kind = basic.get_numba_type(pt.dmatrix().type)
    assert (kind.ndim, kind.dtype) == (2, types.float64)
    increment = basic.numba_njit(lambda x: x + 1.0)  # for compiled code only
    assert numba.njit(lambda x: increment(x))(1.0) == 2.0
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Numba will use object mode", category=UserWarning)
        fallback = basic.generate_fallback_impl(Own("a"), node=Own("a")(pt.dvector("x")).owner)
        np.testing.assert_array_equal(numba.njit(lambda x: fallback(x))(np.ones(2)), 1.0)


@check("pytensor.link.jax.dispatch.basic.jax_funcify")
def dispatch_of_jax():
    """In a process of its own: JAX starts threads, and other tests fork."""
    code = """
        from pytensor.link.jax.dispatch.basic import jax_funcify
        from pymc_features.ops import jax_dispatch
        from pymc_features.ops.response import StructuralResponse
        print(jax_funcify.dispatch(StructuralResponse).__module__)
    """
    assert run_python(code, None) == "pymc_features.ops.jax_dispatch"
