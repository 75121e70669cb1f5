"""The sections of a configuration file: keys, types and what each must be.

The description of a key completes the sentence "`key` must be ..." in messages, see `keys.py`.
"""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BaseModel, Field, model_validator

from pymc_features.io import read_record
from pymc_features.likelihoods import LIKELIHOODS
from pymc_features.records import INTERPOLATIONS, Interpolation, Record
from pymc_features.update.config.entries import STRICT, Positive, Vector, key, priors_in
from pymc_features.update.config.keys import shown
from pymc_features.update.config.priors import Prior

ERRORS = {"sigma": "m/s^2", "correlation_time": "s", "m": "-"}  # parameters of the errors, with their units
#: What sensors measure, by the quantity of the response that it is compared with.
MEASURED = {
    "absolute_acceleration": "acceleration",
    "relative_acceleration": "acceleration",
    "relative_velocity": "velocity",
    "relative_displacement": "displacement",
    "inter_storey_drift": "displacement",
}
SIGMA = {"acceleration": "m/s^2", "velocity": "m/s", "displacement": "m"}  # unit of the errors
ACCELERATIONS = [name for name, measured in MEASURED.items() if measured == "acceleration"]
BETWEEN = '"band-limited" or "linear", between the samples of the base'
KERNELS = ("PersistentSMC", "PopulationIMH", "PopulationMH", "TMCMC")
DRAWS, CHAINS = 10_000_000, 1000  # at most: more would end without memory, after hours


class Section(BaseModel):
    """A table of the file: unknown keys are refused, values are not converted."""

    model_config = STRICT

    def parameters(self, key, config=None):
        """Key, unit and value of every entry that may be random; `key` is that of the section."""
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if isinstance(value, Section):
                yield from value.parameters(f"{key}.{name}")
            elif isinstance(field.json_schema_extra, dict) and "unit" in field.json_schema_extra:
                yield f"{key}.{name}", field.json_schema_extra["unit"], value


def rising(value):
    """Numbers each larger than the one before; the words of the key say so."""
    assert all(low < high for low, high in pairwise(value))
    return tuple(value)


def two_or_more(value):
    """First row, and the one after the last, of two rows at least; the words of the key say so."""
    assert 0 <= value[0] < value[1] - 1
    return tuple(value)


Rows = Annotated[list[int], Field(min_length=2, max_length=2), AfterValidator(two_or_more)]
Window = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(rising)]
Frequencies = Annotated[list[Positive], Field(min_length=1), AfterValidator(rising)]
Names = Annotated[list[str], Field(min_length=1)]
Table = dict[str, Any]


class FileFormat(Section):
    """What a file with numbers may not say itself; see `read_record`."""

    units: str | float | None = key('"g", "m/s^2", "cm/s^2", "gal", or SI units per file unit', None)
    dt: float | None = key("the sampling interval in seconds, positive", None, gt=0)
    wrapped: bool | None = key("true if one series runs along the lines of a text file, else false", None)


class ChannelFormat(FileFormat):
    """What a file with channels may not say itself; see `read_channels`."""

    clock: int | str | Literal[False] | None = key("the column with the times, or false", None)
    clock_units: str | float | None = key('"s", "ms", "us", "ns", or seconds per count', None)
    skip: int | None = key("the number of rows to leave out at the start, not negative", None, ge=0)


class SensorFile(ChannelFormat):
    """The file of one sensor."""

    file: str = key("a file")
    column: int | str | None = key("a column, by index from 0 or header name", None)
    sensitivity: str | float | None = key('a text such as "100 mV/g", or V per SI unit', None)
    scale: float | None = key("a factor, -1.0 for an inverted sensor", None)
    delay: float | None = key("the seconds by which it comes late", None)
    anchors: list[list[float]] | None = key("two pairs [reading of its clock, true time in s]", None)


class Data(ChannelFormat):
    """Which channels were measured, and where on the structure."""

    dataset: Literal["mini_shake_table"] | None = key('"mini_shake_table", or left out', None)
    event: Literal["northridge", "sine1p5"] = key('"northridge" or "sine1p5"', "northridge")
    excitation: Literal["measured", "ambient"] = key('"measured" or "ambient"', "measured")
    files: str | list[str] | dict[str, str | SensorFile] | None = key(
        "a file, a list of files, or a table of sensor names to files or to tables with `file`", None
    )
    columns: int | str | list[int | str] | dict[str, int | str] | None = key(
        "a column, by index from 0 or header name, a list, or a table of sensor names to columns", None
    )
    resample: float | None = key("the sampling rate in Hz that all sensors get, positive", None, gt=0)
    quantity: Literal[tuple(MEASURED)] = key(f"one of {', '.join(MEASURED)}", "absolute_acceleration")
    interpolation: Interpolation = key(BETWEEN, INTERPOLATIONS[0])
    rows: Rows | None = key("two rows or more from 0 on, [first, the one after the last]", None)
    gaps: Literal["refuse", "leave_out"] = key('"refuse" or "leave_out"', "refuse")
    base: str | None = key("the sensor that measured the motion of the base", None)
    sensors: Names = key("the names of the sensors on the structure, one or more")
    dofs: list[int] | None = key("a list with the degree of freedom of each sensor, 0 next to the base", None)
    scale: float | dict[str, float] | None = key(
        "a factor for all sensors, or a table of sensor names to factors, -1.0 for an inverted one", None
    )
    delay: dict[str, float] | None = key("a table of sensor names to seconds by which they are late", None)

    @model_validator(mode="after")
    def one_source(self):
        if self.dataset is not None and self.files is not None:
            raise ValueError("must have one of the keys `files` and `dataset`, got both")
        if self.dataset is None and "event" in self.model_fields_set:
            raise ValueError("must have `event` only with `dataset`, got it with `files`")
        if self.dataset is not None:
            own = {"dataset", "event", "excitation", "base", "sensors", "dofs", "rows", "scale", "delay"}
            if more := sorted(self.model_fields_set - own):
                raise ValueError(f"must have `{more[0]}` only with `files`, got it with `dataset`")
        if self.quantity not in ACCELERATIONS and not isinstance(self.files, dict):
            raise ValueError(
                f"must have `files` as a table of sensors for `quantity` {self.quantity}, got "
                f"{shown(self.files)}: the base moves by an acceleration"
            )
        if len(set(self.sensors)) < len(self.sensors) or self.base in self.sensors:
            raise ValueError(
                f"must name each sensor once, got base {shown(self.base)} and {shown(self.sensors)}"
            )
        return self


class RecordFile(FileFormat):
    """The ground motion, where no sensor measured it."""

    path: str = key("the file with the ground acceleration")
    column: int | str | None = key("a column, by index from 0 or header name", None)
    interpolation: Interpolation = key(BETWEEN, INTERPOLATIONS[0])
    delay: float = key("the time in seconds of the first sample on the clock of the channels", 0.0)

    def read(self, folder: Path) -> Record:
        """The record of the file, between whose samples it moves as the section says."""
        given = self.model_dump(include={"units", "dt", "column", "wrapped"})
        record = read_record(folder / self.path, **given)
        return replace(record, interpolation=self.interpolation or record.interpolation)


class Detrend(Section):
    """Offset or line to subtract."""

    kind: Literal["constant", "linear"] = key('"constant" or "linear"', "constant")
    window: Window | None = key("two rising times [from, to] in seconds", None)


class BandPass(Section):
    """Corner frequencies of the filter."""

    low: float | None = key("a frequency in Hz, positive", None, gt=0)
    high: float | None = key("a frequency in Hz, positive", None, gt=0)
    order: int = key("a whole number from 1 to 10", 4, ge=1)


class Processing(Section):
    """What is done to the channels, in this order."""

    detrend: Detrend | None = key("a table with `kind` and `window`", None)
    band_pass: BandPass | None = key("a table with `low`, `high` and `order`", None)
    trim: Window | None = key("two rising times [from, to] in seconds", None)
    compare: Window | None = key("two rising times [from, to] in seconds after `trim`", None)
    decimate: int = key("a positive whole number", 1, ge=1)
    check_band: Literal[False] | Window | None = key("rising frequencies [from, to] in Hz, or false", None)


class Likelihood(Section):
    """How response and data are compared."""

    kinds: list[Literal[tuple(LIKELIHOODS)]] = key(
        f"a list of {', '.join(LIKELIHOODS)}, each once", ["EXP"], min_length=1
    )
    sigma: Vector | None = key(
        "the name of a prior or a positive number in m/s^2 ([cyclic]: N), one or one for each sensor", None
    )
    correlation_time: Vector | None = key(
        "the name of a prior or a positive number in s, one or one for each sensor", None
    )
    m: Vector | None = key(
        "a positive number, the independent observations of a sensor, one or one for each", None
    )
    density: Literal["feature", "data"] = key('"feature" or "data"', "feature")
    epsilon: float | None = key(
        "the tolerance of ABC in m^2/s^4 (with [cyclic] in N^2), positive", None, gt=0
    )

    @model_validator(mode="after")
    def complete(self):
        if len(set(self.kinds)) < len(self.kinds):
            raise ValueError(f"must name each of `kinds` once, got {self.kinds}")
        for kind in self.kinds:
            for name, value in self.parameters_of(kind).items():
                check_parameter(LIKELIHOODS[kind], name, value)
        for name in ("epsilon", "correlation_time", "m"):
            users = [kind for kind, entry in LIKELIHOODS.items() if name in entry.takes]
            if getattr(self, name) is not None and not set(users) & set(self.kinds):
                raise ValueError(f"must have `{name}` only with {', '.join(users)}, got kinds {self.kinds}")
        if "ABC" in self.kinds and self.epsilon is None and "EXP" not in self.kinds:
            raise ValueError("must have `epsilon` for ABC, or EXP among `kinds` to take it from")
        return self

    def parameters_of(self, kind) -> dict[str, Any]:
        """Names and values of the parameters of the errors that one likelihood takes."""
        return {name: getattr(self, name) for name in ERRORS if name in LIKELIHOODS[kind].takes}

    def parameters(self, key, config=None):
        """Take the unit of what is measured for sigma."""
        sigma = "N" if config.cyclic is not None else SIGMA[MEASURED[config.data.quantity]]
        units = ERRORS | {"sigma": sigma}
        for name in dict.fromkeys(name for kind in self.kinds for name in self.parameters_of(kind)):
            yield f"{key}.{name}", units[name], getattr(self, name)


def check_parameter(entry, name, value) -> None:
    """A parameter of the errors is there, known or inferred as the likelihood says."""
    if value is None:
        raise ValueError(f"must have the key `{name}` for {entry.name}, got none")
    is_random = any(priors_in(value))
    if name in entry.known and is_random:
        wanted, takes, other = "numbers", "takes it for known", "inferred"
    elif name in entry.inferred and not is_random:
        wanted, takes, other = "the name of a prior", "infers it", "known"
    else:
        return
    kinds = " and ".join(kind for kind, one in LIKELIHOODS.items() if name in getattr(one, other))
    advice = f"{kinds} {'infer it' if other == 'inferred' else 'take numbers'}"
    advice = advice if kinds else "Pass a number, or a list with one for each sensor"
    got = shown(next(priors_in(value)).prior) if is_random else shown(value)
    got = f"the prior {got}" if is_random else got
    raise ValueError(f"must have {wanted} as `{name}` for {entry.name}, which {takes}, got {got}. {advice}")


class Sampler(Section):
    """How posteriors are sampled; ABC by subset simulation always."""

    method: Literal["auto", "smc", "nuts", "laplace"] = key('"auto", "smc", "nuts" or "laplace"', "auto")
    kernel: Literal[KERNELS] = key(f"one of {', '.join(KERNELS)}, with `method` smc", "PersistentSMC")
    draws: int = key(f"a whole number from 50 to {DRAWS}, draws of each chain", 1000, ge=50, le=DRAWS)
    tune: int = key(f"a whole number from 1 to {DRAWS}, with `method` nuts", 1000, ge=1, le=DRAWS)
    chains: int = key(f"a whole number from 1 to {CHAINS}", 2, ge=1, le=CHAINS)
    cores: int | None = key("a positive whole number", None, ge=1)
    random_seed: int = key("a whole number, not negative", 0, ge=0)

    @model_validator(mode="after")
    def used(self):
        if "kernel" in self.model_fields_set and self.method != "smc":
            raise ValueError(f"must have `kernel` only with `method` smc, got {self.method!r}")
        return self


QUANTITIES = Literal["inter_storey_drift", "base_shear", "relative_displacement", "absolute_acceleration"]
SOME_QUANTITIES = f"a list of {', '.join(get_args(QUANTITIES))}"


class Report(Section):
    """What the report shows besides."""

    title: str = key("a line of text", "Updated model")
    natural_frequencies: Frequencies | None = key("a list of positive, rising frequencies in Hz", None)
    quantities: list[QUANTITIES] = key(SOME_QUANTITIES, [])


class Candidate(Section):
    """Another structure for the same data."""

    structure: dict[str, Any] = key("a table: a whole structure with `type`, or what differs")
    priors: dict[str, dict[str, Any]] = key("a table of priors besides those of [priors]", {})
    weight: float = key("a prior probability beside 1 of [structure], positive", 1.0, gt=0)


class Population(Section):
    """How one parameter varies from member to member."""

    distribution: Literal["Normal", "LogNormal"] = key('"Normal" or "LogNormal", then of ln', "LogNormal")
    mean: Prior = key("a table, the prior of the mean, with LogNormal of the median")
    scatter: Prior = key("a table, the prior of the standard deviation, with LogNormal that of ln")


class Hierarchical(Section):
    """Several specimens or laboratories, of which the file is one, and their population."""

    members: dict[str, dict[str, Table]] = key("a table of others, each with what differs", min_length=1)
    population: dict[str, Population] = key("a table of parameters that vary, one or more", min_length=1)


class Sensitivity(Section):
    """What `check` says about how well the sensors see each parameter."""

    draws: int = key("a whole number from 3 to 1000, draws of the priors", 20, ge=3, le=1000)
