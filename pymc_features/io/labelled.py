"""Headers of one fact in a line, `LABEL: value`."""

from pymc_features.io.lines import Lines, to_number


def labelled(lines: Lines, end: str | None = None, most: int = 300) -> dict[str, str]:
    """Facts by their labels, in capitals, down to a line that begins with `end` or to the first number.

    A label stays with its first value. The line that begins with `end` is taken, a number is not.
    """
    facts = {}
    for _ in range(most):
        if end is None:
            following = (lines.peek() or "").split()
            if following and all(to_number(word) is not None for word in following):
                return facts
        line = lines.take("a header and values")
        if end is not None and line.strip().upper().startswith(end):
            return facts
        label, colon, value = line.partition(":")
        if colon:
            facts.setdefault(" ".join(label.upper().split()), value.strip())
    raise lines.error(f"the header must end within {most} lines", "more")


def demand(lines: Lines, facts: dict[str, str], label: str) -> str:
    """The value of a label that must be there."""
    if not facts.get(label):
        raise lines.error(f"the header must state {label}", "nothing")
    return facts[label]
