"""Modes of structures in a basis, where their residuals are small and none is missing."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, eigh

from pymc_features.simulators.compiled.vector import LANES
from pymc_features.simulators.reduced.basis import Basis, Terms
from pymc_features.simulators.reduced.inertia import count_below_lanes

TOLERANCE = 2e-9  # of shapes, in the norm of the energy, by the probes
OF_DERIVATIVES = 1e-6  # the same, along parameters in units in which some omega^2 moves by as much as itself
FINER = TOLERANCE / OF_DERIVATIVES
MASSLESS = 1e-13  # an inverse eigenvalue below this times the largest is that of a motion without mass
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


def candidates(terms: Terms, basis: Basis, theta, m, left_out) -> tuple:
    """Modes in the basis of those structures of which the residuals are small, and how large all are.

    `theta` (p, t); a dictionary by its rows, and an array (p,), infinite where no modes were found at all.
    """
    stacks = basis.stiffness, basis.mass, basis.spring_probes, basis.mass_probes
    found, errors = {}, np.full(len(theta), np.inf)
    for i in np.flatnonzero(np.isfinite(theta).all(axis=1)):
        weights = np.append(1.0, theta[i])
        # one by one: in a product of all, the last bits would depend on how many there are
        matrices = [np.tensordot(weights[: len(stack)], stack, 1) for stack in stacks]
        try:
            candidate, errors[i] = solve_reduced(terms, matrices, m, left_out)
        except LinAlgError:
            continue
        if errors[i] <= TOLERANCE and left_out:
            errors[i] = max(errors[i], derivative_error(terms, basis, matrices, m, candidate) * FINER)
        if errors[i] <= TOLERANCE:
            found[i] = candidate
    return found, errors


def solve_reduced(terms, matrices, m, left_out) -> tuple:
    """Modes of V' K V and V' M V, and the largest residual of the lowest m."""
    stiffness, mass, springs, masses = matrices
    own_mass = None if terms.is_inertia else mass
    values, vectors = lowest(stiffness, own_mass, terms.shift, None if left_out else m + 1)
    kept = vectors[:, :m]
    inertia = 1.0 if terms.is_inertia else (kept * (mass @ kept)).sum(axis=0)
    values[:m] = (kept * (stiffness @ kept)).sum(axis=0) / inertia
    if not values[0] > terms.shift:  # rigid bodies have no energy to measure errors by
        return None, np.inf
    residuals = springs @ kept - (masses @ kept) * values[:m]
    return Candidate(values, vectors), size(residuals, values[:m])


def lowest(stiffness, mass, shift, count):
    """Lowest modes of K y = lambda M y, or of all rows where `count` is None.

    Parameters
    ----------
    stiffness, mass : array (r, r)
        K + shift M is positive definite, else a LinAlgError says so. `mass` None stands for the identity.
    shift : float
    count : int or None

    Returns
    -------
    values : array (count,)
        Ascending; infinite for motions without mass.
    vectors : array (r, count)
        y' M y = 1, and y' K y = 1 for motions without mass.
    """
    n = len(stiffness)
    count = n if count is None else min(count, n)
    if mass is None:
        return eigh(stiffness, subset_by_index=[0, count - 1], check_finite=False)
    highest = [n - count, n - 1]
    inverses, vectors = eigh(mass, stiffness + shift * mass, subset_by_index=highest, check_finite=False)
    inverses, vectors = inverses[::-1], vectors[:, ::-1]
    has_mass = inverses > MASSLESS * inverses[0]
    values = np.full(count, np.inf)
    values[has_mass] = 1.0 / inverses[has_mass] - shift
    return values, vectors / np.sqrt(np.where(has_mass, inverses, 1.0))


def size(residuals, values) -> float:
    """The largest norm of residuals (PROBES, m) that the probes have seen, as a share of a mode's energy."""
    largest = np.sqrt((residuals**2).mean(axis=0) / values).max()
    return largest if np.isfinite(largest) else np.inf


def derivative_error(terms, basis, matrices, m, found) -> float:
    """How far derivatives of the kept modes lie outside the basis, by residuals along random directions.

    They solve (K - lambda M) dphi = -(dK - lambda dM) phi, in the basis by the other modes in it; what the
    kept ones have of it lies there in any case.
    """
    _, mass, springs, masses = matrices
    kept, others = found.vectors[:, :m], found.vectors[:, m:]
    values, above = found.values[:m], found.values[m:, None]
    gaps, largest = np.where(np.isinf(above), 1.0, above - values), 0.0
    for direction in terms.directions:
        loads = change(direction, basis.stiffness) @ kept
        residuals = change(direction, basis.spring_probes) @ kept
        if len(basis.mass) > 1:
            loads = loads - change(direction, basis.mass) @ kept * values
            residuals = residuals - change(direction, basis.mass_probes) @ kept * values
        moved = others @ (others.T @ loads / -gaps)
        residuals += springs @ moved - masses @ moved * values - masses @ kept @ (kept.T @ loads)
        largest = max(largest, size(residuals, values))
    return largest


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
        good &= have_mass(terms, lanes)[: len(places)]
    return [i for k, i in enumerate(places) if good[k]]


def have_mass(terms, lanes) -> np.ndarray:
    """In which lanes M is known to be definite, or diagonal and positive but where no structure has mass."""
    masses, above = terms.mass_entries, terms.pattern.rows.size
    if masses[:, :above].any():
        return count_below_lanes(terms.pattern, masses, masses, lanes, np.zeros((1, LANES))) == 0.0
    diagonal = masses[0, above:, None] + masses[1:, above:].T @ lanes
    return ((diagonal > 0.0) | ~masses[:, above:].any(axis=0)[:, None]).all(axis=0)


def with_signs(columns, vectors, m):
    """The vectors (r, > m), the lowest m so that the largest entry of each shape (n,) is positive."""
    shapes = columns @ vectors[:, :m]
    peaks = np.take_along_axis(shapes, abs(shapes).argmax(axis=0)[None], axis=0)
    return np.hstack([vectors[:, :m] * np.where(peaks < 0.0, -1.0, 1.0), vectors[:, m:]])
