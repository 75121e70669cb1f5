"""JAX: Ops of every family as by the kernels; jax.grad, jax.vmap, NUTS; loaded late; what it refuses."""

import functools

import arviz as az
import jax
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.gradient import pushforward
from pytensor.graph.replace import vectorize_graph

import pymc_features as pmf
from pymc_features import paper, response, simulate
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.ops import misfit_statistics
from pymc_features.study import exact as quadrature
from support.commands import run_python
from support.families import CASES, CYCLIC, TRUTH, measured
from support.graphs import PLAIN
from support.structures import noise_record, three_storeys, with_first_spring, with_noise

pytestmark = pytest.mark.slow
LIMIT = 1e-10
DIRECTION = np.array([0.3, -0.2])
N_TIMES = 60


@pytest.fixture(scope="module", autouse=True)
def started():
    """JAX runs from here on, not from collection: other tests fork.

    Before pymc.sampling.jax is imported, which would make a hundred devices of one processor.
    """
    return jax.devices()


@pytest.mark.parametrize("name", ["chain", "coupled damping", "two supports", "hysteretic", *CYCLIC])
def test_all_ops_of_every_family_agree_with_the_kernels(name, quick_compilation):
    """Values, reverse and forward derivatives, alone and in populations; NaN where there is no structure."""
    build, record = (CASES | CYCLIC)[name]
    data = measured(name)
    x, rows, y = pt.vector("x", shape=(2,)), pt.matrix("rows", shape=(None, 2)), pt.matrix("y")
    mu = response(build(x), record)
    e, statistics = pmf.mean_square_discrepancy(mu, y), misfit_statistics(mu, y)
    outputs = [mu, e, statistics]
    outputs += [pt.grad((out**2).sum(), x) for out in outputs]
    outputs += pushforward([mu, e], [x], [pt.constant(DIRECTION)])
    many = [vectorize_graph(out, {x: rows}) for out in (mu, e, statistics)]
    outputs += [out for one in many for out in (one, pt.grad((one**2).sum(), rows))]
    functions = [pytensor.function([x, rows, y], outputs, mode=mode) for mode in ("JAX", PLAIN)]
    points = TRUTH * np.random.default_rng(6).uniform(0.8, 1.2, (4, 2))
    impossible = points.copy()
    impossible[2, 0] = -TRUTH[0]
    for at, population in ((points[0], points), (impossible[2], impossible)):
        found, expected = (function(at, population, data) for function in functions)
        for own, other in zip(found, expected, strict=True):
            assert own.dtype == "float64" and own.shape == other.shape
            scale = np.nan_to_num(np.abs(other)).max()
            np.testing.assert_allclose(own, other, rtol=LIMIT, atol=1e-12 * scale)


RECORD = noise_record(N_TIMES)
MEASURED = with_noise(simulate(three_storeys(100.0), RECORD))


def model_of(likelihood, dt=None):
    """Unknown theta, which may be negative, and sigma; the output step is data where it is given."""
    with pm.Model() as model:
        theta, sigma = pm.Normal("theta", 1.0, 0.3), pm.HalfNormal("sigma", 2.0)
        step = None if dt is None else pm.Data("step", dt)
        measured = pm.Data("measured", every(dt or RECORD.dt))
        mu = response(with_first_spring(theta), RECORD, dt=step)
        likelihood("y", mu=mu, sigma=sigma, observed=measured)
    return model


def every(dt):
    return MEASURED[:, :: round(dt / RECORD.dt)]


def log_density(model):
    """Of the unconstrained parameters, in JAX."""
    from pymc.sampling.jax import get_jaxified_logp

    return get_jaxified_logp(model)


def by_pymc(model, points):
    """Log-densities, and their gradients (point, parameter)."""
    outputs = [model.logp(), model.dlogp()]
    function = model.compile_fn(outputs, inputs=model.value_vars, mode="FAST_COMPILE", point_fn=False)
    pairs = [function(*point) for point in zip(*points, strict=True)]
    return np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])


POINTS = [np.random.default_rng(4).normal(mean, 0.2, 7) for mean in (1.0, 0.0)]  # theta, ln sigma

CORRELATED = functools.partial(pmf.CorrelatedNormal, correlation_time=0.1)
HEAVY_TAILS = functools.partial(pm.StudentT, nu=4.0)  # needs the response itself; the others are fused


@pytest.mark.parametrize(
    "likelihood", [pmf.TruncNormalFeature, pmf.ExpFeature, CORRELATED, pm.Normal, HEAVY_TAILS]
)
def test_log_densities_of_models(likelihood, request):
    """jax.grad and jax.vmap: seven points as by PyMC, one by one; an eighth, impossible, harms none.

    The first with all optimisations of XLA.
    """
    if likelihood is not pmf.TruncNormalFeature:
        request.getfixturevalue("quick_compilation")
    model = model_of(likelihood)
    points = [np.append(POINTS[0], -1.0), np.append(POINTS[1], 0.0)]
    logp, gradients = jax.jit(jax.vmap(jax.value_and_grad(log_density(model))))(points)
    assert logp.dtype == gradients[0].dtype == np.float64
    expected, slopes = by_pymc(model, POINTS)
    np.testing.assert_allclose(logp[:7], expected, rtol=LIMIT)
    np.testing.assert_allclose(np.stack(gradients, axis=1)[:7], slopes, rtol=LIMIT)
    assert np.isneginf(logp[7]) or np.isnan(logp[7])


def test_gradient_by_the_data(quick_compilation):
    """Data that are no numbers, such as a record with unknown offset, count."""
    with pm.Model() as model:
        offset = pm.Flat("offset")
        mu = response(three_storeys(100.0), RECORD)
        pm.Potential("misfit", pmf.mean_square_discrepancy(mu, MEASURED + offset).sum())
    _, [[expected]] = by_pymc(model, [[0.5]])
    [gradient] = jax.jit(jax.grad(log_density(model)))([np.array(0.5)])
    assert gradient == pytest.approx(expected, rel=LIMIT)


@pytest.mark.filterwarnings("ignore:The RandomType SharedVariables")  # PyTensor copies generators for JAX
def test_correlated_draws():
    """Covariance of 20000 draws within five standard errors; a false alarm in 6000 seeds."""
    k = np.arange(23)
    y = pmf.CorrelatedNormal.dist(np.zeros((2, 23)), [1.0, 2.0], [0.2, 0.01], 0.02, size=(20_000, 2))
    draws = pm.draw(y, random_seed=1, mode="JAX")
    for j, (sigma, tau) in enumerate([(1.0, 0.2), (2.0, 0.01)]):
        found = draws[:, j].T @ draws[:, j] / 20_000 / sigma**2
        for longer in (1.0, 1.3):  # the second is a negative control
            expected = np.exp(-np.abs(k - k[:, None]) * 0.02 / (longer * tau))
            worst = (np.abs(found - expected) / np.sqrt((1.0 + expected**2) / 20_000)).max()
            assert (worst < 5.0) == (longer == 1.0)


def test_output_step_as_data(quick_compilation):
    """Comparisons take it as it comes; a response by itself, whose shape it decides, is refused."""
    model = model_of(pmf.TruncNormalFeature, dt=0.04)
    for dt in (0.04, 0.1):
        with model:
            pm.set_data({"step": dt, "measured": every(dt)})
        expected, slopes = by_pymc(model, [x[:1] for x in POINTS])
        logp, gradient = jax.jit(jax.value_and_grad(log_density(model)))([x[0] for x in POINTS])
        np.testing.assert_allclose([logp, *gradient], [expected[0], *slopes[0]], rtol=LIMIT)
    with pytest.raises(NotImplementedError, match="fixed when it compiles.*Pass `dt` to response"):
        pytensor.function([], response(with_first_spring(1.0), RECORD, dt=model["step"]), mode="JAX")


SAMPLERS = {
    "nutpie": {"nuts_sampler": "nutpie", "backend": "jax", "compile_kwargs": {"gradient_backend": "jax"}},
    "numpyro": {"nuts_sampler": "numpyro", "nuts": {"chain_method": "vectorized"}},
}


@pytest.fixture(scope="module")
def one_stiffness():
    """TN for three storeys: the model, and the exact mean and standard deviation of theta."""

    def total(theta):
        misfit = simulate(three_storeys(100.0 * theta), RECORD).values - MEASURED
        return float((misfit**2).mean(axis=1).sum())

    with pm.Model() as model:
        mu = response(three_storeys(100.0 * pm.Uniform("theta", *paper.THETA_RANGE)), RECORD)
        pmf.TruncNormalFeature("y", mu=mu, sigma=pm.Uniform("sigma", *paper.SIGMA_RANGE), observed=MEASURED)
    curve = quadrature.DiscrepancyCurve(total, paper.THETA_RANGE, MEASURED.size)
    exponents = LIKELIHOODS["TN"].exponents(*MEASURED.shape)
    exact = quadrature.exact_posterior(curve, exponents, paper.SIGMA_RANGE)
    nodes, below = exact.marginals["theta"]
    middle, probability = 0.5 * (nodes[1:] + nodes[:-1]), np.diff(below)
    mean = probability @ middle
    return model, mean, np.sqrt(probability @ (middle - mean) ** 2)


@pytest.mark.default_mode
@pytest.mark.statistical
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_samplers_find_the_posterior(sampler, one_stiffness, quick_compilation):
    """Mean and sd of theta within 5 Monte Carlo errors of the quadrature; false alarms: below 1e-4 in all."""
    model, mean, sd = one_stiffness
    quiet = {"progressbar": False, "compute_convergence_checks": False, "cores": 1, "random_seed": 1}
    idata = pm.sample(200, tune=200, chains=2, model=model, **quiet, **SAMPLERS[sampler])
    theta = idata["posterior"]["theta"].values
    assert theta.shape == (2, 200)
    assert az.ess(theta) > 100
    assert abs(theta.mean() - mean) < 5 * az.mcse(theta)
    assert abs(theta.std() - sd) < 5 * az.mcse(theta, method="sd")
    assert abs(theta.mean() - (mean + sd)) > 5 * az.mcse(theta)  # negative control: one sd beside


LATE = """
    import sys
    import numpy as np
    from pymc_features import ModalDamping, SpringMassChain, response
    from support.straight import Record
    import pytensor, pytensor.tensor as pt
    k = pt.dscalar("k")
    y = response(SpringMassChain([1.0, 2.0], k, ModalDamping(0.1)), Record([0.0, 1.0, 0.0], 0.1))
    dispatch = "pymc_features.ops.jax_dispatch"
    expected = pytensor.function([k], y, mode=pytensor.compile.mode.Mode(linker="py", optimizer=None))(9.0)
    assert "jax" not in sys.modules
    import jax
    assert jax.numpy.ones(1).dtype == "float32" and dispatch not in sys.modules
    got = pytensor.function([k], y, mode="JAX")(9.0)
    assert dispatch in sys.modules
    assert got.dtype == "float64"
    np.testing.assert_allclose(got, expected, rtol=1e-14, atol=1e-15)
    print("done")
"""


@pytest.mark.processes
def test_dispatch_is_registered_when_a_graph_is_compiled_for_jax(tmp_path):
    """Not with the package; in double precision also if JAX was in use, in single precision, before."""
    assert run_python(LATE, tmp_path) == "done"
