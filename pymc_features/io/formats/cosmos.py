"""COSMOS V0 to V2: text, integers, reals and comments above each series, with the format of its columns.

Consortium of Organizations for Strong-Motion Observation Systems, COSMOS Strong Motion Data Format, version
1.20, 2001: Tables 2 (units), 9 (text header), 10 (integers) and 11 (reals).
"""

from pathlib import Path

from pymc_features.io.header import (
    check_peak,
    check_sections,
    column_width,
    count_before,
    number_after,
)
from pymc_features.io.lines import Lines, to_count
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "COSMOS"
UNITS = {  # code: factor and unit; the file's own word for others
    2: (1.0, "g"),
    4: (1.0, "cm/s^2"),
    7: (0.0254, "m/s^2"),
    10: (1.0, "gal"),
    11: (1e-3, "g"),
    12: (1e-6, "g"),
}
QUANTITIES = ("accel", "veloc", "displ", "rotat", "angul", "press", "strain", "speed")
STEP, RAW_STEP, PEAK = 61, 33, 63  # reals: of the series [ms], of the recorder [s], signed


def recognises(opening: Opening) -> bool:
    """The first line names the version and the number of text lines."""
    return "(format v" in opening.first and "text lines" in opening.first


def read(path: Path) -> tuple[list[Channel], None]:
    """All accelerations of a file, each below headers of its own."""
    lines = Lines(path, NAME)
    channels = []
    while (line := lines.peek()) is not None:
        if "(format v" not in line.lower():
            raise lines.error("the next channel must begin with its format version", repr(line.strip()[:60]))
        channels += _channel(lines)
    return channels, None


def _channel(lines: Lines) -> list[Channel]:
    """The accelerations below one set of headers."""
    while (first := lines.take("a channel")).strip() == "":
        pass
    if "spectr" in first.lower():
        raise lines.error("the file must hold accelerations", "spectra (V3)", "Read the V2 file.")
    n_text = to_count(next(iter(first.lower().rpartition("with")[2].split()), ""))
    check_sections(lines, {"the number of text lines": n_text})
    text = [lines.take(f"{n_text} lines of text") for _ in range(n_text - 1)]
    _block(lines, "integer", 8)
    reals = _block(lines, "real", 13)
    _skip_comments(lines)
    name = " ".join(text[7].partition("(")[0].split()[2:]) if n_text > 8 else ""
    return list(_series(lines, name or "acceleration", reals))


def _block(lines: Lines, kind: str, width: int):
    """Integers or reals below the line that announces them."""
    line = lines.take(f"{kind} header values").lower()
    count = count_before(line, kind)
    if count is None:
        raise lines.error(f"the number of {kind} header values must stand here", repr(line.strip()[:60]))
    return lines.fields(count, column_width(line, width), f"{kind} header values")


def _skip_comments(lines: Lines) -> None:
    line = lines.take("comments")
    count = count_before(line, "comment")
    if count is None:
        raise lines.error("the number of comment lines must stand here", repr(line.strip()[:60]))
    for _ in range(count):
        if not lines.take(f"{count} comment lines").lstrip().startswith("|"):
            raise lines.error("a comment must begin with |", "another line")


def _series(lines: Lines, name: str, reals):
    """Accelerations up to the next headers; velocities and displacements are passed over."""
    while (line := lines.peek()) is not None and "(format v" not in line.lower():
        line = lines.take("a series").lower()
        if line.lstrip().startswith("end-of-data") or not line.strip():
            continue
        n_times = to_count(next(iter(line.split()), ""))
        if n_times is None or "units=" not in line:
            raise lines.error("the number of points and their units must stand here", repr(line.strip()[:60]))
        values = lines.fields(n_times, column_width(line, 10), "values")
        if not any(word in line for word in QUANTITIES):  # else a misspelt channel would not be missed
            raise lines.error("the quantity must stand here, as acceleration", repr(line.strip()[:60]))
        if "accel" in line and "velocity" not in line:
            yield _acceleration(lines, name, line, values, reals)


def _acceleration(lines: Lines, name: str, line: str, values, reals) -> Channel:
    """One series with the unit, step and peak that the headers state."""
    word, _, code = line.partition("units=")[2].partition("(")
    factor, unit = UNITS.get(to_count(code.partition(")")[0].strip()), (1.0, word.strip(" ,")))
    dt = 1e-3 * reals[STEP] if reals.size > STEP and reals[STEP] > 0.0 else None
    if dt is None and reals.size > RAW_STEP and reals[RAW_STEP] > 0.0:
        dt = float(reals[RAW_STEP])
    seconds = number_after(line, "approx")
    if dt is not None and seconds is not None and abs(values.size * dt - seconds) > 1.0 + 0.02 * seconds:
        raise lines.error(
            f"{values.size} points must take approx {seconds:g} s, as their line says",
            f"{values.size * dt:g} s by the step of the real header, {dt:g} s",
        )
    if reals.size > PEAK and reals[PEAK] > -999.0:
        check_peak(lines, name, values, reals[PEAK])
    return Channel(name, factor * values, unit, dt)


COSMOS = Format(
    NAME,
    recognises,
    ".v0, .v1, .v2, .V1c, .V2c",
    "step, units, channels, peak, format of the columns",
    recorded(read),
)
