"""K-NET and KiK-net, the strong-motion networks of NIED, Japan: counts below seventeen lines of header.

The unit of the counts is the scale factor of the header. They have an offset; as in the maximum that the
header states, the mean of the whole record is taken off. Times are Japanese, and 15 s late by the trigger.

National Research Institute for Earth Science and Disaster Resilience, About K-NET ASCII format,
https://www.kyoshin.bosai.go.jp/kyoshin/man/knetform_en.html, and the answers on scale and maximum in
https://www.kyoshin.bosai.go.jp/kyoshin/faq.html.
"""

from datetime import UTC, datetime
from pathlib import Path

from pymc_features.io.header import check_peak, check_sections
from pymc_features.io.lines import Lines, to_count, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "K-NET and KiK-net"
LABELS = {  # of the lines that are used, in lower case without stops
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


def recognises(opening: Opening) -> bool:
    """The first line is the time of origin, the second the latitude."""
    second = opening.lines[1] if len(opening.lines) > 1 else ""
    return opening.first.startswith("origin time") and second.startswith("Lat.")


def read(path: Path) -> tuple[list[Channel], str]:
    """One component [gal]."""
    lines = Lines(path, NAME)
    found = _header(lines)
    rate = to_count(found["rate"].lower().removesuffix("hz").strip())
    duration = to_number(found["duration"])
    check_sections(lines, {"the sampling frequency": rate, "the duration": duration})
    counts = lines.words(round(rate * duration), "values, frequency times duration")
    if (counts % 1.0).any():
        odd = counts[counts % 1.0 != 0.0][0]
        raise lines.error("values must be counts, whole numbers", f"{odd:g} above this line")
    if (line := lines.peek()) is not None:
        raise lines.error("nothing may follow the values, frequency times duration", repr(line[:60]))
    gal = _scale(lines, found["scale"]) * (counts - counts.mean())
    direction = DIRECTIONS.get(found["direction"], found["direction"])
    check_peak(lines, direction, gal, to_number(found["peak"]))
    name = f"{found['station']} {direction}, {found['time']}"
    return [Channel(direction, gal, "gal", 1.0 / rate, start=_start(lines, found["time"]))], name


def _header(lines: Lines) -> dict[str, str]:
    """Values of the header lines, down to the memo."""
    found = {}
    for _ in range(17):
        words = lines.take("17 lines of header").split()
        if words[:1] == ["Memo."]:
            break
        for label, name in LABELS.items():
            n_words = len(label.split())
            if " ".join(words[:n_words]).replace(".", "").lower() == label:
                found[name] = " ".join(words[n_words:])
    else:
        raise lines.error("line 17 must be the memo", repr(" ".join(words)[:60]))
    if missing := [label for label, name in LABELS.items() if not found.get(name)]:
        raise lines.error(f"the header must state {', '.join(missing)}", "nothing")
    return found


def _scale(lines: Lines, text: str) -> float:
    """Unit of the counts [gal], from "3920(gal)/6182761"."""
    above, _, below = text.lower().partition("(gal)/")
    full, counts = to_number(above.strip()), to_number(below.strip())
    check_sections(lines, {"the scale factor, as 3920(gal)/6182761": full, "the counts of the scale": counts})
    return full / counts


def _start(lines: Lines, text: str) -> float:
    """Time of the first sample [s since 1970, UTC]."""
    try:
        return datetime.strptime(text, "%Y/%m/%d %H:%M:%S").replace(tzinfo=UTC).timestamp() - DELAY
    except ValueError:
        raise lines.error("the record time must be as 2006/01/18 23:25:46", repr(text)) from None


KNET = Format(
    NAME,
    recognises,
    ".NS, .EW, .UD, .NS1, .EW1, .UD1, .NS2, .EW2, .UD2",
    "scale, step, direction, start, peak; the mean is taken off, as for the peak in the header",
    recorded(read),
)
