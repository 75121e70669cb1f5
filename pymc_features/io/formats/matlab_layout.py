"""Whether the parts of a MATLAB file are as long as they say, before SciPy takes memory for them.

MATLAB 5.0 (versions 5 to 7): a header of 128 bytes, then elements of a type, a number of bytes, and those
bytes; an array is an element of elements, and may be compressed. MATLAB 4: 20 bytes above each matrix.

The MathWorks, MAT-File Format, sections 1 and 2.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pymc_features.io.reading.lines import check_size

HEADER, TAG = 128, 8  # bytes
COMPRESSED, ARRAY = 15, 14  # types of elements
TEXT, SPARSE, NUMBERS = 4, 5, range(6, 16)  # classes of arrays
COMPLEX = 0x0800  # flag
# types of the parts that every array has, flags, dimensions and name, and of those of numbers and of text;
# SciPy takes any type as it is, and one in the wrong place ends the process
FIRST_TYPES = ({6}, {5}, {1, 2, 16})
NUMBER_TYPES, TEXT_TYPES = {*range(1, 8), 9, 12, 13}, {1, 2, 4, 16, 17, 18}
CHUNK = 2**16  # bytes
SIZES_4 = (8, 4, 4, 2, 2, 1)  # bytes of a number, by the tens of the type


def check_layout(path: Path) -> int:
    """Bytes that the arrays of a file hold, decompressed; no part is longer than what holds it."""
    raw, held = memoryview(path.read_bytes()), 0
    if 0 in raw[:4]:  # as SciPy tells version 4, whose header is no text
        return _check_4(raw)
    order = "<" if raw[HEADER - 2 : HEADER] == b"IM" else ">"
    for kind, part in _elements(raw[HEADER:], order, 1):
        if kind == COMPRESSED:
            inflate, pieces, inflated = zlib.decompressobj(), [], held
            while part:
                pieces.append(inflate.decompress(part, CHUNK))
                inflated = check_size(path, [inflated, len(pieces[-1])])
                part = inflate.unconsumed_tail
            kind, part = next(_elements(memoryview(b"".join(pieces)), order, 1), (0, b""))
        if kind == ARRAY:
            _check_array([*_elements(part, order)], order)
        held += len(part)
    return held


def _elements(raw: memoryview, order: str, multiple: int = 8) -> Iterator[tuple[int, memoryview]]:
    """Types and contents of elements that follow one another, from multiples of some bytes."""
    start = 0
    while start + TAG <= len(raw):
        word, size = struct.unpack_from(f"{order}II", raw, start)
        short = word >> 16  # bytes that stand in the tag
        first, size = (start + 4, short) if short else (start + TAG, size)
        if first + size > len(raw) or short > 4:
            raise ValueError(f"a part announces {size} bytes, what holds it ends before")
        yield word & 0xFFFF, raw[first : first + size]
        start += TAG + (0 if short else multiple * math.ceil(size / multiple))


def _check_array(parts: list[tuple[int, memoryview]], order: str) -> None:
    """The parts of an array of numbers or text must all be there, and of the types that belong there.

    SciPy takes rows of the entries of a sparse matrix, and the first entry of each column, as they are.
    """
    types = [kind for kind, _ in parts]
    for part in (part for kind, part in parts if kind == ARRAY):  # of a structure, or a cell
        _check_array([*_elements(part, order)], order)
    numbers = [np.frombuffer(part, f"{order}i4") if len(part) % 4 == 0 else None for _, part in parts[:5]]
    flags = int(numbers[0][0]) if parts and len(parts[0][1]) >= 4 and numbers[0] is not None else 0
    kind, others = flags & 0xFF, TEXT_TYPES if flags & 0xFF == TEXT else NUMBER_TYPES
    wanted = [*FIRST_TYPES, *[others] * (len(types) - 3)]
    least = (6 if kind == SPARSE else 4) + bool(flags & COMPLEX)
    known = kind in (TEXT, SPARSE, *NUMBERS)
    if known and (len(types) < least or any(t not in w for t, w in zip(types, wanted, strict=False))):
        raise ValueError(f"an array must have flags, dimensions, name and values, got types {types[:9]}")
    if kind != SPARSE:
        return
    dims, rows, starts = (numbers[k] for k in (1, 3, 4))
    if any(places is None or not places.size for places in (dims, starts)) or rows is None:
        raise ValueError("a sparse matrix must have rows, columns and entries")
    whole = dims.size == 2 and starts.size == dims[1] + 1 and starts[0] == 0 and starts[-1] <= rows.size
    if not whole or (np.diff(starts) < 0).any() or (rows < 0).any() or (rows >= max(dims[0], 1)).any():
        raise ValueError("the entries of a sparse matrix must be in its rows and columns")


def _check_4(raw: memoryview) -> int:
    """Type, rows, columns, whether complex, and length of the name, above each matrix."""
    start, order = 0, "<" if int.from_bytes(raw[:4], "little") <= 5000 else ">"  # of all
    while start + 20 <= len(raw):
        kind, rows, columns, imaginary, n_name = struct.unpack_from(f"{order}5I", raw, start)
        if kind // 10 % 10 >= len(SIZES_4) or kind >= 5000 or imaginary > 1:
            raise ValueError("it is of no version that is known")
        start += 20 + n_name + rows * columns * (1 + imaginary) * SIZES_4[kind // 10 % 10]
        if start > len(raw):
            raise ValueError(f"a matrix announces {rows} x {columns} numbers, the file ends before")
    return len(raw)
