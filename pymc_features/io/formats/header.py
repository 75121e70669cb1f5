"""What headers of strong-motion records state: facts by label, numbers, units, widths of columns, peaks."""

import re
from collections.abc import Callable

import numpy as np

from pymc_features._checks import warn_caller
from pymc_features.io.reading.lines import Lines, to_count, to_number
from pymc_features.io.reading.recording import Channel, Format, Opening, Recording
from pymc_features.io.reading.units import known_factor

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


def series(
    lines: Lines, name: str, count: int | None, dt: float | None, width: int, unit: str | None, peak=None
) -> Channel:
    """The announced number of values in columns, at a stated step, with the peak that the file states."""
    check_sections(lines, {"the number of points": count, "the step": dt})
    values = lines.fields(count, width, "values")
    check_peak(lines, name, values, peak)
    return Channel(name, values, unit, dt)


def check_end(lines: Lines, what: str) -> None:
    """Refuse anything but blanks below the values."""
    if (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow {what}", repr(line.strip()[:60]))


def labelled(lines: Lines, end: str | None = None, most: int = 300) -> dict[str, str]:
    """Facts by their labels, `LABEL: value`, down to a line that begins with `end` or to the first number.

    A label is in capitals and stays with its first value. The line that begins with `end` is taken, a number
    is not.
    """
    facts = {}
    for _ in range(most):
        if end is None:
            following = (lines.peek() or "").split()
            if following and all(to_number(word) is not None for word in following):
                return facts
        line = lines.take("a header and values")
        if end is not None and line.strip().upper().startswith(end):
            return facts
        label, colon, value = line.partition(":")
        if colon:
            facts.setdefault(" ".join(label.upper().split()), value.strip())
    raise lines.error(f"the header must end within {most} lines", "more")


def demand(lines: Lines, facts: dict[str, str], label: str) -> str:
    """The value of a label that must be there."""
    if not facts.get(label):
        raise lines.error(f"the header must state {label}", "nothing")
    return facts[label]


def format_of_lines(name: str, begins: str | Callable, files: str, states: str, read: Callable) -> Format:
    """A format whose reader takes `Lines` and gives channels, or these and the name of the recording.

    It is known by how its files begin, a pattern of the first lines in lower case, or a function of them.
    """

    def recording(path, request) -> Recording:
        found = read(Lines(path, name.partition(" and ")[0]))
        channels, title = found if isinstance(found, tuple) else (found, None)
        return Recording(path.name, channels, title)

    def recognises(opening: Opening) -> bool:
        return re.match(begins, "\n".join(opening.lines[:30]).lower()) is not None

    return Format(name, recognises if isinstance(begins, str) else begins, files, states, recording)
