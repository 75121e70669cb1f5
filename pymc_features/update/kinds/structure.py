"""The structure of a configuration, as a function of the values of its priors."""

import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np

from pymc_features import structures
from pymc_features.exceptions import ConfigError
from pymc_features.io import read_matrices
from pymc_features.io.reading.labels import system_of_units
from pymc_features.structures import AffineStructure, Kind
from pymc_features.structures.specimens import DETERIORATIONS, SPECIMENS
from pymc_features.update.config.entries import Matrix, Taper, evaluated, priors_in
from pymc_features.update.config.messages import named_key
from pymc_features.update.config.sections import Section, parameters_of

CATALOGUE = {cls.__name__: cls for cls in (*structures.STRUCTURES, *SPECIMENS)}
PARTS = {cls.__name__: cls for cls in (*structures.DAMPINGS, *DETERIORATIONS)}
MOST_MODES = 10


class StructureOf:
    """Values of the priors, by name, to a structure: random variables in a model, numbers of one draw.

    Its signature lists the names of the priors, so that `posterior_response` finds them.

    Parameters
    ----------
    section : Section
        [structure] of the file.
    folder : path
        Files of matrices are relative to it.
    """

    def __init__(self, section, folder):
        self.section, self.type = section, CATALOGUE[section.type]
        names = {p.prior for _, _, value in parameters_of("", section) for p in priors_in(value)}
        self.names = sorted(names)
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        self.__signature__ = inspect.Signature([inspect.Parameter(name, kind) for name in self.names])
        self.given = {}
        storeys = spread_over_storeys(section, self.type.inputs) if self.type.has_storeys else {}
        for name in self.type.inputs:
            value = storeys.get(name, getattr(section, name))
            value = loaded(value, f"structure.{name}", Path(folder))
            self.given[name] = in_si(value, name, section)
        self.damping_is_constant = not any(
            True for key, _, value in parameters_of("", section) if "damping" in key for _ in priors_in(value)
        )
        self._constant = None

    @property
    def has_modes(self) -> bool:
        """Return whether the structure moves; specimens have forces alone."""
        return self.type not in SPECIMENS

    @property
    def title(self) -> str:
        """What it is."""
        return self.section.type

    @property
    def has_storeys(self) -> bool:
        """Return whether the structure has drifts."""
        return self.type.has_storeys

    @property
    def n_modes(self) -> int | None:
        """Number of modes kept."""
        return getattr(self.section, "n_modes", None)

    def __call__(self, **values):
        """Return the structure."""
        if self._constant is not None:
            return self._constant.with_parameters(evaluated(self.given["theta"], values))
        arguments = {name: built(value, values) for name, value in self.given.items()}
        structure = self.type(**arguments)
        if self.type is AffineStructure and self.damping_is_constant:
            self._constant = structure
        return structure


def in_si(value, name: str, section):
    """Matrices, and lists of them, in kg, N/m and N s/m."""
    if not hasattr(section, "units") or name in ("influence", "theta") or isinstance(value, Section):
        return value
    with named_key("structure"):
        force, length, mass = system_of_units(section.units)
    factor = mass if name.startswith("mass") else force / length
    if factor == 1.0 or value is None:
        return value
    if name.endswith("_terms"):
        return [item if item is None else in_si(item, name.removesuffix("_terms"), section) for item in value]
    return factor * (value if hasattr(value, "shape") else np.asarray(value, dtype=np.float64))


def loaded(value, key, folder):
    """A value of the file with matrices read."""
    if isinstance(value, Matrix):
        return read_matrix(value, key, folder)
    if isinstance(value, list | tuple):
        return [loaded(item, f"{key}[{i}]", folder) for i, item in enumerate(value)]
    return value


def read_matrix(asked: Matrix, key, folder):
    """One matrix of a file."""
    with named_key(key, path="file"):
        found = read_matrices(folder / asked.file)
    if asked.name is None and len(found) == 1:
        return next(iter(found.values()))
    if asked.name not in found:
        raise ConfigError(
            f"`{key}.name` must be one of the matrices {', '.join(sorted(found))} of {asked.file}, got "
            f"{asked.name!r}."
        )
    return found[asked.name]


def built(value, values):
    """A damping, degradation or pinching as an object, anything else with values in place of names."""
    if isinstance(value, Section):
        part = PARTS[value.type]
        return part(**{name: evaluated(getattr(value, name), values) for name in part.inputs})
    return evaluated(value, values)


def modes_of(structure, n_modes):
    """The lowest modes of a structure."""
    if structure.has_storeys:
        return structure.modes()
    return structure.modes(min(n_modes or MOST_MODES, structure.n_modes))


def spread_over_storeys(section, inputs) -> dict:
    """Values of the section that are one for each storey, or one for all, by name.

    Parameters
    ----------
    section : Section
        Of a structure with storeys.
    inputs : dict
        `inputs` of the structure.

    Raises
    ------
    ConfigError
        If a number of values is not `n`, or a taper has no number of storeys to go over.
    """
    given = {name: getattr(section, name) for name, of in inputs.items() if of.kind is Kind.VECTOR}
    lengths = {name: length for name, value in given.items() if (length := length_of(value)) is not None}
    n = section.n if section.n is not None else next(iter(lengths.values()), None)
    for name, length in lengths.items():
        if section.n is not None and length != n:
            raise ConfigError(
                f"`structure.{name}` must have one value or one for each of the n = {n} storeys, got "
                f"{length}. Groups add up to n."
            )
    return {name: spread(name, value, n, section.n is not None) for name, value in given.items()}


def length_of(value) -> int | None:
    """How many storeys a value is for, None if it can be any number."""
    if isinstance(value, Taper):
        value = value.times
    return len(value) if isinstance(value, list | tuple) else None


def spread(name, value, n, every):
    """A taper over n storeys; one value n times if `every` is to have its own; anything else as it is."""
    if not isinstance(value, Taper):
        return [value] * n if every and not isinstance(value, list) else value
    if n is None:
        raise ConfigError(
            f"`structure.{name}` must have a number of storeys to taper over, got neither `n` nor a list of "
            "values. Add n = 42 to [structure]."
        )
    if n < 2 or length_of(value) not in (None, n):
        what = f"{n} storey" if n < 2 else f"{length_of(value)} values of `times` for {n} storeys"
        raise ConfigError(
            f"`structure.{name}` must taper over two storeys or more, with one value of `times` for each or "
            f"for all, got {what}."
        )
    return replace(value, n=n)
