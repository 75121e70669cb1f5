"""Channels of MATLAB .mat files: matrices of several sensors, or one vector for each."""

from pathlib import Path

import numpy as np

from pymc_features.io.reading.clock import Clock, MeasuredFile, Request, at_samples, even_clock
from pymc_features.io.reading.units import resolve_dt, resolve_units
from pymc_features.io.tables.mat import TIMES, agreed, describe, load_variables, scalar_steps, stated_units


def read_mat_channels(path: Path, request: Request) -> MeasuredFile:
    """Read variables of a .mat file and its clock; see `read_channels`."""
    variables = load_variables(path)
    found = describe(variables, path.name)
    arrays = {
        name: np.squeeze(value).astype(np.float64)
        for name, value in variables.items()
        if value.dtype.kind != "U" and value.size > 1 and np.squeeze(value).ndim <= 2
    }
    timer = _clock_variable(arrays, request.clock, found)
    picked = request.columns
    if picked is None:
        picked = [name for name in arrays if name != timer and name.lower() not in TIMES]
    names, rows = [], []
    for name in picked:
        if not isinstance(name, str) or name not in arrays:
            raise ValueError(f"`columns` must name variables that hold accelerations, got {name!r}. {found}")
        histories = _by_time(arrays[name], name, path.name)
        names += [name] if len(histories) == 1 else [f"{name} {k}" for k in range(len(histories))]
        rows += list(histories)
    lengths = {row.size for row in rows}
    if len(lengths) != 1:
        raise ValueError(
            f"`columns` must name variables of the same number of samples, got {len(lengths)} different "
            f"ones. {found}"
        )
    values = np.array(rows)
    times = None if timer is None else arrays[timer]
    if times is None and request.clock is not False and len(rows) > 1 and (np.diff(values[0]) > 0.0).all():
        times, values, timer, names = values[0], values[1:], names[0], names[1:]
    if times is not None and times.shape != values.shape[1:]:
        raise ValueError(
            f"`clock` must have one time for each of the {values.shape[1]} samples, got {timer} with shape "
            f"{times.shape}. {found}"
        )
    values = values[:, request.skip :]
    if values.shape[1] < 2:
        raise ValueError(f"{path.name} must hold at least 2 samples, got {values.shape[1]}.")
    wrong = np.isinf(values) if request.gaps else ~np.isfinite(values)
    if wrong.any():
        channel, sample = np.argwhere(wrong)[0]
        raise ValueError(
            f"{path.name}, `{names[channel]}`, sample {sample + request.skip}: values must be finite "
            f"numbers, got {values[channel, sample]}. Correct or cut it first."
        )
    factor = resolve_units(request.units, stated_units(variables), path.name)
    clock, numbers = _clock(path.name, values.shape[1], times, timer, variables, request)
    return MeasuredFile(names, at_samples(factor * values, numbers), clock)


def _clock_variable(arrays, clock, found: str) -> str | None:
    if clock is False:
        return None
    if clock is not None:
        if clock not in arrays:
            raise ValueError(f"`clock` must name the vector of times, got {clock!r}. {found}")
        return clock
    return next((name for name in arrays if name.lower() in TIMES), None)


def _by_time(array: np.ndarray, name: str, file: str) -> np.ndarray:
    """Histories (channel, time) of a vector or a matrix, whose longer side is time."""
    if array.ndim == 1:
        return array[None]
    if array.shape[0] == array.shape[1]:
        raise ValueError(
            f"{file}, `{name}`: time must be the longer side of a matrix, got shape {array.shape}. Save one "
            "vector for each sensor."
        )
    return array.T if array.shape[0] > array.shape[1] else array


def _clock(file, n_times, times, timer, variables, request) -> tuple[Clock, np.ndarray]:
    """The clock, and the numbers of the samples (row,)."""
    stated = scalar_steps(variables, file)
    step = agreed(stated, file, request.dt)
    if times is None:
        return Clock(file, n_times, resolve_dt(request.dt, step, file)), np.arange(n_times)
    scale = request.clock_units or 1.0
    readings = scale * times[request.skip :]
    quantum = 4.0 * np.spacing(np.abs(readings).max()) + _quantum(variables.get(timer), readings)
    even, numbers = even_clock(
        readings, lambda row: f"{file}, `{timer}`, sample {row + request.skip}", quantum, request.gaps
    )
    if step is not None and not np.isclose(step, even, rtol=1e-3, atol=0.0):
        raise ValueError(
            f"{file} contradicts itself, {next(iter(stated))} says a step of {step:g} s and {timer} {even:g} "
            "s. Pass `clock_units`, or clock=False and `dt`."
        )
    dt = resolve_dt(request.dt, even, file)
    return Clock(file, int(numbers[-1]) + 1, dt, float(readings[0]), quantum), numbers


def _quantum(variable, readings) -> float:
    """Resolution of times that were stored in single precision [s]."""
    single = variable is not None and variable.dtype == np.float32
    return 4.0 * float(np.finfo(np.float32).eps) * np.abs(readings).max() if single else 0.0
