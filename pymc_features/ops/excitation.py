"""The excitation of a model: how finely its record is marched, and its values at outputs that may change."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op

from pymc_features import band_limited
from pymc_features.simulators.excitation import excitation_of, own_values, refined_request, request_of_family
from pymc_features.simulators.families import NONLINEAR
from pymc_features.simulators.oscillators.arguments import Excitation
from pymc_features.structures.base import IN_PYTHON

N_DRAWS, N_SPARSE = 20, 4  # structures of the prior whose modes are looked at; of sparse ones modes cost more
STARTS = 4  # place of the pattern's starts among the constants of linear structures
UNKNOWN = 4  # refinement where the prior cannot be drawn from


def request_in_model(structure, record, asked):
    """A request with the refinement that structures drawn from the prior need."""
    if not structure.is_symbolic:
        return refined_request(structure, record, asked)
    if record.interpolation == "linear" and structure.family not in NONLINEAR:
        return asked
    parameters = structure.parameters()
    symbolic = [x for x in parameters if isinstance(x, Variable)]
    constants = structure.constants(record)
    is_sparse = structure.family == "linear" and constants[STARTS].size > 0
    try:
        drawn = iter(pm.draw(symbolic, N_SPARSE if is_sparse else N_DRAWS, random_seed=0, mode=IN_PYTHON))
    except Exception:  # noqa: BLE001  flat priors, inputs that are no random variables, Ops of users
        return asked if record.interpolation == "linear" else asked._replace(factor=UNKNOWN)
    numbers = [next(drawn) if isinstance(x, Variable) else np.asarray(x)[None] for x in parameters]
    return request_of_family(structure, numbers, record, asked)


def excitation_in_model(structure, record, dt, asked) -> Excitation:
    """Do as `excitation_of`; where the record or `dt` is data, what follows from it are variables."""
    values = structure.excitation(record)
    found, rows = excitation_of(values, record, asked), np.atleast_2d(values)
    if record.data is not None:
        rows = record.data.astype("float64")[None]
        fine = rows if record.interpolation == "linear" else Refined(asked.factor)(rows)
        found = found._replace(acceleration=fine[0] if values.ndim == 1 else fine)
    elif not isinstance(dt, SharedVariable):
        return found
    substeps, stride = asked.substeps, asked.stride
    if isinstance(dt, SharedVariable):
        ratio = dt / record.dt
        substeps, stride = (pt.round(pt.maximum(r, 1.0)).astype("int64") for r in (1.0 / ratio, ratio))
        found = found._replace(substeps=substeps, stride=stride * asked.factor)
    if record.interpolation == "linear":
        return found
    return found._replace(direct=OwnValues(record.dt)(rows, substeps, stride))


class OfRecord(Op):
    """Base: what is made of a band-limited record (d, t), that no parameter changes."""

    def make_node(self, values, *outputs):
        values, *outputs = map(pt.as_tensor_variable, (values, *outputs))
        return Apply(self, [values, *outputs], [pt.tensor(dtype="float64", shape=(None,) * self.ndim)])

    def connection_pattern(self, node):
        """No parameter changes it."""
        return [[False]] * len(node.inputs)

    def pullback(self, inputs, outputs, cotangents):
        """Nothing to differentiate by."""
        return [pt.zeros_like(x).astype("float64") for x in inputs]


class Refined(OfRecord):
    """Samples (d, u) some times finer whose straight lines stand for a record; see `band_limited.refined`."""

    __props__ = ("factor",)
    ndim = 2

    def __init__(self, factor):
        self.factor = int(factor)

    def perform(self, node, inputs, output_storage):
        output_storage[0][0] = band_limited.refined(inputs[0], self.factor)


class OwnValues(OfRecord):
    """A band-limited record and its derivatives at the outputs, (5, d, u); see `excitation.own_values`.

    Parameters
    ----------
    dt : float
        Sampling interval of the record [s].
    """

    __props__ = ("dt",)
    ndim = 3

    def __init__(self, dt):
        self.dt = float(dt)

    def perform(self, node, inputs, output_storage):
        values, substeps, stride = inputs
        output_storage[0][0] = own_values(values, self.dt, int(substeps), int(stride))
