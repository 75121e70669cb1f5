"""Ground motions, and cyclic tests: prescribed displacement, and the force that was measured."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pymc_features._checks import as_list, message, require, shown, step_or_rate, warn_caller
from pymc_features.io.channels import check_column, checked
from pymc_features.io.formats import read_source
from pymc_features.io.reading.labels import G, role_of, unit_of
from pymc_features.io.reading.recording import Recording, Request, chosen, in_si, named
from pymc_features.records import CyclicTest, Record

if TYPE_CHECKING:
    import xarray as xr

LARGEST = 5.0 * G  # [m/s^2]; the ground has not been seen to move faster
KINDS = "displacement", "force"


def read_record(
    path: str | PathLike,
    *,
    units: str | float | None = None,
    dt: float | None = None,
    fs: float | None = None,
    column: int | str | None = None,
    wrapped: bool | None = None,
) -> Record:
    """Read a ground acceleration from a file and convert it to m/s^2.

    The format is recognised by the first lines. An argument says what the file does not state of units and
    time step. Where both speak and disagree, it is an error, of a step a warning, and the argument is used.

    Parameters
    ----------
    path : str or path-like
        PEER AT2, CSMIP V1 and V2, COSMOS V0 to V2, SMC, K-NET and KiK-net, GeoNet V1A and V2A, ESM, NSMN,
        UNAM, with the extra `seismic` SAC, MiniSEED, TSPAIR and SLIST, with the extra `modal` Universal Files
        (data sets 58), MATLAB (``.mat``, also v7.3), or text, columns of numbers separated by comma,
        semicolon, tab or blanks. One column is the acceleration, two are time [s] and acceleration.
    units, dt, fs
        As of `read_channels`; formats of strong motion state them too. Films digitised at uneven times need
        `dt`: their values are joined by straight lines.
    column : int or str, optional
        Which channel, column or MATLAB variable is the acceleration, by index from 0 or name, if there are
        several. An (N, 2) MATLAB matrix is time and acceleration.
    wrapped : bool, optional
        Text only: True if one series, or times and values in turn, run along the lines; False if each column
        is a series. Needed where neither labels nor a clock tell.

    Returns
    -------
    Record
        Acceleration (time,) [m/s^2], named after the event or station that the file names, else after it.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError, ImportError
        If there is no such file, it cannot be opened, or needs ObsPy or pyuff.
    ValueError, TypeError
        If an argument is not admissible or the file does not hold what its format asks for; the message
        names the file, its format, the line where there is one, and what to do.

    Warns
    -----
    UserWarning
        If `dt` contradicts the file, or the peak of the values is not that of the header.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "pulse.csv"
    ...     _ = path.write_text("time [s],acc [g]\\n0.00,0.0\\n0.02,0.1\\n0.04,-0.2\\n")
    ...     read_record(path)
    Record('pulse', 3 samples, dt=0.02 s, duration=0.04 s, pga=1.962 m/s^2)
    """
    request = checked(Request(units=units, dt=step_or_rate(dt, fs), wrapped=wrapped))
    columns = None if column is None else [check_column(column, "column")]
    recording = read_source(path, request, "path")
    found = chosen(recording, columns, "column")
    held = f"{named(found)}. Pass the name or the index (from 0) of one."
    require(len(found) == 1, f"`column` must be given, {recording.file} has the channels {held}")
    motion = in_si(found[0], request, recording)
    if (peak := np.abs(motion.values).max()) > LARGEST:
        from pymc_features.signals.check import implausible  # a second to import

        warn_caller(f"{recording.file} {implausible(peak)}")
    return Record(motion.values, motion.dt, name=recording.name or Path(recording.file).stem)


def read_cyclic_test(
    files: str | PathLike | Sequence[str | PathLike],
    *,
    columns: Sequence[int | str] | None = None,
    units: Sequence[str | float] | None = None,
    dt: float = 1.0,
    skip: int = 0,
    wrapped: bool | None = None,
) -> tuple[CyclicTest, "xr.DataArray"]:
    """Read displacement and force of a cyclic test from one table or two.

    Parameters
    ----------
    files : path or sequence of two paths
        Text, CSV or any format of `read_channels`: a table with both, or that of the displacement and that of
        the force, with as many rows.
    columns : sequence of two int or str, optional
        Those of the displacement and the force, by index from 0 or header name. By default by their labels,
        or the columns of a table that has two, or one in each of two files.
    units : sequence of two str or float, optional
        Of displacement, "m", "cm", "mm" or "in", or m per file unit, and of force, "N", "kN", "MN", "lbf" or
        "kip", or N per file unit. Headers such as ``drift [mm]`` state them.
    dt : float
        Interval of the samples [s], positive; it labels axes and nothing else.
    skip, wrapped
        As of `read_channels`.

    Returns
    -------
    CyclicTest, xarray.DataArray (sensor, time)
        The displacement [m], named after its file, and the force [N], of the sensor "force". Zeros are those
        of the files: a specimen is untouched where the displacement is zero.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError, ValueError, TypeError
        If there is no such file or it cannot be opened, an argument is not admissible, a file is broken, its
        units are not known, or displacement and force differ in length; the message names file and line.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "wall.csv"
    ...     _ = path.write_text("drift [mm],load [kN]\\n0.0,0.0\\n2.0,35.5\\n-2.0,-34.0\\n")
    ...     test, force = read_cyclic_test(path)
    >>> test, force.values
    (CyclicTest('wall', 3 samples, from -0.002 to 0.002 m), array([[     0.,  35500., -34000.]]))
    """
    import xarray as xr  # slow to import

    is_one = isinstance(files, str | PathLike)
    paths = [files] if is_one else pair(files, "files", "paths")
    picked = pair((None, None) if columns is None else columns, "columns", "an index or a name each")
    picked = [None if column is None else check_column(column, "columns") for column in picked]
    given = pair((None, None) if units is None else units, "units", "one of length and one of force")
    wrapped = False if wrapped is None and columns is not None else wrapped
    request = checked(Request(dt=dt, clock=False, skip=skip, wrapped=wrapped))
    recordings = [read_source(path, request) for path in paths] * (2 if is_one else 1)
    found = []
    for kind, recording, column, unit in zip(KINDS, recordings, picked, given, strict=True):
        if column is None and not recording.question:
            column = _place(recording, kind, KINDS if is_one else (kind,))
        channel = chosen(recording, [column])[0]
        asked = request._replace(units=unit, quantity=kind)
        found.append(in_si(channel, asked, recording._replace(file=f"{recording.file}, {kind}")).values)
    displacement, force = found
    sizes = f"{displacement.size} in {recordings[0].file} and {force.size} in {recordings[-1].file}"
    what = f"as many displacements as forces, got {sizes}"
    require(displacement.size == force.size, f"`files` must have {what}. Cut them to the same rows.")
    test = CyclicTest(displacement, request.dt, name=Path(recordings[0].file).stem)
    coords = {"sensor": ["force"], "time": ("time", test.time, {"units": "s"})}
    return test, xr.DataArray(force[None], coords, ("sensor", "time"), "restoring_force", {"units": "N"})


def pair(value, name: str, what: str) -> list:
    """Two entries, of the displacement and of the force."""
    listed = [] if isinstance(value, str) else as_list(value) or []
    require(len(listed) == 2, message(name, f"two for displacement and force ({what})", shown(value)))
    return listed


def _place(recording: Recording, kind: str, usual: tuple[str, ...]) -> int:
    """The channel that is of a kind by its label, or that at its place among the usual columns."""
    units = [unit_of(channel.unit or "") for channel in recording.channels]
    kinds = [u.quantity if u else role_of(c.name) for c, u in zip(recording.channels, units, strict=True)]
    if kinds.count(kind) == 1:
        return kinds.index(kind)
    place = usual.index(kind)
    if len(kinds) != len(usual) or kinds[place] is not None or kind in kinds:
        held = f"{len(kinds)} columns ({named(recording.channels)})"
        advice = "Pass the one of the displacement and the one of the force."
        raise ValueError(f"`columns` must be given, {recording.file} has {held}. {advice}")
    return place
