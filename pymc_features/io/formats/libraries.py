"""Files that other libraries read: Universal Files by pyuff, seismograms by ObsPy, TDMS, Parquet and HDF5.

Of Universal Files time histories are read, data sets 58 in text or binary numbers (58b); frequency response
functions and spectra, which stand in the same data sets, are refused. Identified modes are read by
`read_modal`.

ObsPy is asked for SAC, MiniSEED and the text formats TSPAIR and SLIST by name, never to find it out: its
detection opens pickles. Its reader of GSE2 is left out, since a damaged file ends the process. These files
hold counts or numbers of any unit, so that `units` must be given.

Čermelj, P., Slavič, J. et al., pyuff, https://github.com/ladisk/pyuff; Structural Dynamics Research
Corporation, Universal File Dataset 58. Krischer, L. et al. (2015), ObsPy: a bridge for seismology into the
scientific Python ecosystem, Comput. Sci. Discov. 8, 014003. National Instruments, TDMS File Format Internal
Structure; Reeve, A., npTDMS, https://github.com/adamreeve/npTDMS.
"""

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pymc_features._checks import listed, warn_caller
from pymc_features.io.formats.matlab import load_variables, recording_of_variables
from pymc_features.io.formats.sources import channels_of, recording_in
from pymc_features.io.reading.labels import Unit, unit_of
from pymc_features.io.reading.lines import Lines, by_library, to_count, to_number, warn_of_widths
from pymc_features.io.reading.recording import Channel, Format, Opening, Recording, Request, even_or_times
from pymc_features.io.reading.units import plural

# --- Universal Files, by pyuff ----------------------------------------------------------------------

NAME = "Universal File"
FUNCTIONS = "58"  # the data set of measured functions
#: Numbers of the data sets that are in use, by the University of Cincinnati's list.
KNOWN = {15, 18, 27, 30, 31, 55, 56, 57, 58, 82, 151, 156, 164, 241, 250, 252, 257, 607, 666, 756, 757, 759}
KNOWN |= {770, 771, 772, 773, 774, 775, 776, 777, 778, 779, 780, 781, 789, 790, 791, 1710, 1715, 1716, 1717}
KNOWN |= {1802, 1807, 1808, 1809, 1858, 1860, 3062, *range(2400, 2500)}
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")  # directions 1 to 6
TIME_RESPONSE = 1  # type of function
BYTE_ORDERS, IEEE = (1, 2), 2  # the least byte first, or last
SINGLE = (2, 5)  # types of numbers in four bytes
PER_LINE = 6  # numbers of a line, at most
UNLABELLED = "", "none"
UNKNOWN = (0, 1)  # types of data that do not say what it is
TYPES = {"strain": 2, "displacement": 8, "force": 9, "velocity": 11, "acceleration": 12, "pressure": 15}


def is_universal(head: bytes) -> bool:
    """Whether a file begins with -1 in columns 5 and 6, and a number that ends in column 6 below it."""
    lines = head.lstrip(b"\r\n").splitlines()[:2]
    if len(lines) < 2 or lines[0].rstrip() != b"    -1":
        return False
    number = lines[1][:6]
    return len(number) == 6 and number.strip().isdigit() and number[-1:].isdigit()


def is_mark(line: str) -> bool:
    """Whether a line begins or ends a data set: -1 in columns 5 and 6."""
    return line[:6].strip() == "-1" and not line[6:].strip()


def read_universal(path: Path, request: Request) -> Recording:
    """All time histories of a file, named by node and direction."""
    with by_library("pyuff", "modal", path, "Universal"):
        import pyuff
    raw = path.read_bytes()
    if not raw.rstrip().endswith(b"    -1"):
        raise ValueError(
            f"{path.name} ({NAME}) must end with a line of -1, it does not. Fetch the file again."
        )
    if b"\0" not in raw:
        _check_text(path)
    with by_library("pyuff", "modal", path, "Universal"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        sets = [file.read_sets(k) for k, kind in enumerate(kinds) if str(kind) == FUNCTIONS]
    if not sets:
        held = listed(list(dict.fromkeys(kinds)))
        raise ValueError(
            f"{path.name} ({NAME}) must hold time histories in data sets 58, got the data sets {held[:200]}. "
            "Read identified modes by `read_modal`."
        )
    if odd := [kind for kind in dict.fromkeys(kinds) if kind not in KNOWN]:
        warn_caller(f"{path.name}: the data sets {listed(odd)} are of no known type. Is a digit of one lost?")
    channels = [_channel(path.name, found, request.quantity) for found in sets]
    for channel, found in zip(channels, sets, strict=True):
        if not channel.problem:
            _check_end(path.name, channel, found, raw)
    begins = {channel.start for channel in channels if not channel.problem}
    if len(begins) < 2:
        channels = [channel._replace(start=None) for channel in channels]
    return Recording(path.name, channels)


def _channel(file: str, found: dict, quantity: str) -> Channel:
    """A time history, as its data set describes it."""
    direction = found["rsp_dir"]
    axis = AXES[abs(direction) - 1] if 1 <= abs(direction) <= len(AXES) else ""
    name = f"{found['rsp_node']}{'-' if direction < 0 else ''}{axis}"
    where, problem = f"{file} ({NAME}), {name}", ""
    if found["func_type"] != TIME_RESPONSE or np.iscomplexobj(found["data"]):
        problem = (
            f"{where}: functions must be time histories, type 1, got type {found['func_type']}. Identify the "
            "modes from frequency response functions first."
        )
    elif found["ordinate_spec_data_type"] not in (*UNKNOWN, TYPES[quantity]):
        problem = (
            f"{where}: histories must be {plural(quantity)}, type {TYPES[quantity]}, got type "
            f"{found['ordinate_spec_data_type']}. Name the columns that are {plural(quantity)}."
        )
    if problem:
        return Channel(name, np.zeros(0), problem=problem)
    values, times = np.asarray(found["data"], dtype=np.float64), np.asarray(found["x"], dtype=np.float64)
    n = found["num_pts"]
    if n < values.size < n + PER_LINE and not values[n:].any():  # the last line is filled up with zeros
        values, times = values[:n], times[:n]
    if values.size != n or times.size != values.size or values.size < 2:
        raise ValueError(
            f"{where}: the {n} samples of the header must be there, at least 2, got {values.size}. Fetch the "
            "file again."
        )
    if not np.isfinite(times).all():
        raise ValueError(f"{where}: times must be finite numbers, got others. Fetch it again.")
    label = found.get("abscissa_axis_units_lab", "").strip()
    clock = Unit("time", 1.0) if label.lower() in UNLABELLED else unit_of(label)
    if clock is None or clock.quantity != "time":
        raise ValueError(f"{where}: times must be in a unit of time, got {label!r}. Export seconds.")
    times = clock.factor * times
    unit = found.get("ordinate_axis_units_lab", "").strip()
    quantum = 1e-5 * float(np.abs(times).max())  # six digits are printed
    return Channel(
        name,
        values,
        None if unit.lower() in UNLABELLED else unit,
        **even_or_times(times, quantum, lambda row: f"{where}, sample {row}"),
        start=float(times[0]),
    )


def _check_end(file: str, channel: Channel, found: dict, raw: bytes) -> None:
    """Refuse binary numbers that do not reach to the end of their data set: a byte was lost or added."""
    if not found["binary"]:
        return
    if found["byte_ordering"] not in BYTE_ORDERS or found["fp_format"] != IEEE:
        raise ValueError(
            f"{file} ({NAME}), {channel.name}: binary numbers must be IEEE, 2, of byte order 1 or 2, got "
            f"{found['fp_format']} and {found['byte_ordering']}. Export them so, or as text."
        )
    kind = ("<" if found["byte_ordering"] == 1 else ">") + (
        "f4" if found["ord_data_type"] in SINGLE else "f8"
    )
    last = channel.values[-1:].astype(kind).tobytes()
    if not any(last + end + b"    -1" in raw for end in (b"", b"\n", b"\r\n")):
        raise ValueError(
            f"{file} ({NAME}), {channel.name}: binary numbers must reach to the end of their data set, they "
            "do not. Fetch the file again."
        )


def _check_text(path: Path) -> None:
    """Look at the widths of the lines of numbers of data sets in text, below eleven lines of header."""
    lines = list(enumerate(Lines(path).whole, 1))
    marks = [k for k, (_, line) in enumerate(lines) if is_mark(line)]
    for first, last in zip(marks[::2], marks[1::2], strict=False):
        if lines[first + 1][1].strip() == FUNCTIONS:
            warn_of_widths(path.name, lines[first + 13 : last])


UNIVERSAL = Format(
    "Universal File 58, by pyuff",
    lambda opening: is_universal(opening.head),
    ".uff, .unv",
    "step, units, channels by node and direction. Needs the extra `modal`",
    read_universal,
)


# --- seismograms, by ObsPy --------------------------------------------------------------------------

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


def read_waveforms(path: Path, request: Request) -> Recording:
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


WAVEFORMS = Format(
    "SAC, MiniSEED, TSPAIR and SLIST, by ObsPy",
    lambda opening: kind_of(opening) is not None,
    ".sac, .mseed, .txt",
    "step, channels, start; pass `units`. Needs the extra `seismic`",
    read_waveforms,
)


# --- loggers and tables: TDMS by npTDMS, Parquet by pandas, HDF5 by h5py ----------------------------


def read_tdms(path: Path, request: Request) -> Recording:
    """All channels of all groups, scaled as their properties say."""
    with by_library("npTDMS", "daq", path, "TDMS"):
        from nptdms import TdmsFile

        groups = TdmsFile.read(path).groups()
        found = [(group, channel, np.asarray(channel[:])) for group in groups for channel in group.channels()]
    channels = []
    for group, channel, values in found:
        facts = channel.properties
        name = channel.name if len(groups) == 1 else f"{group.name}/{channel.name}"
        unit = str(facts.get("unit_string") or facts.get("NI_UnitDescription") or "") or None
        start = facts.get("wf_start_time")
        if isinstance(start, np.datetime64) and start > np.datetime64("1971"):  # 1904 is none
            start = float(start.astype("datetime64[us]").astype(np.int64)) * 1e-6
            start += float(facts.get("wf_start_offset", 0.0))
        else:
            start = None
        problem = ""
        if values.dtype.kind not in "iuf" or values.size < 2:
            problem = f"{path.name}, {name}: values must be numbers, at least 2, got {values.size} others."
            values = np.zeros(0)
        step = float(facts.get("wf_increment", 0.0)) or None
        channels.append(Channel(name, values.astype(np.float64), unit, step, start=start, problem=problem))
    return Recording(path.name, channels)


def read_parquet(path: Path, request: Request) -> Recording:
    """The columns of a table, as of a `pandas.DataFrame`."""
    import pandas as pd

    with by_library("pyarrow", "daq", path, "Parquet", "Save it again."):
        frame = pd.read_parquet(path)
    return recording_in(frame, request)._replace(file=path.name)


def read_hdf5(path: Path, request: Request) -> Recording:
    """Data sets of numbers, with their `units`; `dt` and `fs` as data sets or attributes."""
    return recording_of_variables(load_variables(path), path.name, request)


BINARY = (
    Format(
        "TDMS, by npTDMS",
        lambda opening: opening.head[:4] == b"TDSm",
        ".tdms",
        "step, start, units, channels. Needs the extra `daq`",
        read_tdms,
    ),
    Format(
        "Parquet, by pandas",
        lambda opening: opening.head[:4] == b"PAR1",
        ".parquet",
        "names, units in them, a clock among its columns. Needs the extra `daq`",
        read_parquet,
    ),
    Format(
        "HDF5",
        lambda opening: opening.head[:8] == b"\x89HDF\r\n\x1a\n" and opening.suffix != ".mat",
        ".h5, .hdf5",
        "names, attributes `units`, `dt` and `fs`, a clock among its data sets",
        read_hdf5,
    ),
)
