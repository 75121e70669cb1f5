"""The section [ambient]: how the response to forces that nobody measured is compared."""

from typing import Annotated, Any, Literal

from pydantic import PlainValidator, model_validator

from pymc_features.exceptions import ConfigError
from pymc_features.update.config.entries import Vector
from pymc_features.update.config.sections import Section, key, window

DENSITY = "the name of a prior or a positive number in {}, one or one for each band"
UNITS = {"dofs": "N^2/Hz", "modes": "N^2/kg/Hz"}  # of the forces
ERROR = "m^2/s^3"  # (m/s^2)^2/Hz


def pairs(value):
    """Pairs of frequencies [Hz], or what finds them."""
    if value == "auto":
        return value
    if not isinstance(value, list) or not value:
        raise ValueError('must be "auto" or a list of pairs [from, to] in Hz')
    return [window(item) for item in value]


class Ambient(Section):
    """Spectral densities of forces and errors, and the frequencies that are compared."""

    bands: Annotated[Any, PlainValidator(pairs)] = key('"auto" or a list of pairs [from, to] in Hz', "auto")
    force: Vector = key(DENSITY.format("N^2/Hz"))
    error: Vector = key(DENSITY.format("(m/s^2)^2/Hz"))
    forces: Literal["dofs", "modes"] = key('"dofs" or "modes", where they act', "dofs")

    @model_validator(mode="after")
    def one_for_each_band(self):
        """Numbers are positive, and lists fit the bands."""
        for name in ("force", "error"):
            value = getattr(self, name)
            numbers = [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, float)]
            if any(number <= 0.0 for number in numbers):
                raise ValueError(f"must have positive spectral densities as `{name}`, got {min(numbers):g}")
            if isinstance(value, list) and self.bands == "auto":
                raise ValueError(f'must list `bands` where `{name}` is a list, got "auto"')
            if isinstance(value, list) and len(value) != len(self.bands):
                raise ValueError(
                    f"must have one value or one for each of the {len(self.bands)} bands as `{name}`, got "
                    f"{len(value)}"
                )
        return self

    def parameters(self):
        """Key, unit and value of what may be random."""
        yield "ambient.force", UNITS[self.forces], self.force
        yield "ambient.error", ERROR, self.error


def check_ambient(config) -> None:
    """Other sections say nothing that means nothing where the excitation was not measured.

    Raises
    ------
    ConfigError
        If one does; the message names the key.
    """
    if config.ambient is None:
        raise ConfigError(
            '`ambient` must be given with `data.excitation = "ambient"`: a table with `force` and `error`, '
            "the spectral densities of forces and errors."
        )
    for name in ("record", "likelihood", "events", "modal"):
        if name in config.model_fields_set:
            raise ConfigError(
                f'`{name}` must be left out with `data.excitation = "ambient"`, got it. The spectra of the '
                "channels are compared, as [ambient] says."
            )
    asked = config.processing
    of_data = {"base": config.data.base, "gaps": None if config.data.gaps == "refuse" else config.data.gaps}
    for section, given in (
        ("data", of_data),
        ("processing", {name: getattr(asked, name) for name in ("band_pass", "compare", "check_band")}),
        ("report", {"natural_frequencies": config.report.natural_frequencies}),
        ("report", {"quantities": config.report.quantities or None}),
    ):
        for name, value in given.items():
            if value is not None:
                raise ConfigError(
                    f'`{section}.{name}` must be left out with `data.excitation = "ambient"`, got it. '
                    f"{ADVICE[name]}"
                )


ADVICE = {
    "base": "The motion of the base is not known, or there is none.",
    "gaps": "Take a part of the record without gaps.",
    "band_pass": "Choose by `ambient.bands` which frequencies are compared.",
    "compare": "Choose by `processing.trim` what is compared.",
    "check_band": "Channels are checked against a base.",
    "natural_frequencies": "Those of the channels are identified and shown.",
    "quantities": "No response is predicted.",
}
