"""How much the compressed variables of a MATLAB file hold, without keeping it.

MATLAB 5.0 MAT-file format: a header of 128 bytes, then elements: type, number of bytes, and the bytes.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

HEADER, TAG, COMPRESSED = 128, 8, 15  # bytes; bytes; type of element
CHUNK = 2**16  # bytes


def decompressed_sizes(path: Path) -> Iterator[int]:
    """Bytes of the compressed variables, piece by piece; nothing of files of other versions."""
    with path.open("rb") as file:
        order = {b"IM": "little", b"MI": "big"}.get(file.read(HEADER)[-2:])
        while order and len(tag := file.read(TAG)) == TAG:
            kind, n_bytes = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind == COMPRESSED:
                yield from _inflated(file, n_bytes)
            else:
                file.seek(n_bytes, 1)


def _inflated(file, n_bytes: int) -> Iterator[int]:
    """Sizes of the pieces of one element."""
    inflate = zlib.decompressobj()
    while n_bytes > 0 and (raw := file.read(min(n_bytes, CHUNK))):
        n_bytes -= len(raw)
        while raw:
            yield len(inflate.decompress(raw, CHUNK))
            raw = inflate.unconsumed_tail
