"""SMC, the text format of the United States Geological Survey: one series below text, integers and reals.

Corrected series are even at the rate of the second real. Uncorrected ones of film have no rate: their
values are pairs of time and acceleration, and the times are uneven.

U.S. Geological Survey, National Strong-Motion Program, SMC-format Data Files, sections 3 and 4,
https://escweb.wr.usgs.gov/nsmp-data/smcfmt.html.
"""

from pathlib import Path

import numpy as np

from pymc_features.io.header import check_peak, check_sections
from pymc_features.io.lines import Lines
from pymc_features.io.recording import Channel, Format, Opening, even_or_times, recorded

NAME = "SMC"
QUANTITIES = ("accelerogram", "velocity", "displacement", "spectra", "spectrum")
N_COMMENTS, N_VALUES = 15, 16  # of the 48 integers
NULL, RATE, HIGHEST, LOWEST = 0, 1, 29, 31  # of the 50 reals
DIGITS = 5  # that are printed of every value


def recognises(opening: Opening) -> bool:
    """A digit and the quantity in the first line, a star in the second."""
    first, lines = opening.first, opening.lines
    return (
        first[:1].isdigit()
        and any(word in first for word in QUANTITIES)
        and len(lines) > 1
        and lines[1].startswith("*")
    )


def read(path: Path) -> tuple[list[Channel], None]:
    """The acceleration of a file [cm/s^2]."""
    lines = Lines(path, NAME)
    text = [lines.take("11 lines of text") for _ in range(11)]
    if "accelerogram" not in text[0].lower():
        raise ValueError(f"{lines.title} must hold an acceleration, got {text[0].strip()[:40]!r}.")
    integers = lines.fields(48, 10, "integers")
    reals = lines.fields(50, 15, "reals")
    n_comments, n_values = (int(integers[index]) for index in (N_COMMENTS, N_VALUES))
    check_sections(lines, {"the number of values": n_values})
    for _ in range(max(n_comments, 0)):
        if not lines.take(f"{n_comments} comments").startswith("|"):
            raise lines.error("a comment must begin with |", "another line")
    values = lines.fields(n_values, 10, "values")
    if (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow the {n_values} values", repr(line.strip()[:60]))
    name = " ".join(text[5].partition("component=")[2].split()) or "acceleration"
    channel = _channel(lines, name, values, reals)
    check_peak(lines, name, channel.values, _peak(reals))
    return [channel], None


def _channel(lines: Lines, name: str, values: np.ndarray, reals: np.ndarray) -> Channel:
    """Even values, or pairs of time [s] and value where no rate is stated."""
    if not _is_null(reals, RATE):
        check_sections(lines, {"the samples in a second": float(reals[RATE])})
        return Channel(name, values, "cm/s^2", 1.0 / float(reals[RATE]))
    if values.size % 2 or values.size < 4:
        raise lines.error("values without a rate must be pairs of time and acceleration", values.size)
    times, values = values.reshape(-1, 2).T
    quantum = 10.0 ** (np.floor(np.log10(max(times[-1], 1e-9))) - DIGITS + 1)
    return Channel(name, values, "cm/s^2", **even_or_times(times, quantum, lambda row: lines.where()))


def _is_null(reals: np.ndarray, index: int) -> bool:
    return bool(np.isclose(reals[index], reals[NULL], rtol=1e-3))


def _peak(reals: np.ndarray) -> float | None:
    """The largest absolute value of the header, None where it states none."""
    stated = [abs(float(reals[index])) for index in (HIGHEST, LOWEST) if not _is_null(reals, index)]
    return max(stated, default=None)


SMC = Format(NAME, recognises, ".smc", "step (times, of film), component, peak; cm/s^2", recorded(read))
