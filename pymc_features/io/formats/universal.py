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
from pymc_features.io.reading.format import Channel, Opening, RecordedFormat, even_or_times
from pymc_features.io.reading.lines import shortened
from pymc_features.io.reading.universal import AXES, FUNCTIONS, NAME, is_universal

EXTRA = 'python -m pip install "pymc-features[modal]"'
TIME_RESPONSE = 1  # type of function
BYTE_ORDERS, IEEE = (1, 2), 2  # the least byte first, or last
SINGLE = (2, 5)  # types of numbers in four bytes
ACCELERATION = (0, 1, 12)  # types of data: unknown, general, acceleration


def recognises(opening: Opening) -> bool:
    """-1 in the first line, a number below it."""
    return is_universal(opening.head)


def read(path: Path) -> tuple[list[Channel], None]:
    """All time histories of a file, named by node and direction."""
    try:
        import pyuff
    except ImportError as error:
        raise ImportError(
            f"pyuff must be installed to read {path.name}, a {NAME}, got none. Install it with: {EXTRA}."
        ) from error
    raw = path.read_bytes()
    if not raw.rstrip().endswith(b"    -1"):
        raise ValueError(
            f"{path.name} ({NAME}) must end with a line of -1, it does not. Fetch the file again."
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = pyuff.UFF(str(path))
            kinds = [int(kind) for kind in file.get_set_types()]
            sets = [file.read_sets(k) for k, kind in enumerate(kinds) if str(kind) == FUNCTIONS]
    except Exception as error:  # each damaged file fails in its own way, inside the parser
        raise ValueError(
            f"{path.name} must be a whole {NAME}, pyuff cannot read it ({shortened(error)}). Fetch the file "
            "again."
        ) from error
    if not sets:
        held = listed(list(dict.fromkeys(kinds)))
        raise ValueError(
            f"{path.name} ({NAME}) must hold time histories in data sets 58, got the data sets {held[:200]}. "
            "Read identified modes by `read_modal`."
        )
    channels = [_channel(path.name, found) for found in sets]
    for channel, found in zip(channels, sets, strict=True):
        _check_end(path.name, channel, found, raw)
    begins = {float(found["x"][0]) for found in sets}
    if len(begins) > 1:
        raise ValueError(
            f"{path.name} ({NAME}) must hold histories that begin together, got {min(begins):g} s to "
            f"{max(begins):g} s. Cut them to one window first."
        )
    return channels, None


def _channel(file: str, found: dict) -> Channel:
    """A time history, as its data set describes it."""
    direction = found["rsp_dir"]
    axis = AXES[abs(direction) - 1] if 1 <= abs(direction) <= len(AXES) else ""
    name = f"{found['rsp_node']}{'-' if direction < 0 else ''}{axis}"
    if found["func_type"] != TIME_RESPONSE or np.iscomplexobj(found["data"]):
        raise ValueError(
            f"{file} ({NAME}), {name}: functions must be time histories, type 1, got type "
            f"{found['func_type']}. Identify the modes from frequency response functions first."
        )
    if found["ordinate_spec_data_type"] not in ACCELERATION:
        raise ValueError(
            f"{file} ({NAME}), {name}: histories must be accelerations, type 12, got type "
            f"{found['ordinate_spec_data_type']}. Export accelerations."
        )
    values, times = np.asarray(found["data"], dtype=np.float64), np.asarray(found["x"], dtype=np.float64)
    if values.size != found["num_pts"] or times.size != values.size or values.size < 2:
        raise ValueError(
            f"{file} ({NAME}), {name}: the {found['num_pts']} samples of the header must be there, at least "
            f"2, got {values.size}. Fetch the file again."
        )
    if not np.isfinite(times).all():
        raise ValueError(
            f"{file} ({NAME}), {name}: times must be finite numbers, got others. Fetch it again."
        )
    unit = found.get("ordinate_axis_units_lab", "").strip()
    quantum = 1e-5 * float(np.abs(times).max())  # six digits are printed
    where = f"{file} ({NAME}), {name}"
    return Channel(
        name,
        values,
        None if unit.lower() in ("", "none") else unit,
        **even_or_times(times, quantum, lambda row: f"{where}, sample {row}"),
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


UNIVERSAL = RecordedFormat(
    "Universal File 58, by pyuff",
    recognises,
    ".uff, .unv",
    "step, units, channels by node and direction. Needs the extra `modal`",
    read,
)
