"""Identified modes: the section [modal], what is read, and what a model makes of them."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr
from pydantic import model_validator

from pymc_features import plots
from pymc_features._checks import listed
from pymc_features.exceptions import ConfigError, ModalMatchWarning, PriorWarning
from pymc_features.likelihoods import Likelihood
from pymc_features.modal import ModalData, merge_setups
from pymc_features.modal.files import read_modal
from pymc_features.modal_features import ModalFeature, match_modes, modes
from pymc_features.modal_features.feature import checked_parameters
from pymc_features.modal_features.identified import identified
from pymc_features.storage import fingerprint
from pymc_features.update.config.entries import Vector, evaluated
from pymc_features.update.config.messages import named_key, shown
from pymc_features.update.config.sections import Names, Section, key, parameters_of
from pymc_features.update.config.structure_sections import STRUCTURES
from pymc_features.update.kinds.base import KindOfData, Setting, check_positive_priors
from pymc_features.update.kinds.model import (
    MODAL_DRAWS,
    declare,
    declares_as_prior,
    each_draw,
    names_for,
    thinned,
)
from pymc_features.update.kinds.structure import modes_of
from pymc_features.update.plausibility.findings import of_modes
from pymc_features.update.presentation.mode_rows import COLUMNS, ModeRow, modes_verdict
from pymc_features.update.presentation.nodes import Points, read_nodes
from pymc_features.update.presentation.shown import Figure, table, write_figure

MODAL = Likelihood(
    "MODAL",
    "errors of ln f Gaussian, 1 - MAC as the feature of Eq. (3), modes matched at every evaluation",
    "C9",
    lambda given: None,  # no response is compared in time
    takes=(),
)
SCALE = "the name of a prior or a number, one or one for each mode"
SPARE = 3  # modes beyond those identified, among which the likelihood may choose
BEYOND = 1.2  # of the highest identified frequency: modes above it are not in tables
MATCHED_DRAWS, SHAPE_DRAWS = 500, 100
OF_RESPONSES = ("record", "processing", "likelihood")  # sections that mean nothing without [data]


class ModalSection(Section):
    """Which modes were identified, where on the structure, and how well the model is to meet them."""

    file: str | None = key("a file with identified modes", None)
    files: list[str] | None = key("a list of files, two or more, one for each set-up", None, min_length=2)
    references: Names | None = key("the names of the channels that several set-ups have", None)
    names: dict[str, str] | None = key(
        "a table of quantities to what the files call them, such as omega or damping_percent", None
    )
    modes: list[int] | None = key("a list of numbers of modes in the file, 1 the first", None, min_length=1)
    channels: dict[str, int] | None = key(
        "a table of channel names to degrees of freedom, 0 next to the base", None, min_length=1
    )
    scale: dict[str, float] | None = key(
        "a table of channel names to factors, -1.0 for an inverted one", None
    )
    shapes: bool = key("true or false, whether shapes are compared", True)
    labels: list[str | int] | None = key(
        "a list with a name for each mode, equal for several identifications of one", None, min_length=1
    )
    n_modes: int | None = key("the number of modes of the structure to choose from, positive", None, ge=1)
    sigma_f: Vector = key(f"{SCALE}, the error of the model in ln f", json_schema_extra={"unit": "-"})
    sigma_phi: Vector | None = key(
        f"{SCALE}, the scale of the root of 1 - MAC", None, json_schema_extra={"unit": "-"}
    )
    density: Literal["EXP", "TN"] | float = key('"EXP", "TN" or degrees of freedom, positive', "EXP")
    nodes: str | None = key("a CSV file with columns dof or name, x, y, z", None)

    @model_validator(mode="after")
    def one_source(self):
        """One file, or several with references."""
        if (self.file is None) == (self.files is None):
            raise ValueError("must have one of the keys `file` and `files`, got both or neither")
        if self.references is not None and self.files is None:
            raise ValueError("must have `references` only with `files`, got them with `file`")
        if not self.shapes:
            for name in ("channels", "scale", "sigma_phi", "nodes", "density"):
                if name in self.model_fields_set:
                    raise ValueError(f"must have `{name}` only with shapes, got it with shapes = false")
        if isinstance(self.density, float) and self.density <= 0.0:
            raise ValueError(f"must have positive degrees of freedom as `density`, got {self.density:g}")
        return self

    def parameters(self, config):
        """Key, unit and value of what may be random."""
        return parameters_of("modal", self)


def with_damping(raw):
    """The tables of a file; where only modes are compared a structure needs no damping, which moves none."""
    if not isinstance(raw, dict) or "data" in raw:
        return raw
    structure = raw.get("structure")
    if not isinstance(structure, dict) or "damping" in structure:
        return raw
    section = STRUCTURES.get(structure["type"]) if isinstance(structure.get("type"), str) else None
    if section is None or not section.model_fields["damping"].is_required():
        return raw
    return raw | {"structure": structure | {"damping": {"type": "ModalDamping", "ratios": 0.0}}}


@dataclass(frozen=True)
class Modal(KindOfData):
    """Identified modes, at the channels that are compared.

    Attributes
    ----------
    asked : ModalSection
        How they are compared.
    data : ModalData
        Those that are compared, with real shapes at the channels.
    numbers : list of int
        Of each in its file, 1 the first.
    labels : list
        Which mode each is of; `numbers` if they are all of different ones.
    dofs : list of int
        Degree of freedom of each channel.
    n_modes : int
        Modes of the structure to choose from.
    points : Points or None
        What is drawn; None where nobody knows where degrees of freedom are.
    source : str
        Where they come from.
    """

    asked: ModalSection
    data: ModalData
    numbers: list[int]
    labels: list
    dofs: list[int]
    n_modes: int
    points: Points | None
    source: str

    key, section = "modal", ModalSection
    own = (MODAL,)
    likelihoods = [MODAL.name]

    @classmethod
    def check_sections(cls, config):
        """Refuse what is said of responses where modes are all there is, and a tolerance beside modes."""
        if config.data is not None:
            if config.likelihood is not None and "ABC" in config.likelihood.kinds:
                raise ConfigError(
                    "`likelihood.kinds` must not have ABC with [modal], for a tolerance on responses says "
                    "nothing of modes. Leave one of them out."
                )
            return
        for name in OF_RESPONSES:
            if name in config.model_fields_set:
                raise ConfigError(
                    f"`{name}` must be left out without [data], got it. Identified modes need none."
                )
        for name in ("natural_frequencies", "quantities"):
            if name in config.report.model_fields_set:
                raise ConfigError(
                    f"`report.{name}` must be left out without [data], got it. The report "
                    "has the frequencies of [modal], and no responses."
                )

    @classmethod
    def read(cls, given: Setting):
        """Read the modes of [modal]; it warns of what is suspicious about them."""
        section, structure = given.config.modal, given.expected
        check_positive_priors("modal", section, ("sigma_f", "sigma_phi"), given.priors)
        data, source = read_files(section, given.folder)
        numbers = list(range(1, len(data) + 1)) if section.modes is None else section.modes
        if len(set(numbers)) < len(numbers) or not all(1 <= number <= len(data) for number in numbers):
            raise ConfigError(
                f"`modal.modes` must be different numbers from 1 to {len(data)}, the modes of {source}, got "
                f"{shown(numbers)}. 1 is the first."
            )
        data = data.select([number - 1 for number in numbers])
        labels = numbers if section.labels is None else section.labels
        if section.labels is None and data.labels is not None:
            labels = list(data.labels)
        if len(labels) != len(data):
            raise ConfigError(
                f"`modal.labels` must have a name for each of the {len(data)} modes, got {len(labels)}."
            )
        data, dofs = at_channels(section, data, structure, source)
        if labels is numbers:  # but for modes that were found twice
            found = identified(data)
            labels = [numbers[found.labels[g]] for g in found.groups.argmax(axis=0)]
        check_scales(section, data, source, len(dict.fromkeys(map(str, labels))))
        points = points_of(section, data, dofs, given.folder, structure)
        n_modes = modes_to_choose_from(section, len(dict.fromkeys(map(str, labels))), structure)
        for sentence in of_modes(data.frequencies, given.prior):
            warnings.warn(sentence, PriorWarning, stacklevel=2)
        return cls(section, data, numbers, labels, dofs, n_modes, points, source)

    @classmethod
    def compared(cls, section, data, dofs, structure, source) -> "Modal":
        """Modes that are not read from a file, all different ones."""
        numbers = list(range(1, len(data) + 1))
        n_modes = modes_to_choose_from(section, len(data), structure)
        points = points_of(section, data, dofs, Path(), structure)
        return cls(section, data, numbers, numbers, dofs, n_modes, points, source)

    @property
    def names(self) -> list[str]:
        """What each is called in tables: its number, and its label if it has one."""
        if self.labels == self.numbers:
            return [str(number) for number in self.numbers]
        return [f"{number} ({label})" for number, label in zip(self.numbers, self.labels, strict=True)]

    @property
    def used(self):
        """How many they are."""
        n = len(self.data)
        return f"{n} identified mode{'s' if n > 1 else ''}"

    @property
    def sentence(self) -> str:
        """What they are, and where they come from."""
        n, s = len(self.data), len(self.dofs)
        at = f" at {s} channels" if s else " without shapes"
        return f"{n} mode{'s' if n > 1 else ''}{at} from {self.source}"

    @property
    def band(self):
        """Up to some more than the highest of them."""
        return 0.0, BEYOND * self.data.frequencies.max()

    def prints(self):
        """Return fingerprints of frequencies and shapes."""
        data = self.data
        arrays = {"frequencies": data.frequencies, "sd": data.frequency_sd, "shapes": data.shapes}
        return {
            f"modal_{name}_sha256": fingerprint(np.ascontiguousarray(values))
            for name, values in arrays.items()
            if values is not None
        }

    def parameters(self, likelihood):
        """The errors of the model."""
        return self.asked.sigma_f, self.asked.sigma_phi

    def declare(self, problem, likelihood, structure, values, tolerance):
        """Add the modes; where residuals of responses decide the width, as a factor of the prior."""
        asked = self.asked
        with named_key("modal", n_modes="modal.n_modes"):
            found = modes(structure, self.n_modes, sensors=self.dofs or None)
            scales = [
                None if value is None else pt.as_tensor_variable(evaluated(value, values))
                for value in (asked.sigma_f, asked.sigma_phi)
            ]
            labels = [str(label) for label in self.labels]
            if declares_as_prior(likelihood):
                data = identified(self.data, labels)
                terms = ModalFeature.dist(*checked_parameters(found, data, *scales, asked.density))
                pm.Potential("modal", pm.logp(terms, data.values).sum())
                return
            ModalFeature(
                "modal",
                found,
                observed=self.data,
                sigma_f=scales[0],
                sigma_phi=scales[1],
                density=asked.density,
                labels=labels,
            )

    def predict(self, problem, likelihood, model, idata):
        """Which mode of the model each is matched with."""
        return {"matched": self.matched(problem, idata["posterior"].to_dataset())}

    def shared(self, problem, parts):
        """What was identified, and shapes of draws, which are not kept: other nodes are no other draws."""
        found = {
            f"{kind}/shapes": self.shapes(problem, part["posterior"].to_dataset())
            for kind, part in parts.items()
        }
        return found | {"identified": self.identified_modes()}

    def matched(self, problem, posterior: xr.Dataset, **limits) -> xr.Dataset:
        """Which mode of the model each is matched with, of some draws; see `match_modes`.

        The dimension is `identified`, with the numbers of the modes in their file. `limits` are those of
        partners.
        """
        model = declare(problem.with_data(self), MODAL.name)
        found = match_modes(thinned(posterior, MATCHED_DRAWS), name="modal", model=model, **limits)
        labels = list(map(str, self.labels))  # several identifications of one mode stand together
        order = sorted(range(len(labels)), key=lambda k: labels.index(labels[k]))
        found = found.rename(mode="identified").assign_coords(identified=[self.numbers[k] for k in order])
        found = found.sel(identified=self.numbers)
        return found.assign(has_partner=found["has_partner"].astype(np.int8))

    def shapes(self, problem, posterior: xr.Dataset) -> xr.Dataset:
        """Frequencies [Hz] and shapes of the model at some draws; those without a structure are left out.

        Returns
        -------
        Dataset
            `frequency` (sample, mode); of identified shapes also `at_channels` (sample, mode, channel), and
            `at_points` (sample, mode, point) of what is drawn.
        """
        columns = {"frequency": [], "at_channels": [], "at_points": []}
        for _, found in each_draw(problem, posterior, SHAPE_DRAWS, lambda s: modes_of(s, self.n_modes)):
            rows = found.mode_shapes.T[: self.n_modes]
            columns["frequency"].append(found.natural_frequencies[: self.n_modes])
            columns["at_channels"].append(rows[:, self.dofs])
            if self.points is not None:
                columns["at_points"].append(self.points.entries(rows))
        dims = {"frequency": (), "at_channels": ("channel",), "at_points": ("point",)}
        wanted = {name for name, values in columns.items() if values and np.size(values)}
        found = {
            name: (("sample", "mode", *dims[name]), np.array(columns[name]))
            for name in dims
            if name in wanted
        }
        return xr.Dataset(found, {"mode": 1 + np.arange(self.n_modes)})

    def identified_modes(self) -> xr.Dataset:
        """What was identified: frequency, its standard deviation [Hz], and shape (identified, channel)."""
        data = self.data
        found = {"frequency": ("identified", data.frequencies, {"units": "Hz"})}
        if data.frequency_sd is not None:
            found["frequency_sd"] = "identified", data.frequency_sd, {"units": "Hz"}
        coords = {"identified": self.numbers}
        if data.shapes is not None:
            found["shape"] = ("identified", "channel"), data.shapes
            coords |= {"channel": list(data.channels), "dof": ("channel", self.dofs)}
        return xr.Dataset(found, coords, {"source": self.source})

    def rows(self, matched) -> list[ModeRow]:
        """Every identified mode under one likelihood, from the group `matched`."""
        found = []
        for k, name in enumerate(self.names):
            one = matched.isel(identified=k)
            values, counts = np.unique(one["model_mode"].values, return_counts=True)
            frequency, mac = (
                tuple(map(float, np.quantile(one[key].values, [0.05, 0.5, 0.95])))
                for key in ("frequency", "mac")
            )
            found.append(
                ModeRow(
                    name,
                    float(self.data.frequencies[k]),
                    *frequency,
                    mac,
                    1 + int(values[counts.argmax()]),
                    float(counts.max() / counts.sum()),
                    1.0 - float(one["has_partner"].mean()),
                )
            )
        return found

    @property
    def placed(self):
        """Take the places of the channels."""
        return dict(zip(self.data.channels or [], self.dofs, strict=True))

    def told(self):
        """What they are, and where they come from."""
        yield f"modes: {self.sentence}"

    def check(self, problem, path):
        """Compare them with what the priors expect, and draw both where there are shapes.

        Partners are judged by their shapes: frequencies are what is to be updated.
        """
        draws = expected(problem.with_data(self))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModalMatchWarning)  # the sentences say it
            rows = self.rows(self.matched(problem, draws, deviations=np.inf))
        found = self.shapes(problem, draws)
        cells = [row.cells for row in rows]
        yield table("modes", "modes", "Identified modes [Hz], and the model under the priors", COLUMNS, cells)
        yield from modes_verdict(rows).sentences
        outside = [row for row in rows if not row.low <= row.measured <= row.high]
        if outside:
            named = ", ".join(f"{row.name} ({row.measured:.4g} Hz)" for row in outside)
            yield f"Outside of what the priors expect (5 to 95 %): {named}."
        if "at_channels" in found:
            draw = draw_shapes if "at_points" in found else draw_mac
            write_figure(draw(self, found, rows), path)
            yield f"wrote {path}"

    def tables(self, problem):
        """Frequencies with standard deviations, damping, and the places of channels."""
        data, n = self.data, len(self.data)
        columns = [self.names, [f"{f:.4g}" for f in data.frequencies]]
        for values, factor in ((data.frequency_sd, 1.0), (data.damping_ratios, 100.0)):
            numbers = np.full(n, np.nan) if values is None else factor * values
            columns.append(["" if np.isnan(value) else f"{value:.2g}" for value in numbers])
        at = ", ".join(f"{name} ({dof})" for name, dof in self.placed.items())
        sentences = [
            f"There are {self.sentence}.",
            f"The channels and their degrees of freedom are {at}." if at else "",
            f"Each is matched with one of the {self.n_modes} lowest modes of the structure.",
        ]
        if self.dofs and self.points is None and self in problem.data:
            sentences.append("Name a file with its nodes as `modal.nodes` to see the shapes drawn.")
        header = ("identified mode", "frequency [Hz]", "standard deviation [Hz]", "damping [%]")
        rows, note = list(zip(*columns, strict=True)), " ".join(filter(None, sentences))
        return [table("identified", "data", "Identified modes", header, rows, note)]

    def figures_of(self, problem, part, kind):
        """The MAC matrix and the shapes."""
        shapes, rows = part["shapes"].to_dataset(), self.rows(part["matched"].to_dataset())
        found = []
        if "at_channels" in shapes:
            found.append(
                Figure(
                    f"{kind}_mac",
                    f"{kind}: modal assurance criterion of the identified shapes and those of the model, "
                    "median and 5-95 % interval of the draws. Framed: the modes that are matched.",
                    lambda: draw_mac(self, shapes, rows),
                )
            )
        if "at_points" in shapes:
            found.append(
                Figure(
                    f"{kind}_shapes",
                    f"{kind}: identified shapes (dots) on those of the model they are matched with, each "
                    "draw scaled by the factor that brings it closest.",
                    lambda: draw_shapes(self, shapes, rows),
                )
            )
        return found

    def drawn_of(self, problem, part):
        """The partner of each in most draws, 0 if it has none, and what it is called."""
        matched = part["matched"].to_dataset()
        rows = self.rows(matched)
        partners = np.array([row.partner if row.has_partner else 0 for row in rows])
        labels = [row.name for row in rows]
        return {"matched": matched.assign(partner=("identified", partners), label=("identified", labels))}

    def verdict(self, problem, result, kind):
        """Whether each has a partner."""
        return modes_verdict(self.rows(result[f"{kind}/matched"]))


def expected(problem) -> xr.Dataset:
    """Draws of the priors of what decides on modes."""
    values = {
        name: (("chain", "draw"), problem.priors[name].draw(MODAL_DRAWS, k)[None])
        for k, name in enumerate(names_for(problem, MODAL.name))
    }
    return xr.Dataset(values, {"chain": [0], "draw": np.arange(MODAL_DRAWS)})


def read_files(section, folder) -> tuple[ModalData, str]:
    """The modes of the file, or of all set-ups together, and what they are called."""
    files = [section.file] if section.files is None else section.files
    with named_key("modal", source="file"):
        setups = [read_modal(folder / file, names=section.names) for file in files]
    with named_key("modal", setups="files", channels="references"):
        data = setups[0] if section.files is None else merge_setups(setups, section.references)
    return data, ", ".join(Path(file).name for file in files)


def at_channels(section, data, structure, source) -> tuple[ModalData, list[int]]:
    """The modes at the channels that are compared, and their places; frequencies alone if there are none."""
    if data.shapes is None or not section.shapes:
        for name in ("channels", "scale", "sigma_phi", "nodes"):
            if getattr(section, name) is not None:
                raise ConfigError(
                    f"`modal.{name}` must be left out without shapes, got it. {source} has frequencies alone."
                )
        names = "frequency_sd", "damping_ratios", "damping_sd", "labels"
        known = {name: getattr(data, name) for name in names}
        return ModalData(data.frequencies, **known), []
    n = structure.n_dof
    if section.channels is None:
        raise ConfigError(
            f"`modal.channels` must be given with shapes: a table of channel names to degrees of freedom. "
            f"{source} has {listed(data.channels)}. Or set shapes = false."
        )
    dofs = list(section.channels.values())
    if len(set(dofs)) < len(dofs) or not all(0 <= dof < n for dof in dofs):
        raise ConfigError(
            f"`modal.channels` must have different degrees of freedom from 0 to {n - 1}, got {shown(dofs)}. "
            "0 is next to the base."
        )
    if len(dofs) < 2:
        raise ConfigError(
            "`modal.channels` must be two or more, for a shape of one entry says nothing, got one. Add "
            "channels, or set shapes = false."
        )
    with named_key("modal"):
        data = data.select(channels=list(section.channels))
    return in_their_sense(data, section.scale), dofs


def in_their_sense(data, scale) -> ModalData:
    """Entries times the factors of their channels."""
    if scale is None:
        return data
    for name, factor in scale.items():
        if name not in data.channels or factor == 0.0:
            raise ConfigError(
                f"`modal.scale` must have factors that are not zero for channels that are compared "
                f"({', '.join(data.channels)}), got {shown({name: factor})}."
            )
    factors = np.array([scale.get(name, 1.0) for name in data.channels])
    sd = None if data.shape_sd is None else data.shape_sd * np.abs(factors)
    names = "frequency_sd", "damping_ratios", "damping_sd", "labels", "name"
    kept = {name: getattr(data, name) for name in names}
    return ModalData(data.frequencies, data.shapes * factors, data.channels, shape_sd=sd, **kept)


def check_scales(section, data, source, n) -> None:
    """One positive value, or one for each of n modes; zero where frequencies have standard deviations."""
    if data.shapes is not None and section.sigma_phi is None:
        raise ConfigError(
            f"`modal.sigma_phi` must be given with the shapes of {source}, got none. Pass the scale of the "
            "root of 1 - MAC, about 0.05, or set shapes = false."
        )
    for name in ("sigma_f", "sigma_phi"):
        given = getattr(section, name)
        if isinstance(given, list) and len(given) != n:
            raise ConfigError(
                f"`modal.{name}` must be one value or one for each of the {n} modes, got {len(given)}."
            )
        least = "at least zero" if name == "sigma_f" and data.frequency_sd is not None else "positive"
        for value in given if isinstance(given, list) else [given]:
            if isinstance(value, float) and (value < 0.0 or (value == 0.0 and least == "positive")):
                raise ConfigError(
                    f"`modal.{name}` must be {least}, got {value:g}. 0.01 is an error of one per cent."
                )


def points_of(section, data, dofs, folder, structure) -> Points | None:
    """What is drawn: nodes of a file, or storeys."""
    if data.shapes is None:
        return None
    if section.nodes is not None:
        with named_key("modal.nodes"):
            return read_nodes(
                folder / section.nodes, dict(zip(data.channels, dofs, strict=True)), structure.n_dof
            )
    return Points(np.arange(structure.n_dof), None) if structure.has_storeys else None


def modes_to_choose_from(section, identified: int, structure) -> int:
    """Number of modes of the structure: some more than were identified."""
    most = structure.n_dof if structure.has_storeys else structure.n_modes
    wanted = min(most, identified + SPARE) if section.n_modes is None else section.n_modes
    if not identified <= wanted <= most:
        raise ConfigError(
            f"`modal.n_modes` must be from the {identified} modes identified to the {most} of the structure, "
            f"got {wanted}. Leave it out, or modes by `modal.modes`."
        )
    return wanted


def partners_of(rows: list[ModeRow]) -> list[int]:
    """Mode of the model that each is matched with, 0 the lowest."""
    return [row.partner - 1 for row in rows]


def draw_mac(modal: Modal, shapes, rows):
    """Figure of the MAC matrix."""
    values = shapes["at_channels"].values, shapes["frequency"].values
    return plots.plot_mac(modal.data, *values, partners=partners_of(rows))


def draw_shapes(modal: Modal, shapes, rows):
    """Figure of the shapes along the structure."""
    values = shapes["at_points"].values, shapes["frequency"].values
    return plots.plot_mode_shapes(
        modal.data,
        *values,
        sensors=modal.points.of(modal.dofs),
        nodes=modal.points.nodes,
        partners=partners_of(rows),
    )
