"""Arguments of the kernels of linear structures, what follows from them, and the check of their sizes."""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import assemble, to_dense
from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.oscillators.arguments import Excitation, Outputs, n_outputs


class LinearParameters(NamedTuple):
    """Parameters and matrices of M(theta) x" + C x' + K(theta) x = -M influence a(t) + forces a(t).

    Attributes
    ----------
    theta : array (p,)
        Coefficients: A(theta) = A_0 + sum_i theta_i A_i for each of M, C and K.
    rayleigh : array (2,)
        alpha [1/s] and beta [s] of classical damping.
    ratios : array (k,)
        Damping ratios [-] added to it, of the lowest k modes, at least those that are kept.
    mass, damping, stiffness : array (1 + p, e) or (1, e)
        Entries of A_0, A_1, ... [kg, N s/m, N/m]; only A_0 where nothing depends on theta. Without rows in
        `damping` it is classical; with them `rayleigh` and `ratios` are not read.
    rows, starts : integer array (e,), (n + 1,)
        The pattern of these entries, by columns; both empty for dense matrices, whose entries are in C order.
    influence, forces : array (n, d)
        Displacements under unit displacements of the supports [-], and loads per unit of the inputs.
    """

    theta: np.ndarray
    rayleigh: np.ndarray
    ratios: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    rows: np.ndarray
    starts: np.ndarray
    influence: np.ndarray
    forces: np.ndarray

    @property
    def random(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta, rayleigh and ratios, which may be random and are differentiated."""
        return self.theta, self.rayleigh, self.ratios

    @property
    def n_dof(self) -> int:
        """Number of degrees of freedom n."""
        return self.influence.shape[0]

    @property
    def is_finite(self) -> bool:
        """Whether theta, rayleigh and ratios are finite."""
        return all(np.isfinite(values).all() for values in self.random)

    @property
    def is_classical(self) -> bool:
        """Whether the damping is given by coefficients, not by a matrix."""
        return self.damping.shape[0] == 0

    @property
    def is_dense(self) -> bool:
        """Whether the matrices have all their entries."""
        return self.starts.size == 0

    @property
    def has_constant_modes(self) -> bool:
        """Whether neither M nor K depends on theta."""
        return max(self.mass.shape[0], self.stiffness.shape[0]) == 1

    def assemble(self, stack):
        """A(theta) of a stack of entries, an array or `csc_array` (n, n)."""
        return assemble(stack, self.theta, self.rows, self.starts, self.n_dof)

    def one_of(self, p: int) -> "LinearParameters":
        """Parameters of particle p of a population: `random` has a row for each particle, or one for all."""
        return LinearParameters(*(array[p % array.shape[0]] for array in self.random), *self[N_PARAMETERS:])

    def as_population(self) -> "LinearParameters":
        """A population of one particle."""
        return LinearParameters(*(array[None] for array in self.random), *self[N_PARAMETERS:])

    def for_kernel(self) -> "LinearParameters":
        """These matrices in arrays that compiled code takes."""
        whole = np.int64
        pattern = {name: writable(getattr(self, name), whole) for name in ("rows", "starts")}
        return LinearParameters(*map(writable, self))._replace(**pattern)


SYMMETRY = 1e-14  # differences from the transposed matrix below this times its largest entry are rounding
N_PARAMETERS = 3  # theta, rayleigh and ratios come first


class Arguments(NamedTuple):
    """What a kernel takes.

    Attributes
    ----------
    parameters : LinearParameters
    excitation : Excitation
        Its inputs (d, t) are support accelerations [m/s^2] or forces [N].
    wanted : Outputs
        Its `sensors` are a matrix (s, n), an array or sparse, of combinations of the degrees of freedom.
    """

    parameters: LinearParameters
    excitation: Excitation
    wanted: Outputs

    @property
    def step(self) -> float:
        """Step of the recursion [s]."""
        return self.excitation.dt / self.excitation.substeps

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (s, u) of the response."""
        acceleration, _, substeps, stride, _ = self.excitation
        return self.wanted.sensors.shape[0], n_outputs(acceleration.shape[1], substeps, stride)

    @property
    def inputs(self) -> Excitation:
        """The excitation in arrays that compiled code takes."""
        acceleration, *grid, direct = self.excitation
        return Excitation(writable(acceleration), *grid, writable(direct))

    @property
    def outputs(self) -> Outputs:
        """The outputs in arrays that compiled code takes, the matrix of sensors dense."""
        sensors, n_modes, quantity = self.wanted
        return Outputs(writable(to_dense(sensors)), n_modes, quantity)

    @property
    def has_pairs(self) -> bool:
        """Whether complex modes in lanes are tried: of a full, symmetric C under one input."""
        given, n_inputs = self.parameters, len(self.excitation.acceleration)
        is_full = given.is_dense and not given.is_classical
        return is_full and n_inputs == 1 and is_symmetric(given.damping, given.n_dof)

    def check(self, history=None, weights=None):
        """Refuse sizes that do not agree.

        `history` is the data or a cotangent of the response (s, u), `weights` a cotangent (s, 1 or 4) of
        statistics of the misfit.
        """
        given, n = self.parameters, self.parameters.n_dof
        entries, inputs = given.mass.shape[1], self.excitation.acceleration
        if given.starts.size not in (0, n + 1) or entries != (n * n if given.is_dense else given.rows.size):
            raise ValueError("`rows` and `starts` must be the pattern of the matrices, or empty if dense")
        lengths = {1, 1 + given.theta.size}
        for name in ("mass", "damping", "stiffness"):
            stack = getattr(given, name)
            legal = lengths | {0} if name == "damping" else lengths
            if stack.shape[1] != entries or stack.shape[0] not in legal:
                raise ValueError(f"`{name}` must have shape (1 + p, e) or (1, e) to match `theta` and `mass`")
        if given.forces.shape != given.influence.shape or given.influence.shape[1] != inputs.shape[0]:
            raise ValueError("`influence` and `forces` must have shape (n, d) to match `acceleration` (d, t)")
        if self.wanted.sensors.ndim != 2 or self.wanted.sensors.shape[1] != n:
            raise ValueError("`sensors` must have one column for each degree of freedom")
        if not 1 <= self.wanted.n_modes <= n:
            raise ValueError("`n_modes` must lie between 1 and the number of degrees of freedom")
        if given.rayleigh.size != 2 or (given.is_classical and given.ratios.size < self.wanted.n_modes):
            raise ValueError("`rayleigh` must have 2 values, and `ratios` one for each mode kept")
        if history is not None and history.shape != self.shape:
            raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")
        if weights is not None and weights.shape not in ((self.shape[0], 1), (self.shape[0], 4)):
            raise ValueError("`weights` must have one value or four for each sensor")


def n_particles(parameters: LinearParameters, weights=None) -> int:
    """Number of particles of a population; `weights` (p, ...) have a row for each."""
    counts = {array.shape[0] for array in parameters.random}
    given = counts if weights is None else {weights.shape[0]}
    if len((counts | given) - {1}) > 1 or max(given) < max(counts):
        raise ValueError("the parameters must have one row, or one for each particle, and `weights` all rows")
    return max(given)


def is_symmetric(stack, n) -> bool:
    """Whether all matrices of a stack (terms, n n) are symmetric to rounding, as those of dashpots are."""
    matrices = stack.reshape(-1, n, n)
    skew = abs(matrices - matrices.transpose(0, 2, 1))
    return bool(skew.max() <= SYMMETRY * abs(matrices).max())
