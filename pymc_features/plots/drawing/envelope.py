"""Long histories, drawn so that measured and predicted ones stay visible below each other.

Of more samples than pixels a line hides what lies below it. Time is cut into columns instead, and of each the
smallest and the largest value are drawn: as an area of what was measured, and as two lines of a response that
swings to and fro within a few pixels.
"""

from typing import NamedTuple

import numpy as np

SAMPLES = 2.0  # of each pixel column, above which a line hides what is below it
PIXELS = 6.0  # of an oscillation, below which its line is a blot


class Columns(NamedTuple):
    """How wide the columns are into which time is cut [s], and whether responses are too fast for a line."""

    width: float
    is_fast: bool


def columns_of(ax, time: np.ndarray, responses: np.ndarray) -> Columns | None:
    """Columns for responses (sensor, time), each across an axis as wide as this one; None: lines show them.

    Columns are as wide as a pixel, or as a mean oscillation of what is too fast for a line.
    """
    pixels = max(1, int(ax.get_window_extent().width))
    if time.size <= SAMPLES * pixels:
        return None
    is_below = responses < responses.mean(axis=-1, keepdims=True)
    oscillations = 0.5 * np.count_nonzero(np.diff(is_below, axis=-1)) / len(responses)
    is_fast = PIXELS * oscillations > pixels
    count = min(pixels, oscillations) if is_fast else pixels
    return Columns(float(time[-1] - time[0]) / count, is_fast)


def envelope(time: np.ndarray, values: np.ndarray, width: float) -> tuple[np.ndarray, ...]:
    """Time [s], smallest and largest value of each column, from the first sample to the last.

    Neighbouring columns share a sample, so that an area between them has no gaps.
    """
    count = max(1, round((time[-1] - time[0]) / width))
    starts = np.unique(np.arange(count) * (time.size - 1) // count)
    ends = np.append(starts[1:], time.size - 1)
    low, high = (extreme(extreme.reduceat(values, starts), values[ends]) for extreme in (np.fmin, np.fmax))
    middle = 0.5 * (time[starts] + time[ends])
    middle[0], middle[-1] = time[0], time[-1]
    return middle, low, high


def draw_area(ax, time, low, high, columns, **style) -> None:
    """All between two histories."""
    if columns is not None:
        (time, low, _), (_, _, high) = (envelope(time, values, columns.width) for values in (low, high))
    ax.fill_between(time, low, high, **{"lw": 0} | style)


def draw_band(ax, time, low, high, columns, **style) -> None:
    """What lies between two histories; of fast ones, between the lower and the upper ends of envelopes."""
    if columns is None or not columns.is_fast:
        draw_area(ax, time, low, high, None, **style)
        return
    middle, *lower = envelope(time, low, columns.width)
    _, *upper = envelope(time, high, columns.width)
    for one, other in zip(lower, upper, strict=True):
        draw_area(ax, middle, one, other, None, **style)
        style.pop("label", None)


def draw_line(ax, time, values, columns, **style) -> None:
    """A history, or both ends of the envelope of a fast one."""
    if columns is None or not columns.is_fast:
        ax.plot(time, values, **style)
        return
    middle, *ends = envelope(time, values, columns.width)
    for end in ends:
        ax.plot(middle, end, **style)
        style.pop("label", None)


def draw_measured(ax, time, values, columns) -> None:
    """What was measured: dashes above lines, or an area below them, which is always wider than they are."""
    if columns is None:
        ax.plot(time, values, color="0.1", lw=0.7, ls="--", label="measured")
    else:
        width = 0.0 if columns.is_fast else 2.5
        draw_area(ax, time, values, values, columns, color="0.65", lw=width, zorder=0.9, label="measured")
