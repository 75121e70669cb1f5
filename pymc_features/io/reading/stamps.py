"""Time stamps and decimal commas in the rows of text files, as numbers that any reader takes."""

import re
from datetime import datetime
from functools import lru_cache

DATES = "%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d"
STAMP = re.compile(
    r"""["']?(?:(?P<date>\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})(?:T|["']?[ ;,\t]\s*["']?))?"""
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?P<fraction>[.,]\d+)?)?"
    r"""(?P<half>\s?[AaPp][Mm])?(?P<zone>\s?Z|\s?[+-]\d\d:?\d\d)?["']?""",
    re.ASCII,
)


def without_stamp(line: str) -> str:
    """A line with its first time stamp as seconds since its year began, or since midnight without a date.

    A time zone is taken into account, a half of the day too. The line as it is where there is no stamp.

    Examples
    --------
    >>> without_stamp("2024-01-01T10:00:00.010Z,0.5"), without_stamp("02.01.2024;00:00:01;3")
    ('36000.010,0.5', '86401;3')
    """
    if (found := stamp_in(line)) is None:
        return line
    hour = int(found["hour"])
    if found["half"]:
        hour = hour % 12 + (12 if found["half"].strip().lower() == "pm" else 0)
    seconds = 3600 * hour + 60 * int(found["minute"]) + int(found["second"] or 0)
    if found["date"]:
        seconds += 86400 * (day_of(found["date"]) - 1)
    if (zone := (found["zone"] or "Z").strip()) != "Z":
        seconds -= (60 * int(zone[1:3]) + int(zone[-2:])) * (60 if zone[0] == "+" else -60)
    fraction = (found["fraction"] or "").replace(",", ".")
    return f"{line[: found.start()]}{seconds}{fraction}{line[found.end() :]}"


def stamp_in(line: str) -> re.Match | None:
    """The first time stamp of a line that begins a cell."""
    found = STAMP.search(line) if ":" in line else None
    begins = found is not None and (found.start() == 0 or line[found.start() - 1] in ",; \t")
    return found if begins else None


@lru_cache(64)
def day_of(date: str) -> int:
    """Number of a date in its year."""
    plain = date.replace(".", "-").replace("/", "-") if date[:4].isdigit() else date
    for form in DATES:
        try:
            return datetime.strptime(plain, form).timetuple().tm_yday
        except ValueError:
            continue
    return 0


def with_points(line: str) -> str:
    """A line with decimal points for decimal commas; another mark must separate its cells."""
    return line.replace(",", ".")


#: Whether stamps are numbers then, and what makes a row one of numbers; tried in this order.
CONVERSIONS = (
    (False, lambda line: line),
    (True, without_stamp),
    (False, with_points),
    (True, lambda line: with_points(without_stamp(line))),
)
