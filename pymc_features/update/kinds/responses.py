"""Measured responses to a measured motion of the base: [data], [record], [processing], [likelihood]."""

import numpy as np
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.plots.histories import draw_expected
from pymc_features.update.config.sections import MEASURED, Data
from pymc_features.update.kinds.base import Setting
from pymc_features.update.kinds.channels import base_and_sensors, checked_dofs, read_measured
from pymc_features.update.kinds.coarseness import coarse_sampling, coarseness
from pymc_features.update.kinds.expected import expected_bands
from pymc_features.update.kinds.histories import Histories, check_errors, check_gaps
from pymc_features.update.kinds.residuals import verdict_of_responses
from pymc_features.update.plausibility.findings import mode_rows, scales
from pymc_features.update.presentation.numbers import pretty
from pymc_features.update.presentation.shown import (
    SENSORS,
    Figure,
    processing_steps,
    sensor_rows,
    table,
    write_figure,
)

GAINS = ("sensor", "gain [-]", "lag [ms]", "coherence [-]")
EXPECTED = ("mode", "priors [Hz]", "data [Hz]", "priors [%]", "damping of data [%]", "seen by")
PROMINENCE = 2.0  # of a peak of the gain over the valleys beside it, a factor


class Responses(Histories):
    """Accelerations, velocities, displacements or drifts at the sensors."""

    key, section = "data", Data

    @classmethod
    def is_asked(cls, config):
        """One record, with its excitation."""
        if config.external is not None or config.events is not None:
            return False
        return config.data is not None and config.data.excitation == "measured"

    @classmethod
    def check_sections(cls, config):
        """There are files, a likelihood, and one motion of the base."""
        if config.events is None and config.data.files is None and config.data.dataset is None:
            raise ConfigError(
                "`data` must have one of the keys `files` and `dataset`, got neither. Or name several events "
                "in [events]."
            )
        if config.likelihood is None:
            raise ConfigError("`likelihood` must be given with [data]: a table.")
        if config.data.base is None and config.record is None:
            raise ConfigError(
                "`data.base` must name the sensor on the base, got none. Or give the ground motion in "
                "[record]."
            )
        if config.data.base is not None and config.record is not None:
            raise ConfigError("`record` must be left out with `data.base`, got both. One motion of the base.")

    @classmethod
    def read(cls, given: Setting):
        """The channels, processed, and where they are on the structure."""
        dofs = checked_dofs(given.config, given.expected.n_dof)
        measured = read_measured(given.config, given.folder, given.prior)
        check_likelihood(given, dofs, [measured])
        return cls(given.config, measured, dofs)

    @property
    def used(self):
        """How many histories of what, and for how long."""
        return f"{len(self.dofs)} measured {self.plural} over {self.measured.record.duration:.4g} s"

    @property
    def plural(self) -> str:
        """What is measured, as accelerations."""
        return f"{MEASURED[self.quantity].replace('velocity', 'velocitie')}s"

    @property
    def band(self):
        """What the processing leaves [Hz]."""
        kept, nyquist = self.config.processing.band_pass, 0.5 / self.measured.step
        if kept is None:
            return 0.0, nyquist
        return kept.low or 0.0, min(kept.high or nyquist, nyquist)

    def bands(self, problem, likelihood, model, idata):
        """Add how coarse the base is sampled (sensor,)."""
        found = super().bands(problem, likelihood, model, idata)
        ratios = coarse_sampling(self, problem, idata["posterior"], found["response"])
        return found.assign(coarseness=("sensor", ratios))

    def shared(self, problem, parts):
        """Motion of the base, measured responses and their gain."""
        measured = self.measured
        gain, peaks = measured_gain(measured)
        given = problem.config.report.natural_frequencies
        if given is None and problem.modal is not None:
            given = problem.modal.data.frequencies
        data = xr.Dataset(
            {
                "ground_acceleration": ("record_time", measured.record.acceleration, {"units": "m/s^2"}),
                "measured": measured.channels.drop_attrs().assign_attrs(units=measured.units),
                "gain": gain,
                "peak_frequency": ("peak", peaks, {"units": "Hz"}),
            },
            coords={"record_time": measured.record.time},
            attrs={
                "record": measured.record.name,
                "source": measured.source,
                "interpolation": measured.record.interpolation,
                "refinement": self.request(problem)[0].factor,
            },
        )
        if given is not None:
            data["given_frequency"] = ("given", np.array(given, dtype=np.float64), {"units": "Hz"})
        return {"data": data}

    @property
    def measures(self):
        """Absolute or relative motion, and its unit."""
        relative = {"relative": "relative to the base", "inter": "those of storeys"}
        how = relative.get(self.quantity.split("_")[0], "absolute")
        return f"{self.plural.capitalize()} are {how} and in {pretty(self.measured.units)}."

    @property
    def placed(self):
        """Take the places of [data]."""
        return dict(zip(self.config.data.sensors, self.dofs, strict=True))

    @property
    def is_checked(self):
        """Whether floors follow the base somewhere, or a resonance was seen."""
        return self.measured.checked.is_any

    def told(self):
        """Say where the channels come from, and what the check found."""
        measured = self.measured
        yield f"data: {measured.source}; base: {measured.record}"
        yield f"channels: {measured.checked.sentence}"
        compared = measured.checked.compared
        yield f"priors: {compared.checked}. {scales(compared)}"
        rows = mode_rows(compared)
        yield table("expected", "data", "Priors (5 to 95 %) and data", EXPECTED, rows)
        if measured.left_out:
            yield f"left out as gaps: {measured.left_out}"

    def check(self, problem, path):
        """Draw priors and channels; gains, and how coarse the base is sampled."""
        measured = self.measured
        priors, prior = problem.priors, measured.checked.compared.prior
        units = {name: problem.unit(name) for name in priors}
        densities = {name: one.density for name, one in priors.items()}
        bands = expected_bands(self, problem)
        write_figure(draw_expected(base_and_sensors(measured), bands, densities, units), path)
        if measured.checked.gains is not None:
            yield gains_table(measured.checked.gains)
        middle = {name: priors[name].median for name in problem.structure.names}
        yield coarseness(self, problem, middle, prior.frequencies).sentence
        yield f"wrote {path}"

    def tables(self, problem):
        """The channels, and how they compare with the base."""
        measured, channels = self.measured, self.measured.channels
        left_out = (
            "Peaks, root mean squares and errors are those of the samples that are left."
            if measured.left_out
            else ""
        )
        note = (
            f"The {', '.join(processing_steps(measured.source, self.config.processing))}. There are "
            f"{channels.sizes['time']} samples at {measured.step:.6g} s, of the base at "
            f"{measured.record.dt:.6g} s. The channels were {measured.checked.sentence.rstrip('.')}. "
            f"{left_out}"
        )
        names = ["base", *channels["sensor"].values]
        histories = [measured.record.acceleration, *channels.values]
        rows = sensor_rows(names, ["", *self.dofs], histories)
        gains = [] if measured.checked.gains is None else [gains_table(measured.checked.gains)]
        return [table("channels", "data", "Channels", SENSORS, rows, note.strip()), *gains]

    def figures(self, problem, result):
        """The motion of the base, and the gain of the sensors against it."""
        return [
            Figure(
                "record",
                "Motion of the base that the model is shaken with, after processing.",
                lambda: plots.plot_record(result),
            ),
            Figure(
                "frequencies",
                "Gain of the sensors against the base (root of the ratio of power spectra), and below it the "
                "5-95 % intervals of the natural frequencies with their medians under each likelihood. "
                "Dotted: peaks of the gain; dashed: frequencies given in the configuration, or identified.",
                lambda: plots.plot_natural_frequencies(result),
            ),
        ]

    def verdict(self, problem, result, kind):
        """Whether the median response explains what was measured."""
        return verdict_of_responses(self, result, kind)


def check_likelihood(given: Setting, dofs, measured) -> None:
    """Errors fit the sensors, and likelihoods the gaps."""
    check_errors(given.config, given.priors, len(dofs))
    for one in measured:
        check_gaps(given.config, one)


def gains_table(gains) -> dict:
    """Gain, lag [ms] and coherence of each sensor against the base; dashes where it is unknown."""
    lag = np.round(1e3 * gains["lag"], 2) + 0.0  # no -0.00
    columns = gains["sensor"], gains["gain"], lag, gains["coherence"]
    cells = zip(*(column.values for column in columns), strict=True)
    rows = [
        (name, "-", "-", "-") if np.isnan(gain) else (name, f"{gain:.3f}", f"{lag:.2f}", f"{coherence:.3f}")
        for name, gain, lag, coherence in cells
    ]
    return table("gains", "data", "Sensors against the base", GAINS, rows)


def measured_gain(measured) -> tuple[xr.DataArray, np.ndarray]:
    """Gain of each sensor against the base (sensor, frequency) [-], and the frequencies of its peaks [Hz].

    The root of S_yy / S_xx by Welch's method, half-overlapping Hann windows of a third of the record: where a
    structure rings for longer than a window, a cross-spectrum would cancel at its natural frequencies. Peaks
    are those of the root mean square over sensors, where the base moves and they stand out twofold.
    """
    from scipy import signal  # a second to import

    channels, step, base = measured.channels, measured.step, measured.base
    size = max(min(64, base.size), base.size // 3)
    settings = {"fs": 1.0 / step, "nperseg": size, "nfft": 4 * size}
    frequency, power = signal.welch(base, **settings)
    answer = signal.welch(np.nan_to_num(channels.values), **settings)[1]
    answer *= channels.sizes["time"] / measured.samples[:, None]  # gaps have no power
    gain = np.sqrt(answer / np.maximum(power, 1e-6 * power.max()))
    total = np.log(np.maximum(np.sqrt((gain**2).mean(axis=0)), 1e-12))
    peaks, _ = signal.find_peaks(total, prominence=np.log(PROMINENCE))
    peaks = peaks[(power[peaks] > 1e-4 * power.max()) & (total[peaks] > 0.0)]
    dims, coords = ("sensor", "frequency"), {"sensor": channels["sensor"].values, "frequency": frequency}
    return xr.DataArray(gain, coords, dims), frequency[peaks]
