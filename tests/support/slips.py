"""Slips of the hand, planted into the examples of `pymc-features init`."""

import numpy as np
from scipy import signal

from pymc_features.update import write_example


def planted(folder, example: str, slip):
    """The file of an example with simulated data, after `slip(path, data)` has changed it and its table."""
    path = folder / "slip.toml"
    options = {"example": "building"} if example == "building" else {"synthetic": True}
    write_example(path, **options)
    slip(path, folder / "slip-measured.csv")
    return path


def text(*pairs):
    """Every old part of the configuration replaced by the new one."""

    def slip(path, data):
        changed = path.read_text()
        for old, new in pairs:
            assert old in changed, old
            changed = changed.replace(old, new)
        path.write_text(changed)

    return slip


def table(change):
    """A function of the table of the channels, (time, 1 + channel), times in its first column."""

    def slip(path, data):
        header, *rows = data.read_text().splitlines()
        changed = change(np.array([row.split(",") for row in rows], dtype=float))
        np.savetxt(data, changed, "%.6g", ",", header=header, comments="")

    return slip


def inverted(column):
    """One channel with the opposite sign."""
    return table(lambda rows: rows * np.where(np.arange(rows.shape[1]) == column, -1.0, 1.0))


def swapped(one, other):
    """Two channels in each other's place."""

    def change(rows):
        order = np.arange(rows.shape[1])
        order[[one, other]] = other, one
        return rows[:, order]

    return table(change)


def stretched(factor):
    """Times multiplied by a factor."""
    return table(lambda rows: rows * np.where(np.arange(rows.shape[1]) == 0, factor, 1.0))


def every(n):
    """Each nth sample, after a low-pass."""

    def change(rows):
        few = signal.decimate(rows[:, 1:], n, axis=0, ftype="fir")
        return np.column_stack([rows[::n, 0][: len(few)], few])

    return table(change)


def some(first, last):
    """Samples from the first up to the last."""
    return table(lambda rows: rows[first:last] - [rows[first, 0], *np.zeros(rows.shape[1] - 1)])


def nothing(path, data):
    """No slip."""
