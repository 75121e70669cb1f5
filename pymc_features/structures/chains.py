"""Chains: masses in a row, each joined to the one below by a spring, Eqs. (17)-(19).

Springs are linear, yield (Bouc-Wen, elastic-plastic as its limit), or harden with the cube of their drift.
"""

import copy
from collections.abc import Sequence
from dataclasses import KW_ONLY, fields
from typing import Annotated, Self

import numpy as np
import pytensor.tensor as pt
from pytensor.graph.basic import Variable
from scipy.linalg import eigh_tridiagonal

from pymc_features._checks import as_array, shown
from pymc_features.simulators.chain.modes import LOSS, eigenvalue_of, write_shape
from pymc_features.structures.affine import AffineStructure
from pymc_features.structures.base import (
    AT_LEAST_ONE,
    DAMPING,
    NOT_NEGATIVE,
    NUMERIC,
    POSITIVE,
    SHARE,
    Matrices,
    Modes,
    Structure,
    Values,
    as_vector,
    check_length,
    described,
    is_numeric,
    spread,
    static_length,
    vector,
)
from pymc_features.structures.damping import Damping

RATIO = "Pass post-yield over initial stiffness; use `DuffingChain` for springs that harden."
SHARPNESS = "Pass 1 to 3 for gradual yielding, 20 or more for a nearly bilinear spring."


@described
class Chain(Structure):
    """Masses in a row, each joined to the one below by a spring, the first to the moving base.

    A kind of spring is a subclass: its fields are what its springs need besides, in the order of the kernels,
    and it names the family of these. `matrices` and `modes` are those of the initial stiffness.
    """

    mass: Annotated[Values, vector("kg")]
    stiffness: Annotated[Values, vector("N/m")]
    damping: Annotated[Damping, DAMPING]

    has_storeys = True

    def __post_init__(self):
        super().__post_init__()
        masses, springs = static_length(self.mass), static_length(self.stiffness)
        if masses is None and springs is None:
            raise ValueError(
                "`mass` or `stiffness` must have a known length, got none. "
                "Pass one of them as an array of n values, or declare it with shape=n, or with dims that the "
                "model has coords for."
            )
        if None not in (masses, springs) and masses != springs:
            raise ValueError(
                f"`mass` and `stiffness` must have the same length, got {masses} masses and {springs} "
                "springs."
            )
        self.damping.coefficients(self.n_dof)
        for name in self.springs:
            check_length(getattr(self, name), name, self.n_dof, "springs")

    def __repr__(self):
        return f"{type(self).__name__}({self.n_dof} masses, {self.damping!r})"

    @property
    def springs(self) -> list[str]:
        """Names of what springs have besides their stiffness."""
        _, _, _, *more = (field.name for field in fields(self))
        return more

    @property
    def n_dof(self) -> int:
        masses = static_length(self.mass)
        return static_length(self.stiffness) if masses is None else masses

    def parameters(self) -> tuple:
        """Return `linear_parameters`, and what else the springs have as one table (rows, n)."""
        rows = [spread(getattr(self, name), self.n_dof) for name in self.springs]
        if not rows:
            return self.linear_parameters()
        table = pt.stack(rows) if any(isinstance(row, Variable) for row in rows) else np.stack(rows)
        return *self.linear_parameters(), table

    def linear_parameters(self) -> tuple:
        """Masses (n,), initial stiffnesses (n,), Rayleigh pair (2,) and damping ratios (n,)."""
        rayleigh, ratios = self.damping.coefficients(self.n_dof)
        return spread(self.mass, self.n_dof), spread(self.stiffness, self.n_dof), rayleigh, ratios

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
        factor = as_vector(factor, "factor", "Pass multiples of the present stiffness.")
        check_length(factor, "factor", springs.size, "springs")
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
        bands = (stiffness + above) / mass, -stiffness[1:] / (root[1:] * root[:-1])
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


@described
class SpringMassChain(Chain):
    """Masses in a row, each joined to the one below by a spring, the first to the moving base.

    Parameters
    ----------
    mass : float, array_like (n,) or TensorVariable
        Masses [kg], positive, the one next to the base first; one value stands for all.
    stiffness : float, array_like (n,) or TensorVariable
        Spring constants [N/m], positive; spring i joins mass i to mass i - 1, spring 0 to the base.
    damping : Damping
        `RayleighDamping` or `ModalDamping`.

    Raises
    ------
    ValueError, TypeError
        If a number is not positive, lengths differ, or no length is known.

    Notes
    -----
    A variable with the `dims` of a model has the length of their coordinates, here and in dampings.
    Numbers are checked here; variables cannot be. Where a draw makes a mass or a spring negative,
    the response is NaN and the likelihoods of this package are -inf.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> chain = SpringMassChain(mass=[1.0, 1.0], stiffness=[100.0, 100.0], damping=ModalDamping(0.02))
    >>> chain.modes().angular_frequencies.round(6)  # 10 (sqrt(5) -+ 1) / 2
    array([ 6.18034, 16.18034])
    """

    family = "chain"

    def as_linear(self) -> AffineStructure:
        """Return the same structure by its matrices; its theta are the masses, then the springs."""
        n = self.n_dof
        mass, stiffness, *_ = self.linear_parameters()
        drifts = np.diff(np.eye(n), axis=0, prepend=0.0)
        symbolic = isinstance(mass, Variable) or isinstance(stiffness, Variable)
        return AffineStructure(
            np.zeros((n, n)),
            stiffness=np.zeros((n, n)),
            damping=self.damping,
            mass_terms=[*(np.diag(unit) for unit in np.eye(n)), *(None,) * n],
            stiffness_terms=[*(None,) * n, *(np.outer(drift, drift) for drift in drifts)],
            theta=pt.concatenate([mass, stiffness]) if symbolic else np.concatenate([mass, stiffness]),
        )


@described
class DuffingChain(Chain):
    """A spring-mass chain whose springs have the force f = k d + c d^3, with the drift d.

    Parameters
    ----------
    mass, stiffness, damping
        As of `SpringMassChain`; `stiffness` is k, that of small drifts, and damping is formed with it.
    cubic : float, array_like (n,) or TensorVariable
        c [N/m^3], not negative; one value stands for all. With zero the chain is linear.

    Raises
    ------
    ValueError, TypeError
        If a number is out of its range or lengths differ.

    Notes
    -----
    Accuracy and cost as of `HystereticChain` with n = 2. Where a draw leaves the ranges, the response is NaN.
    Several masses on springs that harden to many times k move chaotically: no solution is accurate for long;
    `integration_error` tells.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> chain = DuffingChain(mass=1.0, stiffness=[100.0, 100.0], damping=ModalDamping(0.02), cubic=5e4)
    >>> chain.modes().angular_frequencies.round(6)  # of small motions
    array([ 6.18034, 16.18034])
    """

    cubic: Annotated[Values, vector("N/m^3", NOT_NEGATIVE)]

    family = "duffing"
    is_linear = False


@described
class HystereticChain(Chain):
    """A spring-mass chain with Bouc-Wen springs.

    With the drift d of a spring and a dimensionless internal variable z, at rest zero::

        f = a k d + (1 - a) k d_y z,    d_y z' = d' [1 - |z|^n (gamma + beta sign(d' z))].

    Parameters
    ----------
    mass, stiffness, damping
        As of `SpringMassChain`; `stiffness` is the initial one, k, and damping is formed with it.
    yield_displacement : float, array_like (n,) or TensorVariable
        d_y [m], positive: the drift at which the initial and the post-yield line meet if beta + gamma = 1.
        One value stands for all springs, here and below.
    post_yield_ratio : float, array_like (n,) or TensorVariable
        a [-], from 0 to 1: stiffness long after yielding over the initial one. With 1 the chain is linear.
    sharpness : float, array_like (n,) or TensorVariable
        n [-], at least 1: how sudden yielding is. Bilinear (elastic-plastic with hardening) in the limit of
        large n; with 20 the force at d_y is 3 % below the bilinear one.
    beta, gamma : float, array_like (n,) or TensorVariable
        Shape of the loops [-], beta > 0 and 0 <= gamma <= beta, for then every loop dissipates energy.
        ``|z|`` stays below (beta + gamma)^(-1/n); leave the sum at one unless published values say otherwise.
        With beta = gamma springs unload at the initial stiffness.

    Raises
    ------
    ValueError, TypeError
        If a number is out of its range or lengths differ.

    Notes
    -----
    Numbers are checked here; variables cannot be. Where a draw leaves the ranges, the response is NaN.

    Histories are integrated by a fifth-order method in steps that follow the state and end at the kinks of
    the law: to 1e-6 of the peak, mostly 1e-8 (tests/simulators/test_hysteretic.py; `integration_error`
    estimates it). Without damping errors of phase add up, to 1e-6 after a dozen periods. One response of ten
    storeys under a record at 0.02 s costs about 0.5 microseconds for each spring and step with n = 1 or 2, 1
    with another n; more where the highest period is shorter than five steps.

    Mean squares with n up to 6 are integrated by Taylor steps: they agree with those of histories to some
    1e-7, at worst to some 1e-6 (tests/simulators/test_taylor.py). Their gradients are the exact derivatives,
    at the price of three to six values. With n = 1 or 2 that costs a third to a half of what it does with
    another n. Gradients of histories, and with n above 6, are central differences: two responses for each
    number that is no constant.

    References
    ----------
    Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249-263. S. Erlicher & N. Point, C. R. Mecanique 332 (2004)
    51-57: ``beta >= |gamma|`` for a law that dissipates.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> damping = ModalDamping(0.02)
    >>> chain = HystereticChain([1.0, 1.0], 100.0, damping, yield_displacement=0.01, post_yield_ratio=0.1)
    >>> chain
    HystereticChain(2 masses, ModalDamping(0.02))
    """

    _: KW_ONLY
    yield_displacement: Annotated[Values, vector("m")]
    post_yield_ratio: Annotated[Values, vector("-", SHARE, RATIO)]
    sharpness: Annotated[Values, vector("-", AT_LEAST_ONE, SHARPNESS)] = 2.0
    beta: Annotated[Values, vector("-", POSITIVE, NUMERIC)] = 0.5
    gamma: Annotated[Values, vector("-", NOT_NEGATIVE, NUMERIC)] = 0.5

    family = "hysteretic"
    is_linear = False

    def __post_init__(self):
        super().__post_init__()
        if is_numeric(self.beta) and is_numeric(self.gamma) and (self.gamma > self.beta).any():
            beta, gamma = np.broadcast_arrays(self.beta, self.gamma)
            wrong = np.flatnonzero(np.atleast_1d(gamma > beta))[0]
            raise ValueError(
                f"`gamma` must not exceed `beta`, got {gamma.flat[wrong]:g} and {beta.flat[wrong]:g}. "
                "Loops would produce energy; in this notation `beta` goes with sign(d' z)."
            )
