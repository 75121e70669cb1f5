"""Formats of record files: each an entry in `FORMATS`."""

from pathlib import Path

from pymc_features.io.formats.libraries import BINARY, UNIVERSAL, WAVEFORMS
from pymc_features.io.formats.matlab import MATLAB
from pymc_features.io.formats.strong_motion import STRONG_MOTION
from pymc_features.io.formats.text import TEXT
from pymc_features.io.reading.recording import Format, Opening, Request

#: A file is read by the first entry that recognises its first lines; the last takes every file.
FORMATS = (MATLAB, *BINARY, *STRONG_MOTION, UNIVERSAL, WAVEFORMS, TEXT)


def format_of(path: Path, request: Request) -> Format:
    """The format of a file, by its first lines, which must be text for what only a text file is asked for."""
    opening = Opening.of(path)
    found = next(entry for entry in FORMATS if entry.recognises(opening))
    if request.wrapped is not None and found is not TEXT:
        raise ValueError(
            f"`wrapped` must be None for {path.name}, got {request.wrapped}. It is a {found.name} file, "
            "whose layout is known."
        )
    return found
