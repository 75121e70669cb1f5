"""Clocks of measured channels: steps, gaps, and the window that several clocks have in common."""

from collections.abc import Callable

import numpy as np

from pymc_features._checks import listed, warn_caller
from pymc_features.exceptions import ChannelWarning


def even_clock(
    times: np.ndarray, where: Callable, quantum: float = 0.0, gaps: bool = False, dt: float | None = None
) -> tuple[float | None, np.ndarray]:
    """Sampling interval [s] of a clock (time,), None if it is uneven and the caller's; numbers of samples."""
    steps = np.diff(times)
    if not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 1
        raise ValueError(
            f"{where(row)}: time must increase, it goes from {times[row - 1]:.10g} s to {times[row]:.10g} s. "
            "Cut the file there; if this is no time, name the column with the times by `clock`, or the "
            "acceleration by `column` and pass `dt`."
        )
    long = 1.5 * (steps.min() if steps.max() < 1.5 * steps.min() else np.median(steps))
    usual = float(steps[steps < long].mean())  # of printed times no step is exact
    missing = np.rint(steps / usual)
    off, slack = np.abs(steps - missing * usual), 0.1 * usual + 2.0 * quantum
    whole = (off <= 0.1 * usual).all() or (slack < 0.4 * usual and (off <= slack * missing).all())
    numbers = np.arange(times.size)
    if (missing > 1.0).any() and whole:
        row = int(np.argmax(missing > 1.0)) + 1
        if not gaps or missing.sum() >= 2.0 * times.size:
            raise ValueError(
                f"{where(row)}: no samples may be missing, {int((missing - 1.0).sum())} are, in "
                f"{int((missing > 1.0).sum())} gap(s), the first from {times[row - 1]:.10g} s to "
                f"{times[row]:.10g} s at a step of {usual:.4g} s. Cut the file to one side, or fill the gap."
            )
        numbers = np.append(0, np.cumsum(missing.astype(np.int64)))
    mean = (times[-1] - times[0]) / numbers[-1]
    # rounding cannot make steps uneven that are multiples of the resolution, `quantum` [s]
    tolerance = 1e-3 * mean + 4.0 * np.spacing(np.abs(times).max())
    multiple = quantum > 0.0 and abs(mean / quantum - round(mean / quantum)) < 1e-6
    if quantum <= mean / 4.0 and not multiple:
        tolerance += quantum
    if np.abs(times - times[0] - mean * numbers).max() > tolerance:
        row = int(np.argmax(np.abs(steps - np.median(steps)))) + 1
        span = f"from {steps.min():.4g} s to {steps.max():.4g} s"
        text = f"{where(row)}: time steps must be even, they vary {span}."
        if dt is None:
            raise ValueError(f"{text} Resample the record first.")
        warn_caller(f"{text} The argument dt={dt:g} s is used.")
        return None, numbers
    return float(f"{mean:.10g}"), numbers


def aligned(channels: list) -> tuple[np.ndarray, float, float]:
    """Values (sensor, time) of the times that all channels have, by whole samples; step and start [s]."""
    first = channels[0]
    for channel in channels[1:]:
        n = min(first.values.size, channel.values.size)
        if abs(channel.dt - first.dt) * (n - 1) > 0.5 * first.dt:
            raise ValueError(
                f"Sensors must have a common clock, the step is {first.dt:.10g} s in {first.name} and "
                f"{channel.dt:.10g} s in {channel.name}. Pass `resample`, the rate [Hz] of all."
            )
    starts, latest, _ = common_span(channels)
    sizes = np.array([channel.values.size for channel in channels])
    if first.start is None:
        if len(set(sizes)) > 1:
            said = listed([f"{channel.name} {channel.values.size}" for channel in channels])
            raise ValueError(
                f"Sensors without clocks must have the same number of samples, got {said}. Cut them to the "
                "same window first."
            )
        return np.array([channel.values for channel in channels]), first.dt, 0.0
    dt = float(f"{np.mean([channel.dt for channel in channels]):.10g}")
    steps = int(np.rint((latest - first.start) / dt))  # of the first clock, to which the others are aligned
    start = first.start + steps * dt
    skipped = np.rint((start - starts) / dt).astype(int)
    n_times = (sizes - skipped).min()
    off = starts + skipped * dt - start
    different = {(c.name, c.values.size, by): c for c, by in zip(channels, off, strict=True)}
    for (name, size, late), channel in different.items():
        if abs(late) > 0.05 * dt + 2.0 * channel.quantum:
            warn_caller(
                f"{name}: its samples come {1e3 * abs(late):.3g} ms ({abs(late) / dt:.2g} samples) "
                f"{'after' if late > 0.0 else 'before'} those of {first.name} by the clocks; they are taken "
                "as simultaneous. Pass `resample` if that matters.",
                ChannelWarning,
            )
        if n_times < 0.5 * size:
            warn_caller(
                f"{name}: only {n_times} of its {size} samples are in the window that all sensors have in "
                "common. Check for a file that starts late or ends early.",
                ChannelWarning,
            )
    rows = [channel.values[k : k + n_times] for channel, k in zip(channels, skipped, strict=True)]
    return np.array(rows), dt, start


def common_span(channels: list) -> tuple[np.ndarray, float, float]:
    """Starts [s], 0 of channels without a clock, which all have or none; start and stop of their common time."""
    bare = [channel.name for channel in channels if channel.start is None]
    if bare and len(bare) < len(channels):
        raise ValueError(
            f"Sensors must have a common clock, {bare[0]} has none and others do. Pass `clock`, the "
            "column with the times, or clock=False and `dt` if all files start together."
        )
    starts = np.array([channel.start or 0.0 for channel in channels])
    stops = starts + [(channel.values.size - 1) * channel.dt for channel in channels]
    if stops.min() - starts.max() < 0.99 * channels[0].dt:
        spans = zip(channels, starts, stops, strict=True)
        ranges = dict.fromkeys(f"{c.name} {start:.6g} s to {stop:.6g} s" for c, start, stop in spans)
        raise ValueError(
            f"Sensors must have a common clock, these have no time in common: {listed(list(ranges))}. Pass "
            "clock=False and `dt` if the files start together, or one event only."
        )
    return starts, float(starts.max()), float(stops.min())
