"""Strong-motion records of headers in blocks of text, integers and reals: COSMOS, CSMIP, GeoNet, SMC.

A reader takes the lines of a file and gives its channels and the name of the recording; `BLOCKS` is their
table. COSMOS Strong Motion Data Format, version 1.20, 2001, Tables 2 (units), 9 (text), 10 (integers) and 11
(reals). Shakal, A. F. and Huang, M. J. (1985), Standard Tape Format for CSMIP Strong-Motion Data Tapes, OSMS
85-03. GNS Science, GeoNet strong-motion data, formats of volumes 1 and 2,
https://www.geonet.org.nz/data/supplementary/strong_motion_file_formats. U.S. Geological Survey, SMC-format
Data Files, sections 3 and 4, https://escweb.wr.usgs.gov/nsmp-data/smcfmt.html.
"""

from collections.abc import Iterator

import numpy as np

from pymc_features.io.formats.header import (
    check_end,
    check_peak,
    check_sections,
    column_width,
    count_before,
    format_of_lines,
    number_after,
    series,
    unit_in,
)
from pymc_features.io.reading.lines import Lines, to_count, to_number
from pymc_features.io.reading.recording import Channel, even_or_times

NO_SPECTRA = "the file must hold accelerations", "spectra (V3)", "Read the V2 file."


def _text(lines: Lines, count: int, what: str) -> list[str]:
    """Lines of text, from the next one that is not blank."""
    while not (first := lines.take(what)).strip():
        pass
    return [first, *(lines.take(f"{count} lines of text") for _ in range(count - 1))]


# --- COSMOS V0 to V2: text, integers, reals and comments above each series ------------------------

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


def read_cosmos(lines: Lines) -> list[Channel]:
    """All accelerations of a file, each below headers of its own."""
    channels = []
    while (line := lines.peek()) is not None:
        if "(format v" not in line.lower():
            raise lines.error("the next channel must begin with its format version", repr(line.strip()[:60]))
        first = _text(lines, 1, "a channel")[0].lower()
        if "spectr" in first:
            raise lines.error(*NO_SPECTRA)
        n_text = to_count(next(iter(first.rpartition("with")[2].split()), ""))
        check_sections(lines, {"the number of text lines": n_text})
        text = [lines.take(f"{n_text} lines of text") for _ in range(n_text - 1)]
        _header_values(lines, "integer", 8)
        reals = _header_values(lines, "real", 13)
        for _ in range(_announced(lines, "comment")):
            if not lines.take("comment lines").lstrip().startswith("|"):
                raise lines.error("a comment must begin with |", "another line")
        name = " ".join(text[7].partition("(")[0].split()[2:]) if n_text > 8 else ""
        channels += _cosmos_series(lines, name or "acceleration", reals)
    return channels


def _announced(lines: Lines, kind: str) -> int:
    """How many integers, reals or comments follow, by the line above them."""
    count = count_before(lines.take(f"{kind}s").lower(), kind)
    if count is None:
        what = f"the number of {kind}{' header values' if kind != 'comment' else ' lines'} must stand here"
        raise lines.error(what, repr(lines.last.strip()[:60]))
    return count


def _header_values(lines: Lines, kind: str, width: int) -> np.ndarray:
    count = _announced(lines, kind)
    return lines.fields(count, column_width(lines.last, width), f"{kind} header values")


def _cosmos_series(lines: Lines, name: str, reals: np.ndarray) -> Iterator[Channel]:
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
            yield _cosmos_acceleration(lines, name, line, values, reals)


def _cosmos_acceleration(lines: Lines, name: str, line: str, values, reals) -> Channel:
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


# --- CSMIP and CESMD, volumes 1 and 2, in lines of 80; film is digitised at uneven times -----------------

UNCORRECTED, CORRECTED = "uncorrected accelerogram data", "corrected accelerogram"
SPECTRA = "response and fourier"
TEXT_LINES, NUMBER_LINES = {1: 13, 2: 25}, {1: 14, 2: 20}  # by volume
PAIR_WIDTH, PAIR_QUANTUM = 7, 1e-3  # characters; [s]


def read_csmip(lines: Lines) -> list[Channel]:
    """All channels of a file of either volume."""
    channels = []
    while (line := lines.peek()) is not None:
        first = line.strip().lower()
        if first.startswith(("/&", "end")):
            _text(lines, 1, "the end of a channel")
        elif first.startswith(UNCORRECTED):
            channels.append(_volume_1(lines))
        elif first.startswith(CORRECTED):
            channels.append(_volume_2(lines))
        elif first.startswith(SPECTRA):
            raise lines.error(*NO_SPECTRA)
        else:
            raise lines.error("a channel or its end must follow", repr(line.strip()[:60]))
    return channels


def _csmip_header(lines: Lines, volume: int) -> list[str]:
    """Text lines of a channel; its numbers repeat what they and the line above the values say."""
    text = _text(lines, TEXT_LINES[volume], "a channel")
    for _ in range(NUMBER_LINES[volume]):
        lines.take(f"{NUMBER_LINES[volume]} lines of numbers below the text")
    return [" ".join(line.split()) for line in text]


def _volume_2(lines: Lines) -> Channel:
    text = _csmip_header(lines, 2)
    channel = _section(lines, "accel", text[7], number_after(text[17], "peak acceleration"))
    while (line := lines.peek()) is not None and "points of" in line.lower():
        _section(lines, line.lower().partition("points of")[2].split()[0], "")
    return channel


def _section(lines: Lines, quantity: str, name: str, peak: float | None = None) -> Channel:
    """A series below the line that says how many values there are, how far apart, and in which unit."""
    line = lines.take("the number of points").lower()
    n_times, dt = count_before(line, "points"), number_after(line, "spaced at")
    if quantity not in line:
        raise lines.error(f"the number of points of {quantity} data must stand here", repr(line.strip()[:60]))
    return series(lines, name, n_times, dt, column_width(line, 10), unit_in(line.partition("sec")[2]), peak)


def _volume_1(lines: Lines) -> Channel:
    text = _csmip_header(lines, 1)
    if "points" not in (lines.peek() or "").lower():
        return _pairs(lines, text)
    line = lines.take("the number of points").lower()
    n_times, rate = to_count(line.split()[0]), number_after(line, "points at")
    if "pts/sec" not in line:
        raise lines.error("the rate must be in pts/sec", repr(line.strip()[:60]))
    check_sections(lines, {"the samples in a second": rate})
    factor, unit = _film_unit(line.partition("units of")[2])
    channel = series(lines, text[6], n_times, 1.0 / rate, column_width(line, 9), unit)
    return channel._replace(values=factor * channel.values)


def _pairs(lines: Lines, text: list[str]) -> Channel:
    """Pairs of time [s] and value, digitised from film."""
    n_pairs = number_after(text[10], "points")
    check_sections(lines, {"the number of points": n_pairs})
    if n_pairs != round(n_pairs):
        raise lines.error("the number of points must be whole", n_pairs)
    pairs = lines.fields(2 * int(n_pairs), PAIR_WIDTH, "times and values").reshape(-1, 2)
    factor, unit = _film_unit(text[11].lower().partition(" and ")[2])
    spacing = even_or_times(pairs[:, 0], PAIR_QUANTUM, lambda row: lines.where())
    return Channel(text[6], factor * pairs[:, 1], unit, **spacing)


def _film_unit(text: str) -> tuple[float, str | None]:
    """Factor and unit of "g/10", "g ." and the like."""
    word = next(iter(text.split()), "").strip(".,").lower()
    return (0.1, "g") if word == "g/10" else (1.0, unit_in(word))


# --- GeoNet V1A and V2A: three components, one below the other, in columns of eight -----------------------

POINTS = 33  # integers: of accelerations, then of velocities and displacements
STEP_1, STEP_2 = 24, 25  # reals, of volumes 1 and 2 [s]


def read_geonet(lines: Lines) -> list[Channel]:
    """The components of a file."""
    channels = []
    while lines.peek() is not None:
        text = _text(lines, 16, "a component")
        volume = text[0].lower()
        if "corrected accelerogram" not in volume:
            raise lines.error("a component must begin with its volume", repr(text[0].strip()[:60]))
        integers, reals = lines.fields(40, 8, "integers"), lines.fields(60, 8, "reals")
        step = STEP_1 if volume.startswith("uncorrected") else STEP_2
        n_times, dt = int(integers[POINTS]), float(reals[step])
        check_sections(lines, {"the number of points": n_times, "the step": dt})
        _check_words(lines, text, n_times, dt)
        values = lines.fields(n_times, 8, "accelerations")
        for n_others in integers[POINTS + 1 : POINTS + 3]:  # velocities, displacements
            lines.fields(max(int(n_others), 0), 8, "values")
        name = next(iter(text[12].partition("Component")[2].split()), "acceleration")
        check_peak(lines, name, values, number_after(text[13].replace("Peak", "peak"), "peak"))
        channels.append(Channel(name, 1e-3 * values, "m/s^2", dt))
    return channels


def _check_words(lines: Lines, text: list[str], n_times: int, dt: float) -> None:
    """Number, step and unit in words must be those of the numbers."""
    said, words = number_after(text[9], "points"), text[10].split()
    steps = [to_number(a) for a, b in zip(words, words[1:], strict=False) if b.lower() in ("s", "sec")]
    if said != n_times or not steps or steps[0] is None or abs(steps[0] - dt) > 0.01 * dt:
        raise lines.error(
            f"the header must state one number of points and one step, in numbers {n_times} and {dt:g} s",
            f"in words {text[9].strip()[:40]!r} and {text[10].strip()[:60]!r}",
        )
    if text[13].split()[3:4] != ["mm/s/s"] or number_after(text[10], "in units of") not in (None, 1.0):
        raise lines.error("accelerations must be in mm/s/s", repr(text[13].strip()[:60]))


# --- SMC: one series; those of film have no rate, and are pairs of time and acceleration ------------------

N_COMMENTS, N_VALUES = 15, 16  # of the 48 integers
NULL, RATE, HIGHEST, LOWEST = 0, 1, 29, 31  # of the 50 reals
DIGITS = 5  # that are printed of every value


def read_smc(lines: Lines) -> list[Channel]:
    """The acceleration of a file [cm/s^2]."""
    text = [lines.take("11 lines of text") for _ in range(11)]
    if "accelerogram" not in text[0].lower():
        raise ValueError(f"{lines.title} must hold an acceleration, got {text[0].strip()[:40]!r}.")
    integers, reals = lines.fields(48, 10, "integers"), lines.fields(50, 15, "reals")
    n_comments, n_values = (int(integers[index]) for index in (N_COMMENTS, N_VALUES))
    check_sections(lines, {"the number of values": n_values})
    for _ in range(max(n_comments, 0)):
        if not lines.take(f"{n_comments} comments").startswith("|"):
            raise lines.error("a comment must begin with |", "another line")
    values = lines.fields(n_values, 10, "values")
    check_end(lines, f"the {n_values} values")
    name = " ".join(text[5].partition("component=")[2].split()) or "acceleration"
    stated = {k: float(reals[k]) for k in (RATE, HIGHEST, LOWEST)}
    stated = {k: real for k, real in stated.items() if not np.isclose(real, reals[NULL], rtol=1e-3)}
    if RATE in stated:
        check_sections(lines, {"the samples in a second": stated[RATE]})
        spacing = {"dt": 1.0 / stated[RATE]}
    elif values.size % 2 or values.size < 4:
        raise lines.error("values without a rate must be pairs of time and acceleration", values.size)
    else:
        times, values = values.reshape(-1, 2).T
        quantum = 10.0 ** (np.floor(np.log10(max(times[-1], 1e-9))) - DIGITS + 1)
        spacing = even_or_times(times, quantum, lambda row: lines.where())
    peaks = [abs(stated[k]) for k in (HIGHEST, LOWEST) if k in stated]
    check_peak(lines, name, values, max(peaks, default=None))
    return [Channel(name, values, "cm/s^2", **spacing)]


BLOCKS = (
    format_of_lines(
        "COSMOS",
        r"(?=.*\(format v).*text lines",
        ".v0, .v1, .v2, .V1c, .V2c",
        "step, units, channels, peak, format of the columns",
        read_cosmos,
    ),
    format_of_lines(
        "CSMIP and CESMD",
        rf"\s*({UNCORRECTED}|{CORRECTED}.*\n.*uncorrected accelerogram|{SPECTRA}.*\n.*{CORRECTED})",
        ".v1, .v2, .raw",
        "step (times, of film), units, channels, peak; V3 files hold spectra and are refused",
        read_csmip,
    ),
    format_of_lines(
        "SMC",
        r"\d.*(accelerogram|velocity|displacement|spectr).*\n\*",
        ".smc",
        "step (times, of film), component, peak; cm/s^2",
        read_smc,
    ),
    format_of_lines(
        "GeoNet",
        r"(un)?corrected accelerogram.*\nsite ",
        ".V1A, .V2A",
        "step, mm/s^2, components, peak",
        read_geonet,
    ),
)
