"""What an example consists of, and the file of its simulated channels."""

from typing import NamedTuple

import numpy as np


class Example(NamedTuple):
    """A configuration that runs as it is.

    Attributes
    ----------
    template : str
        Of the configuration.
    values : dict
        What the template takes.
    channels : str
        Text of the file with simulated channels; empty if measured ones are used.
    sentence : str
        Which data are used, and why.
    """

    template: str
    values: dict
    channels: str
    sentence: str


def channel_file(time, channels) -> str:
    """Text of a table: times (time,) [s], and channels (time,) [m/s^2] by the names of the sensors."""
    lines = [",".join(["time [s]", *(f"{name} [m/s^2]" for name in channels)])]
    rows = zip(time, np.transpose(list(channels.values())), strict=True)
    lines += [f"{t:.2f}," + ",".join(f"{value:.5f}" for value in row) for t, row in rows]
    return "\n".join(lines) + "\n"


def noisy(base, floors, base_noise, floor_noise, random_seed) -> np.ndarray:
    """Base (time,) and floors (floor, time) with white noise, one below the other.

    Parameters
    ----------
    base_noise : float
        Of the sensor at the base [m/s^2].
    floor_noise : float
        Of the floors, over their own standard deviation [-]: an error of the model in its place.
    """
    exact = np.vstack([base, floors])
    scale = np.array([base_noise, *(floor_noise * floors.std(axis=1))])[:, None]
    return exact + scale * np.random.default_rng(random_seed).standard_normal(exact.shape)
