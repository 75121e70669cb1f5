"""A population of chains, `LANES` at a time: their constants into memory, and what a march says of them."""

import numpy as np

from pymc_features.simulators.numbers.vectors import LANES, aligned
from pymc_features.simulators.taylor.ground import Spans
from pymc_features.simulators.taylor.kinks import batch_size
from pymc_features.simulators.taylor.layout import (
    DASHPOT,
    DRAG,
    LOST,
    MAX_STEPS,
    MOBILITY,
    NO_TAPE,
    PEAK,
    RATE_SIGN,
    Z_SIGN,
    group_size,
    layout_of,
)

LARGEST = 1e100  # of a parameter: none overflows on its way
LEAST_PEAK = 1e-2  # of the accelerations of a chain over that of the ground: records begin at zero
FIRST_PHASE = 0.5  # largest product of step and rate of change at first


def modal_squares(mass, stiffness):
    """Squares of the frequencies (p, n), eigenvectors (p, n, n) and the matrix M^-1/2 K M^-1/2 (p, n, n)."""
    n = mass.shape[1]
    roots = np.sqrt(mass)
    above = np.concatenate([stiffness[:, 1:], np.zeros((len(mass), 1))], axis=1)
    matrix = np.zeros((len(mass), n, n))
    at = np.arange(n)
    matrix[:, at, at] = (stiffness + above) / mass
    matrix[:, at[1:], at[:-1]] = matrix[:, at[:-1], at[1:]] = -stiffness[:, 1:] / (
        roots[:, 1:] * roots[:, :-1]
    )
    return *np.linalg.eigh(matrix), matrix


def modal_damping(mass, stiffness, ratios):
    """M^-1 C (p, n, n) of modal ratios, for chains with masses (p, n) on springs (p, n)."""
    roots = np.sqrt(mass)
    squares, vectors, _ = modal_squares(mass, stiffness)
    weights = 2.0 * ratios * np.sqrt(np.maximum(squares, 0.0))
    damping = np.einsum("pir,pr,pjr->pij", vectors, weights, vectors)
    return damping * roots[:, None, :] / roots[:, :, None]


def largest_rate(mass, stiffness, rayleigh, ratios):
    """Upper bound (p,) of the rates of change of linear chains [1/s]: Gershgorin's, omega and damping."""
    above = np.concatenate([stiffness[:, 1:], np.zeros((len(mass), 1))], axis=1)
    omega = np.sqrt(2.0 * ((stiffness + above) / mass).max(axis=1))
    return omega * (1.0 + 2.0 * ratios.max(axis=1)) + rayleigh[:, 0] + rayleigh[:, 1] * omega**2


def is_linear_chain(parameters):
    """Whether the linear parameters of particles (p,) or (1,) are those of a chain, past doubt."""
    mass, stiffness, rayleigh, ratios, _ = parameters
    positive = [((x > 0.0) & (x < LARGEST)).all(axis=1) for x in (mass, stiffness)]
    damping = [((x >= 0.0) & (x < LARGEST)).all(axis=1) for x in (rayleigh, ratios)]
    return np.logical_and.reduce(np.broadcast_arrays(*positive, *damping))


class Lanes:
    """Memory of one group of chains with n springs, for a recurrence."""

    def __init__(self, group, series, n, n_sensors, has_modal_damping):
        self.series, self.n, self.layout = series, n, layout_of(series)
        self.records = aligned(group_size(series, n) * LANES).reshape(-1, LANES)
        self.kept = aligned(5 * (n + 1) * LANES)
        self.batch = aligned(batch_size(series) * LANES)
        self.sums = aligned(4 * n_sensors * LANES).reshape(n_sensors, 4, LANES)
        self.modal = aligned(n * n * LANES if has_modal_damping else 0).reshape(-1, LANES)
        modal = self.modal.ctypes.data if has_modal_damping else 0
        self.group = group(self.records.ctypes.data, self.kept.ctypes.data, modal, n)

    def fill(self, parameters, step, peak):
        """Bring chains, one in each lane, to rest; `step` [s], least `peak` of accelerations [m/s^2]."""
        mass, stiffness, rayleigh, ratios, values = parameters
        self.records[:] = 0.0
        self.sums[:] = 0.0
        springs = self.records[self.layout.record : (self.n + 1) * self.layout.record]
        springs = springs.reshape(self.n, self.layout.record, LANES)
        chain = self.records[(self.n + 1) * self.layout.record :]
        entries = springs[:, self.layout.entries :]
        entries[:, MOBILITY] = step**2 / mass.T
        entries[:, DASHPOT] = (rayleigh[:, 1:] * stiffness).T / step
        entries[:, RATE_SIGN] = entries[:, Z_SIGN] = 1.0
        for c, value in enumerate(self.series.constants(stiffness, values.swapaxes(0, 1))):
            springs[:, self.layout.constants + c] = value.T
        chain[DRAG] = rayleigh[:, 0] * step
        chain[PEAK] = peak
        if self.modal.size:
            damping = step * modal_damping(mass, stiffness, ratios)
            self.modal[:] = damping.transpose(1, 2, 0).reshape(-1, LANES)

    def march(self, march, chains, problem, tape) -> Spans:
        """March chains, one in each lane, through a record; see `march_population`. Returns its spans."""
        ground, wanted, observed = problem
        rate = largest_rate(*chains[:4]).max()
        spans = ground.spans(rate, self.series)
        length = spans.step * spans.widths[0]
        start = int(min(max(np.ceil(length * rate / FIRST_PHASE), 1), MAX_STEPS))
        self.fill(chains, length / start, LEAST_PEAK * ground.peak)
        addresses = self.batch.ctypes.data, self.sums.ctypes.data
        march(self.group, *addresses, start, spans, wanted, observed, tape)
        return spans

    @property
    def lost(self):
        """Which chains have been given up (LANES,)."""
        return self.records[(self.n + 1) * self.layout.record + LOST] > 0.0


def rows_of(parameters, members):
    """Rows of the parameters of some particles."""
    return [np.ascontiguousarray(p[members % len(p)]) for p in parameters]


def groups_of(members):
    """The particles in groups for the lanes, by their places in the population.

    Not by their places among the members: the steps of a particle go by its group, and its numbers must be
    the same wherever a population is cut at multiples of the lanes.
    """
    return np.split(members, np.flatnonzero(np.diff(members // LANES)) + 1)


def march_population(march, lanes, parameters, members, problem, result):
    """Write the statistics of particles into `result` (p, s, 4); return those lost, with neighbours.

    Parameters
    ----------
    march : callable
        Compiled: takes a group, addresses of its batch and sums, the number of steps to begin with, then
        what `problem` holds.
    lanes : Lanes
    parameters : tuple of array
        Mass, stiffness, Rayleigh pair, ratios and law, with a row for each particle, or one for all.
    members : integer array
        The particles, all of them structures.
    problem : tuple
        Ground acceleration (`spans.Ground`), outputs wanted and data.
    """
    lost = []
    for own in groups_of(members):
        lanes.march(march, rows_of(parameters, np.resize(own, LANES)), problem, NO_TAPE)
        result[own] = lanes.sums.transpose(2, 0, 1)[: len(own)]
        if lanes.lost.any():  # the steps of its neighbours went by it
            lost.append(own)
    return np.concatenate(lost) if lost else members[:0]
