"""Natural frequencies, mode shapes and damping ratios of a structure inside a model, and their gradients."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.gradient import disconnected_type
from pytensor.graph.basic import Apply, Constant
from pytensor.graph.replace import _vectorize_node
from pytensor.tensor.variable import TensorVariable
from scipy import sparse

from pymc_features._checks import check_integer
from pymc_features.ops.batches import in_one_call
from pymc_features.ops.gradient import Gradient, filled
from pymc_features.ops.numba_dispatch import run_in_python
from pymc_features.ops.response import as_data, check_arguments
from pymc_features.ops.structural import StructuralOp, count, prepared
from pymc_features.records import Record
from pymc_features.simulators import FAMILIES, Outputs
from pymc_features.simulators.modal.perturbation import Cotangent
from pymc_features.simulators.request import check_outputs, check_sensors, picked_by_name
from pymc_features.structures import Structure
from pymc_features.structures.base import static_length

AT_REST = Record(np.zeros(2), 1.0)  # the constants of a structure are asked for with a load


class ModalOp(StructuralOp):
    """Base of the Ops on modes: parameters of a family, with a row for each particle if `batched`."""

    __props__ = ("family", "batched")

    def __init__(self, family: str, batched: bool = False):
        self.batched = batched
        super().__init__(family=family)

    @property
    def inputs(self):
        return self.spec.parameters | self.spec.constants | {"sensors": "s", "n_modes": ""}

    @property
    def ndims(self) -> tuple[int, ...]:
        """Numbers of dimensions of the inputs of one structure."""
        return tuple(count(dims) for dims in self.inputs.values())

    def dtype(self, name):
        return "int64" if name == "sensors" else super().dtype(name)

    def run(self, inputs) -> tuple[np.ndarray, ...]:
        """Results of the kernel for arrays; it takes a population, of which one structure is the first."""
        n, n_common = self.n_parameters, self.n_common
        arrays = [prepared(x) for x in inputs]
        if not self.batched:
            arrays = [x if n <= i < n_common else x[None] for i, x in enumerate(arrays)]
        *given, sensors, n_modes = arrays[:n_common]
        more = [Cotangent(*arrays[n_common:])] if arrays[n_common:] else []
        kernel = self.spec.modal[self.kernel_name]
        results = kernel(self.spec.arguments(*given), Outputs(sensors, n_modes, 0), *more)
        return tuple(results) if self.batched else tuple(result[0] for result in results)


class StructuralModes(ModalOp):
    """Natural frequencies (mode,) [Hz], shapes (mode, sensor) and damping ratios (mode,)."""

    kernel_name = "modes"
    output_signature = "(m),(m,s),(m)"
    simulates = True  # a value that is not finite is a failed simulation, and counted as such

    def make_node(self, *inputs):
        inputs = self.prepare_inputs(inputs)
        *_, sensors, n_modes = inputs
        m = int(n_modes.data) if isinstance(n_modes, Constant) else None
        rows = (None,) if self.batched else ()
        kinds = (m,), (m, sensors.type.shape[0]), (m,)
        return Apply(self, inputs, [pt.tensor(dtype="float64", shape=(*rows, *shape)) for shape in kinds])

    def infer_shape(self, node, shapes):
        rows, m, s = self.population(shapes), node.inputs[-1], shapes[-2][0]
        return [(*rows, m), (*rows, m, s), (*rows, m)]

    def pullback(self, inputs, outputs, cotangents):
        """By `ModesGradient`."""
        gradient = ModesGradient(self.family, self.batched)
        gradients = gradient(*inputs, *filled(cotangents, outputs), return_list=True)
        return [*gradients, *(disconnected_type() for _ in inputs[self.n_parameters :])]


class ModesGradient(ModalOp, Gradient):
    """Gradient of sum c f + sum W phi + sum d zeta; the last inputs are c (m,), W (m, s) and d (m,)."""

    kernel_name = "modes_gradient"
    n_linear = 0  # its derivatives by c, W and d are not defined either

    @property
    def more_signature(self):
        """Shapes of c, W and d."""
        return "(p,m),(p,m,s),(p,m)" if self.batched else StructuralModes.output_signature

    def transpose(self, inputs, cotangents):
        return []


@_vectorize_node.register(StructuralModes)
def vectorize_modes(op, node, *inputs):
    """Batches of parameters alone are one Op of the population."""
    return in_one_call(op, StructuralModes(op.family, batched=True), inputs, op.ndims)


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
    check_arguments(structure, AT_REST)
    if not FAMILIES[structure.family].modal:
        structure.modes()  # which says why there are none
    most = structure.n_modes
    n_modes = most if n_modes is None else n_modes
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
