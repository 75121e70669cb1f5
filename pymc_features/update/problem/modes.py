"""From files to the identified modes that a model is compared with."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pymc_features._checks import listed
from pymc_features.exceptions import ConfigError
from pymc_features.modal import ModalData, merge_setups
from pymc_features.modal.files import read_modal
from pymc_features.modal_features.identified import identified
from pymc_features.update.config.messages import shown
from pymc_features.update.problem.channels import named_key
from pymc_features.update.problem.nodes import Points, read_nodes

SPARE = 3  # modes beyond those identified, among which the likelihood may choose


@dataclass(frozen=True)
class MeasuredModes:
    """Identified modes.

    Attributes
    ----------
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

    data: ModalData
    numbers: list[int]
    labels: list
    dofs: list[int]
    n_modes: int
    points: Points | None
    source: str

    @property
    def names(self) -> list[str]:
        """What each is called in tables: its number, and its label if it has one."""
        if self.labels == self.numbers:
            return [str(number) for number in self.numbers]
        return [f"{number} ({label})" for number, label in zip(self.numbers, self.labels, strict=True)]

    @property
    def by_label(self) -> list[int]:
        """`numbers` mode by mode, as `match_modes` lists several identifications of one."""
        labels = list(map(str, self.labels))
        order = sorted(range(len(labels)), key=lambda k: labels.index(labels[k]))
        return [self.numbers[k] for k in order]

    @property
    def sentence(self) -> str:
        """What they are, and where they come from."""
        n, s = len(self.data), len(self.dofs)
        at = f" at {s} channels" if s else " without shapes"
        return f"{n} mode{'s' if n > 1 else ''}{at} from {self.source}"


def read_modes(section, folder: Path, structure) -> MeasuredModes:
    """Read the modes of [modal]; files are relative to `folder`, `structure` is what priors expect.

    Raises
    ------
    ConfigError
        If a file is missing or broken, or modes, channels and structure do not fit; the message names the
        key.

    Warns
    -----
    ModalDataWarning
        What is suspicious about them.
    """
    data, source = read_files(section, folder)
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
    points = points_of(section, data, dofs, folder, structure)
    n_modes = modes_to_choose_from(section, len(dict.fromkeys(map(str, labels))), structure)
    return MeasuredModes(data, numbers, labels, dofs, n_modes, points, source)


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
