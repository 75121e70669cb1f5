"""Files, channels and synthetic earthquakes."""

from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import xarray as xr

import pymc_features as pmf
from support.border import Call
from support.odd_values import PAIR, POSITIVE

FOLDER = TemporaryDirectory()
TEXT = Path(FOLDER.name) / "shaken.csv"
TEXT.write_text("time,base,roof\n" + "".join(f"{0.1 * i:.1f},{i % 3},{i % 4}\n" for i in range(9)))
FUNCTIONS = Path(FOLDER.name) / "beam.csv"
FUNCTIONS.write_text("f,re,im\n1,2,3\n2,3,4\n")
BLOWS = {"excitation": np.zeros((4, 64)), "response": np.random.default_rng(2).standard_normal((4, 1, 64))}
BLOWS["excitation"][:, 3:6] = 1.0, 3.0, 1.0
BLOWS |= {"fs": 64.0, "method": "H1"}
MATRICES = Path(FOLDER.name) / "frame.npz"
np.savez(MATRICES, M=np.eye(2))


def channels(**changes):
    """A noisy sine at two sensors, or something odd like it."""
    time = 0.02 * np.arange(800)
    noise = np.random.default_rng(1).standard_normal((2, 800))
    values = np.sin(3.0 * time) * np.exp(-0.1 * time) * [[1.0], [1.1]] + 0.1 * noise
    given = {
        "data": values,
        "dims": ("sensor", "time"),
        "coords": {"sensor": ["base", "roof"], "time": time},
        "attrs": {"units": "m/s^2"},
    }
    return xr.DataArray(**given | changes)


MEASURED = channels()
NANS = np.where(np.arange(800) == 3, np.nan, 1.0) * MEASURED.values
DATES = {"time": np.datetime64("2020-01-01", "ns") + np.arange(800)}
ODD_CHANNELS = {
    "channels with time first": MEASURED.transpose(),
    "channels without times": MEASURED.drop_vars("time"),
    "channels at dates": MEASURED.assign_coords(DATES),
    "channels at uneven times": MEASURED.assign_coords(time=MEASURED.time**2),
    "complex channels": MEASURED.astype(complex),
    "channels of texts": MEASURED.astype(str),
    "channels with NaN": channels(data=NANS),
    "channels of one sample": MEASURED[:, :1],
    "channels of integers": (100.0 * MEASURED).astype(int),
    "channels without names": MEASURED.drop_vars("sensor"),
    "channels of one name": MEASURED.assign_coords(sensor=["roof", "roof"]),
    "one channel": MEASURED[0],
}
WELL = {
    "channels with NaN",
    "channels of integers",
    "channels without names",
    "channels of one name",
    "one channel",
}
SEVERAL = WELL - {"channels of one name", "one channel"}
MORE = {"channels": ODD_CHANNELS}
EARTHQUAKE = {
    "duration": 1.0,
    "dt": 0.1,
    "random_seed": 1,
    "pga": 3.0,
    "spectrum": None,
    "envelope": None,
}


def elsewhere(function, folder):
    """A function that writes, called in a folder of its own."""

    def called(**arguments):
        with chdir(folder):
            return function(**arguments)

    return called


def reader(function):
    """A call of a function that reads channels."""
    return Call(
        function,
        {
            "files": TEXT,
            "columns": None,
            "units": "g",
            "dt": None,
            "clock": None,
            "clock_units": None,
            "skip": 0,
            "wrapped": None,
            "resample": None,
        },
        {
            "columns": {"None"},
            "units": POSITIVE,
            "dt": {"None", *POSITIVE},
            "clock": {"None", "0"},
            "clock_units": {"None", *POSITIVE},
            "skip": {"0"},
            "wrapped": {"None"},
            "resample": {"None", *POSITIVE},
        },
        {"clock_units": ["dt"], "wrapped": ["dt"], "files": ["dt"]},
    )


CALLS = {
    "read_record": Call(
        pmf.read_record,
        {"path": TEXT, "units": "g", "dt": None, "column": "roof", "wrapped": None},
        {
            "units": POSITIVE,
            "dt": {"None", *POSITIVE},
            "wrapped": {"None"},
        },
        {"column": ["dt"], "wrapped": ["column"], "path": ["files", "column", "dt"]},
    ),
    "read_channels": reader(pmf.read_channels),
    "write_channels": Call(
        elsewhere(pmf.io.write_channels, FOLDER.name),
        {"channels": MEASURED, "path": Path(FOLDER.name) / "written.csv"},
        {"channels": SEVERAL - {"channels without names"}},
        more=MORE,
    ),
    "synthetic_earthquake": Call(
        pmf.synthetic_earthquake,
        EARTHQUAKE,
        {
            "duration": {"1.5"},
            "random_seed": {"None", "0"},
            "pga": POSITIVE,
            "spectrum": {"None"},
            "envelope": {"None"},
        },
    ),
    "signals.check_channels": Call(
        pmf.signals.check_channels,
        {"channels": MEASURED, "band": (0.5, 2.0), "base": None, "damping_ratio": 0.02},
        {
            "channels": SEVERAL,
            "band": PAIR,
            "base": {"None"},
        },
        more=MORE,
    ),
    "read_frequency_response": Call(
        pmf.io.read_frequency_response,
        {"files": FUNCTIONS, "units": "m/N", "response": "2", "reference": "1", "columns": ["f", "re", "im"]},
        {"response": {"text"}, "reference": {"text"}, "columns": {"None", "[]"}},
    ),
    "signals.frequency_response": Call(
        pmf.signals.frequency_response,
        BLOWS | {"units": "m/N", "band": (2.0, 20.0), "decay": 0.1, "leave_out": [("0", 1)]},
        {"units": {"None"}, "band": {"None", "DataArray"}, "decay": {"0", "1.5"}, "leave_out": {"[]"}},
        called={"excitation": ("channels",), "fs": ("dt", "band")},
    ),
    "signals.trim": Call(
        pmf.signals.trim,
        {"channels": MEASURED, "start": 0.5, "stop": 9.0},
        {"channels": WELL, "start": {"0", "1.5"}, "stop": {"1.5"}},
        called={"start": ("start, stop",), "stop": ("start, stop",)},
        more=MORE,
    ),
}
