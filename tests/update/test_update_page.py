"""The structures of docs/update.md are those of the package: each is read, and is what the page says."""

import numpy as np
import pytest

from pymc_features.update import read_problem
from pymc_features.update.kinds.model import declare
from support.pages import PAGES, blocks

[PAGE] = [path for path in PAGES if path.name == "update.md"]
EXAMPLES = [text for text in blocks(PAGE, "toml") if text.startswith("[structure]")]
REST = """
sigma = {{ distribution = "HalfNormal", sigma = 0.5 }}

[data]
files = "roof.csv"
units = "m/s^2"
base = "base"
sensors = ["roof"]
dofs = [{dof}]

[likelihood]
kinds = ["EXP"]
sigma = "sigma"
"""


def problem_of(text, folder, dof):
    """The problem of a structure and its priors, with a sensor on one degree of freedom."""
    times = 0.02 * np.arange(100)
    table = np.column_stack([times, np.sin(20.0 * times), np.cos(20.0 * times)])
    np.savetxt(folder / "roof.csv", table, delimiter=",", header="time,base,roof", comments="")
    for code in blocks(PAGE, "python use"):
        exec(compile(code, str(PAGE), "exec"), {})
    path = folder / "page.toml"
    path.write_text(text + REST.format(dof=dof))
    return read_problem(path)


@pytest.mark.filterwarnings("ignore:1 sensor with one sigma")
@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_structures_of_the_page_can_be_updated(tmp_path, monkeypatch, number):
    monkeypatch.chdir(tmp_path)
    problem = problem_of(EXAMPLES[number], tmp_path, dof=0)
    model = declare(problem, "EXP")
    assert {rv.name for rv in model.free_RVs} == set(problem.priors)


def test_modes_of_the_page_can_be_updated(tmp_path):
    [text] = [text for text in blocks(PAGE, "toml") if text.startswith("[modal]")]
    (tmp_path / "modes.csv").write_text("frequency,roof,floor 1,floor 2\n2.6,1,0.3,0.6\n7.1,-0.7,0.7,0.9\n")
    path = tmp_path / "page.toml"
    path.write_text(text)
    problem = read_problem(path)
    model = declare(problem, "MODAL")
    assert {rv.name for rv in model.free_RVs} == set(problem.priors) == {"lower", "upper", "sigma_phi"}
    assert [rv.name for rv in model.observed_RVs] == ["modal"]
    assert problem.modal.data.channels == ("floor 2", "roof")
    assert (problem.modal.dofs, problem.modal.n_modes) == ([1, 3], 4)


def example(word):
    """The one with a word in it."""
    [found] = [text for text in EXAMPLES if word in text]
    return found


def test_groups_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tower = problem_of(example("k_mid"), tmp_path, dof=41).structure(k_low=9e8, k_mid=7e8, zeta=0.02)
    assert tower.stiffness.tolist() == [9e8] * 10 + [7e8] * 20 + [3e8] * 12
    assert tower.mass.tolist() == [5.2e5] * 2 + [4e5] * 40
    assert tower.damping.ratios.tolist() == [0.02] * 3 + [0.05] * 39


@pytest.mark.parametrize("line", [0, 1, 2])
def test_factors_of_the_page(tmp_path, monkeypatch, line):
    """The line that is given, and those that are comments."""
    monkeypatch.chdir(tmp_path)
    lines = example("drawings").splitlines()
    shown = [text.removeprefix("# ") for text in lines if text.removeprefix("# ").startswith("stiffness")]
    first = lines.index(shown[0])
    text = "\n".join([*lines[:first], shown[line], *lines[first + 3 :]])
    if '"upper"' not in shown[line]:
        text = "\n".join(row for row in text.splitlines() if not row.startswith("upper"))
    structure = problem_of(text, tmp_path, dof=4).structure
    chain = structure(**{name: {"lower": 0.8, "upper": 1.2}[name] for name in structure.names})
    factors = [[0.8, 0.8, 1.2, 1.2, 1.2], [0.8] * 5, [0.8, 0.9, 1.0, 1.1, 1.2]][line]
    np.testing.assert_allclose(chain.stiffness, np.array([9e8, 8e8, 8e8, 6e8, 5e8]) * factors)


def test_matrices_of_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    problem = problem_of(example("AffineStructure"), tmp_path, dof=2)
    mass, damping, stiffness = problem.structure(lower=0.9, upper=1.1, tank=0.5, beta=1e-3).matrices()
    np.testing.assert_allclose(mass, np.diag([4.5e5, 4e5, 4e5]))
    expected = [[0.9 * 4 + 1.1 * 3 + 0.5, -1.1 * 3 - 0.5, 0], [-3.8, 1.1 * 5 + 0.5, -2.2], [0, -2.2, 2.2]]
    np.testing.assert_allclose(stiffness, 1e8 * np.array(expected))
    np.testing.assert_allclose(damping, 0.1 * mass + 1e-3 * stiffness)
    assert problem.structure.n_modes == 2
    assert problem.unit("beta") == "s"
    assert "frame.npz_sha256" in problem.settings()
