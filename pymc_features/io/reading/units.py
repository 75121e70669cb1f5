"""Units and time steps: what a file states, what the caller says, and which one counts."""

import os
import warnings
from collections.abc import Callable

import numpy as np

from pymc_features._checks import SAMPLING_INTERVAL, check_positive, is_number, shown, single
from pymc_features.io.reading.labels import unit_of

CHOICES = '"g", "mg", "m/s^2", "cm/s^2", "gal", or a number in m/s^2 per file unit'


def known_factor(unit: str) -> float | None:
    """Acceleration [m/s^2] of one `unit`, or None where it is none of acceleration."""
    found = unit_of(unit)
    return found.factor if found is not None and found.quantity == "acceleration" else None


def unit_factor(units) -> float:
    """Acceleration of one file unit, in m/s^2.

    Parameters
    ----------
    units : str or float
        "g", "mg", "m/s^2", "cm/s^2", "mm/s^2", "gal", "in/s^2", "ft/s^2" in any case and usual spelling
        ("m/s2", "cm/sec/sec"), or the factor itself [m/s^2 per file unit], positive.

    Returns
    -------
    float
        Factor [m/s^2 per file unit].

    Raises
    ------
    ValueError, TypeError
        If the unit is unknown or the number is not positive.

    Examples
    --------
    >>> unit_factor("g"), unit_factor("M/S/S"), unit_factor("Gal"), unit_factor(9.80665)
    (9.81, 1.0, 0.01, 9.80665)
    """
    if isinstance(units, str):
        factor = known_factor(units)
        if factor is None:
            raise ValueError(f"`units` must be one of {CHOICES}, got {units!r}.")
        return factor
    if not is_number(single(units)):
        raise TypeError(f"`units` must be one of {CHOICES}, got {shown(units)}.")
    return check_positive(units, "units", "Pass the m/s^2 per file unit.")


def warn_user(message: str) -> None:
    """Warn at the line that called into this folder from outside."""
    warnings.warn(message, UserWarning, skip_file_prefixes=(os.path.dirname(os.path.dirname(__file__)),))


def resolve_units(units, stated: str | None, source: str) -> float:
    """Factor [m/s^2 per file unit] by the file, or by the argument where the file does not say it.

    A number within 1 % of what the file states (9.80665 for "g") is no contradiction.
    """
    known = None if stated is None else unit_of(stated)
    if known is not None and known.quantity != "acceleration":
        raise ValueError(
            f"{source} must hold accelerations, it states {stated!r}, a unit of {known.quantity}. Pass the "
            "columns that are accelerations."
        )
    if units is None:
        if known is None:
            said = "does not state them" if stated is None else f"states {stated!r}, which is no known unit"
            raise ValueError(f"`units` must be given, {source} {said}. Pass one of {CHOICES}.")
        return known.factor
    factor = unit_factor(units)
    if known is not None and not np.isclose(factor, known.factor, rtol=0.01, atol=0.0):
        raise ValueError(
            f"`units` must be those of the file, {source} states {stated!r}, got {shown(units)}. Leave "
            "`units` out, or correct the file."
        )
    if known is None and stated is not None:
        warn_user(f"{source} states the units {stated!r}; the argument units={units!r} is used.")
    return factor


def resolve_dt(dt: float | None, stated: float | None, source: str) -> float:
    """Sampling interval [s]: the argument wins, the file's statement is the fallback."""
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
        warn_user(f"{source} states a time step of {stated:g} s; the argument dt={dt:g} s is used.")
    return dt


def time_step(
    times: np.ndarray,
    where: Callable[[int], str],
    quantum: float = 0.0,
    numbers: np.ndarray | None = None,
) -> float:
    """Step of evenly increasing times, or an error that names the first place to look at.

    Parameters
    ----------
    times : ndarray (time,)
        Times [s], at least two.
    where : callable
        Maps the index of a sample to how a message calls its place, "elcentro.csv, line 871".
    quantum : float
        Resolution of the printed times [s]. Up to a quarter of the step it is tolerated as
        rounding, unless the step is a multiple of it: then rounding cannot make steps uneven.
        A thousandth of the step is tolerated anyway.
    numbers : ndarray (time,), optional
        Of the samples, from 0, where some are missing between the times.

    Returns
    -------
    float
        Step [s], to ten digits.

    Raises
    ------
    ValueError
        If the times do not increase or the steps are uneven.

    Examples
    --------
    >>> time_step(np.array([0.0, 0.008, 0.017, 0.025]), lambda row: f"line {row + 1}", 0.001)
    0.008333333333
    """
    steps = np.diff(times)
    if not (steps > 0.0).all():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise ValueError(
            f"{where(row)}: time must increase, it goes from {times[row - 1]:g} s to "
            f"{times[row]:g} s. Name the acceleration by `column` and pass `dt` if this is no time."
        )
    numbers = np.arange(times.size) if numbers is None else numbers
    mean = (times[-1] - times[0]) / numbers[-1]
    tolerance = 1e-3 * mean + 4.0 * np.spacing(np.abs(times).max())
    multiple = quantum > 0.0 and abs(mean / quantum - round(mean / quantum)) < 1e-6
    if quantum <= mean / 4.0 and not multiple:
        tolerance += quantum
    if np.abs(times - times[0] - mean * numbers).max() > tolerance:
        row = int(np.argmax(np.abs(steps - np.median(steps)))) + 1
        raise ValueError(
            f"{where(row)}: time steps must be even, they vary from {steps.min():.4g} s to "
            f"{steps.max():.4g} s. Resample the record first."
        )
    return float(f"{mean:.10g}")
