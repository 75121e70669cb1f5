"""Gradients of whole populations, against those of PyMC of one particle at a time."""

import contextlib
import functools
import multiprocessing
import warnings

import cloudpickle
import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pymc.pytensorf import gradient
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from pytensor.graph.replace import _vectorize_node

import pymc_features as pmf
from pymc_features.exceptions import NotDifferentiableError, PopulationWarning
from pymc_features.ops import PopulationGradient, StructuralResponse
from pymc_features.smc import KERNELS, population_logp
from pymc_features.smc.density import evaluation, rows
from support import external_functions as functions
from support import populations
from support.families import CASES, measured
from support.graphs import our_ops_of
from support.populations import discrete, points_of, potential

CLOSE = {"rtol": 1e-9, "atol": 1e-9}


@functools.cache
def two_nodes():
    with pm.Model() as model:
        x, s = pm.Normal("x", shape=2), pm.HalfNormal("s")
        pm.Normal("y", pm.Data("table", [[1.0, 0.5], [0.0, 2.0]]) @ x, s, observed=[1.0, 0.3])
        pm.Poisson("n", pt.exp(x).sum(), observed=3)
    return model


def transforms():
    with pm.Model() as model:
        a = pm.Uniform("a", -1.0, 2.0, shape=2)
        b = pm.LogNormal("b")
        c = pm.Dirichlet("c", np.ones(3))
        pm.Normal("y", a[:, None] + c, b, observed=np.arange(6.0).reshape(2, 3) / 3)
    return model


def nothing_but_a_prior():
    with pm.Model() as model:
        pm.Gamma("x", 2.0, 1.0, shape=2)
    return model


ANY_MODEL = (potential, two_nodes, transforms, nothing_but_a_prior)
LIKELIHOODS = {
    "TN": lambda mu, sigma, y: pmf.TruncNormalFeature("y", mu, sigma, observed=y),
    "EXP": lambda mu, sigma, y: pmf.ExpFeature("y", mu, sigma, observed=y),
    "normal": lambda mu, sigma, y: pm.Normal("y", mu, sigma, observed=y),
    "correlated": lambda mu, sigma, y: pmf.CorrelatedNormal("y", mu, sigma, 0.2, 0.05, observed=y),
    "soft ABC": lambda mu, sigma, y: pmf.DiscrepancySimulator(
        "y", mu, epsilon=9.0, observed=y, kernel="gaussian"
    ),
    "of a changed response": lambda mu, sigma, y: pm.Normal("y", 1.1 * mu, sigma, observed=y),
}


@functools.cache  # what is compiled for one test is there for the others
def structural(name, likelihood="TN"):
    """Two factors of the stiffness, of any sign, and sigma unknown."""
    build, record = CASES[name]
    with pm.Model() as model:
        mu = pmf.response(build(pm.Normal("x", 1.0, 0.1, shape=2)), record)
        LIKELIHOODS[likelihood](mu, pm.HalfNormal("sigma", 1.0), measured(name))
    return model


prior_particles = functools.partial(populations.prior_particles, n=12, spread=0.3)


def evaluation_of(model, **settings):
    return population_logp(model, model.initial_point(), settings)


def one_by_one(model, particles):
    """Log prior, log-likelihood (n,), gradients of log prior and log-posterior (n, d) by PyMC."""
    terms = [model.varlogp, model.datalogp, gradient(model.varlogp, model.value_vars), model.dlogp()]
    function = model.compile_fn(terms, on_unused_input="ignore")
    return map(np.array, zip(*(function(p) for p in points_of(model, particles)), strict=True))


def compare_gradients(model, particles, close=1e-9):
    """The evaluation, whose values and gradients are those of PyMC."""
    logp = evaluation_of(model)
    prior, likelihood, failed, grad_prior, grad_likelihood = logp.gradient(particles)
    for got, expected in zip((prior, likelihood, failed), logp(particles), strict=True):
        np.testing.assert_allclose(got, expected, **CLOSE)
    *values, exact_prior, exact = one_by_one(model, particles)
    for got, expected in zip((prior, likelihood), values, strict=True):
        np.testing.assert_allclose(got, expected, rtol=max(close, 1e-8), atol=max(close, 1e-8))
    scale = 1.0 + abs(exact).max(axis=1, keepdims=True)
    np.testing.assert_allclose(grad_prior / scale, exact_prior / scale, **CLOSE)
    np.testing.assert_allclose((grad_prior + grad_likelihood) / scale, exact / scale, rtol=close, atol=close)
    assert grad_prior.shape == particles.shape and abs(exact).max() > 0.1
    return logp


@pytest.mark.slow
@pytest.mark.parametrize("build", ANY_MODEL)
def test_any_model(build):
    model = build()
    logp = compare_gradients(model, prior_particles(model))
    assert logp.slopes.batched and logp.why_no_gradient == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_family_of_structures(name):
    """In one call of an Op of the population, without a response; of nonlinear chains with other steps.

    What is no structure has density -inf and gradient zero, and those around it do not notice: they are as
    beside copies of one of them (yielding chains that march together take the steps of the most demanding).
    """
    model, yields = structural(name), name in ("duffing", "hysteretic")
    logp = compare_gradients(model, prior_particles(model, spread=0.05), 3e-6 if yields else 1e-9)
    assert logp.slopes.batched
    ops = our_ops_of(logp.slopes.function)
    assert PopulationGradient in ops and StructuralResponse not in ops
    particles = prior_particles(model, n=9, spread=0.02)
    bad = np.isin(np.arange(9), [0, 4, 8])
    particles[bad] = particles[1]
    expected = [a.copy() for a in logp.gradient(particles)]
    particles[bad, 0] = [-3.0, np.nan, -1.0]
    prior, likelihood, failed, *slopes = logp.gradient(particles)
    np.testing.assert_array_equal(failed, bad)
    assert (likelihood[bad] == -np.inf).all() and np.isfinite(prior[[0, 8]]).all() and prior[4] == -np.inf
    for got, exact in zip((prior, likelihood, failed, *slopes), expected, strict=True):
        np.testing.assert_allclose(got[~bad], exact[~bad], rtol=1e-7 if yields else 1e-10)
    assert not any(slope[bad].any() for slope in slopes) and all(s[~bad].all() for s in slopes)


@pytest.mark.slow
@pytest.mark.parametrize("likelihood", [name for name in LIKELIHOODS if name != "TN"])
def test_every_likelihood(likelihood):
    model = structural("chain", likelihood)
    logp = compare_gradients(model, prior_particles(model, spread=0.05))
    assert logp.slopes.batched
    assert (StructuralResponse in our_ops_of(logp.slopes.function)) == (likelihood == "of a changed response")


def test_outside_the_support_is_alone():
    with pm.Model() as model:
        x = pm.Uniform("x", 0.0, 1.0, default_transform=None)
        pm.Normal("y", x, pm.Normal("s"), observed=[0.1, 0.2])
    particles = np.array([[0.5, 1.0], [2.0, 1.0], [0.3, -1.0], [0.2, 0.5]])
    prior, likelihood, failed, *slopes = evaluation_of(model).gradient(particles)
    np.testing.assert_array_equal(np.isfinite(prior + likelihood), [True, False, False, True])
    np.testing.assert_array_equal(failed, [False, False, True, False])
    assert not any(slope[1:3].any() for slope in slopes)
    np.testing.assert_allclose(slopes[1][[0, 3], 0], [(0.3 - 1.0) / 1.0, (0.3 - 0.4) / 0.25])


class Cube(Op):
    """x^3; raises a numerical error for negative x, in its slope for x above 9; may refuse batches."""

    __props__ = ("error", "takes_batches", "is_slope")
    gufunc_signature = "()->()"

    def __init__(self, error, takes_batches, is_slope=False):
        self.error, self.takes_batches, self.is_slope = error, takes_batches, is_slope

    def make_node(self, x):
        return Apply(self, [pt.as_tensor_variable(x)], [pt.dscalar()])

    def infer_shape(self, node, shapes):
        return [()]

    def perform(self, node, inputs, outputs):
        x = float(inputs[0])
        if x < 0 or (self.is_slope and x > 9):
            raise self.error("no solution")
        outputs[0][0] = np.array(3 * x**2 if self.is_slope else x**3)

    def pullback(self, inputs, outputs, cotangents):
        return [cotangents[0] * Cube(self.error, self.takes_batches, is_slope=True)(*inputs)]


@_vectorize_node.register(Cube)
def _vectorize_cube(op, node, x):
    if not op.takes_batches:
        raise NotImplementedError("one at a time")
    return _vectorize_node.dispatch(Op)(op, node, x)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")  # Numba's object mode, and Blockwise's
@pytest.mark.parametrize(
    ("error", "batched", "mode"),
    [
        (np.linalg.LinAlgError, True, "NUMBA"),
        (FloatingPointError, False, "FAST_COMPILE"),
        (ZeroDivisionError, True, "FAST_COMPILE"),
    ],
)
def test_numerical_errors_are_alone_and_failures(error, batched, mode):
    """Also those of the gradient only; particle by particle where the model takes no batch."""
    with pm.Model() as model:
        pm.Potential("solver", -Cube(error, batched)(pm.Normal("x")))
    with contextlib.nullcontext() if batched else pytest.warns(PopulationWarning, match="one at a time"):
        logp = evaluation_of(model, mode=mode)
    x = np.abs(np.random.default_rng(0).normal(size=(33, 1)))
    x[[3, 17, 32]] = [[-1.0], [10.0], [-2.0]]
    prior, likelihood, failed, grad_prior, grad_likelihood = logp.gradient(x)
    bad = np.isin(np.arange(33), [3, 17, 32])
    np.testing.assert_array_equal(failed, bad)
    assert (likelihood[bad] == -np.inf).all() and not grad_prior[bad].any() and not grad_likelihood[bad].any()
    np.testing.assert_allclose(likelihood[~bad], -(x[~bad, 0] ** 3), rtol=1e-12)
    np.testing.assert_allclose(grad_likelihood[~bad], -3 * x[~bad] ** 2, rtol=1e-12)
    np.testing.assert_allclose(grad_prior[~bad], -x[~bad], rtol=1e-12)
    assert logp.slopes.batched == batched and logp.last_error == f"{error.__name__}: no solution"


def stock_simulator():
    with pm.Model() as model:
        pm.Simulator("s", lambda rng, x, size: x, pm.Normal("x"), epsilon=1.0, observed=[1.0])
    return model


def threshold(noise=None, kernel="uniform"):
    build, record = CASES["chain"]
    with pm.Model() as model:
        mu = pmf.response(build(pm.LogNormal("x", shape=2)), record)
        data = measured("chain")
        pmf.DiscrepancySimulator("y", mu, epsilon=1.0, observed=data, kernel=kernel, noise=noise)
    return model


def random_inside():
    with pm.Model() as model:
        pm.Potential("batch", pm.Normal("x") * pm.draw(pm.Normal.dist()) + pt.random.normal())
    return model


class Rough(Op):
    """Identity without a gradient."""

    __props__ = ()
    gufunc_signature = "()->()"

    def make_node(self, x):
        return Apply(self, [pt.as_tensor_variable(x)], [pt.dscalar()])

    def perform(self, node, inputs, outputs):
        outputs[0][0] = inputs[0].copy()


def foreign_op():
    with pm.Model() as model:
        pm.Potential("rough", Rough()(pm.Normal("x")))
    return model


WITHOUT = {
    "k is discrete": discrete,
    "the grad method for input .* of the Simulator_s_rv.* op is undefined": stock_simulator,
    "the hard threshold of DiscrepancySimulator has no gradient": threshold,
    "a simulator with noise has no gradient": lambda: threshold(noise=0.1, kernel="gaussian"),
    "random numbers are drawn inside, anew in each call": random_inside,
    "pullback not implemented for Rough": foreign_op,
}


@pytest.mark.parametrize("reason", WITHOUT)
def test_models_without_a_gradient_say_why(reason):
    """In one sentence; values are evaluated all the same."""
    model = WITHOUT[reason]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logp = evaluation_of(model)
    assert not logp.has_gradient and ". " not in logp.why_no_gradient
    with pytest.raises(NotDifferentiableError, match=f"the model has no gradient: {reason}.*Use a kernel"):
        logp.gradient(np.ones((3, 1)))
    assert len(logp(prior_particles(model, n=3))[0]) == 3


@pytest.mark.slow
def test_external_programs():
    """With the user's gradient particle by particle; without one there is none."""
    with (
        pmf.ExternalSimulator(functions.beam, functions.SHAPE, executor=1, progress=False) as rough,
        pmf.ExternalSimulator(
            functions.beam, functions.SHAPE, executor=1, progress=False, gradient=functions.beam_gradient
        ) as smooth,
    ):
        models = []
        for simulator in (rough, smooth):
            with pm.Model() as model:
                mu = simulator(pm.Uniform("k", 0.5, 1.5))
                pmf.TruncNormalFeature("y", mu, pm.HalfNormal("s"), observed=functions.DATA)
            models.append(model)
        assert evaluation_of(models[0]).why_no_gradient == "an external simulator without `gradient` has none"
        logp = compare_gradients(models[1], prior_particles(models[1], n=4))
        assert logp.batched and not logp.slopes.batched


def never(*args, **kwargs):
    raise AssertionError("compiled again")


def gradient_in_child(sent, particles, queue):
    """Put the gradients, or the error."""
    rows.compile_function = never
    try:
        queue.put(cloudpickle.loads(sent).gradient(particles))
    except BaseException as error:
        queue.put(repr(error))


@pytest.mark.processes
@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
def test_a_forked_process_does_not_compile():
    model = structural("chain")
    logp = evaluation.PopulationLogp(model, model.initial_point(), {})
    particles = prior_particles(model, spread=0.05)
    fork, found = multiprocessing.get_context("fork"), []
    sent = cloudpickle.dumps(logp)
    for compiled in (False, True):
        if compiled:
            logp.compile_gradient()
        queue = fork.SimpleQueue()
        process = fork.Process(target=gradient_in_child, args=(sent, particles, queue))
        process.start()
        found.append(queue.get())
        process.join()
    assert "compiled again" in found[0], "the negative control"
    for got, exact in zip(found[1], logp.gradient(particles), strict=True):
        np.testing.assert_array_equal(got, exact)


def kernel_in(folder, model):
    """A kernel about to begin a chain, with a journal."""
    kernel = pmf.sampling.PopulationIMH(8, model=model, random_seed=1, checkpoint=folder)
    kernel._reset_state()
    kernel.set_rng(np.random.default_rng(1))
    return kernel


@pytest.mark.slow
@pytest.mark.parametrize("kind", KERNELS)
def test_kernels_count_gradients(kind):
    model = structural("chain")
    kernel = kind(8, model=model, random_seed=1)
    particles = prior_particles(model, n=7, spread=0.02)
    particles[2] = -1.0
    results = kernel.evaluate_gradient(particles)
    *_, failed, grad_prior, grad_likelihood = kernel.logp.gradient(particles)
    np.testing.assert_array_equal(results[2:], [grad_prior, grad_likelihood])
    np.testing.assert_allclose(results[:2], kernel.evaluate(particles), rtol=1e-12)
    assert (kernel.gradients, kernel.evaluations, kernel.failed) == (7, 7, 2)


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0, 500])
def test_journals_replay_gradients(tmp_path, monkeypatch, cut):
    """Values and gradients in any order, bit for bit, nothing evaluated again but a record cut short."""
    model = two_nodes()
    particles = prior_particles(model, n=6)
    kernel = kernel_in(tmp_path, model)
    names = ["evaluate", "evaluate_gradient", "evaluate_gradient", "evaluate"]
    expected = [getattr(kernel, name)(particles + i) for i, name in enumerate(names)]
    kernel.journal.close()
    [path] = tmp_path.glob("*.journal")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - cut])
    again = kernel_in(tmp_path, model)
    if cut == 0:
        monkeypatch.setattr(evaluation.PopulationLogp, "__call__", never)
        monkeypatch.setattr(evaluation.PopulationLogp, "gradient", never)
    for i, name in enumerate(names):
        for got, exact in zip(getattr(again, name)(particles + i), expected[i], strict=True):
            np.testing.assert_array_equal(got, exact)
    assert (again.evaluations, again.gradients) == (12, 12)
    again.journal.close()
    assert path.read_bytes() == whole
