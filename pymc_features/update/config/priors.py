"""Priors by the names of PyMC's continuous distributions; nothing in the file is evaluated."""

import difflib
import inspect
from functools import cached_property

import numpy as np
import pymc as pm
from pymc.distributions import continuous
from pytensor.compile.mode import Mode

from pymc_features._checks import is_number
from pymc_features.exceptions import ConfigError
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
    """Names of the arguments of a distribution."""
    parameters = inspect.signature(DISTRIBUTIONS[name].dist).parameters.values()
    return [p.name for p in parameters if p.kind in _ARGUMENTS]


class Prior:
    """A scalar prior, checked.

    Parameters
    ----------
    key : str
        Where it stands in the file, for messages.
    name : str
        Of its distribution.
    arguments : dict
        Names to numbers, or lists of numbers (`Interpolated`).

    Raises
    ------
    ConfigError
        If there is no such distribution, or an argument is unknown, missing or out of range.
    """

    def __init__(self, key: str, name: str, arguments: dict):
        self.key, self.name, self.arguments = key, name, dict(arguments)
        if name not in DISTRIBUTIONS:
            close = difflib.get_close_matches(name, DISTRIBUTIONS, n=1)
            hint = f"Did you mean {close[0]}?" if close else f"There are {', '.join(DISTRIBUTIONS)}."
            raise ConfigError(
                f"`{key}.distribution` must be a continuous distribution of PyMC, got {shown(name)}. {hint}"
            )
        known = arguments_of(name)
        for argument, value in arguments.items():
            if argument not in known:
                raise ConfigError(
                    f"`{key}.{argument}` must be left out, it is no argument of {name}. "
                    f"Those are {', '.join(known) or 'none'}."
                )
            numbers = value if isinstance(value, list) and value else [value]
            if not all(is_number(v) and np.isfinite(v) for v in numbers):
                raise ConfigError(f"`{key}.{argument}` must be a finite number, got {shown(value)}.")
        self._try()

    def __repr__(self):
        listed = ", ".join(f"{name}={value:g}" if is_number(value) else f"{name}=[...]"
                           for name, value in self.arguments.items())  # fmt: skip
        return f"{self.name}({listed})"

    def _given(self):
        return {
            name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
            for name, value in self.arguments.items()
        }

    def _try(self):
        """Refuse what PyMC refuses, a constant, and what is no density."""
        got = f"got {self!r}"
        try:
            variable = DISTRIBUTIONS[self.name].dist(**self._given())
            if variable.ndim:
                raise ConfigError(f"`{self.key}` must be a scalar, {got}. Give each entry its own prior.")
            pm.logp(variable, 0.5).eval(mode=_PLAIN)
            draws = self.draw(8, 0)
            densities = pm.logp(variable, draws).eval(mode=_PLAIN)
        except ConfigError:
            raise
        except NotImplementedError:
            raise ConfigError(
                f"`{self.key}.distribution` must be one that can be drawn from, {got}. "
                "An improper prior has no draws to start from."
            ) from None
        except Exception as error:  # each distribution has its own ways to refuse
            reason = (str(error) or type(error).__name__).splitlines()[0]
            reason = reason.removeprefix("Domain error in arguments. ").rstrip(".")
            raise ConfigError(
                f"`{self.key}` must have admissible arguments of {self.name}, {got}: {reason}."
            ) from error
        if not np.isfinite(draws).all() or np.ptp(draws) == 0.0:
            raise ConfigError(f"`{self.key}` must spread over finite values, {got}. Fix it as a number.")
        if not np.isfinite(densities).all() or np.min(self.arguments.get("pdf_points", 0.0)) < 0.0:
            raise ConfigError(
                f"`{self.key}` must have a positive and finite density, {got}. Change its arguments."
            )

    @cached_property
    def median(self) -> float:
        """A value in the middle, of draws."""
        return float(np.median(self.draw(501, 1)))

    def declare(self, name: str):
        """Add the variable to the model of the context."""
        return DISTRIBUTIONS[self.name](name, **self._given())

    @property
    def density(self) -> tuple[np.ndarray, np.ndarray]:
        """Values (k,), from 0.5 to 99.5 % of draws, and the density (k,) there."""
        values = np.linspace(*np.quantile(self.draw(501, 1), [0.005, 0.995]), 200)
        variable = DISTRIBUTIONS[self.name].dist(**self._given())
        return values, np.exp(pm.logp(variable, values).eval(mode=_PLAIN))

    def draw(self, n: int, seed) -> np.ndarray:
        """Draws (n,)."""
        variable = DISTRIBUTIONS[self.name].dist(**self._given(), size=n)
        return np.asarray(pm.draw(variable, random_seed=seed, mode=_PLAIN))
