"""Responses that the priors expect of a measured motion of the base, without anything compiled."""

import numpy as np

from pymc_features.update.plausibility.scale import transfer

QUANTILES = (0.05, 0.5, 0.95)
VALUES, FEWEST, MOST = 4e6, 20, 100  # numbers in memory; draws
SILENT = 4.0  # time constants after which nothing rings
LONGEST = 8  # lengths of the record


def prior_bands(base, dt: float, prior, dofs, quantity) -> np.ndarray:
    """Quantiles 5, 50 and 95 % (quantile, sensor, time) of responses of a structure that is at rest first.

    Of linear structures, by the transforms of a motion (time,) [m/s^2] and of draws of the modes, each with a
    damping ratio of its own; above half the sampling rate there is nothing.
    """
    n = len(base)
    draws = int(np.clip(VALUES / (n * len(dofs)), FEWEST, MOST))
    some = np.linspace(0, len(prior.frequencies) - 1, min(draws, len(prior.frequencies))).astype(int)
    decay = np.quantile(prior.ratios * prior.frequencies, 0.05) * 2.0 * np.pi
    ringing = SILENT / (max(decay, 1e-12) * dt)
    size = 1 << int(np.ceil(np.log2(n + min(ringing, (LONGEST - 1) * n))))
    spectrum, f = np.fft.rfft(base, size), np.fft.rfftfreq(size, dt)
    bands = np.empty((len(QUANTILES), len(dofs), n))
    for s, dof in enumerate(dofs):
        shares = prior.at_sensors([dof], quantity)[some]
        h = transfer(f, prior.frequencies[some], prior.ratios[some], shares, quantity)[0]
        bands[:, s] = np.quantile(np.fft.irfft(h * spectrum, size)[:, :n], QUANTILES, axis=0)
    return bands
