"""The example of a building: it is read, its data have no faults, and an update finds what it states."""

import re

import numpy as np
import pytest
import xarray as xr

from pymc_features import cli, datasets, simulate
from pymc_features.update import read_problem, write_example
from support.update_files import replaced

pytestmark = pytest.mark.default_mode
QUICK = [
    ('kinds = ["CAL", "NORM"]', 'kinds = ["CAL"]'),
    ("draws = 1000", "draws = 300"),
    ("chains = 2", "chains = 1"),
    ('quantities = ["inter_storey_drift", "base_shear"]', "quantities = []"),
]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The example, as the command writes it."""
    path = tmp_path_factory.mktemp("building") / "tower.toml"
    assert cli.main(["init", str(path), "--example", "building"]) == 0
    wanted = {"tower.toml", "tower.schema.json", "tower-measured.csv"}
    assert {file.name for file in path.parent.iterdir()} == wanted
    return path


@pytest.fixture(scope="module")
def true(path):
    """What the comment at the top of the file states."""
    [line] = [line for line in path.read_text().splitlines() if line.startswith("#     lower = ")]
    found = {name: float(value) for name, value in re.findall(r"(\w+) = ([\d.]+)", line)}
    assert set(found) == {"lower", "middle", "upper", "zeta"}
    return found


def test_file_is_read_and_is_the_building_that_it_states(path, true):
    """Its structure has, at the true values, its frequencies, and the data but for the noise."""
    problem = read_problem(path)
    structure = problem.structure(**{name: true[name] for name in problem.structure.names})
    assert set(true) == set(problem.priors) - {"sigma"}
    expected = np.repeat([0.8 * 9e8, 0.95 * 7e8, 1.1 * 5e8], [3, 3, 2])
    np.testing.assert_allclose(structure.stiffness, expected)
    frequencies = structure.modes().natural_frequencies[:3]
    np.testing.assert_allclose(problem.config.report.natural_frequencies, frequencies, atol=5e-4)
    measured = np.loadtxt(path.with_name("tower-measured.csv"), delimiter=",", skiprows=1)
    record = datasets.el_centro()
    np.testing.assert_allclose(measured[:, 0], record.time, atol=1e-9)
    exact = simulate(structure, record, sensors=problem.first.dofs).values
    noise = measured[:, 2:].T - exact
    np.testing.assert_allclose(noise.std(axis=1) / exact.std(axis=1), 0.05, rtol=0.1)
    np.testing.assert_allclose((measured[:, 1] - record.acceleration).std(), 0.01, rtol=0.1)
    assert abs(np.corrcoef(noise[:, 1:], noise[:, :-1])[:3, 3:]).max() < 0.1  # white


@pytest.mark.slow
def test_update_finds_the_truth(path, true, tmp_path, capsys):
    """In intervals of a few per mille to per cent, which do not hold the medians of the priors."""
    text = path.read_text().replace('"tower-measured.csv"', f'"{path.with_name("tower-measured.csv")}"')
    quick = tmp_path / "quick.toml"
    quick.write_text(replaced(text, QUICK))
    assert cli.main(["update", str(quick), "--cores", "1", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().err
    assert "The model explains the measurements" in said
    assert "warning" not in said
    expected = {"lower": 1.0, "middle": 1.0, "upper": 1.0, "zeta": np.exp(-3.2)}
    with xr.open_datatree(tmp_path / "out" / "update.nc", engine="h5netcdf") as tree:
        posterior = tree["CAL/posterior"].to_dataset()
        for name, value in true.items():
            least, low, high, most = np.quantile(posterior[name].values, [0.005, 0.05, 0.95, 0.995])
            assert least < value < most, name  # one in a hundred is not
            assert not low < expected[name] < high
            assert high - low < 0.02 * value


def test_refusals(tmp_path, capsys):
    path = tmp_path / "a.toml"
    with pytest.raises(ValueError, match="`example` must be one of shaking-table, building, got 'tower'"):
        write_example(path, example="tower")
    assert cli.main(["init", str(path), "--example", "building", "--synthetic"]) == 2
    assert "`--synthetic` must be left out for the example building" in capsys.readouterr().err
    assert not path.exists()
    path.with_name("a-measured.csv").touch()
    with pytest.raises(FileExistsError, match=r"`CONFIG` must be a new file, got .*a-measured.csv. Choose"):
        write_example(path, example="building")
    assert not path.exists()
