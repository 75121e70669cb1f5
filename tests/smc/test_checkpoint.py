"""Samplers that are killed and go on: the same particles, nothing evaluated twice, wrong journals refused."""

import json
import multiprocessing
import os
import signal
import struct
import time
from pathlib import Path

import numpy as np
import pymc as pm
import pytest

from pymc_features import (
    DiscrepancySimulator,
    ExternalSimulator,
    PersistentSMC,
    PopulationIMH,
    PopulationMH,
    SubsetSimulation,
    TruncNormalFeature,
    sample_smc,
)
from pymc_features.exceptions import CheckpointError
from pymc_features.smc import KERNELS
from pymc_features.smc.kernels.checkpoint import MAGIC, Checkpoint, Journal
from support.external_functions import DATA, SHAPE, Counted, beam, note
from support.sampling import QUIET

DRAWS = 80


class Interrupted(BaseException):
    """Stops a run, as Ctrl-C does."""


class InProcess:
    """Twice the parameters, as a function of this process: writes down its calls, and stops after some."""

    def __init__(self, path=None):
        self.path, self.left, self.seconds = path, np.inf, 0.0

    def __call__(self, x):
        self.left -= 1
        if self.left < 0:
            raise Interrupted
        if self.path is not None:
            note(self.path, " ".join(map(repr, x.tolist())))
        time.sleep(self.seconds)
        return np.outer(x, [1.0, 2.0])


def model_of(function, epsilon=0.3, data=None):
    """Two parameters known from a simulator."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        observed = np.outer([0.5, -0.5], [1.0, 2.0]) if data is None else data
        DiscrepancySimulator("y", function, x, epsilon=epsilon, observed=observed, kernel="exponential")
    return model


def sample(model, kernel=PersistentSMC, **settings):
    """Particles (chain, draw, 2), and the result."""
    defaults = {"chains": 2, "cores": 1, "random_seed": 5, "draws": DRAWS}
    with model:
        idata = sample_smc(kernel=kernel, **{**defaults, **settings}, **QUIET)
    return idata.posterior["x"].values, idata


def particles_in(folder) -> list[list[tuple]]:
    """Rows of the complete records of all journals: a reader of its own."""
    batches = []
    for path in sorted(Path(folder).glob("*.journal")):
        content = path.read_bytes()[len(MAGIC) :]
        while len(content) >= 20:
            n, d, _ = struct.unpack("<QQI", content[:20])
            if len(content) < 20 + 8 * n * (d + 3):
                break
            rows = np.frombuffer(content[20 : 20 + 8 * n * d]).reshape(n, d)
            batches.append([tuple(row) for row in rows])
            content = content[20 + 8 * n * (d + 3) :]
    return batches


def calls_in(path) -> list[tuple]:
    """Parameters in the order of the calls."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [tuple(map(float, line.split())) for line in lines]


def size_of(folder) -> int:
    """Bytes in all journals."""
    return sum(path.stat().st_size for path in Path(folder).glob("*.journal"))


def kill_at(size, folder, function, *arguments):
    """Run a function in a forked process until the journals have a size; whether it had to be killed."""
    process = multiprocessing.get_context("fork").Process(target=function, args=arguments)
    process.start()
    while process.is_alive() and size_of(folder) < size:
        time.sleep(0.0002)
    process.kill()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.mark.processes
def test_killed_ten_times(tmp_path):
    function = InProcess()
    model = model_of(function)
    settings = {"kernel": PopulationIMH}  # all batches are equally large
    expected, _ = sample(model, checkpoint=tmp_path / "whole", **settings)  # also compiles, for the forked
    whole, most = size_of(tmp_path / "whole"), max(map(len, particles_in(tmp_path / "whole")))
    folder, function.path, function.seconds = tmp_path / "killed", tmp_path / "calls", 5e-4
    sizes = np.sort(np.random.default_rng(7).uniform(0, 0.85 * whole, 10))
    kills = known = 0
    finished = set()
    for size in sizes:
        kills += kill_at(size, folder, resume, model, folder, settings)
        calls = calls_in(function.path)
        assert finished.isdisjoint(calls[known:]), "evaluated again"
        known, finished = len(calls), {row for batch in particles_in(folder) for row in batch}
        assert len(set(calls) - finished) <= most, "more is lost than the batch in work"
    assert kills == 10
    draws, _ = sample(model, checkpoint=folder, **settings)
    np.testing.assert_array_equal(draws, expected)
    assert finished.isdisjoint(calls_in(function.path)[known:])
    assert size_of(folder) == whole
    assert {row for batch in particles_in(folder) for row in batch} == set(calls_in(function.path))
    assert len(calls_in(function.path)) <= len(set(calls_in(function.path))) + 10 * most


def resume(model, folder, settings):
    """What a killed process was doing."""
    sample(model, checkpoint=folder, **settings)


class Held(Counted):
    """Holds on where the file beside that of the calls allows no more: a process is killed before it ends."""

    def __call__(self, k):
        while len(self.calls()) >= int(Path(f"{self.path}-allowed").read_text()):
            time.sleep(0.005)
        return super().__call__(k)


@pytest.mark.processes
def test_killed_with_an_external_simulator_and_a_cache(tmp_path):
    """Not even the evaluations of the batch in work are lost."""

    def model_with(simulator):
        with pm.Model() as model:
            k, sigma = pm.Uniform("x", 0.3, 1.5, shape=1), pm.HalfNormal("sigma", 1.0)
            TruncNormalFeature("y", simulator(k[0]), sigma, observed=DATA)
        return model

    settings = {"chains": 1, "kernel": PopulationIMH}
    function, folder = Held(tmp_path / "calls", seconds=0.001), tmp_path / "checkpoint"
    allowed = tmp_path / "calls-allowed"
    with ExternalSimulator(
        function, SHAPE, executor=1, cache=tmp_path / "cache.sqlite", progress=False
    ) as simulator:
        model = model_with(simulator)

        def run():
            sample(model, checkpoint=folder, **settings)

        allowed.write_text("80")
        process = multiprocessing.get_context("fork").Process(target=run)
        process.start()
        while process.is_alive() and len(function.calls()) < 60:
            time.sleep(0.001)
        process.kill()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        allowed.write_text("1000000")
        draws, idata = sample(model, checkpoint=folder, **settings)
        expected, _ = sample(model, **settings)  # of calls that are all in the cache
    np.testing.assert_array_equal(draws, expected)
    calls = [k for _, k in function.calls()]
    assert len(calls) <= len(set(calls)) + 2  # one in work and one to be written
    assert len(set(calls)) == idata.sample_stats["evaluations"].sum()


@pytest.mark.slow
@pytest.mark.parametrize("kernel", [*KERNELS, SubsetSimulation], ids=lambda kernel: kernel.__name__)
def test_every_kernel_goes_on(kernel, tmp_path):
    function = InProcess(tmp_path / "calls")
    model = model_of(function)
    settings = {"kernel": kernel, "draws": 60}
    if kernel is SubsetSimulation:
        settings["stage_draws"] = 60
    expected, whole = sample(model, **settings)
    n = len(calls_in(function.path))
    for left in (n // 5, n // 4, n // 3):
        function.left = left
        with pytest.raises(Interrupted):
            sample(model, checkpoint=tmp_path / "folder", **settings)
    function.left = np.inf
    before, finished = len(calls_in(function.path)), particles_in(tmp_path / "folder")
    draws, idata = sample(model, checkpoint=tmp_path / "folder", **settings)
    np.testing.assert_array_equal(draws, expected)
    for name in set(whole.sample_stats) - {"seconds"}:
        np.testing.assert_array_equal(idata.sample_stats[name], whole.sample_stats[name], err_msg=name)
    after = calls_in(function.path)[before:]
    assert finished and after and {row for batch in finished for row in batch}.isdisjoint(after)
    before = len(calls_in(function.path))
    draws, _ = sample(model, checkpoint=tmp_path / "folder", **settings)  # all is known
    np.testing.assert_array_equal(draws, expected)
    assert len(calls_in(function.path)) == before


@pytest.mark.processes
def test_a_dead_chain_process_is_named(tmp_path):
    main = os.getpid()

    def deadly(x):
        if os.getpid() != main:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.outer(x, [1.0, 2.0])

    with pytest.raises(RuntimeError, match="a process that sampled a chain died: killed, or out of memory"):
        sample(model_of(deadly), cores=2, mp_ctx="fork")


# --- what is remembered


# --- what is refused


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A model, and the folder of a run of it."""
    folder = tmp_path_factory.mktemp("checkpoint") / "run"
    model = model_of(InProcess())
    draws, _ = sample(model, checkpoint=folder, chains=1)
    return model, folder, draws


@pytest.fixture
def copied(finished, tmp_path):
    """The same, to be damaged."""
    model, folder, draws = finished
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    [journal] = tmp_path.glob("*.journal")
    return model, tmp_path, journal, draws


FOREIGN = {
    "random_seed=.5., chains=1": {"random_seed": 6},
    "chains=1": {"chains": 2},
    "of one with other: .*draws": {"draws": DRAWS + 1},
    "of one with other: .*kernel": {"kernel": PopulationMH},
    "of one with other: stage_draws": {"stage_draws": 240},
    "of one with other: threshold": {"threshold": 0.4},
}


@pytest.mark.parametrize("message", FOREIGN)
def test_other_settings_are_refused(message, finished):
    model, folder, _ = finished
    with pytest.raises(CheckpointError, match=f"`checkpoint` must be of this run.*{message}.*Choose another"):
        sample(model, checkpoint=folder, **{"chains": 1, **FOREIGN[message]})


@pytest.mark.parametrize("changed", ["data", "epsilon", "prior", "potential"])
def test_other_models_are_refused(changed, finished):
    _, folder, _ = finished
    data = np.outer([0.5, -0.4], [1.0, 2.0]) if changed == "data" else None
    model = model_of(InProcess(), 0.4 if changed == "epsilon" else 0.3, data)
    if changed == "prior":
        with pm.Model() as model:
            x = pm.Normal("x", 0.0, 1.5, shape=2)
            observed = np.outer([0.5, -0.5], [1.0, 2.0])
            DiscrepancySimulator("y", InProcess(), x, epsilon=0.3, observed=observed, kernel="exponential")
    elif changed == "potential":
        with model:
            pm.Potential("more", -model["x"].sum())
    with pytest.raises(CheckpointError, match="of one with other: model"):
        sample(model, checkpoint=folder, chains=1)


def test_new_data_in_a_model_are_refused(tmp_path):
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        data = pm.Data("data", np.array([0.5, -0.5]))
        pm.Normal("y", x, 0.1, observed=data)
    sample(model, PopulationIMH, checkpoint=tmp_path)
    with model:
        pm.set_data({"data": np.array([0.5, -0.4])})
    with pytest.raises(CheckpointError, match="of one with other: model"):
        sample(model, PopulationIMH, checkpoint=tmp_path)


def test_another_external_simulator_is_refused(tmp_path):
    """What it does is part of the model."""

    def other(k):
        return 1.01 * beam(k)

    for function in (beam, other):
        with ExternalSimulator(function, SHAPE, executor=1, progress=False) as simulator:
            with pm.Model() as model:
                k = pm.Uniform("x", 0.5, 1.5, shape=1)
                TruncNormalFeature("y", simulator(k[0]), 0.5, observed=DATA)
            if function is beam:
                sample(model, PopulationIMH, checkpoint=tmp_path, chains=1, draws=20)
            else:
                with pytest.raises(CheckpointError, match="of one with other: model"):
                    sample(model, PopulationIMH, checkpoint=tmp_path, chains=1, draws=20)


HEAD = len(MAGIC)


def test_any_flipped_byte_is_noticed_or_harmless(copied):
    """A journal by itself, wherever it is damaged: an error, or the record is computed anew."""
    _, folder, _, _ = copied
    particles = np.arange(6.0).reshape(3, 2)

    def results(p):
        return p.sum(axis=1), p.prod(axis=1), np.zeros(len(p), dtype=bool)

    path = folder / "one"
    journal = Journal(path)
    for shift in (0.0, 1.0):
        journal.evaluate(results, particles + shift)
    journal.close()
    content = path.read_bytes()
    for i in range(len(content)):
        path.write_bytes(content[:i] + bytes([content[i] ^ 0xFF]) + content[i + 1 :])
        journal = None
        with pytest.raises(CheckpointError):
            try:
                journal = Journal(path)
                for shift in (0.0, 1.0):
                    journal.evaluate(results, particles + shift)
            finally:
                if journal is not None:
                    journal.close()


@pytest.mark.parametrize("cut", [1, 19, 21, 300, 0.5, "magic", "all"])
def test_a_tail_that_is_missing_is_computed_again(cut, copied):
    model, folder, journal, expected = copied
    content = journal.read_bytes()
    if cut == "magic":
        content = content[: HEAD - 3]
    elif cut == "all":
        content = b""
    else:
        content = content[: -cut if isinstance(cut, int) else int(cut * len(content))]
    whole = journal.read_bytes()
    journal.write_bytes(content)
    draws, _ = sample(model, checkpoint=folder, chains=1)
    np.testing.assert_array_equal(draws, expected)
    assert journal.read_bytes() == whole


def test_damaged_descriptions(copied):
    model, folder, _, _ = copied
    for name in ("seed.json", "run.json"):
        before = (folder / name).read_text()
        (folder / name).write_text(before[:-5])
        with pytest.raises(CheckpointError, match=f"`checkpoint` must be intact, got .*{name}"):
            sample(model, checkpoint=folder, chains=1)
        (folder / name).write_text(before)
    (folder / "run.json").unlink()
    with pytest.raises(CheckpointError, match="`checkpoint` must have a run.json, got none"):
        sample(model, checkpoint=folder, chains=1)


def hold(folder, ready, end):
    """Keep a journal in use."""
    rng = np.random.default_rng(1)
    journal = Checkpoint(folder, "model").journal({}, rng)
    ready.set()
    end.wait(60)
    journal.close()


@pytest.mark.processes
def test_a_checkpoint_in_use(tmp_path):
    context = multiprocessing.get_context("fork")
    ready, end = context.Event(), context.Event()
    process = context.Process(target=hold, args=(tmp_path, ready, end))
    process.start()
    assert ready.wait(60)
    with pytest.raises(CheckpointError, match="`checkpoint` must belong to one run at a time, got .* in use"):
        Checkpoint(tmp_path, "model").journal({}, np.random.default_rng(1))
    Checkpoint(tmp_path, "model").journal({}, np.random.default_rng(2)).close()  # of another chain
    end.set()
    process.join()
    Checkpoint(tmp_path, "model").journal({}, np.random.default_rng(1)).close()


def test_models_and_kernels_that_cannot_go_on(tmp_path):
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        DiscrepancySimulator(
            "y", InProcess(), x, epsilon=0.3, observed=np.ones((2, 2)), noise=0.1, kernel="exponential"
        )
    with pytest.raises(ValueError, match="`checkpoint` must be left out for a model with random draws"):
        sample(model, checkpoint=tmp_path)
    with pytest.raises(TypeError, match="`checkpoint` must be left out for MH, which has none"):
        sample(model, pm.smc.MH, checkpoint=tmp_path)


def test_the_seed_is_remembered(tmp_path):
    model = model_of(InProcess())
    first, _ = sample(model, random_seed=None, checkpoint=tmp_path, chains=2)
    again, _ = sample(model, random_seed=None, checkpoint=tmp_path, chains=None)
    np.testing.assert_array_equal(first, again)
    known = json.loads((tmp_path / "seed.json").read_text())
    explicit, _ = sample(model, random_seed=known["random_seed"][0], chains=2)
    np.testing.assert_array_equal(first, explicit)
