"""Units and time steps: what a file states, what the caller says, and which one counts."""

import re

import numpy as np

from pymc_features._checks import (
    SAMPLING_INTERVAL,
    check_positive,
    is_number,
    message,
    shown,
    single,
    warn_caller,
)
from pymc_features.io.reading.labels import MASSES, SI, UNITS, Unit, unit_of

_SENSITIVITY = re.compile(r"\s*(\d+\.?\d*(?:[eE][-+]?\d+)?)\s*([^\s/\d]+)\s*(?:/|per)\s*(.+?)\s*")


def plural(quantity: str) -> str:
    """Accelerations, velocities."""
    return f"{quantity[:-1]}ies" if quantity.endswith("y") else f"{quantity}s"


def choices(quantity: str) -> str:
    """What `units` may be, as a message lists it."""
    names = list(UNITS[quantity])[:6]
    return ", ".join(f'"{name}"' for name in names) + f", or a number in {SI[quantity]} per file unit"


def known_factor(unit: str) -> float | None:
    """Acceleration [m/s^2] of one `unit`, or None where it is none of acceleration."""
    found = unit_of(unit)
    return found.factor if found is not None and found.quantity == "acceleration" else None


def unit_factor(units, quantity: str = "acceleration") -> float:
    """SI units in one file unit of a quantity, in any usual spelling, or the factor itself, positive.

    Examples
    --------
    >>> unit_factor("g"), unit_factor("M/S/S"), unit_factor("Gal"), unit_factor("mm", "displacement")
    (9.81, 1.0, 0.01, 0.001)
    """
    if isinstance(units, str):
        found = unit_of(units)
        if found is None or found.quantity != quantity:
            raise ValueError(f"`units` must be one of {choices(quantity)}, got {units!r}.")
        return found.factor
    if not is_number(single(units)):
        raise TypeError(f"`units` must be one of {choices(quantity)}, got {shown(units)}.")
    return check_positive(units, "units", f"Pass the {SI[quantity]} per file unit.")


def sensitivity_of(sensitivity, quantity: str) -> float:
    """Volts in one SI unit of a quantity, of a number or a text such as "100 mV/g"."""
    if is_number(single(sensitivity)):
        return check_positive(sensitivity, "sensitivity", f"Pass the V per {SI[quantity]}.")
    found = _SENSITIVITY.fullmatch(sensitivity) if isinstance(sensitivity, str) else None
    voltage, unit = (None, None) if found is None else (unit_of(found[2]), unit_of(found[3]))
    kinds = [one and one.quantity for one in (voltage, unit)]
    number = 0.0 if found is None else float(found[1])
    if number <= 0.0 or kinds != ["voltage", quantity]:
        what = f'V per {SI[quantity]}, or a text such as "100 mV/{next(iter(UNITS[quantity]))}"'
        raise ValueError(message("sensitivity", what, shown(sensitivity)))
    return number * voltage.factor / unit.factor


def system_of_units(text: str) -> tuple[float, float, float]:
    """SI units in the force, length and mass of a system of units, "kN, m, t", in any order.

    Examples
    --------
    >>> system_of_units("N, mm, t")
    (1.0, 0.001, 1000.0)
    """
    what = 'a force, a length and a mass, such as "kN, m, t"'
    words = [word.strip() for word in text.split(",")] if isinstance(text, str) else []
    found = {}
    for word in words:
        unit = Unit("mass", MASSES[word]) if word in MASSES else unit_of(word)
        if unit is not None:
            found["length" if unit.quantity == "displacement" else unit.quantity] = unit.factor
    if set(found) != {"force", "length", "mass"} or len(words) != 3:
        raise ValueError(message("units", what, shown(text)))
    return found["force"], found["length"], found["mass"]


def resolve_units(units, stated: str | None, source: str, quantity: str = "acceleration") -> float:
    """Factor [SI per file unit] by the file, or by the argument where the file does not say it.

    A number within 1 % of what the file states (9.80665 for "g") is no contradiction.
    """
    known = None if stated is None else unit_of(stated)
    if known is not None and known.quantity != quantity:
        advice = f"Pass the columns that are {plural(quantity)}."
        if known.quantity == "voltage":
            advice = f'Pass `sensitivity`, such as "100 mV/({next(iter(UNITS[quantity]))})".'
        beside = "" if units is None else f", beside units={shown(units)}"
        raise ValueError(
            f"{source} must hold {plural(quantity)}, it states {stated!r}, a unit of "
            f"{known.quantity}{beside}. {advice}"
        )
    if units is None:
        if known is None:
            said = "does not state them" if stated is None else f"states {stated!r}, which is no known unit"
            raise ValueError(f"`units` must be given, {source} {said}. Pass one of {choices(quantity)}.")
        return known.factor
    factor = unit_factor(units, quantity)
    if known is not None and not np.isclose(factor, known.factor, rtol=0.01, atol=0.0):
        raise ValueError(
            f"`units` must be those of the file, {source} states {stated!r}, got {shown(units)}. Leave "
            "`units` out, or correct the file."
        )
    if known is None and stated is not None:
        warn_caller(f"{source} states the units {stated!r}; the argument units={units!r} is used.")
    return factor


def resolve_dt(dt: float | None, stated: float | None, source: str) -> float:
    """Sampling interval [s]: the argument wins, the file's statement is the fallback."""
    stated = stated if stated is not None and stated > 0.0 else None  # headers with a step of 0 state none
    if dt is None:
        if stated is None:
            raise ValueError(
                f"`dt` must be given, {source} does not state the time step. {SAMPLING_INTERVAL}"
            )
        if stated >= 1.0:  # a counter or milliseconds, silently 1000 times too slow
            raise ValueError(
                f"`dt` must be given, {source} states a time step of {stated:g}, too long for "
                f"seconds. {SAMPLING_INTERVAL}"
            )
        return stated
    if stated is not None and not np.isclose(dt, stated, rtol=1e-3, atol=0.0):
        warn_caller(f"{source} states a time step of {stated:g} s; the argument dt={dt:g} s is used.")
    return dt
