"""Beside a sampled posterior: the prior that it keeps in some directions, and Gaussians at its modes."""

import numpy as np

from pymc_features.smc import prior_points

N_PRIOR = 500  # prior draws that say what the data have added
UNDETERMINED = 0.7  # share of its prior variance that such a direction keeps
LOADING = 0.3  # of a parameter in a direction, beside the largest, to be named
N_GAUSSIAN = 20_000  # draws from the Gaussians at the modes; they cost no evaluation
QUANTILES = (0.05, 0.5, 0.95)
CLOSE, LEAST_EFFICIENCY = 0.1, 0.4  # error of quantiles and share of draws, of a posterior near its Gaussians


def undetermined(model, flat, names) -> list[str]:
    """Directions in which draws (n, d) are nearly as wide as the prior, on the sampled scale."""
    prior = prior_points(model, N_PRIOR, np.random.default_rng(1))
    scale = prior.std(axis=0)
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        return []
    # coordinates in which the prior is a unit sphere: variances beside one
    factor = np.linalg.cholesky(np.cov(prior / scale, rowvar=False).reshape(flat.shape[1], -1))
    shares, axes = np.linalg.eigh(np.atleast_2d(np.cov(np.linalg.solve(factor, (flat / scale).T))))
    found = []
    for share, axis in zip(shares[::-1], axes.T[::-1], strict=True):
        if share < UNDETERMINED:
            break
        loading = np.abs(axis)
        found.append(" with ".join(names[i] for i in np.flatnonzero(loading > LOADING * loading.max())))
    return list(dict.fromkeys(found))


def distance_to_modes(reference, flat):
    """How far the quantiles of Gaussians at the modes are from those of draws (n, d), on the sampled scale.

    Returns
    -------
    worst, error
        The coordinate that is furthest off, and by how much, over the 5-95 % width of its draws; None and NaN
        without modes.
    """
    modes = [] if reference is None else [mode for mode in reference.modes if mode.is_maximum]
    if not modes or flat is None:
        return None, np.nan
    rng = np.random.default_rng(2)
    log_weights = np.array([mode.log_evidence for mode in modes])
    weights = np.exp(log_weights - log_weights.max())
    counts = rng.multinomial(N_GAUSSIAN, weights / weights.sum())
    u = [
        mode.x + rng.standard_normal((n, len(mode.x))) @ mode.factor.T
        for mode, n in zip(modes, counts, strict=True)
    ]
    gaussian = np.quantile(reference.centre + reference.scale * np.concatenate(u), QUANTILES, axis=0)
    sampled = np.quantile(flat, QUANTILES, axis=0)
    errors = np.abs(gaussian - sampled).max(axis=0) / (sampled[-1] - sampled[0])
    worst = int(errors.argmax())
    return worst, float(errors[worst])


def closeness(name, error, efficiency) -> str:
    """A sentence on the quantiles of Gaussians at the modes."""
    close = error < CLOSE and efficiency > LEAST_EFFICIENCY
    return (
        f"{'yes' if close else 'no'}: quantiles of Gaussians at the modes are off by at most "
        f"{100 * error:.0f} % of the 5-95 % width ({name})"
    )
