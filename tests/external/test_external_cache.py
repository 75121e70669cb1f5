"""What a simulator's results are known by, the cache of them, and pickling."""

import copy
import functools
import multiprocessing
import os
import shutil
import sqlite3
import threading
from pathlib import Path

import cloudpickle
import numpy as np
import pymc as pm
import pytest
from pytensor.compile.builders import OpFromGraph

from pymc_features import DiscrepancySimulator, ExpFeature, ProgramSimulator, TruncNormalFeature
from pymc_features.exceptions import UnknownIdentityError
from pymc_features.external.cache import EvaluationCache
from pymc_features.external.workers.calls import Outcome
from pymc_features.fingerprint import fingerprint
from pymc_features.smc.kernels.checkpoint import model_fingerprint
from pymc_features.smc.sample import is_parallel_by_itself
from support import external_functions as functions
from support.commands import run_python
from support.external_functions import DATA, Counted, beam
from support.external_models import AtOnce


def function_of(source, name="f", **known):
    """A function from source text, in a module of nobody."""
    space = {"__name__": "a_script", "np": np, **known}
    exec(compile(source, "<test>", "exec"), space)
    return space[name]


BASE = """
factor = 2.0
def helper(k, n=3):
    return k ** n + factor
class Solver:
    _order = 2
    def __init__(self, steps):
        self.steps = steps
    def solve(self, k):
        return np.sin(k) * self._order
solver = Solver(10)
def f(k, data=(1.0, 2.0)):
    def inner(x):
        return helper(x) * data[0]
    return inner(k) + solver.solve(k)
"""

CHANGES = {
    "constant": ("data[0]", "data[1]"),
    "type of a number": ("(1.0, 2.0)", "(1, 2.0)"),
    "helper": ("+ factor", "- factor"),
    "helper's default": ("n=3", "n=4"),
    "global": ("factor = 2.0", "factor = 2.5"),
    "attribute": ("Solver(10)", "Solver(11)"),
    "method": ("np.sin", "np.cos"),
    "class attribute": ("_order = 2", "_order = 3"),
    "inner function": ("helper(x) *", "helper(x) /"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changed_code_is_another(change):
    before, after = CHANGES[change]
    assert before in BASE
    assert fingerprint(function_of(BASE.replace(before, after))) != fingerprint(function_of(BASE))


def test_what_does_not_count():
    same = "# a comment\n\n" + BASE.replace("factor = 2.0", "unused = object()\nfactor = 2.0")
    assert fingerprint(function_of(same)) == fingerprint(function_of(BASE))


def closure(value):
    """A function that holds a value."""

    def f(k):
        return value

    return f


class Slots:
    """Holds a value in a slot."""

    __slots__ = ("value",)

    def __init__(self, value):
        self.value = value


class Refers:
    """Refers to itself, and to a value."""

    def __init__(self, value):
        self.value, self.me = value, self


HOLDERS = {
    "keyword": lambda v: functools.partial(beam, k=v),
    "attribute": lambda v: Counted("path", v),
    "slot": Slots,
    "cycle": Refers,
    "bound method": lambda v: Counted("path", v).calls,
    "cached": lambda v: functools.lru_cache(closure(v)),
    "array": lambda v: closure(np.array([v, 1.0])),
    "masked array": lambda v: closure(np.ma.array([0.0, 1.0], mask=[v == 1.0, False])),
    "object array": lambda v: closure(np.array([v, None])),
    "dict": lambda v: closure({"a": v}),
    "set": lambda v: closure({v, 5.0}),
    "generator": lambda v: closure(np.random.default_rng(int(v))),
    "path": lambda v: closure(Path(str(v))),
    "class": lambda v: closure(type("Solver", (), {"order": v})),
    "vectorized": lambda v: np.vectorize(closure(v)),
    "library": lambda v: shutil.ignore_patterns(str(v)),  # a closure of its own
    "decorated": lambda v: functools.wraps(beam)(closure(v)),
    "command": lambda v: ProgramSimulator("run", ["k"], {"in": f"{{{{k}}}} {v}"}, "out"),
    "reader": lambda v: ProgramSimulator("run", ["k"], {}, closure(v)),
}


@pytest.mark.parametrize("holder", HOLDERS)
def test_what_a_function_holds_counts(holder):
    make = HOLDERS[holder]
    assert fingerprint(make(1.0)) == fingerprint(make(1.0)) != fingerprint(make(2.0))


def test_large_and_tangled_things_are_read_once():
    tangled = [1.0]
    for _ in range(60):
        tangled = [tangled, tangled]  # 2^60 ways down
    assert fingerprint(tangled) == fingerprint(tangled)
    for unknown in (closure(threading.Lock()), closure(x for x in ())):
        with pytest.raises(UnknownIdentityError, match="the contents of a .* cannot be told"):
            fingerprint(unknown)
    deep = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(UnknownIdentityError, match="nested too deeply"):
        fingerprint(deep)


def model_with(simulator):
    """A feature likelihood."""
    with pm.Model() as model:
        k = pm.Uniform("k", 0.5, 1.5)
        TruncNormalFeature("y", simulator(k), 0.3, observed=DATA)
    return model


WITH_SETS = """
tags = {"some", "words", "in", "a", "set"}
def f(k):
    return len(tags) * (k in {"more", "words"})
"""
OTHER_PROCESS = """
import sys
sys.path.insert(0, {folder!r})
import pytensor
pytensor.config.mode = "FAST_COMPILE"
import numpy as np
import test_external_cache as here
from pymc_features import ExternalSimulator
from support.external_functions import SHAPE, Counted, beam, lives, wait_until
print(here.fingerprint(here.function_of(here.WITH_SETS), here.function_of(here.BASE), Counted("path")))
with ExternalSimulator(Counted({calls!r}), SHAPE, executor=1, cache={cache!r}) as s:
    assert np.array_equal(s.responses(np.array([1.0, 2.0])), [beam(1.0), beam(2.0)])
    print(s.counts["cached"], here.model_fingerprint(here.model_with(s)))
"""


@pytest.mark.processes
def test_the_same_in_another_process(simulator, tmp_path):
    """Fingerprints do not depend on the seed of hashes, and another process finds cached results."""
    s = simulator(Counted(tmp_path / "calls"), cache=tmp_path / "cache.sqlite")
    s.responses(np.array([1.0]))
    folder, cache = str(Path(__file__).parent), str(tmp_path / "cache.sqlite")
    program = OTHER_PROCESS.format(folder=folder, calls=s.function.path, cache=cache)
    assert run_python(program, tmp_path, PYTHONHASHSEED="1").split() == [
        fingerprint(function_of(WITH_SETS), function_of(BASE), Counted("path")),
        "1",
        model_fingerprint(model_with(s)),
    ]
    np.testing.assert_array_equal(s.responses(np.array([2.0]))[0], beam(2.0))
    assert sorted(k for _, k in s.function.calls()) == [1.0, 2.0]


def test_results_are_found_again(simulator, tmp_path):
    path = tmp_path / "cache.sqlite"
    function = Counted(tmp_path / "calls")
    k = np.array([1.0, 2.0])
    simulator(function, cache=path).responses(k)
    other = simulator(function, cache=path)
    np.testing.assert_array_equal(other.responses(np.array([2.0, 3.0])), [beam(2.0), beam(3.0)])
    assert other.counts["cached"] == 1 and [k for _, k in function.calls()] == [1.0, 2.0, 3.0]
    e = other.discrepancies(k, observed=DATA)  # not what `responses` keeps
    np.testing.assert_array_equal(simulator(function, cache=path).discrepancies(k, observed=DATA), e)
    assert len(function.calls()) == 5
    other.discrepancies(k, observed=DATA + 1.0)
    assert len(function.calls()) == 7
    assert not np.array_equal(other.discrepancies(k, observed=DATA + 1.0), e)


def test_failures_are_kept_and_tried_again(simulator, tmp_path):
    s = simulator(functions.ways_to_fail, cache=tmp_path / "cache.sqlite")
    s.responses(np.array([1.0, 2.0, 1.5]))
    s.responses(np.array([1.0]))
    kept = s.evaluator.cache.failures()
    assert [(f["parameters"].tolist(), f["state"]) for f in kept] == [([k], "error") for k in (1.0, 2.0, 1.0)]
    assert kept[0]["message"] == "ZeroDivisionError: first line" and kept[0]["seconds"] >= 0.0
    assert s.counts["cached"] == 0


def test_a_version_stands_for_the_function_of_its_name(simulator, tmp_path):
    settings = {"cache": tmp_path / "cache.sqlite", "version": "1"}
    k = np.ones(1)
    simulator(closure(beam(1.0)), **settings).responses(k)
    assert (simulator(closure(beam(2.0)), **settings).responses(k)[0] == beam(1.0)).all()
    settings["version"] = "2"
    assert (simulator(closure(beam(2.0)), **settings).responses(k)[0] == beam(2.0)).all()
    settings["version"] = "1"
    assert (simulator(functions.two, **settings).responses(k, np.ones((1, 2))) != beam(1.0)).any()
    locked = closure(threading.Lock())
    with pytest.raises(ValueError, match="`version` must be given with `cache`.*lock cannot be told"):
        simulator(locked, cache=tmp_path / "cache.sqlite")
    simulator(locked)  # without a cache it need not be known


def write(path, first, barrier):
    """Write a hundred results."""
    barrier.wait()
    cache = EvaluationCache(path)
    for i in range(first, first + 100):
        cache.add(str(i), (1.0,), Outcome("ok", np.full(3, float(i))))


@pytest.mark.processes
def test_several_writers(tmp_path):
    """The file is made, and written to, by several processes at once."""
    context = multiprocessing.get_context("fork")
    for attempt in range(2):
        path, barrier = tmp_path / f"{attempt}.sqlite", context.Barrier(4)
        writers = [context.Process(target=write, args=(path, 60 * i, barrier)) for i in range(4)]
        for process in writers:
            process.start()
        for process in writers:
            process.join()
        assert [process.exitcode for process in writers] == [0] * 4
        cache = EvaluationCache(path)
        for i in range(280):
            np.testing.assert_array_equal(cache.find(str(i)), np.full(3, float(i)))
        assert cache.find("280") is None


@pytest.mark.processes
def test_connections_do_not_survive_a_fork(tmp_path):
    """SQLite's must not be used, nor closed, in another process than they were opened in."""
    cache = EvaluationCache(tmp_path / "cache.sqlite")
    cache.add("1", (1.0,), Outcome("ok", np.ones(1)))
    assert cache.connection is not None

    def child():
        fresh = cache.connection is None
        cache.add("2", (1.0,), Outcome("ok", np.ones(1)))
        os._exit(0 if fresh and cache.find("1") == [1.0] else 1)

    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    process.join()
    assert process.exitcode == 0 and cache.find("2") == [1.0]


def test_what_is_no_cache_is_refused(tmp_path):
    (tmp_path / "text").write_text("not a database, but long enough to be one" * 100)
    with pytest.raises(ValueError, match="`cache` must be a cache of simulations, got .* not a database"):
        EvaluationCache(tmp_path / "text")
    with pytest.raises(ValueError, match="`cache` must be a file that can be written.*Is there its folder"):
        EvaluationCache(tmp_path / "nowhere" / "cache.sqlite")
    for name, statement, version in (
        ("other", "CREATE TABLE t (x)", 0),
        ("new", "PRAGMA user_version = 2", 2),
    ):
        connection = sqlite3.connect(tmp_path / name)
        connection.execute(statement)
        connection.commit()
        connection.close()
        before = (tmp_path / name).read_bytes()
        with pytest.raises(ValueError, match=f"of version 1, got .* with version {version}"):
            EvaluationCache(tmp_path / name)
        assert (tmp_path / name).read_bytes() == before


def test_pickling(simulator, tmp_path):
    s = simulator(gradient=functions.beam_gradient, cache=tmp_path / "cache.sqlite")
    s.responses(np.ones(1))
    model = model_with(s)
    again, function = cloudpickle.loads(cloudpickle.dumps((s, model.compile_logp())))
    assert again.counts == s.counts and again.identity == s.identity
    np.testing.assert_array_equal(again.responses(np.array([2.0]))[0], beam(2.0))
    point = {"k_interval__": 0.3}
    assert function(point) == model.compile_logp()(point)
    again.close()
    held = simulator(executor=AtOnce(beam))
    with pytest.raises(TypeError, match="`executor` must be a number or an address to travel"):
        cloudpickle.dumps(held)
    assert copy.deepcopy(held) is held


def test_chains_are_not_parallel_by_default(simulator):
    """Their simulations are."""
    for function, expected in ((simulator(), True), (beam, False)):
        with pm.Model() as model:
            k = pm.Uniform("k", 0.5, 1.5)
            given = (function(k),) if expected else (function, k)
            DiscrepancySimulator("y", *given, epsilon=1.0, observed=DATA, noise=0.1)
        assert is_parallel_by_itself(model) == expected


def test_nothing_is_compiled_to_know_that(monkeypatch):
    """A likelihood that is a graph would compile itself for its `fn`, for 9 s in an empty cache."""
    with pm.Model() as model:
        ExpFeature("y", mu=pm.Normal("x") * np.ones((2, 5)), sigma=1.0, observed=np.zeros((2, 5)))
    [likelihood] = model.observed_RVs
    assert isinstance(likelihood.owner.op, OpFromGraph)
    monkeypatch.setattr(OpFromGraph, "fn", property(lambda self: pytest.fail("compiled")))
    assert not is_parallel_by_itself(model)
