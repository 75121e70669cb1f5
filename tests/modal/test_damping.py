"""Damping ratios, and standard deviations of entries of shapes, as data of `ModalFeature`."""

import sys
from pathlib import Path

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import linalg, stats

from pymc_features import ModalFeature, SpringMassChain, modes
from pymc_features.modal import ModalData, match_modes
from pymc_features.modal.feature import checked_parameters
from pymc_features.modal.identified import LEAST, identified
from pymc_features.structures import ModalDamping
from support.graphs import LIGHT, PLAIN
from support.refusals import refusals

RNG = np.random.default_rng(3)
F, ZETA, PHI = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.01, 0.02, 0.015, 0.03]), RNG.normal(size=(4, 5))
LABELS, MODES = ["a", "b", "a", "a", "b", "c"], [0, 2, 0, 0, 2, 1]  # the mode of the model that each is near
PLACES = {0: [0, 2, 3], 2: [1, 4], 1: [5]}
SIGMA = {"sigma_f": 0.02, "sigma_zeta": 0.2, "sigma_phi": 0.1}


def measured(seed=2, missing=True):
    """Six identifications of three modes, with standard deviations of all, some of them missing."""
    rng = np.random.default_rng(seed)
    shapes = rng.choice([-2.0, 1.0], (6, 1)) * PHI[MODES] * (1.0 + 0.05 * rng.normal(size=(6, 5)))
    data = {
        "frequencies": F[MODES] * np.exp(0.02 * rng.normal(size=6)),
        "damping_ratios": ZETA[MODES] * np.exp(0.3 * rng.normal(size=6)),
        "shapes": shapes,
    }
    data["frequency_sd"] = data["frequencies"] * rng.uniform(0.003, 0.01, 6)
    data["damping_sd"] = data["damping_ratios"] * rng.uniform(0.05, 0.2, 6)
    data["shape_sd"] = abs(shapes) * rng.uniform(0.02, 0.1, shapes.shape)
    if missing:
        data["damping_ratios"][2] = np.nan
        data["shapes"][[0, 1, 5], [1, 0, 4]] = np.nan
        data["shapes"][3] = np.nan
    return data


def log_likelihoods(data, found=(F, PHI, ZETA), labels=LABELS, **changed):
    """Of each label, as the model has it."""
    with pm.Model() as model:
        rv = ModalFeature("y", found, observed=data, labels=labels, **(SIGMA | changed))
        [logp] = model.logp(vars=[rv], sum=False)
    return logp


def of_logarithms(values, sd, model, sigma):
    """Log-density of several identifications of one number: an error of the model for all, a scatter each."""
    known = ~np.isnan(values)
    covariance = sigma**2 + np.diag((sd[known] / values[known]) ** 2)
    return stats.multivariate_normal(np.zeros(known.sum()), covariance).logpdf(np.log(values[known] / model))


def of_entries(shapes, variances, model, sigma):
    """Log-density of the part of all shapes of a mode, stacked, that no scale of any of them changes.

    Entries are of a root mean square of one; `variances` are those of their scatter.
    """
    shapes, variances = (x[~np.isnan(shapes).all(axis=1)] for x in (shapes, variances))
    known = ~np.isnan(shapes)
    x = shapes / np.sqrt(np.nanmean(shapes**2, axis=1, keepdims=True))
    x *= np.sign(np.nansum(x * x[:1], axis=1, keepdims=True))
    row, channel = np.nonzero(known)
    covariance = sigma**2 * (channel[:, None] == channel) + np.diag(variances[known])
    scales = np.where(row[:, None] == np.arange(len(shapes)), model[channel][:, None], 0.0)
    across = linalg.null_space(scales.T)
    law = stats.multivariate_normal(np.zeros(across.shape[1]), across.T @ covariance @ across)
    return law.logpdf(across.T @ x[known])


def relative_variances(data):
    """Variances of entries where the mean square of each shape is one."""
    known = ~np.isnan(data["shapes"])
    squares = np.nansum(data["shapes"] ** 2, axis=1, keepdims=True)
    return data["shape_sd"] ** 2 / np.where(squares > 0.0, squares, 1.0) * known.sum(axis=1, keepdims=True)


@pytest.mark.parametrize("missing", [False, True])
def test_closed_forms_against_multivariate_normal_distributions(missing):
    data = measured(missing=missing)
    expected = []
    for mode, rows in PLACES.items():
        of_f = of_logarithms(data["frequencies"][rows], data["frequency_sd"][rows], F[mode], 0.02)
        of_zeta = of_logarithms(data["damping_ratios"][rows], data["damping_sd"][rows], ZETA[mode], 0.2)
        of_shapes = of_entries(data["shapes"][rows], relative_variances(data)[rows], PHI[mode], 0.1)
        expected.append([of_f, of_zeta, of_shapes])
    whole = log_likelihoods(data, density="NORMAL").eval(mode=PLAIN)
    np.testing.assert_allclose(whole, np.sum(expected, axis=1), rtol=1e-10)
    alone = {name: data[name] for name in ("frequencies", "frequency_sd", "damping_ratios", "damping_sd")}
    damped = log_likelihoods(alone, (F, np.zeros((4, 0)), ZETA), sigma_phi=None).eval(mode=PLAIN)
    np.testing.assert_allclose(damped, np.sum(expected, axis=1) - np.array(expected)[:, 2], rtol=1e-10)


def test_lone_shapes_without_labels_and_without_an_error_of_the_model():
    """sigma_phi may be zero where each entry has a standard deviation."""
    data = measured(missing=False)
    data = {name: values[[0, 5, 1]] for name, values in data.items()}
    logp = log_likelihoods(data, labels=None, density="NORMAL", sigma_phi=0.0, sigma_zeta=0.0, sigma_f=0.0)
    variances, order = relative_variances(data), [0, 1, 2]
    expected = [
        of_logarithms(data["frequencies"][[i]], data["frequency_sd"][[i]], F[mode], 0.0)
        + of_logarithms(data["damping_ratios"][[i]], data["damping_sd"][[i]], ZETA[mode], 0.0)
        + of_entries(data["shapes"][[i]], variances[[i]], PHI[mode], 0.0)
        for i, mode in zip(order, [0, 1, 2], strict=True)
    ]
    np.testing.assert_allclose(logp.eval(mode=PLAIN), expected, rtol=1e-10)


@pytest.mark.parametrize("labels", [None, LABELS])
def test_scale_and_sense_of_a_shape_mean_nothing(labels):
    data = measured()
    factors = np.array([-3.0, 0.1, 5.0, 1.0, -0.2, 1e3])[:, None]
    turned = data | {"shapes": factors * data["shapes"], "shape_sd": abs(factors) * data["shape_sd"]}
    found = (np.append(F, [5.0, 6.0]), np.vstack([PHI, PHI[:2] + 1.0]), np.append(ZETA, [0.01, 0.02]))
    first, second = (
        log_likelihoods(x, found, labels, density="NORMAL").eval(mode=PLAIN) for x in (data, turned)
    )
    np.testing.assert_allclose(second, first, rtol=1e-9)
    scaled = (found[0], -7.0 * found[1], found[2])
    np.testing.assert_allclose(
        log_likelihoods(data, scaled, labels, density="NORMAL").eval(mode=PLAIN), first, rtol=1e-9
    )


def test_unknown_standard_deviations_are_pooled_where_a_mode_has_several():
    """Of ln zeta and of entries; a lone one has the error of the model alone."""
    data = measured(missing=False) | {"damping_sd": None, "shape_sd": None}
    _, of_zeta, of_entries = identified(data, LABELS, damping=True).scatter(by_entry=True)
    x = np.log(data["damping_ratios"])
    squares = sum(np.sum((x[rows] - x[rows].mean()) ** 2) for rows in PLACES.values())
    np.testing.assert_allclose(
        of_zeta[:2][[0, 0, 0, 1, 1], [0, 1, 2, 0, 1]], np.sqrt(squares / 3), rtol=1e-12
    )
    assert of_zeta[2, 0] == 0.0 and not of_entries[2].any()
    pooled = identified(data, LABELS).scatter()[2]
    np.testing.assert_allclose(of_entries.reshape(3, 3, 5)[0], np.full((3, 5), pooled[0, 0]), rtol=1e-12)
    same = identified({"frequencies": [1.0, 1.0], "damping_ratios": [0.01, 0.01]}, ["a", "a"], damping=True)
    np.testing.assert_allclose(same.scatter()[1], LEAST)
    assert np.isfinite(log_likelihoods(data, density="NORMAL").eval(mode=PLAIN)).all()


@pytest.mark.parametrize("labels", [None, LABELS])
def test_gradients(labels):
    """Against central differences, by frequencies, shapes, damping ratios and scales."""
    count = 6 if labels is None else 4
    f, shapes, zeta, scales = (
        pt.tensor(shape=shape, dtype="float64") for shape in ((count,), (count, 5), (count,), (3,))
    )
    errors = {name: scales[i] for i, name in enumerate(("sigma_f", "sigma_zeta", "sigma_phi"))}
    logp = log_likelihoods(measured(), (f, shapes, zeta), labels, density="NORMAL", **errors).sum()
    inputs = [f, shapes, zeta, scales]
    value = pytensor.function(inputs, logp, mode=PLAIN)
    slopes = pytensor.function(inputs, pt.grad(logp, inputs), mode=PLAIN)
    more = np.random.default_rng(1).normal(size=(2, 5))
    point = [np.append(F, [5.0, 6.0]), np.vstack([PHI, more]), np.append(ZETA, [0.01, 0.02])]
    point = [*(x[:count] for x in point), np.array([0.03, 0.25, 0.2])]
    for k, slope in enumerate(slopes(*point)):
        for at in np.ndindex(slope.shape):
            moved = []
            step = 1e-6 * (0.01 if k == 2 else 1.0)
            for h in (step, -step):
                changed = [x.copy() for x in point]
                changed[k][at] += h
                moved.append(value(*changed))
            assert slope[at] == pytest.approx((moved[0] - moved[1]) / (2.0 * step), rel=2e-5, abs=1e-4)


def test_modes_without_damping_or_standard_deviations_are_fine():
    """A mode without a ratio has the log-likelihood of its frequency; without `sigma_zeta` nobody asks."""
    data = measured(missing=False)
    data["damping_ratios"][5] = np.nan
    alone = {name: data[name] for name in ("frequencies", "frequency_sd", "damping_ratios", "damping_sd")}
    found = F, np.zeros((4, 0)), ZETA
    with_damping = log_likelihoods(alone, found, sigma_phi=None).eval(mode=PLAIN)
    without = log_likelihoods(alone, found, sigma_phi=None, sigma_zeta=None).eval(mode=PLAIN)
    assert with_damping[2] == pytest.approx(without[2], rel=1e-12)
    assert (with_damping[:2] != without[:2]).all()
    plain = {name: data[name] for name in ("frequencies", "frequency_sd")}
    np.testing.assert_array_equal(
        without, log_likelihoods(plain, (F,), sigma_phi=None, sigma_zeta=None).eval(mode=PLAIN)
    )


def test_a_model_without_damping_cannot_have_damped_data():
    data = {"frequencies": [0.98, 2.0], "damping_ratios": [0.01, np.nan]}
    logp = log_likelihoods(data, (F[:2], np.zeros((2, 0)), np.zeros(2)), None, sigma_phi=None)
    got = logp.eval(mode=PLAIN)
    assert got[0] == -np.inf and np.isfinite(got[1])


def test_what_is_no_structure_is_impossible():
    """NaN in shapes or damping ratios, without a gradient that is NaN."""
    shapes, ratios = pt.matrix("shapes", shape=(4, 5)), pt.vector("ratios", shape=(4,))
    logp = log_likelihoods(measured(), (F, shapes, ratios), density="NORMAL").sum()
    function = pytensor.function([shapes, ratios], [logp, *pt.grad(logp, [shapes, ratios])], mode=PLAIN)
    for spoilt in ((np.full((4, 5), np.nan), ZETA), (PHI, np.full(4, np.nan))):
        value, *slopes = function(*spoilt)
        assert value == -np.inf and all(np.isfinite(slope).all() for slope in slopes)


TWO = {"frequencies": [1.0, 2.0], "damping_ratios": [0.01, 0.02], "damping_sd": [0.001, 0.002]}
TWO |= {"shapes": PHI[:2], "shape_sd": 0.1 * abs(PHI[:2])}
REFUSED = {
    "`damping_ratios` must be known where `sigma_zeta` is given, got none. Leave out `sigma_zeta`": {
        "observed": TWO | {"damping_ratios": None}
    },
    "`damping_ratios` must be positive to be compared, got zero of mode 1. Pass NaN where it is not": {
        "observed": TWO | {"damping_ratios": [0.01, 0.0]}
    },
    "`damping_ratios` must be fractions from 0 to 1, got 1.2. Divide a percentage by 100": {
        "observed": TWO | {"damping_ratios": [1.2, 0.9]}
    },
    "`damping_sd` must be at least 0, or NaN": {"observed": TWO | {"damping_sd": [-0.1, 0.1]}},
    "`modes` must have damping ratios .m,. where `sigma_zeta` is given, got frequencies and shapes": {
        "modes": (F, PHI)
    },
    "`sigma_zeta` must be positive and finite, got -0.1": {"sigma_zeta": -0.1},
    "`sigma_zeta` must be positive and finite, got 0.0": {
        "sigma_zeta": 0.0,
        "observed": TWO | {"damping_sd": None},
    },
    "`sigma_phi` must be positive and finite, got 0.0": {
        "sigma_phi": 0.0,
        "observed": TWO | {"shape_sd": None},
    },
    '`shapes` must be real for density="NORMAL", got complex ones. Pass `observed.real..`': {
        "observed": TWO | {"shapes": 1j * PHI[:2]}
    },
    r"`shape_sd` must have shape \(mode, channel\) = \(2, 5\), got \(2, 3\)": {
        "observed": TWO | {"shape_sd": PHI[:2, :3]}
    },
    "`modes` must be frequencies .m,., shapes .m, s. and perhaps damping ratios .m,., got 1, 2 and 2": {
        "modes": (F, PHI, PHI)
    },
}


@refusals("changed", REFUSED)
def test_refusals(changed, match):
    arguments = {"modes": (F, PHI, ZETA), "observed": TWO, "density": "NORMAL"} | SIGMA | changed
    with pytest.raises(ValueError, match=match), pm.Model():
        ModalFeature("y", arguments.pop("modes"), **arguments)


def test_in_a_model():
    """Names of the entries, one log-likelihood for each mode, draws near the data, and their partners."""
    data = ModalData(
        F[:2],
        PHI[:2],
        [*"abcde"],
        damping_ratios=ZETA[:2],
        damping_sd=0.1 * ZETA[:2],
        shape_sd=0.05 + 0 * PHI[:2],
    )
    light = {"compile_kwargs": {"mode": LIGHT}}
    with pm.Model() as model:
        factor = pm.LogNormal("factor", 0.0, 0.01)
        sigma = SIGMA | {"sigma_zeta": pm.HalfNormal("sigma_zeta", 0.2)}
        ModalFeature("y", (F * factor, PHI, ZETA), observed=data, density="NORMAL", **sigma)
        prior = pm.sample_prior_predictive(30, random_seed=1, **light)
        table = match_modes()
    assert model.coords["y_entry"][:3] == ("frequency", "damping", "shape 0")
    drawn = prior.prior_predictive["y"].sel(chain=0)
    np.testing.assert_allclose(np.exp(np.log(drawn[..., 1]).mean("draw")), ZETA[:2], rtol=0.3)
    np.testing.assert_array_equal(table["model_mode"], [0, 1])
    likelihood = model.compile_logp(mode=PLAIN)(model.initial_point())
    assert np.isfinite(likelihood)


@pytest.mark.statistical
def test_draws_have_the_covariances_of_the_density():
    """Of ln zeta and of the entries of shapes, of 4,000 draws: to five errors, 5 sqrt(2 / 4000) = 11 %."""
    data = measured(missing=False)
    found = identified(data, LABELS, damping=True)
    parameters = checked_parameters((F, PHI, ZETA), found, 0.02, 0.1, "NORMAL", 0.2)
    draws = pm.draw(ModalFeature.dist(*parameters, size=(4000, 3)), random_seed=3)[:, 0].reshape(4000, 3, 7)
    _, of_zeta, of_entries = found.scatter(by_entry=True)
    covariance = np.cov(np.log(draws[:, :, 1]).T)
    np.testing.assert_allclose(covariance, 0.2**2 + np.diag(of_zeta[0] ** 2), rtol=0.11)
    of_channel = of_entries.reshape(3, 3, 5)[0, :, 2]
    np.testing.assert_allclose(
        np.cov(draws[:, :, 4].T), 0.1**2 + np.diag(of_channel), rtol=0.11, atol=0.11 * 0.1**2
    )


def test_a_population_of_structures_is_one_call():
    """Frequencies, damping ratios and shapes of modes that follow the parameters."""
    from pytensor.graph.replace import vectorize_graph

    x, rows = pt.vector("x", shape=(2,)), pt.matrix("rows", shape=(None, 2))
    chain = SpringMassChain(np.ones(3), 100.0 * x[0], ModalDamping(0.02 * x[1]))
    data = {
        "frequencies": [0.7, 2.0],
        "damping_ratios": [0.018, 0.025],
        "shapes": [[0.3, 0.6, 0.8], [-0.7, -0.3, 0.6]],
    }
    logp = log_likelihoods(data, modes(chain), None, density="NORMAL").sum()
    batch = vectorize_graph(logp, {x: rows})
    function = pytensor.function([rows], [batch, pt.grad(batch.sum(), rows)], mode=LIGHT)
    one = pytensor.function([x], [logp, pt.grad(logp, x)], mode=PLAIN)
    points = np.random.default_rng(4).uniform(0.7, 1.4, (4, 2))
    for value, slope, point in zip(*function(points), points, strict=True):
        expected = one(point)
        assert value == pytest.approx(expected[0], rel=1e-11)
        np.testing.assert_allclose(slope, expected[1], rtol=1e-8, atol=1e-9)


@pytest.mark.statistical
def test_intervals_of_damping_cover():
    """90 % intervals of Rayleigh's alpha and beta in 200 laboratories hold the truth in 83 to 97 %.

    The truth is drawn from the prior, so that 90 % is exact; 7 % are 3.3 standard errors of a binomial: one
    of the two is a false alarm in one of 500 seeds. An error of the model of each test, the negative control,
    covers less than two thirds. A thousand: python -m benchmarks --only coverage --names damping.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    try:
        from benchmarks.coverage.damping import coverage
    finally:
        sys.path.pop(0)
    shares = coverage(200)
    assert ((shares > 0.83) & (shares < 0.97)).all()
    assert (coverage(100, shared=False) < 0.67).all()
