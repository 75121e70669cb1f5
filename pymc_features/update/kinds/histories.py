"""Measured histories that responses of a model are compared with in time, under the section [likelihood]."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.likelihoods import DIMS, LIKELIHOODS, Comparison, abc_tolerance
from pymc_features.ops import response
from pymc_features.ops.excitation import request_in_model
from pymc_features.prediction import posterior_response
from pymc_features.simulators.quantities import checked_request
from pymc_features.storage import fingerprint
from pymc_features.update.config.entries import Parameter, evaluated
from pymc_features.update.config.messages import named_key
from pymc_features.update.config.sections import ERRORS
from pymc_features.update.kinds.base import KindOfData, Setting
from pymc_features.update.kinds.channels import Measured
from pymc_features.update.kinds.model import thinned
from pymc_features.update.presentation.components import components_of_draws
from pymc_features.update.presentation.shown import Figure

QUANTILES = (0.05, 0.5, 0.95)
DRAWS = 200
ZOOM = 4.0  # [s] around the strongest motion
LONG = (
    "A record of more samples than the figure has pixels is drawn by its smallest and largest values: as a "
    "grey area what was measured, by two lines a response that oscillates too fast for one."
)


@dataclass(frozen=True)
class Histories(KindOfData):
    """Histories (sensor, time) under a known excitation.

    Attributes
    ----------
    config : Config
        The configuration file.
    measured : Measured
        Excitation and histories.
    dofs : list of int
        Degree of freedom of each sensor.
    """

    config: Any
    measured: Measured
    dofs: list[int]

    n_predicted: ClassVar[int] = DRAWS

    @classmethod
    def measure(cls, given: Setting) -> Measured:
        """Read and check what the sections name."""
        raise NotImplementedError

    @classmethod
    def read(cls, given: Setting):
        """What the section names, with errors that fit it."""
        measured, dofs = cls.measure(given), [0]
        check_errors(given.config, given.priors, len(dofs))
        return cls(given.config, measured, dofs)

    @property
    def likelihoods(self):
        """Take the likelihoods of the file."""
        return self.config.likelihood.kinds

    @property
    def quantity(self) -> str:
        """The quantity of the response that is compared."""
        return self.config.data.quantity

    @property
    def channels(self) -> xr.DataArray:
        """What is compared (sensor, time)."""
        return self.measured.channels

    @property
    def left_out(self):
        """Which part of each sensor is left out as a gap."""
        return self.measured.left_out

    def parameters(self, likelihood):
        """Return the parameters of the errors."""
        return [value for _, value in self.config.likelihood.parameters_of(likelihood)]

    def prints(self):
        """Return fingerprints of the excitation and the histories."""
        return prints_of(self.measured)

    def foretold(self, problem, measured=None) -> list[str]:
        """What likelihoods that count sensors cannot tell, before anything is sampled."""
        n_unknown, m = len(problem.structure.names), self.config.likelihood.m
        advice = "" if measured else " CAL counts what the residuals support."
        found = []
        for kind in self.likelihoods:
            claimed = [LIKELIHOODS[kind].claimed(one.samples, m) for one in measured or [self.measured]]
            if None not in claimed and sum(claimed) < 2 * n_unknown:
                found.append(
                    f"{kind} counts {sum(claimed):.0f} observations for {n_unknown} unknown parameters of "
                    f"the structure: expect a posterior that is not much narrower than the prior.{advice}"
                )
        return found

    def tolerance(self, parts) -> float:
        """delta of ABC: as the configuration says, or Eq. (16) with the posterior of EXP."""
        likelihood, n_sensors = self.config.likelihood, len(self.dofs)
        if likelihood.epsilon is not None:
            return likelihood.epsilon
        if not isinstance(likelihood.sigma, Parameter):
            return abc_tolerance(likelihood.sigma, n_sensors)
        sigma = likelihood.sigma.times * parts["EXP"]["posterior"][likelihood.sigma.prior]
        return abc_tolerance(sigma, n_sensors)

    def request(self, problem):
        """The request of the model's response, with the refinement that its priors need, and its outputs."""
        record = self.measured.record
        with pm.Model():
            values = {name: problem.priors[name].declare(name) for name in problem.structure.names}
            structure = problem.structure(**values)
            asked, outputs = self.as_recorded(problem, structure)
            return request_in_model(structure, record, asked), outputs

    def as_recorded(self, problem, structure):
        """The request of a structure's response to the record as it is, and its outputs."""
        return checked_request(
            structure,
            self.measured.record,
            self.quantity,
            dt=self.measured.step,
            sensors=self.dofs,
            n_modes=problem.structure.n_modes,
        )

    def response(self, problem, structure):
        """The response (sensor, time) of a structure to the excitation, in the model of the context."""
        with named_key("structure"):
            return response(
                structure,
                self.measured.record,
                dt=self.measured.step,
                sensors=self.dofs,
                quantity=self.quantity,
                n_modes=problem.structure.n_modes,
            )

    def declare(self, problem, likelihood, structure, values, tolerance):
        """Add the measured responses to the model of the context."""
        measured, asked = self.measured, self.config.likelihood
        observed = measured.channels
        pm.modelcontext(None).add_coords({dim: observed[dim].values for dim in DIMS})
        mu = self.response(problem, structure)
        errors = {
            name: pt.as_tensor_variable(evaluated(value, values))
            for name, value in asked.parameters_of(likelihood)
        }
        if self.config.processing.compare is not None:
            mu = mu[:, measured.compared]
            errors["dt"] = pt.constant(measured.step)  # which likelihoods no longer see
        given = Comparison(mu, observed.values, epsilon=tolerance, density=asked.density, **errors)
        LIKELIHOODS[likelihood].declare(given)

    def predict(self, problem, likelihood, model, idata):
        """The histories, and bands of the response."""
        channels = self.channels.drop_attrs().assign_attrs(units=self.measured.units)
        return {
            "observed_data": xr.Dataset({"y": channels}),
            "bands": self.bands(problem, likelihood, model, idata),
        }

    def drawn_of(self, problem, part):
        """Responses of draws by their principal components."""
        return {"histories": components_of_draws(self, problem, part)}

    def figures_of(self, problem, part, kind):
        """What was measured with the bands, all of it and its strongest part."""
        shades = "Dark: 5-95 % of the response, from the uncertainty of the parameters. "
        if "predictive" in part["bands"]:
            shades += "Light: 5-95 % of data drawn from the likelihood, where measured samples should lie."
        return [
            Figure(
                f"{kind}_response",
                f"{kind}: measured response and posterior predictive bands. {shades} {LONG}",
                lambda: plots.plot_predictive(part),
            ),
            Figure(
                f"{kind}_response_zoom",
                f"{kind}: the same, {ZOOM:g} s around the strongest motion.",
                lambda: plots.plot_predictive(part, window=strongest(part)),
            ),
        ]

    def bands(self, problem, likelihood, model, idata) -> xr.Dataset:
        """Bands of the response and of data like those measured, at the sensors.

        Returns
        -------
        Dataset
            `response` (quantile, sensor, time), of the parameters' uncertainty alone; `predictive`, the same
            of draws of the likelihood, errors included (ABC has none); `normalised_error` (sensor), rms of
            measured less median response over rms measured; `coverage` (sensor), share of the samples in the
            predictive band, both without the gaps in what was measured; `coarseness` (sensor), see
            `coarse_sampling`. Peaks of other responses
            (`<quantity>_peak`) if the report asks for them.
        """
        observed = self.channels
        coords = {"quantile": list(QUANTILES), "sensor": observed["sensor"], "time": observed["time"]}
        dims = ("quantile", "sensor", "time")
        quantiles = self.response_quantiles(problem, model, idata)
        found = xr.Dataset({"response": (dims, quantiles)}, coords=coords)
        off = observed - found["response"].sel(quantile=0.5, drop=True)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a channel of zeros
            found["normalised_error"] = np.sqrt((off**2).mean("time") / (observed**2).mean("time"))
        if not LIKELIHOODS[likelihood].is_likelihood_free:
            found["predictive"] = dims, predictive(model, idata, self.n_predicted)
            low, high = found["predictive"].isel(quantile=0), found["predictive"].isel(quantile=-1)
            inside = ((observed >= low) & (observed <= high)).where(observed.notnull())
            found["coverage"] = inside.mean("time")
        return found if not problem.config.report.quantities else found.assign(self.peaks(problem, idata))

    def settings(self, problem) -> dict:
        """How responses of draws are predicted."""
        common = {"draws": self.n_predicted, "quantiles": QUANTILES, "random_seed": 0}
        return common | {"dt": self.measured.step, "n_modes": problem.structure.n_modes}

    def response_quantiles(self, problem, model, idata) -> np.ndarray:
        """Quantiles (quantile, sensor, time) of the responses of draws where they are compared."""
        motion, settings = self.measured.record, self.settings(problem)
        found = posterior_response(
            idata, problem.structure, motion, self.quantity, sensors=self.dofs, **settings
        )
        return found[self.quantity].values[..., self.measured.compared]

    def peaks(self, problem, idata) -> dict[str, xr.DataArray]:
        """Quantiles of the peaks of the quantities that the report asks for."""
        names, found = problem.config.report.quantities, {}
        settings = self.settings(problem)
        rest = posterior_response(idata, problem.structure, self.measured.record, names, **settings)
        for name in names:
            peak = rest[f"{name}_peak"]
            rows = {dim: f"{name}_{dim}" for dim in peak.dims if dim != "sample"}
            kept = peak.rename(rows).quantile(QUANTILES, dim="sample", keep_attrs=True)
            found[f"{name}_peak"] = kept.drop_vars([c for c in kept.coords if c not in kept.dims])
        return found


def strongest(part) -> tuple[float, float]:
    """A window [s] around the largest measured acceleration."""
    observed = part["observed_data"]["y"]
    peak = float(observed["time"][int(np.abs(np.nan_to_num(observed.values)).max(axis=0).argmax())])
    last = float(observed["time"][-1])
    first = max(0.0, min(peak - 0.4 * ZOOM, last - ZOOM))
    return first, min(last, first + ZOOM)


def predictive(model, idata, draws: int) -> np.ndarray:
    """Quantiles (quantile, sensor, time) of draws of the data."""
    posterior = thinned(idata["posterior"].to_dataset(), draws)
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


def prints_of(measured: Measured) -> dict[str, str]:
    """What measured responses are recognised by."""
    return {
        "base_sha256": fingerprint(measured.record.inputs[0]),
        "base_interpolation": measured.record.interpolation,
        "channels_sha256": fingerprint(np.ascontiguousarray(measured.channels.values)),
    }


def check_gaps(config, measured) -> None:
    """Likelihoods that compare neighbouring samples take no gaps."""
    whole = [kind for kind in config.likelihood.kinds if not LIKELIHOODS[kind].takes_gaps]
    if whole and measured.left_out:
        raise ConfigError(
            f"`likelihood.kinds` must not have {whole[0]} where samples are missing, got gaps of "
            f"{measured.left_out}: it compares neighbouring samples. Compare a part "
            "without gaps by `processing.compare`, leave out the sensor, or take "
            f"{', '.join(kind for kind, entry in LIKELIHOODS.items() if entry.takes_gaps)}."
        )


def check_errors(config, priors, n_sensors: int) -> None:
    """One positive value, or one for each sensor; the sigma that ABC takes from EXP must be one."""
    likelihood = config.likelihood
    for name, unit in ERRORS.items():
        given = getattr(likelihood, name)
        if isinstance(given, list) and len(given) != n_sensors:
            raise ConfigError(
                f"`likelihood.{name}` must be one value or one for each of the {n_sensors} sensors, got "
                f"{len(given)}."
            )
        for value in given if isinstance(given, list) else [given]:
            if isinstance(value, float) and value <= 0.0:
                advice = f"Pass it in {unit}." if unit != "-" else "1 is that of TN, 2 that of EXP."
                raise ConfigError(f"`likelihood.{name}` must be positive, got {value:g}. {advice}")
            if isinstance(value, Parameter) and (middle := priors[value.prior].median) <= 0.0:
                raise ConfigError(
                    f"`likelihood.{name}` must be positive, got the prior `priors.{value.prior}` with the "
                    f"median {middle:g}. Take a distribution of positive numbers."
                )
    if "ABC" in likelihood.kinds and config.processing.compare is not None:
        raise ConfigError(
            "`likelihood.kinds` must not have ABC with `processing.compare`, for it compares whole "
            "responses. Leave one of them out."
        )
    if "ABC" in likelihood.kinds and likelihood.epsilon is None and isinstance(likelihood.sigma, list):
        raise ConfigError(
            "`likelihood.epsilon` must be given for ABC where each sensor has its own sigma, got none."
        )
