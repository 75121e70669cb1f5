"""Several identifications of one mode: one error of the model, scatter for each, and what follows from it."""

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
import xarray as xr
from scipy import stats
from scipy.special import gammaln

from pymc_features import ModalDamping, ModalFeature, SpringMassChain, modes
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal import mac, match_modes
from pymc_features.modal.feature import checked_parameters
from pymc_features.modal.identified import LEAST, identified
from support.graphs import LIGHT, PLAIN

LABELS = ["a", "b", "a", "a", "b", "c"]
FOUND = np.array([1.0, 2.0, 3.0, 4.0]), np.random.default_rng(1).normal(size=(4, 5))


def measured(seed=2, kind=float, missing=False):
    """Six identifications of the modes 0, 2 and 1 at five channels, with standard deviations."""
    rng, which = np.random.default_rng(seed), [0, 2, 0, 0, 2, 1]
    shapes = rng.choice([-2.0, 1.0], (6, 1)) * FOUND[1][which] + 0.1 * rng.normal(size=(6, 5))
    if kind is complex:
        shapes = shapes * np.exp(1j * rng.uniform(0.0, 6.0, (6, 1)))
    if missing:
        shapes[[0, 2, 3], 1] = np.nan
    sd = FOUND[0][which] * rng.uniform(0.003, 0.01, 6)
    return {
        "frequencies": FOUND[0][which] * np.exp(0.02 * rng.normal(size=6)),
        "frequency_sd": sd,
        "shapes": shapes,
    }


def log_likelihoods(data, found=FOUND, labels=LABELS, **kwargs):
    """Of each label, as the model has it."""
    scales = {"sigma_f": 0.02, "sigma_phi": 0.1} | kwargs
    with pm.Model() as model:
        rv = ModalFeature("y", found, observed=data, labels=labels, **scales)
        [logp] = model.logp(vars=[rv], sum=False)
    return logp


def of_frequencies(data, mode, rows, sigma_f):
    """Log-density of the identifications `rows` of one mode, by SciPy."""
    s = (data["frequency_sd"] / data["frequencies"])[rows]
    covariance = np.diag(s**2) + sigma_f**2
    x = np.log(data["frequencies"][rows] / FOUND[0][mode])
    return stats.multivariate_normal(np.zeros(len(rows)), covariance).logpdf(x)


def of_shapes(data, mode, rows, sigma_phi, m):
    """That of their shapes, with dense matrices; a lone shape has the error of the model alone."""
    shapes, groups = data["shapes"], np.array([[label == one for label in LABELS] for one in "abc"])
    known = ~np.isnan(shapes)
    x = np.where(known, shapes, 0.0)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    for row in groups:  # in the sense of the first
        first = x[np.flatnonzero(row)[0]]
        phase = x @ first.conj()
        x = np.where(row[:, None], x * (phase.conj() / abs(phase))[:, None], x)
    means = np.array([x[row].mean(axis=0) for row in groups])
    squares = sum((abs(x[row] - mean) ** 2).sum() for row, mean in zip(groups, means, strict=True))
    free = sum(np.maximum(known[row].sum(axis=0) - 1, 0).sum() for row in groups)
    s = known[rows[0]].sum()
    phi = np.where(known[rows[0]], FOUND[1][mode], 0.0)
    d = x[rows] - np.outer(x[rows] @ phi / (phi @ phi), phi)
    own = squares / free * s / m if len(rows) > 1 else 0.0
    c = sigma_phi**2 + own * np.eye(len(rows))
    size = m * np.linalg.slogdet(c)[1] + np.trace(np.linalg.solve(c, d @ d.conj().T)).real
    return -0.5 * size - len(rows) * (0.5 * m * np.log(2.0) + gammaln(0.5 * m + 1.0))


@pytest.mark.parametrize("density, m", [("TN", 1), ("EXP", 2), (4.5, 4.5)])
@pytest.mark.parametrize("kind, missing", [(complex, False), (float, True)])
def test_closed_form_against_dense_matrices(kind, missing, density, m):
    """Frequencies against SciPy's multivariate normal, shapes against dense matrices."""
    data = measured(kind=kind, missing=missing)
    got = log_likelihoods(data, density=density).eval(mode=PLAIN)
    places = {0: [0, 2, 3], 2: [1, 4], 1: [5]}
    expected = [
        of_frequencies(data, mode, rows, 0.02) + of_shapes(data, mode, rows, 0.1, m)
        for mode, rows in places.items()
    ]
    np.testing.assert_allclose(got, expected, rtol=1e-10)


def test_gradients_of_repeated_identifications():
    """Against central differences, by frequencies, shapes and scales."""
    f, shapes, scales = (
        pt.vector("f", shape=(4,)),
        pt.matrix("shapes", shape=(4, 5)),
        pt.vector("s", shape=(3,)),
    )
    logp = log_likelihoods(
        measured(missing=True), (f, shapes), sigma_f=scales[0], sigma_phi=scales[1], density=scales[2]
    ).sum()
    inputs = [f, shapes, scales]
    value = pytensor.function(inputs, logp, mode=PLAIN)
    slopes = pytensor.function(inputs, pt.grad(logp, inputs), mode=PLAIN)
    point = [*FOUND, np.array([0.03, 0.2, 2.5])]
    for k, slope in enumerate(slopes(*point)):
        for at in np.ndindex(slope.shape):
            moved = []
            for h in (1e-6, -1e-6):
                changed = [x.copy() for x in point]
                changed[k][at] += h
                moved.append(value(*changed))
            assert slope[at] == pytest.approx((moved[0] - moved[1]) / 2e-6, rel=1e-5, abs=1e-5)


SIGMA, SCATTER, TESTS = 0.02, 0.004, 20


def storeys(theta):
    """Two storeys of theta times 100 N/m: ln f = constant + ln(theta) / 2."""
    return SpringMassChain([1.0, 1.0], [100.0 * theta, 100.0 * theta], ModalDamping(0.0))


def laboratory(rng, theta=1.0):
    """Frequencies [Hz] of the tests of two modes: errors of the model in each mode, scatter in each test."""
    f = storeys(theta).modes().natural_frequencies
    model_error = SIGMA * rng.normal(size=2)
    return (f * np.exp(model_error + SCATTER * rng.normal(size=(TESTS, 2)))).ravel()


def closed_form(data, shared=True):
    """Mean and standard deviation of ln theta, prior N(0, 1/4): ln f = c + ln(theta) / 2 + errors."""
    x = np.log(data.reshape(TESTS, 2) / storeys(1.0).modes().natural_frequencies)
    variance = SIGMA**2 + SCATTER**2 / TESTS if shared else (SIGMA**2 + SCATTER**2) / TESTS
    precision = 4.0 + 2 * 0.25 / variance
    return 0.5 * x.mean(axis=0).sum() / variance / precision, precision**-0.5


def posterior_function():
    """Mean and standard deviation of ln theta by the log-likelihood of the package, for data (2 TESTS,).

    Its posterior is a normal distribution: three points tell both.
    """
    x, y = pt.scalar("x"), pt.matrix("y", shape=(2, TESTS))
    f = np.tile(storeys(1.0).modes().natural_frequencies, TESTS)
    data = identified({"frequencies": f, "frequency_sd": SCATTER * f}, [0, 1] * TESTS)
    parameters = checked_parameters(modes(storeys(pt.exp(x))), data, SIGMA, None, "EXP")
    logp = pm.logp(ModalFeature.dist(*parameters), y).sum()
    value = pytensor.function([x, y], logp - 2.0 * x**2, mode=PLAIN)

    def moments(data):
        low, middle, high = (value(at, data.reshape(TESTS, 2).T) for at in (-0.1, 0.0, 0.1))
        curvature = (2.0 * middle - low - high) / 0.01
        return (high - low) / 0.2 / curvature, curvature**-0.5

    return moments


@pytest.mark.statistical
def test_intervals_of_a_thousand_laboratories_cover():
    """90 % intervals of ln theta in 1,000 laboratories hold the truth in 86 to 94 %, by the closed form.

    The truth is drawn from the prior, so that 90 % is exact; four standard errors of a binomial are 3.8 %: a
    false alarm in 10,000. An error of its own in each test, the negative control, covers less than half.
    Means and standard deviations of the package are those of the closed form to 1e-6, in the first 100.
    """
    rng, posterior, inside = np.random.default_rng(5), posterior_function(), []
    for number in range(1000):
        ln_theta = 0.5 * rng.normal()
        data = laboratory(rng, np.exp(ln_theta))
        exact, independent = closed_form(data), closed_form(data, shared=False)
        if number < 100:
            np.testing.assert_allclose(posterior(data), exact, rtol=1e-6, atol=1e-9)
        inside.append([abs(ln_theta - mean) < 1.645 * sd for mean, sd in (exact, independent)])
    share, of_independent = np.mean(inside, axis=0)
    assert 0.86 < share < 0.94
    assert of_independent < 0.5


def test_log_likelihood_and_draws_of_repeated_identifications():
    """One value for each label; a frequency and a shape in a draw for each identification."""
    data = measured()
    with pm.Model() as model:
        factor = pm.LogNormal("factor", 0.0, 0.01)
        ModalFeature(
            "y", (factor * FOUND[0], FOUND[1]), observed=data, labels=LABELS, sigma_f=0.02, sigma_phi=0.1
        )
        light = {"compile_kwargs": {"mode": LIGHT}}
        prior = pm.sample_prior_predictive(20, random_seed=1, **light).prior.to_dataset()
        posterior = xr.DataTree.from_dict({"posterior": prior})
        drawn = pm.sample_posterior_predictive(posterior, random_seed=2, progressbar=False, **light)
        likelihood = pm.compute_log_likelihood(posterior, progressbar=False, extend_inferencedata=False)
        table = match_modes(posterior)
    assert likelihood["y"].dims == ("chain", "draw", "y_mode") and likelihood["y"].shape == (1, 20, 3)
    assert model.coords["y_mode"] == ("a", "b", "c")
    entries = [f"{what}.{j}" for j in range(3) for what in ["frequency", *(f"shape {c}" for c in range(5))]]
    assert list(model.coords["y_entry"]) == entries
    y = drawn.posterior_predictive["y"].sel(chain=0)
    np.testing.assert_allclose(y.sel(y_mode="a", y_entry=["frequency.0", "frequency.2"]), 1.0, rtol=0.15)
    assert not y.sel(y_mode="b", y_entry="frequency.2").any()
    assert list(table["mode"]) == ["a.0", "a.1", "a.2", "b.0", "b.1", "c"]
    np.testing.assert_array_equal(table["model_mode"][0, 0], [0, 0, 0, 2, 2, 1])
    order = [0, 2, 3, 1, 4, 5]
    expected = np.diag(mac(data["shapes"][order], FOUND[1][table["model_mode"][0, 0].values]))
    np.testing.assert_allclose(table["mac"][0, 0], expected, rtol=1e-9)


@pytest.mark.statistical
def test_draws_share_the_error_of_the_model():
    """Covariance of ln f and of the parts of shapes across the model's, of 4,000 draws: to five errors.

    5 sqrt(2 / 4000) of a variance, 11 %. Independent errors, the negative control, would have none.
    """
    data = measured()
    parameters = checked_parameters(FOUND, identified(data, LABELS), 0.02, 0.1, "EXP")
    many = ModalFeature.dist(*parameters, size=(4000, 3))  # all at once
    draws = pm.draw(many, random_seed=3)[:, 0].reshape(4000, 3, 6)
    covariance = np.cov(np.log(draws[:, :, 0]).T)
    own = (data["frequency_sd"] / data["frequencies"])[[0, 2, 3]] ** 2
    np.testing.assert_allclose(covariance, 0.02**2 + np.diag(own), rtol=0.11)
    phi = FOUND[1][0] / np.linalg.norm(FOUND[1][0])
    off = draws[:, :, 1:] - (draws[:, :, 1:] @ phi)[..., None] * phi
    gram = np.einsum("nic,njc->ij", off, off) / 4000
    scatter = identified(data, LABELS).scatter()[2][0, 0]
    np.testing.assert_allclose(gram, 2 * 0.1**2 + scatter * np.eye(3), rtol=0.11)


def test_scatter_is_pooled_over_modes_where_none_was_identified():
    data = np.array([1.0, 1.02, 2.0, 2.0, 3.0])
    found = identified(data, ["a", "a", "b", "b", "c"])
    of_f, _, of_shapes = found.scatter()
    np.testing.assert_allclose(of_f[:2], np.sqrt(0.5 * np.log(1.02) ** 2 / 2), rtol=1e-12)
    assert of_f[2, 0] == 0.0 and not of_shapes.any()
    same = identified([1.0, 1.0], ["a", "a"]).scatter()[0]
    np.testing.assert_allclose(same, LEAST)


def test_a_mode_that_was_found_twice_has_one_partner():
    """Without labels; else the double would take the next mode of the model."""
    shapes = np.random.default_rng(4).normal(size=(2, 4))
    data = {"frequencies": [1.0, 1.001, 1.5], "frequency_sd": [0.002, 0.002, 0.002]}
    data["shapes"] = np.vstack([shapes[0], -1.02 * shapes[0], shapes[1]])
    found = np.array([1.0, 1.5, 1.6]), np.vstack([shapes, shapes[0] + shapes[1]])
    with pytest.warns(ModalMatchWarning, match="modes 1 and 0 .* found twice: .* pass `labels` that"):
        assert list(identified(data).groups.argmax(axis=0)) == [0, 0, 1]
    with pm.Model(), pytest.warns(ModalMatchWarning):
        ModalFeature("y", found, observed=data, sigma_f=pm.HalfNormal("sigma_f", 0.02), sigma_phi=0.1)
        np.testing.assert_array_equal(match_modes()["model_mode"], [0, 0, 1])
    apart = identified(data, ["a", "b", "c"])
    assert len(apart.labels) == 3
    for change in ({"frequencies": [1.0, 1.005, 1.5]}, {"frequency_sd": None}, {"shapes": None}):
        assert len(identified(data | change).labels) == 3
