"""What one file holds of a measurement: channels on one clock."""

from dataclasses import dataclass

import numpy as np

from pymc_features.io.clock import Clock


@dataclass(frozen=True)
class MeasuredFile:
    """Channels of one file, all sampled at the same times."""

    names: list[str]
    values: np.ndarray  # (channel, time) [m/s^2]
    clock: Clock


@dataclass(frozen=True)
class Request:
    """What the caller of `read_channels` says about every file; None leaves it to the file."""

    columns: list | None = None
    units: str | float | None = None
    dt: float | None = None
    clock: str | int | bool | None = None  # False: no clock
    clock_units: float | None = None  # [s] per count
    skip: int = 0
