"""Matrices of finite-element programs: of OpenSees, by its Python module, and of files that others exported.

OpenSees forms m M + c C + k K for coefficients of our choice (its integrator `GimmeMCK`), and the right-hand
side T' p of loads p at all nodes, of which T says how constrained nodes follow those that are retained
(`constraints Transformation`).
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from inspect import signature
from os import PathLike

import numpy as np
from scipy import sparse

from pymc_features._checks import as_list, check_file, check_number, listed, message, shown, warn_caller
from pymc_features.io import read_matrices
from pymc_features.io.reading.labels import system_of_units
from pymc_features.structures.linear import DofNames

DIRECTIONS = {  # by dimensions and degrees of freedom of a node
    (1, 1): ("x",),
    (2, 2): ("x", "y"),
    (2, 3): ("x", "y", "rz"),
    (3, 3): ("x", "y", "z"),
    (3, 6): ("x", "y", "z", "rx", "ry", "rz"),
}
#: With a stiffness of this share in it, a singular M or C can be factorised, which OpenSees does before it
#: gives the matrix. A power of two scales K without rounding: what is subtracted is what was added.
SHARE = 2.0**-200
MOST_DENSE = 300  # degrees of freedom, from which on sparse matrices cost less
TAG = 987654321  # of the pattern and time series that are added for a moment
#: What programs call the matrices of a structure, in lower case.
NAMES = {
    "mass": ("m", "mass", "maa", "maax", "mgg", "mxx"),
    "stiffness": ("k", "stiffness", "stiff", "kaa", "kaax", "kgg", "kxx"),
    "damping": ("c", "damping", "baa", "baax", "bgg"),
}
HELD = 1e30  # of a diagonal entry: what programs hold a support with
LINEAR = 1e-6  # of the largest change: what two exports may differ by


class OpenSeesModel:
    """Called with parameters, a user's function builds the model anew, and its matrices are read.

    Parameters
    ----------
    build : callable
        Calls the commands of OpenSees that define nodes, masses, elements and constraints.
    """

    def __init__(self, build: Callable):
        self.build, self.names, self.is_damped, self.ops = build, None, False, opensees()
        with suppress(TypeError, ValueError):  # of some built-in functions it is not known
            self.__signature__ = signature(build)

    def __call__(self, **values: float) -> tuple:
        """M, C and K (n, n) of the model as `build` leaves it; large ones are sparse."""
        ops = self.ops
        ops.wipe()
        try:
            self.build(**values)
            if not ops.getNodeTags():
                raise ValueError(message("build", "a function that makes a model in OpenSees", "no nodes"))
            prepare(ops)
            stiffness = left_hand_side(ops, 0.0, 0.0, 1.0)
            mass = left_hand_side(ops, 1.0, 0.0, SHARE) - SHARE * stiffness
            damping = left_hand_side(ops, 0.0, 1.0, SHARE) - SHARE * stiffness
            if self.names is None:
                self.names = names_of(ops, len(stiffness))
                check_held(self.names.dofs, mass, stiffness)
            self.is_damped |= bool(damping.any())
        finally:
            ops.wipe()
        if len(stiffness) > MOST_DENSE:
            return tuple(sparse.csc_array(a) for a in (mass, damping, stiffness))
        return mass, damping, stiffness


def opensees():
    """The module, which is no dependency."""
    try:
        from openseespy import opensees as ops
    except ImportError as error:
        raise ImportError(
            "`from_opensees` needs OpenSeesPy, which is not free for every use. Install it: "
            f"python -m pip install openseespy. ({error})"
        ) from error
    return ops


def prepare(ops) -> None:
    """An analysis whose equations are those of all nodes that are free."""
    ops.wipeAnalysis()
    ops.constraints("Transformation")
    ops.numberer("Plain")
    ops.system("FullGeneral")
    ops.algorithm("Linear")


def left_hand_side(ops, m: float, c: float, k: float) -> np.ndarray:
    """m M + c C + k K, array (n, n)."""
    ops.integrator("GimmeMCK", m, c, k)
    ops.analysis("Transient")
    ops.analyze(1, 0.0)  # forms it; where it is singular the step fails, and it is there nevertheless
    entries, n = np.array(ops.printA("-ret") or []), ops.systemSize()
    if not n or entries.size != n * n:
        what = "a function that leaves a model with free nodes"
        raise ValueError(message("build", what, f"{entries.size} entries of {n} equations"))
    return entries.reshape(n, n)


def check_held(names, mass, stiffness) -> None:
    """Refuse displacements that nothing holds, such as those of a master node out of its floor."""
    loose = ~(mass.any(axis=1) | stiffness.any(axis=1))
    if loose.any():
        free = ", ".join(name for name, is_loose in zip(names, loose, strict=True) if is_loose)
        what = "a function that gives each displacement mass or stiffness"
        raise ValueError(message("build", what, f"neither at {free}", "Hold them by `fix`."))


def names_of(ops, n: int) -> DofNames:
    """Names of all displacements of all nodes, by the equations that OpenSees gives them."""
    dofs, followers, held = [f"equation {i}" for i in range(n)], {}, []
    tied = list(ops.getConstrainedNodes() or [])
    for node in ops.getNodeTags():
        names = displacements(ops, node)
        if node not in tied:
            for name, equation in zip(names, ops.nodeDOFs(node), strict=True):
                if equation < 0:
                    held.append(name)
                else:
                    dofs[equation] = name
    ops.timeSeries("Constant", TAG)
    ops.integrator("GimmeMCK", 0.0, 0.0, 1.0)
    ops.algorithm("Linear", "-factorOnce")
    ops.analysis("Transient")
    at_rest = right_hand_side(ops, None, [])
    for node in tied:
        names, constrained = displacements(ops, node), set(ops.getConstrainedDOFs(node))
        for i, name in enumerate(names):
            unit = [float(i == j) for j in range(len(names))]
            row = right_hand_side(ops, node, unit) - at_rest
            if not row.any():
                held.append(name)
            elif i + 1 in constrained:
                followers[name] = row
            else:
                dofs[int(np.flatnonzero(row)[0])] = name
    return DofNames({name: i for i, name in enumerate(dofs)}, followers, held)


def right_hand_side(ops, node: int | None, load: list[float]) -> np.ndarray:
    """T' p (n,) of a load p at one node, besides what is there at rest."""
    ops.pattern("Plain", TAG, TAG)
    if node is not None:
        ops.load(node, *load)
    ops.analyze(1, 0.0)
    side = np.array(ops.printB("-ret"))
    ops.remove("loadPattern", TAG)
    return side


def displacements(ops, node: int) -> list[str]:
    """Names "node:direction" of the displacements and rotations of a node, or "node:1", "node:2", ..."""
    ndm, ndf = len(ops.nodeCoord(node)), int(np.ravel(ops.getNDF(node))[0])
    numbered = tuple(str(i + 1) for i in range(ndf))
    return [f"{node}:{direction}" for direction in DIRECTIONS.get((ndm, ndf), numbered)]


class Exports:
    """Terms of the matrices of `AffineStructure.from_files`, whose parameters are factors of properties.

    Attributes
    ----------
    nominal, constants, terms : dict
        As of `AffineTerms`; all factors are 1.
    labels : list of str or None
        Degrees of freedom that are free to move.
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
        changes = {str(name): self._change(str(name), source, whole) for name, source in terms.items()}
        free = self._free(whole, labels)
        self.labels = None if labels is None else [labels[k] for k in free]
        self.nominal = dict.fromkeys(changes, 1.0)
        self.terms = {
            part: [change[part][free][:, free] if part in change else None for change in changes.values()]
            for part in whole
        }
        self.constants = {
            part: matrix[free][:, free] - sum(a for a in self.terms[part] if a is not None)
            for part, matrix in whole.items()
        }

    def _read(self, source, name: str) -> tuple[dict, list[str] | None]:
        """Matrices by part, in SI units, and the degrees of freedom where files name them."""
        parts = source if isinstance(source, Mapping) else {None: source}
        by_kind, labels = {}, None
        for part, entry in parts.items():
            pair = as_list(entry) if not isinstance(entry, str | PathLike) else [entry, None]
            if part not in (None, *NAMES) or pair is None or len(pair) != 2:
                what = f"a path, or a mapping of {', '.join(NAMES)} to paths or (path, name)"
                raise TypeError(message(name, what, shown(source)))
            path = check_file(pair[0], name)
            matrices = read_matrices(path)
            for matrix, value in matrices.items():
                usual = next((one for one, names in NAMES.items() if matrix.lower() in names), None)
                alone = "stiffness" if name != "base" and len(matrices) == 1 else None
                kind = part or usual or alone
                is_meant = matrix == pair[1] if pair[1] is not None else len(matrices) == 1 or usual == kind
                if kind is not None and is_meant:
                    by_kind[kind] = self._factors[kind] * (np.diag(value) if value.ndim == 1 else value)
                    labels = matrices.labels.get(matrix, labels)
            if part is not None and part not in by_kind:
                got = f"{path.name} with {listed(list(matrices))}"
                raise ValueError(message(name, f"a file with the {part}", got))
        return {part: _square(matrix, part, name) for part, matrix in by_kind.items()}, labels

    def _change(self, name: str, source, whole: dict) -> dict:
        """Changes of the matrices per unit of a factor, by one export or by two that agree."""
        where, slopes = f"terms[{name!r}]", []
        for pair in [source] if isinstance(source, tuple) else as_list(source) or [None]:
            if as_list(pair) is None or len(pair) != 2:
                raise TypeError(message(where, "(path, factor), or several", shown(source)))
            entry, factor = pair[0], check_number(pair[1], where)
            exported, _ = self._read(entry, where)
            changed = {part: matrix for part, matrix in exported.items() if part in whole}
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
        changes = {part: change for part, change in slopes[0].items() if abs(change).max() > 0.0}
        if not changes:
            raise ValueError(message(where, "an export that changes a matrix", "none"))
        return changes

    @staticmethod
    def _free(whole: dict, labels: list[str] | None) -> np.ndarray:
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
