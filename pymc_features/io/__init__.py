"""Ground motions, one format, one file, one line in `READERS`; measured channels; matrices of structures."""

from os import PathLike
from pathlib import Path

from pymc_features._checks import check_step
from pymc_features.io.at2 import read_at2
from pymc_features.io.channels import CHANNEL_READERS, read_channels
from pymc_features.io.lines import check_readable
from pymc_features.io.mat import read_mat
from pymc_features.io.matrices import read_matrices
from pymc_features.io.text import read_text
from pymc_features.io.units import unit_factor
from pymc_features.records import Record

__all__ = ["CHANNEL_READERS", "READERS", "read_channels", "read_matrices", "read_record"]

#: Reader of every file suffix (lower case); any other suffix is read as text.
READERS = {
    ".at2": read_at2,
    ".mat": read_mat,
    ".txt": read_text,
    ".csv": read_text,
    ".dat": read_text,
    ".tsv": read_text,
    ".acc": read_text,
}


def read_record(
    path: str | PathLike,
    *,
    units: str | float | None = None,
    dt: float | None = None,
    column: int | str | None = None,
) -> Record:
    """Read a ground acceleration from a file and convert it to m/s^2.

    What the file states about units and time step is used when the argument is None. Where both
    speak and disagree, the argument wins and a warning says so; where both are silent, an error.

    Parameters
    ----------
    path : str or path-like
        PEER AT2 (``.at2``), MATLAB (``.mat``, also v7.3), or text (any other suffix), columns of
        numbers separated by comma, semicolon, tab or blanks. One column is the acceleration, two
        are time [s] and acceleration.
    units : str or float, optional
        Of the file: "g" (9.81 m/s^2), "m/s^2", "cm/s^2" or "gal", or m/s^2 per file unit, positive.
        AT2 headers, text headers such as ``acc [g]`` and a MATLAB text variable ``units`` state it.
    dt : float, optional
        Sampling interval [s], positive. AT2 headers, an evenly increasing first text column and the
        MATLAB variables ``dt``, ``fs`` [Hz], ``t`` or ``time`` state it.
    column : int or str, optional
        Which column of a text file, by index from 0 or header name, or which MATLAB variable is the
        acceleration. Needed only if there are several. An (N, 2) MATLAB matrix is time and
        acceleration. Not for AT2.

    Returns
    -------
    Record
        Acceleration (time,) [m/s^2], named after the event in the AT2 header, else after the file.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file or it cannot be opened.
    ValueError, TypeError
        If an argument is not admissible or the file does not hold what its format asks for; the
        message names the file, the line where there is one, and what to do.

    Warns
    -----
    UserWarning
        If `units` or `dt` contradicts the file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "pulse.csv"
    ...     _ = path.write_text("time [s],acc [g]\\n0.00,0.0\\n0.02,0.1\\n0.04,-0.2\\n")
    ...     read_record(path)
    Record('pulse', 3 samples, dt=0.02 s, duration=0.04 s, pga=1.962 m/s^2)
    """
    path = Path(path)
    check_readable(path)
    dt = None if dt is None else check_step(dt)
    if units is not None:
        unit_factor(units)
    reader = READERS.get(path.suffix.lower(), read_text)
    return reader(path, units=units, dt=dt, column=column)
