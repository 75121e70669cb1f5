"""The benchmarks run: their routes agree, and what is not installed is said, not dropped."""

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pymc as pm
import pytest
from scipy import stats

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


def test_gradients_and_scores_of_a_normal(benchmarks):
    """What the comparison with other samplers is counted in, and the answers are computed from."""
    from benchmarks.comparison import gradient_cost
    from benchmarks.known.exact import scores

    with pm.Model() as model:
        pm.Normal("y", pm.Normal("x"), 1.0, observed=0.5)
    assert gradient_cost(model, rounds=1) > 0.0
    [found] = [value for value in vars(scores).values() if hasattr(value, "log_likelihood")]
    z = np.array([[0.0], [0.7]])
    density = found(model)
    np.testing.assert_allclose(density.log_likelihood(z), stats.norm(density.parameters(z)[:, 0]).logpdf(0.5))


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


def test_scores(benchmarks):
    """Independent draws are worth their number: R = 200, so that the effective size is known to 10 %."""
    from benchmarks.methods.result import Result
    from benchmarks.scores import score
    from pymc_features.study.exact import ExactPosterior, Marginal

    nodes = np.linspace(-8.0, 8.0, 2001)
    normal = Marginal.on_grid(nodes, np.exp(-0.5 * nodes**2), nodes)
    rng = np.random.default_rng(1)
    runs = [Result(rng.normal(size=100), rng.normal(size=100), 300.0, 0.0) for _ in range(200)]
    found = score(runs, [1.0] * 200, ExactPosterior(normal, normal, (0.0, 0.0), 0.0))
    np.testing.assert_allclose(found.effective, 100.0, rtol=0.4)
    assert found.evaluations == 300.0 and found.draws == found.distinct == 100.0


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


@pytest.fixture(scope="module")
def tolerance_problem(benchmarks):
    """Two stiffness groups, 200 draws asked for."""
    from benchmarks.abc_problem import ToleranceProblem

    return ToleranceProblem(200)


@pytest.mark.slow
def test_region_within_the_tolerance(tolerance_problem):
    """Draws in a box agree with the grid; both kernels give rho; the response has it too."""
    from benchmarks.abc_problem import ACCEPTANCE

    problem, exact = tolerance_problem, tolerance_problem.exact
    half = 5.0 * np.sqrt(np.diag(exact.covariance))
    points = np.random.default_rng(1).uniform(exact.mean - half, exact.mean + half, (20_000, 2))
    rho = problem.rho(points)
    inside = points[rho <= exact.epsilon]
    # 1900 draws inside: more than three standard errors
    np.testing.assert_allclose(len(inside) / len(points) * np.prod(2.0 * half), ACCEPTANCE, rtol=0.08)
    np.testing.assert_allclose((inside.mean(axis=0) - exact.mean) / half, 0.0, atol=0.02)
    assert problem.rho_of_one(points[0]) == pytest.approx(rho[0])
    misfit = problem.response_of_one(points[0]) - problem.measured
    assert np.mean(misfit**2, axis=1).sum() == pytest.approx(rho[0])


def test_methods_at_a_tolerance(benchmarks, tolerance_problem):
    """Ours, rejection, the textbook: all draws are within, and log P is right to what few draws allow."""
    from benchmarks.abc import score
    from benchmarks.methods import ABC_METHODS

    _, posteriors = benchmarks
    assert len(ABC_METHODS) > 8
    for name in list(ABC_METHODS)[:3]:
        result, seconds = posteriors.attempt(ABC_METHODS[name], tolerance_problem, 1)
        assert result is not None, (name, seconds)
        found = score([result], [seconds], tolerance_problem)
        assert found.within == 1.0 and found.distinct > 0.3
        assert abs(found.log_probability_error[0]) < 1.5
        assert found.simulations > 4 * found.draws
        np.testing.assert_allclose(found.bias, 0.0, atol=1.5)


def test_score_at_a_tolerance(benchmarks, tolerance_problem):
    """Independent draws of the exact mean and covariance are worth their number: R = 200, known to 7 %."""
    from benchmarks.abc import score
    from benchmarks.methods import Accepted

    exact, rng = tolerance_problem.exact, np.random.default_rng(1)
    draws = rng.multivariate_normal(exact.mean, exact.covariance, (200, 50))
    found = score([Accepted(points, 500) for points in draws], [2.0, *[1.0] * 199], tolerance_problem)
    np.testing.assert_allclose(found.effective, 50.0, rtol=0.3)
    assert found.distinct == 1.0 and found.first == 2.0 and found.seconds == 1.0
    assert np.isnan(found.log_probability_error).all()
