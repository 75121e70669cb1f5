"""Population kernels and their evaluation, against PyMC's own that take one particle at a time."""

import multiprocessing
import resource
import sys

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pymc.logprob.utils import ParameterValueError
from pymc.smc.kernels import IMH, MH
from pytensor.link.basic import PerformLinker
from pytensor.scalar import Add, Cast, Mul
from pytensor.tensor.elemwise import Elemwise
from scipy import stats

import pymc_features as pmf
from pymc_features.smc import KERNELS, PopulationLogp, population_logp
from pymc_features.smc.density import rows
from pymc_features.smc.density.rows import has_python_loops, with_mode
from support.graphs import REWRITTEN
from support.populations import discrete, points_of, prior_particles
from support.sampling import SERIAL
from support.structures import noise_record, with_noise

PULSE = noise_record(200)
SCALED = {"rtol": 1e-10, "atol": 1e-10}


def chain(theta, n_dof=3):
    """A chain whose springs all have the factor theta."""
    return pmf.SpringMassChain(np.ones(n_dof), 900.0 * theta * np.ones(n_dof), pmf.ModalDamping(0.05))


def measured(n_dof=3, record=PULSE):
    return with_noise(pmf.simulate(chain(1.0, n_dof), record), 0.3)


@pytest.fixture
def default_mode():
    with pytensor.config.change_flags(mode="Mode"):
        yield


def gaussian():
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        pm.Normal("y", x, 0.3, observed=[1.0, -0.5])
    return model


def many_variables():
    """Scalars, a vector, a matrix and a simplex, bounded on one side, on both, or not at all."""
    with pm.Model() as model:
        a = pm.Normal("a", 1.0, 2.0)
        b = pm.HalfNormal("b", 1.0)
        c = pm.Uniform("c", -1.0, 2.0, shape=2)
        d = pm.Normal("d", 0.0, 0.5, shape=(2, 3))
        e = pm.Dirichlet("e", np.ones(3))
        pm.Normal("y", a + c[:, None] + d * e, b, observed=np.arange(6.0).reshape(2, 3) / 3)
    return model


def data():
    with pm.Model() as model:
        x = pm.Normal("x")
        pm.Normal("y", x, 0.5, observed=pm.Data("measured", np.array([1.0, 2.0, 0.5])))
    return model


def structure():
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        sigma = pm.Gamma("sigma", 3.0, 6.0)
        pmf.TruncNormalFeature("y", mu=pmf.response(chain(theta), PULSE), sigma=sigma, observed=measured())
    return model


def sample(model, kernel, draws=60, chains=1, **settings):
    return pm.sample_smc(
        draws, kernel, model=model, chains=chains, **{"random_seed": 5, **SERIAL, **settings}
    )


def assert_same(one, other, **tolerance):
    """Equal posteriors, and as many stages at equal temperatures."""
    for name, values in one.posterior.data_vars.items():
        np.testing.assert_allclose(other.posterior[name], values, err_msg=name, **tolerance)
    np.testing.assert_allclose(stages(other), stages(one), rtol=1e-9)


def stages(idata):
    return np.concatenate([np.ravel(chain_betas) for chain_betas in np.ravel(idata.sample_stats["beta"])])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "ours", "pymcs"),
    [(many_variables, pmf.sampling.PopulationIMH, IMH), (discrete, pmf.sampling.PopulationMH, MH)],
)
def test_same_particles_as_pymc(build, ours, pymcs):
    """Same seed, same draws and temperatures, whatever the variables are."""
    model = build()
    one, other = sample(model, pymcs), sample(model, ours)
    assert_same(one, other, rtol=1e-12, atol=1e-12)
    assert len(stages(one)) > 1
    rate = "accept_rate" if ours is pmf.sampling.PopulationIMH else "mean_accept_rate"
    np.testing.assert_allclose(
        np.ravel(other.sample_stats[rate]), np.ravel(one.sample_stats[rate]), rtol=1e-12
    )


def test_data_of_another_length_need_no_new_evaluation():
    model = data()
    before = pmf.sampling.PopulationIMH(60, model=model).logp
    for values in ([2.0], np.linspace(0.0, 3.0, 50)):
        with model:
            pm.set_data({"measured": np.array(values)})
        assert_same(sample(model, IMH), sample(model, pmf.sampling.PopulationIMH), rtol=1e-12, atol=1e-12)
        assert pmf.sampling.PopulationIMH(60, model=model).logp is before
        assert pmf.PersistentSMC(60, model=model).logp is before


def test_a_changed_model_is_compiled_anew():
    """Nothing of the former model may answer for the present one. Control: another seed."""
    model = gaussian()
    changes = {
        "observed": lambda: pm.Normal("y1", model["x"][0], 1.0, observed=3.0),
        "potential": lambda: pm.Potential("y2", -(model["x"][0] ** 2)),
        "free": lambda: pm.Normal("y3"),
    }
    for what, change in changes.items():
        before = pmf.sampling.PopulationIMH(60, model=model).logp
        with model:
            change()
        assert pmf.sampling.PopulationIMH(60, model=model).logp is not before, what
    exact = sample(model, IMH)
    assert_same(exact, sample(model, pmf.sampling.PopulationIMH), rtol=1e-12, atol=1e-12)
    with pytest.raises(AssertionError):
        assert_same(exact, sample(model, pmf.sampling.PopulationIMH, random_seed=6), rtol=1e-3)


@pytest.fixture(scope="module")
def sequential():
    """TN model and its draws with the chains one after the other."""
    with pytensor.config.change_flags(mode="Mode"):
        model = structure()
        return model, sample(model, pmf.PersistentSMC, chains=2)


@pytest.mark.processes
@pytest.mark.parametrize("mp_ctx", ["fork", "spawn"])
def test_parallel_chains_give_the_same_draws(sequential, default_mode, mp_ctx):
    """In compiled code, before and after runs in this process."""
    if mp_ctx not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {mp_ctx} on this system")
    model, expected = sequential
    found = sample(model, pmf.PersistentSMC, chains=2, cores=2, mp_ctx=mp_ctx)
    assert_same(expected, found, rtol=1e-12)
    chains = found.posterior["theta"].values
    assert not np.isclose(chains[0], chains[1]).any()
    assert_same(found, sample(model, pmf.PersistentSMC, chains=2), rtol=1e-12)


def one_by_one(model, particles):
    """Log prior and log-likelihood by `model.compile_fn`, -inf where it refuses or is not finite."""
    function = model.compile_fn([model.varlogp, model.datalogp], on_unused_input="ignore")
    rows = []
    for point in points_of(model, particles):
        try:
            rows.append(function(point))
        except ParameterValueError:
            rows.append([-np.inf, -np.inf])
    values = np.array(rows, dtype=float).T
    return np.where(np.isfinite(values), values, -np.inf)


def compare(model, particles):
    """Evaluate both ways; both log prior and log-likelihood of possible particles must agree."""
    logp = population_logp(model, model.initial_point(), {})
    prior, likelihood, failed = logp(particles)
    exact_prior, exact_likelihood = one_by_one(model, particles)
    np.testing.assert_allclose(prior + likelihood, exact_prior + exact_likelihood, **SCALED)
    possible = exact_prior + exact_likelihood > -np.inf
    np.testing.assert_allclose(prior[possible], exact_prior[possible], **SCALED)
    assert logp.batched
    return possible, failed


@pytest.mark.slow
def test_discrete_equals_the_model_point_by_point():
    possible, _ = compare(model := discrete(), prior_particles(model))
    assert possible.sum() > 5


def test_failed_simulations_are_counted():
    """Springs that a draw makes negative; in the statistics of a run, too."""
    with pm.Model() as model:
        theta = pm.Normal("theta")
        pmf.TruncNormalFeature("y", mu=pmf.response(chain(theta), PULSE), sigma=1.0, observed=measured())
    particles = prior_particles(model)
    possible, failed = compare(model, particles)
    np.testing.assert_array_equal(failed, particles[:, 0] <= 0)
    np.testing.assert_array_equal(possible, ~failed)
    for kernel in KERNELS:
        idata = sample(model, kernel)
        assert np.ravel(idata.sample_stats["failed"])[0] > 10, kernel
        assert (idata.posterior["theta"] > 0).all()


@pytest.mark.all_rewrites  # which take the checks away
def test_without_bounds_checks():
    """`pm.Model(check_bounds=False)`: no -inf but what the formula gives, particle by particle."""
    with pm.Model(check_bounds=False) as model:
        pm.Gamma("y", pm.Normal("x", 1.0), 1.0, observed=[0.5, 1.5])
    particles = prior_particles(model)
    possible, _ = compare(model, particles)
    assert possible[particles[:, 0] < 0].all() and (particles < 0).any()


def test_splitting_changes_nothing(monkeypatch):
    model = structure()
    particles = prior_particles(model, n=50)
    whole = PopulationLogp(model, model.initial_point(), {})
    monkeypatch.setattr(rows, "BATCH_BYTES", 8 * 3 * 7)
    parts = PopulationLogp(model, model.initial_point(), {})
    assert 1 < parts.values.batch < 25 < whole.values.batch
    for a, b in zip(whole(particles), parts(particles), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


LONG = noise_record(3000)
N_PARTICLES = 1500


def norm(mu, y):
    pm.Normal("y", mu=mu, sigma=1.0, observed=y)


def norm_unfused(mu, y):
    pm.Normal("y", mu=mu + 0.5, sigma=1.0, observed=y)


def peak_growth(function, queue):
    """Bytes by which the peak memory of this process grows in a call."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    function()
    queue.put(1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before))


@pytest.mark.processes
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="peak memory of a forked process")
@pytest.mark.parametrize(("likelihood", "fused"), [(norm, True), (norm_unfused, False)])
def test_memory_does_not_grow_with_histories(likelihood, fused):
    """All histories would take 108 MB; a fused model takes none, another the batch at a time."""
    y = measured(record=LONG)
    histories = 8 * N_PARTICLES * y.size
    with pm.Model() as model:
        likelihood(pmf.response(chain(pm.Uniform("theta", 0.5, 1.5)), LONG), y)
    with pytensor.config.change_flags(mode="Mode"):
        logp = population_logp(model, model.initial_point(), {})
    particles = prior_particles(model, n=N_PARTICLES)
    logp(particles[:8])
    queue = multiprocessing.get_context("fork").SimpleQueue()
    process = multiprocessing.get_context("fork").Process(
        target=peak_growth, args=(lambda: logp(particles), queue)
    )
    process.start()
    grown = queue.get()
    process.join()
    if fused:
        assert grown < 0.1 * histories
        assert logp.values.batch > N_PARTICLES
    else:
        assert grown > 0.3 * histories, "the negative control"
        assert logp.values.batch < N_PARTICLES


def normal(mean=lambda mu: mu, sigma=lambda: 0.4):
    with pm.Model() as model:
        theta = pm.Normal("theta", 1.0, 0.3)
        pm.Normal("y", mu=mean(pmf.response(chain(theta), PULSE)), sigma=sigma(), observed=measured())
    return model


def holds_a_history(model):
    """Whether the compiled log-likelihood computes a response, not only its discrepancy."""
    graph = model.compile_fn(model.datalogp, mode=REWRITTEN).f.maker.fgraph
    return any("StructuralResponse" in str(node.op) for node in graph.apply_nodes)


@pytest.mark.slow
@pytest.mark.parametrize("values", [0.4, np.array([[0.7], [1.05], [1.4]])], ids=["known", "of each sensor"])
def test_normal_of_a_response_needs_no_history(values):
    """The sum of SciPy's log-densities, also particle by particle, from a graph without a history."""
    known = np.ndim(values) == 0
    model = normal(sigma=lambda: values if known else pm.HalfNormal("sigma", 1.0, shape=(3, 1)))
    point = {"theta": 1.1} if known else {"theta": 1.1, "sigma_log__": np.log(values)}
    assert not holds_a_history(model)
    mu = pmf.simulate(chain(1.1), PULSE).values
    exact = stats.norm.logpdf(measured(), mu, values).sum()
    for mode in (REWRITTEN,) if known else (REWRITTEN, "NUMBA"):
        datalogp = model.compile_fn(model.datalogp, mode=mode)
        assert float(datalogp(point)) == pytest.approx(exact, rel=1e-10)
    logp = population_logp(model, model.initial_point(), {})
    row = np.concatenate([np.ravel(point[v.name]) for v in model.value_vars])
    np.testing.assert_allclose(logp(np.array([row, row]))[1], exact, rtol=1e-10)
    compare(model, prior_particles(model, spread=0.1))


TIMES = np.linspace(0.5, 1.5, PULSE.n_times)


@pytest.mark.parametrize(
    ("mean", "sigma"),
    [
        (lambda mu: mu, lambda: TIMES),
        (lambda mu: mu + 0.5, lambda: 0.4),
        (lambda mu: 2.0 * mu, lambda: 0.4),
        (lambda mu: mu[::-1], lambda: 0.4),
    ],
    ids=["sigma in time", "offset", "factor", "another order"],
)
def test_other_normals_are_left_alone(mean, sigma):
    """Not a function of e_j: the history stays, and the numbers are right."""
    model = normal(mean, sigma)
    assert holds_a_history(model)
    exact = stats.norm.logpdf(measured(), mean(pmf.simulate(chain(1.1), PULSE).values), sigma()).sum()
    assert float(model.compile_fn(model.datalogp)({"theta": 1.1})) == pytest.approx(exact, rel=1e-10)
    compare(model, prior_particles(model, spread=0.1))


@pytest.mark.slow
@pytest.mark.parametrize("shared", [True, False])
def test_one_call_for_each_record(shared):
    """Records of any step and length; one factor for all, or one each: the sum of what they give alone."""
    records = [noise_record(n, dt, seed=n) for n, dt in ((150, 0.02), (200, 0.01), (100, 0.04))]

    def likelihood(i, theta, sigma):
        mu = pmf.response(chain(theta), records[i])
        pmf.TruncNormalFeature(f"y{i}", mu=mu, sigma=sigma, observed=measured(record=records[i]))

    with pm.Model() as joint:
        sigma, mean = pm.HalfNormal("sigma", 1.0), pm.Normal("mean", 1.0, 0.1)
        theta = [mean] * 3 if shared else pm.Normal("theta", mean, 0.05, shape=3)
        for i in range(3):
            likelihood(i, theta[i], sigma)
    logp = population_logp(joint, joint.initial_point(), {})
    ops = [type(node.op).__name__ for node in logp.values.function.maker.fgraph.apply_nodes]
    assert logp.batched and ops.count("PopulationDiscrepancy") == 3
    points = np.random.default_rng(1).normal(1.0, 0.05, (5, 2 if shared else 5))
    points[:, 0] -= 2.0
    alone = np.zeros(5)
    for i in range(3):
        with pm.Model() as one:
            likelihood(i, pm.Normal("factor", 1.0, 0.1), pm.HalfNormal("sigma", 1.0))
        columns = points[:, [1 if shared else 2 + i, 0]]
        alone += population_logp(one, one.initial_point(), {})(columns)[1]
    np.testing.assert_allclose(logp(points)[1], alone, rtol=1e-10)


RECORD = pmf.synthetic_earthquake(2.0, 0.02, random_seed=1)


def declare():
    with pm.Model() as model:
        theta = pm.Uniform("theta", 0.5, 1.5)
        chain = pmf.SpringMassChain([1.0, 1.0], 400.0 * theta, pmf.ModalDamping(0.02))
        pmf.ExpFeature("y", pmf.response(chain, RECORD), pm.HalfNormal("sigma"), observed=np.ones((2, 101)))
    return model


@pytest.mark.default_mode
def test_a_new_model_needs_no_compilation_and_python_is_called_for_no_single_number():
    """NumPy or SciPy has a function for every operation on arrays, those of bounded priors included."""
    model = declare()
    logp = population_logp(model, model.initial_point(), {})
    assert isinstance(logp.values.function.maker.linker, PerformLinker)
    logp.compile_gradient()
    for function in (logp.values.function, logp.slopes.function):
        operations = [node.op for node in function.maker.fgraph.toposort() if isinstance(node.op, Elemwise)]
        folded = (Add, Mul, Cast)  # by PyTensor itself
        alone = [op for op in operations if not (op.nfunc_spec or isinstance(op.scalar_op, folded))]
        assert operations and not alone
    assert cloudpickle.dumps(logp.slopes), "processes of chains take it"
    x = np.array([[-1.0, 0.2], [-40.0, 0.2], [0.3, -1.0], [20.0, 0.2], [40.0, 0.2]])
    uniform = -np.logaddexp(0.0, x[:, 0]) - np.logaddexp(0.0, -x[:, 0])  # with its logit's derivative
    half_normal = 0.5 * np.log(2.0 / np.pi) - 0.5 * np.exp(2.0 * x[:, 1]) + x[:, 1]
    np.testing.assert_allclose(logp(x)[0], uniform + half_normal, rtol=1e-13)


@pytest.mark.default_mode
def test_what_the_user_asks_for_comes_first():
    assert with_mode({"mode": "NUMBA"}, []) == {"mode": "NUMBA"}
    with pytensor.config.change_flags(mode="NUMBA"):
        assert with_mode({}, []) == {}


@pytest.mark.default_mode
@pytest.mark.parametrize(
    ("loops", "declared"),
    [
        (False, lambda x: pt.vectorize(lambda row: pt.dot(np.eye(3), row), signature="(a)->(b)")(x)),
        (True, lambda x: pt.vectorize(lambda row: pt.linalg.expm(pt.diag(row)), signature="(a)->(b,b)")(x)),
        (True, lambda x: pytensor.scan(lambda row, sum: sum + row, x, pt.zeros(3), return_updates=False)),
    ],
)
def test_loops_in_python_are_seen(loops, declared):
    assert has_python_loops([declared(pt.matrix("x"))]) == loops
