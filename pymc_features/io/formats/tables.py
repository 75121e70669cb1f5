"""Files of any layout: MATLAB, known by its suffix, and text, which everything else is taken for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pymc_features.io.reading.clock import MeasuredFile, Request
from pymc_features.io.reading.format import Format
from pymc_features.io.tables.mat import read_mat
from pymc_features.io.tables.mat_channels import read_mat_channels
from pymc_features.io.tables.text import read_text
from pymc_features.io.tables.text_channels import read_text_channels
from pymc_features.records import Record


@dataclass(frozen=True)
class TableFormat(Format):
    """Files whose columns or variables the caller picks."""

    read_record: Callable[[Path, Request], Record]
    read_channels: Callable[[Path, Request], MeasuredFile]

    def record(self, path: Path, request: Request) -> Record:
        return self.read_record(path, request)

    def channels(self, path: Path, request: Request) -> MeasuredFile:
        return self.read_channels(path, request)


MATLAB = TableFormat(
    "MATLAB",
    lambda opening: opening.suffix == ".mat",
    ".mat",
    "what its variables `dt`, `fs`, `t`, `time` and `units` state",
    read_mat,
    read_mat_channels,
)
TEXT = TableFormat(
    "text",
    lambda opening: True,
    "any other",
    "names and units of a header, step of a column of times; pass what is missing",
    read_text,
    read_text_channels,
)
