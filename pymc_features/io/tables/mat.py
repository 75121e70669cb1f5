"""MATLAB .mat files: versions 4 to 7 by SciPy, 7.3 by HDF5.

Only arrays of numbers and text are read. Structures, objects, cells and function handles are passed
over, nothing in the file is executed, and an HDF5 file cannot send the reader to another file.
"""

import math
from pathlib import Path

import h5py
import numpy as np
from scipy.io import loadmat, whosmat

from pymc_features._checks import listed
from pymc_features.io.reading.clock import Request
from pymc_features.io.reading.labels import Unit, unit_of
from pymc_features.io.reading.lines import shortened, to_number
from pymc_features.io.reading.promise import check_promise
from pymc_features.io.reading.units import resolve_dt, resolve_units, time_step
from pymc_features.io.tables.mat_layout import check_layout
from pymc_features.records import Record

TIMES = ("t", "time")
#: Quantity and SI units of numbers that state the step.
SCALARS = {"dt": ("time", 1.0)} | dict.fromkeys(("fs", "sampling_rate", "samplerate"), ("frequency", 1.0))


def read_mat(path: Path, request: Request) -> Record:
    """Read one acceleration series from the variables of a .mat file; see `read_record`."""
    dt = request.dt
    variables = load_variables(path)
    name = _pick(variables, None if request.columns is None else request.columns[0], path.name)
    values = variables[name].astype(np.float64).squeeze()
    stated = {}
    if values.ndim == 2:
        times = np.squeeze(variables[name])[:, 0]
        stated[f"column 0 of {name}"] = _even(times, name, path.name, dt)
        values = values[:, 1]
    stated |= _stated_steps(variables, values.size, path.name, dt)
    step = resolve_dt(dt, agreed(stated, path.name, dt), path.name)
    factor = resolve_units(request.units, stated_units(variables), path.name)
    if not np.isfinite(values).all():
        bad = int(np.argmin(np.isfinite(values)))
        raise ValueError(
            f"{path.name}, `{name}`, sample {bad}: values must be finite numbers, got "
            f"{values[bad]}. Correct or cut it first."
        )
    return Record(factor * values, step, name=path.stem)


def load_variables(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers and texts of a .mat file of any version, by name."""
    try:
        return load_hdf5(path) if h5py.is_hdf5(path) else _load_numbers(path)
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        raise ValueError(
            f"{path.name} must be a MATLAB .mat file, it cannot be read ({shortened(error)}). Save it again."
        ) from error


def stated_units(variables: dict[str, np.ndarray]) -> str | None:
    """The text in the variable `units`."""
    unit = variables.get("units")
    return str(unit.item()) if unit is not None and unit.dtype.kind == "U" else None


def describe(variables: dict[str, np.ndarray], file: str) -> str:
    """What a file holds, as a sentence of a message."""
    found = [
        f"{name} {'text' if value.dtype.kind == 'U' else value.shape}"
        for name, value in sorted(variables.items())
    ]
    return f"{file} holds {listed(found) if found else 'no arrays of numbers'}."


#: Bytes of an element, of the variables that are read from versions 4 to 7.
CLASSES = {
    **dict.fromkeys(("double", "int64", "uint64"), 8),
    **dict.fromkeys(("single", "int32", "uint32", "char"), 4),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int8", "uint8", "logical"), 1),
    "sparse": 0,
}


def load_mat(path: Path) -> dict[str, np.ndarray]:
    """Numbers, texts and sparse matrices of versions 4 to 7; other variables are not even opened."""
    held = check_layout(path)
    found = [entry for entry in whosmat(path) if entry[2] in CLASSES]
    if sum(CLASSES[kind] * _product(shape) for _, shape, kind in found) > 8 * held:  # a byte for a double
        raise ValueError(f"its variables announce more than the {held} bytes that it holds")
    check_promise(path, [8 * int(shape[-1]) for _, shape, kind in found if kind == "sparse"])
    contents = loadmat(path, variable_names=[name for name, _, _ in found])
    return {name: value for name, value in contents.items() if not name.startswith("__")}


def stored_size(item: h5py.Dataset) -> int:
    """Bytes of a data set, all of which must be in the file.

    Raises
    ------
    ValueError
        If parts of it are only promised.
    """
    n_bytes = item.dtype.itemsize * _product(item.shape)
    if item.chunks is None:
        held = item.id.get_storage_size()
    else:
        held = item.id.get_num_chunks() * item.dtype.itemsize * _product(item.chunks)
    if n_bytes > held:
        raise ValueError(f"`{item.name}` announces {n_bytes:.3g} bytes, the file holds {held}")
    return n_bytes


def _product(shape) -> int:
    """Of Python's integers, which do not overflow."""
    return math.prod(int(size) for size in shape)


def _load_numbers(path: Path) -> dict[str, np.ndarray]:
    return {
        name: value
        for name, value in load_mat(path).items()
        if isinstance(value, np.ndarray)
        and (value.dtype.kind in "iuf" or (value.dtype.kind == "U" and value.size == 1))
    }


def load_hdf5(path: Path) -> dict[str, np.ndarray]:
    """Numeric and text variables; MATLAB stores them transposed, and text as 16-bit codes."""
    variables, promised = {}, 0
    with h5py.File(path, "r") as file:
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                continue
            item = file[name]
            if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iuf":
                continue
            if item.external or item.is_virtual or "MATLAB_empty" in item.attrs:
                continue
            promised = check_promise(path, [promised, stored_size(item)])
            kind = item.attrs.get("MATLAB_class", b"double")
            kind = kind.decode() if isinstance(kind, bytes) else str(kind)
            if kind == "char":
                variables[name] = np.array(["".join(map(chr, np.ravel(item[()])))])
            elif kind in ("double", "single") or kind.startswith(("int", "uint")):
                variables[name] = item[()].T
    return variables


def _shape(value: np.ndarray) -> tuple[int, ...]:
    return np.squeeze(value).shape


def _is_series(value: np.ndarray) -> bool:
    """A vector, or the two columns time and acceleration."""
    shape = _shape(value)
    return value.dtype.kind != "U" and (
        len(shape) == 1 or (len(shape) == 2 and shape[1] == 2 and shape[0] > 1)
    )


def _pick(variables: dict[str, np.ndarray], column, file: str) -> str:
    """Name of the acceleration variable."""
    found = describe(variables, file)
    if column is not None:
        if not isinstance(column, str):
            raise TypeError(f"`column` must be the name of a variable, got {column!r}. {found}")
        if column not in variables or not _is_series(variables[column]):
            raise ValueError(
                f"`column` must name a vector or an (N, 2) matrix of time and acceleration, got "
                f"{column!r}. {found}"
            )
        return column
    candidates = [
        name
        for name, value in variables.items()
        if _is_series(value) and name.lower() not in (*TIMES, *SCALARS)
    ]
    if len(candidates) != 1:
        raise ValueError(
            f"`column` must name the acceleration, {len(candidates)} variables could be it. {found}"
        )
    return candidates[0]


def _even(times: np.ndarray, name: str, file: str, dt: float | None) -> float | None:
    """Step of a time vector [s]; one that is uneven does not matter if `dt` is given."""
    eps = np.finfo(times.dtype).eps if times.dtype.kind == "f" else 0.0
    times = times.astype(np.float64)
    resolution = 4.0 * float(eps) * np.abs(times).max()
    try:
        return time_step(times, lambda row: f"{file}, `{name}`, sample {row}", resolution)
    except ValueError:
        if dt is None:
            raise
        return None


def _stated_steps(variables, n_times: int, file: str, dt: float | None) -> dict[str, float | None]:
    """Step [s] by every variable that states one: a rate, a step and a time vector of the same length."""
    steps = scalar_steps(variables, file)
    for name, value in variables.items():
        if value.dtype.kind != "U" and name.lower() in TIMES and _shape(value) == (n_times,):
            steps[name] = _even(np.squeeze(value), name, file, dt)
    return steps


def scalar_steps(variables, file: str) -> dict[str, float | None]:
    """Step [s] by every number that is a step or a rate, with its unit as a text too, such as "100 Hz"."""
    steps = {}
    for name, value in variables.items():
        if name.lower() not in SCALARS or value.size != 1:
            continue
        number, unit = value.item(), Unit(*SCALARS[name.lower()])
        if isinstance(number, str):
            text, _, word = number.strip().partition(" ")
            number, unit = to_number(text), unit_of(word) if word else unit
            if number is None or unit is None or unit.quantity not in ("time", "frequency"):
                raise ValueError(
                    f"{file}, `{name}`: a step or rate must be a number and a unit, got {value.item()!r}. "
                    "Correct it, or remove it and pass `dt`."
                )
        if number > 0.0:
            in_si = float(number) * unit.factor
            steps[name] = in_si if unit.quantity == "time" else 1.0 / in_si
    return steps


def agreed(stated: dict[str, float | None], file: str, dt: float | None) -> float | None:
    """The one step [s] a file states, None if it is silent; an error if it contradicts itself."""
    steps = {name: step for name, step in stated.items() if step is not None}
    if not steps:
        return None
    first = next(iter(steps.values()))
    if dt is None and not np.allclose(list(steps.values()), first, rtol=1e-3, atol=0.0):
        said = listed([f"{name}: {step:g} s" for name, step in steps.items()])
        raise ValueError(f"`dt` must be given, {file} contradicts itself ({said}).")
    return first
