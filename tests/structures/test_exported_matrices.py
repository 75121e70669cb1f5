"""Matrices as finite-element programs export them, made by hand from the vendors' format pages."""

import warnings

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh

import pymc_features as pmf
from support.refusals import refusals

MASS = np.diag([2.0, 1.5, 1.0])
DAMPING = pmf.ModalDamping(0.02)


def frame(factor=1.0):
    """Stiffness of three storeys, the first one times a factor."""
    k = np.array([1000.0 * factor, 1500.0, 1200.0])
    return np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)


def lower(matrix):
    return [(i, j) for i in range(3) for j in range(i + 1) if matrix[i, j]]


def abaqus(path, matrix):
    """*MATRIX OUTPUT, FORMAT=MATRIX INPUT: node, direction, node, direction, value; one half."""
    rows = ["** ASSEMBLED", "*MATRIX INPUT, NAME=FRAME"]
    rows += [f"{10 * (i + 1)}, 1, {10 * (j + 1)}, 1, {matrix[i, j]:.17e}" for i, j in lower(matrix)]
    path.write_text("\n".join(rows) + "\n")


def coordinates(path, matrix):
    """*MATRIX OUTPUT, FORMAT=COORDINATE: both halves."""
    rows = [f"{i + 1} {j + 1} {matrix[i, j]:.17e}" for i, j in zip(*np.nonzero(matrix), strict=True)]
    path.write_text("\n".join(rows) + "\n")


def calculix(path, matrix):
    path.write_text("".join(f"{j + 1} {i + 1} {matrix[i, j]:.17e}\n" for i, j in lower(matrix)))
    path.with_suffix(".dof").write_text("10.1\n20.1\n30.1\n")


def ansys(path, matrix, exponent="D", right_hand_side=True):
    """HBMAT: RSA with right-hand side, and the list of equations."""
    entries = [(i, j) for j in range(3) for i in range(j, 3) if matrix[i, j]]
    starts = [1 + sum(j < column for _, j in entries) for column in range(4)]
    values = [f"{matrix[i, j]:25.15E}".replace("E", exponent) for i, j in entries]
    lines = [f"{'frame':72}{'K':8}", f"{5:14}{1:14}{1:14}{2:14}{int(right_hand_side):14}"]
    lines += [f"{'RSA':14}{3:14}{3:14}{len(entries):14}{0:14}"]
    lines += [f"{'(4I14)':16}{'(8I10)':16}{'(3E25.15)':20}{'(3E25.15)':20}"]
    lines += [f"{'F':14}{1:14}{0:14}"] if right_hand_side else []
    lines += ["".join(f"{k:14}" for k in starts), "".join(f"{i + 1:10}" for i, _ in entries)]
    lines += ["".join(values[:3]), "".join(values[3:])]
    lines += ["".join(f"{k:25.15E}" for k in (1.0, 2.0, 3.0))] if right_hand_side else []
    path.write_text("\n".join(lines) + "\n")
    rows = ["Matrix Eqn   Node   DOF", " 1 10 UX", " 2 20 UX", " 3 30 ROTZ"]
    path.with_suffix(".mapping").write_text("\n".join(rows) + "\n")


NAMED = ["10:x", "20:x", "30:x"]
FORMATS = {
    "abaqus": ("a.mtx", abaqus, NAMED),
    "coordinates": ("a.mtx", coordinates, None),
    "calculix": ("a.sti", calculix, NAMED),
    "ansys": ("a.hb", ansys, ["10:x", "20:x", "30:rz"]),
    "ansys, E": ("a.matrix", lambda p, m: ansys(p, m, "E", False), ["10:x", "20:x", "30:rz"]),
    "table": (
        "a.csv",
        lambda p, m: np.savetxt(p, m, delimiter=",", header="a,b,c", comments=""),
        ["a", "b", "c"],
    ),
    "bare table": ("a.txt", lambda p, m: np.savetxt(p, m), None),
}


@pytest.mark.parametrize("case", FORMATS)
def test_formats(tmp_path, case):
    name, write, labels = FORMATS[case]
    write(tmp_path / name, frame())
    found = pmf.read_matrices(tmp_path / name)
    matrix = found["a"].toarray() if sparse.issparse(found["a"]) else found["a"]
    np.testing.assert_allclose(matrix, frame(), rtol=1e-14)
    assert found.labels == ({} if labels is None else {"a": labels})


def test_nastran(data_dir):
    """Frequencies of the README of these files; text and binary are one matrix."""
    found = pmf.read_matrices(data_dir / "fe" / "dmig.pch")
    assert np.get_printoptions()["legacy"] is False  # pyyeti would change it
    assert found.labels["kaax"][:3] == ["101:x", "102:x", "105:x"]
    values = eigh(found["kaax"], found["maax"], eigvals_only=True)
    frequencies = np.sqrt(np.abs(values[1:6])) / (2.0 * np.pi)
    np.testing.assert_allclose(frequencies, [1.0335, 2.1307, 2.9132, 16.568, 18.169], rtol=2e-4)
    text, binary = (
        pmf.read_matrices(data_dir / "fe" / name)["kgg"]
        for name in ("testplate_kgg_ascii.op4", "testplate_kgg.op4")
    )
    assert np.abs(text - binary).max() < 1e-11 * np.abs(binary).sum()
    found = pmf.read_matrices(data_dir / "fe" / "se_test_n11.op4")
    assert len(found) > 19 and found["kaa"].shape == found["maa"].shape == (105, 105)


BROKEN = {
    "must hold %%MatrixMarket above, or 3 or 5 numbers": ("a.mtx", "1, 2\n"),
    "a.mtx must hold .* 3 or 5 numbers in a line": ("a.mtx", "1,1,1,1,2.0\n1,1,x,1,3.0\n"),
    r"a.sti must hold 3 numbers in a line": ("a.sti", "1 1 2.0\n1 2\n"),
    r"the matrix must be real and assembled, RSA or RUA, got CSA": (
        "a.hb",
        f"title\n{4:14}{1:14}{1:14}{1:14}\n{'CSA':14}{1:14}{1:14}{1:14}{0:14}\n(4I14)\n",
    ),
    "the header must state lines, rows, columns and entries": ("a.hb", "title\n1 2\n3\n"),
}


@refusals("name text", BROKEN)
def test_broken_files(tmp_path, name, text, match):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=match):
        pmf.read_matrices(tmp_path / name)


def exported(folder, factor, name, write=abaqus, suffix=".mtx"):
    path = folder / f"{name}{suffix}"
    write(path, frame(factor))
    return path


@pytest.mark.parametrize(("write", "suffix"), [(abaqus, ".mtx"), (calculix, ".sti"), (ansys, ".hb")])
def test_two_exports_give_the_terms_of_a_parameter(tmp_path, write, suffix):
    base = {"mass": tmp_path / f"m{suffix}", "stiffness": exported(tmp_path, 1.0, "k", write, suffix)}
    write(base["mass"], MASS)
    one, two = (exported(tmp_path, factor, f"k{factor}", write, suffix) for factor in (1.1, 1.4))
    found = pmf.AffineStructure.from_files(base, {"k1": [(one, 1.1), (two, 1.4)]}, damping=DAMPING)
    changed = found.with_parameters({"k1": 0.7})
    np.testing.assert_allclose(changed.stiffness.toarray(), frame(0.7), atol=1e-12 * frame().max())
    assert found.parameter_names == ("k1",) and len(found.dof_names) == 3
    assert abs(changed.modes().natural_frequencies[0] - first_frequency(frame(0.7))) < 1e-9


def first_frequency(stiffness):
    return np.sqrt(eigh(stiffness, MASS, eigvals_only=True)[0]) / (2.0 * np.pi)


def test_directions_and_units(tmp_path):
    """kN, m, t; the ground moves along x only."""
    matrices = {"M": MASS, "K": frame()}
    np.savez(tmp_path / "base.npz", **matrices)
    np.savez(tmp_path / "more.npz", M=MASS, K=frame(2.0))
    terms = {"k1": (tmp_path / "more.npz", 2.0)}
    found = pmf.AffineStructure.from_files(tmp_path / "base.npz", terms, damping=DAMPING, units="kN, m, t")
    np.testing.assert_allclose(np.asarray(found.stiffness), 1e3 * frame())
    np.testing.assert_allclose(np.asarray(found.mass), 1e3 * MASS)
    base = {"mass": tmp_path / "m.hb", "stiffness": exported(tmp_path, 1.0, "k", ansys, ".hb")}
    ansys(base["mass"], MASS)
    terms = {"k1": (exported(tmp_path, 2.0, "k2", ansys, ".hb"), 2.0)}
    found = pmf.AffineStructure.from_files(base, terms, damping=DAMPING, direction="x")
    np.testing.assert_array_equal(found.influence, [1.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="`direction` must be one of x, got .y"):
        pmf.AffineStructure.from_files(base, terms, damping=DAMPING, direction="y")


def test_rows_that_hold_nothing_are_left_out(tmp_path):
    """Of a superelement, and of supports that a program holds by a penalty."""
    stiffness, mass = np.zeros((5, 5)), np.zeros((5, 5))
    stiffness[:3, :3], mass[:3, :3] = frame(), MASS
    stiffness[4, 4] = 1e36
    np.savez(tmp_path / "base.npz", M=mass, K=stiffness)
    stiffness[:3, :3] = frame(2.0)
    np.savez(tmp_path / "more.npz", K=stiffness)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = pmf.AffineStructure.from_files(
            tmp_path / "base.npz", {"k1": (tmp_path / "more.npz", 2.0)}, damping=DAMPING
        )
    assert found.n_dof == 3
    said = " ".join(str(warning.message) for warning in caught)
    assert "without stiffness and mass are left out: 3." in said and "that are held are left out: 4." in said


def terms_of(folder, *pairs):
    np.savez(folder / "base.npz", M=MASS, K=frame())
    return {"k1": [(exported(folder, real, f"k{k}"), told) for k, (real, told) in enumerate(pairs)]}


def test_what_from_files_refuses(tmp_path):
    terms = terms_of(tmp_path, (2.0, 2.0))
    np.savez(tmp_path / "mass.npz", M=MASS)
    make = pmf.AffineStructure.from_files
    with pytest.raises(ValueError, match="`base` must be files with stiffness, got mass"):
        make(tmp_path / "mass.npz", terms, damping=DAMPING)
    with pytest.raises(ValueError, match="`base` must be a file with the stiffness, got base.npz with M, K"):
        make(
            {"mass": tmp_path / "mass.npz", "stiffness": (tmp_path / "base.npz", "S")}, terms, damping=DAMPING
        )
    with pytest.raises(TypeError, match="`terms` must be a mapping"):
        make(tmp_path / "base.npz", {}, damping=DAMPING)
    with pytest.raises(ValueError, match='`units` must be a force, a length and a mass, such as "kN, m, t"'):
        make(tmp_path / "base.npz", terms, damping=DAMPING, units="kN, m")
    np.savez(tmp_path / "small.npz", K=np.eye(2))
    with pytest.raises(ValueError, match="must be of the size of the base, got 2, 3"):
        make(tmp_path / "base.npz", {"k1": (tmp_path / "small.npz", 2.0)}, damping=DAMPING)
    with pytest.raises(ValueError, match="`damping` must be given"):
        make(tmp_path / "base.npz", terms)
