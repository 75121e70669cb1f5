"""NSMN, the national strong-motion network of Turkey: labelled facts above three columns in gal.

Disaster and Emergency Management Authority (AFAD), text files of the Turkish National Strong Motion Network,
https://tadas.afad.gov.tr; the facts that are used stand by name in each file.
"""

from pathlib import Path

from pymc_features.io.header import check_sections
from pymc_features.io.labelled import demand, labelled
from pymc_features.io.lines import Lines, to_count, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "NSMN"
DIRECTIONS = "N-S"  # the line with the directions begins so


def recognises(opening: Opening) -> bool:
    """The first line is a title."""
    return opening.first.lstrip().startswith("strong ground motion records of turk")


def read(path: Path) -> tuple[list[Channel], None]:
    """The three components of a file [gal]."""
    lines = Lines(path, NAME)
    lines.take("a title")
    facts = labelled(lines, DIRECTIONS)
    directions = lines.last.split()
    n_times = to_count(demand(lines, facts, "NUMBER OF DATA"))
    dt = to_number(demand(lines, facts, "SAMPLING INTERVAL (SEC)"))
    check_sections(lines, {"the number of data": n_times, "the sampling interval": dt})
    values = lines.rows(n_times, len(directions), "rows, the number of data")
    if (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow the {n_times} rows", repr(line.strip()[:60]))
    return [Channel(name, column, "gal", dt) for name, column in zip(directions, values.T, strict=True)], None


NSMN = Format(NAME, recognises, ".txt", "step, directions; gal", recorded(read))
