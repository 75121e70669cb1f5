"""The check of channels against each other, and the lines of the file that correct what it finds."""

import json
import re
import warnings
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features import signals
from pymc_features.exceptions import ChannelWarning, ConfigError, PriorWarning
from pymc_features.update.plausibility.findings import Compared, of_data
from pymc_features.update.plausibility.resonances import spectra_of
from pymc_features.update.plausibility.sensors import lags_confirmed, told_by_modes

LOWEST, HIGHEST = 1.0 / 7.0, 0.5  # of the first natural frequency: where the floors follow the base
TOP = 0.55  # the same, of a band that was asked for
NARROWEST = 1.5  # factor between the ends of a band
LAGS = "Check clocks"  # in what is said of them
EXPLAINS_ANY = 0.99  # damping ratio that explains any lag
FOLLOWS = 0.7  # coherence of one floor at least, where nobody has named the band
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
    compared : Compared or None
        The data beside the priors; None of a cyclic test.
    """

    gains: xr.Dataset | None
    sentence: str
    compared: Compared | None = None

    @property
    def is_any(self) -> bool:
        """Whether anything could be checked."""
        return self.gains is not None or (self.compared is not None and bool(self.compared.peaks))


def check(channels, config, prior) -> Checked:
    """Compare the channels, base first, with the priors, and check them where floors follow the base.

    That is in the band of the file, but below the first natural frequency that the data show, or the priors
    where they do not.

    Raises
    ------
    ConfigError
        If the clock of a sensor is a second or more from that of the base.

    Warns
    -----
    PriorWarning
        What the priors and the data contradict each other in.
    ChannelWarning
        What `check_channels` finds, and the lines of the file that correct it.
    """
    compared = compare_with_priors(channels, config, prior)
    if config.processing.check_band is False:
        return Checked(None, "not checked against each other, as the file says", compared)
    band = band_of(config.processing.check_band, compared, prior)
    if config.data.quantity != "absolute_acceleration":
        reason = f"{config.data.quantity} is no motion of the base"
    else:
        reason = "" if band == config.processing.check_band else why_not(channels, band)
    if reason:
        gains, sentence = unknown_gains(channels), f"not checked against each other: {reason}"
    else:
        gains = gains_of(channels, band, compared, config)
        sentence = f"checked against each other between {band[0]:.3g} and {band[1]:.3g} Hz"
        refuse_offsets(gains)
    if of_modes := told_by_modes(gains, compared.placed):
        warnings.warn(of_modes, ChannelWarning, stacklevel=2)
    if lines := corrections(gains, config):
        warnings.warn(f"If it is so, put into [data]: {'; '.join(lines)}", ChannelWarning, stacklevel=2)
    return Checked(None if reason else gains, sentence, compared)


def band_of(asked, compared, prior) -> tuple[float, float]:
    """Choose where floors follow the base: the band of the file, below the first mode of data or priors."""
    first = prior.first
    if compared.first and (compared.is_contradicted or HIGHEST * first > TOP * compared.first):
        first = compared.first
    if asked is None:
        return LOWEST * first, HIGHEST * first
    if compared.first and asked[1] > TOP * compared.first:
        return asked[0], TOP * compared.first
    return asked


def compare_with_priors(channels, config, prior) -> Compared:
    """Compare what the sensors show with the priors, and warn of what is wrong."""
    data, asked, kept = config.data, config.processing, config.processing.band_pass
    step = signals.sampling_step(channels)
    window = asked.compare or asked.trim or (0.0, channels.sizes["time"] * step)
    compared = of_data(
        channels,
        step,
        prior,
        sensor_dofs(config),
        data.quantity,
        duration=window[1] - window[0],
        pass_band=(0.0, np.inf) if kept is None else (kept.low or 0.0, kept.high or np.inf),
    )
    for sentence in compared.sentences:
        warnings.warn(sentence, PriorWarning, stacklevel=2)
    return compared


def gains_of(channels, band, compared, config) -> xr.Dataset:
    """What `check_channels` finds, without lags that the modes contradict."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gains = signals.check_channels(channels, band=band)
    delays = gains["delay"].values[1:]
    is_lag = delays.any() and np.abs(delays).max() < OFFSET
    if (
        is_lag
        and compared.placed is not None
        and not lags_confirmed(
            spectra_of(channels, compared.step),
            compared.prior,
            sensor_dofs(config),
            config.data.quantity,
            factor=compared.scale.factor,
            delays=delays,
        )
    ):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            gains = signals.check_channels(channels, band=band, damping_ratio=EXPLAINS_ANY)
    for warning in sorted(caught, key=lambda warning: LAGS in str(warning.message)):  # the least of faults
        warnings.warn(warning.message, warning.category, stacklevel=2)
    return gains


def sensor_dofs(config) -> list[int]:
    """Degree of freedom of each sensor."""
    return config.data.dofs or list(range(len(config.data.sensors)))


def unknown_gains(channels) -> xr.Dataset:
    """What `check_channels` returns where nothing is to be corrected."""
    n = channels.sizes["sensor"]
    columns = {"scale": ("sensor", np.ones(n)), "delay": ("sensor", np.zeros(n))}
    return xr.Dataset(columns, {"sensor": channels["sensor"].values})


def why_not(channels, band) -> str:
    """Why a band tells nothing; empty if it does."""
    if not band[1] > NARROWEST * band[0]:
        return f"the first mode of the data leaves too little of the band from {band[0]:.3g} Hz on"
    try:
        coherence = signals.low_frequency_gains(channels, band)["coherence"].values[1:]
    except ValueError as error:
        return str(error)
    if not (coherence >= FOLLOWS).any():
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
    entries = [f"{name_of(name)} = {float(f'{value:.6g}')}" for name, value in values.items()]
    return f"{{ {', '.join(entries)} }}" if entries else "{}"  # which cancels what is there


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
