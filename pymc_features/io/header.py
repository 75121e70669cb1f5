"""Facts in the sentences of a file's header: numbers, units, widths of columns, peaks."""

import re

import numpy as np

from pymc_features._checks.messages import warn_caller
from pymc_features.io.lines import Lines, to_count, to_number
from pymc_features.io.units import known_factor

_WIDTH = re.compile(r"(?<!\d)\d{0,3}[FEI](\d{1,3})", re.IGNORECASE | re.ASCII)
_PUNCTUATION = ".,;:()="


def number_after(text: str, phrase: str) -> float | None:
    """The number that follows a phrase, in any case; None where there is none."""
    place = text.lower().find(phrase.lower())
    words = text[place + len(phrase) :].split() if place >= 0 else []
    for word in words[:2]:  # an equals sign may stand between them
        if (number := to_number(word.rstrip(",;"))) is not None and np.isfinite(number):
            return number
    return None


def count_before(text: str, word: str) -> int | None:
    """The whole number at the start of a line that goes on with a word; None where it does not."""
    parts = text.split(maxsplit=2)
    return to_count(parts[0]) if len(parts) > 1 and parts[1].lower().startswith(word) else None


def unit_in(text: str) -> str | None:
    """The first unit of acceleration among the words of a line, "cm/sec2" for example."""
    for mark in "()=,":
        text = text.replace(mark, " ")
    words = (word.strip(_PUNCTUATION) for word in text.split())
    return next((word for word in words if known_factor(word) is not None), None)


def column_width(text: str, otherwise: int) -> int:
    """Characters of each column by a Fortran format such as (8F10.3), which is the last in the line."""
    found = _WIDTH.findall(text[text.rfind("(") + 1 :]) if "(" in text else []
    return int(found[0]) if found and int(found[0]) > 0 else otherwise


def check_sections(lines: Lines, facts: dict[str, object]) -> None:
    """Refuse a header in which one of the named facts is missing, or is no positive number."""
    for what, value in facts.items():
        if value is None or (isinstance(value, int | float) and not 0 < value < np.inf):
            raise lines.error(f"the header must state {what}, a positive number", value)


def check_peak(lines: Lines, name: str, values: np.ndarray, stated: float | None) -> None:
    """Warn if the peak of the values is not the one that the file states, in the same unit."""
    if stated is None or values.size == 0:
        return
    peak, stated = float(np.abs(values).max()), abs(stated)
    if stated > 0.0 and abs(peak - stated) > 0.02 * stated + 0.005:
        warn_caller(
            f"{lines.title}, {name}: the file states a peak of {stated:.4g}, its values have {peak:.4g}. Is "
            "it damaged?"
        )
