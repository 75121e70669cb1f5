"""ESM and ITACA (DYNA format): labelled facts above one column of accelerations.

Engineering Strong Motion database, Luzi, L. et al. (2016), Seism. Res. Lett. 87, 987-997; the labels are
those of DYNA 1.2. The Turkish TADAS exports the same layout.
"""

from datetime import UTC, datetime
from pathlib import Path

from pymc_features.io.header import check_peak, check_sections
from pymc_features.io.labelled import demand, labelled
from pymc_features.io.lines import Lines, to_count, to_number
from pymc_features.io.recording import Channel, Format, Opening, recorded

NAME = "ESM"


def recognises(opening: Opening) -> bool:
    """The first two lines name the event."""
    return opening.first.startswith("event_name:") and any(
        line.startswith("EVENT_ID:") for line in opening.lines[:3]
    )


def read(path: Path) -> tuple[list[Channel], str]:
    """One component."""
    lines = Lines(path, NAME)
    facts = labelled(lines)
    n_times, dt = (
        to_count(demand(lines, facts, "NDATA")),
        to_number(demand(lines, facts, "SAMPLING_INTERVAL_S")),
    )
    check_sections(lines, {"NDATA": n_times, "SAMPLING_INTERVAL_S": dt})
    kind = demand(lines, facts, "DATA_TYPE")
    if kind.upper() != "ACCELERATION":
        raise lines.error("DATA_TYPE must be ACCELERATION", repr(kind), "Fetch the file of the acceleration.")
    values = lines.words(n_times, "values, NDATA")
    if (line := lines.peek()) is not None:
        raise lines.error(f"nothing may follow the NDATA = {n_times} values", repr(line.strip()[:60]))
    name = facts.get("STREAM") or "acceleration"
    check_peak(lines, name, values, to_number(facts.get("PGA_CM/S^2", "")))
    station = f"{facts.get('NETWORK', '')}.{facts.get('STATION_CODE', '')} {name}".strip(". ")
    channel = Channel(name, values, facts.get("UNITS") or None, dt, start=_start(lines, facts))
    return [channel], station


def _start(lines: Lines, facts: dict[str, str]) -> float | None:
    """Time of the first sample [s since 1970], None if the file does not state it."""
    text = facts.get("DATE_TIME_FIRST_SAMPLE_YYYYMMDD_HHMMSS", "")
    if not text:
        return None
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.strptime(whole, "%Y%m%d_%H%M%S").replace(tzinfo=UTC)
    except ValueError:
        raise lines.error("the time of the first sample must be as 20190728_160919.870", repr(text)) from None
    return moment.timestamp() + (to_number(f"0.{fraction}") or 0.0)


ESM = Format(NAME + " and ITACA", recognises, ".ASC", "step, units, component, start, peak", recorded(read))
