"""What all chains share: masses in a row, springs between them, and the linear chain of Eqs. (17)-(19)."""

import copy
from collections.abc import Sequence
from typing import Self

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable
from scipy.linalg import eigh_tridiagonal

from pymc_features._checks import as_array, shown
from pymc_features.simulators.chain.graded import LOSS, eigenvalue_of, write_shape
from pymc_features.structures.base import Matrices, Modes, Structure, Values, as_vector, spread, static_length
from pymc_features.structures.damping import Damping
from pymc_features.structures.inputs import DAMPING, vector


class Chain(Structure):
    """Masses in a row, each joined to the one below by a spring, the first to the moving base.

    A kind of spring is a subclass: it adds what its springs need, if anything, with `spring_vector`, and
    names the family of kernels. `matrices` and `modes` are those of the initial stiffness.
    """

    has_storeys = True
    inputs = {"mass": vector("kg"), "stiffness": vector("N/m"), "damping": DAMPING}

    def __init__(self, mass: Values, stiffness: Values, damping: Damping):
        self.mass = as_vector(mass, "mass", "kg")
        self.stiffness = as_vector(stiffness, "stiffness", "N/m")
        if not isinstance(damping, Damping):
            raise TypeError(
                f"`damping` must be a Damping, got {type(damping).__name__}. "
                "Pass RayleighDamping(alpha, beta) or ModalDamping(ratios)."
            )
        self.damping = damping
        lengths = {static_length(v) for v in (self.mass, self.stiffness)} - {None}
        if len(lengths) > 1:
            raise ValueError(
                f"`mass` and `stiffness` must have the same length, got {static_length(self.mass)} "
                f"masses and {static_length(self.stiffness)} springs."
            )
        if not lengths:
            raise ValueError(
                "`mass` or `stiffness` must have a known length, got none. "
                "Pass one of them as an array of n values, or declare it with shape=n, or with dims that the "
                "model has coords for."
            )
        self._n_dof = lengths.pop()
        self.damping.coefficients(self._n_dof)

    def __repr__(self):
        return f"{type(self).__name__}({self.n_dof} masses, {self.damping!r})"

    @property
    def n_dof(self) -> int:
        return self._n_dof

    def parameters(self) -> tuple:
        return self.linear_parameters()

    def linear_parameters(self) -> tuple:
        """Masses (n,), initial stiffnesses (n,), Rayleigh pair (2,) and damping ratios (n,)."""
        rayleigh, ratios = self.damping.coefficients(self.n_dof)
        return spread(self.mass, self.n_dof), spread(self.stiffness, self.n_dof), rayleigh, ratios

    def spring_vector(
        self, value: Values, name: str, unit: str, *, allow_zero: bool = False
    ) -> np.ndarray | Variable:
        """Return a checked parameter of the springs: one value or one for each of them."""
        vector = as_vector(value, name, unit, allow_zero=allow_zero)
        if static_length(vector) not in (None, self.n_dof):
            raise ValueError(
                f"`{name}` must have one value or one for each of the {self.n_dof} springs, "
                f"got {static_length(vector)}."
            )
        return vector

    def spring_table(self, *rows: np.ndarray | Variable) -> np.ndarray | Variable:
        """Stack parameters of the springs, (rows, n)."""
        rows = [spread(row, self.n_dof) for row in rows]
        return pt.stack(rows) if any(isinstance(row, Variable) for row in rows) else np.stack(rows)

    def scale_stiffness(self, factor: Values, springs: int | Sequence[int]) -> Self:
        """Return a chain with the chosen springs multiplied by `factor`.

        Parameters
        ----------
        factor : float, array_like (len(springs),) or TensorVariable
            Positive factor [-], one for all chosen springs or one for each.
        springs : sequence of int
            Springs counted from the base, 0 first, each once.
        """
        asked, springs = springs, np.atleast_1d(as_array(springs))
        if springs.ndim != 1 or springs.dtype.kind not in "iu":
            raise TypeError(f"`springs` must be integers, got {shown(asked)}.")
        if len(set(springs.tolist())) < springs.size or not ((springs >= 0) & (springs < self.n_dof)).all():
            raise ValueError(
                f"`springs` must be different numbers from 0 to {self.n_dof - 1}, "
                f"got {springs.tolist()}. Spring 0 is next to the base."
            )
        factor = as_vector(factor, "factor", "multiples of the present stiffness")
        if static_length(factor) not in (None, springs.size):
            raise ValueError(
                f"`factor` must have one value or one for each of the {springs.size} springs, "
                f"got {static_length(factor)}."
            )
        stiffness = spread(self.stiffness, self.n_dof)
        if isinstance(factor, Variable) or isinstance(stiffness, Variable):
            chosen = (np.arange(self.n_dof)[:, None] == springs).astype(float)
            # A sum, since setting entries would be a loop over the particles of a population.
            scaled = stiffness * (1.0 - chosen.sum(axis=1) + pt.sum(chosen * factor, axis=-1))
        else:
            scaled = stiffness.copy()
            scaled[springs] *= factor
        changed = copy.copy(self)
        if not isinstance(scaled, Variable):
            scaled.setflags(write=False)
        changed.stiffness = scaled
        return changed

    def _numbers(self):
        self.check_numbers()
        return self.linear_parameters()

    def inertia(self) -> np.ndarray | Variable:
        """Return the masses (1, n) [kg]: the influence of the base is one on every mass."""
        return self.linear_parameters()[0][None]

    def matrices(self) -> Matrices:
        """Return M [kg], C [N s/m] and initial K [N/m], Eqs. (17)-(19), each an array (n, n)."""
        mass, stiffness, rayleigh, ratios = self._numbers()
        matrix_m = np.diag(mass)
        above = np.append(stiffness[1:], 0.0)
        matrix_k = np.diag(stiffness + above)
        matrix_k -= np.diag(stiffness[1:], 1) + np.diag(stiffness[1:], -1)
        matrix_c = rayleigh[0] * matrix_m + rayleigh[1] * matrix_k
        if ratios.any():
            modes = self.modes()
            shapes = matrix_m @ modes.mode_shapes
            matrix_c = matrix_c + shapes * (2.0 * ratios * modes.angular_frequencies) @ shapes.T
        return Matrices(matrix_m, matrix_c, matrix_k)

    def modes(self) -> Modes:
        """Natural frequencies, shapes, participation factors and damping ratios, see `Modes`.

        The eigenvalues are refined by Rayleigh quotients written as sums of spring energies; those
        of a uniform chain agree with the closed form to 1e-14 (tests/structures/test_structures.py). So do
        those of springs and masses of any ratio (tests/structures/test_graded_chains.py).
        """
        mass, stiffness, rayleigh, ratios = self._numbers()
        root = np.sqrt(mass)
        above = np.append(stiffness[1:], 0.0)
        with np.errstate(over="ignore"):
            bands = (stiffness + above) / mass, -stiffness[1:] / (root[1:] * root[:-1])
        if not all(np.isfinite(band).all() for band in bands):
            raise ValueError(
                "`stiffness` over `mass` must be finite numbers, got stiffnesses up to "
                f"{stiffness.max():.3g} N/m and masses from {mass.min():.3g} kg. Check their units."
            )
        values, vectors = eigh_tridiagonal(*bands)
        shapes = vectors / root[:, None]
        drifts = np.diff(shapes, axis=0, prepend=0.0)
        inertia = (mass[:, None] * shapes**2).sum(axis=0)
        omega = np.sqrt((stiffness[:, None] * drifts**2).sum(axis=0) / inertia)
        for r in np.flatnonzero(values < LOSS * values[-1]):
            value = eigenvalue_of(mass, stiffness, r)
            write_shape(mass, stiffness, value, shapes[:, r])
            omega[r], inertia[r] = np.sqrt(value), mass @ shapes[:, r] ** 2
        shapes = shapes * np.where(shapes[-1] < 0, -1.0, 1.0) / np.sqrt(inertia)
        zeta = 0.5 * (rayleigh[0] / omega + rayleigh[1] * omega) + ratios
        return Modes(omega, shapes, mass @ shapes, zeta)
