"""What can be told from channels: one dead, clipped, held, or in wrong units, and one against another."""

from itertools import combinations

import numpy as np
import xarray as xr

from pymc_features._checks import check_share, require
from pymc_features.signals.channels import check_array, filled, sampling_step, sensor_names, warn_channel
from pymc_features.signals.spectra import base_index, low_frequency_gains

GRAVITY = 9.81  # [m/s^2]
LARGEST = 5.0 * GRAVITY  # [m/s^2]; models on shaking tables stay below
SMALLEST = 1e-5  # [m/s^2]; below the noise of most accelerometers
_FLAT_TOP = 3  # samples in a row at the extreme
_HELD = 5  # samples in a row of one value amid a motion
_COHERENT = 0.5  # below, gain and lag mean little
_GAINS = (0.4, 2.5)  # of a floor against the base, up to half the first natural frequency
_DROP = 0.01  # of a gain against the sensor below: tolerance of sensors
_LATE = 0.1  # of a sample
_RATIOS = {
    GRAVITY: "as if one were in g and the other in m/s^2",
    100.0: "as if one were in cm/s^2",
    100.0 * GRAVITY: "as if one were in g and the other in cm/s^2",
    1000.0: "as if one were in milli-units",
}


def check_channels(
    channels: xr.DataArray,
    band: tuple[float, float],
    *,
    base: str | int | None = None,
    damping_ratio: float = 0.02,
) -> xr.Dataset:
    """Warn of channels that do not fit each other, and return what was found; nothing is repaired.

    All sensors measure the absolute acceleration in one direction and are listed from the base up, as on a
    building with its first natural frequency above the band.

    Parameters
    ----------
    channels, band, base
        As of `low_frequency_gains`, in m/s^2, the base among the channels.
    damping_ratio : float
        The largest expected, positive; its share of a lag is not reported.

    Returns
    -------
    xarray.Dataset (sensor)
        `gain`, `lag` [s], their standard errors and `coherence` as of `low_frequency_gains`; `peak` [m/s^2],
        the largest deviation from the median; `scale` [-] and `delay` [s], what `correct` takes to put right
        a channel that is inverted, in other units, or late, else 1 and 0. Where one channel is late, all get
        the lag that damping and chance do not explain. `attrs["order"]`: the sensors by their gains, if these
        do not rise.

    Raises
    ------
    ValueError, TypeError
        If an argument is not admissible, or a channel is constant.

    Warns
    -----
    ChannelWarning
        If a channel is clipped, interrupted, a copy, or implausible in m/s^2; or against the base inverted,
        unrelated (coherence below 0.5), larger or smaller by a factor that units explain (gain beyond 0.4 to
        2.5), or late or early by more than a tenth of a sample, what the damping explains and three standard
        errors; or if the gains do not rise from the base up, so that sensors may be swapped.

    Notes
    -----
    A swap is found if the gains differ by more than 1 % and three standard errors, so not in a band where the
    base hardly moves, nor between high floors of almost the same gain: look at `gain_error`.

    False alarms: none in 240 shaken chains of random stiffness, 20 and 60 s long, with noise of 0.3 % of the
    peak; eight lags in 2,000 events of 30 s, some hardly above the noise (tests/signals/test_lag_alarms.py).
    """
    check_array(channels, sensors=True)
    damping_ratio = check_share(damping_ratio, "damping_ratio", "0.02 is 2 %.")
    found = low_frequency_gains(channels, band, base=base)
    check_each(channels)
    still = np.nanmedian(channels.values, axis=1, keepdims=True)
    found["peak"] = ("sensor", np.nanmax(np.abs(channels.values - still), axis=1), {"units": "m/s^2"})
    index, names = base_index(channels, base), [repr(name) for name in found["sensor"].values.tolist()]
    tolerance, (_, highest) = _LATE * sampling_step(channels), found.attrs["band"]
    columns = [found[name].values for name in ("gain", "lag", "lag_error", "coherence")]
    size = np.abs(columns[0])
    plain = (size >= _GAINS[0]) & (size <= _GAINS[1])
    late, scale, delay = False, np.ones(size.size), np.zeros(size.size)
    for i, (gain, lag, error, coherence) in enumerate(zip(*columns, strict=True)):
        name, base = f"Channel {names[i]}", names[index]
        if i == index or np.isnan(gain):
            continue
        if coherence < _COHERENT:
            why = "Another direction or event, no motion in the band, or a broken sensor?"
            warn_channel(f"{name} is unrelated to {base}: coherence {coherence:.2g}. {why}")
            continue
        if gain < 0.0:
            said = f"low-frequency gain {gain:.3g}. Multiply it by -1"
            warn_channel(f"{name} is inverted against {base}: {said}.")
        scale[i] = np.sign(gain)
        if not plain[i]:  # units that are known to be mistaken for each other
            ratio = max(size[i], 1.0 / size[i])
            known = next((known for known in _RATIOS if 0.75 < ratio / known < 1.5), 1.0)
            scale[i] *= 1.0 / known if size[i] > 1.0 else known
            reason = f", {_RATIOS[known]}" if known in _RATIOS else ""
            said = f"a low-frequency gain of {gain:.3g} against {base}, where floors follow the base{reason}"
            warn_channel(f"{name} has {said}. Check units and sensitivity.")
        explained = abs(1.0 - 1.0 / max(size[i], 1.0)) * (damping_ratio / (1.5 * np.pi * highest))
        beyond = abs(lag) - explained - 3.0 * error  # what neither damping nor chance explains
        delay[i] = lag if beyond > 0.0 else 0.0
        if beyond > tolerance:
            late = True
            said = f"{1e3 * abs(lag):.3g} ms ({abs(lag) * _LATE / tolerance:.3g} samples)"
            said = f"{said} {'after' if lag > 0.0 else 'before'} {base}, +- {1e3 * error:.2g} ms"
            warn_channel(f"{name} comes {said}. Check clocks, and what the lag does to phases.")
    found.attrs["order"] = _check_order(found.isel(sensor=plain & (found["coherence"].values >= _COHERENT)))
    delay *= late  # no clock is touched for what no message is worth
    return found.assign(scale=("sensor", scale), delay=("sensor", delay, {"units": "s"}))


def _check_order(found: xr.Dataset) -> list[str]:
    """Names in the order of the gains, if that is not the one they are listed in."""
    gains, errors = np.abs(found["gain"].values), found["gain_error"].values
    if not (np.diff(gains) < -_DROP - 3.0 * np.hypot(errors[1:], errors[:-1])).any():
        return []
    names = [str(name) for name in found["sensor"].values]
    listed = ", ".join(f"{name} {gain:.3f}" for name, gain in zip(names, gains, strict=True))
    said = "Sensors may be swapped, or not listed from the base up: low-frequency gains must rise"
    warn_channel(f"{said}, got {listed}.")
    return [names[i] for i in np.argsort(gains, kind="stable")]


def check_each(channels: xr.DataArray) -> None:
    """Warn of suspicious channels (sensor, time) in m/s^2, gaps left out; refuse constant ones."""
    names = [repr(str(name)) for name in sensor_names(channels)]
    values = np.asarray(channels.values, dtype=np.float64)
    gaps = np.isnan(values)
    measured = [row[~missing] for row, missing in zip(values, gaps, strict=True)] if gaps.any() else values
    for name, history in zip(names, measured, strict=True):
        same = f"all its {history.size} samples are {history[:1].sum():g}"
        moves = history.size and history.max() > history.min()
        require(moves, f"Channel {name} must move, {same}. Leave it out.")
    with np.errstate(over="ignore", invalid="ignore"):  # implausible peaks may be as large as numbers get
        for name, history in zip(names, measured, strict=True):
            for suspicion in _suspicions(history):
                warn_channel(f"Channel {name} {suspicion}")
        for j, i in combinations(range(len(names)), 2):
            parts = ((values[i, :k], values[j, :k]) for k in (100, None))  # the first tell most apart
            if all(np.array_equal(*part, equal_nan=True) for part in parts):
                same = f"{names[j]} and {names[i]} are identical to the last bit"
                warn_channel(f"Channels {same}: one sensor read twice. Leave one out.")
        # a first sample of exact zeros before noise or offsets is the empty packet of a logger
        whole = filled(values)[0]
        later = whole[:, 1:21]
        zero = (whole[:, 0] == 0.0) & (later != 0.0).all(axis=1) & (later.shape[1] == 20)
        if zero.all() and (np.abs(whole[:, 1]) > 4.0 * np.median(np.abs(np.diff(later)), axis=1)).any():
            said = f"of {', '.join(names)} is exactly zero, unlike those that follow: an empty packet?"
            warn_channel(f"The first sample {said} Pass skip=1 to `read_channels`, or trim it.")


def runs_of(history) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First sample and length of each run of equal samples, and the larger of the jumps beside it."""
    starts = np.flatnonzero(np.r_[True, history[1:] != history[:-1]])
    between = np.abs(np.diff(history)[starts[1:] - 1])
    jumps = np.maximum(np.r_[0.0, between], np.r_[between, 0.0])
    return starts, np.diff(np.r_[starts, history.size]), jumps


def flat_tops(history) -> list[tuple[float, np.ndarray]]:
    """Extremes at which a history stays as if cut off, and the lengths of its flat tops there."""
    starts, lengths, jumps = runs_of(history)
    found = []
    for extreme in (history.max(), history.min()):
        flat = (history[starts] == extreme) & (lengths >= _FLAT_TOP)
        if flat.any() and abs(extreme - np.median(history)) > 0.5 * history.std():  # else the value at rest
            # a smooth peak that rounds to three equal samples has 1.5 steps of the resolution beside them
            tops = lengths[flat & (jumps > 3.0 * np.diff(np.unique(history)).min())]
            found += [(extreme, tops)] if tops.size else []
    return found


def implausible(peak: float) -> str:
    """What is said of a peak [m/s^2] that no motion has."""
    what = f"an implausible peak of {peak:.4g} m/s^2, {peak / GRAVITY:.3g} g"
    return f"has {what}. Check `units`, and that it is an acceleration."


def _suspicions(history):
    """Texts about one channel: peaks that no structure sees, gravity, tops cut off and values held."""
    extent = history.max() - history.min()
    doubtful = not 2.0 * SMALLEST < extent < LARGEST  # the peak is half of it at least
    peak = np.abs(history - np.median(history)).max() if doubtful else extent
    if not SMALLEST <= peak <= LARGEST and doubtful:
        yield implausible(peak)
    elif abs(abs(history.mean()) - GRAVITY) < 0.03 * GRAVITY:
        yield f"has a mean of {history.mean():.4g} m/s^2, that of gravity. Is it vertical? Detrend it if so."
    again = history[1:] == history[:-1]
    if not (again[1:] & again[:-1]).any():  # never three in a row
        return
    for extreme, tops in flat_tops(history)[:1]:
        word = "largest" if extreme == history.max() else "smallest"
        said = f"{tops.sum()} samples at its {word} value {extreme:.4g} m/s^2, in {tops.size} flat tops"
        yield f"looks clipped: {said}. Leave it out, or use a weaker shaking."
    starts, lengths, jumps = runs_of(history)
    inner = (history[starts] != history.max()) & (history[starts] != history.min())
    held = np.flatnonzero((lengths >= _HELD) & (jumps > 2.0 * np.diff(history).std()) & inner)
    if held.size:  # filled in amid a motion: it ends, or starts, with a jump
        longest = held[np.argmax(lengths[held])]
        said = f"{history[starts[longest]]:.4g} m/s^2 over {lengths[longest]} samples"
        said = f"{said} from sample {starts[longest]}: a gap filled by the logger?"
        yield f"repeats one value amid a motion, {said} Cut it off by `trim`."
