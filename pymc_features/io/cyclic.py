"""Tables of cyclic tests: prescribed displacement, and the force that was measured."""

from collections.abc import Sequence
from os import PathLike
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features._checks import (
    as_list,
    check_integer,
    check_path,
    check_positive,
    check_step,
    is_number,
    message,
    shown,
    single,
)
from pymc_features.cyclic_test import CyclicTest
from pymc_features.io.channels import check_column, check_wrapped
from pymc_features.io.reading.labels import FORCES, LENGTHS, role_of, unit_of
from pymc_features.io.reading.lines import check_readable
from pymc_features.io.tables.table import Table, check_not_wrapped, parse_table


class Kind(NamedTuple):
    """One of the two columns: what it is called, the units to name, and that of SI."""

    name: str
    units: dict[str, float]
    si: str


KINDS = Kind("displacement", LENGTHS, "m"), Kind("force", FORCES, "N")


def read_cyclic_test(
    files: str | PathLike | Sequence[str | PathLike],
    *,
    columns: Sequence[int | str] | None = None,
    units: Sequence[str | float] | None = None,
    dt: float = 1.0,
    skip: int = 0,
    wrapped: bool | None = None,
) -> tuple[CyclicTest, xr.DataArray]:
    """Read displacement and force of a cyclic test from one table or two.

    Parameters
    ----------
    files : path or sequence of two paths
        Text or CSV, any lines above the numbers: a table with both, or that of the displacement and that of
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
    is_one = isinstance(files, str | PathLike)
    paths = [check_path(path, "files") for path in ([files] if is_one else pair(files, "files", "paths"))]
    picked = [None, None] if columns is None else pair(columns, "columns", "an index or a name each")
    picked = [None if column is None else check_column(column, "columns") for column in picked]
    given = [None, None] if units is None else pair(units, "units", "one of length and one of force")
    factors = [None if u is None else factor_of(u, kind) for u, kind in zip(given, KINDS, strict=True)]
    check_wrapped(wrapped)
    skip, dt = check_integer(skip, "skip", least=0, advice="It counts rows at the start."), check_step(dt)
    tables = []
    for path in paths:
        check_readable(path, "files")
        tables.append(parse_table(path, skip, wrapped))
        check_not_wrapped(tables[-1], wrapped, clock=False, named=columns is not None)
    tables *= 2 if is_one else 1
    alone = (0, 1) if is_one else (0, 0)
    displacement, force = (
        column_of(table, index_of(table, column, kind, place, 1 + is_one), kind, factor)
        for table, column, kind, place, factor in zip(tables, picked, KINDS, alone, factors, strict=True)
    )
    if displacement.size != force.size:
        raise ValueError(
            f"`files` must have as many displacements as forces, got {displacement.size} in {tables[0].file} "
            f"and {force.size} in {tables[1].file}. Cut them to the same rows."
        )
    test = CyclicTest(displacement, dt, name=paths[0].stem)
    return test, measured_force(test, force)


def measured_force(test: CyclicTest, force: np.ndarray) -> xr.DataArray:
    """The force (time,) [N] of a test as the only channel (sensor, time)."""
    coords = {"sensor": ["force"], "time": ("time", test.time, {"units": "s"})}
    return xr.DataArray(force[None], coords, ("sensor", "time"), "restoring_force", {"units": "N"})


def pair(value, name: str, what: str) -> list:
    """Two entries, of the displacement and of the force."""
    listed = as_list(value)
    if listed is None or isinstance(value, str) or len(listed) != 2:
        got = shown(value)
        raise ValueError(message(name, f"two for displacement and force ({what})", got))
    return listed


def factor_of(unit, kind: Kind) -> float:
    """m or N per unit of a file."""
    choices = ", ".join(f'"{name}"' for name in kind.units)
    advice = f"Of the {kind.name} pass one of {choices}, or {kind.si} per file unit."
    if isinstance(unit, str):
        known = unit_of(unit)
        if known is None or known.quantity != kind.name:
            raise ValueError(message("units", "known", shown(unit), advice))
        return known.factor
    if not is_number(single(unit)):
        raise TypeError(message("units", "names of units or numbers", shown(unit), advice))
    return check_positive(unit, "units", advice)


def index_of(table: Table, column, kind: Kind, place: int, usual: int) -> int:
    """Where a column stands: as asked, by its label, or at its place among the usual number of columns."""
    if column is not None:
        return table.find(column, "columns", kind.name)
    n_columns = table.values.shape[1]
    labelled = [i for i in range(n_columns) if quantity_of(table, i) == kind.name]
    if len(labelled) == 1:
        return labelled[0]
    if n_columns != usual or quantity_of(table, place) is not None or labelled:
        raise ValueError(
            f"`columns` must be given, {table.file} has {n_columns} columns ({table.names()}). "
            "Pass the one of the displacement and the one of the force."
        )
    return place


def quantity_of(table: Table, index: int) -> str | None:
    """Displacement, force or what else a column is by its unit, or by its name."""
    stated = [unit.quantity for text in table.brackets(index) if (unit := unit_of(text)) is not None]
    return next(iter(stated), role_of(table.name(index) or ""))


def column_of(table: Table, index: int, kind: Kind, factor: float | None) -> np.ndarray:
    """One column (row,) in SI units, of which a given factor must be that of the header."""
    stated = [unit for text in table.brackets(index) if (unit := unit_of(text)) is not None]
    if stated and stated[0].quantity != kind.name:
        raise ValueError(
            f"`columns` must name a {kind.name}, the column {table.label(index)[-1]!r} of {table.file} is a "
            f"{stated[0].quantity}. Pass another."
        )
    if factor is None and not stated:
        choices = ", ".join(f'"{name}"' for name in kind.units)
        raise ValueError(
            f"`units` must be given, {table.file} does not state that of the {kind.name}. Pass one of "
            f"{choices}, or {kind.si} per file unit."
        )
    if factor is not None and stated and not np.isclose(factor, stated[0].factor, rtol=0.01, atol=0.0):
        raise ValueError(
            f"`units` must be those of the file, got {factor:g} {kind.si} per unit of the {kind.name}, "
            f"{table.file} states {table.brackets(index)[0]!r}. Leave `units` out, or correct the file."
        )
    return table.values[:, index] * (stated[0].factor if factor is None else factor)
