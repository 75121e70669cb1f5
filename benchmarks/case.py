"""Inputs of one population evaluation: what every route to e_j is given."""

from dataclasses import dataclass, replace

import numpy as np

import pymc_features as pmf
from pymc_features.simulators import ChainParameters, Excitation, Outputs, chain_response

ALPHA, BETA = 0.2265, 6.7515e-4  # Rayleigh damping of the source's example [1/s], [s]
STIFFNESS = 1800.0  # N/m
NOISE = 0.05  # over the root mean square of each channel


@dataclass(frozen=True, eq=False)
class Case:
    """A population of chains under one record, with data.

    Attributes
    ----------
    stiffness : array (P, n)
        One chain a row [N/m]; the masses are 1 kg.
    acceleration : array (t,)
        Ground acceleration at steps of `dt` seconds.
    substeps : int
        Output steps for each step of the record.
    sensors : integer array (s,)
        Degrees of freedom whose absolute acceleration is compared.
    observed : array (s, N_D)
        Data.
    """

    stiffness: np.ndarray
    acceleration: np.ndarray
    dt: float
    substeps: int
    sensors: np.ndarray
    observed: np.ndarray

    @property
    def n_dof(self):
        """Degrees of freedom, all of whose modes are kept."""
        return self.stiffness.shape[1]

    @property
    def mass(self):
        """Masses [kg], shape (n,)."""
        return np.ones(self.n_dof)

    @property
    def rayleigh(self):
        """alpha and beta, shape (2,)."""
        return np.array([ALPHA, BETA])

    @property
    def settings(self):
        """Excitation and outputs, as the kernels take them."""
        excitation = Excitation(self.acceleration, self.dt, self.substeps, stride=1)
        return excitation, Outputs(self.sensors, self.n_dof, quantity=0)

    @property
    def step(self):
        """Step of the output [s]."""
        return self.dt / self.substeps

    @property
    def fine_acceleration(self):
        """Ground acceleration at the output steps, interpolated linearly, shape (N_D,)."""
        if self.substeps == 1:
            return self.acceleration
        positions = np.arange(self.observed.shape[1]) / self.substeps
        return np.interp(positions, np.arange(self.acceleration.size), self.acceleration)

    def first(self, particles):
        """The same case with the first few particles only."""
        return replace(self, stiffness=self.stiffness[:particles])

    @property
    def steps(self):
        """Particles times output steps."""
        return len(self.stiffness) * self.observed.shape[1]


def build(record, *, particles, n_dof=10, n_sensors=None, substeps=1, seed=0):
    """Return a case: the lowest three springs scaled by theta ~ U(0.5, 1.5), data from theta = 1.

    Sensors are spread evenly over the height; all degrees of freedom by default.
    """
    rng = np.random.default_rng(seed)
    acceleration = np.array(record.acceleration)  # for what may not be written kernels are compiled again
    sensors = np.unique(np.linspace(0, n_dof - 1, n_sensors or n_dof).round().astype(np.int64))
    nominal = np.full(n_dof, STIFFNESS)
    exact = chain_response(
        ChainParameters(np.ones(n_dof), nominal, np.array([ALPHA, BETA]), np.zeros(n_dof)),
        Excitation(acceleration, record.dt, substeps, stride=1),
        Outputs(sensors, n_dof, quantity=0),
    )
    scale = NOISE * np.sqrt(np.mean(exact**2, axis=1, keepdims=True))
    stiffness = np.tile(nominal, (particles, 1))
    stiffness[:, :3] *= rng.uniform(0.5, 1.5, (particles, 1))
    return Case(
        stiffness=stiffness,
        acceleration=acceleration,
        dt=record.dt,
        substeps=substeps,
        sensors=sensors,
        observed=exact + scale * rng.standard_normal(exact.shape),
    )


def record_of_length(n_times):
    """A record of a given number of samples at 0.02 s: white noise of 1 m/s^2, whose cost is any other's."""
    return pmf.Record(np.random.default_rng(n_times).standard_normal(n_times), 0.02)
