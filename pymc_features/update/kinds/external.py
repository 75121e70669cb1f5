"""A program that someone else wrote in place of a structure: the section [external]."""

import time
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from pydantic import model_validator
from pytensor.graph.traversal import ancestors

from pymc_features.exceptions import ConfigError
from pymc_features.external import ExternalSimulator, ProgramSimulator, emulate
from pymc_features.io.reading.labels import SI
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.ops import ExternalResponse
from pymc_features.update.config.entries import Parameter
from pymc_features.update.config.keys import named_key
from pymc_features.update.config.sections import MEASURED, Section, key
from pymc_features.update.kinds.base import channels_table, printed, thinned
from pymc_features.update.kinds.channels import part_compared, read_whole
from pymc_features.update.kinds.histories import WITH_EVIDENCE, Histories, accounted_for

SIMULATED = 50  # draws whose responses the report shows
LEFT_OUT = {  # keys that speak of a structure mean nothing here, and filters would touch one side alone
    "structure record events modal ambient cyclic predict compare hierarchical sensitivity": "with "
    "[external], got it. The program decides.",
    "data.base data.dofs data.excitation data.interpolation processing.band_pass processing.check_band "
    "processing.decimate report.natural_frequencies report.quantities": "with [external], got it. What the "
    "program returns is compared as it is.",
}


class ExternalSection(Section):
    """Which program, how it gets parameters, and what it leaves."""

    program: str | list[str] = key('a command, as "OpenSees frame.tcl", or a list of its words')
    units: dict[str, str] = key(
        'a table of the priors that stand as {{NAME}} in program and template to their units, as {k = "N/m"}',
        min_length=1,
    )
    template: dict[str, str] = key("a table of the files that the program reads to their templates", {})
    files: list[str] = key("a list of files that are copied beside them as they are", [])
    output: str = key("the file that the program leaves: .npy, .csv or text in columns")
    columns: list[int] | None = key("a list of columns that count, from 0, one for each sensor", None)
    transpose: bool = key("true if the rows of the file are times, else false", True)
    timeout: float | None = key("seconds after which a run is stopped, positive", None, gt=0)
    retries: int = key("a whole number of further attempts, not negative", 0, ge=0)
    cache: str = key("a file that keeps every run", "simulations.sqlite")
    emulate: int | None = key("a whole number of runs from 10 on, for an emulator", None, ge=10)

    @model_validator(mode="after")
    def takes_something(self):
        texts = [self.program] if isinstance(self.program, str) else self.program
        if not self.template and not any("{{" in text for text in texts):
            raise ValueError(
                "must have a `template`, or a parameter as {{NAME}} in `program`, got neither: the program "
                "would always do the same"
            )
        return self

    def parameters(self, key, config=None):
        for name, unit in self.units.items():
            yield f"{key}.units.{name}", unit, Parameter(prior=name)


class ProgramOf:
    """What stands in place of a structure: the names of the program's parameters, and no modes."""

    has_modes = has_storeys = False
    n_modes, files = None, ()

    def __init__(self, section: ExternalSection):
        self.names = list(section.units)
        self.title = section.program if isinstance(section.program, str) else " ".join(section.program)

    def __call__(self, **values):
        return [values[name] for name in self.names]


@dataclass(frozen=True)
class External(Histories):
    """Histories that a program computes for known parameters; it alone knows the motion of the base."""

    simulator: ExternalSimulator | None = None  # the program, with its cache

    key, section, refused = "external", ExternalSection, LEFT_OUT
    is_checked, n_predicted = False, SIMULATED

    @classmethod
    def check_sections(cls, config):
        """The measured files are there, and likelihoods do without sensitivities."""
        if config.data is None or (config.data.files is None and config.data.dataset is None):
            raise ConfigError("`data` must be given with [external]: a table with the measured `files`.")
        super().check_sections(config)
        is_emulated = config.external.emulate is not None
        for kind in config.likelihood.kinds:
            entry = LIKELIHOODS[kind]
            if entry.calibrates or (is_emulated and entry.is_likelihood_free):
                why = " and `emulate`" if is_emulated else ", for programs have no sensitivities"
                raise ConfigError(
                    f"`likelihood.kinds` must not have {kind} with [external]{why}. Take "
                    f"{', '.join(WITH_EVIDENCE)}."
                )
        if is_emulated and config.sampler.method != "auto":
            raise ConfigError(
                f'`sampler.method` must be "auto" with `external.emulate`, got {config.sampler.method!r}.'
            )

    @classmethod
    def read(cls, problem):
        config, asked = problem.config, problem.config.external
        channels, step, source = read_whole(config, problem.folder)
        channels = channels.drop_vars("units", errors="ignore")
        channels = channels.assign_attrs(units=SI[MEASURED[config.data.quantity]])
        compared, first = part_compared(channels, config.processing)
        with named_key("external", command="program", inputs="template", result="output"):
            templates = {name: problem.folder / file for name, file in asked.template.items()}
            settings = asked.model_dump(include={"columns", "transpose"})
            settings["files"] = [problem.folder / file for file in asked.files]
            names = list(asked.units)
            program = ProgramSimulator(asked.program, names, templates, asked.output, **settings)
            settings = asked.model_dump(include={"timeout", "retries"})
            settings |= {"cache": problem.folder / asked.cache, "executor": config.sampler.cores}
            simulator = ExternalSimulator(program, shape=channels.shape, dt=step, progress=False, **settings)
        found = cls(config, None, compared, step, source, list(range(len(compared))), first, simulator)
        return found.check_likelihood(problem)

    @property
    def used(self):
        return f"{len(self.dofs)} measured histories over {self.step * self.simulator.shape[1]:.4g} s"

    def prints(self):
        return printed({"channels": self.channels.values}) | {"program": self.simulator.identity}

    def response(self, problem, structure):
        """What the program returns; `structure` has its parameters in their order."""
        return self.simulator(*structure)

    def sample(self, problem, likelihood, model, seed, running):
        """The posterior from some hundred runs, if it is asked for."""
        sampler, runs = self.config.sampler, self.config.external.emulate
        if runs is None:
            return None
        settings = {"draws": sampler.draws, "chains": sampler.chains, "progressbar": running.progressbar}
        with named_key("external.emulate", runs="external.emulate"):
            return emulate(runs, model=model, random_seed=seed, **settings)

    @contextmanager
    def responses(self, problem, model, idata):
        """Take responses by the program or its emulator, without those at which the program fails."""
        drawn = thinned(idata["posterior"].to_dataset(), SIMULATED).stack(sample=("chain", "draw"))
        # the emulator where the model has one; that of ABC has no response among its variables
        ops = [v.owner.op for v in ancestors(model.basic_RVs) if v.owner is not None]
        found = next((op.simulator for op in ops if isinstance(op, ExternalResponse)), self.simulator)
        values = found.responses(*(drawn[name].values for name in problem.structure.names))
        values = values[..., self.window]
        known = np.isfinite(values).all(axis=(1, 2))
        labels = {name: ("sample", drawn[name].values[known]) for name in ("chain", "draw")}
        yield labels, lambda: [(0, np.moveaxis(values[known], 0, -1))]

    def told(self):
        yield f"data: {self.source}; {self.simulator.shape[1]} samples at {self.step:.6g} s"
        yield f"program: {' '.join(self.simulator.function.command)}"

    def check(self, problem, path):
        middle = {name: problem.priors[name].median for name in problem.structure.names}
        values = ", ".join(f"{name} = {value:.4g}" for name, value in middle.items())
        start, known = time.perf_counter(), self.simulator.counts["cached"]
        [found] = self.simulator.responses(*(np.array([value]) for value in middle.values()))
        how = f"took {time.perf_counter() - start:.2g} s"
        if not np.isfinite(found).all():
            reason = self.simulator.failures[-1].message if self.simulator.failures else "it is not finite"
            raise ConfigError(f"`external.program` must run at the medians of the priors, {values}: {reason}")
        off = self.channels - found[:, self.window]
        relative = np.sqrt((off**2).mean("time") / (self.channels**2).mean("time")).values
        how = "came from the cache" if self.simulator.counts["cached"] > known else how
        yield (
            f"The program {how} at the medians of the priors, {values}: it accounts for "
            f"{accounted_for(self.channels['sensor'].values, relative)}."
        )

    def tables(self, problem, result):
        shown = channels_table(self, f". Responses are those of {SIMULATED} draws.")
        return [*super().tables(problem, result), shown]
