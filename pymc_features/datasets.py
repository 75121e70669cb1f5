"""Real ground motions, downloaded once and checked, or taken from a local folder."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pymc_features.records import Record

__all__ = ["DatasetUnavailableError", "el_centro"]

#: Name of the environment variable with the folder that is searched before the network.
DATA_VARIABLE = "PYMC_FEATURES_DATA"

_TIMEOUT = 15.0  # [s]
_GRAVITY = 9.81  # [m/s^2] per g, the value of the reference results


class DatasetUnavailableError(OSError):
    """A data set is neither in the local folder nor can it be downloaded."""


@dataclass(frozen=True)
class _Source:
    """A file at a fixed public address."""

    file: str
    url: str
    sha256: str


_SOURCES = {
    "el_centro": _Source(
        file="elcentro.dat",
        url="https://raw.githubusercontent.com/insane-group/interpretable-structural-dynamics/"
        "a63b3e533484f791464aaa1f3354eaca8292c575/data/elcentro.dat",
        sha256="9836d860a6943ae728bed3b52e6dbbf0d4f54fd123f52b54e5980fd6e6c9d0aa",
    ),
}


def el_centro() -> Record:
    """North-south ground acceleration of El Centro, Imperial Valley earthquake, 18 May 1940.

    Digitised by Peknold: 1559 samples, 0.02 s apart, peak 0.31882 g, with g = 9.81 m/s^2.
    The file is looked for in the folder that the environment variable ``PYMC_FEATURES_DATA`` names,
    then in the cache, then downloaded; its SHA-256 is checked in each case.

    Returns
    -------
    Record
        Acceleration (1559,) [m/s^2], dt = 0.02 s.

    Raises
    ------
    DatasetUnavailableError
        If the file is not at hand and cannot be downloaded.
    ValueError
        If the local file is not the published one.

    Notes
    -----
    The last row of the file, a zero beyond the published samples, is left out.

    References
    ----------
    Chopra, A. K., Dynamics of Structures, appendix 6: the same version, in print.
    """
    acceleration = np.loadtxt(_fetch(_SOURCES["el_centro"]), usecols=1, max_rows=1559)
    return Record(_GRAVITY * acceleration, dt=0.02, name="El Centro 1940 NS")


def _fetch(source: _Source) -> Path:
    """Path of the checked file: the local folder first, then the cache, then the network."""
    if folder := os.environ.get(DATA_VARIABLE):
        path = Path(folder) / source.file
        if path.is_file():
            return _checked(path, source)
    return _checked(_download(source), source)


def _checked(path: Path, source: _Source) -> Path:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if digest != source.sha256:
        raise ValueError(
            f"{path} must have the SHA-256 {source.sha256}, got {digest}. "
            f"Replace it by the file from {source.url}."
        )
    return path


def _download(source: _Source) -> Path:
    import pooch  # only here: records made by hand need no network

    try:
        path = pooch.retrieve(
            source.url,
            known_hash=f"sha256:{source.sha256}",
            fname=source.file,
            path=pooch.os_cache("pymc_features"),
            downloader=pooch.HTTPDownloader(timeout=_TIMEOUT),
        )
    except (OSError, ValueError) as error:  # no network, no cache folder, or other bytes
        raise DatasetUnavailableError(
            f"{source.file} could not be downloaded from {source.url} ({error}). Set "
            f"{DATA_VARIABLE} to a folder that holds it, or pass a record file to `read_record`."
        ) from error
    return Path(path)
