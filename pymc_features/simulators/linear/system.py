"""A linear structure at one set of parameters: its matrices, and its modes with their damping and load."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features.algebra import assemble, is_definite, natural_modes, shifted_factor, spectral_shift
from pymc_features.simulators.linear.arguments import writable
from pymc_features.simulators.linear.dense import dense_modes
from pymc_features.simulators.oscillators_old.march import STIFFEST, classical_drag, feed_through

COUPLING = 1e-12  # off-diagonal entries of D below this times the largest are rounding


class System(NamedTuple):
    """Modes x = Phi q of a structure: q" + D q' + Omega^2 q = -Gamma a(t).

    Attributes
    ----------
    mass, damping, stiffness : array or csc_array (n, n)
        `damping` is None if classical.
    factor
        Of K + shift M, see `algebra.shifted_factor`, if they are sparse.
    omega : array (m,)
        [rad/s], exactly zero for rigid-body modes.
    shapes : array (n, m)
        Phi, mass-normalised columns.
    others : tuple of arrays or None
        omega and shapes of the modes left out, where they are at hand.
    drag : array (m,) or (m, m)
        D [1/s], its diagonal if the damping is classical.
    load : array (n, d)
        M influence - forces.
    participation : array (m, d)
        Gamma = Phi' load.
    """

    mass: np.ndarray
    damping: np.ndarray | None
    stiffness: np.ndarray
    factor: object
    omega: np.ndarray
    shapes: np.ndarray
    others: tuple | None
    drag: np.ndarray
    load: np.ndarray
    participation: np.ndarray


@np.errstate(over="ignore", invalid="ignore")
def solve_system(a, *, left_out=False, known=None) -> System | None:
    """Modes of a structure; None where the parameters describe none.

    Parameters
    ----------
    a : Arguments
    left_out : bool
        Whether all modes are wanted, if the matrices are dense.
    known : tuple of arrays, optional
        omega and shapes of a structure that is known to be admissible; the system is without factor then.
    """
    if not all(np.isfinite(values).all() for values in (a.theta, a.rayleigh, a.ratios)):
        return None
    n, m, factor, others = a.influence.shape[0], a.n_modes, None, None
    mass, stiffness = (assemble(stack, a.theta, a.rows, a.starts, n) for stack in (a.mass, a.stiffness))
    if known is None:
        every = left_out and m < n and a.is_dense
        factor, *known = admissible_modes(mass, stiffness, n if every else m)
        if not known:
            return None
        others = (known[0][m:], known[1][:, m:]) if every else None
    omega, shapes = known[0][:m], np.ascontiguousarray(known[1][:, :m])
    damping = None if a.is_classical else assemble(a.damping, a.theta, a.rows, a.starts, n)
    drag = modal_drag(a, mass, damping, omega, shapes)
    if drag is None or not max(omega.max(), abs(drag).max()) * a.step < STIFFEST:
        return None
    load = mass @ a.influence - a.forces
    return System(mass, damping, stiffness, factor, omega, shapes, others, drag, load, shapes.T @ load)


def admissible_modes(mass, stiffness, n_modes):
    """(factor, omega, shapes); None alone where M is not positive definite or some omega^2 is negative.

    The factor, of K + shift M, is None of dense matrices.
    """
    if not sparse.issparse(mass):
        omega, rows = np.empty(n_modes), np.empty((n_modes, mass.shape[0]))
        found = dense_modes(writable(mass), writable(stiffness), omega, rows)
        return (None, omega, rows.T) if found else (None,)
    if not (np.isfinite(mass.data).all() and np.isfinite(stiffness.data).all() and is_definite(mass)):
        return (None,)
    factor = shifted_factor(mass, stiffness)
    if factor is None:
        return (None,)
    try:
        return factor, *natural_modes(mass, stiffness, n_modes, factor)
    except (np.linalg.LinAlgError, RuntimeError):  # modes that cannot be found
        return (None,)


def modal_drag(a, mass, damping, omega, shapes):
    """D of the modes, (m,) or (m, m); None if it feeds energy into some motion."""
    if damping is None:
        drag = np.empty(omega.size)
        law = writable(a.rayleigh), writable(a.ratios)
        return drag if classical_drag(writable(omega), *law, a.step, drag) else None
    drag = shapes.T @ (damping @ shapes)
    if not np.isfinite(drag).all():
        return None
    lowest = np.linalg.eigvalsh(0.5 * (drag + drag.T))[0]
    return drag if lowest >= -spectral_shift(mass, damping) else None


def is_coupled(drag: np.ndarray) -> bool:
    """Whether damping, 2 zeta omega (m,) or D (m, m), couples the modes beyond rounding (1e-12)."""
    if drag.ndim == 1:
        return False
    off = drag - np.diag(np.diagonal(drag))
    return bool(abs(off).max() > COUPLING * abs(drag).max())


def observe(a, system):
    """Mode shapes at the outputs (s, m), and feed-through of the inputs (s, d)."""
    seen, moved = writable(a.sensors @ system.shapes), writable(a.sensors @ a.influence)
    pushed, direct = writable(system.shapes.T @ a.forces), np.empty(moved.shape)
    complete = a.n_modes == system.load.shape[0]
    feed_through(seen, writable(system.participation), pushed, moved, a.quantity, complete, direct)
    return seen, direct
