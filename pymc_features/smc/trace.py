"""The trace of a chain in one call of a compiled function, where PyMC calls one for each draw."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pymc.smc.sampling
import pytensor.tensor as pt
from pymc.backends.ndarray import NDArray
from pymc.pytensorf import compile as compile_function
from pymc.smc.sampling import _build_trace_from_kernel_state as draw_by_draw
from pymc.vartypes import discrete_types
from pytensor.graph.replace import vectorize_graph
from pytensor.graph.traversal import ancestors

from pymc_features.smc.density.compilation import with_mode
from pymc_features.smc.density.graph import largest_result
from pymc_features.smc.density.nodes import is_random, simulator_functions
from pymc_features.smc.density.rows import BATCH_BYTES


class TraceFunction:
    """What a trace holds of a model, of many draws at once.

    Parameters
    ----------
    model : pymc.Model

    Attributes
    ----------
    possible : bool
        False if something in the model takes one draw at a time, or draws random numbers itself.
    """

    def __init__(self, model):
        self.values = model.value_vars
        self.variables = model.unobserved_value_vars
        rest = [v for v in self.variables if v not in self.values]
        owners = {v.owner for v in ancestors(rest) if v.owner is not None}
        self.possible = not (simulator_functions(rest) or any(map(is_random, owners)))
        self.names, self.function = [v.name for v in rest], None
        if not (self.possible and rest):
            return
        self.batch = max(1, BATCH_BYTES // (8 * largest_result(self.values, rest)))
        inputs = [pt.tensor(v.name, dtype=v.dtype, shape=(None, *v.type.shape)) for v in self.values]
        try:
            outputs = vectorize_graph(rest, dict(zip(self.values, inputs, strict=True)))
        except Exception:  # any Op of any library may refuse in its own way
            self.possible = False
            return
        rows = inputs[0].shape[0]
        outputs = [
            new if new.ndim > old.ndim else pt.broadcast_to(new, (rows, *new.shape))
            for new, old in zip(outputs, rest, strict=True)
        ]
        self.function = compile_function(inputs, outputs, on_unused_input="ignore", **with_mode({}, outputs))

    def __call__(self, draws: list) -> dict[str, np.ndarray]:
        """All variables (draw, ...) by name, from those of `model.value_vars`."""
        own = dict(zip([v.name for v in self.values], draws, strict=True))
        if self.function is not None:
            parts = [
                self.function(*(x[i : i + self.batch] for x in draws))
                for i in range(0, len(draws[0]), self.batch)
            ]
            own |= dict(zip(self.names, map(np.concatenate, zip(*parts, strict=True)), strict=True))
        return {v.name: own[v.name] for v in self.variables}


@contextmanager
def all_draws_at_once() -> Iterator[None]:
    """Let `pm.sample_smc` write its traces in one call; as it does by itself where that is not possible."""
    functions = {}

    def build_trace(tempered_posterior, var_info, variables, chain, model):
        if model not in functions:
            functions[model] = TraceFunction(model)
        if not functions[model].possible:
            return draw_by_draw(tempered_posterior, var_info, variables, chain, model)
        draws, first = [], 0
        for v in variables:
            shape, size = var_info[v.name]
            values = tempered_posterior[:, first : first + size].reshape(-1, *shape)
            draws.append((np.round(values) if v.dtype in discrete_types else values).astype(v.dtype))
            first += size
        return filled_trace(functions[model], draws, chain, model)

    pymc.smc.sampling._build_trace_from_kernel_state = build_trace
    try:
        yield
    finally:
        pymc.smc.sampling._build_trace_from_kernel_state = draw_by_draw


def filled_trace(function, draws, chain, model) -> NDArray:
    """A chain's trace of draws, arrays (draw, ...) in the order of `model.value_vars`."""
    found = function(draws)
    trace = NDArray(
        name=model.name,
        model=model,
        fn=lambda *point: [x[0] for x in function([np.asarray(x)[None] for x in point]).values()],
        var_shapes={name: x.shape[1:] for name, x in found.items()},
        var_dtypes={name: x.dtype for name, x in found.items()},
    )
    trace.setup(len(draws[0]), chain)
    trace.samples.update({name: np.ascontiguousarray(x) for name, x in found.items()})
    trace.draw_idx = trace.draws
    return trace
