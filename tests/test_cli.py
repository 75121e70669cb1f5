"""The command line: messages, interrupts and exit codes."""

import io
import os
import runpy
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from numba import njit
from numba.core import event
from rich.console import Console

from pymc_features import cli, progress, warm_up
from pymc_features.cli import make_parser
from pymc_features.records import Record
from pymc_features.simulators import simulate
from pymc_features.simulators.chain.kernels import chain_response
from pymc_features.simulators.compiled import jit
from support.commands import ROOT


@pytest.fixture(scope="module")
def record_file(tmp_path_factory):
    """A short ground motion in g, one column."""
    path = tmp_path_factory.mktemp("record") / "pulse.csv"
    values = 0.3 * np.random.default_rng(3).normal(size=160)
    path.write_text("acceleration [g]\n" + "\n".join(f"{v:.6f}" for v in values) + "\n")
    return path


def arguments(record_file, out, *more):
    """A run of a few seconds for each part."""
    return [
        *("reproduce", "--quick", "--record", str(record_file), "--record-dt", "0.02"),
        *("--draws", "60", "--chains", "1", "--cores", "1", "--out", str(out), *more),
    ]


def test_the_package_is_the_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["pymc_features", "update", "nowhere.toml"])
    monkeypatch.setattr(cli, "command", cli.main)  # without its signals and what it does at exit
    with pytest.raises(SystemExit) as stopped:
        runpy.run_module("pymc_features", run_name="__main__")
    assert stopped.value.code == 2
    assert "nowhere.toml" in capsys.readouterr().err


def test_reproduce_takes_an_executor(record_file, tmp_path, capsys):
    assert cli.main(arguments(record_file, tmp_path, "--executor", "0")) == 2
    assert "`executor` must be something that runs simulations, got 0" in capsys.readouterr().err
    parsed = make_parser().parse_args(["reproduce", "--executor", "tcp://host:8786"])
    assert parsed.executor == "tcp://host:8786"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--record", "missing.csv"], "`path` must be an existing file, got missing.csv"),
        (["--units", "furlong"], "`units` must be one of"),
        (["--stiffness", "-3"], "`stiffness` must be positive and finite, got -3"),
        (["--noise-time", "-1"], "`noise_time` must be positive or zero, got -1"),
        (["--draws", "1"], "`draws` must be an integer of at least 50, got 1"),
        (["--structure", "steel"], "`structure` must be one of linear, bouc-wen, got 'steel'"),
        (["--likelihoods", "TN", "MAX"], "`likelihoods` must be among NORM, TN, EXP, ABC"),
        (["--record-dt", "-0.02"], "`dt` must be positive, got -0.02"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(record_file, tmp_path, capsys, more, message):
    assert cli.main(arguments(record_file, tmp_path / "out", *more)) == 2
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert error.splitlines()[-1].startswith("pymc-features: error: ")


def test_traceback_on_request(record_file, tmp_path):
    with pytest.raises(ValueError, match="`draws` must be"):
        cli.main(arguments(record_file, tmp_path, "--draws", "1", "--traceback"))


def test_unknown_option_is_exit_code_2(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["reproduce", "--fast"])
    assert stop.value.code == 2
    assert "--fast" in capsys.readouterr().err


@pytest.mark.slow
def test_warm_up_samples_a_model_of_each_kind(monkeypatch, capsys):
    """Two of them here: the others take long where nothing is compiled yet."""
    kept = ("chains with damping ratios", "identified modes")
    monkeypatch.setattr(warm_up, "STEPS", {name: warm_up.STEPS[name] for name in kept})
    assert cli.main(["warm-up"]) == 0
    told = capsys.readouterr().err
    assert all(line in told for line in (f"[0/2] {kept[0]}", f"[1/2] {kept[1]}", "[2/2] finished"))
    for structure in warm_up.FAMILIES.values():
        assert simulate(structure(1.1), Record(np.sin(np.arange(20.0)), 0.02)).shape == (10, 20)


def test_the_first_compilation_is_announced_once(monkeypatch, caplog):
    """And only that of a kernel; what compiles is not run."""
    caplog.set_level("INFO", "pymc_features")
    monkeypatch.setattr(jit.FIRST_USE, "is_told", False)
    for dispatcher in (njit(lambda x: x), chain_response, chain_response):
        with event.trigger_event("numba:compile", data={"dispatcher": dispatcher}):
            pass
    assert [one.getMessage().partition(",")[0] for one in caplog.records] == ["Compiling for this machine"]


def test_el_centro_is_the_default():
    record, sentence = cli.find_record(make_parser().parse_args(["reproduce"]))
    assert (record.name, record.n_times) == ("El Centro 1940 NS", 1559)
    assert "El Centro" in sentence


def started(command):
    """A command in a process that Ctrl-C stops."""
    return subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)},
        # a shell's background jobs ignore Ctrl-C, and hand that on
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def waits_for(process, words):
    """What a process says until it has said these."""
    said = ""
    while words not in said:
        line = process.stderr.readline()
        assert line, said
        said += line
    return said


@pytest.mark.processes
@pytest.mark.parametrize(("module", "presses"), [("numpy", 1), ("pymc", 2)])
def test_interrupts_while_importing(module, presses, tmp_path):
    """At first, and in PyMC, which takes seconds: one line, and a second press is too late."""
    (path := tmp_path / "empty.toml").touch()
    process = started([sys.executable, "-X", "importtime", "-m", "pymc_features.cli", "update", str(path)])
    waits_for(process, f" {module}\n")
    for _ in range(presses):
        process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=60)[1]
    rest = [line for line in error.splitlines() if not line.startswith("import time:")]
    assert (process.returncode, rest) == (130, ["Interrupted."])


@pytest.mark.processes
def test_interrupts_keep_what_is_finished(record_file, tmp_path):
    """After the first part, twice: the second comes while the program stops, or while Python ends."""
    command = [sys.executable, "-m", "pymc_features.cli"]
    process = started([*command, *arguments(record_file, tmp_path, "--draws", "200")])
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not list(tmp_path.glob("parts/NORM_x0.2.nc")):
        time.sleep(0.1)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    assert "Traceback" not in error
    assert "Interrupted: finished parts are kept in" in error or "Interrupted again: ended at once" in error
    assert (tmp_path / "parts" / "NORM_x0.2.nc").exists()


SLOW_TO_STOP = """
import atexit, multiprocessing, sys, time
from pymc_features import cli
from pymc_features.progress import PartProgress

def wait(words):
    print(words, file=sys.stderr, flush=True)
    time.sleep(100)

class HalfMade:
    def __init__(self):
        wait("at work")
        self.made = True

    def __del__(self):
        assert self.made

def slow(options, console):
    options.out = "here"
    multiprocessing.get_context("fork").Process(target=time.sleep, args=(100,), daemon=True).start()
    with PartProgress(console, "update"):
        try:
            HalfMade()
        finally:
            if "unwinding" in options.config:
                wait("stopping")
            atexit.register(wait, "stopping")

cli.update = slow
sys.exit(cli.command())
"""


@pytest.mark.processes
@pytest.mark.parametrize("where", ["unwinding", "at exit"])
def test_a_second_interrupt_ends_what_is_slow_to_stop(where, tmp_path):
    """In the middle of its stopping, or when all is said and Python ends."""
    (path := tmp_path / f"{where}.toml").touch()
    process = started([sys.executable, "-c", SLOW_TO_STOP, "update", str(path)])
    said = ""
    for words in ("at work", "stopping"):
        said += waits_for(process, words)
        process.send_signal(signal.SIGINT)
    start = time.monotonic()
    _, rest = process.communicate(timeout=60)  # the other end of the pipe is also the child's
    assert time.monotonic() - start < 30.0
    assert process.returncode == 130, said + rest
    assert "Traceback" not in said + rest
    assert rest == "Interrupted again: ended at once; finished parts are kept.\n"
    assert ("Interrupted: finished parts are kept in here" in said) == (where == "at exit")


@pytest.mark.processes
def test_imports_cannot_swallow_an_interrupt(tmp_path):
    """As extension modules of pandas make another error of it, and callbacks of weak references drop it."""
    (tmp_path / "swallowing.py").write_text(
        "import os, signal\n"
        "try:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    sum(range(10_000))\n"
        "except BaseException:\n"
        "    raise SystemError('<class> returned a result with an exception set')\n"
    )
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from pymc_features import cli\n"
        "cli.NEEDED['init'] = 'swallowing'; sys.exit(cli.command())"
    )
    process = started([sys.executable, "-c", code, "init"])
    assert process.communicate(timeout=60)[1] == "Interrupted.\n"
    assert process.returncode == 130


@pytest.mark.processes
def test_interrupt_while_an_error_is_said():
    code = (
        "import sys\nfrom pymc_features import cli\n"
        "def interrupted(): raise KeyboardInterrupt\n"
        "cli.main = interrupted\nsys.exit(cli.command())"
    )
    process = started([sys.executable, "-c", code])
    assert process.communicate(timeout=60)[1] == "Interrupted.\n"
    assert process.returncode == 130


def test_interrupt_of_a_command_that_keeps_nothing(monkeypatch, capsys):
    def interrupted(options, console):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "init", interrupted)
    assert cli.main(["init", "some.toml"]) == 130
    assert capsys.readouterr().err == "Interrupted.\n"


class Clock:
    """Seconds that pass when they are waited for, up to an end; what else is said at its time."""

    def __init__(self, end, *events):
        self.now, self.end, self.events = 0.0, end, list(events)

    def wait(self, seconds):
        self.now += seconds
        while self.events and self.events[0][0] <= self.now:
            when, act = self.events.pop(0)
            after, self.now = self.now, when
            act()
            self.now = after
        return self.now > self.end

    def set(self):
        self.end = self.now


@pytest.mark.parametrize("terminal", [False, True])
def test_nothing_is_silent_for_long(monkeypatch, terminal):
    """A line for each three seconds of silence, none while something else is said, or there are bars."""
    said = io.StringIO()
    clock = Clock(21.0, (7.0, lambda: alive.now("[0/2] NORM")), (9.0, lambda: alive.heard()))
    monkeypatch.setattr(progress, "monotonic", lambda: clock.now)
    alive = progress.Heartbeat(Console(file=said, force_terminal=terminal), "loading")
    alive.over = clock
    alive._beat()
    later = [] if terminal else [f"[0/2] NORM, for {seconds} s" for seconds in (5, 8, 11, 14)]
    assert said.getvalue().splitlines() == ["loading, for 3 s", "loading, for 6 s", *later]


def test_lines_of_parts_where_there_is_no_terminal_and_one_bar_in_one(monkeypatch):
    """Parts of two seconds: a line at the first, then not before three seconds have passed."""
    clock, said = iter([0.0, *(2.0 * k for k in range(6))]), io.StringIO()
    parts = {"NORM_x0.1": 0, "TN_x0.1": 1, "EXP_x0.1": 2, "ABC_x0.1": 3, "figures": 99, "finished": 100}
    with monkeypatch.context() as patch:
        patch.setattr(progress, "monotonic", lambda: next(clock))
        with progress.PartProgress(Console(file=said), "study", pause=3.0) as update:
            for part, done in parts.items():
                update(part, done, 100)
    lines = ["[0/100] NORM_x0.1", "[2/100] EXP_x0.1, 3 min 16 s left", "[99/100] figures, 0 s left"]
    assert said.getvalue().split("\n")[:3] == lines and not said.getvalue().split("\n", 3)[3].strip()
    said = io.StringIO()
    with progress.PartProgress(Console(file=said, force_terminal=True, width=120), "study") as update:
        for done in range(50):
            update(f"NORM_x{done}", done, 50)
        update("finished", 50, 50)
    assert said.getvalue().count("\n") == 1
    assert "50/50" in said.getvalue() and "finished" in said.getvalue()


@pytest.mark.skipif(shutil.which("bash") is None, reason="the shell is bash")
def test_a_shell_completes_commands_options_and_files(tmp_path):
    """As bash asks for it: the word so far, and those before."""
    (tmp_path / "frame.toml").touch()
    script = tmp_path / "completion.sh"
    command = [sys.executable, "-m", "pymc_features", "--print-completion", "bash"]
    script.write_text(subprocess.run(command, capture_output=True, text=True).stdout)
    for words, expected in (
        (["che"], "check"),
        (["update", "--fo"], "--force"),
        (["check", "fra"], "frame.toml"),
    ):
        asked = (
            f"source {script}; COMP_WORDS=(pymc-features {' '.join(words)}); COMP_CWORD={len(words)}; "
            f"_shtab_pymc_features pymc-features {words[-1]} x; echo ${{COMPREPLY[@]}}"
        )
        done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, cwd=tmp_path)
        assert done.stdout.split() == [expected], done.stderr
