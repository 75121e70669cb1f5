"""Real ground motions and measurements, some of which are downloaded once and checked."""

import hashlib
import os
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
import xarray as xr
from scipy import sparse
from scipy.io import loadmat

from pymc_features._checks import check_choice
from pymc_features.exceptions import DatasetUnavailableError
from pymc_features.io import read_channels
from pymc_features.modal import ModalData
from pymc_features.modal.files import read_modal
from pymc_features.records import Record

__all__ = ["Footbridge", "el_centro", "footbridge", "mini_shake_table", "rc_column"]
__dir__ = __all__.copy

#: Name of the environment variable with the folder that is searched before the network.
DATA_VARIABLE = "PYMC_FEATURES_DATA"

_TIMEOUT = 15.0  # [s]
_GRAVITY = 9.81  # [m/s^2] per g, the value of the reference results
_EL_CENTRO = Path(__file__).parent / "data" / "elcentro.dat"


_SHAKE_TABLE = (
    "https://raw.githubusercontent.com/STAIRlab/mdof/c8c0f8c8b773d11acd72d141842d4fd8150b6167/"
    + quote("notebooks/uploads/mini_shake_table/Flexible vs. Stiff/Flexible 3 story/")
)
_LEVELS = {
    "base": "Ground Floor/({})Xsens DOT_{}.csv",
    "floor1": "1st Floor/({})Xsens DOT_{}.csv",
    "floor2": "2nd Floor/({})left leg_{}.csv",
    "floor3": "3rd Floor (Top floor)/({})Xsens DOT_{}.csv",
}
# event: name of the local files, name and time in the published ones, SHA-256 from the base up
_EVENTS = {
    "northridge": (
        "northridge",
        ("Northridge", "20250306_122607"),
        (
            "d38c0442e1836535852f2b45217af3486615714e7742f26feaa0b2ff3d9e52a9",
            "3086df1825be77215bb5344ee76bb6ad55afac815871bc6845c122749fec07a1",
            "26f8cc9dac2d1afd7923b8dd41992b33ae2922b8cdcc5943d1a4b034a30ae424",
            "a3f9fa56a402b0177f89dc88236f37b85a474cb92f72e04ce9c01f71fe914c07",
        ),
    ),
    "sine1p5": (
        "sine1p5hz",
        ("Sine 1.5", "20250306_121949"),
        (
            "ab0002eea09f13086d5024e0340771624a17cf9f3f7b7e21bfe38d59016ce165",
            "4462d46f87f0794f65cbbb76909abcd9e2304f5f7f3ce81ffe05a8fe11870797",
            "d8ee143acdb5ec7d586f9bdb32ceb3de7ff692af76105f6da6e324a5eec67b8a",
            "9c384a59016c35e6867c6f596e731b63a438619f4c82fff47381aed9444d1b65",
        ),
    ),
}

_BRIDGE = "https://raw.githubusercontent.com/ywang-structures/Structural-Model-Updating/79ee420aa5c51b6ab0ca77ba5abbb35a4ea772c4/Examples/SteelPedestrianBridge/Experiment/Experiment_Model_Updating/"
_BRIDGE_FILES = {
    "ExpModeInfo_FEM.mat": "c185a0ff1473d8ccf1dd93062df9e469df328de4c4832ecb8061cc4f2f21be82",
    "SteelPedestrianBridgeExp.mat": "eed1274c9fd2b89ba5f9da7c67548e4a48e25321288880aa7951de2c95be84af",
}
_BRIDGE_PARTS = (
    "K_Frame",
    "K_Truss",
    *(f"K_Conc{k}" for k in range(1, 12)),
    "K_y1",
    "K_z1",
    "K_y2",
    "K_z2",
)

_COLUMN = "https://raw.githubusercontent.com/NHERI-SimCenter/quoFEM/{}/Examples/qfem-0034/src/{}"
_COLUMN_COMMITS = "8cc8c98792dcb02efd8f276c884f4733cf55ce93", "1b7db1552be0daae95460df72147f49fff66442d"
_COLUMN_FILES = {
    "experimentDisp.csv": "02b1df7f2235a6f40df96cd4ffca3681edf9c0e6f1c7f9c23f4b7a6eeb59bea3",
    "experimentForce.csv": "cd597dc05b2e89777e0ed6b75a10adc3902c6f906fd5e7b6a1d126f4ed70b13b",
}


def el_centro() -> Record:
    """North-south ground acceleration of El Centro, Imperial Valley earthquake, 18 May 1940.

    Digitised by Peknold: 1559 samples, 0.02 s apart, peak 0.31882 g, with g = 9.81 m/s^2. It comes with the
    package.

    Returns
    -------
    Record
        Acceleration (1559,) [m/s^2], dt = 0.02 s.

    Notes
    -----
    The last row of the file, a zero beyond the published samples, is left out.

    References
    ----------
    Chopra, A. K., Dynamics of Structures, appendix 6: the same version, in print. The file is that of
    https://github.com/insane-group/interpretable-structural-dynamics (Apache-2.0), data/elcentro.dat.
    """
    acceleration = np.loadtxt(_EL_CENTRO, usecols=1, max_rows=1559)
    return Record(_GRAVITY * acceleration, dt=0.02, name="El Centro 1940 NS", interpolation="linear")


def mini_shake_table(event: str) -> xr.DataArray:
    """Accelerations of a three-storey model on a shaking table, as its sensors measured them.

    A flexible steel-wall model (University of California, Berkeley, 6 March 2025), one wireless sensor on the
    table and on each floor. Looked for in ``PYMC_FEATURES_DATA/mini_shake_table``, the cache, and the
    network, and checked by SHA-256.

    Parameters
    ----------
    event : str
        "northridge", a scaled ground motion from 10.3 to 62.2 s, or "sine1p5", a sine of 1.5 Hz from 16.0
        to 48.2 s. Before it the model is still, but for 0.03 m/s^2 rms on floor3 before northridge; after it
        the model vibrates freely.

    Returns
    -------
    xarray.DataArray (sensor, time)
        Absolute acceleration [m/s^2] in the direction of shaking: sensors base, floor1, floor2, floor3;
        12116 or 7307 samples 0.008333 s apart, by the sensors' clocks.

    Raises
    ------
    DatasetUnavailableError
        If a file is not at hand and cannot be downloaded.
    ValueError
        If there is no such event, or a local file is not the published one.

    Notes
    -----
    As measured, but for the empty first packet. Each sensor has an offset of -0.05 to 0.22 m/s^2 (tilt);
    noise 0.010 to 0.012 m/s^2 rms. No channel is inverted; floor3 comes 2 ms after the base, a quarter sample
    (`signals.check_channels`). Lumped floor masses 0.1601, 0.1601, 0.1421 kg: weighed blocks and sensors, and
    the share of two walls. Natural frequencies near 3.7, 11.2 and 16.7 Hz.

    References
    ----------
    STAIRlab, mdof, https://github.com/STAIRlab/mdof, BSD-2-Clause.
    """
    local, names, digests = _EVENTS[check_choice(event, "event", _EVENTS)]
    paths = {}
    for (level, there), digest in zip(_LEVELS.items(), digests, strict=True):
        file = f"mini_shake_table/flexible_{local}_{level}.csv"
        paths[level] = _fetch(file, _SHAKE_TABLE + quote(there.format(*names), safe="/()"), digest)
    channels = read_channels(paths, columns="Acc_X", units="m/s^2", skip=1)
    return channels.assign_attrs(event=event)


class Footbridge(NamedTuple):
    """A measured bridge and its finite elements.

    Attributes
    ----------
    modal : ModalData
        Five modes at 58 channels, with standard deviations; a channel is called after its degree of freedom,
        ``dof 12`` for example.
    mass : csc_array (946, 946)
        Diagonal; zero for 474 degrees of freedom.
    stiffness_parts : dict of str to csc_array (946, 946)
        Steel frame and truss, eleven segments of the deck, and springs at the supports: the stiffness is
        sum_i (1 + alpha_i) K_i, nominally with alpha = 0.
    measured : ndarray (58,)
        Degree of freedom of each channel, from 0.
    """

    modal: ModalData
    mass: sparse.csc_array
    stiffness_parts: dict[str, sparse.csc_array]
    measured: np.ndarray


def footbridge() -> Footbridge:
    """Measured modes and finite elements of a steel pedestrian bridge with a concrete deck.

    On the campus of the Georgia Institute of Technology. Looked for in
    ``PYMC_FEATURES_DATA/modal/footbridge``, the cache, and the network, and checked by SHA-256. The files are
    under the GPL-3 of their authors and do not come with the package.

    Returns
    -------
    Footbridge
        Modes between 4.06 and 11.50 Hz, as means of 7 to 16 identifications each. The matrices are not in SI
        units, but in kips and inches by their size; angular frequencies are in rad/s.

    Raises
    ------
    DatasetUnavailableError
        If a file is not at hand and cannot be downloaded.
    ValueError
        If a local file is not the published one.

    Notes
    -----
    Each mode shape is 1 at one channel, where its standard deviation is 0. The first two nominal modes are
    swapped against the measured ones: the lowest measured mode is the second of the model.

    References
    ----------
    Dong, X. and Wang, Y., Formulation and optimization algorithm comparison for the FE model updating of
    large-scale models, and https://github.com/ywang-structures/Structural-Model-Updating (GPL-3).
    """
    modes, matrices = (
        _fetch(f"modal/footbridge/{file}", _BRIDGE + file, digest) for file, digest in _BRIDGE_FILES.items()
    )
    found = loadmat(matrices)  # not by `read_matrices`: dense zeros, a hundred times the size of the file
    measured = found["measDOFs"].astype(np.int64).ravel() - 1
    modal = read_modal(
        modes,
        names={
            "eigenvalue": "lambdaExp",
            "eigenvalue_sd": "std_lambdaExp",
            "shapes": "psiExp_m",
            "shape_sd": "std_psiExp",
        },
        channels=[f"dof {k}" for k in measured],
    )
    parts = {name: sparse.csc_array(found[name].astype(np.float64)) for name in _BRIDGE_PARTS}
    return Footbridge(modal, sparse.csc_array(found["M0"]), parts, measured)


def rc_column() -> xr.Dataset:
    """Measured loops of a reinforced-concrete column under cyclic displacement of its top.

    A cantilever of 1.60 m, 0.40 m square, under 744 kN of axial force. Looked for in
    ``PYMC_FEATURES_DATA/rc_column``, the cache, and the network; refused as those of `footbridge` are.

    Returns
    -------
    Dataset (step)
        Prescribed `displacement` of the top [m] and lateral `force` [N], 548 of each.

    References
    ----------
    Soesianawati, Park & Priestley, Limited ductility design of reinforced concrete columns, University of
    Canterbury, 1986; files of https://github.com/NHERI-SimCenter/quoFEM (BSD-2-Clause).
    """
    columns = []
    for commit, (file, digest) in zip(_COLUMN_COMMITS, _COLUMN_FILES.items(), strict=True):
        text = _fetch(f"rc_column/{file}", _COLUMN.format(commit, file), digest).read_text(encoding="utf-8")
        columns.append(np.array(text.replace(",", " ").split(), dtype=np.float64))
    return xr.Dataset({"displacement": ("step", columns[0]), "force": ("step", 1e3 * columns[1])})


def _fetch(file: str, url: str, sha256: str) -> Path:
    """Path of a published file, its bytes checked: in the local folder, then the cache, then the network."""
    folder = os.environ.get(DATA_VARIABLE)
    if folder and (path := Path(folder, file)).is_file():
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if digest != sha256:
            raise ValueError(
                f"{path} must have the SHA-256 {sha256}, got {digest}. Replace it by the file from {url}."
            )
        return path
    import pooch  # only here: records made by hand need no network

    try:
        return Path(
            pooch.retrieve(
                url,
                known_hash=f"sha256:{sha256}",
                fname=file,
                path=pooch.os_cache("pymc_features"),
                downloader=pooch.HTTPDownloader(timeout=_TIMEOUT),
            )
        )
    except (OSError, ValueError) as error:  # no network, no cache folder, or other bytes
        raise DatasetUnavailableError(
            f"{file} could not be downloaded from {url} ({error}). Set {DATA_VARIABLE} to a folder that "
            "holds it, or pass measured channels to `read_channels`."
        ) from error
