"""Fits of the chain to one record without a compiled model: each event and each step is another record."""

import numpy as np

import pymc_features as pmf
from benchmarks.coverage.chain import N_FACTORS, PRIOR_WIDTH, structure
from benchmarks.coverage.intervals import calibrated, of_density
from pymc_features.calibration.residuals import Comparison, Coordinates

LARGEST = 10.0  # |ln theta| that is tried


class Predictions:
    """What `pymc_features.calibration.residuals` asks of a model: NORM with ln theta (3,) and ln sigma."""

    def __init__(self, record, data, dt):
        self.record, self.data, self.dt = record, data, dt
        self.count = 0
        none = np.zeros(N_FACTORS + 1, dtype=int)
        self.coordinates = Coordinates(none, none > 0, 1.0 * none)

    def __call__(self, z):
        """The only likelihood, at a point (4,)."""
        self.count += 1
        mu = pmf.simulate(structure(np.exp(z[:N_FACTORS])), self.record, dt=self.dt).values
        n_times = self.data.shape[1]
        return [Comparison(mu, self.data, np.exp(z[-1]), n_times, step=self.dt).by_sensor()]

    def frequencies(self, z):
        """Natural frequencies [Hz] of the only likelihood's structure, at a point (4,)."""
        return [structure(np.exp(z[:N_FACTORS])).modes().natural_frequencies]


class Target:
    """Posterior density of ln theta (3,) and ln sigma of one record."""

    def __init__(self, record, data, dt):
        self.record, self.data, self.dt = record, data, dt
        self.size = data.size
        self.n_times = data.shape[1]

    def misfit(self, theta):
        """S, the sum of e_j."""
        mu = pmf.simulate(structure(theta), self.record, dt=self.dt).values
        return float(np.sum((self.data - mu) ** 2)) / self.n_times

    def log_prior(self, z):
        """Of points (n, 4): factors log-normal, sigma uniform."""
        return z[:, -1] - 0.5 * np.sum((z[:, :N_FACTORS] / PRIOR_WIDTH) ** 2, axis=1)

    def log_likelihood(self, z):
        """NORM of points (n, 4)."""
        s = np.array([self.misfit(x) for x in np.exp(z[:, :N_FACTORS].clip(-LARGEST, LARGEST))])
        value = -0.5 * self.n_times * s * np.exp(-2.0 * z[:, -1]) - self.size * z[:, -1]
        return np.where(np.isfinite(value), value, -np.inf)

    def __call__(self, z):
        return self.log_prior(z) + self.log_likelihood(z)


def start_of(record, data, dt):
    """A point (4,) to climb from: factors of one, and the sigma that they leave."""
    residual = data - pmf.simulate(structure(np.ones(N_FACTORS)), record, dt=dt).values
    return np.append(np.zeros(N_FACTORS), 0.5 * np.log(np.mean(residual**2)))


def norm_and_cal(record, data, dt, start, rng):
    """Intervals of theta by NORM and CAL, and its most likely value (3,)."""
    target = Target(record, data, dt)
    cal = calibrated(Predictions(record, data, dt), start, N_FACTORS)
    density = cal.density(target.log_prior, target.log_likelihood)
    found = {
        "NORM": of_density(target, cal.point, cal.claimed_factor, N_FACTORS, rng),
        "CAL": of_density(density, cal.point, cal.factor, N_FACTORS, rng),
    }
    found = {k: x._replace(ends=np.exp(x.ends), draws=np.exp(x.draws)) for k, x in found.items()}
    return found, np.exp(cal.point[:N_FACTORS])
