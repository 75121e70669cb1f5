"""Intervals of one posterior, and whether those of several events can be of one structure."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.stats import chi2, t

from pymc_features._checks import check_finite, check_group, check_share, check_texts, message

IMPROBABLE = 0.05  # p-value below which events are said to disagree
FEWEST_DRAWS = 20
SHORT = 2.0  # standard deviations from a bound within which the shortest interval is given: beyond, equal
# tails hardly differ from it, and nearer they never contain the bound
FEW = 0.01  # of the draws between an interval and a bound: the interval ends at the bound


def event_check(
    events: Sequence[xr.DataTree], *, var_names: Sequence[str] | None = None, probability: float = 0.9
) -> xr.Dataset:
    """Compare the posteriors that several events give of the same parameters.

    An error that is the same all along a record leads each event to another value. With posterior means x_e
    and variances v_e of E events,

        Q = sum_e (x_e - m)^2 / v_e,    m = sum_e (x_e / v_e) / sum_e (1 / v_e),

    is chi-square with E - 1 degrees of freedom if the intervals are right. By `growth`, the square root of
    Q / (E - 1) but not below one, all must grow to explain the scatter (Birge's ratio). The interval for the
    value common to all events weighs them by 1 / (v_e + tau^2), tau^2 their scatter (Paule & Mandel), and its
    width comes from how far they are apart, with Student's t (Hartung & Knapp).

    Parameters
    ----------
    events : sequence of DataTree
        Posteriors of two or more independent events, best of `calibrate`.
    var_names : sequence of str, optional
        Variables to compare. By default those in all events; of posteriors of `calibrate` only those that
        change the response, because noise may differ from event to event.
    probability : float
        Of the intervals.

    Returns
    -------
    Dataset
        Over `parameter` (variable and index): `mean` and `standard_deviation` ``(event, parameter)``, `q`,
        `p_value`, `growth`, `scatter` tau, `centre`, `lower` and `upper`. Attributes: the joint `p_value` and
        `growth` of all parameters with their correlations, `compatible` (p-value of at least 0.05) and
        `message`, a sentence.

    Raises
    ------
    TypeError, ValueError
        If there are fewer than two posteriors, or they have no variable in common, of one shape.

    Notes
    -----
    Events that were measured on one occasion, or priors that decide a parameter in all of them, agree more
    than independent ones: then `growth` is too low.

    References
    ----------
    Birge, Phys. Rev. 40, 1932; Paule & Mandel, J. Res. NBS 87, 1982; Hartung & Knapp, Stat. Med. 20, 2001;
    IntHout, Ioannidis & Borm, BMC Med. Res. Methodol. 14, 2014.
    """
    probability = check_share(probability, "probability", "Use for example 0.9.")
    draws = common_draws(events, var_names)
    names, n = list(draws[0]), len(draws)
    rows = [np.stack(list(event.values())) for event in draws]
    means = np.stack([x.mean(axis=1) for x in rows])
    covariances = np.stack([np.cov(x).reshape(len(names), -1) for x in rows])
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    apart = [between(x, v, probability) for x, v in zip(means.T, variances.T, strict=True)]
    q, degrees = joint_q(means, covariances), len(names) * (n - 1)
    p_value, growth = float(chi2.sf(q, degrees)), max(1.0, float(np.sqrt(q / degrees)))
    message = f"The {n} events agree (p-value {p_value:.2g}): their intervals need not grow."
    if p_value < IMPROBABLE:
        worst = max(range(len(names)), key=lambda i: apart[i]["growth"])
        message = (
            f"The {n} events do not agree (p-value {p_value:.1g}): their intervals must grow {growth:.3g} "
            f"times, that of {names[worst]} {apart[worst]['growth']:.3g} times, so that one structure "
            "explains all. The model errs in the same way all along a record, or the structure changed: use "
            "the interval of the events together (`lower`, `upper`), or give each event its own parameters."
        )
    over = ("event", "parameter")
    return xr.Dataset(
        {"mean": (over, means), "standard_deviation": (over, variances**0.5)}
        | {name: ("parameter", np.array([one[name] for one in apart])) for name in apart[0]},
        {"event": np.arange(n), "parameter": names},
        dict(p_value=p_value, growth=growth, compatible=int(p_value >= IMPROBABLE), message=message),
    )


def between(x, v, probability) -> dict:
    """Scatter of means x (event,) with variances v (event,), and the interval of what they have in common."""
    n = len(x)

    def weighed(tau2):
        """Sum of the weights, centre, and Q."""
        w = 1.0 / (v + tau2)
        centre = np.sum(w * x) / w.sum()
        return w.sum(), centre, np.sum(w * (x - centre) ** 2)

    q, tau2 = weighed(0.0)[-1], 0.0
    if q > n - 1:
        tau2 = brentq(lambda s: weighed(s)[-1] - (n - 1), 0.0, n * np.ptp(x) ** 2)
    weight, centre, rest = weighed(tau2)
    half = t.ppf(0.5 + 0.5 * probability, n - 1) * np.sqrt(rest / ((n - 1) * weight))
    growth, p_value = max(1.0, np.sqrt(q / (n - 1))), chi2.sf(q, n - 1)
    found = {"q": q, "p_value": p_value, "growth": growth, "scatter": np.sqrt(tau2), "centre": centre}
    return found | {"lower": centre - half, "upper": centre + half}


def joint_q(means, covariances) -> float:
    """Q of all parameters (event, parameter), with their covariances (event, parameter, parameter)."""
    precisions = np.linalg.pinv(covariances, hermitian=True)
    total = np.einsum("epq,eq->p", precisions, means)
    off = means - np.linalg.pinv(precisions.sum(axis=0), hermitian=True) @ total
    return float(np.einsum("ep,epq,eq->", off, precisions, off))


def common_draws(events, var_names) -> list[dict[str, np.ndarray]]:
    """Draws (draw,) of the same scalars, by name, of each event."""
    from arviz_base import labels, xarray_var_iter  # slow to import

    if isinstance(events, xr.DataTree) or not isinstance(events, Sequence) or len(events) < 2:
        got = len(events) if isinstance(events, Sequence) else type(events).__name__
        advice = "Pass for example [idata_1, idata_2]."
        raise TypeError(message("events", "a sequence of two or more posteriors", got, advice))
    advice, label = "That is event {}. Pass what `sample` returned.", labels.BaseLabeller().make_label_flat
    posteriors = [
        check_group(event, "events", "posterior", advice.format(i), "chain", "draw")
        for i, event in enumerate(events)
    ]
    if var_names is None:
        var_names = [name for name in posteriors[0] if all(tells(event, name) for event in events)]
    else:
        var_names = check_texts(var_names, "var_names", "names of variables")
    draws = []
    for i, posterior in enumerate(posteriors):
        if missing := [name for name in var_names if name not in posterior.data_vars]:
            raise ValueError(f"`var_names` must be in every posterior, got no {missing[0]} in event {i}.")
        if posterior.sizes["chain"] * posterior.sizes["draw"] < FEWEST_DRAWS:
            raise ValueError(f"`events` must have at least {FEWEST_DRAWS} draws, got fewer in event {i}.")
        some = posterior[list(var_names)].transpose("chain", "draw", ...)
        draws.append({})
        for name, at, place, x in xarray_var_iter(some, skip_dims={"chain", "draw"}):
            check_finite(x, "var_names", f"Those are draws of {label(name, at, place)} in event {i}.")
            draws[-1][label(name, at, place)] = x.ravel()
    if not draws[0] or any(list(x) != list(draws[0]) for x in draws):
        raise ValueError(
            "`events` must have parameters in common, with one shape, got "
            f"{' and '.join(str(list(x)) for x in draws)}. Name them with `var_names`."
        )
    return draws


def tells(event, name) -> bool:
    """Whether a posterior has a variable, and, as far as is known, its response depends on it."""
    if name not in event["posterior"].data_vars or "calibration" not in event.children:
        return name in event["posterior"].data_vars
    known = event["calibration"]["changes_response"]
    return bool(known.isel(parameter=[str(x).split("[")[0] == name for x in known["parameter"].values]).any())


def interval(draws, probability=0.9, bound=None) -> tuple[float, float]:
    """Equal-tailed interval of draws (n,), or, next to a bound, the shortest."""
    if bound is None:
        return tuple(map(float, np.quantile(draws, [0.5 - 0.5 * probability, 0.5 + 0.5 * probability])))
    x = np.sort(draws)
    n = int(np.ceil(probability * len(x)))
    first = int(np.argmin(x[n - 1 :] - x[: len(x) - n + 1]))
    low, high = x[first], x[first + n - 1]
    if np.mean((x > min(bound, high)) & (x < max(bound, low))) < FEW:
        low, high = min(bound, low), max(bound, high)
    return float(low), float(high)
