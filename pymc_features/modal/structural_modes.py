"""Natural frequencies, mode shapes and damping ratios of a structure inside a model, and their gradients."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply, Constant, Variable
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.blockwise import Blockwise
from pytensor.tensor.variable import TensorVariable
from scipy import sparse

from pymc_features._checks import check_integer
from pymc_features.ops.gradient import filled, undefined
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.ops.population import as_rows, without_unit_batch
from pymc_features.ops.response import as_data
from pymc_features.ops.structural import count, shapes
from pymc_features.records import Record
from pymc_features.simulators import FAMILIES, Outputs
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.modal.perturbation import Cotangent
from pymc_features.simulators.request import check_outputs, check_sensors, picked_by_name
from pymc_features.structures import Structure
from pymc_features.structures.base import static_length

OUTPUTS = ("(m)", "(m,s)", "(m)")
AT_REST = Record(np.zeros(2), 1.0)  # the constants of a structure are asked for with a load


class ModalOp(Op):
    """Base of the Ops on modes: parameters of a family, its constants, sensors and number of modes.

    Parameters
    ----------
    family : str
        A key of `simulators.FAMILIES`. Everything else the kernels read is an input of the node.
    batched : bool
        Whether each parameter has a row for each particle, or one for all.
    """

    __props__ = ("family", "batched")
    kernel_name: str

    def __init__(self, family: str, batched: bool = False):
        self.family, self.batched = family, batched

    @property
    def spec(self):
        """The family: no attribute, for machine code does not travel with pickled Ops."""
        return FAMILIES[self.family]

    @property
    def n_parameters(self) -> int:
        """Number of parameters, the first inputs."""
        return len(self.spec.parameters)

    @property
    def ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the inputs of one structure."""
        inputs = *self.spec.parameters.values(), *self.spec.constants.values()
        return *(count(dims) for dims in inputs), 1, 0

    @property
    def gufunc_signature(self):
        """Shapes for one particle; a population Op is never wrapped."""
        if self.batched:
            return None
        common = shapes(self.spec.parameters | self.spec.constants | {"sensors": "s", "n_modes": ""})
        return f"{common}{self.more_signature}->{self.output_signature}"

    def prepare_inputs(self, inputs):
        """Cast inputs common to all Ops, and check their numbers of dimensions."""
        types = [self.spec.dtype(name) for name in (*self.spec.parameters, *self.spec.constants)]
        prepared = []
        for i, (x, ndim, dtype) in enumerate(
            zip(inputs, self.ndims, [*types, "int64", "int64"], strict=True)
        ):
            tensor = x if isinstance(x, Variable) else pt.as_tensor_variable(np.asarray(x, dtype=dtype))
            expected = ndim + (self.batched and i < self.n_parameters)
            if tensor.ndim != expected:
                raise ValueError(f"input {i} must have {expected} dimensions, got {tensor.ndim}.")
            prepared.append(tensor if tensor.dtype == dtype else tensor.astype(dtype))
        return prepared

    def prepare_node(self, node, storage_map, compute_map, impl):
        """Forget what other functions have learnt, so that a run with the same seed is the same."""
        KNOWN.forget()

    def perform(self, node, inputs, output_storage):
        for storage, result in zip(output_storage, self.run(inputs), strict=True):
            storage[0] = result

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """Results of the kernel for arrays; it takes a population, of which one structure is the first."""
        n, n_common = self.n_parameters, len(self.ndims)
        arrays = [np.require(x, requirements=["C", "W"]) if np.ndim(x) else x.item() for x in inputs]
        if not self.batched:
            rows = [i < n or i >= n_common for i in range(len(arrays))]
            arrays = [x[None] if row else x for x, row in zip(arrays, rows, strict=True)]
        parameters = self.spec.arguments(*arrays[: n_common - 2])
        wanted = Outputs(arrays[n_common - 2], arrays[n_common - 1], 0)
        results = self.spec.modal[self.kernel_name](parameters, wanted, *self.more(arrays[n_common:]))
        return tuple(results) if self.batched else tuple(result[0] for result in results)

    def connection_pattern(self, node):
        """Parameters and cotangents count; constants, sensors and the number of modes do not."""
        last = len(self.ndims)
        counts = [i < self.n_parameters or i >= last for i in range(len(node.inputs))]
        return [[c] * len(node.outputs) for c in counts]


class StructuralModes(ModalOp):
    """Natural frequencies (mode,) [Hz], shapes (mode, sensor) and damping ratios (mode,)."""

    kernel_name = "modes"
    more_signature, output_signature = "", ",".join(OUTPUTS)
    simulates = True  # a value that is not finite is a failed simulation, and counted as such

    def more(self, arrays):
        """Nothing else."""
        return ()

    def make_node(self, *inputs):
        inputs = self.prepare_inputs(inputs)
        *_, sensors, n_modes = inputs
        m = int(n_modes.data) if isinstance(n_modes, Constant) else None
        rows = (None,) if self.batched else ()
        kinds = (m,), (m, sensors.type.shape[0]), (m,)
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=(*rows, *shape)) for shape in kinds])

    def infer_shape(self, node, shapes):
        rows = ()
        if self.batched:
            most = shapes[0][0]
            for shape in shapes[1 : self.n_parameters]:
                most = pt.maximum(most, shape[0])
            rows = (most,)
        m, s = node.inputs[-1], shapes[-2][0]
        return [(*rows, m), (*rows, m, s), (*rows, m)]

    def pullback(self, inputs, outputs, cotangents):
        """By `ModesGradient`."""
        gradient = ModesGradient(self.family, self.batched)
        gradients = gradient(*inputs, *filled(cotangents, outputs), return_list=True)
        return [*gradients, *(disconnected_type() for _ in inputs[self.n_parameters :])]


class ModesGradient(ModalOp):
    """Gradient of sum c f + sum W phi + sum d zeta; the last inputs are c (m,), W (m, s) and d (m,)."""

    kernel_name = "modes_gradient"
    more_signature = "," + ",".join(OUTPUTS)

    @property
    def output_signature(self):
        """Shapes of the outputs are those of the parameters."""
        return shapes(self.spec.parameters)

    def more(self, arrays):
        """The cotangents, in one tuple."""
        return (Cotangent(*arrays),)

    def make_node(self, *inputs):
        common, more = inputs[: len(self.ndims)], inputs[len(self.ndims) :]
        common = self.prepare_inputs(common)
        more = [pt.as_tensor_variable(x).astype("float64") for x in more]
        return Apply(self, [*common, *more], [x.type() for x in common[: self.n_parameters]])

    def infer_shape(self, node, shapes):
        return shapes[: self.n_parameters]

    def pullback(self, inputs, outputs, cotangents):
        """No second derivatives."""
        pattern = self.connection_pattern(outputs[0].owner)
        return [
            undefined(self, inputs, i) if counts else disconnected_type()
            for i, (counts, *_) in enumerate(pattern)
        ]


@_vectorize_node.register(StructuralModes)
def vectorize_modes(op, node, *inputs):
    """Batches of parameters alone become one Op of the population; others are left to `Blockwise`."""
    n = op.n_parameters
    inputs = [without_unit_batch(x, ndim) for x, ndim in zip(inputs, op.ndims, strict=True)]
    constants = inputs[n:]
    if op.batched or any(x.ndim != ndim for x, ndim in zip(constants, op.ndims[n:], strict=True)):
        return Blockwise(op).make_node(*inputs).outputs
    if all(x.ndim == ndim for x, ndim in zip(inputs, op.ndims, strict=True)):
        return op.make_node(*inputs).outputs
    rows, batch = as_rows(inputs[:n], op.ndims[:n])
    results = StructuralModes(op.family, batched=True).make_node(*rows, *constants).outputs
    if batch is None:
        return results
    return [x.reshape((*batch, *tuple(x.shape)[1:]), ndim=len(batch) + x.ndim - 1) for x in results]


run_in_python(StructuralModes, ModesGradient)


class SymbolicModes(NamedTuple):
    """Modes as variables of a model, in ascending order of frequency.

    Attributes
    ----------
    frequencies : TensorVariable (mode,)
        f_r = omega_r / (2 pi) [Hz].
    shapes : TensorVariable (mode, sensor)
        **Rows** are the mass-normalised shapes, phi_r' M phi_r = 1, at the sensors [kg^(-1/2)].
    damping_ratios : TensorVariable (mode,)
        zeta_r [-].
    """

    frequencies: TensorVariable
    shapes: TensorVariable
    damping_ratios: TensorVariable


def modes(
    structure: Structure,
    n_modes: int | None = None,
    *,
    sensors: Sequence[int] | Sequence[str] | None = None,
    outputs: ArrayLike | sparse.sparray | None = None,
) -> SymbolicModes:
    """Natural frequencies, mode shapes and modal damping of a structure inside a PyMC model.

    Parameters
    ----------
    structure : SpringMassChain, LinearStructure, AffineStructure, HystereticChain or DuffingChain
        Its parameters may be random variables. Of a nonlinear chain the modes are those of small motions.
    n_modes : int, optional
        Number of modes, lowest first. All by default.
    sensors : sequence of int or str, optional
        Degrees of freedom at which the shapes are wanted, 0 next to the base, or their names. All by default.
    outputs : array_like or sparse matrix (s, n), optional
        S, for shapes S phi of combinations of degrees of freedom instead of `sensors`: sensors between nodes,
        in oblique directions, strains.

    Returns
    -------
    SymbolicModes
        Frequencies [Hz], shapes (mode, sensor) and damping ratios. NaN where the parameters describe no
        structure.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    See Also
    --------
    ModalFeature : compares them with identified modes.

    Notes
    -----
    Modes are those without damping, and a damping matrix C gives the ratios phi_r' C phi_r / (2 omega_r). The
    sign of a shape is that of `structure.modes()` and may change along the parameters; quantities such as the
    MAC do not notice.

    Differentiable once, exactly: to 1e-8 where two frequencies differ by 1e-6 of them
    (tests/modal/test_modes.py). Where two are equal, what depends on their sum and on the plane of
    their shapes has an exact gradient; single frequencies and shapes have none there, whatever is returned.
    Where `n_modes` cuts a pair of equal frequencies, keep both.

    A population is one call. Modes of sparse structures that differ in theta alone are found in a basis of
    those that were solved before, checked by residuals and inertia: frequencies are those of each by itself
    to 1e-11, shapes and gradients to 1e-6 (tests/simulators/test_reduced.py).

    Examples
    --------
    >>> from pymc_features import ModalDamping, SpringMassChain
    >>> chain = SpringMassChain(mass=[1.0, 1.0], stiffness=100.0, damping=ModalDamping(0.02))
    >>> modes(chain, 1).frequencies.eval().round(6)  # 10 (sqrt(5) - 1) / 2 rad/s
    array([0.983632])
    """
    if not isinstance(structure, Structure):
        raise TypeError(
            f"`structure` must be a Structure, got {type(structure).__name__}. "
            "Pass for example a SpringMassChain."
        )
    if not FAMILIES[structure.family].modal:
        structure.modes()  # which says why there are none
    most = structure.n_modes
    if n_modes is None:
        n_modes = most
    n_modes = check_integer(n_modes, "n_modes", most=most, advice="Leave it out for all.")
    op = StructuralModes(structure.family)
    parameters = dict(zip(op.spec.parameters, structure.parameters(), strict=True))
    given = static_length(parameters["ratios"])
    if given is not None and given < n_modes:
        raise ValueError(
            f"`n_modes` must not exceed the {given} damping ratios of the structure, got {n_modes}. Give a "
            "ratio for each mode, or one for all."
        )
    picked, combined = picked_outputs(structure, sensors, outputs)
    constants = zip(op.spec.constants, structure.constants(AT_REST), strict=True)
    shared = [as_data(array, name) for name, array in constants]
    found = SymbolicModes(*op(*parameters.values(), *shared, picked, n_modes))
    if combined is None:
        return found
    return found._replace(shapes=pt.dot(found.shapes, combined.T))


def picked_outputs(structure: Structure, sensors, outputs) -> tuple[np.ndarray, np.ndarray | None]:
    """Degrees of freedom (p,) of which an output is made, and S (s, p) if that is more than a choice."""
    combined = None
    if outputs is None:
        sensors, combined, _ = picked_by_name(structure, sensors)
    elif sensors is not None:
        raise ValueError("`sensors` must be left out with `outputs`, got both. Choose rows of `outputs`.")
    else:
        combined = check_outputs(outputs, structure.n_dof)
    if combined is None:
        return check_sensors(sensors, structure.n_dof), None
    picked = np.flatnonzero(combined.any(axis=0))
    return picked, combined[:, picked]
