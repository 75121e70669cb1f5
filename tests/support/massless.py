"""A cantilever whose rotations have no mass, or whose masses sit on rigid arms, and its condensation."""

import numpy as np
from scipy import sparse

from pymc_features import AffineStructure, LinearStructure, RayleighDamping
from support.reference import first_order_hold

RAYLEIGH = RayleighDamping(0.3, 2e-3)
ELEMENT = np.array(  # of Euler and Bernoulli, unit length; displacement and rotation of each end
    [[12.0, 6.0, -12.0, 6.0], [6.0, 4.0, -6.0, 2.0], [-12.0, -6.0, 12.0, -6.0], [6.0, 2.0, -6.0, 4.0]]
)


class Cantilever:
    """Beam of `n` elements, theta = (factor of the lower half, of the upper, mass added at the tip [kg]).

    Displacement and rotation of each node, from the base up; the mass of a node sits on an `arm` [m] along
    the beam, so that it moves by u = v + arm * rotation. The matrices are arrays of the kind of theta.
    """

    def __init__(self, n=4, arm=0.0):
        self.n, self.arm, self.n_dof = n, arm, 2 * n
        masses = np.diag(1.0 + 0.5 * np.sin(np.arange(n)))
        tip = np.diag(np.arange(n) == n - 1).astype(float)
        reach = np.kron(np.eye(n), [1.0, arm])  # u of v and rotations
        self.mass_terms = [reach.T @ masses @ reach, None, None, reach.T @ tip @ reach]
        halves = np.zeros((2, 2 * n + 2, 2 * n + 2))
        for e in range(n):
            at = slice(2 * e, 2 * e + 4)
            halves[2 * e // n, at, at] += 40.0 * (1.0 + 0.2 * np.cos(e)) * ELEMENT
        self.stiffness_terms = [0.0 * halves[0, 2:, 2:], halves[0, 2:, 2:], halves[1, 2:, 2:], None]
        pots = reach.T @ np.diag(np.linspace(0.2, 2.0, n)) @ reach
        swirl = np.triu(np.ones((n, n)), 1)
        pots += 0.3 * reach.T @ (swirl - swirl.T) @ reach  # gyroscopic
        beta = 1e-3  # C acts on the rotations as beta K
        self.damping_terms = [
            pots,
            beta * self.stiffness_terms[1],
            beta * self.stiffness_terms[2],
            0.5 * self.mass_terms[3],
        ]
        self.influence = np.kron(np.ones(n), [1.0, 0.0])

    def matrices(self, theta):
        """M, C and K."""
        return tuple(
            terms[0] + sum(t * a for t, a in zip(theta, terms[1:], strict=True) if a is not None)
            for terms in (self.mass_terms, self.damping_terms, self.stiffness_terms)
        )

    def structure(self, theta, damping=RAYLEIGH, kind=np.asarray):
        """The structure; `damping` None is the matrix."""
        by_matrix = {
            "damping": kind(self.damping_terms[0]),
            "damping_terms": self.terms(self.damping_terms, kind),
        }
        return AffineStructure(
            kind(self.mass_terms[0]),
            stiffness=kind(self.stiffness_terms[0]),
            stiffness_terms=self.terms(self.stiffness_terms, kind),
            mass_terms=self.terms(self.mass_terms, kind),
            influence=self.influence,
            theta=theta,
            **(by_matrix if damping is None else {"damping": damping}),
        )

    @staticmethod
    def terms(matrices, kind):
        return [None if a is None else kind(a) for a in matrices[1:]]

    def condensed(self, theta):
        """M, C, K of the displacements of the masses, and x = R u."""
        n = self.n
        turned = np.kron(np.eye(n), [[1.0, -self.arm], [0.0, 1.0]])  # v, rotation of u, rotation
        mass, damping, stiffness = (turned.T @ a @ turned for a in self.matrices(theta))
        moved, free = np.arange(0, 2 * n, 2), np.arange(1, 2 * n, 2)
        follow = -np.linalg.solve(stiffness[np.ix_(free, free)], stiffness[np.ix_(free, moved)])
        static = np.zeros((2 * n, n), follow.dtype)
        static[moved], static[free] = np.eye(n), follow
        return *(static.T @ a @ static for a in (mass, damping, stiffness)), turned @ static

    def response(self, theta, record, quantity, rayleigh=None):
        """All degrees of freedom (n, time) by the condensed matrices, without modes; analytic in theta."""
        mass, damping, stiffness, static = self.condensed(theta)
        if rayleigh is not None:
            damping = rayleigh[0] * mass + rayleigh[1] * stiffness
        load = -static.T @ (self.matrices(theta)[0] @ self.influence)[:, None]
        system = (np.linalg.solve(mass, a) for a in (damping, stiffness, load))
        x, v, relative = first_order_hold(*system, record.acceleration[None], record.dt)
        ground = self.influence[:, None] * record.acceleration
        return (static @ relative + ground, static @ relative, static @ v, static @ x)[quantity]

    def condensed_structure(self, theta, damping):
        """The structure of the masses alone, and x = R u; its relative response is that of ours."""
        mass, matrix, stiffness, static = self.condensed(theta)
        influence = np.linalg.solve(mass, static.T @ self.matrices(theta)[0] @ self.influence)
        mass, stiffness = (0.5 * (a + a.T) for a in (mass, stiffness))
        damping = matrix if damping is None else damping
        return LinearStructure(mass, stiffness=stiffness, damping=damping, influence=influence), static


KINDS = {"dense": np.asarray, "sparse": sparse.csc_array}
