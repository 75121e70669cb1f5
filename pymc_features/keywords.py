"""Keyword arguments that a function hands on to another."""

import difflib
from collections.abc import Iterable, Mapping


def check_keywords(given: Mapping[str, object], known: Iterable[str], function: str) -> None:
    """Refuse names that `function` does not know, with the one that may be meant."""
    known = list(known)
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            raise TypeError(
                f"keyword arguments of {function}() must be its own or {', '.join(known)}, got {name!r}."
                + (f" Did you mean {near[0]!r}?" if near else "")
            )
