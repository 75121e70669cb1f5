"""Ground motions, measured channels and cyclic tests of many formats; matrices of structures."""

from os import PathLike
from pathlib import Path

import numpy as np

from pymc_features._checks import warn_caller
from pymc_features.io.channels import (
    check_column,
    checked,
    read_channels,
    read_channels_with_gaps,
    recording_from,
)
from pymc_features.io.cyclic import read_cyclic_test
from pymc_features.io.formats import FORMATS
from pymc_features.io.matrices import read_matrices
from pymc_features.io.reading.labels import G
from pymc_features.io.reading.recording import Request, chosen, in_si, named
from pymc_features.io.write import write_channels
from pymc_features.records import Record

__all__ = [
    "FORMATS",
    "read_channels",
    "read_channels_with_gaps",
    "read_cyclic_test",
    "read_matrices",
    "read_record",
    "write_channels",
]

LARGEST = 5.0 * G  # [m/s^2]; the ground has not been seen to move faster


def read_record(
    path: str | PathLike,
    *,
    units: str | float | None = None,
    dt: float | None = None,
    column: int | str | None = None,
    wrapped: bool | None = None,
) -> Record:
    """Read a ground acceleration from a file and convert it to m/s^2.

    The format is recognised by the first lines. What the file states about units and time step is used when
    the argument is None. Where both speak and disagree, it is an error, of a step a warning, and the argument
    is used; where both are silent, an error.

    Parameters
    ----------
    path : str or path-like
        PEER AT2, CSMIP V1 and V2, COSMOS V0 to V2, SMC, K-NET and KiK-net, GeoNet V1A and V2A, ESM, NSMN,
        UNAM, with the extra `seismic` SAC, MiniSEED, TSPAIR and SLIST, with the extra `modal` Universal Files
        (data sets 58), MATLAB (``.mat``, also v7.3), or text, columns of numbers separated by comma,
        semicolon, tab or blanks. One column is the acceleration, two are time [s] and acceleration.
    units : str or float, optional
        Of the file, where it does not state them: "g" (9.81 m/s^2), "mg", "m/s^2", "cm/s^2", "mm/s^2", "gal",
        "in/s^2" or "ft/s^2", or m/s^2 per file unit, positive. Formats of strong motion, text headers such as
        ``acc [g]`` and a MATLAB text variable ``units`` do; others are an error then.
    dt : float, optional
        Sampling interval [s], positive. Formats of strong motion, an evenly increasing first text column and
        the MATLAB variables ``dt``, ``fs`` [Hz], ``t`` or ``time`` state it. Films digitised at uneven times
        need it: their values are joined by straight lines.
    column : int or str, optional
        Which channel of a recording or column of a text file, by index from 0 or name, or which MATLAB
        variable is the acceleration. Needed only if there are several. An (N, 2) MATLAB matrix is time and
        acceleration.
    wrapped : bool, optional
        Text only: True if one series runs along the lines, several values to each, or times and values in
        turn; False if each column is a series. Needed where neither labels nor a clock tell.

    Returns
    -------
    Record
        Acceleration (time,) [m/s^2], named after the event or station that the file names, else after it.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file or it cannot be opened.
    ValueError, TypeError
        If an argument is not admissible or the file does not hold what its format asks for; the
        message names the file, its format, the line where there is one, and what to do.
    ImportError
        If the file is a seismogram and ObsPy is not installed, or a Universal File and pyuff is not.

    Warns
    -----
    UserWarning
        If `dt` contradicts the file, or the peak of the values is not that of the header.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "pulse.csv"
    ...     _ = path.write_text("time [s],acc [g]\\n0.00,0.0\\n0.02,0.1\\n0.04,-0.2\\n")
    ...     read_record(path)
    Record('pulse', 3 samples, dt=0.02 s, duration=0.04 s, pga=1.962 m/s^2)
    """
    request = checked(Request(units=units, dt=dt, wrapped=wrapped))
    columns = None if column is None else [check_column(column, "column")]
    recording = recording_from(path, request, "path")
    found = chosen(recording, columns, "column")
    if len(found) > 1:
        raise ValueError(
            f"`column` must be given, {recording.file} has the channels "
            f"{named(found)}. Pass the name or the index (from 0) of one."
        )
    values, clock = in_si(found[0], request, recording)
    peak = np.abs(values).max()
    if peak > LARGEST:
        from pymc_features.signals.check import implausible  # a second to import

        warn_caller(f"{recording.file} {implausible(peak)}")
    return Record(values, clock.dt, name=recording.name or Path(recording.file).stem)
