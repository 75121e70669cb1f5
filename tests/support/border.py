"""Whether a call with an odd argument works, is refused clearly, or fails somewhere inside."""

import inspect
import warnings
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from traceback import extract_tb
from unittest.mock import patch

import numpy as np
import pymc as pm

import pymc_features

ODD = {
    "None": None,
    "True": True,
    "text": "abc",
    "-1.0": -1.0,
    "nan": np.nan,
    "complex": 1.0 + 1.0j,
    "[]": [],
    "three dimensions": np.ones((2, 2, 2)),
}
ROOT = str(Path(pymc_features.__file__).parent)


class Passed(Exception):  # noqa: N818  no error: all arguments were taken
    """Raised where the work would begin."""


def work(*args, **kwargs):
    """In the place of what takes long."""
    raise Passed


@dataclass
class Call:
    """A call that works, and what its arguments may be besides.

    Attributes
    ----------
    function : callable
    arguments : dict
        All that are tried, with values that work, by name.
    takes : dict
        Names of odd values that each argument takes, besides True where its own value is True or False.
    called : dict
        What messages name in place of an argument, or where it does not fit another.
    positional : tuple of str
        Arguments that are passed by place.
    instead : dict
        Places in the package, and what stands there while it is called.
    more : dict
        Odd values for one argument alone, by argument.
    coords : dict, optional
        Of the new model in whose context it is called, if there is to be one.
    """

    function: Callable
    arguments: dict
    takes: dict[str, Iterable[str]] = field(default_factory=dict)
    called: dict[str, Iterable[str]] = field(default_factory=dict)
    positional: tuple[str, ...] = ()
    instead: dict[str, Callable] = field(default_factory=dict)
    more: dict[str, dict] = field(default_factory=dict)
    coords: dict | None = None

    def __call__(self, **changes):
        """Call it with some arguments changed."""
        given = {**self.arguments, **changes}
        args = [given.pop(name) for name in self.positional]
        with ExitStack() as stack, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self.coords is not None:
                stack.enter_context(pm.Model(coords=self.coords))
            for place, replacement in self.instead.items():
                stack.enter_context(patch(place, replacement))
            return self.function(*args, **given)

    def odd(self, argument: str) -> dict:
        """Odd values of an argument, by name; None is not odd where it is the default."""
        odd = {**ODD, **self.more.get(argument, {})}
        parameter = inspect.signature(self.function).parameters.get(argument)
        if self.arguments[argument] is None or (parameter and parameter.default is None):
            del odd["None"]
        return odd

    def taken(self, argument: str) -> set[str]:
        """Names of the odd values that an argument takes."""
        own = {"True"} if isinstance(self.arguments[argument], bool) else set()
        return own | set(self.takes.get(argument, ()))


def fate(call: Call, argument: str, value) -> str:
    """Return "taken", "refused", or how it failed: what was raised, and where."""
    try:
        call(**{argument: value})
    except Passed:
        return "taken"
    except Exception as error:
        where = extract_tb(error.__traceback__, limit=-1)[-1]
        names = (argument, *call.called.get(argument, ()))
        if not where.filename.startswith(ROOT):
            return f"{type(error).__name__} in {Path(where.filename).name}: {error}"
        if isinstance(error, AttributeError | IndexError | KeyError) or "raise " not in str(where.line):
            return f"{type(error).__name__} in {Path(where.filename).name}, {where.line}: {error}"
        named = any(f"`{name}" in str(error) for name in names)
        return "refused" if named else f"refused without `{argument}`: {error}"
    return "taken"


def wrong(call: Call, argument: str) -> dict[str, str]:
    """Odd values of an argument whose fate is not what the table says."""
    found = {}
    for name, value in call.odd(argument).items():
        told = fate(call, argument, value)
        wanted = "taken" if name in call.taken(argument) else "refused"
        if told != wanted:
            found[name] = told
    return found
