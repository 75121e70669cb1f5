"""What can be told from channels one by one: dead, clipped, held, in wrong units, or copies."""

import numpy as np
import xarray as xr

from pymc_features.signals.channels import warn_channel
from pymc_features.signals.gaps import filled
from pymc_features.signals.quasi_static import sensor_names

GRAVITY = 9.81  # [m/s^2]
LARGEST = 5.0 * GRAVITY  # [m/s^2]; models on shaking tables stay below
SMALLEST = 1e-5  # [m/s^2]; below the noise of most accelerometers
_FLAT_TOP = 3  # samples in a row at the extreme
_HELD = 5  # samples in a row of one value amid a motion


def check_each(channels: xr.DataArray) -> None:
    """Warn of suspicious channels (sensor, time) in m/s^2, gaps left out; refuse constant ones."""
    names = [repr(str(name)) for name in sensor_names(channels)]
    values = np.asarray(channels.values, dtype=np.float64)
    gaps = np.isnan(values)
    measured = [row[~gap] if gap.any() else row for row, gap in zip(values, gaps, strict=True)]
    for name, history in zip(names, measured, strict=True):
        if not history.size or history.max() == history.min():
            raise ValueError(
                f"Channel {name} must move, all its {history.size} samples are {history[:1].sum():g}. Leave "
                "it out."
            )
    with np.errstate(over="ignore", invalid="ignore"):  # implausible peaks may be as large as numbers get
        for name, history in zip(names, measured, strict=True):
            for message in (_units(history), *_flat(history)):
                if message:
                    warn_channel(f"Channel {name} {message}")
        _copies(names, values)
        _empty_start(names, filled(values)[0])


def _units(history) -> str | None:
    """Peaks that no structure sees, or gravity."""
    extent = history.max() - history.min()  # the peak is half of it at least
    if not 2.0 * SMALLEST < extent < LARGEST:
        peak = np.abs(history - np.median(history)).max()
        if peak > LARGEST:
            return (
                f"has an implausible peak of {peak:.4g} m/s^2, {peak / GRAVITY:.3g} g. Check `units`, and "
                "that it is an acceleration."
            )
        if peak < SMALLEST:
            return f"has an implausible peak of {peak:.2g} m/s^2, {peak / GRAVITY:.1g} g. Check `units`."
    if abs(abs(history.mean()) - GRAVITY) < 0.03 * GRAVITY:
        return f"has a mean of {history.mean():.4g} m/s^2, that of gravity. Is it vertical? Detrend it if so."
    return None


def _flat(history) -> list[str]:
    """What stretches of one value say: tops that are cut off, and values that are held."""
    again = history[1:] == history[:-1]
    if not (again[1:] & again[:-1]).any():  # never three in a row
        return []
    starts = np.flatnonzero(np.r_[True, ~again])
    lengths = np.diff(np.r_[starts, history.size])
    between = np.abs(np.diff(history)[starts[1:] - 1])
    jumps = np.maximum(np.r_[0.0, between], np.r_[between, 0.0])  # the larger of before and after
    found = (check(history, starts, lengths, jumps) for check in (_clipped, _held))
    return [text for text in found if text]


def _clipped(history, starts, lengths, jumps) -> str | None:
    """Flat tops at the largest or smallest value, entered or left by more than the resolution explains."""
    for extreme, word in ((history.max(), "largest"), (history.min(), "smallest")):
        flat = (history[starts] == extreme) & (lengths >= _FLAT_TOP)
        if not flat.any() or abs(extreme - np.median(history)) < 0.5 * history.std():
            continue  # the value at rest
        # a smooth peak that rounds to three equal samples has 1.5 steps of the resolution beside them
        tops = lengths[flat & (jumps > 3.0 * np.diff(np.unique(history)).min())]
        if tops.size:
            return (
                f"looks clipped: {tops.sum()} samples at its {word} value {extreme:.4g} m/s^2, in "
                f"{tops.size} flat tops. Leave it out, or use a weaker shaking."
            )
    return None


def _held(history, starts, lengths, jumps) -> str | None:
    """A value held, or filled in, amid a motion: it ends, or starts, with a jump."""
    inner = (history[starts] != history.max()) & (history[starts] != history.min())
    held = np.flatnonzero((lengths >= _HELD) & (jumps > 2.0 * np.diff(history).std()) & inner)
    if not held.size:
        return None
    longest = held[np.argmax(lengths[held])]
    return (
        f"repeats one value amid a motion, {history[starts[longest]]:.4g} m/s^2 over {lengths[longest]} "
        f"samples from sample {starts[longest]}: a gap filled by the logger? Cut it off by `trim`."
    )


def _copies(names, values) -> None:
    for i in range(len(names)):
        for j in range(i):
            parts = ((values[i, :k], values[j, :k]) for k in (100, None))  # the first tell most apart
            if all(np.array_equal(*part, equal_nan=True) for part in parts):
                warn_channel(
                    f"Channels {names[j]} and {names[i]} are identical to the last bit: one sensor read "
                    "twice. Leave one out."
                )


def _empty_start(names, values) -> None:
    """A first sample of exact zeros before noise or offsets: the empty packet of a logger."""
    later = values[:, 1:21]
    if later.shape[1] < 20:
        return
    zero = (values[:, 0] == 0.0) & (later != 0.0).all(axis=1)
    jump = np.abs(values[:, 1]) > 4.0 * np.median(np.abs(np.diff(later, axis=1)), axis=1)
    if zero.all() and jump.any():
        warn_channel(
            f"The first sample of {', '.join(names)} is exactly zero, unlike those that follow: an empty "
            "packet? Pass skip=1 to `read_channels`, or trim it."
        )
