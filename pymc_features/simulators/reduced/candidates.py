"""Modes of structures in a basis, where their residuals are small and none is missing."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.reduced.basis import Basis, Terms
from pymc_features.simulators.reduced.eigenproblem import lowest
from pymc_features.simulators.reduced.inertia import count_below_lanes

TOLERANCE = 3e-8  # of shapes, in the norm of the energy, by the probes
OF_DERIVATIVES = 1e-6  # the same, along parameters in units in which some omega^2 moves by as much as itself
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


def candidates(terms: Terms, basis: Basis, theta, m, left_out) -> dict:
    """Modes in the basis of those structures of which the residuals are small; `theta` (p, t)."""
    usable = np.flatnonzero(np.isfinite(theta).all(axis=1))
    weights = np.hstack([np.ones((len(usable), 1)), theta[usable]])
    stacks = basis.stiffness, basis.mass, basis.spring_probes, basis.mass_probes
    parts = (np.tensordot(weights[:, : len(stack)], stack, 1) for stack in stacks)
    found = {}
    for i, *matrices in zip(usable, *parts, strict=True):
        try:
            candidate = solve_reduced(terms, matrices, m, left_out)
        except LinAlgError:
            continue
        if candidate is None or (left_out and not holds_derivatives(terms, basis, matrices, m, candidate)):
            continue
        found[i] = candidate
    return found


def solve_reduced(terms, matrices, m, left_out) -> Candidate | None:
    """Modes of V' K V and V' M V; None if the residuals of the lowest m are large."""
    stiffness, mass, springs, masses = matrices
    own_mass = None if terms.is_inertia else mass
    values, vectors = lowest(stiffness, own_mass, terms.shift, None if left_out else m + 1)
    kept = vectors[:, :m]
    inertia = 1.0 if terms.is_inertia else (kept * (mass @ kept)).sum(axis=0)
    values[:m] = (kept * (stiffness @ kept)).sum(axis=0) / inertia
    if not values[0] > terms.shift:  # rigid bodies have no energy to measure errors by
        return None
    residuals = springs @ kept - (masses @ kept) * values[:m]
    return Candidate(values, vectors) if (size(residuals, values[:m]) <= TOLERANCE).all() else None


def size(residuals, values):
    """Norms (m,) of residuals (PROBES, m) that the probes have seen, as shares of the energy of the modes."""
    return np.sqrt((residuals**2).mean(axis=0) / values)


def holds_derivatives(terms, basis, matrices, m, found) -> bool:
    """Whether the derivatives of the kept modes lie in the basis, by their residuals along random directions.

    They solve (K - lambda M) dphi = -(dK - lambda dM) phi, in the basis by the other modes in it; what the
    kept ones have of it lies there in any case.
    """
    _, mass, springs, masses = matrices
    kept, others = found.vectors[:, :m], found.vectors[:, m:]
    values, above = found.values[:m], found.values[m:, None]
    gaps = np.where(np.isinf(above), 1.0, above - values)
    for direction in terms.directions:
        loads = change(direction, basis.stiffness) @ kept
        residuals = change(direction, basis.spring_probes) @ kept
        if len(basis.mass) > 1:
            loads = loads - change(direction, basis.mass) @ kept * values
            residuals = residuals - change(direction, basis.mass_probes) @ kept * values
        moved = others @ (others.T @ loads / -gaps)
        residuals += springs @ moved - masses @ moved * values - masses @ kept @ (kept.T @ loads)
        if not (size(residuals, values) <= OF_DERIVATIVES).all():
            return False
    return True


def change(direction, stack):
    """sum_i d_i A_i, zero where nothing depends on theta."""
    return np.tensordot(direction, stack[1:], 1) if len(stack) > 1 else np.zeros(stack.shape[1:])


def complete(terms: Terms, theta, m, found) -> list:
    """Which candidates are all there is: M definite, and no other omega^2 below the highest one kept."""
    if not found:
        return []
    places = list(found)
    lanes, bounds = np.zeros((theta.shape[1], LANES)), np.zeros((1, LANES))
    lanes[:, : len(places)] = theta[places].T
    bounds[0, : len(places)] = [found[i].values[m - 1] * (1.0 - BELOW) for i in places]
    springs, masses = terms.spring_entries, terms.mass_entries
    below = count_below_lanes(terms.pattern, springs, masses, lanes, bounds)
    good = [below[k] == np.sum(found[i].values[:m] < bounds[0, k]) for k, i in enumerate(places)]
    if len(masses) > 1:
        negative = count_below_lanes(terms.pattern, masses, masses, lanes, np.zeros((1, LANES)))
        good &= negative[: len(places)] == 0.0
    return [i for k, i in enumerate(places) if good[k]]


def with_signs(columns, vectors, m):
    """The vectors (r, > m), the lowest m so that the largest entry of each shape (n,) is positive."""
    shapes = columns @ vectors[:, :m]
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.hstack([vectors[:, :m] * np.where(peaks < 0.0, -1.0, 1.0), vectors[:, m:]])
