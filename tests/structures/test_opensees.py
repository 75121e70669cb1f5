"""Models in OpenSees as structures, beside what it answers, or answered where it is not installed."""

import sys
from functools import partial

import numpy as np
import pymc as pm
import pytest
from scipy import sparse

import pymc_features as pmf
from pymc_features import AffineStructure, ModalDamping, RayleighDamping, simulate
from support import opensees
from support.commands import ROOT
from support.opensees import ALPHA, BETA, CHANGED, NOMINAL, building, shaking, tied_frame
from support.pages import blocks
from support.structures import peak_error

DAMPED = partial(building, damped=True)
DIRECTIONS = dict(zip(range(1, 7), ("x", "y", "z", "rx", "ry", "rz"), strict=True))
WATCHED = [f"{node}:{DIRECTIONS[i]}" for node, i in opensees.WATCHED]


@pytest.fixture(autouse=True)
def program(monkeypatch):
    """OpenSees, or its answers."""
    opensees.install(monkeypatch)


def frame(**settings):
    return AffineStructure.from_opensees(building, NOMINAL, **{"damping": ModalDamping(0.02)} | settings)


def test_frequencies_are_those_of_opensees():
    expected = opensees.answered("frequencies", opensees.frequencies_of_the_building)
    structure = frame().with_parameters(CHANGED)
    assert (structure.n_dof, structure.n_modes) == (45, 9)  # 36 rotations and deflections have no mass
    np.testing.assert_allclose(structure.modes().angular_frequencies, expected, rtol=1e-9)


@pytest.mark.parametrize("damping", [None, RayleighDamping(ALPHA, BETA)], ids=["read", "given"])
def test_histories_are_those_of_opensees(damping):
    """Of masters, of corners that follow them, and of rotations and deflections without mass."""
    expected = opensees.answered("history", opensees.history_of_the_building)
    structure = AffineStructure.from_opensees(DAMPED, NOMINAL, damping=damping).with_parameters(CHANGED)
    found = simulate(structure, shaking(), sensors=WATCHED, quantity="relative_acceleration")
    assert found["sensor"].values.tolist() == WATCHED
    assert abs(expected).max(axis=1).min() > 1e-3 * abs(expected).max()  # each has something to compare
    for name, row, other in zip(WATCHED, found.values, expected, strict=True):
        assert peak_error(row, other) < 1e-3, name


def test_absolute_acceleration_of_what_follows():
    """With the ground in its own direction, without it across and in rotation."""
    structure, record = frame(), shaking()
    absolute = simulate(structure, record, sensors=["31:x", "31:y", "39:rz"]).values
    relative = simulate(
        structure, record, sensors=["31:x", "31:y", "39:rz"], quantity="relative_acceleration"
    ).values
    np.testing.assert_allclose(absolute[0], relative[0] + record.acceleration, atol=1e-12)
    np.testing.assert_allclose(absolute[1:], relative[1:], atol=1e-12)
    along = simulate(frame(direction="y"), record, sensors="31:y").values
    assert peak_error(along, absolute[:1]) > 0.1


def test_example_of_the_page():
    """Whose beam does not stretch: both corners move alike."""
    (code,) = (b for b in blocks(ROOT / "docs" / "structures.md", "python no-run") if "from_opensees" in b)
    names = {"pmf": pmf, "pm": pm, "np": np, "record": shaking()}
    exec(code, names)
    left, right, up = names["acceleration"].eval({names["columns"]: 30e9})
    np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-12)
    assert 0.0 < abs(up).max() < 0.1 * abs(left).max()


def test_the_page_for_those_who_know_opensees():
    """What it asserts holds, of another record than on the page."""
    (code,) = blocks(ROOT / "docs" / "coming_from.md", "python needs=openseespy")
    exec(
        code.replace("chains=2", "chains=1, cores=1, progressbar=False"),
        {"pmf": pmf, "pm": pm, "np": np, "record": shaking()},
    )


def test_two_directions_are_two_supports():
    structure = frame(direction=("x", "y"))
    assert structure.n_supports == 2
    np.testing.assert_allclose(structure.inertia().sum(axis=1), [3 * NOMINAL["mass"]] * 2)


def test_plane_frame_with_a_tie():
    expected = opensees.answered("frequencies of the frame", opensees.frequencies_of_the_frame)
    structure = AffineStructure.from_opensees(
        tied_frame, {"stiffness": 2e7, "mass": 500.0}, damping=ModalDamping(0.02)
    ).with_parameters({"stiffness": 3e7, "mass": 800.0})
    np.testing.assert_allclose(structure.modes().angular_frequencies, expected, rtol=1e-9)
    assert structure.dof_names == ("2:rz", "3:x", "3:y", "3:rz", "4:y", "4:rz")
    np.testing.assert_array_equal(structure.rows_named(["4:x"]), [[0, 1, 0, 0, 0, 0]])


def test_models_by_name():
    """Of sensors one of which only follows."""
    structure, record, sensors = frame(), shaking(), ["19:x", "31:x", "39:y"]
    changed = NOMINAL | {"columns": 24e9}
    with pm.Model():
        columns = pm.Uniform("columns", 15e9, 45e9)
        mu = pmf.response(structure.with_parameters(NOMINAL | {"columns": columns}), record, sensors=sensors)
    expected = simulate(structure.with_parameters(changed), record, sensors=sensors)
    assert peak_error(mu.eval({columns: 24e9}), expected) < 1e-10
    shapes = pmf.modes(structure, 2, sensors=sensors).shapes.eval()
    rows = structure.rows_named(sensors)
    np.testing.assert_allclose(shapes, (rows @ structure.modes(2).mode_shapes).T, atol=1e-12)


def test_large_models_are_sparse(monkeypatch):
    expected = frame().modes(4).angular_frequencies
    monkeypatch.setattr("pymc_features.structures.terms.MOST_DENSE", 44)
    structure = frame()
    assert sparse.issparse(structure.stiffness) and structure.stiffness.nnz < 45 * 45 / 3
    np.testing.assert_allclose(structure.modes(4).angular_frequencies, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "build, settings, message",
    [
        (partial(building, loose=True), {}, r"neither at 19:z, 19:rx, 19:ry, .* Hold them by `fix`"),
        (building, {"damping": None}, "`damping` must be given if the model has none"),
        (building, {"direction": "rz"}, "`direction` must be one of x, y, z, got 'rz'"),
        (building, {"direction": 1}, "`direction` must be x, y, z or several of them"),
        (tied_frame, {}, "`build` must be a function of columns, beams, mass, as in `parameters`"),
        (lambda columns, beams, mass: None, {}, "`build` must be a function that makes a model in OpenSees"),
    ],
    ids=["loose", "undamped", "rotation", "number", "other names", "no model"],
)
def test_refusals(build, settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        AffineStructure.from_opensees(build, NOMINAL, **{"damping": ModalDamping(0.02)} | settings)


def test_names_that_are_none():
    with pytest.raises(ValueError, match="`sensors` must be free to move, got '1:x'. It moves with the base"):
        simulate(frame(), shaking(), sensors=["1:x"])


def test_without_opensees(monkeypatch):
    monkeypatch.setitem(sys.modules, "openseespy", None)
    with pytest.raises(ImportError, match="needs OpenSeesPy, .*pip install openseespy"):
        frame()
