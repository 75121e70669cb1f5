"""Seismological files that ObsPy reads: SAC, MiniSEED and the text formats TSPAIR and SLIST.

ObsPy is asked for one format by name, never to find it out: its detection opens pickles. Its reader of GSE2
is left out, since a damaged file ends the process. These files hold counts or numbers of any unit, so that
`units` must be given.

Krischer, L. et al. (2015), ObsPy: a bridge for seismology into the scientific Python ecosystem, Comput. Sci.
Discov. 8, 014003.
"""

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pymc_features._checks.messages import warn_caller
from pymc_features.io.reading.lines import by_library, to_count, to_number
from pymc_features.io.reading.recording import Channel, Format, Opening, Recording, Request

VERSIONS = (6, 7)  # of the SAC header
FEWEST_STAMPS = 3  # by which the step is told
SAC_HEADER, SAC_VERSION, SAC_COUNT, SAC_FLOATS = 632, 304, 316, 70  # bytes, bytes, bytes, numbers


def _is_sac(opening: Opening) -> bool:
    """A header of 632 bytes, in either order, with its version, a step and the number of values."""
    return opening.lines == [] and _sac_count(opening.head) is not None


def _sac_count(head: bytes) -> int | None:
    for order in "<>":
        if len(head) >= SAC_HEADER:
            (step,) = struct.unpack_from(f"{order}f", head, 0)
            (version,) = struct.unpack_from(f"{order}i", head, SAC_VERSION)
            (count,) = struct.unpack_from(f"{order}i", head, SAC_COUNT)
            if version in VERSIONS and step > 0.0 and count > 0:
                return count
    return None


def _is_sac_text(opening: Opening) -> bool:
    """Five numbers in each of the first 22 lines, -12345 where one is not known."""
    lines = [line.split() for line in opening.lines[:22]]
    whole = len(lines) == 22 and all(len(words) == 5 for words in lines)
    if not whole or any(to_number(word) is None for words in lines for word in words):
        return False
    return to_count(lines[15][1]) in VERSIONS and sum(w.startswith("-12345") for ws in lines for w in ws) > 9


def _is_miniseed(opening: Opening) -> bool:
    """Six digits, a letter for the quality and a blank, in front of every record."""
    head = opening.head
    return len(head) >= 48 and head[:6].isdigit() and head[6:7] in b"DRQM" and head[7:8] in b" \0"


def _is_timeseries(opening: Opening, layout: str) -> bool:
    words = opening.lines[0].split(",") if opening.lines else []
    return bool(words) and words[0].startswith("TIMESERIES ") and layout in (word.strip() for word in words)


#: Name of a format, as ObsPy calls it: whether a file begins like one.
KINDS: dict[str, Callable[[Opening], bool]] = {
    "SAC": _is_sac,
    "SACXY": _is_sac_text,
    "MSEED": _is_miniseed,
    "TSPAIR": lambda opening: _is_timeseries(opening, "TSPAIR"),
    "SLIST": lambda opening: _is_timeseries(opening, "SLIST"),
}


def kind_of(opening: Opening) -> str | None:
    """Which of the formats a file is of."""
    return next((kind for kind, begins in KINDS.items() if begins(opening)), None)


def read(path: Path, request: Request) -> Recording:
    """All channels of a file; NaN in gaps."""
    opening, size = Opening.of(path), path.stat().st_size
    kind = kind_of(opening)
    if kind == "SAC" and 4 * (_sac_count(opening.head) or 0) > size:  # before memory is taken for them
        raise ValueError(
            f"{path.name} must be a whole {kind} file, it announces more values than its {size} bytes "
            "can hold. Fetch the file again."
        )
    options = {"checksize": True} if kind == "SAC" else {}
    with by_library("ObsPy", "seismic", path, kind):
        import obspy

        with warnings.catch_warnings(), path.open("rb") as raw:
            warnings.simplefilter("error")  # ObsPy warns of damaged records and goes on
            warnings.simplefilter("ignore", DeprecationWarning)
            warnings.filterwarnings("ignore", "Sample spacing read from SAC")  # 0.004 s in single precision
            stream = obspy.read(raw, format=kind, check_compression=False, **options)
            stream.merge(method=0)  # joins what follows, and what overlaps and agrees; masks gaps
    _check_count(path, kind, stream)
    steps = stamped_steps(path, stream) if kind == "MSEED" else {}
    return Recording(path.name, channels_of(stream, f"{path.name} ({kind})", steps))


def stamped_steps(path: Path, stream) -> dict[str, float]:
    """Steps [s] by the times of a file's records, of channels whose header says another one, with a warning.

    Half a sample over the length of the record is another one, and three records tell.
    """
    from obspy.io.mseed.util import get_record_information

    records, found = {}, {}
    with path.open("rb") as file:
        at, size = 0, path.stat().st_size
        while at < size:
            info = get_record_information(file, at)
            name = ".".join(info[key] for key in ("network", "station", "location", "channel"))
            records.setdefault(name, []).append((float(info["starttime"].timestamp), info["npts"]))
            at += info["record_length"]
    for name, own in records.items():
        begins, counts = np.array(sorted(own)).T
        stated = next((trace.stats.delta for trace in stream if trace.id == name), None)
        places = np.append(0.0, np.cumsum(counts)[:-1])
        if stated is None or len(own) < FEWEST_STAMPS:
            continue
        if np.diff(begins).max() > 1.5 * stated * counts.max():  # a gap
            continue
        step = float(np.polyfit(places, begins - begins[0], 1)[0])
        if abs(step / stated - 1.0) * counts.sum() > 0.5:
            found[name] = step
            warn_caller(
                f"{path.name}: the header of {name} states a step of {stated:.6g} s, the times of its "
                f"{len(own)} records {step:.6g} s, which is used. Check the clock of the logger."
            )
    return found


def _check_count(path: Path, kind: str, stream) -> None:
    """Refuse text files with another number of values than their headers announce, which ObsPy reads."""
    if kind not in ("TSPAIR", "SLIST"):
        return
    with path.open("rb") as file:
        headers = [line.decode("latin-1") for line in file if line.startswith(b"TIMESERIES ")]
    counts = [to_count("".join(line.split(",")[1:2]).strip().partition(" ")[0]) for line in headers]
    announced = None if None in counts else sum(counts)
    found = sum(trace.data.size for trace in stream)
    if found != announced:
        raise ValueError(
            f"{path.name} ({kind}) must hold the {announced} samples of its headers, got {found}. "
            "Fetch the file again."
        )


def channels_of(stream, source: str, rates: dict[str, float]) -> list[Channel]:
    """The traces of a stream; NaN in gaps."""
    channels, codes = [], [trace.stats.channel for trace in stream]
    for trace in stream:
        sac = trace.stats.get("sac", {})
        uneven = sac.get("leven", 1) != 1 or sac.get("iftype", 1) != 1
        if uneven or trace.data.dtype.kind not in "iuf" or not trace.stats.delta > 0.0:
            raise ValueError(
                f"{source} must hold an even series of numbers, {trace.id} is none. Resample it."
            )
        name = trace.stats.channel if trace.stats.channel and len(set(codes)) == len(codes) else trace.id
        values = np.ma.filled(trace.data.astype(np.float64), np.nan)
        # of SAC in single precision; ObsPy rounds it to microseconds
        stated = float(f"{sac['delta']:.7g}") if "delta" in sac else trace.stats.delta
        step, start = rates.get(trace.id, stated), trace.stats.starttime.timestamp
        channels.append(Channel(name, values, None, float(step), start=float(start)))
    return channels


WAVEFORMS = Format(
    "SAC, MiniSEED, TSPAIR and SLIST, by ObsPy",
    lambda opening: kind_of(opening) is not None,
    ".sac, .mseed, .txt",
    "step, channels, start; pass `units`. Needs the extra `seismic`",
    read,
)
