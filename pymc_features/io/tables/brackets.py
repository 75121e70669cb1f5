"""Brackets in labels, "acc [m/s^2]", found in one pass over the text."""

import re

_OPEN = re.compile(r"[\[(]")
_CLOSE = re.compile(r"[\])]")


def _places(text: str) -> list[tuple[int, int]]:
    """Begin and end of each text from an opening bracket to the next closing one."""
    places, position = [], 0
    while (begin := _OPEN.search(text, position)) and (end := _CLOSE.search(text, begin.end())):
        places.append((begin.start(), end.end()))
        position = end.end()
    return places


def texts_in_brackets(text: str) -> list[str]:
    """What stands in brackets.

    Examples
    --------
    >>> texts_in_brackets("t [s], a (m/s^2)")
    ['s', 'm/s^2']
    """
    return [text[begin + 1 : end - 1].strip() for begin, end in _places(text)]


def without_brackets(text: str) -> str:
    """The text without brackets and what stands in them.

    Examples
    --------
    >>> without_brackets("acc [g]")
    'acc'
    """
    kept, position = [], 0
    for begin, end in _places(text):
        kept.append(text[position:begin])
        position = end
    return "".join([*kept, text[position:]]).strip()


def labels_with_brackets(text: str) -> list[str]:
    """Words, each with the brackets that follow it.

    Examples
    --------
    >>> labels_with_brackets("time [s] acc [g] x")
    ['time [s]', 'acc [g]', 'x']
    """
    labels, position = [], 0
    for begin, end in _places(text):
        words = text[position:begin].split()
        labels += words[:-1]
        labels.append(text[text.rindex(words[-1], position, begin) : end] if words else text[begin:end])
        position = end
    return labels + text[position:].split()
