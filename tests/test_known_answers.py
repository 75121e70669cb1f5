"""The answers that samplers are judged by, checked by routes that do not use their formulas."""

import sys
from pathlib import Path

import numpy as np
import pytest
from pymc.model.transform.conditioning import remove_value_transforms
from scipy import stats

import pymc_features as pmf
from pymc_features.smc.density.evaluation import population_logp
from pymc_features.smc.proposals.proposal import fit_mixture
from pymc_features.study.exact import DiscrepancyCurve, Exponents, exact_posterior

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
try:
    import benchmarks.known as known
    from benchmarks.known import structural
    from benchmarks.known.exact import estimates
finally:
    sys.path.pop(0)

# name: to coordinates in which the target is not bent, back, and ln |dx / dy|
STRAIGHT = {
    "funnel": (
        lambda x: np.column_stack([x[:, 0], x[:, 1:] * np.exp(-0.5 * x[:, :1])]),
        lambda y: np.column_stack([y[:, 0], y[:, 1:] * np.exp(0.5 * y[:, :1])]),
        lambda y: 0.5 * (y.shape[1] - 1) * y[:, 0],
    ),
    "banana": (
        lambda x: np.hstack([first_half(x), second_half(x) - first_half(x) ** 2]),
        lambda y: np.hstack([first_half(y), second_half(y) + first_half(y) ** 2]),
        lambda y: np.zeros(len(y)),
    ),
}
HALF_CAUCHY = stats.halfcauchy(scale=5.0)


def of_tau(tau):
    """Its normal score under the prior."""
    return stats.norm.ppf(HALF_CAUCHY.cdf(tau))


def to_tau(z):
    """Back from there."""
    return HALF_CAUCHY.ppf(stats.norm.cdf(z))


def log_slope_of_tau(z):
    """ln d tau / d z."""
    return stats.norm.logpdf(z) - HALF_CAUCHY.logpdf(to_tau(z))


STRAIGHT["schools_centred"] = (
    lambda x: np.column_stack([x[:, 0], of_tau(x[:, 1]), (x[:, 2:] - x[:, :1]) / x[:, 1:2]]),
    lambda y: np.column_stack([y[:, 0], to_tau(y[:, 1]), y[:, :1] + y[:, 2:] * to_tau(y[:, 1:2])]),
    lambda y: log_slope_of_tau(y[:, 1]) + 8.0 * np.log(to_tau(y[:, 1])),
)
SAME = (lambda x: x, lambda y: y, lambda y: np.zeros(len(y)))
CLOSED = ["gaussian-10", "funnel-10", "banana-10", "modes_1234-10", "schools_centred-10"]
POINTS = 20_000


def first_half(x):
    return x[:, : x.shape[1] // 2]


def second_half(x):
    return x[:, x.shape[1] // 2 :]


def weighted_points(name, problem, rng):
    """Independent points on the model's own scale, and their log weights."""
    to_straight, back, log_slope = STRAIGHT.get(name.split("-")[0], SAME)
    fitted = to_straight(problem.draws(3000, rng))
    mixture = fit_mixture(fitted, np.ones(len(fitted)), rng)
    y = mixture.move(np.zeros((POINTS, fitted.shape[1])), 1.0, rng)
    model = remove_value_transforms(problem.model)  # which changes the order of its variables
    x, names = back(y), [rv.name for rv in model.free_RVs]
    columns = [
        i for name in names for i, label in enumerate(problem.answer.labels) if label.split("[")[0] == name
    ]
    density = population_logp(model, model.initial_point(), {"mode": "FAST_COMPILE"})
    log_prior, log_likelihood, _ = density(x[:, columns])
    return x, log_prior + log_likelihood + log_slope(y) - mixture.log_density(y)


@pytest.mark.slow
@pytest.mark.parametrize("name", CLOSED)
def test_density_integrates_to_the_evidence(name):
    """By importance sampling of the model itself; quantiles of the weighted points are the answer's, too."""
    problem = known.problem(name)
    x, log_weights = weighted_points(name, problem, np.random.default_rng(1))
    weights = np.exp(log_weights - log_weights.max())
    log_z = np.log(weights.mean()) + log_weights.max()
    error = weights.std() / weights.mean() / np.sqrt(POINTS)
    assert error < 0.03
    assert abs(log_z - problem.answer.log_evidence) < 4.0 * error
    found, errors = estimates.of_weighted(x, weights)
    assert (np.abs(found - problem.answer.quantiles) < 5.0 * errors).all()
    wrong = problem.answer.quantiles + 0.1 * problem.answer.width
    assert not (np.abs(found - wrong) < 5.0 * errors).all()


@pytest.mark.parametrize("name", [n for n in known.TARGET_NAMES if n not in ("gaussian-30", "logistic-10")])
def test_exact_draws(name):
    """Shares below the stated quantiles, 5 standard errors at most in all of them, and of the modes."""
    problem = known.problem(name)
    x = problem.draws(40_000, np.random.default_rng(2))
    answer = problem.answer
    assert answer.quantiles.shape == (3, len(answer.labels)) == (3, x.shape[1])
    p = known.PROBABILITIES[:, None]
    shares = np.array([(x <= row).mean(axis=0) for row in answer.quantiles])
    assert (np.abs(shares - p) < 5.0 * np.sqrt(p * (1.0 - p) / len(x))).all()
    if problem.modes is not None:
        w = problem.modes.weights
        assert (np.abs(problem.modes.found(x) - w) < 5.0 * np.sqrt(w * (1.0 - w) / len(x))).all()


@pytest.mark.parametrize("like", ["NORM", "TN", "EXP"])
def test_saved_answers_of_one_factor(like, total_discrepancy):
    """Found by midpoints in the prior's probability; here by the package's own quadrature."""
    sensors, samples = structural.measured(2).shape
    exponents = {
        "NORM": Exponents(sensors * samples, samples, -0.5 * sensors * samples * np.log(2.0 * np.pi)),
        "TN": Exponents(sensors, 1.0, 0.5 * sensors * np.log(2.0 / np.pi)),
        "EXP": Exponents(2.0 * sensors, 1.0, -sensors * np.log(2.0)),
    }
    exact = exact_posterior(total_discrepancy, exponents[like], (1e-9, 2.0))
    answer = known.saved_answer(f"{like}-2-wide")
    quantiles = [m.quantile(known.PROBABILITIES) for m in exact.marginals.values()]
    assert (np.abs(answer.quantiles - np.column_stack(quantiles)) < 1e-5 * answer.width).all()
    np.testing.assert_allclose(answer.log_evidence, exact.log_evidence, atol=1e-6)


@pytest.fixture(scope="module")
def total_discrepancy():
    """S(theta) of the structure with one factor."""
    measured, sensors = structural.measured(2), structural.sensors(2)
    damping = pmf.RayleighDamping(alpha=structural.ALPHA, beta=structural.BETA)

    def total(theta):
        structure = structural.structure(2, np.array([theta]), damping)
        response = pmf.simulate(structure, structural.record(), sensors=sensors).values
        return ((measured - response) ** 2).mean(axis=1).sum()

    return DiscrepancyCurve(total, (0.5, 1.5), measured.size, n_nodes=301)
