"""How much a file may hold: arrays much larger than itself are refused before memory is taken for them."""

from collections.abc import Iterable
from pathlib import Path

TIMES = 20  # the size of the file
ALWAYS = 64 * 2**20  # bytes; small files of much compressed or sparse arrays


def check_size(path: Path, n_bytes: Iterable[int]) -> int:
    """Refuse a file whose arrays would take more than twenty times its size, and more than 64 MiB.

    Returns
    -------
    int
        What they take.
    """
    promised, size = 0, path.stat().st_size
    for count in n_bytes:
        promised += count
        if promised > max(TIMES * size, ALWAYS):
            raise ValueError(
                f"{path.name} must not hold arrays of more than {TIMES} times its size and "
                f"{ALWAYS // 2**20} MiB, got {promised:.3g} bytes in a file of {size}. Is it damaged? "
                "If not, save it uncompressed."
            )
    return promised
