"""Binary files of loggers and of tables: TDMS by npTDMS, Parquet by pandas, HDF5 by h5py.

National Instruments, TDMS File Format Internal Structure; Reeve, A., npTDMS,
https://github.com/adamreeve/npTDMS.
"""

from pathlib import Path

import numpy as np

from pymc_features.io.formats.matlab import load_variables, recording_of_variables
from pymc_features.io.formats.sources import recording_in
from pymc_features.io.reading.lines import by_library
from pymc_features.io.reading.recording import Channel, Format, Recording, Request


def read_tdms(path: Path, request: Request) -> Recording:
    """All channels of all groups, scaled as their properties say."""
    with by_library("npTDMS", "daq", path, "TDMS"):
        from nptdms import TdmsFile

        groups = TdmsFile.read(path).groups()
        found = [(group, channel, np.asarray(channel[:])) for group in groups for channel in group.channels()]
    channels = []
    for group, channel, values in found:
        facts = channel.properties
        name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
        unit = str(facts.get("unit_string") or facts.get("NI_UnitDescription") or "") or None
        start = facts.get("wf_start_time")
        if isinstance(start, np.datetime64) and start > np.datetime64("1971"):  # 1904 is none
            start = float(start.astype("datetime64[us]").astype(np.int64)) * 1e-6
            start += float(facts.get("wf_start_offset", 0.0))
        else:
            start = None
        problem = ""
        if values.dtype.kind not in "iuf" or values.size < 2:
            problem = f"{path.name}, {name}: values must be numbers, at least 2, got {values.size} others."
            values = np.zeros(0)
        step = float(facts.get("wf_increment", 0.0)) or None
        channels.append(Channel(name, values.astype(np.float64), unit, step, start=start, problem=problem))
    return Recording(path.name, channels)


def read_parquet(path: Path, request: Request) -> Recording:
    """The columns of a table, as of a `pandas.DataFrame`."""
    import pandas as pd

    with by_library("pyarrow", "daq", path, "Parquet", "Save it again."):
        frame = pd.read_parquet(path)
    return recording_in(frame, request)._replace(file=path.name)


def read_hdf5(path: Path, request: Request) -> Recording:
    """Data sets of numbers, with their `units`; `dt` and `fs` as data sets or attributes."""
    return recording_of_variables(load_variables(path), path.name, request)


BINARY = (
    Format(
        "TDMS, by npTDMS",
        lambda opening: opening.head[:4] == b"TDSm",
        ".tdms",
        "step, start, units, channels. Needs the extra `daq`",
        read_tdms,
    ),
    Format(
        "Parquet, by pandas",
        lambda opening: opening.head[:4] == b"PAR1",
        ".parquet",
        "names, units in them, a clock among its columns. Needs the extra `daq`",
        read_parquet,
    ),
    Format(
        "HDF5",
        lambda opening: opening.head[:8] == b"\x89HDF\r\n\x1a\n" and opening.suffix != ".mat",
        ".h5, .hdf5",
        "names, attributes `units`, `dt` and `fs`, a clock among its data sets",
        read_hdf5,
    ),
)
