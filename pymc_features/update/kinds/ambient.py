"""Response to forces that nobody measured: [ambient], its bands, and what models make of them."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import pymc as pm
import xarray as xr
from pydantic import Field, model_validator

from pymc_features import plots
from pymc_features.ambient import AmbientResponse, identify_modes, propose_bands, spectral_response, subspace
from pymc_features.ambient.bands import checked_bands
from pymc_features.ambient.fit import fitted_spectra
from pymc_features.exceptions import AmbientWarning, ConfigError
from pymc_features.likelihoods import DIMS, Likelihood
from pymc_features.records import Record
from pymc_features.signals.spectra import averaged_spectra
from pymc_features.structures import Structure
from pymc_features.update.config.entries import Vector
from pymc_features.update.config.keys import demand, named_key, shown
from pymc_features.update.config.sections import Section, Window, key
from pymc_features.update.kinds import base, modal
from pymc_features.update.kinds.base import KindOfData, Verdict
from pymc_features.update.kinds.channels import checked_dofs, read_whole

AMBIENT = Likelihood(
    "AMBIENT",
    "Fourier transforms of the channels complex Gaussian, forces and errors white in each band",
    "C8",
    takes=(),
)
Windows = Annotated[list[Window], Field(min_length=1)]
DENSITY = "the name of a prior or a positive number in {}, one or one for each band"
UNITS = {"dofs": "N^2/Hz", "modes": "N^2/kg/Hz"}  # of the forces
ERROR = "m^2/s^3"  # (m/s^2)^2/Hz
PASSED = 0.4  # of the sampling rate: what decimation leaves as it was
PARTNER = {"sigma_f": 0.01, "sigma_phi": 0.05}  # by which modes of the model are matched
DRAWS = 50
CERTAIN = 6.0  # standard deviations of a part of a band off
MUCH = 1.5  # factor of the power that is worth a word
GOT = 'with `data.excitation = "ambient"`, got it.'
LEFT_OUT = {  # keys that mean nothing here, and why
    "record likelihood events modal": f"{GOT} The spectra of the channels are compared, as [ambient] says.",
    "data.gaps": f"{GOT} Take a part of the record without gaps.",
    "processing.band_pass": f"{GOT} Choose by `ambient.bands` which frequencies are compared.",
    "processing.compare": f"{GOT} Choose by `processing.trim` what is compared.",
    "processing.check_band": f"{GOT} Channels are checked against a base.",
    "report.natural_frequencies": f"{GOT} Those of the channels are identified and shown.",
    "report.quantities": f"{GOT} No response is predicted.",
}


class AmbientSection(Section):
    """Spectral densities of forces and errors, and the frequencies that are compared."""

    bands: Literal["auto"] | Windows = key('"auto" or a list of rising pairs [from, to] in Hz', "auto")
    force: Vector = key(DENSITY.format("N^2/Hz"))
    error: Vector = key(DENSITY.format("(m/s^2)^2/Hz"))
    forces: Literal["dofs", "modes"] = key('"dofs" or "modes", where they act', "dofs")
    excitation: Literal["unknown", "base"] = key('"unknown" or "base", that moves besides', "unknown")

    @model_validator(mode="after")
    def one_for_each_band(self):
        for name in ("force", "error"):
            if isinstance(getattr(self, name), list) and self.bands == "auto":
                raise ValueError(f'must list `bands` where `{name}` is a list, got "auto"')
        return self

    def parameters(self, key, config=None):
        yield f"{key}.force", UNITS[self.forces], self.force
        yield f"{key}.error", ERROR, self.error


@dataclass(frozen=True)
class Ambient(KindOfData):
    """Accelerations under forces that nobody measured."""

    config: Any  # the configuration file
    channels: xr.DataArray  # (sensor, time) measured accelerations [m/s^2] at `step`
    step: float  # sampling interval [s]
    bands: np.ndarray  # (band, 2) Frequencies that are compared [Hz]
    source: str  # where the channels come from
    dofs: list[int]  # degree of freedom of each sensor
    structure: Structure  # what the priors expect
    base: xr.DataArray | None = None  # (1, time) its known motion [m/s^2]

    key, section, refused = "ambient", AmbientSection, LEFT_OUT
    own, likelihoods = (AMBIENT,), [AMBIENT.name]
    is_checked = False  # but by the modes beside

    @classmethod
    def is_asked(cls, config):
        is_program = config.external is not None
        return config.data is not None and config.data.excitation == "ambient" and not is_program

    @classmethod
    def check_sections(cls, config):
        if config.ambient is None:
            raise ConfigError(
                '`ambient` must be given with `data.excitation = "ambient"`: a table with `force` and '
                "`error`, the spectral densities of forces and errors."
            )
        if (config.ambient.excitation == "base") != (config.data.base is not None):
            raise ConfigError(
                '`data.base` must name the sensor on the base with `ambient.excitation = "base"`, and be '
                f"left out without it, got {shown(config.data.base)}."
            )
        super().check_sections(config)

    @classmethod
    def read(cls, problem):
        config, asked = problem.config, problem.config.ambient
        dofs = checked_dofs(config, problem.expected.n_dof)
        n_bands = None if asked.bands == "auto" else len(asked.bands)
        for name in ("force", "error"):
            base.check_positive(f"ambient.{name}", getattr(asked, name), problem.priors, n_bands, "bands")
        channels, step, source = read_whole(config, problem.folder)
        base_motion = None
        if asked.excitation == "base":
            base_motion, channels = channels.isel(sensor=[0]), channels.isel(sensor=slice(1, None))
        with named_key("ambient.bands"):
            bands = propose_bands(channels) if asked.bands == "auto" else asked.bands
            bands = checked_bands(bands, channels.sizes["time"], step, 0).limits
        if config.processing.decimate > 1 and bands.max() > PASSED / step:
            raise ConfigError(
                f"`ambient.bands` must end below {PASSED / step:.4g} Hz after `processing.decimate`, got "
                f"{bands.max():.4g} Hz: decimation weakens what is above. Decimate less."
            )
        return cls(config, channels, step, bands, source, dofs, problem.expected, base_motion)

    @cached_property
    def beside(self):
        """Modes identified in the bands, when they are first asked for: that takes seconds.

        There are none, and an AmbientWarning, if no band has one, or they are more than the structure has.
        """
        most = modal.most_modes(self.structure)
        try:
            with named_key("ambient.bands"):
                data = identify_modes(self.channels, self.bands, excitation=self.base)
            demand(
                (n := len(data)) <= most,
                f"The channels have {n} modes in the bands, more than the structure: it cannot explain all "
                "of them. Choose `ambient.bands` around those that it has.",
            )
        except ConfigError as error:
            warnings.warn(f"There are no modes to compare with. {error}", AmbientWarning, stacklevel=2)
            return ()
        dofs, partner = self.dofs, PARTNER
        if len(dofs) < 2:  # a shape of one entry says nothing
            data, dofs, partner = replace(data, **modal.WITHOUT_SHAPES), [], {"sigma_f": PARTNER["sigma_f"]}
        section, numbers = modal.ModalSection(file="", shapes=bool(dofs), **partner), list(range(1, n + 1))
        source, n_modes = "the spectra in the bands", min(most, n + modal.SPARE)
        found = modal.Modal(section, data, dofs, source, n_modes, numbers, numbers, is_fitted=False)
        return (found,)

    @property
    def duration(self) -> float:
        return self.step * self.channels.sizes["time"]

    @property
    def used(self):
        return f"{len(self.dofs)} channels of ambient vibration over {self.duration:.4g} s"

    @property
    def band(self):
        return float(self.bands.min()), float(self.bands.max())

    @property
    def placed(self):
        return dict(zip(self.config.data.sensors, self.dofs, strict=True))

    def prints(self):
        known = None if self.base is None else self.base.values
        return base.printed({"channels": self.channels.values, "bands": self.bands, "base": known})

    def parameters(self, likelihood):
        return {"force": self.config.ambient.force, "error": self.config.ambient.error}

    def declare(self, problem, likelihood, structure, values, tolerance):
        asked = self.config.ambient
        pm.modelcontext(None).add_coords({dim: self.channels[dim].values for dim in DIMS})
        force, error = self.variables(likelihood, values).values()
        settings = {"forces": asked.forces, "sensors": self.dofs, "n_modes": problem.structure.n_modes}
        measured = {"bands": self.bands, "dt": self.step, "observed": self.channels.values}
        if self.base is not None:
            measured["excitation"] = Record(self.base.values[0], self.step)
        with named_key("ambient", excitation="ambient.force", error="ambient.error"):
            spectra = spectral_response(structure, force, **settings)
            AmbientResponse("y", spectra, error=error, dims=DIMS, **measured)

    def predict(self, problem, likelihood, model, idata):
        draws = base.thinned(idata["posterior"].to_dataset(), DRAWS)
        return {"spectra": fitted_spectra(self.channels, self.bands, model, draws)}

    def shared(self, problem):
        """Averages of the spectra of the channels over twenty parts: singular values."""
        spectra = averaged_spectra(self.channels.values, self.step)
        values = (("value", "frequency"), spectra.singular_values[1:].T, {"units": "(m/s^2)^2/Hz"})
        parts = {"singular_value": values, "band": (("band", "end"), np.asarray(self.bands))}
        return {"singular_values": xr.Dataset(parts, {"frequency": spectra.frequencies[1:]})}

    def draw(self, fitted=None):
        """Figure of the singular values, perhaps with those of the fitted model."""
        identified = self.beside[0].data.frequencies if self.beside else None
        seen = self.channels if fitted is None else fitted.get("residual", self.channels)
        return plots.singular_values(seen, self.bands, frequencies=identified, fitted=fitted)

    def told(self):
        yield f"data: {self.source}, {self.duration:.4g} s at {self.step:.4g} s"

    def check(self, problem, path):
        wrote = base.drawn_to(path, self.draw)
        yield f"bands = [{', '.join(f'[{low:.4g}, {high:.4g}]' for low, high in self.bands)}]  # Hz"
        if self.beside and subspace.is_installed():
            yield from subspace.opinion_on(self.beside[0].data, self.channels, self.base)
        yield wrote

    def tables(self, problem, result):
        bands = ", ".join(f"{low:.4g} to {high:.4g} Hz" for low, high in self.bands)
        how = ", proposed from the peaks of the spectra" if self.config.ambient.bands == "auto" else ""
        forces = "Nobody measured the forces" if self.base is None else "Forces act beside the known base"
        more = f". {forces}. Compared are the frequencies {bands}{how}."
        return [base.channels_table(self, more)]

    def figures_of(self, problem, part, kind):
        return {"spectra": lambda: self.draw(part["spectra"].to_dataset())}

    def verdict(self, problem, result, kind):
        return verdict_of_power(result[f"{kind}/spectra"].to_dataset())


def verdict_of_power(fitted) -> Verdict:
    """Judge the power in each part of the bands, see `fitted_spectra`."""
    ratio, sd = fitted["ratio"].values, fitted["sd"].values
    more = (ratio > MUCH) & (ratio - 1.0 > CERTAIN * sd)
    less = (ratio < 1.0 / MUCH) & (1.0 - ratio > CERTAIN * sd)
    ends = zip(fitted["low"].values, fitted["high"].values, strict=True)
    places, n = [f"{low:.4g} to {high:.4g} Hz" for low, high in ends], len(ratio)
    wrong = (more | less).sum()
    if not wrong:
        where = f"all {n} parts of the bands" if n > 1 else "its band"
        return Verdict([f"The power of the channels is what the model expects in {where}."], True)
    told = [f"The power of the channels is not what the model expects in {wrong} of {n} parts of the bands."]
    if more.any():
        worst = int(np.argmax(np.where(more, ratio, 0.0)))
        told.append(
            f"The channels have up to {ratio[worst]:.2g} times the power that it expects, most at "
            f"{places[worst]}: a mode, a direction or a machine may be missing, or a force that is not white."
        )
    if less.any():
        worst = int(np.argmin(np.where(less, ratio, np.inf)))
        told.append(
            f"They have down to {ratio[worst]:.2g} of the power that it expects, most at {places[worst]}: "
            "forces or errors may differ from band to band. Give them a value for each."
        )
    return Verdict(told, False)
