"""The benchmarks run: their routes agree, and what is not installed is said, not dropped."""

import importlib
import subprocess
import sys
from pathlib import Path

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


@pytest.fixture(scope="module")
def case(benchmarks, record):
    """Four chains under two seconds of the record."""
    from benchmarks.case import build
    from pymc_features import Record

    return build(Record(record.acceleration[:100], record.dt), particles=4, substeps=2)


def test_all_of_them_can_be_imported(benchmarks):
    """But for those of other packages, which ask for these."""
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        if path.name != "__main__.py":
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            try:
                importlib.import_module(name)
            except ModuleNotFoundError as error:
                assert not error.name.startswith(("pymc_features", "benchmarks")), name


@pytest.mark.slow
def test_routes_agree(benchmarks, case):
    """Every route that can run here gives e_j; a wrong one stops the run."""
    evaluation, _ = benchmarks
    calls, errors, missing = evaluation.prepared_routes(case)
    assert len(calls) + len(missing) == len(evaluation.ROUTES) > 5
    assert max(errors.values()) < evaluation.TOLERANCE
    reference = calls["our kernel, one particle at a time"]()
    with pytest.raises(RuntimeError, match="wrong: e_j differ from the scalar kernel's by"):
        evaluation.check("wrong", reference * (1.0 + 1e-8), reference)


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
