"""Checks of arguments, with one message for all: "`name` must be ..., got .... What to do."."""

from numbers import Real

import numpy as np

SAMPLING_INTERVAL = "Pass the sampling interval in seconds."


def message(name: str, condition: str, got, advice: str = "") -> str:
    """The sentence about an argument, and advice if there is any."""
    return f"`{name}` must be {condition}, got {got}.{' ' if advice else ''}{advice}"


def is_number(value) -> bool:
    """Whether a value is a real number; True and False are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def check_number(value, name: str, advice: str = "") -> float:
    """A finite or infinite number, or an array with one, as a float."""
    try:
        if isinstance(value, str | bool) or np.ndim(value):
            raise TypeError
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(message(name, "a number", repr(value), advice)) from None


def check_positive(value, name: str, advice: str = "", *, allow_zero: bool = False) -> float:
    """A finite number that is positive, or not negative, as a float."""
    number = check_number(value, name, advice)
    if not (0.0 < number < np.inf or (allow_zero and number == 0.0)):
        raise ValueError(message(name, "positive or zero" if allow_zero else "positive", number, advice))
    return number


def check_step(dt) -> float:
    """A sampling interval [s]."""
    return check_positive(dt, "dt", SAMPLING_INTERVAL)


def check_integer(value, name: str, *, least: int = 1, most: int | None = None, advice: str = "") -> int:
    """A whole number within bounds, as an int; 2.0 counts as one."""
    inside = is_number(value) and value % 1 == 0 and value >= least and (most is None or value <= most)
    if not inside:
        bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise ValueError(message(name, f"an integer {bounds}", repr(value), advice))
    return int(value)


def check_finite(array: np.ndarray, name: str, advice: str = "") -> None:
    """Refuse NaN and infinity, with the place of the first."""
    wrong = np.argwhere(~np.isfinite(array))
    if wrong.size:
        place = tuple(map(int, wrong[0]))
        at = place[0] if len(place) == 1 else place
        raise ValueError(message(name, "finite", f"{array[place]} at index {at}", advice))


def as_numbers(value, name: str, advice: str = "") -> np.ndarray:
    """A read-only float64 array of its own."""
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        kind = type(value).__name__
        raise TypeError(message(name, "an array of numbers", kind, advice)) from None
    numbers.setflags(write=False)
    return numbers
