"""Measured responses to a measured motion of the base: [data], [record], [processing], [likelihood]."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from pymc_features import signals
from pymc_features.exceptions import ConfigError
from pymc_features.io.reading.labels import SI
from pymc_features.plots.histories import draw_expected
from pymc_features.records import Record
from pymc_features.simulators.quantities import rows_of
from pymc_features.simulators.simulate import respond
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import MEASURED, Data
from pymc_features.update.kinds import channels as files
from pymc_features.update.kinds.base import QUANTILES, Verdict, channels_table, drawn_to, table
from pymc_features.update.kinds.histories import ROUGH, SEGMENTS, UNEXPLAINED, Histories, headline
from pymc_features.update.plausibility.findings import Compared, mode_rows, scales
from pymc_features.update.templates.numbers import pretty

GAINS = ("sensor", "gain [-]", "lag [ms]", "coherence [-]")
EXPECTED = ("mode", "priors [Hz]", "data [Hz]", "priors [%]", "damping of data [%]", "seen by")
PROMINENCE = 2.0  # of a peak of the gain over the valleys beside it, a factor
FINEST = 8  # refinement of the record beside which that of the model is judged
TOO_COARSE = 1.0  # difference over the half-width of the 90 % bands that is more than the fit may claim
WORSE = 0.9  # relative error of a model with which nothing is gained
RINGS = 0.4  # share of the error's energy near natural frequencies
FOLLOWS = 0.6  # coherence of the error with the base: noise has it in one of 20,000 frequencies
BESIDE = 0.1  # relative distance within which a peak is that of a natural frequency
DAMPING = (5e-4, 0.2)  # ratios that structures have


@dataclass(frozen=True)
class Responses(Histories):
    """Accelerations, velocities, displacements or drifts at the sensors."""

    compared: Compared | None = None  # the data beside the priors
    gains: xr.Dataset | None = None  # of `check_channels`; None where it could not tell anything
    checked: str = ""  # what was checked of the channels against each other, or why it was not

    key, section = "data", Data

    @classmethod
    def is_asked(cls, config):
        if config.external is not None or config.events is not None:
            return False
        return config.data is not None and config.data.excitation == "measured"

    @classmethod
    def check_sections(cls, config):
        if config.events is None and config.data.files is None and config.data.dataset is None:
            raise ConfigError(
                "`data` must have one of the keys `files` and `dataset`, got neither. Or give [events]."
            )
        super().check_sections(config)
        if config.data.base is None and config.record is None:
            raise ConfigError(
                "`data.base` must name the sensor on the base, got none. Or give its motion in [record]."
            )
        if config.data.base is not None and config.record is not None:
            raise ConfigError("`record` must be left out with `data.base`, got both. One motion of the base.")

    @classmethod
    def read(cls, problem):
        dofs = files.checked_dofs(problem.config, problem.expected.n_dof)
        return cls.of_files(problem, problem.config, problem.folder, dofs).check_likelihood(problem)

    @staticmethod
    def of_files(problem, config, folder: Path, dofs) -> "Responses":
        """Read, correct, check and process the channels of a configuration with files in a folder."""
        data, asked = config.data, config.processing
        channels, source = files.read_corrected(config, folder)
        section, file = data, source
        if config.record is not None:
            channels = files.with_motion(channels, config.record, folder)
            section, file = config.record, Path(config.record.path).name
        gaps = np.isnan(channels.values[0])
        if gaps.any():
            start = float(channels["time"][int(gaps.argmax())])
            raise ConfigError(
                f"`data.base` must have no gaps, for it shakes the model, got {gaps.sum()} samples missing "
                f"in {data.base}, the first at {start:g} s. Cut the files to one side by `data.rows`, or "
                "give the motion in [record]."
            )
        channels = files.detrended(channels, asked)
        with named_key("processing.check_band"):
            prior = problem.prior.at_sensors(dofs, data.quantity)
            compared, gains, checked = files.check(channels, config, prior)
        if asked.band_pass is not None:
            corners = asked.band_pass.low, asked.band_pass.high
            with named_key("processing.band_pass"):
                channels = signals.band_pass(channels, *corners, order=asked.band_pass.order)
        if asked.trim is not None:
            with named_key("processing.trim"):
                files.warn_of_motion(channels, asked.trim[0], compared.first or problem.prior.first)
                channels = signals.trim(channels, *asked.trim)
        channels = channels.drop_vars("units", errors="ignore")  # of which there may be two
        motion = channels.isel(sensor=0).assign_attrs(units="m/s^2")
        title = f"{data.base or 'ground motion'}, {file}"
        record = Record.from_channel(motion, name=title, interpolation=section.interpolation)
        with named_key("processing.decimate"):
            floors = signals.decimate(channels.isel(sensor=slice(1, None)), asked.decimate)
        if MEASURED[data.quantity] == "acceleration":
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Mean of empty slice")  # in a gap from end to end
                files.warn_of_offsets(floors)
        floors, first = files.part_compared(floors.assign_attrs(units=SI[MEASURED[data.quantity]]), asked)
        for name in floors["sensor"].values[floors.isnull().all("time").values]:
            raise ConfigError(
                f"`data.sensors` must have samples to compare, got a gap from end to end of {name} (filters "
                "and decimation widen gaps). Leave it out."
            )
        step = asked.decimate * record.dt
        return Responses(config, record, floors, step, source, dofs, first, compared, gains, checked)

    @property
    def used(self):
        return f"{len(self.dofs)} measured {self.plural} over {self.record.duration:.4g} s"

    @property
    def plural(self) -> str:
        """What is measured, as accelerations."""
        return f"{MEASURED[self.quantity].replace('velocity', 'velocitie')}s"

    @property
    def measures(self):
        relative = {"relative": "relative to the base", "inter": "those of storeys"}
        how = relative.get(self.quantity.split("_")[0], "absolute")
        return f"{self.plural.capitalize()} are {how} and in {pretty(self.units)}."

    @property
    def band(self):
        kept, nyquist = self.config.processing.band_pass, 0.5 / self.step
        if kept is None:
            return 0.0, nyquist
        return kept.low or 0.0, min(kept.high or nyquist, nyquist)

    @property
    def placed(self):
        return dict(zip(self.config.data.sensors, self.dofs, strict=True))

    @property
    def is_checked(self):
        """Whether floors follow the base somewhere, or a resonance was seen."""
        return self.gains is not None or bool(self.compared.peaks)

    @property
    def motion(self) -> np.ndarray:
        """Motion of the base (time,) at the times of the channels [m/s^2]."""
        from scipy import signal  # a second to import

        stride = round(self.step / self.record.dt)
        return signal.resample_poly(self.record.acceleration, 1, stride)[self.window]

    @property
    def with_motion(self) -> xr.DataArray:
        """All channels (sensor, time) after processing, the base first."""
        names = ["base", *self.channels["sensor"].values.astype(str)]
        coords = {"sensor": names, "time": self.channels["time"].values}
        if self.units != "m/s^2":
            coords["units"] = "sensor", ["m/s^2", *[self.units] * (len(names) - 1)]
        return xr.DataArray(np.vstack([self.motion, self.channels.values]), coords, ("sensor", "time"))

    def bands(self, problem, likelihood, model, idata, response):
        """Add what refining the base changes, over the half-width of the 90 % bands, (sensor,)."""
        found, posterior = super().bands(problem, likelihood, model, idata, response), idata["posterior"]
        ends = found["response"].sel(quantile=[QUANTILES[0], QUANTILES[-1]])
        low, high = ends.transpose("quantile", "sensor", "time").values
        values = {name: float(posterior[name].mean()) for name in problem.structure.names}
        _, change, _ = self.refined(problem, values)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = change / (0.5 * np.sqrt(((high - low) ** 2).mean(axis=1)))
        return found.assign(coarseness=("sensor", ratios))

    def refined(self, problem, values) -> tuple[float, np.ndarray, np.ndarray]:
        """What a refinement of the base by eight changes of the responses at some values of the priors.

        A record that is taken as straight lines is compared with one that is band-limited. Returned are the
        highest natural frequency that the record excites over the sampling rate of the base [-], and root
        mean squares of the difference and of the response (sensor,).
        """
        structure, record = problem.structure(**values), self.record
        asked, outputs = self.request(problem)
        rows = rows_of(structure, asked.quantity, asked, outputs).picked
        used = respond(structure, record, asked, rows)[:, self.window]
        smooth = replace(record, interpolation="band-limited")
        fine = respond(structure, smooth, asked._replace(factor=FINEST), rows)[:, self.window]
        modes = structure.modes(asked.n_modes) if structure.family == "linear" else structure.modes()
        shares = modes.natural_frequencies * record.dt
        change, size = (np.sqrt((rows**2).mean(axis=1)) for rows in (used - fine, fine))
        return float(shares[shares <= 1.0].max(initial=shares[0])), change, size

    def shared(self, problem):
        gain, peaks = measured_gain(self)
        given = problem.config.report.natural_frequencies
        if given is None and problem.modal is not None:
            given = problem.modal.data.frequencies
        data = super().shared(problem)["data"].assign_coords(record_time=self.record.time)
        data["ground_acceleration"] = "record_time", self.record.acceleration, {"units": "m/s^2"}
        data["gain"], data["peak_frequency"] = gain, ("peak", peaks, {"units": "Hz"})
        if given is not None:
            data["given_frequency"] = "given", np.array(given, dtype=np.float64), {"units": "Hz"}
        how = {"record": self.record.name, "interpolation": self.record.interpolation}
        return {"data": data.assign_attrs(how, refinement=self.request(problem)[0].factor)}

    def told(self):
        yield f"data: {self.source}; base: {self.record}"
        yield f"channels: {self.checked}"
        yield f"priors: {self.compared.checked}. {scales(self.compared)}"
        yield table("expected", "data", "Priors (5 to 95 %) and data", EXPECTED, mode_rows(self.compared))
        if self.left_out:
            yield f"left out as gaps: {self.left_out}"

    def check(self, problem, path):
        densities = {name: prior.density for name, prior in problem.priors.items()}
        expected = self.expected(problem)[self.quantity].transpose("quantile", ..., "time")
        bands = expected.values[..., self.window]
        wrote = drawn_to(path, lambda: draw_expected(self.with_motion, bands, densities, problem.units))
        if self.gains is not None:
            yield gains_table(self.gains)
        middle = {name: problem.priors[name].median for name in problem.structure.names}
        share, change, size = self.refined(problem, middle)
        yield (
            f"The base is sampled {1.0 / share:.3g} times in a period of the highest mode used; "
            f"refining it {FINEST} times changes responses by {100.0 * max(change / size):.2g} %."
        )
        yield wrote

    def tables(self, problem, result):
        more = f", of the base at {self.record.dt:.6g} s. The channels were {self.checked.rstrip('.')}. "
        if self.left_out:
            more += "Peaks, root mean squares and errors are those of the samples that are left."
        gains = [] if self.gains is None else [gains_table(self.gains)]
        channels = channels_table(self, more, self.record.acceleration)
        return [*super().tables(problem, result), channels, *gains]

    def verdict(self, problem, result, kind):
        part = result[kind]
        modes = part["modal"].to_dataset().median(["chain", "draw"])
        frequencies, ratios = modes["natural_frequency"].values, modes["damping_ratio"].values
        error, relative, structured = self.errors(part)
        sensors = part["bands"]["sensor"].values.astype(str)
        bad = (relative > UNEXPLAINED) & structured
        told = [headline(sensors, relative, bad)]
        measured = np.nan_to_num(self.channels.values)
        turned = np.sqrt(((2.0 * measured - error) ** 2).sum(axis=1) / (measured**2).sum(axis=1))
        if (relative > WORSE).all() and (turned < relative).all():
            told.append(
                "With the opposite sign of the base the same model comes closer: the base, or all sensors, "
                "may be inverted. Try scale = { ... = -1.0 } in [data]."
            )
        else:
            found = residuals_of(self, error, frequencies)
            rough, peaks = structured & (relative > ROUGH), result["data"]["peak_frequency"].values
            told += errors_of_model(found, sensors, rough, peaks, frequencies, self.band)
        told += odd_modes(frequencies, ratios, self.band)
        of_sampling = []
        if "coarseness" in part["bands"]:
            of_sampling = too_coarse(part["bands"]["coarseness"].values, sensors, self.record)
        return Verdict([*told, *of_sampling], not bad.any() and not of_sampling)


def gains_table(gains) -> dict:
    """Gain, lag [ms] and coherence of each sensor against the base; dashes where it is unknown."""
    lag = np.round(1e3 * gains["lag"], 2) + 0.0  # no -0.00
    columns = gains["sensor"], gains["gain"], lag, gains["coherence"]
    rows = [
        (name, *(("-", "-", "-") if np.isnan(gain) else (f"{gain:.3f}", f"{lag:.2f}", f"{coherence:.3f}")))
        for name, gain, lag, coherence in zip(*(column.values for column in columns), strict=True)
    ]
    return table("gains", "data", "Sensors against the base", GAINS, rows)


def measured_gain(data: Responses) -> tuple[xr.DataArray, np.ndarray]:
    """Gain of each sensor against the base (sensor, frequency) [-], and the frequencies of its peaks [Hz].

    The root of S_yy / S_xx by Welch's method, half-overlapping Hann windows of a third of the record: where a
    structure rings for longer than a window, a cross-spectrum would cancel at its natural frequencies. Peaks
    are those of the root mean square over sensors, where the base moves and they stand out twofold.
    """
    from scipy import signal  # a second to import

    channels, step, base = data.channels, data.step, data.motion
    size = max(min(64, base.size), base.size // 3)
    settings = {"fs": 1.0 / step, "nperseg": size, "nfft": 4 * size}
    frequency, power = signal.welch(base, **settings)
    answer = signal.welch(np.nan_to_num(channels.values), **settings)[1]
    answer *= channels.sizes["time"] / data.samples[:, None]  # gaps have no power
    gain = np.sqrt(answer / np.maximum(power, 1e-6 * power.max()))
    total = np.log(np.maximum(np.sqrt((gain**2).mean(axis=0)), 1e-12))
    peaks, _ = signal.find_peaks(total, prominence=np.log(PROMINENCE))
    peaks = peaks[(power[peaks] > 1e-4 * power.max()) & (total[peaks] > 0.0)]
    dims, coords = ("sensor", "frequency"), {"sensor": channels["sensor"].values, "frequency": frequency}
    return xr.DataArray(gain, coords, dims), frequency[peaks]


class Residuals(NamedTuple):
    """Spectra of what the median response of a likelihood leaves over."""

    frequency: np.ndarray  # (frequency,) [Hz]
    # (sensor, frequency) its coherence with the base, and its power over that of the measured response [-]
    coherence: np.ndarray
    left: np.ndarray
    near: np.ndarray  # (sensor, mode) share of its energy near the natural frequencies of the model


def residuals_of(data: Responses, error, frequencies) -> Residuals:
    """Spectra of the error (sensor, time) of the median response, beside those of the base."""
    from scipy import signal  # a second to import

    measured, size = np.nan_to_num(data.channels.values), error.shape[1]
    if not error.any():  # a response without any error has no spectrum of it
        error = np.finfo(float).eps * measured
    fs = 1.0 / data.step
    rough = {"fs": fs, "nperseg": min(size, max(16, size // SEGMENTS))}
    with np.errstate(divide="ignore", invalid="ignore"):  # of frequencies without any motion
        frequency, coherence = signal.coherence(data.motion[:size], error, **rough)
    fine = min(size, max(64, size // 3))
    at, power = signal.welch(error, fs=fs, nperseg=fine, nfft=4 * fine)
    close = np.maximum(BESIDE * frequencies, 2.0 * fs / fine)[:, None]
    beside = np.abs(at - frequencies[:, None]) < close
    beside &= np.cumsum(beside, axis=0) == 1  # each frequency counts once
    return Residuals(
        frequency,
        np.nan_to_num(coherence),
        signal.welch(error, **rough)[1] / signal.welch(measured, **rough)[1],
        power @ beside.T / power.sum(axis=1, keepdims=True),
    )


def errors_of_model(found: Residuals, sensors, rough, peaks, frequencies, band):
    """Say where errors are no noise and at which mode they ring, and which peaks the model lacks."""
    if rough.any():
        near = found.near[rough].mean(axis=0)
        mode = int(near.argmax())
        where = f", most of it at mode {mode + 1} ({frequencies[mode]:.3g} Hz)" if near.sum() > RINGS else ""
        yield (
            f"The error at {', '.join(sensors[rough])} is no noise but an error of the model{where}: "
            "stiffness or damping may change during the motion, as where springs yield, or the model lacks a "
            "part."
        )
    follows = ((found.coherence > FOLLOWS) & (found.left > 0.5)).any(axis=0)
    alone = [
        f"{peak:.3g}"
        for peak in peaks
        if band[0] < peak < band[1]
        and (np.abs(frequencies - peak) >= BESIDE * peak).all()
        and follows[np.abs(found.frequency - peak) <= 1.5 * found.frequency[1]].any()
    ]
    if alone:
        yield (
            f"The measurements have a peak at {', '.join(alone)} Hz, where the model has no natural "
            "frequency: a storey, a direction or a support may be missing."
        )


def odd_modes(frequencies, ratios, band):
    """Say which natural frequencies the data do not show, and which damping structures do not have."""
    outside = [f"f{k + 1} ({f:.3g} Hz)" for k, f in enumerate(frequencies) if not band[0] <= f <= band[1]]
    if outside:
        more = f" and {len(outside) - 5} more" if len(outside) > 5 else ""
        yield (
            f"{', '.join(outside[:5])}{more} {'lies' if len(outside) == 1 else 'lie'} outside the band of "
            f"the data, {band[0]:.3g} to {band[1]:.3g} Hz: what is said of them is extrapolated from the "
            "others."
        )
    odd = np.flatnonzero((ratios < DAMPING[0]) | (ratios > DAMPING[1]))
    if odd.size:
        named = ", ".join(f"{100 * ratios[k]:.3g} % at mode {k + 1}" for k in odd[:5])
        yield (f"The damping is beyond what structures have: {named}. It may stand for what the model lacks.")


def too_coarse(ratios, sensors, record) -> list[str]:
    """A sentence where the sampling of the base changes a response by more than its bands are wide."""
    worst = int(np.nan_to_num(ratios).argmax())
    if not ratios[worst] > TOO_COARSE:
        return []
    is_linear = record.interpolation == "linear"
    advice = 'Set interpolation = "band-limited".' if is_linear else "Measure the base at a higher rate."
    return [
        f"The base is sampled too coarsely: refining it {FINEST} times changes the response of "
        f"{sensors[worst]} by {ratios[worst]:.2g} times the half-width of its 90 % bands. Do not use these "
        f"results. {advice}"
    ]
