"""Identified modes: the section [modal], what is read, and what a model makes of them."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pymc as pm
import xarray as xr
from pydantic import model_validator

from pymc_features import plots
from pymc_features._checks import listed
from pymc_features.exceptions import ModalMatchWarning, PriorWarning
from pymc_features.likelihoods import LIKELIHOODS, Likelihood
from pymc_features.modal import ModalData, ModalFeature, match_modes, merge_setups, modes
from pymc_features.modal.feature import checked_parameters
from pymc_features.modal.files import read_modal
from pymc_features.modal.files.nodes import read_nodes
from pymc_features.modal.identified import identified
from pymc_features.update.config.entries import Vector
from pymc_features.update.config.keys import demand, named_key, refuse, shown
from pymc_features.update.config.sections import Names, Section, key
from pymc_features.update.kinds import base
from pymc_features.update.kinds.base import QUANTILES, KindOfData, Points, Verdict, kinds_of, table
from pymc_features.update.plausibility.findings import of_modes
from pymc_features.update.templates.numbers import Scale, fixed

MODAL = Likelihood(
    "MODAL",
    "errors of ln f Gaussian, 1 - MAC as the feature of Eq. (3), modes matched at every evaluation",
    "C9",
    takes=(),
)
SCALE = "the name of a prior or a number, one or one for each mode"
ALONE_WITHOUT = {  # keys that mean nothing where only modes are compared, and why
    "record processing likelihood": "Identified modes need none.",
    "report.natural_frequencies report.quantities": "The report has the frequencies of [modal], and no "
    "responses.",
}
WITHOUT_SHAPES = {"shapes": None, "channels": (), "shape_sd": None}
SPARE = 3  # modes beyond those identified, among which the likelihood may choose
BEYOND = 1.2  # of the highest identified frequency: modes above it are not in tables
MATCHED_DRAWS = 500
HERTZ = Scale(1.0, "Hz")
MOST = 0.5  # share of the draws without a partner that is said
WIDTH = 3.29  # standard deviations between 5 and 95 % of a normal distribution
APART = 5.0  # standard deviations between an identified frequency and that of the model
ALONE = 0.95  # share of the draws in which a mode takes the same partner
COLUMNS = ("mode", "measured", "5 %", "50 %", "95 %", "off", "MAC", "5-95 %", "partner")
IDENTIFIED = ("identified mode", "frequency [Hz]", "standard deviation [Hz]", "damping [%]")
MEANING = (
    "Frequencies in Hz: as measured, and 5, 50 and 95 % of the mode of the model that each is matched with; "
    "how far its median is off; the MAC of the two shapes with its interval; and the number of that mode, f1 "
    "being the lowest. A partner is within three standard deviations of the frequency, and has a "
    "MAC of at least 0.5."
)


class ModalSection(Section):
    """Which modes were identified, where on the structure, and how well the model is to meet them."""

    file: str | None = key("a file with identified modes", None)
    files: list[str] | None = key("a list of files, two or more, one for each set-up", None, min_length=2)
    references: Names | None = key("the names of the channels that several set-ups have", None)
    names: dict[str, str] | None = key("a table of quantities, such as omega, to names in the files", None)
    modes: list[int] | None = key("a list of numbers of modes in the file, 1 the first", None, min_length=1)
    channels: dict[str, int] | None = key(
        "a table of channel names to degrees of freedom, 0 next to the base", None, min_length=1
    )
    scale: dict[str, float] | None = key("a table of channel names to factors, -1.0 inverts one", None)
    shapes: bool = key("true or false, whether shapes are compared", True)
    labels: list[str | int] | None = key(
        "a list with a name for each mode, equal for several identifications of one", None, min_length=1
    )
    n_modes: int | None = key("the number of modes of the structure to choose from, positive", None, ge=1)
    sigma_f: Vector = key(f"{SCALE}, the error of the model in ln f", unit="-")
    sigma_phi: Vector | None = key(f"{SCALE}, the scale of the root of 1 - MAC", None, unit="-")
    sigma_zeta: Vector | None = key(f"{SCALE}, the error of the model in ln zeta", None, unit="-")
    density: Literal["EXP", "TN", "NORMAL"] | float = key(
        '"EXP", "TN", "NORMAL" or degrees of freedom, positive', "EXP"
    )
    nodes: str | None = key("a CSV file with columns dof or name, x, y, z", None)

    @model_validator(mode="after")
    def one_source(self):
        if (self.file is None) == (self.files is None):
            raise ValueError("must have one of the keys `file` and `files`, got both or neither")
        if self.references is not None and self.files is None:
            raise ValueError("must have `references` only with `files`, got them with `file`")
        if isinstance(self.density, float) and self.density <= 0.0:
            raise ValueError(f"must have positive degrees of freedom as `density`, got {self.density:g}")
        return self


class ModeRow(NamedTuple):
    """One identified mode and its partners in the draws."""

    name: str  # its number in the file, and its label
    measured: float  # [Hz]
    model: tuple[float, float, float]  # 5, 50 and 95 % of the frequency of its partner [Hz]
    mac: tuple[float, float, float]  # 5, 50 and 95 %; NaN without a shape
    partner: int  # mode of the model that most draws take, 1 the lowest
    share: float  # of the draws that take it
    strangers: float  # share of the draws in which it has no partner

    @property
    def off(self) -> float:
        return self.model[1] / self.measured - 1.0

    def deviation(self, sd: float) -> float:
        """How many standard deviations the median of the model is off, if that of the measurement is `sd`."""
        low, middle, high = self.model
        return (middle - self.measured) / float(np.hypot(sd, (high - low) / WIDTH))

    @property
    def has_partner(self) -> bool:
        return self.strangers <= MOST

    @property
    def cells(self) -> tuple[str, ...]:
        """Texts of the row, in the order of `COLUMNS`."""
        low, middle, high = self.mac
        of_shape = ("", "") if np.isnan(middle) else (f"{middle:.3f}", f"{low:.3f}-{high:.3f}")
        quantiles = fixed(self.model, (self.model[2] - self.model[0]) / WIDTH, HERTZ)
        numbers = f"{self.measured:.4g}", *quantiles, f"{100.0 * self.off:+.2f} %"
        return self.name, *numbers, *of_shape, f"f{self.partner}" if self.has_partner else "none"


@dataclass(frozen=True)
class Modal(KindOfData):
    """Identified modes, at the channels that are compared."""

    asked: ModalSection  # how they are compared
    data: ModalData  # those that are compared, with real shapes at the channels
    dofs: list[int]  # degree of freedom of each channel
    source: str  # where they come from
    n_modes: int  # modes of the structure to choose from
    numbers: list[int]  # of each in its file, 1 the first
    labels: list  # which mode each is of; `numbers` if they are all of different ones
    nodes: Points | None = None  # what is drawn, of a file
    is_fitted: bool = True  # false of those in channels of ambient vibration, whose spectra are fitted

    key, section = "modal", ModalSection
    own = (MODAL,)
    likelihoods = [MODAL.name]

    @classmethod
    def check_sections(cls, config):
        if config.data is None:
            for keys, words in ALONE_WITHOUT.items():
                refuse(config, keys, f"without [data], got it. {words}")
        demand(
            config.data is None or config.likelihood is None or "ABC" not in config.likelihood.kinds,
            "`likelihood.kinds` must not have ABC with [modal], for a tolerance on responses says nothing of "
            "modes. Leave one of them out.",
        )

    @classmethod
    def read(cls, problem):
        section, folder, structure = problem.config.modal, problem.folder, problem.expected
        files = [section.file] if section.files is None else section.files
        source = ", ".join(Path(file).name for file in files)
        with named_key("modal", source="file"):
            setups = [read_modal(folder / file, names=section.names) for file in files]
        with named_key("modal", setups="files", channels="references"):
            data = setups[0] if section.files is None else merge_setups(setups, section.references)
        numbers = list(range(1, len(data) + 1)) if section.modes is None else section.modes
        demand(
            len(set(numbers)) == len(numbers) and {*numbers} <= {*range(1, len(data) + 1)},
            f"`modal.modes` must be different numbers from 1 to {len(data)}, the modes of {source}, got "
            f"{shown(numbers)}. 1 is the first.",
        )
        data = data.select([number - 1 for number in numbers])
        labels = section.labels or (numbers if data.labels is None else list(data.labels))
        what = f"a name for each of the {len(data)} modes, got {len(labels)}."
        demand(len(labels) == len(data), f"`modal.labels` must have {what}")
        data, dofs = at_channels(section, data, structure, source)
        if labels is numbers:  # but for modes that were found twice
            found = identified(data)
            labels = [numbers[found.labels[g]] for g in found.groups.argmax(axis=0)]
        n = len(dict.fromkeys(map(str, labels)))
        advice, is_known = "0.01 is an error of one per cent.", data.frequency_sd is not None
        for name, can_be_zero in (("sigma_f", is_known), ("sigma_phi", False), ("sigma_zeta", False)):
            value, of_each = getattr(section, name), (n, "modes", advice)
            base.check_positive(f"modal.{name}", value, problem.priors, *of_each, can_be_zero=can_be_zero)
        what = f"`modal.sigma_zeta` must be left out without damping ratios, {source} has none."
        demand(section.sigma_zeta is None or data.damping_ratios is not None, what)
        nodes = None
        if dofs and section.nodes is not None:
            with named_key("modal", nodes="modal.nodes"):
                channels = dict(zip(data.channels, dofs, strict=True))
                nodes = Points(*read_nodes(folder / section.nodes, channels, structure.n_dof))
        most = most_modes(structure)
        n_modes = min(most, n + SPARE) if section.n_modes is None else section.n_modes
        demand(
            n <= n_modes <= most,
            f"`modal.n_modes` must be from the {n} modes identified to the {most} of the structure, got "
            f"{n_modes}. Leave it out, or modes by `modal.modes`.",
        )
        for sentence in of_modes(data.frequencies, problem.prior):
            warnings.warn(sentence, PriorWarning, stacklevel=2)
        return cls(section, data, dofs, source, n_modes, numbers, labels, nodes)

    @property
    def names(self) -> list[str]:
        """What each is called in tables: its number, and its label if it has one."""
        pairs = zip(self.numbers, self.labels, strict=True)
        are_same = self.labels == self.numbers
        return [str(number) if are_same else f"{number} ({label})" for number, label in pairs]

    @property
    def used(self):
        return f"{len(self.data)} identified mode{'s' if len(self.data) > 1 else ''}"

    @property
    def sentence(self) -> str:
        at = f" at {len(self.dofs)} channels" if self.dofs else " without shapes"
        return f"{self.used.replace('identified ', '')}{at} from {self.source}"

    @property
    def band(self):
        return 0.0, BEYOND * self.data.frequencies.max()

    @property
    def placed(self):
        return dict(zip(self.data.channels or [], self.dofs, strict=True))

    def prints(self):
        data = self.data
        found = {"frequencies": data.frequencies, "sd": data.frequency_sd, "shapes": data.shapes}
        if self.asked.sigma_zeta is not None:
            found |= {"damping": data.damping_ratios, "damping_sd": data.damping_sd}
        if self.asked.density == "NORMAL":
            found["shape_sd"] = data.shape_sd
        return base.printed({f"modal_{name}": values for name, values in found.items()})

    def declare(self, problem, likelihood, structure, values, tolerance):
        """Add the modes; where residuals of responses decide the width, as a factor of the prior."""
        density, labels = self.asked.density, [str(label) for label in self.labels]
        with named_key("modal", n_modes="modal.n_modes"):
            found = modes(structure, self.n_modes, sensors=self.dofs or None)
            scales = self.variables(likelihood, values)
            if likelihood in LIKELIHOODS and LIKELIHOODS[likelihood].calibrates:
                data = identified(self.data, labels, damping="sigma_zeta" in scales)
                f, phi, zeta = map(scales.get, ("sigma_f", "sigma_phi", "sigma_zeta"))
                terms = checked_parameters(found, data, f, phi, density, zeta)
                pm.Potential("modal", pm.logp(ModalFeature.dist(*terms), data.values).sum())
            else:
                ModalFeature("modal", found, observed=self.data, labels=labels, density=density, **scales)

    def predict(self, problem, likelihood, model, idata):
        return {"matched": self.matched(problem, idata["posterior"].to_dataset())}

    def matched(self, problem, posterior: xr.Dataset, **limits) -> xr.Dataset:
        """Which mode of the model each identified one is matched with, of some draws; see `match_modes`.

        `label` is what each is called, `partner` that of each in most draws, 0 if it has none.
        """
        model = base.declare(problem.with_data(self), MODAL.name)
        found = match_modes(base.thinned(posterior, MATCHED_DRAWS), name="modal", model=model, **limits)
        labels = list(map(str, self.labels))  # several identifications of one mode stand together
        order = sorted(range(len(labels)), key=lambda k: labels.index(labels[k]))
        found = found.rename(mode="identified").assign_coords(identified=[self.numbers[k] for k in order])
        found = found.sel(identified=self.numbers)
        found = found.assign(has_partner=found["has_partner"].astype(np.int8))
        partners = np.array([row.partner if row.has_partner else 0 for row in self.rows(found)])
        return found.assign(partner=("identified", partners), label=("identified", self.names))

    def rows(self, matched) -> list[ModeRow]:
        """Every identified mode under one likelihood, from the group `matched`."""
        found = []
        for k, (name, measured) in enumerate(zip(self.names, self.data.frequencies.tolist(), strict=True)):
            one = matched.isel(identified=k)
            values, counts = np.unique(one["model_mode"].values, return_counts=True)
            f, mac = (np.quantile(one[key].values, QUANTILES).tolist() for key in ("frequency", "mac"))
            most, share = 1 + int(values[counts.argmax()]), float(counts.max() / counts.sum())
            strangers = 1.0 - float(one["has_partner"].mean())
            found.append(ModeRow(name, measured, tuple(f), tuple(mac), most, share, strangers))
        return found

    def shared(self, problem):
        """What was identified: frequency, its standard deviation [Hz], and shape (identified, channel)."""
        data, coords = self.data, {"identified": self.numbers}
        found = {"frequency": ("identified", data.frequencies, {"units": "Hz"})}
        if data.frequency_sd is not None:
            found["frequency_sd"] = "identified", data.frequency_sd, {"units": "Hz"}
        if data.shapes is not None:
            found["shape"] = ("identified", "channel"), data.shapes
            coords |= {"channel": list(data.channels), "dof": ("channel", self.dofs)}
        attrs = {"source": self.source, "n_modes": self.n_modes}
        return {"identified": xr.Dataset(found, coords, attrs)}

    def told(self):
        yield f"modes: {self.sentence}"

    def check(self, problem, path):
        """Compare them with what the priors expect, and draw both where there are shapes.

        Partners are judged by their shapes: frequencies are what is to be updated.
        """
        names = base.names_for(problem.with_data(self), MODAL.name)
        draws = base.draws_of_priors(problem, names, base.MODAL_DRAWS)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModalMatchWarning)  # the sentences say it
            matched = self.matched(problem, draws, deviations=np.inf)
        rows = self.rows(matched)
        cells = [row.cells for row in rows]
        yield table("modes", "modes", "Identified modes [Hz], and the model under the priors", COLUMNS, cells)
        yield from modes_verdict(rows).sentences
        outside = [row for row in rows if not row.model[0] <= row.measured <= row.model[2]]
        if outside:
            named = ", ".join(f"{row.name} ({row.measured:.4g} Hz)" for row in outside)
            yield f"Outside of what the priors expect (5 to 95 %): {named}."
        part = {"mode_shapes": base.mode_shapes(problem, draws), "matched": matched}
        if figures := self.figures_of(problem, part, ""):
            yield base.drawn_to(path, [*figures.values()][-1])

    def tables(self, problem, result):
        data = self.data
        columns = [self.names, [f"{f:.4g}" for f in data.frequencies]]
        for values, factor in ((data.frequency_sd, 1.0), (data.damping_ratios, 100.0)):
            numbers = np.full(len(data), np.nan) if values is None else factor * values
            columns.append(["" if np.isnan(value) else f"{value:.2g}" for value in numbers])
        note = f"There are {self.sentence}. "
        if self.placed:
            at = ", ".join(f"{name} ({dof})" for name, dof in self.placed.items())
            note += f"The channels and their degrees of freedom are {at}. "
        note += f"Each is matched with one of the {self.n_modes} lowest modes of the structure."
        if self.dofs and not self.is_drawn(problem) and self.is_fitted:
            note += " Name a file with its nodes as `modal.nodes` to see the shapes drawn."
        kinds = {kind: self.rows(result[f"{kind}/matched"]) for kind in kinds_of(result)}
        cells = [(kind, *row.cells) for kind, of_kind in kinds.items() for row in of_kind]
        return [
            table("identified", "data", "Identified modes", IDENTIFIED, zip(*columns, strict=True), note),
            table("modes", "modes", "Identified modes [Hz]", ("likelihood", *COLUMNS), cells, MEANING),
        ]

    def is_drawn(self, problem) -> bool:
        """Whether the places of the shapes are known: storeys, or nodes of a file."""
        return self.nodes is not None or problem.structure.has_storeys

    def figures_of(self, problem, part, kind):
        if not self.dofs:
            return {}
        points = base.points_of(problem)
        at = points.of(self.dofs)
        kept = {"mode": slice(self.n_modes)}
        shapes, frequencies = (part["mode_shapes"][key].isel(kept).values for key in ("shape", "frequency"))
        partners = [row.partner - 1 for row in self.rows(part["matched"])]
        found = {"mac": lambda: plots.mac(self.data, shapes[..., at], frequencies, partners=partners)}
        if self.is_drawn(problem):
            places = {"sensors": at, "nodes": points.nodes, "partners": partners}
            found["shapes"] = lambda: plots.mode_shapes(self.data, shapes, frequencies, **places)
        return found

    def verdict(self, problem, result, kind):
        """Whether all have a partner in the model, of a close frequency where they are not fitted."""
        rows = self.rows(result[f"{kind}/matched"])
        found = modes_verdict(rows)
        if self.is_fitted:
            return found
        off = [abs(row.deviation(sd)) for row, sd in zip(rows, self.data.frequency_sd, strict=True)]
        far = [(z, row) for z, row in zip(off, rows, strict=True) if z > APART and row.has_partner]
        if not far:
            return found
        worst, row = max(far)
        sentence = (
            f"The identified mode {row.name} lies {worst:.0f} standard deviations from that of the "
            "model: the structure cannot have these frequencies together, and the intervals, which "
            "take it for right, are too narrow. Let more of it be uncertain."
        )
        return Verdict([sentence, *found.sentences], False)


def most_modes(structure) -> int:
    return structure.n_dof if structure.has_storeys else structure.n_modes


def modes_verdict(rows: list[ModeRow]) -> Verdict:
    """What to think of the fit of identified modes, and whether all have a partner."""
    strangers = [row for row in rows if not row.has_partner]
    partners, n, told = [row for row in rows if row.has_partner], len(rows), []
    for row in strangers:
        of_shape = "" if np.isnan(row.mac[1]) else f", MAC {row.mac[1]:.2f}"
        told.append(
            f"The model has no partner for the identified mode {row.name} ({row.measured:.4g} Hz): the best "
            f"that is left is at {row.model[1]:.4g} Hz{of_shape}."
        )
    if partners:
        some = f"{len(partners)} of {n} identified modes" if strangers else f"all {n} identified modes"
        off = max(partners, key=lambda row: abs(row.off))
        sentence = (
            f"The model has a partner for {'the identified mode' if n == 1 else some}: the median frequency "
            f"is off by at most {100.0 * abs(off.off):.2g} % (mode {off.name})"
        )
        if shaped := [row for row in partners if not np.isnan(row.mac[1])]:
            worst = min(shaped, key=lambda row: row.mac[1])
            sentence += f", the MAC is at least {worst.mac[1]:.3f} (mode {worst.name})"
        told.append(f"{sentence}.")
    for row in rows:
        if row.share < ALONE:
            told.append(
                f"The identified mode {row.name} takes f{row.partner} in {100.0 * row.share:.0f} % of the "
                "draws, and others in the rest: they change places, or the data cannot tell them apart."
            )
    return Verdict(told, not strangers)


def at_channels(section, data, structure, source) -> tuple[ModalData, list[int]]:
    """The modes at the channels that are compared, in their sense, and their places; or frequencies alone."""
    if data.shapes is None or not section.shapes:
        of_shapes = ("channels", "scale", "sigma_phi", "nodes") + ("density",) * (not section.shapes)
        asked = [*filter(section.model_fields_set.__contains__, of_shapes), None]
        why = f"{source} has frequencies alone" if section.shapes else "It says shapes = false"
        demand(len(asked) == 1, f"`modal.{asked[0]}` must be left out without shapes, got it. {why}.")
        return replace(data, **WITHOUT_SHAPES), []
    demand(
        section.channels is not None,
        "`modal.channels` must be given with shapes: a table of channel names to degrees of freedom. "
        f"{source} has {listed(data.channels)}. Or set shapes = false.",
    )
    dofs = list(section.channels.values())
    base.check_dofs("modal.channels", dofs, structure.n_dof)
    demand(
        len(dofs) > 1,
        "`modal.channels` must be two or more, for a shape of one entry says nothing, got one. Add channels, "
        "or set shapes = false.",
    )
    with named_key("modal"):
        data = data.select(channels=list(section.channels))
    scale = section.scale or {}
    for name, factor in scale.items():
        demand(
            name in data.channels and factor != 0.0,
            "`modal.scale` must have factors that are not zero for channels that are compared "
            f"({', '.join(data.channels)}), got {shown({name: factor})}.",
        )
    demand(
        section.sigma_phi is not None,
        f"`modal.sigma_phi` must be given with the shapes of {source}, got none. Pass the scale of the root "
        "of 1 - MAC, about 0.05, or set shapes = false.",
    )
    factors = np.array([scale.get(name, 1.0) for name in data.channels])
    sd = None if data.shape_sd is None else data.shape_sd * np.abs(factors)
    return replace(data, shapes=data.shapes * factors, shape_sd=sd), dofs
