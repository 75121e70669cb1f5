"""Command lines as simulators, and the settings of simulators."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pymc_features import ExternalSimulator, ProgramSimulator
from support.external_functions import DATA, SHAPE, beam, lives, wait_until

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
    c = ProgramSimulator(program, ["k", "v"], inputs, "out.txt", transpose=False)
    result = run_in(tmp_path / "run", monkeypatch, c, 1 / 3, np.array([1.5, 1e-9]))
    assert result.tolist() == [[0.0, 2.0]]
    text = (tmp_path / "run" / "deep" / "in.txt").read_text()
    assert text == f"{1 / 3!r} 3.333e-01 1e-09     1.50 {{{{1 2}} {{3}}}} {{{{4}}}} {{k}}"
    assert (tmp_path / "run" / "model.tcl").read_text() == f"set k {1 / 3!r}"
    with pytest.raises(TypeError, match="the program has 2 parameters, got 1"):
        c(1.0)


def test_results_of_programs(tmp_path, monkeypatch):
    program = [*PYTHON, "-c", SUM]
    c = ProgramSimulator(program, ["a", "b"], {"in.txt": "{{a}} {{b}}"}, "out.csv", columns=[1, 2])
    assert run_in(tmp_path / "csv", monkeypatch, c, 1 / 3, 2.0).tolist() == [[1 / 3, 2.0], [2.0, 1 / 3]]
    np.save(tmp_path / "table.npy", np.arange(6.0).reshape(3, 2))
    nothing = [*PYTHON, "-c", ""]
    c = ProgramSimulator(nothing, ["a"], {}, "table.npy", files=[tmp_path / "table.npy"])
    assert run_in(tmp_path / "npy", monkeypatch, c, 1.0).tolist() == [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]]
    given = {"files": [tmp_path / "table.npy"]}
    c = ProgramSimulator(nothing, ["a"], {}, lambda folder: np.load(folder / "table.npy"), **given)
    assert run_in(tmp_path / "function", monkeypatch, c, 1.0).shape == (3, 2)
    (tmp_path / "solver").write_text(f"#!{sys.executable}\nopen('out.txt', 'w').write('7')")
    (tmp_path / "solver").chmod(0o755)
    c = ProgramSimulator("./solver --fast", ["a"], {}, "out.txt", files=[tmp_path / "solver"])  # split
    assert run_in(tmp_path / "program", monkeypatch, c, 1.0).tolist() == [[7.0]]


def test_programs_that_fail(tmp_path, monkeypatch):
    fails = [*PYTHON, "-c", "import sys; sys.stderr.write('first\\nsingular matrix\\n'); sys.exit(2)"]
    cases = {
        "exit code 2: singular matrix": ProgramSimulator(fails, ["a"], {}, "out.txt"),
        "the program left no out.txt": ProgramSimulator([*PYTHON, "-c", ""], ["a"], {}, "out.txt"),
        "no-such-solver": ProgramSimulator("no-such-solver", ["a"], {}, "out.txt"),
    }
    for message, c in cases.items():
        with pytest.raises((RuntimeError, FileNotFoundError), match=message):
            run_in(tmp_path / "run", monkeypatch, c, 1.0)


@pytest.mark.slow
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
        ProgramSimulator(program, ["k"], {}, "out.txt", files=[tmp_path / "solver.py"]),
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
        s = simulator(ProgramSimulator(program, ["k"], {}, "out.txt"), returns="mean_square")
        assert s.discrepancies(np.ones(1), observed=DATA).tolist() == [[1.5, 2.5]]


def test_ours_travel_without_the_package(simulator, tmp_path, monkeypatch):
    """A process that runs a `ProgramSimulator` or a gradient does not import PyMC."""

    def modules(folder):
        loaded = sum(name.partition(".")[0] in ("pymc", "pymc_features") for name in sys.modules)
        return np.full(SHAPE, float(loaded))

    s = simulator(ProgramSimulator([*PYTHON, "-c", ""], ["k"], {}, modules))
    assert (s.responses(np.ones(1)) == 0.0).all()

    def gradient(k, cotangent):
        return float("pymc_features" in sys.modules)

    s = simulator(gradient=gradient)
    assert s.gradients(np.ones(1), cotangent=DATA)[0] == [0.0]


LINE = {"command": "run", "parameters": ["k"], "inputs": {}, "result": "out.txt"}
BAD_LINES = {
    "`command` must name a program": {"command": ""},
    "`parameters` must be a list of names, got \\['1'\\]": {"parameters": ["1"]},
    "`inputs` must name parameters \\(k\\), got 'm' in in.txt": {"inputs": {"in.txt": "{{m}}"}},
    "`inputs` must name parameters \\(k\\), got 'm' in command": {"command": "run {{m[1]}}"},
    "`inputs` must have formats of numbers, such as .3e, got 'd'": {"inputs": {"in.txt": "{{k:d}}"}},
    "`inputs` must give a text or a Path for in.txt, got int": {"inputs": {"in.txt": 1}},
    "`inputs` must be an existing file, got nowhere.txt": {"inputs": {"in.txt": Path("nowhere.txt")}},
    "`files` must be an existing file, got nowhere.dat": {"files": ["nowhere.dat"]},
    "`result` must be the name of a file or a function, got 3": {"result": 3},
}


@pytest.mark.parametrize("message", BAD_LINES)
def test_command_lines_that_cannot_be(message):
    settings = {**LINE, **BAD_LINES[message]}
    with pytest.raises((ValueError, TypeError), match=message):
        ProgramSimulator(**settings)
    ProgramSimulator(**LINE)


BAD_SETTINGS = {
    "`function` must be callable, got int": {"function": 1},
    "`gradient` must be callable, got int": {"gradient": 1},
    "`shape` must be \\(sensors, times\\) of the data, got \\(2, 0\\)": {"shape": (2, 0)},
    "`shape` must be \\(sensors, times\\) of the data, got 3": {"shape": 3},
    "`returns` must be one of response, mean_square, got 'e'": {"returns": "e"},
    "`timeout` must be a positive number of seconds, got 0": {"timeout": 0},
    "`dt` must be a positive number of seconds, got -1.0": {"dt": -1.0},
    "`retries` must be an integer of at least 0, got 1.5": {"retries": 1.5},
    "`version` must be a text, got 1": {"version": 1},
    "`executor` must be something that runs simulations, got 0": {"executor": 0},
    "`executor` must be something that runs simulations, got True": {"executor": True},
    "`progress` must be True or False, got 'no'": {"progress": "no"},
}


@pytest.mark.parametrize("message", BAD_SETTINGS)
def test_settings_that_cannot_be(message):
    with pytest.raises((ValueError, TypeError), match=message):
        ExternalSimulator(**{"function": beam, "shape": SHAPE, **BAD_SETTINGS[message]})


def test_dask_has_to_be_installed_and_reachable(simulator, monkeypatch):
    with pytest.raises(
        ValueError, match="`executor` must be the address of a Dask scheduler, got 'nonsense://a'"
    ):
        simulator(executor="nonsense://a").responses(np.ones(1))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match="without Dask. Install distributed"):
        simulator(executor="tcp://127.0.0.1:1").responses(np.ones(1))
