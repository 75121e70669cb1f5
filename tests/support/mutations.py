"""Damaged copies of files, and what a reader may do with one: refuse it plainly, or read what it says."""

import re
import time
import tracemalloc
import warnings

import numpy as np

SECONDS = 2.0
TIMES = 20  # the size of the file, besides what reading any file takes
BASE = 3_000_000  # bytes
EXTREMES = [
    b"1e999",
    b"-1",
    b"999999999999",
    b"nan",
    b"0",
    b"1,5",
    b"1_0",
    b"1e-400",
    b"",
    b"4294967295",
    b"0x10",
]
_NUMBER = re.compile(rb"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?")


def mutated(raw: bytes, rng: np.random.Generator) -> tuple[bytes, int]:
    """A copy with one to three changes, and how many; half of the copies have one."""
    n_changes = int(rng.choice([1, 1, 2, 3]))
    for _ in range(n_changes):
        raw = CHANGES[rng.integers(len(CHANGES))](raw, rng)
    return raw, n_changes


def _place(raw, rng):
    """Half of them in the first tenth, where the header is."""
    return int(rng.integers(max(len(raw) // (10 if rng.random() < 0.5 else 1), 1)))


def other_byte(raw, rng):
    at = _place(raw, rng)
    return raw[:at] + bytes([rng.integers(256)]) + raw[at + 1 :]


def other_digit(raw, rng):
    at = _place(raw, rng)
    return raw[:at] + bytes([rng.integers(48, 58)]) + raw[at + 1 :]


def cut_out(raw, rng):
    at = _place(raw, rng)
    return raw[:at] + raw[at + int(rng.integers(1, 20)) :]


def put_in(raw, rng):
    at = _place(raw, rng)
    return raw[:at] + rng.bytes(int(rng.integers(1, 8))) + raw[at:]


def twice(raw, rng):
    at = _place(raw, rng)
    return raw[:at] + raw[at : at + int(rng.integers(1, 200))] + raw[at:]


def cut_off(raw, rng):
    return raw[: _place(raw, rng)]


def extreme(raw, rng):
    found = list(_NUMBER.finditer(raw[: len(raw) // (10 if rng.random() < 0.5 else 1)]))
    if not found:
        return raw
    number = found[rng.integers(len(found))]
    return raw[: number.start()] + EXTREMES[rng.integers(len(EXTREMES))] + raw[number.end() :]


def _lines(raw, rng):
    lines = raw.split(b"\n")
    return lines, _place(lines, rng)


def without_line(raw, rng):
    lines, at = _lines(raw, rng)
    return b"\n".join(lines[:at] + lines[at + 1 :])


def line_twice(raw, rng):
    lines, at = _lines(raw, rng)
    return b"\n".join(lines[: at + 1] + lines[at:])


def lines_swapped(raw, rng):
    lines, at = _lines(raw, rng)
    other = int(rng.integers(len(lines)))
    lines[at], lines[other] = lines[other], lines[at]
    return b"\n".join(lines)


CHANGES = (
    other_byte,
    other_digit,
    cut_out,
    put_in,
    twice,
    cut_off,
    extreme,
    without_line,
    line_twice,
    lines_swapped,
)


def outcome(path, read, traced):
    """What `read` gives for a file, None if it refuses it, and whether it warns; its memory if `traced`."""
    size, used = path.stat().st_size, 0
    if traced:  # four times as slow
        tracemalloc.start()
    start = time.process_time()
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = read(path)
    except (ValueError, OSError) as error:
        found, caught, text = None, [], str(error)
        assert path.name in text or text.startswith("`") or text.startswith("Sensors must"), (
            f"whose error? {text}"
        )
        assert len(text) < 1500, text[:1500]
    finally:
        if traced:
            used = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
    assert time.process_time() - start < SECONDS
    assert used < TIMES * size + BASE, f"{used} bytes for a file of {size}"
    return found, bool(caught)


def is_what_it_says(found, expected, most=60) -> bool:
    """Whether a history (time,) is the expected one but for a factor, or but for a few samples.

    An altered digit cannot be told from another measurement; more than that can. Differences of neighbours
    are compared, since a mean is taken off in some formats.
    """
    if found.size != expected.size:
        return False
    if np.array_equal(np.sort(found), np.sort(expected)):  # lines that were swapped
        return True
    found, expected = np.diff(found), np.diff(expected)
    scale = np.median(found[expected != 0.0] / expected[expected != 0.0])
    close = np.isclose(
        found, scale * expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max() * max(abs(scale), 1.0)
    )
    return int((~close).sum()) <= most
