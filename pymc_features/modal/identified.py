"""Identified modes as the likelihood takes them: checked, by the mode of the structure that each is of."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pymc_features._checks import (
    as_array,
    as_list,
    as_numbers,
    is_number,
    message,
    require,
    shown,
    warn_caller,
)
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.data import ModalData, check_numbers, demand, mac
from pymc_features.ops import by_labels

FIELDS = ("frequencies", "shapes", "frequency_sd", "damping_ratios", "damping_sd", "shape_sd")
SAME = 0.9  # MAC of a mode that an identification found twice
LEAST = 1e-4  # standard deviation of ln f and of a shape of length one: three digits of a table are no more


class Identified(NamedTuple):
    """Up to k identifications of each of g modes, at s channels; NaN where there is none, or no entry.

    Shapes are of any scale, of one sense where a mode has several; s = 0 without shapes.
    """

    labels: np.ndarray  # (g,), what each mode is called
    groups: np.ndarray  # (g, i), whether an identification, in the order of the data, is of a mode
    frequencies: np.ndarray  # (g, k), f^ [Hz]
    sd: np.ndarray  # (g, k), standard deviation of ln f^ [-], zero where none was identified
    shapes: np.ndarray  # (g, k, s), phi^, real or complex
    shape_sd: np.ndarray  # (g, k, s), in the scale of the shapes, zero where none is known
    damping: np.ndarray | None = None  # (g, k), zeta^, None where it is not compared
    damping_sd: np.ndarray | None = None  # (g, k), standard deviation of ln zeta^, zero where none is known

    @property
    def is_complex(self) -> bool:
        """Whether shapes are complex."""
        return np.iscomplexobj(self.shapes)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """The data (g, k), or their real and imaginary parts, by their names."""
        parts = {"": self.shapes}
        if self.is_complex:
            missing = np.where(np.isnan(self.shapes), np.nan, 0.0)
            parts = {"real ": missing + self.shapes.real, "imaginary ": missing + self.shapes.imag}
        found = {"frequency": self.frequencies}
        found |= {} if self.damping is None else {"damping": self.damping}
        for part, values in parts.items():
            found |= {f"{part}shape {j}": values[..., j] for j in range(values.shape[-1])}
        return found

    @property
    def entries(self) -> list[str]:
        """Names of the columns of `values`."""
        k = self.frequencies.shape[1]
        return [name if k == 1 else f"{name}.{j}" for j in range(k) for name in self.columns]

    @property
    def rows(self) -> np.ndarray:
        """The data with a row for each mode, those of its identifications one after another."""
        return np.stack([*self.columns.values()], axis=-1).reshape(len(self.labels), -1)

    @property
    def values(self) -> np.ndarray:
        """The rows, zero for NaN."""
        return np.nan_to_num(self.rows)

    @property
    def known(self) -> np.ndarray:
        """1 where an entry of `values` is known, else 0."""
        return (~np.isnan(self.rows)).astype(np.float64)

    def scatter(self, by_entry: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What identifications scatter besides the error of the model.

        Standard deviations (g, k) of ln f^ and ln zeta^, (g, 0) where damping is not compared; mean squares
        (g, k) of shapes of length one, or variances (g, k s) of entries where their mean square is one.
        """
        of_f, of_zeta = log_scatter(self.frequencies, self.sd), np.zeros((len(self.labels), 0))
        if self.damping is not None:
            of_zeta = log_scatter(self.damping, self.damping_sd)
        of_entries = entry_scatter(self.shapes, self.shape_sd) if by_entry else shape_scatter(self.shapes)
        return of_f, of_zeta, of_entries


def identified(observed, labels=None, *, damping: bool = False) -> Identified:
    """Check identified modes: an object or mapping with some of `FIELDS`, as of `ModalData`, or frequencies.

    Without labels each is of a mode of its own, but those that were found twice.
    """
    if isinstance(observed, Mapping):
        if not set(observed) <= set(FIELDS) or "frequencies" not in observed:
            raise ValueError(message("observed", f"a mapping of {', '.join(FIELDS)}", ", ".join(observed)))
        given = observed
    elif hasattr(observed, "frequencies"):
        given = {name: getattr(observed, name, None) for name in FIELDS}
        labels = getattr(observed, "labels", None) if labels is None else labels
    else:
        given = {"frequencies": observed}
    frequencies = ModalData(given["frequencies"]).frequencies
    given = {**given, "shape_sd": by_labels(given.get("shape_sd"), axes=("mode", "sensor"))}
    shapes, n = _shapes(given.get("shapes"), frequencies.size), frequencies.size

    def spread(name: str) -> np.ndarray | float:
        """Standard deviations, zero where there is none."""
        if (value := given.get(name)) is None:
            return 0.0
        values = as_numbers(value, name)
        values = np.where(values == 0.0, np.nan, values)
        return np.nan_to_num(check_numbers(values, name, n, shapes.shape[1]))

    arrays = {"frequencies": frequencies, "sd": spread("frequency_sd") / frequencies, "shapes": shapes}
    arrays["shape_sd"] = np.zeros(shapes.shape) + (spread("shape_sd") if shapes.size else 0.0)
    if damping:
        arrays["damping"] = ratios = _damping(given.get("damping_ratios"), n)
        arrays["damping_sd"] = np.nan_to_num(spread("damping_sd") / ratios)
    if labels is None:
        labels = doubles(np.log(frequencies), arrays["sd"], arrays["shapes"])
    listed, labels = as_list(labels), as_array(labels)
    is_whole, what = listed is not None and labels.shape == (n,), f"{n} labels, one for each identification"
    require(is_whole, message("labels", what, f"shape {labels.shape}"))
    if not all(isinstance(label, str) or is_number(label) for label in listed):
        raise TypeError(message("labels", "texts or numbers", shown(listed)))
    names, first, owner = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first)  # that of the first identifications
    names, owner = names[order], np.argsort(order)[owner]
    groups = owner == np.arange(len(names))[:, None]
    rows = np.full((len(names), groups.sum(axis=1).max()), -1)
    rows[owner, groups.cumsum(axis=1)[owner, np.arange(owner.size)] - 1] = np.arange(owner.size)
    by_mode = {name: np.append(x, np.full_like(x[:1], np.nan), axis=0)[rows] for name, x in arrays.items()}
    by_mode["shapes"] = in_one_sense(by_mode["shapes"])
    return Identified(names, groups, **by_mode)


def _damping(ratios, n: int) -> np.ndarray:
    """Damping ratios (n,), NaN where there is none."""
    ratios = np.full(n, np.nan) if ratios is None else check_numbers(ratios, "damping_ratios", n)
    advice = "Leave out `sigma_zeta`, or read the damping ratios as well."
    what = "`damping_ratios` must be known where `sigma_zeta` is given"
    demand(not np.isnan(ratios).all(), what, "none", advice)
    got = f"zero of mode {np.argmin(ratios != 0.0)}"
    what = "`damping_ratios` must be positive to be compared"
    demand((ratios != 0.0).all(), what, got, "Pass NaN where it is not known.")
    return ratios


def _shapes(shapes, n: int) -> np.ndarray:
    """Shapes (n, s), s = 0 without; a shape of one entry says nothing."""
    shapes = by_labels(shapes, axes=("mode", "sensor"))
    if shapes is None:
        return np.zeros((n, 0))
    shapes = as_numbers(shapes, "shapes", allow_complex=True)
    advice = "Give one row for each mode, NaN where a channel is missing; transpose modes in columns."
    is_whole = shapes.ndim == 2 and len(shapes) == n
    require(is_whole, message("shapes", f"({n}, channels) to match `frequencies`", shapes.shape, advice))
    finite = message("shapes", "finite", "infinity", "Pass NaN where a channel is missing.")
    require(not np.isinf(shapes).any(), finite)
    known = ~np.isnan(shapes)
    known &= known.sum(axis=1, keepdims=True) > 1
    zero = known.any(axis=1) & ~np.where(known, shapes, 0.0).any(axis=1)
    got = f"zeros in row {zero.argmax()}"
    require(not zero.any(), message("shapes", "not zero", got, "Pass NaN where a shape is missing."))
    return np.where(known, shapes, np.nan)


def doubles(ln_f, sd, shapes) -> list[int]:
    """Number (i,) of the first identification that each is the same as, its own if there is none before it.

    The same are those whose frequencies are closer than their standard deviations and whose shapes agree, at
    three channels or more; they are named in a warning.
    """
    known = (~np.isnan(shapes)).astype(np.int64)
    same = (known @ known.T > 2) & (mac(shapes, shapes) > SAME)
    same &= np.abs(ln_f[:, None] - ln_f) < sd[:, None] + sd
    owner = np.arange(len(ln_f))
    for i in owner:
        if same[i, :i].any():
            owner[i] = owner[same[i].argmax()]
    if twice := [f"{i} and {first}" for i, first in enumerate(owner) if first != i]:
        warn_caller(
            f"the identified modes {', '.join(twice)} (0 the first) are taken for one that was found twice: "
            "their frequencies are closer than their standard deviations, and their shapes agree. Leave one "
            "out, or pass `labels` that differ if they are two.",
            ModalMatchWarning,
        )
    return owner.tolist()


# --- several identifications of one mode: in one sense, and how much they scatter --------------------------


def in_one_sense(shapes) -> np.ndarray:
    """Shapes (g, k, s) with those of one mode turned by the phases, or signs, by which they agree best.

    The Gram matrix of e^(i a_j) v has the leading eigenvector e^(i a_j). A mode with one shape keeps it.
    """
    x = np.nan_to_num(shapes / lengths(shapes))
    u = np.linalg.eigh(x @ x.conj().swapaxes(1, 2))[1][..., -1:]
    size = np.abs(u)
    several = x.any(axis=2).sum(axis=1)[:, None, None] > 1
    return shapes * np.where(several & (size > 0.0), u.conj() / np.where(size > 0.0, size, 1.0), 1.0)


def lengths(shapes) -> np.ndarray:
    """Lengths of shapes at the channels that are known, 1 where there is none."""
    length = np.linalg.norm(np.nan_to_num(shapes), axis=-1, keepdims=True)
    return np.where(length > 0.0, length, 1.0)


def deviations(x) -> tuple[np.ndarray, np.ndarray]:
    """Squares of x (g, k, ...) about the mean of each mode, zero for NaN, and how many are more than one."""
    known = ~np.isnan(x)
    count = known.sum(axis=1, keepdims=True)
    mean = np.nan_to_num(x).sum(axis=1, keepdims=True) / np.maximum(count, 1)
    return np.abs(np.where(known, x - mean, 0.0)) ** 2, np.maximum(count - 1, 0)


def log_scatter(values, sd) -> np.ndarray:
    """Standard deviations (g, k) of logarithms besides the error of the model, 1 where there is no value.

    Those that were identified; where there are none, of modes with several identifications, the deviation
    from the mean of each mode, pooled over modes.
    """
    squares, more = deviations(np.log(values))
    pooled = np.sqrt(np.sum(squares) / max(1, np.sum(more)))
    return np.where(np.isnan(values), 1.0, np.where((more > 0) & (sd == 0.0), max(pooled, LEAST), sd))


def shape_scatter(shapes) -> np.ndarray:
    """Mean square (g, k) by which shapes of length one differ from the mean of their mode; zero of lone ones.

    Pooled over modes and channels, for the channels that an identification has.
    """
    squares, more = deviations(shapes / lengths(shapes))
    each = max(np.sum(squares) / max(1, np.sum(more)), LEAST**2)
    channels = (~np.isnan(shapes)).sum(axis=2)
    several = (channels > 0).sum(axis=1, keepdims=True) > 1
    return np.where(several, each * channels, 0.0)


def entry_scatter(shapes, sd) -> np.ndarray:
    """Variances (g, k s) of entries of shapes of a root mean square of one, besides the error of the model.

    Those that were identified; where there are none, of modes with several shapes, as of `shape_scatter`.
    """
    channels = (~np.isnan(shapes)).sum(axis=2, keepdims=True)
    pooled = shape_scatter(shapes)[..., None]  # of a length of one, which is a mean square of 1 / channels
    of_entries = np.square(sd * np.sqrt(channels) / lengths(shapes))
    variance = np.where(np.nan_to_num(sd) > 0.0, of_entries, pooled)
    return np.where(np.isnan(shapes), 0.0, variance).reshape(len(shapes), -1)
