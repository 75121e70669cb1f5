"""The constant matrices of a linear structure, dense or sparse, checked one by one and together."""

import warnings
from itertools import zip_longest
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg import eigh

from pymc_features._checks import as_array, as_numbers, check_finite, message
from pymc_features.algebra import (
    Massless,
    condense,
    definite_factor,
    massless_motions,
    shifted_factor,
    softest_motion,
    spectral_shift,
    to_dense,
)

type MatrixLike = ArrayLike | sparse.sparray | sparse.spmatrix

UNITS = {"mass": "kg", "damping": "N s/m", "stiffness": "N/m"}
SYMMETRY = 1e-10  # largest difference between A and A' over the largest entry that counts as rounding
PROPORTIONAL = 1e-10  # the same, between damping and a multiple of the stiffness
LOST = 1e-13  # of the largest stiffness over mass: eigenvalues below were wrong by 0.3 %, all below 1e-15
FEW = 6  # degrees of freedom that a message names
TAKES_PART = 1e-6  # share of the largest displacement of a motion from which one is named


def as_matrix(value, name: str, unit: str, *, n: int | None = None, symmetric: bool = True, thin=False):
    """Return a square matrix of numbers as a float64 array or `csc_array` of its own, checked.

    Parameters
    ----------
    value : array_like (n, n), sparse matrix (n, n) or array_like (n,)
        A vector stands for a diagonal matrix.
    name, unit : str
        For messages.
    n : int, optional
        Number of rows it must have.
    thin : bool
        Whether a vector becomes a sparse diagonal matrix.
    symmetric : bool
        Whether it must be symmetric; what is so up to rounding is made so exactly.
    """
    matrix = _numbers(value, name, unit)
    if matrix.ndim == 1 and matrix.size:
        matrix = sparse.csc_array(sparse.diags_array(matrix)) if thin else np.diag(matrix)
    advice = "Give one row and one column for each degree of freedom."
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] == 0:
        raise ValueError(message(name, "a square matrix", f"shape {matrix.shape}", advice))
    if n not in (None, matrix.shape[0]):
        what = f"`{name}` must have shape ({n}, {n}) to match `stiffness`"
        raise ValueError(f"{what}, got {matrix.shape}. {advice}")
    if not np.isfinite(matrix.data if sparse.issparse(matrix) else matrix).all():
        raise ValueError(message(name, "finite", "NaN or infinity", f"Pass entries in {unit}."))
    return _symmetrised(matrix, name) if symmetric else matrix


def _numbers(value, name, unit):
    matrix = value if sparse.issparse(value) else as_array(value)
    if matrix.dtype.kind not in "iuf":
        advice = (
            f"Pass an array or a SciPy sparse matrix in {unit}; what is random goes into the `theta` of an "
            "AffineStructure."
        )
        raise TypeError(message(name, "a matrix of real numbers", type(value).__name__, advice))
    if sparse.issparse(matrix):
        return sparse.csc_array(matrix, dtype=np.float64, copy=True)
    return matrix.astype(np.float64)


def _symmetrised(matrix, name):
    difference = abs(matrix - matrix.T)
    if difference.max() > SYMMETRY * abs(matrix).max():
        flat = difference.toarray() if sparse.issparse(difference) else difference
        i, j = np.unravel_index(flat.argmax(), flat.shape)
        i, j = sorted((int(i), int(j)))
        raise ValueError(
            f"`{name}` must be symmetric, got {matrix[i, j]:g} in row {i}, column {j} and "
            f"{matrix[j, i]:g} in row {j}, column {i}. Where only one triangle is stored, add its transpose."
        )
    half = 0.5 * (matrix + matrix.T)
    return sparse.csc_array(half) if sparse.issparse(half) else half


def as_influence(value, n: int) -> np.ndarray:
    """Return displacements (n,) or (n, supports) under unit displacements of the supports, checked."""
    value = np.ones(n) if value is None else to_dense(value)
    influence = as_numbers(value, "influence", "Pass displacement ratios [-]; they cannot be random.")
    if influence.ndim not in (1, 2) or influence.shape[0] != n or influence.size == 0:
        raise ValueError(
            f"`influence` must have shape ({n},) or ({n}, supports), got {influence.shape}. "
            "Give the displacement of every degree of freedom under a unit displacement of each support."
        )
    check_finite(influence, "influence", "Pass displacement ratios [-].")
    return influence


def check_mass(mass) -> Massless:
    """Refuse a mass matrix with a negative eigenvalue, or without any mass; return what it does not move."""
    massless = massless_motions(mass)
    if massless is not None and massless.rank:
        return massless
    diagonal = mass.diagonal()
    i, got = int(diagonal.argmin()), "an indefinite matrix"
    if diagonal[i] < 0.0:
        got = f"{diagonal[i]:g} kg at degree of freedom {i}"
    elif massless is not None:
        got = "zeros"
    raise ValueError(
        f"`mass` must be positive semi-definite and not zero, got {got}. Check the signs; degrees of freedom "
        "without mass have rows of zeros."
    )


def check_static(stiffness, massless: Massless) -> None:
    """Refuse motions with neither mass nor stiffness."""
    if massless.are_held(stiffness):
        return
    energy, motion = softest_motion(stiffness, massless)
    moved = np.flatnonzero(abs(motion) > TAKES_PART * abs(motion).max())
    got = "negative" if energy < -SYMMETRY else "no"
    raise ValueError(
        f"`stiffness` must be positive definite where there is no mass, got {got} stiffness for a motion of "
        f"{named(moved)}. Give it mass, attach an element, or remove it."
    )


def named(dofs) -> str:
    """The first of some degrees of freedom, in words."""
    shown = dofs if len(dofs) <= FEW else [*dofs[:FEW], f"{len(dofs) - FEW} others"]
    return f"degree{'s' if len(dofs) > 1 else ''} of freedom {in_words(shown)}"


def in_words(names) -> str:
    """Names with commas and an "and"."""
    *rest, last = map(str, names)
    return f"{', '.join(rest)} and {last}" if rest else last


def check_stiffness(mass, stiffness, massless: Massless):
    """Refuse K with a negative omega^2; return the factor of K + shift M, definite if K is admissible."""
    check_static(stiffness, massless)
    factor = shifted_factor(mass, stiffness)
    if factor is None:
        got = "a negative pivot"
        if not sparse.issparse(stiffness):
            if massless.dofs.size:
                _, mass, stiffness = condense(mass, stiffness, massless)
            lowest = eigh(stiffness, mass, eigvals_only=True, subset_by_index=[0, 0])[0]
            got = f"omega^2 = {lowest:.4g} (rad/s)^2 as the lowest eigenvalue"
        raise ValueError(
            f"`stiffness` must have no negative eigenvalue, got {got}. "
            "Check the signs of the elements; rigid-body modes (omega = 0) are welcome."
        )
    return factor


def warn_of_lost_digits(mass, stiffness, omega) -> None:
    """Warn where stiff parts leave no digits to soft ones in the sums that a matrix holds."""
    masses, springs = mass.diagonal(), stiffness.diagonal()
    ratios = np.divide(springs, masses, out=np.full(len(masses), np.nan), where=masses > 0.0)
    if np.isnan(ratios).all():
        return
    limit = LOST * np.nanmax(ratios)
    elastic = omega[omega > 0.0]
    if (elastic**2 < limit).any() or (len(elastic) < len(omega) and np.nanmin(ratios) < limit):
        warnings.warn(
            f"frequencies below {np.sqrt(limit) / (2.0 * np.pi):.3g} Hz are lost to rounding beside the "
            f"stiffness at {named([int(np.nanargmax(ratios))])}. Lower it, for parts 1e6 times as stiff as "
            "those around them are as good as rigid, or declare a chain as SpringMassChain.",
            skip_file_prefixes=(str(Path(__file__).parents[1]),),
        )


def check_damping(mass, damping, stiffness, massless: Massless) -> None:
    """Refuse a damping matrix that feeds energy into some motion, x' C x < 0."""
    symmetric = 0.5 * (damping + damping.T)
    raised = symmetric + spectral_shift(mass, symmetric) * mass
    if massless.dofs.size:  # where nothing but the stiffness need be there
        raised = raised + spectral_shift(stiffness, symmetric) * stiffness
    if definite_factor(raised) is None:
        raise ValueError(
            "`damping` must not feed energy into any motion, got a matrix whose symmetric part has a "
            "negative eigenvalue. Check the signs of the dashpots."
        )


def check_static_damping(dampings, stiffnesses, massless: Massless) -> None:
    """Refuse dashpots on what has no mass, unless C_i is the same multiple of K_i there for all i.

    Then N' C phi = beta N' K phi = 0 of all modes, and what has no mass follows as statically as without C.
    """
    if not massless.dofs.size:
        return
    pairs = [
        (massless.motions.T @ damping, massless.motions.T @ stiffness)
        for damping, stiffness in zip_longest(dampings, stiffnesses, fillvalue=0.0 * stiffnesses[0])
    ]
    square = sum((stiffness * stiffness).sum() for _, stiffness in pairs)
    beta = sum((damping * stiffness).sum() for damping, stiffness in pairs) / (square or 1.0)
    size = sum(abs(damping).sum(axis=1) for damping, _ in pairs)
    wrong = sum(abs(damping - beta * stiffness).sum(axis=1) for damping, stiffness in pairs)
    wrong = np.flatnonzero(wrong > PROPORTIONAL * size.max())
    if wrong.size:
        raise ValueError(
            "`damping` must be zero where there is no mass, or a multiple of `stiffness`, got dashpots at "
            f"{named(np.sort(massless.dofs[wrong]))}. Add mass, or pass RayleighDamping or ModalDamping."
        )


def check_static_forces(forces, picked, massless: Massless) -> None:
    """Refuse forces (n, d) on what has no mass if it is asked for: degrees of freedom (s,) or rows (s, n)."""
    seen = massless.motions[picked] if picked.ndim == 1 else picked @ massless.motions
    loaded = np.flatnonzero(abs(massless.motions.T @ forces).sum(axis=1))
    if loaded.size and abs(seen).sum():
        raise ValueError(
            "`sensors` must lie on mass if a force acts where there is none, got forces at "
            f"{named(np.sort(massless.dofs[loaded]))}. Ask for other sensors, or add mass: what has none "
            "follows the force at once, with velocities as rough as its rate."
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
