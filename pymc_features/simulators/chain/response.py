"""Response of a spring-mass chain, Eqs. (17)-(24), and its misfit from data."""

import numpy as np

from pymc_features.simulators.chain.modes import chain_modes
from pymc_features.simulators.compiled.jit import inline, jit
from pymc_features.simulators.oscillators.arguments import Excitation, n_outputs
from pymc_features.simulators.oscillators.modal_system import ModalSystem, feed_through
from pymc_features.simulators.oscillators.recursion import march_modes, statistics, write_damping


@jit
def check_sizes(parameters, wanted):
    """Refuse inputs whose sizes would make the kernels read outside their arrays."""
    mass, stiffness, rayleigh, ratios = parameters
    n_dof = mass.size
    if stiffness.size != n_dof or ratios.size != n_dof or rayleigh.size != 2:
        raise ValueError("`mass`, `stiffness` and damping `ratios` must have equal lengths")
    for j in range(wanted.sensors.size):
        if wanted.sensors[j] < 0 or wanted.sensors[j] >= n_dof:
            raise ValueError("`sensors` must be degrees of freedom of the structure")
    if wanted.n_modes < 1 or wanted.n_modes > n_dof:
        raise ValueError("`n_modes` must lie between 1 and the number of degrees of freedom")


@jit
def check_history(history, excitation, wanted):
    """Refuse data, or weights on the response, of another shape than the response's."""
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    if history.shape[0] != wanted.sensors.size or history.shape[1] != total:
        raise ValueError("`observed` or the cotangent must have the shape (sensor, time) of the response")


@jit
def ground_motion(excitation):
    """The excitation with its acceleration as one input (1, t)."""
    acceleration, dt, substeps, stride, direct = excitation
    return Excitation(acceleration.reshape(1, acceleration.size), dt, substeps, stride, direct)


@jit
def write_shapes(rows, sensors, shapes):
    """Write S Phi (s, m) from mode shapes in rows (n, n)."""
    for j in range(sensors.size):
        for r in range(shapes.shape[1]):
            shapes[j, r] = rows[r, sensors[j]]


@jit
def modes_of(parameters, step, wanted):
    """Modes of a chain, everything that the recursion needs once for each set of parameters.

    Parameters
    ----------
    parameters : ChainParameters
    step : float
        Of the recursion [s].
    wanted : Outputs

    Returns
    -------
    valid : bool
        False if the parameters describe no structure; the rest is undefined then.
    system : ModalSystem
        The modes kept.
    omega : array (n,)
        Of all modes [rad/s].
    rows : array (n, n)
        All mode shapes, mass-normalised, one in each row.
    """
    mass, stiffness, rayleigh, ratios = parameters
    n, m = mass.size, wanted.n_modes
    omega, participation, rows = np.empty(n), np.empty(n), np.zeros((n, n))
    damping, shapes = np.empty(m), np.empty((wanted.sensors.size, m))
    valid = chain_modes(mass, stiffness, omega, rows, participation)
    if valid:
        valid = write_damping(omega[:m], rayleigh, ratios, step, damping)
    write_shapes(rows, wanted.sensors, shapes)
    return valid, ModalSystem(omega[:m], damping, shapes, participation[:m].reshape(m, 1)), omega, rows


@jit
def write_feed(system, quantity, complete, feed):
    """Write the feed-through (s,) of the ground acceleration: zero for the absolute one with all modes."""
    for j in range(feed.size):
        by_modes = 0.0
        for r in range(system.omega.size):
            by_modes += system.shapes[j, r] * system.participation[r, 0]
        feed[j] = feed_through(1.0, 0.0, by_modes, quantity, complete)


@jit
def chain_feed(system, wanted, complete):
    """Feed-through (s, 1) of the ground acceleration."""
    feed = np.empty(wanted.sensors.size)
    write_feed(system, wanted.quantity, complete, feed)
    return feed.reshape(feed.size, 1)


@jit
def chain_response(parameters, excitation, wanted):
    """Response history (s, u) of a spring-mass chain, exact for an excitation linear between its samples.

    Parameters
    ----------
    parameters : ChainParameters
    excitation : Excitation
    wanted : Outputs

    Returns
    -------
    array (s, u)
        All NaN where the parameters describe no structure.
    """
    check_sizes(parameters, wanted)
    total = n_outputs(excitation.acceleration.size, excitation.substeps, excitation.stride)
    history = np.empty((wanted.sensors.size, total))
    valid, system, omega, _ = modes_of(parameters, excitation.dt / excitation.substeps, wanted)
    if valid:
        feed, motion = chain_feed(system, wanted, wanted.n_modes == omega.size), ground_motion(excitation)
        march_modes(system, feed, motion, wanted.quantity, history, history, np.empty((1, 0)))
    else:
        history[:] = np.nan
    return history


@inline
def compare(parameters, excitation, wanted, observed, n_statistics):
    """Statistics (s, 1) or (s, 4) of the misfit, see `oscillators.misfit`; NaN where there is no structure.

    Memory: a few blocks of 128 samples, whatever the length of the record.
    """
    check_sizes(parameters, wanted)
    check_history(observed, excitation, wanted)
    sums = np.zeros((n_statistics, wanted.sensors.size))
    valid, system, omega, _ = modes_of(parameters, excitation.dt / excitation.substeps, wanted)
    if valid:
        feed, motion = chain_feed(system, wanted, wanted.n_modes == omega.size), ground_motion(excitation)
        march_modes(system, feed, motion, wanted.quantity, observed, np.empty((0, 0)), sums)
    else:
        sums[:] = np.nan
    return statistics(sums, observed.shape[1])


@jit
def chain_discrepancy(parameters, excitation, wanted, observed):
    """e_j = (1/N_D) sum_k [y_j(k) - g_j(k; theta)]^2 (s,), Eq. (3), of data (s, u) in its unit."""
    return compare(parameters, excitation, wanted, observed, 1)[:, 0].copy()


@jit
def chain_misfit(parameters, excitation, wanted, observed):
    """What the log-density of errors correlated in time needs of the misfit r = y - g: (s, 4).

    e_j, the sum of the squared increments r(k) - r(k - 1) over N_D, the first misfit and the last.
    """
    return compare(parameters, excitation, wanted, observed, 4)
