"""What other libraries read or hold: Universal Files, seismograms, TDMS, Parquet, and data in memory.

Of Universal Files data sets 58 are read: time histories here, in text or binary numbers, frequency response
functions by `read_frequency_response`. ObsPy is asked for formats by name, never to find them out: its
detection opens pickles. Its reader of GSE2 is left out, since a damaged file ends the process.

Čermelj, P., Slavič, J. et al., pyuff, https://github.com/ladisk/pyuff; Structural Dynamics Research
Corporation, Universal File Dataset 58. Krischer, L. et al. (2015), ObsPy: a bridge for seismology into the
scientific Python ecosystem, Comput. Sci. Discov. 8, 014003. National Instruments, TDMS File Format Internal
Structure; Reeve, A., npTDMS, https://github.com/adamreeve/npTDMS.
"""

import re
import struct
import warnings
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from pymc_features._checks import listed, message, require, shown, warn_caller
from pymc_features.io.reading.labels import Label, role_of, unit_of
from pymc_features.io.reading.lines import Lines, by_library, to_count, to_number, warn_of_widths
from pymc_features.io.reading.recording import Channel, Columns, Opening, Recording, Request, recording_of

NAME = "Universal File"
FUNCTIONS = "58"  # the data set of measured functions
#: Numbers of the data sets that are in use, by the University of Cincinnati's list.
KNOWN = {15, 18, 27, 30, 31, 55, 56, 57, 58, 82, 151, 156, 164, 241, 250, 252, 257, 607, 666, 756, 757, 759}
KNOWN |= {770, 771, 772, 773, 774, 775, 776, 777, 778, 779, 780, 781, 789, 790, 791, 1710, 1715, 1716, 1717}
KNOWN |= {1802, 1807, 1808, 1809, 1858, 1860, 3062, *range(2400, 2500)}
AXES = ("X", "Y", "Z", "RX", "RY", "RZ")  # directions 1 to 6
VERSIONS = (6, 7)  # of the SAC header
SAC = "f300xi8xi"  # step, and behind what is skipped version and count, of 632 bytes in all
SEP005 = "data", "name", "unit_str"
#: Columns of whole numbers of records 6, of types, nodes and directions, and 7, above the step.
COLUMNS = {6: [(0, 5), (5, 15), (15, 20), (20, 30), (41, 51), (51, 55), (66, 76), (76, 80)]}
COLUMNS |= {7: [(0, 10), (10, 20), (20, 30)]}
RIGHT = re.compile(r" *[-+]?\d+")
#: How a file begins: -1 in columns 5 and 6, and a number that ends in column 6 below it.
UNIVERSAL = rb"[\r\n]*    -1[ \t]*(?:\r\n|\r|\n) *\d+(?<=[\r\n].{6})"
TYPES = {"strain": 2, "displacement": 8, "force": 9, "velocity": 11, "acceleration": 12, "pressure": 15}
QUANTITY_OF_TYPE = {number: name for name, number in TYPES.items()} | {13: "force"}  # that excites
QUANTITY_OF_TYPE |= {0: None, 1: None}  # which do not say


def is_mark(line: str) -> bool:
    """Whether a line begins or ends a data set: -1 in columns 5 and 6."""
    return line[:6].strip() == "-1" and not line[6:].strip()


def universal_sets(path: Path) -> tuple[list[int], list[dict]]:
    """Numbers of all data sets of a file, and its functions as pyuff reads them, beside all `raw` bytes."""
    raw = path.read_bytes()
    if not raw.rstrip().endswith(b"    -1"):
        raise ValueError(f"{path.name} ({NAME}) must end in a line of -1, it does not. Fetch it again.")
    with by_library("pyuff", "modal", path, "Universal"), warnings.catch_warnings():
        import pyuff

        warnings.simplefilter("ignore")
        with TemporaryDirectory() as folder:
            if b"\0" not in raw and (plain := re.sub(rb"(\d)[dD](?=[-+]\d\d)", rb"\1E", raw)) != raw:
                path = Path(folder) / path.name  # of Fortran's double precision
                path.write_bytes(plain)
            file = pyuff.UFF(str(path))
            kinds = [int(kind) for kind in file.get_set_types()]
            places = [k for k, kind in enumerate(kinds) if str(kind) == FUNCTIONS]
            return kinds, [file.read_sets(k) | {"raw": raw} for k in places]


def numbers_of(found: dict, source: str) -> tuple[np.ndarray, np.ndarray]:
    """Values and abscissa of a function, of which no byte was lost or added."""
    values, x, n = np.asarray(found["data"]), np.asarray(found["x"], dtype=np.float64), found["num_pts"]
    if n < values.size < n + 6 and not values[n:].any():  # zeros fill the last line of six up
        values, x = values[:n], x[:n]
    what = f"the {n} samples of its header must be there, got {values.size}"
    require(values.size == x.size == n > 1 and np.isfinite(x).all(), f"{source}: {what}. Fetch it again.")
    if found["binary"]:  # numbers must reach to the end of the data set
        order, single = found["byte_ordering"], found["ord_data_type"] in (2, 5)
        last = np.array(values[-1:]).view(np.float64)[-1:]
        last = last.astype(f"{'<' if order == 1 else '>'}f{4 if single else 8}").tobytes()
        whole = any(last + end + b"    -1" in found["raw"] for end in (b"", b"\n", b"\r\n"))
        if order not in (1, 2) or found["fp_format"] != 2 or not whole:
            what = "IEEE, 2, of byte order 1 or 2, and reach to the end of their data set"
            got = f"{found['fp_format']} and {order}. Fetch the file again."
            raise ValueError(f"{source}: binary numbers must be {what}, got {got}")
    return values, x


def unit_on(found: dict, axis: str) -> str:
    """The unit on an axis of a function, empty if there is none."""
    text = found.get(f"{axis}_axis_units_lab", "").strip().replace("\ufffd", "²")  # of Latin-1
    return "" if text.lower() == "none" else text


def read_universal(path: Path, request: Request) -> Recording:
    """All time histories of a file, named by node and direction; why one that is spoilt cannot be taken."""
    _check_text(path, path.read_bytes())
    kinds, sets = universal_sets(path)
    held = f"the data sets {listed(list(dict.fromkeys(kinds)))[:200]}. Read modes by `read_modal`."
    require(sets, f"{path.name} ({NAME}) must hold time histories in data sets 58, got {held}")
    if odd := [kind for kind in dict.fromkeys(kinds) if kind not in KNOWN]:
        warn_caller(f"{path.name}: the data sets {listed(odd)} are of no known type. Is a digit of one lost?")
    channels = []
    for found in sets:
        direction = found["rsp_dir"]
        axis = dict(enumerate(AXES, 1)).get(abs(direction), "")
        name = f"{found['rsp_node']}{'-' if direction < 0 else ''}{axis}"
        try:
            channels.append(_history(name, found, f"{path.name} ({NAME}), {name}"))
        except ValueError as error:
            channels.append(Channel(name, np.zeros(0), problem=str(error)))
    if len({channel.start for channel in channels if not channel.problem}) < 2:
        channels = [channel._replace(start=None) for channel in channels]
    return Recording(path.name, channels)


def _history(name: str, found: dict, source: str) -> Channel:
    """The numbers of a data set on their clock."""
    if found["func_type"] != 1 or np.iscomplexobj(found["data"]):
        advice = "Read frequency response functions by `io.read_frequency_response`."
        got = f"got type {found['func_type']}. {advice}"
        raise ValueError(f"{source}: functions must be time histories, type 1, {got}")
    values, times = numbers_of(found, source)
    clock = unit_of(label := unit_on(found, "abscissa") or "s", "time")
    require(clock, f"{source}: times must be in a unit of time, got {label!r}. Export seconds.")
    times = clock.factor * times
    quantum = 1e-5 * float(np.abs(times).max())  # six digits are printed
    spacing = Channel.spacing(times, quantum, lambda row: f"{source}: sample {row}")
    quantity = QUANTITY_OF_TYPE.get(kind := found["ordinate_spec_data_type"], f"data of type {kind}")
    unit, values = unit_on(found, "ordinate") or None, values.astype(np.float64)
    return Channel(name, values, unit, **spacing, start=float(times[0]), quantity=quantity)


def _check_text(path: Path, raw: bytes) -> None:
    """Look at the columns of records 6 and 7 of data sets, and at the widths of lines of numbers in text."""
    for found in re.finditer(rb"(?m)^    -1\s*?\n    58.*\n((?:.*\n){7})", raw.replace(b"\r\n", b"\n")):
        lines = found[1].decode("latin-1").split("\n")[5:]
        for (record, columns), line in zip(COLUMNS.items(), lines, strict=False):
            cells = [line[begin:end] for begin, end in columns]
            if odd := [cell for cell in cells if cell.strip() and not RIGHT.fullmatch(cell)]:
                said = f"got {odd[0]!r}. Is a character lost or added, and a node or the step with it?"
                where = f"{path.name}, record {record} of a data set 58"
                warn_caller(f"{where}: numbers must stand at the right ends of their columns, {said}")
    if b"\0" not in raw:
        lines = list(enumerate(Lines(path).whole, 1))
        marks = [k for k, (_, line) in enumerate(lines) if is_mark(line)]
        for first, last in zip(marks[::2], marks[1::2], strict=False):
            if lines[first + 1][1].strip() == FUNCTIONS:
                warn_of_widths(path.name, lines[first + 13 : last])


def _is_sac(opening: Opening) -> bool:
    """A header of 632 bytes, in either order, with its version, a step and the number of values."""
    if opening.lines or len(opening.head) < 632:
        return False
    found = [struct.unpack_from(order + SAC, opening.head) for order in "<>"]
    return any(step > 0.0 and version in VERSIONS and count > 0 for step, version, count in found)


def _is_sac_text(opening: Opening) -> bool:
    """Five numbers in each of the first 22 lines, -12345 where one is not known."""
    lines = [line.split() for line in opening.lines[:22]]
    words = [word for line in lines for word in line]
    if [len(line) for line in lines] != [5] * 22 or None in map(to_number, words):
        return False
    return to_count(lines[15][1]) in VERSIONS and sum(word.startswith("-12345") for word in words) > 9


#: Name of a format, as ObsPy calls it, and how its files begin: MiniSEED with six digits, the quality and a
#: blank, the text formats with a line that has the layout among its words.
KINDS = {
    "SAC": _is_sac,
    "SACXY": _is_sac_text,
    "MSEED": rb"(?s)\d{6}[DRQM][ \0].{40}",
    "TSPAIR": rb"TIMESERIES (?:.*,)?[ \t]*TSPAIR[ \t]*(?:[,\r\n]|$)",
    "SLIST": rb"TIMESERIES (?:.*,)?[ \t]*SLIST[ \t]*(?:[,\r\n]|$)",
}


def kind_of(opening: Opening) -> str | None:
    """Which of the formats a file is of."""
    return next((kind for kind, begins in KINDS.items() if opening.begins(begins)), None)


def read_waveforms(path: Path, request: Request) -> Recording:
    """All channels of a file; NaN in gaps."""
    kind = kind_of(Opening.of(path))
    options = {"checksize": True} if kind == "SAC" else {}  # before memory is taken
    with by_library("ObsPy", "seismic", path, kind):
        import obspy

        with warnings.catch_warnings(), path.open("rb") as raw:
            warnings.simplefilter("error")  # ObsPy warns of damaged records and goes on
            warnings.simplefilter("ignore", DeprecationWarning)
            warnings.filterwarnings("ignore", "Sample spacing read from SAC")  # 0.004 s in single precision
            stream = obspy.read(raw, format=kind, check_compression=False, **options)
            stream.merge(method=0)  # joins what follows, and what overlaps and agrees; masks gaps
    if kind in ("TSPAIR", "SLIST"):  # ObsPy reads files with another number of values than they announce
        counts = re.findall(rb"(?m)^TIMESERIES [^,]*,\s*(\d{1,12})(?![^\s,])", path.read_bytes())
        announced, found = sum(map(int, counts)), sum(trace.data.size for trace in stream)
        what = f"the {announced} samples of its headers, got {found}"
        require(found == announced, f"{path.name} ({kind}) must hold {what}. Fetch the file again.")
    steps = stamped_steps(path, stream) if kind == "MSEED" else {}
    return Recording(path.name, channels_of(stream, f"{path.name} ({kind})", steps))


def stamped_steps(path: Path, stream) -> dict[str, float]:
    """Steps [s] by the times of records, of channels whose header is off by half a sample over all."""
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
        if stated is None or len(own) < 3 or np.diff(begins).max() > 1.5 * stated * counts.max():
            continue  # of gaps no step is told
        places = np.append(0.0, np.cumsum(counts)[:-1])
        step = float(np.polyfit(places, begins - begins[0], 1)[0])
        if abs(step / stated - 1.0) * counts.sum() > 0.5:
            found[name] = step
            said = f"a step of {stated:.6g} s, the times of its {len(own)} records {step:.6g} s"
            advice = "which is used. Check the clock of the logger."
            warn_caller(f"{path.name}: the header of {name} states {said}, {advice}")
    return found


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
        step, start = float(facts.get("wf_increment", 0.0)) or None, facts.get("wf_start_time")
        is_start = isinstance(start, np.datetime64) and start > np.datetime64("1971")  # 1904 is none
        start = float(start.astype("datetime64[us]").astype(np.int64)) * 1e-6 if is_start else None
        start = start and start + float(facts.get("wf_start_offset", 0.0))
        problem = ""
        if values.dtype.kind not in "iuf" or values.size < 2:
            problem = f"{path.name}, {name}: values must be numbers, at least 2, got {values.size} others."
            values = np.zeros(0)
        channels.append(Channel(name, values.astype(np.float64), unit, step, start=start, problem=problem))
    return Recording(path.name, channels)


def read_parquet(path: Path, request: Request) -> Recording:
    """The columns of a table, as of a `pandas.DataFrame`."""
    import pandas as pd

    with by_library("pyarrow", "daq", path, "Parquet", "Save it again."):
        frame = pd.read_parquet(path)
    return recording_in(frame, request)._replace(file=path.name)


def is_source(value) -> bool:
    """Whether a value holds channels by itself, rather than being the path of a file."""
    if {"DataFrame", "DataArray", "Stream"} & {base.__name__ for base in type(value).__mro__}:
        return True
    entries = value if isinstance(value, list | tuple) else ()
    return len(entries) > 0 and all(isinstance(entry, Mapping) and "data" in entry for entry in entries)


def recording_in(source, request: Request) -> Recording:
    """The channels of a `pandas.DataFrame`, an `xarray.DataArray`, an ObsPy `Stream` or a list of SEP005."""
    names = {base.__name__ for base in type(source).__mro__}
    if "DataFrame" in names:
        return _of_frame(source, request)
    if "DataArray" in names:
        return Recording("the DataArray", _of_array(source))
    if "Stream" in names:
        return Recording("the Stream", channels_of(source.copy().merge(method=0), "the Stream", {}))
    return Recording("the list", [_of_dict(entry) for entry in source])


def channels_of(stream, source: str, rates: dict[str, float]) -> list[Channel]:
    """The traces of a stream; NaN in gaps."""
    channels, codes = [], [trace.stats.channel for trace in stream]
    for trace in stream:
        sac = trace.stats.get("sac", {})
        uneven = sac.get("leven", 1) != 1 or sac.get("iftype", 1) != 1
        if uneven or trace.data.dtype.kind not in "iuf" or not trace.stats.delta > 0.0:
            raise ValueError(f"{source} must hold even series of numbers, {trace.id} is none. Resample it.")
        name = trace.stats.channel if trace.stats.channel and len(set(codes)) == len(codes) else trace.id
        values = np.ma.filled(trace.data.astype(np.float64), np.nan)
        # of SAC in single precision; ObsPy rounds it to microseconds
        stated = float(f"{sac['delta']:.7g}") if "delta" in sac else trace.stats.delta
        step, start = rates.get(trace.id, stated), trace.stats.starttime.timestamp
        channels.append(Channel(name, values, None, float(step), start=float(start)))
    return channels


def _of_frame(frame, request: Request) -> Recording:
    """Columns by their labels; an index that is named as a time, or holds dates, is the clock."""
    labels = [Label.of(str(name)) for name in frame.columns]
    if other := [str(name) for name, kind in frame.dtypes.items() if kind.kind not in "iufb"]:
        raise ValueError(f"`files` must hold numbers, got a DataFrame with {listed(other)}. Drop these.")
    values, origin, index = frame.to_numpy(dtype=np.float64), 0.0, frame.index
    dates = index.dtype.kind in "mM"
    if dates or (index.name is not None and role_of(str(index.name)) == "time"):
        origin, seconds = _seconds(index.to_numpy())
        values = np.insert(values, 0, seconds, axis=1)
        labels = [Label("time", "time") if dates else Label.of(str(index.name)), *labels]
    table = Columns("the DataFrame", labels, values[request.skip :], lambda row, _: f"row {row}")
    return recording_of(table._replace(stamp=0 if dates else None, origin=origin), request)


def _seconds(times: np.ndarray) -> tuple[float, np.ndarray]:
    """The first of some dates [s since 1970], or 0 of durations and numbers, and the times (time,) since."""
    if times.dtype.kind not in "mM":
        return 0.0, times.astype(np.float64)
    nanoseconds = times.astype(f"{times.dtype.kind}8[ns]").astype(np.int64)
    first = int(nanoseconds[0]) if times.dtype.kind == "M" else 0
    return first * 1e-9, (nanoseconds - first) * 1e-9


def _of_array(array) -> list[Channel]:
    """Sensors by the coordinate `sensor`, times [s] or dates by the coordinate `time`, `units` in `attrs`."""
    if not set(array.dims) <= {"sensor", "time"} or "time" not in array.dims:
        raise ValueError(message("files", "a DataArray (sensor, time)", array.dims, "Transpose it."))
    whole = array if "sensor" in array.dims else array.expand_dims("sensor")
    whole, place = whole.transpose("sensor", "time"), {}
    if "time" in array.coords:
        origin, times = _seconds(whole["time"].values)
        unit = "s" if whole["time"].dtype.kind in "mM" else str(whole["time"].attrs.get("units", "s"))
        place = _clock("the DataArray", times, unit, origin + float(array.attrs.get("start", 0.0)))
    units = np.asarray(whole.coords.get("units", array.attrs.get("units")), dtype=object)
    rows = zip(whole["sensor"].values, whole.values, np.broadcast_to(units, len(whole)), strict=True)
    return [
        Channel(str(name), row.astype(np.float64), None if unit is None else str(unit), **place)
        for name, row, unit in rows
    ]


def _of_dict(entry: Mapping) -> Channel:
    """A channel by SEP005, proposal 5 of the Structural Health Monitoring community's `sdypy`."""
    whole = {*SEP005} <= {*entry} and ("fs" in entry or "time" in entry)
    held = f"got one with {listed(list(entry))}. Complete it."
    require(whole, f"`files` must be dicts with {', '.join(SEP005)} and `fs` or `time`, {held}")
    start, name = entry.get("start_timestamp"), entry["name"]
    if isinstance(start, str):
        try:
            start = datetime.fromisoformat(start)
        except ValueError:
            raise ValueError(message("start_timestamp", "an ISO date", shown(start))) from None
    if isinstance(start, datetime):
        start = (start if start.tzinfo else start.replace(tzinfo=UTC)).timestamp()
    place = {"dt": 1.0 / float(entry["fs"]) if "fs" in entry else None, "start": start}
    if entry.get("time") is not None:
        place = _clock(name, entry["time"], "s", start or 0.0, place["dt"])
    unit = None if entry["unit_str"] is None else str(entry["unit_str"])
    return Channel(str(name), np.asarray(entry["data"], dtype=np.float64), unit, **place)


def _clock(name, times, unit: str, start: float, dt: float | None = None) -> dict[str, float]:
    """Step [s] of times (time,), which a step may be stated of, and start, from which they count [s]."""
    readings, label = np.asarray(times, dtype=np.float64)[:, None], Label("time", "time", unit)
    table = Columns(str(name), [label], readings, lambda row, _: f"{name}, sample {row}", dt=dt)
    [clock] = recording_of(table, Request()).channels
    return {"dt": clock.dt, "start": start + clock.start}
