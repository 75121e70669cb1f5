"""`sensor_placement`: which sensors tell most, before there are data."""

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
    check_model,
    check_positive,
    check_seed,
    is_among,
    message,
    shown,
    single,
)
from pymc_features.inference.parameters import check_continuous, posterior_for, to_unconstrained
from pymc_features.placement.information import Information, best_sensors, gram_matrices
from pymc_features.smc import prior_points

CRITERIA = ("D", "A", "prediction")


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
    draws, seed = checked_settings(settings)
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


def checked_settings(settings) -> tuple[int, int | None]:
    """Number of points, and a seed."""
    if unknown := sorted(set(settings) - {"draws", "random_seed"}):
        raise TypeError(message("settings", "draws or random_seed", ", ".join(unknown)))
    draws = check_integer(settings.get("draws", 20), "draws")
    return draws, check_seed(settings.get("random_seed"), several=False)


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
