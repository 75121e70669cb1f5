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


@pytest.mark.slow
def test_jax_has_the_likelihood_of_the_posteriors(benchmarks):
    """That of the samplers by JAX is the package's own."""
    from benchmarks.jax_model import log_likelihood
    from benchmarks.problem import Problem

    problem = Problem()
    for theta, sigma in ((1.0, 0.1), (0.8, 0.3)):
        value = float(log_likelihood(problem)(theta, sigma))
        assert abs(value - problem.log_likelihood(theta, sigma)) < 1e-9 * abs(value)


@pytest.mark.slow
def test_other_tools_agree(benchmarks):
    """Those that are installed compute the e_j of the same structures, and not of others."""
    from benchmarks.case import build, record_of_length
    from benchmarks.structures import kernels, population, structures, with_peers

    case, found, absent = build(record_of_length(60), particles=3, n_dof=3), {}, set()
    for name, structure in structures(case).items():
        given = population(structure, case)
        calls, differences, missing = with_peers(name, given)
        found, absent = found | differences, absent | missing
        if name == "coupled damping":
            label = "coupled damping: JAX, matrix exponential and scan"
            other = kernels(population(structures(case)["LinearStructure"], case))["value"]()
            assert abs(calls[label]() / other - 1.0).max() > 1e-3
    rough = {label: own for label, own in found.items() if "OpenSees" in label}
    assert len(found) - len(rough) == 7 - 2 * ("diffrax" in absent)
    assert max(own for label, own in found.items() if label not in rough) < 1e-4
    assert max(rough.values(), default=0.0) < 0.3
    assert absent <= {"diffrax", "openseespy"}


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
