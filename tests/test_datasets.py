"""Real records: the local folder, the download and what can go wrong with either."""

import hashlib
import json
import shutil

import numpy as np
import pooch
import pytest
from scipy.io import loadmat
from scipy.linalg import eigh

from pymc_features import Record, datasets
from pymc_features.datasets import el_centro, footbridge, mini_shake_table, rc_column
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.io import read_record
from pymc_features.io.reading.labels import G

FOLDER = "mini_shake_table"
FILE = f"{FOLDER}/flexible_sine1p5hz_base.csv"


@pytest.fixture
def no_download(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("the network must not be touched")

    monkeypatch.setattr(pooch, "retrieve", refuse)


@pytest.fixture
def no_folder(monkeypatch):
    monkeypatch.delenv("PYMC_FEATURES_DATA", raising=False)


def test_el_centro_comes_with_the_package(no_download, no_folder):
    record = el_centro()
    assert (record.n_times, record.dt, record.name) == (1559, 0.02, "El Centro 1940 NS")
    assert record.pga == pytest.approx(0.31882 * 9.81, rel=1e-14)
    assert record.duration == pytest.approx(31.16)
    digest = hashlib.sha256(datasets._EL_CENTRO.read_bytes()).hexdigest()
    assert digest == "9836d860a6943ae728bed3b52e6dbbf0d4f54fd123f52b54e5980fd6e6c9d0aa"  # as published


def test_el_centro_equals_the_file_without_its_last_row():
    whole = read_record(datasets._EL_CENTRO, units="g")
    assert whole.n_times == 1560
    assert whole.acceleration[-1] == 0.0
    np.testing.assert_array_equal(el_centro().acceleration, whole.acceleration[:-1])
    assert datasets._GRAVITY == G


def test_el_centro_is_the_excitation_of_the_reference_results(no_download, reference_dir):
    reference = np.loadtxt(
        reference_dir / "exact_10dof_elcentro_absacc.csv", delimiter=",", skiprows=1, usecols=1
    )
    np.testing.assert_allclose(el_centro().acceleration, reference, rtol=1e-14, atol=1e-14)


def test_wrong_local_file(tmp_path, monkeypatch):
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FILE).write_text("time,acceleration\n")
    monkeypatch.setenv("PYMC_FEATURES_DATA", str(tmp_path))
    with pytest.raises(ValueError, match="flexible_sine1p5hz_base.csv must have the SHA-256 ab0002.*Replace"):
        mini_shake_table("sine1p5")


@pytest.mark.parametrize("empty_folder", [True, False])
def test_download(no_folder, data_dir, tmp_path, monkeypatch, empty_folder):
    if empty_folder:
        monkeypatch.setenv("PYMC_FEATURES_DATA", str(tmp_path))
    calls = []

    def retrieve(url, **options):
        calls.append((url, options))
        return str(data_dir / options["fname"])

    monkeypatch.setattr(pooch, "retrieve", retrieve)
    assert mini_shake_table("sine1p5").sizes["sensor"] == len(calls) == 4
    _, options = calls[0]
    assert options["known_hash"] == (
        "sha256:ab0002eea09f13086d5024e0340771624a17cf9f3f7b7e21bfe38d59016ce165"
    )
    assert options["path"] == pooch.os_cache("pymc_features")
    assert options["downloader"].kwargs == {"timeout": 15.0}


@pytest.fixture
def cache(no_folder, tmp_path, monkeypatch):
    """The real `pooch.retrieve` on a cache of our own."""
    monkeypatch.setattr(pooch, "os_cache", lambda project: tmp_path / project)
    return tmp_path / "pymc_features"


def serve(monkeypatch, action):
    calls = []

    def download(self, url, output_file, pooch_instance, **_):
        calls.append(url)
        return action(output_file)

    monkeypatch.setattr(pooch.HTTPDownloader, "__call__", download)
    return calls


def no_answer(target):
    raise ConnectionError("no route to host")


def other_bytes(target):
    with open(target, "w") as file:
        file.write("<html>please log in</html>")


@pytest.mark.parametrize(("action", "reason"), [(no_answer, "no route to host"), (other_bytes, "hash")])
def test_failed_download(cache, monkeypatch, action, reason):
    calls = serve(monkeypatch, action)
    message = (
        f"flexible_sine1p5hz_base.csv could not be downloaded.*{reason}.*Set PYMC_FEATURES_DATA to a folder "
        "that holds it, or pass measured channels to `read_channels`"
    )
    with pytest.raises(DatasetUnavailableError, match=f"(?s){message}") as caught:
        mini_shake_table("sine1p5")
    assert isinstance(caught.value, OSError)
    assert len(calls) == 1  # no retries
    assert not (cache / FILE).exists()


LEVELS = ["base", "floor1", "floor2", "floor3"]
EVENTS = [("northridge", "northridge", 12116, 7.878), ("sine1p5", "sine1p5hz", 7307, 6.652)]


@pytest.mark.parametrize(("event", "file", "n_times", "pga"), EVENTS)
def test_mini_shake_table(no_download, data_dir, recwarn, event, file, n_times, pga):
    channels = mini_shake_table(event)
    assert not recwarn.list
    assert list(channels["sensor"].values) == LEVELS
    assert channels.sizes["time"] == n_times
    assert (channels.attrs["units"], channels.attrs["event"]) == ("m/s^2", event)
    for level in LEVELS:
        path = data_dir / "mini_shake_table" / f"flexible_{file}_{level}.csv"
        column = np.loadtxt(path, delimiter=",", skiprows=9, usecols=5)  # without the empty packet
        np.testing.assert_array_equal(channels.sel(sensor=level).values, column)
    base = Record.from_channel(channels, "base")
    assert (base.dt, base.name) == (0.008333, "base")
    assert base.pga == pytest.approx(pga, abs=1e-3)


def test_mini_shake_table_is_downloaded_once(cache, data_dir, monkeypatch):
    def copy(target):
        shutil.copyfile(
            data_dir / "mini_shake_table" / f"flexible_sine1p5hz_{LEVELS[len(calls) - 1]}.csv", target
        )

    calls = serve(monkeypatch, copy)
    first, second = mini_shake_table("sine1p5"), mini_shake_table("sine1p5")
    assert len(calls) == 4
    np.testing.assert_array_equal(first.values, second.values)
    folder = (
        "https://raw.githubusercontent.com/STAIRlab/mdof/c8c0f8c8b773d11acd72d141842d4fd8150b6167/notebooks/"
    )
    folder += "uploads/mini_shake_table/Flexible%20vs.%20Stiff/Flexible%203%20story/"
    assert calls[0] == f"{folder}Ground%20Floor/(Sine%201.5)Xsens%20DOT_20250306_121949.csv"
    assert calls[2] == f"{folder}2nd%20Floor/(Sine%201.5)left%20leg_20250306_121949.csv"
    assert calls[3] == f"{folder}3rd%20Floor%20(Top%20floor)/(Sine%201.5)Xsens%20DOT_20250306_121949.csv"


# --- footbridge ---------------------------------------------------------------------------------

BRIDGE = "modal/footbridge"


@pytest.fixture(scope="module")
def published(reference_dir):
    return json.loads((reference_dir / "modal_published.json").read_text())["footbridge"]


def test_footbridge(no_download, data_dir, recwarn, published):
    """Modes beside SciPy's reader, and beside what was published of them."""
    bridge = footbridge()
    assert not recwarn.list
    theirs = loadmat(data_dir / BRIDGE / "ExpModeInfo_FEM.mat")
    np.testing.assert_array_equal(bridge.modal.shapes, theirs["psiExp_m"].T)
    np.testing.assert_array_equal(bridge.modal.shape_sd, theirs["std_psiExp"].T)
    np.testing.assert_allclose(bridge.modal.frequencies, np.sqrt(theirs["lambdaExp"].ravel()) / (2.0 * np.pi))
    np.testing.assert_allclose(bridge.modal.frequencies, published["frequencies_hz"], rtol=1e-12)
    np.testing.assert_allclose(bridge.modal.frequency_sd, published["sd_hz"], rtol=1e-12)
    np.testing.assert_array_equal((bridge.modal.shapes == 1.0).sum(axis=1), 1)
    assert (bridge.modal.shape_sd[bridge.modal.shapes == 1.0] < 1e-15).all()
    matrices = loadmat(data_dir / BRIDGE / "SteelPedestrianBridgeExp.mat")
    np.testing.assert_array_equal(bridge.measured, matrices["measDOFs"].ravel() - 1)
    assert bridge.modal.channels == tuple(f"dof {k}" for k in bridge.measured)
    assert list(bridge.stiffness_parts) == published["parameters"]
    assert bridge.mass.shape == (946, 946)
    assert (bridge.mass.diagonal() == 0.0).sum() == 474


def nominal_modes(bridge, alpha):
    """Frequencies [Hz] and shapes (dof, mode) of the finite elements, those without mass condensed."""
    stiffness = sum((1.0 + a) * part for a, part in zip(alpha, bridge.stiffness_parts.values(), strict=True))
    stiffness, mass = stiffness.toarray(), bridge.mass.diagonal()
    kept, without = np.flatnonzero(mass > 0.0), np.flatnonzero(mass == 0.0)
    recovery = -np.linalg.solve(stiffness[np.ix_(without, without)], stiffness[np.ix_(without, kept)])
    condensed = stiffness[np.ix_(kept, kept)] + stiffness[np.ix_(kept, without)] @ recovery
    squares, shapes = eigh(0.5 * (condensed + condensed.T), np.diag(mass[kept]), subset_by_index=[0, 7])
    whole = np.empty((mass.size, squares.size))
    whole[kept], whole[without] = shapes, recovery @ shapes
    return np.sqrt(squares) / (2.0 * np.pi), whole


def test_finite_elements_of_the_footbridge(no_download, published):
    """Their frequencies and modal assurance criteria are the published ones, nominal and updated."""
    bridge = footbridge()
    for alpha, expected, order in (
        (np.zeros(17), published["nominal"], published["nominal"]["best_match"]),
        (published["published_optimum_mac"]["alpha"], published["published_optimum_mac"], range(5)),
    ):
        frequencies, shapes = nominal_modes(bridge, alpha)
        n = len(expected["frequencies_hz"])
        np.testing.assert_allclose(frequencies[:n], expected["frequencies_hz"], rtol=1e-8)
        a, b = bridge.modal.shapes, shapes[bridge.measured].T[list(order)]
        mac = (a * b).sum(axis=1) ** 2 / (a**2).sum(axis=1) / (b**2).sum(axis=1)
        np.testing.assert_allclose(mac, expected["mac"], rtol=1e-7)


def test_a_footbridge_of_other_bytes(tmp_path, monkeypatch):
    (tmp_path / BRIDGE).mkdir(parents=True)
    (tmp_path / BRIDGE / "ExpModeInfo_FEM.mat").write_bytes(b"MATLAB 5.0 MAT-file")
    monkeypatch.setenv("PYMC_FEATURES_DATA", str(tmp_path))
    with pytest.raises(
        ValueError, match="ExpModeInfo_FEM.mat must have the SHA-256 c185a0ff.*Replace it by the file"
    ):
        footbridge()


# --- column -------------------------------------------------------------------------------------


def test_column(no_download, data_dir):
    """The published numbers in SI units."""
    if not (data_dir / "rc_column").is_dir():
        pytest.skip("the loops of the column are not there")
    column = rc_column()
    assert dict(column.sizes) == {"step": 548}
    assert column["force"].values[:3].tolist() == [0.0, 32470.0, 58731.0]
    assert float(column["displacement"].max()) == pytest.approx(0.078, abs=0.001)
