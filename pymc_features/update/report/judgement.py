"""What a judgement of a fit says."""

from typing import NamedTuple


class Verdict(NamedTuple):
    """What to think of the fit.

    Attributes
    ----------
    sentences : list of str
        The first says whether the model explains the measurements; others say why not.
    explains : bool
        Whether it does.
    """

    sentences: list[str]
    explains: bool
