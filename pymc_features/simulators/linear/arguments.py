"""What the kernels of linear structures take, in this order, and the check of its sizes."""

from typing import NamedTuple

import numpy as np

from pymc_features.algebra import to_dense
from pymc_features.simulators.oscillators.arguments import n_outputs


class LinearParameters(NamedTuple):
    """Parameters and matrices of a linear structure: the first ten of `Arguments`."""

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


class Arguments(NamedTuple):
    """M(theta) x" + C x' + K(theta) x = -M influence a(t) + forces a(t), and what is asked of it.

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
    acceleration : array (d, t)
        The inputs, support accelerations [m/s^2] or forces [N], linear between their samples.
    dt : float
        Their step [s].
    substeps, stride : int
        Of the recursion between two samples, and between two outputs, as in `recursion.advance`.
    sensors : array (s, n) or sparse matrix
        Wanted combinations of the degrees of freedom: rows of the identity for sensors.
    n_modes, quantity : int
        Modes kept, and a position in `QUANTITIES`.
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
    acceleration: np.ndarray
    dt: float
    substeps: int
    stride: int
    sensors: np.ndarray
    n_modes: int
    quantity: int

    @property
    def step(self) -> float:
        """Step of the recursion [s]."""
        return self.dt / self.substeps

    @property
    def grid(self) -> tuple[int, int]:
        """Substeps and stride."""
        return self.substeps, self.stride

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (s, u) of the response."""
        return self.sensors.shape[0], n_outputs(self.acceleration.shape[1], self.substeps, self.stride)

    @property
    def is_classical(self) -> bool:
        """Whether the damping is given by coefficients, not by a matrix."""
        return self.damping.shape[0] == 0

    @property
    def is_dense(self) -> bool:
        """Whether the matrices have all their entries."""
        return self.starts.size == 0

    @property
    def inputs(self) -> np.ndarray:
        """`acceleration` for a kernel."""
        return writable(self.acceleration)

    @property
    def loads(self) -> tuple[np.ndarray, np.ndarray]:
        """`influence` and `forces` for a kernel."""
        return writable(self.influence), writable(self.forces)

    @property
    def outputs(self) -> np.ndarray:
        """`sensors` for a kernel, dense."""
        return writable(to_dense(self.sensors))

    def check(self, history=None, weights=None):
        """Refuse sizes that do not agree.

        `history` is the data or a cotangent of the response (s, u), `weights` a cotangent of e (s,).
        """
        n, entries = self.influence.shape[0], self.mass.shape[1]
        if self.starts.size not in (0, n + 1) or entries != (self.rows.size if self.starts.size else n * n):
            raise ValueError("`rows` and `starts` must be the pattern of the matrices, or empty if dense")
        lengths = {1, 1 + self.theta.size}
        for name in ("mass", "damping", "stiffness"):
            stack = getattr(self, name)
            legal = lengths | {0} if name == "damping" else lengths
            if stack.shape[1] != entries or stack.shape[0] not in legal:
                raise ValueError(f"`{name}` must have shape (1 + p, e) or (1, e) to match `theta` and `mass`")
        if self.forces.shape != self.influence.shape or self.influence.shape[1] != self.acceleration.shape[0]:
            raise ValueError("`influence` and `forces` must have shape (n, d) to match `acceleration` (d, t)")
        if self.sensors.ndim != 2 or self.sensors.shape[1] != n:
            raise ValueError("`sensors` must have one column for each degree of freedom")
        if not 1 <= self.n_modes <= n:
            raise ValueError("`n_modes` must lie between 1 and the number of degrees of freedom")
        if self.rayleigh.size != 2 or (self.is_classical and self.ratios.size < self.n_modes):
            raise ValueError("`rayleigh` must have 2 values, and `ratios` one for each mode kept")
        if history is not None and history.shape != self.shape:
            raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")
        if weights is not None and weights.shape != self.shape[:1]:
            raise ValueError("`weights` must have one value for each sensor")


N_PARAMETERS = 3  # theta, rayleigh and ratios may be random


def writable(array, dtype=np.float64) -> np.ndarray:
    """The array, or a copy if it is read-only or strided: one compiled kernel serves all."""
    return np.require(array, dtype, ["C", "W"])


def one_of(parameters, p: int) -> tuple:
    """Parameters of particle p: each array has a row for each particle, or one for all."""
    return tuple(array[p % array.shape[0]] for array in parameters)


def n_particles(parameters, weights=None) -> int:
    """Number of particles of a population; `weights` (p, s) have a row for each."""
    counts = {array.shape[0] for array in parameters}
    given = counts if weights is None else {weights.shape[0]}
    if len((counts | given) - {1}) > 1 or max(given) < max(counts):
        raise ValueError("the parameters must have one row, or one for each particle, and `weights` all rows")
    return max(given)
