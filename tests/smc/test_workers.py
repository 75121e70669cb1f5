"""Populations and chains on several processes or a cluster: the particles are those of one process."""

import _thread
import functools
import logging
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from scipy import sparse

import pymc_features as pmf
from pymc_features.exceptions import NoWorkersError
from pymc_features.external.workers import calls
from pymc_features.simulators.linear.known import KNOWN
from pymc_features.simulators.nonlinear.kernels import PARTICLES
from pymc_features.smc import open_workers, population_logp
from pymc_features.smc import workers as workers_module
from pymc_features.smc.density.rows import UNIT
from support.external_functions import DATA, SHAPE, beam, lives
from support.families import CASES, RAYLEIGH, measured, pulse
from support.sampling import QUIET

RNG = np.random.default_rng(7)


@pytest.fixture(autouse=True)
def usual_mode():
    """NumPy around the kernels, as users have it."""
    with pytensor.config.change_flags(mode="Mode"):
        yield


@pytest.fixture
def eager(monkeypatch):
    """Every population is worth a message, and none begins here while workers load the model."""
    monkeypatch.setattr(workers_module, "HERE", 0.0)
    monkeypatch.setattr(workers_module, "ELSEWHERE", 0.0)
    monkeypatch.setattr(workers_module.Run, "some_are_ready", lambda self, work: True)


def model_of(name, likelihood=pmf.ExpFeature):
    """A structure of two factors, some of which are no structure, and the scale of the errors."""
    build, record = CASES[name]
    with pm.Model() as model:
        x, sigma = pm.Normal("x", 1.0, 0.5, shape=2), pm.HalfNormal("sigma", 1.0)
        likelihood("y", mu=pmf.response(build(x), record), sigma=sigma, observed=measured(name))
    return model


def two_nodes():
    """Springs from a random field, two events, the second as data to change: a product of matrices inside."""
    basis = np.random.default_rng(5).standard_normal((3, 2))
    with pm.Model() as model:
        x = pm.Normal("x", shape=2)
        structure = pmf.SpringMassChain(np.ones(3), 120.0 * pt.exp(0.1 * pt.dot(basis, x)), RAYLEIGH)
        acceleration = pmf.response(structure, pulse())
        pmf.ExpFeature("y", mu=acceleration, sigma=1.0, observed=measured("chain"))
        pmf.TruncNormalFeature("z", mu=acceleration, sigma=2.0, observed=pm.Data("data", measured("chain")))
    return model


def same(found, expected):
    """Whether all draws are the same, bit for bit."""
    names = list(expected.posterior.data_vars)
    return equal(*([result.posterior[n].values for n in names] for result in (found, expected)))


def equal(found, expected):
    """Whether all arrays are the same, bit for bit."""
    return all(np.array_equal(one, other) for one, other in zip(found, expected, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["chain", "hysteretic"])
def test_rows_do_not_depend_on_where_a_population_is_cut(name):
    """Among them particles that are no structure, and others that are stepped more finely."""
    model = model_of(name)
    logp = population_logp(model, model.initial_point(), {})
    particles = np.random.default_rng(3).normal(1.0, 0.8, (6 * UNIT + 5, 3))
    before = PARTICLES["taylor"]
    whole = logp(particles)
    assert logp.values.unit == UNIT and 0 < np.isfinite(whole[1]).sum() < len(particles)
    cuts = [0, UNIT, 4 * UNIT, len(particles)]
    parts = [logp(particles[i:k]) for i, k in zip(cuts, cuts[1:], strict=False)]
    assert equal(map(np.concatenate, zip(*parts, strict=True)), whole)
    if name == "hysteretic":
        assert PARTICLES["taylor"] > before
        shifted = logp(particles[1:])[1]  # other neighbours, other steps
        assert (shifted != whole[1][1:]).any()
        np.testing.assert_allclose(shifted, whole[1][1:], rtol=1e-4)


def large_sparse():
    """300 masses on springs in a plane, stiffer to one side, on a bedding: two factors, four modes."""
    along, across = (
        sparse.diags_array([2.0 * np.ones(k), -np.ones(k - 1), -np.ones(k - 1)], offsets=[0, 1, -1])
        for k in (20, 15)
    )
    springs = sparse.kron(along, sparse.eye_array(15)) + 2.3 * sparse.kron(sparse.eye_array(20), across)
    bedding = sparse.diags_array(np.linspace(0, 1, 300))
    terms = [1e4 * sparse.csc_array(springs), 1e3 * sparse.csc_array(bedding)]
    plane = pmf.AffineStructure(
        np.ones(300),
        stiffness=sparse.csc_array((300, 300)),
        damping=pmf.ModalDamping(0.02),
        stiffness_terms=terms,
        theta=np.ones(2),
    )
    data = RNG.normal(size=(2, len(pulse().acceleration)))
    with pm.Model() as model:
        x = pm.LogNormal("x", 0.0, 0.2, shape=2)
        mu = pmf.response(plane.with_parameters(x), pulse(), sensors=[5, 200], n_modes=4)
        pmf.ExpFeature("y", mu=mu, sigma=1.0, observed=data)
    return model


@pytest.mark.processes
def test_large_structures_share_a_basis(eager):
    """Values and gradients, here, in other cuts and in another process; far from the prior too."""
    model = large_sparse()
    logp = population_logp(model, model.initial_point(), {})
    particles = RNG.normal(0.0, 0.2, (3 * UNIT + 3, 2))
    particles[4], particles[9] = [3.0, -3.0], [-6.0, 5.0]
    values, slopes = logp(particles), logp.gradient(particles)
    [of_values], [of_slopes] = logp.values.bases, logp.slopes.bases
    assert of_values.is_fixed and 8 < of_values.basis.size <= of_slopes.basis.size < 100
    assert of_values.found >= len(particles) - 2 and np.isfinite(values[1]).all()
    logp(particles[::-1])
    with open_workers(1) as workers:
        elsewhere = workers.run().of(logp)
        answers = logp(particles[:UNIT]), elsewhere(particles), elsewhere.gradient(particles)
    assert all(map(equal, answers, ([x[:UNIT] for x in values], values, slopes)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KNOWN, "of", lambda *given, **settings: None)
        in_full = logp.gradient(particles)
    np.testing.assert_allclose(values[1], in_full[1], rtol=1e-8)
    np.testing.assert_allclose(slopes[4], in_full[4], rtol=1e-5, atol=1e-5 * abs(in_full[4]).max())


class Here(ThreadPoolExecutor):
    """A thread that does what a worker does, in this process; counts what it is sent."""

    places = 2

    def __init__(self, lose=()):
        super().__init__(1)
        self.payloads, self.parts, self.lose = [], 0, set(lose)

    def submit(self, function, digest, arguments, timeout, payload):
        self.payloads.append(payload)
        self.parts += 1
        if self.parts in self.lose:
            return super().submit(int, "a machine that is gone")
        return super().submit(function, digest, arguments, timeout, payload)


@pytest.mark.processes
def test_the_particles_of_one_process(eager):
    """Two chains at once, with gradients (`sample`), a product of matrices, two likelihoods, and data."""
    settings = {"model": two_nodes(), "chains": 2, "random_seed": 1, **QUIET}
    with ThreadPoolExecutor(1) as pool, open_workers(pool) as workers:  # one process has all to say here
        for run in (functools.partial(pmf.sample_smc, stage_draws=60), pmf.sample):
            expected, found = run(60, cores=1, **settings), run(60, executor=workers, **settings)
            assert same(found, expected)
            for name in ("evaluations", "gradients", "beta"):
                np.testing.assert_array_equal(found.sample_stats[name], expected.sample_stats[name])


@pytest.mark.processes
def test_local_processes_dask_and_a_killed_worker(eager, tmp_path):
    """Of yielding chains; with a checkpoint, which does not know of executors."""
    distributed = pytest.importorskip("distributed")
    model = model_of("hysteretic")
    logp = population_logp(model, model.initial_point(), {})
    particles = RNG.normal(1.0, 0.3, (400, 3))
    expected = logp(particles)
    settings = {"model": model, "chains": 1, "random_seed": 3, "stage_draws": 60, **QUIET}
    whole = pmf.sample_smc(60, cores=1, checkpoint=tmp_path / "kept", **settings)
    [journal] = (tmp_path / "kept").glob("*.journal")
    journal.write_bytes(journal.read_bytes()[: journal.stat().st_size // 2])  # as if it had been killed
    quiet = {"dashboard_address": ":0", "silence_logs": logging.CRITICAL, "local_directory": str(tmp_path)}
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **quiet) as cluster,
        open_workers(cluster.scheduler_address) as workers,
    ):
        own = workers.run().of(logp)
        assert equal(own(particles), expected)
        [victim] = (p.process.pid for p in calls._IDLE[workers.owner])
        timer = threading.Timer(0.01, os.kill, (victim, signal.SIGKILL))
        timer.start()
        assert all(equal(own(particles), expected) for _ in range(5))
        timer.join()
        now = [p.process.pid for p in calls._IDLE[workers.owner]]
        assert now and victim not in now
        assert same(pmf.sample_smc(60, checkpoint=tmp_path / "kept", executor=workers, **settings), whole)
        begun = time.monotonic()
    assert not any(map(lives, now)) and time.monotonic() - begun < 30.0


@pytest.fixture
def usual_ctrl_c():
    """Python's own handler; commands that other tests have run leave theirs."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.processes
def test_ctrl_c_ends_the_processes_and_loses_nothing(eager, usual_ctrl_c, monkeypatch, tmp_path):
    """Pressed while two chains wait for a worker; the next run goes on from what is kept."""
    elsewhere, done, pids = workers_module.Run.elsewhere, [], set()

    def interrupted(self, *rest):
        found = elsewhere(self, *rest)
        done.append(1)
        if len(done) == 4:
            known = [kept.get(self.workers.owner, ()) for kept in (calls._IDLE, calls._BUSY)]
            pids.update(p.process.pid for processes in known for p in processes)
            _thread.interrupt_main()
        return found

    settings = {"model": model_of("chain"), "chains": 2, "random_seed": 4, "stage_draws": 60, **QUIET}
    expected = pmf.sample_smc(60, cores=1, **settings)
    with monkeypatch.context() as patch:
        patch.setattr(workers_module.Run, "elsewhere", interrupted)
        with pytest.raises(KeyboardInterrupt):
            pmf.sample_smc(60, executor=1, checkpoint=tmp_path / "kept", **settings)
    assert pids and not any(map(lives, pids))
    found = pmf.sample_smc(60, cores=1, checkpoint=tmp_path / "kept", **settings)
    assert same(found, expected)
    assert sum(j.stat().st_size for j in (tmp_path / "kept").glob("*.journal")) > 0


def test_a_model_is_sent_where_it_is_missing_and_parts_again_that_are_lost(eager, monkeypatch):
    """By an executor of the user's, that does not bring it; nothing of the package runs in processes here.

    A part on which two processes die is evaluated all the same; one on which all do is an error.
    """
    monkeypatch.setattr(calls, "SimulatorProcess", InThisProcess)
    model = model_of("chain")
    logp = population_logp(model, model.initial_point(), {})
    particles = RNG.normal(1.0, 0.3, (200, 3))
    monkeypatch.setattr("pymc_features.external.workers.executors.SMALL", 0)
    with Here(lose={3, 4, 5}) as pool, open_workers(pool) as workers:
        own = workers.run().of(logp)
        np.testing.assert_array_equal(own(particles)[1], logp(particles)[1])
        sent = [payload for payload in pool.payloads if payload is not None]
        assert 1 <= len(sent) < len(pool.payloads) and len({*sent}) == 1
        n_sent = len(sent)
        own(particles)
        assert len([p for p in pool.payloads if p is not None]) == n_sent  # it is there
        calls._PAYLOADS.clear()  # a new machine in place of an old one
        np.testing.assert_array_equal(own(particles)[1], logp(particles)[1])
        assert len([p for p in pool.payloads if p is not None]) > n_sent
        monkeypatch.setattr(InThisProcess, "dies", 2)
        np.testing.assert_array_equal(own(particles)[1], logp(particles)[1])
        monkeypatch.setattr(InThisProcess, "dies", 1000)
        with pytest.raises(NoWorkersError, match="`executor` must have workers that live, got 3 that died"):
            own(particles)


class InThisProcess:
    """What a process does, without one; dies, or answers."""

    dies = 0
    process = type("Alive", (), {"poll": staticmethod(lambda: None), "returncode": 0})
    usable = True

    def __init__(self, payload, is_wanted):
        self.works, self.digests = [calls_of(payload)], []

    def load(self, digest, payload):
        """One more."""
        if digest not in self.digests:
            self.works.append(calls_of(payload))
            self.digests.append(digest)
        return "ready", "", 0.0

    def ask(self, digest, arguments, timeout):
        """Answer; or say that it died."""
        if InThisProcess.dies:
            InThisProcess.dies -= 1
            return "died", "the process ended with signal 9", 0.0
        return "ok", self.works[self.digests.index(digest)](*arguments), 0.01

    def close(self):
        """Nothing to end."""


def calls_of(payload):
    """The function in a payload."""
    return cloudpickle.loads(payload)["function"]


def test_values_that_are_no_executor():
    for executor in (0, 1.5, True, "", [2], ThreadPoolExecutor):
        for run in (pmf.sample_smc, pmf.sample):
            with pytest.raises(TypeError, match="`executor` must be something that runs simulations, got"):
                run(100, model=model_of("chain"), executor=executor)


def test_models_and_kernels_that_take_no_executor():
    settings = {"model": model_of("chain"), "executor": 2, **QUIET}
    with pytest.raises(TypeError, match="`executor` must be left out for MH, which has none"):
        pmf.sample_smc(100, pm.smc.MH, **settings)
    with pmf.ExternalSimulator(beam, SHAPE, executor=1, progress=False) as simulator, pm.Model() as external:
        pmf.ExpFeature("y", simulator(pm.Uniform("k", 0.5, 1.5)), 1.0, observed=DATA)
    with pytest.raises(ValueError, match="`executor` must be left out for a model with an ExternalSimulator"):
        pmf.sample_smc(100, **settings | {"model": external})
    build, record = CASES["chain"]
    with pm.Model() as noisy:
        mu = pmf.response(build(pm.Normal("x", 1.0, 0.3, shape=2)), record)
        pmf.DiscrepancySimulator("y", mu, epsilon=30.0, observed=measured("chain"), noise=0.1)
    with pytest.raises(ValueError, match="`executor` must be left out for a model with random draws inside"):
        pmf.sample_smc(100, pmf.SubsetSimulation, **settings | {"model": noisy})
