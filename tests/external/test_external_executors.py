"""External simulators on a Dask cluster of two workers on this machine."""

import logging
import os
import signal

import numpy as np
import pymc as pm
import pytensor
import pytest

from pymc_features import ExternalSimulator, PopulationIMH, TruncNormalFeature, sample_smc
from pymc_features.exceptions import NoWorkersError
from support import external_functions as functions
from support.external_functions import DATA, SHAPE, Counted, Timed, beam, lives, wait_until
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


def test_two_workers_run_at_the_same_time(cluster, client, tmp_path):
    """Where either may, calls of both overlap; where only one may (the negative control), none do."""
    first, _ = client.scheduler_info(n_workers=-1)["workers"]
    shares = []
    with client.get_executor(workers=[first], pure=False) as one:
        for executor in (one, cluster.scheduler_address):
            function = Timed(tmp_path / f"calls{len(shares)}", seconds=0.1)
            with on(executor, function) as simulator:
                simulator.responses(np.linspace(1.0, 2.0, 16))
            calls = function.calls()
            processes = {pid for pid, _, _ in calls}
            together = sum(
                any(a < other_b and other_a < b for other, other_a, other_b in calls if other != pid)
                for pid, a, b in calls
            )
            shares.append((len(calls), len(processes), together / len(calls)))
    assert shares[0] == (16, 1, 0.0)
    assert shares[1][:2] == (16, 2) and shares[1][2] > 0.5


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


def test_nothing_is_left_on_the_workers(client, tmp_path):
    simulator = on(client, Counted(tmp_path / "calls"))
    simulator.responses(np.arange(1.0, 9.0))
    pids = {pid for pid, _ in simulator.function.calls()}
    assert pids and all(map(lives, pids))
    simulator.close()
    assert not any(map(lives, pids))


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


def test_the_function_is_sent_once(client, monkeypatch):
    """With its data, and not along with each call."""
    big, sent, submit = np.arange(20_000.0), [], client.submit

    def heavy(k):
        return beam(k) + big[-1]

    def spy(function, *arguments, **settings):
        sent.append(sum(len(a) for a in arguments if isinstance(a, bytes)))
        return submit(function, *arguments, **settings)

    monkeypatch.setattr(client, "submit", spy)
    with on(client, heavy) as simulator:
        expected = [beam(x) + big[-1] for x in (1.0, 2.0, 3.0)]
        np.testing.assert_array_equal(simulator.responses(np.arange(1.0, 4.0)), expected)
    assert len(sent) == 4 and sent[0] > 8 * 20_000 and sum(sent[1:]) == 0


def test_a_client_that_is_closed(client):
    simulator = on(client)
    simulator.responses(np.ones(1))
    client.close()
    with pytest.raises(NoWorkersError, match="`executor` must run simulations, got .* is closed"):
        simulator.responses(np.array([2.0]))
