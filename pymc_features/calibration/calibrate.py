"""`calibrate`: a posterior as wide as the residuals support, in every direction."""

import warnings

import numpy as np
import pymc as pm
import xarray as xr
from pymc.util import RandomState

from pymc_features._checks import check_flag, check_integer, check_model, check_seed
from pymc_features.calibration.adjusted import adjusted_model, stretching
from pymc_features.calibration.effective import described
from pymc_features.calibration.fit import Predictions, hessian
from pymc_features.calibration.modes import Part, distinct_fits, pooled
from pymc_features.calibration.sandwich import Sandwich, sandwich, whitening
from pymc_features.exceptions import CalibrationWarning, SamplingWarning
from pymc_features.inference.parameters import Unconstrained, posterior_for
from pymc_features.inference.sample import Search, compared_draws, sample_from
from pymc_features.smc import Reference, open_workers, population_logp, prior_points
from pymc_features.smc.proposals.reference import Mode

CURVED = 0.2  # standard deviations over which curvature is measured
PRIOR_DRAWS = 500
# mean square of standard deviations from the maximum that is far, and the share of draws that makes a warning
FAR, MANY = 10.0, 0.25
NO_CLIMBS = "the maximum was known"


def calibrate(
    idata: xr.DataTree,
    *,
    model: pm.Model | None = None,
    draws: int | None = None,
    chains: int | None = None,
    random_seed: RandomState = None,
    progressbar: bool = True,
    **settings,
) -> xr.DataTree:
    """Posterior whose width the residuals decide, not the sampling rate or the number of sensors.

    The likelihood is raised to the power, and stretched around its maximum by the matrix, that give it the
    curvature A B^-1 A, where B is the covariance of the score that the residuals support
    (`effective_samples`). With the prior as it is, the posterior is sampled again. The maximum does not move,
    the prior's bounds and information keep their meaning, and any likelihood of the response leads to nearly
    the same interval.

    Parameters
    ----------
    idata : DataTree
        What `sample`, `sample_smc` or `pm.sample` returned for NORM, TN, EXP, `GammaFeature` or
        `CorrelatedNormal`, of one or several records.
    model : pymc.Model, optional
        The model of the context by default.
    draws, chains : int, optional
        As in `idata` by default.
    random_seed : int or sequence of int, optional
        For the same draws each time.
    progressbar : bool
        Whether to show progress.
    **settings
        Of `sample`.

    Returns
    -------
    DataTree
        As from `sample`, of the calibrated posterior; `sample_stats` has the attribute `power`, and the group
        `calibration` is what `effective_samples` returns. With several modes that group has them as a
        dimension, with their `weight`, and `sample_stats` says of which `mode` a draw is; its other numbers
        are those of the heaviest. The evidence is that of the stretched likelihood, and must not be compared
        with others.

    Raises
    ------
    TypeError, ValueError
        As of `effective_samples`, or if the likelihood has no maximum near the draws.

    Warns
    -----
    CalibrationWarning
        If errors persist for more than a fifth of the record, or a quarter of the draws are far from the
        maximum.
    SamplingWarning
        As from `sample`.

    Notes
    -----
    Modes that lie more than some standard deviations apart are calibrated each by itself. Each has the
    evidence of its stretched likelihood, but the ratio of the maxima is raised to the power of the highest,
    which decides how much one mode is likelier than another. A bias of the model, the same in every record,
    is not seen in residuals.

    References
    ----------
    Ribatet, Cooley & Davison, Stat. Sin. 22, 2012; Shaby, Bayesian Anal. 9, 2014.
    """
    for name, value, least in (("draws", draws, 2), ("chains", chains, 1)):
        if value is not None:
            check_integer(value, name, least=least)
    check_seed(random_seed)
    check_flag(progressbar, "progressbar")
    model = check_model(model)
    posterior = posterior_for(model, idata, "idata")
    rng = np.random.default_rng(np.random.SeedSequence(random_seed).spawn(1)[0])
    settings |= {
        "draws": draws or posterior.sizes["draw"],
        "chains": chains or posterior.sizes["chain"],
        "random_seed": random_seed,
        "progressbar": progressbar,
    }
    predictions = Predictions(model)
    modes = [
        (fit, curved(predictions, fit, sandwich(fit.events, fit.information)))
        for fit in distinct_fits(predictions, idata, rng)
    ]
    adjusted, parts = adjusted_model(model, len(modes)), []
    with open_workers(settings.pop("executor", None)) as workers:
        for i, mode in enumerate(modes):
            others, own = modes[:i] + modes[i + 1 :], settings | {"executor": workers}
            part = calibrated_mode(adjusted, mode, others, own, rng)
            part.idata["calibration"] = xr.DataTree(described(model, *mode))
            far_away(compared_draws(model, part.idata["posterior"]), *mode)
            parts.append(part)
    calibrated = pooled(parts, rng)
    for group in ("observed_data", "constant_data"):
        if group in idata.children:
            calibrated[group] = idata[group].copy()
    if advice := calibrated["sample_stats"].attrs["advice"]:
        warnings.warn(advice, SamplingWarning, stacklevel=2)
    return calibrated


def far_away(draws, fit, result: Sandwich):
    """Warn if many draws (n, d) are far from the maximum at which the residuals have decided the width."""
    off = (np.empty((0, len(fit.z))) if draws is None else draws) - fit.z
    directions = np.linalg.matrix_rank(whitening(result.information))
    away = np.einsum("ni,ij,nj->n", off, result.precision, off) > FAR * directions
    if away.size and away.mean() > MANY:
        warnings.warn(
            f"{100 * away.mean():.0f} % of the calibrated draws are far from the likelihood's maximum: the "
            "priors, or a maximum that no draw was near, outweigh it, and there the residuals have decided "
            "no width. Use a longer record, several events in one model, or priors that agree with the data.",
            CalibrationWarning,
            stacklevel=3,
        )


def calibrated_mode(adjusted, mode, others, settings, rng) -> Part:
    """The posterior around a maximum; each is a fit and its sandwich."""
    model, (fit, result), d = adjusted.model, mode, len(mode[0].z)
    power, matrix = stretching(result.information, result.precision)
    elsewhere = np.reshape([fit.z for fit, _ in others], (-1, d))
    precisions = np.reshape([result.precision for _, result in others], (-1, d, d))
    adjusted.set(power, fit.z, matrix, result.precision, elsewhere, precisions)
    found = Search(bell(model, fit.z, result.precision, rng), 0, 0, NO_CLIMBS)
    idata = sample_from(found, model, Unconstrained(model), **settings)
    idata["sample_stats"].attrs |= {"power": power}
    logp = population_logp(model, model.initial_point(), settings.get("compile_kwargs") or {})
    return Part(idata, power, logp(fit.z[None])[1][0] / power)


def curved(predictions, fit, result: Sandwich) -> Sandwich:
    """The sandwich with the likelihood's own curvature as A, where that is positive.

    It is measured along the axes of A: where parameters are correlated, a change of one of them alone by its
    standard deviation leads far away.
    """
    whiten = whitening(result.information)
    widths = np.sqrt(np.diag(whiten.T @ result.variability @ whiten))
    steps = CURVED * np.minimum(widths, 1.0)
    relative = hessian(predictions, fit.z, (whiten * steps).T) / np.outer(steps, steps)
    if not np.linalg.eigvalsh(relative).min(initial=np.inf) > 0:
        return result
    unwhiten = whiten.T @ result.information
    return result._replace(information=unwhiten.T @ relative @ unwhiten)


def bell(model, point, precision, rng) -> Reference:
    """What to draw from first: a bell of the likelihood's wanted width, no wider than the prior."""
    prior = prior_points(model, PRIOR_DRAWS, rng)
    centre, scale = prior.mean(axis=0), prior.std(axis=0)
    covariance = np.linalg.inv(precision + np.diag(scale**-2.0))
    factor = np.linalg.cholesky(covariance / np.outer(scale, scale))
    return Reference([Mode((point - centre) / scale, factor, 0.0, 1)], centre, scale)
