"""Modes of many sparse structures that are alike, by those of the ones before.

Of the first structure all is computed: a factor F of K + s M, and its lowest modes by Lanczos iteration. The
next one begins with the best combinations of all modes found so far, a reduced basis V: the eigenproblem of
V' K V and V' M V, for which only coefficients of the parameters are summed. These shapes are improved as far
as need be by the conjugate directions of F^-1 (K x - mu M x) (LOBPCG: Knyazev, SIAM J. Sci. Comput. 23,
517-541, 2001), and what is new in them joins the basis. The residuals say how far the shapes are off; the
inertia of K - mu M says that none is missing and no eigenvalue negative. Where either fails, all is computed
anew.

Per structure that takes one factorisation, for the inertia, and a few solutions by the old factor, in the
place of two factorisations and dozens of solutions one by one.
"""

import numpy as np
from scipy.linalg import LinAlgError, eigh, qr

from pymc_features.algebra import assemble, spectral_shift
from pymc_features.algebra.factorisation import count_below
from pymc_features.simulators.linear.system import admissible_modes

LARGE = 3000  # degrees of freedom from which this is faster than to begin anew each time
TOLERANCE = 1e-7  # of shapes, in the norm of the energy; that of frequencies is its square
MAX_STEPS = 7
NEW = 1e-7  # share of a shape outside the basis from which it joins
MOST_COLUMNS = 400  # of the basis


class Neighbours:
    """Lowest modes of structures that share their sparse matrices and differ in theta.

    Parameters
    ----------
    parameters : LinearParameters
        Of one of them.
    n_modes : int
        Number of modes m.

    Attributes
    ----------
    solved : int
        How many structures were computed by themselves.
    """

    def __init__(self, parameters, n_modes: int):
        self.given, self.m = parameters, n_modes
        self.q = n_modes + 2 + n_modes // 4  # some more: neighbours to change places with
        self.factor, self.metric, self.solved = None, None, 0
        none, pattern = np.zeros(0), (parameters.rows, parameters.starts, parameters.n_dof)
        self.terms = [
            [assemble(row[None], none, *pattern) for row in stack]
            for stack in (parameters.stiffness, parameters.mass)
        ]
        self.basis = np.zeros((parameters.n_dof, 0))
        self.reduced = [np.zeros((len(terms), 0, 0)) for terms in self.terms]

    @property
    def is_worthwhile(self) -> bool:
        """Whether there are many degrees of freedom, of which few modes are wanted."""
        return self.given.n_dof >= LARGE and 8 * self.q < MOST_COLUMNS

    def modes(self, own, *, checked: bool = True):
        """omega (m,) and shapes (n, m) of a structure; None where there is none.

        Parameters
        ----------
        own : LinearParameters
        checked : bool
            Whether to make sure that none is missing; not needed of modes that were found before.
        """
        if not own.is_finite:
            return None
        mass, stiffness = own.assemble(own.mass), own.assemble(own.stiffness)
        if self.factor is not None:
            found = self.improved(own.theta, mass, stiffness)
            if found is not None and not (checked and misses_some(mass, stiffness, found[0], self.m)):
                return found[0][: self.m], found[1][:, : self.m]
        self.solved += 1
        factor, *known = admissible_modes(mass, stiffness, self.q)
        if not known:
            return None
        omega, shapes = known
        if omega[0] > 0.0:  # rigid bodies have no energy to measure errors by
            self.factor = factor
            if self.metric is None:
                self.metric = stiffness + spectral_shift(mass, stiffness) * mass
            self.join(shapes)
        return omega[: self.m], shapes[:, : self.m]

    def improved(self, theta, mass, stiffness):
        """omega (q,) and shapes (n, q), from those of the neighbours; None where that fails."""
        weights = np.concatenate([[1.0], theta])
        small = [np.tensordot(weights[: len(r)], r, 1) for r in self.reduced]
        try:
            shapes = self.basis @ lowest(*small, self.q)[1]
            return self.iterated(mass, stiffness, shapes)
        except (LinAlgError, ValueError):  # no structure, or none near
            return None

    def iterated(self, mass, stiffness, shapes):
        """The same, from a first guess; None without convergence."""
        directions = np.zeros((shapes.shape[0], 0))
        for step in range(MAX_STEPS):
            forces, momenta = stiffness @ shapes, mass @ shapes
            inertia = (shapes * momenta).sum(axis=0)
            values = (shapes * forces).sum(axis=0) / inertia
            if not (values > 0.0).all():
                return None
            residual = forces - momenta * values
            better = self.factor.solve(residual)
            error = np.sqrt(np.maximum((residual * better).sum(axis=0), 0.0) / (values * inertia))
            if (error[: self.m] <= TOLERANCE).all():
                if step:
                    self.join(shapes)
                return in_order(values, shapes / np.sqrt(inertia))
            block = np.hstack([shapes, better, directions])
            block, _ = qr(block / np.linalg.norm(block, axis=0), mode="economic", check_finite=False)
            _, mix = lowest(block.T @ (stiffness @ block), block.T @ (mass @ block), self.q)
            new = block @ mix
            directions = new - shapes @ np.linalg.lstsq(shapes, new, rcond=None)[0]
            norms = np.linalg.norm(directions, axis=0)
            directions, shapes = directions[:, norms > 0.0], new
        return None

    def join(self, shapes):
        """Add to the basis what is new in some shapes."""
        if self.basis.shape[1] + shapes.shape[1] > MOST_COLUMNS:
            return
        scale = np.sqrt((shapes * (self.metric @ shapes)).sum(axis=0))
        new = shapes / scale
        for _ in range(2):
            new = new - self.basis @ (self.basis.T @ (self.metric @ new))
        squares, turn = np.linalg.eigh(new.T @ (self.metric @ new))
        kept = squares > NEW**2
        new = new @ (turn[:, kept] / np.sqrt(squares[kept]))
        old, k = self.basis.shape[1], self.basis.shape[1] + new.shape[1]
        self.basis = np.hstack([self.basis, new])
        for i, terms in enumerate(self.terms):
            grown = np.zeros((len(terms), k, k))
            grown[:, :old, :old] = self.reduced[i]
            for matrix, reduced in zip(terms, grown, strict=True):
                columns = self.basis.T @ (matrix @ new)
                reduced[:, old:], reduced[old:, :] = columns, columns.T
            self.reduced[i] = grown


def lowest(stiffness, mass, count):
    """Lowest `count` eigenvalues and vectors of small matrices, by 1 / omega^2: M may be singular."""
    n = len(mass)
    inverses, vectors = eigh(mass, stiffness, subset_by_index=[max(n - count, 0), n - 1])
    return 1.0 / inverses[::-1], vectors[:, ::-1]


def in_order(values, shapes):
    """omega and shapes in ascending order, the largest entry of each positive."""
    order = np.argsort(values, kind="stable")
    shapes = shapes[:, order]
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.sqrt(values[order]), shapes * np.where(peaks < 0.0, -1.0, 1.0)


def misses_some(mass, stiffness, omega, m) -> bool:
    """Whether K - omega_m^2 M has other negative eigenvalues than the lower modes, or it cannot be told."""
    values = omega[:m] ** 2
    bound = values[-1] - 1e-6 * values[-1]
    below = count_below(mass, stiffness, bound)
    return below is None or below != np.sum(values < bound)
