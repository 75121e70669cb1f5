"""Where to run: first all over the prior, then where the posterior is and where it is unknown."""

import warnings

import numpy as np
from scipy import stats

from pymc_features.inference.unit_cube import unit_cube
from pymc_features.smc import prior_points

WIDER, DEGREES = 1.5, 4.0  # of the Student-t around the posterior's draws, for what the emulator may miss
DOUBT = 2.0  # standard deviations by which a likelihood may be larger than expected
EDGE = 0.02  # share of the posterior's draws that are taken for its edge
TARGETS = 400


def first_points(model, space, n, rng):
    """Points (n, d) all over the prior: Sobol's in its unit cube, or draws where it has no cube."""
    d = len(space.join(space.point))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", "RandomVariables .* were found in the derived graph", UserWarning
            )
            cube = unit_cube(model, space, {})
    except ValueError:
        return prior_points(model, n, rng)
    sobol = stats.qmc.Sobol(d, rng=rng)
    u = sobol.random_base2(max(1, int(np.ceil(np.log2(n)))))[:n]
    [theta] = cube.to_theta(np.clip(u, 1e-6, 1.0 - 1e-6))
    return theta


def uncertainty(campaign, theta, rng):
    """Contribution (n, group) of each process to the variance of the log-likelihood at points (n, d).

    By components one standard deviation up and down, with random signs where several share a process: slope and
    curvature of any likelihood.
    """
    emulator = campaign.stand_in.emulator
    here = campaign.log_likelihood(theta, np.zeros(len(emulator.basis)))
    parts = np.zeros((len(theta), len(emulator.groups)))
    for g, group in enumerate(emulator.groups):
        shift = np.zeros(len(emulator.basis))
        shift[group] = rng.choice([-1.0, 1.0], size=group.stop - group.start)
        up, down = (campaign.log_likelihood(theta, sign * shift) for sign in (1.0, -1.0))
        with np.errstate(invalid="ignore"):
            parts[:, g] = (0.5 * (up - down)) ** 2 + 0.5 * (up + down - 2.0 * here) ** 2
    return np.where(np.isfinite(parts), parts, 0.0)


def candidates(campaign, draws, rng):
    """Points to choose from (n, d): draws from the posterior, and what may belong to it if the emulator errs."""
    draws = draws[rng.permutation(len(draws))[:TARGETS]]
    spread = WIDER**2 * np.cov(draws, rowvar=False).reshape(draws.shape[1], -1)
    wide = stats.multivariate_t(draws.mean(axis=0), spread, DEGREES, allow_singular=True, seed=rng)
    wide = np.reshape(wide.rvs(TARGETS), (-1, draws.shape[1]))
    log_posterior = [np.sum(campaign.logp(points)[:2], axis=0) for points in (draws, wide)]
    edge = np.quantile(log_posterior[0], EDGE)
    some = np.flatnonzero(np.isfinite(log_posterior[1]))
    deviation = np.sqrt(uncertainty(campaign, wide[some], rng).sum(axis=1))
    possible = some[log_posterior[1][some] + DOUBT * deviation > edge]
    return np.concatenate([draws, wide[possible]])


def next_points(campaign, draws, n, rng):
    """Points (n, d) that teach most about the posterior, chosen one after the other.

    Each is the one that lowers the variance of the log-likelihood most, on average over what is or may be the
    posterior, given those chosen before: a Gaussian process's variance does not depend on what is found.
    """
    points = candidates(campaign, draws, rng)
    emulator = campaign.stand_in.emulator
    coordinates = emulator.coordinates(campaign.x_of(points))
    covariances = [process.covariance(coordinates) for process in emulator.processes]
    variances = np.stack([np.diag(c) for c in covariances], axis=1)
    parts = uncertainty(campaign, points, rng)
    per_unit = parts / np.maximum(variances, 1e-12)
    per_unit /= (1.0 + parts.sum(axis=1))[:, None]  # much uncertainty is no better than all
    chosen = []
    for _ in range(n):
        gain = np.zeros(len(points))
        for g, (covariance, process) in enumerate(zip(covariances, emulator.processes, strict=True)):
            reduced = covariance**2 / (np.diag(covariance) + process.noise)
            gain += per_unit[:, g] @ reduced
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        for g, process in enumerate(emulator.processes):
            column = covariances[g][:, best]
            covariances[g] = covariances[g] - np.outer(column, column) / (column[best] + process.noise)
    return points[chosen]
