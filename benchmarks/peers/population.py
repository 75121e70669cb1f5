"""A population of one structure, as the tools are given it."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.case import Case


class Population(NamedTuple):
    """Particles of a structure under the record of a case.

    Attributes
    ----------
    structure : Structure
        Of the nominal stiffness.
    parameters : tuple of array
        Of its family; those that differ have a row for each particle.
    case : Case
        Record, sensors and data.
    """

    structure: Any
    parameters: tuple
    case: Case

    def first(self, particles):
        """The same with the first few particles only."""
        return self._replace(
            parameters=tuple(p[:particles] for p in self.parameters), case=self.case.first(particles)
        )

    def matrices(self):
        """M, C and K of each particle, (P, n, n)."""
        if self.structure.family == "linear":
            found = [self.structure.with_parameters(theta).matrices() for theta in self.parameters[0]]
            return tuple(np.array(matrices) for matrices in zip(*found, strict=True))
        mass, springs, ((alpha, beta),) = self.parameters[:3]
        above = np.hstack([springs[:, 1:], np.zeros((len(springs), 1))])
        n = np.arange(mass.shape[1])
        m, k = np.zeros((2, len(springs), n.size, n.size))
        m[:, n, n], k[:, n, n] = mass, springs + above
        k[:, n[1:], n[:-1]] = k[:, n[:-1], n[1:]] = -springs[:, 1:]
        return m, alpha * m + beta * k, k


def mean_squares(found, case):
    """e_j of accelerations (P, s, time)."""
    return np.mean((np.asarray(found) - case.observed) ** 2, axis=2)


def springs_of(family, xp):
    """Functions for the forces of nonlinear springs (n,) and the rates of their z, by the array module `xp`.

    Plain array expressions, which Numba compiles and JAX traces: the equation of `HystereticChain`, or that
    of `DuffingChain`, whose z stays zero.
    """

    def forces(drift, z, stiffness, values):
        if family == "duffing":
            return stiffness * drift + values[0] * drift**3
        d_y, a = values[0], values[1]
        return stiffness * (a * drift + (1.0 - a) * d_y * z)

    def growth(rate, z, values):
        if family == "duffing":
            return 0.0 * z
        d_y, n, beta, gamma = values[0], values[2], values[3], values[4]
        return rate / d_y * (1.0 - xp.abs(z) ** n * (gamma + beta * xp.sign(rate * z)))

    return forces, growth


def chain_rates(family, xp, compiled=lambda function: function):
    """A function of (u, v, z, ground, mass, stiffness, rayleigh, values) that returns v, v' and z'."""
    forces, growth = map(compiled, springs_of(family, xp))

    def rates(u, v, z, ground, mass, stiffness, rayleigh, values):
        end = xp.zeros(1)
        drift, rate = u - xp.concatenate((end, u[:-1])), v - xp.concatenate((end, v[:-1]))
        pull = forces(drift, z, stiffness, values) + rayleigh[1] * stiffness * rate
        above = xp.concatenate((pull[1:], end))
        return v, (above - pull) / mass - rayleigh[0] * v - ground, growth(rate, z, values)

    return compiled(rates)
