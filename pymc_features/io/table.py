"""Text files as tables: columns of numbers below an optional header."""

import operator
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from pymc_features.io.lines import not_a_number, read_lines, to_number
from pymc_features.io.units import known_factor

_SEPARATORS = (r"\t", ";", ",", r"\s+")
_COMMENTS = ("#", "%", "//")
_BRACKET = re.compile(r"[\[(]\s*([^\])]*?)\s*[\])]")


@dataclass(frozen=True)
class Table:
    """Numbers of a text file, and what stands above them."""

    file: str
    header: list[str]  # lines above the numbers, comment signs removed
    labels: list[list[str]]  # those header lines that split into one label per column
    values: np.ndarray  # (row, column)
    lines: list[tuple[int, str]]  # number and text of the line behind every row
    separator: str

    def where(self, row: int) -> str:
        """How a message calls the place of a row."""
        return f"{self.file}, line {self.lines[row][0]}"

    def label(self, index: int) -> list[str]:
        """What the header lines call a column."""
        return [labels[index] for labels in self.labels]

    def name(self, index: int) -> str | None:
        """Label of a column without its unit, by the last header line; None without a header."""
        return _BRACKET.sub("", self.labels[-1][index]).strip() if self.labels else None

    def brackets(self, index: int) -> list[str]:
        """Texts in brackets above a column, in most files its unit."""
        return [found[1] for text in self.label(index) if (found := _BRACKET.search(text))]

    def stated_unit(self, index: int) -> str | None:
        """Acceleration unit in brackets above the column, or anywhere in an unlabelled header."""
        texts = self.label(index) if self.labels else self.header
        units = [unit for text in texts for unit in _BRACKET.findall(text)]
        return next((unit for unit in units if known_factor(unit) is not None), None)

    def quantum(self, index: int) -> float:
        """Resolution of a printed column, from its decimals and its significant digits."""
        tokens = [_split(line, self.separator)[index] for _, line in self.lines]
        parts = [Decimal(token.replace("d", "e").replace("D", "e")).as_tuple() for token in tokens]
        decimals = 10.0 ** min(part.exponent for part in parts)
        largest = np.abs(self.values[:, index]).max()
        if largest == 0.0:
            return decimals
        digits = max(len(part.digits) for part in parts)
        return max(decimals, 10.0 ** (np.floor(np.log10(largest)) - digits + 1))

    def names(self) -> str:
        """The columns, as a message lists them."""
        return ", ".join(self.labels[-1]) if self.labels else f"0 to {self.values.shape[1] - 1}"

    def find(self, column, argument: str, what: str) -> int:
        """Index of a column by its index or header name.

        Raises
        ------
        ValueError, TypeError
            If there is no such column, or several; the message names `argument` and says `what` it asks for.
        """
        n_columns = self.values.shape[1]
        if isinstance(column, str):
            matches = {
                index
                for index in range(n_columns)
                for label in self.label(index)
                if column.strip() in (label, _BRACKET.sub("", label).strip())
            }
        else:
            try:
                matches = {operator.index(column)} & set(range(n_columns))
            except TypeError:
                raise TypeError(f"`{argument}` must be an index or a name, got {column!r}.") from None
        if len(matches) != 1:
            raise ValueError(
                f"`{argument}` must be one of the columns of {self.file} ({self.names()}), got {column!r}. "
                f"Pass the index (from 0) or the header name of the {what}."
            )
        return matches.pop()


def parse_table(path: Path, skip: int = 0) -> Table:
    """Read a text file into a table, without its first `skip` rows of numbers.

    Raises
    ------
    ValueError
        If there are no rows of numbers, a row is spoilt, or fewer than two are left.
    """
    file = path.name
    lines = [(n, line.strip()) for n, line in enumerate(read_lines(path), 1) if line.strip()]
    if not lines:
        raise ValueError(f"{file} must hold at least 2 samples, it is empty.")
    header, bare = [], []
    for start in range(len(lines)):
        number, line = lines[start]
        if line.startswith(_COMMENTS):
            header.append(line.lstrip("#%/ \t"))
        elif (separator := _separator(line)) is not None:
            break
        else:
            header.append(line)
            bare.append((number, line))
    else:
        raise ValueError(
            f"{file} must hold rows of numbers, none was found in its {len(lines)} lines. "
            "Use a decimal point, and a comma, semicolon, tab or blank between columns."
        )
    n_columns = len(_split(lines[start][1], separator))
    for number, line in bare:  # a spoilt first row must not pass for a header
        cells = _split(line, separator)
        if len(cells) == n_columns > 1 and to_number(cells[0]) is not None:
            bad = next(cell for cell in cells if to_number(cell) is None)
            raise not_a_number(f"{file}, line {number}", bad)
    body = [(n, line) for n, line in lines[start:] if not line.startswith(_COMMENTS)]
    values = _numbers(file, body, separator, n_columns)[skip:]
    if values.shape[0] < 2:
        raise ValueError(f"{file} must hold at least 2 samples, got {values.shape[0]}.")
    labels = [found for line in header if (found := _labels(line, n_columns))]
    return Table(file, header, labels, values, body[skip:], separator)


def _split(line: str, separator: str) -> list[str]:
    cells = [cell.strip().strip('"') for cell in re.split(separator, line.strip())]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def _separator(line: str) -> str | None:
    """The separator that turns a line into numbers, None if none does."""
    for separator in _SEPARATORS:
        if all(to_number(cell) is not None for cell in _split(line, separator)):
            return separator
    return None


def _numbers(file: str, body: list[tuple[int, str]], separator: str, n_columns: int) -> np.ndarray:
    """The rows as an array; the fast parser where it takes them, else cell by cell, to name a spoilt one."""
    delimiter = {r"\t": "\t", r"\s+": None}.get(separator, separator)
    try:
        values = np.loadtxt([line for _, line in body], delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        values = None
    if values is not None and values.shape == (len(body), n_columns) and np.isfinite(values).all():
        return values
    cells = [_row(file, n, line, separator, n_columns) for n, line in body]
    return np.array([[to_number(cell) for cell in row] for row in cells])


def _row(file: str, number: int, line: str, separator: str, n_columns: int) -> list[str]:
    cells = _split(line, separator)
    where = f"{file}, line {number}"
    for cell in cells:
        value = to_number(cell)
        if value is None or not np.isfinite(value):
            raise not_a_number(where, cell)
    if len(cells) != n_columns:
        raise ValueError(
            f"{where}: rows must have {n_columns} values like the first, got {len(cells)}. "
            "Complete or cut the row."
        )
    return cells


def _labels(line: str, n_columns: int) -> list[str] | None:
    """One label per column, blanks allowed before a bracket: "time [s] acc [g]"."""
    ways = [_split(line, separator) for separator in _SEPARATORS]
    ways.append(re.findall(r"[^\s\[(]+\s*[\[(][^\])]*[\])]|\S+", line))
    return next((labels for labels in ways if len(labels) == n_columns), None)
