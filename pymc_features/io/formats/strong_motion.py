"""Strong-motion records whose header states facts by name: PEER AT2, ESM, K-NET and KiK-net, NSMN, UNAM.

A reader takes the lines of a file and gives its channels and the name of the recording; `FACTS` is their
table. Pacific Earthquake Engineering Research Center, AT2 (spellings have varied over the decades). Luzi, L.
et al. (2016), Engineering Strong Motion database, Seism. Res. Lett. 87, 987-997, with the labels of DYNA 1.2,
in which the Turkish TADAS exports too. National Research Institute for Earth Science and Disaster Resilience,
About K-NET ASCII format, https://www.kyoshin.bosai.go.jp/kyoshin/man/knetform_en.html. Disaster and Emergency
Management Authority (AFAD), text files of the Turkish National Strong Motion Network,
https://tadas.afad.gov.tr. Sociedad Mexicana de Ingenieria Sismica, archivo estandar de aceleracion 2.0.
"""

import re
from datetime import UTC, datetime
from io import StringIO

import numpy as np

from pymc_features._checks import warn_caller
from pymc_features.io.formats.header import (
    check_end,
    check_peak,
    check_sections,
    column_width,
    demand,
    format_of_lines,
    labelled,
)
from pymc_features.io.reading.lines import Lines, not_a_number, to_count, to_number, warn_of_widths
from pymc_features.io.reading.recording import Channel
from pymc_features.io.reading.units import known_factor

# --- PEER AT2: what the values are, how many (NPTS) and how far apart (DT), in any words -------------

MOST_HEADER_LINES = 200
# of lines with single blanks; all repetitions are bounded, so that the time is proportional to the text
_NUMBER = r"[-+]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eEdD][-+]?\d{1,3})?"
_NPTS = re.compile(r"\bNPTS\s?[=:]\s?(\d{1,12})(?![\dA-Za-z])", re.IGNORECASE | re.ASCII)
_DT = re.compile(rf"\bDT\s?[=:]\s?({_NUMBER})", re.IGNORECASE | re.ASCII)
_NPTS_DT = re.compile(
    rf"(?<!\d)(\d{{1,12}})\s?,?\s({_NUMBER})\s?,?\s?NPTS\s?,?\s?DT", re.IGNORECASE | re.ASCII
)
_UNITS = re.compile(r"\bunits\s?(?:\b(?:of|are|is|in)\b|[=:(])\s?\(?\s?([a-z/0-9^*²]{1,40})", re.IGNORECASE)
_ACCELERATION_IN = re.compile(r"acceleration[a-z ]{0,60}\bin\s?\(?\s?([a-z/0-9^*]{1,40})", re.IGNORECASE)
_DATE = re.compile(r"\b\d{1,2}/\d{1,2}/\d{2,4}\b", re.ASCII)
_GLUED = re.compile(r"(?<=[\d.])([-+])", re.ASCII)


def read_at2(lines: Lines) -> tuple[list[Channel], str | None]:
    """The single series of a file, and its event."""
    npts, header, values = next((k for k, line in lines if "NPTS" in line.upper()), 0), [], []
    first, last = 0, 0
    for number, line in lines:
        # Fortran glues a value to the one before it when both fill their fields
        tokens = _GLUED.sub(r" \1", line.replace(",", " ")).split()
        if values or (number > npts and tokens and all(to_number(token) is not None for token in tokens)):
            if line.startswith("***"):  # *** End Data ***
                break
            for token in tokens:
                value = to_number(token)
                if value is None or not np.isfinite(value):
                    raise not_a_number(f"{lines.title}, line {number}", token)
                values.append(value)
            first, last = first or number, number
        elif number <= npts or len(header) < MOST_HEADER_LINES:
            header = [*header[-MOST_HEADER_LINES:], " ".join(line.split())]
    if not values:
        raise ValueError(
            f"{lines.title} must hold values below its header, none was found. Is it an AT2 file?"
        )
    rows = enumerate(StringIO(lines.text), 1)
    warn_of_widths(lines.title, (row for row in rows if first <= row[0] <= last and row[1].strip()))
    text = "\n".join(header)
    both = _NPTS_DT.search(text)
    found = both.groups() if both else [m and m[1] for m in (_NPTS.search(text), _DT.search(text))]
    if found[0] and len(values) != int(found[0]):
        raise ValueError(
            f"{lines.title} must hold the NPTS = {int(found[0])} values its header announces, got "
            f"{len(values)}. Fetch the file again or correct the header."
        )
    if not found[0] and "NPTS" in text.upper():
        raise ValueError(f"{lines.title} must state NPTS as a whole number, it does not. Correct the header.")
    if not found[0] and found[1]:
        warn_caller(
            f"{lines.title} states its step, but no number of values (NPTS) to compare with. Is it whole?"
        )
    step = to_number(found[1]) if found[1] else None  # DT = 0 states nothing
    unit, words = _UNITS.search(text), _ACCELERATION_IN.search(text)
    if unit is None and words is not None and known_factor(words[1]) is not None:
        unit = words
    dated = [line for line in header if _DATE.search(line)]
    channel = Channel(lines.stem, np.array(values), unit and unit[1], step or None)
    return [channel], dated[0] if len(dated) == 1 else None


# --- ESM and ITACA: one column of accelerations ------------------------------------------------------


def read_esm(lines: Lines) -> tuple[list[Channel], str]:
    """One component."""
    facts = labelled(lines)
    n_times = to_count(demand(lines, facts, "NDATA"))
    dt = to_number(demand(lines, facts, "SAMPLING_INTERVAL_S"))
    check_sections(lines, {"NDATA": n_times, "SAMPLING_INTERVAL_S": dt})
    duration = to_number(facts.get("DURATION_S", ""))
    if duration is not None and abs(duration - n_times * dt) > 1.5 * dt + 0.01 * duration:
        raise lines.error(
            f"NDATA = {n_times} samples at {dt:g} s must take DURATION_S", f"{duration:g} s", "Correct it."
        )
    kind = demand(lines, facts, "DATA_TYPE")
    if kind.upper() != "ACCELERATION":
        raise lines.error("DATA_TYPE must be ACCELERATION", repr(kind), "Fetch the file of the acceleration.")
    values = lines.words(n_times, "values, NDATA")
    check_end(lines, f"the NDATA = {n_times} values")
    name = facts.get("STREAM") or "acceleration"
    check_peak(lines, name, values, to_number(facts.get("PGA_CM/S^2", "")))
    start, text = None, facts.get("DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS", "")
    if text:
        whole, _, fraction = text.partition(".")
        example = "the time of the first sample must be as 20190728_160919.870"
        start = _moment(lines, whole, "%Y%m%d_%H%M%S", example) + (to_number(f"0.{fraction}") or 0.0)
    station = f"{facts.get('NETWORK', '')}.{facts.get('STATION_CODE', '')} {name}".strip(". ")
    return [Channel(name, values, facts.get("UNITS") or None, dt, start=start)], station


def _moment(lines: Lines, text: str, form: str, example: str) -> float:
    """A date and time [s since 1970, UTC]."""
    try:
        return datetime.strptime(text, form).replace(tzinfo=UTC).timestamp()
    except ValueError:
        raise lines.error(example, repr(text)) from None


# --- K-NET and KiK-net: counts below seventeen lines -------------------------------------------------

KNET = {  # label of a line in lower case without stops: what it states
    "station code": "station",
    "record time": "time",
    "sampling freq(hz)": "rate",
    "duration time(s)": "duration",
    "dir": "direction",
    "scale factor": "scale",
    "max acc (gal)": "peak",
}
DIRECTIONS = {"1": "NS1", "2": "EW1", "3": "UD1", "4": "NS2", "5": "EW2", "6": "UD2"}  # 2: at the surface
DELAY = 15.0 + 9 * 3600.0  # [s], of the trigger, and of Japanese time on UTC


def read_knet(lines: Lines) -> tuple[list[Channel], str]:
    """One component [gal], without the mean of its counts, as for the maximum that the header states."""
    found = {}
    for _ in range(17):
        words = lines.take("17 lines of header").split()
        if words[:1] == ["Memo."]:
            break
        for label, name in KNET.items():
            n_words = len(label.split())
            if " ".join(words[:n_words]).replace(".", "").lower() == label:
                found[name] = " ".join(words[n_words:])
    else:
        raise lines.error("line 17 must be the memo", repr(" ".join(words)[:60]))
    if missing := [label for label, name in KNET.items() if not found.get(name)]:
        raise lines.error(f"the header must state {', '.join(missing)}", "nothing")
    rate, duration = to_count(found["rate"].lower().removesuffix("hz").strip()), to_number(found["duration"])
    check_sections(lines, {"the sampling frequency": rate, "the duration": duration})
    above, _, below = found["scale"].lower().partition("(gal)/")
    full, scale = to_number(above.strip()), to_number(below.strip())
    check_sections(lines, {"the scale factor, as 3920(gal)/6182761": full, "the counts of the scale": scale})
    counts = lines.words(round(rate * duration), "values, frequency times duration", whole=True)
    check_end(lines, "the values, frequency times duration")
    gal = full / scale * (counts - counts.mean())
    direction = DIRECTIONS.get(found["direction"], found["direction"])
    check_peak(lines, direction, gal, to_number(found["peak"]))
    example = "the record time must be as 2006/01/18 23:25:46"
    start = _moment(lines, found["time"], "%Y/%m/%d %H:%M:%S", example) - DELAY
    name = f"{found['station']} {direction}, {found['time']}"
    return [Channel(direction, gal, "gal", 1.0 / rate, start=start)], name


# --- NSMN and UNAM: columns of all directions ---------------------------------------------------------


def read_nsmn(lines: Lines) -> list[Channel]:
    """The three components of a file [gal]."""
    lines.take("a title")
    facts = labelled(lines, "N-S")  # so begins the line with the directions
    directions = lines.last.split()
    n_times = to_count(demand(lines, facts, "NUMBER OF DATA"))
    dt = to_number(demand(lines, facts, "SAMPLING INTERVAL (SEC)"))
    check_sections(lines, {"the number of data": n_times, "the sampling interval": dt})
    per_line = len(directions)
    values = lines.words(n_times * per_line, "rows, the number of data", per_line=per_line).reshape(
        -1, per_line
    )
    check_end(lines, f"the {n_times} rows")
    return [Channel(name, column, "gal", dt) for name, column in zip(directions, values.T, strict=True)]


def read_unam(lines: Lines) -> list[Channel]:
    """The channels of a file."""
    facts = labelled(lines, "DATOS DE ACELERACION")
    directions = _between_slashes(facts, "ORIENTACION C1-C6", "ORIENTACION C7-C12")
    counts = {to_count(text) for text in _between_slashes(facts, "NUM. TOTAL DE MUESTRAS")}
    steps = {to_number(text) for text in _between_slashes(facts, "INTERVALO DE MUESTREO")}
    if not directions or len(counts) != 1 or len(steps) != 1:
        raise lines.error(
            "the header must state orientations, one number of samples and one interval for all channels",
            f"{len(directions)} orientations, {len(counts)} numbers, {len(steps)} intervals",
        )
    n_times, dt = counts.pop(), steps.pop()
    check_sections(lines, {"the number of samples": n_times, "the interval": dt})
    for text in _between_slashes(facts, "DURACION DEL REGISTRO"):
        duration = to_number(text)
        # a decimated file may state the step of the recorder
        if duration is not None and abs(duration - n_times * dt) > 2.0 * dt + 0.01 * duration:
            raise lines.error(
                f"{n_times} samples at {dt:g} s must take the duration of the header", f"{duration:g} s"
            )
    unit = demand(lines, facts, "UNIDADES DE LOS DATOS").split()[0]
    for _ in range(4):
        lines.take("four lines of titles above the values")
    width = column_width("(" + next((facts[key] for key in facts if key.startswith("FORMATO DATOS")), ""), 10)
    values = lines.fields(n_times * len(directions), width, "values").reshape(-1, len(directions))
    check_end(lines, f"the {n_times} rows")
    peaks = [to_number(text) for text in _between_slashes(facts, "ACEL. MAX.(GAL)")]
    for name, column, peak in zip(directions, values.T, [*peaks, *[None] * len(directions)], strict=False):
        check_peak(lines, name, column, peak)
    return [Channel(name, column, unit, dt) for name, column in zip(directions, values.T, strict=True)]


def _between_slashes(facts: dict[str, str], *labels: str) -> list[str]:
    """What stands between the slashes behind labels that begin so, "/N00E/N90E/V"."""
    found = [facts[key] for key in facts if key.startswith(labels)]
    return [part.strip() for text in found for part in text.split("/") if part.strip()]


AT2 = format_of_lines(
    "PEER AT2",
    lambda opening: (
        opening.suffix == ".at2"
        or any("NPTS" in line and "DT" in line for line in map(str.upper, opening.lines[:20]))
    ),
    ".AT2",
    "step, number of values, units, event",
    read_at2,
)
FACTS = (
    format_of_lines(
        "ESM and ITACA",
        r"event_name:.*\n(.*\n)?event_id:",
        ".ASC",
        "step, units, component, start, peak",
        read_esm,
    ),
    format_of_lines(
        "K-NET and KiK-net",
        r"origin time.*\nlat\.",
        ".NS, .EW, .UD, .NS1, .EW1, .UD1, .NS2, .EW2, .UD2",
        "scale, step, direction, start, peak; the mean is taken off, as for the peak in the header",
        read_knet,
    ),
    format_of_lines(
        "NSMN", r"\s*strong ground motion records of turk", ".txt", "step, directions; gal", read_nsmn
    ),
    format_of_lines(
        "UNAM",
        r"(.*\n){0,29}.*archivo estandar de aceleracion",
        "day and number, .191",
        "step, units, directions, peaks",
        read_unam,
    ),
)
