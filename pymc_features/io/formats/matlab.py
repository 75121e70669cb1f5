"""MATLAB .mat files: version 4 by SciPy, 5 to 7 by their layout, 7.3 and other HDF5 files by h5py; NumPy's.

Arrays of numbers and text are read, those in structures too, as `name.field`. Objects, cells and function
handles are passed over, nothing in a file is executed, and HDF5 cannot send the reader to another file.

Versions 5 to 7: a header of 128 bytes, then elements of a type, a number of bytes, and those bytes; an array
is an element of elements, and may be compressed. SciPy does not read these: it takes types and lengths as
they are, and a spoilt one ends the process. The MathWorks, MAT-File Format, section 1.
"""

import math
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.io import loadmat, whosmat

from pymc_features._checks import listed, require
from pymc_features.io.reading.labels import Label, role_of, unit_of
from pymc_features.io.reading.lines import check_size, most_bytes, shortened, to_number
from pymc_features.io.reading.recording import Channel, Columns, Recording, Request, recording_of

#: Units of numbers that state the step, by their names as of `_key`.
STEPS = "dt ts delta deltat timestep samplinginterval sampleinterval samplingperiod sampleperiod"
RATES = "fs samplingrate samplerate samplingfrequency samplefrequency samplingfreq samplefreq"
SCALARS = dict.fromkeys(STEPS.split(), unit_of("s")) | dict.fromkeys(RATES.split(), unit_of("Hz"))
DEEPEST = 4  # structures in one another
KINDS = {".mat": "a MATLAB .mat", ".npy": "a NumPy", ".npz": "a NumPy"}
NUMPY = b"\x93NUMPY"
HEADER = 128  # bytes
COMPRESSED, ARRAY = 15, 14  # types of elements
STRUCTURE, TEXT, SPARSE, NUMBERS = 2, 4, 5, range(6, 16)  # classes of arrays
CHUNK = 2**16  # bytes that are decompressed at a time
LOGICAL, COMPLEX = 0x0200, 0x0800  # flags
#: Numbers of a type of elements, and the codec of a text.
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
CODECS = {1: "latin-1", 2: "latin-1", 4: "utf-16-{}", 16: "utf-8", 17: "utf-16-{}", 18: "utf-32-{}"}


def load_variables(path: Path) -> dict[str, np.ndarray]:
    """Arrays of numbers, sparse matrices and texts of a .mat file of any version, HDF5 or NumPy, by name."""
    import h5py

    try:
        if h5py.is_hdf5(path):
            return _load_hdf5(path)
        if zipfile.is_zipfile(path):
            return _load_npz(path)
        raw = memoryview(path.read_bytes())
        if raw[: len(NUMPY)] == NUMPY:
            return {path.stem: np.load(path, mmap_mode="r", allow_pickle=False)}
        if 0 in raw[:4]:  # version 4, of which SciPy's reader is in Python; the header of version 5 is text
            pairs = loadmat(BytesIO(raw), spmatrix=False).items()
            names = [name for name, *_ in whosmat(BytesIO(raw))]
        else:
            pairs = [*_read_5(path, raw)]
            names = [name for name, _ in pairs if "." not in name]
        require(len(set(names)) == len(names), "a variable is there twice")
        return {name: value for name, value in pairs if name and not name.startswith("__")}
    except Exception as error:  # each damaged file fails in its own way
        kind = KINDS.get(path.suffix.lower(), "an HDF5")
        said = f"it cannot be read ({shortened(error)}). Save it again."
        raise ValueError(f"{path.name} must be {kind} file, {said}") from error


def _read_5(path: Path, raw: memoryview) -> Iterator[tuple[str, np.ndarray]]:
    """Names and values of the variables of versions 5 to 7."""
    order, left = "<" if raw[HEADER - 2 : HEADER] == b"IM" else ">", most_bytes(path)
    if bytes(raw[HEADER - 4 : HEADER - 2])[:: 1 if order == "<" else -1] != b"\0\1":
        raise ValueError("it is of no version that is known")
    for kind, part in _elements(raw[HEADER:], order, 1):
        if kind == COMPRESSED:
            inflate, whole = zlib.decompressobj(), bytearray()
            while part and len(whole) <= left:
                whole += inflate.decompress(part, CHUNK)
                part = inflate.unconsumed_tail
            require(inflate.eof, f"an array is cut, or must not be larger than {most_bytes(path):.3g} bytes")
            left -= len(whole)
            kind, part = next(_elements(memoryview(whole), order, 1), (0, b""))
        require(kind == ARRAY, f"a variable must be an array, type {ARRAY}, got type {kind}")
        yield from _array_5([*_elements(part, order)], order, "", 0)


def _elements(raw: memoryview, order: str, multiple: int = 8) -> Iterator[tuple[int, memoryview]]:
    """Types and contents of elements that follow one another, from multiples of some bytes."""
    start = 0
    while start + 8 <= len(raw):
        word, size = struct.unpack_from(f"{order}II", raw, start)
        short = word >> 16  # bytes that stand in the tag
        first, size = (start + 4, short) if short else (start + 8, size)
        if first + size > len(raw) or short > 4:
            raise ValueError(f"a part announces {size} bytes, what holds it ends before")
        yield word & 0xFFFF, raw[first : first + size]
        start += 8 + (0 if short else multiple * math.ceil(size / multiple))
    require(start >= len(raw), f"{len(raw) - start} bytes are left at the end of a part")


def _array_5(parts, order: str, prefix: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Name and value of an array of numbers or text, or of those in a structure."""

    def numbers(place: int) -> np.ndarray:
        kind, part = parts[place]
        return np.frombuffer(part, order + TYPES[kind])

    if not parts:
        return
    flags = int(numbers(0)[0])
    kind, dims, name = flags & 0xFF, numbers(1), prefix + bytes(parts[2][1]).decode("latin-1")
    if kind == STRUCTURE and dims.prod() == 1 and depth < DEEPEST:
        width, names = int(numbers(3)[0]), bytes(parts[4][1])
        for k, (_, part) in enumerate(parts[5:]):
            field = names[k * width : (k + 1) * width].split(b"\0")[0].decode("latin-1")
            inner = [*_elements(part, order)]
            yield from _array_5(inner, order, f"{name}.{field}", depth + 1)
    elif kind == TEXT and dims.prod() and len(parts[3][1]):
        codec = CODECS[parts[3][0]].format("le" if order == "<" else "be")
        rows = np.array(list(bytes(parts[3][1]).decode(codec))).reshape(dims, order="F")
        yield name, np.array(["".join(row) for row in rows.reshape(-1, dims[-1])])
    elif kind == SPARSE:
        # of logical ones the type is that of doubles, whatever they are
        data = np.frombuffer(parts[5][1], np.uint8) if flags & LOGICAL else numbers(5)
        data = data + 1j * numbers(6) if flags & COMPLEX else data
        yield name, _compressed(dims[0], numbers(4), numbers(3), data)
    elif kind in NUMBERS:
        values = numbers(3) + 1j * numbers(4) if flags & COMPLEX else numbers(3)
        yield name, values.reshape(dims, order="F")


def _compressed(n_rows: int, starts: np.ndarray, rows: np.ndarray, data: np.ndarray):
    """A sparse matrix of compressed columns, all of whose entries are in it."""
    rows, n_entries = rows[: int(starts[-1])], int(starts[-1])
    require(not (np.r_[rows, starts] % 1).any(), "places in a sparse matrix must be whole numbers")
    places = rows.astype(np.int64), starts.astype(np.int64)
    matrix = sparse.csc_array((data[:n_entries], *places), shape=(int(n_rows), starts.size - 1))
    matrix.check_format()
    return matrix


def _load_npz(path: Path) -> dict[str, np.ndarray]:
    """Arrays by name, or the matrix that `scipy.sparse.save_npz` wrote."""
    with zipfile.ZipFile(path) as file:
        check_size(path, [entry.file_size for entry in file.infolist()])
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    if not {"format", "shape", "data"} <= set(arrays):
        return arrays
    check_size(path, 8 * np.ravel(arrays["shape"]))
    matrix = sparse.load_npz(path)
    if matrix.format == "bsr":
        matrix.check_format(full_check=True)  # SciPy converts a damaged one to another matrix
    matrix = sparse.csc_array(matrix)
    matrix.check_format()
    return {path.stem: matrix}


def _load_hdf5(path: Path) -> dict[str, np.ndarray]:
    """Variables of version 7.3, and of other HDF5 files, which have `units`, `dt` and `fs` in attributes."""
    import h5py

    variables, sizes = {}, []

    def inside(group, name: str):
        """What a name stands for, if that is in the file itself."""
        return group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None

    def array(item) -> np.ndarray | None:
        pairs = item.dtype.names == ("real", "imag")
        kind = str(_text(item.attrs.get("MATLAB_class", "double")))
        is_number = kind in ("double", "single", "char") or kind.startswith(("int", "uint"))
        apart = item.external or item.is_virtual or "MATLAB_empty" in item.attrs
        if apart or not is_number or not (pairs or item.dtype.kind in "iuf"):
            return None
        sizes.append(item.nbytes)
        check_size(path, sizes)
        held = item.id.get_storage_size()
        if item.chunks:  # which may be compressed
            held = item.id.get_num_chunks() * item.dtype.itemsize * math.prod(item.chunks)
        if item.nbytes > held:
            raise ValueError(f"`{item.name}` announces {item.nbytes:.3g} bytes, the file holds {held}")
        if kind == "char":
            return np.array(["".join(map(chr, np.ravel(item[()])))])
        values = item[()].T
        return values["real"] + 1j * values["imag"] if pairs else values

    def stated(item, keys, prefix: str) -> None:
        for name in item.attrs:
            if _key(name) in keys:
                variables[prefix + name] = np.asarray(_text(item.attrs[name]))

    def read(group, prefix: str, depth: int) -> None:
        stated(group, (*SCALARS, "units", "unit"), prefix)
        for name in group:
            item = None if name.startswith("#") else inside(group, name)
            if isinstance(item, h5py.Group) and "MATLAB_sparse" in item.attrs:
                parts = [np.ravel(array(inside(item, part))) for part in ("jc", "ir", "data") if part in item]
                parts += [np.zeros(0, np.int64)] * (3 - len(parts))  # without entries there are columns alone
                variables[prefix + name] = _compressed(item.attrs["MATLAB_sparse"], *parts)
            elif isinstance(item, h5py.Group) and depth < DEEPEST:
                read(item, f"{prefix}{name}.", depth + 1)
            elif isinstance(item, h5py.Dataset) and (values := array(item)) is not None:
                unit = _text(item.attrs.get("units", item.attrs.get("unit", "")))
                variables[f"{prefix}{name} [{unit}]" if unit else prefix + name] = values
                stated(item, SCALARS, prefix)

    with h5py.File(path, "r") as file:
        read(file, "", 0)
    return variables


def _key(name: str) -> str:
    """What a variable is called inside its structure, in lower case, without blanks and underscores."""
    return re.sub("[_ ]", "", name.lower().rpartition(".")[2])


def _text(value):
    """An attribute, of which texts may be bytes."""
    return value.decode() if isinstance(value, bytes) else value


def read_matlab(path: Path, request: Request) -> Recording:
    """The vectors of a file, and the rows of its matrices, whose longer side is time; see `read_channels`."""
    file, variables = path.name, load_variables(path)
    groups: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    for name, value in variables.items():
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size > 1 and value.ndim <= 2:
            array = np.squeeze(value)
            groups.setdefault((name.rpartition(".")[0], max(array.shape)), {})[name] = array
    for (_, n_times), arrays in groups.items():
        times = [name for name in arrays if role_of(Label.of(name.rpartition(".")[2]).name) == "time"]
        if len(times) == len(arrays) and len(groups) > 1 and request.clock is None and request.dt is None:
            others = listed([f"{name} {a.shape}" for group in groups.values() for name, a in group.items()])
            what = f"`{times[0]}` must have one time for each sample, got {n_times} beside {others}"
            raise ValueError(f"{file}: {what}. Name the times by `clock`, or pass clock=False and `dt`.")
    channels = []
    for (inside, n_times), arrays in groups.items():
        whole = {name: array for name, array in arrays.items() if array.shape != (n_times, n_times)}
        problem = f"time must be the longer side of a matrix, got shape {(n_times, n_times)}. Save vectors."
        squares = [name for name in arrays if name not in whole]
        channels += [Channel(name, np.zeros(0), problem=f"{file}, `{name}`: {problem}") for name in squares]
        if whole and n_times - request.skip >= 2:
            facts = {of: value for of, value in variables.items() if of.rpartition(".")[0] in (inside, "")}
            units, dt = _stated(facts, inside, file, request.dt)
            columns = _columns(file, whole, n_times, request)._replace(units=units, dt=dt)
            names = [text for label in columns.labels for text in (label.text, label.name)]
            is_clear = request.clock in names or request.clock is False or len(groups) == 1
            clock = request.clock if is_clear else None
            found = recording_of(columns, request._replace(clock=clock)).channels
            of = (name for name, array in whole.items() for _ in range(array.size // n_times))
            channels += [channel._replace(label=name) for channel, name in zip(found, of, strict=True)]
    held = listed([f"{name} {value.shape}" for name, value in sorted(variables.items())])
    require(channels, f"{file} must hold histories of at least 2 samples, it holds {held}. Save vectors.")
    return Recording(file, channels, skipped=True)


def _columns(file: str, arrays: dict[str, np.ndarray], n_times: int, request: Request) -> Columns:
    """Vectors and matrices of one length as a table."""
    labels, rows = [], []
    for name, array in arrays.items():
        histories = np.atleast_2d(array).astype(np.float64)
        histories = histories if histories.shape[1] == n_times else histories.T
        inside, dot, own = name.rpartition(".")
        _, own, unit = Label.of(own)
        one = Label(name, inside + dot + own, unit)
        several = [Label(f"{name} {k}", f"{inside + dot + own} {k}", unit) for k in range(len(histories))]
        labels += [one] if len(histories) == 1 else several
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


def _stated(facts: Mapping, inside: str, file: str, dt: float | None) -> tuple[str | None, float | None]:
    """Units and step [s] that a structure, or else the file, states in texts and numbers such as "100 Hz"."""
    units, steps = set(), {}
    for name, value in facts.items():
        key = _key(name)
        stated = value.item() if value.size == 1 else None
        if key in ("units", "unit") and isinstance(stated, str):
            units.add(stated.strip())
        if key not in SCALARS or stated is None:
            continue
        text, _, word = str(stated).strip().partition(" ")
        number, unit = to_number(text), unit_of(word, "time", "frequency") if word else SCALARS[key]
        if number is None or unit is None:
            said = f"got {stated!r}. Correct it, or remove it and pass `dt`."
            raise ValueError(f"{file}, `{name}`: a step or rate must be a number and a unit, {said}")
        if number > 0.0:
            in_si = number * unit.factor
            steps[name] = in_si if unit.quantity == "time" else 1.0 / in_si
    require(len(units) < 2, f"{file} contradicts itself, it states the units {listed(sorted(units))}.")
    steps = {name: step for name, step in steps.items() if name.rpartition(".")[0] == inside} or steps
    first = next(iter(steps.values()), None)
    if dt is None and not all(np.isclose(step, first, rtol=1e-3, atol=0.0) for step in steps.values()):
        said = listed([f"{name}: {step:g} s" for name, step in steps.items()])
        raise ValueError(f"`dt` must be given, {file} contradicts itself ({said}).")
    return next(iter(units), None), first
