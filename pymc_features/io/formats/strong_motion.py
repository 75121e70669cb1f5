"""Strong-motion records: PEER AT2, ESM, K-NET, NSMN and UNAM; COSMOS, CSMIP, GeoNet and SMC in blocks.

A reader takes the lines of a file and yields its channels; `LAYOUTS` is the table of readers. Luzi, L. et al.
(2016), Engineering Strong Motion database, Seism. Res. Lett. 87, 987-997, with the labels of DYNA 1.2, in
which the Turkish TADAS exports too. NIED, About K-NET ASCII format,
https://www.kyoshin.bosai.go.jp/kyoshin/man/knetform_en.html. AFAD, text files of the Turkish National Strong
Motion Network, https://tadas.afad.gov.tr. Sociedad Mexicana de Ingenieria Sismica, archivo estandar de
aceleracion 2.0. COSMOS Strong Motion Data Format, version 1.20, 2001, Tables 2 (units), 9 (text), 10
(integers) and 11 (reals). Shakal, A. F. and Huang, M. J. (1985), Standard Tape Format for CSMIP Strong-Motion
Data Tapes, OSMS 85-03. GNS Science, GeoNet strong-motion data, formats of volumes 1 and 2,
https://www.geonet.org.nz/data/supplementary/strong_motion_file_formats. U.S. Geological Survey, SMC-format
Data Files, sections 3 and 4, https://escweb.wr.usgs.gov/nsmp-data/smcfmt.html.
"""

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import pairwise, zip_longest
from pathlib import Path

import numpy as np

from pymc_features._checks import require, warn_caller
from pymc_features.io.reading.labels import unit_of
from pymc_features.io.reading.lines import Lines, column_width, finite, to_count, to_number, warn_of_widths
from pymc_features.io.reading.recording import Channel, Recording, Request

NO_SPECTRA = "the file must hold accelerations", "spectra (V3)", "Read the V2 file."
KNET = "station code", "record time", "sampling freq(hz)", "duration time(s)", "dir"
KNET += "scale factor", "max acc (gal)"
DIRECTIONS = {"1": "NS1", "2": "EW1", "3": "UD1", "4": "NS2", "5": "EW2", "6": "UD2"}  # 2: at the surface
DELAY = 15.0 + 9 * 3600.0  # [s], of the trigger, and of Japanese time on UTC
UNITS = {2: (1.0, "g"), 4: (1.0, "cm/s^2"), 7: (0.0254, "m/s^2")}  # of COSMOS
UNITS |= {10: (1.0, "gal"), 11: (1e-3, "g"), 12: (1e-6, "g")}
QUANTITIES = ("accel", "veloc", "displ", "rotat", "angul", "press", "strain", "speed")
UNCORRECTED, CORRECTED = "uncorrected accelerogram data", "corrected accelerogram"
SPECTRA = "response and fourier"
CSMIP = rf"\s*({UNCORRECTED}|{CORRECTED}.*\n.*uncorrected accelerogram|{SPECTRA}.*\n.*{CORRECTED})"
TEXT_LINES, NUMBER_LINES = {1: 13, 2: 25}, {1: 14, 2: 20}  # by volume of CSMIP


def positive(lines: Lines, value: float | None, what: str) -> float:
    """A number that the header must state."""
    holds = value is not None and 0 < value < np.inf
    lines.require(holds, f"the header must state {what}, a positive number", str(value))
    return value


def number_after(text: str, phrase: str) -> float | None:
    """The number that follows a phrase, in any case; None where there is none."""
    place = text.lower().find(phrase)
    words = text[place + len(phrase) :].split() if place >= 0 else []
    numbers = (to_number(word.rstrip(",;")) for word in words[:2])  # an equals sign may stand between them
    return next((number for number in numbers if number is not None and np.isfinite(number)), None)


def unit_in(text: str) -> str | None:
    """The first unit of acceleration among the words of a line, "cm/sec2" for example."""
    words = (word.strip(".;:") for word in re.split(r"[()=,\s]", text))
    return next((word for word in words if unit_of(word, "acceleration")), None)


def channel(lines: Lines, name: str, values: np.ndarray, unit, peak=None, factor=1.0, **place) -> Channel:
    """A channel; a warning if the values, before the factor, have another peak than the file states."""
    largest, stated = float(np.abs(values).max(initial=0.0)), abs(peak or 0.0)
    if stated > 0.0 and values.size and abs(largest - stated) > 0.02 * stated + 0.005:
        said = f"its values have {largest:.4g}. Is it damaged?"
        warn_caller(f"{lines.title}, {name}: the file states a peak of {stated:.4g}, {said}")
    return Channel(name, factor * values, unit, **place)


def check_duration(lines: Lines, count: int, dt: float, stated: float | None, slack: tuple) -> None:
    """Refuse samples that take another time [s] than the header states; `slack` [s], and of it."""
    if stated is not None and abs(stated - count * dt) > slack[0] + slack[1] * stated:
        raise lines.error(f"{count} samples at {dt:g} s must take the time of the header", f"{stated:g} s")


def labelled(lines: Lines, end: str | None = None) -> dict[str, str]:
    """Facts by their labels in capitals, `LABEL: value`, down to a line with `end` or to a first number."""
    facts = {}
    while True:
        following = (lines.peek() or "").split()
        if end is None and following and None not in map(to_number, following):
            return facts
        line = lines.take("a header and values")
        if end is not None and line.strip().upper().startswith(end):
            return facts
        label, colon, value = line.partition(":")
        if colon:
            facts.setdefault(" ".join(label.upper().split()), value.strip())


# of lines with single blanks; all repetitions are bounded, so that the time is proportional to the text
_NUMBER = r"[-+]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eEdD][-+]?\d{1,3})?"
_NPTS = re.compile(r"\bNPTS\s?[=:]\s?(\d{1,12})(?![\dA-Za-z])", re.IGNORECASE | re.ASCII)
_DT = re.compile(rf"\bDT\s?[=:]\s?({_NUMBER})", re.IGNORECASE | re.ASCII)
_NPTS_DT = re.compile(rf"(?ia)(?<!\d)(\d{{1,12}})\s?,?\s({_NUMBER})\s?,?\s?NPTS\s?,?\s?DT")
_UNITS = re.compile(r"\bunits\s?(?:\b(?:of|are|is|in)\b|[=:(])\s?\(?\s?([a-z/0-9^*²]{1,40})", re.IGNORECASE)
_ACCELERATION_IN = re.compile(r"acceleration[a-z ]{0,60}\bin\s?\(?\s?([a-z/0-9^*]{1,40})", re.IGNORECASE)
_DATE = re.compile(r"\b\d{1,2}/\d{1,2}/\d{2,4}\b", re.ASCII)
_GLUED = re.compile(r"(?<=[\d.])([-+])", re.ASCII)


def read_at2(lines: Lines) -> Iterator[Channel]:
    """PEER AT2: what the values are, how many (NPTS) and how far apart (DT), in any words."""
    npts, header, values = next((k for k, line in lines if "NPTS" in line.upper()), 0), [], []
    first = last = 0
    for number, line in lines:
        # Fortran glues a value to the one before it when both fill their fields
        tokens = _GLUED.sub(r" \1", line.replace(",", " ")).split()
        if values or (number > npts and tokens and None not in map(to_number, tokens)):
            if line.startswith("***"):  # *** End Data ***
                break
            values += [finite(token, f"{lines.title}, line {number}") for token in tokens]
            first, last = first or number, number
        else:
            header.append(" ".join(line.split()))
    require(values, f"{lines.title} must hold values below its header, none was found. Is it AT2?")
    rows = enumerate(lines.whole[first - 1 : last], first)
    warn_of_widths(lines.title, ((number, row) for number, row in rows if row.strip()))
    text = "\n".join(header)
    both = _NPTS_DT.search(text)
    count, step = both.groups() if both else [m and m[1] for m in (_NPTS.search(text), _DT.search(text))]
    if count and len(values) != int(count):
        said = f"the NPTS = {int(count)} values its header announces, got {len(values)}"
        raise ValueError(f"{lines.title} must hold {said}. Fetch the file again or correct the header.")
    if not count and "NPTS" in text.upper():
        raise ValueError(f"{lines.title} must state NPTS as a whole number, it does not. Correct the header.")
    if not count and step:
        warn_caller(f"{lines.title} states its step, but no number of values (NPTS). Is it whole?")
    unit, words = _UNITS.search(text), _ACCELERATION_IN.search(text)
    unit = words if unit is None and words is not None and unit_in(words[1]) else unit
    dated = [line for line in header if _DATE.search(line)]
    lines.event = dated[0] if len(dated) == 1 else None
    step = to_number(step) if step else None  # DT = 0 states nothing
    yield Channel(lines.stem, np.array(values), unit and unit[1], step or None)


def read_esm(lines: Lines) -> Iterator[Channel]:
    """ESM and ITACA: one component, in one column."""
    facts = labelled(lines)
    n_times = positive(lines, to_count(facts.get("NDATA", "")), "NDATA")
    dt = positive(lines, to_number(facts.get("SAMPLING_INTERVAL_S", "")), "SAMPLING_INTERVAL_S")
    check_duration(lines, n_times, dt, to_number(facts.get("DURATION_S", "")), (1.5 * dt, 0.01))
    kind, advice = facts.get("DATA_TYPE", ""), "Fetch the file of the acceleration."
    lines.require(kind.upper() == "ACCELERATION", "DATA_TYPE must be ACCELERATION", repr(kind), advice)
    values = lines.numbers(n_times, "values, NDATA")
    name, peak = facts.get("STREAM") or "acceleration", to_number(facts.get("PGA_CM/S^2", ""))
    whole, _, fraction = facts.get("DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS", "").partition(".")
    start = _moment(lines, whole, "%Y%m%d_%H%M%S", "20190728_160919.870") if whole else None
    start = start and start + (to_number(f"0.{fraction}") or 0.0)
    lines.event = f"{facts.get('NETWORK', '')}.{facts.get('STATION_CODE', '')} {name}".strip(". ")
    yield channel(lines, name, values, facts.get("UNITS") or None, peak, dt=dt, start=start)


def _moment(lines: Lines, text: str, form: str, example: str) -> float:
    """A date and time [s since 1970, UTC]."""
    try:
        return datetime.strptime(text, form).replace(tzinfo=UTC).timestamp()
    except ValueError:
        raise lines.error(f"the time of the record must be as {example}", repr(text)) from None


def read_knet(lines: Lines) -> Iterator[Channel]:
    """K-NET and KiK-net: one component [gal], without the mean of its counts, as for the stated maximum."""
    found = {}
    for _ in range(17):
        words = lines.take("17 lines of header").split()
        if words[:1] == ["Memo."]:
            break
        for label in KNET:
            n_words = len(label.split())
            if " ".join(words[:n_words]).replace(".", "").lower() == label:
                found[label] = " ".join(words[n_words:])
    else:
        raise lines.error("line 17 must be the memo", repr(" ".join(words)[:60]))
    missing = [label for label in KNET if not found.get(label)]
    lines.require(not missing, f"the header must state {', '.join(missing)}", "nothing")
    station, time, rate, duration, direction, scale, peak = (found[label] for label in KNET)
    rate = positive(lines, to_count(rate.lower().removesuffix("hz").strip()), "the sampling frequency")
    duration = positive(lines, to_number(duration), "the duration")
    scales, what = [*scale.lower().split("(gal)/"), ""][:2], "the scale factor, as 3920(gal)/6182761"
    full, scale = (positive(lines, to_number(part.strip()), what) for part in scales)
    counts = lines.numbers(round(rate * duration), "values, frequency times duration", whole=True)
    gal = full / scale * (counts - counts.mean())
    direction = DIRECTIONS.get(direction, direction)
    start = _moment(lines, time, "%Y/%m/%d %H:%M:%S", "2006/01/18 23:25:46") - DELAY
    lines.event = f"{station} {direction}, {time}"
    yield channel(lines, direction, gal, "gal", to_number(peak), dt=1.0 / rate, start=start)


def read_nsmn(lines: Lines) -> Iterator[Channel]:
    """NSMN: columns of three components [gal]."""
    lines.take("a title")
    facts = labelled(lines, "N-S")  # so begins the line with the directions
    directions = lines.last.split()
    n_times = positive(lines, to_count(facts.get("NUMBER OF DATA", "")), "NUMBER OF DATA")
    dt = positive(lines, to_number(facts.get("SAMPLING INTERVAL (SEC)", "")), "SAMPLING INTERVAL (SEC)")
    width = len(directions)
    values = lines.numbers(n_times * width, "rows, the number of data", per_line=width).reshape(-1, width)
    yield from (Channel(name, column, "gal", dt) for name, column in zip(directions, values.T, strict=True))


def read_unam(lines: Lines) -> Iterator[Channel]:
    """UNAM: columns of all directions."""
    facts = labelled(lines, "DATOS DE ACELERACION")

    def listed(*labels: str) -> list[str]:
        """What stands between the slashes behind labels that begin so, "/N00E/N90E/V"."""
        found = [facts[key] for key in facts if key.startswith(labels)]
        return [part.strip() for text in found for part in text.split("/") if part.strip()]

    directions = listed("ORIENTACION C1-C6", "ORIENTACION C7-C12")
    counts = {to_count(text) for text in listed("NUM. TOTAL DE MUESTRAS")}
    steps = {to_number(text) for text in listed("INTERVALO DE MUESTREO")}
    must = "the header must state orientations, one number of samples and one interval for all channels"
    got = f"{len(directions)} orientations, {len(counts)} numbers, {len(steps)} intervals"
    lines.require(directions and len(counts) == len(steps) == 1, must, got)
    n_times = positive(lines, counts.pop(), "the number of samples")
    dt = positive(lines, steps.pop(), "the interval")
    for text in listed("DURACION DEL REGISTRO"):  # a decimated file may state the step of the recorder
        check_duration(lines, n_times, dt, to_number(text), (2.0 * dt, 0.01))
    unit = next(iter(facts.get("UNIDADES DE LOS DATOS", "").split()), None)
    lines.several(4, "lines of titles above the values")
    width = column_width("(" + next((facts[key] for key in facts if key.startswith("FORMATO DATOS")), ""), 10)
    columns = lines.numbers(n_times * len(directions), "values", width).reshape(-1, len(directions)).T
    peaks = zip_longest(directions, map(to_number, listed("ACEL. MAX.(GAL)")))
    for (name, peak), column in zip(peaks, columns, strict=False):
        yield channel(lines, name, column, unit, peak, dt=dt)


def _counted(lines: Lines, what: str, *words: str) -> tuple[int, str]:
    """The number that begins the next line that is not blank, and the line, which has some words."""
    lines.peek()
    line = lines.take(what).lower()
    count = to_count(next(iter(line.split()), ""))
    is_here = count is not None and all(word in line for word in words)
    lines.require(is_here, f"{what} must stand here")
    return count, line


def _comments(lines: Lines, count: int) -> None:
    begin = all(line.lstrip().startswith("|") for line in lines.several(count, "comments"))
    lines.require(begin, "a comment must begin with |", "another line")


def read_cosmos(lines: Lines) -> Iterator[Channel]:
    """COSMOS V0 to V2: text, integers, reals and comments above each series; accelerations are taken."""
    reals = np.zeros(0)
    while (line := lines.peek()) is not None:
        must = "the next channel must begin with its format version"
        lines.require("(format v" in line.lower(), must, repr(line.strip()[:60]))
        first = lines.take("a channel").lower()
        lines.require("spectr" not in first, *NO_SPECTRA)
        n_text = to_count(next(iter(first.rpartition("with")[2].split()), ""))
        text = lines.several(positive(lines, n_text, "the number of text lines") - 1, "more lines of text")
        for kind, width in (("integer", 8), ("real", 13)):
            count, line = _counted(lines, f"the number of {kind} header values or lines", kind)
            reals = lines.numbers(count, f"{kind} header values", column_width(line, width))
        _comments(lines, _counted(lines, "the number of comment header values or lines", "comment")[0])
        # the step of the recorder [s], that of the series [ms], its peak
        recorded, step, peak = np.append(reals, np.zeros(64))[[33, 61, 63]].tolist()
        steps = [step for step in (1e-3 * step, recorded) if step > 0.0]
        peak = peak if peak > -999.0 else None
        name = " ".join(text[7].partition("(")[0].split()[2:]) if len(text) > 7 else ""
        while (line := lines.peek()) is not None and "(format v" not in line.lower():
            if line.lstrip().lower().startswith("end-of-data"):
                lines.take("a series")
                continue
            what = "the number of points, their units and quantity, as acceleration,"
            n_times, line = _counted(lines, what, "units=")
            lines.require(any(word in line for word in QUANTITIES), f"{what} must stand here")
            values = lines.numbers(n_times, "values", column_width(line, 10))
            if "accel" not in line or "velocity" in line:
                continue
            if steps:
                check_duration(lines, n_times, steps[0], number_after(line, "approx"), (1.0, 0.02))
            word, _, code = line.partition("units=")[2].partition("(")
            factor, unit = UNITS.get(to_count(code.partition(")")[0].strip()), (1.0, word.strip(" ,")))
            dt = steps[0] if steps else None
            yield channel(lines, name or "acceleration", values, unit, peak, factor, dt=dt)


def read_csmip(lines: Lines) -> Iterator[Channel]:
    """CSMIP and CESMD, volumes 1 and 2, in lines of 80 characters."""
    while (line := lines.peek()) is not None:
        first = line.strip().lower()
        volume = next((v for v, begins in ((1, UNCORRECTED), (2, CORRECTED)) if first.startswith(begins)), 0)
        lines.require(not first.startswith(SPECTRA), *NO_SPECTRA)
        follows = volume or first.startswith(("/&", "end"))
        lines.require(follows, "a channel or its end must follow", repr(line.strip()[:60]))
        text = lines.several(TEXT_LINES.get(volume, 1), "lines of text")
        # which repeat what text and the line above values say
        lines.several(NUMBER_LINES.get(volume, 0), "lines of numbers below the text")
        text = [" ".join(line.split()) for line in text]
        if volume == 1:
            yield _volume_1(lines, text)
        elif volume == 2:
            yield _section(lines, "accel", text[7], number_after(text[17], "peak acceleration"))
            while "points of" in (lines.peek() or "").lower():
                _section(lines, lines.peek().lower().partition("points of")[2].split()[0], "")


def _section(lines: Lines, quantity: str, name: str, peak: float | None = None) -> Channel:
    """A series below the line that says how many values there are, how far apart, and in which unit."""
    count, line = _counted(lines, f"the number of points of {quantity} data", quantity, "points")
    dt = positive(lines, number_after(line, "spaced at"), "the step")
    values = lines.numbers(count, "values", column_width(line, 10))
    return channel(lines, name, values, unit_in(line.partition("sec")[2]), peak, dt=dt)


def _volume_1(lines: Lines, text: list[str]) -> Channel:
    """Values at an even step, or pairs of time [s] and value that were digitised from film."""
    if "points" not in (lines.peek() or "").lower():
        n_pairs = positive(lines, number_after(text[10], "points"), "the number of points")
        lines.require(n_pairs == round(n_pairs), "the number of points must be whole", n_pairs)
        times, values = lines.numbers(2 * int(n_pairs), "times and values", 7).reshape(-1, 2).T
        spacing = Channel.spacing(times, 1e-3, lambda row: lines.where())
        unit = text[11].lower().partition(" and ")[2]
    else:
        count, line = _counted(lines, "the number of points, and their rate in pts/sec,", "pts/sec")
        rate = positive(lines, number_after(line, "points at"), "the samples in a second")
        values, spacing = lines.numbers(count, "values", column_width(line, 9)), {"dt": 1.0 / rate}
        unit = line.partition("units of")[2]
    word = next(iter(unit.split()), "").strip(".,")
    factor, unit = (0.1, "g") if word == "g/10" else (1.0, unit_in(word))
    return Channel(text[6], factor * values, unit, **spacing)


def read_geonet(lines: Lines) -> Iterator[Channel]:
    """GeoNet V1A and V2A: three components, one below the other, in columns of eight characters."""
    while lines.peek() is not None:
        text = lines.several(16, "lines of text")
        volume = text[0].lower()
        if "corrected accelerogram" not in volume:
            raise lines.error("a component must begin with its volume", repr(text[0].strip()[:60]))
        integers, reals = lines.numbers(40, "integers", 8), lines.numbers(60, "reals", 8)
        n_times, *n_others = integers[33:36].astype(int).tolist()  # of velocities and displacements
        dt = positive(lines, float(reals[24 if volume.startswith("uncorrected") else 25]), "the step")
        said, words = number_after(text[9], "points"), pairwise(text[10].split())
        steps = [to_number(number) for number, unit in words if unit.lower() in ("s", "sec")]
        if said != n_times or not steps or steps[0] is None or abs(steps[0] - dt) > 0.01 * dt:
            must = f"one number of points and one step, in numbers {n_times} and {dt:g} s"
            got = f"in words {text[9].strip()[:40]!r} and {text[10].strip()[:60]!r}"
            raise lines.error(f"the header must state {must}", got)
        if text[13].split()[3:4] != ["mm/s/s"] or number_after(text[10], "in units of") not in (None, 1.0):
            raise lines.error("accelerations must be in mm/s/s", repr(text[13].strip()[:60]))
        values = lines.numbers(n_times, "accelerations", 8)
        for count in n_others:
            lines.numbers(max(count, 0), "values", 8)
        name = next(iter(text[12].partition("Component")[2].split()), "acceleration")
        yield channel(lines, name, values, "m/s^2", number_after(text[13], "peak"), 1e-3, dt=dt)


def read_smc(lines: Lines) -> Iterator[Channel]:
    """SMC: one series [cm/s^2]; of film it has no rate, and is pairs of time and acceleration."""
    text = lines.several(11, "lines of text")
    if "accelerogram" not in text[0].lower():
        raise ValueError(f"{lines.title} must hold an acceleration, got {text[0].strip()[:40]!r}.")
    integers, reals = lines.numbers(48, "integers", 10), lines.numbers(50, "reals", 15)
    n_comments, n_values = integers[15:17].astype(int).tolist()
    _comments(lines, n_comments)
    values = lines.numbers(n_values, "values", 10)
    name = " ".join(text[5].partition("component=")[2].split()) or "acceleration"
    null, *facts = reals[[0, 1, 29, 31]].tolist()
    rate, *peaks = (None if np.isclose(fact, null, rtol=1e-3) else fact for fact in facts)
    if rate is not None:
        spacing = {"dt": 1.0 / positive(lines, rate, "the samples in a second")}
    elif values.size % 2 or values.size < 4:
        raise lines.error("values without a rate must be pairs of time and acceleration", values.size)
    else:
        times, values = values.reshape(-1, 2).T
        quantum = 10.0 ** (np.floor(np.log10(max(times[-1], 1e-9))) - 4)  # five digits are printed
        spacing = Channel.spacing(times, quantum, lambda row: lines.where())
    peak = max((abs(peak) for peak in peaks if peak is not None), default=None)
    yield channel(lines, name, values, "cm/s^2", peak, **spacing)


#: By the name of a format, how its first lines begin, in lower case, or its suffix, and what reads it.
LAYOUTS = {
    "PEER AT2": (r"\.at2$|(.*\n){0,19}(?=.*npts).*dt", read_at2),
    "COSMOS": (r"(?=.*\(format v).*text lines", read_cosmos),
    "CSMIP and CESMD": (CSMIP, read_csmip),
    "SMC": (r"\d.*(accelerogram|velocity|displacement|spectr).*\n\*", read_smc),
    "GeoNet": (r"(un)?corrected accelerogram.*\nsite ", read_geonet),
    "ESM and ITACA": (r"event_name:.*\n(.*\n)?event_id:", read_esm),
    "K-NET and KiK-net": (r"origin time.*\nlat\.", read_knet),
    "NSMN": (r"\s*strong ground motion records of turk", read_nsmn),
    "UNAM": (r"(.*\n){0,29}.*archivo estandar de aceleracion", read_unam),
}


def read_strong_motion(name: str, path: Path, request: Request) -> Recording:
    """The channels of a file of one of the layouts, below which nothing may follow."""
    lines = Lines(path, name.partition(" and ")[0])
    channels = list(LAYOUTS[name][1](lines))
    if lines.announced and (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow the {lines.announced}", repr(line.strip()[:60]))
    return Recording(path.name, channels, lines.event)
