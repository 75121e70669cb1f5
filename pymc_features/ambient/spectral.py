"""`spectral_response`: what white forces that nobody measured make of a structure."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.graph.basic import Constant
from pytensor.tensor import TensorLike, TensorVariable
from scipy import sparse

from pymc_features._checks import as_numbers, check_choice, check_finite, message, shown
from pymc_features.modal_features import modes
from pymc_features.ops import as_tensor
from pymc_features.simulators.request import check_outputs, check_sensors, picked_by_name
from pymc_features.structures import Structure

MEASURED = {"acceleration": 0, "velocity": 1, "displacement": 2}  # how often the acceleration is integrated


class SpectralResponse(NamedTuple):
    """Modes of a structure at the sensors, and the forces on them.

    Attributes
    ----------
    frequencies, damping_ratios : TensorVariable (mode,)
        f_r [Hz] and zeta_r [-].
    shapes : TensorVariable (mode, sensor)
        Mass-normalised [kg^(-1/2)].
    patterns : TensorVariable (mode, force)
        phi_r' w_i, what unit force i does to mode r.
    excitation : TensorVariable (), (band,) or (band, force)
        One-sided spectral density of the forces.
    quantity : str
        A key of `MEASURED`.
    """

    frequencies: TensorVariable
    damping_ratios: TensorVariable
    shapes: TensorVariable
    patterns: TensorVariable
    excitation: TensorVariable
    quantity: str


def spectral_response(
    structure: Structure,
    excitation: TensorLike,
    *,
    forces: str | ArrayLike = "dofs",
    sensors: Sequence[int] | Sequence[str] | None = None,
    outputs: ArrayLike | sparse.sparray | None = None,
    n_modes: int | None = None,
    quantity: str = "acceleration",
) -> SpectralResponse:
    """Response of a structure to independent forces that are known by their spectral densities only.

    Parameters
    ----------
    structure : Structure
        Its parameters may be random variables. Of a nonlinear chain the small motions count.
    excitation : tensor_like (), (band,) or (band, force)
        One-sided spectral density of each force [N^2/Hz], constant in each band of `AmbientResponse`.
        Positive.
    forces : {"dofs", "modes"} or array_like (n, force)
        Where they act: one on each degree of freedom; one on each mode, phi' f with the unit N^2/kg/Hz; or
        patterns along the structure, in columns.
    sensors : sequence of int or str, optional
        Degrees of freedom where was measured, 0 next to the base, or their names. All by default.
    outputs : array_like or sparse matrix (s, n), optional
        S, for measured combinations S x of degrees of freedom instead of `sensors`.
    n_modes : int, optional
        Modes that are taken into account, lowest first; all by default. Of a mode above the bands the
        quasi-static part counts still.
    quantity : {"acceleration", "velocity", "displacement"}
        What was measured.

    Returns
    -------
    SpectralResponse
        For `AmbientResponse`.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.
    """
    check_choice(quantity, "quantity", tuple(MEASURED))
    density = spectral(excitation, "excitation")
    if isinstance(forces, str) and check_choice(forces, "forces", ("dofs", "modes")) == "modes":
        found = modes(structure, n_modes, sensors=sensors, outputs=outputs)
        patterns = pt.eye(found.frequencies.type.shape[0])
        return SpectralResponse(*at_sensors(found, found.shapes), patterns, density, quantity)
    found = modes(structure, n_modes)
    n = structure.n_dof
    patterns = found.shapes if isinstance(forces, str) else pt.dot(found.shapes, checked_patterns(forces, n))
    if outputs is not None:
        if sensors is not None:
            raise ValueError("`sensors` must be left out with `outputs`, got both. Choose rows of `outputs`.")
        shapes = pt.dot(found.shapes, check_outputs(outputs, n).T)
    else:
        picked, combined, _ = picked_by_name(structure, sensors)
        shapes = found.shapes[:, check_sensors(picked, n)]
        if combined is not None:
            shapes = pt.dot(found.shapes, combined.T)
    return SpectralResponse(*at_sensors(found, shapes), patterns, density, quantity)


def at_sensors(found, shapes):
    """The first three attributes of `SpectralResponse`."""
    return found.frequencies, found.damping_ratios, shapes


def checked_patterns(forces, n: int) -> np.ndarray:
    """Patterns of forces (n, force)."""
    patterns = as_numbers(forces, "forces", 'Pass "dofs", "modes", or a matrix.').astype(np.float64)
    if patterns.ndim != 2 or len(patterns) != n or not patterns.size:
        raise ValueError(message("forces", f"({n}, force), a row for each degree of freedom", patterns.shape))
    check_finite(patterns, "forces")
    return patterns


def spectral(value, name: str) -> TensorVariable:
    """A tensor; numbers are refused where they are not positive."""
    tensor = as_tensor(value, name, "Pass a spectral density.")
    numbers = tensor.data if isinstance(tensor, Constant) else np.ones(1)
    if not numbers.size or not (np.isfinite(numbers) & (numbers > 0)).all():
        raise ValueError(message(name, "positive and finite", shown(np.asarray(numbers).tolist())))
    return tensor
