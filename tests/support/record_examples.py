"""An example of each format of recordings, and what is in it."""

from dataclasses import dataclass

import numpy as np

from support import record_files as files

RNG = np.random.default_rng(5)
N = 200
MOTION = np.round(
    RNG.standard_normal((3, N)).cumsum(axis=1), 3
)  # cm/s^2, two to three digits before the point
MOTION -= np.round(MOTION.mean(axis=1), 3)[:, None]
COUNTS = RNG.integers(-9000, 9000, N) + 8009
FILM = np.cumsum(np.r_[0.0, RNG.choice([0.004, 0.005, 0.006], 160)])  # s, to a thousandth as on film


@dataclass(frozen=True)
class Example:
    """A file and what is in it."""

    format_name: str  # the beginning of it
    suffix: str
    text: str
    channels: dict  # name: (time,) [m/s^2]
    dt: float
    start: float | None = None


def named(scale, *names):
    return {name: scale * row for name, row in zip(names, MOTION, strict=False)}


KNET_GAL = 3920.0 / 6182761.0 * (COUNTS - COUNTS.mean())
EXAMPLES = {
    "knet": Example("K-NET", ".NS", files.knet(COUNTS), {"N-S": 0.01 * KNET_GAL}, 0.01, 1137594346.0 - 15.0),
    "kiknet": Example(
        "K-NET",
        ".EW2",
        files.knet(COUNTS, rate=200, scale="2000(gal)/8388608", direction="5"),
        {"EW2": 0.01 * 2000.0 / 8388608.0 * (COUNTS - COUNTS.mean())},
        0.005,
        1137594346.0 - 15.0,
    ),
    "cosmos": Example(
        "COSMOS",
        ".V2c",
        files.cosmos(named(1.0, "340 deg", "Up"), 0.02),
        named(0.01, "1: 340 deg", "2: Up"),
        0.02,
    ),
    "cosmos g": Example(
        "COSMOS",
        ".v1",
        files.cosmos(named(0.01, "340 deg"), 0.005, unit="g (02)"),
        named(0.0981, "1: 340 deg"),
        0.005,
    ),
    "csmip 2": Example(
        "CSMIP",
        ".v2",
        files.csmip_2(named(1.0, "360 Deg", "Up"), 0.005),
        named(0.01, "Chan 1: 360 Deg", "Chan 2: Up"),
        0.005,
    ),
    "csmip 1": Example(
        "CSMIP", ".v1", files.csmip_1(named(0.001, "90 Deg"), 0.005), named(0.00981, "Chan 1: 90 Deg"), 0.005
    ),
    "smc": Example("SMC", ".smc", files.smc(MOTION[0], 200.0), {"360": 0.01 * MOTION[0]}, 0.005),
    "geonet 2": Example(
        "GeoNet",
        ".V2A",
        files.geonet({k: np.round(v, 1) for k, v in named(10.0, "N28W", "S62W", "Up").items()}, 0.02),
        {k: 1e-3 * np.round(v, 1) for k, v in named(10.0, "N28W", "S62W", "Up").items()},
        0.02,
    ),
    "geonet 1": Example(
        "GeoNet",
        ".V1A",
        files.geonet({"S90E": np.round(10 * MOTION[0], 1)}, 0.005, volume=1),
        {"S90E": 1e-3 * np.round(10 * MOTION[0], 1)},
        0.005,
    ),
    "esm": Example(
        "ESM", ".ASC", files.esm(MOTION[0], 0.005), {"HNN": 0.01 * MOTION[0]}, 0.005, 1564330159.87
    ),
    "nsmn": Example(
        "NSMN",
        ".txt",
        files.nsmn(named(1.0, "N-S", "E-W", "U-D"), 0.01),
        named(0.01, "N-S", "E-W", "U-D"),
        0.01,
    ),
    "unam": Example(
        "UNAM",
        ".191",
        files.unam(named(1.0, "N00E", "N90E", "V"), 0.005),
        named(0.01, "N00E", "N90E", "V"),
        0.005,
    ),
    "at2": Example(
        "PEER AT2", ".AT2", files.at2(1e-3 * MOTION[0], 0.005), {"at2": 9.81e-3 * MOTION[0]}, 0.005
    ),
}
