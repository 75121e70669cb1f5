"""Sensitivity A and variability B of the score, and what follows from them."""

from typing import NamedTuple

import numpy as np

from pymc_features.calibration.spectrum import ErrorModel, error_model

FLAT = 1e-10  # of the largest relative eigenvalue: directions that a likelihood cannot tell


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
    def claims(self) -> np.ndarray:
        """A^-1 (d, d), the covariance that the likelihood claims; zero along what it cannot tell."""
        whiten = whitening(self.information)
        return whiten @ whiten.T

    @property
    def covariance(self) -> np.ndarray:
        """A^-1 B A^-1 (d, d), that of the likelihood's maximum."""
        return self.claims @ self.variability @ self.claims

    @property
    def precision(self) -> np.ndarray:
        """A B^-1 A (d, d)."""
        whiten = whitening(self.information)
        varies = whiten.T @ self.variability @ whiten
        tells = self.information @ whiten
        return tells @ np.linalg.solve(varies, tells.T)


def sandwich(events, information) -> Sandwich:
    """A and B of independent events; `information` (d, d) is A."""
    models, variability = [], 0.0
    for event in events:
        model = error_model(
            event.whole(event.residuals),
            event.sensitivities,
            event.whole(event.response),
            None if event.measured is None else event.whole(event.sensitivities),
        )
        models.append(model)
        variability = variability + model.variability + of_scale(event)
    return Sandwich(information, variability, models)


def of_scale(event) -> np.ndarray:
    """Covariance (d, d) of what the scales add to the score, sum_jk (r_jk^2 - m_j / N) d ln s_j / dz.

    It is a sum over time, so that its covariance is that of N times the mean of a series.
    """
    used = np.flatnonzero(np.abs(event.of_scale).sum(axis=0))
    d = event.of_scale.shape[1]
    result = np.zeros((d, d))
    if not used.size:
        return result
    if event.measured is not None:
        kept, square = event.measured, event.residuals**2
        series = event.whole(square) - (square.sum(axis=1) / kept.sum(axis=1))[:, None]
        whole = np.repeat(event.of_scale[:, None, used], kept.shape[1], axis=1)
        parts = error_model(series, kept[..., None] * whole, None, whole)
        result[np.ix_(used, used)] = parts.variability
        return result
    series = np.einsum("st,sp->pt", event.residuals**2, event.of_scale[:, used])
    series -= series.mean(axis=1, keepdims=True)
    constant = np.repeat(np.eye(used.size)[:, None], series.shape[1], axis=1)
    result[np.ix_(used, used)] = error_model(series, constant, None).variability
    return result


def known(matrix) -> np.ndarray:
    """Parameters (d,) that a likelihood depends on."""
    diagonal = np.diag(matrix)
    return np.flatnonzero(diagonal > FLAT**2 * diagonal.max(initial=0.0))


def whitening(information) -> np.ndarray:
    """W (d, k) with W' A W = 1, for the k directions that A tells."""
    used = known(information)
    scale = np.sqrt(np.diag(information)[used])
    values, vectors = np.linalg.eigh(information[np.ix_(used, used)] / np.outer(scale, scale))
    keep = values > FLAT * values.max()
    result = np.zeros((len(information), keep.sum()))
    result[used] = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return result
