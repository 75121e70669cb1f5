"""The number of storeys of [structure], and its values for each of them."""

from dataclasses import replace

from pymc_features.exceptions import ConfigError
from pymc_features.structures import Kind
from pymc_features.update.config.entries import Taper


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
