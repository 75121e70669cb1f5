"""`compare`: which of several model classes the data support, and whether any of them explains the data."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from numpy.typing import ArrayLike
from scipy.special import softmax
from scipy.stats import chi2

from pymc_features._checks import (
    as_list,
    as_numbers,
    check_finite,
    check_group,
    check_mapping,
    check_seed,
    message,
    shown,
)
from pymc_features.calibration.events import event_check
from pymc_features.calibration.residuals import Predictions, log_likelihood
from pymc_features.inference.parameters import posterior_for, some_draws
from pymc_features.smc import savable

DECIDED = 0.95  # probability of the best model from which one may speak of a decision
UNCERTAIN = 0.1  # standard error of a probability that is too large to tell anything
NOT_WHITE, DISAGREE = 0.01, 0.05  # p-values of residuals, and of events, that a model does not explain
ERROR_DRAWS = 4000  # of the errors of the log evidences
LAGS, SOME = 20, 20  # of the test for white residuals, and draws of which the likeliest has them
ITERATIONS, SMALL = 10_000, 1e-10  # of stacking
SAMPLE_BOTH = "Pass what `sample` or `sample_smc` returned for each model."


def compare(
    models: Mapping[str, xr.DataTree | Sequence[xr.DataTree]],
    *,
    prior: Mapping[str, float] | None = None,
    checks: Mapping[str, pm.Model] | None = None,
    held_out: Mapping[str, ArrayLike] | None = None,
    predictions: Mapping[str, xr.Dataset] | None = None,
    random_seed: int | None = None,
) -> xr.DataTree:
    """Compare model classes by their evidence, and say when none of them explains the data.

    Of models M_k with evidences Z_k and prior probabilities P(M_k), whose predictions may be averaged,

        P(M_k | d) = P(M_k) Z_k / sum_j P(M_j) Z_j,    p(y | d) = sum_k P(M_k | d) p(y | d, M_k).

    Parameters
    ----------
    models : dict of str to DataTree, or to a sequence of DataTree
        What `sample` or `sample_smc` returned for each model of the same data. Several posteriors are those
        of several events with parameters of their own, whose evidences are multiplied; then `event_check`
        asks whether they can be of one structure.
    prior : dict of str to float, optional
        Prior probabilities, or numbers in proportion to them; equal by default.
    checks : dict of str to pymc.Model, optional
        The PyMC models, of posteriors that are single: their residuals are tested for whiteness.
    held_out : dict of str to array_like (event,), optional
        ln p(event | the other events) of events that a model has not seen, for weights by stacking.
    predictions : dict of str to Dataset, optional
        Draws (chain, draw, ...) of the same quantities from each model, to be averaged.
    random_seed : int, optional
        For the same averaged draws each time.

    Returns
    -------
    DataTree
        `comparison` (model): `log_evidence`, `log_evidence_se`, `prior`, `probability`, `probability_se`
        and, where asked for, `p_white` (p-value of white residuals), `p_events` (of events that agree) and
        `stacking` (weight). Its attributes: `best`; `decided`, whether its probability is at least 0.95 by
        two standard errors; `explained`, whether some model explains the data, as far as that was tested;
        `message`, some sentences. `prediction`: draws (sample, ...), each from the model that the coordinate
        `model` names.

    Raises
    ------
    TypeError, ValueError
        If models are of other data, their likelihoods are densities of something else, a model has no
        evidence, or the errors of the evidences leave the probabilities uncertain by 0.1 or more.

    Notes
    -----
    An evidence depends on how wide the priors are, however many data there are: a prior twice as wide costs
    ln 2 for each parameter that the data determine. Stacking does not mind, nor does it assume that one model
    is right.

    References
    ----------
    Beck & Yuen, J. Eng. Mech. 130, 192-203 (2004); Hoeting, Madigan, Raftery & Volinsky, Stat. Sci. 14
    (1999); Yao, Vehtari, Simpson & Gelman, Bayesian Anal. 13 (2018).

    Examples
    --------
    >>> def sampled(log_evidence):
    ...     draws = {"x": (("chain", "draw"), np.zeros((1, 2)))}
    ...     attrs = {"log_evidence": log_evidence, "log_evidence_se": 0.01, "likelihoods": '{"y": "data"}'}
    ...     parts = {"posterior": xr.Dataset(draws), "sample_stats": xr.Dataset(attrs=attrs)}
    ...     return xr.DataTree.from_dict(parts | {"observed_data": xr.Dataset({"y": ("time", [1.0, 2.0])})})
    >>> found = compare({"shear": sampled(-12.0), "bending": sampled(-10.0)})["comparison"]
    >>> found["probability"].values.round(2), found.attrs["decided"]
    (array([0.12, 0.88]), 0)
    """
    check_seed(random_seed, several=False)
    classes = candidates(models)
    names = list(classes)
    priors = prior_probabilities(prior, names)
    values, errors = np.array([one.evidence for one in classes.values()]).T
    probabilities, uncertain = posterior_probabilities(values, errors, priors)
    if uncertain.max() > UNCERTAIN:
        listed = ", ".join(f"{v:.1f} +- {e:.2g}" for v, e in zip(values, errors, strict=True))
        what = "posteriors whose evidences are known well enough to compare them"
        raise ValueError(message("models", what, listed, "Increase `draws` of `sample`."))
    columns = {
        "log_evidence": values,
        "log_evidence_se": errors,
        "prior": priors,
        "probability": probabilities,
        "probability_se": uncertain,
    }
    columns |= explanations(classes, of_names(checks, names, "checks"))
    if scores := of_names(held_out, names, "held_out"):
        columns["stacking"] = stacking_weights(scores_of(scores))
    result = xr.Dataset({name: ("model", x) for name, x in columns.items()}, {"model": names})
    parts = {"comparison": result.assign_attrs(summary(result))}
    if draws := of_names(predictions, names, "predictions"):
        parts["prediction"] = averaged(draws, probabilities, np.random.default_rng(random_seed))
    return xr.DataTree.from_dict(parts)


class Evidence(NamedTuple):
    """ln Z and its standard error; NaN where the sampler has left none."""

    value: float
    error: float


class Candidate(NamedTuple):
    """One model class: a posterior of each event, ln Z of all data, the data and the kinds of densities."""

    events: list[xr.DataTree]
    evidence: Evidence
    data: list
    kinds: list[str]


def evidence_of(idata: xr.DataTree) -> Evidence:
    """What `sample`, `sample_smc`, `laplace` or `pm.sample_smc` has left.

    Of several chains the mean of the evidences; where a sampler gives no standard error, that of the mean
    from how far the chains are apart. The evidence of a stretched likelihood, of `calibrate`, is none.
    """
    unknown = Evidence(np.nan, np.nan)
    if "sample_stats" not in idata.children or "calibration" in idata.children:
        return unknown
    summary = idata["sample_stats"].attrs
    if "log_evidence" in summary:
        return Evidence(float(summary["log_evidence"]), float(summary["log_evidence_se"]))
    stats = savable(idata)["sample_stats"].to_dataset()
    name = "log_marginal_likelihood"
    name = f"{name}_is" if f"{name}_is" in stats else name  # of `laplace`
    if name not in stats:
        return unknown
    values = np.asarray(stats[name].values, dtype=np.float64)
    weights = np.exp(values - values.max())
    value, n = float(values.max() + np.log(weights.mean())), len(values)
    if f"{name}_se" in stats:
        errors = np.asarray(stats[f"{name}_se"].values, dtype=np.float64)
        return Evidence(value, float(np.sqrt(((weights * errors) ** 2).sum()) / weights.sum()))
    return Evidence(value, float(weights.std(ddof=1) / weights.mean() / np.sqrt(n)) if n > 1 else np.nan)


def product(evidences: Iterable[Evidence]) -> Evidence:
    """Evidence of all data of independent parts."""
    values, errors = np.array(list(evidences)).T
    return Evidence(float(np.sum(values)), float(np.linalg.norm(errors)))


def candidates(models) -> dict[str, Candidate]:
    """Two or more model classes that can be compared."""
    plain = isinstance(models, Mapping) and not isinstance(models, xr.Dataset | xr.DataTree)
    if not plain or len(models) < 2 or not all(isinstance(name, str) for name in models):
        raise TypeError(message("models", "a dict of two or more posteriors", shown(models), SAMPLE_BOTH))
    classes = {name: candidate(name, value) for name, value in models.items()}
    first, *others = classes
    for name in others:
        if classes[name].data != classes[first].data:
            raise ValueError(
                f"`models` must be of the same data, got others for {name} than for {first}. Sample both "
                "with the same channels, window and sampling step."
            )
        kinds = [", ".join(classes[one].kinds) for one in (first, name)]
        if kinds[0] != kinds[1]:
            raise ValueError(
                f"`models` must have likelihoods that are densities of the same, got {kinds[0]} for {first} "
                f"and {kinds[1]} for {name}: their evidences have other units. Use one likelihood, or "
                "density='data' in both."
            )
    return classes


def candidate(name: str, value) -> Candidate:
    """One model class, by the posterior or the posteriors of it."""
    events = [value] if isinstance(value, xr.DataTree) else as_list(value)
    if not events:
        raise TypeError(message("models", "posteriors", f"{shown(value)} for {name}", SAMPLE_BOTH))
    data, kinds = [], []
    for event in events:
        check_group(event, "models", "posterior", SAMPLE_BOTH, "chain", "draw")
        stats = check_group(event, "models", "sample_stats", SAMPLE_BOTH).attrs
        observed = check_group(event, "models", "observed_data", SAMPLE_BOTH)
        if "likelihoods" not in stats:
            what = "posteriors that say what their likelihoods are"
            raise ValueError(message("models", what, f"none for {name}", SAMPLE_BOTH))
        data += [(x.shape, x.values.astype(np.float64).tobytes()) for x in observed.data_vars.values()]
        kinds += json.loads(stats["likelihoods"]).values()
    total = product(map(evidence_of, events))
    if not np.isfinite(total).all():
        why = "`calibrate` stretches the likelihood" if "calibration" in events[0].children else "it has none"
        what = "posteriors with an evidence and its standard error"
        raise ValueError(message("models", what, f"none for {name}: {why}", SAMPLE_BOTH))
    return Candidate(events, total, sorted(data), sorted(set(kinds)))


def of_names(values, names, argument: str) -> dict:
    """A mapping with something for each model, in their order; empty if there is none."""
    values = check_mapping(values, argument, "a dict with the names of `models`")
    if values and set(values) != set(names):
        raise ValueError(message(argument, f"of the models {', '.join(names)}", ", ".join(values)))
    return {name: values[name] for name in names} if values else {}


def prior_probabilities(prior, names) -> np.ndarray:
    """Prior probabilities (model,), that sum to one."""
    weights = of_names(prior, names, "prior")
    if not weights:
        return np.full(len(names), 1.0 / len(names))
    numbers = as_numbers(list(weights.values()), "prior")
    check_finite(numbers, "prior")
    if numbers.ndim != 1 or not (numbers > 0.0).all():
        raise ValueError(message("prior", "a positive number for each model", shown(list(weights.values()))))
    return numbers / numbers.sum()


def posterior_probabilities(values, errors, priors):
    """P(M_k | d), and standard errors that those of the log evidences leave, each (model,)."""
    noise = np.random.default_rng(0).standard_normal((ERROR_DRAWS, len(values)))
    log_p = np.log(priors) + values
    return softmax(log_p), softmax(log_p + errors * noise, axis=-1).std(axis=0)


def explanations(classes: dict[str, Candidate], models: dict) -> dict[str, np.ndarray]:
    """p-values (model,) of what each model leaves, as far as they can be had."""
    tests = {}
    for name, model in models.items():
        if not isinstance(model, pm.Model):
            raise TypeError(message("checks", "a dict of pymc.Model", f"{shown(model)} for {name}"))
        if len(classes[name].events) > 1:
            raise ValueError(message("checks", "left out where models have several posteriors", name))
    if models:
        whiteness = [residual_whiteness(model, classes[name].events[0]) for name, model in models.items()]
        tests["p_white"] = np.array(whiteness)
    if all(len(one.events) > 1 for one in classes.values()):
        tests["p_events"] = np.array([event_check(one.events).attrs["p_value"] for one in classes.values()])
    return tests


def scores_of(held_out: dict) -> np.ndarray:
    """Log predictive densities (model, event)."""
    rows = [as_numbers(row, "held_out") for row in held_out.values()]
    if any(row.ndim != 1 or not row.size or row.shape != rows[0].shape for row in rows):
        got = ", ".join(str(row.shape) for row in rows)
        raise ValueError(message("held_out", "a number of each event for each model", f"arrays {got}"))
    check_finite(np.array(rows), "held_out")
    return np.array(rows)


def summary(result: xr.Dataset) -> dict:
    """Attributes of the comparison."""
    best = int(np.argmax(result["probability"].values))
    name, p = result["model"].values[best], float(result["probability"][best])
    decided = p - 2.0 * float(result["probability_se"][best]) >= DECIDED
    sentences = [
        f"{name} has a probability of {p:.3g} among these models: "
        + ("the data decide for it." if decided else "the data do not decide between them.")
    ]
    fails = np.zeros(result.sizes["model"], dtype=bool)
    if "p_white" in result:
        fails |= result["p_white"].values < NOT_WHITE
    if "p_events" in result:
        fails |= result["p_events"].values < DISAGREE
    if fails.all():
        sentences.append(
            "None of the models explains the data: of each, residuals are not white or events disagree. "
            "The best of them is the least wrong, and intervals under it are too narrow; see `calibrate`."
        )
    elif fails[best]:
        other = result["model"].values[~fails]
        sentences.append(f"It does not explain the data; {', '.join(other)} leave white residuals.")
    flags = {"decided": int(decided), "explained": int(not fails.all())}
    return {"best": str(name)} | flags | {"message": " ".join(sentences)}


def averaged(predictions: dict, probabilities, rng) -> xr.Dataset:
    """Draws (sample, ...) of all models, each as often as its model is probable."""
    for name, draws in predictions.items():
        if not (isinstance(draws, xr.Dataset) and {"chain", "draw"} <= set(draws.dims)):
            what = "a dict of Datasets along chain and draw"
            raise TypeError(message("predictions", what, f"{shown(draws)} for {name}"))
    stacked = [
        draws.stack(sample=("chain", "draw")).reset_index("sample", drop=True)
        for draws in predictions.values()
    ]
    first = stacked[0]
    for name, draws in zip(predictions, stacked, strict=True):
        same = set(draws.data_vars) == set(first.data_vars) and all(
            draws[x].isel(sample=0).shape == first[x].isel(sample=0).shape for x in first.data_vars
        )
        if not same or not draws.sizes["sample"]:
            raise ValueError(
                message("predictions", "of the same quantities and shapes", f"others for {name}")
            )
    n = max(draws.sizes["sample"] for draws in stacked)
    edges = np.floor(n * np.append(0.0, np.cumsum(probabilities)) + rng.random()).astype(int).clip(max=n)
    edges[0], edges[-1] = 0, n
    chosen = [
        draws.isel(sample=rng.choice(draws.sizes["sample"], count, replace=count > draws.sizes["sample"]))
        for draws, count in zip(stacked, np.diff(edges), strict=True)
    ]
    labels = np.repeat(list(predictions), np.diff(edges))
    return xr.concat(chosen, "sample", join="override").assign_coords(model=("sample", labels))


def stacking_weights(scores: np.ndarray) -> np.ndarray:
    """Weights (model,) with the largest sum over events of ln sum_k w_k p_k(event).

    `scores` (model, event) are ln p_k of each held-out event. The sum is concave in w; expectation and
    maximisation climb it, and each step w_k <- mean_e w_k p_ke / sum_j w_j p_je stays on the simplex.

    Yao, Vehtari, Simpson & Gelman, Bayesian Anal. 13, 917-1007 (2018), Eq. (4).
    """
    densities = np.exp(scores - scores.max(axis=0))
    weights = np.full(len(scores), 1.0 / len(scores))
    for _ in range(ITERATIONS):
        shares = weights[:, None] * densities
        new = (shares / shares.sum(axis=0)).mean(axis=1)
        if np.abs(new - weights).max() < SMALL:
            break
        weights = new
    return weights


def residual_whiteness(model, idata) -> float:
    """p-value of white residuals at the likeliest of some draws, of the worst sensor, times their number.

    Ljung & Box, Biometrika 65, 1978, with 20 lags. Residuals are those that the likelihood takes to be
    independent: of a `CorrelatedNormal` what each sample adds.
    """
    posterior, predictions = posterior_for(model, idata, "models"), Predictions(model)
    values = [predictions(z) for z in some_draws(model, posterior, SOME)]
    best = values[int(np.argmax([log_likelihood(value) for value in values]))]
    p_values = [ljung_box(row) for value in best for row in value.residuals]
    return float(min(1.0, len(p_values) * min(p_values)))


def ljung_box(x: np.ndarray) -> float:
    """p-value of a white series (time,)."""
    n, x = len(x), x - x.mean()
    lags = np.arange(1, min(LAGS, n // 5) + 1)
    if not lags.size or not x.any():
        return 1.0
    correlations = np.array([x[k:] @ x[:-k] for k in lags]) / (x @ x)
    return float(chi2.sf(n * (n + 2) * np.sum(correlations**2 / (n - lags)), len(lags)))
