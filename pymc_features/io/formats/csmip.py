"""CSMIP and CESMD, volumes 1 and 2: text and numbers above each channel of a station, in lines of 80.

Volume 1 holds uncorrected accelerations: digital ones at a stated rate, those of film as pairs of time and
value. Volume 2 holds corrected acceleration, velocity and displacement. Volume 3 holds spectra.

Shakal, A. F. and Huang, M. J., Standard Tape Format for CSMIP Strong-Motion Data Tapes, California Division
of Mines and Geology, Report OSMS 85-03, 1985.
"""

from pathlib import Path

from pymc_features.io.header import (
    check_peak,
    check_sections,
    column_width,
    count_before,
    number_after,
    unit_in,
)
from pymc_features.io.lines import Lines, to_count
from pymc_features.io.recording import Channel, Format, Opening, even_or_times, recorded

NAME = "CSMIP"
UNCORRECTED, CORRECTED = "uncorrected accelerogram data", "corrected accelerogram"
SPECTRA = "response and fourier"
NUMBERS = {1: 14, 2: 20}  # lines of integers and reals below the text, by volume
TEXT = {1: 13, 2: 25}
PAIR_WIDTH, PAIR_QUANTUM = 7, 1e-3  # characters; [s]


def recognises(opening: Opening) -> bool:
    """The first line says which volume it is, and those after it how it came from the one before."""
    second = opening.lines[1].lower() if len(opening.lines) > 1 else ""
    return (
        opening.first.lstrip().startswith(UNCORRECTED)
        or (opening.first.lstrip().startswith(CORRECTED) and "uncorrected accelerogram" in second)
        or (opening.first.lstrip().startswith(SPECTRA) and CORRECTED in second)
    )


def read(path: Path) -> tuple[list[Channel], None]:
    """All channels of a file of either volume."""
    lines = Lines(path, NAME)
    channels = []
    while (line := lines.peek()) is not None:
        first = line.strip().lower()
        if first.startswith("/&") or first.startswith("end"):
            while not lines.take("the end of a channel").strip():
                pass
        elif first.startswith(UNCORRECTED):
            channels.append(_volume_1(lines))
        elif first.startswith(CORRECTED):
            channels.append(_volume_2(lines))
        elif first.startswith(SPECTRA):
            raise lines.error("the file must hold accelerations", "spectra (V3)", "Read the V2 file.")
        else:
            raise lines.error("a channel or its end must follow", repr(line.strip()[:60]))
    return channels, None


def _header(lines: Lines, volume: int) -> list[str]:
    """Text lines of a channel; its numbers repeat what they and the line above the values say."""
    while not (first := lines.take("a channel")).strip():
        pass
    text = [first, *(lines.take(f"{TEXT[volume]} lines of text") for _ in range(TEXT[volume] - 1))]
    for _ in range(NUMBERS[volume]):
        lines.take(f"{NUMBERS[volume]} lines of numbers below the text")
    return [" ".join(line.split()) for line in text]


def _volume_2(lines: Lines) -> Channel:
    text = _header(lines, 2)
    channel = _section(lines, "accel", text[7])
    check_peak(lines, channel.name, channel.values, number_after(text[17], "peak acceleration"))
    while (line := lines.peek()) is not None and "points of" in line.lower():
        _section(lines, line.lower().partition("points of")[2].split()[0], "")
    return channel


def _section(lines: Lines, quantity: str, name: str) -> Channel:
    """A series below the line that says how many values there are, how far apart, and in which unit."""
    line = lines.take("the number of points").lower()
    n_times, dt = count_before(line, "points"), number_after(line, "spaced at")
    if quantity not in line:
        raise lines.error(f"the number of points of {quantity} data must stand here", repr(line.strip()[:60]))
    check_sections(lines, {"the number of points": n_times, "the step": dt})
    values = lines.fields(n_times, column_width(line, 10), "values")
    return Channel(name, values, unit_in(line.partition("sec")[2]), dt)


def _volume_1(lines: Lines) -> Channel:
    text = _header(lines, 1)
    following = (lines.peek() or "").lower()
    if "points" not in following:
        return _pairs(lines, text)
    line = lines.take("the number of points").lower()
    n_times, rate = to_count(line.split()[0]), number_after(line, "points at")
    check_sections(lines, {"the number of points": n_times, "the samples in a second": rate})
    if "pts/sec" not in line:
        raise lines.error("the rate must be in pts/sec", repr(line.strip()[:60]))
    values = lines.fields(n_times, column_width(line, 9), "values")
    factor, unit = _unit(line.partition("units of")[2])
    return Channel(text[6], factor * values, unit, 1.0 / rate)


def _pairs(lines: Lines, text: list[str]) -> Channel:
    """Pairs of time [s] and value, digitised from film."""
    n_pairs = number_after(text[10], "points")
    check_sections(lines, {"the number of points": n_pairs})
    if n_pairs != round(n_pairs):
        raise lines.error("the number of points must be whole", n_pairs)
    pairs = lines.fields(2 * int(n_pairs), PAIR_WIDTH, "times and values").reshape(-1, 2)
    factor, unit = _unit(text[11].lower().partition(" and ")[2])
    spacing = even_or_times(pairs[:, 0], PAIR_QUANTUM, lambda row: lines.where())
    return Channel(text[6], factor * pairs[:, 1], unit, **spacing)


def _unit(text: str) -> tuple[float, str | None]:
    """Factor and unit of "g/10", "g ." and the like."""
    word = next(iter(text.split()), "").strip(".,").lower()
    return (0.1, "g") if word == "g/10" else (1.0, unit_in(word))


CSMIP = Format(
    NAME + " and CESMD",
    recognises,
    ".v1, .v2, .raw",
    "step (times, of film), units, channels, peak; V3 files hold spectra and are refused",
    recorded(read),
)
