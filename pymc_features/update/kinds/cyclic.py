"""Cyclic tests: the section [cyclic], displacement and force, and whether a specimen explains them."""

from pathlib import Path

import numpy as np

from pymc_features import plots
from pymc_features.exceptions import ConfigError
from pymc_features.io import read_cyclic_test
from pymc_features.io.reading.labels import FORCES, LENGTHS
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import Section, key
from pymc_features.update.config.structures import SPECIMENS
from pymc_features.update.kinds.base import Verdict, drawn_to, table
from pymc_features.update.kinds.histories import UNEXPLAINED, Histories

LENGTH_OR_FORCE = f"two units, of displacement ({', '.join(LENGTHS)}) and of force ({', '.join(FORCES)})"
ROUGH = 0.1  # rms error over measured rms that is worth a word where the error persists from sample to sample
PERSISTS = 0.5  # correlation of the error with that of the sample before
ENERGY = 0.1  # relative error of the dissipated energy that is worth a word


class CyclicSection(Section):
    """A table with both, or one of each."""

    files: str | list[str] = key("a file, or a list of two, of the displacement and of the force")
    columns: list[int | str] | None = key(
        "two columns, of displacement and force, by index from 0 or header name",
        None,
        min_length=2,
        max_length=2,
    )
    units: list[str | float] | None = key(
        f"{LENGTH_OR_FORCE}, or m and N per file unit", None, min_length=2, max_length=2
    )
    skip: int = key("the number of rows to leave out at the start, not negative", 0, ge=0)
    wrapped: bool | None = key("true if one series runs along the lines, else false", None)


class Cyclic(Histories):
    """Displacement and force of a cyclic test, which stand for motion of the base and responses."""

    key, section = "cyclic", CyclicSection
    quantity = "restoring_force"
    is_checked = False

    refused = {
        "data record processing events modal ambient": "with [cyclic], got it. Displacement and force are "
        "all there is.",
        "report.natural_frequencies report.quantities": "with [cyclic], got it. There is no motion.",
    }

    @classmethod
    def check_sections(cls, config):
        if config.structure.type not in SPECIMENS:
            raise ConfigError(
                f"`structure.type` must be {' or '.join(SPECIMENS)} with [cyclic], got "
                f"{config.structure.type}. Its displacement is prescribed."
            )
        super().check_sections(config)

    @classmethod
    def read(cls, problem):
        asked = problem.config.cyclic
        names = [asked.files] if isinstance(asked.files, str) else asked.files
        paths = [problem.folder / name for name in names]
        with named_key("cyclic"):
            test, force = read_cyclic_test(
                paths[0] if isinstance(asked.files, str) else paths, **asked.model_dump(exclude={"files"})
            )
        source = ", ".join(Path(name).name for name in names)
        return cls(problem.config, test, force, test.dt, source, [0]).check_likelihood(problem)

    @property
    def used(self):
        return f"{self.record.n_times} measured forces of a cyclic test"

    def bands(self, problem, likelihood, model, idata, response):
        """Add the displacement beside the time."""
        found = super().bands(problem, likelihood, model, idata, response)
        return found.assign_coords(displacement=("time", self.record.displacement))

    def shared(self, problem):
        displacement = "time", self.record.displacement, {"units": "m"}
        return {"data": super().shared(problem)["data"].assign_coords(displacement=displacement)}

    def told(self):
        yield f"data: {self.source}; {self.record}"

    def check(self, problem, path):
        force, found = self.channels, self.expected(problem)
        wrote = drawn_to(path, lambda: plots.loops(found, measured=force))
        low, *_, high = found[self.quantity].transpose("quantile", "sensor", "time").values
        share = float(np.mean((force.values >= low) & (force.values <= high)))
        yield f"{100.0 * share:.0f} % of the measured forces lie within what the priors expect (5 to 95 %)"
        yield wrote

    def tables(self, problem, result):
        displacement, force = self.record.displacement, self.channels.values[0]
        rows = [
            (name, f"{values.min():.4g}", f"{values.max():.4g}")
            for name, values in (("displacement [m]", displacement), ("force [N]", force))
        ]
        note = (
            f"The source, {self.source}, has {force.size} samples. The loops dissipate "
            f"{np.trapezoid(force, displacement):.4g} J."
        )
        own = table("cyclic", "data", "Cyclic test", ("", "smallest", "largest"), rows, note)
        return [*super().tables(problem, result), own]

    def figures_of(self, problem, part, kind):
        bands, force = part["bands"].to_dataset(), part["observed_data"]["y"]
        found = bands[["response"]].rename(response=self.quantity)
        return {"loops": lambda: plots.loops(found, measured=force)}

    def verdict(self, problem, result, kind):
        displacement = self.record.displacement
        force = result[kind]["observed_data"]["y"].values[0]
        model = result[kind]["bands"]["response"].sel(quantile=0.5).values[0]
        error = force - model
        relative = float(np.sqrt((error**2).sum() / (force**2).sum()))
        explains = relative <= UNEXPLAINED
        said = "The specimen explains" if explains else "This specimen does not explain"
        share = 100.0 * max(0.0, 1.0 - relative**2)
        told = [f"{said} the loops: it accounts for {share:.0f} % of the force (share of the mean square)."]
        done, by_model = np.trapezoid(force, displacement), np.trapezoid(model, displacement)
        if abs(by_model / done - 1.0) > ENERGY:
            told.append(
                f"The measured loops dissipate {done:.3g} J, those of the model {by_model:.3g} J: their "
                "shape is not that of the law."
            )
        persistence = float((error[1:] * error[:-1]).sum() / (error**2).sum()) if error.any() else 0.0
        if relative > ROUGH and persistence > PERSISTS:
            largest = float(displacement[np.abs(error).argmax()])
            told.append(
                "The error is no noise but an error of the model, largest at a displacement of "
                f"{largest:.3g} m. Let more of the specimen be uncertain (degradation, pinching); what is "
                "left then is beyond its law."
            )
        return Verdict(told, explains)
