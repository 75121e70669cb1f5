"""External simulators on a Dask cluster of two workers on this machine."""

import logging
import os
import signal

import numpy as np
import pymc as pm
import pytensor
import pytest

from pymc_features import ExternalSimulator, TruncNormalFeature, sample_smc
from pymc_features.sampling import PopulationIMH
from support import external_functions as functions
from support.external_functions import DATA, SHAPE, Counted, beam, lives, wait_until
from support.sampling import QUIET

distributed = pytest.importorskip("distributed")

START_SECONDS = 60.0  # of a worker, on a busy machine
pytestmark = pytest.mark.processes


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Two workers with a thread each."""
    with distributed.LocalCluster(
        processes=True,
        n_workers=2,
        threads_per_worker=1,
        dashboard_address=":0",
        silence_logs=logging.CRITICAL,
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as cluster:
        yield cluster


@pytest.fixture
def client(cluster):
    """Of the test's own; both workers are there."""
    with distributed.Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=START_SECONDS)
        yield client


def on(executor, function=beam, **settings):
    """A simulator there."""
    return ExternalSimulator(function, SHAPE, executor=executor, progress=False, **settings)


def test_the_same_particles_as_here(cluster, tmp_path):
    draws = []
    for executor in (1, cluster.scheduler_address):
        with on(executor, Counted(tmp_path / "calls")) as simulator, pm.Model():
            k, sigma = pm.Uniform("k", 0.3, 1.5), pm.HalfNormal("sigma", 1.0)
            TruncNormalFeature("y", simulator(k), sigma, observed=DATA)
            with pytensor.config.change_flags(mode="FAST_COMPILE"):
                idata = sample_smc(30, PopulationIMH, chains=1, random_seed=1, **QUIET)
            draws.append(idata.posterior["k"].values)
            assert idata.sample_stats["failed"].sum() == 0
    half = len(Counted(tmp_path / "calls").calls()) // 2
    calls = [k for _, k in Counted(tmp_path / "calls").calls()]
    assert sorted(calls[:half]) == sorted(calls[half:])
    np.testing.assert_array_equal(draws[0], draws[1])


def test_a_killed_worker_costs_only_its_own_calls(client, tmp_path):
    simulator = on(client, Counted(tmp_path / "calls", seconds=0.05), cache=tmp_path / "cache.sqlite")
    victim = next(iter(client.run(os.getpid).values()))
    k = np.linspace(1.0, 2.0, 60)
    ticks = []

    def kill_when_half_done():
        if simulator.counts["ok"] > 20 and not ticks:
            ticks.append(1)
            os.kill(victim, signal.SIGKILL)

    simulator.evaluator.lines.tick = kill_when_half_done
    np.testing.assert_array_equal(simulator.responses(k), [beam(x) for x in k])
    assert ticks and simulator.counts == {**dict.fromkeys(simulator.counts, 0), "ok": 60}
    ran = [x for _, x in simulator.function.calls()]
    assert set(ran) == set(k) and len(ran) <= 60 + 8
    simulator.close()
    assert client.status == "running"  # it is not ours


def test_stopping_kills_what_runs_there(client, tmp_path):
    path = tmp_path / "pids"
    simulator = on(client, functions.Hanging(path))

    def stop_when_running():
        if path.exists() and len(path.read_text().splitlines()) == 2:
            raise KeyboardInterrupt

    simulator.evaluator.lines.tick = stop_when_running
    with pytest.raises(KeyboardInterrupt):
        simulator.responses(np.arange(1.0, 9.0))
    wait_until(lambda: not any(map(lives, path.read_text().split())))
    assert len(path.read_text().splitlines()) == 2
