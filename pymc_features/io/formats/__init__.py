"""Formats of record files: one format, one file, one entry in `FORMATS`."""

from pathlib import Path

from pymc_features.io.formats.at2 import AT2
from pymc_features.io.formats.cosmos import COSMOS
from pymc_features.io.formats.csmip import CSMIP
from pymc_features.io.formats.esm import ESM
from pymc_features.io.formats.geonet import GEONET
from pymc_features.io.formats.knet import KNET
from pymc_features.io.formats.nsmn import NSMN
from pymc_features.io.formats.smc import SMC
from pymc_features.io.formats.unam import UNAM
from pymc_features.io.formats.universal import UNIVERSAL
from pymc_features.io.formats.waveforms import WAVEFORMS
from pymc_features.io.matlab import MATLAB
from pymc_features.io.recording import Format, Opening, Request
from pymc_features.io.text import TEXT

#: A file is read by the first entry that recognises its first lines; the last takes every file.
FORMATS = (MATLAB, AT2, COSMOS, CSMIP, SMC, KNET, GEONET, ESM, NSMN, UNAM, UNIVERSAL, WAVEFORMS, TEXT)


def format_of(path: Path, request: Request) -> Format:
    """The format of a file, by its first lines, which must be text for what only a text file is asked for.

    Raises
    ------
    ValueError
        If `request.wrapped` is given for a format that says itself how its values stand.
    """
    opening = Opening.of(path)
    found = next(entry for entry in FORMATS if entry.recognises(opening))
    if request.wrapped is not None and found is not TEXT:
        raise ValueError(
            f"`wrapped` must be None for {path.name}, got {request.wrapped}. It is a {found.name} file, "
            "whose layout is known."
        )
    return found
