"""The sentence that refuses an argument: "`name` must be ..., got .... What to do."."""

import errno
import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from reprlib import Repr

LONGEST = 80  # characters of a value in a message
MOST = 20  # names in a list
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of a file system that takes no more
_SHORT = Repr(maxlist=12, maxtuple=12, maxdict=6, maxlong=40, maxstring=LONGEST, maxother=LONGEST)


def message(name: str, condition: str, got, advice: str = "") -> str:
    """The sentence about an argument, and advice if there is any."""
    return f"`{name}` must be {condition}, got {got}.{' ' if advice else ''}{advice}"


def shown(value) -> str:
    """A value as a message has it: on one short line, whatever it is."""
    try:
        text = " ".join(_SHORT.repr(value).split())
    except Exception:  # integers of thousands of digits, and classes whose text fails
        return type(value).__name__
    return text if len(text) <= 2 * LONGEST else type(value).__name__


def listed(names: Sequence, most: int = MOST) -> str:
    """Names as a message lists them, the first of many."""
    more = f", ... {len(names)} in all" if len(names) > most else ""
    return ", ".join(str(name)[:40] for name in names[:most]) + more or "none"


def warn_caller(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called into this package from outside."""
    warnings.warn(text, category, skip_file_prefixes=(str(Path(__file__).parents[1]),))


@contextmanager
def says_where_it_is_full(path):
    """What the system says of a full disk gets the file, and what to do."""
    try:
        yield
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise OSError(
            f"`{path}` could not be written, for the disk is full ({error.strerror}). What was finished "
            "before is kept; make room, and the same call continues."
        ) from error
