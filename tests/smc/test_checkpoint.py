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

import pymc_features as pmf
from pymc_features.exceptions import CheckpointError
from pymc_features.smc import KERNELS
from pymc_features.smc.kernels.checkpoint import MAGIC, Journal, chain_journal, read_json, remembered
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


def model_of(function, epsilon=0.3):
    """Two parameters known from a simulator."""
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        observed = np.outer([0.5, -0.5], [1.0, 2.0])
        pmf.DiscrepancySimulator("y", function, x, epsilon=epsilon, observed=observed, kernel="exponential")
    return model


def sample(model, kernel=pmf.PersistentSMC, **settings):
    """Particles (chain, draw, 2), and the result."""
    defaults = {"chains": 2, "cores": 1, "random_seed": 5, "draws": DRAWS}
    with model:
        idata = pmf.sample_smc(kernel=kernel, **{**defaults, **settings}, **QUIET)
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


def killed_when(condition, model, folder, settings, every=0.0002):
    """Go on with a run in a forked process until then; whether it had to be killed."""
    settings = settings | {"checkpoint": folder}
    process = multiprocessing.get_context("fork").Process(target=sample, args=(model,), kwargs=settings)
    process.start()
    while process.is_alive() and not condition():
        time.sleep(every)
    process.kill()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.mark.processes
def test_killed_five_times(tmp_path):
    function = InProcess()
    model = model_of(function)
    settings = {"kernel": pmf.sampling.PopulationIMH}  # all batches are equally large
    expected, _ = sample(model, checkpoint=tmp_path / "whole", **settings)  # also compiles, for the forked
    whole, most = size_of(tmp_path / "whole"), max(map(len, particles_in(tmp_path / "whole")))
    folder, function.path, function.seconds = tmp_path / "killed", tmp_path / "calls", 5e-4
    sizes = np.sort(np.random.default_rng(7).uniform(0, 0.85 * whole, 5))
    kills = known = 0
    finished = set()
    for size in sizes:
        kills += killed_when(lambda size=size: size_of(folder) >= size, model, folder, settings)
        calls = calls_in(function.path)
        assert finished.isdisjoint(calls[known:]), "evaluated again"
        known, finished = len(calls), {row for batch in particles_in(folder) for row in batch}
        assert len(set(calls) - finished) <= most, "more is lost than the batch in work"
    assert kills == 5
    draws, _ = sample(model, checkpoint=folder, **settings)
    np.testing.assert_array_equal(draws, expected)
    assert finished.isdisjoint(calls_in(function.path)[known:])
    assert size_of(folder) == whole
    assert {row for batch in particles_in(folder) for row in batch} == set(calls_in(function.path))
    assert len(calls_in(function.path)) <= len(set(calls_in(function.path))) + 5 * most


@pytest.mark.processes
def test_killed_with_an_external_simulator_and_a_cache(tmp_path):
    """Not even the evaluations of the batch in work are lost."""

    class Held(Counted):
        """Holds on where the file beside that of the calls allows no more, until its process is killed."""

        def __call__(self, k):
            while len(self.calls()) >= int(Path(f"{self.path}-allowed").read_text()):
                time.sleep(0.02)
            return super().__call__(k)

    settings = {"chains": 1, "kernel": pmf.sampling.PopulationIMH}
    function, folder = Held(tmp_path / "calls", seconds=0.001), tmp_path / "checkpoint"
    allowed = tmp_path / "calls-allowed"
    cached = {"executor": 1, "cache": tmp_path / "cache.sqlite", "progress": False}
    with pmf.ExternalSimulator(function, SHAPE, **cached) as simulator:
        with pm.Model() as model:
            k, sigma = pm.Uniform("x", 0.3, 1.5, shape=1), pm.HalfNormal("sigma", 1.0)
            pmf.TruncNormalFeature("y", simulator(k[0]), sigma, observed=DATA)
        allowed.write_text("80")
        assert killed_when(lambda: len(function.calls()) >= 60, model, folder, settings, every=0.02)
        allowed.write_text("1000000")
        draws, idata = sample(model, checkpoint=folder, **settings)
        expected, _ = sample(model, **settings)  # of calls that are all in the cache
    np.testing.assert_array_equal(draws, expected)
    calls = [k for _, k in function.calls()]
    assert len(calls) <= len(set(calls)) + 2  # one in work and one to be written
    assert len(set(calls)) == idata.sample_stats["evaluations"].sum()


@pytest.mark.slow
@pytest.mark.parametrize("kernel", [*KERNELS, pmf.SubsetSimulation], ids=lambda kernel: kernel.__name__)
def test_every_kernel_goes_on(kernel, tmp_path):
    function = InProcess(tmp_path / "calls")
    model = model_of(function)
    settings = {"kernel": kernel, "draws": 60}
    if kernel is pmf.SubsetSimulation:
        settings["stage_draws"] = 60
    expected, whole = sample(model, **settings)
    n = len(calls_in(function.path))
    for left in (n // 4, n // 3):
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


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A model, and the folder of a run of it."""
    folder = tmp_path_factory.mktemp("checkpoint") / "run"
    model = model_of(InProcess())
    draws, _ = sample(model, checkpoint=folder, chains=1)
    return model, folder, draws


def written(folder, files):
    """A folder with these files {name: bytes}."""
    folder.mkdir(exist_ok=True)
    for name, raw in files.items():
        (folder / name).write_bytes(raw)
    return folder


def contents(folder):
    """The files {name: bytes} of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}


FOREIGN = {
    "random_seed=.5., chains=1": {"random_seed": 6},
    "chains=1": {"chains": 2},
    "of one with other: .*draws": {"draws": DRAWS + 1},
    "of one with other: .*kernel": {"kernel": pmf.sampling.PopulationMH},
    "of one with other: stage_draws": {"stage_draws": 240},
    "of one with other: threshold": {"threshold": 0.4},
}


@pytest.mark.parametrize("message", FOREIGN)
def test_other_settings_are_refused(message, finished):
    model, folder, _ = finished
    with pytest.raises(CheckpointError, match=f"`checkpoint` must be of this run.*{message}.*Choose another"):
        sample(model, checkpoint=folder, **{"chains": 1, **FOREIGN[message]})


def test_other_models_are_refused(finished):
    _, folder, _ = finished
    model = model_of(InProcess())
    with model:
        pm.Potential("more", -model["x"].sum())
    for other in (model_of(InProcess(), epsilon=0.4), model):
        with pytest.raises(CheckpointError, match="of one with other: model"):
            sample(other, checkpoint=folder, chains=1)


@pytest.mark.slow
def test_new_data_in_a_model_are_refused(tmp_path):
    """And the search for modes with the former ones, though nothing but that was done."""
    with pm.Model() as model:
        pm.Normal("y", pm.Normal("x", shape=2), 0.1, observed=pm.Data("data", np.array([0.5, -0.5])))
    run = {"model": model, "chains": 1, "cores": 1, "random_seed": 5, "check": None, "progressbar": False}
    pmf.sample(60, checkpoint=tmp_path / "whole", **run)
    files = {name: (tmp_path / "whole" / name).read_bytes() for name in ("modes.record", "seed.json")}
    pmf.sample(60, checkpoint=written(tmp_path / "stopped", files), **run)
    with model:
        pm.set_data({"data": np.array([0.5, -0.4])})
    (tmp_path / "whole" / "modes.record").unlink()
    with pytest.raises(CheckpointError, match="of one with other: model"):
        pmf.sample(60, checkpoint=tmp_path / "whole", **run)
    match = "got a wrong sum in .*modes.record: it is damaged, or of another"
    with pytest.raises(CheckpointError, match=match):
        pmf.sample(60, checkpoint=written(tmp_path / "other", files), **run)


def test_another_external_simulator_is_refused(tmp_path):
    """What it does is part of the model."""

    def other(k):
        return 1.01 * beam(k)

    for function in (beam, other):
        with pmf.ExternalSimulator(function, SHAPE, executor=1, progress=False) as simulator:
            with pm.Model() as model:
                k = pm.Uniform("x", 0.5, 1.5, shape=1)
                pmf.TruncNormalFeature("y", simulator(k[0]), 0.5, observed=DATA)
            if function is beam:
                sample(model, pmf.sampling.PopulationIMH, checkpoint=tmp_path, chains=1, draws=20)
            else:
                with pytest.raises(CheckpointError, match="of one with other: model"):
                    sample(model, pmf.sampling.PopulationIMH, checkpoint=tmp_path, chains=1, draws=20)


def recorded(path):
    """Sums of two batches of particles, from a journal where it has them."""
    journal, particles = Journal(path), np.arange(6.0).reshape(3, 2)

    def results(p):
        return p.sum(axis=1), p.prod(axis=1), np.zeros(len(p), dtype=bool)

    try:
        return [journal.evaluate(results, particles + shift)[0] for shift in (0.0, 1.0)]
    finally:
        journal.close()


def test_any_flipped_byte_is_noticed_and_any_missing_tail_computed_again(tmp_path):
    path = tmp_path / "one"
    expected, content = recorded(path), path.read_bytes()
    for i in range(len(content)):
        path.write_bytes(content[:i] + bytes([content[i] ^ 0xFF]) + content[i + 1 :])
        with pytest.raises(CheckpointError):
            recorded(path)
        path.write_bytes(content[:i])
        np.testing.assert_array_equal(recorded(path), expected)
        assert path.read_bytes() == content


def test_descriptions_that_are_gone_of_another_kind_or_edited(finished, tmp_path):
    model, folder, _ = finished
    files = contents(folder)
    for text in ("", "null", "{}", '{"random_seed": [], "chains": 1}', "[" * 10**5):
        (tmp_path / "run.json").write_text(text)
        with pytest.raises(CheckpointError, match="`checkpoint` must be intact, got .*run.json: .*Choose"):
            read_json(tmp_path / "run.json")
    edited = json.dumps(json.loads(files["seed.json"]) | {"chains": 3})
    (tmp_path / "seed.json").write_text(edited)
    with pytest.raises(CheckpointError, match="`checkpoint` must be intact, got .*seed.json: a wrong sum"):
        remembered(tmp_path, None, None, 4)
    (written(tmp_path / "gone", files) / "run.json").unlink()
    with pytest.raises(CheckpointError, match="`checkpoint` must have a run.json, got none"):
        sample(model, checkpoint=tmp_path / "gone", chains=1)


def test_a_journal_of_another_model_is_refused(finished, tmp_path):
    """With the same seed and prior, so of the same first particles: the likelihoods would be wrong."""
    _, folder, draws = finished
    other, of_other = model_of(InProcess(), epsilon=0.4), {"checkpoint": tmp_path / "other", "chains": 1}
    assert not np.array_equal(sample(other, **of_other)[0], draws)
    [name] = [name for name in contents(folder) if name.endswith(".journal")]
    written(tmp_path / "other", {name: contents(folder)[name]})
    match = f"got a wrong sum in .*{name}: it is damaged, or of another run"
    with pytest.raises(CheckpointError, match=match):
        sample(other, **of_other)


def hold(folder, ready, end):
    """Keep a journal in use."""
    rng = np.random.default_rng(1)
    journal = chain_journal(folder, {"model": "model"}, rng)
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
        chain_journal(tmp_path, {"model": "model"}, np.random.default_rng(1))
    chain_journal(tmp_path, {"model": "model"}, np.random.default_rng(2)).close()  # of another chain
    end.set()
    process.join()
    chain_journal(tmp_path, {"model": "model"}, np.random.default_rng(1)).close()


def test_models_and_kernels_that_cannot_go_on(tmp_path):
    with pm.Model() as model:
        x = pm.Normal("x", 0.0, 1.0, shape=2)
        pmf.DiscrepancySimulator(
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
