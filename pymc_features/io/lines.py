"""Files that can be read; lines and numbers of any text file."""

import codecs
import re
from pathlib import Path

import numpy as np

#: Pattern of a decimal number with an E or a Fortran D exponent.
FLOAT = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"
_NUMBER = re.compile(FLOAT, re.ASCII)
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)


def check_readable(path: Path) -> None:
    """Refuse folders, missing files and files that cannot be opened."""
    if path.is_dir():
        raise IsADirectoryError(f"`path` must be a file, got the folder {path}. Name a file in it.")
    if not path.exists():
        raise FileNotFoundError(
            f"`path` must be an existing file, got {path}. The current folder is {Path.cwd()}."
        )
    try:
        path.open("rb").close()
    except OSError as error:
        raise type(error)(f"`path` must be readable, got {path}: {error.strerror}.") from error


def read_lines(path: Path) -> list[str]:
    """Lines of a text file with any line ends (LF, CR LF, CR CR LF, CR) and byte-order mark."""
    raw = path.read_bytes()
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = raw.decode("utf-16", errors="replace")
    elif b"\0" in raw:
        raise ValueError(f"{path.name} must be a text file, it holds binary data. Export it as CSV.")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    return re.split(r"\r*\n|\r", text)


def to_number(token: str) -> float | None:
    """Value of a decimal number (E or D exponent), NaN for nan and inf, None for anything else."""
    if _NUMBER.fullmatch(token):
        return float(token.replace("d", "e").replace("D", "e"))
    return np.nan if _NOT_FINITE.fullmatch(token) else None


def not_a_number(where: str, token: str) -> ValueError:
    """The error for a token that is no finite number."""
    what = "an empty cell" if not token else repr(token)
    return ValueError(f"{where}: values must be finite numbers, got {what}. Correct or cut it first.")
