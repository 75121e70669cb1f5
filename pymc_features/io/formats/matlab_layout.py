"""Whether the parts of a MATLAB file are as long as they say, before SciPy takes memory for them.

MATLAB 5.0 (versions 5 to 7): a header of 128 bytes, then elements of a type, a number of bytes, and those
bytes; an array is an element of elements, and may be compressed. MATLAB 4: 20 bytes above each matrix.

The MathWorks, MAT-File Format, sections 1 and 2.
"""

import math
import zlib
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
    """Bytes that the arrays of a file hold, decompressed."""
    with path.open("rb") as file:
        header = file.read(HEADER)
        if 0 in header[:4]:  # as SciPy tells version 4, whose header is no text
            return _check_4(path, file, header)
        return _check_5(path, file, "little" if header[-2:] == b"IM" else "big")


def _check_5(path: Path, file, order: str) -> int:
    size, held = path.stat().st_size, 0
    while len(tag := file.read(TAG)) == TAG:
        kind, n_bytes = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
        if n_bytes > size - file.tell():
            raise ValueError(f"an element announces {n_bytes} bytes, the file ends before")
        raw = file.read(n_bytes)
        if kind == COMPRESSED:
            raw = _inflated(path, raw, held)
            kind, n_bytes = int.from_bytes(raw[:4], order), int.from_bytes(raw[4:8], order)
            raw = raw[TAG:]
            if n_bytes > len(raw):
                raise ValueError(f"a compressed array announces {n_bytes} bytes, {len(raw)} came out")
        if kind == ARRAY:
            _check_parts(raw, order)
        held += len(raw)
    return held


def _inflated(path: Path, raw: bytes, held: int) -> bytes:
    """The bytes of a compressed element."""
    inflate, pieces = zlib.decompressobj(), []
    while raw:
        pieces.append(inflate.decompress(raw, CHUNK))
        held = check_size(path, [held, len(pieces[-1])])
        raw = inflate.unconsumed_tail
    return b"".join(pieces)


def _check_parts(raw: bytes, order: str) -> None:
    """Elements of an array follow one another, from multiples of eight bytes, to its end."""
    start, parts, types = 0, [], []
    while start + TAG <= len(raw):
        word = int.from_bytes(raw[start : start + 4], order)
        short = word >> 16  # bytes that stand in the tag
        n_bytes = 0 if short else int.from_bytes(raw[start + 4 : start + 8], order)
        if start + TAG + n_bytes > len(raw) or short > 4:
            raise ValueError(f"a part of an array announces {n_bytes or short} bytes, the array ends before")
        first = start + 4 if short else start + TAG
        parts.append(raw[first : first + (short or n_bytes)])
        types.append(word & 0xFFFF)
        start += TAG + 8 * math.ceil(n_bytes / 8)
    flags = int.from_bytes(parts[0][:4], order) if parts else 0
    _check_types(flags, types)
    if flags & 0xFF == SPARSE:
        _check_sparse(parts, order)


def _check_types(flags: int, types: list[int]) -> None:
    """The parts of an array of numbers or text must all be there, and of the types that belong there."""
    kind, is_complex = flags & 0xFF, bool(flags & COMPLEX)
    others = TEXT_TYPES if kind == TEXT else NUMBER_TYPES
    wanted = [*FIRST_TYPES, *[others] * (len(types) - 3)]
    least = (6 if kind == SPARSE else 4) + is_complex
    known = kind in (TEXT, SPARSE, *NUMBERS)
    if known and (len(types) < least or any(t not in w for t, w in zip(types, wanted, strict=False))):
        raise ValueError(f"an array must have flags, dimensions, name and values, got types {types[:9]}")


def _check_sparse(parts: list[bytes], order: str) -> None:
    """Rows of the entries, and the first entry of each column, which SciPy takes as they are."""
    if len(parts) < 6 or any(len(part) % 4 for part in (parts[1], parts[3], parts[4])):
        raise ValueError("a sparse matrix must have rows, columns and entries")
    dims, rows, starts = (
        np.frombuffer(parts[k], f"{'<' if order == 'little' else '>'}i4") for k in (1, 3, 4)
    )
    whole = dims.size == 2 and starts.size == dims[1] + 1 and starts[0] == 0 and starts[-1] <= rows.size
    if not whole or (np.diff(starts) < 0).any() or (rows < 0).any() or (rows >= max(dims[0], 1)).any():
        raise ValueError("the entries of a sparse matrix must be in its rows and columns")


def _check_4(path: Path, file, first: bytes) -> int:
    """Type, rows, columns, whether complex, and length of the name, above each matrix."""
    size, start = path.stat().st_size, 0
    order = "little" if int.from_bytes(first[:4], "little") <= 5000 else "big"  # of all
    file.seek(0)
    while len(header := file.read(20)) == 20:
        kind, rows, columns, imaginary, n_name = (
            int.from_bytes(header[k : k + 4], order) for k in range(0, 20, 4)
        )
        if kind // 10 % 10 >= len(SIZES_4) or kind >= 5000 or imaginary > 1:
            raise ValueError("it is of no version that is known")
        start += 20 + n_name + rows * columns * (1 + imaginary) * SIZES_4[kind // 10 % 10]
        if start > size:
            raise ValueError(f"a matrix announces {rows} x {columns} numbers, the file ends before")
        file.seek(start)
    return size
