"""Identified modes as the likelihood takes them: checked, in one array without missing values."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pymc_features._checks import as_array, as_list, as_numbers, is_number, message, shown, warn_caller
from pymc_features.exceptions import ModalMatchWarning
from pymc_features.modal.data import ModalData
from pymc_features.ops import by_labels

FIELDS = ("frequencies", "shapes", "frequency_sd")


class Identified(NamedTuple):
    """Identifications of modes, i of them at s channels, of g different modes.

    Shapes are of any scale, of one sense where a mode has several; s = 0 without shapes.
    """

    frequencies: np.ndarray  # (i,), f^ [Hz]
    sd: np.ndarray  # (i,), standard deviation of ln f^ [-], zero where none was identified
    shapes: np.ndarray  # (i, s), phi^, real or complex, zero where an entry is missing
    known: np.ndarray  # (i, s), 1 where an entry is known, 0 throughout a shape that says nothing
    labels: np.ndarray  # (g,), what each mode is called
    groups: np.ndarray  # (g, i), 1 where an identification is of a mode

    @property
    def is_complex(self) -> bool:
        """Whether shapes are complex."""
        return np.iscomplexobj(self.shapes)

    @property
    def values(self) -> np.ndarray:
        """The data in one array (i, 1 + s), or (i, 1 + 2 s) of complex shapes: f^, Re phi^, Im phi^."""
        parts = [self.shapes.real, self.shapes.imag] if self.is_complex else [self.shapes]
        return np.hstack([self.frequencies[:, None], *parts])

    @property
    def entries(self) -> list[str]:
        """Names of the columns of `values`."""
        s = self.shapes.shape[1]
        names = [f"shape {j}" for j in range(s)]
        if self.is_complex:
            names = [f"{part} {name}" for part in ("real", "imaginary") for name in names]
        return ["frequency", *names]

    @property
    def by_label(self) -> np.ndarray:
        """`values` with a row for each mode, (g, k (1 + s)): those of its identifications, then zeros."""
        return by_label(self.values, self.groups).reshape(len(self.groups), -1)

    @property
    def known_by_label(self) -> np.ndarray:
        """1 where an entry of `by_label` is known, else 0."""
        parts = [np.ones((len(self.known), 1)), *[self.known] * (2 if self.is_complex else 1)]
        return by_label(np.hstack(parts), self.groups).reshape(len(self.groups), -1)

    @property
    def entries_by_label(self) -> list[str]:
        """Names of the columns of `by_label`."""
        k = rows_by_label(self.groups).shape[1]
        return self.entries if k == 1 else [f"{entry}.{j}" for j in range(k) for entry in self.entries]

    @property
    def scatter(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation of ln f^, and mean square of shapes of length one, both (g, k)."""
        of_f = frequency_scatter(self.frequencies, self.sd, self.groups)
        of_shapes = shape_scatter(self.shapes, self.known, self.groups)
        return by_label(of_f, self.groups, 1.0), by_label(of_shapes, self.groups)


def identified(observed, labels=None) -> Identified:
    """Check identified modes.

    Parameters
    ----------
    observed : object or mapping with `frequencies`, `shapes` and `frequency_sd`, or array_like (i,)
        Frequencies [Hz] (i,), shapes (i, s) or None, standard deviations (i,) [Hz] or None; an array is
        frequencies alone.
    labels : sequence (i,), optional
        Which mode each identification is of; by default each is of a mode of its own, but those that were
        found twice.
    """
    if isinstance(observed, Mapping):
        unknown = sorted(set(observed) - set(FIELDS))
        if unknown or "frequencies" not in observed:
            raise ValueError(message("observed", f"a mapping of {', '.join(FIELDS)}", ", ".join(observed)))
        frequencies, shapes, sd = (observed.get(name) for name in FIELDS)
    elif hasattr(observed, "frequencies"):
        frequencies, shapes, sd = (getattr(observed, name, None) for name in FIELDS)
        labels = getattr(observed, "labels", None) if labels is None else labels
    else:
        frequencies, shapes, sd = observed, None, None
    frequencies = ModalData(frequencies).frequencies
    shapes, known = _shapes(by_labels(shapes, axes=("mode", "sensor")), frequencies.size)
    sd = _sd(sd, frequencies) / frequencies
    if labels is None:
        labels = _numbers(doubles(np.log(frequencies), sd, shapes, known))
    owner, names = _labels(labels, frequencies.size)
    groups = (owner == np.arange(len(names))[:, None]).astype(np.float64)
    shapes = in_one_sense(shapes, groups)
    return Identified(frequencies, sd, shapes, known, names, groups)


def identification_names(labels, owner) -> list[str]:
    """Names of identifications: the label of each one's mode, with a number where it has several."""
    owner = list(owner)
    return [
        f"{labels[g]}" if owner.count(g) == 1 else f"{labels[g]}.{owner[:i].count(g)}"
        for i, g in enumerate(owner)
    ]


def _sd(sd, frequencies):
    """Standard deviations [Hz]; a missing one is zero, as one that was not identified."""
    sd = np.zeros(frequencies.size) if sd is None else as_numbers(sd, "frequency_sd")
    sd = np.where(np.isnan(sd), 0.0, sd)
    if sd.shape != frequencies.shape or not ((sd >= 0) & (sd < np.inf)).all():
        what = f"{frequencies.size} numbers that are not negative"
        raise ValueError(message("frequency_sd", what, shown(sd), "Pass Hz, NaN where there is none."))
    return sd


def _shapes(shapes, n):
    """Shapes without NaN, and where they are known; a shape of one entry says nothing."""
    if shapes is None:
        return np.zeros((n, 0)), np.zeros((n, 0))
    shapes = as_numbers(shapes, "shapes", allow_complex=True)
    if shapes.ndim != 2 or shapes.shape[0] != n:
        what = f"({n}, channels) to match `frequencies`"
        advice = "Give one row for each mode, NaN where a channel is missing; transpose modes in columns."
        raise ValueError(message("shapes", what, shapes.shape, advice))
    if np.isinf(shapes).any():
        raise ValueError(message("shapes", "finite", "infinity", "Pass NaN where a channel is missing."))
    known = ~np.isnan(shapes)
    known &= known.sum(axis=1, keepdims=True) > 1
    shapes = np.where(known, shapes, 0.0)
    zero = known.any(axis=1) & ~shapes.any(axis=1)
    if zero.any():
        got = f"zeros in row {zero.argmax()}"
        raise ValueError(message("shapes", "not zero", got, "Pass NaN where a shape is missing."))
    kind = np.complex128 if np.iscomplexobj(shapes) else np.float64
    return shapes.astype(kind), known.astype(np.float64)


def _numbers(owner):
    """A number for each mode; says which are taken for one that was found twice."""
    twice = [f"{i} and {first}" for i, first in enumerate(owner) if first != i]
    if twice:
        warn_caller(
            f"the identified modes {', '.join(twice)} (0 the first) are taken for one that was found twice: "
            "their frequencies are closer than their standard deviations, and their shapes agree. Leave one "
            "out, or pass `labels` that differ if they are two.",
            ModalMatchWarning,
        )
    return owner.tolist()


def _labels(labels, n):
    """The mode of each identification, and what the modes are called, in the order of their first."""
    given, labels = as_list(labels), as_array(labels)
    if given is None or labels.shape != (n,):
        what = f"{n} labels, one for each identification"
        raise ValueError(message("labels", what, f"shape {labels.shape}"))
    if not all(isinstance(label, str) or is_number(label) for label in given):
        raise TypeError(message("labels", "texts or numbers", shown(given)))
    names, first, owner = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return np.argsort(order)[owner], names[order]


# --- several identifications of one mode: by label, in one sense, and how much they scatter ---------------

SAME = 0.9  # MAC of a mode that an identification found twice
LEAST = 1e-4  # standard deviation of ln f and of a shape of length one: three digits of a table are no more


def rows_by_label(groups) -> np.ndarray:
    """Rows (g, k) of the identifications of each mode, -1 where it has fewer than k, from ones (g, i)."""
    places = [np.flatnonzero(row) for row in groups]
    k = max(map(len, places))
    return np.array([np.pad(p, (0, k - len(p)), constant_values=-1) for p in places])


def by_label(values, groups, missing=0.0) -> np.ndarray:
    """Values (i, ...) of identifications as (g, k, ...)."""
    rows = rows_by_label(groups)
    found = values[rows]
    found[rows < 0] = missing
    return found


def in_one_sense(shapes, groups) -> np.ndarray:
    """Shapes (i, s) with those of one mode turned by the phases, or signs, by which they agree best.

    The Gram matrix of e^(i a_j) v has the leading eigenvector e^(i a_j). A mode with one shape keeps it.
    """
    turned = shapes.copy()
    for row in groups:
        own = np.flatnonzero(row)
        if own.size > 1 and shapes.shape[1]:
            x = unit_rows(shapes[own])
            u = np.linalg.eigh(x @ x.conj().T)[1][:, -1]
            size = np.abs(u)
            turned[own] *= np.where(size > 0.0, u.conj() / np.where(size > 0.0, size, 1.0), 1.0)[:, None]
    return turned


def unit_rows(shapes) -> np.ndarray:
    """Rows of length one; rows of zeros stay."""
    length = np.linalg.norm(shapes, axis=1, keepdims=True)
    return shapes / np.where(length > 0.0, length, 1.0)


def frequency_scatter(frequencies, sd, groups) -> np.ndarray:
    """Standard deviations (i,) of ln f^ of each identification, besides the error of the model.

    Those that were identified; where there are none, of modes with several identifications, the deviation
    from the mean of each mode, pooled over modes.
    """
    counts = groups.sum(axis=1)
    repeated = (counts @ groups) > 1
    ln_f = np.log(frequencies)
    off = ln_f - (groups @ ln_f / counts) @ groups
    pooled = np.sqrt(np.sum(off**2) / max(1.0, np.sum(counts - 1.0)))
    return np.where(repeated & (sd == 0.0), max(pooled, LEAST), sd)


def shape_scatter(shapes, known, groups) -> np.ndarray:
    """Mean square (i,) by which shapes of length one differ from the mean of their mode; zero of lone shapes.

    Pooled over modes and channels, for the channels that an identification has.
    """
    x = unit_rows(shapes)
    counts = groups @ known
    mean = groups @ x / np.maximum(counts, 1.0)
    off = np.where(known > 0.0, x - groups.T @ mean, 0.0)
    free = np.sum(np.maximum(counts - 1.0, 0.0))
    each = max(np.sum(np.abs(off) ** 2) / max(1.0, free), LEAST**2)
    has_shape = known.any(axis=1)
    repeated = (groups @ has_shape) @ groups > 1
    return np.where(has_shape & repeated, each * known.sum(axis=1), 0.0)


def doubles(ln_f, sd, shapes, known) -> np.ndarray:
    """Number (i,) of the first identification that each is the same as, its own if there is none before it.

    The same are those whose frequencies are closer than their standard deviations and whose shapes agree, at
    three channels or more.
    """
    owner = np.arange(len(ln_f))
    for i in range(len(ln_f)):
        for j in range(i):
            both = known[i] * known[j]
            x, y = shapes[i] * both, shapes[j] * both
            norms = np.linalg.norm(x) * np.linalg.norm(y)
            if (
                both.sum() > 2
                and abs(ln_f[i] - ln_f[j]) < sd[i] + sd[j]
                and abs(x @ y.conj()) ** 2 > SAME * norms**2
            ):
                owner[i] = owner[j]
                break
    return owner
