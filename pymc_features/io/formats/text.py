"""Text files with columns of numbers: which lines are numbers, what separates them, time stamps."""

import csv
import re
from array import array
from contextlib import suppress
from datetime import UTC, datetime
from io import BytesIO
from itertools import chain, islice, pairwise, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pymc_features._checks import listed, require
from pymc_features.io.reading.labels import BRACKETS, SI, WORD, Label, role_of, unit_of
from pymc_features.io.reading.lines import Lines, finite, not_a_number, to_number
from pymc_features.io.reading.recording import Columns, Recording, Request, clock_column, recording_of

COMMENTS = ("#", "%", "//")
SEPARATORS = ("\t", ";", "|", ",", " ")
#: 20240131T120000, or without the T
COMPACT = re.compile(rb"(?<![\d.])((?:19|20)\d\d)([01]\d)([0-3]\d)T?([0-2]\d)([0-5]\d)([0-5]\d)(?!\d)")
NO_UNIT = {"", "-", "[]", "TS", "RN"}  # in a row of units; the last two in tables of Campbell's loggers, TOA5
WRAPPED = "Pass wrapped=True if one series runs along the lines"
MISSING = ("", "nan", "+nan", "-nan")  # cells of a gap, in lower case
MOST_HEADER_LINES = 10_000
FEW = 200_000  # characters that are read cell by cell before pandas is imported
SAMPLED = 200  # lines of usual length, at both ends, whose printed digits say how fine a column is
ENDS = 12  # lines that tell whether the last one is whole
DATES = ["%Y-%m-%d", "%d.%m.%Y", "%d-%b-%Y", "%d.%m.%y", "%d/%m/%Y"]
DATES += ["%m/%d/%Y", "%Y/%m/%d", "%Y.%m.%d", "%d-%m-%Y", "%m-%d-%Y"]
DATE = r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.](?:\d\d?|[A-Z][a-z]{2})[-/.]\d{4}|\d\d\.\d\d\.\d\d"
STAMP = re.compile(
    rf"(?a)(?:(?P<date>{DATE})(?:T|[ ,;]\s*))?"
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?P<fraction>[.,]\d+)?)?"
    r"(?P<half>\s?[AaPp][Mm])?(?P<zone>\s?Z|\s?UTC|\s?GMT|\s?[+-]\d\d:?\d\d)?"
)
#: A rate or a step above the numbers: "fs = 100 Hz", "Sampling interval (ms): 5", "Sampling rate 200 Hz".
STATED = re.compile(
    r"(?i)(?<![a-z])"
    r"(?:(?P<step>dt|delta[ _]?t|time[ _-]?step|(?:sampling|sample|scan)[ _-]*(?:interval|period))|fs|"
    r"(?:sampling|sample|scan|acquisition)[ _-]*(?:rate|frequency|freq)|abtast(?:rate|frequenz)|messrate)"
    r"\s*(?:[\[(](?P<unit>[^\])]*)[\])]\s*)?(?P<mark>[:=,;\s])[=\s]*(?P<number>[\d.,]*\d(?:e[+-]?\d+)?)"
    r"\s*(?P<behind>[a-zµμ/]*)"
)
#: The unit of all columns above the numbers: "# units: g", "Unit;mm/s²".
ALL_IN = re.compile(r"(?i)(?<![a-z])(?:units?|einheit(?:en)?)\s*[:=;,]\s*(\S+)\s*$")


class Layout(NamedTuple):
    """How the rows of numbers are written."""

    separator: str
    decimal: str
    count: int  # cells of a row
    stamp: tuple[int, ...] = ()  # cells of a time stamp: one, or that of the date and that of the time

    def cells(self, line: str) -> list[str]:
        """The cells of a row, time stamps in one, decimal points for commas."""
        cells = split(line, self.separator)
        cells = without_ends(cells) if len(without_ends(cells)) == self.count else cells
        if len(self.stamp) == 2:
            first, second = (cells[k : k + 1] for k in self.stamp)
            joint = "," if second and second[0].isdigit() else " "  # a fraction of a second, or the time
            cells[self.stamp[0] : self.stamp[1] + 1] = [joint.join(first + second)]
        if self.decimal == ",":
            cells = [cell if ":" in cell else _with_point(cell) for cell in cells]
        return cells

    @property
    def n_columns(self) -> int:
        return self.count - max(len(self.stamp) - 1, 0)


def split(line: str, separator: str) -> list[str]:
    """Cells of a line, without quotation marks, blanks around them, and an empty one at the end."""
    if separator == " ":
        return [cell.strip('"') for cell in line.split()]
    cells = line.split(separator) if '"' not in line else next(csv.reader([line], delimiter=separator), [])
    cells = [cell.strip().strip('"') for cell in cells]
    return cells[:-1] if len(cells) > 1 and not cells[-1] else cells


def without_ends(cells: list[str]) -> list[str]:
    """Cells without the empty ones at the end."""
    last = next((k for k in range(len(cells) - 1, 0, -1) if cells[k]), 0)
    return cells[: last + 1]


def _with_point(cell: str) -> str:
    """A number with a decimal point for its comma; one that has a point as well is none."""
    return f"{cell} (a point)" if "." in cell else cell.replace(",", ".")


def layout_of(line: str) -> Layout | None:
    """How a line is a row of numbers; None if it is none."""
    for decimal, separator in product(".,", SEPARATORS):
        if separator == decimal or (decimal == "," and "," not in line):
            continue
        cells = without_ends(split(line, separator))
        stamp = _stamp(cells) if ":" in line else ()
        rest = [cell for k, cell in enumerate(cells) if k not in stamp]
        rest = [_with_point(cell) for cell in rest] if decimal == "," else rest
        if rest and all(to_number(cell) is not None for cell in reversed(rest)):
            return Layout(separator, decimal, len(cells), stamp)
    return None


def _stamp(cells: list[str]) -> tuple[int, ...]:
    """The cells of the first time stamp, and of the date that stands beside it."""
    for k, cell in enumerate(cells):
        if STAMP.fullmatch(cell):
            dated = k > 0 and re.fullmatch(DATE, cells[k - 1]) is not None
            zoned = cells[k + 1 : k + 2] and re.fullmatch("[AaPp][Mm]", cells[k + 1])
            first, last = k - dated, k + bool(zoned)
            return (first,) if first == last else (first, last)
    return ()


def read_columns(path: Path, request: Request) -> Columns:
    """The table of a text file without the rows to skip; of a wrapped series one column, or two."""
    lines = Lines(path)
    if COMPACT.search(lines.raw, 0, FEW):
        lines.raw = COMPACT.sub(rb"\1-\2-\3T\4:\5:\6", lines.raw)
    header, first, layout = _header(lines)
    _refuse_spoilt_first(path.name, header, first, layout)
    start = sum(map(len, islice(BytesIO(lines.raw), first - 1)))
    places = (start, start + 80 * SAMPLED), (max(start, len(lines.raw) - 80 * SAMPLED), None)
    top, bottom = (lines.raw[slice(*place)].decode(errors="ignore").split("\n") for place in places)
    decimals = [len(layout.cells(row)[-1].partition(".")[2]) for row in bottom[-ENDS:] if row.strip()]
    if bottom[-1] and len(decimals) == ENDS and len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]:
        said = "with fewer decimals than the lines above it. Fetch the file again, or cut the line."
        raise ValueError(f"{path.name}: the last line must be whole, it ends in {bottom[-1][-12:]!r} {said}")
    found = None
    if len(lines.raw) > FEW and not request.wrapped:
        with suppress(ValueError, OverflowError):  # of a row that is not as the first
            found = _by_pandas(lines, start, top[0].rstrip(), layout)
    origin, values = found or _cell_by_cell(lines, first, layout, request)
    dt, stating = stated_step(path.name, header, layout.decimal)
    labels, own, unit = _labels(header, layout, stating)
    rows_in_line = 1.0
    if request.wrapped:
        values = values[~np.isnan(values)]
        paired = values.size % 2 == 0 and is_paired(values.reshape(-1, 2), layout.count)
        values = values.reshape(-1, 1 + paired)
        rows_in_line = layout.count / values.shape[1]
        labels, own = [Label("", "")] * values.shape[1], False
    values = values[request.skip :]
    require(len(values) > 1, f"{path.name} must hold at least 2 samples, got {len(values)}.")

    def where(row: int, column: int) -> str:
        line = int((row + request.skip) / rows_in_line)
        return f"{path.name}, line {next(islice(_rows(lines, first), line, None))[0]}"

    def resolution(index: int) -> float:
        rows = [layout.cells(row.strip())[index : index + 1] for row in [*top[:-1], *bottom[1:]] or top]
        largest, stamped = np.abs(values[:, index]).max(), layout.stamp[:1] == (index,)
        return _resolution(sum(rows, []), largest, stamped)

    stamp = layout.stamp[0] if layout.stamp else None
    return Columns(path.name, labels, values, where, resolution, own, stamp, origin, unit, dt)


def stated_step(file: str, header, decimal: str) -> tuple[float | None, list[int]]:
    """The step [s] that lines above the numbers state, as a step or as a rate, and which lines."""
    steps = {}
    for number, line, _ in header:
        for found in STATED.finditer(line):
            quantity, usual = ("time", "s") if found["step"] else ("frequency", "Hz")
            unit = unit_of(found["unit"] or found["behind"] or usual, quantity)
            value = to_number(found["number"].replace(",", "." if decimal == "," else ","))
            if value and (unit or found["mark"] in ":=,;"):
                in_si = value * (unit.factor if unit else 1.0)  # samples per second
                steps[number] = in_si if found["step"] else 1.0 / in_si
    first = next(iter(steps.values()), None)
    if not np.allclose([*steps.values()], first or 0.0, rtol=1e-3, atol=0.0):
        said = listed([f"line {number}: {step:g} s" for number, step in steps.items()])
        raise ValueError(f"{file} contradicts itself, it states more than one time step ({said}).")
    return first, list(steps)


def read_text(path: Path, request: Request) -> Recording:
    """The columns of a text file on their clock; lines that may be one wrapped series are a question."""
    columns = read_columns(path, request)
    known = clock_column(columns, request.clock) is not None or columns.own
    question, n_columns = "", columns.values.shape[1]
    if request.wrapped is None and n_columns > 2 and (not known or is_paired(columns.values, n_columns)):
        said = f"{columns.file} has lines of {n_columns} values without labels or clock"
        question = f"`wrapped` must be given, {said}. {WRAPPED}, else wrapped=False."
    return recording_of(columns, request, question)


def is_paired(values: np.ndarray, n_columns: int) -> bool:
    """Whether every other value (row, column) in reading order is a time that runs forward."""
    even = n_columns > 2 and n_columns % 2 == 0
    return even and all((np.diff(values[:n, ::2].ravel()) > 0.0).all() for n in (100, None))


def _header(lines: Lines) -> tuple[list[tuple[int, str, bool]], int, Layout]:
    """Number, text and whether it is a comment of each line above the numbers; the first of these; how."""
    header = []
    for (number, line), (_, after) in pairwise(chain(lines, [(0, "")])):
        comment = line.startswith(COMMENTS)
        layout = None if comment else layout_of(line)
        if layout is not None and (layout.decimal == "," or layout.stamp):  # the next must be written alike
            below = layout_of(after)
            alike = below is not None and (below.separator, below.stamp) == (layout.separator, layout.stamp)
            layout = layout if alike else None
        if layout is not None:
            return header, number, _decimal_commas(lines, number, header, layout)
        header.append((number, line.lstrip("#%/ \t") if comment else line, comment))
        if len(header) == MOST_HEADER_LINES:
            break
    require(header, f"{lines.file} must hold at least 2 samples, it is empty.")
    said = f"{'first ' * (len(header) == MOST_HEADER_LINES)}{len(header)} lines. "
    for (number, line, comment), separator in product(header, SEPARATORS):
        cells = without_ends(split(line, separator))
        odd = [c for c in cells if to_number(c) is None and to_number(c.replace(",", ".")) is None]
        if odd and len(cells) > 1 + len(odd) and not comment:
            what = repr(odd[0] or "an empty cell")
            said = f"{said}Line {number} has {what} among its numbers: leave such columns out. "
            break
    row = "A row is numbers, or a time stamp and numbers, with a comma, semicolon, bar, tab or blank between."
    raise ValueError(f"{lines.file} must hold rows of numbers, none was found in its {said}{row}")


def _decimal_commas(lines: Lines, first: int, header, layout: Layout) -> Layout:
    """The layout if commas do not separate: in 10:00:00,250 and in one column, 0,12, below a single label."""
    if layout.separator != ",":
        return layout
    rows = [split(line, ",") for _, line in islice(_rows(lines, first), SAMPLED)]
    if len(layout.stamp) == 1:  # seconds that stand twice go on in the cell behind them
        [k] = layout.stamp
        (now, fraction), (then, further) = ([*row[k : k + 2], "", ""][:2] for row in [*rows, []][:2])
        digits = fraction.isdigit() and further.isdigit() and len(fraction) == len(further) in (3, 6)
        if now == then and digits and now.count(":") == 2 and "." not in now and layout.count > k + 2:
            return layout._replace(stamp=(k, k + 1))
    elif layout == Layout(",", ".", 2) and all(len(row) == 2 for row in rows):
        plain = all(not set(".eE") & set("".join(row)) for row in rows)
        labels = [line for _, line, comment in header if not comment]
        single = bool(labels) and len(split(labels[-1], ",")) == 1 and len(WORD.findall(labels[-1])) == 1
        zeros = any(part[:1] == "0" and len(part) > 1 or whole == "-0" for whole, part in rows)
        return Layout(" ", ",", 1) if plain and (single or zeros) else layout
    return layout


def _refuse_spoilt_first(file: str, header, first: int, layout: Layout) -> None:
    """Refuse a row above the numbers that is one of them, but for a cell, or a whole one above the labels."""
    below_labels = False
    for number, line, comment in header:
        if comment:
            continue
        where, cells = f"{file}, line {number}", layout.cells(line)
        found = layout_of(line) if len(cells) == layout.n_columns else None
        if found is not None and found._replace(decimal=layout.decimal) == layout:
            raise ValueError(f"{where}: a row of numbers must not stand above the labels. Put these on top.")
        stamped = bool(layout.stamp) and bool(_stamp(cells))
        rest = [cell for cell in cells if not (stamped and STAMP.fullmatch(cell))]
        odd = [cell for cell in rest if to_number(cell) is None]
        measured = sum("." in cell for cell in rest if to_number(cell) is not None)
        beside = len(rest) == measured + 1 > layout.n_columns and not re.search("[A-Za-z]", "".join(odd))
        numeric = beside or re.match(r"\D?[\d.+-]|$", cells[0])  # as L0.0000
        most = 2 * measured >= len(cells)
        almost_all = number == first - 1 and 1 < layout.n_columns <= measured + 1 + stamped
        is_row = numeric and ((below_labels and most) or almost_all)
        swallowed = almost_all and below_labels and measured > 1
        if is_row or swallowed or (stamped and 2 * measured >= len(rest) > 0):
            raise not_a_number(where, next(iter(odd), cells[0]))
        below_labels |= len(cells) == layout.n_columns and len(odd) == len(rest)


def _labels(header, layout: Layout, stating: list[int]) -> tuple[list[Label], bool, str | None]:
    """What stands above each column, whether it is more than a title, and the unit of all columns.

    Of the lines of the header those that are `stating` a rate are no labels.
    """

    def is_of_units(cells: list[str]) -> bool:
        known = all(unit_of(cell.strip("[]()")) or cell in NO_UNIT for cell in cells)
        return cells[0] == "TS" or (any(cells) and known)

    candidates = (line for number, line, _ in header if number not in stating)
    candidates = [line for line in candidates if not ALL_IN.search(line)]
    stated = (match[1] for _, line, _ in header if (match := ALL_IN.search(line)))
    of_all = next((unit for unit in stated if unit_of(unit, *SI)), None)
    named = [cells for line in candidates if (cells := _named(line, layout))]
    units = [cells for cells in named if is_of_units(cells)]
    named = [cells for cells in named if cells not in units]
    texts = [cells for cells in named if all(to_number(cell) is None for cell in cells)]
    if not texts:
        found = (unit.strip() for _, line, _ in header for unit in BRACKETS.findall(line))
        unit = next((unit for unit in found if unit_of(unit, "acceleration")), None)
        return [Label("", "")] * layout.n_columns, bool(units), of_all or unit
    rows = [[Label.of(text) for text in cells] for cells in texts]
    n_roles = [sum(role_of(label.name) is not None for label in row) for row in rows]
    chosen = max(range(len(rows)), key=lambda k: (n_roles[k], k))
    labels = []
    for k, text in enumerate(texts[chosen]):
        stated = (cells[k].strip("[]()") for cells in units if cells[k] not in NO_UNIT)
        elsewhere = (row[k].unit for row in reversed(rows) if row[k].unit is not None)
        label = Label.of(text, next(stated, None))
        labels.append(label if label.unit is not None else label._replace(unit=next(elsewhere, None)))
    is_title = all(comment for _, line, comment in header if _named(line, layout) == texts[chosen])
    told = any(role_of(label.name) for label in labels) or not is_title
    own = any(label.unit is not None for label in labels) or (layout.separator != " " and told)
    return labels, own, of_all


def _named(line: str, layout: Layout) -> list[str] | None:
    """One label for each column, such as "time [s] acc [g]"; of the two of a time stamp the second."""
    own = split(line, layout.separator)
    own = own[: layout.count] if len(without_ends(own)) <= layout.count else own
    if len(layout.stamp) == 2 and len(own) == layout.count:
        return [*own[: layout.stamp[0]], *own[layout.stamp[1] :]]
    ways = [own, *(split(line, other) for other in SEPARATORS), WORD.findall(line)]
    return next((labels for labels in ways if len(labels) == layout.n_columns), None)


def _rows(lines: Lines, first: int):
    """Number and text of the rows of numbers."""
    return ((number, line) for number, line in lines if number >= first and not line.startswith(COMMENTS))


def _by_pandas(lines: Lines, start: int, first: str, layout: Layout) -> tuple[float, np.ndarray]:
    """Origin of the stamps and rows (row, column), all written as the first."""
    import pandas as pd  # half a second to import

    kinds = {k: str if k in layout.stamp else np.float64 for k in range(layout.count)}
    stream = BytesIO(lines.raw)  # which is not copied
    stream.seek(start)
    frame = pd.read_csv(
        stream,
        sep=r"\s+" if layout.separator == " " else layout.separator,
        header=None,
        decimal=layout.decimal,
        dtype=kinds,
        keep_default_na=False,
        skipinitialspace=f"{layout.separator} " in first,
        float_precision="round_trip" if int(pd.__version__.split(".")[0]) < 3 else None,
    )
    while frame.shape[1] > layout.count and layout.separator != " " and (frame.iloc[:, -1] == "").all():
        frame = frame.iloc[:, :-1]  # a separator at the end of each row
    origin = 0.0
    if layout.stamp:
        texts = [frame.pop(k) for k in layout.stamp]
        joint = "," if layout.separator == "," and texts[-1][0].isdigit() else " "
        origin, seconds = seconds_of([joint.join(row) for row in zip(*texts, strict=True)], lines.file)
        frame.insert(layout.stamp[0], "seconds", seconds)
    values = np.array([frame[k] for k in frame], dtype=np.float64).T  # columns whole
    require(values.shape[1] == layout.n_columns and np.isfinite(values).all(), "a row is not as the first")
    return origin, values


def _cell_by_cell(lines: Lines, first: int, layout: Layout, request: Request) -> tuple[float, np.ndarray]:
    """Rows of any spelling (row, column), NaN in gaps and behind a wrapped series."""
    values, texts, short = array("d"), [], None
    for number, line in _rows(lines, first):
        where, cells = f"{lines.file}, line {number}", layout.cells(line)
        if request.gaps and len(cells) + 1 == layout.n_columns and line.endswith(layout.separator):
            cells.append("")  # the last cell is empty
        if request.wrapped and short is None and 0 < len(cells) < layout.n_columns:
            short = number
            cells += [""] * (layout.n_columns - len(cells))
        elif short is not None:
            what = f"the first, which has {layout.n_columns}. Complete the line before this one"
            raise ValueError(f"{where}: only the last line of wrapped values may be shorter than {what}.")
        for k, cell in enumerate(cells):
            if layout.stamp and k == layout.stamp[0] and STAMP.fullmatch(cell):
                texts.append(cell)
                values.append(0.0)
            elif (request.gaps or number == short) and cell.lower() in MISSING:
                values.append(np.nan)
            else:
                values.append(finite(cell, where))
        if len(cells) != layout.n_columns:
            said = f"rows must have {layout.n_columns} values like the first, got {len(cells)}"
            raise ValueError(f"{where}: {said}. Complete or cut the row. {WRAPPED}.")
    found = np.array(values).reshape(-1, layout.n_columns)
    origin = 0.0
    if layout.stamp:
        origin, found[:, layout.stamp[0]] = seconds_of(texts, lines.file)
    return origin, found


def _resolution(cells: list[str], largest: float, stamped: bool) -> float:
    """Resolution of a printed column, from decimals and significant digits of some of its cells."""
    if stamped:
        stamps = (STAMP.fullmatch(cell) for cell in cells)
        return 10.0 ** min((1 - len(stamp["fraction"] or ".") for stamp in stamps if stamp), default=0)
    least, digits = 0, 1
    for cell in cells:
        if to_number(cell) is not None:
            mantissa, _, power = cell.lower().replace("d", "e").partition("e")
            whole, _, decimals = mantissa.lstrip("+-").partition(".")
            least = min(least, max(int(power or 0) - len(decimals), -300))
            digits = max(digits, len((whole + decimals).lstrip("0")))
    if largest == 0.0:
        return 10.0**least
    return max(10.0**least, 10.0 ** (np.floor(np.log10(largest)) - digits + 1))


def seconds_of(texts: list[str], file: str) -> tuple[float, np.ndarray]:
    """Midnight before the first time stamp [s since 1970], 0 without dates, and the seconds since."""
    found = [STAMP.fullmatch(text) for text in texts]
    if None in found:
        raise ValueError(f"{file}: time stamps must be as the first, got {texts[found.index(None)]!r}.")
    dates, ways = list(dict.fromkeys(match["date"] for match in found if match["date"])), []
    for form in DATES if dates else ():
        with suppress(ValueError):
            ways.append({d: datetime.strptime(d, form).replace(tzinfo=UTC).timestamp() for d in dates})
    # of two ways to read them the nearer dates
    days = min(ways, key=lambda way: max(way.values()) - min(way.values()), default={})
    what = f"those of a calendar, all written alike, got {', '.join(dates[:3])}"
    require(days or not dates, f"{file}: dates must be {what}. Correct them.")
    origin, seconds = min(days.values(), default=0.0), []
    for match in found:
        date, hour, minute, second, fraction, half, zone = match.groups()
        hour = int(hour) if not half else int(hour) % 12 + 12 * (half.strip().lower() == "pm")
        of_day = 3600 * hour + 60 * int(minute) + int(second or 0)
        if (zone := (zone or "Z").strip()) not in ("Z", "UTC", "GMT"):
            of_day -= (60 * int(zone[1:3]) + int(zone[-2:])) * (60 if zone[0] == "+" else -60)
        of_day += float((fraction or "0").replace(",", "."))
        seconds.append(days.get(date, origin) - origin + of_day)
    seconds = np.array(seconds)
    if not days:
        seconds[1:] += 86400.0 * np.cumsum(np.diff(seconds) < -43200.0)
    return origin, seconds
