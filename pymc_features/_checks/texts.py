"""Texts, names of variables and labels, choices, paths, and lists of them."""

import os
from collections.abc import Iterable, Mapping, Set
from pathlib import Path

import numpy as np

from pymc_features._checks.messages import message, shown
from pymc_features._checks.numeric import is_number, single


def check_title(value) -> str:
    """What figures and messages call something: a text, or a number such as that of a station."""
    if is_number(value):
        return shown(value.item() if isinstance(value, np.generic) else value)
    return check_text(value, "name", "Figures and messages show it.")


def check_name(value) -> str:
    """The name of a variable in a model."""
    if not check_text(value, "name", "It names the variable in the model.") or "\0" in value:
        raise ValueError(message("name", "a text with letters", shown(value)))
    return value


def as_list(value) -> list | None:
    """What iterating over a value gives; None of what is one thing or has no order."""
    is_one = isinstance(value, str | bytes | Mapping | Set) or hasattr(value, "read")
    if is_one or not isinstance(value, Iterable):
        return None
    try:
        return list(value)
    except Exception:  # arrays and variables without dimensions
        return None


def check_text(value, name: str, advice: str = "") -> str:
    """A text."""
    if not isinstance(value, str):
        raise TypeError(message(name, "a text", shown(value), advice))
    return value


def is_among(value, labels: Iterable) -> bool:
    """Whether a text or a number is one of some labels."""
    label = single(value)
    return (isinstance(label, str) or is_number(label)) and label in list(labels)


def check_choice(value, name: str, choices: Iterable[str], advice: str = "") -> str:
    """One of some texts."""
    choices = list(choices)
    if not isinstance(value, str) or value not in choices:
        raise ValueError(message(name, f"one of {', '.join(choices)}", shown(value), advice))
    return value


def check_texts(value, name: str, what: str, advice: str = "") -> list[str]:
    """Several texts as a list; one by itself is a list of one."""
    listed = [value] if isinstance(value, str) else as_list(value)
    if listed is None or not all(isinstance(text, str) for text in listed):
        raise TypeError(message(name, what, shown(value), advice))
    return listed


def check_path(value, name: str = "path", advice: str = "") -> Path:
    """The path of a file or a folder."""
    try:
        text = os.fspath(value)
    except TypeError:
        text = None
    if not isinstance(text, str):
        raise TypeError(message(name, "a path", shown(value), advice))
    if not text or "\0" in text:
        raise ValueError(message(name, "a path", shown(value), advice))
    return Path(text)
