"""Which matrices are admissible for a structure, and what to say of those that are not."""

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from pymc_features.algebra import is_definite, shifted_factor, spectral_shift


def check_mass(mass) -> None:
    """Refuse a mass matrix that is not positive definite."""
    if is_definite(mass):
        return
    diagonal = mass.diagonal()
    i = int(diagonal.argmin())
    got = f"{diagonal[i]:g} kg at degree of freedom {i}" if diagonal[i] <= 0.0 else "an indefinite matrix"
    raise ValueError(
        f"`mass` must be positive definite, got {got}. Condense degrees of freedom without mass."
    )


def check_stiffness(mass, stiffness):
    """Refuse K with a negative omega^2; return the factor of K + shift M, definite if K is admissible."""
    factor = shifted_factor(mass, stiffness)
    if factor is None:
        got = "a negative pivot"
        if not sparse.issparse(stiffness):
            lowest = eigh(stiffness, mass, eigvals_only=True, subset_by_index=[0, 0])[0]
            got = f"omega^2 = {lowest:.4g} (rad/s)^2 as the lowest eigenvalue"
        raise ValueError(
            f"`stiffness` must have no negative eigenvalue, got {got}. "
            "Check the signs of the elements; rigid-body modes (omega = 0) are welcome."
        )
    return factor


def check_damping(mass, damping) -> None:
    """Refuse a damping matrix that feeds energy into some motion, x' C x < 0."""
    symmetric = 0.5 * (damping + damping.T)
    if not is_definite(symmetric + spectral_shift(mass, symmetric) * mass):
        raise ValueError(
            "`damping` must not feed energy into any motion, got a matrix whose symmetric part has a "
            "negative eigenvalue. Check the signs of the dashpots."
        )


def check_connected(mass, damping, stiffness) -> None:
    """Refuse a degree of freedom that nothing touches: no spring, no dashpot, no shared mass."""
    touched = abs(mass).sum(axis=1) - abs(mass.diagonal()) + abs(stiffness).sum(axis=1)
    if damping is not None:
        touched = touched + abs(damping).sum(axis=1)
    free = np.flatnonzero(np.asarray(touched).ravel() == 0.0)
    if free.size:
        raise ValueError(
            f"`stiffness` must hold every degree of freedom, got a row of zeros for {free[0]}"
            f"{' and others' if free.size > 1 else ''}. Remove the degree of freedom or attach an element; "
            "a structure may move as a whole, but not a node by itself."
        )
