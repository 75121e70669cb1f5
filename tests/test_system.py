"""Other systems: what one of them alone has stands in one place; texts, paths, consoles and line ends."""

import ast
import os
import sys

import numpy as np
import pytest

import pymc_features as pmf
from support.commands import ROOT, run

PACKAGE = ROOT / "pymc_features"
#: What Windows, or Linux, lacks: modules, and names of modules or methods.
OF_ONE_SYSTEM = {
    *("fcntl", "grp", "msvcrt", "pwd", "resource", "termios", "winreg", "_winapi"),
    *("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1", "alarm", "pthread_sigmask", "setitimer"),
    *("fork", "forkpty", "getpgid", "getuid", "geteuid", "killpg", "mkfifo", "pread", "pwrite"),
    *("register_at_fork", "sched_getaffinity", "setpgid", "setsid", "statvfs", "sysconf", "uname"),
    *("pass_fds", "preexec_fn", "start_new_session", "creationflags"),
}
TEXTS = {
    "read_text": 0,
    "write_text": 1,
}  # methods of paths, and how many arguments stand before the encoding


def used(tree):
    """Names of modules, attributes and keyword arguments in a file, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", node.lineno
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield node.attr, node.lineno
        elif isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value.lineno
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "/dev/" in node.value:
            yield "/dev/", node.lineno


def of_one_system(tree):
    return [(name, line) for name, line in used(tree) if name in OF_ONE_SYSTEM | {"/dev/"}]


def without_encoding(tree):
    """Lines where a text is read or written in the encoding of the system."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", None)
        is_given = any(keyword.arg == "encoding" for keyword in node.keywords)
        if name in TEXTS and not is_given and len(node.args) <= TEXTS[name]:
            yield node.lineno


def test_calls_of_one_system_stand_in_one_place():
    trees = {path: ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")}
    places = {path.relative_to(PACKAGE).as_posix(): of_one_system(tree) for path, tree in trees.items()}
    assert {name: found for name, found in places.items() if found and name != "system.py"} == {}
    assert {name for name, _ in places["system.py"]} >= {"fcntl", "msvcrt", "killpg", "_winapi"}
    assert of_one_system(ast.parse("os.fork()")) == [("fork", 1)]
    texts = {path.relative_to(PACKAGE).as_posix(): [*without_encoding(tree)] for path, tree in trees.items()}
    assert {name: lines for name, lines in texts.items() if lines} == {}
    assert [*without_encoding(ast.parse("path.write_text(text)"))] == [1]


@pytest.mark.processes
def test_command_in_a_folder_of_any_name_on_a_console_without_utf8(tmp_path):
    """Blanks and umlauts in its path; every sentence comes through, whatever letters the console lacks."""
    folder = tmp_path / "Messung Brücke 1"
    folder.mkdir()
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "PYTHONPATH": str(ROOT)}
    for command in (["init", "--example", "building"], ["check", "update.toml"]):
        run(sys.executable, "-m", "pymc_features", *command, cwd=folder, env=environment)
    assert (folder / "update-check.png").exists()


TABLE = (
    "time [s],base [m/s^2],roof [m/s^2]",
    *(f"{0.01 * k:.2f},{np.sin(k):.4f},{np.cos(k):.4f}" for k in range(40)),
)
AT2 = (
    *("PEER NGA STRONG MOTION DATABASE RECORD", "Imperial Valley, 5/19/1940, El Centro, 180"),
    *("ACCELERATION TIME SERIES IN UNITS OF G", "NPTS=   10, DT=   .0100 SEC"),
    *("  .1000E-02  .2000E-02 -.1000E-02  .3000E-02  .4000E-02",) * 2,
)
MODES = "mode,frequency [Hz],damping [%],base,roof", "1,1.25,2.0,0.4,1.0", "2,3.5,1.5,1.0,-0.6"
FILES = {
    "channels.csv": (TABLE, lambda path: pmf.read_channels(path).values),
    "record.AT2": (AT2, lambda path: pmf.read_record(path).acceleration),
    "modes.csv": (MODES, lambda path: pmf.read_modal(path).shapes),
}


@pytest.mark.parametrize("name", FILES)
def test_line_ends_of_other_systems_are_read_alike(name, tmp_path):
    lines, read = FILES[name]
    found = []
    for folder, end in (("unix", "\n"), ("windows", "\r\n"), ("old mac ü", "\r")):
        path = tmp_path / folder / name
        path.parent.mkdir()
        path.write_bytes((end.join(lines) + end).encode())
        found.append(read(path))
    assert found[0].size >= 4
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
