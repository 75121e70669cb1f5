"""DiscrepancySimulator: a pm.Simulator whose distance is the sum of mean squares, against exact answers."""

import warnings

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pymc.distributions.simulator import SimulatorRV
from pytensor.compile.mode import Mode
from scipy.optimize import brentq

from pymc_features import (
    DiscrepancySimulator,
    ExpFeature,
    ModalDamping,
    RayleighDamping,
    Record,
    SpringMassChain,
    abc_tolerance,
    mean_square_discrepancy,
    response,
    sigma_mpv,
    simulate,
)
from pymc_features.likelihood_free import KERNELS

LIGHT = Mode(linker="py", optimizer="fast_compile")
PRIOR = (0.5, 1.5)


def chain_of(theta):
    base = SpringMassChain(np.ones(3), 100.0, RayleighDamping(0.1, 1e-3))
    return base.scale_stiffness(theta, springs=[0])


@pytest.fixture(scope="module")
def pulse():
    return Record(np.random.default_rng(0).normal(size=60), 0.02, name="pulse")


@pytest.fixture(scope="module")
def measured(pulse):
    exact = simulate(chain_of(1.0), pulse).values
    return exact + 0.05 * np.random.default_rng(1).normal(size=exact.shape)


@pytest.fixture(scope="module")
def rho(pulse, measured):
    """S(theta) of Eq. (15), by a route without PyMC."""

    def total(theta):
        return np.square(simulate(chain_of(theta), pulse).values - measured).mean(axis=1).sum()

    return total


def build_model(pulse, measured, *, epsilon, kernel="uniform", theta=None, **kwargs):
    with pm.Model() as model:
        theta = pm.Uniform("theta", *PRIOR) if theta is None else theta()
        mu = response(chain_of(theta), pulse)
        DiscrepancySimulator("y", mu, epsilon=epsilon, observed=measured, kernel=kernel, **kwargs)
    return model


def log_likelihood(model):
    """Function theta -> log-likelihood of the node."""
    function = model.compile_logp(vars=model.observed_RVs, jacobian=False, mode=LIGHT)

    def at(theta):
        logit = np.log((theta - PRIOR[0]) / (PRIOR[1] - theta))
        return float(function({"theta_interval__": logit}))

    return at


# --------------------------------------------------------------------------- the node


def test_is_a_simulator_of_pymc(pulse, measured):
    model = build_model(pulse, measured, epsilon=1.0)
    node = model["y"]
    assert isinstance(node.owner.op, SimulatorRV)
    assert model.observed_RVs == [node]
    assert node.type.ndim == 2
    np.testing.assert_array_equal(model.rvs_to_values[node].data, measured)


def test_uniform_kernel_is_a_step_at_the_tolerance(pulse, measured, rho):
    """0 inside, -inf outside; the edge found on the grid of theta by another route."""
    epsilon = 1.5 * rho(1.0)
    logp = log_likelihood(build_model(pulse, measured, epsilon=epsilon))
    values = {theta: logp(theta) for theta in np.linspace(0.55, 1.45, 91)}
    for theta, value in values.items():
        assert value == (0.0 if rho(theta) <= epsilon else -np.inf)
    assert 3 <= sum(v == 0.0 for v in values.values()) < 88
    for kernel_epsilon, expected in ((rho(1.2) * (1 + 1e-9), 0.0), (rho(1.2) * (1 - 1e-9), -np.inf)):
        assert log_likelihood(build_model(pulse, measured, epsilon=kernel_epsilon))(1.2) == expected


def test_exponential_kernel_is_exp_at_fixed_sigma(pulse, measured, rho):
    """epsilon = 2 sigma^2: ExpFeature up to -N_0 ln(2 sigma^2), Eq. (9)."""
    sigma = 0.13
    logp = log_likelihood(build_model(pulse, measured, epsilon=2 * sigma**2, kernel="exponential"))
    with pm.Model() as model:
        mu = response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        ExpFeature("y", mu=mu, sigma=sigma, observed=measured)
    feature = log_likelihood(model)
    constant = 3 * np.log(2 * sigma**2)
    for theta in (0.6, 0.9, 1.0, 1.3):
        assert logp(theta) == pytest.approx(feature(theta) + constant, rel=1e-10)
        assert logp(theta) == pytest.approx(-rho(theta) / (2 * sigma**2), rel=1e-10)


def test_gaussian_kernel(pulse, measured, rho):
    logp = log_likelihood(build_model(pulse, measured, epsilon=0.2, kernel="gaussian"))
    for theta in (0.6, 0.9, 1.0, 1.3):
        assert logp(theta) == pytest.approx(-0.5 * (rho(theta) / 0.2) ** 2, rel=1e-10)


@pytest.mark.parametrize("kernel", KERNELS)
def test_failed_simulation_is_outside(pulse, measured, kernel):
    """A spring that a draw makes negative: -inf, not an exception."""
    model = build_model(pulse, measured, epsilon=10.0, kernel=kernel, theta=lambda: pm.Normal("theta"))
    function = model.compile_logp(vars=model.observed_RVs, mode=LIGHT)
    assert function({"theta": -1.0}) == -np.inf
    assert np.isfinite(function({"theta": 1.0}))


def test_tolerance_may_be_data(pulse, measured, rho):
    with pm.Model() as model:
        epsilon = pm.Data("epsilon", 2 * rho(1.2))
        mu = response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        DiscrepancySimulator("y", mu, epsilon=epsilon, observed=measured)
    logp = log_likelihood(model)
    assert logp(1.2) == 0.0
    with model:
        pm.set_data({"epsilon": 0.5 * rho(1.2)})
    assert logp(1.2) == -np.inf


def test_data_may_be_data(pulse, measured, rho):
    with pm.Model() as model:
        data = pm.Data("measured", measured)
        mu = response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        DiscrepancySimulator("y", mu, epsilon=1.0, observed=data, kernel="exponential")
    logp = log_likelihood(model)
    assert logp(0.8) == pytest.approx(-rho(0.8), rel=1e-10)
    with model:
        pm.set_data({"measured": measured + 1.0})
    shifted = np.square(simulate(chain_of(0.8), pulse).values - measured - 1.0).mean(axis=1).sum()
    assert logp(0.8) == pytest.approx(-shifted, rel=1e-10)


def test_response_may_be_recorded(pulse, measured, rho):
    with pm.Model() as model:
        mu = pm.Deterministic("mu", response(chain_of(pm.Uniform("theta", *PRIOR)), pulse))
        DiscrepancySimulator("y", mu, epsilon=1.0, observed=measured, kernel="exponential")
    assert log_likelihood(model)(0.8) == pytest.approx(-rho(0.8), rel=1e-10)


def test_all_random_parameters_of_a_structure_reach_the_simulator(pulse, measured):
    """Mass, stiffness, Rayleigh pair and ratios; output step, sensors, modes and quantity as asked."""
    asked = {"dt": 0.04, "sensors": [2, 0], "n_modes": 2, "quantity": "relative_velocity"}
    cases = {
        "mass": lambda x: SpringMassChain([1.0, x, 1.0], 100.0, ModalDamping(0.05)),
        "stiffness": lambda x: SpringMassChain(np.ones(3), [100.0, 90.0, 100.0 * x], ModalDamping(0.05)),
        "rayleigh": lambda x: SpringMassChain(np.ones(3), 100.0, RayleighDamping(x, 1e-3)),
        "ratios": lambda x: SpringMassChain(np.ones(3), 100.0, ModalDamping(0.05 * x)),
    }
    data = measured[:2, :30]
    for name, build in cases.items():
        with pm.Model() as model:
            mu = response(build(pm.Uniform("theta", *PRIOR)), pulse, **asked)
            DiscrepancySimulator("y", mu, epsilon=1.0, observed=data, kernel="exponential")
        exact = np.square(simulate(build(0.8), pulse, **asked).values - data).mean(axis=1).sum()
        assert log_likelihood(model)(0.8) == pytest.approx(-exact, rel=1e-10), name


# --------------------------------------------------------------------------- Python functions


def shelf(theta):
    """A function of one parameter: what a user's own solver would be."""
    return np.outer([1.0, 2.0], np.sin(theta * np.arange(5.0)))


def line(slope, offsets):
    """A scalar and a vector parameter."""
    return offsets[:, None] + slope * np.arange(5.0)


def test_function_of_one_parameter():
    data = shelf(0.9) + 0.1
    with pm.Model() as model:
        theta = pm.Uniform("theta", *PRIOR)
        DiscrepancySimulator("y", shelf, theta, epsilon=0.5, observed=data, kernel="exponential")
    exact = np.square(shelf(1.2) - data).mean(axis=1).sum()
    assert log_likelihood(model)(1.2) == pytest.approx(-exact / 0.5, rel=1e-12)


def test_function_of_a_scalar_and_a_vector():
    data = np.random.default_rng(0).normal(size=(2, 5))
    with pm.Model() as model:
        slope, offsets = pm.Normal("slope"), pm.Normal("offsets", shape=2)
        DiscrepancySimulator("y", line, slope, offsets, epsilon=0.5, observed=data, kernel="gaussian")
        prior = pm.sample_prior_predictive(6, random_seed=1, compile_kwargs={"mode": LIGHT})
    logp = model.compile_logp(vars=model.observed_RVs, mode=LIGHT)
    point = {"slope": 0.3, "offsets": np.array([1.0, -1.0])}
    exact = np.square(line(**point) - data).mean(axis=1).sum()
    assert float(logp(point)) == pytest.approx(-0.5 * (exact / 0.5) ** 2, rel=1e-12)
    draws = prior["prior"].dataset.isel(chain=0)
    for k in range(6):
        expected = line(float(draws["slope"][k]), draws["offsets"].values[k])
        np.testing.assert_allclose(prior["prior_predictive"]["y"].values[0, k], expected, rtol=1e-12)


def test_simulator_function_takes_batches(pulse, measured):
    """Parameters of a batch, or a size, as PyMC passes them; NaN stays in its own row."""
    with pm.Model():
        mu = response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        node = DiscrepancySimulator("y", mu, epsilon=1.0, observed=measured)
    function = node.owner.op.fn
    springs = np.array([[70.0, 100.0, 100.0], [-1.0, 100.0, 100.0], [130.0, 100.0, 100.0]])
    rest = np.array([0.1, 1e-3]), np.zeros(3)
    histories = function(None, np.ones(3), springs, *rest, None)
    assert histories.shape == (3, 3, 60)
    for row, theta in ((0, 0.7), (2, 1.3)):
        np.testing.assert_allclose(histories[row], simulate(chain_of(theta), pulse), rtol=1e-10)
    assert np.isnan(histories[1]).all()
    repeated = function(None, np.ones(3), springs[0], *rest, (2, 1))
    np.testing.assert_array_equal(repeated, np.tile(histories[0], (2, 1, 1, 1)))


# --------------------------------------------------------------------------- sampling


def exact_interval(rho, epsilon):
    """The two thetas where rho = epsilon, around the smallest rho."""
    grid = np.linspace(*PRIOR, 201)
    values = np.array([rho(theta) for theta in grid])
    inside = np.flatnonzero(values <= epsilon)
    assert (np.diff(inside) == 1).all(), "one interval"
    assert 0 < inside[0] <= inside[-1] < 200, "inside the prior"
    first, last = grid[inside[[0, -1]]]
    step = grid[1] - grid[0]
    gap = lambda theta: rho(theta) - epsilon  # noqa: E731
    return brentq(gap, first - step, first), brentq(gap, last, last + step)


def test_stock_smc_fills_the_exact_interval(pulse, measured, rho):
    """ABC posterior under a flat prior: uniform on {theta: rho <= epsilon}.

    Quantiles 5, 50, 95 % of 2 x 1000 draws: the standard error is 1.5 % of the width at the median
    (measured over ten seeds) and a third of it elsewhere; the limit of 6 % is four of them, a false
    alarm in 1e4 seeds. The prior is the negative control.
    """
    e = mean_square_discrepancy(simulate(chain_of(1.0), pulse).values, measured)
    epsilon = abc_tolerance(1.5 * sigma_mpv(e), n_sensors=3)
    low, high = exact_interval(rho, epsilon)
    model = build_model(pulse, measured, epsilon=epsilon)
    with model, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        idata = pm.sample_smc(
            1000, chains=2, cores=1, random_seed=3, progressbar=False, compute_convergence_checks=False
        )
    theta = idata.posterior["theta"].values.ravel()
    assert theta.size == 2000
    slack = 1e-9 * (high - low)
    assert ((theta >= low - slack) & (theta <= high + slack)).all()
    assert all(rho(t) <= epsilon for t in theta[::50])
    fractions = np.array([0.05, 0.5, 0.95])
    exact = low + fractions * (high - low)
    np.testing.assert_allclose(np.quantile(theta, fractions), exact, atol=0.06 * (high - low))
    prior = PRIOR[0] + fractions * (PRIOR[1] - PRIOR[0])
    assert np.abs(prior - exact).max() > 0.06 * (high - low)


def test_predictive_draws_are_histories(pulse, measured):
    """Prior and posterior predictive: the response itself at each draw, with dimensions."""
    coords = {"sensor": ["low", "middle", "top"], "time": pulse.time}
    with pm.Model(coords=coords) as model:
        mu = response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        DiscrepancySimulator("y", mu, epsilon=1.0, observed=measured, dims=("sensor", "time"))
        prior = pm.sample_prior_predictive(5, random_seed=1, compile_kwargs={"mode": LIGHT})
        predictive = pm.sample_posterior_predictive(
            prior["prior"].dataset, random_seed=2, progressbar=False, compile_kwargs={"mode": LIGHT}
        )["posterior_predictive"]["y"]
    assert model.named_vars_to_dims["y"] == ("sensor", "time")
    for values in (prior["prior_predictive"]["y"], predictive):
        assert values.dims == ("chain", "draw", "sensor", "time")
        assert values.shape == (1, 5, 3, 60)
        for k, theta in enumerate(prior["prior"]["theta"].values[0]):
            expected = simulate(chain_of(theta), pulse).values
            np.testing.assert_allclose(values.values[0, k], expected, rtol=1e-10, atol=1e-12)


# --------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("changes", "error", "match"),
    [
        ({"kernel": "box"}, ValueError, "`kernel` must be one of uniform, exponential, gaussian, got 'box'"),
        ({"epsilon": 0.0}, ValueError, "`epsilon` must be positive and finite, got 0.0. Pass a tolerance"),
        ({"epsilon": -1}, ValueError, "`epsilon` must be positive and finite, got -1"),
        ({"epsilon": np.nan}, ValueError, "`epsilon` must be positive and finite, got nan"),
        ({"epsilon": np.inf}, ValueError, "`epsilon` must be positive and finite, got inf"),
        ({"mu": np.zeros((3, 60))}, TypeError, "`mu` must be what `response` returned or a function, got nd"),
        ({"mu": pt.zeros((3, 60))}, TypeError, "got another PyTensor expression. Pass a function"),
        ({"mu": shelf}, ValueError, "`params` must be given with a function, got none. Pass its parameters"),
        ({"params": (1.0,)}, ValueError, "`params` must be left out when `mu` is a response: it has its own"),
        ({"observed": np.zeros(60)}, ValueError, r"must be \(sensor, time\) to match a response, got shape"),
        ({"observed": np.full((3, 60), np.nan)}, ValueError, "`observed` must be finite numbers of shape"),
        (
            {"observed": np.zeros((60, 3))},
            ValueError,
            r"\(3, 60\) to match `mu`, got \(60, 3\). Transpose it",
        ),
        (
            {"observed": np.zeros((3, 59))},
            ValueError,
            r"\(3, 60\) to match `mu`, got \(3, 59\). Give one row",
        ),
    ],
)
def test_refusals(pulse, measured, changes, error, match):
    with pm.Model():
        theta = pm.Uniform("theta", *PRIOR)
        mu = changes.get("mu", response(chain_of(theta), pulse))
        arguments = {"epsilon": 1.0, "observed": measured} | changes
        params = arguments.pop("params", ())
        arguments.pop("mu", None)
        with pytest.raises(error, match=match):
            DiscrepancySimulator("y", mu, *params, **arguments)


def test_scaled_response_is_refused(pulse, measured):
    with pm.Model(), pytest.raises(TypeError, match="must be what `response` returned, got another PyTensor"):
        mu = 2.0 * response(chain_of(pm.Uniform("theta", *PRIOR)), pulse)
        DiscrepancySimulator("y", mu, epsilon=1.0, observed=measured)
