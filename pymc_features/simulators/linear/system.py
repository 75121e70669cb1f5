"""A linear structure at one set of parameters: its matrices, and its modes with their damping and load."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from pymc_features.algebra import massless_motions, natural_modes, shifted_factor, spectral_shift
from pymc_features.simulators.compiled.arrays import writable
from pymc_features.simulators.linear.arguments import Arguments
from pymc_features.simulators.linear.dense import dense_modes
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.numbers.vectors import LANES
from pymc_features.simulators.oscillators.modal_system import (
    STIFFEST,
    ModalSystem,
    highest_coupled_step,
    write_damping,
    write_feed,
)

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
        omega and shapes of the modes left out, where they are at hand; omega is infinite, and phi' K phi = 1,
        of motions without mass.
    modal_damping : array (m,) or (m, m)
        D [1/s], its diagonal 2 zeta omega if the damping is classical.
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
    modal_damping: np.ndarray
    load: np.ndarray
    participation: np.ndarray


@np.errstate(over="ignore", invalid="ignore")
def solve_system(a: Arguments, *, left_out=False, known=None) -> System | None:
    """Modes of a structure; None where the parameters describe none.

    Parameters
    ----------
    a : Arguments
    left_out : bool
        Whether all modes are wanted, if the matrices are dense.
    known : tuple of arrays, optional
        omega and shapes of a structure that is known to be admissible; the system is without factor then.
    """
    given, m, factor, others = a.parameters, a.wanted.n_modes, None, None
    if not given.is_finite:
        return None
    mass, stiffness = given.assemble(given.mass), given.assemble(given.stiffness)
    if known is None:
        every = left_out and m < given.n_dof and given.is_dense
        factor, *known = admissible_modes(mass, stiffness, given.n_dof if every else m)
        if not known:
            return None
        left_out &= given.is_dense and len(known[0]) == given.n_dof
    else:
        left_out = False
    if not given.is_classical:  # the ground takes along what is too fast to be stepped
        m = int(np.searchsorted(known[0][:m] * a.step, highest_coupled_step(a.excitation), side="right"))
    if left_out and m < given.n_dof:
        others = known[0][m:], known[1][:, m:]
    omega, shapes = known[0][:m], np.ascontiguousarray(known[1][:, :m])
    damping = None if given.is_classical else given.assemble(given.damping)
    modal_damping = project_damping(a, mass, damping, omega, shapes)
    if modal_damping is None or not given.is_classical and not abs(modal_damping).max() * a.step < STIFFEST:
        return None
    load = mass @ given.influence - given.forces
    participation = shapes.T @ load
    return System(mass, damping, stiffness, factor, omega, shapes, others, modal_damping, load, participation)


def solved(a: Arguments, particles, *, left_out=False, signed=False):
    """Yield number, `Arguments` and `System` of some particles of a population; None for no structure.

    Where the modes were found in a basis, see `reduced`, the arguments and the system are those of the
    structure reduced to it: dense, of as many degrees of freedom as the basis has columns.

    Parameters
    ----------
    a : Arguments
        Its sensors a matrix.
    particles : integer array
    left_out : bool
        Whether derivatives are asked for, which need what the modes that are left out add.
    signed : bool
        Whether shapes must be positive at their largest entry.
    """
    known = KNOWN.of(a.parameters, a.wanted.n_modes, len(particles), left_out=left_out)
    if known is None:
        for p in particles:
            own = a._replace(parameters=a.parameters.one_of(p))
            yield p, own, solve_system(own, left_out=left_out)
        return
    n_blocks = -(-len(particles) // LANES)
    for first in range(n_blocks):  # a block is from all of the population, which may be in order
        waiting = list(particles[first::n_blocks])
        while waiting:
            found, unknown = solved_in_basis(a, known, waiting, left_out, signed)
            for p, pair in found.items():
                yield p, *pair
            for p in unknown:
                own = a._replace(parameters=a.parameters.one_of(p))
                yield p, own, learnt(own, known, left_out)
            waiting = [p for p in waiting if p not in found and p not in unknown]


def solved_alone(a: Arguments, *, left_out=False) -> tuple:
    """`Arguments` and `System` of one structure, see `solved`."""
    population = a._replace(parameters=a.parameters.as_population())
    [(_, own, system)] = solved(population, [0], left_out=left_out)
    return own, system


def solved_in_basis(a, known, particles, left_out, signed) -> tuple:
    """Arguments and systems of those of up to `LANES` particles found in a basis, and which to solve in full.

    These are all others where nothing is learnt from them, otherwise the worst, before all is asked again.
    """
    given = a.parameters
    theta = np.stack([given.theta[p % given.theta.shape[0]] for p in particles])
    basis, found, errors = known.modes(theta, left_out=left_out, signed=signed)
    result = {}
    if found:
        wanted = a.wanted._replace(sensors=a.wanted.sensors @ basis.columns)
        a = a._replace(parameters=basis.reduced(given), wanted=wanted)
    for i, (omega, vectors) in found.items():
        own = a._replace(parameters=a.parameters.one_of(particles[i]))
        system = solve_system(own, known=(omega, vectors))
        if system is not None and left_out:
            kept = system.omega.size
            system = system._replace(others=(omega[kept:], vectors[:, kept:]))
        result[particles[i]] = own, system
    others = sorted((i for i in range(len(particles)) if i not in found), key=lambda i: -errors[i])
    return result, [particles[i] for i in (others if known.is_fixed else others[:1])]


def learnt(a: Arguments, known, left_out) -> System | None:
    """The system of a structure that is not found in a basis, whose modes join it."""
    given = a.parameters
    if not given.is_finite:
        return None
    mass, stiffness = given.assemble(given.mass), given.assemble(given.stiffness)
    factor, *modes = admissible_modes(mass, stiffness, a.wanted.n_modes if known.is_fixed else known.n_learnt)
    system = solve_system(a, known=modes) if modes else None
    if system is None:
        return None
    known.learn((mass, stiffness), (factor, *modes), left_out=left_out)
    return system._replace(factor=factor)


def admissible_modes(mass, stiffness, n_modes):
    """(factor, omega, shapes); None alone where M or an omega^2 is negative, or K fails where no mass is.

    The factor, of K + shift M, is None of dense matrices.
    """
    if not sparse.issparse(mass):
        omega, rows = np.empty(n_modes), np.empty((n_modes, mass.shape[0]))
        found = dense_modes(writable(mass), writable(stiffness), omega, rows)
        return (None, omega, rows.T) if found else (None,)
    if not (np.isfinite(mass.data).all() and np.isfinite(stiffness.data).all()):
        return (None,)
    massless = massless_motions(mass)
    if massless is None or not massless.rank or not massless.are_held(stiffness):
        return (None,)
    factor = shifted_factor(mass, stiffness)
    if factor is None:
        return (None,)
    try:
        return factor, *natural_modes(mass, stiffness, n_modes, factor, massless)
    except (np.linalg.LinAlgError, RuntimeError):  # modes that cannot be found
        return (None,)


def project_damping(a, mass, damping, omega, shapes):
    """D of the modes, (m,) or (m, m); None if it feeds energy into some motion."""
    if damping is None:
        diagonal, given = np.empty(omega.size), a.parameters
        rayleigh, ratios = writable(given.rayleigh), writable(given.ratios)
        return diagonal if write_damping(writable(omega), rayleigh, ratios, a.step, diagonal) else None
    projected = shapes.T @ (damping @ shapes)
    if not np.isfinite(projected).all():
        return None
    lowest = np.linalg.eigvalsh(0.5 * (projected + projected.T))[0]
    return projected if lowest >= -spectral_shift(mass, damping) else None


def is_coupled(modal_damping: np.ndarray) -> bool:
    """Whether damping, 2 zeta omega (m,) or D (m, m), couples the modes beyond rounding (1e-12)."""
    if modal_damping.ndim == 1:
        return False
    off = modal_damping - np.diag(np.diagonal(modal_damping))
    return bool(abs(off).max() > COUPLING * abs(modal_damping).max())


def uncoupled(modal_damping: np.ndarray) -> np.ndarray:
    """2 zeta omega (m,) of modes that the damping does not couple, without negative rounding errors."""
    if modal_damping.ndim == 1:
        return modal_damping
    return np.maximum(np.diagonal(modal_damping), 0.0)


def modes_at_outputs(a: Arguments, system: System) -> ModalSystem:
    """The modes as the outputs have them, with the diagonal of D."""
    return ModalSystem(
        writable(system.omega),
        writable(uncoupled(system.modal_damping)),
        writable(a.wanted.sensors @ system.shapes),
        writable(system.participation),
    )


def observe(a: Arguments, system: System) -> tuple[ModalSystem, np.ndarray]:
    """The modes as the outputs have them, and feed-through of the inputs (s, d)."""
    given, modes = a.parameters, modes_at_outputs(a, system)
    by_forces = writable((modes.shapes @ (system.shapes.T @ given.forces)).ravel())
    support_motion = writable(a.wanted.sensors @ given.influence)
    feed = np.empty(support_motion.shape)
    is_complete = system.omega.size == given.n_dof
    write_feed(modes, support_motion, a.wanted.quantity, is_complete, by_forces, feed)
    return modes, feed
