"""Checks of arguments, with one message for all: "`name` must be ..., got .... What to do."."""

import errno
import os
import stat
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from contextlib import contextmanager
from importlib.util import find_spec
from numbers import Integral, Real
from pathlib import Path
from reprlib import Repr
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pymc as pm
    import xarray as xr

LONGEST = 80  # characters of a value in a message
MOST = 20  # names in a list
LIBRARIES = (str(Path(__file__).parent), *find_spec("pymc").submodule_search_locations)  # no user's
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of a file system that takes no more
_SHORT = Repr(maxlist=12, maxtuple=12, maxdict=6, maxlong=40, maxstring=LONGEST, maxother=LONGEST)
SAMPLING_INTERVAL = "Pass the sampling interval in seconds."
LARGEST_COUNT = 10**9  # of draws, samples, rows: more fit into no memory
#: What arrays hold that are no numbers, by NumPy's letters.
CONTENTS = {"b": "booleans", "c": "complex numbers", "M": "dates", "m": "durations", "O": "objects"}
CONTENTS |= {"S": "bytes", "T": "texts", "U": "texts", "V": "records"}


# ---- messages ----


def message(name: str, condition: str, got, advice: str = "") -> str:
    """The sentence about an argument, and advice if there is any."""
    return f"`{name}` must be {condition}, got {got}.{' ' if advice else ''}{advice}"


def require(holds, text: str) -> None:
    """Refuse what does not hold, in a sentence."""
    if not holds:
        raise ValueError(text)


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
    """Warn at the line that called into this package, or into PyMC on the way to it, from outside."""
    warnings.warn(text, category, skip_file_prefixes=LIBRARIES)


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


# ---- numbers ----


def is_number(value) -> bool:
    """Whether a value is a real number; True and False are none, nor are durations, NumPy's integers."""
    return isinstance(value, Real) and not isinstance(value, bool | np.timedelta64)


def single(value):
    """The scalar in an array without dimensions; anything else as it is."""
    holds_one = getattr(value, "ndim", None) == 0 and hasattr(value, "__array__")
    return np.asarray(value)[()] if holds_one and not np.ma.isMaskedArray(value) else value


def to_float(number) -> float:
    """A real number as a float; integers beyond its range as infinity."""
    try:
        return float(number)
    except OverflowError:
        return np.inf if number > 0 else -np.inf


def check_number(value, name: str, advice: str = "") -> float:
    """A finite or infinite number, or an array with one, as a float."""
    number = single(value)
    if not is_number(number):
        raise TypeError(message(name, "a number", shown(value), advice))
    return to_float(number)


def check_positive(value, name: str, advice: str = "", *, allow_zero: bool = False) -> float:
    """A finite number that is positive, or not negative, as a float."""
    number = check_number(value, name, advice)
    if not (0.0 < number < np.inf or (allow_zero and number == 0.0)):
        raise ValueError(message(name, "positive or zero" if allow_zero else "positive", number, advice))
    return number


def check_step(dt) -> float:
    """A sampling interval [s]."""
    return check_positive(dt, "dt", SAMPLING_INTERVAL)


def step_or_rate(dt, fs):
    """The sampling interval [s], or that of a sampling rate [Hz]; None where neither is given."""
    if fs is None:
        return dt
    rate = check_positive(fs, "fs", "Pass the sampling rate in Hz.")
    if dt is not None:
        raise TypeError(f"`fs` must be left out where `dt` is given, got {rate:g} Hz and {shown(dt)} s.")
    return 1.0 / rate


def check_share(value, name: str, advice: str = "") -> float:
    """A number between 0 and 1, neither of them, as a float."""
    number = single(value)
    if not (is_number(number) and 0.0 < number < 1.0):
        advice = f" {advice}" if advice else ""
        raise ValueError(f"`{name}` must lie between 0 and 1, got {shown(value)}.{advice}")
    return float(number)


def check_integer(value, name: str, *, least: int = 1, most: int | None = None, advice: str = "") -> int:
    """A whole number within bounds, as an int; 2.0 counts as one."""
    number, largest = single(value), LARGEST_COUNT if most is None else most
    if not (is_number(number) and least <= number <= largest and number % 1 == 0):
        is_large = is_number(number) and number > largest
        bounds = f"of at least {least}" if most is None and not is_large else f"from {least} to {largest}"
        raise ValueError(message(name, f"an integer {bounds}", shown(value), advice))
    return int(number)


def check_seed(value, name: str = "random_seed", *, several: bool = True, states: bool = False):
    """A seed as it came: None, an integer of at least 0, or `several`; with `states` also a generator."""
    kinds = (np.random.Generator, np.random.RandomState, np.random.BitGenerator, np.random.SeedSequence)
    if value is None or (states and isinstance(value, kinds)):
        return value
    array = as_array(value)
    entries = array.ravel().tolist() if array.dtype.kind in "iuO" else []
    whole = bool(entries) and all(isinstance(x, Integral) and not isinstance(x, bool) for x in entries)
    if array.ndim > several or not whole or min(entries) < 0:
        more = ", or several" * several + " or a Generator" * states
        raise ValueError(message(name, f"an integer of at least 0{more}", shown(value), "Or leave it out."))
    return value if several else entries[0]


def as_array(value) -> np.ndarray:
    """What NumPy makes of a value; an array with the value itself where that fails or is masked."""
    try:
        if not (np.ma.isMaskedArray(value) and np.ma.getmaskarray(value).any()):
            return np.asarray(value)
    except Exception:  # uneven lists, and classes that fail in their own way
        pass
    array = np.empty((), dtype=object)
    array[()] = value
    return array


def as_numbers(
    value, name: str, advice: str = "", *, what: str = "an array of numbers", allow_complex: bool = False
) -> np.ndarray:
    """A read-only float64 array of its own; of complex numbers, where they are allowed, a complex128 one.

    Integers and numbers of any precision are taken; texts, dates, booleans, complex numbers and masked
    values, which NumPy would turn into numbers, are not.
    """
    array = as_array(value)
    if array.dtype == object and array.size and all(map(is_number, array.flat)):
        array = np.reshape([to_float(number) for number in array.flat], array.shape)
    is_complex = allow_complex and array.dtype.kind == "c"
    if array.dtype.kind not in "iuf" and not is_complex:
        kind = type(value).__name__
        if np.ma.isMaskedArray(value):
            kind = "a masked array"
        elif array.ndim and not isinstance(value, str):
            kind = f"{kind} of {CONTENTS.get(array.dtype.kind, array.dtype)}"
        raise TypeError(message(name, what, kind, advice))
    numbers = np.array(array, dtype=np.complex128 if is_complex else np.float64)
    numbers.setflags(write=False)
    return numbers


def masked_as_nan(value):
    """A masked array of numbers with NaN for what it hides; anything else as it is."""
    if np.ma.isMaskedArray(value) and value.dtype.kind in "iuf":
        return np.ma.filled(value.astype(np.float64), np.nan)
    return value


def check_finite(array: np.ndarray, name: str, advice: str = "") -> None:
    """Refuse NaN and infinity, with the place of the first."""
    wrong = np.argwhere(~np.isfinite(array))
    if wrong.size or not np.isfinite(array).all():
        place = tuple(map(int, wrong[0]))
        at = f" at index {place[0] if len(place) == 1 else place}" if place else ""
        raise ValueError(message(name, "finite", f"{array[place]}{at}", advice))


# ---- texts, lists and paths ----


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


def check_file(value, name: str = "path") -> Path:
    """The path of a file that can be opened."""
    path = check_path(value, name)
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            path.open("rb").close()
    except (FileNotFoundError, NotADirectoryError):
        advice = f"The current folder is {Path.cwd()}."
        raise FileNotFoundError(message(name, "an existing file", path, advice)) from None
    except OSError as error:  # no permission, a name that is too long
        raise type(error)(f"`{name}` must be readable, got {shown(str(path))}: {error.strerror}.") from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(message(name, "a file", f"the folder {path}", "Name a file in it."))
    if not stat.S_ISREG(mode):  # devices have no end
        got = f"the device or pipe {path}"
        raise OSError(message(name, "a file", got, "Copy its contents into a file."))
    return path


# ---- flags, functions, mappings, results and models ----


def check_flag(value, name: str, advice: str = "") -> bool:
    """True or False."""
    if not isinstance(single(value), bool | np.bool_):
        raise TypeError(message(name, "True or False", shown(value), advice))
    return bool(value)


def check_callable(value, name: str, advice: str = "") -> Callable:
    """A function."""
    if not callable(value):
        raise TypeError(message(name, "a function", shown(value), advice))
    return value


def check_mapping(value, name: str, what: str, advice: str = "") -> dict:
    """A mapping with texts as keys, or None, as a new dict."""
    if value is None:
        return {}
    kinds = {kind.__name__ for kind in type(value).__mro__}
    plain = isinstance(value, Mapping) and not kinds & {"Dataset", "DataTree"}
    if not plain or not all(isinstance(key, str) for key in value):
        raise TypeError(message(name, what, shown(value), advice))
    return dict(value)


def check_group(tree, name: str, group: str, advice: str, *dims: str) -> "xr.Dataset":
    """A group of a DataTree, with these dimensions, as a Dataset."""
    import xarray as xr  # slow to import, and not needed to read a record

    is_tree = isinstance(tree, xr.DataTree)
    if not is_tree or group not in tree.children:
        got = f"one with {', '.join(tree.children) or 'none'}" if is_tree else shown(tree)
        raise TypeError(message(name, f"a DataTree with a group `{group}`", got, advice))
    dataset = tree[group].to_dataset()
    for dim in dims:
        if not dataset.sizes.get(dim):
            what = f"a DataTree whose `{group}` has values along {', '.join(dims)}"
            raise ValueError(message(name, what, f"none along {dim}", advice))
    return dataset


def check_model(model) -> "pm.Model":
    """The model given, or that of the context."""
    import pymc as pm  # slow to import

    if not (model is None or isinstance(model, pm.Model)):
        raise TypeError(message("model", "a pymc.Model", shown(model), "Leave it out in a model's context."))
    try:
        model = pm.modelcontext(model)
    except TypeError:
        advice = "Pass model=..., or call it within `with model:`."
        raise TypeError(message("model", "given outside of a model's context", "None", advice)) from None
    if not model.free_RVs:
        raise ValueError("`model` must have free parameters, got none. Declare variables without data.")
    return model


def check_keywords(given: Mapping[str, object], known: Iterable[str], function: str) -> None:
    """Refuse names that `function` does not know, with the one that may be meant."""
    import difflib  # not needed to read a record

    known = list(known)
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            raise TypeError(
                f"keyword arguments of {function}() must be its own or {', '.join(known)}, got {name!r}."
                + (f" Did you mean {near[0]!r}?" if near else "")
            )
