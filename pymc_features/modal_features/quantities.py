"""`modes`: natural frequencies, mode shapes and damping ratios of a structure inside a model."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.tensor.variable import TensorVariable
from scipy import sparse

from pymc_features._checks import check_integer
from pymc_features.modal_features.operations import StructuralModes
from pymc_features.ops.response import as_data
from pymc_features.records import Record
from pymc_features.simulators.families import FAMILIES
from pymc_features.simulators.request import check_outputs, check_sensors, picked_by_name
from pymc_features.structures import Structure
from pymc_features.structures.base import static_length

AT_REST = Record(np.zeros(2), 1.0)  # the constants of a structure are asked for with a load


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
    (tests/modal_features/test_modes.py). Where two are equal, what depends on their sum and on the plane of
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
    n, most = structure.n_dof, structure.n_modes
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
    combined = None
    if outputs is not None:
        if sensors is not None:
            raise ValueError("`sensors` must be left out with `outputs`, got both. Choose rows of `outputs`.")
        combined = check_outputs(outputs, n)
    else:
        sensors, combined, _ = picked_by_name(structure, sensors)
    picked = check_sensors(sensors, n) if combined is None else np.flatnonzero(combined.any(axis=0))
    constants = zip(op.spec.constants, structure.constants(AT_REST), strict=True)
    shared = [as_data(array, name) for name, array in constants]
    found = SymbolicModes(*op(*parameters.values(), *shared, picked, n_modes))
    if combined is None:
        return found
    return found._replace(shapes=pt.dot(found.shapes, combined[:, picked].T))
