"""Frequency response functions: the section [frequency_response], and what a model makes of their modes."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from pymc_features import plots
from pymc_features.exceptions import PriorWarning
from pymc_features.io import read_frequency_response
from pymc_features.likelihoods import Likelihood
from pymc_features.modal.frequency_response import FrequencyResponse, MeasuredModes, measured_modes, placed
from pymc_features.modal.transfer import unit_responses
from pymc_features.update.config.entries import Vector, evaluated, priors_in
from pymc_features.update.config.keys import demand, named_key
from pymc_features.update.config.sections import Section, Window, key
from pymc_features.update.kinds import base
from pymc_features.update.kinds.base import QUANTILES, KindOfData, Verdict, kinds_of, table
from pymc_features.update.plausibility.findings import of_modes

FRF = Likelihood("FRF", "modes of response functions, each with one error of the model", "C8", takes=())
DRAWS, LINES = 200, 600  # of a posterior, and of the lines, that are predicted
FAR = 3.0  # standard deviations of a mode that the model does not have
LOW = 0.8  # coherence that is worth a word
PLACES = "a table of labels in the files to degrees of freedom, 0 next to the base"
ERROR = "the name of a prior or a number, the error of the model"
COLUMNS = "mode", "measured [Hz]", "5 %", "50 %", "95 %", "damping [%]", "5-95 %"


class FrequencyResponseSection(Section):
    """Files, places of sensors and forces, and how well the model is to meet the modes."""

    files: str | list[str] = key("a file with frequency response functions, or a list of files")
    units: str | None = key("the unit of all functions, such as (m/s^2)/N, where files do not say", None)
    response: str | None = key("the label of the response, where files do not say", None)
    reference: str | list[str] | None = key("the label of each file's reference, if it does not say", None)
    responses: dict[str, int] | None = key(f"{PLACES}, of sensors", None, min_length=1)
    references: dict[str, int] | None = key(f"{PLACES}, of forces", None, min_length=1)
    band: Window | None = key("two frequencies in Hz, of the lines that are compared", None)
    n_modes: int | None = key("the number of modes of the structure to choose from, positive", None, ge=1)
    sigma_f: Vector = key(f"{ERROR} in ln f", unit="-")
    sigma_zeta: Vector = key(f"{ERROR} in ln zeta", unit="-")
    sigma_phi: Vector = key(f"{ERROR} of shapes, relative", unit="-")


@dataclass(frozen=True)
class FrequencyResponses(KindOfData):
    """Functions with the modes that they show, and where their sensors and forces are."""

    asked: FrequencyResponseSection
    measured: MeasuredModes
    dofs: list[int]  # of responses
    points: list[int] | None  # of references; None under a motion of the base
    source: str

    key, section = "frequency_response", FrequencyResponseSection
    own, likelihoods = (FRF,), [FRF.name]
    refused = {"data record processing likelihood": "with [frequency_response], got it. It needs none."}

    @classmethod
    def read(cls, problem):
        asked, n = problem.config.frequency_response, problem.expected.n_dof
        files = [asked.files] if isinstance(asked.files, str) else asked.files
        for at, _, value in asked.parameters(cls.key):
            base.check_positive(at, value, problem.priors)
        with named_key("frequency_response"):
            stated = asked.model_dump(include={"units", "response", "reference"}, exclude_none=True)
            data = read_frequency_response([problem.folder / file for file in files], **stated)
            if asked.band is not None:
                data = data.sel(frequency=slice(*asked.band))
            measured = measured_modes(data.sel(frequency=data["frequency"] > 0.0))
        places = []
        for role in ("response", "reference"):
            given, labels = getattr(asked, f"{role}s"), [str(label) for label in data[role].values]
            if role == "reference" and data.attrs["excitation"] == "base":
                places.append(None)
                continue
            missing = ", ".join(
                label for label in labels if label not in (labels if given is None else given)
            )
            demand(not missing, f"`{cls.key}.{role}s` must have every label, got none of {missing}.")
            with named_key("frequency_response"):
                dofs = None if given is None else [given[label] for label in labels]
                places.append(placed(problem.expected, labels, dofs, f"{role}s")[0])
            what = f"`{cls.key}.{role}s` must be degrees of freedom from 0 to {n - 1}."
            demand(max(places[-1]) < n, what)
        f = measured.fit.modes.frequencies
        for sentence in of_modes(f, problem.prior):
            warnings.warn(sentence, PriorWarning, stacklevel=2)
        return cls(asked, measured, *places, ", ".join(Path(file).name for file in files))

    def prints(self):
        names = {"frequency_response_frequency": "frequency", "frequency_response_response": self.key}
        return base.printed({name: self.measured.data[of].values for name, of in names.items()})

    @property
    def used(self):
        n, k = len(self.measured.fit.modes.natural), self.measured.data["frequency_response"][..., 0].size
        return f"{n} modes in {k} frequency response functions"

    @property
    def band(self):
        return tuple(self.measured.data["frequency"].values[[0, -1]])

    @property
    def placed(self):
        return dict(zip(self.measured.data["response"].values.tolist(), self.dofs, strict=True))

    def declare(self, problem, likelihood, structure, values, tolerance):
        given = self.variables(likelihood, values)
        if self.asked.responses is not None:  # else in the sense that labels say
            given |= {"responses": self.dofs, "references": self.points}
        with named_key("frequency_response"):
            FrequencyResponse(
                self.key, structure, observed=self.measured, n_modes=self.asked.n_modes, **given
            )

    def predict(self, problem, likelihood, model, idata):
        """Quantiles of the model's functions at some lines, and of its modes next to the measured ones."""
        posterior, data = base.thinned(idata["posterior"].to_dataset(), DRAWS), self.measured.data
        every = max(1, data.sizes["frequency"] // LINES)
        lines = self.measured.lines._replace(frequencies=data["frequency"].values[::every])
        natural = self.measured.fit.modes.frequencies
        sizes, nearest = [], []
        for _, found in base.modes_of_draws(problem, posterior, self.asked.n_modes):
            f, zeta, shapes = found.natural_frequencies, found.damping_ratios, found.mode_shapes
            g = unit_responses(2.0 * np.pi * f, zeta, lines)
            if self.points is not None:
                sizes.append(np.abs(np.einsum("am,rm,mk->ark", shapes[self.dofs], shapes[self.points], g)))
            at = np.abs(np.log(natural[:, None] / f)).argmin(axis=1)
            nearest.append([f[at], zeta[at]])
        q = ["quantile"]
        modes = np.quantile(nearest, QUANTILES, axis=0)
        parts = {
            "natural_frequency": ([*q, "mode"], modes[:, 0], {"units": "Hz"}),
            "damping_ratio": ([*q, "mode"], modes[:, 1]),
        }
        coords = {"quantile": list(QUANTILES), "mode": 1 + np.arange(len(natural))}
        if sizes:
            dims = "response", "reference", "frequency"
            parts["size"] = ([*q, *dims], np.quantile(sizes, QUANTILES, axis=0))
            parts["measured"] = (dims, np.abs(data["frequency_response"].values[..., ::every]))
            coords |= {dim: data[dim].values for dim in dims[:2]} | {"frequency": lines.frequencies}
        return {"functions": xr.Dataset(parts, coords, {"units": data.attrs["units"]})}

    def shared(self, problem):
        """The modes that were measured, with standard deviations of ln f and ln zeta."""
        modes, sd = self.measured.fit.modes, self.measured.fit.deviations
        found = {"frequency": modes.frequencies, "damping_ratio": modes.ratios}
        found |= {"ln_frequency_sd": sd[:, 0], "ln_damping_sd": sd[:, 1]}
        parts = {name: ("mode", values) for name, values in found.items()}
        return {
            "measured_modes": xr.Dataset(parts, {"mode": 1 + np.arange(len(sd))}, {"source": self.source})
        }

    def told(self):
        data, (low, high) = self.measured.data, self.band
        yield f"response functions: {self.used} from {self.source}, {low:.4g} to {high:.4g} Hz"
        if "coherence" in data:
            weak = data["coherence"].mean("frequency")
            for label in weak["response"].values[(weak < LOW).any("reference").values]:
                yield f"The coherence of {label} is below {LOW:g} on average: noise, or forces not measured."

    def tables(self, problem, result):
        modes = self.measured.fit.modes
        rows = []
        for kind in kinds_of(result):
            found = result[f"{kind}/functions"].to_dataset()
            for i, (measured, zeta) in enumerate(zip(modes.frequencies, modes.ratios, strict=True)):
                f, z = (found[name].values[:, i] for name in ("natural_frequency", "damping_ratio"))
                ends = f"{100.0 * z[0]:.3g}-{100.0 * z[2]:.3g}"
                cells = (f"{x:.5g}" for x in (measured, *f))
                rows.append((kind, i + 1, *cells, f"{100.0 * zeta:.3g}", ends))
        note = f"There are {self.used} from {self.source}. Damping as measured, and 5 to 95 % of the model."
        columns = "likelihood", *COLUMNS
        return [table("response_functions", "modes", "Modes of response functions", columns, rows, note)]

    def figures_of(self, problem, part, kind):
        found = part["functions"].to_dataset()
        return {"response_functions": lambda: plots.response_functions(found)} if "size" in found else {}

    def verdict(self, problem, result, kind):
        found, posterior = result[f"{kind}/functions"].to_dataset(), result[f"{kind}/posterior"].to_dataset()
        modes, sd = self.measured.fit.modes, self.measured.fit.deviations
        medians = posterior[[item.prior for item in priors_in(self.asked.sigma_f)]].median()
        sigma = float(evaluated(self.asked.sigma_f, {name: float(medians[name]) for name in medians}))
        middle = found["natural_frequency"].sel(quantile=0.5).values
        off = np.log(modes.frequencies / middle)
        z = np.abs(off) / np.hypot(sigma, sd[:, 0])
        worst = int(z.argmax())
        said = "The model has" if z[worst] < FAR else "The model does not have"
        told = [
            f"{said} the {len(z)} modes of the response functions: frequencies are off by at most "
            f"{100.0 * np.abs(off).max():.2g} %, {z[worst]:.2g} standard deviations (mode {worst + 1})."
        ]
        return Verdict(told, bool(z[worst] < FAR))
