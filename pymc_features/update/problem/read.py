"""A configuration with everything it refers to, checked before anything is sampled."""

import hashlib
import json
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pymc_features.exceptions import ConfigError, PriorWarning
from pymc_features.storage import fingerprint
from pymc_features.update.config.document import Config, read_config
from pymc_features.update.config.entries import Matrix, priors_in
from pymc_features.update.config.messages import shown
from pymc_features.update.config.priors import Prior
from pymc_features.update.plausibility.findings import of_modes, of_priors
from pymc_features.update.plausibility.prior_modes import PriorModes, prior_modes
from pymc_features.update.problem.ambient import MeasuredAmbient, compared_modes, read_ambient
from pymc_features.update.problem.channels import Measured, named_key, read_measured
from pymc_features.update.problem.cyclic import read_cyclic
from pymc_features.update.problem.events import Event, read_events
from pymc_features.update.problem.kinds import AMBIENT, KINDS, MODAL
from pymc_features.update.problem.likelihood import check_errors, check_gaps
from pymc_features.update.problem.modes import MeasuredModes, read_modes
from pymc_features.update.problem.structure import StructureOf, modes_of

#: Keys that change no draw, or, as the tolerance, those of ABC alone.
WITHOUT_EFFECT = (
    "report",
    "modal.nodes",
    "likelihood.kinds",
    "likelihood.epsilon",
    "sampler.cores",
    "events.folder",  # each event is recognised by its data
    "events.pattern",
    "events.files",
)
BEYOND = 1.2  # of the highest identified frequency: modes above it are not in tables


@dataclass(frozen=True)
class Problem:
    """What is updated with what.

    Attributes
    ----------
    path : Path
        The configuration file.
    text : str
        What it says.
    config : Config
        The same, validated.
    raw : dict
        The same, as it was parsed.
    measured : Measured or None
        Motion of the base, and measured responses; of several events those of the last one. None if the
        excitation was not measured.
    structure : StructureOf
        Values of the priors to a structure.
    priors : dict
        Names to `Prior`, in the order of the file.
    dofs : list of int
        Degree of freedom of each sensor.
    given_modes, ambient : MeasuredModes or None, MeasuredAmbient or None
        Identified modes of [modal]; response to forces that nobody measured.
    events : tuple of Event
        In their order; empty if there is one only, without [events].
    """

    path: Path
    text: str
    config: Config
    raw: dict
    measured: Measured | None
    structure: StructureOf
    priors: dict[str, Prior]
    dofs: list[int]
    given_modes: MeasuredModes | None = None
    events: tuple[Event, ...] = ()
    ambient: MeasuredAmbient | None = None

    @property
    def is_cyclic(self) -> bool:
        """Whether it is a cyclic test, which has forces and no motion."""
        return self.config.cyclic is not None

    @property
    def quantity(self) -> str:
        """The quantity of the response that is compared."""
        return "restoring_force" if self.is_cyclic else self.config.data.quantity

    def at(self, event: Event) -> "Problem":
        """The problem of one event alone; identified modes count once, with the first."""
        modes = self.given_modes if event is self.events[0] else None
        return replace(self, measured=event.measured, events=(), given_modes=modes)

    @property
    def modal(self) -> MeasuredModes | None:
        """Identified modes; of ambient vibration those that the channels have, which are only compared."""
        return self.given_modes if self.ambient is None else self.ambient.modes

    @property
    def of_modes(self) -> "Problem":
        """The problem of identified modes alone, with which those of the model are compared."""
        if self.ambient is None:
            return self
        config = self.config.model_copy(update={"modal": compared_modes(self.modal.data)})
        return replace(self, config=config, given_modes=self.modal, ambient=None)

    @property
    def events_sha256(self) -> str:
        """What all events are recognised by; empty without any."""
        prints = [[event.name, *prints_of(event.measured).values()] for event in self.events]
        return hashlib.sha256(json.dumps(prints).encode()).hexdigest() if prints else ""

    @property
    def asked(self) -> list[str]:
        """Likelihoods of the file: that of spectra, or of modes alone, where it has no excitation."""
        if self.ambient is not None:
            return [AMBIENT.name]
        return [MODAL.name] if self.measured is None else self.config.likelihood.kinds

    @property
    def kinds(self) -> list[str]:
        """Likelihoods in the order they are sampled: ABC may need EXP, and CAL what it calibrates."""
        needed = [KINDS[kind].calibrates for kind in self.asked]
        kinds = dict.fromkeys([*self.asked, *filter(None, needed)])
        return sorted(kinds, key=lambda kind: kind == "ABC" or bool(KINDS[kind].calibrates))

    @property
    def reported(self) -> list[str]:
        """Likelihoods of the report in their order: first those whose width the residuals decide."""
        return sorted(self.asked, key=lambda kind: not KINDS[kind].calibrates)

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies [Hz] that the processing leaves; without responses those up to the highest mode."""
        if self.ambient is not None:
            return float(self.ambient.bands.min()), float(self.ambient.bands.max())
        if self.measured is None:
            return 0.0, BEYOND * self.modal.data.frequencies.max()
        kept, nyquist = self.config.processing.band_pass, 0.5 / self.measured.step
        if kept is None:
            return 0.0, nyquist
        return kept.low or 0.0, min(kept.high or nyquist, nyquist)

    def unit(self, name: str) -> str:
        """Unit of a prior, from where it is used."""
        return self.config.uses()[name][0][1]

    def settings(self) -> dict:
        """All that determines the draws, flat, for the folder they are kept in."""
        flat = dict(flattened(self.raw))
        kept = {k: v for k, v in flat.items() if not k.startswith(WITHOUT_EFFECT)}
        if self.measured is not None and not self.events:  # events may be added
            kept |= prints_of(self.measured)
        if self.ambient is not None:
            arrays = {"channels": self.ambient.channels.values, "bands": self.ambient.bands}
            kept |= {f"{k}_sha256": fingerprint(np.ascontiguousarray(v)) for k, v in arrays.items()}
        elif self.modal is not None:
            data = self.modal.data
            arrays = {"frequencies": data.frequencies, "sd": data.frequency_sd, "shapes": data.shapes}
            for name, values in arrays.items():
                if values is not None:
                    kept[f"modal_{name}_sha256"] = fingerprint(np.ascontiguousarray(values))
        for file in sorted(files_of(self.config.structure)):
            digest = hashlib.sha256((self.path.parent / file).read_bytes())
            kept[f"{file}_sha256"] = digest.hexdigest()
        return json.loads(json.dumps(kept, default=str))


def prints_of(measured: Measured) -> dict[str, str]:
    """What measured responses are recognised by."""
    return {
        "base_sha256": fingerprint(measured.record.inputs[0]),
        "base_interpolation": measured.record.interpolation,
        "channels_sha256": fingerprint(np.ascontiguousarray(measured.channels.values)),
    }


def flattened(table, prefix=""):
    """Dotted keys and values of a parsed file."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from flattened(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def files_of(section) -> set[str]:
    """Files with matrices that a section names."""
    values = [getattr(section, name) for name in type(section).model_fields]
    found = [v for value in values for v in (value if isinstance(value, list) else [value])]
    return {value.file for value in found if isinstance(value, Matrix)}


def read_problem(path) -> Problem:
    """Read a configuration file and everything it refers to.

    Parameters
    ----------
    path : path
        Of the configuration; other files are relative to its folder.

    Returns
    -------
    Problem

    Raises
    ------
    FileNotFoundError, ConfigError, DatasetUnavailableError
        Whatever is wrong with it; the message names the key.

    Warns
    -----
    PriorWarning
        If the priors expect what no structure has, or what the data contradict.
    ChannelWarning
        If a channel is suspicious.
    """
    path = Path(path)
    config, raw = read_config(path)
    priors = {
        name: Prior(f"priors.{name}", section.distribution, section.arguments)
        for name, section in config.priors.items()
    }
    structure = StructureOf(config.structure, path.parent)
    with named_key("structure"):
        expected = structure(**{n: priors[n].median for n in structure.names})
        prior = None if config.cyclic is not None else expected_modes(structure, priors, expected)
    for sentence in (
        [] if prior is None else of_priors(prior, {n: uses[0][1] for n, uses in config.uses().items()})
    ):
        warnings.warn(sentence, PriorWarning, stacklevel=2)
    measured, dofs, modal, events, ambient = None, [], None, (), None
    if config.cyclic is not None:
        measured, dofs = read_cyclic(config, path.parent), [0]
        check_errors(config, priors, len(dofs))
    elif config.ambient is not None:
        dofs = checked_dofs(config, expected.n_dof)
        ambient = read_ambient(config, path.parent, dofs, expected)
        check_positive_priors("ambient", config.ambient, ("force", "error"), priors)
    elif config.data is not None:
        dofs = checked_dofs(config, expected.n_dof)
        if config.events is None:
            measured = read_measured(config, path.parent, prior)
        else:
            events = read_events(config, path.parent, prior)
            measured = events[-1].measured
        check_errors(config, priors, len(dofs))
        for one in [event.measured for event in events] or [measured]:
            check_gaps(config, one)
    if config.modal is not None:
        check_positive_priors("modal", config.modal, ("sigma_f", "sigma_phi"), priors)
        modal = read_modes(config.modal, path.parent, expected)
        for sentence in of_modes(modal.data.frequencies, prior):
            warnings.warn(sentence, PriorWarning, stacklevel=2)
    frequencies = config.report.natural_frequencies
    if frequencies is not None and not (frequencies and np.all(np.diff([0.0, *frequencies]) > 0.0)):
        raise ConfigError(
            f"`report.natural_frequencies` must be positive and rise, got {shown(frequencies)}. "
            "Pass them in Hz."
        )
    if "inter_storey_drift" in config.report.quantities and not structure.type.has_storeys:
        raise ConfigError(
            "`report.quantities` must not have inter_storey_drift for a structure without storeys, "
            f"{config.structure.type}. Use relative_displacement."
        )
    text = path.read_text(encoding="utf-8")
    return Problem(path, text, config, raw, measured, structure, priors, dofs, modal, events, ambient)


def expected_modes(structure, priors, expected) -> PriorModes:
    """Modes of draws of the priors; `expected` is the structure at the medians."""
    with np.errstate(all="ignore"):  # the inverse of a tiny mass is no number
        found = modes_of(expected, 1).natural_frequencies
    if not (found.size and np.isfinite(found[0])):
        raise ValueError(
            "masses and stiffnesses must have a natural frequency at the medians of the priors, got none. "
            "Check their units."
        )
    with np.errstate(all="ignore"):
        return prior_modes(
            structure,
            {name: priors[name].draw for name in structure.names},
            expected,
            lambda one: modes_of(one, structure.n_modes),
        )


def checked_dofs(config, size) -> list[int]:
    """A degree of freedom for each sensor."""
    sensors, dofs = config.data.sensors, config.data.dofs
    if dofs is None:
        if len(sensors) != size:
            raise ConfigError(
                f"`data.sensors` must be one for each of the {size} degrees of freedom of the structure, got "
                f"{len(sensors)}. Say by `data.dofs` where they are."
            )
        return list(range(size))
    if len(dofs) != len(sensors):
        raise ConfigError(
            f"`data.dofs` must have one value for each of the {len(sensors)} sensors, got {len(dofs)}."
        )
    if len(set(dofs)) < len(dofs) or not all(0 <= dof < size for dof in dofs):
        raise ConfigError(
            f"`data.dofs` must be different numbers from 0 to {size - 1}, got {shown(dofs)}. 0 is next "
            "to the base."
        )
    return dofs


def check_positive_priors(section, asked, names, priors) -> None:
    """Scales have priors of positive numbers."""
    for name in names:
        for item in priors_in(getattr(asked, name)):
            if (middle := priors[item.prior].median) <= 0.0:
                raise ConfigError(
                    f"`{section}.{name}` must be positive, got the prior `priors.{item.prior}` with the "
                    f"median {middle:g}. Take a distribution of positive numbers."
                )
