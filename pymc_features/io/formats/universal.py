"""Time histories in Universal Files, data sets 58 in text or binary numbers (58b), by pyuff.

Frequency response functions and spectra, which stand in the same data sets, are refused. Identified modes are
read by `read_modal`.

Čermelj, P., Slavič, J. et al., pyuff, https://github.com/ladisk/pyuff; Structural Dynamics Research
Corporation, Universal File Dataset 58.
"""

import warnings
from pathlib import Path

import numpy as np

from pymc_features._checks import listed
from pymc_features._checks.messages import warn_caller
from pymc_features.io.reading.labels import Unit, unit_of
from pymc_features.io.reading.lines import Lines, by_library, warn_of_widths
from pymc_features.io.reading.recording import Channel, Format, Recording, Request, even_or_times
from pymc_features.io.reading.units import plural

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


def read(path: Path, request: Request) -> Recording:
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
    read,
)
