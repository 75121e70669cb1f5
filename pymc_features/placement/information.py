"""What sensors together tell of the parameters, with errors that neighbours share.

Of sensors i, j with sensitivities S_i(t) of the response, over the scale of its errors, by the parameters z,

    I = sum_ij [R^-1]_ij G_ij,    G_ij = sum_t S_i(t) S_j(t)',    R_ij = exp(-|x_i - x_j| / L),

where R is the correlation of the errors of sensors at x_i and x_j (Papadimitriou & Lombaert 2012). Parameters
are counted in standard deviations of their prior, so that their posterior has the covariance (1 + I)^-1.
"""

import numpy as np

from pymc_features.calibration.residuals import Predictions, events_at
from pymc_features.smc import prior_points

N_PRIOR = 500  # draws that tell the scale of the prior
STEP = 1e-3  # of the differences, in standard deviations of the prior


class Information:
    """G_ij at some points, and criteria of any choice of sensors.

    Parameters
    ----------
    gram : array (point, sensor, sensor, parameter, parameter)
    correlation : array (sensor, sensor)
    criterion : {"D", "A", "prediction"}
    """

    def __init__(self, gram: np.ndarray, correlation: np.ndarray, criterion: str):
        self.gram, self.correlation, self.criterion = gram, correlation, criterion
        self.of_response = np.einsum("kiipq->kpq", gram)
        self.unit = np.eye(gram.shape[-1])

    def of(self, chosen: list[int]) -> np.ndarray:
        """I (point, parameter, parameter) of some sensors."""
        weights = np.linalg.inv(self.correlation[np.ix_(chosen, chosen)])
        return np.einsum("ij,kijpq->kpq", weights, self.gram[:, chosen][:, :, chosen], optimize=True)

    def gain(self, chosen: list[int]) -> float:
        """What a choice is worth, more being better; nothing without sensors, mean over the points.

        D: the information gained, half the logarithm of the determinant of 1 + I [nats]. A: the share of the
        parameters' prior variance that is lost. prediction: that of the variance of the response at all
        candidates.
        """
        posterior = self.unit + (self.of(chosen) if chosen else 0.0 * self.of_response)
        if self.criterion == "D":
            return float(0.5 * np.linalg.slogdet(posterior)[1].mean())
        covariance = np.linalg.inv(posterior)
        if self.criterion == "A":
            return float(1.0 - np.trace(covariance, axis1=1, axis2=2).mean() / len(self.unit))
        left = np.einsum("kpq,kqp->k", covariance, self.of_response)
        return float(1.0 - np.mean(left / np.einsum("kpp->k", self.of_response)))


def gram_matrices(model, points: np.ndarray, chosen: list[int]) -> np.ndarray:
    """G (point, sensor, sensor, parameter, parameter) of some sensors at points (k, d), of all events."""
    predictions = Predictions(model)
    scale = prior_points(model, N_PRIOR, np.random.default_rng(0)).std(axis=0)
    total = []
    for z in points:
        events = events_at(predictions, z, STEP * scale, predictions(z))
        at_point = 0.0
        for event in events:
            s = event.sensitivities[chosen] * scale
            at_point = at_point + np.einsum("itp,jtq->ijpq", s, s, optimize=True)
        total.append(at_point)
    return np.stack(total)


def best_sensors(information: Information, n: int) -> tuple[list[int], list[float]]:
    """A choice of n sensors and the gains on the way: the best one more each time, then exchanges."""
    candidates, chosen, gains = range(len(information.correlation)), [], []
    for _ in range(n):
        rest = [i for i in candidates if i not in chosen]
        scores = [information.gain([*chosen, i]) for i in rest]
        chosen.append(rest[int(np.argmax(scores))])
        gains.append(max(scores))
    best, improved = gains[-1], True
    while improved:
        improved = False
        for place in range(n):
            others = chosen[:place] + chosen[place + 1 :]
            for i in candidates:
                if i not in chosen and (value := information.gain([*others, i])) > best * (1.0 + 1e-9):
                    chosen, best, improved = [*others, i], value, True
                    break
    order = in_order(information, chosen)
    return order, [information.gain(order[: k + 1]) for k in range(n)]


def in_order(information: Information, chosen: list[int]) -> list[int]:
    """A choice in the order in which its members tell most."""
    order: list[int] = []
    while len(order) < len(chosen):
        rest = [i for i in chosen if i not in order]
        order.append(max(rest, key=lambda i: information.gain([*order, i])))
    return order
