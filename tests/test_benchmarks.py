"""The benchmarks can be run: what is wrong stops them, and what is not installed is said, not dropped."""

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def benchmarks():
    """The folder beside the package, as a package."""
    sys.path.insert(0, str(ROOT))
    try:
        import benchmarks.evaluation as evaluation
        import benchmarks.posteriors as posteriors
    finally:
        sys.path.remove(str(ROOT))
    return evaluation, posteriors


def test_all_of_them_can_be_imported(benchmarks):
    """But for those of other packages, which ask for these."""
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        if path.name != "__main__.py":
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            try:
                importlib.import_module(name)
            except ModuleNotFoundError as error:
                assert not error.name.startswith(("pymc_features", "benchmarks")), name


def test_a_wrong_route_stops_the_run(benchmarks):
    """All routes are compared whenever the section is run."""
    evaluation, _ = benchmarks
    assert len(evaluation.ROUTES) > 5
    evaluation.check("right", np.ones(3), np.ones(3))
    with pytest.raises(RuntimeError, match="wrong: e_j differ from the scalar kernel's by"):
        evaluation.check("wrong", np.ones(3) * (1.0 + 1e-8), np.ones(3))


def test_command_line_says_what_it_does():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--help"], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert all(word in done.stdout for word in ("--quick", "posteriors", "abc", "dimensions", "targets"))


def test_a_missing_tool_is_reported(benchmarks):
    """Whatever a method raises becomes a line of the table."""
    _, posteriors = benchmarks

    def missing(problem, seed):
        raise ImportError("no module named nothing")

    def broken(problem, seed):
        raise ZeroDivisionError("oh")

    assert posteriors.attempt(missing, None, 1)[1] == ("not installed", "no module named nothing")
    assert posteriors.attempt(broken, None, 1)[1][0] == "failed"
    assert len(posteriors.METHODS) > 10
