"""Matrices that a finite-element program exported, once for the base and once for each changed property."""

from collections.abc import Mapping
from os import PathLike

import numpy as np
from scipy import sparse

from pymc_features._checks import as_list, check_number, check_path, listed, message, shown, warn_caller
from pymc_features.io import read_matrices
from pymc_features.io.reading.lines import check_readable
from pymc_features.io.reading.units import system_of_units

#: What programs call the matrices of a structure, in lower case.
NAMES = {
    "mass": ("m", "mass", "maa", "maax", "mgg", "mxx"),
    "stiffness": ("k", "stiffness", "stiff", "kaa", "kaax", "kgg", "kxx"),
    "damping": ("c", "damping", "baa", "baax", "bgg"),
}
HELD = 1e30  # of a diagonal entry: what programs hold a support with
LINEAR = 1e-6  # of the largest change: what two exports may differ by


class Exports:
    """The matrices of `AffineStructure.from_files` as a function of factors of properties.

    Attributes
    ----------
    terms : dict of str to dict
        Changes of the matrices, by parameter, per unit of its factor.
    labels : list of str or None
        Degrees of freedom that are kept.
    """

    def __init__(self, base, terms, units: str | None):
        force, length, mass = (1.0, 1.0, 1.0) if units is None else system_of_units(units)
        self._factors = {"mass": mass, "stiffness": force / length, "damping": force / length}
        whole, labels = self._read(base, "base")
        if missing := {"mass", "stiffness"} - set(whole):
            what = f"files with {' and '.join(sorted(missing))}"
            raise ValueError(message("base", what, ", ".join(whole) or "none", "Name them: {'mass': ...}."))
        if not isinstance(terms, Mapping) or not terms:
            raise TypeError(message("terms", "a mapping of parameters to (path, factor)", shown(terms)))
        changes = {str(name): self._change(str(name), given, whole) for name, given in terms.items()}
        kept = self._kept(whole, labels)
        self.labels = None if labels is None else [labels[k] for k in kept]
        self.base = {name: matrix[kept][:, kept] for name, matrix in whole.items()}
        self.terms = {
            name: {part: matrix[kept][:, kept] for part, matrix in change.items()}
            for name, change in changes.items()
        }

    def build(self, **factors):
        """(M, C, K), or (M, K) without damping, of factors of the properties."""
        parts = []
        for part, matrix in self.base.items():
            changes = [
                (factors[name] - 1.0) * change[part] for name, change in self.terms.items() if part in change
            ]
            parts.append((part, sum(changes, matrix)))
        found = dict(parts)
        order = ("mass", "damping", "stiffness") if "damping" in found else ("mass", "stiffness")
        return tuple(found[part] for part in order)

    def influence(self, direction: str) -> np.ndarray:
        """Displacements (n,) of the degrees of freedom for a unit of one direction of the ground."""
        moved = [label.partition(":")[2] == direction for label in self.labels or ()]
        if not any(moved):
            what = "one of the directions of degrees of freedom that the files name"
            known = sorted({label.partition(":")[2] for label in self.labels or ()} - {""})
            raise ValueError(message("direction", what, shown(direction), f"They have {listed(known)}."))
        return np.array(moved, dtype=np.float64)

    def _read(self, given, name: str) -> tuple[dict, list[str] | None]:
        """Matrices by part, in SI units, and the degrees of freedom where files name them."""
        parts = given if isinstance(given, Mapping) else {None: given}
        found, labels = {}, None
        for part, entry in parts.items():
            pair = as_list(entry) if not isinstance(entry, str | PathLike) else [entry, None]
            if part not in (None, *NAMES) or pair is None or len(pair) != 2:
                what = f"a path, or a mapping of {', '.join(NAMES)} to paths or (path, name)"
                raise TypeError(message(name, what, shown(given)))
            path = check_path(pair[0], name)
            check_readable(path, name)
            matrices = read_matrices(path)
            for matrix, value in matrices.items():
                usual = next((one for one, names in NAMES.items() if matrix.lower() in names), None)
                alone = "stiffness" if name != "base" and len(matrices) == 1 else None
                own = part or usual or alone
                wanted = matrix == pair[1] if pair[1] is not None else len(matrices) == 1 or usual == own
                if own is not None and wanted:
                    found[own] = self._factors[own] * (np.diag(value) if value.ndim == 1 else value)
                    labels = matrices.labels.get(matrix, labels)
            if part is not None and part not in found:
                got = f"{path.name} with {listed(list(matrices))}"
                raise ValueError(message(name, f"a file with the {part}", got))
        return {part: _square(matrix, part, name) for part, matrix in found.items()}, labels

    def _change(self, name: str, given, whole: dict) -> dict:
        """Changes of the matrices per unit of a factor, by one export or by two that agree."""
        where, slopes = f"terms[{name!r}]", []
        for pair in [given] if isinstance(given, tuple) else as_list(given) or [None]:
            if as_list(pair) is None or len(pair) != 2:
                raise TypeError(message(where, "(path, factor), or several", shown(given)))
            entry, factor = pair[0], check_number(pair[1], where)
            found, _ = self._read(entry, where)
            changed = {part: matrix for part, matrix in found.items() if part in whole}
            sizes = {matrix.shape[0] for matrix in [*changed.values(), *whole.values()]}
            if factor == 1.0 or not changed:
                raise ValueError(message(where, "an export of a factor other than 1", shown(pair)))
            if len(sizes) > 1:
                raise ValueError(message(where, "of the size of the base", listed(sorted(sizes))))
            slopes.append({part: (a - whole[part]) / (factor - 1.0) for part, a in changed.items()})
        for other in slopes[1:]:
            for part in slopes[0].keys() & other.keys():
                largest, off = abs(slopes[0][part]).max(), abs(other[part] - slopes[0][part]).max()
                if off > LINEAR * largest:
                    raise ValueError(
                        f"`{where}` must change the {part} in proportion to its factor, two exports differ "
                        f"by {off / largest:.2g} of the change. Choose a property in which it is linear."
                    )
        return {part: change for part, change in slopes[0].items() if abs(change).max() > 0.0}

    @staticmethod
    def _kept(whole: dict, labels: list[str] | None) -> np.ndarray:
        """Degrees of freedom that have stiffness or mass and are free to move."""
        mass, stiffness = whole["mass"], whole["stiffness"]
        if mass.shape != stiffness.shape:
            raise ValueError(message("base", f"of {stiffness.shape[0]} degrees of freedom", mass.shape[0]))
        size = sum(np.asarray(abs(matrix).sum(axis=0)).ravel() for matrix in (mass, stiffness))
        empty, held = size == 0.0, stiffness.diagonal() >= HELD
        for left_out, what in ((empty, "without stiffness and mass"), (held & ~empty, "that are held")):
            if left_out.any():
                names = [labels[k] if labels else str(k) for k in np.flatnonzero(left_out)]
                warn_caller(f"{len(names)} degrees of freedom {what} are left out: {listed(names)}.")
        return np.flatnonzero(~(empty | held))


def _square(matrix, part: str, name: str):
    """A square matrix, sparse ones by rows."""
    if matrix.shape[0] != matrix.shape[1]:
        raise ValueError(message(name, f"a file with a square {part}", f"shape {matrix.shape}"))
    return sparse.csr_array(matrix) if sparse.issparse(matrix) else matrix
