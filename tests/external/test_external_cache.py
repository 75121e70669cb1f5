"""What a simulator's results are known by, the cache of them, command lines, and settings."""

import copy
import functools
import inspect
import multiprocessing
import os
import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import cloudpickle
import numba
import numpy as np
import pymc as pm
import pytest

from pymc_features import (
    CommandLine,
    DiscrepancySimulator,
    ExternalSimulator,
    Surrogate,
    TruncNormalFeature,
    sample_smc,
)
from pymc_features.external import EvaluationCache, checks
from pymc_features.external.processes.calls import Outcome
from pymc_features.fingerprint import UnknownIdentityError, fingerprint
from pymc_features.smc.kernels.checkpoint import model_fingerprint
from pymc_features.smc.sample import is_parallel_by_itself
from support import external_functions as functions
from support.external_functions import SHAPE, Counted, beam, lives, wait_until
from support.sampling import QUIET

DATA = 2.0 * beam(1.0)
pytestmark = pytest.mark.usefixtures("fast_compile")


@pytest.fixture
def simulator():
    """Makes simulators with the shape of `beam` on one process, and ends them."""
    made = []

    def make(function=beam, **settings):
        made.append(ExternalSimulator(function, SHAPE, **{"executor": 1, "progress": False, **settings}))
        return made[-1]

    yield make
    for one in made:
        one.close()


# --- identity


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
    "default": ("(1.0, 2.0)", "(1.0, 3.0)"),
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
    "closure": closure,
    "partial": lambda v: functools.partial(beam, v),
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
    "nested": lambda v: closure([({"a": (v,)},)]),
    "generator": lambda v: closure(np.random.default_rng(int(v))),
    "path": lambda v: closure(Path(str(v))),
    "class": lambda v: closure(type("Solver", (), {"order": v})),
    "vectorized": lambda v: np.vectorize(closure(v)),
    "library": lambda v: shutil.ignore_patterns(str(v)),  # a closure of its own
    "decorated": lambda v: functools.wraps(beam)(closure(v)),
    "command": lambda v: CommandLine("run", ["k"], {"in": f"{{{{k}}}} {v}"}, "out"),
    "reader": lambda v: CommandLine("run", ["k"], {}, closure(v)),
}


@pytest.mark.parametrize("holder", HOLDERS)
def test_what_a_function_holds_counts(holder):
    make = HOLDERS[holder]
    assert fingerprint(make(1.0)) == fingerprint(make(1.0)) != fingerprint(make(2.0))


def test_order_and_type_count_but_sharing_does_not():
    assert fingerprint({"a": 1, "b": 2}) != fingerprint({"b": 2, "a": 1})
    assert fingerprint(1) != fingerprint(1.0) != fingerprint(True) and fingerprint(0.0) != fingerprint(-0.0)
    assert fingerprint([1], [2]) != fingerprint([1, 2]) and fingerprint("1") != fingerprint(b"1")
    array = np.arange(3.0)
    assert fingerprint([array, array]) == fingerprint([array, array.copy()])
    assert fingerprint(array) != fingerprint(array.astype(int)) != fingerprint(array[None])


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


def test_compiled_functions():
    a, b, c = (numba.njit(closure(v)) for v in (1.0, 1.0, 2.0))
    assert fingerprint(a) == fingerprint(b) != fingerprint(c)


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
sys.path.insert(0, {tests!r})
import pytensor
pytensor.config.mode = "FAST_COMPILE"
import numpy as np
import test_external_cache as here
from support.external_functions import SHAPE, Counted, beam, lives, wait_until
print(here.fingerprint(here.function_of(here.WITH_SETS), here.function_of(here.BASE), Counted("path")))
with here.ExternalSimulator(Counted({calls!r}), SHAPE, executor=1, cache={cache!r}) as s:
    assert np.array_equal(s.responses(np.array([1.0, 2.0])), [beam(1.0), beam(2.0)])
    print(s.counts["cached"], here.model_fingerprint(here.model_with(s)))
"""


def test_the_same_in_another_process(simulator, tmp_path):
    """Fingerprints do not depend on the seed of hashes, and another process finds cached results."""
    s = simulator(Counted(tmp_path / "calls"), cache=tmp_path / "cache.sqlite")
    s.responses(np.array([1.0]))
    program = OTHER_PROCESS.format(
        tests=str(Path(__file__).parents[1]), calls=s.function.path, cache=str(tmp_path / "cache.sqlite")
    )
    command, environment = [sys.executable, "-c", program], {**os.environ, "PYTHONHASHSEED": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [
        fingerprint(function_of(WITH_SETS), function_of(BASE), Counted("path")),
        "1",
        model_fingerprint(model_with(s)),
    ]
    np.testing.assert_array_equal(s.responses(np.array([2.0]))[0], beam(2.0))
    assert sorted(k for _, k in s.function.calls()) == [1.0, 2.0]


def test_model_fingerprints(simulator):
    own = model_fingerprint(model_with(simulator()))
    assert own == model_fingerprint(model_with(simulator(executor=2)))
    assert own != model_fingerprint(model_with(simulator(version="2")))
    assert own != model_fingerprint(model_with(simulator(closure(1.0))))


# --- the cache


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


def test_failures_are_kept_and_tried_again(simulator, tmp_path):
    s = simulator(functions.ways_to_fail, cache=tmp_path / "cache.sqlite")
    s.responses(np.array([1.0, 2.0, 1.5]))
    s.responses(np.array([1.0]))
    kept = s.evaluator.cache.failures()
    assert [(f["parameters"].tolist(), f["state"]) for f in kept] == [
        ([1.0], "error"),
        ([2.0], "error"),
        ([1.0], "error"),
    ]
    assert kept[0]["message"] == "ZeroDivisionError: first line" and kept[0]["seconds"] >= 0.0
    assert s.counts["cached"] == 0


def write(path, first, barrier):
    """Write a hundred results."""
    barrier.wait()
    cache = EvaluationCache(path)
    for i in range(first, first + 100):
        cache.add(str(i), (1.0,), Outcome("ok", np.full(3, float(i))))


def test_several_writers(tmp_path):
    """The file is made, and written to, by several processes at once."""
    context = multiprocessing.get_context("fork")
    for attempt in range(3):
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


def test_several_threads(tmp_path):
    cache = EvaluationCache(tmp_path / "cache.sqlite")
    wrong = []

    def work(first):
        for i in range(first, first + 50):
            cache.add(str(i), (1.0,), Outcome("ok", np.array([float(i)])))
            if cache.find(str(i)) != [i]:
                wrong.append(i)

    threads = [threading.Thread(target=work, args=(50 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong and cache.execute("SELECT count(*) FROM results") == [(200,)]


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


def test_a_relative_path_stays_where_it_was(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cache = EvaluationCache("cache.sqlite")
    monkeypatch.chdir("/")
    cache.add("1", (1.0,), Outcome("ok", np.ones(1)))
    assert cloudpickle.loads(cloudpickle.dumps(cache)).find("1") == [1.0]
    cache.close()
    assert cache.find("1") == [1.0]  # opens again


# --- pickling


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
    held = simulator(executor=Held())
    with pytest.raises(TypeError, match="`executor` must be a number or an address to travel"):
        cloudpickle.dumps(held)
    assert copy.deepcopy(held) is held


class Held:
    """An executor that stays where it is."""

    def submit(self, *call):
        raise RuntimeError("closed")


@pytest.mark.parametrize("noise", [None, 0.1])
def test_chains_are_not_parallel_by_default(noise, simulator):
    """Their simulations are."""
    for s, expected in ((simulator(), True), (beam, False)):
        with pm.Model() as model:
            k = pm.Uniform("k", 0.5, 1.5)
            mu, parameters = (s(k), ()) if expected else (s, (k,))
            DiscrepancySimulator("y", mu, *parameters, epsilon=1.0, observed=DATA, noise=noise)
        assert is_parallel_by_itself(model) == expected


def test_chains_in_parallel_give_the_same(simulator, tmp_path):
    draws = []
    for cores in (1, 2):
        with model_with(simulator(cache=tmp_path / "cache.sqlite")):
            idata = sample_smc(40, chains=2, cores=cores, mp_ctx="fork", random_seed=1, **QUIET)
            draws.append(idata.posterior["k"].values)
    np.testing.assert_array_equal(draws[0], draws[1])


# --- command lines

PYTHON = [sys.executable, "-S"]
SUM = (
    "a, b = map(float, open('in.txt').read().split()); open('out.csv', 'w').write(f'0,{a},{b}\\n1,{b!r},{a}')"
)


def run_in(folder, monkeypatch, command, *values):
    """What a command line returns in a folder."""
    folder.mkdir(exist_ok=True)
    monkeypatch.chdir(folder)
    return command(*values)


def test_templates(tmp_path, monkeypatch):
    template = "{{k}} {{ k:.3e }} {{v[1]}} {{v[0]:8.2f}} {{1 2} {3}} {{4}} {k}"
    (tmp_path / "model.tcl").write_text("set k {{k}}")
    program = [*PYTHON, "-c", "open('out.txt', 'w').write('{{v[1]:.1f}} 2')"]
    inputs = {"deep/in.txt": template, "model.tcl": tmp_path / "model.tcl"}
    c = CommandLine(program, ["k", "v"], inputs, "out.txt", transpose=False)
    result = run_in(tmp_path / "run", monkeypatch, c, 1 / 3, np.array([1.5, 1e-9]))
    assert result.tolist() == [[0.0, 2.0]]
    text = (tmp_path / "run" / "deep" / "in.txt").read_text()
    assert text == f"{1 / 3!r} 3.333e-01 1e-09     1.50 {{{{1 2}} {{3}}}} {{{{4}}}} {{k}}"
    assert (tmp_path / "run" / "model.tcl").read_text() == f"set k {1 / 3!r}"
    with pytest.raises(TypeError, match="the program has 2 parameters, got 1"):
        c(1.0)


def test_results_of_programs(tmp_path, monkeypatch):
    program = [*PYTHON, "-c", SUM]
    c = CommandLine(program, ["a", "b"], {"in.txt": "{{a}} {{b}}"}, "out.csv", columns=[1, 2])
    assert run_in(tmp_path / "csv", monkeypatch, c, 1 / 3, 2.0).tolist() == [[1 / 3, 2.0], [2.0, 1 / 3]]
    np.save(tmp_path / "table.npy", np.arange(6.0).reshape(3, 2))
    nothing = [*PYTHON, "-c", ""]
    c = CommandLine(nothing, ["a"], {}, "table.npy", files=[tmp_path / "table.npy"])
    assert run_in(tmp_path / "npy", monkeypatch, c, 1.0).tolist() == [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]]
    c = CommandLine(
        nothing, ["a"], {}, lambda folder: np.load(folder / "table.npy"), files=[tmp_path / "table.npy"]
    )
    assert run_in(tmp_path / "function", monkeypatch, c, 1.0).shape == (3, 2)
    (tmp_path / "solver").write_text(f"#!{sys.executable}\nopen('out.txt', 'w').write('7')")
    (tmp_path / "solver").chmod(0o755)
    c = CommandLine("./solver --fast", ["a"], {}, "out.txt", files=[tmp_path / "solver"])  # a string, split
    assert run_in(tmp_path / "program", monkeypatch, c, 1.0).tolist() == [[7.0]]


def test_programs_that_fail(tmp_path, monkeypatch):
    fails = [*PYTHON, "-c", "import sys; sys.stderr.write('first\\nsingular matrix\\n'); sys.exit(2)"]
    cases = {
        "exit code 2: singular matrix": CommandLine(fails, ["a"], {}, "out.txt"),
        "the program left no out.txt": CommandLine([*PYTHON, "-c", ""], ["a"], {}, "out.txt"),
        "no-such-solver": CommandLine("no-such-solver", ["a"], {}, "out.txt"),
    }
    for message, c in cases.items():
        with pytest.raises((RuntimeError, FileNotFoundError), match=message):
            run_in(tmp_path / "run", monkeypatch, c, 1.0)


def test_command_line_as_a_simulator(simulator, tmp_path):
    """In scratch folders, failures and time-outs counted; a program that hangs is killed."""
    code = (
        "import sys, time, os\nk = float(sys.argv[1])\nopen(sys.argv[2], 'a').write(f'{os.getpid()} ')\n"
        "if k == 2: sys.exit('no convergence')\nif k == 3: time.sleep(100)\n"
        "open('out.txt', 'w').writelines(f'{t / k!r} {2 * t / k!r}\\n' for t in range(1, 6))\n"
    )
    (tmp_path / "solver.py").write_text(code)
    program = [*PYTHON, "solver.py", "{{k}}", str(tmp_path / "pids")]
    s = simulator(
        CommandLine(program, ["k"], {}, "out.txt", files=[tmp_path / "solver.py"]),
        timeout=2.0,
        scratch=tmp_path / "scratch",
        executor=2,
    )
    results = s.responses(np.array([1.0, 2.0, 3.0, 7.0]))
    np.testing.assert_array_equal(results[[0, 3]], [beam(1.0), beam(7.0)])
    assert s.counts == {"ok": 2, "error": 1, "timeout": 1, "died": 0, "invalid": 0, "cached": 0}
    assert {f.message for f in s.failures} == {
        "RuntimeError: exit code 1: no convergence",
        "no result after 2 s",
    }
    s.close()
    assert list((tmp_path / "scratch").iterdir()) == []
    wait_until(lambda: not any(map(lives, (tmp_path / "pids").read_text().split())))


def test_mean_squares_by_a_program(simulator):
    for text in ("1.5 2.5", "1.5\\n2.5"):
        program = [*PYTHON, "-c", f"open('out.txt', 'w').write('{text}')"]
        s = simulator(CommandLine(program, ["k"], {}, "out.txt"), returns="mean_square")
        assert s.discrepancies(np.ones(1), observed=DATA).tolist() == [[1.5, 2.5]]


def test_ours_travel_without_the_package(simulator, tmp_path, monkeypatch):
    """A process that runs a `CommandLine` or a gradient does not import PyMC."""

    def modules(folder):
        loaded = sum(name.partition(".")[0] in ("pymc", "pymc_features") for name in sys.modules)
        return np.full(SHAPE, float(loaded))

    s = simulator(CommandLine([*PYTHON, "-c", ""], ["k"], {}, modules))
    assert (s.responses(np.ones(1)) == 0.0).all()

    def gradient(k, cotangent):
        return float("pymc_features" in sys.modules)

    s = simulator(gradient=gradient)
    assert s.gradients(np.ones(1), cotangent=DATA)[0] == [0.0]


LINE = {"command": "run", "parameters": ["k"], "inputs": {}, "result": "out.txt"}
BAD_LINES = {
    "`command` must name a program": {"command": ""},
    "`parameters` must be a list of names, got 'k'": {"parameters": "k"},
    "`parameters` must be a list of names, got \\['1'\\]": {"parameters": ["1"]},
    "`inputs` must name parameters \\(k\\), got 'm' in in.txt": {"inputs": {"in.txt": "{{m}}"}},
    "`inputs` must name parameters \\(k\\), got 'm' in command": {"command": "run {{m[1]}}"},
    "`inputs` must have formats of numbers, such as .3e, got 'd'": {"inputs": {"in.txt": "{{k:d}}"}},
    "`inputs` must give a text or a Path for in.txt, got int": {"inputs": {"in.txt": 1}},
    "a file of the program must exist, got nowhere.txt": {"inputs": {"in.txt": Path("nowhere.txt")}},
    "a file of the program must exist, got nowhere.dat": {"files": ["nowhere.dat"]},
    "`result` must be the name of a file or a function, got 3": {"result": 3},
}


@pytest.mark.parametrize("message", BAD_LINES)
def test_command_lines_that_cannot_be(message):
    settings = {**LINE, **BAD_LINES[message]}
    with pytest.raises((ValueError, TypeError), match=message):
        CommandLine(**settings)
    CommandLine(**LINE)


# --- settings

BAD_SETTINGS = {
    "`function` must be callable, got int": {"function": 1},
    "`gradient` must be callable, got int": {"gradient": 1},
    "`shape` must be \\(sensors, times\\) of the data, got \\(2,\\)": {"shape": (2,)},
    "`shape` must be \\(sensors, times\\) of the data, got \\(2, 0\\)": {"shape": (2, 0)},
    "`shape` must be \\(sensors, times\\) of the data, got 3": {"shape": 3},
    "`returns` must be one of response, mean_square, got 'e'": {"returns": "e"},
    "`timeout` must be a positive number of seconds, got 0": {"timeout": 0},
    "`timeout` must be a positive number of seconds, got inf": {"timeout": np.inf},
    "`dt` must be a positive number of seconds, got -1.0": {"dt": -1.0},
    "`retries` must be an integer of at least 0, got 1.5": {"retries": 1.5},
    "`retries` must be an integer of at least 0, got True": {"retries": True},
    "`version` must be a text, got 1": {"version": 1},
    "`surrogate` must be a Surrogate, got int": {"surrogate": 1},
    "`gradient` must be left out with `surrogate`": {"gradient": beam, "surrogate": Surrogate(1)},
    "`executor` must be something that runs simulations, got 0": {"executor": 0},
    "`executor` must be something that runs simulations, got True": {"executor": True},
    "`executor` must be something that runs simulations, got \\[\\]": {"executor": []},
}


@pytest.mark.parametrize("message", BAD_SETTINGS)
def test_settings_that_cannot_be(message):
    with pytest.raises((ValueError, TypeError), match=message):
        ExternalSimulator(**{"function": beam, "shape": SHAPE, **BAD_SETTINGS[message]})


def test_every_setting_that_is_checked_is_tested():
    names = {re.match("`(\\w+)`", message)[1] for message in BAD_SETTINGS}
    assert names == set(inspect.signature(checks.check_settings).parameters)


def test_dask_has_to_be_installed_and_reachable(simulator, monkeypatch):
    with pytest.raises(
        ValueError, match="`executor` must be the address of a Dask scheduler, got 'nonsense://a'"
    ):
        simulator(executor="nonsense://a").responses(np.ones(1))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match="without Dask. Install distributed"):
        simulator(executor="tcp://127.0.0.1:1").responses(np.ones(1))
