"""Cyclic tests: the section [cyclic], displacement and force, and whether a specimen explains them."""

import warnings
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import xarray as xr
from pydantic import PlainValidator

from pymc_features import plots
from pymc_features._checks import is_number
from pymc_features.exceptions import ConfigError, PredictionWarning
from pymc_features.io import read_cyclic_test
from pymc_features.io.reading.labels import FORCES, LENGTHS
from pymc_features.prediction import posterior_response
from pymc_features.update.config.messages import named_key, shown
from pymc_features.update.config.sections import Section, key
from pymc_features.update.config.structure_sections import SPECIMENS
from pymc_features.update.kinds.base import Setting
from pymc_features.update.kinds.channels import Measured
from pymc_features.update.kinds.checks import Checked
from pymc_features.update.kinds.histories import DRAWS, Histories
from pymc_features.update.presentation.shown import Figure, Verdict, table, write_figure

LENGTH_OR_FORCE = f"two units, of displacement ({', '.join(LENGTHS)}) and of force ({', '.join(FORCES)})"
UNEXPLAINED = 0.35  # rms error over measured rms: more is no explanation
ROUGH = 0.1  # the same, worth a word where the error persists from sample to sample
PERSISTS = 0.5  # correlation of the error with that of the sample before
ENERGY = 0.1  # relative error of the dissipated energy that is worth a word


def pair_of(accepts, words):
    """A list of two values, for displacement and force."""

    def pair(value):
        if not (isinstance(value, list) and len(value) == 2 and all(map(accepts, value))):
            raise ValueError(f"must be {words}, got {shown(value)}")
        return value

    return Annotated[Any, PlainValidator(pair)]


class CyclicSection(Section):
    """A table with both, or one of each."""

    files: str | list[str] = key("a file, or a list of two, of the displacement and of the force")
    columns: (
        pair_of(lambda v: type(v) in (int, str), "two columns, by index from 0 or header name") | None
    ) = key("two columns, of displacement and force, by index from 0 or header name", None)
    units: pair_of(lambda v: isinstance(v, str) or is_number(v), LENGTH_OR_FORCE) | None = key(
        f"{LENGTH_OR_FORCE}, or m and N per file unit", None
    )
    skip: int = key("the number of rows to leave out at the start, not negative", 0, ge=0)
    wrapped: bool | None = key("true if one series runs along the lines, else false", None)


class Cyclic(Histories):
    """Displacement and force of a cyclic test, which stand for motion of the base and responses."""

    key, section = "cyclic", CyclicSection
    quantity = "restoring_force"
    is_checked = False

    @classmethod
    def check_sections(cls, config):
        """A specimen and a cyclic test belong together, and other sections say nothing besides."""
        if config.structure.type not in SPECIMENS:
            raise ConfigError(
                f"`structure.type` must be {' or '.join(SPECIMENS)} with [cyclic], got "
                f"{config.structure.type}. Its displacement is prescribed."
            )
        for name in ("data", "record", "processing", "events", "modal", "ambient"):
            if name in config.model_fields_set:
                raise ConfigError(
                    f"`{name}` must be left out with [cyclic], got it. Displacement and force are all "
                    "there is."
                )
        for name in ("natural_frequencies", "quantities"):
            if name in config.report.model_fields_set:
                raise ConfigError(
                    f"`report.{name}` must be left out with [cyclic], got it. There is no motion."
                )
        if config.likelihood is None:
            raise ConfigError("`likelihood` must be given with [cyclic]: a table.")

    @classmethod
    def measure(cls, given: Setting) -> Measured:
        """Read displacement and force; files are relative to the folder."""
        config, folder = given.config, given.folder
        asked = config.cyclic
        names = [asked.files] if isinstance(asked.files, str) else asked.files
        paths = [folder / name for name in names]
        with named_key("cyclic"):
            test, force = read_cyclic_test(
                paths[0] if isinstance(asked.files, str) else paths,
                columns=asked.columns,
                units=asked.units,
                skip=asked.skip,
                wrapped=asked.wrapped,
            )
        source = ", ".join(Path(name).name for name in names)
        return Measured(test, force, test.dt, source, Checked(None, "not checked: there is one"))

    @property
    def used(self):
        """How many forces."""
        return f"{self.measured.record.n_times} measured forces of a cyclic test"

    def bands(self, problem, likelihood, model, idata):
        """Add the displacement beside the time."""
        found = super().bands(problem, likelihood, model, idata)
        return found.assign_coords(displacement=("time", self.measured.record.displacement))

    def shared(self, problem, parts):
        """Displacement and force."""
        measured = self.measured
        displacement = ("time", measured.record.displacement, {"units": "m"})
        channels = measured.channels.drop_attrs().assign_attrs(units="N")
        attrs = {"source": measured.source}
        return {"data": xr.Dataset({"measured": channels}, {"displacement": displacement}, attrs)}

    def told(self):
        """The files, and the test."""
        yield f"data: {self.measured.source}; {self.measured.record}"

    def check(self, problem, path):
        """Draw measured loops and what the priors expect of them; how much of it they hold."""
        priors, names = problem.priors, problem.structure.names
        columns = {n: (("chain", "draw"), priors[n].draw(DRAWS, k)[None]) for k, n in enumerate(names)}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PredictionWarning)  # priors may reach beyond what a specimen is
            found = posterior_response(
                xr.Dataset(columns), problem.structure, self.measured.record, self.quantity, draws=DRAWS
            )
        force = self.measured.channels
        write_figure(plots.plot_loops(found, measured=force), path)
        low, *_, high = found[self.quantity].transpose("quantile", "sensor", "time").values
        share = float(np.mean((force.values >= low) & (force.values <= high)))
        yield f"{100.0 * share:.0f} % of the measured forces lie within what the priors expect (5 to 95 %)"
        yield f"wrote {path}"

    def tables(self, problem):
        """Say where displacement and force come from, and how large they are."""
        displacement, force = self.measured.record.displacement, self.measured.channels.values[0]
        rows = [
            (name, f"{values.min():.4g}", f"{values.max():.4g}")
            for name, values in (("displacement [m]", displacement), ("force [N]", force))
        ]
        note = (
            f"The source, {self.measured.source}, has {force.size} samples. The loops dissipate "
            f"{energy(displacement, force):.4g} J."
        )
        return [table("cyclic", "data", "Cyclic test", ("", "smallest", "largest"), rows, note)]

    def figures_of(self, problem, part, kind):
        """Force against displacement."""
        bands, force = part["bands"].to_dataset(), part["observed_data"]["y"]
        found = bands[["response"]].rename(response=self.quantity)
        return [
            Figure(
                f"{kind}_loops",
                f"{kind}: force against displacement in three parts of the test. Dashed what was measured; "
                "blue the 5-95 % interval and the median of the specimen, from the uncertainty of the "
                "parameters.",
                lambda: plots.plot_loops(found, measured=force),
            )
        ]

    def verdict(self, problem, result, kind):
        """Whether the median force meets the measured one."""
        return verdict_of_loops(self.measured.record.displacement, result[kind])


def energy(displacement, force) -> float:
    """Work of a force along its displacement [J], by the trapezoidal rule."""
    return float(np.trapezoid(force, displacement))


def verdict_of_loops(displacement, part) -> Verdict:
    """Judge how the median force of a likelihood meets the measured one."""
    force = part["observed_data"]["y"].values[0]
    model = part["bands"]["response"].sel(quantile=0.5).values[0]
    error = force - model
    relative = float(np.sqrt((error**2).sum() / (force**2).sum()))
    share = (
        f"it accounts for {100.0 * max(0.0, 1.0 - relative**2):.0f} % of the force (share of the mean square)"
    )
    explains = relative <= UNEXPLAINED
    sentences = [
        f"The specimen explains the loops: {share}."
        if explains
        else f"This specimen does not explain the loops: {share}."
    ]
    done, by_model = energy(displacement, force), energy(displacement, model)
    if abs(by_model / done - 1.0) > ENERGY:
        sentences.append(
            f"The measured loops dissipate {done:.3g} J, those of the model {by_model:.3g} J: their shape is "
            "not that of the law."
        )
    persistence = float((error[1:] * error[:-1]).sum() / (error**2).sum()) if error.any() else 0.0
    if relative > ROUGH and persistence > PERSISTS:
        largest = float(displacement[np.abs(error).argmax()])
        sentences.append(
            "The error is no noise but an error of the model, largest at a displacement of "
            f"{largest:.3g} m. Let more of the specimen be uncertain (degradation, pinching); what is left "
            "then is beyond its law."
        )
    return Verdict(sentences, explains)
