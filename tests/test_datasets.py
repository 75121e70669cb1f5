"""Real records: the local folder, the download and what can go wrong with either."""

import shutil

import numpy as np
import pooch
import pytest

from pymc_features import datasets
from pymc_features.datasets import DatasetUnavailableError, el_centro
from pymc_features.io import read_record
from pymc_features.io.units import G

FILE = "elcentro.dat"


@pytest.fixture
def no_download(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("the network must not be touched")

    monkeypatch.setattr(pooch, "retrieve", refuse)


@pytest.fixture
def no_folder(monkeypatch):
    monkeypatch.delenv("PYMC_FEATURES_DATA", raising=False)


def test_el_centro_from_the_folder(no_download, data_dir):
    record = el_centro()
    assert (record.n_times, record.dt, record.name) == (1559, 0.02, "El Centro 1940 NS")
    assert record.pga == pytest.approx(0.31882 * 9.81, rel=1e-14)
    assert record.duration == pytest.approx(31.16)


def test_el_centro_equals_the_file_without_its_last_row(no_download, data_dir):
    whole = read_record(data_dir / FILE, units="g")
    assert whole.n_times == 1560
    assert whole.acceleration[-1] == 0.0
    np.testing.assert_array_equal(el_centro().acceleration, whole.acceleration[:-1])
    assert datasets._GRAVITY == G


def test_el_centro_is_the_excitation_of_the_reference_results(no_download, reference_dir):
    reference = np.loadtxt(
        reference_dir / "exact_10dof_elcentro_absacc.csv", delimiter=",", skiprows=1, usecols=1
    )
    np.testing.assert_allclose(el_centro().acceleration, reference, rtol=1e-14, atol=1e-14)


def test_wrong_local_file(no_download, data_dir, tmp_path, monkeypatch):
    content = (data_dir / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(content.replace(b"\r\n", b"\n"))
    monkeypatch.setenv("PYMC_FEATURES_DATA", str(tmp_path))
    with pytest.raises(ValueError, match="elcentro.dat must have the SHA-256 9836d860.*Replace it by"):
        el_centro()


@pytest.mark.parametrize("empty_folder", [True, False])
def test_download(no_folder, data_dir, tmp_path, monkeypatch, empty_folder):
    if empty_folder:
        monkeypatch.setenv("PYMC_FEATURES_DATA", str(tmp_path))
    calls = []

    def retrieve(url, **options):
        calls.append((url, options))
        return str(data_dir / FILE)

    monkeypatch.setattr(pooch, "retrieve", retrieve)
    assert el_centro().n_times == 1559
    [(url, options)] = calls
    assert url == (
        "https://raw.githubusercontent.com/insane-group/interpretable-structural-dynamics/"
        "a63b3e533484f791464aaa1f3354eaca8292c575/data/elcentro.dat"
    )
    assert options["known_hash"] == (
        "sha256:9836d860a6943ae728bed3b52e6dbbf0d4f54fd123f52b54e5980fd6e6c9d0aa"
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


def test_download_is_cached(cache, data_dir, monkeypatch):
    calls = serve(monkeypatch, lambda target: shutil.copyfile(data_dir / FILE, target))
    first, second = el_centro(), el_centro()
    assert len(calls) == 1
    assert (cache / FILE).is_file()
    np.testing.assert_array_equal(first.acceleration, second.acceleration)


def no_answer(target):
    raise ConnectionError("no route to host")


def other_bytes(target):
    with open(target, "w") as file:
        file.write("<html>please log in</html>")


@pytest.mark.parametrize(("action", "reason"), [(no_answer, "no route to host"), (other_bytes, "hash")])
def test_failed_download(cache, monkeypatch, action, reason):
    calls = serve(monkeypatch, action)
    message = (
        f"elcentro.dat could not be downloaded.*{reason}.*Set PYMC_FEATURES_DATA to a folder that "
        "holds it, or pass a record file to `read_record`"
    )
    with pytest.raises(DatasetUnavailableError, match=f"(?s){message}") as caught:
        el_centro()
    assert isinstance(caught.value, OSError)
    assert len(calls) == 1  # no retries
    assert not (cache / FILE).exists()
