"""Channels as files that other programs read: CSV with units in its header, Universal Files."""

import re
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from pymc_features._checks import check_path, message, require
from pymc_features.io.formats.libraries import AXES, TYPES
from pymc_features.io.reading.labels import SI
from pymc_features.io.reading.lines import by_library

if TYPE_CHECKING:
    import xarray as xr

EPOCH = 1e8  # [s]; clocks that read more count from 1970
TYPE_OF_UNIT = {SI[quantity]: kind for quantity, kind in TYPES.items()}  # of data set 58
PLACE = re.compile(rf"(\d+)(-?)({'|'.join(sorted(AXES, key=len, reverse=True))})")


def write_channels(channels: "xr.DataArray", path: str | PathLike) -> None:
    """Write channels to a file that `read_channels` reads back equal.

    Parameters
    ----------
    channels : xarray.DataArray (sensor, time)
        As from `read_channels`, in SI units.
    path : str or path-like
        CSV (``.csv``, ``.txt``): a column of times [s], or of time stamps where `attrs["start"]` counts from
        1970, and one for each sensor, its unit in brackets, empty cells in gaps. Universal File (``.uff``,
        ``.unv``, with the extra `modal`): data sets 58 in double precision, of sensors named by node and
        direction, as ``12Z``; one start of all is read as 0.

    Raises
    ------
    ValueError, TypeError, ImportError
        If these are no channels, the ending is another, a name does not fit the format, or pyuff is missing.

    Examples
    --------
    >>> import tempfile
    >>> import xarray as xr
    >>> channels = xr.DataArray([[1.5, 0.5]], {"sensor": ["roof"], "time": [0.0, 0.02]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_channels(channels, f"{folder}/roof.csv")
    ...     print(open(f"{folder}/roof.csv").read().splitlines())
    ['time [s],roof [m/s^2]', '0,1.5', '0.02,0.5']
    """
    from pymc_features.signals.channels import check_array, sampling_step

    path, step = check_path(path), sampling_step(check_array(channels, sensors=True))
    writers = {".csv": _write_csv, ".txt": _write_csv, ".uff": _write_universal, ".unv": _write_universal}
    if path.suffix.lower() not in writers:
        raise ValueError(message("path", f"a file ending in {', '.join(writers)}", path.name))
    whole = [channels.attrs.get("units", "m/s^2")] * channels.sizes["sensor"]
    units = channels["units"].values if "units" in channels.coords else whole
    names = [str(name) for name in channels["sensor"].values] if "sensor" in channels.coords else []
    if len(names) < len(units) or any(re.search(r"[\[\]()\n]", name) for name in names):
        raise ValueError(message("channels", "names of sensors without brackets", ", ".join(names) or "none"))
    writers[path.suffix.lower()](path, names, [str(unit) for unit in units], channels, step)


def _write_csv(path, names, units, channels, step: float) -> None:
    import pandas as pd  # half a second to import

    start, times = float(channels.attrs.get("start", 0.0)), step * np.arange(channels.sizes["time"])
    label, clock = "time [s]", [f"{time:.15g}" for time in start + times]
    if start > EPOCH:
        since = np.int64(round(start * 1e6)) * 1000 + np.rint(times * 1e9).astype(np.int64)
        label, clock = "time", np.datetime_as_string(since.astype("datetime64[ns]"), timezone="UTC")
    labels = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)]
    table = pd.DataFrame(channels.values.T, clock, labels, dtype=np.float64)
    table.to_csv(path, index_label=label, float_format="%.17g", lineterminator="\n")


def _write_universal(path, names, units, channels, step: float) -> None:
    require(channels.notnull().all(), f"`channels` must be without gaps for {path.name}, got NaN. Write CSV.")
    times = float(channels.attrs.get("start", 0.0)) + step * np.arange(channels.sizes["time"])
    sets = []
    for name, unit, values in zip(names, units, channels.values, strict=True):
        found = PLACE.fullmatch(name)
        what = "named by node and direction, as 12Z, for a Universal File"
        require(found, message("channels", what, name, "Rename them, or write CSV."))
        node, sign, axis = found.groups()
        even = int(float(f"{step:.5e}") == step and times[0] == 0.0)  # six digits
        of = {"type": 58, "binary": 1, "func_type": 1, "ref_node": 0, "ref_dir": 0, "ord_data_type": 4}
        of |= {"id1": name, "rsp_node": int(node), "rsp_dir": (AXES.index(axis) + 1) * (-1 if sign else 1)}
        of |= {"data": values.astype(np.float64), "x": times, "abscissa_spacing": even}
        of |= {"abscissa_axis_units_lab": "s", "ordinate_axis_units_lab": unit}
        sets.append(of | {"orddenom_spec_data_type": 0, "ordinate_spec_data_type": TYPE_OF_UNIT.get(unit, 0)})
    with by_library("pyuff", "modal", path, "Universal"):
        import pyuff
    path.write_bytes(b"")
    file = pyuff.UFF(str(path))
    for one in sets:  # the mode "overwrite" of pyuff spoils the first of several
        file.write_sets(one, mode="add")
