"""Names of degrees of freedom, such as "12:x", and of what rigidly follows them."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple, Self

import numpy as np

from pymc_features._checks import as_list, message, shown

ASK = "Name degrees of freedom, or give their numbers."
FEW = 6  # names that a message lists


class DofNames(NamedTuple):
    """What the degrees of freedom of a structure are called.

    Attributes
    ----------
    own : dict of str to int
        Names of the degrees of freedom, in their order.
    followers : mapping of str to array (n,)
        Names of displacements that are combinations S x of the degrees of freedom, with their rows of S.
    held : collection of str
        Names of displacements that supports prevent.
    """

    own: dict[str, int]
    followers: Mapping[str, np.ndarray]
    held: Iterable[str]

    def rows(self, names: Sequence[str]) -> np.ndarray:
        """Degrees of freedom (s,), or rows (s, n) of S where one of the names is that of a follower."""
        for name in names:
            if name not in self.own and name not in self.followers:
                raise ValueError(self.refusal(name))
        if all(name in self.own for name in names):
            return np.array([self.own[name] for name in names])
        rows = np.zeros((len(names), len(self.own)))
        for row, name in zip(rows, names, strict=True):
            if name in self.own:
                row[self.own[name]] = 1.0
            else:
                row[:] = self.followers[name]
        return rows

    def refusal(self, name: str) -> str:
        """Why a name is none of a degree of freedom."""
        if name in self.held:
            return message(
                "sensors", "free to move", shown(name), "It moves with the base: pass the record itself."
            )
        known = [*self.own, *self.followers]
        close = get_close_matches(name, known, n=3, cutoff=0.6)
        advice = f"Is {' or '.join(close)} meant?" if close else ASK
        first = ", ".join(known[:FEW]) + (f" and {len(known) - FEW} others" if len(known) > FEW else "")
        return message("sensors", f"among {first}", shown(name), advice)


class Named:
    """A structure whose degrees of freedom may have names."""

    _names: DofNames | None = None

    @property
    def dof_names(self) -> tuple[str, ...] | None:
        """Names of the degrees of freedom in their order; None where they have none."""
        return None if self._names is None else tuple(self._names.own)

    def with_names(self, names: Sequence[str]) -> Self:
        """Return the structure with names of its degrees of freedom, for `sensors=["12:x", ...]`.

        Parameters
        ----------
        names : sequence of n str
            All different.
        """
        listed, n = as_list(names), self.n_dof
        if listed is None or not all(isinstance(name, str) for name in listed):
            raise TypeError(message("names", f"{n} texts", shown(names)))
        if len(set(listed)) != n or len(listed) != n:
            twice = [name for name in listed if listed.count(name) > 1]
            got = f"{shown(twice[0])} twice" if twice else str(len(listed))
            raise ValueError(message("names", f"{n} different texts", got, "Name every degree of freedom."))
        return self.with_dof_names(DofNames({name: i for i, name in enumerate(listed)}, {}, ()))

    def with_dof_names(self, names: DofNames) -> Self:
        """Return the structure with names of what follows rigidly and of what is held, too."""
        named = copy.copy(self)
        named._names = names
        return named

    def rows_named(self, names: Sequence[str]) -> np.ndarray:
        """Degrees of freedom (s,), or combinations (s, n) of all, that have these names."""
        return self._names.rows(names)
