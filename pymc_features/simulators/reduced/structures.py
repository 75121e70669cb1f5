"""Structures of a population one after the other, in a reduced basis where that is good enough."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.system import solve_system
from pymc_features.simulators.reduced.basis import Basis, Terms
from pymc_features.simulators.reduced.eigenproblem import lowest
from pymc_features.simulators.reduced.inertia import count_below_lanes
from pymc_features.simulators.reduced.known import KNOWN

TOLERANCE = 3e-9  # of shapes, in the norm of the energy, by the probes
BELOW = 1e-6  # how far below the highest mode kept the others are counted, as a share of omega^2


class Candidate(NamedTuple):
    """Modes of a structure in a basis, not yet known to be complete.

    Attributes
    ----------
    values : array (> m,) or (r,)
        omega^2.
    vectors : array (r, > m)
    """

    values: np.ndarray
    vectors: np.ndarray


def solved(a: Arguments, particles, *, left_out=False):
    """Yield number, `Arguments` and `System` of some particles of a population; None where there is no structure.

    Where the modes were found in a basis, the arguments and the system are those of the structure reduced to
    it: dense, of as many degrees of freedom as the basis has columns.
    """
    known = KNOWN.of(a.parameters, a.wanted.n_modes, len(particles))
    for first in range(0, len(particles), LANES):
        waiting = particles[first : first + LANES]
        while len(waiting):
            found = {} if known is None else in_basis(a, known, waiting, left_out)
            for p, pair in found.items():
                yield p, *pair
            waiting = [p for p in waiting if p not in found]
            if not waiting:
                break
            p, *waiting = waiting
            own = a._replace(parameters=a.parameters.one_of(p))
            yield p, own, solve_system(own, left_out=left_out) if known is None else known.solve(own)


def in_basis(a, known, block, left_out) -> dict:
    """Arguments and systems of those particles of a block whose modes are good."""
    if known.basis is None or known.basis.size <= a.wanted.n_modes + 1:
        return {}
    reduced, given = known.reduced(a), a.parameters
    theta = np.stack([given.theta[p % given.theta.shape[0]] for p in block])
    found = candidates(known.terms, known.basis, theta, a.wanted.n_modes, left_out)
    good = complete(known.terms, theta, a.wanted.n_modes, found)
    return {block[i]: system_of(reduced, block[i], found[i]) for i in good}


def candidates(terms: Terms, basis: Basis, theta, m, left_out) -> dict:
    """Modes in the basis of those structures of which the residuals are small; `theta` (p, t)."""
    usable = np.flatnonzero(np.isfinite(theta).all(axis=1))
    weights = np.hstack([np.ones((len(usable), 1)), theta[usable]])
    stacks = basis.stiffness, basis.mass, basis.spring_probes, basis.mass_probes
    parts = [np.tensordot(weights[:, : len(stack)], stack, 1) for stack in stacks]
    found = {}
    for i, stiffness, mass, springs, masses in zip(usable, *parts, strict=True):
        try:
            own_mass = None if terms.is_inertia else mass
            values, vectors = lowest(stiffness, own_mass, terms.shift, None if left_out else m + 1)
        except LinAlgError:
            continue
        kept, forces = vectors[:, :m], stiffness @ vectors[:, :m]
        inertia = 1.0 if terms.is_inertia else (kept * (mass @ kept)).sum(axis=0)
        values[:m] = (kept * forces).sum(axis=0) / inertia
        if not values[0] > terms.shift:  # rigid bodies have no energy to measure errors by
            continue
        residuals = springs @ kept - (masses @ kept) * values[:m]
        error = np.sqrt((residuals**2).mean(axis=0) / values[:m])
        if (error <= TOLERANCE).all():
            found[i] = Candidate(values, vectors)
    return found


def complete(terms: Terms, theta, m, found) -> list:
    """Which candidates are all there is: M definite, and no other omega^2 below the highest one kept."""
    places = list(found)
    lanes, bounds = np.zeros((theta.shape[1], LANES)), np.zeros((1, LANES))
    lanes[:, : len(places)] = theta[places].T
    bounds[0, : len(places)] = [found[i].values[m - 1] * (1.0 - BELOW) for i in places]
    below = count_below_lanes(terms.pattern, terms.spring_entries, terms.mass_entries, lanes, bounds)
    expected = [np.sum(found[i].values[:m] < bounds[0, k]) for k, i in enumerate(places)]
    return [i for k, i in enumerate(places) if below[k] == expected[k]]


def system_of(reduced: Arguments, p, found: Candidate):
    """Arguments and system of one structure in the basis."""
    own, m = reduced._replace(parameters=reduced.parameters.one_of(p)), reduced.wanted.n_modes
    omega = np.sqrt(np.maximum(found.values, 0.0))
    system = solve_system(own, known=(omega, found.vectors))
    if system is not None and omega.size > m + 1:
        system = system._replace(others=(omega[m:], found.vectors[:, m:]))
    return own, system
