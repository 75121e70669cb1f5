"""`sensor_placement`: which sensors tell most, before there are data.

Of sensors i, j with sensitivities S_i(t) of the response, over the scale of its errors, by the parameters z,

    I = sum_ij [R^-1]_ij G_ij,    G_ij = sum_t S_i(t) S_j(t)',    R_ij = exp(-|x_i - x_j| / L),

where R is the correlation of the errors of sensors at x_i and x_j (Papadimitriou & Lombaert 2012). Parameters
are counted in standard deviations of their prior, so that their posterior has the covariance (1 + I)^-1.
"""

from collections.abc import Sequence

import numpy as np
import pymc as pm
import xarray as xr
from numpy.typing import ArrayLike

from pymc_features._checks import (
    as_list,
    as_numbers,
    check_choice,
    check_finite,
    check_integer,
    check_keywords,
    check_model,
    check_positive,
    check_seed,
    is_among,
    message,
    shown,
    single,
)
from pymc_features.calibration.residuals import Predictions, events_at
from pymc_features.inference.parameters import check_continuous, posterior_for, to_unconstrained
from pymc_features.smc import prior_points

CRITERIA = ("D", "A", "prediction")
N_PRIOR = 500  # draws that tell the scale of the prior
STEP = 1e-3  # of the differences, in standard deviations of the prior


def sensor_placement(
    model: pm.Model,
    candidates: Sequence | None,
    n: int,
    criterion: str = "D",
    *,
    positions: ArrayLike | None = None,
    correlation_length: float = 1.0,
    idata: xr.DataTree | None = None,
    **settings: int,
) -> xr.Dataset:
    """Choose n of many places for sensors, by what they tell together of the parameters.

    What the Fisher information of the likelihoods tells is averaged over draws of the parameters. Errors of
    sensors at x_i and x_j have the correlation ``exp(-|x_i - x_j| / L)``: without it two sensors end side by
    side at one antinode, as if the second told as much again.

    Parameters
    ----------
    model : pymc.Model
        With likelihoods of the response at all places, (sensor, time); of the data only the shape counts.
    candidates : sequence, optional
        Places to choose from: labels along the likelihood's first dimension, or positions in it; all of them
        by None.
    n : int
        Sensors to place.
    criterion : {"D", "A", "prediction"}
        What is to be large: the information gained about all parameters together [nats]; the share of their
        prior variance that the data take away, in the mean of all parameters; that of the variance of the
        predicted response at all candidates.
    positions : array_like (candidate,) or (candidate, axis), optional
        x, where the candidates are [m]; 0, 1, 2, ... by default, as of storeys.
    correlation_length : float
        L, in the unit of `positions`.
    idata : DataTree, optional
        What is known of the parameters; their prior by default.
    **settings
        `draws`, points at which the information is averaged, 20 by default, and their `random_seed`.

    Returns
    -------
    Dataset
        `sensor` (order), the places from the most telling on; `gain` (order), what the first ones tell
        together; `alone` (candidate), what each tells by itself; `chosen` (candidate); `position`. The
        attribute `criterion`.

    Raises
    ------
    TypeError, ValueError
        If candidates are unknown, or fewer than n; if a likelihood is not known, or two candidates are at
        one place.

    Notes
    -----
    One candidate more at a time, then exchanges of one for another while they help: on random structures as
    good as trying all choices (tests/placement). Each point costs two predictions for each parameter, and
    memory for a square of candidates times parameters.

    References
    ----------
    Papadimitriou & Lombaert, Mech. Syst. Signal Process. 28, 105-127 (2012). Udwadia, J. Eng. Mech. 120,
    368-390 (1994).
    """
    model = check_model(model)
    check_continuous(model, "sensor_placement()")
    criterion = check_choice(criterion, "criterion", CRITERIA)
    check_keywords(settings, ("draws", "random_seed"), "sensor_placement")
    draws = check_integer(settings.get("draws", 20), "draws")
    seed = check_seed(settings.get("random_seed"), several=False)
    labels, chosen = chosen_sensors(model, candidates)
    n = check_integer(n, "n", most=len(chosen))
    x = checked_positions(positions, len(chosen))
    length = check_positive(correlation_length, "correlation_length", "In the unit of `positions`.")
    points = points_of(model, idata, draws, np.random.default_rng(seed))
    distance = np.linalg.norm(x[:, None] - x[None], axis=-1)
    gram = gram_matrices(model, points, chosen)
    information = Information(gram, np.exp(-distance / length), criterion)
    best, gains = best_sensors(information, n)
    names = np.array([labels[i] for i in chosen])
    return xr.Dataset(
        {
            "sensor": ("order", names[best]),
            "gain": ("order", gains),
            "alone": ("candidate", [information.gain([i]) for i in range(len(chosen))]),
            "chosen": ("candidate", np.isin(np.arange(len(chosen)), best)),
            "position": (("candidate", "axis"), x),
        },
        {"order": np.arange(1, n + 1), "candidate": names},
        {"criterion": criterion, "correlation_length": length},
    )


def chosen_sensors(model, candidates) -> tuple[list, list[int]]:
    """Labels of all sensors, and which of them are candidates."""
    sizes = {tuple(rv.shape[:-1].eval()) for rv in model.observed_RVs}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1:
        wanted = "one with likelihoods (sensor, time) of the same sensors"
        raise ValueError(message("model", wanted, f"leading shapes {sorted(sizes)}"))
    [[count]] = sizes
    dims = model.named_vars_to_dims.get(model.observed_RVs[0].name) or [None]
    known = model.coords.get(dims[0])
    labels = list(range(count)) if known is None else [single(np.asarray(x)) for x in known]
    if candidates is None:
        return labels, list(range(count))
    listed = as_list(candidates)
    if not listed:
        raise TypeError(message("candidates", "a sequence of sensors", shown(candidates)))
    if not all(is_among(x, labels) for x in listed) or len(set(listed)) < len(listed):
        raise ValueError(message("candidates", f"different ones of {shown(labels)}", shown(listed)))
    return labels, [labels.index(x) for x in listed]


def checked_positions(positions, count: int) -> np.ndarray:
    """Positions (candidate, axis), all different."""
    x = np.arange(count, dtype=float) if positions is None else as_numbers(positions, "positions")
    check_finite(x, "positions")
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != count or not x.size:
        raise ValueError(message("positions", f"of shape ({count},) or ({count}, axis)", x.shape))
    if len(np.unique(x, axis=0)) < count:
        raise ValueError(message("positions", "all different", "two candidates at one place"))
    return x


def points_of(model, idata, draws: int, rng) -> np.ndarray:
    """Points (k, d) on the sampled scale, of a posterior or the prior."""
    if idata is None:
        return prior_points(model, draws, rng)
    posterior = posterior_for(model, idata, "idata")
    flat = to_unconstrained(model, posterior)
    flat = flat.reshape(-1, flat.shape[-1])
    return flat[rng.choice(len(flat), min(draws, len(flat)), replace=False)]


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
        events = events_at(predictions, predictions.coordinates, z, STEP * scale, predictions(z))
        at_point = 0.0
        for event in events:
            s = event.sensitivities[chosen] * scale
            at_point = at_point + np.einsum("itp,jtq->ijpq", s, s, optimize=True)
        total.append(at_point)
    return np.stack(total)


def best_sensors(information: Information, n: int) -> tuple[list[int], list[float]]:
    """A choice of n sensors and the gains on the way: the best one more each time, then exchanges."""
    candidates = range(len(information.correlation))
    chosen = in_order(information, candidates, n)
    best, improved = information.gain(chosen), True
    while improved:
        improved = False
        for place in range(n):
            others = chosen[:place] + chosen[place + 1 :]
            for i in candidates:
                if i not in chosen and (value := information.gain([*others, i])) > best * (1.0 + 1e-9):
                    chosen, best, improved = [*others, i], value, True
                    break
    order = in_order(information, chosen, n)
    return order, [information.gain(order[: k + 1]) for k in range(n)]


def in_order(information: Information, candidates: Sequence[int], n: int) -> list[int]:
    """n of some candidates, each the one that tells most beside those before it."""
    order: list[int] = []
    while len(order) < n:
        rest = [i for i in candidates if i not in order]
        order.append(max(rest, key=lambda i: information.gain([*order, i])))
    return order
