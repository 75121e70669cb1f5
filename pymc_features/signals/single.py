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
    measured = [history[~np.isnan(history)] for history in values]
    for name, history in zip(names, measured, strict=True):
        if (history == history[:1]).all():
            raise ValueError(
                f"Channel {name} must move, all its {history.size} samples are {history[:1].sum():g}. Leave "
                "it out."
            )
    with np.errstate(over="ignore", invalid="ignore"):  # implausible peaks may be as large as numbers get
        for name, history in zip(names, measured, strict=True):
            for message in (_units(history), _clipped(history), _held(history)):
                if message:
                    warn_channel(f"Channel {name} {message}")
        _copies(names, values)
        _empty_start(names, filled(values)[0])


def _units(history) -> str | None:
    """Peaks that no structure sees, or gravity."""
    peak = np.abs(history - np.median(history)).max()
    if peak > LARGEST:
        return (
            f"has an implausible peak of {peak:.4g} m/s^2, {peak / GRAVITY:.3g} g. Check `units`, and that "
            "it is an acceleration."
        )
    if peak < SMALLEST:
        return f"has an implausible peak of {peak:.2g} m/s^2, {peak / GRAVITY:.1g} g. Check `units`."
    if abs(abs(history.mean()) - GRAVITY) < 0.03 * GRAVITY:
        return f"has a mean of {history.mean():.4g} m/s^2, that of gravity. Is it vertical? Detrend it if so."
    return None


def _runs(history) -> tuple[np.ndarray, np.ndarray]:
    """First samples and lengths of the stretches of one value."""
    starts = np.flatnonzero(np.r_[True, np.diff(history) != 0.0])
    return starts, np.diff(np.r_[starts, history.size])


def _clipped(history) -> str | None:
    """Flat tops at the largest or smallest value, entered or left by more than the resolution explains."""
    starts, lengths = _runs(history)
    resolution = np.diff(np.unique(history)).min()
    jumps = _jumps(history, starts)
    for extreme, word in ((history.max(), "largest"), (history.min(), "smallest")):
        if abs(extreme - np.median(history)) < 0.5 * history.std():
            continue  # the value at rest
        # a smooth peak that rounds to three equal samples has 1.5 steps of the resolution beside them
        flat = lengths[(history[starts] == extreme) & (lengths >= _FLAT_TOP) & (jumps > 3.0 * resolution)]
        if flat.size:
            return (
                f"looks clipped: {flat.sum()} samples at its {word} value {extreme:.4g} m/s^2, in "
                f"{flat.size} flat tops. Leave it out, or use a weaker shaking."
            )
    return None


def _jumps(history, starts) -> np.ndarray:
    """Larger one of the steps before and after each stretch."""
    between = np.abs(np.diff(history)[starts[1:] - 1])
    return np.maximum(np.r_[0.0, between], np.r_[between, 0.0])


def _held(history) -> str | None:
    """A value held, or filled in, amid a motion: it ends, or starts, with a jump."""
    starts, lengths = _runs(history)
    jumps = _jumps(history, starts)
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
            if np.array_equal(values[i], values[j], equal_nan=True):
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
