"""Formats of record files: each an entry in `FORMATS`."""

from pathlib import Path

from pymc_features.io.formats.libraries import BINARY, UNIVERSAL, WAVEFORMS
from pymc_features.io.formats.matlab import MATLAB
from pymc_features.io.formats.strong_motion import STRONG_MOTION
from pymc_features.io.formats.text import TEXT
from pymc_features.io.reading.recording import Opening, Recording, Request

#: A file is read by the first entry that recognises its first lines; the last takes every file.
FORMATS = (MATLAB, *BINARY, *STRONG_MOTION, UNIVERSAL, WAVEFORMS, TEXT)


def read_file(path: Path, request: Request) -> Recording:
    """The channels of a file, by its first lines; no file leaves the library with another error than ours."""
    opening = Opening.of(path)
    entry = next(entry for entry in FORMATS if entry.recognises(opening))
    if request.wrapped is not None and entry is not TEXT:
        raise ValueError(
            f"`wrapped` must be None for {path.name}, got {request.wrapped}. It is a {entry.name} file, "
            "whose layout is known."
        )
    try:
        found = entry.read(path, request)
    except (ArithmeticError, LookupError, MemoryError, TypeError, UnicodeError) as error:
        raise ValueError(
            f"{path.name} must be a whole {entry.name} file, it cannot be read ({error}). Fetch it again."
        ) from error
    if not found.channels:
        raise ValueError(f"{path.name} ({entry.name}) must hold an acceleration, none was found.")
    return found
