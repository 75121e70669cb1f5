"""Tables of cyclic tests: prescribed displacement, and the force that was measured."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pymc_features._checks import as_list, message, shown
from pymc_features.io.channels import check_column, checked, recording_from
from pymc_features.io.reading.labels import role_of, unit_of
from pymc_features.io.reading.recording import Channel, Recording, Request, chosen, in_si, named
from pymc_features.records import CyclicTest

if TYPE_CHECKING:
    import xarray as xr

KINDS = "displacement", "force"


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
        Column of the displacement and that of the force, by index from 0 or header name. By default the
        columns of a table that has two, or one in each of two files.
    units : sequence of two str or float, optional
        Of displacement, "m", "cm", "mm" or "in", or m per file unit, and of force, "N", "kN", "MN", "lbf" or
        "kip", or N per file unit. Headers such as ``drift [mm]`` state them.
    dt : float
        Interval of the samples [s], positive; it labels axes and nothing else.
    skip : int
        Rows left out at the start.
    wrapped : bool, optional
        True if one series runs along the lines of the files, False if each column is a series. Needed where
        neither labels nor two columns tell.

    Returns
    -------
    CyclicTest, xarray.DataArray (sensor, time)
        The displacement [m], named after its file, and the force [N], of the sensor "force". Zeros are those
        of the files: a specimen is untouched where the displacement is zero.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        If there is no such file or it cannot be opened.
    ValueError, TypeError
        If an argument is not admissible, a file is broken, its units are not known, or displacement and
        force do not have the same length; the message names file and line.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "wall.csv"
    ...     _ = path.write_text("drift [mm],load [kN]\\n0.0,0.0\\n2.0,35.5\\n-2.0,-34.0\\n")
    ...     test, force = read_cyclic_test(path)
    >>> test
    CyclicTest('wall', 3 samples, from -0.002 to 0.002 m)
    >>> force.values
    array([[     0.,  35500., -34000.]])
    """
    import xarray as xr  # slow to import

    is_one = isinstance(files, str | PathLike)
    paths = [files] if is_one else pair(files, "files", "paths")
    picked = [None, None] if columns is None else pair(columns, "columns", "an index or a name each")
    picked = [None if column is None else check_column(column, "columns") for column in picked]
    given = [None, None] if units is None else pair(units, "units", "one of length and one of force")
    wrapped = False if wrapped is None and columns is not None else wrapped
    request = checked(Request(dt=dt, clock=False, skip=skip, wrapped=wrapped))
    recordings = [recording_from(path, request, "files") for path in paths]
    found = []
    for kind, column, unit, place in zip(KINDS, picked, given, (0, int(is_one)), strict=True):
        recording = recordings[0 if is_one else KINDS.index(kind)]
        channel = _channel(recording, column, kind, place, 1 + is_one)
        asked = request._replace(units=unit, quantity=kind)
        found.append(in_si(channel, asked, recording._replace(file=f"{recording.file}, {kind}"))[0])
    displacement, force = found
    if displacement.size != force.size:
        raise ValueError(
            f"`files` must have as many displacements as forces, got {displacement.size} in "
            f"{recordings[0].file} and {force.size} in {recordings[-1].file}. Cut them to the same rows."
        )
    test = CyclicTest(displacement, request.dt, name=Path(recordings[0].file).stem)
    coords = {"sensor": ["force"], "time": ("time", test.time, {"units": "s"})}
    return test, xr.DataArray(force[None], coords, ("sensor", "time"), "restoring_force", {"units": "N"})


def pair(value, name: str, what: str) -> list:
    """Two entries, of the displacement and of the force."""
    listed = as_list(value)
    if listed is None or isinstance(value, str) or len(listed) != 2:
        raise ValueError(message(name, f"two for displacement and force ({what})", shown(value)))
    return listed


def _channel(recording: Recording, column, kind: str, place: int, usual: int) -> Channel:
    """A channel as asked, by its label, or at its place among the usual number of columns."""
    if column is not None:
        return chosen(recording, [column])[0]
    if recording.question:
        raise ValueError(recording.question)
    units = [unit_of(channel.unit or "") for channel in recording.channels]
    kinds = [u.quantity if u else role_of(c.name) for c, u in zip(recording.channels, units, strict=True)]
    if kinds.count(kind) == 1:
        place = kinds.index(kind)
    elif len(kinds) != usual or kinds[place] is not None or kind in kinds:
        raise ValueError(
            f"`columns` must be given, {recording.file} has {len(kinds)} columns "
            f"({named(recording.channels)}). Pass the one of the displacement and the one of the force."
        )
    return recording.channels[place]
