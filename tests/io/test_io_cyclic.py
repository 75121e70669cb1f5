"""Tables of cyclic tests: units, columns, one file or two, and what is refused."""

import numpy as np
import pytest

from pymc_features.io import read_cyclic_test
from support.refusals import refusals

D, F = np.array([0.0, 1.5, -2.5, 4.0]), np.array([0.0, 20.0, -30.0, 35.0])
TABLE = "step,drift [mm],load [kN]\n" + "".join(
    f"{i},{d},{f}\n" for i, (d, f) in enumerate(zip(D, F, strict=True))
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "wall.csv").write_text(TABLE)
    (tmp_path / "bare.txt").write_text("".join(f"{d} {f}\n" for d, f in zip(D, F, strict=True)))
    (tmp_path / "disp.csv").write_text("\n".join(map(str, D)))
    (tmp_path / "force.csv").write_text(",".join(map(str, F)))
    (tmp_path / "three.txt").write_text(TABLE.partition("\n")[2])
    (tmp_path / "short.csv").write_text("1\n2\n3\n")
    return tmp_path


@pytest.mark.parametrize(
    ("files", "settings"),
    [
        ("wall.csv", {"columns": ("drift", "load")}),
        ("wall.csv", {"columns": (1, 2), "units": ("mm", "kN")}),
        ("bare.txt", {"units": (1e-3, 1e3)}),
        (["disp.csv", "force.csv"], {"units": ("mm", "kN"), "wrapped": True}),
    ],
)
def test_units_and_places(folder, files, settings):
    paths = folder / files if isinstance(files, str) else [folder / name for name in files]
    test, force = read_cyclic_test(paths, dt=0.5, **settings)
    np.testing.assert_allclose(test.displacement, 1e-3 * D)
    np.testing.assert_allclose(force.values, [1e3 * F])
    assert force.attrs["units"] == "N" and force["time"].values[-1] == 1.5
    assert test.name == str(np.atleast_1d(files)[0]).split(".")[0]


def test_inches_and_kips(folder):
    test, force = read_cyclic_test(folder / "bare.txt", units=("in", "kip"), skip=1)
    np.testing.assert_allclose([test.displacement[0], force.values[0, 0]], [0.0381, 88964.43230521])


VALUES = {
    "`columns` must be given, three.txt has 3 columns": ("three.txt", {"wrapped": False}),
    "`units` must be given, bare.txt, displacement does not state them": ("bare.txt", {}),
    "`units` must be one of \"N\", .* got 'g'": ("bare.txt", {"units": ("m", "g")}),
    "`columns` must be one of the channels of wall.csv": ("wall.csv", {"columns": ("drift", "nothing")}),
    "`files` must have as many": (["short.csv", "force.csv"], {"units": ("m", "N"), "wrapped": True}),
    "`units` must be two for displacement and force": ("bare.txt", {"units": "mm"}),
}


@refusals("case", VALUES)
def test_refusals(folder, case, match):
    files, settings = case
    paths = folder / files if isinstance(files, str) else [folder / name for name in files]
    with pytest.raises(ValueError, match=match):
        read_cyclic_test(paths, **settings)


LABELLED = {  # header: columns in its order, settings
    "force,displacement": ((F, D), {"units": ("mm", "kN")}),
    "Load [kN],Stroke [mm]": ((F, D), {}),
    "F [kN],u [mm]": ((F, D), {}),
    "time [s],drift (mm),load (kN)": ((np.arange(4.0), D, F), {}),
    "load [kN],temperature [degC],LVDT [mm]": ((F, D, D), {}),
}


@pytest.mark.parametrize("head", LABELLED)
def test_labels_say_which_column_is_which(tmp_path, head):
    columns, settings = LABELLED[head]
    np.savetxt(tmp_path / "wall.csv", np.column_stack(columns), delimiter=",", header=head, comments="")
    test, force = read_cyclic_test(tmp_path / "wall.csv", **settings)
    np.testing.assert_allclose(test.displacement, 1e-3 * D)
    np.testing.assert_allclose(force.values, [1e3 * F])


CONTRADICTIONS = {
    "`units` must be those of the file, wall.csv, displacement states 'mm', got 'cm'": {
        "units": ("cm", "kN")
    },
    "wall.csv, displacement must hold displacements, it states 'kN', a unit of force": {
        "columns": ("load", "drift")
    },
}


@refusals("settings", CONTRADICTIONS)
def test_what_contradicts_the_label(folder, settings, match):
    with pytest.raises(ValueError, match=match):
        read_cyclic_test(folder / "wall.csv", **settings)
