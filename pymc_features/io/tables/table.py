"""Text files as tables: columns of numbers below an optional header."""

import re
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from pymc_features._checks import listed, shown
from pymc_features.io.reading.labels import role_of, unit_of
from pymc_features.io.reading.lines import Lines, not_a_number, to_number
from pymc_features.io.reading.stamps import CONVERSIONS, stamp_in
from pymc_features.io.reading.units import known_factor
from pymc_features.io.tables.brackets import labels_with_brackets, texts_in_brackets, without_brackets
from pymc_features.io.tables.first_row import refuse_spoilt_first

_SEPARATORS = (r"\t", ";", ",", r"\s+")
_COMMENTS = ("#", "%", "//")
MOST_HEADER_LINES = 10_000
MISSING = ("", "nan", "+nan", "-nan")  # cells of a gap, in lower case


@dataclass(frozen=True)
class Table:
    """Numbers of a text file, and what stands above them."""

    file: str
    header: list[str]  # lines above the numbers, comment signs removed
    labels: list[list[str]]  # those header lines that split into one label per column
    values: np.ndarray  # (row, column)
    body: "Body"
    separator: str
    rows_in_line: int = 1
    stamp: int | None = None  # the column that was time stamps: seconds of their year

    def where(self, row: int) -> str:
        """How a message calls the place of a row."""
        number = next(n for k, (n, _) in enumerate(self.body) if k == row // self.rows_in_line)
        return f"{self.file}, line {number}"

    def label(self, index: int) -> list[str]:
        """What the header lines call a column."""
        return [labels[index] for labels in self.labels]

    def name(self, index: int) -> str | None:
        """Label of a column without its unit, by the last header line; None without a header."""
        return without_brackets(self.labels[-1][index]) if self.labels else None

    def brackets(self, index: int) -> list[str]:
        """Texts in brackets above a column, in most files its unit."""
        return [found[0] for text in self.label(index) if (found := texts_in_brackets(text))]

    def stated_unit(self, index: int) -> str | None:
        """The unit in brackets above a column, one of acceleration anywhere in an unlabelled header.

        Without a known one the text that stands where it should.
        """
        texts = self.label(index) if self.labels else self.header
        found = [text for line in texts for text in texts_in_brackets(line)]
        known = [text for text in found if unit_of(text) is not None]
        if not self.labels:
            known, found = [text for text in known if known_factor(text) is not None], []
        return next(iter([*known, *found]), None)

    def unit_of(self, index: int, quantity: str) -> float | None:
        """SI units per unit of a column that a bracket above it states, if that is of a quantity."""
        units = [unit for text in self.brackets(index) if (unit := unit_of(text)) is not None]
        return next((unit.factor for unit in units if unit.quantity == quantity), None)

    def role(self, index: int) -> str | None:
        """What a column is by its label, see `role_of`."""
        return role_of(self.name(index) or "")

    def quantum(self, index: int) -> float:
        """Resolution of a printed column, from its decimals and its significant digits."""
        least, digits = 0, 1
        for _, line in self.body:
            exponent, n_digits = _printed(_cell(line, self.separator, index))
            least, digits = min(least, exponent), max(digits, n_digits)
        decimals = 10.0**least
        largest = np.abs(self.values[:, index]).max()
        if largest == 0.0:
            return decimals
        return max(decimals, 10.0 ** (np.floor(np.log10(largest)) - digits + 1))

    def names(self) -> str:
        """The columns, as a message lists them."""
        return listed(self.labels[-1]) if self.labels else f"0 to {self.values.shape[1] - 1}"

    def find(self, column, argument: str, what: str) -> int:
        """Index of a column by its index or header name.

        Raises
        ------
        ValueError
            If there is no such column, or several; the message names `argument` and says `what` it asks for.
        """
        n_columns = self.values.shape[1]
        if isinstance(column, str):
            matches = {
                index
                for index in range(n_columns)
                for label in self.label(index)
                if column.strip() in (label, without_brackets(label))
            }
        else:
            matches = {column} & set(range(n_columns))
        if len(matches) != 1:
            raise ValueError(
                f"`{argument}` must be one of the columns of {self.file} ({self.names()}), got "
                f"{shown(column)}. Pass the index (from 0) or the header name of the {what}."
            )
        return matches.pop()


@dataclass(frozen=True)
class Body:
    """Number and text of the lines with numbers, cut from the text each time they are gone through."""

    lines: Lines
    first: int  # line number
    convert: Callable[[str], str]  # of time stamps and decimal commas to numbers
    skip: int = 0  # lines left out at the start

    def __iter__(self) -> Iterator[tuple[int, str]]:
        skipped = 0
        for number, line in self.lines:
            if number >= self.first and not line.startswith(_COMMENTS):
                if skipped >= self.skip:
                    yield number, self.convert(line)
                skipped += 1


def parse_table(path: Path, skip: int = 0, wrapped: bool | None = None, gaps: bool = False) -> Table:
    """Read a text file into a table, without its first `skip` rows of numbers.

    With `gaps` cells below the first row may be "nan" or empty: NaN.

    With `wrapped` its values are one series that runs along the lines, and the table has one column, or, if
    they are times and values in turn, two.

    Raises
    ------
    ValueError
        If there are no rows of numbers, a row is spoilt, or fewer than two are left.
    """
    lines = Lines(path)
    header, bare, first, separator, kind = _header(lines)
    stamped, convert = CONVERSIONS[kind]
    line = next(line for number, line in lines if number == first)
    stamp = len(_split(f"{line[: stamp_in(line).start()]}0", separator)) - 1 if stamped else None
    body = Body(lines, first, convert, skip)
    n_columns = len(_split(next(line for _, line in Body(lines, first, convert)), separator))
    above = [(number, _split(line, separator)) for number, line in bare]
    refuse_spoilt_first(path.name, above, first, n_columns)
    if wrapped:
        values, n_columns = _series(path.name, Body(lines, first, convert), separator)
        values = _at_least_two(path.name, values[skip:])
        return Table(
            path.name,
            header,
            [],
            values,
            Body(lines, first, convert),
            separator,
            n_columns // values.shape[1],
        )
    values = _numbers(path.name, Body(lines, first, convert), separator, n_columns, gaps)[skip:]
    labels = [found for line in header if (found := _labels(line, n_columns, separator, stamp))]
    values = _at_least_two(path.name, values)
    return Table(path.name, header, labels, values, body, separator, stamp=stamp)


def _at_least_two(file: str, values: np.ndarray) -> np.ndarray:
    if values.shape[0] < 2:
        raise ValueError(f"{file} must hold at least 2 samples, got {values.shape[0]}.")
    return values


def _header(lines: Lines) -> tuple[list[str], list[tuple[int, str]], int, str, int]:
    """Lines above the numbers, those without a comment sign, the first line of numbers, its separator.

    And which of `CONVERSIONS` makes numbers of it.
    """
    header, bare, seen = [], [], 0
    for (number, line), (_, after) in pairwise(chain(lines, [(0, "")])):
        seen += 1
        if line.startswith(_COMMENTS):
            header.append(line.lstrip("#%/ \t"))
        elif (found := _separator_of(line)) is not None and (found[1] == 0 or _separator_of(after) == found):
            return header, bare, number, *found
        else:
            header.append(line)
            bare.append((number, line))
        if seen == MOST_HEADER_LINES:
            break
    if not seen:
        raise ValueError(f"{lines.file} must hold at least 2 samples, it is empty.")
    raise ValueError(
        f"{lines.file} must hold rows of numbers, none was found in its "
        f"{'first ' * (seen == MOST_HEADER_LINES)}{seen} lines. "
        "A row is numbers, or a time stamp and numbers, with a comma, semicolon, tab or blank between."
    )


def _split(line: str, separator: str) -> list[str]:
    cells = [cell.strip().strip('"') for cell in re.split(separator, line.strip())]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _cell(line: str, separator: str, index: int) -> str:
    """One cell of `_split`, without those behind it."""
    return re.split(separator, line.strip(), maxsplit=index + 1)[index].strip().strip('"')


def _separator_of(line: str) -> tuple[str, int] | None:
    """The separator that turns a line into numbers, and the conversion before that; None if none does."""
    for kind, (stamped, convert) in enumerate(CONVERSIONS):
        separator = _separator(converted := convert(line)) if kind == 0 or convert(line) != line else None
        if separator is not None and not (stamped and len(_split(converted, separator)) < 2):
            return separator, kind
    return None


def _separator(line: str) -> str | None:
    """The separator that turns a line into numbers, None if none does."""
    for separator in _SEPARATORS:
        first = to_number(_cell(line, separator, 0)) is not None  # most lines of a header end here
        if first and all(to_number(cell) is not None for cell in _split(line, separator)):
            return separator
    return None


def _numbers(file: str, body: Body, separator: str, n_columns: int, gaps: bool) -> np.ndarray:
    """The rows as an array; the fast parser where it takes them, else cell by cell, to name a spoilt one."""
    delimiter = {r"\t": "\t", r"\s+": None}.get(separator, separator)
    try:
        values = np.loadtxt((line for _, line in body), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        values = None
    if values is not None and values.shape[1] == n_columns:
        wrong = np.isinf(values) if gaps else ~np.isfinite(values)
        if not wrong.any():
            return values
    cells = array("d")
    for number, line in body:
        cells.extend(_row(file, number, line, separator, n_columns, gaps))
    return np.array(cells).reshape(-1, n_columns)


def _row(
    file: str, number: int, line: str, separator: str, n_columns: int | None, gaps: bool = False
) -> list[float]:
    where, row = f"{file}, line {number}", []
    cells = _split(line, separator)
    if gaps and len(cells) + 1 == n_columns and line.rstrip().endswith(separator):
        cells.append("")  # the last cell is empty
    for cell in cells:
        if gaps and cell.lower() in MISSING:
            row.append(np.nan)
            continue
        value = to_number(cell)
        if value is None or not -np.inf < value < np.inf:
            raise not_a_number(where, cell)
        row.append(value)
    if n_columns is not None and len(row) != n_columns:
        raise ValueError(
            f"{where}: rows must have {n_columns} values like the first, got {len(row)}. "
            "Complete or cut the row, or pass wrapped=True if one series runs along the lines."
        )
    return row


def _series(file: str, body: Body, separator: str) -> tuple[np.ndarray, int]:
    """Values (sample, 1) of one series that runs along the lines, or (sample, 2) with the times before them.

    And how many values stand in the first line.
    """
    values, n_columns = array("d"), 0
    for number, line in body:
        row = _row(file, number, line, separator, None)
        if n_columns and len(values) % n_columns:
            raise ValueError(
                f"{file}, line {number}: only the last line of wrapped values may be shorter than the first, "
                f"which has {n_columns}. Complete the line before this one."
            )
        values.extend(row)
        n_columns = n_columns or len(row)
    found = np.array(values)
    return found.reshape(-1, 2) if is_paired(found, n_columns) else found[:, None], n_columns


def is_paired(values: np.ndarray, n_columns: int) -> bool:
    """Whether every other value in reading order, from the first, is a time that runs forward."""
    even = n_columns > 2 and n_columns % 2 == 0 and values.size % 2 == 0
    return even and bool((np.diff(values[::2]) > 0.0).all())


def check_not_wrapped(table: Table, wrapped: bool | None, clock: bool, named: bool) -> None:
    """Refuse lines that may as well be one wrapped series, unless the caller says what they are.

    Columns are series if there is a `clock` beside them, if they are `named` by the caller, or if labels
    stand above them. A title of as many words is no label: labels between blanks count only with brackets.
    """
    n_columns = table.values.shape[1]
    if wrapped is not None or n_columns < 3:
        return
    labelled = bool(table.labels) and (
        table.separator != r"\s+" or any(table.brackets(index) for index in range(n_columns))
    )
    if is_paired(table.values.ravel(), n_columns) or not (clock or named or labelled):
        raise ValueError(
            f"`wrapped` must be given, {table.file} has lines of {n_columns} values without labels or clock. "
            "Pass wrapped=True if one series runs along the lines, wrapped=False if each column is a series."
        )


def _printed(token: str) -> tuple[int, int]:
    """Power of ten of the last printed digit of a number, at least -300, and how many digits it has."""
    mantissa, _, exponent = token.lower().replace("d", "e").partition("e")
    whole, _, decimals = mantissa.lstrip("+-").partition(".")
    digits = (whole + decimals).lstrip("0")
    return max((int(exponent) if exponent else 0) - len(decimals), -300), max(len(digits), 1)


def _labels(line: str, n_columns: int, separator: str, stamp: int | None) -> list[str] | None:
    """One label per column, blanks allowed before a bracket: "time [s] acc [g]".

    A time stamp of date and time may have two, of which the second stays.
    """
    own = _split(line, separator)
    if stamp is not None and len(own) == n_columns + 1:
        return [*own[:stamp], *own[stamp + 1 :]]
    ways = [own, *(_split(line, other) for other in _SEPARATORS), labels_with_brackets(line)]
    return next((labels for labels in ways if len(labels) == n_columns), None)
