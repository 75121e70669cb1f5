"""Files that can be read; lines and numbers of any text file, in time and memory proportional to its size."""

import codecs
import gzip
import re
import zipfile
from array import array
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from io import BytesIO
from itertools import chain
from pathlib import Path

import numpy as np

from pymc_features._checks import require, warn_caller

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eEdD][-+]?\d+)?", re.ASCII)
_WIDTH = re.compile(r"(?<!\d)\d{0,3}[FEI](\d{1,3})", re.IGNORECASE | re.ASCII)
_PLUS = re.compile(r"(?<![eEdD])\+")  # in front of a number, not of an exponent
_WHOLE = re.compile(r"[-+]?\d+", re.ASCII)
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)

LONGEST_NUMBER = 100  # characters
TIMES = 20  # the size of the file
ALWAYS = 64 * 2**20  # bytes; small files of much compressed or sparse arrays
GZIP, ZIP = b"\x1f\x8b", b"PK\3\4"  # the first bytes; a spreadsheet is a zip file
SAMPLE = 400  # bytes that tell the encoding
RARE, FEWEST_LINES = 0.02, 8  # of lines of another width than the others, and how many tell the width


def most_bytes(path: Path) -> int:
    """What the arrays of a file may take: twenty times its size, and 64 MiB of small ones."""
    return max(TIMES * path.stat().st_size, ALWAYS)


def check_size(path: Path, n_bytes: Iterable[int]) -> None:
    """Refuse arrays of more bytes than those of a file may take."""
    if (promised := sum(map(int, n_bytes))) > most_bytes(path):
        most = f"{TIMES} times its size and {ALWAYS // 2**20} MiB"
        said = f"got {promised:.3g} bytes. Is it damaged? If not, save it uncompressed."
        raise ValueError(f"{path.name} must not hold arrays of more than {most}, {said}")


def decoded(raw: bytes) -> str:
    """Text of a file in UTF-8, UTF-16 (with its mark or not) or Latin-1, line feeds for any line ends."""
    even, odd = raw[:SAMPLE:2], raw[1:SAMPLE:2]
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = raw.decode("utf-16", errors="replace")
    elif len(odd) > 1 and any(even) != any(odd) and (all(even) or all(odd)):
        text = raw.decode("utf-16-le" if any(even) else "utf-16-be", errors="replace")
    else:
        try:
            text = raw.removeprefix(codecs.BOM_UTF8).decode()
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    return text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def text_in(path: Path) -> bytes:
    """What a file holds: unpacked by gzip, the sheet of a spreadsheet with a tab between its cells."""
    raw = path.read_bytes()
    if raw.startswith(GZIP):
        with by_library("gzip", "", path, "gzip"), gzip.open(path) as file:
            raw = file.read(most_bytes(path) + 1)
        check_size(path, [len(raw)])
    if not raw.startswith(ZIP):
        return raw
    with by_library("openpyxl", "daq", path, "spreadsheet (.xlsx)", "Save one sheet as CSV."):
        held = zipfile.ZipFile(BytesIO(raw)).infolist()
        is_book = any(entry.filename.startswith("xl/") for entry in held)
    require(is_book, f"{path.name} must be a text file, got a zip file of {len(held)} files. Unpack it.")
    check_size(path, [entry.file_size for entry in held])
    with by_library("openpyxl", "daq", path, "spreadsheet (.xlsx)", "Save one sheet as CSV."):
        from openpyxl import load_workbook

        book = load_workbook(BytesIO(raw), read_only=True, data_only=True)
        sheets = {sheet.title: [*sheet.iter_rows(values_only=True)] for sheet in book.worksheets}
    is_number = {
        name: [isinstance(cell, float | int) for cell in chain(*rows)] for name, rows in sheets.items()
    }
    counts = {name: sum(cells) for name, cells in is_number.items()}
    largest = max(counts, key=counts.get)
    several = [name for name, count in counts.items() if 10 * count > counts[largest]]
    said = f"got {', '.join(map(repr, several[:5]))}. Save each as a file of its own."
    require(len(several) < 2, f"{path.name} must have its numbers in one sheet, {said}")
    rows = (["" if cell is None else str(cell) for cell in row] for row in sheets[largest])
    return "\n".join("\t".join(row) for row in rows).encode()


class Lines:
    """The lines of a text file, which messages call by its format, if that is known; no binary data."""

    def __init__(self, path: Path, format_name: str = ""):
        raw = text_in(path)
        plain = raw.isascii() and b"\r" not in raw and b"\0" not in raw
        self.raw = raw if plain else decoded(raw).encode(errors="replace")  # UTF-8 with line feeds
        if b"\0" in self.raw:
            raise ValueError(f"{path.name} must be a text file, it holds binary data. Export it as CSV.")
        self.file, self.stem = path.name, path.stem
        self.title = f"{path.name} ({format_name})" if format_name else path.name
        self.number, self.last = 0, ""  # of the line that was taken last, and what it says
        self.announced, self.event = "", None  # which numbers were read last; what the recording is called

    @cached_property
    def whole(self) -> list[str]:
        """All lines, as they are."""
        return self.raw.decode().removesuffix("\n").split("\n")

    def __iter__(self) -> Iterator[tuple[int, str]]:
        """Number, from 1, and text of every line that is not blank, without blanks around it."""
        for number, raw in enumerate(BytesIO(self.raw), 1):  # most callers need the first ones only
            if line := raw.decode().strip():
                yield number, line

    def peek(self) -> str | None:
        """The next line that is not blank, None at the end of the file; blank ones before it are passed."""
        while self.number < len(self.whole):
            if (line := self.whole[self.number]).strip():
                return line
            self.number += 1
        return None

    def take(self, what: str) -> str:
        """The next line, blank or not; `what` it should be, for the message at the end of the file."""
        if self.number >= len(self.whole):
            raise ValueError(f"{self.title} must hold {what}, it ends at line {self.number}. Fetch it again.")
        self.last = self.whole[self.number]
        self.number += 1
        return self.last

    def several(self, count: int, what: str) -> list[str]:
        """The next lines, as many as `what` says."""
        return [self.take(f"{count} {what}") for _ in range(count)]

    def where(self) -> str:
        """How a message calls the line that was taken last."""
        return f"{self.title}, line {self.number}"

    def error(self, condition: str, got=None, advice: str = "Fetch the file again.") -> ValueError:
        """The error about the line that was taken last, which is what was got unless something is said."""
        got = repr(self.last.strip()[:80]) if got is None else got
        return ValueError(f"{self.where()}: {condition}, got {got}. {advice}")

    def require(self, holds, condition: str, got=None, advice: str = "Fetch the file again.") -> None:
        """Refuse what does not hold of the line that was taken last."""
        if not holds:
            raise self.error(condition, got, advice)

    def numbers(self, count: int, what: str, width=0, *, whole=False, per_line=0) -> np.ndarray:
        """Numbers (count,) from as many lines as it takes, between blanks or in columns, which may touch."""
        values, self.announced = array("d"), f"{count // (per_line or 1)} {what}"
        while len(values) < count:
            line, where = self.take(self.announced).rstrip(), self.where()
            tokens = line.split()
            if width:
                tokens = [line[start : start + width].lstrip() for start in range(0, len(line), width)]
                fills, got = line and len(line) % width == 0, f"{len(line)} characters"
                self.require(fills, f"values must fill columns of {width} characters", got)
                per_line = per_line or len(tokens)
            last = width and len(values) + len(tokens) == count
            if per_line and not last and (len(tokens) % per_line if width else len(tokens) != per_line):
                raise self.error(f"lines must hold {per_line} values", len(tokens))
            for token in tokens:
                if whole and not _WHOLE.fullmatch(token):
                    raise self.error("values must be counts, whole numbers", repr(token[:60]))
                values.append(finite(token, where))
        if len(values) != count:
            raise self.error(f"the file must hold the {count} {what} that it announces", len(values))
        return np.array(values)


def column_width(text: str, otherwise: int) -> int:
    """Characters of each column by a Fortran format such as (8F10.3), which is the last in the line."""
    found = _WIDTH.findall(text[text.rfind("(") + 1 :]) if "(" in text else []
    return int(found[0]) if found and int(found[0]) > 0 else otherwise


def warn_of_widths(title: str, lines: Iterable[tuple[int, str]]) -> None:
    """Tell of a line of numbers in columns whose length, or plus sign, few others have."""
    found = [(number, len(line.rstrip()), _PLUS.search(line) is not None) for number, line in lines]
    if len(found) <= FEWEST_LINES:
        return
    numbers, lengths, plus = np.array(found).T
    usual, few = np.bincount(lengths[:-1]).argmax(), max(1, RARE * len(found))
    odd = lengths[:-1] != usual
    if 0 < odd.sum() <= few:
        said = f"the line has {lengths[odd.argmax()]} characters, others {usual}. Is a digit or a sign lost?"
        warn_caller(f"{title}, line {numbers[odd.argmax()]}: numbers must fill their columns, {said}")
    elif 0 < plus.sum() <= few:
        number = numbers[plus.argmax()]
        warn_caller(f"{title}, line {number}: a number has a plus sign, others have none. Is it one?")


def to_number(token: str) -> float | None:
    """Value of a decimal number (E or D exponent), NaN for nan and inf, None for anything else."""
    if len(token) > LONGEST_NUMBER:
        return None
    if _NUMBER.fullmatch(token):
        return float(token.replace("d", "e").replace("D", "e"))
    return np.nan if _NOT_FINITE.fullmatch(token) else None


def to_count(token: str) -> int | None:
    """A whole number of at most twelve digits, None for anything else."""
    return int(token) if token.isascii() and token.isdigit() and len(token) <= 12 else None


def finite(token: str, where: str) -> float:
    """Value of a finite number; `where` is how a message calls its place."""
    number = to_number(token)
    if number is None or not -np.inf < number < np.inf:
        raise not_a_number(where, token)
    return number


def not_a_number(where: str, token: str) -> ValueError:
    """The error for a token that is no finite number."""
    what = repr(token if len(token) <= 60 else f"{token[:60]}...") if token else "an empty cell"
    return ValueError(f"{where}: values must be finite numbers, got {what}. Correct or cut it first.")


@contextmanager
def by_library(name: str, extra: str, path: Path, kind: str, again="Fetch it again.") -> Iterator[None]:
    """The errors of a library in our words: that it is not installed, or cannot read a file."""
    try:
        yield
    except ImportError as error:
        said = f"{name} must be installed to read {path.name}, a {kind} file, got none. Install it with"
        raise ImportError(f'{said}: python -m pip install "pymc-features[{extra}]".') from error
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        said = f"{name} cannot read it ({shortened(error)}). {again}"
        raise ValueError(f"{path.name} must be a whole {kind} file, {said}") from error


def shortened(error: Exception) -> str:
    """What another library says, in printable characters and not at length."""
    text = " ".join(str(error).split())
    text = "".join(character if character.isprintable() else "?" for character in text)
    return text if len(text) <= 300 else f"{text[:300]}..."
