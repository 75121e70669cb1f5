"""The response history as a PyTensor Op, and `response`, its public function."""

from collections.abc import Callable, Sequence
from contextlib import contextmanager

import numpy as np
import pytensor
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.compile.ops import ViewOp
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.traversal import ancestors, explicit_graph_inputs
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.elemwise import DimShuffle, Elemwise
from pytensor.tensor.shape import SpecifyShape
from pytensor.tensor.variable import TensorVariable
from scipy import sparse

from pymc_features._checks import shown
from pymc_features.algebra import to_dense
from pymc_features.ops.excitation import excitation_in_model, request_in_model
from pymc_features.ops.external import ExternalResponse
from pymc_features.ops.gradient import ResponseGradient, gradient_op
from pymc_features.ops.structural import StructuralOp
from pymc_features.records import CyclicTest, DynamicLoad, Loading, Record
from pymc_features.simulators import (
    HISTORIES,
    SIMULATED,
    at_outputs,
    checked_request,
    force_share,
    quantities_of,
    rows_of,
)
from pymc_features.simulators.excitation import excitation_of, frequencies_of
from pymc_features.structures import Structure
from pymc_features.structures.base import IN_PYTHON


class StructuralResponse(StructuralOp):
    """Response history (sensor, time) of a structure, Eqs. (17)-(24)."""

    kernel_name = "response"
    output_signature = "(s,u)"

    def make_node(self, *inputs):
        inputs = self.prepare_inputs(inputs)
        shape = self.static_n_sensors(inputs), self.static_n_outputs(inputs)
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=shape)])

    def infer_shape(self, node, shapes):
        return [(shapes[self.at("sensors")][0], self.symbolic_n_outputs(node, shapes))]

    def run(self, inputs):
        """The history, as Python calls it."""
        return (self.spec.history(*self.arguments(inputs)),)

    def pullback(self, inputs, outputs, cotangents):
        """By `ResponseGradient`."""
        gradients = gradient_op(self, ResponseGradient, inputs)(*inputs, *cotangents, return_list=True)
        return [*gradients, *(disconnected_type() for _ in inputs[self.n_parameters :])]


def response(
    structure: Structure,
    record: Record | Loading | CyclicTest,
    *,
    dt: float | TensorVariable | None = None,
    sensors: Sequence[int] | Sequence[str] | None = None,
    quantity: str | None = None,
    n_modes: int | None = None,
    outputs: ArrayLike | sparse.sparray | None = None,
) -> TensorVariable:
    """Response history of a structure to a ground acceleration, or other loads, inside a PyMC model.

    Parameters
    ----------
    structure : SpringMassChain, LinearStructure, AffineStructure, HystereticChain, DuffingChain, ...
        Its parameters may be random variables; or a HystereticSpecimen.
    record : Record, Loading or CyclicTest
        Ground acceleration, or, on linear structures, accelerations of several supports or forces; the
        structure is at rest at the first sample. Of a specimen the displacement that is prescribed.
    dt : float or pm.Data, optional
        Output step [s], an integer multiple or divisor of the record's step, which is the default. As
        data it can be changed together with the measurements, without compiling the model anew.
    sensors : sequence of int or str, optional
        Degrees of freedom, or storeys of a drift, 0 next to the base; or their names, where the structure has
        any (`LinearStructure.with_names`). All by default.
    quantity : str, optional
        As of `simulate`: "absolute_acceleration" (default), "relative_acceleration" [m/s^2],
        "relative_velocity" [m/s], "relative_displacement" [m], "inter_storey_drift" [m] or "base_shear" [N];
        of a specimen "restoring_force" [N].
    n_modes : int, optional
        Number of modes kept, lowest first. All by default, and of a nonlinear structure always.
    outputs : array_like or sparse matrix (s, n), optional
        S, for combinations S x of the quantity over all degrees of freedom instead of `sensors`.

    Returns
    -------
    TensorVariable (sensor, time)
        Sensors, storeys of a drift, outputs, or supports of a base shear, as accurate as of `simulate`. NaN
        throughout where the parameters describe no structure.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    See Also
    --------
    simulate : the same numbers without PyTensor.

    Notes
    -----
    The feature likelihoods recognise this variable and compute the discrepancy without storing the history;
    not that of combinations (drifts, shears, `outputs`) of a nonlinear structure, nor a base shear of
    uncertain masses.

    A band-limited record is refined by 1, 2 or 4 before it is marched, as 20 structures drawn from the prior
    need it; where they cannot be drawn, by 4.

    Differentiable once, exactly, in all parameters, at repeated frequencies too; not where damping ratios
    that differ from mode to mode change places, nor where `n_modes` cuts a pair of equal frequencies. The
    gradient of a linear structure costs two to four times the response, whatever the number of parameters.
    That of a history of a chain that yields is a central difference, two responses for each number that is no
    constant; comparisons of such a history have exact ones, as `HystereticChain` says.

    Examples
    --------
    >>> from pymc_features import ModalDamping, SpringMassChain
    >>> chain = SpringMassChain(mass=[1.0, 1.0], stiffness=100.0, damping=ModalDamping(0.02))
    >>> response(chain, Record([0.0, 1.0, 0.0], dt=0.1)).type.shape
    (2, 3)
    """
    check_arguments(structure, record)
    quantity = quantities_of(structure)[0] if quantity is None else quantity
    step = dt.get_value() if isinstance(dt, SharedVariable) else dt
    asked, outputs = checked_request(
        structure, record, quantity, dt=step, sensors=sensors, n_modes=n_modes, outputs=outputs
    )
    asked = request_in_model(structure, record, asked)
    if HISTORIES[quantity].dim == "support":
        if sensors is not None:
            raise ValueError(
                f"`sensors` must be left out for the base shear, got {shown(sensors)}. It sums all masses."
            )
        return base_shear(structure, record, dt, asked)
    return respond(structure, record, dt, asked, rows_of(structure, quantity, asked, outputs).picked)


def base_shear(structure, record, dt, asked) -> TensorVariable:
    """Base shear (support, time) [N] as of `simulate`; the request is that of absolute accelerations."""
    shear = respond(structure, record, dt, asked, structure.inertia())
    share = force_share(structure, record, "base_shear")
    if share is None:
        return shear
    if isinstance(dt, SharedVariable):
        raise TypeError("`dt` must be a number for a base shear under forces, got pm.Data. Pass seconds.")
    return shear + share @ at_outputs(record, asked)


def respond(structure, record, dt, asked, rows) -> TensorVariable:
    """Response of degrees of freedom (s,), or of combinations S x, S (s, n), of all of them."""
    if isinstance(rows, Variable) or (rows.ndim == 2 and not structure.is_linear):
        return pt.dot(rows, respond(structure, record, dt, asked, np.arange(structure.n_dof)))
    if rows.ndim == 2:
        structure = structure.as_linear()
    op = StructuralResponse(asked.quantity, structure.family)
    rows = op.spec.rows(rows, structure.n_dof)
    if op.spec.takes_outputs:
        rows = as_data(to_dense(rows), "outputs")
    excitation = excitation_in_model(structure, record, dt, asked)
    inputs = op.spec.inputs_of(structure, record, excitation, rows, asked.n_modes)
    inputs = dict(zip(op.names, inputs, strict=True))
    for name in (*op.spec.constants, "acceleration", "direct"):
        if not isinstance(inputs[name], Variable):
            inputs[name] = as_data(inputs[name], name)
    result = op(*inputs.values())
    result.owner.tag.excited = structure.excitation(record), record, asked
    return result


def as_data(array, name):
    """An array as a shared variable: constants enter the keys of compiled graphs, large ones prevent them."""
    return pytensor.shared(np.array(array), name=name, shape=array.shape)


def check_arguments(structure, record):
    """Refuse what is no structure or no record."""
    if not isinstance(structure, Structure):
        raise TypeError(
            f"`structure` must be a Structure, got {type(structure).__name__}. "
            "Pass for example a SpringMassChain."
        )
    if not isinstance(record, DynamicLoad):
        raise TypeError(
            f"`record` must be a Record, got {type(record).__name__}. "
            "Use read_record(path) or Record(acceleration, dt)."
        )


def response_node(variable: TensorVariable) -> Apply | None:
    """Return the node whose output `variable` is, if it is a response, looking through copies.

    Names, deterministics and shape annotations leave the value alone; batches are `Blockwise`.
    """
    while variable.owner is not None:
        op = variable.owner.op
        core = op.core_op if isinstance(op, Blockwise) else op
        if isinstance(core, StructuralResponse | ExternalResponse):
            return variable.owner
        is_copy = isinstance(op, ViewOp) or (
            isinstance(op, Elemwise) and op.scalar_op == pytensor.scalar.identity
        )
        is_same = isinstance(op, DimShuffle) and op.new_order == tuple(range(variable.ndim))
        if not (is_copy or is_same or isinstance(op, SpecifyShape)):
            return None
        variable = variable.owner.inputs[0]
    return None


def structural_node(variable: TensorVariable) -> Apply | None:
    """Return the first response of a structure among what is behind a variable; None where there is none."""
    nodes = (v.owner for v in ancestors([variable]) if v.owner is not None)
    return next((node for node in nodes if isinstance(node.op, StructuralResponse)), None)


def was_simulated(variable: TensorVariable) -> bool:
    """Whether structures of the family behind a variable were simulated in this process, or there is none."""
    node = structural_node(variable)
    return node is None or node.op.family in SIMULATED


def frequencies_behind(variable: TensorVariable) -> tuple[list[Variable], Callable] | None:
    """Natural frequencies of the first structure behind a variable; None where there is none.

    What they depend on, variables, and a function of the values of these for frequencies (m,) [Hz], of small
    motions where springs yield.
    """
    node = structural_node(variable)
    if node is None or not node.op.spec.modal:
        return None
    n = node.op.n_parameters

    def of_values(values):
        *values, n_modes = values
        return frequencies_of(node.op, [x[None] for x in values[:n]], values[n:], int(n_modes))[0]

    inputs = node.inputs[: n + len(node.op.spec.constants)]
    return [*inputs, node.inputs[node.op.at("n_modes")]], of_values


@contextmanager
def noisy_base(variable: TensorVariable, sd: float, rng: np.random.Generator):
    """While it lasts, the motion behind a prediction has white noise of a standard deviation [m/s^2]."""
    node = structural_node(variable)
    if node is None or not isinstance(node.inputs[node.op.at("direct")], SharedVariable):
        raise ValueError(
            "`base_noise` must be left out of a prediction that is no response of a structure to a record "
            "with outputs at a fixed step."
        )
    acceleration, direct = (node.inputs[node.op.at(name)] for name in ("acceleration", "direct"))
    values, record, asked = node.tag.excited
    noisy = excitation_of(values + sd * rng.standard_normal(values.shape), record, asked)
    before = acceleration.get_value(), direct.get_value()
    try:
        acceleration.set_value(noisy.acceleration)
        direct.set_value(noisy.direct)
        yield
    finally:
        acceleration.set_value(before[0])
        direct.set_value(before[1])


def response_step(variable: TensorVariable, *, at_present: bool = False) -> float | None:
    """Output step [s] of a response, None if `variable` is none or the step is not a constant.

    `at_present` also a step that is data of the model, as it is now.
    """
    node = response_node(variable)
    if node is None:
        return None
    core = node.op.core_op if isinstance(node.op, Blockwise) else node.op
    if isinstance(core, ExternalResponse):
        return core.simulator.dt
    inputs = [node.inputs[core.at(name)] for name in ("dt", "substeps", "stride")]
    try:
        dt, substeps, stride = map(pt.get_underlying_scalar_constant_value, inputs)
    except pt.exceptions.NotScalarConstantError:
        if not at_present or any(explicit_graph_inputs(inputs)):
            return None
        dt, substeps, stride = (np.ravel(x.eval(mode=IN_PYTHON))[0] for x in inputs)
    return float(dt) * int(stride) / int(substeps)
