"""MATLAB .mat files: versions 4 to 7 by SciPy, 7.3 by HDF5.

Arrays of numbers and text are read, those in structures too, as `name.field`. Objects, cells and function
handles are passed over, nothing in the file is executed, and an HDF5 file cannot send the reader to another
file.
"""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from pymc_features._checks import listed
from pymc_features.io.formats.matlab_layout import check_layout
from pymc_features.io.reading.labels import Label, Unit, unit_of
from pymc_features.io.reading.lines import check_size, shortened, to_number
from pymc_features.io.reading.recording import Channel, Columns, Format, Recording, Request, recording_of

#: Quantity and SI units of numbers that state the step.
SCALARS = {"dt": ("time", 1.0)} | dict.fromkeys(("fs", "samplingrate", "samplerate"), ("frequency", 1.0))
UNIT_NAMES = "units", "unit"
#: Bytes of an element, of the variables that are read from versions 4 to 7.
CLASSES = {
    **dict.fromkeys(("double", "int64", "uint64"), 8),
    **dict.fromkeys(("single", "int32", "uint32", "char"), 4),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int8", "uint8", "logical"), 1),
    "sparse": 0,
    "struct": 0,
}
DEEPEST = 4  # structures in one another


def load_variables(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers, sparse matrices and texts of a .mat file of any version, or of HDF5, by name."""
    import h5py

    try:
        return _load_hdf5(path) if h5py.is_hdf5(path) else _load_mat(path)
    except Exception as error:  # each damaged file fails in its own way, inside the parsers
        kind = "a MATLAB .mat" if path.suffix.lower() == ".mat" else "an HDF5"
        raise ValueError(
            f"{path.name} must be {kind} file, it cannot be read ({shortened(error)}). Save it again."
        ) from error


def _load_mat(path: Path) -> dict[str, np.ndarray]:
    """Variables of versions 4 to 7; those of other classes are not even opened."""
    from scipy.io import loadmat, whosmat

    held = check_layout(path)
    found = [entry for entry in whosmat(path) if entry[2] in CLASSES]
    if sum(CLASSES[kind] * math.prod(map(int, shape)) for _, shape, kind in found) > 8 * held:
        raise ValueError(f"its variables announce more than the {held} bytes that it holds")
    check_size(path, [8 * int(shape[-1]) for _, shape, kind in found if kind == "sparse"])
    contents = loadmat(path, variable_names=[name for name, _, _ in found])
    return {name: value for name, value in _flat(contents, "", 0) if not name.startswith("__")}


def _flat(contents: Mapping, prefix: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Names and arrays, of structures with the names of their fields."""
    for name, value in contents.items():
        kind = getattr(value, "dtype", None)
        if kind is not None and kind.names and value.size == 1 and depth < DEEPEST:
            fields = {field: value[field].item() for field in kind.names}
            yield from _flat(fields, f"{prefix}{name}.", depth + 1)
        elif kind is not None and kind.kind in "iufcbU":
            yield prefix + name, value


def _load_hdf5(path: Path) -> dict[str, np.ndarray]:
    """Variables of version 7.3: arrays are stored transposed, text as 16-bit codes, structures as groups.

    Other HDF5 files have facts in attributes: `units` of a data set, which go to its name, `dt` and `fs`.
    """
    import h5py

    variables, sizes = {}, []

    def read(group, prefix: str, depth: int) -> None:
        for key in {"dt", "fs", "units"} & set(group.attrs):
            variables[prefix + key] = np.asarray(_text(group.attrs[key]))
        for name in group:
            item = group[name] if _is_inside(group, name) and not name.startswith("#") else None
            if isinstance(item, h5py.Group) and "MATLAB_sparse" in item.attrs:
                variables[prefix + name] = _sparse(path, item)
            elif isinstance(item, h5py.Group) and depth < DEEPEST:
                read(item, f"{prefix}{name}.", depth + 1)
            elif isinstance(item, h5py.Dataset) and (array := _array(path, item, sizes)) is not None:
                unit = _text(item.attrs.get("units", item.attrs.get("unit", "")))
                variables[f"{prefix}{name} [{unit}]" if unit else prefix + name] = array
                for key in {"dt", "fs"} & set(item.attrs):
                    variables[prefix + key] = np.asarray(_text(item.attrs[key]))

    with h5py.File(path, "r") as file:
        read(file, "", 0)
    return variables


def _text(value):
    """An attribute, of which texts may be bytes."""
    return value.decode() if isinstance(value, bytes) else value


def _is_inside(group, name: str) -> bool:
    """Whether a name is that of something in the file itself."""
    import h5py

    return isinstance(group.get(name, getlink=True), h5py.HardLink)


def _array(path: Path, item, sizes: list[int]) -> np.ndarray | None:
    """Numbers or text of a data set that is stored in the file itself."""
    pairs = item.dtype.names == ("real", "imag")
    if item.external or item.is_virtual or "MATLAB_empty" in item.attrs:
        return None
    if item.dtype.kind not in "iuf" and not pairs:
        return None
    sizes.append(_stored_size(item))
    check_size(path, sizes)
    kind = str(_text(item.attrs.get("MATLAB_class", "double")))
    if kind == "char":
        return np.array(["".join(map(chr, np.ravel(item[()])))])
    if not (kind in ("double", "single") or kind.startswith(("int", "uint"))):
        return None
    values = item[()].T
    return values["real"] + 1j * values["imag"] if pairs else values


def _stored_size(item) -> int:
    """Bytes of a data set, all of which must be in the file."""
    n_bytes = item.dtype.itemsize * math.prod(map(int, item.shape))
    if item.chunks is None:
        held = item.id.get_storage_size()
    else:
        held = item.id.get_num_chunks() * item.dtype.itemsize * math.prod(map(int, item.chunks))
    if n_bytes > held:
        raise ValueError(f"`{item.name}` announces {n_bytes:.3g} bytes, the file holds {held}")
    return n_bytes


def _sparse(path: Path, group):
    """A sparse matrix, which is a group of compressed columns."""
    from scipy import sparse

    names = [name for name in ("jc", "data", "ir") if group.get(name, getlink=True) is not None]
    parts = {name: _array(path, group[name], []) if _is_inside(group, name) else None for name in names}
    if any(part is None for part in parts.values()) or "jc" not in parts:
        raise ValueError(f"`{group.name}` is no sparse matrix of numbers")
    starts, rows = (np.ravel(parts.get(name, [])) for name in ("jc", "ir"))
    for places in (starts, rows):
        if not ((places >= 0) & (places < 2**62) & (places == np.rint(places))).all():
            raise ValueError(f"`{group.name}` must hold places from 0 on")
    shape = int(group.attrs["MATLAB_sparse"]), starts.size - 1
    matrix = sparse.csc_array(shape)
    if "data" in parts:
        places = rows.astype(np.int64), starts.astype(np.int64)
        matrix = sparse.csc_array((np.ravel(parts["data"]), *places), shape=shape)
    matrix.check_format()
    return matrix


# --- channels ---------------------------------------------------------------------------------------


def read_matlab(path: Path, request: Request) -> Recording:
    """The vectors of a file, and the rows of its matrices, whose longer side is time; see `read_channels`."""
    return recording_of_variables(load_variables(path), path.name, request)


def recording_of_variables(variables: Mapping, file: str, request: Request) -> Recording:
    """The vectors and matrices among some variables on their clocks."""
    groups: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    for name, value in variables.items():
        if value.dtype.kind in "iuf" and value.size > 1 and value.ndim <= 2:
            array = np.squeeze(value)
            groups.setdefault((_inside(name), max(array.shape)), {})[name] = array
    channels = []
    _check_times(groups, file, request)
    for (inside, n_times), arrays in groups.items():
        problems = {name: _problem(array, name, file, request.gaps) for name, array in arrays.items()}
        channels += [Channel(name, np.zeros(0), problem=text) for name, text in problems.items() if text]
        whole = {name: array for name, array in arrays.items() if not problems[name]}
        if whole and n_times - request.skip >= 2:
            facts = {name: value for name, value in variables.items() if _inside(name) in (inside, "")}
            columns = _columns(file, whole, n_times, request)._replace(
                units=_stated_units(facts, inside, file), dt=_stated_step(facts, inside, file, request.dt)
            )
            names = [text for label in columns.labels for text in (label.text, label.name)]
            known = request.clock in names or request.clock is False
            clock = request.clock if known or len(groups) == 1 else None
            found = recording_of(columns, request._replace(clock=clock)).channels
            of = (name for name, array in whole.items() for _ in range(array.size // n_times))
            channels += [channel._replace(label=name) for channel, name in zip(found, of, strict=True)]
    if not channels:
        held = listed([f"{name} {value.shape}" for name, value in sorted(variables.items())])
        raise ValueError(f"{file} must hold histories of at least 2 samples, it holds {held}. Save vectors.")
    return Recording(file, channels, skipped=True)


def _check_times(groups, file: str, request: Request) -> None:
    """Refuse times that are none of the samples of any variable."""
    for (_, n_times), arrays in groups.items():
        times = [name for name in arrays if Label.of(name.rpartition(".")[2]).role == "time"]
        if len(times) == len(arrays) and len(groups) > 1 and request.clock is None and request.dt is None:
            others = [f"{name} {a.shape}" for group in groups.values() for name, a in group.items()]
            raise ValueError(
                f"{file}: `{times[0]}` must have one time for each sample, got {n_times} beside "
                f"{listed(others)}. Name the times by `clock`, or pass clock=False and `dt`."
            )


def _inside(name: str) -> str:
    """The structure that a variable is in."""
    return name.rpartition(".")[0]


def _columns(file: str, arrays: dict[str, np.ndarray], n_times: int, request: Request) -> Columns:
    """Vectors and matrices of one length as a table."""
    labels, rows = [], []
    for name, array in arrays.items():
        histories = np.atleast_2d(array).astype(np.float64)
        histories = histories if histories.shape[1] == n_times else histories.T
        if len(histories) == 1:
            label = Label.of(name.rpartition(".")[2])
            inside = _inside(name)
            labels.append(Label(name, f"{inside}.{label.name}" if inside else label.name, label.unit))
        else:
            labels += [Label(f"{name} {k}", f"{name} {k}") for k in range(len(histories))]
        rows += list(histories)
    values = np.array(rows).T[request.skip :]
    eps = max((np.finfo(a.dtype).eps for a in arrays.values() if a.dtype.kind == "f"), default=0.0)
    return Columns(
        file,
        labels,
        values,
        lambda row, column: f"{file}, `{labels[column].text}`, sample {row + request.skip}",
        lambda column: 4.0 * float(eps) * np.abs(values[:, column]).max(),
        own=next(iter(arrays.values())).ndim == 1,
    )


def _problem(array: np.ndarray, name: str, file: str, gaps: bool) -> str:
    """Why the numbers of a variable are no histories."""
    bad = np.argwhere(np.isinf(array) if gaps else ~np.isfinite(array))
    if len(bad):
        return (
            f"{file}, `{name}`, sample {bad[0].max()}: values must be finite numbers, got "
            f"{array[tuple(bad[0])]}. Correct or cut it first."
        )
    if array.ndim == 2 and array.shape[0] == array.shape[1]:
        return (
            f"{file}, `{name}`: time must be the longer side of a matrix, got shape {array.shape}. Save one "
            "vector for each sensor."
        )
    return ""


def _stated_units(facts: Mapping, inside: str, file: str) -> str | None:
    """The text in the variable `units` of a structure, or else of the file."""
    texts = {
        _inside(name): str(value.item()).strip()
        for name, value in facts.items()
        if name.lower().rpartition(".")[2] in UNIT_NAMES and value.dtype.kind == "U" and value.size == 1
    }
    if len(set(texts.values())) > 1:
        said = listed(sorted(texts.values()))
        raise ValueError(f"{file} contradicts itself, it states the units {said}. Correct it.")
    return texts.get(inside, texts.get(""))


def _stated_step(facts: Mapping, inside: str, file: str, dt: float | None) -> float | None:
    """The step [s] that numbers and texts such as "100 Hz" state in a structure, or else in the file."""
    steps = {}
    for name, value in facts.items():
        key = re.sub("[_ ]", "", name.lower().rpartition(".")[2])
        if key not in SCALARS or value.size != 1:
            continue
        number, unit = value.item(), Unit(*SCALARS[key])
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
    steps = {name: step for name, step in steps.items() if _inside(name) == inside} or steps
    if not steps:
        return None
    first = next(iter(steps.values()))
    if dt is None and not np.allclose(list(steps.values()), first, rtol=1e-3, atol=0.0):
        said = listed([f"{name}: {step:g} s" for name, step in steps.items()])
        raise ValueError(f"`dt` must be given, {file} contradicts itself ({said}).")
    return first


MATLAB = Format(
    "MATLAB",
    lambda opening: opening.suffix == ".mat",
    ".mat",
    "what its variables `dt`, `fs`, `t`, `time` and `units` state",
    read_matlab,
)
