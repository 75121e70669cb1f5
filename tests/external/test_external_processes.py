"""Processes of external simulators: failures, kills, interrupts, scratch folders, progress."""

import multiprocessing
import os
import pickle
import signal
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pymc as pm
import pytest

from pymc_features import ExternalSimulator, sample_smc
from pymc_features.exceptions import NoWorkersError, UnusableSimulatorError
from pymc_features.external.cache import EvaluationCache
from pymc_features.external.evaluator import Lines
from pymc_features.external.workers import calls
from pymc_features.sampling import PopulationIMH
from support import external_functions as functions
from support.external_functions import DATA, SECONDS, SHAPE, Counted, Hanging, beam, lives, wait_until
from support.external_models import BrokenElsewhere
from support.sampling import QUIET

pytestmark = pytest.mark.processes


def test_ways_to_fail(simulator):
    s = simulator(functions.ways_to_fail, executor=2, timeout=1.0)
    k = np.array([*range(1, 9), 1.5, np.nan, np.inf])
    results = s.responses(k)
    assert np.isfinite(results[8]).all() and np.isnan(np.delete(results, 8, axis=0)).all()
    failures = {
        f.parameters[0]: (f.state, f.message) for f in s.failures if f.parameters[0] == f.parameters[0]
    }
    assert failures[1.0] == ("error", "ZeroDivisionError: first line")
    assert failures[2.0] == ("error", "the result is not finite")
    assert "must return an array of shape (2, 5), got (2, 4)" in failures[3.0][1]
    assert "must return real numbers, got complex ones" in failures[4.0][1]
    assert failures[5.0] == ("error", "SystemExit: no licence")
    assert failures[6.0] == ("died", "the process ended with exit code 3: last words")
    assert failures[7.0] == ("died", "the process ended with signal 9")
    assert failures[8.0] == ("timeout", "no result after 1 s")
    assert failures[np.inf] == ("invalid", "the parameters are not finite")
    assert s.counts == {"ok": 1, "error": 5, "timeout": 1, "died": 2, "invalid": 2, "cached": 0}


def test_retries(simulator, tmp_path):
    k = np.arange(1.0, 4.0)
    for n in (1, 2):
        (tmp_path / f"{n}").mkdir()
        s = simulator(functions.FailsAtFirst(tmp_path / f"{n}", n), retries=1)
        assert np.isnan(s.responses(k)).all() == (n == 2)
        assert s.counts["error"] == (3 if n == 2 else 0)
    (tmp_path / "died").mkdir()
    s = simulator(functions.FailsAtFirst(tmp_path / "died", 1, died=True))  # once more in any case
    np.testing.assert_array_equal(s.responses(k[:1])[0], beam(1.0))
    assert s.counts["died"] == 0


def test_a_function_that_cannot_be_loaded(simulator):
    s = simulator(BrokenElsewhere())
    with pytest.raises(UnusableSimulatorError, match="must be loadable in another process.*ImportError"):
        s.responses(np.ones(1))
    s = simulator(DiesWhenLoaded())
    with pytest.raises(UnusableSimulatorError, match="must be loadable.*exit code 4"):
        s.responses(np.ones(1))
    error = pickle.loads(pickle.dumps(UnusableSimulatorError("nothing")))  # as it comes from a cluster
    assert str(error).count("must be loadable") == 1


class DiesWhenLoaded(BrokenElsewhere):
    """Ends its process while it is unpickled."""

    def __reduce__(self):
        return os._exit, (4,)


def test_posterior_with_failures(tmp_path):
    """10 % raise and 5 % hang, by lot: the rest is the conjugate posterior, and the counts are right."""
    sigma, cache = 8.0, tmp_path / "cache.sqlite"
    basis = functions.beam(1.0)
    with ExternalSimulator(
        functions.troubled_line, SHAPE, executor=4, timeout=0.5, cache=cache, progress=False
    ) as s:
        with pm.Model():
            a = pm.Normal("a", 0.0, 1.0)
            pm.Normal("y", s(a), sigma, observed=basis)
            idata = sample_smc(100, PopulationIMH, chains=1, random_seed=3, **QUIET)
        counts, kept = s.counts, EvaluationCache(cache)
    failed = {float(f["parameters"][0]): f["state"] for f in kept.failures()}
    for a, state in failed.items():
        assert state == ("error" if functions.lot(a) < 0.1 else "timeout") and functions.lot(a) < 0.15
    run = np.frombuffer(b"".join(row[0] for row in kept.execute("SELECT parameters FROM results")))
    assert (np.array([functions.lot(a) for a in run]) >= 0.15).all()
    assert len(run) == counts["ok"] and len(failed) == counts["error"] + counts["timeout"]
    assert idata.sample_stats["failed"].sum() == len(failed) > 20 and counts["timeout"] > 5
    precision = 1.0 + np.sum(basis**2) / sigma**2
    mean, sd = np.sum(basis**2) / sigma**2 / precision, precision**-0.5
    draws = idata.posterior["a"].values.ravel()
    assert abs(draws.mean() - mean) < 4.5 * sd / np.sqrt(100)
    assert 0.7 < draws.std() / sd < 1.4
    assert not set(draws) & set(failed)


def test_any_executor(simulator):
    k = np.arange(1.0, 4.0)
    expected = [beam(x) for x in k]
    big = np.zeros(20_000)  # more than travels with every call

    def loaded(x):
        return beam(x) + big[0]

    with ThreadPoolExecutor(2) as pool:
        np.testing.assert_array_equal(simulator(executor=pool).responses(k), expected)
        np.testing.assert_array_equal(simulator(loaded, executor=pool).responses(k), expected)
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        s = simulator(loaded, executor=pool)
        np.testing.assert_array_equal(s.responses(k), expected)
        np.testing.assert_array_equal(s.discrepancies(k, observed=DATA).shape, (3, 2))
    with pytest.raises(NoWorkersError, match="`executor` must run simulations.*after shutdown"):
        s.responses(k + 1.0)


def test_processes_are_used_again_and_ended(simulator, tmp_path):
    s = simulator(Counted(tmp_path / "calls"), executor=2)
    s.responses(np.arange(1.0, 9.0))
    s.responses(np.arange(11.0, 19.0))
    pids = {pid for pid, _ in s.function.calls()}
    assert len(pids) <= 2 and all(map(lives, pids))
    s.close()
    assert not any(map(lives, pids))
    assert not {*s.evaluator._digests} & {*calls._IDLE, *calls._BUSY, *calls._PAYLOADS}
    s.responses(np.ones(1))  # starts again
    assert s.function.calls()[-1][0] not in pids
    twin = simulator(s.function)
    twin.responses(np.ones(1))
    s.close()
    assert lives(s.function.calls()[-1][0])  # not its own


def run_forked(function, *arguments):
    """A forked process that runs a function, and the function's end of the matter."""
    process = multiprocessing.get_context("fork").Process(target=function, args=arguments, daemon=True)
    process.start()
    return process


def hang(path, n):
    """Simulations that do not end."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs in the background may ignore it
    with ExternalSimulator(Hanging(path), SHAPE, executor=n, progress=False) as s:
        s.responses(np.arange(1.0, 9.0))


def pids_in(path):
    """All numbers in a file."""
    return [int(word) for word in path.read_text().split()] if path.exists() else []


@pytest.mark.parametrize("way", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill"])
def test_a_run_that_is_stopped_leaves_no_orphans(way, tmp_path):
    path = tmp_path / "pids"
    process = run_forked(hang, path, 2)
    wait_until(lambda: len(pids_in(path)) == 4)
    assert all(map(lives, pids_in(path)))
    os.kill(process.pid, way)
    process.join(SECONDS)
    assert process.exitcode not in (None, 0)
    wait_until(lambda: not any(map(lives, pids_in(path))))
    assert len(pids_in(path)) == 4  # nothing was begun after


def test_scratch_folders(simulator, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    for scratch, inside in ((True, tmp_path / "temporary"), (tmp_path / "scratch", tmp_path / "scratch")):
        s = simulator(functions.curious, scratch=scratch)
        results = s.responses(np.arange(1.0, 4.0))
        assert (results[:, 0, 0] == 0.0).all() and (results[:, 0, 1] == 1.0).all()
        [own] = inside.iterdir()
        assert list(own.iterdir()) == []
        s.close()
        assert list(inside.iterdir()) == []


def test_progress_lines(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    lines = Lines(True)
    lines.begin(100)
    for i in range(40):
        now[0] += 0.5
        lines.count(i % 4 != 0)
        lines.tick()
    now[0] += 1000.0  # between batches
    lines.begin(3700)
    now[0] += 20.0
    for _ in range(50):
        lines.count(True)
    lines.tick()
    assert capsys.readouterr().err.splitlines() == [
        "simulations: 10 done, 3 failed, 2/s; of this batch 10 of 100, 0:45 left",
        "simulations: 30 done, 8 failed, 2/s; of this batch 30 of 100, 0:35 left",
        "simulations: 90 done, 10 failed, 2.25/s; of this batch 50 of 3700, 24:20 left",
    ]
    silent = Lines(False)
    silent.begin(1)
    silent.tick()
    assert capsys.readouterr().err == ""
