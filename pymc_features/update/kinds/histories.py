"""Measured histories that responses of a model are compared with in time, under the section [likelihood]."""

import json
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from pymc_features import plots
from pymc_features.calibration.events import SHORT
from pymc_features.exceptions import ConfigError, PredictionWarning
from pymc_features.likelihoods import DIMS, LIKELIHOODS, Comparison, abc_tolerance
from pymc_features.ops import response
from pymc_features.ops.excitation import request_in_model
from pymc_features.prediction import posterior_response
from pymc_features.prediction.draws import structure_draws
from pymc_features.records import CyclicTest, Record
from pymc_features.simulators.quantities import checked_request
from pymc_features.update.config.entries import Parameter
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import ERRORS
from pymc_features.update.kinds import base
from pymc_features.update.kinds.base import QUANTILES, KindOfData, Verdict, kinds_of, table
from pymc_features.update.templates.numbers import interval_texts

DRAWS = 200
#: Likelihoods whose posterior has an evidence, and may be the prior of another.
WITH_EVIDENCE = [name for name, one in LIKELIHOODS.items() if not (one.calibrates or one.is_likelihood_free)]
UNEXPLAINED = 0.35  # rms error over measured rms: more is no explanation, unless it is noise
NARROW, DENSE = 0.1, 0.3  # white noise has less than this share of its energy in a tenth of the frequencies
ROUGH = 0.15  # rms error over measured rms that is worth a word where it is structured
SEGMENTS = 8  # of a record, for coherences
ZOOM = 4.0  # [s] around the strongest motion
ERROR_OF_FIT = ("likelihood", "sensor", "rms error / measured rms", "samples in the 90 % band")
LARGEST = ("likelihood", "largest response", "unit", "5 %", "50 %", "95 %")
COMPONENTS, HELD = 6, 0.999  # at most so many, or as many as hold this share of the variance


@dataclass(frozen=True)
class Histories(KindOfData):
    """Histories (sensor, time) under a known excitation."""

    config: Any  # the configuration file
    record: Record | CyclicTest | None  # motion of the base, or displacement of a specimen
    # (sensor, time) what is compared, NaN in gaps, with its unit; time 0 is that of the record
    channels: xr.DataArray
    step: float  # sampling interval of the channels [s], a multiple of the record's
    source: str  # where they come from
    dofs: list[int]  # degree of freedom of each sensor
    first: int = 0  # sample of the response that the first of the channels is compared with

    n_predicted: ClassVar[int] = DRAWS
    events: ClassVar[dict] = {}

    @classmethod
    def check_sections(cls, config):
        super().check_sections(config)
        if config.likelihood is None:
            raise ConfigError(f"`likelihood` must be given with [{cls.key}]: a table.")

    def check_likelihood(self, problem) -> "Histories":
        """Refuse errors that do not fit the sensors, and likelihoods that do not fit the gaps."""
        likelihood, left_out = self.config.likelihood, self.left_out
        for name, unit in ERRORS.items():
            advice = f"Pass it in {unit}." if unit != "-" else "1 is that of TN, 2 that of EXP."
            of_each = len(self.dofs), "sensors", advice
            base.check_positive(f"likelihood.{name}", getattr(likelihood, name), problem.priors, *of_each)
        if "ABC" in likelihood.kinds and self.config.processing.compare is not None:
            raise ConfigError(
                "`likelihood.kinds` must not have ABC with `processing.compare`, for it compares whole "
                "responses. Leave one of them out."
            )
        if "ABC" in likelihood.kinds and likelihood.epsilon is None and isinstance(likelihood.sigma, list):
            raise ConfigError(
                "`likelihood.epsilon` must be given for ABC where each sensor has its own sigma, got none."
            )
        whole = [kind for kind in likelihood.kinds if not LIKELIHOODS[kind].takes_gaps]
        if whole and left_out:
            raise ConfigError(
                f"`likelihood.kinds` must not have {whole[0]} where samples are missing, got gaps of "
                f"{left_out}: it compares neighbouring samples. Compare a part without gaps by "
                "`processing.compare`, leave out the sensor, or take "
                f"{', '.join(kind for kind, entry in LIKELIHOODS.items() if entry.takes_gaps)}."
            )
        return self

    @property
    def likelihoods(self):
        return self.config.likelihood.kinds

    @property
    def quantity(self) -> str:
        return self.config.data.quantity

    @property
    def units(self) -> str:
        return self.channels.attrs.get("units", "m/s^2")

    @property
    def with_units(self) -> xr.DataArray:
        """The channels, of which nothing is said but their unit."""
        return self.channels.drop_attrs().assign_attrs(units=self.units)

    @property
    def window(self) -> slice:
        """Samples of the response, at `step`, that are compared."""
        return slice(self.first, self.first + self.channels.sizes["time"])

    @property
    def samples(self) -> np.ndarray:
        """Numbers (sensor,) of the samples that are compared."""
        return self.channels.notnull().sum("time").values

    @property
    def left_out(self) -> str:
        """Which part of each sensor is left out as a gap; empty without gaps."""
        shares = 100.0 * (1.0 - self.samples / self.channels.sizes["time"])
        named = zip(self.channels["sensor"].values, shares, strict=True)
        return ", ".join(f"{share:.2g} % of {name}" for name, share in named if share > 0.0)

    def parameters(self, likelihood):
        return self.config.likelihood.parameters_of(likelihood)

    def prints(self):
        found = base.printed({"base": self.record.inputs[0], "channels": self.channels.values})
        return found | {"base_interpolation": self.record.interpolation}

    def foretold(self, problem):
        """What likelihoods that count sensors cannot tell, perhaps of several events."""
        n_unknown, m, several = len(problem.structure.names), self.config.likelihood.m, self.events.values()
        advice = "" if several else " CAL counts what the residuals support."
        claims = {kind: LIKELIHOODS[kind].claimed for kind in self.likelihoods}
        counts = {kind: [of(one.samples, m) for one in several or [self]] for kind, of in claims.items()}
        return [
            f"{kind} counts {sum(each):.0f} observations for {n_unknown} unknown parameters of the structure"
            f": expect a posterior that is not much narrower than the prior.{advice}"
            for kind, each in counts.items()
            if None not in each and sum(each) < 2 * n_unknown
        ]

    def tolerance(self, parts) -> float:
        """delta of ABC: as the configuration says, or Eq. (16) with the posterior of EXP."""
        epsilon, sigma = self.config.likelihood.epsilon, self.config.likelihood.sigma
        if epsilon is None and isinstance(sigma, Parameter):
            sigma = sigma.times * parts["EXP"]["posterior"][sigma.prior]
        return abc_tolerance(sigma, len(self.dofs)) if epsilon is None else epsilon

    def settings(self, problem, **more) -> dict:
        """What a response needs besides the structure and the motion."""
        return {"dt": self.step, "sensors": self.dofs, "n_modes": problem.structure.n_modes} | more

    def request(self, problem):
        """The request of the model's response, with the refinement that its priors need, and its outputs."""
        with pm.Model():
            values = {name: problem.priors[name].variable(name) for name in problem.structure.names}
            structure = problem.structure(**values)
            asked, outputs = checked_request(structure, self.record, self.quantity, **self.settings(problem))
            return request_in_model(structure, self.record, asked), outputs

    def expected(self, problem) -> xr.Dataset:
        """Responses that the priors expect, as of `posterior_response`."""
        draws = base.draws_of_priors(problem, problem.structure.names, DRAWS)
        settings = self.settings(problem, draws=DRAWS, quantiles=QUANTILES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PredictionWarning)  # priors may reach beyond what a structure is
            return posterior_response(draws, problem.structure, self.record, self.quantity, **settings)

    def response(self, problem, structure):
        """The response (sensor, time) of a structure to the excitation, in the model of the context."""
        with named_key("structure"):
            return response(structure, self.record, quantity=self.quantity, **self.settings(problem))

    def declare(self, problem, likelihood, structure, values, tolerance):
        asked = self.config.likelihood
        pm.modelcontext(None).add_coords({dim: self.channels[dim].values for dim in DIMS})
        mu = self.response(problem, structure)
        errors = self.variables(likelihood, values)
        if self.config.processing.compare is not None:
            mu = mu[:, self.window]
            errors["dt"] = pt.constant(self.step)  # which likelihoods no longer see
        given = Comparison(mu, self.channels.values, epsilon=tolerance, density=asked.density, **errors)
        LIKELIHOODS[likelihood].declare(given)

    def predict(self, problem, likelihood, model, idata):
        """The histories, bands of the response, and responses of draws by their principal components."""
        observed = self.channels
        with self.responses(problem, model, idata) as (labels, blocks):
            quantiles = np.empty((len(QUANTILES), *observed.shape))
            for first, values in blocks():
                part = slice(first, first + values.shape[1])
                quantiles[:, :, part] = np.quantile(values, QUANTILES, axis=-1)
            coords = {"quantile": list(QUANTILES)} | {dim: observed[dim] for dim in observed.dims}
            response = xr.DataArray(quantiles, coords, ("quantile", *observed.dims))
            median = response.sel(quantile=0.5, drop=True)
            return {
                "observed_data": xr.Dataset({"y": self.with_units}),
                "bands": self.bands(problem, likelihood, model, idata, response),
                "histories": principal_components(blocks, median, labels),
            }

    @contextmanager
    def responses(self, problem, model, idata):
        """Labels of some draws, and a function that yields blocks of their responses where they are compared.

        A block has its first sample and the responses (sensor, time, draw) from there on.
        """
        posterior, name, start = idata["posterior"].to_dataset(), self.quantity, self.first
        asked = [self.record], [name], DRAWS, 0
        settings = self.settings(problem, keep_histories=True)
        with structure_draws(posterior, problem.structure, *asked, **settings) as drawn:

            def blocks():
                for first, values in drawn.ensemble.blocks(name):
                    at, end = max(first, start), self.window.stop
                    if first < end and first + values.shape[1] > at:
                        yield at - start, values[:, at - first : end - first]

            yield drawn.labels, blocks

    def bands(self, problem, likelihood, model, idata, response) -> xr.Dataset:
        """Bands of the response and of data like those measured, at the sensors.

        `response` (quantile, sensor, time) is of the parameters' uncertainty alone; `predictive`, the same of
        draws of the likelihood, errors included (ABC has none); `normalised_error` (sensor), rms of measured
        less median response over rms measured; `coverage` (sensor), share of the samples in the predictive
        band, both without the gaps in what was measured; peaks of other responses (`<quantity>_peak`) if the
        report asks for them.
        """
        observed, found = self.channels, xr.Dataset({"response": response})
        off = observed - response.sel(quantile=0.5, drop=True)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a channel of zeros
            found["normalised_error"] = np.sqrt((off**2).mean("time") / (observed**2).mean("time"))
        if not LIKELIHOODS[likelihood].is_likelihood_free:
            found["predictive"] = response.dims, predictive(model, idata, self.n_predicted)
            low, high = found["predictive"].isel(quantile=0), found["predictive"].isel(quantile=-1)
            inside = ((observed >= low) & (observed <= high)).where(observed.notnull())
            found["coverage"] = inside.mean("time")
        if names := problem.config.report.quantities:
            settings = self.settings(problem, draws=DRAWS, random_seed=0, sensors=None)
            rest = posterior_response(idata, problem.structure, self.record, names, **settings)
            for name in names:
                peak = rest[f"{name}_peak"]
                rows = {dim: f"{name}_{dim}" for dim in peak.dims if dim != "sample"}
                kept = peak.rename(rows).quantile(QUANTILES, dim="sample", keep_attrs=True)
                found[f"{name}_peak"] = kept.drop_vars([c for c in kept.coords if c not in kept.dims])
        return found

    def shared(self, problem):
        return {"data": xr.Dataset({"measured": self.with_units}, attrs={"source": self.source})}

    def sentences(self, problem, result, explains):
        if self.left_out:
            yield f"Left out as gaps: {self.left_out}.", True
        kinds = kinds_of(result)
        for kind in (kind for kind in kinds if LIKELIHOODS[kind].calibrates):
            yield self.supported(result[kind], kind, kinds, explains), True

    def supported(self, part, kind: str, kinds, explains: bool) -> str:
        """How many observations the residuals support, and what made the intervals what they are."""
        n_eff, m = float(part["calibration"].attrs["n_eff"]), self.config.likelihood.m
        names = dict.fromkeys([LIKELIHOODS[kind].calibrates, *kinds])
        claims = {name: LIKELIHOODS[name].claimed(self.samples, m) for name in names}
        claimed = [f"{name} {n:,.0f}" for name, n in claims.items() if n is not None]
        claimed[0] = claimed[0].replace(" ", " claims ", 1)
        told = [f"The residuals support {n_eff:,.0f} independent observations; {', '.join(claimed)}."]
        n_modes = part["calibration"].sizes.get("mode", 1)
        if not explains:
            told.append("No interval can be relied on where the model does not explain the measurements.")
        elif n_modes > 1:
            told.append(
                f"The likelihood has {n_modes} maxima, of which residuals do not tell the right one: no "
                "interval can be relied on."
            )
        else:
            told.append(f"{kind} comes first, for its intervals are as wide as the residuals support.")
        told.append(json.loads(part.attrs["calibration"])["sentence"])
        if at := bounds_of(part):
            named = ", ".join(f"{name} ({bound:.4g})" for name, bound in at.items())
            told.append(f"Next to a bound of its prior the 90 % interval is the shortest one: {named}.")
        return " ".join(filter(None, told))

    def errors(self, part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Error of the median response, zero in gaps; its relative rms, and whether it is no noise."""
        error = part["observed_data"]["y"] - part["bands"]["response"].sel(quantile=0.5, drop=True)
        error = np.nan_to_num(error.transpose("sensor", "time").values)
        structured = densest_share(error, self.step, self.band) > DENSE
        return error, part["bands"]["normalised_error"].values, structured

    def verdict(self, problem, result, kind):
        sensors = result[kind]["bands"]["sensor"].values.astype(str)
        _, relative, structured = self.errors(result[kind])
        bad, rough = structured & (relative > UNEXPLAINED), structured & (relative > ROUGH)
        told = [headline(sensors, relative, bad)]
        if rough.any():
            told.append(
                f"The error at {', '.join(sensors[rough])} is no noise but an error of the model: it is "
                "gathered around few frequencies."
            )
        return Verdict(told, not bad.any())

    def tables(self, problem, result):
        fit, peaks = [], []
        for kind in kinds_of(result):
            bands = result[kind]["bands"].to_dataset()
            shares = bands.get("coverage", xr.full_like(bands["normalised_error"], np.nan)).values
            columns = bands["sensor"].values, bands["normalised_error"].values, shares
            for name, error, share in zip(*columns, strict=True):
                fit.append((kind, name, f"{error:.2f}", "" if np.isnan(share) else f"{100 * share:.0f} %"))
            names = [name for name in bands.data_vars if str(name).endswith("_peak")]
            peaks += [(kind, *row) for name in names for row in peak_rows(bands[name])]
        return [
            table("fit", "response", "Error of the median response", ERROR_OF_FIT, fit),
            table("peaks", "response", "Largest values of other responses", LARGEST, peaks),
        ]

    def figures_of(self, problem, part, kind):
        return {
            "response": lambda: plots.predictive(part),
            "response_zoom": lambda: plots.predictive(part, window=strongest(part)),
        }


def densest_share(error, step, band) -> np.ndarray:
    """Largest share (sensor,) of the energy of errors (sensor, time) in a tenth of a band."""
    from scipy import signal  # a second to import

    size = error.shape[1]
    frequency, spectrum = signal.welch(error, 1.0 / step, nperseg=min(size, max(16, size // SEGMENTS)))
    inside = np.sort(spectrum[:, (frequency >= band[0]) & (frequency <= band[1])], axis=1)
    some = max(1, round(NARROW * inside.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):  # of no error at all
        return np.nan_to_num(inside[:, -some:].sum(axis=1) / inside.sum(axis=1))


def accounted_for(sensors, relative) -> str:
    """Share of the mean square of each sensor that is explained, by its relative error."""
    shares = 100.0 * np.maximum(0.0, 1.0 - np.square(relative))
    return ", ".join(f"{share:.0f} % of {name}" for name, share in zip(sensors, shares, strict=True))


def headline(sensors, relative, bad) -> str:
    """One sentence on all sensors."""
    named = accounted_for(sensors, relative)
    if bad.any():
        worst = ", ".join(np.asarray(sensors)[bad])
        return f"This model does not explain {worst}: it accounts for {named} (share of the mean square)."
    if (relative > UNEXPLAINED).any():
        return f"The model explains the measurements but for noise: it accounts for {named}."
    return f"The model explains the measurements: it accounts for {named} (share of the mean square)."


def predictive(model, idata, draws: int) -> np.ndarray:
    """Quantiles (quantile, sensor, time) of draws of the data."""
    posterior = base.thinned(idata["posterior"].to_dataset(), draws)
    drawn = pm.sample_posterior_predictive(
        xr.DataTree.from_dict({"posterior": posterior}),
        model=model,
        var_names=["y"],
        random_seed=0,
        progressbar=False,
        compile_kwargs={"mode": "FAST_COMPILE"},
    )
    values = drawn["posterior_predictive"]["y"].values
    return np.nanquantile(values.reshape(-1, *values.shape[2:]), QUANTILES, axis=0)


def bounds_of(part) -> dict[str, float]:
    """Parameters whose interval is the shortest, and the bound of their prior that it lies next to."""
    found = json.loads(part.attrs.get("calibration", '{"parameters": {}}'))["parameters"]
    close = {name: row for name, row in found.items() if (row["room"] or 0.0) < SHORT and row["near_bound"]}
    return {name: row["bound"] for name, row in close.items()}


def peak_rows(peaks) -> list[tuple]:
    """Place, unit and quantiles of the largest values of a quantity."""
    label = str(peaks.name).removesuffix("_peak").replace("_", " ")
    values = np.reshape(peaks.transpose("quantile", ...).values, (peaks.sizes["quantile"], -1)).T
    dim = next((d for d in peaks.dims if d != "quantile"), None)
    names = [f"{label}, {dim.rpartition('_')[2]} {v}" for v in peaks[dim].values] if dim else [label]
    texts = [interval_texts(row, peaks.attrs.get("units", "-")) for row in values]
    return [(name, unit, *row) for name, (unit, row) in zip(names, texts, strict=True)]


def strongest(part) -> tuple[float, float]:
    """A window [s] around the largest measured acceleration."""
    observed = part["observed_data"]["y"]
    peak = float(observed["time"][int(np.abs(np.nan_to_num(observed.values)).max(axis=0).argmax())])
    last = float(observed["time"][-1])
    first = max(0.0, min(peak - 0.4 * ZOOM, last - ZOOM))
    return first, min(last, first + ZOOM)


def principal_components(blocks, median, labels) -> xr.Dataset:
    """Responses of some draws, less their median, by principal components: a page shows any, and holds few.

    The deviations D (sensor and time, draw) have the Gram matrix D'D = V diag(s^2) V'; the components are
    U = D V with the largest s, and a draw is the median plus U times its row of V. The share of the variance
    that is held is in `attrs`.
    """

    def deviations():
        for first, values in blocks():
            part = slice(first, first + values.shape[1])
            yield part, values - median.values[:, part, None]

    gram = sum(np.einsum("rta,rtb->ab", d, d) for _, d in deviations())
    squares, vectors = np.linalg.eigh(gram)
    squares, vectors = np.maximum(squares[::-1], 0.0), vectors[:, ::-1]
    total = squares.sum()
    share = np.cumsum(squares) / total if total > 0.0 else np.ones(len(squares))
    n = min(int(np.searchsorted(share, HELD)) + 1, COMPONENTS, len(squares))
    component = np.zeros((n, *median.shape), np.float32)
    for part, d in deviations():
        component[:, :, part] = np.einsum("rts,sc->crt", d, vectors[:, :n])
    return xr.Dataset(
        {
            "component": (("component", *median.dims), component),
            "coefficient": (("sample", "component"), vectors[:, :n]),
        },
        {"sensor": median["sensor"], "time": median["time"], **labels},
        {"share": float(share[n - 1])},
    )
