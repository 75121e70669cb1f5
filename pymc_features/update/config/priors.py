"""Priors by the names of PyMC's continuous distributions; nothing in the file is evaluated."""

import difflib
import inspect
from functools import cached_property

import numpy as np
import pymc as pm
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pymc.distributions import continuous
from pytensor.compile.mode import Mode

from pymc_features._checks import is_number
from pymc_features.update.config.keys import shown

#: Classes of `pymc.distributions.continuous` that stand for families of distributions.
ABSTRACT = ("Continuous", "PositiveContinuous", "UnitContinuous", "CircularContinuous", "BoundedContinuous")
DISTRIBUTIONS = {
    name: value
    for name, value in vars(continuous).items()
    if isinstance(value, type)
    and issubclass(value, pm.Continuous)
    and hasattr(value, "dist")  # not the random variables behind them
    and name not in ABSTRACT
}
_PLAIN = Mode(linker="py", optimizer=None)  # nothing to compile
_ARGUMENTS = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


def arguments_of(name: str) -> list[str]:
    parameters = inspect.signature(DISTRIBUTIONS[name].dist).parameters.values()
    return [p.name for p in parameters if p.kind in _ARGUMENTS]


class Prior(BaseModel):
    """A scalar prior: its distribution, and the distribution's own arguments besides."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)
    distribution: str = Field(description="the name of a continuous distribution of PyMC")

    @field_validator("distribution")
    @classmethod
    def is_known(cls, name):
        if name not in DISTRIBUTIONS:
            close = difflib.get_close_matches(name, DISTRIBUTIONS, n=1)
            hint = f"Did you mean {close[0]}?" if close else f"There are {', '.join(DISTRIBUTIONS)}"
            raise ValueError(f"must be a continuous distribution of PyMC, got {shown(name)}. {hint}")
        return name

    @model_validator(mode="after")
    def is_admissible(self):
        """Refuse what is no argument, what PyMC refuses, a constant, and what is no density."""
        got, known = f"got {self!r}", arguments_of(self.distribution)
        for argument, value in self.model_extra.items():
            if argument not in known:
                named = f"{self.distribution} ({', '.join(known) or 'none'})"
                raise ValueError(f"must have arguments of {named} alone, got `{argument}`")
            numbers = value if isinstance(value, list) and value else [value]
            if not all(is_number(v) and np.isfinite(v) for v in numbers):
                raise ValueError(f"must have finite numbers, got {argument} = {shown(value)}")
        try:
            variable = self.variable()
            if not variable.ndim:
                pm.logp(variable, 0.5).eval(mode=_PLAIN)
                draws = self.draw(8, 0)
                densities = pm.logp(variable, draws).eval(mode=_PLAIN)
        except NotImplementedError:
            raise ValueError(
                f"must be a `distribution` that can be drawn from, no improper one, {got}"
            ) from None
        except Exception as error:  # each distribution has its own ways to refuse
            reason = (str(error) or type(error).__name__).splitlines()[0]
            reason = reason.removeprefix("Domain error in arguments. ").rstrip(".")
            raise ValueError(
                f"must have admissible arguments of {self.distribution}, {got}: {reason}"
            ) from error
        if variable.ndim:
            raise ValueError(f"must be a scalar, {got}. Give each entry its own prior")
        if not np.isfinite(draws).all() or np.ptp(draws) == 0.0:
            raise ValueError(f"must spread over finite values, {got}. Fix it as a number")
        if not np.isfinite(densities).all() or np.min(self.model_extra.get("pdf_points", 0.0)) < 0.0:
            raise ValueError(f"must have a positive and finite density, {got}. Change its arguments")
        return self

    def __repr__(self):
        listed = (f"{k}={v:g}" if is_number(v) else f"{k}=[...]" for k, v in self.model_extra.items())
        return f"{self.distribution}({', '.join(listed)})"

    def variable(self, *name, **shape):
        """A variable, of the model of the context where it has a name."""
        given, known = self.model_extra, DISTRIBUTIONS[self.distribution]
        given = {k: np.array(v, np.float64) if isinstance(v, list) else v for k, v in given.items()}
        return (known if name else known.dist)(*name, **given, **shape)

    @cached_property
    def median(self) -> float:
        """A value in the middle, of draws."""
        return float(np.median(self.draw(501, 1)))

    @property
    def density(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,), from 0.5 to 99.5 % of draws, and the density (k,) there."""
        values = np.linspace(*np.quantile(self.draw(501, 1), [0.005, 0.995]), 200)
        return values, np.exp(pm.logp(self.variable(), values).eval(mode=_PLAIN))

    def draw(self, n: int, seed) -> np.ndarray:
        """Draws (n,)."""
        return np.asarray(pm.draw(self.variable(size=n), random_seed=seed, mode=_PLAIN))
