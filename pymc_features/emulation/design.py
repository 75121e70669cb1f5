"""Design of runs: first all over the prior, then where the posterior is and where it is unknown."""

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
    """Contribution (n, process) of each process to the variance of the log-likelihood at points (n, d).

    By components one standard deviation up and down, with random signs where several share a process: slope
    and curvature of any likelihood.
    """
    none = [np.zeros(len(response.emulator.basis)) for response in campaign.responses]
    here, parts = campaign.log_likelihood(theta, none), []
    for i, response in enumerate(campaign.responses):
        for group in response.emulator.groups:
            sides = []
            signs = rng.choice([-1.0, 1.0], size=group.stop - group.start)
            for side in (1.0, -1.0):
                shifts = [shift.copy() for shift in none]
                shifts[i][group] = side * signs
                sides.append(campaign.log_likelihood(theta, shifts))
            with np.errstate(invalid="ignore"):
                parts.append((0.5 * (sides[0] - sides[1])) ** 2 + 0.5 * (sum(sides) - 2.0 * here) ** 2)
    parts = np.stack(parts, axis=1)
    return np.where(np.isfinite(parts), parts, 0.0)


def candidates(campaign, draws, rng):
    """Points to choose from (n, d): draws from the posterior, and what may belong to it for all one knows."""
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
    noises, covariances = [], []
    for response in campaign.responses:
        coordinates = response.coordinates(response.x_of(points))
        for process in response.emulator.processes:
            noises.append(process.noise)
            covariances.append(process.covariance(coordinates))
    variances = np.stack([np.diag(c) for c in covariances], axis=1)
    parts = uncertainty(campaign, points, rng)
    per_unit = parts / np.maximum(variances, 1e-12)
    per_unit /= (1.0 + parts.sum(axis=1))[:, None]  # much uncertainty is no better than all
    chosen = []
    for _ in range(n):
        gain = np.zeros(len(points))
        for g, (covariance, noise) in enumerate(zip(covariances, noises, strict=True)):
            reduced = covariance**2 / (np.diag(covariance) + noise)
            gain += per_unit[:, g] @ reduced
        gain[chosen] = -np.inf
        best = int(gain.argmax())
        chosen.append(best)
        for g, noise in enumerate(noises):
            column = covariances[g][:, best]
            covariances[g] = covariances[g] - np.outer(column, column) / (column[best] + noise)
    return points[chosen]
