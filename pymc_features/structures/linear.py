"""Any linear structure M x" + C x' + K x = load, and the names of its degrees of freedom, such as "12:x"."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple, Self

import numpy as np
from pytensor.graph.basic import Variable
from scipy import sparse

from pymc_features._checks import as_list, check_integer, listed, message, shown
from pymc_features.algebra import AffineMatrix, always_massless, common_pattern, natural_modes, to_dense
from pymc_features.records import DynamicLoad
from pymc_features.structures.base import (
    DAMPING_OR_MATRIX,
    MATRIX,
    Matrices,
    Modes,
    Structure,
    static_length,
)
from pymc_features.structures.damping import Damping
from pymc_features.structures.matrices import (
    MatrixLike,
    as_influence,
    as_matrix,
    check_connected,
    check_damping,
    check_mass,
    check_static_damping,
    check_static_forces,
    check_stiffness,
    warn_of_lost_digits,
)

ASK = "Name degrees of freedom, or give their numbers."
FEW = 6  # names that a message lists


class DofNames(NamedTuple):
    """What the degrees of freedom of a structure are called.

    Attributes
    ----------
    dofs : dict of str to int
        Names of the degrees of freedom, in their order.
    followers : mapping of str to array (n,)
        Names of displacements that are combinations S x of the degrees of freedom, with their rows of S.
    held : collection of str
        Names of displacements that supports prevent.
    """

    dofs: dict[str, int]
    followers: Mapping[str, np.ndarray]
    held: Iterable[str]

    @classmethod
    def of(cls, names: Sequence[str]) -> Self:
        """Names of degrees of freedom that nothing follows."""
        return cls({name: i for i, name in enumerate(names)}, {}, ())

    def rows(self, names: Sequence[str]) -> np.ndarray:
        """Degrees of freedom (s,), or rows (s, n) of S where one of the names is that of a follower."""
        for name in names:
            if name not in self.dofs and name not in self.followers:
                raise ValueError(self.refusal(name))
        if all(name in self.dofs for name in names):
            return np.array([self.dofs[name] for name in names])
        rows = np.zeros((len(names), len(self.dofs)))
        for row, name in zip(rows, names, strict=True):
            if name in self.dofs:
                row[self.dofs[name]] = 1.0
            else:
                row[:] = self.followers[name]
        return rows

    def refusal(self, name: str) -> str:
        """Why a name is none of a degree of freedom."""
        if name in self.held:
            return message(
                "sensors", "free to move", shown(name), "It moves with the base: pass the record itself."
            )
        names = [*self.dofs, *self.followers]
        close = get_close_matches(name, names, n=3, cutoff=0.6)
        advice = f"Is {' or '.join(close)} meant?" if close else ASK
        first = ", ".join(names[:FEW]) + (f" and {len(names) - FEW} others" if len(names) > FEW else "")
        return message("sensors", f"among {first}", shown(name), advice)

    def influence(self, direction: str) -> np.ndarray:
        """Displacements (n,) under a unit displacement of the ground in one direction."""
        directions = sorted({name.partition(":")[2] for name in self.dofs} & {"x", "y", "z"})
        if direction not in directions:
            advice = "It is that of the ground motion, by the names of the degrees of freedom."
            raise ValueError(message("direction", f"one of {listed(directions)}", shown(direction), advice))
        influence = np.array([name.endswith(f":{direction}") for name in self.dofs], dtype=np.float64)
        for name, row in self.followers.items():
            if abs(row @ influence - name.endswith(f":{direction}")) > 1e-9:
                raise ValueError(
                    "`build` must tie nodes such that all of them can move with the ground, got a constraint "
                    f"on {name!r} that forbids it. Pass the matrices and `influence` to `from_matrices`."
                )
        return influence


class LinearStructure(Structure):
    """A structure given by its matrices, M x" + C x' + K x = -M influence a_g(t), or forces on the right.

    Parameters
    ----------
    mass : array_like (n, n) or (n,), or sparse matrix
        M [kg], symmetric and positive semi-definite; a vector is a diagonal. Degrees of freedom without mass
        (rows of zeros, or masses at the ends of rigid arms) follow the others statically.
    stiffness : array_like (n, n) or (n,), or sparse matrix
        K [N/m], symmetric and positive semi-definite: structures that move as rigid bodies are allowed,
        degrees of freedom that nothing touches, or that have neither mass nor stiffness, are not. If it is
        sparse, so is everything. By name only, like `damping`: the two could be taken for each other.
    damping : Damping, or array_like (n, n), or sparse matrix
        `RayleighDamping`, `ModalDamping` (one ratio, or one for each mode, of which there may be fewer
        than n if no more are kept), or C [N s/m], which need not be diagonalised by the modes. Its
        symmetric part must be positive semi-definite; a skew part (gyroscopic forces) is allowed. Where there
        is no mass it is zero, or a multiple of K.
    influence : array_like (n,) or (n, supports), optional
        Displacement of each degree of freedom under a unit displacement of the base or of each support [-],
        ones by default. With several supports, influence = -inv(K) K_support, and "relative" quantities are
        relative to this quasi-static motion.

    Raises
    ------
    ValueError, TypeError
        If a matrix is not admissible; what is below 1e-8 trace(K) / trace(M) in omega^2 counts as zero.

    Notes
    -----
    Checked by factorisations, O(n^3 / 3) dense, a few seconds for 100,000 sparse degrees of freedom.
    Where `n_modes` cuts a pair of equal frequencies, the direction of the kept shape is arbitrary: keep both.

    Examples
    --------
    >>> from pymc_features import ModalDamping
    >>> stiffness = [[300.0, -100.0], [-100.0, 300.0]]
    >>> frame = LinearStructure([2.0, 2.0], stiffness=stiffness, damping=ModalDamping(0.02))
    >>> frame.modes().angular_frequencies.round(6)  # sqrt(200 / 2), sqrt(400 / 2)
    array([10.      , 14.142136])
    """

    family = "linear"
    inputs = {"mass": MATRIX, "stiffness": MATRIX, "damping": DAMPING_OR_MATRIX, "influence": MATRIX}
    _names: DofNames | None = None

    def __init__(
        self,
        mass: MatrixLike,
        *,
        stiffness: MatrixLike,
        damping: Damping | MatrixLike,
        influence: MatrixLike | None = None,
    ):
        stiffness = as_matrix(stiffness, "stiffness", "N/m")
        self._install_constants((mass, stiffness, damping), influence, ((), (), ()))
        self._install(np.zeros(0))

    def _install_constants(self, matrices, influence, terms):
        """Keep what does not depend on the coefficients: A_0 of M, K and C, and A_i of M, C and K."""
        mass, stiffness, damping = matrices
        n = stiffness.shape[0]
        mass = as_matrix(mass, "mass", "kg", n=n, thin=sparse.issparse(stiffness))
        constants = [mass, None, stiffness]
        self.damping = damping
        if not isinstance(damping, Damping):
            if isinstance(damping, Variable | str) or damping is None or callable(damping):
                got, advice = type(damping).__name__, DAMPING_OR_MATRIX.advice
                raise TypeError(message("damping", "a matrix or a Damping", got, advice))
            constants[1] = as_matrix(damping, "damping", "N s/m", n=n, symmetric=False)
        kind, pattern = to_dense, None
        if sparse.issparse(stiffness):
            kind = sparse.csc_array
            stacked = (*constants, *terms[0], *terms[1], *terms[2])
            pattern = common_pattern([a for a in stacked if a is not None])
        self._terms = tuple(
            None if a is None else AffineMatrix(kind(a), added, pattern)
            for a, added in zip(constants, terms, strict=True)
        )
        self.influence = as_influence(influence, n)
        if isinstance(damping, Damping):
            self._coefficients()

    def _install(self, theta):
        """Set the coefficients, and check the matrices, or of variables what all of their matrices share."""
        self.theta, self._modes, is_random = theta, {}, isinstance(theta, Variable)
        masses, dampings, stiffnesses = (
            None if a is None else a.matrices() if is_random else [a.at(theta)] for a in self._terms
        )
        check_connected(*(a and sum(map(abs, a)) for a in (masses, dampings, stiffnesses)))
        self._massless = always_massless(masses) if is_random else check_mass(*masses)
        if not is_random:
            self._factor = check_stiffness(*masses, *stiffnesses, self._massless)
            self._matrices = masses[0], dampings and dampings[0], stiffnesses[0]
        if dampings is not None:
            check_static_damping(dampings, stiffnesses, self._massless)
            if not is_random:
                check_damping(*masses, *dampings, *stiffnesses, self._massless)

    def __getstate__(self):
        """Copies and workers make the factor anew: SciPy's cannot be pickled."""
        return self.__dict__ | {"_factor": None}

    def as_linear(self) -> "LinearStructure":
        """Return the structure itself; other linear structures return their matrices."""
        return self

    def __repr__(self):
        kind = "sparse" if self._terms[2].is_sparse else "dense"
        damping = repr(self.damping) if isinstance(self.damping, Damping) else "damping matrix"
        return f"{type(self).__name__}({self.n_dof} degrees of freedom, {kind}, {damping})"

    @property
    def n_dof(self) -> int:
        return self._terms[2].shape[0]

    @property
    def n_modes(self) -> int:
        return self._massless.rank

    @property
    def n_supports(self) -> int:
        """Number of base accelerations it takes."""
        return 1 if self.influence.ndim == 1 else self.influence.shape[1]

    def parameters(self) -> tuple:
        """Coefficients theta (p,), Rayleigh pair (2,) and damping ratios; zeros beside a damping matrix."""
        rayleigh, ratios = np.zeros(2), np.zeros(self.n_dof)
        if isinstance(self.damping, Damping):
            rayleigh, ratios = self._coefficients()
        return self.theta, rayleigh, ratios

    def constants(self, record: DynamicLoad) -> tuple:
        """Matrices and load, M x" + C x' + K x = -M influence a(t) + forces a(t), for `excitation(record)`.

        Returns
        -------
        mass, damping, stiffness : array (1 + p, e) or (1, e)
            Entries of A_0, A_1, ...; only A_0 where nothing depends on theta, none for classical damping.
        rows, starts : integer arrays
            Their common pattern, by columns; both empty for dense matrices.
        influence, forces : array (n, d)
            One of them is zero.
        """
        n, entries = self.n_dof, self._terms[2].stack.shape[1]
        stacks = (np.zeros((0, entries)) if a is None else a.stack for a in self._terms)
        influence = self.influence.reshape(n, -1)
        if record.is_force:
            forces = record.places(n)
            influence = np.zeros(forces.shape)
        else:
            forces = np.zeros(influence.shape)
        return *stacks, self._terms[2].rows, self._terms[2].starts, influence, forces

    def excitation(self, record: DynamicLoad) -> np.ndarray:
        """Support accelerations [m/s^2] or forces [N], array (d, t)."""
        if not record.is_force and record.n_inputs != self.n_supports:
            raise ValueError(
                f"`record` must give {self.n_supports} support accelerations, one for each column of "
                f"`influence`, got {record.n_inputs}. Pass Loading(values, dt) with that many rows."
            )
        return record.inputs

    def check_sensors(self, record: DynamicLoad, picked: np.ndarray) -> None:
        """Refuse degrees of freedom (s,), or combinations (s, n) of all, that have no response to a load."""
        if record.is_force and self.n_modes < self.n_dof:
            check_static_forces(record.places(self.n_dof), picked, self._massless)

    def _coefficients(self, n_modes=None):
        """Rayleigh pair, and ratios of all modes they are given for, or of the lowest `n_modes`."""
        ratios = getattr(self.damping, "ratios", None)
        length = (None if ratios is None else static_length(ratios)) or self.n_dof
        if n_modes is None:
            return self.damping.coefficients(min(length, self.n_dof))
        rayleigh, ratios = self.damping.coefficients(max(length, n_modes))
        return rayleigh, ratios[:n_modes]

    def _numbers(self):
        self.check_numbers()
        return self._matrices

    @property
    def mass(self) -> np.ndarray | sparse.csc_array:
        """M [kg], array or `csc_array` (n, n)."""
        return self._numbers()[0]

    @property
    def stiffness(self) -> np.ndarray | sparse.csc_array:
        """K [N/m], array or `csc_array` (n, n)."""
        return self._numbers()[2]

    def inertia(self) -> np.ndarray | Variable:
        """Return influence' M (supports, n) [kg], the masses that the motion of each support moves."""
        static = self.influence.reshape(self.n_dof, -1)
        moved, *more = ((mass @ static).T for mass in self._terms[0].matrices())
        for i, part in enumerate(more):
            moved = moved + self.theta[i] * part
        return moved

    def matrices(self) -> Matrices:
        """Return M [kg], C [N s/m] and K [N/m], arrays (n, n), or sparse if K was given so.

        Of `ModalDamping` C is dense and needs all modes.
        """
        mass, damping, stiffness = self._numbers()
        if damping is None:
            rayleigh, ratios = self._coefficients(self.n_modes)
            damping = rayleigh[0] * mass + rayleigh[1] * stiffness
            if ratios.any():
                omega, shapes = self._natural(self.n_modes)
                moved = mass @ shapes
                damping = to_dense(damping) + moved * (2.0 * ratios * omega) @ moved.T
        return Matrices(mass, damping, stiffness)

    def _natural(self, n_modes):
        if n_modes not in self._modes:
            mass, _, stiffness = self._numbers()
            self._modes[n_modes] = natural_modes(mass, stiffness, n_modes, self._factor, self._massless)
        return self._modes[n_modes]

    def modal_damping(self, n_modes: int | None = None) -> np.ndarray:
        """C in the modes: 2 zeta_r omega_r, shape (m,), or phi' C phi, shape (m, m), of a matrix [1/s]."""
        n_modes = self._check_n_modes(n_modes)
        _, damping, _ = self._numbers()
        omega, shapes = self._natural(n_modes)
        if damping is not None:
            return shapes.T @ (damping @ shapes)
        rayleigh, ratios = self._coefficients(n_modes)
        return rayleigh[0] + rayleigh[1] * omega**2 + 2.0 * ratios * omega

    def modes(self, n_modes: int | None = None) -> Modes:
        """Return undamped modes, lowest first: all, or `n_modes` of them.

        Participation factors have shape (m,), or (m, supports) if `influence` has columns. Damping ratios
        of a matrix are phi_r' C phi_r / (2 omega_r); of rigid-body modes they are zero or infinite. Shapes
        are positive at their largest entry.
        """
        n_modes = self._check_n_modes(n_modes)
        omega, shapes = self._natural(n_modes)
        warn_of_lost_digits(self.mass, self.stiffness, omega)
        damping = self.modal_damping(n_modes)
        damping = damping if damping.ndim == 1 else np.diagonal(damping)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.where((omega == 0.0) & (abs(damping) < 1e-12), 0.0, damping / (2.0 * omega))
        return Modes(omega, shapes, shapes.T @ (self.mass @ self.influence), ratios)

    def _check_n_modes(self, n_modes):
        self._numbers()
        if n_modes is None:
            return self.n_modes
        return check_integer(n_modes, "n_modes", most=self.n_modes, advice="Leave it out for all modes.")

    @property
    def dof_names(self) -> tuple[str, ...] | None:
        """Names of the degrees of freedom in their order; None where they have none."""
        return None if self._names is None else tuple(self._names.dofs)

    def with_names(self, names: Sequence[str]) -> Self:
        """Return the structure with names of its degrees of freedom, for `sensors=["12:x", ...]`.

        Parameters
        ----------
        names : sequence of n str
            All different.
        """
        texts, n = as_list(names), self.n_dof
        if texts is None or not all(isinstance(name, str) for name in texts):
            raise TypeError(message("names", f"{n} texts", shown(names)))
        if len(set(texts)) != n or len(texts) != n:
            twice = [name for name in texts if texts.count(name) > 1]
            got = f"{shown(twice[0])} twice" if twice else str(len(texts))
            raise ValueError(message("names", f"{n} different texts", got, "Name every degree of freedom."))
        return self.with_dof_names(DofNames.of(texts))

    def with_dof_names(self, names: DofNames) -> Self:
        """Return the structure with names of what follows rigidly and of what is held, too."""
        named = copy.copy(self)
        named._names = names
        return named

    def rows_named(self, names: Sequence[str]) -> np.ndarray:
        """Degrees of freedom (s,), or combinations (s, n) of all, that have these names."""
        return self._names.rows(names)
