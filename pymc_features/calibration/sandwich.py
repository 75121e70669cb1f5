"""Sensitivity A and variability B of the score, and what follows from them.

B grows where the frequency bands of a record disagree about the parameters. With u_b the part of the score in
a band b, and B_b its covariance by the residuals,

    growth = sqrt(max(1, chi2 / (k - p))),
    chi2 = min_d sum_b (u_b - A_b d)' B_b^-1 (u_b - A_b d),

of k components of the score over all bands and p parameters, is by how much intervals must grow for the bands
to agree (Birge, Phys. Rev. 40, 1932). A_b d is how a change d of the parameters changes u_b: the fit weighs
samples, and not bands by their errors. It is about one for errors that spectra describe, and more where the
model is not the structure. Bands lie between the natural frequencies of the model.
"""

from typing import NamedTuple

import numpy as np

from pymc_features.calibration.spectrum import ErrorModel, error_model

FLAT = 1e-10  # of the largest relative eigenvalue: directions that a likelihood cannot tell
MOST_BANDS = 5  # the last one holds all frequencies above
HIGHEST = 0.45  # of the sampling rate: frequencies above divide no bands
FAINT, SINGULAR = 1e-9, 1e-3  # of a parameter's variance, of the largest eigenvalue: not counted
LARGEST = 2.0  # factor that intervals grow by
NOTABLE = 1.5  # factor that is worth a word


class Sandwich(NamedTuple):
    """How much the likelihood claims to know, and how much its score varies."""

    information: np.ndarray  # A (d, d), minus the Hessian of the log-likelihood
    variability: np.ndarray  # B (d, d), covariance of the score; A if the likelihood's assumptions hold
    models: list[ErrorModel]  # of each event
    growth: float = np.nan  # by how much the frequency bands disagree; NaN where there are none
    of_response: np.ndarray | float = np.nan  # the part of B (d, d) that the responses have

    @property
    def factor(self) -> float:
        """By which the disagreement of bands makes intervals wider."""
        return 1.0 if np.isnan(self.growth) else min(LARGEST, self.growth)

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
        values, vectors = directions(self.information, self.variability)
        along = self.information @ vectors
        return (along / values) @ along.T


def sandwich(events, model_error="bands", leverage=True) -> Sandwich:
    """A, by Gauss and Newton, and B of independent events.

    `model_error` "bands" lets the width grow where frequency bands disagree, None does not; `leverage` puts
    back what the fit took out of the residuals.
    """
    whiten = whitening(sum(event.of_response for event in events))
    models = [
        error_model(
            event.whole(event.residuals),
            event.sensitivities,
            event.whole(event.value.mu),
            event.whole(event.sensitivities),
            edges_of(event),
            whiten if leverage and whiten.size else None,
        )
        for event in events
    ]
    growth = growth_of(models, whiten.shape[1]) if model_error else np.nan
    result = Sandwich(sum(event.information for event in events), 0.0, models, growth)
    of_response = result.factor**2 * sum(model.variability for model in models)
    variability = of_response + result.factor**2 * sum(map(of_scale, events))
    return result._replace(variability=variability, of_response=of_response)


def of_scale(event) -> np.ndarray:
    """Covariance (d, d) of what the scales add to the score, sum_jk (r_jk^2 - m_j / N) d ln s_j / dz.

    It is a sum over time, so that its covariance is that of N times the mean of a series.
    """
    used = np.flatnonzero(np.abs(event.of_scale).sum(axis=0))
    result, square = np.zeros((event.of_scale.shape[1],) * 2), event.residuals**2
    if used.size:
        measured = ~event.value.gaps
        series = event.whole(square) - (square.sum(axis=1) / measured.sum(axis=1))[:, None]
        whole = np.repeat(event.of_scale[:, None, used], series.shape[1], axis=1)
        model = error_model(series, measured[..., None] * whole, whole=whole)
        result[np.ix_(used, used)] = model.variability
    return result


def known(matrix) -> np.ndarray:
    """Parameters (d,) that a likelihood depends on."""
    diagonal = np.diag(matrix)
    return np.flatnonzero(diagonal > FLAT**2 * diagonal.max(initial=0.0))


def whitening(information, flat=FLAT) -> np.ndarray:
    """W (d, k) with W' A W = 1, for the k directions that A tells."""
    used = known(information)
    scale = np.sqrt(np.diag(information)[used])
    values, vectors = np.linalg.eigh(information[np.ix_(used, used)] / np.outer(scale, scale))
    keep = values > flat * values.max(initial=0.0)
    result = np.zeros((len(information), keep.sum()))
    result[used] = vectors[:, keep] / np.sqrt(values[keep]) / scale[:, None]
    return result


def directions(information, other) -> tuple[np.ndarray, np.ndarray]:
    """Values v (k,), ascending, and V (d, k) with V' A V = 1 and V' X V = diag(v), of what A tells."""
    whiten = whitening(information)
    relative = whiten.T @ other @ whiten
    values, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    return values, whiten @ vectors


def combined(first, second, share) -> np.ndarray:
    """First of two matrices (d, d), and of the second what a function of its values (k,) leaves of them."""
    values, vectors = directions(first, second)
    along = first @ vectors
    return first + (along * share(values)) @ along.T


def stretching(information: np.ndarray, precision: np.ndarray) -> tuple[float, np.ndarray]:
    """Power k and matrix C (d, d) with C' (k A) C = the wanted precision (d, d).

    C has determinant one. It is the unit matrix along directions that the likelihood does not tell.
    """
    values, vectors = directions(information, precision)
    power = float(np.exp(np.mean(np.log(values)))) if values.size else 1.0
    along = (vectors * (np.sqrt(values / power) - 1.0)) @ vectors.T
    return power, np.eye(len(information)) + along @ information


def edges_of(event) -> np.ndarray:
    """Frequencies between bands, in cycles per sample."""
    f = np.sort(np.multiply([] if event.frequencies is None else event.frequencies, event.value.step))
    f = f[f < HIGHEST]
    return 0.5 * (f[:-1] + f[1:])[: MOST_BANDS - 1]


def growth_of(models, p: int) -> float:
    """The factor, not limited, by the error models of all events and p parameters; NaN without bands."""
    if all(len(model.scores) == 1 for model in models):
        return np.nan
    left, slopes = [], []
    largest = np.diag(sum(model.variability for model in models))
    scale = np.sqrt(np.where(largest > 0.0, largest, 1.0))
    for model in models:
        for u, b, a in zip(model.scores, model.variabilities, model.informations, strict=True):
            seen = np.diag(b) > FAINT * largest
            whiten = whitening(b * np.outer(seen, seen), SINGULAR)
            left.append(whiten.T @ u)
            slopes.append(whiten.T @ a * (largest > 0.0) / scale)
    left, slopes = np.concatenate(left), np.concatenate(slopes)
    if len(left) <= p:
        return np.nan
    left = left - slopes @ np.linalg.lstsq(slopes, left, rcond=SINGULAR)[0]
    return float(np.sqrt(max(1.0, left @ left / (len(left) - p))))


def sentence(growth: float) -> str:
    """What the disagreement of bands means; empty where it is no more than spectra explain."""
    if not growth > NOTABLE:
        return ""
    return (
        f"The frequency bands of this record disagree about the parameters by a factor of {growth:.2g} more "
        "than its residuals allow: the model is not the structure, or the errors are narrow-band. "
        f"Intervals are {min(LARGEST, growth):.2g} times wider, for the values that fit best on average over "
        "such events."
    )
