"""Formats of record files: each an entry in `FORMATS`."""

from functools import partial

from pymc_features._checks import check_file, require
from pymc_features.io.formats import libraries
from pymc_features.io.formats.matlab import read_matlab
from pymc_features.io.formats.strong_motion import LAYOUTS, read_strong_motion
from pymc_features.io.formats.text import read_text
from pymc_features.io.reading.recording import Format, Opening, Recording, Request

#: The table of formats: name, usual endings of file names, what its files state themselves. A file is of the
#: first one that recognises its first lines; the last takes every file.
TABLE = """\
MATLAB | .mat | what its variables `dt`, `fs`, `t`, `time` and `units` state
NumPy | .npz, .npy | as of MATLAB; of one array nothing
TDMS, by npTDMS | .tdms | step, start, units, channels. Needs the extra `daq`
Parquet, by pandas | .parquet | names, units in them, a clock among its columns. Needs the extra `daq`
HDF5 | .h5, .hdf5 | names, attributes `units`, `dt` and `fs`, a clock among its data sets
PEER AT2 | .AT2 | step, number of values, units, event
COSMOS | .v0, .v1, .v2, .V1c, .V2c | step, units, channels, peak, format of the columns
CSMIP and CESMD | .v1, .v2, .raw | step (times, of film), units, channels, peak; V3 files are refused
SMC | .smc | step (times, of film), component, peak; cm/s^2
GeoNet | .V1A, .V2A | step, mm/s^2, components, peak
ESM and ITACA | .ASC | step, units, component, start, peak
K-NET and KiK-net | .NS, .EW, .UD, .NS1 to .UD2 | scale, step, direction, start, peak; the mean is taken off
NSMN | .txt | step, directions; gal
UNAM | day and number, .191 | step, units, directions, peaks
Universal File 58, by pyuff | .uff, .unv | step, units, channels by node, direction. Needs the extra `modal`
SAC, MiniSEED, TSPAIR and SLIST, by ObsPy | .sac, .mseed, .txt | step, channels, start; pass `units`. \
Needs the extra `seismic`
text | any other, .gz, .xlsx | names and units of a header, step of a column of times; pass what is missing. \
A spreadsheet needs the extra `daq`
"""
#: How the files of a format begin, and what reads them.
READERS = {
    "MATLAB": (r"\.mat$", read_matlab),
    "NumPy": (lambda opening: opening.suffix in (".npz", ".npy"), read_matlab),
    "TDMS, by npTDMS": (b"TDSm", libraries.read_tdms),
    "Parquet, by pandas": (b"PAR1", libraries.read_parquet),
    "HDF5": (rb"\x89HDF\r\n\x1a\n", read_matlab),
    **{name: (begins, partial(read_strong_motion, name)) for name, (begins, _) in LAYOUTS.items()},
    "Universal File 58, by pyuff": (libraries.UNIVERSAL, libraries.read_universal),
    "SAC, MiniSEED, TSPAIR and SLIST, by ObsPy": (libraries.kind_of, libraries.read_waveforms),
    "text": (b"", read_text),
}
FORMATS = tuple(Format(*row, *READERS[row[0]]) for row in (row.split(" | ") for row in TABLE.splitlines()))
TEXT = FORMATS[-1]


def read_source(source, request: Request, name: str = "files") -> Recording:
    """The channels of a file, by its first lines, or of what is in memory; with our errors alone."""
    if libraries.is_source(source):
        return libraries.recording_in(source, request)
    path = check_file(source, name)
    opening = Opening.of(path)
    entry = next(entry for entry in FORMATS if opening.begins(entry.begins))
    said = f"got {request.wrapped}. It is a {entry.name} file, whose layout is known."
    require(request.wrapped is None or entry is TEXT, f"`wrapped` must be None for {path.name}, {said}")
    try:
        found = entry.read(path, request)
    except (ArithmeticError, LookupError, MemoryError, TypeError, UnicodeError) as error:
        said = f"it cannot be read ({error}). Fetch it again."
        raise ValueError(f"{path.name} must be a whole {entry.name} file, {said}") from error
    require(found.channels, f"{path.name} ({entry.name}) must hold an acceleration, none was found.")
    return found
