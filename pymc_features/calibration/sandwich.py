"""Sensitivity A and variability B of the score, and what follows from them."""

from typing import NamedTuple

import numpy as np

from pymc_features.calibration.spectrum import ErrorModel, error_model


class Sandwich(NamedTuple):
    """How much the likelihood claims to know, and how much its score varies.

    Attributes
    ----------
    information : array (d, d)
        A, minus the Hessian of the log-likelihood.
    variability : array (d, d)
        B, the covariance of the score; A if the likelihood's assumptions hold.
    models : list of ErrorModel
        Of each event.
    """

    information: np.ndarray
    variability: np.ndarray
    models: list[ErrorModel]

    @property
    def precision(self) -> np.ndarray:
        """A B^-1 A (d, d): the inverse covariance of the likelihood's maximum."""
        half = np.linalg.solve(root(self.variability), self.information)
        return half.T @ half


def root(matrix) -> np.ndarray:
    """Lower Cholesky factor of a covariance, a little rounder where it is singular to rounding."""
    scale = np.sqrt(np.diag(matrix)).clip(min=np.finfo(float).tiny)
    relative = matrix / np.outer(scale, scale)
    return scale[:, None] * np.linalg.cholesky(relative + 1e-12 * np.eye(len(matrix)))


def sandwich(events, information) -> Sandwich:
    """A and B of independent events; `information` (d, d) is A."""
    models, variability = [], 0.0
    for event in events:
        model = error_model(event.residuals, event.sensitivities, event.response)
        models.append(model)
        variability = variability + model.variability + of_scale(event)
    return Sandwich(information, variability, models)


def of_scale(event) -> np.ndarray:
    """Covariance (d, d) of the score that belongs to the scales: sum (r^2 - m / N) d ln s / dz.

    The squares of the residuals are a series of which the sum is known; theirs is the covariance of that.
    """
    used = np.flatnonzero(np.abs(event.of_scale).sum(axis=0))
    d = event.of_scale.shape[1]
    result = np.zeros((d, d))
    if not used.size:
        return result
    series = np.einsum("st,sp->pt", event.residuals**2, event.of_scale[:, used])
    series -= series.mean(axis=1, keepdims=True)
    constant = np.repeat(np.eye(used.size)[:, None], series.shape[1], axis=1)
    result[np.ix_(used, used)] = error_model(series, constant, None).variability
    return result
