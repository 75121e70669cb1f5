"""The check of channels against each other, and the lines of the file that correct what it finds."""

import json
import re
import warnings
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features import signals
from pymc_features.exceptions import ChannelWarning, ConfigError

LOWEST, HIGHEST = 1.0 / 7.0, 0.5  # of the first natural frequency: where the floors follow the base
COHERENT = 0.5  # of a floor with the base, where the base moves
MOVING, QUIET = 0.2, 3.0  # of the rms of the whole, and of the quietest period: a sensor that is in motion
OFFSET = 1.0  # s: clocks that are not the same, and no lag


class Checked(NamedTuple):
    """What was found out about the channels.

    Attributes
    ----------
    gains : Dataset or None
        Of `check_channels`; None where it was not asked for or could not tell anything.
    sentence : str
        What was checked, or why it was not.
    """

    gains: xr.Dataset | None
    sentence: str


def check(channels, config, first_frequency: float) -> Checked:
    """Check the channels, base first, in the band of the file or below an expected frequency [Hz].

    Raises
    ------
    ConfigError
        If the clock of a sensor is a second or more from that of the base.

    Warns
    -----
    ChannelWarning
        What `check_channels` finds, and the lines of the file that correct it.
    """
    asked = config.processing.check_band
    if config.data.quantity != "absolute_acceleration":
        return Checked(
            None, f"not checked against each other: {config.data.quantity} is no motion of the base"
        )
    if asked is False:
        return Checked(None, "not checked against each other, as the file says")
    if asked is None:
        band = LOWEST * first_frequency, HIGHEST * first_frequency
        reason = why_not(channels, band)
        if reason:
            return Checked(None, f"not checked against each other: {reason}")
    else:
        band = asked
    gains = signals.check_channels(channels, band=band)
    refuse_offsets(gains)
    if lines := corrections(gains, config):
        warnings.warn(f"If it is so, put into [data]: {'; '.join(lines)}", ChannelWarning, stacklevel=2)
    return Checked(gains, f"checked against each other between {band[0]:.3g} and {band[1]:.3g} Hz")


def why_not(channels, band) -> str:
    """Why a band that nobody asked for tells nothing; empty if it does."""
    try:
        coherence = signals.low_frequency_gains(channels, band)["coherence"].values[1:]
    except ValueError as error:
        return str(error)
    if not (coherence >= COHERENT).any():
        return f"no sensor follows the base between {band[0]:.3g} and {band[1]:.3g} Hz"
    return ""


def refuse_offsets(gains) -> None:
    """A sensor that is seconds late has another clock."""
    late, known = gains["lag"].values, gains["coherence"].values >= COHERENT
    found = np.flatnonzero(known & (np.abs(late) >= OFFSET))
    if found.size:
        name, lag = str(gains["sensor"].values[found[0]]), late[found[0]]
        raise ConfigError(
            f"`data.files` must have one clock, got {name} {abs(lag):.4g} s "
            f"{'after' if lag > 0 else 'before'} the base. Cut the files to the same time, or set "
            f"`data.delay = {table({name: lag})}`."
        )


def corrections(gains, config) -> list[str]:
    """Lines of [data] that put right what was found, with what is corrected already."""
    data, lines = config.data, []
    names = [str(name) for name in gains["sensor"].values]
    given = data.scale if isinstance(data.scale, dict) else dict.fromkeys(names, data.scale or 1.0)
    scale = {n: given.get(n, 1.0) * float(f) for n, f in zip(names, gains["scale"].values, strict=True)}
    if (gains["scale"].values[1:] == -1.0).all():
        scale = {names[0]: -given.get(names[0], 1.0)} | {n: given.get(n, 1.0) for n in names[1:]}
    if (gains["scale"].values != 1.0).any():
        lines.append(f"scale = {table({n: f for n, f in scale.items() if f != 1.0})}")
    if gains["delay"].values.any():
        late = dict(data.delay or {})
        for name, more in zip(names, gains["delay"].values, strict=True):
            late[name] = late.get(name, 0.0) + float(more)
        lines.append(f"delay = {table({n: t for n, t in late.items() if t})}")
    order = gains.attrs.get("order", [])
    if order:
        lines.append(f"sensors = {json.dumps([name for name in order if name in data.sensors])}")
    return lines


def table(values) -> str:
    """An inline table of the file."""
    entries = (f"{name_of(name)} = {float(f'{value:.6g}')}" for name, value in values.items())
    return f"{{ {', '.join(entries)} }}"


def name_of(key) -> str:
    """A key, quoted where it must be."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key)


def warn_of_motion(channels, start, first_frequency) -> None:
    """Warn of a window that begins while the sensors move: models start at rest."""
    step = signals.sampling_step(channels)
    period = max(2, round(1.0 / (first_frequency * step)))
    first = round((start - float(channels["time"][0])) / step)
    if first <= 0 or channels.sizes["time"] < 4 * period:
        return
    floors = channels.values[1:] - np.nanmean(channels.values[1:], axis=1, keepdims=True)
    floors = np.nan_to_num(floors)  # in gaps nothing is seen to move
    power = np.cumsum(np.pad(floors**2, ((0, 0), (1, 0))), axis=1)
    moving = np.sqrt((power[:, period:] - power[:, :-period]).clip(min=0.0) / period)  # from each sample on
    before = moving[:, max(0, first - period)]
    everywhere = np.sqrt((floors**2).mean(axis=1))
    in_motion = (before > MOVING * everywhere) & (before > QUIET * moving.min(axis=1))
    if in_motion.any():
        names = [str(name) for name in channels["sensor"].values[1:][in_motion]]
        warnings.warn(
            f"`processing.trim` cuts into the motion of {', '.join(names)} at {start:g} s, but the model "
            "starts at rest there. Begin where the structure is at rest, and choose by `processing.compare` "
            "what is compared.",
            ChannelWarning,
            stacklevel=2,
        )
