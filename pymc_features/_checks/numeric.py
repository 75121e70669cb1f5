"""Numbers, seeds and arrays of numbers, and what NumPy would quietly turn into them."""

from numbers import Integral, Real

import numpy as np

from pymc_features._checks.messages import message, shown

SAMPLING_INTERVAL = "Pass the sampling interval in seconds."
LARGEST_COUNT = 10**9  # of draws, samples, rows: more fit into no memory
#: What arrays hold that are no numbers, by NumPy's letters.
CONTENTS = {
    "b": "booleans",
    "c": "complex numbers",
    "M": "dates",
    "m": "durations",
    "O": "objects",
    "S": "bytes",
    "T": "texts",
    "U": "texts",
    "V": "records",
}


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
    inside = is_number(number) and least <= number <= largest and number % 1 == 0
    if not inside:
        is_large = most is None and is_number(number) and number > largest
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
