"""DiscrepancySimulator: a pm.Simulator whose distance is the sum of mean squares, against exact answers."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pymc.distributions.simulator import SimulatorRV
from scipy import stats
from scipy.optimize import brentq

import pymc_features as pmf
from pymc_features.exceptions import NotDifferentiableError
from pymc_features.likelihoods import KERNELS
from pymc_features.smc import population_logp
from support.graphs import LIGHT
from support.refusals import refusals
from support.sampling import SERIAL
from support.structures import noise_record, with_first_spring, with_noise

PRIOR = (0.5, 1.5)


@pytest.fixture(scope="module")
def pulse():
    return noise_record(60)


@pytest.fixture(scope="module")
def measured(pulse):
    return with_noise(pmf.simulate(with_first_spring(1.0), pulse), 0.05)


@pytest.fixture(scope="module")
def rho(pulse, measured):
    """S(theta) of Eq. (15), by a route without PyMC."""

    def total(theta):
        return np.square(pmf.simulate(with_first_spring(theta), pulse).values - measured).mean(axis=1).sum()

    return total


def build_model(pulse, measured, *, epsilon, kernel="uniform", theta=None, **kwargs):
    with pm.Model() as model:
        theta = pm.Uniform("theta", *PRIOR) if theta is None else theta()
        mu = pmf.response(with_first_spring(theta), pulse)
        pmf.DiscrepancySimulator("y", mu, epsilon=epsilon, observed=measured, kernel=kernel, **kwargs)
    return model


def log_likelihood(model):
    """Function theta -> log-likelihood of the node."""
    function = model.compile_logp(vars=model.observed_RVs, jacobian=False, mode=LIGHT)

    def at(theta):
        logit = np.log((theta - PRIOR[0]) / (PRIOR[1] - theta))
        return float(function({"theta_interval__": logit}))

    return at


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


@pytest.mark.parametrize("sigma", [0.13, np.array([0.05, 0.13, 0.4])], ids=["common", "of each sensor"])
def test_exponential_kernel_is_exp_at_fixed_sigma(pulse, measured, rho, sigma):
    """epsilon = 2 sigma^2: ExpFeature, Eq. (9), constants included."""
    logp = log_likelihood(build_model(pulse, measured, epsilon=2 * sigma**2, kernel="exponential"))
    with pm.Model() as model:
        mu = pmf.response(with_first_spring(pm.Uniform("theta", *PRIOR)), pulse)
        pmf.ExpFeature("y", mu=mu, sigma=sigma, observed=measured)
    feature = log_likelihood(model)
    for theta in (0.6, 0.9, 1.0, 1.3):
        assert logp(theta) == pytest.approx(feature(theta), rel=1e-10)
        if np.ndim(sigma) == 0:
            expected = -rho(theta) / (2 * sigma**2) - 3 * np.log(2 * sigma**2)
            assert logp(theta) == pytest.approx(expected, rel=1e-10)


def test_gaussian_kernel(pulse, measured, rho):
    logp = log_likelihood(build_model(pulse, measured, epsilon=0.2, kernel="gaussian"))
    for theta in (0.6, 0.9, 1.0, 1.3):
        assert logp(theta) == pytest.approx(-0.5 * (rho(theta) / 0.2) ** 2, rel=1e-10)


def test_failed_simulation_is_outside(pulse, measured):
    """A spring that a draw makes negative: -inf, not an exception."""
    for kernel in KERNELS:
        model = build_model(pulse, measured, epsilon=10.0, kernel=kernel, theta=lambda: pm.Normal("theta"))
        function = model.compile_logp(vars=model.observed_RVs, mode=LIGHT)
        assert function({"theta": -1.0}) == -np.inf
        assert np.isfinite(function({"theta": 1.0}))


def test_tolerance_may_be_data(pulse, measured, rho):
    with pm.Model() as model:
        epsilon = pm.Data("epsilon", 2 * rho(1.2))
        mu = pmf.response(with_first_spring(pm.Uniform("theta", *PRIOR)), pulse)
        pmf.DiscrepancySimulator("y", mu, epsilon=epsilon, observed=measured)
    logp = log_likelihood(model)
    assert logp(1.2) == 0.0
    with model:
        pm.set_data({"epsilon": 0.5 * rho(1.2)})
    assert logp(1.2) == -np.inf


def test_all_random_parameters_of_a_structure_reach_the_simulator(pulse, measured):
    """Mass, stiffness, Rayleigh pair and ratios; output step, sensors, modes and quantity as asked."""
    asked = {"dt": 0.04, "sensors": [2, 0], "n_modes": 2, "quantity": "relative_velocity"}
    cases = {
        "mass": lambda x: pmf.SpringMassChain([1.0, x, 1.0], 100.0, pmf.ModalDamping(0.05)),
        "stiffness": lambda x: pmf.SpringMassChain(
            np.ones(3), [100.0, 90.0, 100.0 * x], pmf.ModalDamping(0.05)
        ),
        "rayleigh": lambda x: pmf.SpringMassChain(np.ones(3), 100.0, pmf.RayleighDamping(x, 1e-3)),
        "ratios": lambda x: pmf.SpringMassChain(np.ones(3), 100.0, pmf.ModalDamping(0.05 * x)),
    }
    data = measured[:2, :30]
    for name, build in cases.items():
        with pm.Model() as model:
            mu = pmf.response(build(pm.Uniform("theta", *PRIOR)), pulse, **asked)
            pmf.DiscrepancySimulator("y", mu, epsilon=1.0, observed=data, kernel="exponential")
        exact = np.square(pmf.simulate(build(0.8), pulse, **asked).values - data).mean(axis=1).sum()
        assert log_likelihood(model)(0.8) == pytest.approx(-exact, rel=1e-10), name


def shelf(theta):
    """A function of one parameter: what a user's own solver would be."""
    return np.outer([1.0, 2.0], np.sin(theta * np.arange(5.0)))


def line(slope, offsets):
    """A scalar and a vector parameter."""
    return offsets[:, None] + slope * np.arange(5.0)


def test_function_of_a_scalar_and_a_vector():
    data = np.random.default_rng(0).normal(size=(2, 5))
    with pm.Model() as model:
        slope, offsets = pm.Normal("slope"), pm.Normal("offsets", shape=2)
        pmf.DiscrepancySimulator("y", line, slope, offsets, epsilon=0.5, observed=data, kernel="gaussian")
        prior = pm.sample_prior_predictive(6, random_seed=1, compile_kwargs={"mode": LIGHT})
    logp = model.compile_logp(vars=model.observed_RVs, mode=LIGHT)
    point = {"slope": 0.3, "offsets": np.array([1.0, -1.0])}
    exact = np.square(line(**point) - data).mean(axis=1).sum()
    assert float(logp(point)) == pytest.approx(-0.5 * (exact / 0.5) ** 2, rel=1e-12)
    draws = prior["prior"].dataset.isel(chain=0)
    for k in range(6):
        expected = line(float(draws["slope"][k]), draws["offsets"].values[k])
        np.testing.assert_allclose(prior["prior_predictive"]["y"].values[0, k], expected, rtol=1e-12)


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


@pytest.mark.default_mode
@pytest.mark.statistical
def test_stock_smc_fills_the_exact_interval(pulse, measured, rho):
    """ABC posterior under a flat prior: uniform on {theta: rho <= epsilon}.

    Quantiles 5, 50, 95 % of 2 x 1000 draws: the standard error is 1.5 % of the width at the median
    (measured over ten seeds) and a third of it elsewhere; the limit of 6 % is four of them, a false
    alarm in 1e4 seeds. The prior is the negative control.
    """
    e = pmf.mean_square_discrepancy(pmf.simulate(with_first_spring(1.0), pulse).values, measured)
    epsilon = pmf.likelihoods.abc_tolerance(1.5 * pmf.likelihoods.sigma_mpv(e), n_sensors=3)
    low, high = exact_interval(rho, epsilon)
    model = build_model(pulse, measured, epsilon=epsilon)
    with model:
        idata = pm.sample_smc(1000, chains=2, random_seed=3, **SERIAL)
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
        mu = pmf.response(with_first_spring(pm.Uniform("theta", *PRIOR)), pulse)
        pmf.DiscrepancySimulator("y", mu, epsilon=1.0, observed=measured, dims=("sensor", "time"))
        prior = pm.sample_prior_predictive(5, random_seed=1, compile_kwargs={"mode": LIGHT})
        predictive = pm.sample_posterior_predictive(
            prior["prior"].dataset, random_seed=2, progressbar=False, compile_kwargs={"mode": LIGHT}
        )["posterior_predictive"]["y"]
    assert isinstance(model["y"].owner.op, SimulatorRV) and model.observed_RVs == [model["y"]]
    assert model.named_vars_to_dims["y"] == ("sensor", "time")
    for values in (prior["prior_predictive"]["y"], predictive):
        assert values.dims == ("chain", "draw", "sensor", "time")
        assert values.shape == (1, 5, 3, 60)
        for k, theta in enumerate(prior["prior"]["theta"].values[0]):
            expected = pmf.simulate(with_first_spring(theta), pulse).values
            np.testing.assert_allclose(values.values[0, k], expected, rtol=1e-10, atol=1e-12)


REFUSALS_VALUES = {  # what is said: what is given
    "`kernel` must be one of uniform, exponential, gaussian, got 'box'": {"kernel": "box"},
    "`epsilon` must be positive and finite, got 0.0. Pass a tolerance": {"epsilon": 0.0},
    "`epsilon` must be positive and finite, got nan": {"epsilon": np.nan},
    "`epsilon` must be positive and finite, got inf": {"epsilon": np.inf},
    "`params` must be given with a function, got none. Pass its parameters": {"mu": shelf},
    "`params` must be left out when `mu` is a response: it has its own": {"params": (1.0,)},
    r"must be \(sensor, time\) to match a response, got shape": {"observed": np.zeros(60)},
    "`observed` must be finite numbers of shape": {"observed": np.full((3, 60), np.inf)},
    "`observed` must have data of every sensor, .* at index 0": {"observed": np.full((3, 60), np.nan)},
    r"\(3, 60\) to match `mu`, got \(60, 3\). Transpose it": {"observed": np.zeros((60, 3))},
    "got NaN alone at index 0. Leave it out": {"observed": np.ma.masked_greater(np.ones((3, 60)), 0.5)},
    r"`epsilon` must be one number or one for each of the 3 sensors, got shape": {"epsilon": [1.0, 2.0]},
    r"`epsilon` must be positive and finite, got \[1.0, 0.0, 1.0\]. Pass a": {"epsilon": [1.0, 0.0, 1.0]},
    "`noise` must be not negative and finite, got -0.1. Pass a standard deviation in": {"noise": -0.1},
    r"`noise` must be not negative and finite, got \[0.1, inf, 0.1\]": {"noise": [0.1, np.inf, 0.1]},
    r"`noise` must be one number or one for each of the 3 sensors, got sha": {"noise": np.ones((3, 60))},
    r"shape \(sensor, time\), or \(entry,\) for a summary, got shape": {"observed": np.zeros((3, 60, 1))},
}
REFUSALS_TYPES = {
    "`mu` must be what `response` returned or a function, got nd": {"mu": np.zeros((3, 60))},
    "got another PyTensor expression. Pass a function": {"mu": pt.zeros((3, 60))},
    "`observed` must be an array of numbers, got str": {"observed": "data"},
    "`epsilon` must be numbers or PyTensor variables, got str. Pass": {"epsilon": "small"},
}


@refusals("changes", REFUSALS_VALUES, REFUSALS_TYPES)
def test_refusals(pulse, measured, changes, error, match):
    with pm.Model():
        theta = pm.Uniform("theta", *PRIOR)
        mu = changes.get("mu", pmf.response(with_first_spring(theta), pulse))
        arguments = {"epsilon": 1.0, "observed": measured} | changes
        params = arguments.pop("params", ())
        arguments.pop("mu", None)
        with pytest.raises(error, match=match):
            pmf.DiscrepancySimulator("y", mu, *params, **arguments)


SCALE = np.array([0.05, 0.3, 1.0])


def noisy_model(pulse, measured, noise=SCALE, epsilon=1.0, kernel="exponential"):
    return build_model(pulse, measured, epsilon=epsilon, kernel=kernel, noise=noise)


def mean_squares(pulse, measured, noise, theta=1.2, n=4000, seed=0):
    """e_j (n, sensor) of the fused node: one tolerance at a time lets a single sensor through."""
    logit = np.log((theta - PRIOR[0]) / (PRIOR[1] - theta))
    columns = []
    for j in range(3):
        alone = np.full(3, 1e300)
        alone[j] = 1.0
        model = build_model(pulse, measured, epsilon=alone, kernel="exponential", noise=noise)
        function = population(model).with_rng(np.random.default_rng(seed + j))
        columns.append(-function(np.full((n, 1), logit))[1] - np.log(alone).sum())
    return np.column_stack(columns)


def population(model):
    return population_logp(model, model.initial_point(), {"mode": "FAST_COMPILE"})


def by_histories(pulse, measured, noise, theta=1.2, n=4000):
    """The slow reference: noisy histories, one by one, against the data."""
    exact = pmf.simulate(with_first_spring(theta), pulse).values
    noisy = exact + np.reshape(noise, (-1, 1)) * np.random.default_rng(5).standard_normal((n, *exact.shape))
    return np.square(noisy - measured).mean(axis=2)


def same_law(found, expected):
    """Kolmogorov-Smirnov of each sensor at 1e-3 / 3, means and variances within 4.5 standard errors."""
    for a, b in zip(found.T, expected.T, strict=True):
        error = np.hypot(a.std(), b.std()) / np.sqrt(len(a))
        squares = [(x - x.mean()) ** 2 for x in (a, b)]
        spread = np.hypot(squares[0].std(), squares[1].std()) / np.sqrt(len(a))
        if (
            stats.ks_2samp(a, b).pvalue < 1e-3 / 3
            or abs(a.mean() - b.mean()) > 4.5 * error
            or abs(squares[0].mean() - squares[1].mean()) > 4.5 * spread
        ):
            return False
    return True


def test_fused_noise_has_the_exact_law(pulse, measured, noise=SCALE):
    """4000 mean squares without a history against as many histories: a false alarm in 1000.

    Negative controls: noise 3 % larger; the misfit and the noise added without their product, which has
    the right mean but a smaller variance; the misfit left out.
    """
    found = mean_squares(pulse, measured, noise)
    assert same_law(found, by_histories(pulse, measured, noise))
    assert not same_law(found, by_histories(pulse, measured, 1.03 * noise))
    misfit = np.square(pmf.simulate(with_first_spring(1.2), pulse).values - measured).mean(axis=1)
    rng = np.random.default_rng(7)
    uncorrelated = misfit + noise**2 * rng.chisquare(60, (4000, 3)) / 60
    np.testing.assert_allclose(uncorrelated.mean(axis=0), found.mean(axis=0), rtol=0.05)
    assert not same_law(found, uncorrelated)
    assert not same_law(found, uncorrelated - misfit)


def test_sensors_have_noise_of_their_own(pulse, measured):
    """The variance of rho is the sum of its parts', within 4.5 standard errors: a false alarm in 1e5."""
    noise = np.full(3, 0.2)
    logp = population(noisy_model(pulse, measured, noise)).with_rng(np.random.default_rng(3))
    total = -logp(np.full((8000, 1), np.log(0.7 / 0.3)))[1]
    expected = by_histories(pulse, measured, noise, n=8000)
    parts = expected.sum(axis=1)
    error = np.hypot(total.var(), parts.var()) * np.sqrt(2 / 8000)
    assert abs(total.var() - parts.var()) < 4.5 * error
    common = expected.std(axis=0).sum() ** 2
    assert abs(total.var() - common) > 4.5 * error, "as one draw for all sensors would have"


def test_noise_is_drawn_anew(pulse, measured):
    """For each particle of a call, for each call, and for each generator."""
    logp = population(noisy_model(pulse, measured))
    particles = np.zeros((50, 1))
    values = np.concatenate([logp(particles)[1] for _ in range(2)])
    assert len(np.unique(values)) == 100
    streams = [logp.with_rng(np.random.default_rng(seed))(particles)[1] for seed in (1, 2, 1)]
    assert not np.isin(streams[0], streams[1]).any()
    np.testing.assert_array_equal(streams[0], streams[2])
    half = streams[0][:25], streams[0][25:]
    assert abs(np.corrcoef(*half)[0, 1]) < 0.8


def test_predictive_histories_contain_the_noise(pulse, measured):
    """Standard deviations of each sensor's residuals over 60 times and 200 draws, at 4.5 errors (2.9 %)."""
    with noisy_model(pulse, measured) as model:
        prior = pm.sample_prior_predictive(200, random_seed=1, compile_kwargs={"mode": LIGHT})
    assert len(model.free_RVs) == 1
    theta = prior["prior"]["theta"].values[0]
    residuals = prior["prior_predictive"]["y"].values[0] - [
        pmf.simulate(with_first_spring(t), pulse).values for t in theta
    ]
    np.testing.assert_allclose(residuals.std(axis=(0, 2)), SCALE, rtol=0.029)
    assert abs(np.corrcoef(residuals[:, 2, :-1].ravel(), residuals[:, 2, 1:].ravel())[0, 1]) < 0.045
    assert abs(np.corrcoef(residuals[:, 1].ravel(), residuals[:, 2].ravel())[0, 1]) < 0.045


@pytest.mark.statistical
@pytest.mark.parametrize("kernel", [pmf.PersistentSMC, pm.smc.kernels.IMH])
def test_noise_in_other_samplers(pulse, measured, kernel):
    """PyMC allows no random draws in a log-density but those of a simulator."""
    model = noisy_model(pulse, measured, 0.1, epsilon=0.5)
    idata = pm.sample_smc(100, kernel, model=model, chains=1, random_seed=1, **SERIAL)
    assert 0.8 < float(idata.posterior["theta"].mean()) < 1.2


def test_noise_has_no_gradient(pulse, measured):
    with pytest.raises(NotDifferentiableError, match="a simulator with noise has no gradient. Sample with"):
        noisy_model(pulse, measured).compile_dlogp(mode=LIGHT)
    build_model(pulse, measured, epsilon=1.0, kernel="exponential").compile_dlogp(mode=LIGHT)


@pytest.mark.parametrize(("noise", "takes_batches"), [(0.2, True), ([0.1, 0.2, 0.4], False)])
def test_noise_of_a_summary(noise, takes_batches):
    """Three frequencies: rho is a weighted sum of chi-squared, Kolmogorov-Smirnov at 1e-3."""

    def frequencies(k):
        return np.multiply.outer(np.atleast_1d(np.sqrt(k))[:, 0] if takes_batches else np.sqrt(k), [1, 2, 3])

    frequencies.batched = takes_batches
    with pm.Model() as model:
        k = pm.Uniform("k", 0.5, 1.5, shape=1 if takes_batches else ())
        pmf.DiscrepancySimulator(
            "y", frequencies, k, epsilon=1.0, observed=np.ones(3), kernel="exponential", noise=noise
        )
    found = -population(model).with_rng(np.random.default_rng(1))(np.zeros((4000, 1)))[1]
    errors = np.reshape(noise, -1) * np.random.default_rng(2).standard_normal((4000, 3))
    expected = np.square([0.0, 1.0, 2.0] + errors).sum(axis=1)
    assert stats.ks_2samp(found, expected).pvalue > 1e-3
    assert stats.ks_2samp(found, np.square([0.0, 1.0, 2.0] + 1.2 * errors).sum(axis=1)).pvalue < 1e-3


def test_a_random_tolerance_is_refused(pulse, measured):
    with pm.Model():
        mu = pmf.response(with_first_spring(pm.Uniform("theta", *PRIOR)), pulse)
        with pytest.raises(TypeError, match="`epsilon` must be a number.* got the random variable e. Look"):
            pmf.DiscrepancySimulator("y", mu, epsilon=pm.HalfNormal("e"), observed=measured)
    with pm.Model() as model:
        epsilon, x = pm.HalfNormal("e"), pm.Normal("x")
        pm.Simulator("y", lambda rng, x, size: x, x, epsilon=epsilon, observed=[0.0])
    with pytest.raises(TypeError, match="`epsilon` of y must be a number.* depends on random variables"):
        pmf.SubsetSimulation(300, model=model)


def test_a_solver_may_use_its_array_again():
    """Each result counts, not the last one many times."""
    work = np.zeros(2)

    def solver(x):
        work[:] = x
        return work

    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pmf.DiscrepancySimulator("y", solver, x, epsilon=0.5, observed=np.zeros(2))
    kernel = pmf.SubsetSimulation(300, model=model, random_seed=1)
    particles = np.array([[0.1, 0.2], [3.0, 1.0], [0.0, 0.5]])
    np.testing.assert_allclose(-kernel.logp(particles)[1], (particles**2).sum(axis=1))


def test_summary_counts_each_entry_once():
    data = np.array([1.0, 2.5, 2.0])
    with pm.Model() as model:
        theta = pm.Uniform("theta", *PRIOR)
        pmf.DiscrepancySimulator(
            "y",
            lambda k: np.sqrt(k) * np.arange(1, 4),
            theta,
            epsilon=0.5,
            observed=data,
            kernel="exponential",
        )
    exact = np.square(np.sqrt(1.2) * np.array([1, 2, 3]) - data).sum()
    assert log_likelihood(model)(1.2) == pytest.approx(-exact / 0.5 - 3 * np.log(0.5), rel=1e-12)
